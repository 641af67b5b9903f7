"""The rod: beside the other ways, inside the kernel, in batches, in lanes; at last what was promised of it."""

from collections.abc import Sequence

from benchmarks import batch, compare, inside
from benchmarks.batch import Batch
from benchmarks.cases import bare_large, paper_loads
from benchmarks.inside import COLD, JACOBIAN, TOGETHER, Work
from benchmarks.peak import peaks
from benchmarks.timing import digits, print_table, shown
from probedesign.rod.kernels.steps import WIDE

Compared = Sequence[dict[str, compare.Found | None]]

COLD_AT_MOST, WARM_AT_MOST, CALL_AT_MOST = 30e-6, 12e-6, 60e-6
"""[s]."""
BATCH_AT_LEAST, LANES_AT_LEAST = 100_000.0, 400_000.0
"""Solutions a second on two cores; what lanes should lead to."""


def report() -> None:
    """Measure everything and print it."""
    rod = bare_large()
    compared = compare.compared(rod)
    compare.print_compared(compared)
    calls = compare.calls_from_python(rod)
    compare.print_calls(calls)
    peak, load = peaks(), paper_loads(rod)[1]
    work, each = inside.measure(rod, paper_loads(rod)), inside.parts(rod, load)
    inside.print_times(work, max(peak.values()))
    for name in (COLD, JACOBIAN):
        inside.print_parts(work[name][1], each, peak, name)
    batches = batch.report()
    print_lanes(batches, work)
    print_targets([
        *of_one(compared, work, calls[compare.CALLS[0]]),
        *of_batches(batches),
        *of_floor(work, max(peak.values())),
    ])  # fmt: skip


def print_lanes(batches: dict[str, Batch], work: dict[str, list[Work]]) -> None:
    """What lanes brought, and what stands in the way of more."""
    gains = [alone.seconds / beside.seconds for alone, beside in zip(work[COLD], work[TOGETHER], strict=True)]
    print(
        f"  lanes: {WIDE} like cases side by side × {digits(min(gains))} or more, unlike ones "
        + ", ".join(f"× {digits(batch.gain)} ({name})" for name, batch in batches.items())
        + "\n  in the way of more: a core has so many units for whole registers, and the steps keep them busy; "
        "stops, Newton's matrix and the path go lane by lane"
    )


def of_one(compared: Compared, work: dict[str, list[Work]], call: float) -> list[list[str]]:
    """The targets of one equilibrium."""
    cold, warm = (max(w.seconds for w in work[name]) for name in (COLD, JACOBIAN))
    rows = [at_most("one equilibrium, cold, inside the kernel", cold, COLD_AT_MOST)]
    for start, least in compare.TARGETS.items():
        name = compare.closest(start, compared)
        if name:
            ratio = min(compare.ratios(name, compared, compare.INSIDE))
            verdict = _verdict(ratio >= least)
            rows.append([f"over the same: {name}", f"× {digits(ratio)}", f"≥ {least:g} ×", verdict])
    return [
        *rows,
        at_most("from a neighbouring load with the Jacobian by force and s_contact", warm, WARM_AT_MOST),
        at_most("one call from Python, cold", call, CALL_AT_MOST),
    ]


def of_batches(batches: dict[str, Batch]) -> list[list[str]]:
    """The targets of many cases."""
    rows = []
    for name, found in batches.items():
        threads = max(found.rates)
        rate = found.rates[threads]
        rows.append([f"{name}: solutions a second on {threads} threads", f"{rate:,.0f}", f"≥ {BATCH_AT_LEAST:,.0f}",
                     _verdict(rate >= BATCH_AT_LEAST)])  # fmt: skip
    best = max(max(found.rates.values()) for found in batches.values())
    rows.append([f"lanes towards {LANES_AT_LEAST:,.0f}", f"{best:,.0f}", "tried and reported", "tried"])
    return rows


def of_floor(work: dict[str, list[Work]], peak: float) -> list[list[str]]:
    """How much of the floating-point floor is reached."""
    shares = [w.operations / w.seconds / peak for w in work[COLD]]
    return [
        ["share of the floating-point peak, cold", f"{min(shares):.0%}", "where the rest goes", "see above"]
    ]


def at_most(name: str, seconds: float, most: float) -> list[str]:
    """A line of a time that is to be short, the slowest of the loads."""
    return [name, shown(seconds), f"≤ {shown(most)}", _verdict(seconds <= most)]


def _verdict(reached: bool) -> str:
    return "reached" if reached else "missed"


def print_targets(rows: Sequence[Sequence[str]]) -> None:
    """Print what was promised and what is."""
    print_table(
        "What was promised, under the least favourable of the loads; peers by their row whose error comes closest "
        "to ours and is not below it",
        ["", "measured", "target", ""],
        rows,
    )
