"""Rates, slowest cases and reproducibility of batches of random cases."""

import os
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import repeat
from typing import NamedTuple

import numpy as np

from benchmarks.cases import GRAVITY, Cases, Load, bare_large, paper_loads, random_cases, random_loads
from benchmarks.figures import CostCurve, draw_cost
from benchmarks.kernel_profile import SIMULTANEOUS, Request, counted, solver
from benchmarks.timing import format_seconds, interleaved, print_table
from probedesign.core.frames import Array
from probedesign.rod.batch import CHUNK, solve_batch
from probedesign.rod.kernels.equations import OK, Body
from probedesign.rod.kernels.newton import COLD
from probedesign.rod.kernels.solve import SOLUTION, scratch_buffers, solve_cases
from probedesign.rod.kernels.steps import WIDE
from probedesign.rod.rod import RESULTS, TOLERANCES, Rod

CASES = 100_000
SINGLE_CASES = 10_000
"""Cases that are timed one by one."""
ROUNDS = 3
AMOUNTS = (100, 300, 1000, 3000, 10_000, 30_000, 100_000)
"""Numbers of cases in the plot."""
KNOTS = (1, 4, 8, 16, 32, 64, 128, 256)
"""Numbers of frusta of the same cone in the plot; more frusta need more steps."""
STEP_TOLERANCES = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13)
"""Error tolerances of a step in the plot."""


class Batch(NamedTuple):
    """Measurements of one set of cases; times in s."""

    shares: dict[str, float]  #: share of each result code.
    seconds: dict[int, float]  #: kernel time of all cases by number of threads.
    whole: float  #: time of `solve_batch` on all cores, including the conversion of rods, loads and results.
    stacking: float  #: time of the conversion of rods and loads to arrays.
    same: bool  #: whether the results are bitwise equal for all numbers of threads.
    alone: Array  #: time of each of the first cases by itself, (SINGLE_CASES,).
    curve: CostCurve  #: time of one thread over the number of cases.

    @property
    def rates(self) -> dict[int, float]:
        """Solutions per second by number of threads; failed cases do not count."""
        return {threads: CASES * self.shares["ok"] / s for threads, s in self.seconds.items()}

    @property
    def gain(self) -> float:
        """Speed-up by solving cases in SIMD lanes, on one core."""
        return float(self.alone.mean()) * CASES / self.seconds[1]


class Kernel:
    """A set of cases and their solutions as arrays."""

    def __init__(self, cases: Cases) -> None:
        stacks = (np.stack(arrays) for arrays in zip(*(rod.body for rod in cases.rods), strict=True))
        self.bodies = Body(*(np.ascontiguousarray(stack) for stack in stacks))
        self.loads, self.which = cases.loads, cases.which
        self.found = np.empty(len(self.loads), dtype=SOLUTION)
        self.derivatives = np.empty((len(self.loads), 15, 1))

    def solve(self, first: int, last: int) -> None:
        """Solve the cases first ... last - 1."""
        solve_cases(
            first, last, self.bodies, self.which, self.loads, None, COLD, False, *TOLERANCES["fast"],
            *scratch_buffers(0, 0, CHUNK), self.found, self.derivatives,
        )  # fmt: skip

    def seconds(self, n: int, threads: int) -> float:
        """Return the time of the first n cases [s]."""
        firsts = range(0, n, CHUNK)
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(self.solve, repeat(0, threads), repeat(1)))  # starts the threads
            start = time.perf_counter()
            list(pool.map(self.solve, firsts, (min(first + CHUNK, n) for first in firsts)))
            return time.perf_counter() - start

    def each(self, n: int) -> Array:
        """Return the time of each of the first n cases without the call itself [s], (n,); the better of two runs."""
        best = np.full(n, np.inf)
        work = scratch_buffers(0, 0)
        fixed = (self.bodies, self.which, self.loads, None, COLD, False, *TOLERANCES["fast"], *work)

        def once(first: int, last: int) -> float:
            start = time.perf_counter()
            solve_cases(first, last, *fixed, self.found, self.derivatives)
            return time.perf_counter() - start

        empty = min(once(0, 0) for _ in range(100))
        for _ in range(2):
            best = np.minimum(best, [once(i, i + 1) - empty for i in range(n)])
        return best


def measure(cases: Cases) -> Batch:
    """Measure a set of cases."""
    n = len(cases.which)
    start = time.perf_counter()
    kernel = Kernel(cases)
    stacking = time.perf_counter() - start
    kernel.solve(0, 1)
    threads = sorted({1, len(os.sched_getaffinity(0))})
    results, seconds = [], {}
    for count in threads:
        seconds[count] = min(kernel.seconds(n, count) for _ in range(ROUNDS))
        results.append(kernel.found.copy())
    status = results[0]["status"]
    solved = status == OK
    same = all(
        np.array_equal(found["status"], status) and np.array_equal(found[solved], results[0][solved])
        for found in results
    )
    start = time.perf_counter()
    solve_batch(cases.rods, cases.gravity, cases.force, cases.s_contact, which=cases.which)
    whole = time.perf_counter() - start
    amounts = [amount for amount in AMOUNTS if amount < n]
    points = [min(kernel.seconds(amount, 1) for _ in range(2 if amount > 3000 else 9)) for amount in amounts]
    curve = CostCurve(np.array([*amounts, n], dtype=float), np.array([*points, seconds[1]]))
    return Batch(_shares(status), seconds, whole, stacking, same, kernel.each(min(n, SINGLE_CASES)), curve)


