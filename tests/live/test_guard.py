"""Guarded motion: events at the wire, limits with hysteresis, the latched stop, and the examples for robots."""

import importlib
import json
import socket
import struct
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from probedesign.cli.main import run
from probedesign.core.errors import InputError
from probedesign.estimation.estimate import Estimate
from probedesign.live.blocks import Block, WrenchReading, dropout_block
from probedesign.live.outputs.guard import FIRST_READINGS, RELEASE, Guard, GuardChannel, GuardedSource, Limits
from probedesign.live.processing.chain import ProcessingOptions
from probedesign.live.processing.commands import Command, CommandQueue
from probedesign.live.processing.estimates import EstimateUpdate
from probedesign.live.processing.tare import TareWindow
from probedesign.live.run import estimate_stream
from probedesign.live.sources.source import open_source
from tests.live.peers import box, until

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
RATE, BIAS = 7000.0, np.array([0.3, -0.2, 0.5, 0.002, -0.003, 0.001])


class Watched:
    """A guard that knows bias and gravity, with samples of a force and a moment over those of the free probe."""

    def __init__(self, estimator, limits=None, armed=True):
        self.events, self.lines, self.model = [], [], estimator.model
        self.guard = Guard(estimator, limits or Limits(), self.events.append, self.lines.append)
        self._rng, self.time, gravity = np.random.default_rng(1), 0.0, estimator.model.gravity_base
        free = estimator.free(gravity).wrench_base
        self.free = self.model.to_sensor(free, gravity) + BIAS
        if armed:
            reading = WrenchReading(0.0, self.free, gravity)
            self.guard.on_estimate(EstimateUpdate(reading, Estimate("no_contact"), wrench_base=free))

    def send(self, force=0.0, moment=0.0, samples=7, noise=0.0):
        excess = self.model.to_sensor([force, 0.0, 0.0, 0.0, moment, 0.0], np.zeros(3))
        excess = excess - self.model.to_sensor(np.zeros(6), np.zeros(3))
        std = noise * self.model.noise.std * np.sqrt(self.model.averaging_samples)
        rows = self.free + excess + std * self._rng.standard_normal((samples, 6))
        times = self.time + np.arange(1, samples + 1) / RATE
        self.time = times[-1]
        self.guard.watch(Block(times, rows, self.model.gravity_base, times))

    def of(self, kind):
        return [event for event in self.events if event["kind"] == kind]


@pytest.mark.parametrize(
    ("force", "moment", "named"),
    [(0.6, 0.0, "the force of 0.6 N exceeds its limit of 0.5 N"),
     (0.1, 0.03, "the moment of 0.03 N·m exceeds its limit of 0.02 N·m")],
)  # fmt: skip
def test_a_limit_stops_once_until_it_is_reset_below_its_hysteresis(estimator, force, moment, named):
    watched = Watched(estimator, Limits(0.5, 0.02))
    watched.send(0.5 * 0.99, 0.02 * 0.99)
    assert not watched.guard.stop
    for _ in range(3):
        watched.send(force, moment)
    (event,) = watched.of("limit")
    assert event["stop"] == watched.guard.stop == named and any(named in line for line in watched.lines)
    watched.send(force * 0.9 if not moment else force, moment * 0.9)  # between release and limit
    with pytest.raises(InputError, match="has not fallen below 80% of it"):
        watched.guard.reset(Command("reset"))
    watched.send(0.5 * RELEASE * 0.99, 0.0)
    assert watched.guard.stop  # it falls by itself, the stop stays
    assert watched.guard.reset(Command("reset")) == "guard: reset" and not watched.guard.stop
    watched.send(force, moment)
    assert len(watched.of("limit")) == 2


def test_silence_a_fault_and_saturation_stop(estimator):
    model = estimator.model
    dead = np.zeros((1, 6))
    dead[0, 2] = 1.01 * model.wrench_range[2]
    now = np.zeros(1)
    for block, named in (
        (dropout_block(model.gravity_base, "stale, no record for 0.05 s", 0), "stale, no record"),
        (Block(now, np.zeros((1, 6)), model.gravity_base, now, "transducer saturated"), "transducer saturated"),
        (Block(now, dead, model.gravity_base, now), "Fz is at its limit"),
        (Block(now, np.full((1, 6), np.nan), model.gravity_base, now), "Fx is at its limit or not a number"),
    ):
        watched = Watched(estimator)
        watched.guard.watch(block)
        assert named in watched.guard.stop and watched.of("limit")[0]["stop"] == watched.guard.stop


