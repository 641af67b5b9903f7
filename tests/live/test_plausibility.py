"""Signals that no working sensor or robot gives: each is a named fault without a position, and ends with its cause."""

import numpy as np
import pytest

from probedesign.core.errors import InputError
from probedesign.live.blocks import Block
from probedesign.live.poses.base_poses import BasePoses, TimedPose
from probedesign.live.processing.averaging import choose_averaging
from probedesign.live.processing.chain import ProcessingOptions
from probedesign.live.processing.plausibility import LEAP_HOLD
from probedesign.live.processing.tare import TareWindow
from probedesign.live.recordings.csv import write_recording
from probedesign.live.recordings.mcap_write import McapRecorder
from probedesign.live.run import estimate_recording, estimate_stream
from probedesign.live.sources.replay import ReplaySource
from probedesign.live.sources.source import open_source
from probedesign.mapping.explore import check_poses
from tests.live.mcap_files import TIME_ROUNDING
from tests.live.peers import box

RATE, SAMPLES = 2000.0, 36
FAULT = (3.0, 4.5)  #: Time of each fault [s].
#: Time after its end by which a fault must have ended [s]: noise is measured over the last quarter of a second.
MARGIN = 0.4


@pytest.fixture(scope="module")
def free(estimator):
    """Raw readings of a free probe for seven seconds, quantised as the sensor's are: times and wrenches."""
    model, rng = estimator.model, np.random.default_rng(4)
    time = np.arange(int(7.0 * RATE)) / RATE
    step = model.noise.std * np.sqrt(SAMPLES)
    still = model.to_sensor(estimator.free().wrench_base, model.gravity_base)
    return time, np.rint((still + step * rng.normal(size=(len(time), 6))) / (0.2 * step)) * 0.2 * step


def replayed(estimator, path, options):
    """The updates of a recording that is replayed, and the messages."""
    lines = []
    source = ReplaySource(estimator.model, path, "speed=max")
    return list(estimate_stream(estimator, source, options, lines.append)), lines


def during(time):
    return (time >= FAULT[0]) & (time < FAULT[1])


def frozen(wrench, inside, model):
    wrench[inside] = wrench[np.argmax(inside) - 1]


def dead(wrench, inside, model):
    wrench[inside, 4] = 0.0


def saturated(wrench, inside, model):
    wrench[inside, 1] = model.wrench_range[1]


def noisy(wrench, inside, model):
    rng = np.random.default_rng(5)
    wrench[inside] += 8.0 * model.noise.std * np.sqrt(SAMPLES) * rng.normal(size=(inside.sum(), 6))


def thousandth(wrench, inside, model):
    wrench[inside] /= 1000.0


@pytest.mark.parametrize(
    ("change", "named", "found_after"),
    [(frozen, "frozen", 0.05), (dead, "My", 0.05), (saturated, "Fy", 0.0), (noisy, "scatter", 0.3),
     (thousandth, "scatter", 0.15)],
)  # fmt: skip
def test_a_fault_in_a_file_has_no_position_and_ends(change, named, found_after, estimator, free, tmp_path):
    time, wrench = free[0], free[1].copy()
    change(wrench, during(time), estimator.model)
    write_recording(tmp_path / "fault.csv", time, wrench)
    updates, lines = replayed(estimator, tmp_path / "fault.csv", ProcessingOptions(TareWindow(0.0, 1.0), SAMPLES))
    while_it_lasts = [u for u in updates if FAULT[0] + found_after + 0.05 < u.reading.time < FAULT[1] - 0.05]
    assert while_it_lasts and all(named in u.reading.fault for u in while_it_lasts)
    assert {u.estimate.result for u in while_it_lasts} == {"out_of_range"}
    assert not [u for u in updates if u.reading.fault and u.estimate.ok]
    outside = [u for u in updates if not FAULT[0] - 0.05 < u.reading.time < FAULT[1] + MARGIN]
    assert {u.estimate.result for u in outside} == {"no_contact"}
    assert [line.split(":")[0] for line in lines if "fault" in line] == ["fault", "the fault has ended"]
    rows = estimate_recording(estimator, tmp_path / "fault.csv", TareWindow(0.0, 1.0), SAMPLES).rows
    offline = [row["result"] for row in rows]
    assert "out_of_range" in offline and offline[-1] == "no_contact"


