"""Maximum a posteriori: the touch of the surface that explains a reading best, with its noise, the error sources and
the prior on friction.

Where it may lie follows from one integration (`candidates.py`); where that leads to no place at all, from the scan of
the force–moment method (`force_moment.py`). The fit itself is compiled (`contact_fit.py`, `multistart.py`).
"""

import math
from collections import defaultdict
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from probedesign.core import statistics
from probedesign.core.frames import Array
from probedesign.core.statistics import MISFIT_CHANCE, max_chi2
from probedesign.estimation import multistart
from probedesign.estimation.contact_fit import AT_END, FIT_SCRATCH, STALLED, FitMemory
from probedesign.estimation.estimate import Candidate
from probedesign.estimation.force_moment import Problem, touch_at
from probedesign.estimation.multistart import FIT, MAX_STARTS
from probedesign.rod.equilibrium import Equilibrium, Sensitivity
from probedesign.rod.kernels.surface_contact import ALONG, AROUND, DEAD, NORMAL, TIP, S
from probedesign.rod.rod import Rod

_SAME = 1e-5  #: Places closer than this, over the length, are one.
_ALIKE = 0.05  #: Two places closer than this, over a standard deviation, are one; a fit ends within a hundredth of it.


def dof_of(friction: float) -> int:
    """Return the degrees of freedom left to test a contact by.

    Six channels and the two components of the prior on friction, less five unknowns; one where the direction of the
    force is free.
    """
    return 3 if math.isfinite(friction) else 1


def locate(problem: Problem, near: Candidate | None = None) -> list[Candidate]:
    """Locate the touches of greatest posterior probability, each with its covariance.

    Args:
        problem: the reading and what it is known to.
        near: a touch close by: only from there is then searched, everywhere only if nothing is there.
    """
    if near is not None and near.touch is not None:
        close = _places(problem, _fit(problem, near.touch))
        if close and explains(close[0]):
            return close[:1]
    places = _places(problem, _fit(problem, None))
    if not any(explains(place) for place in places):
        places += _scanned(problem)
    if problem.sources.model.rod.rounded_from is not None:
        places += _at_rounded_tip(problem, places)
    return _distinct(problem, places)


def _scanned(problem: Problem) -> list[Candidate]:
    rod, force, places = problem.sources.model.rod, problem.seen.force, list[Candidate]()
    for s, tip in problem.scan.starts:
        eq = rod.solve(problem.seen.gravity, force, s, guess=tip)
        R = eq.R_at(s) if eq.ok else np.eye(3)
        places += _places(problem, _fit(problem, touch_at(rod, s, force, R[:, 2], R[:, 0], tip)))
    return places


def _at_rounded_tip(problem: Problem, places: list[Candidate]) -> list[Candidate]:
    """Return the touch of a round end if it explains the reading where no touch of the flank close to it does."""
    end = locate_at_rounded_tip(problem)
    if end is None or not explains(end):
        return []
    near = (
        explains(place) and not place.at_end and abs(place.s_contact - end.s_contact) <= 3.0 * (place.std_s + end.std_s)
        for place in places
    )  # fmt: skip
    return [] if any(near) else [end]


def explains(place: Candidate) -> bool:
    """Return whether a contact there is consistent with the reading (χ² test)."""
    return place.chi2 <= max_chi2(place.dof, MISFIT_CHANCE)


#: Memory of fits that have ended, by knots and error sources, for the next ones; threads do not share a piece.
_spare: dict[tuple[int, int], list[tuple[FitMemory, NDArray[Any]]]] = defaultdict(list)


def _fit(problem: Problem, near: Array | None) -> NDArray[Any]:
    """Return what was fitted from one touch, or from every candidate along the probe: rows of `FIT`, (n,)."""
    rows = np.empty(MAX_STARTS, dtype=FIT)
    if near is not None:
        rows["touch"][0] = near
    return rows[: _run(problem, multistart.EVERYWHERE if near is None else multistart.NEAR, rows)]


