"""The search for one case's tip, a lane's sweep at a time: from a guess or along the path, then polished."""

import math

from probedesign.rod.kernels.body import GENERAL, LOAD, NOT_CONVERGED, OK, STEP_LIMIT, UNSTABLE
from probedesign.rod.kernels.compiled import inlined, inner
from probedesign.rod.kernels.lane_sweep import ALLOWED, TIP, intend
from probedesign.rod.kernels.lanes import BEND, EVENT, MARGIN, STUCK, TIPS, TURN, row3
from probedesign.rod.kernels.newton import (
    AGAIN,
    FOUND,
    INVERSE,
    MAX_TURN,
    MOMENT_FIRST,
    NEWTON,
    STABLE,
    STATUS,
    TURNED,
    WHOLE,
    begin_newton,
    begin_path,
    follow,
    is_clamped,
    is_judged,
    misfit,
    newton,
    put_part,
    turn_tip,
    wanted_turn,
)
from probedesign.rod.kernels.steps import WIDE, D, T
from probedesign.rod.kernels.vectors import cross, dot, put

COLD, WARM, WARM_ONLY = 0, 1, 2
"""Start from no load; from a guess, else from no load; from a guess or not at all."""
PATH_TOLERANCE = 1e-4
"""Of sweeps on the way to the whole load [rad]; only where they end is reported."""
CAREFUL_TOLERANCE = 1e-9
"""Of a second try along the path."""
SAFE_MARGIN = 0.3
"""Of stability on the path, from which its sweeps need no second judgement: they know it to a hundredth."""
NEAR = 3e-3
"""How close [rad] the path has to come to the whole load's equilibrium before it is polished."""
ROUNDING = 1e-14
"""Of the tip's turn [rad]; what grows of it on the way is no misfit."""
MAX_GROWTH = 1e4
"""Beyond which smaller steps help no more."""
MAX_POLISH = 12

UNLOADED, GUESSED, PATH, POLISH, RETAKE, JUDGE = range(6)
"""What a sweep is for: the shape without load, Newton from a guess, Newton along the path, its last digits, Newton's
matrix anew for those, the margin of stability to the last digit."""
PHASE, START, CAREFUL, TOLERANCE, RESIDUAL, BEFORE, POLISHES, GROWTH = range(NEWTON, NEWTON + 8)
"""In mind of the search: its phase, where it starts from, whether this is the second try along the path, the sweeps'
tolerance, misfit at the base now and before [rad], sweeps of polishing, how much a turn of the tip grows."""
MIND = NEWTON + 8


@inlined
def tip_growth(theta, growth):
    """The larger of a growth and of how much larger than at the tip a unit turn of it is at the base."""
    return max(growth, max(abs(theta[0]), max(abs(theta[1]), abs(theta[2]))))


@inner
def begin_search(mind, o, load, start, body, tol):
    """Take up a case; the tip in mind is its guess unless `start` is COLD."""
    for q in range(LOAD):
        mind[o + WHOLE + q] = load[q]
    mind[o + START], mind[o + CAREFUL], mind[o + MOMENT_FIRST] = start, 0.0, 0.0
    mind[o + RESIDUAL], mind[o + ALLOWED] = math.inf, 0.0
    if start == COLD:
        _begin_path(mind, o, body, tol)
        return
    put_part(mind, o, 1.0)
    begin_newton(mind, o, NEAR, MAX_TURN)
    mind[o + PHASE], mind[o + TOLERANCE] = GUESSED, max(tol, PATH_TOLERANCE)
    intend(mind, o, mind[o + TOLERANCE], 1.0, 1.0)


@inner
def _begin_path(mind, o, body, tol):
    """Set out from no load: where the rod stands straight, or as it is curved by nature."""
    general = body.constants[GENERAL] != 0.0
    judged = is_judged(mind, o + WHOLE)
    careful = mind[o + CAREFUL] > 0.0
    # A very soft rod magnifies the errors of the steps themselves; under a moment, the way matters.
    mind[o + TOLERANCE] = CAREFUL_TOLERANCE if careful and judged else max(tol, PATH_TOLERANCE)
    mind[o + MOMENT_FIRST] = 1.0 if careful and not judged else 0.0
    put(mind, o + TIP, (0.0, 0.0, 1.0))
    put(mind, o + TIP + 3, (1.0, 0.0, 0.0))
    if general:
        put_part(mind, o, 0.0)
        mind[o + PHASE] = UNLOADED
        intend(mind, o, 1e-9, 1.0, 0.0)
    else:
        begin_path(mind, o, NEAR)
        mind[o + PHASE] = PATH
        intend(mind, o, mind[o + TOLERANCE], 1.0, 1.0)


