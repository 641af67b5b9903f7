"""Wrenches by UDP: units, clocks, losses, silence and hostile datagrams."""

import json
import random
import signal
import socket
import threading
from contextlib import closing, suppress

import msgpack
import numpy as np
import pytest

from probedesign.core.errors import InputError
from probedesign.live.blocks import iter_readings
from probedesign.live.datagrams import MAX_DATAGRAM, SENDER_TIMEOUT, Listener
from probedesign.live.processing.chain import ProcessingOptions
from probedesign.live.run import estimate_stream
from probedesign.live.sources import udp
from probedesign.live.sources.source import STALE_TIME, open_source
from probedesign.live.sources.udp import MAX_RATE, UdpSource, parse_wrench
from probedesign.rod.contact import solve_frictionless
from tests.live.peers import until

GOOD = {"fx_N": 0.1, "fy_N": -0.2, "fz_N": 0.3, "mx_Nm": 1e-3, "my_Nm": -2e-3, "mz_Nm": 3e-3}
WRENCH = np.array(list(GOOD.values()))
END = 20.0  #: Time at which the source of a script ends [s].


def datagram(**values) -> bytes:
    return json.dumps(GOOD | values).encode()


class Script(Listener):
    """A listener whose datagrams arrive at stated times, by a clock that runs only while the source waits."""

    def __init__(self, *arrivals, start=500.0):
        super().__init__("--source udp://", "wrenches", ("127.0.0.1", 0), parse_wrench, MAX_RATE)
        self.now, self._start, self._arrivals = start, start, list(arrivals)

    def start(self):
        self._socket.close()

    def sleep(self, seconds):
        self.now += seconds

    def wait(self, timeout):
        due = self._start + self._arrivals[0][0] if self._arrivals else np.inf
        self.now = max(self.now, min(self.now + timeout, due))
        while self._arrivals and self._start + self._arrivals[0][0] <= self.now:
            at, content, *sender = self._arrivals.pop(0)
            try:
                self.receive(content, tuple(sender) or ("127.0.0.1", 1), self._start + at)
            except InputError as error:
                self.reject("invalid", f"a datagram {error}")

    def pop(self):
        if self.now > self._start + END:
            raise InputError("over")
        return super().pop()


class Heard:
    """What a source gives of datagrams at stated times [s], until it has been silent for long."""

    def __init__(self, estimator, monkeypatch, *arrivals, **options):
        script, self.lines, self.blocks = Script(*arrivals), [], []
        for name, call in (("monotonic", lambda: script.now), ("sleep", script.sleep)):
            monkeypatch.setattr(udp, name, call)
        self.source = UdpSource(estimator.model, script, self.lines.append, **options)
        with pytest.raises(InputError, match="over"):
            self.blocks.extend(self.source)
        self.readings, self.counts = list(iter_readings(self.blocks)), script.counts


@pytest.fixture
def heard(estimator, monkeypatch):
    return lambda *arrivals, **options: Heard(estimator, monkeypatch, *arrivals, **options)


def every(interval, *contents) -> list:
    return [(i * interval, content) for i, content in enumerate(contents)]


# the content of a datagram


@pytest.mark.parametrize(
    "other",
    [
        {"fx_mN": 100.0, "fy_mN": -200.0, "fz_mN": 300.0, "mx_Nmm": 1.0, "my_Nmm": -2.0, "mz_mNm": 3.0},
        {"fx_N": 0.1, "fy_N": -0.2, "fz_N": 0.3, "tx_Nm": 1e-3, "ty_Nm": -2e-3, "tz_Nm": 3e-3},
        GOOD | {"anything": "else"},
    ],
)
def test_units_are_those_of_the_names(other):
    """The product with a power of ten rounds once: 1e-15 of values below one."""
    assert parse_wrench(other).value.wrench == pytest.approx(WRENCH, abs=1e-15)


@pytest.mark.parametrize(
    "wrong",
    [
        {"fx_N": None}, {"fx_N": "much"}, {"fx_N": float("nan")}, {"fx_N": True}, {"fx_N": [1]}, {"fx_N": 10**400},
        {"fx_mN": 1.0}, {"tx_Nm": 1.0}, {"fz_N": 2000.0}, {"mz_Nm": 60.0}, {"time_s": 1e12}, {"time_s": "now"},
        {"time_ms": 5.0, "time_s": 1.0}, {"sequence": 1.5}, {"sequence": -1}, {"sequence": True}, {"sequence": 2**63},
    ],
)  # fmt: skip
def test_what_is_no_wrench(wrong):
    with pytest.raises(InputError):
        parse_wrench(GOOD | wrong)
    with pytest.raises(InputError, match="no mz_Nm"):
        parse_wrench({name: value for name, value in GOOD.items() if name != "mz_Nm"})


