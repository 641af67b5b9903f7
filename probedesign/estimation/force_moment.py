"""Touches that make a measured moment: the published force-moment method, and curves of touches for a fusion's start.

The force-moment method takes the force by the paper's equation 5, of any direction, and finds the arclengths at which
that force makes the measured moment. It acts on the centreline: the couple of a force at the surface is neglected. The
paper shoots from the base for zero moment at the tip. Here every trial starts at the tip, where the moment is zero by
itself, and is matched to the measured moment at the base: the same equation, solved in the direction in which errors
decay instead of growing through the thin tip (docs/decisions/0002).

Without the force, one measured moment has a curve of touches along the probe, each place with the frictionless force
that it takes. The point that was touched from several poses is where their curves meet.

Source: "Spatial Position Estimation of Lightweight and Delicate Objects using a Soft haptic Probe", equations 4 to 6.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from probedesign.core.frames import Array
from probedesign.estimation import multistart
from probedesign.estimation.error_sources import ErrorSources
from probedesign.estimation.estimate import Candidate
from probedesign.estimation.model import Observation
from probedesign.rod.batch import Batch, solve_batch
from probedesign.rod.contact import surface_point
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.kernels.equations import OK
from probedesign.rod.kernels.newton import COLD, SOLUTION, scratch_buffers, solve_cases
from probedesign.rod.kernels.surface_contact import TIP, TOUCH
from probedesign.rod.rod import Rod

STATIONS = 33  #: Arclengths scanned for candidates: L/32 apart, denser than the misfit's own waves (tests/estimation).
#: Forces up to which fewer will do, as F L² r(0)/(E I(0) r(L)): a probe that hardly bends makes no waves.
LIGHT = ((0.5, 9), (1.5, 17))
SCAN_TOLERANCE = 1e-5  #: Error a step [rad] while scanning.
ACROSS = 0.5  #: Sine from which a force counts as across the free rod.
ALONG = 0.26  #: Sine of 15°: a contact pushing closer to the surface would need a friction coefficient of 3.7.
#: Stations that a minimum may lie away from where the scan saw it: a probe bent by less than a thousandth of a radian
#: feels the scan's own errors.
REACH = 4
#: Share of the squared misfit that a last step may still take off: a hundred-thousandth of what is left unexplained,
#: which the rod's own digits hide.
FLAT = 1e-10
#: A secant is used as the curvature of the misfit within this factor of the curvature of a linear moment.
CURVED = 10.0
_MAX_ITERATIONS = 60
_CLOSE = 1e-10  # of the length: a hundredth of a nanometre on a long probe


def _stations(rod: Rod, force: Array) -> int:
    thinnest = float(rod.radius[rod.s <= rod.flank_end].min())
    softer_axis = min(rod.factors[1:3])
    stiffness = softer_axis * rod.youngs_modulus * math.pi / 4.0 * float(rod.radius[0]) ** 3 * thinnest
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
    along = tangents @ (force / (math.sqrt(force @ force) or 1.0))
    whole = (tangents * tangents).sum(axis=1) if force.any() else along**2
    sines: Array = np.sqrt(np.maximum(whole - along**2, 0.0))
    return sines


def _curvature(linear: float, slope: float, last: float, way: float) -> float:
    """Return the second derivative of half the squared misfit by arclength: the secant from the last place where it
    indicates a minimum, else that of a linear moment."""
    secant = (slope - last) / way if way != 0.0 else np.nan
    return secant if linear / CURVED < secant < CURVED * linear else max(linear, 1e-300)


@dataclass(frozen=True)
class Scan:
    """Scan of one reading along the probe, made when it is first needed; it does not depend on the reading's
    covariance.
    """

    rod: Rod  #: of the probe.
    gravity: Array  #: base axes [m/s²], (3,).
    force: Array  #: base axes [N], (3,).
    moment: Array  #: measured, about the base [N·m], (3,).

    @cached_property
    def starts(self) -> list[tuple[float, Array]]:
        """Return arclength [m] and tip (6,) of every local minimum of the scanned misfit."""
        stations, misfit, tips = self._scanned
        before, after = np.append(np.inf, misfit[:-1]), np.append(misfit[1:], np.inf)
        least = np.flatnonzero((misfit <= before) & (misfit <= after))
        return [(float(stations[i]), tips[i]) for i in least]

    @cached_property
    def _scanned(self) -> tuple[Array, Array, Array]:
        """Return arclengths [m] (j,), squared misfits of the base moment with the force there [N²·m²] (j,) and the
        tips' sections (j, 6), as far as equilibria exist."""
        rod, count = self.rod, _stations(self.rod, self.force)
        stations = np.linspace(0.0, rod.flank_end, count)
        loads = np.tile(rod.load(self.gravity, self.force, 0.0), (count, 1))
        loads[:, -1] = stations
        found = np.empty(count, dtype=SOLUTION)
        reached = solve_cases(
            0, count, rod.stacked, np.zeros(count, dtype=np.int64), loads, COLD, True,
            SCAN_TOLERANCE, 10.0 * SCAN_TOLERANCE, scratch_buffers(0, 0), found, np.empty((count, 15, 1)),
        )  # fmt: skip
        if found["status"][reached - 1] != OK:
            reached -= 1
        if not rod.is_curved:
            reached = _pushed(self.force, found["tip"][:1, :3], found["tangent"][:reached])
        misfit = ((found["moment"][:reached] - self.moment) ** 2).sum(axis=1)
        return stations[:reached], misfit, found["tip"][:reached]

    @cached_property
    def candidates(self) -> list[Equilibrium]:
        """Return the equilibria at the local minima of the misfit along the probe, best first."""
        found: list[Equilibrium] = []
        for s, tip in self.starts:
            eq = self._refined(s, tip)
            if eq is not None and all(abs(eq.s_contact - other.s_contact) >= 1e-6 * self.rod.length for other in found):
                found.append(eq)
        return sorted(found, key=lambda eq: float(((eq.wrench_base[3:6] - self.moment) ** 2).sum()))

    def _refined(self, s: float, guess: Array) -> Equilibrium | None:
        """Return the equilibrium at the minimum of the misfit nearest to s [m], with its load columns.

        Gauss-Newton with exact sensitivities and, from the second step on, secants of the slope: where no place
        explains the moment, Gauss-Newton steps alone converge linearly. A step that overshoots, or that leads where
        there is no equilibrium (the probe is unstable there), is halved.

        Returns:
            None if none was found, or if the search ended at a bound short of the probe's own ends or at the edge of
            the equilibria: that is no minimum.
        """
        rod, reach = self.rod, REACH * self.rod.length / (STATIONS - 1)
        low, high = max(s - reach, 0.0), min(s + reach, rod.flank_end)
        best: Equilibrium | None = None
        least, at, step, blocked, slope = np.inf, s, 0.0, False, np.nan
        for _ in range(_MAX_ITERATIONS):
            eq = rod.solve(self.gravity, self.force, s, guess=guess, guess_only=True, columns="load")
            misfit = eq.wrench_base[3:6] - self.moment
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


