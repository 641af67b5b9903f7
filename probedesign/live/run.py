"""From a source to answers, as long as it runs."""

from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing
from itertools import islice

from probedesign.estimator.estimate import RESULTS
from probedesign.estimator.estimator import Estimator
from probedesign.live.answer import Answer
from probedesign.live.block import Block
from probedesign.live.chain import Chain
from probedesign.live.flow import recorded, until
from probedesign.live.locate import locate as locate
from probedesign.live.plan import Plan as Plan
from probedesign.live.pose.poses import Poses
from probedesign.live.recorder import Recorder
from probedesign.live.requests import Request, Requests
from probedesign.live.sink import Sink
from probedesign.live.source import Source
from probedesign.live.watch import Tell

Say = Callable[[str], None]
Asked = Callable[[Request], None]


def estimate_stream(
    estimator: Estimator,
    source: Source,
    plan: Plan,
    say: Say,
    recorder: Recorder | None = None,
    *,
    sinks: Sequence[Sink] = (),
    requests: Requests | None = None,
    poses: Poses | None = None,
    other: Callable[[Request], None] = lambda request: None,
) -> Generator[Answer, None, None]:
    """Answers as the readings come.

    Args:
        estimator: of the probe.
        source: of the readings; closed at the end, however that comes.
        plan: what to do with them.
        say: takes each line that a user should know.
        recorder: takes every reading as it was read, before averaging and tare.
        sinks: are given blocks, answers and events; closed at the end.
        requests: looked at between two blocks: a tare, a mark, the end.
        poses: of the base; closed at the end. None: it stands as the frozen probe or the source says.
        other: takes the requests that are not for this loop.

    Raises:
        InputError: the tare's window is no good, or the source fails.
    """

    def tell(time: float, line: str) -> None:
        say(line)
        for sink in sinks:
            sink.told(time, line)

    with closing(iter(source)) as stream, ExitStack() as closed:
        for sink in sinks:
            closed.callback(sink.close)
        if poses is not None:
            closed.callback(poses.close)
        blocks: Iterator[Block] = stream if plan.seconds is None else until(stream, plan.seconds)
        if recorder is not None:
            blocks = recorded(blocks, recorder)
        chain = Chain(estimator, plan, poses, tell)
        answers = _answers(chain, blocks, sinks, requests or Requests(), tell, other)
        for answer in islice(answers, plan.count):
            for sink in sinks:
                sink.answered(answer)
            yield answer


def _answers(
    chain: Chain, blocks: Iterator[Block], sinks: Sequence[Sink], requests: Requests, tell: Tell, other: Asked
) -> Iterator[Answer]:
    """Answers block by block, and what is asked for between two."""
    for block in blocks:
        for sink in sinks:
            sink.read(block)
        yield from chain.take(block)
        for request in requests.taken():
            match request.wish:
                case "tare":
                    chain.take_tare()
                case "mark":
                    tell(float(block.time[-1]), f"mark: {request.text}" if request.text else "mark")
                case "stop":
                    return
                case _:
                    other(request)
    yield from chain.ended()


def count_results(answers: Iterable[str]) -> dict[str, int]:
    """How many estimates had each result, in the order of `RESULTS`, without those that none had."""
    counted = Counter(answers)
    return {result: counted[result] for result in RESULTS if counted[result]}


def describe_counts(counts: dict[str, int]) -> str:
    """The counts in one line."""
    told = ", ".join(f"{count} {result}" for result, count in counts.items())
    return f"{sum(counts.values())} estimates" + (f": {told}" if told else "")
