"""Find the tip's section for which the base is clamped: Newton's method, load continuation, and the final iterations.

Each function here evaluates the finished sweep of one lane and sets what its next sweep starts from, so that `solve`
can run many cases side by side. The tip is sought from a guess or along the path from no load (`seek`), then iterated
to the tolerance (`polish`).
"""

import math

from probedesign.rod.kernels import inlined, inner
from probedesign.rod.kernels import lanes as rows
from probedesign.rod.kernels.equations import (
    COUPLE,
    FORCE,
    GENERAL,
    GRAVITY,
    LOAD,
    NOT_CONVERGED,
    OK,
    S_CONTACT,
    STEP_LIMIT,
    TIP_MOMENT,
    UNSTABLE,
)
from probedesign.rod.kernels.lane_sweep import intend
from probedesign.rod.kernels.lanes import STUCK, row3
from probedesign.rod.kernels.linalg import add, cross, dot, put, take, times
from probedesign.rod.kernels.steps import WIDE, D, T

MAX_NEWTON = 12
"""Sweeps of Newton's method at one load: it converges quadratically in a few, or has left the branch."""
MAX_TURN = 0.35
"""Largest turn of the tip [rad] between prediction and solution of a load step: keeps the branch."""
MIN_LOAD_STEP = 1e-4
"""Smallest step along the load path, over the whole load: where even that fails, the branch ends."""
BAD_GUESS, GOOD_GUESS = 0.8, 0.2
"""Residual at the base [rad] of a predicted tip: above the first no second sweep is tried; load steps aim at the
other."""
MAX_WORK = 40_000
"""Integration steps that a path may take: a tenth of a second, a thousand times the usual; then the search ends."""

AGAIN, FOUND, LOST = 0, 1, 2
"""Outcomes of evaluating a sweep: sweep once more, converged, given up."""


@inlined
def turn_tip(tip, turn):
    """Rotate a stored section [t, d], (6,), by a rotation vector [rad]."""
    angle = math.sqrt(dot(turn, turn))
    if angle > 0.0:
        co, si = math.cos(angle), math.sin(angle) / angle
        turns = (1.0 - co) / (angle * angle)
        t, d = take(tip, 0), take(tip, 3)
        t = add(add(times(co, t), si, cross(turn, t)), turns * dot(turn, t), turn)
        d = add(add(times(co, d), si, cross(turn, d)), turns * dot(turn, d), turn)
        put_section(tip, t, d)


@inlined
def put_section(tip, t, d):
    """Store [t, d], made a unit tangent and a unit normal of it."""
    t = times(1.0 / math.sqrt(dot(t, t)), t)
    d = add(d, -dot(d, t), t)
    put(tip, 0, t)
    put(tip, 3, times(1.0 / math.sqrt(dot(d, d)), d))


@inlined
def prepare(tip, t, d, thetas, general, inverse):
    """Compute, from the tip's columns at the base, the matrix that maps the base's residual to the tip's rotation.

    The residual is that of the base's tangent t and x axis d: (t_x, t_y, d_y), the last only of a rod that is not
    round and straight. Fills `inverse` with the turn in base axes, row by row, (9,).

    Args:
        tip: [t, d] at the tip, a pair.
        thetas: turns of the base by the tip's turns about its axes, three of (3,).

    Returns:
        Whether there is one: its determinant is not zero.
    """
    a, b, c = thetas
    axes = (tip[1], cross(tip[0], tip[1]), tip[0])
    u, v, w = cross(a, t), cross(b, t), cross(c, t)
    r0, r1, r2 = (u[0], v[0], w[0]), (u[1], v[1], w[1]), (0.0, 0.0, 1.0)
    if general:
        r2 = (cross(a, d)[1], cross(b, d)[1], cross(c, d)[1])
    else:  # turning a round section about its tangent moves nothing
        r0, r1 = (r0[0], r0[1], 0.0), (r1[0], r1[1], 0.0)
    c0, c1, c2 = cross(r1, r2), cross(r2, r0), cross(r0, r1)
    det = dot(r0, c0)
    if not abs(det) > 1e-300 or not math.isfinite(det):
        return False
    for q in range(3):
        inverse[3 * q] = (axes[0][q] * c0[0] + axes[1][q] * c0[1] + axes[2][q] * c0[2]) / det
        inverse[3 * q + 1] = (axes[0][q] * c1[0] + axes[1][q] * c1[1] + axes[2][q] * c1[2]) / det
        third = (axes[0][q] * c2[0] + axes[1][q] * c2[1] + axes[2][q] * c2[2]) / det
        inverse[3 * q + 2] = third if general else 0.0
    return True


