"""Speed of the rod: against other solvers, in its kernel, by calls from Python and in batches."""

import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import repeat
from typing import NamedTuple

import numpy as np

from benchmarks import solver_comparison
from benchmarks.cases import Cases, Load, bare_large, paper_loads, random_cases, random_loads
from benchmarks.solver_comparison import NODES, solver
from benchmarks.timing import format_seconds, interleaved, print_table, value_range
from probedesign.rod.batch import CHUNK, solve_batch
from probedesign.rod.kernels.equations import ALL_COLUMNS, LOAD_COLUMNS, OK, Body
from probedesign.rod.kernels.newton import COLD, SOLUTION, scratch_buffers, solve_cases
from probedesign.rod.rod import RESULTS, TOLERANCES, Rod

CASES = 100_000  #: Cases of a batch.
ROUNDS, BATCH_ROUNDS = 9, 3

#: Derivatives, nodes of the shape and whether it starts from a neighbouring load, of each solve that is timed.
SOLVES = {
    "cold: tip, base moment, contact": (0, 0, False),
    "cold with the shape": (0, NODES, False),
    "cold, with the Jacobian by force and s_contact": (LOAD_COLUMNS, 0, False),
    "neighbouring load": (0, 0, True),
    "neighbouring load, with the Jacobian by force and s_contact": (LOAD_COLUMNS, 0, True),
    "neighbouring load, with all 18 derivatives": (ALL_COLUMNS + 2, 0, True),
}


class Batch(NamedTuple):
    """Measurements of one set of cases; times in s."""

    shares: dict[str, float]  #: share of each result code.
    rates: dict[int, float]  #: solutions per second of the kernel by number of threads; failed cases do not count.
    whole: float  #: time of `solve_batch` on all cores, including the conversion of rods, loads and results.
    same: bool  #: whether the results are bitwise equal for all numbers of threads.


def report() -> None:
    """Run and print all measurements of the rod."""
    rod = bare_large()
    solver_comparison.print_comparison(solver_comparison.compare(rod))
    solver_comparison.print_calls(solver_comparison.calls_from_python(rod))
    kernel = kernel_seconds(rod, paper_loads(rod))
    print_table(
        f"Kernel time, fast mode, the large probe under 4 loads of the paper. Medians of {ROUNDS} interleaved rounds",
        ["one equilibrium", "time"],
        [[name, value_range(seconds, format_seconds)] for name, seconds in kernel.items()],
    )
    print_batches(
        {
            "random probes": measure_batch(random_cases(CASES)),
            "large probe, random loads": measure_batch(random_loads(rod, CASES)),
        }
    )


def kernel_seconds(rod: Rod, loads: Sequence[Load]) -> dict[str, list[float]]:
    """Return the time of each solve for each load without the call from Python [s]."""
    seconds: dict[str, list[float]] = {name: [] for name in SOLVES}
    for load in loads:
        calls: dict[str, Callable[[], object]] = {
            name: solver(rod, load, columns, room, warm) for name, (columns, room, warm) in SOLVES.items()
        }
        for name, value in interleaved(calls, ROUNDS).items():
            seconds[name].append(value / solver_comparison.COPIES)
    return seconds


class Kernel:
    """A set of cases and their solutions as arrays."""

    def __init__(self, cases: Cases) -> None:
        stacks = (np.stack(arrays) for arrays in zip(*(rod.body for rod in cases.rods), strict=True))
        bodies = Body(*(np.ascontiguousarray(stack) for stack in stacks))
        self._arguments = (bodies, cases.which, cases.loads, COLD, False, *TOLERANCES["fast"])
        self.solutions = np.empty(len(cases.which), dtype=SOLUTION)
        self._derivatives = np.empty((len(cases.which), 15, 1))

    def solve(self, first: int, last: int) -> None:
        """Solve the cases first ... last - 1."""
        solve_cases(first, last, *self._arguments, scratch_buffers(0, 0), self.solutions, self._derivatives)

    def seconds(self, n: int, threads: int) -> float:
        """Return the time of the first n cases [s]."""
        firsts = range(0, n, CHUNK)
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(self.solve, repeat(0, threads), repeat(1)))  # starts the threads
            start = time.perf_counter()
            list(pool.map(self.solve, firsts, (min(first + CHUNK, n) for first in firsts)))
            return time.perf_counter() - start


def measure_batch(cases: Cases) -> Batch:
    """Measure a set of cases."""
    n, kernel = len(cases.which), Kernel(cases)
    results, seconds = [], {}
    for threads in sorted({1, len(os.sched_getaffinity(0))}):
        seconds[threads] = min(kernel.seconds(n, threads) for _ in range(BATCH_ROUNDS))
        results.append(kernel.solutions.copy())
    status = results[0]["status"]
    solved = status == OK
    same = all(
        np.array_equal(solutions["status"], status) and np.array_equal(solutions[solved], results[0][solved])
        for solutions in results
    )
    start = time.perf_counter()
    solve_batch(cases.rods, cases.gravity, cases.force, cases.s_contact, which=cases.which)
    whole = time.perf_counter() - start
    shares = {"ok": 0.0}
    for code in np.unique(status).astype(int):
        shares[RESULTS[code]] = shares.get(RESULTS[code], 0.0) + float((status == code).mean())
    rates = {threads: n * shares["ok"] / value for threads, value in seconds.items()}
    return Batch(shares, rates, whole, same)


def print_batches(batches: dict[str, Batch]) -> None:
    """Print the measurements of all sets in one table."""

    def row(name: str, cell: Callable[[Batch], str]) -> list[str]:
        return [name, *(cell(batch) for batch in batches.values())]

    def unsolved(batch: Batch) -> str:
        return ", ".join(f"{name} {share:.3%}" for name, share in batch.shares.items() if name != "ok") or "none"

    print_table(
        f"{CASES:,} random cases, each cold, fast mode: tip, base moment, contact. Best of {BATCH_ROUNDS}",
        ["", *batches],
        [
            row("solved", lambda batch: f"{batch.shares['ok']:.3%}"),
            row("not solved", unsolved),
            *(row(f"solutions per second, {threads} thread{'s' * (threads > 1)}",
                  lambda batch, threads=threads: f"{batch.rates[threads]:,.0f}")  # type: ignore[misc]
              for threads in next(iter(batches.values())).rates),
            row("results bitwise equal for all threads", lambda batch: "yes" if batch.same else "no"),
            row("solve_batch, everything included", lambda b: f"{CASES * b.shares['ok'] / b.whole:,.0f} /s"),
        ],
    )  # fmt: skip