def _shares(status: Array) -> dict[str, float]:
    """Return the share of "ok" and of each other result that occurs."""
    shares = {"ok": 0.0}
    for code in np.unique(status).astype(int):
        shares[RESULTS[code]] = shares.get(RESULTS[code], 0.0) + float((status == code).mean())
    return shares


def measure_both() -> dict[str, Batch]:
    """Measure both sets of cases."""
    return {
        "random probes": measure(random_cases(CASES)),
        "large probe, random loads": measure(random_loads(bare_large(), CASES)),
    }


def print_batches(found: dict[str, Batch]) -> None:
    """Print the measurements of all sets in one table."""
    batches = list(found.values())
    rows = [
        ["solved", *(f"{batch.shares['ok']:.3%}" for batch in batches)],
        ["not solved", *(_others(batch.shares) for batch in batches)],
    ]
    for threads in batches[0].seconds:
        name = f"solutions per second, {threads} thread{'s' if threads > 1 else ''}"
        rows.append([name, *(f"{batch.rates[threads]:,.0f}" for batch in batches)])
    rows += [
        ["results bitwise equal for all threads", *("yes" if b.same else "no" for b in batches)],
        *([f"one case, {q:g}th percentile", *(format_seconds(float(np.percentile(b.alone, q))) for b in batches)]
          for q in (50, 90, 99, 100)),
        ["share of the slowest 1 % in the time", *(f"{_slowest(b.alone):.0%}" for b in batches)],
        ["conversion of rods and loads, not included", *(format_seconds(b.stacking) for b in batches)],
        ["solve_batch, everything included", *(f"{CASES * b.shares['ok'] / b.whole:,.0f} /s" for b in batches)],
        [f"speed-up by {WIDE} SIMD lanes, on one core", *(f"× {b.gain:.2f}" for b in batches)],
    ]  # fmt: skip
    print_table(
        f"{CASES:,} random cases, each cold, fast mode: tip, base moment, contact. Best of {ROUNDS}", ["", *found], rows
    )


def _others(shares: dict[str, float]) -> str:
    return ", ".join(f"{name} {share:.3%}" for name, share in shares.items() if name != "ok") or "none"


def _slowest(seconds: Array) -> float:
    return float(np.sort(seconds)[-len(seconds) // 100 :].sum() / seconds.sum())


def divided(rod: Rod, frusta: int) -> Rod:
    """Return the same cone divided into frusta of equal length."""
    s = np.linspace(0.0, rod.length, frusta + 1)
    radius = rod.radius_at(s)
    return Rod(s, radius, rod.youngs_modulus, rod.shear_modulus, rod.density, rod.shear_coefficient)


def step_costs(rod: Rod, load: Load) -> dict[str, CostCurve]:
    """Return the time of a solve over its steps, best of nine, for smaller tolerances and for more frusta."""
    by_tolerance = _cost([rod] * len(STEP_TOLERANCES), load, [Request(tol=tol) for tol in STEP_TOLERANCES])
    by_frusta = _cost([divided(rod, frusta) for frusta in KNOTS], load, [Request()] * len(KNOTS))
    return {"smaller tolerance": by_tolerance, "more frusta": by_frusta}


def _cost(rods: Sequence[Rod], load: Load, requests: Sequence[Request]) -> CostCurve:
    steps, seconds = [], []
    for rod, request in zip(rods, requests, strict=True):
        solve = solver(rod, load, request, 20)
        seconds.append(min(interleaved({"": solve}, 1)[""] for _ in range(9)) / 20)
        _operations, calls = counted(rod, rod.load(GRAVITY, load.force, load.s), request)
        steps.append(float(sum(calls.get(name, 0) for name in SIMULTANEOUS)))
    order = np.argsort(steps)
    return CostCurve(np.array(steps)[order], np.array(seconds)[order])


def plot(found: dict[str, Batch]) -> dict[str, float]:
    """Draw time over cases and over steps, and return the scaling exponents by series."""
    rod = bare_large()
    panels = {
        "cases, one thread": {name: batch.curve for name, batch in found.items()},
        "steps of a solve, state and derivatives": step_costs(rod, paper_loads(rod)[1]),
    }
    draw_cost(panels)
    return {name: cost.exponent for series in panels.values() for name, cost in series.items()}


def report() -> dict[str, Batch]:
    """Print the table, draw the figure and return the measurements."""
    found = measure_both()
    print_batches(found)
    exponents = plot(found)
    print("  docs/pictures/cost.png shows the time; scaling exponents (1: proportional): "
          + ", ".join(f"{name} {value:.2f}" for name, value in exponents.items()))  # fmt: skip
    return found