@inlined
def misfit(t, d, general):
    """Return the residual of the base's tangent and x axis, zero where it is clamped: (t_x, t_y, d_y)."""
    return (t[0], t[1], d[1] if general else 0.0)


@inlined
def is_clamped(t, d, general, most):
    """Return whether the base is clamped within `most` [rad], and not the other way round."""
    r = misfit(t, d, general)
    return t[2] > 0.0 and (not general or d[0] > 0.0) and dot(r, r) <= most * most


@inlined
def target_rotation(t, d, general, inverse):
    """Return the rotation of the tip by Newton's method."""
    r = misfit(t, d, general)
    return (-dot(take(inverse, 0), r), -dot(take(inverse, 3), r), -dot(take(inverse, 6), r))


@inlined
def is_judged(load):
    """Return whether stability is tested: dead forces and gravity have a potential, a dead moment has none."""
    m = take(load, TIP_MOMENT)
    return m[0] == 0.0 and m[1] == 0.0 and m[2] == 0.0


@inlined
def begin_newton(state, until, reach):
    """Start Newton's method from the stored tip, until the next rotation would be below `until` [rad].

    Gives up as soon as the tip has left its guess by more than `reach` [rad]; a guess that nothing predicted
    (`reach` negative) is first turned once, which is the linear solution, and that is what must not be left.
    """
    for q in range(6):
        state.guess[q] = state.tip[q]
    state.turns, state.away, state.first_residual = 0.0, 0.0, 0.0
    state.until, state.reach = until, reach
    state.status, state.margin = NOT_CONVERGED, -1.0


@inlined
def _distance(state, general):
    """Return the distance of the tip's section from its guess."""
    dt = add(take(state.tip, 0), -1.0, take(state.guess, 0))
    dd = add(take(state.tip, 3), -1.0, take(state.guess, 3))
    return math.sqrt(dot(dt, dt) + (dot(dd, dd) if general else 0.0))


@inner
def newton(lanes, lane, state, general):
    """Evaluate a finished sweep: rotate the tip, and return AGAIN, FOUND or LOST."""
    state.steps += lanes[WIDE * rows.STEPS + lane]
    if lanes[WIDE * rows.EVENT + lane] == STUCK:
        state.status = STEP_LIMIT
        return LOST
    t, d = row3(lanes, T, lane), row3(lanes, D, lane)
    until, reach, first_turn = state.until, state.reach, state.turns == 0.0
    r = misfit(t, d, general)
    if first_turn:
        state.first_residual = math.sqrt(dot(r, r)) if t[2] > 0.0 else 2.0
        if state.first_residual > BAD_GUESS and reach > 0.0:
            state.away = state.first_residual
            return LOST
    # The tip alone does not decide: in a soft hanging rod a tiny error there is a large one at the base.
    clamped = is_clamped(t, d, general, 10.0 * until)
    thetas = (
        row3(lanes, rows.TIPS, lane),
        row3(lanes, rows.TIPS + rows.TURN, lane),
        row3(lanes, rows.TIPS + 2 * rows.TURN, lane),
    )
    tip = (take(state.tip, 0), take(state.tip, 3))
    if not prepare(tip, t, d, thetas, general, state.inverse):
        return LOST
    turn = target_rotation(t, d, general, state.inverse)
    angle = math.sqrt(dot(turn, turn))
    if not math.isfinite(angle):
        return LOST
    # At most 1 rad: beyond, the linearisation does not hold for the direction either.
    turn_tip(state.tip, times(min(1.0, 1.0 / max(angle, 1e-300)), turn))
    if first_turn and reach < 0.0:
        for q in range(6):
            state.guess[q] = state.tip[q]
    away = _distance(state, general)
    state.away = away
    if angle > 1.0 or away > abs(reach):
        state.away = max(away, angle)
        return LOST
    if angle < until and clamped:
        state.margin = lanes[WIDE * rows.MARGIN + lane]
        state.turned = max(min(lanes[WIDE * rows.BEND + lane], 1.0), min(angle, 1.0))
        good = state.margin > 0.0 or not is_judged(state.load)
        state.status = OK if good else UNSTABLE
        return FOUND if good else LOST
    state.turns += 1.0
    # A thousandth of the tolerance: Newton's method is then at a solution, whichever way round it is clamped.
    if (angle < 1e-3 * until and t[2] <= 0.0) or state.turns >= MAX_NEWTON:
        return LOST  # converged, but clamped the other way round; or not converged
    return AGAIN


