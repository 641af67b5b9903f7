"""`netft://` against the simulated box over real sockets, with what goes wrong on the wire."""

import socket

import numpy as np
import pytest

from probedesign.live.box.faults import Faults
from probedesign.live.box.transducer import OFFSET
from probedesign.live.netft import wire
from probedesign.live.netft.wire import RECORD
from probedesign.live.run import locate
from tests.live.peers import LOAD, Reader, box, close, mean_of

pytest.importorskip("pynetft")


def test_loss_disorder_and_rubbish_are_counted_and_change_no_reading(estimator):
    faults = Faults(loss=0.02, reorder=0.02, duplicate=0.02, garbage=0.02, short=0.02)
    with box(estimator, faults=faults) as peer, Reader(peer, estimator) as reader:
        reader.more(2000)
    counts = reader.source.counts
    assert all(counts[name] > 0 for name in ("lost", "late", "doubled", "malformed"))
    assert counts["lost"] < 0.2 * counts["received"]  # not four thousand millions for one that came late
    times = np.array([r.time for r in reader.readings])
    assert (np.diff(times) > 0.0).all()
    ticks = np.diff(times) * wire.SAMPLES_PER_SECOND
    assert np.allclose(ticks, np.rint(ticks), atol=1e-6)  # the sensor's own clock
    assert (np.abs(mean_of(reader.readings) - LOAD - OFFSET) <= close(estimator, 2000) + 1e-6).all()


def test_the_clock_passes_the_end_of_its_32_bits(estimator):
    with box(estimator, powered=2**32 - 1000) as peer, Reader(peer, estimator) as reader:
        reader.more(3000)
    times = [r.time for r in reader.readings]
    assert reader.source.counts["restarts"] == 0
    assert (np.diff(times) > 0.0).all() and times[-1] < 60.0


def test_a_restart_is_survived_marked_and_not_mixed(estimator):
    with box(estimator) as peer, Reader(peer, estimator) as reader:
        peer.restart(0.3)
        reader.said("stale")
        reader.said("tare from before is kept")
        reader.more()
    stretches = [r.stretch for r in reader.readings]
    assert stretches == sorted(stretches) and stretches[-1] > stretches[0]
    assert (np.diff([r.time for r in reader.readings]) > 0.0).all()


def test_a_restart_soon_after_power_up_is_survived(estimator):
    """pynetft takes a clock that goes back within its first 65536 samples for late records and refuses them all."""
    with box(estimator, powered=20000) as peer, Reader(peer, estimator) as reader:
        peer.restart(0.2)
        reader.said("tare from before is kept")
        reader.more()


def test_a_stall_is_stale_and_gives_no_readings(estimator):
    with box(estimator) as peer, Reader(peer, estimator) as reader:
        peer.stall(0.4)
        reader.said("stale")
        reader.more()
    assert reader.source.counts["interruptions"] >= 1


def test_a_stolen_stream_is_asked_for_again_and_told(estimator):
    with box(estimator) as peer, Reader(peer, estimator) as reader:
        for _ in range(4):
            peer.steal()
            reader.wait(lambda: peer.client is not None)
            reader.more(20)
        reader.said("another client")


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"torque_unit": "N-m"}, "scfgtu: N-mm, now N-m"),
        ({"counts_per_force": 1e3}, "cfgcpf: 1000000.0, now 1000.0"),
        ({"tool": (0.0, 0.0, 10.0, 0.0, 0.0, 0.0)}, "cfgtfx: 0; 0; 0; 0; 0; 0, now 0; 0; 10; 0; 0; 0"),
        ({"bias": (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)}, "setbias"),
    ],
)
def test_a_configuration_that_changes_ends_the_run(estimator, change, told):
    with box(estimator) as peer, Reader(peer, estimator, "&check_s=0.1") as reader:
        peer.configure(**change)
        reader.wait(lambda: reader.error is not None)
    assert told in str(reader.error) and "start again" in str(reader.error)


def test_a_restart_with_another_configuration_ends_the_run_before_a_reading(estimator):
    with box(estimator) as peer, Reader(peer, estimator, "&check_s=3600") as reader:
        peer.restart(0.2)
        peer.configure(torque_unit="N-m")
        reader.wait(lambda: reader.error is not None)
    assert {r.stretch for r in reader.readings} == {0}


def test_a_saturated_sample_is_no_reading_to_estimate_from(estimator):
    with box(estimator) as peer, Reader(peer, estimator) as reader:
        peer.saturate()
        reader.wait(lambda: reader.readings[-1].fault)
        saturated = reader.readings[-1]
        peer.saturate(False)
        reader.wait(lambda: not reader.readings[-1].fault)
    assert "transducer saturated" in saturated.fault and "0x80020000" in saturated.fault
    assert locate(estimator, saturated).result == "out_of_range"
    reader.said("transducer saturated")


def test_a_latched_monitor_condition_is_no_fault(estimator):
    with box(estimator) as peer:
        peer._transducer.latched = True
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