def _run(problem: Problem, task: int, rows: NDArray[Any]) -> int:
    model, seen = problem.sources.model, problem.seen
    size = len(model.rod.s), len(problem.sources.names)
    spare = _spare[size]
    try:
        memory, scratch = spare.pop()
    except IndexError:
        memory, scratch = multistart.fit_memory(*size), np.empty(1, dtype=FIT_SCRATCH)
    count = multistart.fit_contacts(
        model.rod.body, model.rod.flank_end, seen.gravity, model.mass, seen.wrench, problem.noise, problem.friction,
        *problem.sources.arguments, task, memory, scratch, rows,
    )  # fmt: skip
    spare.append((memory, scratch))
    return int(count)


#: Share of the force that is normal below which a fit has run into the wall that keeps contacts from pulling.
_PULLED = 1e-3


def _places(problem: Problem, rows: NDArray[Any]) -> list[Candidate]:
    candidates = [_candidate(problem, row) for row in rows]
    return [
        candidate
        for candidate, row in zip(candidates, rows, strict=True)
        if row["status"] != STALLED
        or not explains(candidate)
        or candidate.force_normal <= _PULLED * float(np.linalg.norm(candidate.force_base))
    ]


_FIELDS = FIT.names or ()


def _candidate(problem: Problem, row: np.void) -> Candidate:
    model = problem.sources.model
    fit = dict(zip(_FIELDS, cast("tuple[Any, ...]", row.item()), strict=True))  # faster than field by field
    touch = fit["touch"]
    normal = float(touch[NORMAL])

    def shape() -> Equilibrium:
        return model.rod.solve(
            problem.seen.gravity, touch[DEAD : DEAD + 3], float(touch[S]), couple=touch[DEAD + 3 : TIP],
            guess=touch[TIP:],
        )  # fmt: skip

    return Candidate(
        s_contact=min(max(fit["s_contact"], 0.0), model.rod.length),
        std_s=math.sqrt(max(fit["var_s"], 0.0)),
        p_contact_base=fit["centre"],
        p_surface_base=fit["surface"],
        force_base=fit["force"],
        cov_contact_base=fit["cov_centre"],
        cov_surface_base=fit["cov_surface"],
        force_normal=normal,
        force_tangential=normal * math.hypot(touch[AROUND], touch[ALONG]),
        chi2=fit["chi2"],
        dof=dof_of(problem.friction),
        lever=fit["lever"],
        at_end=fit["status"] == AT_END,
        shape=shape,
        fit=row,
    )


def profile_interval(problem: Problem, place: Candidate) -> tuple[float, float]:
    """Return the arclengths s_contact [m] between which the contact lies with a probability of 95 %.

    The bounds are where the misfit, least over everything but the touched section, has grown by the 95 % quantile of a
    χ² with one degree of freedom; an end of the probe bounds the interval where the misfit grows by less. Where the
    posterior is normal these are 1.96 standard deviations to either side; near the tip and for light touches they are
    not.

    Args:
        problem: the reading and what it is known to.
        place: the touch that explains it best; one without unknowns of a touch has the interval of `ratio_interval`.
    """
    length = problem.sources.model.rod.length
    if place.fit is None:
        std_force = math.sqrt(float(np.trace(problem.noise[:3, :3])) / 3.0)
        share = std_force / max(float(np.linalg.norm(place.force_base)), 1e-300)
        return ratio_interval(place.s_contact, place.std_s, share, length)
    rows = np.array([place.fit])
    _run(problem, multistart.BOUNDS, rows)
    low, high = np.clip(rows["bounds"][0], 0.0, length).tolist()
    return low, high


