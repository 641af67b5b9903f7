"""The tip's section that holds the base in its clamp: Newton on it, and the path to it from no load.

All in steps between which a lane sweeps: each looks at a finished sweep and says what the next one starts from.
"""

import math

from probedesign.rod.kernels.body import (
    COUPLE,
    FORCE,
    GRAVITY,
    LOAD,
    NOT_CONVERGED,
    OK,
    S_CONTACT,
    STEP_LIMIT,
    TIP_MOMENT,
    UNSTABLE,
)
from probedesign.rod.kernels.compiled import inlined, inner
from probedesign.rod.kernels.lane_sweep import PART, SWEEP, TIP
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
from probedesign.rod.kernels.steps import WIDE, D, T
from probedesign.rod.kernels.vectors import add, cross, dot, put, take, times

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
"""In mind of Newton: sweeps so far, the turn [rad] that is small enough, how far the tip may come from its guess,
how far it came, the guess's misfit [rad], what came of it, how far the rod turned, the margin of stability; of the
path: steps of all its sweeps, the shares of the load found last, the one tried, how much to add."""
GUESS, INVERSE, WAY, WHOLE = SHARE + 1, SHARE + 7, SHARE + 16, SHARE + 34
"""The tip guessed, (6,); the matrix that gives the tip's turn from the base's misfit, (9,); the tips found last,
(18,); the whole load, (LOAD,)."""
MOMENT_FIRST = WHOLE + LOAD
NEWTON = MOMENT_FIRST + 1


@inlined
def turn_tip(tip, o, turn):
    """Turn the section that stands in an array from o on by a rotation vector [rad]."""
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
    """[t, d] made a unit tangent and a unit normal of it."""
    t = times(1.0 / math.sqrt(dot(t, t)), t)
    d = add(d, -dot(d, t), t)
    put(tip, o, t)
    put(tip, o + 3, times(1.0 / math.sqrt(dot(d, d)), d))


@inlined
def prepare(tip, t, d, thetas, general, inverse, o):
    """From the tip's columns at the base: the matrix that gives the tip's turn from the base's misfit.

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
    """What the base's tangent and x axis lack of its clamp, as numbers that vanish there: (t_x, t_y, d_y)."""
    return (t[0], t[1], d[1] if general else 0.0)


@inlined
def is_clamped(t, d, general, most):
    """Whether the base stands in its clamp within `most` [rad], and not the other way round."""
    r = misfit(t, d, general)
    return t[2] > 0.0 and (not general or d[0] > 0.0) and dot(r, r) <= most * most


@inlined
def wanted_turn(t, d, general, inverse, o):
    """Newton's turn of the tip."""
    r = misfit(t, d, general)
    return (-dot(take(inverse, o), r), -dot(take(inverse, o + 3), r), -dot(take(inverse, o + 6), r))


@inlined
def is_judged(load, o):
    """Dead forces and gravity have a potential; a dead moment has none, so no second variation judges it."""
    m = take(load, o + TIP_MOMENT)
    return m[0] == 0.0 and m[1] == 0.0 and m[2] == 0.0


@inlined
def begin_newton(mind, o, until, reach):
    """From the tip in mind, until the next turn would be below `until` [rad].

    Gives up as soon as the tip has left its guess by more than `reach` [rad]; a guess that nothing predicted
    (`reach` negative) is first turned once, which is the linear answer, and that is what must not be left.
    """
    for q in range(6):
        mind[o + GUESS + q] = mind[o + TIP + q]
    mind[o + TURNS], mind[o + AWAY], mind[o + FIRST] = 0.0, 0.0, 0.0
    mind[o + UNTIL], mind[o + REACH] = until, reach
    mind[o + STATUS], mind[o + STABLE] = NOT_CONVERGED, -1.0


@inlined
def _distance(mind, o, general):
    """How far the tip's section is from its guess."""
    dt = add(take(mind, o + TIP), -1.0, take(mind, o + GUESS))
    dd = add(take(mind, o + TIP + 3), -1.0, take(mind, o + GUESS + 3))
    return math.sqrt(dot(dt, dt) + (dot(dd, dd) if general else 0.0))