def test_a_healthy_sensor_has_no_fault(estimator, free, tmp_path):
    write_recording(tmp_path / "free.csv", *free)
    rows = estimate_recording(estimator, tmp_path / "free.csv", TareWindow(0.0, 1.0), None).rows
    assert {row["result"] for row in rows} == {"no_contact"} and len(rows) == len(free[0]) // SAMPLES


def test_frozen_values_at_the_wire_are_a_fault_that_a_replay_has_too(estimator, tmp_path):
    """Their sequence numbers run on."""
    recorded, by_time = McapRecorder(tmp_path / "faults.mcap", estimator.model), {}
    model, lines = estimator.model, []
    still = model.to_sensor(estimator.free().wrench_base, model.gravity_base)
    with box(estimator, load=still) as peer:
        read = peer._transducer.read
        stream = estimate_stream(
            estimator, open_source(peer.source, model, lines.append),
            ProcessingOptions(TareWindow(0.0, 0.5), SAMPLES), lines.append, recorded,
        )  # fmt: skip
        for count, update in enumerate(stream, 1):
            by_time[update.reading.time] = update.reading.fault
            if count == 20:
                kept = read(np.zeros(1), peer.configuration)
                peer._transducer.read = lambda time, _, kept=kept: [np.repeat(each, len(time), 0) for each in kept]
            if count == 60:
                peer._transducer.read = read
            if count == 120:
                stream.close()
                break
    faults = list(by_time.values())
    assert any("frozen" in fault for fault in faults[20:70])
    assert not any("frozen" in fault for fault in [*faults[:19], *faults[-30:]])
    recorded.close()
    updates, _ = replayed(estimator, tmp_path / "faults.mcap", ProcessingOptions(TareWindow(0.0, 0.5), SAMPLES))
    again = {update.reading.time: update.reading.fault for update in updates}
    times = np.array(list(again))
    for time, fault in by_time.items():  # a recording keeps times to the nanosecond
        nearest = times[np.argmin(np.abs(times - time))]
        assert nearest == pytest.approx(time, abs=TIME_ROUNDING) and again[nearest] == fault


# poses


def stated(model, positions, step=0.01):
    """Poses of the base along x at each time [mm], without rotation."""
    poses = [TimedPose(i * step, (1e-3 * x, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)) for i, x in enumerate(positions)]
    return BasePoses("stated", poses, gravity_world=model.gravity_base)


def test_a_base_that_leaps_has_no_position_until_it_moves_on(estimator, free):
    """A millimetre in ten milliseconds is a slow robot; as a metre, no robot."""
    model, (time, wrench) = estimator.model, free
    x = np.zeros(701)
    x[100:200] = np.linspace(0.0, 100.0, 100)
    x[200:] = 100.0
    x[400] = 1100.0
    blocks = [Block(time, wrench, model.gravity_base, np.full(len(time), np.nan))]

    class Source:
        title, notes = "", ()

        def __iter__(self):
            yield from blocks

    lines = []
    options = ProcessingOptions(TareWindow(0.0, 0.5), SAMPLES)
    updates = list(estimate_stream(estimator, Source(), options, lines.append, poses=stated(model, x)))
    for u in (u for u in updates if u.reading.time < 6.9):
        leaping = 3.98 < u.reading.time < 4.02 + LEAP_HOLD
        near = abs(u.reading.time - 4.0) < 0.04 or abs(u.reading.time - 4.0 - LEAP_HOLD) < 0.06
        assert near or ("leapt" in u.reading.fault) == leaping == (u.estimate.result == "out_of_range")
    assert sum("the base leapt" in line for line in lines) == 1