@dataclass(eq=False)
class Problem:
    """What one reading is located from."""

    sources: ErrorSources  #: error sources under its gravity.
    seen: Observation  #: the reading.
    friction: float  #: prior standard deviation of the friction ratio.
    noise: Array  #: covariance of the reading by noise and drift, (6, 6).

    @cached_property
    def scan(self) -> Scan:
        """Return the reading's scan along the probe, made when it is first needed."""
        return Scan(self.sources.model.rod, self.seen.gravity, self.seen.force, self.seen.wrench[3:6])


def touch_at(rod: Rod, s: float, force: Array, tangent: Array, x_axis: Array, tip: Array) -> Array:
    """Return the touch whose force crosses the centreline at s, (TOUCH,).

    Args:
        rod: of the probe.
        s: arclength of the centreline's point [m].
        force: on the probe [N], (3,).
        tangent, x_axis: of the section there, (3,) each.
        tip: section of the tip, (6,).
    """
    touch = np.zeros(TOUCH)
    multistart.placed(rod.body, rod.flank_end, s, force, tangent.copy(), x_axis.copy(), touch)
    touch[TIP:] = tip
    return touch


DOF = 2  #: Three moments, one unknown.


def locate(problem: Problem) -> list[Candidate]:
    """Return the places where the measured force makes the measured moment, or nearly.

    Args:
        problem: the reading and what it is known to.
    """
    return [_candidate(problem, eq) for eq in problem.scan.candidates]


