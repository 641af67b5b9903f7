"""Timing of calls, number formats and table output for all benchmarks."""

import os
import platform
import statistics
import time
from collections.abc import Callable, Mapping, Sequence

import numba
import numpy
import scipy

from probedesign.cli.console import print_columns


def interleaved(
    calls: Mapping[str, Callable[[], object]], rounds: int, min_round_s: float = 2e-3, max_total_s: float = 2.0
) -> dict[str, float]:
    """Return the median time of each call [s] over interleaved rounds.

    Each round runs all calls, so that changes of the machine's speed affect all of them alike.

    Args:
        calls: functions to time, by name.
        rounds: number of rounds.
        min_round_s: a shorter call is repeated within its round until this time is filled [s].
        max_total_s: a call that would exceed this time over all rounds takes part in fewer rounds, at least 3 [s].
    """
    repeats, call_rounds = {}, {}
    for name, call in calls.items():  # this call also compiles and fills caches
        call()
        once = _seconds(call, 1)
        repeats[name] = max(1, round(min_round_s / once))
        call_rounds[name] = min(rounds, max(3, int(max_total_s / once)))
    times: dict[str, list[float]] = {name: [] for name in calls}
    for i in range(rounds):
        for name, call in calls.items():
            if i < call_rounds[name]:
                times[name].append(_seconds(call, repeats[name]))
    return {name: statistics.median(found) for name, found in times.items()}


def _seconds(call: Callable[[], object], repeats: int) -> float:
    start = time.perf_counter()
    for _ in range(repeats):
        call()
    return (time.perf_counter() - start) / repeats


def format_seconds(seconds: float) -> str:
    """Return a time with three digits and a suitable unit."""
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds / 1e-6:.3g} µs"


def two_digits(value: float) -> str:
    """Return a number with two significant digits and without an exponent."""
    return f"{float(f'{value:.2g}'):g}"


def value_range(values: Sequence[float], form: Callable[[float], str]) -> str:
    """Return the range of values as text."""
    low, high = form(min(values)), form(max(values))
    return low if low == high else f"{low} – {high}"


def print_table(title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table with numbers to the right and words to the left."""
    print(f"\n{title}")
    print_columns(head, rows)


def print_machine() -> None:
    """Print the machine and the versions of the numerical libraries."""
    print(
        f"{os.cpu_count()} CPUs, {platform.system()} {platform.machine()}, Python {platform.python_version()}, "
        f"numpy {numpy.__version__}, scipy {scipy.__version__}, numba {numba.__version__}"
    )
