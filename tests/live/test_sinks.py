"""What feeds recorder, view, publisher and terminal: all of them, whatever becomes of one."""

import pytest

from probedesign.live.outputs.sinks import Sinks
from probedesign.live.processing.scheduler import Plan, Requests
from probedesign.live.run import estimate_stream
from probedesign.live.sources.sim import Simulation


class Kept:
    def __init__(self):
        self.blocks, self.answers, self.lines, self.closed = [], [], [], 0

    def read(self, block):
        self.blocks.append(block)

    def answered(self, answer):
        self.answers.append(answer)

    def told(self, time, line):
        self.lines.append((time, line))

    def close(self):
        self.closed += 1


class Broken(Kept):
    def __init__(self, call):
        super().__init__()
        setattr(self, call, self.fail)

    def fail(self, *arguments):
        raise OSError(28, "No space left on device")


def test_every_sink_sees_every_reading_and_answer(estimator):
    kept, plan = Kept(), Plan(samples=2)
    answers = list(
        estimate_stream(estimator, Simulation(estimator.model, "speed=max&rate_hz=2"), plan, print, kept)
    )
    assert sum(map(len, kept.blocks)) == 40
    assert kept.answers == answers and len(answers) == 20
    assert not kept.closed  # who opens it closes it


@pytest.mark.parametrize("call", ["read", "answered", "told", "close"])
def test_a_sink_that_fails_is_dropped_with_one_line_and_the_others_go_on(estimator, call):
    kept, broken = Kept(), Broken(call)
    sinks = Sinks(kept, broken)
    stream = Simulation(estimator.model, "speed=max&rate_hz=2&seconds=5")
    answers = list(estimate_stream(estimator, stream, Plan(), sinks.say, sinks))
    sinks.say("the end")
    sinks.close()
    assert kept.answers == answers and len(answers) == 10
    assert kept.closed == 1
    failures = [line for _, line in kept.lines if "Broken" in line]
    assert len(failures) == 1 and "No space left on device" in failures[0]


def test_what_is_said_has_the_time_of_the_last_reading(estimator):
    kept = Kept()
    sinks = Sinks(kept)
    list(estimate_stream(estimator, Simulation(estimator.model, "speed=max&seconds=1"), Plan(), print, sinks))
    sinks.say("now")
    assert kept.lines == [(pytest.approx(0.98), "now")]  # the last of 50 readings a second


def test_requests_are_taken_between_two_readings(estimator):
    requests, said, done = Requests(), [], []
    requests.does("start recording", done.append)
    answers = estimate_stream(
        estimator, Simulation(estimator.model, "speed=max"), Plan(), said.append, None, requests
    )
    next(answers)
    requests.ask("mark", "here")
    requests.ask("start recording")
    next(answers)
    assert said == ["mark: here"] and [request.wish for request in done] == ["start recording"]
    requests.ask("stop")
    assert list(answers) == []