def _candidate(problem: Problem, eq: Equilibrium) -> Candidate:
    """Return an equilibrium as a candidate.

    Its covariance is that of the published estimate, force by equation 5, then s by least squares on the moment. With
    a = ∂M/∂s and B = ∂M/∂F along the equilibria, a reading off by (ε_F, ε_M) moves s by aᵀ(ε_M - B ε_F)/(aᵀa) and the
    contact point by p_s δs + p_F ε_F. The standard deviation of s is infinite where the moment does not depend on s.
    """
    assert eq.sensitivity is not None
    rod, s, noise = problem.sources.model.rod, eq.s_contact, problem.noise
    force, R = eq.load[0:3].copy(), eq.R_at(s)
    D = np.nan_to_num(problem.sources.columns_at(touch_at(rod, s, force, R[:, 2], R[:, 0], eq.tip))[1])
    d_wrench, d_p = eq.sensitivity.d_wrench, eq.sensitivity.d_position
    a, misfit_by_wrench = d_wrench[3:6, 3], np.hstack([d_wrench[3:6, 0:3], -np.eye(3)])
    with np.errstate(divide="ignore", invalid="ignore"):
        s_by_wrench = -(a @ misfit_by_wrench) / float(a @ a)
    p_by_wrench = np.outer(d_p[:, 3], s_by_wrench)
    p_by_wrench[:, 0:3] += d_p[:, 0:3]
    by_sources = p_by_wrench @ D[:6] - D[9:12]
    cov = p_by_wrench @ noise @ p_by_wrench.T + by_sources @ by_sources.T
    misfit, misfit_by_sources = eq.wrench_base[3:6] - problem.seen.wrench[3:6], misfit_by_wrench @ D[:6]
    cov_misfit = misfit_by_wrench @ noise @ misfit_by_wrench.T + misfit_by_sources @ misfit_by_sources.T
    surface = surface_point(rod, eq)
    out = (surface - eq.p_contact_base) / max(float(np.linalg.norm(surface - eq.p_contact_base)), 1e-300)
    # Where around the section the force acts follows from its direction, which friction turns.
    lean = float(rod.radius_at(s)) * min(problem.friction, 1.0)
    return Candidate(
        s_contact=s,
        std_s=float(np.sqrt(s_by_wrench @ (noise + D[:6] @ D[:6].T) @ s_by_wrench)),
        p_contact_base=eq.p_contact_base,
        p_surface_base=surface,
        force_base=force,
        cov_contact_base=cov,
        cov_surface_base=cov + lean**2 * (np.eye(3) - np.outer(out, out)),
        force_normal=float("nan"),
        force_tangential=float("nan"),
        chi2=float(misfit @ np.linalg.solve(cov_misfit, misfit)),
        dof=DOF,
        lever=float(np.linalg.norm(eq.sensitivity.d_moment[:, 3])) / max(float(np.linalg.norm(force)), 1e-300),
        at_end=s in (0.0, rod.flank_end),
        shape=lambda: eq,
    )


CURVE_STATIONS = 24
NEAREST = 0.04  #: Of the stations to the base, over the length.
MAX_BENT = 6.0  #: F s² r(0)/(E I(0) r(s)) beyond which a push has no equilibrium; to search for one would take long.
_CURVE_ITERATIONS = 3
X_AXIS, Y_AXIS = slice(3, 6), slice(9, 12)  #: Of the section at the contact, in `Batch.frame`.


@dataclass(frozen=True)
class Curve:
    """Places that are consistent with one moment."""

    points: Array  #: of the centreline, in the world [m], (j, 3); NaN where no force makes the moment.
    touches: tuple[Array | None, ...]  #: that make the moment there, (TOUCH,) each, (j,).