@inner
def newton(lanes, lane, mind, o, general):
    """Look at a finished sweep: turn the tip, and say whether to sweep again."""
    mind[o + TOTAL] += lanes[WIDE * STEPS + lane]
    if lanes[WIDE * EVENT + lane] == STUCK:
        mind[o + STATUS] = STEP_LIMIT
        return LOST
    t, d = row3(lanes, T, lane), row3(lanes, D, lane)
    until, reach, first_turn = mind[o + UNTIL], mind[o + REACH], mind[o + TURNS] == 0.0
    r = misfit(t, d, general)
    if first_turn:
        mind[o + FIRST] = math.sqrt(dot(r, r)) if t[2] > 0.0 else 2.0
        if mind[o + FIRST] > BAD_GUESS and reach > 0.0:
            mind[o + AWAY] = mind[o + FIRST]
            return LOST
    # The tip alone does not tell: what it lacks by a hair, a soft hanging rod lacks by turns at its base.
    clamped = is_clamped(t, d, general, 10.0 * until)
    thetas = (row3(lanes, TIPS, lane), row3(lanes, TIPS + TURN, lane), row3(lanes, TIPS + 2 * TURN, lane))
    tip = (take(mind, o + TIP), take(mind, o + TIP + 3))
    if not prepare(tip, t, d, thetas, general, mind, o + INVERSE):
        return LOST
    turn = wanted_turn(t, d, general, mind, o + INVERSE)
    angle = math.sqrt(dot(turn, turn))
    if not math.isfinite(angle):
        return LOST
    turn_tip(mind, o + TIP, times(min(1.0, 1.0 / max(angle, 1e-300)), turn))
    if first_turn and reach < 0.0:
        for q in range(6):
            mind[o + GUESS + q] = mind[o + TIP + q]
    away = _distance(mind, o, general)
    mind[o + AWAY] = away
    if angle > 1.0 or away > abs(reach):
        mind[o + AWAY] = max(away, angle)
        return LOST
    if angle < until and clamped:
        mind[o + STABLE] = lanes[WIDE * MARGIN + lane]
        mind[o + TURNED] = max(min(lanes[WIDE * BEND + lane], 1.0), min(angle, 1.0))
        good = mind[o + STABLE] > 0.0 or not is_judged(mind, o + PART)
        mind[o + STATUS] = OK if good else UNSTABLE
        return FOUND if good else LOST
    mind[o + TURNS] += 1.0
    if (angle < 1e-3 * until and t[2] <= 0.0) or mind[o + TURNS] >= MAX_NEWTON:
        return LOST  # at rest, but clamped the other way round; or never at rest
    return AGAIN


@inlined
def put_part(mind, o, share):
    """The share of the load: all of it grows together, or the tip moment first and the rest after it."""
    moment_first = mind[o + MOMENT_FIRST] > 0.0
    rest = max(0.0, 2.0 * share - 1.0) if moment_first else share
    first = min(1.0, 2.0 * share) if moment_first else share
    whole, part = o + WHOLE, o + PART
    for q in range(3):
        mind[part + FORCE + q] = rest * mind[whole + FORCE + q]
        mind[part + GRAVITY + q] = rest * mind[whole + GRAVITY + q]
        mind[part + TIP_MOMENT + q] = first * mind[whole + TIP_MOMENT + q]
        mind[part + COUPLE + q] = rest * mind[whole + COUPLE + q]
    mind[part + S_CONTACT] = mind[whole + S_CONTACT]


@inlined
def _extrapolate(mind, o):
    """The tip's section at the share tried, by the parabola through the last three found.

    Equal shares stand for points that are not there yet.
    """
    goal, at, at_old, at_older = mind[o + GOAL], mind[o + AT], mind[o + AT_OLD], mind[o + AT_OLDER]
    w0, w1, w2 = 1.0, 0.0, 0.0
    if at_old > at_older:
        w0 = (goal - at_old) * (goal - at_older) / ((at - at_old) * (at - at_older))
        w1 = (goal - at) * (goal - at_older) / ((at_old - at) * (at_old - at_older))
        w2 = (goal - at) * (goal - at_old) / ((at_older - at) * (at_older - at_old))
    elif at > at_old:
        w0, w1 = (goal - at_old) / (at - at_old), (at - goal) / (at - at_old)
    w = o + WAY
    t = add(add(times(w0, take(mind, w)), w1, take(mind, w + 6)), w2, take(mind, w + 12))
    d = add(add(times(w0, take(mind, w + 3)), w1, take(mind, w + 9)), w2, take(mind, w + 15))
    put_section(mind, o + TIP, t, d)


@inlined
def _next_share(mind, o, until):
    """Set out for the next share of the load."""
    mind[o + GOAL] = min(1.0, mind[o + AT] + mind[o + SHARE])
    put_part(mind, o, mind[o + GOAL])
    _extrapolate(mind, o)
    close = until if mind[o + GOAL] >= 1.0 else 3e-3
    begin_newton(mind, o, close, MAX_TURN if mind[o + AT] > 0.0 else -MAX_TURN)


@inner
def begin_path(mind, o, until):
    """Set out from the tip in mind, that of no load, for the whole load at once."""
    for q in range(18):
        mind[o + WAY + q] = mind[o + TIP + q % 6]
    mind[o + AT], mind[o + AT_OLD], mind[o + AT_OLDER], mind[o + SHARE], mind[o + TOTAL] = (
        0.0,
        0.0,
        0.0,
        1.0,
        0.0,
    )
    _next_share(mind, o, until)


@inner
def follow(mind, o, outcome, until):
    """What comes of Newton on a share of the load: a longer step along the path, or a shorter one instead."""
    at, goal = mind[o + AT], mind[o + GOAL]
    if outcome == FOUND:
        for q in range(12):
            mind[o + WAY + 17 - q] = mind[o + WAY + 11 - q]
        for q in range(6):
            mind[o + WAY + q] = mind[o + TIP + q]
        first = max(mind[o + FIRST], 1e-9)
        mind[o + SHARE] = (goal - at) * min(4.0, max(0.5, (GOOD_GUESS / first) ** (1.0 / 3.0)))
        mind[o + AT_OLDER], mind[o + AT_OLD], mind[o + AT] = mind[o + AT_OLD], at, goal
        if goal >= 1.0:
            return FOUND
    else:
        mind[o + SHARE] = (goal - at) * max(0.2, min(0.5, 0.8 * MAX_TURN / max(mind[o + AWAY], 1e-9)))
        if mind[o + SHARE] < MIN_LOAD_STEP or mind[o + TOTAL] > MAX_WORK:
            return LOST
    _next_share(mind, o, until)
    return AGAIN
