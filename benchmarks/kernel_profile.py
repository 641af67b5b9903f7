"""Time and floating-point operations of the compiled solver without Python, in total and by kind of step."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from benchmarks.cases import GRAVITY, Load
from benchmarks.flop_count import count, flops
from benchmarks.timing import format_seconds, interleaved, print_table, value_range
from probedesign.core.frames import Array
from probedesign.rod.kernels import kernel, newton
from probedesign.rod.kernels.equations import ALL_COLUMNS, LOAD_COLUMNS, OK, frustum_of, rest_of
from probedesign.rod.kernels.lane_sweep import tick
from probedesign.rod.kernels.lanes import LENGTH, SIZE, STEP_BUDGET, TIPS, TOL, WANTS_TIPS, D, H, S, T, put_frustum
from probedesign.rod.kernels.linalg import put, take
from probedesign.rod.kernels.solve import LANES, SOLUTION, scratch_buffers, solve_cases
from probedesign.rod.kernels.steps import (
    BLOCK,
    COLUMN,
    NEXT,
    STATE,
    WIDE,
    WORK,
    forced_columns_step,
    free_columns_step,
    full_step,
)
from probedesign.rod.rod import TOLERANCES, Rod

COPIES = 100
"""Copies of a case in one call, so that the overhead of the call is negligible."""
NODES = 64
"""Nodes of the shape."""
ROUNDS = 9
NEIGHBOUR = 1.01
"""Factor on the force of the neighbouring load that a warm solve starts from."""
STEPS = {"state, Newton iteration": "round_lanes_step", "tip derivatives, Newton iteration": "round_tips_step",
         "state, solution": "full_step", "tip derivatives, solution": "free_columns_step",
         "load derivatives, solution": "forced_columns_step"}  # fmt: skip
"""Step functions by kind. The Newton iteration integrates in SIMD lanes; the solution is integrated once more."""
SIMULTANEOUS = ("round_lanes_step", "round_tips_step")
"""Steps that integrate WIDE cases at once."""
TRIPS = 1000
"""Steps in each timed loop."""


class Request(NamedTuple):
    """Options of a solve."""

    columns: int = 0  #: number of derivatives.
    room: int = 0  #: number of nodes of the shape.
    warm: bool = False  #: whether the solve starts from a neighbouring load.
    group: int = 1  #: number of cases solved in SIMD lanes at once.
    tol: float = TOLERANCES["fast"][0]  #: tolerance of a step.


COLD = "cold: tip, base moment, contact"
IN_LANES = f"the same, {WIDE} cases at once: per case"
SHAPE = "cold with the shape"
JACOBIAN = "neighbouring load, with the Jacobian by force and s_contact"
REQUESTS = {
    COLD: Request(),
    IN_LANES: Request(group=WIDE),
    SHAPE: Request(room=NODES),
    "cold, with the Jacobian by force and s_contact": Request(LOAD_COLUMNS),
    "neighbouring load": Request(warm=True),
    JACOBIAN: Request(LOAD_COLUMNS, warm=True),
    "neighbouring load, with all 16 derivatives": Request(ALL_COLUMNS + 2, warm=True),
}


class Work(NamedTuple):
    """Median time [s], floating-point operations and function calls by name of one solve."""

    seconds: float
    operations: int
    calls: dict[str, int]


class Part(NamedTuple):
    """Time [s] and floating-point operations of one step of a kind."""

    seconds: float
    operations: int


def solver(rod: Rod, load: Load, request: Request, copies: int = COPIES) -> Callable[[], int]:
    """Return a function that solves copies of one case in one call of the kernel.

    Raises:
        ArithmeticError: the case has no equilibrium.
    """
    loads = np.tile(rod.load(GRAVITY, load.force, load.s), (copies, 1))
    found, derivatives = np.empty(copies, dtype=SOLUTION), np.empty((copies, 15, request.columns + 1))
    which, work = (np.zeros(copies, dtype=np.int64), scratch_buffers(request.columns, request.room, request.group))
    neighbour = rod.solve(GRAVITY, NEIGHBOUR * load.force, load.s).tip
    start = newton.WARM_ONLY if request.warm else newton.COLD
    tips = found["tip"]
    case = (0, copies, rod.stacked, which, loads, rod.directed, start, False, request.tol, request.tol / 10.0)

    def solve() -> int:
        tips[:] = neighbour
        done: int = solve_cases(*case, *work, found, derivatives)
        return done

    solve()
    if (found["status"] != OK).any():
        raise ArithmeticError("a case of the benchmark has no equilibrium")
    return solve


def counted(rod: Rod, load: Array, request: Request, neighbour: Array | None = None) -> tuple[int, dict[str, int]]:
    """Return the operations of one solve and the calls of each function.

    Args:
        rod: the rod.
        load: in the layout of the kernels, (LOAD,).
        request: options of the solve.
        neighbour: tip of a neighbouring load to start from; None for a cold start.
    """
    n = WIDE  # copies of the case, so that no lane is empty
    found, derivatives = np.zeros(n, dtype=SOLUTION), np.zeros((n, 15, request.columns + 1))
    if neighbour is not None:
        found["tip"] = neighbour
    start = newton.COLD if neighbour is None else newton.WARM_ONLY
    work = scratch_buffers(request.columns, request.room, n)
    for numbers in work:
        numbers[:] = 0.0  # uninitialised memory may contain NaN
    which, tol = np.zeros(n, dtype=np.int64), request.tol
    done, calls = count(solve_cases, 0, n, rod.stacked, which, np.tile(load, (n, 1)),
                        rod.directed, start, False, tol, tol / 10.0, *work, found, derivatives)  # fmt: skip
    return flops(done) // n, {name: times if name in SIMULTANEOUS else times // n for name, times in calls.items()}


def measure(rod: Rod, loads: Sequence[Load]) -> dict[str, list[Work]]:
    """Return the work of each request for each load."""
    found: dict[str, list[Work]] = {name: [] for name in REQUESTS}
    for load in loads:
        seconds = interleaved({name: solver(rod, load, request) for name, request in REQUESTS.items()}, ROUNDS)
        neighbour = rod.solve(GRAVITY, NEIGHBOUR * load.force, load.s).tip
        for name, request in REQUESTS.items():
            packed = rod.load(GRAVITY, load.force, load.s)
            found[name].append(
                Work(seconds[name] / COPIES, *counted(rod, packed, request, neighbour if request.warm else None))
            )
    return found


@kernel
def _solution_steps(trips: int, kinds: Any, body: Any, load: Any, work: Any, block: Any) -> None:
    """Integrate with steps of the given kinds, as in a sweep; the steps are too short to change the state much."""
    free, forced = kinds
    s, frustum, rest = body.knots[-1], frustum_of(body, 0, False), rest_of(body, 0)
    force, gravity, h = take(load, 0), take(load, 3), -1e-6 * s
    for _ in range(trips):
        full_step(s, h, work, frustum, rest, force, gravity, 1.0)
        if free:
            free_columns_step(h, block, work)
        if forced:
            forced_columns_step(h, block, work, gravity)
        s += h  # otherwise the compiler moves what depends only on s out of the loop
        for q in range(STATE):
            work[q] = work[STATE + q]
        for q in range(WIDE * COLUMN):
            block[q] = block[WIDE * NEXT + q]


@kernel
def _newton_steps(trips: int, tips: bool, body: Any, lanes: Any) -> None:
    """Integrate with steps in all lanes, including the control of their size."""
    length, frustum = body.knots[-1], frustum_of(body, 0, False)
    for lane in range(WIDE):
        put_frustum(lanes, lane, frustum)
        for row, value in (
            (S, length),
            (LENGTH, length),
            (TOL, 1.0),
            (SIZE, 1.0),
            (STEP_BUDGET, 1e9),
            (WANTS_TIPS, 1.0),
        ):
            lanes[WIDE * row + lane] = value
        for row in (T + 2, D, TIPS, TIPS + 7):
            lanes[WIDE * row + lane] = 1.0
    for _ in range(trips):
        for lane in range(WIDE):
            lanes[WIDE * H + lane] = -1e-6 * length
        tick(lanes, None, tips)


@kernel
def _begin(work: Any, block: Any) -> None:
    work[:] = 0.0
    put(work, 0, (0.0, 0.0, 1.0))
    put(work, 9, (1.0, 0.0, 0.0))
    block[:] = 1.0


def parts(rod: Rod, load: Load) -> dict[str, Part]:
    """Return time and operations of each kind of step by the name of its function.

    Steps with derivatives are timed together with those they extend, and the difference is returned. Steps in lanes
    have the time of all lanes and the operations of one. Within a solve a step takes longer than in a loop of its own,
    probably because the decoded instructions of all kinds do not fit the cache.
    """
    work, block, packed = (np.empty(WORK), np.empty(BLOCK), rod.load(GRAVITY, load.force, load.s))
    _begin(work, block)
    lanes = np.zeros(LANES)
    case = (rod.body, packed, work, block)
    kinds: dict[str, tuple[Any, tuple[object, ...]]] = {
        "full": (_solution_steps, ((False, False), *case)),
        "free": (_solution_steps, ((True, False), *case)),
        "forced": (_solution_steps, ((True, True), *case)),
        "round": (_newton_steps, (False, rod.body, lanes)),
        "tips": (_newton_steps, (True, rod.body, lanes)),
    }
    seconds = interleaved({name: partial(steps, TRIPS, *args) for name, (steps, args) in kinds.items()}, ROUNDS)
    found = {
        name: Part(seconds[name] / TRIPS, flops(count(steps, 2, *args)[0]) - flops(count(steps, 1, *args)[0]))
        for name, (steps, args) in kinds.items()
    }
    return {
        "full_step": found["full"],
        "free_columns_step": _difference(found["free"], found["full"]),
        "forced_columns_step": _difference(found["forced"], found["free"]),
        "round_lanes_step": _per_lane(found["round"]),
        "round_tips_step": _per_lane(_difference(found["tips"], found["round"])),
    }


def _per_lane(part: Part) -> Part:
    """Return the time of all lanes and the operations of one."""
    return Part(part.seconds, part.operations // WIDE)


def _difference(both: Part, one: Part) -> Part:
    return Part(both.seconds - one.seconds, both.operations - one.operations)


def print_times(found: dict[str, list[Work]], peak: float) -> None:
    """Print time and operations of each solve; `peak` is the highest operation rate of a core [1/s]."""
    rows = []
    for name, work in found.items():
        share = [w.operations / w.seconds / peak for w in work]
        rows.append([
            name,
            value_range([w.seconds for w in work], format_seconds),
            value_range([float(sum(w.calls.get(step, 0) for step in STEPS.values())) for w in work], "{:.0f}".format),
            value_range([float(w.operations) for w in work], "{:.0f}".format),
            value_range([w.operations / w.seconds / 1e9 for w in work], "{:.1f}".format),
            value_range(share, "{:.0%}".format),
        ])  # fmt: skip
    print_table(
        f"Kernel time, fast mode, the large probe under {len(next(iter(found.values())))} loads of the paper. "
        f"{COPIES} copies in each call, medians of {ROUNDS} interleaved rounds",
        ["one equilibrium", "time", "steps", "operations", "Gflop/s", "share of peak"],
        rows,
    )
    print(
        "  operations: + - × ÷ √ of floats in the source, counted by running it on instrumented numbers\n"
        f"  peak: {peak / 1e9:.3g} Gflop/s of one core with SIMD fused multiply-adds, measured"
    )


def print_parts(work: Work, each: dict[str, Part], peaks: dict[str, float], name: str) -> None:
    """Print the share of each kind of step in the time of one solve."""
    peak, scalar = max(peaks.values()), min(peaks.values())
    rows, left, operations = [], work.seconds, work.operations
    for kind, step in STEPS.items():
        calls, part = work.calls.get(step, 0), each[step]
        if calls:
            left, operations = left - calls * part.seconds, operations - calls * part.operations
            rows.append(_part_row(kind, calls, calls * part.seconds, calls * part.operations, work.seconds, peak))
    rows.append(_part_row("other", "", left, operations, work.seconds, peak))
    rows.append(_part_row("whole solve", "", work.seconds, work.operations, work.seconds, peak))
    print_table(
        f"Time by kind of step, {name}; each kind timed in a loop",
        ["kind of step", "number", "time", "share", "operations", "Gflop/s", "share of peak"],
        rows,
    )
    print(
        f"  Steps of the Newton iteration include the control of their size; one case uses one of {WIDE} SIMD lanes.\n"
        f"  The state of the solution is scalar: at most {scalar / 1e9:.3g} Gflop/s.\n"
        "  Derivatives of the solution use four lanes; of the first four only the three of the tip are needed.\n"
        "  Other: Newton's matrix, the path, stops, copies between arrays, calls."
    )


def _part_row(kind: str, calls: object, seconds: float, operations: int, whole: float, peak: float) -> list[str]:
    rate = operations / max(seconds, 1e-12)
    return [
        kind, str(calls), format_seconds(seconds), f"{seconds / whole:.0%}", str(operations), f"{rate / 1e9:.1f}",
        f"{rate / peak:.0%}",
    ]  # fmt: skip
