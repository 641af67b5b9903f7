"""`daq://` through nidaqmx with a simulated driver: no card is needed, and NI's own classes run."""

import sys
from itertools import islice

import numpy as np
import pytest

from probedesign.core.errors import InputError, MissingDependencyError, ProbeDesignError
from probedesign.live.blocks import iter_readings
from probedesign.live.processing.estimates import locate
from probedesign.live.sources.source import open_source
from tests.live.cal_file import U, text

nidaqmx = pytest.importorskip("nidaqmx")
pytest.importorskip("defusedxml")

from tests.live.fake_daqmx import FakeDriver  # noqa: E402  # needs nidaqmx

VOLTS = np.array([0.5, -1.0, 0.25, 2.0, -0.5, 0.1])
SI = np.array([1, 1, 1, 1e-3, 1e-3, 1e-3])


def steady(index):
    return np.tile(VOLTS, (len(index), 1))


@pytest.fixture
def cal(tmp_path):
    path = tmp_path / "FT1.cal"
    path.write_text(text("1.1"))
    return path


@pytest.fixture
def driver(monkeypatch):
    driver = FakeDriver(steady)
    monkeypatch.setattr(nidaqmx.utils, "_select_interpreter", lambda *_: driver)
    return driver


def opened(estimator, cal, query="", channels="Dev1/ai0:5", log_lines=None):
    log = (log_lines if log_lines is not None else []).append
    return open_source(f"daq://{channels}?cal={cal}{query}", estimator.model, log)


def blocks(source, count):
    stream = iter(source)
    found = list(islice(stream, count))
    stream.close()
    return found


def test_volts_become_the_wrench_about_the_tool_face(estimator, cal, driver):
    """To a rounding of each product."""
    source = opened(estimator, cal)
    readings = list(iter_readings(blocks(source, 5)))
    assert np.allclose([r.wrench_sensor for r in readings], U @ VOLTS * SI, rtol=1e-12, atol=1e-14)
    assert not any(r.fault for r in readings)
    assert driver.asked["terminal"].name == "DIFF" and driver.asked["reach"] == (-10.0, 10.0)
    assert not driver.tasks  # closed
    assert "sensor FT1 SI-25-0.25" in source.title
    assert any("differs from that of the probe's sensor" in note for note in source.notes)


@pytest.mark.parametrize("asked", [7000.0, 3000.0])
def test_time_is_the_cards_own(estimator, cal, driver, asked):
    """At the rate that the card's clock divides to, not the one that was asked for."""
    readings = list(iter_readings(blocks(opened(estimator, cal, f"&rate_hz={asked:g}"), 20)))
    rate = driver.asked["rate"]
    assert rate != asked
    times = np.array([r.time for r in readings])
    assert np.allclose(times, np.arange(len(times)) / rate, rtol=1e-12)
    received = np.array([r.received for r in readings])
    assert np.isfinite(received).all()


def test_all_that_waits_is_taken_at_once_but_not_without_end(estimator, cal, driver):
    driver.waiting = 500
    assert len(blocks(opened(estimator, cal), 1)[0]) == 500
    driver.waiting = 100_000
    assert len(blocks(opened(estimator, cal), 1)[0]) == 700  # a tenth of a second


def test_a_clipped_gauge_is_a_fault_of_its_samples_alone(estimator, cal, driver):
    def clips(index):
        volts = steady(index)
        volts[(index >= 5) & (index < 9), 2] = 9.9
        return volts

    driver.volts = clips
    readings = list(iter_readings(blocks(opened(estimator, cal), 6)))
    assert [i for i, r in enumerate(readings) if r.fault] == [5, 6, 7, 8]
    assert readings[5].fault == "transducer saturated: gauge 2 beyond 9.8 V"
    assert locate(estimator, readings[5]).result == "out_of_range"


def test_beyond_the_calibration_is_a_fault(estimator, cal, driver):
    """Fz = 3.7 N/V: 4 V at each of the three gauges that carry it is 45 N, its range is 35 N."""
    driver.volts = lambda index: np.tile([4.0, 0.0, 4.0, 0.0, 4.0, 0.0], (len(index), 1))
    first = next(iter_readings(blocks(opened(estimator, cal), 1)))
    assert first.fault == "Fz beyond the calibrated range"
    assert locate(estimator, first).result == "out_of_range"


