"""The compiled solver without Python around it: how long it takes, how much it computes, and where the time goes."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from benchmarks.cases import GRAVITY, Load
from benchmarks.operations import count, flops
from benchmarks.timing import interleaved, print_table, shown, spread
from probedesign.core.frames import Array
from probedesign.rod.kernels import newton
from probedesign.rod.kernels.equations import ALL_COLUMNS, LOAD_COLUMNS, OK, frustum_of, rest_of
from probedesign.rod.kernels.lane_sweep import tick
from probedesign.rod.kernels.lanes import (
    LENGTH,
    SIZE,
    STEP_BUDGET,
    TIPS,
    TOL,
    WANTS_TIPS,
    D,
    H,
    S,
    T,
    put_frustum,
)
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
"""Of one case in one call, so that the call itself costs nothing."""
NODES = 64
ROUNDS = 9
BESIDE = 1.01
"""Of the force: the neighbouring load that a warm solve starts from."""
STEPS = {"the state, sought": "round_lanes_step", "the tip's columns, sought": "round_tips_step",
         "the state, reported": "full_step", "the tip's columns, reported": "free_columns_step",
         "columns by loads, reported": "forced_columns_step"}  # fmt: skip
SIMULTANEOUS = ("round_lanes_step", "round_tips_step")
"""Steps that take WIDE cases in the time of one."""
TRIPS = 1000


class Request(NamedTuple):
    """Request of a solve: number of derivatives, number of nodes of the shape, start from a neighbour or cold, number
    of cases side by side."""

    columns: int = 0
    room: int = 0
    warm: bool = False
    group: int = 1
    tol: float = TOLERANCES["fast"][0]


COLD = "cold: tip, base moment, contact"
TOGETHER = f"the same, {WIDE} cases side by side: of each"
SHAPE = "cold with the shape"
JACOBIAN = "neighbouring load, with the Jacobian by force and s_contact"
REQUESTS = {
    COLD: Request(),
    TOGETHER: Request(group=WIDE),
    SHAPE: Request(room=NODES),
    "cold, with the Jacobian by force and s_contact": Request(LOAD_COLUMNS),
    "neighbouring load": Request(warm=True),
    JACOBIAN: Request(LOAD_COLUMNS, warm=True),
    "neighbouring load, with all 16 derivatives": Request(ALL_COLUMNS + 2, warm=True),
}


class Work(NamedTuple):
    """Of one solve: median time [s], operations, and calls of each function by name."""

    seconds: float
    operations: int
    calls: dict[str, int]


class Part(NamedTuple):
    """A kind of step: what one takes by itself [s], and its operations."""

    seconds: float
    operations: int


def solver(rod: Rod, load: Load, request: Request, copies: int = COPIES) -> Callable[[], int]:
    """Copies of one case, solved in one call of the kernel; from a neighbour, each of them from the same."""
    loads = np.tile(rod.load(GRAVITY, load.force, load.s), (copies, 1))
    found, derivatives = np.empty(copies, dtype=SOLUTION), np.empty((copies, 15, request.columns + 1))
    which, work = (
        np.zeros(copies, dtype=np.int64),
        scratch_buffers(request.columns, request.room, request.group),
    )
    beside = rod.solve(GRAVITY, BESIDE * load.force, load.s).tip
    start = newton.WARM_ONLY if request.warm else newton.COLD
    tips = found["tip"]
    case = (0, copies, rod.stacked, which, loads, rod.directed, start, False, request.tol, request.tol / 10.0)

    def solve() -> int:
        tips[:] = beside
        done: int = solve_cases(*case, *work, found, derivatives)
        return done

    solve()
    if (found["status"] != OK).any():
        raise ArithmeticError("a case of the benchmark has no equilibrium")
    return solve


def counted(
    rod: Rod, load: Array, request: Request, beside: Array | None = None
) -> tuple[int, dict[str, int]]:
    """Return the operations of one solve, and the calls of each function; the load as the kernels take it."""
    n = WIDE  # of the same case, so that no lane works on nothing
    found, derivatives = np.zeros(n, dtype=SOLUTION), np.zeros((n, 15, request.columns + 1))
    if beside is not None:
        found["tip"] = beside
    start = newton.COLD if beside is None else newton.WARM_ONLY
    work = scratch_buffers(request.columns, request.room, n)
    for numbers in work:
        numbers[:] = 0.0  # memory as it comes may hold what is no number
    which, tol = np.zeros(n, dtype=np.int64), request.tol
    done, calls = count(solve_cases, 0, n, rod.stacked, which, np.tile(load, (n, 1)),
                        rod.directed, start, False, tol, tol / 10.0, *work, found, derivatives)  # fmt: skip
    return flops(done) // n, {
        name: times if name in SIMULTANEOUS else times // n for name, times in calls.items()
    }


def measure(rod: Rod, loads: Sequence[Load]) -> dict[str, list[Work]]:
    """Return the work of each request, for each load."""
    found: dict[str, list[Work]] = {name: [] for name in REQUESTS}
    for load in loads:
        seconds = interleaved(
            {name: solver(rod, load, request) for name, request in REQUESTS.items()}, ROUNDS
        )
        beside = rod.solve(GRAVITY, BESIDE * load.force, load.s).tip
        for name, request in REQUESTS.items():
            given = rod.load(GRAVITY, load.force, load.s)
            found[name].append(
                Work(seconds[name] / COPIES, *counted(rod, given, request, beside if request.warm else None))
            )
    return found


@njit(error_model="numpy")
def _reported(trips: int, kinds: Any, body: Any, load: Any, work: Any, block: Any) -> None:
    """Steps of those kinds in turn, each from where the last one came to, as in a sweep; too short to come far."""
    free, forced = kinds
    s, frustum, rest = body.knots[-1], frustum_of(body, 0, False), rest_of(body, 0)
    force, gravity, h = take(load, 0), take(load, 3), -1e-6 * s
    for _ in range(trips):
        full_step(s, h, work, frustum, rest, force, gravity, 1.0)
        if free:
            free_columns_step(h, block, work)
        if forced:
            forced_columns_step(h, block, work, gravity)
        s += h  # or the compiler would take what depends on it alone out of the loop
        for q in range(STATE):
            work[q] = work[STATE + q]
        for q in range(WIDE * COLUMN):
            block[q] = block[WIDE * NEXT + q]


@njit(error_model="numpy")
def _sought(trips: int, tips: bool, body: Any, lanes: Any) -> None:
    """The same of steps in all lanes, judged and taken."""
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


@njit
def _begin(work: Any, block: Any) -> None:
    work[:] = 0.0
    put(work, 0, (0.0, 0.0, 1.0))
    put(work, 9, (1.0, 0.0, 0.0))
    block[:] = 1.0


def parts(rod: Rod, load: Load) -> dict[str, Part]:
    """The kinds of step, by the functions' names: the state's by themselves, columns by what they add to those.

    Those of a case that is sought: of a lane, whose neighbours cost nothing more. In turn with others a step takes
    longer than again and again by itself: most likely because the code of all does not stay decoded.
    """
    work, block, given = (
        np.empty(WORK),
        np.empty(BLOCK),
        rod.load(GRAVITY, load.force, load.s),
    )
    _begin(work, block)
    lanes = np.zeros(LANES)
    case = (rod.body, given, work, block)
    kinds: dict[str, tuple[Any, tuple[object, ...]]] = {
        "full": (_reported, ((False, False), *case)),
        "free": (_reported, ((True, False), *case)),
        "forced": (_reported, ((True, True), *case)),
        "round": (_sought, (False, rod.body, lanes)),
        "tips": (_sought, (True, rod.body, lanes)),
    }
    seconds = interleaved({name: partial(steps, TRIPS, *of) for name, (steps, of) in kinds.items()}, ROUNDS)
    found = {
        name: Part(seconds[name] / TRIPS, flops(count(steps, 2, *of)[0]) - flops(count(steps, 1, *of)[0]))
        for name, (steps, of) in kinds.items()
    }
    return {
        "full_step": found["full"],
        "free_columns_step": _beyond(found["free"], found["full"]),
        "forced_columns_step": _beyond(found["forced"], found["free"]),
        "round_lanes_step": _of_lane(found["round"]),
        "round_tips_step": _of_lane(_beyond(found["tips"], found["round"])),
    }


def _of_lane(part: Part) -> Part:
    """All lanes take as long as one; the operations are one's."""
    return Part(part.seconds, part.operations // WIDE)


def _beyond(both: Part, one: Part) -> Part:
    return Part(both.seconds - one.seconds, both.operations - one.operations)


def print_times(found: dict[str, list[Work]], peak: float) -> None:
    """Print what each solve takes and computes; peak: operations a second of a core at most."""
    rows = []
    for name, work in found.items():
        share = [w.operations / w.seconds / peak for w in work]
        rows.append([
            name,
            spread([w.seconds for w in work], shown),
            spread([float(sum(w.calls.get(step, 0) for step in STEPS.values())) for w in work], "{:.0f}".format),
            spread([float(w.operations) for w in work], "{:.0f}".format),
            spread([w.operations / w.seconds / 1e9 for w in work], "{:.1f}".format),
            spread(share, "{:.0%}".format),
        ])  # fmt: skip
    print_table(
        f"Inside the kernel, fast mode, the large probe under {len(next(iter(found.values())))} loads of the paper. "
        f"{COPIES} copies a call, medians of {ROUNDS} interleaved rounds",
        ["one equilibrium", "time", "steps", "operations", "10⁹ a second", "of the peak"],
        rows,
    )
    print(
        "  operations: + - × ÷ √ on floats as the source says them, counted by running it on numbers that count\n"
        f"  peak: {peak / 1e9:.3g}·10⁹ a second of one core, fused multiply-adds on whole registers, measured"
    )


def print_parts(work: Work, each: dict[str, Part], peaks: dict[str, float], name: str) -> None:
    """Print where the time of one solve goes."""
    peak, numbers = max(peaks.values()), min(peaks.values())
    rows, left, operations = [], work.seconds, work.operations
    for what, step in STEPS.items():
        calls, part = work.calls.get(step, 0), each[step]
        if calls:
            left, operations = left - calls * part.seconds, operations - calls * part.operations
            rows.append(_part(what, calls, calls * part.seconds, calls * part.operations, work.seconds, peak))
    rows.append(_part("all else", "", left, operations, work.seconds, peak))
    rows.append(_part("the solve", "", work.seconds, work.operations, work.seconds, peak))
    print_table(
        f"Where the time goes, {name}: each kind of step timed in a loop of steps",
        ["steps of", "how many", "time", "of all", "operations", "10⁹ a second", "of the peak"],
        rows,
    )
    print(
        f"  Sought: with all that is done for a step. A case alone uses one of {WIDE} lanes of a register; the "
        "reported state goes number by number.\n  Both: at most "
        f"{numbers / 1e9:.3g}·10⁹ a second. Reported columns go four to a register, but of the first four only the "
        "tip's three are needed.\n"
        "  All else: Newton's matrix, the path, stops, moving numbers between arrays, calls."
    )


def _part(what: str, calls: object, seconds: float, operations: int, whole: float, peak: float) -> list[str]:
    rate = operations / max(seconds, 1e-12)
    return [
        what, str(calls), shown(seconds), f"{seconds / whole:.0%}", str(operations), f"{rate / 1e9:.1f}",
        f"{rate / peak:.0%}",
    ]  # fmt: skip