def ratio_interval(s: float, std_s: float, share: float, length: float) -> tuple[float, float]:
    """Return the 95 % interval of an arclength [m] that is a moment over an uncertain force.

    With the force normal, s F/(F ± 1.96 σ_F) are its ends: 1.96 σ_s/(1 + 1.96 σ_F/F) below s and
    1.96 σ_s/(1 - 1.96 σ_F/F) above it.

    Args:
        s, std_s: arclength and its standard deviation [m].
        share: standard deviation of the force over the force.
        length: of the probe [m], which bounds the interval.

    Source: E. C. Fieller, J. R. Stat. Soc. B 16, 1954, for a numerator that is known.
    """
    way, x = statistics.sigmas_95(1) * std_s, statistics.sigmas_95(1) * share
    return max(s - way / (1.0 + x), 0.0), min(s + way / (1.0 - x), length) if x < 1.0 else length


def _distinct(problem: Problem, places: list[Candidate]) -> list[Candidate]:
    if len(places) < 2:
        return places
    kept: list[Candidate] = []
    same = _SAME * problem.sources.model.rod.length
    for place in sorted(places, key=lambda place: place.chi2):
        if all(np.linalg.norm(place.p_surface_base - other.p_surface_base)
               >= same + _ALIKE * min(place.std_s, other.std_s) for other in kept):  # fmt: skip
            kept.append(place)
    return kept


ROUNDED_TIP_DOF = 3  #: Six channels, three unknowns: the force.
_FORCE_ITERATIONS = 12
_FORCE_CLOSE = 1e-3  #: Step of the whitened misfit, in standard deviations, at which the search ends.
_LEANING = 3.0  #: Standard deviations of the force by which it may seem to lean less than the flank's normal.
#: Ratio of friction that is counted where the direction of the force is free: the touched point lies within R.
MAX_FRICTION = 1.0


class _ForceFit(NamedTuple):
    """Equilibrium under the fitted force, with the derivatives of the whitened misfit."""

    #: eq, sensitivity: equilibrium and its derivatives by the load; force: on the centre of the sphere [N], (3,).
    eq: Equilibrium
    sensitivity: Sensitivity
    force: Array
    r: Array  #: r, J: whitened misfit (6,) and its derivatives by the force (6, 3).
    J: Array


def locate_at_rounded_tip(problem: Problem) -> Candidate | None:
    """Locate the touch of the round end that explains a reading best.

    The normals of a sphere all meet at its centre. So a push on the round end acts on the axis there but for its
    friction, which turns it by up to atan μ about the touched point: it then passes the centre at μ R. The round end of
    an elliptic probe is half an ellipsoid, where the push has a couple about the centre besides. Instead of the
    arclength its lean is unknown, from the flank's own to straight along the axis.

    Args:
        problem: of a rod with a rounded tip.

    Returns:
        The place; None if the probe cannot be pushed so, or the force would not point into the round end.
    """
    rod = problem.sources.model.rod
    s, R = _sphere(rod)
    lean = R * min(problem.friction, MAX_FRICTION)
    fit = _fit_force(problem, s, lean)
    if fit is None:
        return None
    eq, force = fit.eq, fit.force
    cov_force, size = np.linalg.inv(fit.J.T @ fit.J), float(np.linalg.norm(force))
    axes = eq.R_at(s)
    t, (x, y, _) = axes[:, 2], force @ axes
    reach = math.hypot(x, rod.flatness * y) / max(math.hypot(x, y), 1e-300)
    tilt = float(force @ t) + size * math.sin(math.atan(rod.taper_at(rod.flank_end) * reach))
    if size == 0.0 or tilt > _LEANING * math.sqrt(float(t @ cov_force @ t)) + lean / R * size:
        return None
    by_force = fit.sensitivity.d_position[:, :3]
    # Facets are no sphere, and no print is: their normals miss its centre by so much.
    std_s = math.hypot(rod.flank_end - s, lean)
    out = -force / size
    cov_contact = by_force @ cov_force @ by_force.T + std_s**2 * np.outer(t, t)
    return Candidate(
        s_contact=s,
        std_s=std_s,
        p_contact_base=eq.p_contact_base,
        p_surface_base=eq.p_contact_base + _round_arm(rod, axes, force, R),
        force_base=force,
        cov_contact_base=cov_contact,
        cov_surface_base=cov_contact + lean**2 * (np.eye(3) - np.outer(out, out)),
        force_normal=size,
        force_tangential=0.0,
        chi2=float(fit.r @ fit.r),
        dof=ROUNDED_TIP_DOF,
        lever=float(np.linalg.norm(fit.sensitivity.d_moment[:, 3])) / size,
        shape=lambda: eq,
    )