def test_a_recording_with_positions_in_metres_is_refused(estimator):
    """0 ... 0.4 written into x_mm."""
    gravity, ends = estimator.model.gravity_base, np.array([0.0, 0.99])
    readings = [Block(ends, np.zeros((2, 6)), gravity, ends)]
    with pytest.raises(InputError, match="in metres"):
        check_poses(stated(estimator.model, np.linspace(0.0, 0.4, 100)), readings)
    check_poses(stated(estimator.model, np.linspace(0.0, 400.0, 100)), readings)


# averaging


@pytest.mark.parametrize("rate", [10.0, 50.0, 200.0, 1000.0, 7000.0])
@pytest.mark.parametrize("averaged", [1, 36])
def test_samples_and_means_are_told_apart(rate, averaged, estimator):
    model, n = estimator.model, 64
    rng = np.random.default_rng(int(rate))
    noise = model.noise.std * np.sqrt(model.averaging_samples / averaged)
    wrench = noise * rng.normal(size=(n, 6)) + np.linspace(0.0, 0.02, n)[:, None]  # while the probe is pressed
    found = choose_averaging(np.arange(n) / rate, wrench, model)
    assert found.samples == model.averaging_samples // averaged


def test_noise_beyond_that_of_samples_is_not_averaged_longer(estimator):
    """A hundred times the noise of single samples would be that of means of 360,000 samples."""
    model, rng = estimator.model, np.random.default_rng(2)
    noise = 100.0 * model.noise.std * np.sqrt(model.averaging_samples)
    found = choose_averaging(np.arange(64) / 1000.0, noise * rng.normal(size=(64, 6)), model)
    assert found.samples == model.averaging_samples and "noise of single samples" in found.summary
    assert found.duration == pytest.approx(model.averaging_samples / 1000.0)
    still = np.tile(np.arange(6.0), (64, 1))  # without noise the rate decides
    for rate, samples in ((100.0, 1), (7000.0, model.averaging_samples)):
        assert choose_averaging(np.arange(64) / rate, still, model).samples == samples


@pytest.mark.parametrize("rate", [10.0, 50.0, 194.0])
def test_noise_of_means_is_a_fault_from_the_first_reading(rate, estimator, tmp_path):
    """Eight times the stated noise, where the rate does not separate noise from motion. Eight readings find it in four
    of five cases and twelve in 98 %."""
    model, rng = estimator.model, np.random.default_rng(3)
    n = int(6.0 * rate)
    still = model.to_sensor(estimator.free().wrench_base, model.gravity_base)
    write_recording(
        tmp_path / "noisy.csv", np.arange(n) / rate, still + 8.0 * model.noise.std * rng.normal(size=(n, 6))
    )
    updates, _ = replayed(estimator, tmp_path / "noisy.csv", ProcessingOptions(samples=1, zero="trusted"))
    assert len(updates) == n and all("scatters" in u.reading.fault for u in updates)
    assert {u.estimate.result for u in updates} == {"out_of_range"}


@pytest.mark.parametrize("rate", [10.0, 25.0, 100.0])
def test_a_probe_that_sways_and_is_touched_at_a_low_rate_has_no_fault(rate, estimator, tmp_path):
    """A force of 20 mN that changes at random from reading to reading, in all three components, at 0.6 L."""
    model, rng = estimator.model, np.random.default_rng(6)
    n = int(20.0 * rate)
    s = 0.6 * model.rod.length
    arm = np.array([[0.0, -s, 0.0], [s, 0.0, 0.0], [0.0, 0.0, 0.0]])
    force = 0.02 * rng.normal(size=(n, 3))
    wrench = estimator.free().wrench_base + np.hstack([force, force @ arm.T])
    read = model.to_sensor(wrench, model.gravity_base) + model.noise.std * rng.normal(size=(n, 6))
    write_recording(tmp_path / "swaying.csv", np.arange(n) / rate, read)
    updates, _ = replayed(estimator, tmp_path / "swaying.csv", ProcessingOptions(samples=1, zero="trusted", rate=2.0))
    assert updates and not any(u.reading.fault for u in updates)


