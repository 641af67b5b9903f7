"""The tip's section that holds the base in its clamp: Newton on it, and the path to it from no load."""

import math

from probedesign.rod.kernels.body import (
    COUPLE,
    FORCE,
    GENERAL,
    GRAVITY,
    LOAD,
    NOT_CONVERGED,
    OK,
    S_CONTACT,
    TIP_MOMENT,
    UNSTABLE,
)
from probedesign.rod.kernels.compiled import inlined, inner, merged
from probedesign.rod.kernels.steps import WIDE
from probedesign.rod.kernels.sweep import sweep
from probedesign.rod.kernels.vectors import add, cross, dot, put, take, times

MAX_NEWTON = 12
MAX_TURN = 0.35
"""Largest turn of the tip [rad] between prediction and solution of a load step: keeps the branch."""
PATH_TOLERANCE = 1e-4
"""Of sweeps on the way to the whole load [rad]; only where they end is reported."""
CAREFUL_TOLERANCE = 1e-9
"""Of a second try along the path."""
MIN_LOAD_STEP = 1e-4
BAD_GUESS, GOOD_GUESS = 0.8, 0.2
"""Misfit at the base [rad] of a predicted tip: not worth a second sweep; what load steps aim at."""
PATHS = LOAD + 24
"""Numbers that following a path works in."""
MAX_WORK = 40_000
"""Steps that a solve may take: a tenth of a second, a thousand times the usual; a hopeless load ends there."""


@inlined
def turn_tip(tip, turn):
    """Turn the tip's section by a rotation vector [rad]."""
    angle = math.sqrt(dot(turn, turn))
    if angle > 0.0:
        co, si = math.cos(angle), math.sin(angle) / angle
        turns = (1.0 - co) / (angle * angle)
        t, d = take(tip, 0), take(tip, 3)
        t = add(add(times(co, t), si, cross(turn, t)), turns * dot(turn, t), turn)
        d = add(add(times(co, d), si, cross(turn, d)), turns * dot(turn, d), turn)
        t = times(1.0 / math.sqrt(dot(t, t)), t)
        d = add(d, -dot(d, t), t)
        put(tip, 0, t)
        put(tip, 3, times(1.0 / math.sqrt(dot(d, d)), d))


@inner
def _prepare(tip, y, blocks, general, inverse):
    """From the tip's columns at the base: the matrix that gives the tip's turn from the base's misfit, (9,).

    The misfit is what the base's tangent and x axis lack: (t_x, t_y, d_y), the last only of a rod that is not
    round and straight. Row by row the turn, in base axes.

    Returns:
        Whether there is one.
    """
    t, d = take(y, 0), take(y, 9)
    axes = (take(tip, 3), cross(take(tip, 0), take(tip, 3)), take(tip, 0))
    r0 = (by_tip(blocks, 0, t, 0), by_tip(blocks, 1, t, 0), by_tip(blocks, 2, t, 0))
    r1 = (by_tip(blocks, 0, t, 1), by_tip(blocks, 1, t, 1), by_tip(blocks, 2, t, 1))
    r2 = (0.0, 0.0, 1.0)
    if general:
        r2 = (by_tip(blocks, 0, d, 1), by_tip(blocks, 1, d, 1), by_tip(blocks, 2, d, 1))
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
def by_tip(blocks, lane, x, q):
    """Component q of what a turn of the tip does to the axis x at the base."""
    return cross((blocks[lane], blocks[WIDE + lane], blocks[2 * WIDE + lane]), x)[q]


@inlined
def misfit(y, general):
    """What the base lacks of its clamp, as numbers that vanish there: (t_x, t_y, d_y)."""
    return (y[0], y[1], y[10] if general else 0.0)


@inlined
def is_clamped(y, general, most):
    """Whether the base stands in its clamp within `most` [rad], and not the other way round."""
    r = misfit(y, general)
    return y[2] > 0.0 and (not general or y[9] > 0.0) and dot(r, r) <= most * most


@inlined
def wanted_turn(y, general, inverse):
    """Newton's turn of the tip."""
    r = misfit(y, general)
    return (-dot(take(inverse, 0), r), -dot(take(inverse, 3), r), -dot(take(inverse, 6), r))


@inlined
def _distance(tip, t, d, general):
    """How far the tip's section is from another."""
    dt = add(take(tip, 0), -1.0, t)
    dd = add(take(tip, 3), -1.0, d)
    return math.sqrt(dot(dt, dt) + (dot(dd, dd) if general else 0.0))


