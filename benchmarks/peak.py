"""How many floating-point operations a second one core of this machine does at most, measured."""

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numba import njit

from benchmarks.operations import count_operations, flops
from benchmarks.timing import print_table

ROUNDS = 15
TRIPS = 20_000
LANES = 256
"""Numbers in each row that the vectorised kernel works on: all four stay in the first cache."""
DEPTH = 8
"""Multiply-adds on each number between reading and writing it."""
SHRINK, SHIFT = 0.999, 1e-3
"""x ← x · SHRINK + SHIFT stays near 1, away from infinity and from numbers too small to be quick."""

fused = njit(fastmath={"contract"})
"""A multiplication and the addition to it in one instruction."""
apart = njit
"""As the rod is compiled: each rounded by itself."""


def _numbers(trips: int, m: float, c: float) -> float:
    """Twelve chains of x ← x m + c: enough to hide the latency, few enough to stay in registers."""
    a, b, d, e, f, g = 0.1, 0.2, 0.3, 0.4, 0.5, 0.6
    p, q, r, s, t, u = 0.7, 0.8, 0.9, 1.0, 1.1, 1.2
    for _ in range(trips):
        a, b, d, e, f, g = a * m + c, b * m + c, d * m + c, e * m + c, f * m + c, g * m + c
        p, q, r, s, t, u = p * m + c, q * m + c, r * m + c, s * m + c, t * m + c, u * m + c
    return a + b + d + e + f + g + p + q + r + s + t + u


def _lanes(trips: int, x: Any, m: float, c: float) -> None:
    """Four chains on each column of x (4, LANES); numba turns the loop over the columns into vectors."""
    for _ in range(trips):
        for i in range(LANES):
            a, b, d, e = x[0, i], x[1, i], x[2, i], x[3, i]
            for _ in range(DEPTH):
                a, b, d, e = a * m + c, b * m + c, d * m + c, e * m + c
            x[0, i], x[1, i], x[2, i], x[3, i] = a, b, d, e


def peaks() -> dict[str, float]:
    """Operations a second by the way they are issued; a multiply-add counts as two."""
    x = np.ones((4, LANES))
    a_trip = flops(count_operations(_numbers, 2, SHRINK, SHIFT)) - flops(
        count_operations(_numbers, 1, SHRINK, SHIFT)
    )
    a_sweep = flops(count_operations(_lanes, 1, x, SHRINK, SHIFT))
    one_by_one = partial(_rate, TRIPS, a_trip)
    in_vectors = partial(_rate, TRIPS // 100, a_sweep)
    return {
        "numbers, multiplied and added apart": one_by_one(partial(apart(_numbers), TRIPS, SHRINK, SHIFT)),
        "numbers, fused": one_by_one(partial(fused(_numbers), TRIPS, SHRINK, SHIFT)),
        "vectors, fused": in_vectors(partial(fused(_lanes), TRIPS // 100, x, SHRINK, SHIFT)),
    }


def _rate(trips: int, operations: int, call: Callable[[], object]) -> float:
    """The best of many: whatever disturbs a run makes it slower."""
    call()  # compiles
    return trips * operations / min(_seconds(call) for _ in range(ROUNDS))


def _seconds(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def report() -> None:
    """Print the table."""
    print_table(
        f"Floating-point peak of one core. Best of {ROUNDS} rounds",
        ["issued as", "10⁹ a second"],
        [[name, f"{rate / 1e9:.3g}"] for name, rate in peaks().items()],
    )
