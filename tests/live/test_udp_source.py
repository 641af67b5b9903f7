"""Wrenches by UDP: units, clocks, losses, silence, hostile datagrams, and sources that other packages add."""

import json
import random
import signal
import socket
import threading
import time
from contextlib import closing, suppress

import msgpack
import numpy as np
import pytest

from probedesign.core.errors import InputError
from probedesign.live.datagrams import MAX_DATAGRAM, SENDER_TIMEOUT, Listener
from probedesign.live.processing.chain import ProcessingOptions
from probedesign.live.run import estimate_stream
from probedesign.live.sources.source import STALE_TIME, open_source
from probedesign.live.sources.udp import MAX_RATE, parse_wrench
from probedesign.rod.contact import solve_frictionless
from tests.live.peers import Reader, until

GOOD = {"fx_N": 0.1, "fy_N": -0.2, "fz_N": 0.3, "mx_Nm": 1e-3, "my_Nm": -2e-3, "mz_Nm": 3e-3}
WRENCH = np.array(list(GOOD.values()))


class Waiting(Reader):
    def more(self, count=0):
        return None


class Sender:
    """Sends to a source that listens on a port of the system's choice."""

    def __init__(self, query=""):
        self.source = f"udp://127.0.0.1:0{query}"
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def connect(self, reader):
        self._socket.connect(reader.source._listener.address)
        time.sleep(0.05)  # what arrives before the source is read is discarded
        return self

    def send(self, content=None, **values):
        self._socket.send(content if content is not None else json.dumps(GOOD | values).encode())
        time.sleep(0.002)


@pytest.fixture
def opened(estimator):
    sender = Sender()
    with Waiting(sender, estimator) as reader:
        yield reader, sender.connect(reader)
        reader._ended.set()
        sender.send()  # the reader looks at its end after a block


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


def test_json_and_messagepack_give_the_same_readings(opened):
    reader, sender = opened
    sender.send(time_s=5.0, sequence=1)
    sender.send(msgpack.packb(GOOD | {"time_s": 5.01, "sequence": 2}))
    reader.wait(lambda: len(reader.readings) == 2)
    assert [r.time for r in reader.readings] == [5.0, 5.01]
    assert all(np.array_equal(r.wrench_sensor, WRENCH) for r in reader.readings)
    assert not any(r.fault or r.stretch for r in reader.readings)


def test_hostile_datagrams_are_counted_and_survived(opened):
    reader, sender = opened
    sender.send(time_s=1.0)
    hostile = [
        b"", b"\xff", b"{", b"[]", b"\x81", b"\x81\xc4\x01a\x01", b"[" * 4000, b" " * (MAX_DATAGRAM + 1), b"\x00" * 36,
        msgpack.packb([1, 2]), json.dumps(GOOD | {"fx_N": 1e9}).encode(), b"\xdf\xff\xff\xff\xff",
    ]  # fmt: skip
    for content in hostile:
        sender.send(content)
    sender.send(time_s=0.5)
    sender.send(time_s=1e6)
    sender.send()
    sender.send(time_s=1.02, frame="tool\x1b[31m")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.sendto(json.dumps(GOOD | {"time_s": 1.03}).encode(), reader.source._listener.address)
    time.sleep(0.002)
    sender.send(time_s=1.04)
    reader.wait(lambda: len(reader.readings) == 2)
    assert [r.time for r in reader.readings] == [1.0, 1.04]
    counts = reader.source._listener.counts
    assert counts["invalid"] == len(hostile) == reader.source.counts["malformed"]
    assert counts["not increasing in time"] == counts["jumping in time"] == counts["not always timed"] == 1
    assert counts["in another frame"] == counts["from another sender"] == 1
    assert all(line.isprintable() for line in reader.lines)
    assert sum("rejected and counted" in line for line in reader.lines) == 6  # each kind once


def test_lost_and_late_datagrams_are_counted_by_their_sequence(opened):
    reader, sender = opened
    for sequence in (1, 2, 5, 4, 5, 6):
        sender.send(sequence=sequence)
    reader.wait(lambda: len(reader.readings) == 4)
    reader.wait(lambda: reader.source.counts["lost"] == 2)
    assert reader.source._listener.counts["late or duplicated"] == 2


def test_forged_numbers_leap_no_further_than_can_have_been_sent(opened):
    """Each leap alone would be possible after the second that a sender may be silent."""
    reader, sender = opened
    began = time.monotonic()
    for i in range(20):
        sender.send(sequence=1 + 15_000 * i)
    counts = reader.source._listener.counts
    reader.wait(lambda: sum(counts[kind] for kind in ("taken", "leaping in sequence")) == 20)
    assert counts["lost"] < 20_000 * (1.0 + time.monotonic() - began)
    assert counts["leaping in sequence"] > 0


def test_a_leap_of_the_sequence_is_rejected_and_named(opened):
    """A million datagrams cannot be lost in the second since the last; a sender that goes on there begins anew."""
    reader, sender = opened
    for sequence in (1, 2, 1_000_002, 3):
        sender.send(sequence=sequence)
    reader.wait(lambda: len(reader.readings) == 3)
    assert reader.source._listener.counts["leaping in sequence"] == 1
    assert any("sequence leaps by 1000000" in line for line in reader.lines)
    time.sleep(SENDER_TIMEOUT)
    sender.send(sequence=1_000_003)
    reader.wait(lambda: len(reader.readings) == 4)
    assert reader.source.counts["lost"] == 0 and reader.readings[-1].stretch == 1


