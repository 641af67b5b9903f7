"""Solve cases one after the other: the tip is sought and polished, then one last sweep has all requested outputs.

`solve_cases` is the entry point of the kernels from Python; `ScratchBuffers` is the memory that it works in.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from probedesign.core.frames import Array
from probedesign.rod.kernels import inlined, inner, kernel
from probedesign.rod.kernels.equations import GENERAL, NOT_CONVERGED, OK, UNSTABLE, Body
from probedesign.rod.kernels.linalg import dot, take
from probedesign.rod.kernels.newton import (
    CASE,
    MAX_GROWTH,
    ROUNDING,
    WARM,
    is_clamped,
    is_judged,
    misfit,
    polish,
    seek,
    target_rotation,
    turn_tip,
)
from probedesign.rod.kernels.steps import BLOCK, COLUMN, STATE, WIDE, D, M, P, T
from probedesign.rod.kernels.sweep import FIRST_STEPS, sensitivities, sweep

#: Result of one case: status, margin of stability, residual at the base [rad], number of nodes filled, section of the
#: tip, base moment [N·m], and tangent and position from the base [m] of the contact.
SOLUTION = np.dtype([
    ("status", "f8"), ("margin", "f8"), ("residual", "f8"), ("count", "f8"), ("tip", "f8", 6), ("moment", "f8", 3),
    ("tangent", "f8", 3), ("point", "f8", 3),
])  # fmt: skip
#: Times the tolerance, the residual from which one more turn of the tip is enough: Newton's matrix, computed NEAR the
#: equilibrium, leaves a thousandth of it.
INITIAL_TOLERANCE = 200.0
SINGLE_ROD = np.zeros(1, dtype=np.int64)  #: Index of the rod of a single case.


class ScratchBuffers(NamedTuple):
    """Memory of `solve_cases`, which allocates nothing: one set per thread; of the last case on return."""

    case: NDArray[Any]  #: CASE, (1,).
    nodes: Array  #: shape and columns, (m · (1 + STATE + 36 chunks),), may be none.
    blocks: Array  #: columns at the base, (chunks · BLOCK,), may be none.
    y: Array  #: state at the base, (STATE,).
    contact: Array  #: state and columns at s_c, (STATE + 36 chunks,).
    turns: Array  #: rotations of the tip, see `sensitivities`, (3, k).


def scratch_buffers(k: int, room: int) -> ScratchBuffers:
    """Return buffers for k sensitivities and `room` nodes of the shape."""
    chunks = -(-(3 + k) // WIDE) if k else 0  # of the k columns and the three rotations of the tip
    width = 1 + STATE + WIDE * COLUMN * chunks  # of a node: arclength, state, columns
    return ScratchBuffers(
        case=np.empty(1, dtype=CASE), nodes=np.empty(room * width), blocks=np.empty(chunks * BLOCK), y=np.empty(STATE),
        contact=np.empty(width - 1), turns=np.empty((3, k)),
    )  # fmt: skip


@inlined
def _body_of(bodies, b):
    return Body(
        bodies.knots[b], bodies.radii[b], bodies.volume_beyond[b], bodies.volume_by_knot[b], bodies.rest[b],
        bodies.constants[b],
    )  # fmt: skip


@inner
def _report(case, scratch, body, load, tol, until):
    """Sweep a solved case once more, with the outputs beside base and contact; its tip is turned where necessary.

    Args:
        tol: error allowed a step [rad]; until: residual allowed at the base [rad];
            both relative to how far the rod turns.

    Returns:
        How many nodes were filled.
    """
    general, growth, size = body.constants[GENERAL] != 0.0, case.growth, case.turned
    first = -body.knots[-1] / FIRST_STEPS
    tol = tol / min(growth, MAX_GROWTH)
    for _ in range(6):  # the sweep with all outputs takes other steps than the search: one or two turns correct that
        status, count, margin, size, _steps, _first = sweep(
            case.tip[:], scratch.y, case.work[:], scratch.blocks, body, load, tol, size, first, True, scratch.nodes,
            scratch.contact,
        )  # fmt: skip
        case.status = status
        if scratch.blocks.shape[0] > 0:
            case.margin = margin
        if status != OK:
            case.residual = math.inf
            return 0
        t, d = take(scratch.y, T), take(scratch.y, D)
        r = misfit(t, d, general)
        case.residual = math.sqrt(dot(r, r))
        if is_clamped(t, d, general, max(max(until, tol) * size, ROUNDING * growth)):
            case.status = OK if case.margin > 0.0 or not is_judged(load) else UNSTABLE
            return count
        turn_tip(case.tip, target_rotation(t, d, general, case.inverse))
    case.status = NOT_CONVERGED
    return 0


@inlined
def _write(solution, case, y, contact, count):
    solution.status, solution.margin, solution.residual, solution.count = case.status, case.margin, case.residual, count
    for q in range(6):
        solution.tip[q] = case.tip[q]
    for q in range(3):
        solution.moment[q] = y[M + q]
        solution.tangent[q] = contact[T + q]
        solution.point[q] = contact[P + q] - y[P + q]


@kernel
def solve_cases(first, last, bodies, which, loads, start, chained, tol, until, scratch, solutions, derivatives):
    """Solve for the equilibria of the cases first ... last - 1.

    Args:
        bodies: Body of stacked arrays, one row a rod; which: the rod of each case, (n,).
        loads: (n, LOAD).
        start: COLD, WARM or WARM_ONLY; from a guess: the tip in the case's row of `solutions`.
        chained: whether each case starts from the one before it, until one has no solution. If not, the solutions do
            not depend on their order.
        tol: error allowed a step [rad]; until: residual allowed at the base [rad]; both relative to how far the rod
            turns.
        scratch: ScratchBuffers. With neither nodes nor blocks there is no last sweep, no section axes, and `y` and
            `contact` stay as they are.
        solutions: SOLUTION, (n,).
        derivatives: of the base moment (3) and the contact's [t, x axis, position, y axis] (12), by k parameters,
            and in the last column those twelve themselves, (n, 15, k + 1); filled if k > 0.

    Returns:
        How many cases were done.
    """
    reports = scratch.nodes.shape[0] > 0 or scratch.blocks.shape[0] > 0
    near_enough = INITIAL_TOLERANCE * tol if reports else 0.0
    case = scratch.case[0]
    for i in range(first, last):
        body, load, solution = _body_of(bodies, which[i]), loads[i], solutions[i]
        follows = chained and i > first
        for q in range(6):
            case.tip[q] = solutions[i - 1 if follows else i].tip[q]
        if seek(case, load, WARM if follows else start, body, tol):
            polish(case, body, tol, until, near_enough)
        if reports and case.status == OK:
            count = _report(case, scratch, body, load, tol, until)
            _write(solution, case, scratch.y, scratch.contact, count)
        else:
            _write(solution, case, case.y, case.contact, 0)
        if chained and case.status != OK:
            return i + 1 - first
        if scratch.turns.shape[1] > 0 and case.status == OK:
            sensitivities(scratch.y, scratch.blocks, scratch.contact, body, load, scratch.turns, derivatives[i])
    return last - first