def test_a_contact_is_an_event_of_its_sample_and_noise_is_none(estimator):
    """Ten seconds of noise: the test has one false alarm an hour."""
    watched = Watched(estimator)
    for _ in range(10_000):
        watched.send(noise=1.0)
    assert not watched.of("contact") and len(watched.of("heartbeat")) > 10
    watched.send(0.2, 0.02, noise=1.0)
    (event,) = watched.of("contact")
    assert event["contact"] is True and watched.time - event["time_s"] < 7 / RATE
    for _ in range(200):
        watched.send(noise=1.0)
    assert [event["contact"] for event in watched.of("contact")] == [True, False]


def test_without_a_tare_it_is_not_armed(estimator):
    watched = Watched(estimator, Limits(0.5), armed=False)
    for _ in range(FIRST_READINGS):
        watched.send(2.0)
    assert not watched.guard.stop and not any(event["armed"] for event in watched.events)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--guard", "udp://127.0.0.1:9", "--limit-force-N", "20"], "--limit-force-N 20 must be positive and within"),
        (["--guard", "udp://127.0.0.1:9", "--limit-moment-Nm", "-1"], "--limit-moment-Nm -1 must be positive"),
        (["--guard", "udp://127.0.0.1:9", "--limit-force-N", "nan"], "--limit-force-N nan must be positive"),
        (["--limit-force-N", "1"], "are watched by a guard"),
        (["--guard", "nowhere"], "--guard nowhere: write udp://HOST:PORT"),
    ],
)
def test_what_cannot_be_guarded_is_one_line(bundle, capsys, options, named):
    assert run(["live", str(bundle), "--source", "sim:?speed=max&seconds=1", *options]) == 2
    err = capsys.readouterr().err
    assert named in err.splitlines()[-1]


def test_at_the_wire_a_press_on_a_streaming_box_stops_and_is_reset(estimator):
    """Contact, limit and heartbeat as datagrams, beside the estimates; the box is off at last."""
    model = estimator.model
    free = model.to_sensor(estimator.free(model.gravity_base).wrench_base, model.gravity_base)
    pressed = [0.0]

    def load(when):
        return np.tile(free + np.array([pressed[0], 0.0, 0.0, 0.0, 0.08 * pressed[0], 0.0]), (len(when), 1))

    lines, events, commands = [], [], CommandQueue()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as controller, box(estimator) as peer:
        controller.bind(("127.0.0.1", 0))
        controller.setblocking(False)
        peer._transducer._load = load
        channel = GuardChannel(f"udp://127.0.0.1:{controller.getsockname()[1]}", lines.append)
        guard = Guard(estimator, Limits(0.5), channel.send, lines.append)
        commands.register("reset", guard.reset)
        source = GuardedSource(open_source(peer.source, model, lines.append), guard)
        options, state = ProcessingOptions(TareWindow(0.0, 0.3), 36), "free"
        deadline = time.monotonic() + 20.0
        for update in estimate_stream(estimator, source, options, lines.append, guard, commands):
            assert time.monotonic() < deadline, (state, lines, events[-3:])
            while True:
                try:
                    events.append(json.loads(controller.recv(4096)))
                except BlockingIOError:
                    break
            kinds = {event["kind"] for event in events}
            if state == "free" and update.reading.time > 0.6 and "heartbeat" in kinds:
                assert not guard.stop
                pressed[0], state = 1.0, "pressed"
            elif state == "pressed" and {"contact", "limit"} <= kinds:
                pressed[0], state = 0.0, "released"
            elif state == "released" and events[-1]["kind"] == "heartbeat" and not events[-1]["contact"]:
                assert guard.stop
                commands.put("reset")
                state = "reset"
            elif state == "reset" and not events[-1]["stop"]:
                break
        channel.close()
    assert next(event for event in events if event["kind"] == "limit")["force_N"] == pytest.approx(1.0, abs=0.1)
    assert any("guard: reset" in line for line in lines)
    assert {event["armed"] for event in events[-3:]} == {True} and all(event["schema"] == 1 for event in events)


# examples


def module(name, monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLES)
    return importlib.import_module(name)


class Events:
    """A guard that sends events to an example."""

    def __init__(self, port):
        self._socket, self._to = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), ("127.0.0.1", port)

    def send(self, kind="heartbeat", stop="", contact=False, armed=True):
        event = {"schema": 1, "kind": kind, "stop": stop, "contact": contact, "armed": armed}
        self._socket.sendto(json.dumps(event).encode(), self._to)


