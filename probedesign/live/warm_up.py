"""Compiling, or loading from the cache, all that an answer needs, before a sensor waits for it."""

import gc
import threading
from collections.abc import Callable

import numpy as np

from probedesign.estimation.detector import Detector
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.tracker import Tracker
from probedesign.frames import Array, pose
from probedesign.live.simulate import bearable
from probedesign.rod.contact import solve_frictionless

PATIENCE = 6.0
"""Kernels that take longer than this are not read from the cache but compiled [s]."""
RATE = 7000.0
TOUCHES, SAMPLES = 12, 8
"""More touches than the tracker keeps nodes, so that it joins some; more samples than it linearises in turn."""


def warm_up(estimator: Estimator, say: Callable[[str], None], *, fusing: bool = False) -> None:
    """Answer once, so that every kernel is there, and say so if that takes long.

    Args:
        estimator: of the probe.
        say: takes the notice.
        fusing: the detector and the tracker too.
    """
    what = "rod, estimator, detector and tracker" if fusing else "rod and estimator"
    notice = threading.Timer(
        PATIENCE, say, [f"compiling {what}, once, a minute or so; nothing is read before"]
    )
    notice.daemon = True
    notice.start()
    try:
        touches = _touches(estimator)
        for wrench, _ in touches[-1:]:
            estimate = estimator.estimate(wrench)
            _ = estimator.estimate(wrench, near=estimate).shape
        if fusing:
            _fuse(estimator, touches)
    finally:
        notice.cancel()
    gc.collect()
    gc.freeze()  # all that has been made so far stays: a collection that walks through it takes a tenth of a second


def _touches(estimator: Estimator) -> list[tuple[Array, Array]]:
    """Wrench and pose of the base of touches of the world's origin, harder and harder."""
    model = estimator.model
    s, found = 0.7 * model.rod.length, []
    for force in bearable(model.rod) * np.linspace(0.5, 1.0, TOUCHES):
        touch = solve_frictionless(model.rod, model.gravity_base, s, 0.5, float(force))
        if touch.result == "ok":
            eq = touch.equilibrium
            _ = eq.R_at(s)  # what a simulated source needs
            found.append((eq.wrench_base, pose(np.eye(3), -eq.p_contact_base)))
    return found


def _fuse(estimator: Estimator, touches: list[tuple[Array, Array]]) -> None:
    """Follow the touches as samples come."""
    model = estimator.model
    free = estimator.free(model.gravity_base).wrench_base
    Detector(model, RATE).run(np.zeros((SAMPLES, 6)))
    tracker = Tracker(estimator, gravity_world=model.gravity_base, rate=RATE)
    still = pose(np.eye(3), np.zeros(3))
    steps = [(free, still), *(touch for touch in touches for _ in range(SAMPLES))]
    for i, (wrench, T) in enumerate(steps):
        tracker.update(wrench, T, i / RATE)
    wrenches, poses = zip(*touches[:2], strict=True)
    estimator.fuse(wrenches, poses, model.gravity_base)  # what the tracker starts anew with
