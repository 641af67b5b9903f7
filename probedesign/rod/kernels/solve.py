"""Solve many cases: lanes take up the next case as they finish one; then one last sweep with all outputs asked for.

`solve_cases` is the entry point of the kernels from Python; `ScratchBuffers` is the memory that it works in.
"""

import math
from typing import NamedTuple

import numpy as np

from probedesign.core.frames import Array
from probedesign.rod.kernels.compiled import announce, inline_always, inlined, kernel
from probedesign.rod.kernels.equations import GENERAL, NOT_CONVERGED, OK, UNSTABLE
from probedesign.rod.kernels.lane_sweep import SEEN, TIP, arrive, body_of, launch, tick
from probedesign.rod.kernels.lanes import EVENT, GOING, READY, ROWS, STUCK, WANTS_TIPS
from probedesign.rod.kernels.linalg import take
from probedesign.rod.kernels.newton import (
    GROWTH,
    INVERSE,
    MAX_GROWTH,
    RESIDUAL,
    ROUNDING,
    SOLVER_STATE,
    STABLE,
    STATUS,
    TURNED,
    WARM,
    begin_polish,
    begin_search,
    is_clamped,
    is_judged,
    misfit,
    polish,
    seek,
    turn_tip,
    wanted_turn,
)
from probedesign.rod.kernels.sensitivities import sensitivities
from probedesign.rod.kernels.steps import BLOCK, COLUMN, STATE, WIDE, WORK, D, T
from probedesign.rod.kernels.sweep import sweep

BASE = SOLVER_STATE
"""In a case's state after all of the search: the state at the base."""
CASE = BASE + STATE
FIXED = WIDE * ROWS + WIDE + WORK
"""Numbers that solving works in beside CASE for each case that is in work together."""
SEEKING, POLISHING = 0, 1


@inlined
def parts(scratch):
    """Return views of the scratch memory: lanes, case of each lane, work of a last sweep, solver states."""
    a = WIDE * ROWS
    b = a + WIDE
    return scratch[:a], scratch[a:b], scratch[b:FIXED], scratch[FIXED:]


@inlined
def _wants_tips(lanes, seats):
    """Return whether a busy lane integrates the tip's columns."""
    wanted = False
    for lane in range(WIDE):
        wanted = wanted or (seats[lane] >= 0.0 and lanes[WIDE * WANTS_TIPS + lane] > 0.0)
    return wanted


@inline_always
def through(
    stage, count, lanes, seats, states, bodies, which, loads, directed, start, tol, until, near_enough
):
    """Run all cases of a group through one stage.

    Args:
        count: of cases; which, loads: theirs.
        directed: see `tick`.
        seats: the case of each lane, -1: none, (WIDE,).
        states: solver state of each case, with its tip's guess if there is one, (group · CASE,).
    """
    waiting, busy, general = 0, 0, directed is not None
    for lane in range(WIDE):
        seats[lane] = -1.0
    while True:
        for lane in range(WIDE):
            while seats[lane] < 0.0 and waiting < count:
                o, body = waiting * CASE, body_of(bodies, which[waiting])
                if stage == SEEKING:
                    begin_search(states, o, loads[waiting], start, body, tol)
                elif states[o + STATUS] == OK:
                    begin_polish(states, o, tol)
                if stage == SEEKING or states[o + STATUS] == OK:
                    seats[lane] = waiting
                    busy += 1
                    lanes[WIDE * EVENT + lane] = READY
                waiting += 1
            case = int(seats[lane])
            if case >= 0 and lanes[WIDE * EVENT + lane] == READY:
                launch(lanes, lane, states, case * CASE, body_of(bodies, which[case]), general)
        if busy == 0:
            break
        tick(lanes, directed, _wants_tips(lanes, seats))
        for lane in range(WIDE):
            if seats[lane] >= 0.0 and lanes[WIDE * EVENT + lane] != GOING:
                case = int(seats[lane])
                o, body = case * CASE, body_of(bodies, which[case])
                if lanes[WIDE * EVENT + lane] == STUCK or arrive(lanes, lane, states, o, body, general):
                    if stage == SEEKING:
                        over = seek(lanes, lane, states, o, body, tol)
                    else:
                        for q in range(STATE):
                            states[o + BASE + q] = lanes[WIDE * q + lane]
                        over = polish(lanes, lane, states, o, body, until, near_enough)
                    lanes[WIDE * EVENT + lane] = READY
                    if over:
                        seats[lane] = -1.0
                        busy -= 1


@inline_always
def report(state, o, work, body, load, tol, until, nodes, blocks, y, contact):
    """Sweep a case once more, with the outputs beside base and contact.

    Args:
        state: the case's, from o on; its tip is turned a little more where it has to.
        load: (13,), see `body`.
        tol: error allowed a step [rad]; until: residual allowed at the base [rad];
            both relative to how far the rod turns.
        nodes: for shape and columns, (m · (1 + STATE + 36 chunks),).
        blocks: columns at the base, (chunks · BLOCK,), may be none.
        y, contact: state at the base, (STATE,), state and columns at s_c, (STATE + 36 chunks,).

    Returns:
        status, nodes filled, margin of stability, residual at the base [rad].
    """
    general, growth, size = body.constants[GENERAL] != 0.0, state[o + GROWTH], state[o + TURNED]
    tol = tol / min(growth, MAX_GROWTH)
    margin, residual, tip = state[o + STABLE], math.inf, state[o + TIP : o + TIP + 6]
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
        turn_tip(state, o + TIP, wanted_turn(t, d, general, state, o + INVERSE))
    return NOT_CONVERGED, 0, margin, residual


