"""Sinks: each receives everything, also after another has failed; datagrams need no receiver."""

import configparser
import json
import socket
import subprocess
import sys
from datetime import datetime
from pathlib import Path

import pytest

from probedesign.cli.main import build_app, run
from probedesign.core.errors import InputError
from probedesign.live.blocks import WrenchReading
from probedesign.live.outputs.sinks import SinkGroup, StderrSink, UdpPublisher
from probedesign.live.processing.chain import ProcessingOptions
from probedesign.live.processing.estimates import COLUMNS, EstimateUpdate
from probedesign.live.run import estimate_stream
from probedesign.live.sources.sim import SimulatedSource


class Kept:
    def __init__(self):
        self.blocks, self.answers, self.lines, self.closed = [], [], [], 0

    def on_samples(self, block):
        self.blocks.append(block)

    def on_estimate(self, answer):
        self.answers.append(answer)

    def on_event(self, time, line):
        self.lines.append((time, line))

    def close(self):
        self.closed += 1


class Broken(Kept):
    def __init__(self, call):
        super().__init__()
        setattr(self, call, self.fail)

    def fail(self, *arguments):
        raise OSError(28, "No space left on device")


def test_every_sink_sees_every_reading_and_answer_and_messages_have_the_time_of_the_last_reading(estimator):
    kept, plan = Kept(), ProcessingOptions(samples=2)
    sinks, source = SinkGroup(kept), SimulatedSource(estimator.model, "speed=max&rate_hz=2")
    answers = list(estimate_stream(estimator, source, plan, print, sinks))
    assert sum(map(len, kept.blocks)) == 40
    assert kept.answers == answers and len(answers) == 20
    assert not kept.closed  # who opens it closes it
    sinks.log("now")
    assert kept.lines == [(pytest.approx(19.5), "now")]


@pytest.mark.parametrize("call", ["on_samples", "on_estimate", "on_event", "close"])
def test_a_sink_that_fails_is_dropped_with_one_line_and_the_others_go_on(estimator, call):
    kept, broken = Kept(), Broken(call)
    sinks = SinkGroup(kept, broken)
    stream = SimulatedSource(estimator.model, "speed=max&rate_hz=2&seconds=5")
    answers = list(estimate_stream(estimator, stream, ProcessingOptions(), sinks.log, sinks))
    sinks.log("the end")
    sinks.close()
    assert kept.answers == answers and len(answers) == 10
    assert kept.closed == 1
    failures = [line for _, line in kept.lines if "Broken" in line]
    assert len(failures) == 1 and "No space left on device" in failures[0]


# messages


def test_messages_that_differ_in_numbers_are_printed_once_in_ten_seconds(capsys, monkeypatch):
    now = [100.0]
    monkeypatch.setattr("probedesign.live.outputs.sinks.monotonic", lambda: now[0])
    sink = StderrSink()
    for i in range(50):
        now[0] += 0.5
        sink.on_event(now[0], f"fault: {i} readings in a row; no position")
        sink.on_event(now[0], f"touch {i}, 1.0 ... 2.0 s: not located")
    sink.close()
    lines = capsys.readouterr().err.splitlines()
    assert sum(line.startswith("touch") for line in lines) == 50  # promised, each of them
    faults = [line for line in lines if line.startswith("fault")]
    assert faults == [
        "fault: 0 readings in a row; no position",
        "fault: 20 readings in a row; no position (19 more such lines before)",
        "fault: 40 readings in a row; no position (19 more such lines before)",
        "fault: 49 readings in a row; no position (9 such lines)",
    ]


def test_a_log_has_every_message_with_its_time_and_is_continued(bundle, tmp_path, capsys):
    log = tmp_path / "new" / "live.log"
    for _ in range(2):
        assert run(["live", str(bundle), "--source", SIM, "--count", "3", "--log", str(log)]) == 0
    printed = [line for line in capsys.readouterr().err.splitlines() if "compiling" not in line]
    logged = [line for line in log.read_text().splitlines() if "compiling" not in line]
    assert len(logged) == len(printed) == 4
    for line, text in zip(logged, printed, strict=True):
        when, rest = line.split(" ", 1)
        assert datetime.fromisoformat(when).tzinfo is not None and rest.endswith(f" {text}")
    assert run(["live", str(bundle), "--source", SIM, "--log", str(tmp_path)]) == 2
    assert "cannot be written" in capsys.readouterr().err


def test_the_unit_of_systemd_starts_a_command_that_exists():
    unit = configparser.ConfigParser(interpolation=None)
    unit.optionxform = str
    unit.read(EXAMPLES / "probedesign-live.service")
    program, *arguments = unit["Service"]["ExecStart"].split()
    assert program.endswith("/bin/probedesign")
    command, bound, _ = build_app(with_settings=False).parse_args(arguments, exit_on_error=False, print_error=False)
    assert command.__name__ == "live" and bound.arguments["log"] == Path("/var/log/probedesign/live.log")
    assert unit["Service"]["RestartPreventExitStatus"] == "2"