# the stream


def test_json_and_messagepack_give_the_same_readings(heard):
    packed = msgpack.packb(GOOD | {"time_s": 5.01, "sequence": 2})
    readings = heard(*every(0.01, datagram(time_s=5.0, sequence=1), packed)).readings
    assert [r.time for r in readings] == [5.0, 5.01]
    assert all(np.array_equal(r.wrench_sensor, WRENCH) for r in readings)
    assert not any(r.fault or r.stretch for r in readings)


def test_hostile_datagrams_are_counted_and_survived(estimator):
    """Over a socket, from a sender to a thread."""
    hostile = [
        b"", b"\xff", b"{", b"[]", b"\x81", b"\x81\xc4\x01a\x01", b"[" * 4000, b" " * (MAX_DATAGRAM + 1), b"\x00" * 36,
        msgpack.packb([1, 2]), datagram(fx_N=1e9), b"\xdf\xff\xff\xff\xff",
    ]  # fmt: skip
    later = [datagram(time_s=0.5), datagram(time_s=1e6), datagram(), datagram(time_s=1.02, frame="tool\x1b[31m")]
    with closing(Listener("--source udp://", "wrenches", ("127.0.0.1", 0), parse_wrench, MAX_RATE)) as listener:
        listener.start()
        with (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
        ):
            for content in (datagram(time_s=1.0), *hostile, *later):
                sender.sendto(content, listener.address)
            until(lambda: listener.counts["in another frame"])
            other.sendto(datagram(time_s=1.03), listener.address)
            until(lambda: listener.counts["from another sender"])
            sender.sendto(datagram(time_s=1.04), listener.address)
            until(lambda: listener.counts["taken"] == 2)
        assert [value.time for _, value, _ in listener.pop()] == [1.0, 1.04]
        lines, counts = listener.pop_messages(), listener.counts
    assert counts["invalid"] == len(hostile)
    assert counts["not increasing in time"] == counts["jumping in time"] == counts["not always timed"] == 1
    assert counts["in another frame"] == counts["from another sender"] == 1
    assert all(line.isprintable() for line in lines)
    assert sum("rejected and counted" in line for line in lines) == 6  # each kind once


def test_lost_and_late_datagrams_are_counted_by_their_sequence(heard):
    told = heard(*every(0.002, *(datagram(sequence=i) for i in (1, 2, 5, 4, 5, 6)), b"{"))
    assert len(told.readings) == 4 and told.counts["late or duplicated"] == 2
    assert (told.counts["lost"], told.counts["invalid"]) == (2, 1)


def test_forged_numbers_leap_no_further_than_can_have_been_sent(heard):
    """Each leap alone would be possible after the second that a sender may be silent."""
    counts = heard(*every(0.002, *(datagram(sequence=1 + 15_000 * i) for i in range(20)))).counts
    assert counts["lost"] < MAX_RATE * (1.0 + 20 * 0.002) and counts["leaping in sequence"] > 0


def test_a_leap_of_the_sequence_is_rejected_and_named(heard):
    """A million datagrams cannot be lost in the second since the last; a sender that goes on there begins anew."""
    arrivals = every(0.002, *(datagram(sequence=i) for i in (1, 2, 1_000_002, 3)))
    told = heard(*arrivals, (0.01 + SENDER_TIMEOUT, datagram(sequence=1_000_003)))
    assert len(told.readings) == 4 and told.counts["leaping in sequence"] == 1
    assert any("sequence leaps by 1000000" in line for line in told.lines)
    assert told.counts["lost"] == 0 and told.readings[-1].stretch == 1


def test_a_fault_of_the_sender_is_that_of_the_reading(heard):
    readings = heard(*every(0.01, datagram(fault="saturated\x1b[2J"), datagram())).readings
    assert [r.fault for r in readings] == ["saturated\\x1b[2J", ""]


def test_without_time_stamps_the_arrival_counts_from_zero(heard):
    readings = heard(*every(0.25, datagram(), datagram())).readings
    assert [r.time for r in readings] == [0.0, 0.25]


def test_silence_is_reported_and_a_restarted_sender_continues_the_time(heard):
    """Its clock begins anew; the source's clock goes on by what passed between both, and no mean spans the gap."""
    begun = [(0.002 * i, datagram(time_s=50.0 + 0.002 * i)) for i in range(10)]
    told = heard(*begun, (1.5, datagram(time_s=3.0)))
    first = next(block for block in told.blocks if not len(block))
    assert "stale" in first.fault and any("stale" in line for line in told.lines)
    before, after = told.readings[-2:]
    assert after.time - before.time == pytest.approx(after.received - before.received, abs=1e-9)
    assert (before.stretch, after.stretch) == (0, 1) and told.source.interruptions == 1