@inlined
def dot_of(r):
    """Return |r|²."""
    return r[0] * r[0] + r[1] * r[1] + r[2] * r[2]


ROW_STATUS, ROW_MARGIN, ROW_RESIDUAL, ROW_COUNT, ROW_TIP, ROW_MOMENT, ROW_CONTACT, ROW_LENGTH = (
    0,
    1,
    2,
    3,
    4,
    10,
    13,
    19,
)
"""Offsets in a row of results: status, stability margin, residual, number of nodes filled, section of the tip (6), base
moment (3), [t, position from the base] of the contact (6); and the length of a row."""
NEAR_ENOUGH = 200.0
"""Times the tolerance: Newton's matrix, taken NEAR the answer, makes a thousandth of a misfit."""


@inlined
def _write(row, state, o, y, contact, status, margin, residual, count):
    """Store a result in its row."""
    row[ROW_STATUS], row[ROW_MARGIN], row[ROW_RESIDUAL], row[ROW_COUNT] = status, margin, residual, count
    for q in range(6):
        row[ROW_TIP + q] = state[o + TIP + q]
    for q in range(3):
        row[ROW_MOMENT + q] = y[3 + q]
        row[ROW_CONTACT + q] = contact[q]
        row[ROW_CONTACT + 3 + q] = contact[6 + q] - y[6 + q]


@kernel
def solve_cases(
    first, last, bodies, which, loads, directed, start, chained, tol, until, scratch, nodes, blocks, y, contact, turns,
    found, derivatives,
):  # fmt: skip
    """Solve for the equilibria of the cases first ... last - 1.

    Args:
        bodies: Body of stacked arrays, one row a rod; which: the rod of each case, (n,).
        loads: (n, LOAD).
        directed: None if all rods are round and straight, else 0.
        start: COLD, WARM or WARM_ONLY; from a guess: the tip that stands in the case's row of `found`.
        chained: whether each case starts from the one before it, until one has no answer. If not, the answers do
            not depend on their order.
        tol: error allowed a step [rad]; until: residual allowed at the base [rad]; both relative to how far the rod
            turns.
        scratch: (FIXED + group · CASE,). As many cases are sought before any of them is polished, since polishing
            needs no columns, which a lane beside would.
        nodes, blocks, y, contact: see `report`; those of the last case on return. With neither nodes nor blocks
            there is no last sweep, no section axes, and `y` and `contact` stay as they are.
        turns: scratch, (3, k).
        found: answers, (n, ROW_LENGTH).
        derivatives: of the base moment (3) and the contact's [t, x axis, position, y axis] (12), by k parameters,
            and in the last column those twelve themselves, (n, 15, k + 1); filled if k > 0.

    Returns:
        How many cases were done.
    """
    lanes, seats, work, states = parts(scratch)
    reports = nodes.shape[0] > 0 or blocks.shape[0] > 0
    near_enough = NEAR_ENOUGH * tol if reports else 0.0
    case = first
    while case < last:
        count = 1 if chained else min(last - case, states.shape[0] // CASE)
        from_where = WARM if chained and case > first else start
        for k in range(count):
            guess = case - 1 if chained and case > first else case + k
            for q in range(6):
                states[k * CASE + TIP + q] = found[guess, ROW_TIP + q]
        group, of = loads[case : case + count], which[case : case + count]
        for stage in (SEEKING, POLISHING):
            through(
                stage,
                count,
                lanes,
                seats,
                states,
                bodies,
                of,
                group,
                directed,
                from_where,
                tol,
                until,
                near_enough,
            )
        for k in range(count):
            o, row, filled = k * CASE, found[case + k], 0
            body, load = body_of(bodies, of[k]), group[k]
            status, margin, residual = states[o + STATUS], states[o + STABLE], states[o + RESIDUAL]
            if reports and status == OK:
                code, filled, margin, residual = report(
                    states, o, work, body, load, tol, until, nodes, blocks, y, contact
                )
                status = float(code)
                _write(row, states, o, y, contact, status, margin, residual, filled)
            else:
                base, seen = states[o + BASE : o + BASE + STATE], states[o + SEEN : o + SEEN + STATE]
                _write(row, states, o, base, seen, status, margin, residual, filled)
            if chained and status != OK:
                return case + k + 1 - first
            if turns.shape[1] > 0 and status == OK:
                sensitivities(y, blocks, contact, body, load, turns, derivatives[case + k])
        case += count
    return last - first


SINGLE_ROD = np.zeros(1, dtype=np.int64)
"""Index of the rod of a single case."""


class ScratchBuffers(NamedTuple):
    """Memory of `solve_cases`, which allocates nothing: one set per thread. Its docstring describes each."""

    scratch: Array
    nodes: Array
    blocks: Array
    y: Array
    contact: Array
    turns: Array


def scratch_buffers(k: int, room: int, group: int = 1) -> ScratchBuffers:
    """Return buffers for k sensitivities, `room` nodes of the shape and `group` cases side by side."""
    announce(solve_cases)
    chunks = chunks_of(k) if k else 0
    width = width_of(chunks)
    return ScratchBuffers(
        scratch=np.empty(FIXED + group * CASE),
        nodes=np.empty(room * width),
        blocks=np.empty(chunks * BLOCK),
        y=np.empty(STATE),
        contact=np.empty(width - 1),
        turns=np.empty((3, k)),
    )


def chunks_of(k: int) -> int:
    """Return how many blocks of columns contain k sensitivities and the three rotations of the tip."""
    return -(-(3 + k) // WIDE)


def width_of(chunks: int) -> int:
    """Return the number of values of a node: arclength, state, columns."""
    return 1 + STATE + WIDE * COLUMN * chunks
