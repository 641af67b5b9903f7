"""Guarded motion: events at the wire, limits with hysteresis, the latched stop, and the examples for robots."""

import json
import socket
import time

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
from tests.live.peers import box

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
