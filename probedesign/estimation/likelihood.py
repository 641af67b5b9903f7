"""Maximum a posteriori: the touch of the surface that explains a reading best, with its noise, the error sources and
the prior on friction.

Where it may lie follows from one integration (`candidates.py`); where that leads to no place at all, from the scan of
the force–moment method (`arclength_scan.py`). The fit itself is compiled (`contact_fit.py`, `multistart.py`).
"""

import math

import numpy as np

from probedesign.core.frames import Array
from probedesign.core.statistics import MISFIT_CHANCE, max_chi2
from probedesign.estimation import multistart, rounded_tip
from probedesign.estimation.contact_fit import AT_END, STALLED
from probedesign.estimation.contact_fit import WORK as FIT_WORK
from probedesign.estimation.estimate import Candidate
from probedesign.estimation.multistart import (
    CENTRE_AT,
    FORCE_AT,
    MAX_STARTS,
    POSTERIOR_AT,
    ROW,
    S_AT,
    STATUS,
    SURFACE_AT,
    TOUCH_AT,
)
from probedesign.estimation.problem import Problem
from probedesign.estimation.surface_contact_kernel import (
    ALONG,
    AROUND,
    DEAD,
    NORMAL,
    ROWS,
    TIP,
    TOUCH,
    UNKNOWNS,
    S,
    work_size,
)
from probedesign.estimation.uncertainty_kernel import CHI2, COV_CENTRE, COV_POINT, LEVER, LINEAR, VAR_S
from probedesign.rod.equilibrium import Equilibrium

_SAME = 1e-5
"""Places closer than this, over the length, are one."""
_ALIKE = 0.05
"""Two places closer than this, over a standard deviation, are one; a fit ends within a hundredth of it."""


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
        found = _places(problem, _fit(problem, near.touch))
        if found and explains(found[0]):
            return found[:1]
    places = _places(problem, _fit(problem, None))
    if not any(explains(place) for place in places):
        for s, tip in problem.scan.starts:
            places += _places(problem, _fit(problem, _started(problem, s, tip)))
    if problem.sources.model.rod.rounded_from is not None:
        places += _at_rounded_tip(problem, places)
    return _distinct(problem, places)


def _at_rounded_tip(problem: Problem, places: list[Candidate]) -> list[Candidate]:
    """Return the touch of a round end if it explains the reading where no touch of the flank close to it does."""
    end = rounded_tip.locate(problem)
    if end is None or not explains(end):
        return []
    near = (
        abs(p.s_contact - end.s_contact) <= 3.0 * (p.std_s + end.std_s) and not p.at_end
        for p in places
        if explains(p)
    )
    return [] if any(near) else [end]


def explains(place: Candidate) -> bool:
    """Return whether a contact there is consistent with the reading (χ² test)."""
    return place.chi2 <= max_chi2(place.dof, MISFIT_CHANCE)


def _fit(problem: Problem, near: Array | None) -> Array:
    """Return what was fitted from one touch, or from every candidate along the probe: rows of `FIT`, (n, ROW)."""
    model, seen = problem.sources.model, problem.seen
    rows = np.empty((MAX_STARTS, ROW))
    if near is not None:
        rows[0, TOUCH_AT:POSTERIOR_AT] = near
    count = multistart.fit_contacts(
        model.rod.body, model.rod.flank_end, seen.gravity, model.mass, seen.wrench, problem.noise, problem.friction,
        *problem.sources.arguments(), near is not None, np.empty(problem.sources.room), rows,
    )  # fmt: skip
    found: Array = rows[:count]
    return found


def _started(problem: Problem, s: float, tip: Array) -> Array:
    """Return a guess from a place of the scan, (TOUCH,)."""
    touch, force = np.zeros(TOUCH), problem.seen.force
    eq = problem.sources.model.rod.solve(problem.seen.gravity, force, s, guess=tip)
    R = eq.R_at(s) if eq.ok else np.eye(3)
    rod = problem.sources.model.rod
    multistart.placed(rod.body, rod.flank_end, s, force, R[:, 2].copy(), R[:, 0].copy(), touch)
    touch[TIP:] = tip
    return touch


def _places(problem: Problem, rows: Array) -> list[Candidate]:
    """Return candidates of the fits that are least misfits, or that end where nothing explains the reading."""
    places = []
    for row in rows:
        place = _candidate(problem, row)
        if row[STATUS] == STALLED and explains(place):
            pushes = place.force_normal > _PULLED * float(np.linalg.norm(place.force_base))
            if pushes:
                continue
        places.append(place)
    return places


