"""From a source to answers, as long as it runs."""

import gc
import threading
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing
from itertools import islice

import numpy as np

from probedesign.estimation.detector import Detector
from probedesign.estimation.estimate import RESULTS
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.tracker import Tracker
from probedesign.frames import Array, pose
from probedesign.live.outputs.sinks import Sink
from probedesign.live.poses.base_poses import Poses
from probedesign.live.processing.blocks import Block, until
from probedesign.live.processing.chain import Chain
from probedesign.live.processing.estimates import Answer
from probedesign.live.processing.scheduler import Plan, Requests
from probedesign.live.sources.sim import bearable
from probedesign.live.sources.source import Source
from probedesign.rod.contact import solve_frictionless

Say = Callable[[str], None]


def estimate_stream(
    estimator: Estimator,
    source: Source,
    plan: Plan,
    say: Say,
    sink: Sink | None = None,
    requests: Requests | None = None,
    poses: Poses | None = None,
) -> Generator[Answer, None, None]:
    """Answers as the readings come.

    Args:
        estimator: of the probe.
        source: of the readings; closed at the end, however that comes.
        plan: what to do with them.
        say: takes each line that a user should know.
        sink: takes every reading as it was read, before averaging and tare, and every answer.
        requests: what a person asks meanwhile: a tare, a mark, the end.
        poses: of the base; closed at the end. None: it stands as the frozen probe or the source says.

    Raises:
        InputError: the tare's window is no good, or the source fails.
    """
    chain = Chain(estimator, plan, poses, say)
    try:
        with closing(iter(source)) as stream:
            blocks: Iterator[Block] = stream if plan.seconds is None else until(stream, plan.seconds)
            for answer in islice(_answers(chain, blocks, say, sink, requests), plan.count):
                if sink is not None:
                    sink.answered(answer)
                yield answer
    finally:
        chain.due.ended()
        if poses is not None:
            poses.close()


def _answers(
    chain: Chain, blocks: Iterator[Block], say: Say, sink: Sink | None, requests: Requests | None
) -> Iterator[Answer]:
    """Answers block by block, and what is asked for meanwhile."""
    for block in blocks:
        if sink is not None:
            sink.read(block)
        for answer in chain.take(block):
            yield answer
            if _asked_to_stop(chain, say, requests):
                return
        if _asked_to_stop(chain, say, requests):
            return
    yield from chain.ended()


def _asked_to_stop(chain: Chain, say: Say, requests: Requests | None) -> bool:
    """Do what is asked for; whether that is the end."""
    for request in requests.taken() if requests is not None else ():
        match request.wish:
            case "tare":
                chain.take_tare()
            case "mark":
                say(f"mark: {request.text}")
            case "stop":
                return True
            case _:
                say(f"{request.wish} is not possible here")
    return False


def count_results(answers: Iterable[str]) -> dict[str, int]:
    """How many estimates had each result, in the order of `RESULTS`, without those that none had."""
    counted = Counter(answers)
    return {result: counted[result] for result in RESULTS if counted[result]}


def describe_counts(counts: dict[str, int]) -> str:
    """The counts in one line."""
    told = ", ".join(f"{count} {result}" for result, count in counts.items())
    return f"{sum(counts.values())} estimates" + (f": {told}" if told else "")


NOTICE_DELAY = 6.0
"""Kernels that take longer than this are not read from the cache but compiled [s]."""
WARM_UP_RATE = 7000.0
WARM_UP_TOUCHES, WARM_UP_SAMPLES = 12, 8
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
        NOTICE_DELAY, say, [f"compiling {what}, once, a minute or so; nothing is read before"]
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
    for force in bearable(model.rod) * np.linspace(0.5, 1.0, WARM_UP_TOUCHES):
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
    Detector(model, WARM_UP_RATE).run(np.zeros((WARM_UP_SAMPLES, 6)))
    tracker = Tracker(estimator, gravity_world=model.gravity_base, rate=WARM_UP_RATE)
    still = pose(np.eye(3), np.zeros(3))
    steps = [(free, still), *(touch for touch in touches for _ in range(WARM_UP_SAMPLES))]
    for i, (wrench, T) in enumerate(steps):
        tracker.update(wrench, T, i / WARM_UP_RATE)
    wrenches, poses = zip(*touches[:2], strict=True)
    estimator.fuse(wrenches, poses, model.gravity_base)  # what the tracker starts anew with
