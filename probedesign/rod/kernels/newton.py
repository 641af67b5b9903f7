"""Find the tip's section for which the base is clamped: Newton's method, load continuation, and the final iterations.

Each function here evaluates the finished sweep of one lane and sets what its next sweep starts from, so that `solve`
can run many cases side by side. The tip is sought from a guess or along the path from no load (`seek`), then iterated
to the tolerance (`polish`).
"""

import math

from probedesign.rod.kernels.compiled import inlined, inner
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
from probedesign.rod.kernels.lane_sweep import ALLOWED, LOAD_NOW, SWEEP, TIP, intend
from probedesign.rod.kernels.lanes import (
    BEND,
    EVENT,
    MARGIN,
    STEPS,
    STUCK,
    TIPS,
    TURN,
    row3,
)
from probedesign.rod.kernels.linalg import add, cross, dot, put, take, times
from probedesign.rod.kernels.steps import WIDE, D, T

MAX_NEWTON = 12
MAX_TURN = 0.35
"""Largest turn of the tip [rad] between prediction and solution of a load step: keeps the branch."""
MIN_LOAD_STEP = 1e-4
BAD_GUESS, GOOD_GUESS = 0.8, 0.2
"""Misfit at the base [rad] of a predicted tip: not worth a second sweep; what load steps aim at."""
MAX_WORK = 40_000
"""Steps that a path may take: a tenth of a second, a thousand times the usual; a hopeless load ends there."""

AGAIN, FOUND, LOST = 0, 1, 2
"""What comes of a look: sweep once more, it is there, it is not to be had."""

(TURNS, UNTIL, REACH, AWAY, FIRST, STATUS, TURNED, STABLE, TOTAL, AT, AT_OLD, AT_OLDER, GOAL, SHARE) = range(
    SWEEP, SWEEP + 14
)
"""Offsets in the solver state of Newton's method: sweeps so far, the turn [rad] that is small enough, how far the
tip may come from its guess, how far it came, the guess's misfit [rad], what came of it, how far the rod turned, the
margin of stability; of the path: steps of all its sweeps, the shares of the load found last, the one tried, how much
to add."""
GUESS, INVERSE, WAY, WHOLE = SHARE + 1, SHARE + 7, SHARE + 16, SHARE + 34
"""The tip guessed, (6,); the matrix that gives the tip's turn from the base's misfit, (9,); the tips found last,
(18,); the whole load, (LOAD,)."""
MOMENT_FIRST = WHOLE + LOAD
NEWTON = MOMENT_FIRST + 1


@inlined
def turn_tip(tip, o, turn):
    """Rotate the section stored in an array from o on by a rotation vector [rad]."""
    angle = math.sqrt(dot(turn, turn))
    if angle > 0.0:
        co, si = math.cos(angle), math.sin(angle) / angle
        turns = (1.0 - co) / (angle * angle)
        t, d = take(tip, o), take(tip, o + 3)
        t = add(add(times(co, t), si, cross(turn, t)), turns * dot(turn, t), turn)
        d = add(add(times(co, d), si, cross(turn, d)), turns * dot(turn, d), turn)
        put_section(tip, o, t, d)


@inlined
def put_section(tip, o, t, d):
    """Store [t, d], made a unit tangent and a unit normal of it."""
    t = times(1.0 / math.sqrt(dot(t, t)), t)
    d = add(d, -dot(d, t), t)
    put(tip, o, t)
    put(tip, o + 3, times(1.0 / math.sqrt(dot(d, d)), d))