class FakeController:
    """The side of the controller in RTDE, version 2, with the packages of the published guide."""

    def __init__(self, register=b"INT32"):
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port, self.requests, self.values = self._server.getsockname()[1], [], []
        self._register = register
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self):
        link, _ = self._server.accept()
        with link, link.makefile("rb") as stream:
            while len(head := stream.read(3)) == 3:
                length, kind = struct.unpack(">HB", head)
                content = stream.read(length - 3)
                if kind == ord("U"):
                    recipe, value = struct.unpack(">Bi", content)
                    assert recipe == 7
                    self.values.append(value)
                    continue
                self.requests.append((chr(kind), content))
                started = {"O", "I"} <= {each for each, _ in self.requests}
                answer = {"V": b"\x01" if content == b"\0\x02" else b"\0", "O": b"\x01DOUBLE",
                          "I": b"\x07" + self._register, "S": bytes([started])}[chr(kind)]  # fmt: skip
                note = struct.pack(">HB", 7, ord("M")) + b"\x01a\x00\x00"  # a text message in between
                link.sendall(note + struct.pack(">HB", 3 + len(answer), kind) + answer)


def test_the_example_for_universal_robots_writes_the_register(monkeypatch):
    ur, receive = module("ur_guard", monkeypatch), module("receive_guard", monkeypatch)
    monkeypatch.setattr(receive, "SILENCE", 5.0)
    controller, guard, ended = FakeController(), receive.GuardEvents(0), threading.Event()
    events, robot = Events(guard.port), ur.Rtde("127.0.0.1", controller.port)
    thread = threading.Thread(target=ur.forward, args=(guard, robot, ended.is_set))
    thread.start()

    def write(value, **event):
        events.send(**event)
        until(lambda: controller.values[-1:] == [value], lambda: (value, controller.values[-5:]))

    until(lambda: controller.values[:1] == [1])  # before the first event
    write(1, armed=False)
    write(0)
    write(1, kind="contact", contact=True)
    write(0, kind="contact")
    write(1, kind="limit", stop="the force exceeds its limit")
    write(0)
    monkeypatch.setattr(receive, "SILENCE", 0.0)
    until(lambda: controller.values[-1] == 1)
    ended.set()
    thread.join()
    assert [kind for kind, _ in controller.requests] == ["V", "O", "I", "S"]
    assert controller.requests[1][1] == struct.pack(">d", 1.0) + b"timestamp"
    assert controller.requests[2][1] == b"input_int_register_24"


def test_a_register_in_use_is_named(monkeypatch):
    ur = module("ur_guard", monkeypatch)
    with pytest.raises(ConnectionError, match="input_int_register_24: IN_USE"):
        ur.Rtde("127.0.0.1", FakeController(b"IN_USE").port)


class FakeFranky:
    """The part of franky 2.0 that the example uses: a motion calls its callbacks in each step until another follows."""

    def __init__(self):
        self.started, self.calls, self.before = [], 0, {}

    def CartesianVelocityMotion(self, target, duration):
        assert isinstance(target, tuple)
        motion = SimpleNamespace(kind="move", steps=duration, callbacks=[])
        motion.register_callback = motion.callbacks.append
        return motion

    def CartesianVelocityStopMotion(self):
        return SimpleNamespace(kind="stop", steps=0)

    def Twist(self, linear_velocity):
        return tuple(linear_velocity)

    def Duration(self, milliseconds):
        return milliseconds

    def move(self, motion, asynchronous=False):
        assert asynchronous
        self.started.append(motion.kind)
        self._motion = motion

    def join_motion(self):
        motion = self._motion
        for step in range(motion.steps):
            if self._motion is not motion:
                return True
            self.before.get(step, lambda: None)()
            for callback in motion.callbacks:
                callback(None, 1, step, step, None)
                self.calls += 1
        return True


@pytest.mark.parametrize("event", [{"contact": True}, {"stop": "the force exceeds its limit"}, {"armed": False}, None])
def test_the_example_for_franka_stops_in_the_callback(monkeypatch, event):
    franka, receive = module("franka_guard", monkeypatch), module("receive_guard", monkeypatch)
    monkeypatch.setattr(receive, "SILENCE", 5.0)
    guard, robot = receive.GuardEvents(0), FakeFranky()
    assert franka.move_guarded(robot, robot, guard) == "no event of the guard" and not robot.started
    events = Events(guard.port)
    events.send()
    if event is not None:
        robot.before[40] = lambda: events.send(**event)
    reason = franka.move_guarded(robot, robot, guard, seconds=0.1)
    if event is None:
        assert (reason, robot.started, robot.calls) == ("", ["move"], 100)
    else:
        assert reason and robot.started == ["move", "stop"] and robot.calls == 41
