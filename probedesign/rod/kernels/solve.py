"""Tips of cases side by side, each lane taking up the next case as it ends one; then what is asked of each."""

import math

from probedesign.rod.kernels.body import GENERAL, NOT_CONVERGED, OK, UNSTABLE
from probedesign.rod.kernels.compiled import inlined, merged
from probedesign.rod.kernels.lane_sweep import TIP, arrive, body_of, launch, tick
from probedesign.rod.kernels.lanes import EVENT, GOING, READY, ROWS, STUCK, WANTS_TIPS
from probedesign.rod.kernels.newton import (
    INVERSE,
    STABLE,
    STATUS,
    TURNED,
    is_clamped,
    is_judged,
    misfit,
    turn_tip,
    wanted_turn,
)
from probedesign.rod.kernels.search import (
    GROWTH,
    MAX_GROWTH,
    MIND,
    ROUNDING,
    begin_polish,
    begin_search,
    polish,
    seek,
)
from probedesign.rod.kernels.steps import STATE, WIDE, WORK, D, T
from probedesign.rod.kernels.sweep import sweep
from probedesign.rod.kernels.vectors import take

BASE = MIND
"""In a case's mind after all of the search: the state at the base."""
CASE = BASE + STATE
FIXED = WIDE * ROWS + WIDE + WORK
"""Numbers that solving works in beside CASE for each case that is in work together."""
SEEKING, POLISHING = 0, 1


@inlined
def parts(scratch):
    """The lanes, which mind each lane is of, what a last sweep works in, the minds."""
    a = WIDE * ROWS
    b = a + WIDE
    return scratch[:a], scratch[a:b], scratch[b:FIXED], scratch[FIXED:]


@inlined
def _wants_tips(lanes, seats):
    """Whether a lane at work wants its tip's columns."""
    wanted = False
    for lane in range(WIDE):
        wanted = wanted or (seats[lane] >= 0.0 and lanes[WIDE * WANTS_TIPS + lane] > 0.0)
    return wanted


@merged
def through(
    stage, count, lanes, seats, minds, bodies, which, loads, directed, start, tol, until, near_enough
):
    """All cases of a group through one stage.

    Args:
        count: of cases; which, loads: theirs.
        directed: see `tick`.
        seats: the case of each lane, -1: none, (WIDE,).
        minds: of each case, its tip's guess where there is one, (group · CASE,).
    """
    waiting, busy, general = 0, 0, directed is not None
    for lane in range(WIDE):
        seats[lane] = -1.0
    while True:
        for lane in range(WIDE):
            while seats[lane] < 0.0 and waiting < count:
                o, body = waiting * CASE, body_of(bodies, which[waiting])
                if stage == SEEKING:
                    begin_search(minds, o, loads[waiting], start, body, tol)
                elif minds[o + STATUS] == OK:
                    begin_polish(minds, o, tol)
                if stage == SEEKING or minds[o + STATUS] == OK:
                    seats[lane] = waiting
                    busy += 1
                    lanes[WIDE * EVENT + lane] = READY
                waiting += 1
            case = int(seats[lane])
            if case >= 0 and lanes[WIDE * EVENT + lane] == READY:
                launch(lanes, lane, minds, case * CASE, body_of(bodies, which[case]), general)
        if busy == 0:
            break
        tick(lanes, directed, _wants_tips(lanes, seats))
        for lane in range(WIDE):
            if seats[lane] >= 0.0 and lanes[WIDE * EVENT + lane] != GOING:
                case = int(seats[lane])
                o, body = case * CASE, body_of(bodies, which[case])
                if lanes[WIDE * EVENT + lane] == STUCK or arrive(lanes, lane, minds, o, body, general):
                    if stage == SEEKING:
                        over = seek(lanes, lane, minds, o, body, tol)
                    else:
                        for q in range(STATE):
                            minds[o + BASE + q] = lanes[WIDE * q + lane]
                        over = polish(lanes, lane, minds, o, body, until, near_enough)
                    lanes[WIDE * EVENT + lane] = READY
                    if over:
                        seats[lane] = -1.0
                        busy -= 1


@merged
def report(mind, o, work, body, load, tol, until, nodes, blocks, y, contact):
    """Sweep a case once more, with what is asked for beside base and contact.

    Args:
        mind: the case's, from o on; its tip is turned a little more where it has to.
        load: (13,), see `body`.
        tol: error allowed a step [rad]; until: residual allowed at the base [rad];
            both relative to how far the rod turns.
        nodes: for shape and columns, (m · (1 + STATE + 36 chunks),).
        blocks: columns at the base, (chunks · BLOCK,), may be none.
        y, contact: state at the base, (STATE,), state and columns at s_c, (STATE + 36 chunks,).

    Returns:
        status, nodes filled, margin of stability, residual at the base [rad].
    """
    general, growth, size = body.constants[GENERAL] != 0.0, mind[o + GROWTH], mind[o + TURNED]
    tol = tol / min(growth, MAX_GROWTH)
    margin, residual, tip = mind[o + STABLE], math.inf, mind[o + TIP : o + TIP + 6]
    for _ in range(6):
        status, count, found, size, _steps = sweep(
            tip, y, work, blocks, body, load, tol, size, nodes, contact
        )
        margin = found if blocks.shape[0] > 0 else margin
        if status != OK:
            return status, 0, margin, math.inf
        t, d = take(y, T), take(y, D)
        r = misfit(t, d, general)
        residual = math.sqrt(dot_of(r))
        if is_clamped(t, d, general, max(max(until, tol) * size, ROUNDING * growth)):
            stable = margin > 0.0 or not is_judged(load, 0)
            return (OK if stable else UNSTABLE), count, margin, residual
        turn_tip(mind, o + TIP, wanted_turn(t, d, general, mind, o + INVERSE))
    return NOT_CONVERGED, 0, margin, residual


@inlined
def dot_of(r):
    """|r|²."""
    return r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