def test_a_slow_sender_is_not_silent(heard):
    """The limit of silence follows the usual interval: here 1.5 times what is too long for a fast sensor."""
    told = heard(*every(1.5 * STALE_TIME, *(datagram(sequence=i) for i in range(8))))
    assert [r.stretch for r in told.readings] == [0] * 8 and not told.source.interruptions


def test_bursts_with_complete_times_are_no_interruptions(heard):
    """Ten readings of 10 ms at once: after the first bursts, a pause between two is neither silence nor a gap."""
    told = heard(*((0.1 * i, datagram(time_s=0.1 * i + 0.01 * j)) for i in range(12) for j in range(10)))
    assert [r.stretch for r in told.readings] == [0] * 120 and not told.source.interruptions
    silent = [i for i, block in enumerate(told.blocks) if not len(block)]
    assert sum(map(len, told.blocks[silent[1] :])) > 100  # the first one is that of the first burst


@pytest.mark.parametrize(
    ("frame", "named", "used"),
    [("base", "tool0", "base"), ("", "base", "base"), ("sensor", "base", ""), ("", "tool0", "")],
)
def test_wrenches_in_the_base_frame_are_transformed(heard, estimator, frame, named, used):
    (reading,) = heard((0.0, datagram(frame=named)), frame=frame).readings
    expected = estimator.model.to_sensor(WRENCH, estimator.model.gravity_base) if used == "base" else WRENCH
    assert np.array_equal(reading.wrench_sensor, expected)


def test_no_sender_ends_with_one_line(estimator):
    with pytest.raises(InputError, match=r"no wrench within 0\.1 s"):
        list(open_source("udp://127.0.0.1:0?wait_s=0.1", estimator.model))


def test_a_wrench_by_udp_is_located_as_it_was_sent(estimator):
    """The whole chain: what the rod gives for a contact at 0.7 of the length is found there, noise-free."""
    model = estimator.model
    s = 0.7 * model.rod.length
    touch = solve_frictionless(model.rod, model.gravity_base, s, 0.5, 0.02)
    wrench = model.to_sensor(touch.equilibrium.wrench_base, model.gravity_base)
    names = dict(zip(GOOD, wrench.tolist(), strict=True))
    source = open_source("udp://127.0.0.1:0", model)
    updates = estimate_stream(estimator, source, ProcessingOptions(samples=1, count=1, zero="trusted"), print)
    ended = threading.Event()

    def send():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not ended.wait(0.005):
                # a millionth of a newton: readings that are identical are those of a frozen sensor
                reading = {name: value + 1e-6 * random.random() for name, value in names.items()}
                sender.sendto(json.dumps(reading).encode(), source._listener.address)

    thread = threading.Thread(target=send, daemon=True)
    thread.start()
    (update,) = updates
    ended.set()
    assert update.estimate.ok
    assert abs(update.estimate.s_contact - s) < update.estimate.std_s  # noise-free: the model error alone is stated


def test_values_that_nobody_takes_in_time_are_lost_and_reported():
    with closing(Listener("--follow", "wrenches", ("127.0.0.1", 0), parse_wrench, max_queued=3)) as listener:
        for _ in range(5):
            listener.receive(datagram(), ("127.0.0.1", 1), 9.0)
        assert len(listener.pop()) == 3 and listener.summary == "5 wrenches, 2 lost"
        assert [line for line in listener.pop_messages() if "the oldest are lost" in line]


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="Windows has no timer signals")
def test_ctrl_c_while_waiting_does_not_block_the_thread_that_receives():
    """An interruption within the wait of an Event leaves its lock held in about one of 200 cases."""

    def interrupt(*_):
        raise KeyboardInterrupt

    random.seed(1)
    with closing(Listener("--source udp://", "wrenches", ("127.0.0.1", 0), parse_wrench, MAX_RATE)) as listener:
        listener.start()
        previous = signal.signal(signal.SIGALRM, interrupt)
        try:
            for _ in range(1000):  # without the remedy five of them hold the lock
                with suppress(KeyboardInterrupt):
                    signal.setitimer(signal.ITIMER_REAL, random.uniform(1e-5, 5e-5))
                    while True:
                        listener.wait(1e-7)
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, previous)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.sendto(datagram(), listener.address)
        until(listener.pop)
