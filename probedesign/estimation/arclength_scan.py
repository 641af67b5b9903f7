"""Where along the probe a known force acts: the arclengths whose base moment matches the reading.

The paper shoots from the base for zero moment at the tip. Here every trial starts at the tip, where the
moment is zero by itself, and is matched to the measured moment at the base: the same equation, met from
the side on which errors die out instead of growing through the thin tip (docs/decisions/0002).
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from probedesign.core.frames import Array
from probedesign.estimation.observation import Observation
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.kernels.equations import OK
from probedesign.rod.kernels.newton import COLD
from probedesign.rod.kernels.solve import SOLUTION, scratch_buffers, solve_cases
from probedesign.rod.rod import Rod

STATIONS = 33
"""Arclengths scanned for candidates: L/32 apart, denser than the misfit's own waves (tests/estimation)."""
LIGHT = ((0.5, 9), (1.5, 17))
"""Forces up to which fewer will do, as F L² r(0)/(E I(0) r(L)): a probe that hardly bends makes no waves."""
SCAN_TOLERANCE = 1e-5
"""Error a step [rad] while scanning."""
ACROSS = 0.5
"""Sine from which a force counts as across the free rod."""
ALONG = 0.26
"""Sine of 15°: a contact pushing closer to the surface would need a friction coefficient of 3.7."""
REACH = 4
"""Stations that a minimum may lie away from where the scan saw it: a probe bent by less than a thousandth of a
radian feels the scan's own errors."""
FLAT = 1e-10
"""Share of the squared misfit that a last step may still take off: a hundred-thousandth of what is left unexplained,
which the rod's own digits hide."""
CURVED = 10.0
"""A secant is used as the curvature of the misfit within this factor of the curvature of a linear moment."""
_MAX_ITERATIONS = 60
_CLOSE = 1e-10  # of the length: a hundredth of a nanometre on a long probe


def scan(rod: Rod, gravity: Array, force: Array, moment: Array) -> tuple[Array, Array, Array]:
    """Return the misfit of the base moment as the force acts at each of many arclengths.

    Args:
        rod: the rod.
        gravity: base axes [m/s²], (3,).
        force: base axes [N], (3,).
        moment: measured, about the base [N·m], (3,).

    Returns:
        Arclengths [m] (j,), squared misfit [N²·m²] (j,) and the tips' sections (j, 6), as far as equilibria exist.
    """
    count = _stations(rod, force)
    stations = np.linspace(0.0, rod.flank_end, count)
    loads = np.tile(rod.load(gravity, force, 0.0), (count, 1))
    loads[:, -1] = stations
    found = np.empty(count, dtype=SOLUTION)
    reached = solve_cases(
        0, count, rod.stacked, np.zeros(count, dtype=np.int64), loads, rod.directed, COLD, True,
        SCAN_TOLERANCE, 10.0 * SCAN_TOLERANCE, *scratch_buffers(0, 0), found, np.empty((count, 15, 1)),
    )  # fmt: skip
    if found["status"][reached - 1] != OK:
        reached -= 1
    reached = _pushed(force, found["tip"][:1, :3], found["tangent"][:reached])
    misfit = ((found["moment"][:reached] - moment) ** 2).sum(axis=1)
    return stations[:reached], misfit, found["tip"][:reached]


def _stations(rod: Rod, force: Array) -> int:
    """Return how many arclengths to scan."""
    thinnest = float(rod.radius[rod.s <= rod.flank_end].min())
    stiffness = rod.youngs_modulus * math.pi / 4.0 * float(rod.radius[0]) ** 3 * thinnest
    bend = math.sqrt(force @ force) * rod.length**2 / stiffness
    return next((count for most, count in LIGHT if bend < most), STATIONS)


def _pushed(force: Array, free: Array, tangents: Array) -> int:
    """Return how many stations from the base on can be pushed so: where the force has bent the rod into its own
    direction, no contact short of the tip can push along the surface it touches."""
    across = (_sines(force, free) > ACROSS).all() and _sines(force, np.array([[0.0, 0.0, 1.0]]))[0] > ACROSS
    along = _sines(force, tangents) <= ALONG
    along[:1] = False
    return int(np.argmax(along)) if across and along.any() else len(tangents)


def _sines(force: Array, tangents: Array) -> Array:
    """Return the sine of the angle between a force and each tangent (j, 3); 0 without a force."""
    along = tangents @ (force / (math.sqrt(force @ force) or 1.0))
    whole = (tangents * tangents).sum(axis=1) if force.any() else along**2
    sines: Array = np.sqrt(np.maximum(whole - along**2, 0.0))
    return sines