# UDP publisher


EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
SIM = "sim:?speed=max&rate_hz=3"


@pytest.fixture
def receiver():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)  # it is read when the run is over
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(10.0)
        yield receiver


def address(receiver) -> str:
    return f"udp://127.0.0.1:{receiver.getsockname()[1]}"


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        return receiver.getsockname()[1]


def answer_of(estimator, time=0.0, received=float("nan")) -> EstimateUpdate:
    gravity = estimator.model.gravity_base
    eq = estimator.model.rod.solve(gravity, (0.0, 0.02, 0.0), 0.08)
    reading = WrenchReading(time, estimator.model.to_sensor(eq.wrench_base, gravity), gravity, received=received)
    return EstimateUpdate(reading, estimator.estimate(eq.wrench_base, gravity))


def test_live_publishes_what_it_prints(bundle, receiver, capsys):
    assert run(["live", str(bundle), "--source", SIM, "--json", "--publish", address(receiver)]) == 0
    out, err = capsys.readouterr()
    printed = [json.loads(line) for line in out.splitlines()]
    messages = []
    while len([m for m in messages if m["kind"] == "estimate"]) < len(printed):
        messages.append(json.loads(receiver.recv(65535)))
    published = [m for m in messages if m["kind"] == "estimate"]
    assert [{name: m[name] for name in row} for m, row in zip(published, printed, strict=True)] == printed
    assert [m["number"] for m in messages] == list(range(1, len(messages) + 1))
    assert err.splitlines()[-1].startswith("published ")


def test_when_it_came_and_went_is_stamped_by_both_clocks(estimator, receiver):
    publisher = UdpPublisher(address(receiver), print)
    publisher.on_estimate(answer_of(estimator, received=0.25))
    message = json.loads(receiver.recv(65535))
    assert set(COLUMNS) < set(message) and message["result"] == "ok"
    assert message["received_monotonic_s"] == 0.25
    late = message["sent_monotonic_s"] - 0.25
    assert message["latency_ms"] == pytest.approx(1e3 * late, rel=1e-9)
    # doubles hold today's Unix time to 2.4e-7 s
    assert message["sent_unix_s"] - message["received_unix_s"] == pytest.approx(late, abs=1e-6)


def test_readings_without_arrival_time_have_no_latency_and_events_are_sent(estimator, receiver):
    publisher = UdpPublisher(address(receiver), print)
    publisher.on_estimate(answer_of(estimator))
    publisher.on_event(3.5, "stale")
    estimate, event = (json.loads(receiver.recv(65535)) for _ in range(2))
    assert estimate["received_unix_s"] is None and estimate["latency_ms"] is None
    assert (event["kind"], event["time_s"], event["event"]) == ("event", 3.5, "stale")


def test_a_run_without_receiver_continues(bundle, capsys):
    nobody = f"udp://127.0.0.1:{free_port()}"
    assert run(["live", str(bundle), "--source", SIM, "--publish", nobody]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 60


def test_a_network_that_accepts_nothing_is_reported_once_and_counted(estimator):
    log_lines = []
    publisher = UdpPublisher("udp://255.255.255.255:9", log_lines.append)  # broadcasting is not permitted unasked
    for _ in range(3):
        publisher.on_estimate(answer_of(estimator))
    publisher.close()
    assert (publisher.sent, publisher.dropped, len(log_lines)) == (0, 3, 2)
    assert "the run continues" in log_lines[0] and "3 were not accepted" in log_lines[1]


@pytest.mark.parametrize(
    "wrong",
    ["127.0.0.1:9000", "udp://127.0.0.1", "udp://:9", "tcp://a:1", "udp://a:99999", "udp://a:1/x", "udp://[x:1"],
)
def test_what_is_no_address(wrong):
    with pytest.raises(InputError, match="write udp://HOST:PORT"):
        UdpPublisher(wrong, print)
    with pytest.raises(InputError, match=r"--publish udp://no-such-host\.invalid:9"):
        UdpPublisher("udp://no-such-host.invalid:9", print)


def test_the_receiver_of_the_docs_receives(estimator):
    port = free_port()
    command = [sys.executable, str(EXAMPLES / "receive_udp.py"), str(port)]
    publisher = UdpPublisher(f"udp://127.0.0.1:{port}", print)
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as example:
        assert example.stdout.readline() == "stale: no datagram arrived\n"  # it listens from here on
        publisher.on_event(0.0, "tare")
        publisher.on_estimate(answer_of(estimator))
        assert example.stdout.readline() == "event: tare\n"
        assert example.stdout.readline().startswith("touched at s = ")
        example.terminate()