def equal_moments(rod: Rod, gravity: Array, moment: Array, T_world_base: Array) -> Curve:
    """Return for each station the force across the probe whose base moment comes nearest to the one read, all at once.

    Args:
        rod: of the probe.
        gravity: base axes [m/s²], (3,).
        moment: read at the base [N·m], (3,).
        T_world_base: pose of the base, (4, 4).
    """
    stations = np.linspace(NEAREST, 1.0, CURVE_STATIONS) * rod.flank_end
    points, touches = np.full((CURVE_STATIONS, 3), np.nan), list[Array | None]([None] * CURVE_STATIONS)
    force, going = np.zeros((CURVE_STATIONS, 3)), np.arange(CURVE_STATIONS)
    for _ in range(_CURVE_ITERATIONS):
        bearable = np.linalg.norm(force[going], axis=1) <= _max_force(rod, stations[going])
        for j in going[~bearable]:
            points[j], touches[j] = np.nan, None
        going = going[bearable]
        if len(going) == 0:
            break
        batch = solve_batch(rod, gravity, force[going], stations[going], columns="load")
        going, batch = going[batch.ok], batch.rows(batch.ok)
        for j, case in zip(going, range(len(going)), strict=True):
            touches[j] = touch_at(rod, float(stations[j]), force[j].copy(), batch.frame[case, :3],
                                  batch.frame[case, X_AXIS], batch.tip[case])  # fmt: skip
        points[going] = batch.p_contact_base @ T_world_base[:3, :3].T + T_world_base[:3, 3]
        force[going] = _across(batch, force[going], moment)
    return Curve(points, tuple(touches))


def _max_force(rod: Rod, s: Array) -> Array:
    radius = rod.radius_at(s)
    most: Array = MAX_BENT * rod.youngs_modulus * math.pi / 4.0 * float(rod.radius[0]) ** 3 * radius / s**2
    return most


def _across(batch: Batch, force: Array, moment: Array) -> Array:
    across = np.stack([batch.frame[:, X_AXIS], batch.frame[:, Y_AXIS]], axis=2)
    by_force = batch.d_moment[:, :, :3]
    misfit = moment - batch.wrench_base[:, 3:6] + np.einsum("jik,jk->ji", by_force, force)
    found: Array = np.einsum("jik,jkl,jl->ji", across, np.linalg.pinv(by_force @ across), misfit)
    return found


def closest_approaches(curves: list[Curve]) -> list[tuple[int, ...]]:
    """Return where curves come nearest to each other: a station of each, for every local minimum, nearest first."""
    if len(curves) < 2:
        return []
    first = curves[0].points
    stations, total = [np.arange(CURVE_STATIONS)], np.zeros(CURVE_STATIONS)
    for other in curves[1:]:
        nearest, apart = _nearest(first, other.points)
        stations.append(nearest)
        total += apart**2
    before, after = np.append(np.inf, total[:-1]), np.append(total[1:], np.inf)
    lowest = np.flatnonzero((total <= before) & (total <= after) & np.isfinite(total))
    return [tuple(int(of[j]) for of in stations) for j in lowest[np.argsort(total[lowest])]]


def _nearest(points: Array, line: Array) -> tuple[NDArray[np.intp], Array]:
    """Return the vertex of a line (j, 3) next to where each point (i, 3) comes nearest to it, and how near [m]."""
    start, way = line[:-1], np.diff(line, axis=0)
    off = points[:, None] - start[None]
    with np.errstate(invalid="ignore"):
        share = np.clip((off * way).sum(axis=2) / (way * way).sum(axis=1), 0.0, 1.0)
        apart = np.linalg.norm(off - share[:, :, None] * way, axis=2)
    apart = np.where(np.isfinite(apart), apart, np.inf)
    segment = apart.argmin(axis=1)
    i = np.arange(len(points))
    vertex = segment + (np.nan_to_num(share[i, segment]) > 0.5)
    return vertex, apart[i, segment]