@inlined
def set_load_fraction(state, share):
    """Set the fraction of the load: all of it together, or the tip moment first and then the rest."""
    moment_first = state.moment_first > 0.0
    rest = max(0.0, 2.0 * share - 1.0) if moment_first else share
    first = min(1.0, 2.0 * share) if moment_first else share
    whole, part = state.whole_load, state.load
    for q in range(3):
        part[FORCE + q], part[GRAVITY + q] = rest * whole[FORCE + q], rest * whole[GRAVITY + q]
        part[TIP_MOMENT + q], part[COUPLE + q] = first * whole[TIP_MOMENT + q], rest * whole[COUPLE + q]
    part[S_CONTACT] = whole[S_CONTACT]


@inlined
def _extrapolate(state):
    """Predict the tip's section at the fraction tried by the parabola through the last three solutions.

    Equal shares represent points that are not there yet.
    """
    goal, at, at_old, at_older = state.goal, state.fraction, state.fraction_1, state.fraction_2
    w0, w1, w2 = 1.0, 0.0, 0.0
    if at_old > at_older:
        w0 = (goal - at_old) * (goal - at_older) / ((at - at_old) * (at - at_older))
        w1 = (goal - at) * (goal - at_older) / ((at_old - at) * (at_old - at_older))
        w2 = (goal - at) * (goal - at_old) / ((at_older - at) * (at_older - at_old))
    elif at > at_old:
        w0, w1 = (goal - at_old) / (at - at_old), (at - goal) / (at - at_old)
    tips = state.path_tips
    t = add(add(times(w0, take(tips, 0)), w1, take(tips, 6)), w2, take(tips, 12))
    d = add(add(times(w0, take(tips, 3)), w1, take(tips, 9)), w2, take(tips, 15))
    put_section(state.tip, t, d)


@inlined
def _next_share(state, until):
    """Start the next fraction of the load."""
    state.goal = min(1.0, state.fraction + state.increment)
    set_load_fraction(state, state.goal)
    _extrapolate(state)
    close = until if state.goal >= 1.0 else NEAR
    begin_newton(state, close, MAX_TURN if state.fraction > 0.0 else -MAX_TURN)


@inner
def begin_path(state, until):
    """Start the load path from the stored tip, that of no load, trying the whole load at once."""
    for q in range(18):
        state.path_tips[q] = state.tip[q % 6]
    state.fraction = state.fraction_1 = state.fraction_2 = state.steps = 0.0
    state.increment = 1.0
    _next_share(state, until)


@inner
def follow(state, outcome, until):
    """Evaluate Newton's method at a fraction of the load: lengthen the step along the path, or shorten it.

    The residual of a parabola's prediction grows with the cube of the step.
    """
    at, goal = state.fraction, state.goal
    if outcome == FOUND:
        for q in range(12):
            state.path_tips[17 - q] = state.path_tips[11 - q]
        for q in range(6):
            state.path_tips[q] = state.tip[q]
        first = max(state.first_residual, 1e-9)  # no division by zero; the factor is limited to 4 in any case
        state.increment = (goal - at) * min(4.0, max(0.5, (GOOD_GUESS / first) ** (1.0 / 3.0)))
        state.fraction_2, state.fraction_1, state.fraction = state.fraction_1, at, goal
        if goal >= 1.0:
            return FOUND
    else:
        # So that the tip would come to 0.8 of the allowed turn, but at most half and at least a fifth of this step.
        state.increment = (goal - at) * max(0.2, min(0.5, 0.8 * MAX_TURN / max(state.away, 1e-9)))
        if state.increment < MIN_LOAD_STEP or state.steps > MAX_WORK:
            return LOST
    _next_share(state, until)
    return AGAIN