@inner
def newton(tip, y, work, contact, blocks, inverse, body, load, tol, until, judged, reach):
    """Newton on the tip (6,), in place, until the next turn would be below `until` [rad].

    Gives up as soon as the tip has left its guess by more than `reach` [rad]; a guess that nothing predicted
    (`reach` negative) is first turned once, which is the linear answer, and that is what must not be left.

    Returns:
        status, how far the tip came from its guess, or wanted to [rad], the guess's misfit at the base [rad], how far
        the rod turned, the margin of stability, steps.
    """
    general = body.constants[GENERAL] != 0.0
    t, d = take(tip, 0), take(tip, 3)
    away, first, total = 0.0, 0.0, 0
    for k in range(MAX_NEWTON):
        status, _count, margin, bend, steps = sweep(
            tip, y, work, blocks, body, load, tol, 1.0, general, work[:0], contact
        )
        total += steps
        if status != OK:
            return status, away, first, bend, margin, total
        if k == 0:
            r = misfit(y, general)
            first = math.sqrt(dot(r, r)) if y[2] > 0.0 else 2.0
            if first > BAD_GUESS and reach > 0.0:
                return NOT_CONVERGED, first, first, bend, margin, total
        # The tip alone does not tell: what it lacks by a hair, a soft hanging rod lacks by turns at its base.
        clamped = is_clamped(y, general, 10.0 * until)
        if not _prepare(tip, y, blocks, general, inverse):
            return NOT_CONVERGED, away, first, bend, margin, total
        turn = wanted_turn(y, general, inverse)
        angle = math.sqrt(dot(turn, turn))
        if not math.isfinite(angle):
            return NOT_CONVERGED, away, first, bend, margin, total
        turn_tip(tip, times(min(1.0, 1.0 / max(angle, 1e-300)), turn))
        if k == 0 and reach < 0.0:
            t, d = take(tip, 0), take(tip, 3)
        away = _distance(tip, t, d, general)
        if angle > 1.0 or away > abs(reach):
            return NOT_CONVERGED, max(away, angle), first, bend, margin, total
        if angle < until and clamped:
            status = OK if margin > 0.0 or not judged else UNSTABLE
            return status, away, first, max(bend, min(angle, 1.0)), margin, total
        if angle < 1e-3 * until and y[2] <= 0.0:  # at rest, but clamped the other way round
            break
    return NOT_CONVERGED, away, first, 1.0, -1.0, total


@inlined
def is_judged(load):
    """Dead forces and gravity have a potential; a dead moment has none, so no second variation judges it."""
    return load[TIP_MOMENT] == 0.0 and load[TIP_MOMENT + 1] == 0.0 and load[TIP_MOMENT + 2] == 0.0


@inlined
def _part_of(load, part, share, moment_first):
    """The share of a load: all of it grows together, or the tip moment first and the rest after it."""
    rest = max(0.0, 2.0 * share - 1.0) if moment_first else share
    first = min(1.0, 2.0 * share) if moment_first else share
    for q in range(3):
        part[FORCE + q] = rest * load[FORCE + q]
        part[GRAVITY + q] = rest * load[GRAVITY + q]
        part[TIP_MOMENT + q] = first * load[TIP_MOMENT + q]
        part[COUPLE + q] = rest * load[COUPLE + q]
    part[S_CONTACT] = load[S_CONTACT]


@inlined
def _extrapolate(goal, at, at_old, at_older, tips, out):
    """The tip's section at the share `goal` of the load, by the parabola through the last three found.

    Args:
        at, at_old, at_older: their shares; equal ones stand for points that are not there yet.
        tips: the last, the one before and the one before that, (18,).
    """
    w0, w1, w2 = 1.0, 0.0, 0.0
    if at_old > at_older:
        w0 = (goal - at_old) * (goal - at_older) / ((at - at_old) * (at - at_older))
        w1 = (goal - at) * (goal - at_older) / ((at_old - at) * (at_old - at_older))
        w2 = (goal - at) * (goal - at_old) / ((at_older - at) * (at_older - at_old))
    elif at > at_old:
        w0, w1 = (goal - at_old) / (at - at_old), (at - goal) / (at - at_old)
    t = add(add(times(w0, take(tips, 0)), w1, take(tips, 6)), w2, take(tips, 12))
    d = add(add(times(w0, take(tips, 3)), w1, take(tips, 9)), w2, take(tips, 15))
    t = times(1.0 / math.sqrt(dot(t, t)), t)
    d = add(d, -dot(d, t), t)
    put(out, 0, t)
    put(out, 3, times(1.0 / math.sqrt(dot(d, d)), d))


@inlined
def unbent(tip):
    """The tip of the rod without load, but for its natural curvature."""
    put(tip, 0, (0.0, 0.0, 1.0))
    put(tip, 3, (1.0, 0.0, 0.0))


@merged
def trace(tip, y, work, contact, blocks, inverse, paths, body, load, tol, until, moment_first):
    """Follow the equilibrium from no load to the whole load; the tip (6,) on return.

    Args:
        paths: scratch, (PATHS,).

    Returns:
        status, how far the rod turned, the margin of stability, steps.
    """
    part, tips, tried = paths[:LOAD], paths[LOAD : LOAD + 18], paths[LOAD + 18 :]
    judged = is_judged(load)
    for q in range(18):
        tips[q] = tip[q % 6]
    at, at_old, at_older, step, bend, margin, total = 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0
    while at < 1.0:
        goal = min(1.0, at + step)
        _part_of(load, part, goal, moment_first)
        _extrapolate(goal, at, at_old, at_older, tips, tried)
        close, reach = until if goal >= 1.0 else 3e-3, MAX_TURN if at > 0.0 else -MAX_TURN
        status, away, first, bend, margin, steps = newton(
            tried, y, work, contact, blocks, inverse, body, part, tol, close, judged, reach
        )
        total += steps
        if status == OK:
            for q in range(12):
                tips[17 - q] = tips[11 - q]
            for q in range(6):
                tips[q] = tried[q]
            step = (goal - at) * min(4.0, max(0.5, (GOOD_GUESS / max(first, 1e-9)) ** (1.0 / 3.0)))
            at_older, at_old, at = at_old, at, goal
        else:
            step = (goal - at) * max(0.2, min(0.5, 0.8 * MAX_TURN / max(away, 1e-9)))
            if step < MIN_LOAD_STEP or total > MAX_WORK:
                return status, bend, margin, total
    for q in range(6):
        tip[q] = tips[q]
    return OK, bend, margin, total