def test_a_clock_that_stops_is_stale_until_it_runs_again(estimator, cal, driver):
    driver.script = {3: -200284, 4: -200284}
    log_lines = []
    found = blocks(opened(estimator, cal, log_lines=log_lines), 8)
    assert [len(block) > 0 for block in found] == [True] * 3 + [False] * 2 + [True] * 3
    assert all("stale, no record for" in block.fault for block in found[3:5])
    assert [block.stretch for block in found] == [0, 0, 0, 0, 0, 1, 1, 1]
    assert sum("stale" in line for line in log_lines) == 1
    assert any("the tare is kept" in line for line in log_lines)
    assert (np.diff([r.time for r in iter_readings(found)]) > 0.0).all()


@pytest.mark.parametrize("code", [-200279, -200222, -200361])
def test_overwritten_samples_are_reported_and_the_acquisition_restarts(estimator, cal, driver, code):
    driver.script = {4: code}
    log_lines = []
    found = blocks(opened(estimator, cal, log_lines=log_lines), 8)
    assert driver.starts == 2 and not driver.tasks
    assert [block.stretch for block in found] == [0] * 4 + [1] * 4
    assert (np.diff([r.time for r in iter_readings(found)]) > 0.0).all()
    assert any("samples were lost because reading was too slow" in line for line in log_lines)


def test_what_the_driver_refuses_is_one_line(estimator, cal, driver):
    driver.script = {2: -200045}
    with pytest.raises(InputError) as error:
        blocks(opened(estimator, cal), 5)
    assert str(error.value) == "daq://Dev1/ai0:5: NI's driver reports: Driver message. (error -200045)"
    assert not driver.tasks
    driver.script = dict.fromkeys(range(2, 100), -200279)  # an acquisition that always overruns
    with pytest.raises(InputError, match="Driver message"):
        blocks(opened(estimator, cal), 5)


def test_no_driver_is_one_line_with_its_remedy(estimator, cal):
    try:
        nidaqmx.system.System.local()
    except nidaqmx.errors.DaqNotFoundError:
        with pytest.raises(MissingDependencyError, match=r"needs NI's driver NI-DAQmx; get it from ni\.com"):
            opened(estimator, cal)
    else:
        pytest.skip("NI's driver is installed here")


def test_no_nidaqmx_is_one_line_with_its_remedy(estimator, cal, monkeypatch):
    for name in [*(name for name in sys.modules if name.startswith("nidaqmx.")), "nidaqmx"]:
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(MissingDependencyError, match=r"needs nidaqmx: pip install 'probedesign\[daq\]'"):
        opened(estimator, cal)


@pytest.mark.parametrize(
    ("spec", "expected"),
    [
        ("daq:Dev1/ai0:5?cal={cal}", "write daq://Dev1/ai0:5?cal=FILE"),
        ("daq://Dev1/ai0:5", "needs its sensor's calibration; write daq://Dev1/ai0:5?cal="),
        ("daq://Dev1/ai0:5?cal=", "needs its sensor's calibration"),
        ("daq://Dev1/ai0:5?cal=none.cal", "none.cal: cannot be read as a calibration"),
        ("daq://Dev1/ai0:5?cal={cal}&cal={cal}", "cal is given twice"),
        ("daq://Dev1/ai0:4?cal={cal}", "name six inputs of one card"),
        ("daq://Dev1/ai0:2,Dev2/ai0:2?cal={cal}", "name six inputs of one card"),
        ("daq://Dev1/ao0:5?cal={cal}", "name six inputs of one card"),
        ("daq://?cal={cal}", "name six inputs of one card"),
        ("daq://Dev7/ai0:5?cal={cal}", "no card Dev7; available are Dev1, Dev2"),
        ("daq://Dev1/ai0:5?cal={cal}&rate=7", "did you mean rate_hz?"),
        ("daq://Dev1/ai0:5?cal={cal}&rate_hz=0", "rate_hz = '0' must be a number"),
    ],
)
def test_what_is_no_card(estimator, cal, driver, spec, expected):
    with pytest.raises(ProbeDesignError) as error:
        open_source(spec.format(cal=cal), estimator.model)
    assert expected in str(error.value)
    assert not driver.tasks


def test_six_inputs_may_be_listed_individually(estimator, cal, driver):
    channels = "Dev1/ai0:2,Dev1/ai8:10"
    blocks(opened(estimator, cal, channels=channels), 1)
    assert driver.asked["channel"] == channels