def test_raw_samples_without_averaging_are_a_fault(estimator, free, tmp_path):
    """`--average 1` for single samples: their noise is six times that of the model's means. Sixteen show it surely, so
    that only the first estimate may precede it."""
    write_recording(tmp_path / "raw.csv", *free)
    updates, _ = replayed(
        estimator, tmp_path / "raw.csv", ProcessingOptions(samples=1, rate=5.0, seconds=3.0, zero="trusted")
    )
    assert {u.estimate.result for u in updates[1:]} == {"out_of_range"}
    assert "averaged" in updates[1].reading.fault


# the zero


@pytest.fixture(scope="module")
def mounted(estimator, free, tmp_path_factory):
    """Means of a free probe whose bias was taken with the probe mounted, a step of the resolution off."""
    time, wrench = free[0][::SAMPLES][:-1], free[1][: SAMPLES * (len(free[0]) // SAMPLES)]
    means = wrench.reshape(-1, SAMPLES, 6).mean(axis=1)[: len(time)]
    step = estimator.model.noise.std * np.sqrt(SAMPLES)
    means = means - estimator.model.to_sensor(estimator.free().wrench_base, estimator.model.gravity_base) + step
    path = tmp_path_factory.mktemp("zero") / "mounted.csv"
    write_recording(path, time[: len(means)], means)
    return path


@pytest.mark.parametrize(("zero", "result"), [("checked", "no_tare"), ("auto", "no_contact")])
def test_a_zero_that_was_never_taken_has_no_position_and_an_automatic_tare_takes_the_first_rest(
    estimator, mounted, zero, result
):
    rows = estimate_recording(estimator, mounted, zero=zero).rows
    assert {row["result"] for row in rows} == {result}
    updates, lines = replayed(estimator, mounted, ProcessingOptions(zero=zero))
    assert {u.estimate.result for u in updates} == {result}
    if zero == "auto":
        assert updates[0].reading.time == pytest.approx(1.0, abs=0.1)
    else:
        assert {u.phase for u in updates} == {""} and sum("--tare auto" in line for line in lines) == 1


def test_an_automatic_tare_waits_for_rest_and_names_its_reason_without_a_window(estimator, mounted, tmp_path):
    """A channel that moves for the first three seconds is not at rest; one that moves throughout has no rest."""
    readings = [r for block in ReplaySource(estimator.model, mounted, "speed=max") for r in block.readings()]
    for path, end in ((tmp_path / "moved.csv", 3.0), (tmp_path / "moving.csv", np.inf)):
        moved = [r.wrench_sensor + 1e-3 * np.sin(9.0 * r.time) * (r.time < end) * np.eye(6)[4] for r in readings]
        write_recording(path, [r.time for r in readings], moved)
    _, lines = replayed(estimator, tmp_path / "moved.csv", ProcessingOptions(zero="auto"))
    waits = [line for line in lines if "waits for" in line]
    assert len(waits) == 1 and "My scatters by" in waits[0]
    tare = estimate_recording(estimator, tmp_path / "moved.csv", zero="auto").tare
    assert tare is not None and 2.5 < tare.window.start < 4.5
    for run in (
        lambda: estimate_recording(estimator, tmp_path / "moving.csv", zero="auto"),
        lambda: replayed(estimator, tmp_path / "moving.csv", ProcessingOptions(zero="auto")),
    ):
        with pytest.raises(InputError, match="no 1 s at rest: My scatters by") as error:
            run()
        assert "window" not in str(error.value)
