"""Time of an estimate."""

from collections.abc import Callable
from functools import partial
from itertools import count

import numpy as np

from benchmarks.cases import GRAVITY, TABLE_I
from benchmarks.timing import format_seconds, interleaved, print_table
from benchmarks.touches import paper_models, presses, touch
from probedesign.core.frames import Array
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.tracker import Tracker

ROUNDS = 9


def report() -> None:
    """Print the table."""
    model = paper_models()["large"]
    estimator = Estimator(model)
    calls: dict[str, Callable[[], object]] = {
        "free probe": partial(estimator.estimate, estimator.free(GRAVITY).wrench_base, GRAVITY)
    }
    for force, fraction in TABLE_I:
        one = touch(model, GRAVITY, fraction * model.rod.length, np.pi / 2, force)
        assert one is not None, "the large probe has an equilibrium under these touches of the paper"
        name, wrench = f"{force:g} N at {fraction:g} L", one.wrench
        near = estimator.estimate(wrench, GRAVITY)
        calls[f"{name}, ml, cold"] = partial(estimator.estimate, wrench, GRAVITY)
        calls[f"{name}, ml, from a neighbour"] = partial(estimator.estimate, 1.0001 * wrench, GRAVITY, near=near)
        calls[f"{name}, force–moment"] = partial(estimator.estimate, wrench, GRAVITY, method="force_moment")
    pressed = presses(model, GRAVITY, 0.7 * model.rod.length, np.pi / 2, np.linspace(2e-3, 1e-2, 5))
    assert pressed is not None, "the large probe has an equilibrium under a light press"
    calls["fuse, five touches"] = partial(estimator.fuse, pressed.wrenches, pressed.Ts, GRAVITY)
    calls["tracker, one more reading after five touches"] = _tracking(estimator, pressed.wrenches, pressed.Ts)
    seconds = interleaved(calls, ROUNDS)
    print_table(
        f"Time of one call from Python, large probe. Median of {ROUNDS} interleaved rounds",
        ["call", "time", "calls per second"],
        [[name, format_seconds(t), f"{1.0 / t:.0f}"] for name, t in seconds.items()],
    )


def _tracking(estimator: Estimator, wrenches: Array, Ts: Array) -> Callable[[], object]:
    """Return a call that updates a tracker after five touches."""
    tracker, ticks = Tracker(estimator, gravity_world=GRAVITY), count(1)
    for wrench, T in zip(wrenches, Ts, strict=True):
        for _ in range(36):
            tracker.update(wrench, T, next(ticks) / 7000.0)
    return lambda: tracker.update(wrenches[-1], Ts[-1], next(ticks) / 7000.0)
