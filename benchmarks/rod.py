"""Speed of the rod against other solvers, in its kernel, in batches and in SIMD lanes, with its targets."""

from collections.abc import Sequence

from benchmarks import batch_solves, kernel_profile, solver_comparison
from benchmarks.batch_solves import Batch
from benchmarks.cases import bare_large, paper_loads
from benchmarks.kernel_profile import COLD, IN_LANES, JACOBIAN, Work
from benchmarks.peak import peaks
from benchmarks.solver_comparison import Measurement
from benchmarks.timing import format_seconds, print_table, two_digits
from probedesign.rod.kernels.steps import WIDE

Comparison = Sequence[dict[str, Measurement | None]]

MAX_COLD, MAX_WARM, MAX_CALL = 30e-6, 20e-6, 60e-6
"""Targets of the time of a cold solve, a warm solve and a call from Python [s]."""
MIN_BATCH_RATE, LANES_GOAL = 100_000.0, 400_000.0
"""Target of the solutions per second on two cores, and long-term goal of SIMD lanes."""


def report() -> None:
    """Run and print all measurements of the rod."""
    rod = bare_large()
    comparison = solver_comparison.compare(rod)
    solver_comparison.print_comparison(comparison)
    calls = solver_comparison.calls_from_python(rod)
    solver_comparison.print_calls(calls)
    peak, load = peaks(), paper_loads(rod)[1]
    work, parts = kernel_profile.measure(rod, paper_loads(rod)), kernel_profile.parts(rod, load)
    kernel_profile.print_times(work, max(peak.values()))
    for name in (COLD, JACOBIAN):
        kernel_profile.print_parts(work[name][1], parts, peak, name)
    batches = batch_solves.report()
    print_lanes(batches, work)
    print_targets([
        *single_targets(comparison, work, calls[solver_comparison.CALLS[0]]),
        *batch_targets(batches),
        *peak_share(work, max(peak.values())),
    ])  # fmt: skip


def print_lanes(batches: dict[str, Batch], work: dict[str, list[Work]]) -> None:
    """Print the speed-up by SIMD lanes and what limits it."""
    gains = [one.seconds / in_lanes.seconds for one, in_lanes in zip(work[COLD], work[IN_LANES], strict=True)]
    print(
        f"  speed-up by {WIDE} SIMD lanes: equal cases × {two_digits(min(gains))} or more, different cases "
        + ", ".join(f"× {two_digits(batch.gain)} ({name})" for name, batch in batches.items())
        + "\n  limits: the steps keep the SIMD units of a core busy; "
        "stops, Newton's matrix and the path are computed lane by lane"
    )


def single_targets(comparison: Comparison, work: dict[str, list[Work]], call: float) -> list[list[str]]:
    """Return the targets of one equilibrium."""
    cold, warm = (max(w.seconds for w in work[name]) for name in (COLD, JACOBIAN))
    rows = [upper_target("one equilibrium, cold, kernel time", cold, MAX_COLD)]
    for start, target in solver_comparison.TARGETS.items():
        name = solver_comparison.most_accurate(start, comparison)
        if name:
            ratio = min(solver_comparison.ratios(name, comparison, solver_comparison.KERNEL))
            verdict = _verdict(ratio >= target)
            rows.append([f"time of {name} over it", two_digits(ratio), f"≥ {target:g}", verdict])
    return [
        *rows,
        upper_target("from a neighbouring load with the Jacobian by force and s_contact", warm, MAX_WARM),
        upper_target("one call from Python, cold", call, MAX_CALL),
    ]


def batch_targets(batches: dict[str, Batch]) -> list[list[str]]:
    """Return the targets of batches."""
    rows = []
    for name, found in batches.items():
        threads = max(found.rates)
        rate = found.rates[threads]
        rows.append([f"{name}: solutions per second on {threads} threads", f"{rate:,.0f}", f"≥ {MIN_BATCH_RATE:,.0f}",
                     _verdict(rate >= MIN_BATCH_RATE)])  # fmt: skip
    best = max(max(found.rates.values()) for found in batches.values())
    rows.append(["solutions per second with SIMD lanes", f"{best:,.0f}", f"goal {LANES_GOAL:,.0f}", "reported"])
    return rows


def peak_share(work: dict[str, list[Work]], peak: float) -> list[list[str]]:
    """Return the share of the floating-point peak."""
    shares = [w.operations / w.seconds / peak for w in work[COLD]]
    return [["share of the floating-point peak, cold", f"{min(shares):.0%}", "-", "reported"]]


def upper_target(name: str, seconds: float, target: float) -> list[str]:
    """Return the row of a time with its upper target."""
    return [name, format_seconds(seconds), f"≤ {format_seconds(target)}", _verdict(seconds <= target)]


def _verdict(reached: bool) -> str:
    return "reached" if reached else "missed"


def print_targets(rows: Sequence[Sequence[str]]) -> None:
    """Print measured values and targets."""
    print_table(
        "Targets, for the least favourable of the loads; of each other solver the variant with the smallest error that "
        "is not below the error of Rod.solve",
        ["", "measured", "target", ""],
        rows,
    )
