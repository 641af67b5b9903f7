"""Runs the processing chain on a source, and compiles all kernels beforehand."""

import gc
import threading
from collections import Counter
from collections.abc import Generator, Iterable, Iterator
from contextlib import closing
from itertools import islice

import numpy as np

from probedesign.core.frames import Array, pose
from probedesign.estimation.detector import Detector
from probedesign.estimation.estimate import RESULTS
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.tracker import Tracker
from probedesign.live import Log
from probedesign.live.outputs.sinks import Sink
from probedesign.live.poses.base_poses import BasePoses
from probedesign.live.processing.blocks import Block, limit_duration
from probedesign.live.processing.chain import Chain
from probedesign.live.processing.estimates import EstimateUpdate
from probedesign.live.processing.scheduler import CommandQueue, ProcessingOptions
from probedesign.live.sources.source import Source
from probedesign.rod.contact import solve_frictionless
from probedesign.simulation.rod_and_sensor import safe_force


def estimate_stream(
    estimator: Estimator,
    source: Source,
    options: ProcessingOptions,
    log: Log,
    sink: Sink | None = None,
    commands: CommandQueue | None = None,
    poses: BasePoses | None = None,
) -> Generator[EstimateUpdate, None, None]:
    """Yield estimates as readings arrive.

    Args:
        estimator: estimator of the probe.
        source: source of the readings; closed at the end in any case.
        options: processing options.
        log: callback for messages to the user.
        sink: receives every raw reading, before averaging and tare, and every estimate.
        commands: commands from the user: a tare, a mark, the end.
        poses: poses of the base; closed at the end. None: it is fixed as the frozen probe or the source states.

    Raises:
        InputError: the tare window cannot be used, or the source fails.
    """
    chain = Chain(estimator, options, poses, log)
    try:
        with closing(iter(source)) as stream:
            blocks: Iterator[Block] = (
                stream if options.seconds is None else limit_duration(stream, options.seconds)
            )
            for update in islice(_updates(chain, blocks, log, sink, commands), options.count):
                if sink is not None:
                    sink.on_estimate(update)
                yield update
    finally:
        chain.scheduler.finish()
        if poses is not None:
            poses.close()


def _updates(
    chain: Chain, blocks: Iterator[Block], log: Log, sink: Sink | None, commands: CommandQueue | None
) -> Iterator[EstimateUpdate]:
    """Yield estimates block by block and execute commands in between."""
    for block in blocks:
        if sink is not None:
            sink.on_samples(block)
        for update in chain.process(block):
            yield update
            if _run_commands(chain, log, commands):
                return
        if _run_commands(chain, log, commands):
            return
    yield from chain.finish()


def _run_commands(chain: Chain, log: Log, commands: CommandQueue | None) -> bool:
    """Execute the queued commands; return whether to stop."""
    for command in commands.pop_all() if commands is not None else ():
        match command.name:
            case "tare":
                chain.take_tare()
            case "mark":
                log(f"mark: {command.text}")
            case "stop":
                return True
            case _:
                log(f"{command.name} is not available here")
    return False


def count_results(results: Iterable[str]) -> dict[str, int]:
    """Return the number of estimates with each result, in the order of `RESULTS`, without zeros."""
    counted = Counter(results)
    return {result: counted[result] for result in RESULTS if counted[result]}


def describe_counts(counts: dict[str, int]) -> str:
    """Return the counts as one line."""
    text = ", ".join(f"{count} {result}" for result, count in counts.items())
    return f"{sum(counts.values())} estimates" + (f": {text}" if text else "")


NOTICE_DELAY = 6.0
"""Time after which the user is informed [s]: kernels that take longer are compiled, not loaded from the cache."""
WARM_UP_RATE = 7000.0
WARM_UP_TOUCHES, WARM_UP_SAMPLES = 12, 8
"""More touches than the tracker has keyframes, so that it merges some; more samples than it linearizes in turn."""


def warm_up(estimator: Estimator, log: Log, *, fusing: bool = False) -> None:
    """Compute one estimate so that every kernel is compiled, and report it if that takes long.

    Args:
        estimator: estimator of the probe.
        log: callback for the message.
        fusing: include detector and tracker.
    """
    kernels = "rod, estimator, detector and tracker" if fusing else "rod and estimator"
    notice = threading.Timer(
        NOTICE_DELAY, log, [f"compiling {kernels}; this takes about a minute once, reading starts afterwards"]
    )
    notice.daemon = True
    notice.start()
    try:
        touches = _warm_up_touches(estimator)
        for wrench, _ in touches[-1:]:
            estimate = estimator.estimate(wrench)
            _ = estimator.estimate(wrench, near=estimate).shape
        if fusing:
            _warm_up_fusion(estimator, touches)
    finally:
        notice.cancel()
    gc.collect()
    gc.freeze()  # exclude existing objects: a collection that visits them takes 0.1 s


def _warm_up_touches(estimator: Estimator) -> list[tuple[Array, Array]]:
    """Return wrench and base pose of touches of the world origin, with increasing force."""
    model = estimator.model
    s, found = 0.7 * model.rod.length, []
    for force in safe_force(model.rod) * np.linspace(0.5, 1.0, WARM_UP_TOUCHES):
        touch = solve_frictionless(model.rod, model.gravity_base, s, 0.5, float(force))
        if touch.result == "ok":
            eq = touch.equilibrium
            _ = eq.R_at(s)  # a simulated source uses this kernel
            found.append((eq.wrench_base, pose(np.eye(3), -eq.p_contact_base)))
    return found


def _warm_up_fusion(estimator: Estimator, touches: list[tuple[Array, Array]]) -> None:
    """Track the touches sample by sample."""
    model = estimator.model
    free = estimator.free(model.gravity_base).wrench_base
    Detector(model, WARM_UP_RATE).run(np.zeros((WARM_UP_SAMPLES, 6)))
    tracker = Tracker(estimator, gravity_world=model.gravity_base, rate=WARM_UP_RATE)
    still = pose(np.eye(3), np.zeros(3))
    steps = [(free, still), *(touch for touch in touches for _ in range(WARM_UP_SAMPLES))]
    for i, (wrench, T) in enumerate(steps):
        tracker.update(wrench, T, i / WARM_UP_RATE)
    wrenches, poses = zip(*touches[:2], strict=True)
    estimator.fuse(wrenches, poses, model.gravity_base)  # the tracker restarts with this
