"""One contact from one reading."""

from functools import partial

import numpy as np

from benchmarks.cases import GRAVITY, LARGE, TABLE_I
from benchmarks.timing import interleaved, print_table, shown
from probedesign.design import load_design
from probedesign.probe import build_probe

ROUNDS = 9


def report() -> None:
    """Print the table."""
    probe = build_probe(load_design(LARGE))
    estimator = probe.estimator()
    wrenches = {"free probe": probe.solve(GRAVITY).wrench_base}
    for force, fraction in TABLE_I:
        touched = probe.solve(GRAVITY, fraction * probe.length, (0.0, force, 0.0))
        wrenches[f"{force:g} N at {fraction:g} L"] = touched.wrench_base
    calls = {
        name: partial(estimator.estimate, wrench, np.array(GRAVITY)) for name, wrench in wrenches.items()
    }
    seconds = interleaved(calls, ROUNDS)
    print_table(
        f"Estimator.estimate, large probe. Median of {ROUNDS} interleaved rounds",
        ["reading", "result", "time", "a second"],
        [[name, calls[name]().result, shown(t), f"{1.0 / t:.0f}"] for name, t in seconds.items()],
    )