COLD, WARM, WARM_ONLY = 0, 1, 2
"""Start from no load; from a guess, else from no load; from a guess or not at all."""
PATH_TOLERANCE = 1e-4
"""Error of a sweep's step on the way to the whole load [rad]; only the end of the way is reported."""
CAREFUL_TOLERANCE = 1e-9
"""The same in a second try along the path."""
SAFE_MARGIN = 0.3
"""Margin of stability on the path from which it is not computed again: those sweeps have it to a hundredth."""
NEAR = 3e-3
"""Turn of the tip [rad] from which the equilibrium of the whole load is polished."""
ROUNDING = 1e-14
"""Rounding error of the tip's turn [rad]; what it grows to at the base is accepted as residual."""
MAX_GROWTH = 1e4
"""Growth of a turn of the tip beyond which smaller steps do not help, as rounding dominates."""
MAX_POLISH = 12
"""Sweeps of polishing: with a fixed matrix each halves the residual at least, usually a thousandfold."""

UNLOADED, GUESSED, PATH, POLISH, RETAKE, JUDGE = range(6)
"""Purposes of a sweep: the shape without load, Newton from a guess, Newton along the path, its last digits, a
new matrix for those, the margin of stability to the last digit."""


@inlined
def tip_growth(theta, growth):
    """Return the larger of `growth` and the magnification of a unit rotation of the tip at the base."""
    return max(growth, max(abs(theta[0]), max(abs(theta[1]), abs(theta[2]))))


@inner
def begin_search(state, load, start, body, tol):
    """Start a case; the stored tip is its guess unless `start` is COLD."""
    for q in range(LOAD):
        state.whole_load[q] = load[q]
    state.start, state.careful, state.moment_first = start, 0.0, 0.0
    state.residual, state.first_allowed = math.inf, 0.0
    if start == COLD:
        _begin_path(state, body, tol)
        return
    set_load_fraction(state, 1.0)
    begin_newton(state, NEAR, MAX_TURN)
    state.phase, state.tolerance = GUESSED, max(tol, PATH_TOLERANCE)
    intend(state, state.tolerance, 1.0, 1.0)


@inner
def _begin_path(state, body, tol):
    """Start from no load: from the straight rod, or from its shape at rest."""
    general = body.constants[GENERAL] != 0.0
    judged = is_judged(state.whole_load)
    careful = state.careful > 0.0
    # A very soft rod magnifies the errors of the steps themselves; under a moment, the path matters.
    state.tolerance = CAREFUL_TOLERANCE if careful and judged else max(tol, PATH_TOLERANCE)
    state.moment_first = 1.0 if careful and not judged else 0.0
    put(state.tip, 0, (0.0, 0.0, 1.0))
    put(state.tip, 3, (1.0, 0.0, 0.0))
    if general:
        set_load_fraction(state, 0.0)
        state.phase = UNLOADED
        intend(state, 1e-9, 1.0, 0.0)  # the shape at rest is the start of every path: it costs one sweep
    else:
        begin_path(state, NEAR)
        state.phase = PATH
        intend(state, state.tolerance, 1.0, 1.0)


@inner
def begin_polish(state, tol):
    """Start the final iterations from a tip NEAR the equilibrium, with Newton's matrix there."""
    state.phase, state.residual_before, state.polishes = POLISH, math.inf, 0.0
    state.tolerance = tol / min(state.growth, MAX_GROWTH)
    intend(state, state.tolerance, state.turned, 0.0)