def _round_arm(rod: Rod, axes: Array, force: Array, radius: float) -> Array:
    """Return the vector from the centre of the round end to its point whose normal is against a force [m], (3,).

    Of the ellipsoid with the semi-axes D = diag(R, f R, R) in section axes, it is D² n/|D n|.
    """
    semi_axes, n = radius * np.array([1.0, rod.flatness, 1.0]), -(force @ axes)
    return np.asarray(axes @ (semi_axes**2 * n) / max(float(np.linalg.norm(semi_axes * n)), 1e-300))


def _fit_force(problem: Problem, s: float, lean: float) -> _ForceFit | None:
    """Fit the force at arclength s [m] by Gauss-Newton; None where there is no equilibrium or no convergence.

    Args:
        lean: how far friction moves the line of action from the sphere's centre [m].
    """
    rod, seen = problem.sources.model.rod, problem.seen
    force, tip, moved, whiten = seen.force, None, math.inf, None
    couple, by_force = np.zeros(3), np.zeros((3, 3))
    for _ in range(_FORCE_ITERATIONS):
        eq = rod.solve(seen.gravity, force, s, couple=couple, guess=tip, columns="contact")
        if not eq.ok or eq.sensitivity is None:
            return None
        if whiten is None:  # the error sources are taken at the first guess
            whiten = statistics.whiten(_covariance(problem, s, lean, force, eq, eq.sensitivity))
        r = whiten @ (eq.wrench_base - seen.wrench)
        J = whiten @ (eq.sensitivity.d_wrench[:, :3] + eq.sensitivity.d_wrench[:, 4:7] @ by_force)
        if moved < _FORCE_CLOSE:
            return _ForceFit(eq, eq.sensitivity, force, r, J)
        step = -np.linalg.lstsq(J, r, rcond=None)[0]
        force, tip, moved = force + step, eq.tip, float(np.linalg.norm(J @ step))
        if rod.flatness != 1.0:  # the couple in the axes of the section as it was, which converges with it
            axes, radius, h = eq.R_at(s), rod.length - s, 1e-6 * max(float(np.linalg.norm(force)), 1e-300)
            couple = np.cross(_round_arm(rod, axes, force, radius), force)
            there = [np.cross(_round_arm(rod, axes, force + d, radius), force + d) for d in h * np.eye(3)]
            by_force = (np.array(there).T - couple[:, None]) / h
    return None


def _covariance(
    problem: Problem, s: float, lean: float, force: Array, eq: Equilibrium, sensitivity: Sensitivity
) -> Array:
    rod = problem.sources.model.rod
    R = eq.R_at(s)
    D = np.nan_to_num(problem.sources.columns_at(touch_at(rod, s, force, R[:, 2], R[:, 0], eq.tip))[1])
    # Friction adds a couple about the centre, of any direction across the force.
    couple = lean * float(np.linalg.norm(force)) * sensitivity.d_wrench[:, 4:7]
    return np.asarray(problem.noise + D[:6] @ D[:6].T + couple @ couple.T)


def _sphere(rod: Rod) -> tuple[float, float]:
    """Return the arclength of the sphere's centre and its radius [m], from the flank and the end of the rod."""
    tan = float(rod.taper_at(rod.flank_end))
    sin = tan / math.hypot(1.0, tan)
    blunt = float(rod.radius_at(rod.flank_end)) - tan * (rod.length - rod.flank_end)
    R = blunt * math.sqrt(1.0 - sin * sin) / (1.0 - sin)
    return rod.length - R, R
