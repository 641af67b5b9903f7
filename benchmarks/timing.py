"""Timing, and the one table that every part of the benchmark prints."""

import os
import platform
import statistics
import time
from collections.abc import Callable, Mapping, Sequence

import numba
import numpy
import scipy


def interleaved(
    calls: Mapping[str, Callable[[], object]], rounds: int, at_least_s: float = 2e-3, at_most_s: float = 2.0
) -> dict[str, float]:
    """Median seconds of each call over so many rounds; each round runs all of them, so drift hits all alike.

    A call much shorter than `at_least_s` is repeated within its round until that time is filled. One that would
    take more than `at_most_s` over all rounds sits out the last of them, but never the first three.
    """
    repeats, turns = {}, {}
    for name, call in calls.items():  # also warms up: compilation and caches
        call()
        once = _seconds(call, 1)
        repeats[name] = max(1, round(at_least_s / once))
        turns[name] = min(rounds, max(3, int(at_most_s / once)))
    times: dict[str, list[float]] = {name: [] for name in calls}
    for turn in range(rounds):
        for name, call in calls.items():
            if turn < turns[name]:
                times[name].append(_seconds(call, repeats[name]))
    return {name: statistics.median(found) for name, found in times.items()}


def _seconds(call: Callable[[], object], repeats: int) -> float:
    start = time.perf_counter()
    for _ in range(repeats):
        call()
    return (time.perf_counter() - start) / repeats


def shown(seconds: float) -> str:
    """A time with three digits and a fitting unit."""
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds / 1e-6:.3g} µs"


def digits(value: float) -> str:
    """Two of them, without an exponent."""
    return f"{float(f'{value:.2g}'):g}"


def spread(values: Sequence[float], show: Callable[[float], str]) -> str:
    """From the least to the most."""
    low, high = show(min(values)), show(max(values))
    return low if low == high else f"{low} – {high}"


def print_table(title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Left column to the left, the others to the right."""
    widths = [max(len(row[i]) for row in [head, *rows]) for i in range(len(head))]
    print(f"\n{title}")
    for row in [head, ["-" * w for w in widths], *rows]:
        first, *rest = (
            cell.ljust(w) if i == 0 else cell.rjust(w)
            for i, (cell, w) in enumerate(zip(row, widths, strict=True))
        )
        print("  " + "  ".join([first, *rest]))


def print_machine() -> None:
    """What the numbers were taken with."""
    print(f"{os.cpu_count()} CPUs, {platform.system()} {platform.machine()}, Python {platform.python_version()}, "
          f"numpy {numpy.__version__}, scipy {scipy.__version__}, numba {numba.__version__}")  # fmt: skip