@inlined
def prepare(tip, t, d, thetas, general, inverse, o):
    """Compute, from the tip's columns at the base, the matrix that maps the base's residual to the tip's rotation.

    The misfit is what the base's tangent t and x axis d lack: (t_x, t_y, d_y), the last only of a rod that is not
    round and straight. Row by row the turn, in base axes, into `inverse` from o on.

    Args:
        tip: [t, d] at the tip, a pair.
        thetas: turns of the base by the tip's turns about its axes, three of (3,).

    Returns:
        Whether there is one.
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
        inverse[o + 3 * q] = (axes[0][q] * c0[0] + axes[1][q] * c0[1] + axes[2][q] * c0[2]) / det
        inverse[o + 3 * q + 1] = (axes[0][q] * c1[0] + axes[1][q] * c1[1] + axes[2][q] * c1[2]) / det
        third = (axes[0][q] * c2[0] + axes[1][q] * c2[1] + axes[2][q] * c2[2]) / det
        inverse[o + 3 * q + 2] = third if general else 0.0
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
def wanted_turn(t, d, general, inverse, o):
    """Return the rotation of the tip by Newton's method."""
    r = misfit(t, d, general)
    return (-dot(take(inverse, o), r), -dot(take(inverse, o + 3), r), -dot(take(inverse, o + 6), r))


@inlined
def is_judged(load, o):
    """Return whether stability is tested: dead forces and gravity have a potential, a dead moment has none."""
    m = take(load, o + TIP_MOMENT)
    return m[0] == 0.0 and m[1] == 0.0 and m[2] == 0.0


@inlined
def begin_newton(state, o, until, reach):
    """Start Newton's method from the stored tip, until the next rotation would be below `until` [rad].

    Gives up as soon as the tip has left its guess by more than `reach` [rad]; a guess that nothing predicted
    (`reach` negative) is first turned once, which is the linear answer, and that is what must not be left.
    """
    for q in range(6):
        state[o + GUESS + q] = state[o + TIP + q]
    state[o + TURNS], state[o + AWAY], state[o + FIRST] = 0.0, 0.0, 0.0
    state[o + UNTIL], state[o + REACH] = until, reach
    state[o + STATUS], state[o + STABLE] = NOT_CONVERGED, -1.0


@inlined
def _distance(state, o, general):
    """Return the distance of the tip's section from its guess."""
    dt = add(take(state, o + TIP), -1.0, take(state, o + GUESS))
    dd = add(take(state, o + TIP + 3), -1.0, take(state, o + GUESS + 3))
    return math.sqrt(dot(dt, dt) + (dot(dd, dd) if general else 0.0))


@inner
def newton(lanes, lane, state, o, general):
    """Evaluate a finished sweep: rotate the tip, and return AGAIN, FOUND or LOST."""
    state[o + TOTAL] += lanes[WIDE * STEPS + lane]
    if lanes[WIDE * EVENT + lane] == STUCK:
        state[o + STATUS] = STEP_LIMIT
        return LOST
    t, d = row3(lanes, T, lane), row3(lanes, D, lane)
    until, reach, first_turn = state[o + UNTIL], state[o + REACH], state[o + TURNS] == 0.0
    r = misfit(t, d, general)
    if first_turn:
        state[o + FIRST] = math.sqrt(dot(r, r)) if t[2] > 0.0 else 2.0
        if state[o + FIRST] > BAD_GUESS and reach > 0.0:
            state[o + AWAY] = state[o + FIRST]
            return LOST
    # The tip alone does not tell: what it lacks by a hair, a soft hanging rod lacks by turns at its base.
    clamped = is_clamped(t, d, general, 10.0 * until)
    thetas = (row3(lanes, TIPS, lane), row3(lanes, TIPS + TURN, lane), row3(lanes, TIPS + 2 * TURN, lane))
    tip = (take(state, o + TIP), take(state, o + TIP + 3))
    if not prepare(tip, t, d, thetas, general, state, o + INVERSE):
        return LOST
    turn = wanted_turn(t, d, general, state, o + INVERSE)
    angle = math.sqrt(dot(turn, turn))
    if not math.isfinite(angle):
        return LOST
    turn_tip(state, o + TIP, times(min(1.0, 1.0 / max(angle, 1e-300)), turn))
    if first_turn and reach < 0.0:
        for q in range(6):
            state[o + GUESS + q] = state[o + TIP + q]
    away = _distance(state, o, general)
    state[o + AWAY] = away
    if angle > 1.0 or away > abs(reach):
        state[o + AWAY] = max(away, angle)
        return LOST
    if angle < until and clamped:
        state[o + STABLE] = lanes[WIDE * MARGIN + lane]
        state[o + TURNED] = max(min(lanes[WIDE * BEND + lane], 1.0), min(angle, 1.0))
        good = state[o + STABLE] > 0.0 or not is_judged(state, o + LOAD_NOW)
        state[o + STATUS] = OK if good else UNSTABLE
        return FOUND if good else LOST
    state[o + TURNS] += 1.0
    if (angle < 1e-3 * until and t[2] <= 0.0) or state[o + TURNS] >= MAX_NEWTON:
        return LOST  # at rest, but clamped the other way round; or never at rest
    return AGAIN