@inner
def begin_polish(mind, o, tol):
    """From a tip NEAR the equilibrium, with Newton's matrix there."""
    mind[o + PHASE], mind[o + BEFORE], mind[o + POLISHES] = POLISH, math.inf, 0.0
    mind[o + TOLERANCE] = tol / min(mind[o + GROWTH], MAX_GROWTH)
    intend(mind, o, mind[o + TOLERANCE], mind[o + TURNED], 0.0)


@inlined
def _again(mind, o, of_size, with_tips):
    """Sweep once more: the search is not over."""
    intend(mind, o, mind[o + TOLERANCE], of_size, with_tips)
    return False


@inlined
def _done(mind, o, status):
    """The search ends here."""
    mind[o + STATUS] = status
    return True


@inner
def seek(lanes, lane, mind, o, body, tol):
    """Look at a finished sweep on the way to the whole load, and have the next in mind.

    Returns:
        Whether the tip is NEAR or lost, as mind[STATUS] says.
    """
    general = body.constants[GENERAL] != 0.0
    phase = mind[o + PHASE]
    if phase == UNLOADED:
        if lanes[WIDE * EVENT + lane] == STUCK:
            return _done(mind, o, STEP_LIMIT)
        t, d = row3(lanes, T, lane), row3(lanes, D, lane)
        e = cross(t, d)
        put(mind, o + TIP, (d[2], e[2], t[2]))
        put(mind, o + TIP + 3, (d[0], e[0], t[0]))
        begin_path(mind, o, NEAR)
        mind[o + PHASE] = PATH
        return _again(mind, o, 1.0, 1.0)
    outcome = newton(lanes, lane, mind, o, general)
    if phase == PATH and outcome != AGAIN:
        outcome = follow(mind, o, outcome, NEAR)
    if outcome == AGAIN:
        return _again(mind, o, 1.0, 1.0)
    if outcome == FOUND:
        growth = tip_growth(row3(lanes, TIPS, lane), tip_growth(row3(lanes, TIPS + TURN, lane), 1.0))
        mind[o + GROWTH] = tip_growth(row3(lanes, TIPS + 2 * TURN, lane), growth) if general else growth
        return True
    if mind[o + START] == WARM_ONLY or mind[o + CAREFUL] > 0.0:
        return True
    if phase == PATH:
        mind[o + CAREFUL] = 1.0
    _begin_path(mind, o, body, tol)
    return False


@inlined
def _is_unsure(mind, o):
    """Whether the path's sweeps leave the stability open."""
    return is_judged(mind, o + WHOLE) and mind[o + STABLE] < SAFE_MARGIN


@inner
def polish(lanes, lane, mind, o, body, until, near_enough):
    """Look at a finished sweep near the equilibrium, and have the next in mind.

    Args:
        until: residual allowed at the base [rad]; near_enough: misfit [rad] from which one more turn leads home, none
            where state and contact are wanted; both relative to how far the rod turns.

    Returns:
        Whether the search is over, as mind[STATUS] says.
    """
    general, phase = body.constants[GENERAL] != 0.0, mind[o + PHASE]
    if phase == RETAKE:
        outcome = newton(lanes, lane, mind, o, general)
        if outcome == AGAIN:
            return _again(mind, o, 1.0, 1.0)
        if outcome != FOUND:
            return True
        mind[o + PHASE], mind[o + BEFORE] = POLISH, math.inf
        return _again(mind, o, mind[o + TURNED], 0.0)
    if lanes[WIDE * EVENT + lane] == STUCK:
        return _done(mind, o, STEP_LIMIT)
    size = mind[o + TURNED] = min(lanes[WIDE * BEND + lane], 1.0)
    if phase == JUDGE:
        mind[o + STABLE] = lanes[WIDE * MARGIN + lane]
        return _done(mind, o, OK if mind[o + STABLE] > 0.0 else UNSTABLE)
    t, d = row3(lanes, T, lane), row3(lanes, D, lane)
    r = misfit(t, d, general)
    residual, before = math.sqrt(dot(r, r)), mind[o + BEFORE]
    mind[o + RESIDUAL] = mind[o + BEFORE] = residual
    if is_clamped(t, d, general, max(until * size, ROUNDING * mind[o + GROWTH])):
        if not _is_unsure(mind, o):
            return _done(mind, o, OK)
        mind[o + PHASE] = JUDGE
        return _again(mind, o, size, 1.0)
    mind[o + POLISHES] += 1.0
    if mind[o + POLISHES] >= MAX_POLISH:
        return _done(mind, o, NOT_CONVERGED)
    if not residual < 0.5 * before:  # the path's matrix does not lead on: take it anew
        begin_newton(mind, o, 1e-6, 0.1)
        mind[o + PHASE] = RETAKE
        return _again(mind, o, 1.0, 1.0)
    turn_tip(mind, o + TIP, wanted_turn(t, d, general, mind, o + INVERSE))
    if residual < near_enough * size and not _is_unsure(mind, o):
        return _done(mind, o, OK)
    return _again(mind, o, size, 0.0)
