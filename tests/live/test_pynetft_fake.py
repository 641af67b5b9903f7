"""Our client against pynetft's own fake sensor, a peer that knows nothing of ours.

It is in pynetft's source package alone, as tests/integration/fake_sensor.py; with that folder on PYTHONPATH this runs.
"""

import threading

import numpy as np
import pytest

from probedesign.live.sources.source import open_source
from tests.live.peers import until

fake = pytest.importorskip("fake_sensor", reason="pynetft's source package is not on PYTHONPATH")

COUNTS = (250_000, -500_000, 1_000_000, 2_000, -3_000, 4_000)


@pytest.fixture
def sensor():
    with fake.FakeSensor() as sensor:
        yield sensor


class Reading:
    """Reads a source in a thread until it has enough."""

    def __init__(self, sensor, estimator, enough):
        self.lines, self.blocks = [], []
        spec = f"netft://{sensor.host}:{sensor.rdt_port}?http={sensor.http_port}&check_s=3600"
        self.source = open_source(spec, estimator.model, self.lines.append)
        self._enough = enough
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self):
        stream = iter(self.source)
        for block in stream:
            self.blocks.append(block)
            if self._enough(self):
                break
        stream.close()

    @property
    def readings(self):
        return [reading for block in self.blocks for reading in block.readings()]

    def end(self):
        self._thread.join(10.0)
        assert not self._thread.is_alive(), (self.lines, len(self.readings))


@pytest.mark.parametrize(("unit", "metre"), [("N-m", 1.0), ("N-mm", 1e-3)])
def test_units_counts_and_clock(sensor, estimator, unit, metre):
    sensor.configure(torque_unit=unit)
    for i in range(50):
        sensor.queue_record(COUNTS, ft_sequence=1000 + 7 * i)
    run = Reading(sensor, estimator, lambda run: len(run.readings) >= 50)
    run.end()
    expected = np.array(COUNTS) * 1e-6 * ([1.0] * 3 + [metre] * 3)
    assert np.allclose([r.wrench_sensor for r in run.readings], expected, rtol=1e-12)
    assert np.allclose(np.diff([r.time for r in run.readings]), 1e-3, rtol=1e-9)  # seven samples of 7000 a second
    assert sensor.wait_for_command(0, timeout=5.0)  # the stream was stopped in the end


def test_loss_rubbish_and_faults_are_counted(sensor, estimator):
    for rdt in (1, 2, 5, 6, 6, 4, 7):
        sensor.queue_record(COUNTS, rdt_sequence=rdt, ft_sequence=100 + rdt)
    sensor.queue_malformed()
    sensor.queue_record(COUNTS, rdt_sequence=8, ft_sequence=108, status=0x80020000)
    sensor.queue_record(COUNTS, rdt_sequence=1, ft_sequence=200, on_start=2)
    run = Reading(sensor, estimator, lambda run: len(run.readings) >= 7)
    run.end()
    assert [round(7000 * r.time) for r in run.readings] == [0, 1, 4, 5, 6, 7, 99]
    assert [bool(r.fault) for r in run.readings] == [False] * 5 + [True, False]
    counts = run.source.counts
    assert (counts["lost"], counts["late"], counts["doubled"], counts["malformed"]) == (1, 1, 1, 1)
    assert counts["faults"] == 1


def test_another_calibration_after_silence_is_refused_before_a_reading(sensor, estimator):
    sensor.configure_on_start(2, counts_per_torque=1000.0)
    sensor.queue_record(COUNTS)
    sensor.queue_record(COUNTS, on_start=2, rdt_sequence=1, ft_sequence=9000)
    lines, error = [], []
    spec = f"netft://{sensor.host}:{sensor.rdt_port}?http={sensor.http_port}&check_s=3600"
    stream = iter(open_source(spec, estimator.model, lines.append))
    seen = [next(stream)]

    def read():
        try:
            seen.extend(stream)
        except Exception as wrong:
            error.append(wrong)

    threading.Thread(target=read, daemon=True).start()
    until(lambda: error, lambda: lines)
    assert "cfgcpt: 1000000.0, now 1000.0" in str(error[0])
    assert sum(len(block) for block in seen) == 1
