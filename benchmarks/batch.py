"""Many random cases: how many a second, how long the slowest wait, and whether threads change the answers."""

import os
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import repeat
from typing import NamedTuple

import numpy as np

from benchmarks.cases import GRAVITY, Cases, Load, bare_large, paper_loads, random_cases, random_loads
from benchmarks.inside import SIMULTANEOUS, Request, counted, solver
from benchmarks.plots import Cost, draw_cost, slope
from benchmarks.timing import interleaved, print_table, shown
from probedesign.core.frames import Array
from probedesign.rod.batch import CHUNK, solve_batch
from probedesign.rod.kernels.equations import OK, Body
from probedesign.rod.kernels.newton import COLD
from probedesign.rod.kernels.solve import SOLUTION, scratch_buffers, solve_cases
from probedesign.rod.kernels.steps import WIDE
from probedesign.rod.rod import RESULTS, TOLERANCES, Rod

CASES = 100_000
ALONE = 10_000
"""Cases that are timed one by one."""
ROUNDS = 3
AMOUNTS = (100, 300, 1000, 3000, 10_000, 30_000, 100_000)
"""Cases of the points of the plot."""
KNOTS = (1, 4, 8, 16, 32, 64, 128, 256)
"""Frusta that the same cone is cut into, so that a sweep needs ever more steps."""
FINER = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13)
"""Errors allowed a step."""


class Batch(NamedTuple):
    """Of one set of cases.

    Attributes:
        shares: of each result, all cases together 1.
        seconds: of all cases by threads, the kernel's alone.
        whole: of `solve_batch` on all cores, rods and loads into arrays and answers out of them included.
        stacking: of putting rods and loads into arrays.
        same: whether threads left every bit as it was.
        alone: of each of the first cases, (ALONE,).
        curve: cases and seconds of one thread.
    """

    shares: dict[str, float]
    seconds: dict[int, float]
    whole: float
    stacking: float
    same: bool
    alone: Array
    curve: Cost

    @property
    def rates(self) -> dict[int, float]:
        """Solutions a second by threads; a case without an answer is none."""
        return {threads: CASES * self.shares["ok"] / s for threads, s in self.seconds.items()}

    @property
    def gain(self) -> float:
        """How many times as fast cases are side by side as alone, on one core."""
        return float(self.alone.mean()) * CASES / self.seconds[1]


class Kernel:
    """A set of cases as arrays, and where their answers go."""

    def __init__(self, cases: Cases) -> None:
        stacks = (np.stack(arrays) for arrays in zip(*(rod.body for rod in cases.rods), strict=True))
        self.bodies = Body(*(np.ascontiguousarray(stack) for stack in stacks))
        self.loads, self.which = cases.loads, cases.which
        self.found = np.empty(len(self.loads), dtype=SOLUTION)
        self.derivatives = np.empty((len(self.loads), 15, 1))

    def solve(self, first: int, last: int) -> None:
        """The cases first ... last - 1."""
        solve_cases(
            first, last, self.bodies, self.which, self.loads, None, COLD, False, *TOLERANCES["fast"],
            *scratch_buffers(0, 0, CHUNK), self.found, self.derivatives,
        )  # fmt: skip

    def seconds(self, n: int, threads: int) -> float:
        """Of the first n cases."""
        firsts = range(0, n, CHUNK)
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(self.solve, repeat(0, threads), repeat(1)))  # the threads stand ready
            start = time.perf_counter()
            list(pool.map(self.solve, firsts, (min(first + CHUNK, n) for first in firsts)))
            return time.perf_counter() - start

    def each(self, n: int) -> Array:
        """Seconds of each of the first n cases, the call itself taken off: the better of two."""
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


def measure(cases: Cases, n: int = CASES) -> Batch:
    """Everything of one set of n cases."""
    start = time.perf_counter()
    kernel = Kernel(cases)
    stacking = time.perf_counter() - start
    kernel.solve(0, 1)
    threads = sorted({1, len(os.sched_getaffinity(0))})
    answers, seconds = [], {}
    for count in threads:
        seconds[count] = min(kernel.seconds(n, count) for _ in range(ROUNDS))
        answers.append(kernel.found.copy())
    status = answers[0]["status"]
    good = status == OK
    same = all(
        np.array_equal(found["status"], status) and np.array_equal(found[good], answers[0][good])
        for found in answers
    )
    start = time.perf_counter()
    solve_batch(cases.rods, cases.gravity, cases.force, cases.s_contact, which=cases.which)
    whole = time.perf_counter() - start
    amounts = [amount for amount in AMOUNTS if amount < n]
    points = [min(kernel.seconds(amount, 1) for _ in range(2 if amount > 3000 else 9)) for amount in amounts]
    curve = Cost(np.array([*amounts, n], dtype=float), np.array([*points, seconds[1]]))
    return Batch(_shares(status), seconds, whole, stacking, same, kernel.each(min(n, ALONE)), curve)


