"""Time and error of the compiled rod and of scipy for equilibria of the paper's large probe."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from benchmarks.cases import GRAVITY, Load, paper_loads
from benchmarks.collocation import solve_by_bvp
from benchmarks.timing import format_seconds, interleaved, print_table, two_digits, value_range
from probedesign.core.frames import Array
from probedesign.rod.kernels.equations import OK
from probedesign.rod.kernels.newton import COLD, SOLUTION, WARM_ONLY, scratch_buffers, solve_cases
from probedesign.rod.rod import TOLERANCES, Rod

ROUNDS = 9
COPIES = 100  #: Copies of a case in one call of the kernel, so that the overhead of the call is negligible.
NODES = 64  #: Nodes of the shape.
NEIGHBOUR = 1.01  #: Factor on the force of the neighbouring load that a warm solve starts from.
STATIONS = 31  #: Stations at which centrelines are compared.
ROD, KERNEL = "Rod.solve", "kernel of Rod.solve, with the shape"
CALLS = ("cold", "from a neighbouring load", "the same with the Jacobian by force and s_contact",
         "the same with all derivatives")  # fmt: skip

Centreline = tuple[Array, Array]  #: Stations [m], (k,), and points of the centreline [m], (k, 3).


class Method(NamedTuple):
    """A solver of one case."""

    timed: Callable[[], object]  #: the call to time.
    centreline: Callable[[], Centreline]  #: the call that returns its centreline.
    copies: int = 1  #: number of solves in the timed call.


class Measurement(NamedTuple):
    """Median time [s] and largest distance from the converged centreline [m] of one method for one case."""

    seconds: float
    error: float


def solver(rod: Rod, load: Load, columns: int, room: int, warm: bool = False) -> Callable[[], object]:
    """Return a function that solves COPIES of one case in one call of the kernel.

    Args:
        rod, load: the case.
        columns: number of derivatives; room: number of nodes of the shape.
        warm: whether the solve starts from a neighbouring load.

    Raises:
        ArithmeticError: the case has no equilibrium.
    """
    loads = np.tile(rod.load(GRAVITY, load.force, load.s), (COPIES, 1))
    solutions, derivatives = np.empty(COPIES, dtype=SOLUTION), np.empty((COPIES, 15, columns + 1))
    which, scratch = np.zeros(COPIES, dtype=np.int64), scratch_buffers(columns, room)
    neighbour = rod.solve(GRAVITY, NEIGHBOUR * load.force, load.s).tip
    start = WARM_ONLY if warm else COLD

    def solve() -> None:
        solutions["tip"] = neighbour
        solve_cases(0, COPIES, rod.stacked, which, loads, start, False, *TOLERANCES["fast"], scratch, solutions,
                    derivatives)  # fmt: skip

    solve()
    if (solutions["status"] != OK).any():
        raise ArithmeticError("a case of the benchmark has no equilibrium")
    return solve


def by_rod(rod: Rod, load: Load) -> dict[str, Method]:
    """Return the methods with the compiled rod from a cold start."""
    s = np.linspace(0.0, rod.length, STATIONS)
    fast = partial(rod.solve, GRAVITY, load.force, load.s)
    reference = partial(rod.solve, GRAVITY, load.force, load.s, mode="reference")
    return {
        KERNEL: Method(solver(rod, load, 0, NODES), lambda: (s, fast().p_at(s)), COPIES),
        ROD: Method(fast, lambda: (s, fast().p_at(s))),
        'Rod.solve(mode="reference")': Method(reference, lambda: (s, reference().p_at(s))),
    }


def by_scipy(rod: Rod, load: Load) -> dict[str, Method]:
    """Return collocation with scipy's default tolerance."""
    s = np.linspace(0.0, rod.length, STATIONS)
    run = partial(solve_by_bvp, rod, GRAVITY, load.force, load.s, s, 1e-3)
    return {"solve_bvp, tol 1e-3": Method(run, lambda: (s, run()))}


def measure(rod: Rod, load: Load) -> dict[str, Measurement]:
    """Measure all methods for one case."""
    truth = rod.solve(GRAVITY, load.force, load.s, mode="reference")
    solvers = {**by_rod(rod, load), **by_scipy(rod, load)}
    seconds = interleaved({name: method.timed for name, method in solvers.items()}, ROUNDS)
    found = {}
    for name, method in solvers.items():
        s, p = method.centreline()
        error = float(np.linalg.norm(p - truth.p_at(s), axis=1).max())
        found[name] = Measurement(seconds[name] / method.copies, error)
    return found


def compare(rod: Rod) -> list[dict[str, Measurement]]:
    """Measure all methods for all loads."""
    return [measure(rod, load) for load in paper_loads(rod)]


def print_comparison(found: Sequence[dict[str, Measurement]]) -> None:
    """Print times, errors and ratios."""
    print_table(
        f"One equilibrium of the large probe, cold, range over {len(found)} loads of the paper. "
        f"Medians of up to {ROUNDS} interleaved rounds",
        ["method", "time", "error [µm]", f"time / {ROD}", "time / kernel"],
        [row(name, found) for name in found[0]],
    )
    print("  error: largest distance from the converged centreline (Rod.solve in reference mode, "
          "which tests/rod/test_truth.py and test_balance.py compare with closed forms)")  # fmt: skip


def row(name: str, found: Sequence[dict[str, Measurement]]) -> list[str]:
    """Return the row of one method."""
    measured = [case[name] for case in found]
    return [
        name,
        value_range([m.seconds for m in measured], format_seconds),
        value_range([m.error for m in measured], lambda error: "< 0.001" if error < 1e-9 else two_digits(error / 1e-6)),
        value_range(ratios(name, found, ROD), two_digits),
        value_range(ratios(name, found, KERNEL), two_digits),
    ]


def ratios(name: str, found: Sequence[dict[str, Measurement]], reference: str) -> list[float]:
    """Return the time of a method over that of a reference method for every case."""
    return [case[name].seconds / case[reference].seconds for case in found]


def calls_from_python(rod: Rod) -> dict[str, float]:
    """Return the time of calls from Python [s] for the slowest of the loads."""
    slowest = dict.fromkeys(CALLS, 0.0)
    for load in paper_loads(rod):
        neighbour = rod.solve(GRAVITY, NEIGHBOUR * load.force, load.s).tip
        case = (GRAVITY, load.force, load.s)
        calls = (
            partial(rod.solve, *case),
            partial(rod.solve, *case, guess=neighbour),
            partial(rod.solve, *case, guess=neighbour, columns="load"),
            partial(rod.solve, *case, guess=neighbour, columns="all"),
        )
        seconds = interleaved(dict(zip(CALLS, calls, strict=True)), ROUNDS)
        slowest = {name: max(slowest[name], seconds[name]) for name in CALLS}
    return slowest


def print_calls(slowest: dict[str, float]) -> None:
    """Print the times of calls from Python."""
    print_table(
        f"One call from Python. Median of {ROUNDS} interleaved rounds, slowest of the loads",
        ["Rod.solve", "time"],
        [[name, format_seconds(seconds)] for name, seconds in slowest.items()],
    )
