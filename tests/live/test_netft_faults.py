"""`netft://` against the simulated box over real sockets, with faults of the network and the box."""

import socket
import threading
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from probedesign.live.blocks import Block
from probedesign.live.processing.chain import ProcessingOptions
from probedesign.live.processing.estimates import locate
from probedesign.live.processing.tare import TareWindow
from probedesign.live.run import estimate_stream
from probedesign.live.sources import netft
from probedesign.live.sources import netft_configuration as configuration
from probedesign.live.sources import netft_rdt as rdt
from probedesign.live.sources.netft_configuration import differences
from probedesign.live.sources.netft_rdt import RECORD, SensorClock
from probedesign.live.sources.source import STALE_TIME, open_source
from probedesign.simulation.netft_box import NATIVE, OFFSET
from tests.live.peers import LOAD, Reader, averaged, box, close, mean_of


@pytest.fixture(autouse=True)
def hurried(monkeypatch):
    """The stream is requested again every 50 ms, as soon as it is stale."""
    monkeypatch.setattr(netft, "REQUEST_INTERVAL", 0.05)


def test_loss_disorder_and_rubbish_are_counted_and_change_no_reading(estimator):
    with box(estimator) as peer, Reader(peer, estimator) as reader:
        peer.disorder = 0.04
        reader.more(1000)
    counts = reader.source.counts
    assert all(counts[name] > 0 for name in ("lost", "late", "malformed"))
    assert counts["lost"] < 0.2 * counts["received"]  # not four thousand millions for one that came late
    times = np.array([r.time for r in reader.readings])
    assert (np.diff(times) > 0.0).all()
    ticks = np.diff(times) * rdt.SAMPLES_PER_SECOND
    assert np.allclose(ticks, np.rint(ticks), atol=1e-6)  # the sensor's own clock
    assert (np.abs(mean_of(reader.readings) - LOAD - OFFSET) <= close(estimator, 1000) + 1e-6).all()


def assert_events_in_order(reader) -> None:
    """Silence is in the stream and reported, after the last reading before it and before the first after; the readings
    beyond it are of another stretch."""
    silences = [i for i, (_, what) in enumerate(reader.story) if isinstance(what, Block) and not len(what)]
    lines = [i for i, (_, what) in enumerate(reader.story) if isinstance(what, str)]
    first = silences[0]
    when, silence = reader.story[first]
    before = next(b for _, b in reversed(reader.story[:first]) if isinstance(b, Block))
    after = next(b for _, b in reader.story[first:] if isinstance(b, Block) and len(b))
    stale = next(i for i in lines if "stale" in reader.story[i][1])
    again = next(i for i in lines if "records resumed" in reader.story[i][1])
    resumed = next(i for i, (_, what) in enumerate(reader.story) if what is after)
    assert stale < first < again < resumed
    assert "stale, no record for" in silence.fault
    assert when - before.received[-1] > STALE_TIME  # it was silent so long at least, by the host's clock
    assert after.received[0] - before.received[-1] < 10.0  # half a second and some; it does not hang
    assert (before.stretch, silence.stretch) == (0, 0) and after.stretch > 0


@pytest.mark.parametrize("options", [{}, {"initial_samples": 20_000}])
def test_a_restart_is_survived_marked_and_not_mixed(estimator, options):
    """Also soon after power-up: a counter that goes back a little is no late record."""
    with box(estimator, **options) as peer, Reader(peer, estimator) as reader:
        peer.restart(0.1)
        reader.has_logged("previous tare is kept")
        reader.more()
    assert_events_in_order(reader)
    assert reader.source.counts["restarts"] == 1
    assert (np.diff([r.time for r in reader.readings]) > 0.0).all()
    means = list(averaged(reader.blocks, 36))
    assert {m.stretch for m in means} == {r.stretch for r in reader.readings}


def test_the_tare_survives_a_restart(estimator):
    """The offset of the transducer is 600 times the noise: without its tare the free probe would be a contact."""
    gravity = estimator.model.gravity_base
    free = estimator.model.to_sensor(estimator.free(gravity).wrench_base, gravity)
    lines = []
    with box(estimator, load=free) as peer:
        source = open_source(peer.source, estimator.model, lines.append)
        stream = estimate_stream(estimator, source, ProcessingOptions(TareWindow(0.0, 0.1), 36), lines.append)
        before = list(islice(stream, 5))
        peer.restart(0.1)
        last = before[-1].reading.stretch  # a busy machine may have interrupted the stream before
        after = list(islice((answer for answer in stream if answer.reading.stretch > last), 5))
        stream.close()
    assert len(before) == len(after) == 5
    assert {answer.estimate.result for answer in before + after} == {"no_contact"}
    assert any("the tare is kept" in line for line in lines)


def test_a_stall_is_stale_and_gives_no_readings(estimator):
    with box(estimator) as peer, Reader(peer, estimator) as reader:
        peer.stall(0.1)
        reader.has_logged("records resumed")
        reader.more()
    assert_events_in_order(reader)
    assert reader.source.counts["interruptions"] >= 1


def test_a_box_that_goes_away_is_stale_for_as_long(estimator):
    """Its port is closed: the system answers for it."""
    with box(estimator) as peer, Reader(peer, estimator) as reader:
        peer.__exit__()
        reader.wait(lambda: sum(not len(block) for block in reader.blocks) > 2)
        count = len(reader.readings)
        reader.wait(lambda: sum(not len(block) for block in reader.blocks) > 6)
        assert len(reader.readings) == count
    assert reader.error is None


