"""Peak rate of floating-point operations of one core, measured."""

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numba import njit

from benchmarks.flop_count import count_operations, flops
from benchmarks.timing import print_table

ROUNDS = 15
TRIPS = 20_000
LANES = 256
"""Columns of the array of the vectorised kernel; its four rows fit the first-level cache."""
DEPTH = 8
"""Multiply-adds of each number between its load and its store."""
SHRINK, SHIFT = 0.999, 1e-3
"""x ← x · SHRINK + SHIFT stays near 1, far from infinity and from subnormal numbers, which are slow."""

fused = njit(fastmath={"contract"})
"""Compile multiplication and addition to one fused instruction."""
separate = njit
"""Compile with separate rounding, as the rod is compiled."""


def _scalar_chains(trips: int, m: float, c: float) -> float:
    """Run twelve chains of x ← x m + c, which hide the latency and fit the registers."""
    a, b, d, e, f, g = 0.1, 0.2, 0.3, 0.4, 0.5, 0.6
    p, q, r, s, t, u = 0.7, 0.8, 0.9, 1.0, 1.1, 1.2
    for _ in range(trips):
        a, b, d, e, f, g = a * m + c, b * m + c, d * m + c, e * m + c, f * m + c, g * m + c
        p, q, r, s, t, u = p * m + c, q * m + c, r * m + c, s * m + c, t * m + c, u * m + c
    return a + b + d + e + f + g + p + q + r + s + t + u


def _vector_chains(trips: int, x: Any, m: float, c: float) -> None:
    """Run four chains in each column of x, (4, LANES); numba vectorises the loop over the columns."""
    for _ in range(trips):
        for i in range(LANES):
            a, b, d, e = x[0, i], x[1, i], x[2, i], x[3, i]
            for _ in range(DEPTH):
                a, b, d, e = a * m + c, b * m + c, d * m + c, e * m + c
            x[0, i], x[1, i], x[2, i], x[3, i] = a, b, d, e


def peaks() -> dict[str, float]:
    """Return the operation rates [1/s] by kind of instruction; a multiply-add counts as two operations."""
    x = np.ones((4, LANES))
    per_trip = flops(count_operations(_scalar_chains, 2, SHRINK, SHIFT)) - flops(
        count_operations(_scalar_chains, 1, SHRINK, SHIFT)
    )
    per_sweep = flops(count_operations(_vector_chains, 1, x, SHRINK, SHIFT))
    scalar_rate = partial(_rate, TRIPS, per_trip)
    vector_rate = partial(_rate, TRIPS // 100, per_sweep)
    return {
        "scalar, separate multiply and add": scalar_rate(partial(separate(_scalar_chains), TRIPS, SHRINK, SHIFT)),
        "scalar, fused multiply-add": scalar_rate(partial(fused(_scalar_chains), TRIPS, SHRINK, SHIFT)),
        "SIMD, fused multiply-add": vector_rate(partial(fused(_vector_chains), TRIPS // 100, x, SHRINK, SHIFT)),
    }


def _rate(trips: int, operations: int, call: Callable[[], object]) -> float:
    """Return the highest rate of several runs, because disturbances only slow a run down."""
    call()  # compiles
    return trips * operations / min(_seconds(call) for _ in range(ROUNDS))


def _seconds(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def report() -> None:
    """Print the peak rates."""
    print_table(
        f"Floating-point peak of one core. Best of {ROUNDS} rounds",
        ["instructions", "Gflop/s"],
        [[name, f"{rate / 1e9:.3g}"] for name, rate in peaks().items()],
    )
