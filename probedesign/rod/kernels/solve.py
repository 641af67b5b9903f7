"""Solve many cases: lanes take up the next case as they finish one; then one last sweep with all requested outputs.

`solve_cases` is the entry point of the kernels from Python; `ScratchBuffers` is the memory that it works in.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from probedesign.core.frames import Array
from probedesign.rod.kernels import inline_always, inlined, kernel
from probedesign.rod.kernels import lanes as rows
from probedesign.rod.kernels.equations import GENERAL, NOT_CONVERGED, OK, UNSTABLE
from probedesign.rod.kernels.lane_sweep import SOLVER_STATE, arrive, body_of, launch, tick
from probedesign.rod.kernels.lanes import GOING, READY, ROWS, STUCK
from probedesign.rod.kernels.linalg import dot, take
from probedesign.rod.kernels.newton import (
    MAX_GROWTH,
    ROUNDING,
    WARM,
    begin_polish,
    begin_search,
    is_clamped,
    is_judged,
    misfit,
    polish,
    seek,
    target_rotation,
    turn_tip,
)
from probedesign.rod.kernels.steps import BLOCK, COLUMN, STATE, WIDE, WORK, D, M, P, T
from probedesign.rod.kernels.sweep import sensitivities, sweep

SEEKING, POLISHING = 0, 1

SOLUTION = np.dtype([
    ("status", "f8"), ("margin", "f8"), ("residual", "f8"), ("count", "f8"), ("tip", "f8", 6), ("moment", "f8", 3),
    ("tangent", "f8", 3), ("point", "f8", 3),
])  # fmt: skip
"""Result of one case: status, margin of stability, residual at the base [rad], number of nodes filled, section of the
tip, base moment [N·m], and tangent and position from the base [m] of the contact."""
INITIAL_TOLERANCE = 200.0
"""Times the tolerance, the residual from which one more turn of the tip is enough: Newton's matrix, computed NEAR the
equilibrium, leaves a thousandth of it."""


@inlined
def _wants_tips(lanes, seats):
    """Return whether a busy lane integrates the tip's columns."""
    wanted = False
    for lane in range(WIDE):
        wanted = wanted or (seats[lane] >= 0.0 and lanes[WIDE * rows.WANTS_TIPS + lane] > 0.0)
    return wanted


@inlined
def _clear(lanes, lane):
    """Set a lane without a case to zero.

    It computes beside the others. From what it had, or from uninitialised memory, it would come to subnormal numbers,
    with which processors compute up to a hundred times as slowly; zeros give NaN, which costs nothing.
    """
    for row in range(ROWS):
        lanes[WIDE * row + lane] = 0.0


@inline_always
def through(stage, count, lanes, seats, states, bodies, which, loads, directed, start, tol, until, initial_tolerance):
    """Run all cases of a group through one stage.

    Args:
        count: of cases; which, loads: theirs.
        directed: see `tick`.
        seats: the case of each lane, -1: none, (WIDE,).
        states: SOLVER_STATE of each case, with its tip's guess if there is one, (group,).
    """
    waiting, busy, general = 0, 0, directed is not None
    for lane in range(WIDE):
        seats[lane] = -1.0
        _clear(lanes, lane)
    while True:
        for lane in range(WIDE):
            while seats[lane] < 0.0 and waiting < count:
                state, body = states[waiting], body_of(bodies, which[waiting])
                if stage == SEEKING:
                    begin_search(state, loads[waiting], start, body, tol)
                elif state.status == OK:
                    begin_polish(state, tol)
                if stage == SEEKING or state.status == OK:
                    seats[lane] = waiting
                    busy += 1
                    lanes[WIDE * rows.EVENT + lane] = READY
                waiting += 1
            case = int(seats[lane])
            if case >= 0 and lanes[WIDE * rows.EVENT + lane] == READY:
                launch(lanes, lane, states[case], body_of(bodies, which[case]), general)
        if busy == 0:
            break
        tick(lanes, directed, _wants_tips(lanes, seats))
        for lane in range(WIDE):
            if seats[lane] >= 0.0 and lanes[WIDE * rows.EVENT + lane] != GOING:
                case = int(seats[lane])
                state, body = states[case], body_of(bodies, which[case])
                if lanes[WIDE * rows.EVENT + lane] == STUCK or arrive(lanes, lane, state, body, general):
                    if stage == SEEKING:
                        over = seek(lanes, lane, state, body, tol)
                    else:
                        for q in range(STATE):
                            state.base[q] = lanes[WIDE * q + lane]
                        over = polish(lanes, lane, state, body, until, initial_tolerance)
                    lanes[WIDE * rows.EVENT + lane] = READY
                    if over:
                        seats[lane] = -1.0
                        busy -= 1
                        if waiting == count:
                            _clear(lanes, lane)