@inlined
def _again(state, of_size, with_tips):
    """Request one more sweep."""
    intend(state, state.tolerance, of_size, with_tips)
    return False


@inlined
def _done(state, status):
    """End the search with a status."""
    state.status = status
    return True


@inner
def seek(lanes, lane, state, body, tol):
    """Evaluate a finished sweep on the way to the whole load, and set the next one.

    Returns:
        Whether the tip is NEAR or lost, by `state.status`.
    """
    general = body.constants[GENERAL] != 0.0
    phase = state.phase
    if phase == UNLOADED:
        if lanes[WIDE * rows.EVENT + lane] == STUCK:
            return _done(state, STEP_LIMIT)
        t, d = row3(lanes, T, lane), row3(lanes, D, lane)
        e = cross(t, d)
        put(state.tip, 0, (d[2], e[2], t[2]))
        put(state.tip, 3, (d[0], e[0], t[0]))
        begin_path(state, NEAR)
        state.phase = PATH
        return _again(state, 1.0, 1.0)
    outcome = newton(lanes, lane, state, general)
    if phase == PATH and outcome != AGAIN:
        outcome = follow(state, outcome, NEAR)
    if outcome == AGAIN:
        return _again(state, 1.0, 1.0)
    if outcome == FOUND:
        growth = tip_growth(row3(lanes, rows.TIPS, lane), tip_growth(row3(lanes, rows.TIPS + rows.TURN, lane), 1.0))
        state.growth = tip_growth(row3(lanes, rows.TIPS + 2 * rows.TURN, lane), growth) if general else growth
        return True
    if state.start == WARM_ONLY or state.careful > 0.0:
        return True
    if phase == PATH:
        state.careful = 1.0
    _begin_path(state, body, tol)
    return False


@inlined
def _is_unsure(state):
    """Return whether the sweeps of the path leave the stability undecided."""
    return is_judged(state.whole_load) and state.margin < SAFE_MARGIN


@inner
def polish(lanes, lane, state, body, until, near_enough):
    """Evaluate a finished sweep near the equilibrium, and set the next one.

    Args:
        until: residual allowed at the base [rad]; near_enough: residual [rad] from which one more turn converges, 0
            where state and contact are wanted; both relative to how far the rod turns.

    Returns:
        Whether the search is over, with the result in `state.status`.
    """
    general, phase = body.constants[GENERAL] != 0.0, state.phase
    if phase == RETAKE:
        outcome = newton(lanes, lane, state, general)
        if outcome == AGAIN:
            return _again(state, 1.0, 1.0)
        if outcome != FOUND:
            return True
        state.phase, state.residual_before = POLISH, math.inf
        return _again(state, state.turned, 0.0)
    if lanes[WIDE * rows.EVENT + lane] == STUCK:
        return _done(state, STEP_LIMIT)
    size = state.turned = min(lanes[WIDE * rows.BEND + lane], 1.0)
    if phase == JUDGE:
        state.margin = lanes[WIDE * rows.MARGIN + lane]
        return _done(state, OK if state.margin > 0.0 else UNSTABLE)
    t, d = row3(lanes, T, lane), row3(lanes, D, lane)
    r = misfit(t, d, general)
    residual, before = math.sqrt(dot(r, r)), state.residual_before
    state.residual = state.residual_before = residual
    if is_clamped(t, d, general, max(until * size, ROUNDING * state.growth)):
        if not _is_unsure(state):
            return _done(state, OK)
        state.phase = JUDGE
        return _again(state, size, 1.0)
    state.polishes += 1.0
    if state.polishes >= MAX_POLISH:
        return _done(state, NOT_CONVERGED)
    if not residual < 0.5 * before:  # the path's matrix does not converge: compute it anew
        begin_newton(state, 1e-6, 0.1)  # the tip is NEAR: a tenth of a radian from there is another branch
        state.phase = RETAKE
        return _again(state, 1.0, 1.0)
    turn_tip(state.tip, target_rotation(t, d, general, state.inverse))
    if residual < near_enough * size and not _is_unsure(state):
        return _done(state, OK)
    return _again(state, size, 0.0)