def refine(
    rod: Rod, gravity: Array, force: Array, moment: Array, s: float, low: float, high: float, guess: Array
) -> Equilibrium | None:
    """Return the equilibrium at the nearest minimum of the misfit in [low, high].

    Gauss-Newton with exact sensitivities and, from the second step on, secants of the slope: where no place explains
    the moment, Gauss-Newton steps alone converge linearly.

    A step that overshoots, or that leads where there is no equilibrium (the probe is unstable there), is halved.

    Returns:
        The equilibrium with its load columns; None if none was found, or if the search ended at a bound short
        of the probe's own ends or at the edge of the equilibria: that is no minimum.
    """
    best: Equilibrium | None = None
    least, at, step, blocked, slope = np.inf, s, 0.0, False, np.nan
    for _ in range(_MAX_ITERATIONS):
        eq = rod.solve(gravity, force, s, guess=guess, guess_only=True, columns="load")
        misfit = eq.wrench_base[3:6] - moment
        square = float(misfit @ misfit)
        if eq.sensitivity is not None and square < least:
            a = eq.sensitivity.d_moment[:, 3]
            last, slope = slope, float(a @ misfit)
            step = -slope / _curvature(float(a @ a), slope, last, s - at)
            best, least, at, blocked, guess = eq, square, s, False, eq.tip
        else:
            blocked = blocked or not eq.ok
            step *= 0.5
        s = min(max(at + step, low), high)
        if best is None or abs(s - at) <= _CLOSE * rod.length or abs(slope * step) <= FLAT * least:
            break
    inside = at not in (low, high) or at in (0.0, rod.flank_end) or abs(step) <= _CLOSE * rod.length
    return best if inside and not blocked else None


def _curvature(linear: float, slope: float, last: float, way: float) -> float:
    """Return the second derivative of half the squared misfit by arclength: the secant from the last place where it
    indicates a minimum, else that of a linear moment."""
    secant = (slope - last) / way if way != 0.0 else np.nan
    return secant if linear / CURVED < secant < CURVED * linear else max(linear, 1e-300)


@dataclass(frozen=True)
class Scan:
    """Scan of one reading along the probe, made when it is first needed; it does not depend on the reading's
    covariance.

    Attributes:
        rod: of the probe.
        gravity: base axes [m/s²], (3,).
        force: base axes [N], (3,).
        moment: measured, about the base [N·m], (3,).
    """

    rod: Rod
    gravity: Array
    force: Array
    moment: Array

    @classmethod
    def of(cls, rod: Rod, seen: Observation) -> "Scan":
        """Return the scan of a reading."""
        return cls(rod, seen.gravity, seen.force, seen.wrench[3:6])

    @cached_property
    def starts(self) -> list[tuple[float, Array]]:
        """Return arclength [m] and tip (6,) of every local minimum of the scanned misfit."""
        stations, misfit, tips = self._scanned
        before, after = np.append(np.inf, misfit[:-1]), np.append(misfit[1:], np.inf)
        least = np.flatnonzero((misfit <= before) & (misfit <= after))
        return [(float(stations[i]), tips[i]) for i in least]

    @property
    def likeliest(self) -> tuple[float, Array] | None:
        """Return the start of least misfit; None if there is no equilibrium at all."""
        stations, misfit, tips = self._scanned
        return (float(stations[misfit.argmin()]), tips[misfit.argmin()]) if len(misfit) else None

    @cached_property
    def _scanned(self) -> tuple[Array, Array, Array]:
        return scan(self.rod, self.gravity, self.force, self.moment)

    @cached_property
    def candidates(self) -> list[Equilibrium]:
        """Return the equilibria at the local minima of the misfit along the probe, best first."""
        found: list[Equilibrium] = []
        for s, tip in self.starts:
            eq = self._refined(s, tip)
            if eq is not None and not any(_same_place(eq, other) for other in found):
                found.append(eq)
        return sorted(found, key=lambda eq: float(((eq.wrench_base[3:6] - self.moment) ** 2).sum()))

    def _refined(self, s: float, tip: Array) -> Equilibrium | None:
        reach = REACH * self.rod.length / (STATIONS - 1)
        low, high = max(s - reach, 0.0), min(s + reach, self.rod.flank_end)
        return refine(self.rod, self.gravity, self.force, self.moment, s, low, high, tip)


def _same_place(a: Equilibrium, b: Equilibrium) -> bool:
    return bool(abs(a.s_contact - b.s_contact) < 1e-6 * a.body.knots[-1])