def test_a_fault_of_the_sender_is_that_of_the_reading(opened):
    reader, sender = opened
    sender.send(fault="saturated\x1b[2J")
    sender.send()
    reader.wait(lambda: len(reader.readings) == 2)
    assert [r.fault for r in reader.readings] == ["saturated\\x1b[2J", ""]


def test_without_time_stamps_the_arrival_counts(opened):
    """From zero; a busy receiver may take both at once."""
    reader, sender = opened
    sender.send()
    reader.wait(lambda: len(reader.readings) == 1)
    sender.send()
    reader.wait(lambda: len(reader.readings) == 2)
    first, second = reader.readings
    assert first.time == 0.0 and second.time == pytest.approx(second.received - first.received, abs=1e-9)
    assert second.received > first.received  # the first had been read when the second was sent


def test_silence_is_reported_and_a_restarted_sender_continues_the_time(opened):
    """Its clock begins anew; the source's clock goes on by what passed between both, and no mean spans the gap."""
    reader, sender = opened
    for i in range(10):
        sender.send(time_s=50.0 + 0.002 * i)
    reader.has_logged("stale")
    assert any(len(block) == 0 and "stale" in block.fault for block in reader.blocks)
    time.sleep(SENDER_TIMEOUT)
    sender.send(time_s=3.0)
    reader.wait(lambda: len(reader.readings) == 11)
    before, after = reader.readings[-2:]
    assert after.time - before.time == pytest.approx(after.received - before.received, abs=1e-6)
    assert (before.stretch, after.stretch) == (0, 1) and reader.source.counts["interruptions"] == 1


def test_a_slow_sender_is_not_silent(opened):
    """The limit of silence follows the usual interval: here 1.5 times what is too long for a fast sensor."""
    reader, sender = opened
    for i in range(8):
        sender.send(sequence=i)
        time.sleep(1.5 * STALE_TIME)
    reader.wait(lambda: len(reader.readings) == 8)
    assert {r.stretch for r in reader.readings} == {0} and not reader.source.counts["interruptions"]


def test_bursts_with_complete_times_are_no_interruptions(opened):
    """Ten readings of 10 ms at once: after the first bursts, a pause between two is neither silence nor a gap."""
    reader, sender = opened
    for burst in range(12):
        for i in range(10):
            sender.send(time_s=0.1 * burst + 0.01 * i)
        time.sleep(0.1)
    reader.wait(lambda: len(reader.readings) == 120)
    assert {r.stretch for r in reader.readings} == {0} and not reader.source.counts["interruptions"]
    silent = [i for i, block in enumerate(reader.blocks) if not len(block)]
    assert sum(map(len, reader.blocks[max(silent, default=0) :])) > 60


def test_no_sender_ends_with_one_line(estimator):
    with Waiting(Sender("?wait_s=0.2"), estimator) as reader:
        reader.wait(lambda: reader.error is not None)
    assert "no wrench within 0.2 s" in str(reader.error)


def test_wrenches_in_the_base_frame_are_transformed(estimator):
    sender = Sender("?frame=base")
    with Waiting(sender, estimator) as reader:
        sender.connect(reader).send(frame="tool0")
        reader.wait(lambda: len(reader.readings) == 1)
        reader._ended.set()
        sender.send(frame="tool0")
    model = estimator.model
    assert np.array_equal(reader.readings[0].wrench_sensor, model.to_sensor(WRENCH, model.gravity_base))


def test_a_wrench_by_udp_is_located_as_it_was_sent(estimator):
    """The whole chain: what the rod gives for a contact at 0.7 of the length is found there, noise-free."""
    model = estimator.model
    s = 0.7 * model.rod.length
    touch = solve_frictionless(model.rod, model.gravity_base, s, 0.5, 0.02)
    wrench = model.to_sensor(touch.equilibrium.wrench_base, model.gravity_base)
    names = dict(zip(GOOD, wrench.tolist(), strict=True))
    source = open_source("udp://127.0.0.1:0", model)
    updates = estimate_stream(estimator, source, ProcessingOptions(samples=1, count=1, zero="trusted"), print)
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def send():
        for i in range(400):
            # a millionth of a newton: readings that are identical are those of a frozen sensor
            reading = {name: value + 1e-6 * (i % 7) for name, value in names.items()}
            sender.sendto(json.dumps(reading | {"sequence": i}).encode(), source._listener.address)
            time.sleep(0.005)

    thread = threading.Thread(target=send, daemon=True)
    thread.start()
    (update,) = updates
    assert update.estimate.ok
    assert abs(update.estimate.s_contact - s) < update.estimate.std_s  # noise-free: the model error alone is stated


def test_values_that_nobody_takes_in_time_are_lost_and_reported():
    with closing(Listener("--follow", "wrenches", ("127.0.0.1", 0), parse_wrench, max_queued=3)) as listener:
        for _ in range(5):
            listener.receive(json.dumps(GOOD).encode(), ("127.0.0.1", 1), 9.0)
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
            for _ in range(3000):
                with suppress(KeyboardInterrupt):
                    signal.setitimer(signal.ITIMER_REAL, random.uniform(1e-5, 5e-5))
                    while True:
                        listener.wait(1e-7)
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, previous)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.sendto(json.dumps(GOOD).encode(), listener.address)
        until(listener.pop)