@inline_always
def report(state, work, body, load, tol, until, nodes, blocks, y, contact):
    """Sweep a case once more, with the outputs beside base and contact.

    Args:
        state: of the case; its tip is turned a little more where necessary.
        load: (13,), see `body`.
        tol: error allowed a step [rad]; until: residual allowed at the base [rad];
            both relative to how far the rod turns.
        nodes: for shape and columns, (m · (1 + STATE + 36 chunks),).
        blocks: columns at the base, (chunks · BLOCK,), may be none.
        y, contact: state at the base, (STATE,), state and columns at s_c, (STATE + 36 chunks,).

    Returns:
        status, nodes filled, margin of stability, residual at the base [rad].
    """
    general, growth, size = body.constants[GENERAL] != 0.0, state.growth, state.turned
    tol = tol / min(growth, MAX_GROWTH)
    margin, residual, tip = state.margin, math.inf, state.tip[:]
    for _ in range(6):  # the sweep with all outputs takes other steps than the search: one or two turns correct that
        status, count, found, size, _steps = sweep(tip, y, work, blocks, body, load, tol, size, nodes, contact)
        margin = found if blocks.shape[0] > 0 else margin
        if status != OK:
            return status, 0, margin, math.inf
        t, d = take(y, T), take(y, D)
        r = misfit(t, d, general)
        residual = math.sqrt(dot(r, r))
        if is_clamped(t, d, general, max(max(until, tol) * size, ROUNDING * growth)):
            stable = margin > 0.0 or not is_judged(load)
            return (OK if stable else UNSTABLE), count, margin, residual
        turn_tip(state.tip, target_rotation(t, d, general, state.inverse))
    return NOT_CONVERGED, 0, margin, residual


@inlined
def _write(row, state, y, contact, status, margin, residual, count):
    """Store a result in its row."""
    row.status, row.margin, row.residual, row.count = status, margin, residual, count
    for q in range(6):
        row.tip[q] = state.tip[q]
    for q in range(3):
        row.moment[q] = y[M + q]
        row.tangent[q] = contact[T + q]
        row.point[q] = contact[P + q] - y[P + q]


@kernel
def solve_cases(
    first, last, bodies, which, loads, directed, start, chained, tol, until, states, lanes, nodes, blocks, y, contact,
    turns, found, derivatives,
):  # fmt: skip
    """Solve for the equilibria of the cases first ... last - 1.

    Args:
        bodies: Body of stacked arrays, one row a rod; which: the rod of each case, (n,).
        loads: (n, LOAD).
        directed: None if all rods are round and straight, else 0.
        start: COLD, WARM or WARM_ONLY; from a guess: the tip in the case's row of `found`.
        chained: whether each case starts from the one before it, until one has no solution. If not, the solutions do
            not depend on their order.
        tol: error allowed a step [rad]; until: residual allowed at the base [rad]; both relative to how far the rod
            turns.
        states: scratch, SOLVER_STATE, (group,). As many cases are sought before any of them is polished: polishing
            needs no columns, which a seeking lane beside it would integrate for both.
        lanes: scratch of the lanes, the case of each and the work of a last sweep, (LANES,).
        nodes, blocks, y, contact: see `report`; those of the last case on return. With neither nodes nor blocks
            there is no last sweep, no section axes, and `y` and `contact` stay as they are.
        turns: scratch, (3, k).
        found: solutions, SOLUTION, (n,).
        derivatives: of the base moment (3) and the contact's [t, x axis, position, y axis] (12), by k parameters,
            and in the last column those twelve themselves, (n, 15, k + 1); filled if k > 0.

    Returns:
        How many cases were done.
    """
    seats, work = lanes[WIDE * ROWS : WIDE * ROWS + WIDE], lanes[WIDE * ROWS + WIDE :]
    reports = nodes.shape[0] > 0 or blocks.shape[0] > 0
    initial_tolerance = INITIAL_TOLERANCE * tol if reports else 0.0
    case = first
    while case < last:
        count = 1 if chained else min(last - case, states.shape[0])
        from_where = WARM if chained and case > first else start
        for k in range(count):
            guess = case - 1 if chained and case > first else case + k
            for q in range(6):
                states[k].tip[q] = found[guess].tip[q]
        group, of = loads[case : case + count], which[case : case + count]
        for stage in (SEEKING, POLISHING):
            through(
                stage, count, lanes, seats, states, bodies, of, group, directed, from_where, tol, until,
                initial_tolerance,
            )  # fmt: skip
        for k in range(count):
            state, row, filled = states[k], found[case + k], 0
            body, load = body_of(bodies, of[k]), group[k]
            status, margin, residual = state.status, state.margin, state.residual
            if reports and status == OK:
                code, filled, margin, residual = report(state, work, body, load, tol, until, nodes, blocks, y, contact)
                status = float(code)
                _write(row, state, y, contact, status, margin, residual, filled)
            else:
                _write(row, state, state.base[:], state.contact[:], status, margin, residual, filled)
            if chained and status != OK:
                return case + k + 1 - first
            if turns.shape[1] > 0 and status == OK:
                sensitivities(y, blocks, contact, body, load, turns, derivatives[case + k])
        case += count
    return last - first


LANES = WIDE * ROWS + WIDE + WORK
"""Numbers that solving works in beside the solver states."""
SINGLE_ROD = np.zeros(1, dtype=np.int64)
"""Index of the rod of a single case."""


class ScratchBuffers(NamedTuple):
    """Memory of `solve_cases`, which allocates nothing: one set per thread. Its docstring describes each."""

    states: NDArray[Any]
    lanes: Array
    nodes: Array
    blocks: Array
    y: Array
    contact: Array
    turns: Array


def scratch_buffers(k: int, room: int, group: int = 1) -> ScratchBuffers:
    """Return buffers for k sensitivities, `room` nodes of the shape and `group` cases side by side."""
    chunks = chunks_of(k) if k else 0
    width = width_of(chunks)
    return ScratchBuffers(
        states=np.empty(group, dtype=SOLVER_STATE),
        lanes=np.empty(LANES),
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