_PULLED = 1e-3
"""Share of the force that is normal below which a fit has run into the wall that keeps contacts from pulling."""


def _candidate(problem: Problem, row: Array) -> Candidate:
    """Return a fit, a row of `FIT`, as a candidate."""
    model, k = problem.sources.model, POSTERIOR_AT
    touch = row[TOUCH_AT:k]
    normal = float(touch[NORMAL])

    def shape() -> Equilibrium:
        """Solve for the probe under the fitted touch."""
        return model.rod.solve(
            problem.seen.gravity, touch[DEAD : DEAD + 3], float(touch[S]), couple=touch[DEAD + 3 : TIP],
            guess=touch[TIP:],
        )  # fmt: skip

    return Candidate(
        s_contact=min(max(float(row[S_AT]), 0.0), model.rod.length),
        std_s=math.sqrt(max(float(row[k + VAR_S]), 0.0)),
        p_contact_base=row[CENTRE_AT:S_AT],
        p_surface_base=row[SURFACE_AT:CENTRE_AT],
        force_base=row[FORCE_AT:SURFACE_AT],
        cov_contact_base=row[k + COV_CENTRE : k + LINEAR].reshape(3, 3),
        cov_surface_base=row[k + COV_POINT : k + COV_CENTRE].reshape(3, 3),
        force_normal=normal,
        force_tangential=normal * math.hypot(touch[AROUND], touch[ALONG]),
        chi2=float(row[k + CHI2]),
        dof=dof_of(problem.friction),
        lever=float(row[k + LEVER]),
        at_end=bool(row[STATUS] == AT_END),
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
        place: the touch that explains it best; one without unknowns of a touch has the normal interval.
    """
    rod = problem.sources.model.rod
    if place.touch is None:
        low, high = (place.s_contact + way * 1.96 * place.std_s for way in (-1.0, 1.0))
        return max(low, 0.0), min(high, rod.length)
    return _bound(problem, place, -1.0), _bound(problem, place, 1.0)


def _bound(problem: Problem, place: Candidate, way: float) -> float:
    """Return one end of `profile_interval`, by steps of a standard deviation and bisection."""
    assert place.touch is not None
    model, end = problem.sources.model, problem.sources.model.rod.flank_end
    touch, s = place.touch.copy(), float(place.touch[S])
    limit, lin = place.chi2 + max_chi2(1, 0.05), np.empty((ROWS, 1 + UNKNOWNS))
    sweep_work, work = np.empty(work_size(0)), np.empty(FIT_WORK)

    def misfit(at: float) -> float:
        """Return the least misfit squared with the touched section at an arclength [m]."""
        return float(multistart.profile_misfit(
            model.rod.body, problem.seen.gravity, model.mass, problem.seen.wrench, place.whiten, problem.friction, at,
            touch, sweep_work, lin, work,
        ))  # fmt: skip

    inside, outside = s, math.nan
    for _ in range(MAX_PROFILE_STEPS):
        there = min(max(inside + 0.7 * way * place.std_s, 0.0), end)
        before = touch.copy()
        if misfit(there) > limit:
            touch, outside = before, there
            break
        inside = there
        if there in (0.0, end):
            break
    if math.isfinite(outside):
        for _ in range(6):
            middle = 0.5 * (inside + outside)
            before = touch.copy()
            if misfit(middle) > limit:
                touch, outside = before, middle
            else:
                inside = middle
    found = np.empty(1)
    multistart.contact_arclengths(model.rod.body, touch[None], found)
    return float(min(max(found[0], 0.0), model.rod.length))


MAX_PROFILE_STEPS = 12
"""Steps of 0.7 standard deviations within which a bound of the interval is searched."""


def _distinct(problem: Problem, places: list[Candidate]) -> list[Candidate]:
    """Return each place once, best first."""
    if len(places) < 2:
        return places
    found: list[Candidate] = []
    length = problem.sources.model.rod.length
    for place in sorted(places, key=lambda of: of.chi2):
        same = (
            np.linalg.norm(place.p_surface_base - of.p_surface_base)
            < _SAME * length + _ALIKE * min(place.std_s, of.std_s)
            for of in found
        )
        if not any(same):
            found.append(place)
    return found
