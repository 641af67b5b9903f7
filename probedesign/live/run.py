"""From a source to answers, as long as it runs."""

from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing
from itertools import islice

from probedesign.estimation.estimate import RESULTS
from probedesign.estimation.estimator import Estimator
from probedesign.live.answer import Answer
from probedesign.live.block import Block
from probedesign.live.chain import Chain
from probedesign.live.flow import until
from probedesign.live.locate import locate as locate
from probedesign.live.plan import Plan as Plan
from probedesign.live.pose.poses import Poses
from probedesign.live.requests import Requests
from probedesign.live.sink import Sink
from probedesign.live.source import Source

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