def _shares(status: Array) -> dict[str, float]:
    """Of the results, those that occur and "ok"."""
    shares = {"ok": 0.0}
    for code in np.unique(status).astype(int):
        shares[RESULTS[code]] = shares.get(RESULTS[code], 0.0) + float((status == code).mean())
    return shares


def both() -> dict[str, Batch]:
    """The two sets of cases."""
    return {
        "random probes": measure(random_cases(CASES)),
        "large probe, random loads": measure(random_loads(bare_large(), CASES)),
    }


def print_batches(found: dict[str, Batch]) -> None:
    """Print them side by side."""
    batches = list(found.values())
    rows = [
        ["solved, of all", *(f"{batch.shares['ok']:.3%}" for batch in batches)],
        ["without an answer", *(_others(batch.shares) for batch in batches)],
    ]
    for threads in batches[0].seconds:
        name = f"solutions a second, {threads} thread{'s' if threads > 1 else ''}"
        rows.append([name, *(f"{batch.rates[threads]:,.0f}" for batch in batches)])
    rows += [
        ["answers of all threads the same to the bit", *("yes" if b.same else "NO" for b in batches)],
        *([f"one case, {q:g} % take less than", *(shown(float(np.percentile(b.alone, q))) for b in batches)]
          for q in (50, 90, 99, 100)),
        ["time of the slowest hundredth, of all", *(f"{_slowest(b.alone):.0%}" for b in batches)],
        ["left out: rods and loads into arrays", *(shown(b.stacking) for b in batches)],
        ["solve_batch, all included", *(f"{CASES * b.shares['ok'] / b.whole:,.0f} a second" for b in batches)],
        [f"gain by {WIDE} lanes, on one core", *(f"× {b.gain:.2f}" for b in batches)],
    ]  # fmt: skip
    print_table(
        f"{CASES:,} random cases, each cold, fast mode: tip, base moment, contact. Best of {ROUNDS}",
        ["", *found],
        rows,
    )


def _others(shares: dict[str, float]) -> str:
    return ", ".join(f"{name} {share:.3%}" for name, share in shares.items() if name != "ok") or "none"


def _slowest(seconds: Array) -> float:
    return float(np.sort(seconds)[-len(seconds) // 100 :].sum() / seconds.sum())


def cut(rod: Rod, frusta: int) -> Rod:
    """The same cone in so many pieces."""
    s = np.linspace(0.0, rod.length, frusta + 1)
    radius = rod.radius_at(s)
    return Rod(s, radius, rod.youngs_modulus, rod.shear_modulus, rod.density, rod.shear_coefficient)


def step_costs(rod: Rod, load: Load) -> dict[str, Cost]:
    """Steps of a solve and what it takes, the best of nine, by finer steps and by more frusta."""
    finer = _cost([rod] * len(FINER), load, [Request(tol=tol) for tol in FINER])
    longer = _cost([cut(rod, frusta) for frusta in KNOTS], load, [Request()] * len(KNOTS))
    return {"finer steps": finer, "more frusta": longer}


def _cost(rods: Sequence[Rod], load: Load, asked: Sequence[Request]) -> Cost:
    steps, seconds = [], []
    for rod, ask in zip(rods, asked, strict=True):
        solve = solver(rod, load, ask, 20)
        seconds.append(min(interleaved({"": solve}, 1)[""] for _ in range(9)) / 20)
        _operations, calls = counted(rod, rod.load(GRAVITY, load.force, load.s), ask)
        steps.append(float(sum(calls.get(name, 0) for name in SIMULTANEOUS)))
    order = np.argsort(steps)
    return Cost(np.array(steps)[order], np.array(seconds)[order])


def plot(found: dict[str, Batch]) -> dict[str, float]:
    """Draw cost against cases and against steps; slopes on logarithmic axes by series."""
    rod = bare_large()
    panels = {
        "cases, one thread": {name: batch.curve for name, batch in found.items()},
        "steps of a solve, state and columns": step_costs(rod, paper_loads(rod)[1]),
    }
    draw_cost(panels)
    return {name: slope(cost) for series in panels.values() for name, cost in series.items()}


def report() -> dict[str, Batch]:
    """Print the table and draw the picture."""
    found = both()
    print_batches(found)
    slopes = plot(found)
    print("  cost drawn in docs/pictures/cost.png; slope on logarithmic axes, 1 where it is in proportion: "
          + ", ".join(f"{name} {value:.2f}" for name, value in slopes.items()))  # fmt: skip
    return found