@inlined
def set_load_fraction(state, o, share):
    """Set the fraction of the load: all of it together, or the tip moment first and then the rest."""
    moment_first = state[o + MOMENT_FIRST] > 0.0
    rest = max(0.0, 2.0 * share - 1.0) if moment_first else share
    first = min(1.0, 2.0 * share) if moment_first else share
    whole, part = o + WHOLE, o + LOAD_NOW
    for q in range(3):
        state[part + FORCE + q] = rest * state[whole + FORCE + q]
        state[part + GRAVITY + q] = rest * state[whole + GRAVITY + q]
        state[part + TIP_MOMENT + q] = first * state[whole + TIP_MOMENT + q]
        state[part + COUPLE + q] = rest * state[whole + COUPLE + q]
    state[part + S_CONTACT] = state[whole + S_CONTACT]


@inlined
def _extrapolate(state, o):
    """Predict the tip's section at the fraction tried by the parabola through the last three solutions.

    Equal shares stand for points that are not there yet.
    """
    goal, at, at_old, at_older = state[o + GOAL], state[o + AT], state[o + AT_OLD], state[o + AT_OLDER]
    w0, w1, w2 = 1.0, 0.0, 0.0
    if at_old > at_older:
        w0 = (goal - at_old) * (goal - at_older) / ((at - at_old) * (at - at_older))
        w1 = (goal - at) * (goal - at_older) / ((at_old - at) * (at_old - at_older))
        w2 = (goal - at) * (goal - at_old) / ((at_older - at) * (at_older - at_old))
    elif at > at_old:
        w0, w1 = (goal - at_old) / (at - at_old), (at - goal) / (at - at_old)
    w = o + WAY
    t = add(add(times(w0, take(state, w)), w1, take(state, w + 6)), w2, take(state, w + 12))
    d = add(add(times(w0, take(state, w + 3)), w1, take(state, w + 9)), w2, take(state, w + 15))
    put_section(state, o + TIP, t, d)


@inlined
def _next_share(state, o, until):
    """Start the next fraction of the load."""
    state[o + GOAL] = min(1.0, state[o + AT] + state[o + SHARE])
    set_load_fraction(state, o, state[o + GOAL])
    _extrapolate(state, o)
    close = until if state[o + GOAL] >= 1.0 else 3e-3
    begin_newton(state, o, close, MAX_TURN if state[o + AT] > 0.0 else -MAX_TURN)


@inner
def begin_path(state, o, until):
    """Start the load path from the stored tip, that of no load, trying the whole load at once."""
    for q in range(18):
        state[o + WAY + q] = state[o + TIP + q % 6]
    state[o + AT], state[o + AT_OLD], state[o + AT_OLDER], state[o + SHARE], state[o + TOTAL] = (
        0.0,
        0.0,
        0.0,
        1.0,
        0.0,
    )
    _next_share(state, o, until)