def test_a_stolen_stream_is_requested_again_and_reported(estimator):
    with box(estimator) as peer, Reader(peer, estimator) as reader:
        for _ in range(4):
            peer.drop_client()
            reader.wait(lambda: peer.client is not None)
            reader.more(20)
        reader.has_logged("another client")
    assert reader.error is None


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"counts_per_force": 1e3}, "cfgcpf: 1000000.0, now 1000.0"),
        ({"tool": (0.0, 0.0, 10.0, 0.0, 0.0, 0.0)}, "cfgtfx: 0; 0; 0; 0; 0; 0, now 0; 0; 10; 0; 0; 0"),
        ({"bias": (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)}, "setbias: 0; 0; 0; 0; 0; 0, now 1; 0; 0; 0; 0; 0"),
    ],
)
def test_changes_are_named_by_their_tags(change, expected):
    assert differences(NATIVE, replace(NATIVE, **change)) == [expected]


def test_a_configuration_that_changes_ends_the_run(estimator):
    with box(estimator) as peer, Reader(peer, estimator, "&check_s=0.1") as reader:
        peer.configure(torque_unit="N-m")
        reader.wait(lambda: reader.error is not None)
    assert "scfgtu: N-mm, now N-m" in str(reader.error) and "restart with a new tare" in str(reader.error)


def test_a_restart_with_another_configuration_ends_the_run_before_a_reading(estimator):
    with box(estimator) as peer, Reader(peer, estimator, "&check_s=3600") as reader:
        peer.restart(0.1)
        peer.configure(torque_unit="N-m")
        reader.wait(lambda: reader.error is not None)
    assert {r.stretch for r in reader.readings} == {0}


def test_a_page_that_does_not_respond_delays_no_reading(estimator, monkeypatch):
    """The counter continues after a pause of the network, so the box is the same."""
    released = threading.Event()
    monkeypatch.setattr("probedesign.live.sources.source.REPORT_TIMES", (0.0, 0.1, 0.2))
    with box(estimator) as peer, Reader(peer, estimator) as reader:
        monkeypatch.setattr(configuration, "fetch_page", lambda *page: b"x" * (not released.wait()))
        peer.stall(0.1)
        reader.wait(lambda: reader.readings[-1].stretch > 0)
        reader.more(100)
        assert not released.is_set() and reader.error is None
        peer.restart(0.1)  # and then it may be another one
        reader.wait(lambda: any("its page does not respond" in line for line in reader.lines))
        released.set()  # an empty page
        reader.wait(lambda: reader.error is not None)
    assert "its configuration has changed" in str(reader.error)
    assert (np.diff([r.time for r in reader.readings]) > 0.0).all()


def test_a_saturated_sample_is_no_reading_to_estimate_from(estimator):
    with box(estimator) as peer, Reader(peer, estimator) as reader:
        peer.load[0] = 1e3
        reader.wait(lambda: sum(bool(r.fault) for r in reader.readings) > 10)
        peer.load[0] = LOAD[0]
        reader.wait(lambda: not reader.readings[-1].fault)
        reader.more()
    faults = [r for r in reader.readings if r.fault]
    assert all("transducer saturated" in r.fault and "0x80020000" in r.fault for r in faults)
    assert {locate(estimator, r).result for r in faults} == {"out_of_range"}
    assert reader.source.counts["faults"] == len(faults)
    texts = [line.partition(": ")[2] for line in reader.lines]
    assert texts.index("healthy again") > texts.index(faults[0].fault)
    assert (np.diff([r.time for r in reader.readings]) > 0.0).all()


def test_a_latched_monitor_condition_is_no_fault(estimator):
    with box(estimator) as peer:
        peer.status = rdt.SUMMARY | rdt.LATCHED
        with Reader(peer, estimator) as reader:
            reader.more()
    assert not any(r.fault for r in reader.readings)


def test_datagrams_from_another_address_are_not_read(estimator):
    with (
        box(estimator) as peer,
        Reader(peer, estimator) as reader,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger,
    ):
        for i in range(50):
            stranger.sendto(RECORD.pack(10**6 + i, 10**9 + i, 0, *[10**7] * 6), peer.client)
        reader.more()
    assert max(abs(r.wrench_sensor[0]) for r in reader.readings) < 1.0
    assert reader.source.counts["restarts"] == 0


# the clock


def ticks(clock, ft, received):
    """Samples since the first, and which records the clock takes."""
    new, time, _ = clock.times(np.array(ft), np.array(received, dtype=float))
    return np.rint(time * rdt.SAMPLES_PER_SECOND).astype(int).tolist(), new.tolist()


FT = [2**32 - 2, 2**32 - 1, 0, 0, 5, 7, 7, 8]
WRAPPED = [0, 1, 2, 7, 9, 10]


@pytest.mark.parametrize("cut", range(1, 8))
def test_the_clock_counts_the_same_however_records_are_cut(cut):
    """Past the end of the 32 bits; a sample that is repeated is no new reading."""
    clock, received = SensorClock(), np.arange(8) / 7000
    first, new = ticks(clock, FT[:cut], received[:cut])
    second, more = ticks(clock, FT[cut:], received[cut:])
    assert first + second == WRAPPED
    assert new + more == [True, True, True, False, True, True, False, True]
    assert clock.restarts == 0


def test_a_clock_that_starts_again_is_bridged_by_the_hosts_and_a_long_stall_is_no_restart():
    """What counts is the time since the last new sample."""
    clock, stalled = SensorClock(), SensorClock()
    assert ticks(clock, [10**6, 10**6 + 1, 3, 4], [0.0, 0.0, 2.0, 2.0])[0] == [0, 1, 14001, 14002]
    assert ticks(stalled, [5, 5, 5, 140005], [0.0, 10.0, 20.0, 20.0])[0] == [0, 140000]
    assert (clock.restarts, stalled.restarts) == (1, 0)