@inner
def follow(state, o, outcome, until):
    """Evaluate Newton's method at a fraction of the load: lengthen the step along the path, or shorten it."""
    at, goal = state[o + AT], state[o + GOAL]
    if outcome == FOUND:
        for q in range(12):
            state[o + WAY + 17 - q] = state[o + WAY + 11 - q]
        for q in range(6):
            state[o + WAY + q] = state[o + TIP + q]
        first = max(state[o + FIRST], 1e-9)
        state[o + SHARE] = (goal - at) * min(4.0, max(0.5, (GOOD_GUESS / first) ** (1.0 / 3.0)))
        state[o + AT_OLDER], state[o + AT_OLD], state[o + AT] = state[o + AT_OLD], at, goal
        if goal >= 1.0:
            return FOUND
    else:
        state[o + SHARE] = (goal - at) * max(0.2, min(0.5, 0.8 * MAX_TURN / max(state[o + AWAY], 1e-9)))
        if state[o + SHARE] < MIN_LOAD_STEP or state[o + TOTAL] > MAX_WORK:
            return LOST
    _next_share(state, o, until)
    return AGAIN


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
"""Offsets in the solver state of the search: its phase, where it starts from, whether this is the second try along
the path, the sweeps' tolerance, misfit at the base now and before [rad], sweeps of polishing, how much a turn of the
tip grows."""
SOLVER_STATE = NEWTON + 8


@inlined
def tip_growth(theta, growth):
    """Return the larger of `growth` and the magnification of a unit rotation of the tip at the base."""
    return max(growth, max(abs(theta[0]), max(abs(theta[1]), abs(theta[2]))))


@inner
def begin_search(state, o, load, start, body, tol):
    """Start a case; the stored tip is its guess unless `start` is COLD."""
    for q in range(LOAD):
        state[o + WHOLE + q] = load[q]
    state[o + START], state[o + CAREFUL], state[o + MOMENT_FIRST] = start, 0.0, 0.0
    state[o + RESIDUAL], state[o + ALLOWED] = math.inf, 0.0
    if start == COLD:
        _begin_path(state, o, body, tol)
        return
    set_load_fraction(state, o, 1.0)
    begin_newton(state, o, NEAR, MAX_TURN)
    state[o + PHASE], state[o + TOLERANCE] = GUESSED, max(tol, PATH_TOLERANCE)
    intend(state, o, state[o + TOLERANCE], 1.0, 1.0)


@inner
def _begin_path(state, o, body, tol):
    """Start from no load: from the straight rod, or from its shape at rest."""
    general = body.constants[GENERAL] != 0.0
    judged = is_judged(state, o + WHOLE)
    careful = state[o + CAREFUL] > 0.0
    # A very soft rod magnifies the errors of the steps themselves; under a moment, the way matters.
    state[o + TOLERANCE] = CAREFUL_TOLERANCE if careful and judged else max(tol, PATH_TOLERANCE)
    state[o + MOMENT_FIRST] = 1.0 if careful and not judged else 0.0
    put(state, o + TIP, (0.0, 0.0, 1.0))
    put(state, o + TIP + 3, (1.0, 0.0, 0.0))
    if general:
        set_load_fraction(state, o, 0.0)
        state[o + PHASE] = UNLOADED
        intend(state, o, 1e-9, 1.0, 0.0)
    else:
        begin_path(state, o, NEAR)
        state[o + PHASE] = PATH
        intend(state, o, state[o + TOLERANCE], 1.0, 1.0)


@inner
def begin_polish(state, o, tol):
    """Start the final iterations from a tip NEAR the equilibrium, with Newton's matrix there."""
    state[o + PHASE], state[o + BEFORE], state[o + POLISHES] = POLISH, math.inf, 0.0
    state[o + TOLERANCE] = tol / min(state[o + GROWTH], MAX_GROWTH)
    intend(state, o, state[o + TOLERANCE], state[o + TURNED], 0.0)


@inlined
def _again(state, o, of_size, with_tips):
    """Request one more sweep."""
    intend(state, o, state[o + TOLERANCE], of_size, with_tips)
    return False


@inlined
def _done(state, o, status):
    """End the search with a status."""
    state[o + STATUS] = status
    return True


@inner
def seek(lanes, lane, state, o, body, tol):
    """Evaluate a finished sweep on the way to the whole load, and set the next one.

    Returns:
        Whether the tip is NEAR or lost, as state[STATUS] says.
    """
    general = body.constants[GENERAL] != 0.0
    phase = state[o + PHASE]
    if phase == UNLOADED:
        if lanes[WIDE * EVENT + lane] == STUCK:
            return _done(state, o, STEP_LIMIT)
        t, d = row3(lanes, T, lane), row3(lanes, D, lane)
        e = cross(t, d)
        put(state, o + TIP, (d[2], e[2], t[2]))
        put(state, o + TIP + 3, (d[0], e[0], t[0]))
        begin_path(state, o, NEAR)
        state[o + PHASE] = PATH
        return _again(state, o, 1.0, 1.0)
    outcome = newton(lanes, lane, state, o, general)
    if phase == PATH and outcome != AGAIN:
        outcome = follow(state, o, outcome, NEAR)
    if outcome == AGAIN:
        return _again(state, o, 1.0, 1.0)
    if outcome == FOUND:
        growth = tip_growth(row3(lanes, TIPS, lane), tip_growth(row3(lanes, TIPS + TURN, lane), 1.0))
        state[o + GROWTH] = tip_growth(row3(lanes, TIPS + 2 * TURN, lane), growth) if general else growth
        return True
    if state[o + START] == WARM_ONLY or state[o + CAREFUL] > 0.0:
        return True
    if phase == PATH:
        state[o + CAREFUL] = 1.0
    _begin_path(state, o, body, tol)
    return False


@inlined
def _is_unsure(state, o):
    """Return whether the sweeps of the path leave the stability undecided."""
    return is_judged(state, o + WHOLE) and state[o + STABLE] < SAFE_MARGIN


@inner
def polish(lanes, lane, state, o, body, until, near_enough):
    """Evaluate a finished sweep near the equilibrium, and set the next one.

    Args:
        until: residual allowed at the base [rad]; near_enough: misfit [rad] from which one more turn leads home, none
            where state and contact are wanted; both relative to how far the rod turns.

    Returns:
        Whether the search is over, as state[STATUS] says.
    """
    general, phase = body.constants[GENERAL] != 0.0, state[o + PHASE]
    if phase == RETAKE:
        outcome = newton(lanes, lane, state, o, general)
        if outcome == AGAIN:
            return _again(state, o, 1.0, 1.0)
        if outcome != FOUND:
            return True
        state[o + PHASE], state[o + BEFORE] = POLISH, math.inf
        return _again(state, o, state[o + TURNED], 0.0)
    if lanes[WIDE * EVENT + lane] == STUCK:
        return _done(state, o, STEP_LIMIT)
    size = state[o + TURNED] = min(lanes[WIDE * BEND + lane], 1.0)
    if phase == JUDGE:
        state[o + STABLE] = lanes[WIDE * MARGIN + lane]
        return _done(state, o, OK if state[o + STABLE] > 0.0 else UNSTABLE)
    t, d = row3(lanes, T, lane), row3(lanes, D, lane)
    r = misfit(t, d, general)
    residual, before = math.sqrt(dot(r, r)), state[o + BEFORE]
    state[o + RESIDUAL] = state[o + BEFORE] = residual
    if is_clamped(t, d, general, max(until * size, ROUNDING * state[o + GROWTH])):
        if not _is_unsure(state, o):
            return _done(state, o, OK)
        state[o + PHASE] = JUDGE
        return _again(state, o, size, 1.0)
    state[o + POLISHES] += 1.0
    if state[o + POLISHES] >= MAX_POLISH:
        return _done(state, o, NOT_CONVERGED)
    if not residual < 0.5 * before:  # the path's matrix does not lead on: take it anew
        begin_newton(state, o, 1e-6, 0.1)
        state[o + PHASE] = RETAKE
        return _again(state, o, 1.0, 1.0)
    turn_tip(state, o + TIP, wanted_turn(t, d, general, state, o + INVERSE))
    if residual < near_enough * size and not _is_unsure(state, o):
        return _done(state, o, OK)
    return _again(state, o, size, 0.0)
