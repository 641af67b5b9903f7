"""The chain on a probe that a moving base presses against an edge, the rod solved in reference mode."""

from dataclasses import replace

import numpy as np
import pytest

from probedesign.core.errors import InputError
from probedesign.core.frames import pose
from probedesign.estimation.bias import WALK_STEPS
from probedesign.estimation.estimator import Estimator
from probedesign.live.blocks import Block
from probedesign.live.datagrams import decode_object
from probedesign.live.poses.base_poses import BasePoses, TimedPose, pose_from_matrix
from probedesign.live.poses.open import open_poses
from probedesign.live.poses.pose_sources import parse_pose
from probedesign.live.processing.chain import Chain, ProcessingOptions
from probedesign.live.processing.estimates import estimate_row, json_line, world_row
from probedesign.live.processing.tare import Tare, TareWindow
from probedesign.live.processing.touches import SPAN
from probedesign.live.recordings.mcap_write import McapRecorder
from probedesign.live.run import estimate_stream
from probedesign.live.sources.replay import ReplaySource
from probedesign.rod.contact import solve_frictionless
from probedesign.simulation import scenes
from probedesign.simulation.netft_box import (
    CYCLE_DWELL_TIME,
    MOVE_TIME,
    PRESS_TIME,
    REST_TIME,
    BaseMotion,
    SimulatedRobot,
)

RATE, SAMPLES = 500.0, 5  #: Of single samples [Hz], and to a mean: a hundred means a second.
BIAS = np.array([0.3, -0.2, 0.5, 0.002, -0.003, 0.001])
UPRIGHT = (0.0, 0.0, 0.0, 1.0)


@pytest.fixture(scope="module")
def motion(estimator):
    """Rest, onto one edge at 0.6 of the length, hold, off it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(scenes.SCENES, "edge", (scenes.SceneObject("edge", 0.6, 0.0),))
        return BaseMotion(estimator.model, scenes.press_scene(estimator.model, "edge", friction=0.0))


def blocks(model, wrench_sensor, time, size=25, seed=1, walk=0.0):
    """Blocks of single samples with their noise, of (n, 6) at (n,); `walk` of their bias in a second, over it."""
    rng, std = np.random.default_rng(seed), np.sqrt(np.diag(model.noise.cov) * SAMPLES)
    read = wrench_sensor + std * rng.standard_normal((len(time), 6))
    read += walk * std * np.cumsum(rng.standard_normal((len(time), 6)), axis=0) / np.sqrt(RATE)
    for i in range(0, len(time), size):
        part = slice(i, i + size)
        unknown = np.full(len(time[part]), np.nan)
        yield Block(time[part], read[part], model.gravity_base, unknown)


def touch(motion, **options):
    time = np.arange(int((motion.cycle_time + 1.0) * RATE)) / RATE
    return blocks(motion.model, motion.wrench_sensor(time) + BIAS, time, **options)


def reported_poses(motion, late=0.0, latency=0.0):
    """Poses as a robot sends them, 125 per second, each with a time stamp that is late [s]."""
    time = np.arange(-0.2, motion.cycle_time + 1.2, 1.0 / 125.0)
    p = motion.p_world_base(np.maximum(time, 0.0))
    stated = [TimedPose(t + late, tuple(at), UPRIGHT) for t, at in zip(time.tolist(), p.tolist(), strict=True)]
    return BasePoses("stated", stated, latency=latency, gravity_world=motion.model.gravity_base)


def run(estimator, stream, poses=None, plan=None, ask=()):
    """Answers, events and the chain; `ask` holds times at which a tare is asked for."""
    lines, asked = [], list(ask)
    chain = Chain(estimator, plan or ProcessingOptions(TareWindow(0.0, 2.0), SAMPLES, 25.0), poses, lines.append)
    answers = []
    for block in stream:
        answers += chain.process(block)
        if asked and block.time[-1] >= asked[0]:
            asked.pop(0)
            try:
                lines.append(chain.take_tare())
            except InputError as error:
                lines.append(f"tare refused: {error}")
    return [*answers, *chain.finish()], lines, chain


@pytest.fixture(scope="module")
def touched(estimator, motion):
    return run(estimator, touch(motion), reported_poses(motion))


def test_the_touched_point_lies_in_its_ellipsoid_of_the_world(estimator, motion, touched):
    """A Gaussian's lies there in 999 of 1000 cases: χ² of three degrees of freedom below 16.3."""
    _, _, chain = touched
    (contact,) = chain.contacts
    assert contact.settled and contact.fused.ok
    off = contact.fused.p_surface_world - motion.objects[0].point
    assert off @ np.linalg.solve(contact.fused.cov_surface_world, off) < 16.3
    # One reading alone knows this touch to 2 mm. The simulated object is rigid, and the probe straight.
    known = replace(estimator.priors, object_compliance=0.0, bow_mm=0.0, pose_deg=0.0)
    (contact,) = run(Estimator(estimator.model, known), touch(motion), reported_poses(motion))[2].contacts
    assert contact.fused.ok and contact.fused.rms < 1e-3


def test_the_phases_are_those_of_figure_8(motion, touched):
    answers, lines, chain = touched
    order = [a.phase for a, b in zip(answers[1:], answers, strict=False) if a.phase != b.phase]
    assert order == ["moving", "touching", "settled", "touching", "released", "moving", "free"]
    time = {phase: [a.reading.time for a in answers if a.phase == phase] for phase in set(order)}
    pressed = REST_TIME + MOVE_TIME + PRESS_TIME  # where the base begins to hold
    # The whole span must be still; a mean lies half its length, 5 ms, before its last sample.
    assert pressed + SPAN - 0.01 <= time["settled"][0] <= pressed + 1.5 * SPAN
    assert time["settled"][-1] <= pressed + CYCLE_DWELL_TIME + SPAN
    assert any(line.startswith("touch 1, ") and "mm in world" in line for line in lines)
    assert not chain.contacts[0].ongoing


def test_without_poses_there_is_no_place_in_the_world(estimator, motion, touched):
    answers, _, chain = run(estimator, touch(motion))
    assert {a.fused for a in answers} == {None}
    assert all(np.isnan(a.T_world_base).all() and a.stale == "" for a in answers)
    assert chain.contacts[0].settled and chain.contacts[0].estimate.ok
    # The base does not turn here, so each estimate is the one with poses.
    for mine, other in zip(answers, touched[0], strict=True):
        if other.estimate.result == "in_motion":  # what moves is known from poses alone
            continue
        # In motion the bias is not followed, which differs by a fraction of its uncertainty.
        off = abs(mine.estimate.s_contact - other.estimate.s_contact)
        assert mine.estimate.result == other.estimate.result and not off > 0.2 * other.estimate.std_s


@pytest.mark.parametrize("size", [7, 1000])
def test_the_size_of_the_blocks_changes_nothing(size, estimator, motion):
    def short(size):
        stream = (b for b in touch(motion, size=size) if b.time[-1] < 3.0)
        return run(estimator, stream, reported_poses(motion), ProcessingOptions(TareWindow(0.0, 0.5), SAMPLES))[0]

    answers, like = short(size), short(25)
    fewest = min(len(answers), len(like))
    assert fewest >= 150  # of 1.5 s at least; blocks of 1000 end there
    for mine, other in zip(answers[:fewest], like[:fewest], strict=True):
        assert mine.reading.time == other.reading.time and mine.phase == other.phase
        assert mine.estimate.detection_chi2 == other.estimate.detection_chi2
        assert np.array_equal(mine.wrench_base, other.wrench_base)


def test_poses_whose_latency_is_stated_are_taken_for_true(estimator, motion, touched):
    answers, _, _ = run(estimator, touch(motion), reported_poses(motion, late=0.060, latency=0.060))
    last, same = (a[-1].contacts[0].fused for a in (answers, touched[0]))
    # The same poses at the same times, but for the rounding of time to nanoseconds: 1e-9 s at 13 mm/s.
    assert last.p_contact_world == pytest.approx(same.p_contact_world, abs=1e-9)


def turning(model, seconds):
    """The free probe on a base that turns by a right angle about y and by another about z: readings, and poses."""
    time = np.arange(int(seconds * RATE)) / RATE
    share = np.clip((time - 1.0) / (seconds - 2.0), 0.0, 1.0) * np.pi / 2.0
    turns = [_about_y(a) @ _about_z(a) for a in share]
    gravities = [R.T @ model.gravity_base for R in turns]
    steps = {a: model.rod.solve(g).wrench_base for a, g in zip(share, gravities, strict=True)}
    wrench = [model.to_sensor(steps[a], g) for a, g in zip(share, gravities, strict=True)]
    poses = [pose_from_matrix(t, pose(R)) for t, R in zip(time[::4].tolist(), turns[::4], strict=True)]
    return time, np.array(wrench), BasePoses("turning", poses, gravity_world=model.gravity_base)


def _about_y(a):
    return np.array([[np.cos(a), 0.0, np.sin(a)], [0.0, 1.0, 0.0], [-np.sin(a), 0.0, np.cos(a)]])


def _about_z(a):
    return np.array([[np.cos(a), -np.sin(a), 0.0], [np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]])


@pytest.fixture(scope="module")
def turned(estimator):
    return turning(estimator.model, 6.0)


def test_free_probe_has_no_contact_at_any_orientation(estimator, turned):
    """A mean of five samples that turn with 0.4 rad/s is off by a hundredth of its noise; the chance that one of 600
    free readings is called a contact is 1e-3."""
    time, wrench, poses = turned
    stream = blocks(estimator.model, wrench, time)
    answers, _, chain = run(estimator, stream, poses, ProcessingOptions(TareWindow(0.0, 0.9), SAMPLES))
    known = [a for a in answers if not a.stale]
    # The base jumps to 0.5 rad/s at 1 s and to rest at 5 s, which would make a probe sway for a while.
    steady = [a for a in known if not any(at <= a.reading.time < at + 1.5 for at in (1.0, 5.0))]
    assert len(known) > 480 and {a.estimate.result for a in known} <= {"no_contact", "in_motion"}
    assert len(steady) > 250 and {a.estimate.result for a in steady} == {"no_contact"}
    assert "moving" in {a.phase for a in known} and chain.contacts == ()


def test_without_a_pose_there_is_no_number(estimator, motion):
    """Poses lack from 1.0 to 1.4 s and from 1.8 s on."""
    all_poses = reported_poses(motion)
    stated = [
        TimedPose(t, tuple(all_poses.at(t)[:3, 3]), UPRIGHT) for t in all_poses.track.times if t < 1.0 or 1.4 < t < 1.8
    ]
    stream = (b for b in touch(motion) if b.time[-1] < 2.5)
    poses = BasePoses("with a gap", stated, gravity_world=motion.model.gravity_base)
    answers, lines, _ = run(estimator, stream, poses, ProcessingOptions(TareWindow(0.0, 0.5), SAMPLES))
    for a in answers:
        lacks = 1.0 <= a.reading.time < 1.4 or a.reading.time >= 1.8
        edge = min(abs(a.reading.time - at) for at in (1.0, 1.4, 1.8)) < 0.01  # poses are 8 ms apart
        if edge:
            continue
        assert (a.stale == "pose") == lacks == (a.estimate.result == "out_of_range")
        assert a.fused.result == ("out_of_range" if lacks else "no_contact")
        assert np.isnan(a.wrench_base).all() == np.isnan(a.T_world_base).all() == lacks
    assert [line.split(":")[0].split(" at ")[0] for line in lines if "pose" in line] == [
        "no pose of the base",
        "the base pose is available again",
        "no pose of the base",
    ]


def test_a_requested_tare_is_taken_while_free_and_refused_during_contact_and_where_one_begins(estimator, motion):
    stream = (b for b in touch(motion) if b.time[-1] < 8.5)
    _, lines, chain = run(estimator, stream, reported_poses(motion), ask=[2.5, 2.7, 4.9, 7.9])
    stated = [line for line in lines if line.startswith("tare")]
    assert stated[0].startswith("tare from 200 readings in 0:2 s: Fx 30")
    assert stated[1] == stated[4] == "tare: keep the probe free and still for 2 s"
    assert stated[2] == "tare refused: a tare is already being taken"
    assert stated[3].startswith("tare from 200 readings in 2.5")
    assert stated[5].startswith("tare refused: the probe is moving")
    refusals = {f"tare refused: the probe is {p}; the previous tare is kept" for p in ("touching", "settled")}
    assert stated[6].split(", unless")[0] in refusals and stated[6].endswith('asked for with "force"')
    assert len(stated) == 7 and chain.tare.window.start == pytest.approx(2.5, abs=0.1)
    noise = estimator.model.noise.std
    assert (np.abs(chain.tare.bias_sensor - BIAS) < 5.0 * noise / np.sqrt(200.0)).all()


def test_the_first_tare_may_be_requested(estimator, motion):
    """Before it there is neither a phase nor a position: a bias would look like a touch."""
    stream = (b for b in touch(motion) if b.time[-1] < 4.0)
    answers, _, chain = run(estimator, stream, None, ProcessingOptions(samples=SAMPLES, rate=1.0), ask=[1.0])
    assert chain.tare is not None and answers[-1].estimate.result == "no_contact"
    assert (answers[1].phase, answers[1].estimate.result) == ("", "no_tare") and answers[-1].phase == "free"


def test_a_requested_tare_is_refused_in_a_touch_when_the_zero_is_that_of_the_sensor(estimator, motion):
    """A tare then would make the touch the zero, and the free probe a touch."""
    time = np.arange(int(9.0 * RATE)) / RATE
    stream = blocks(motion.model, motion.wrench_sensor(time), time)  # zeroed without the probe: no bias
    options = ProcessingOptions(samples=SAMPLES, rate=1.0)
    _, lines, chain = run(estimator, stream, reported_poses(motion), options, ask=[7.9])
    assert any(line.startswith("tare refused: the probe is") for line in lines) and chain.tare is None


def test_the_age_of_a_tare_taken_beforehand_counts(estimator, motion):
    """A touch of 20 mN is lost in the drift of a thousand seconds."""
    time = np.arange(int(1.0 * RATE)) / RATE
    touched = np.tile(
        estimator.model.to_sensor(motion_wrench(estimator, 0.02), estimator.model.gravity_base), (len(time), 1)
    )
    stds = []
    for age in (0.0, 1000.0):
        tare = Tare(np.zeros(6), 100, TareWindow(0.0, 1.0), -age)
        lines: list[str] = []
        chain = Chain(estimator, ProcessingOptions(samples=SAMPLES), None, lines.append, tare)
        first = next(u for b in blocks(estimator.model, touched, time) for u in chain.process(b))
        stds.append((first.estimate.result, first.estimate.std_s))
    assert stds[0][0] == "ok"
    assert stds[1][0] != "ok" or stds[1][1] > 1.5 * stds[0][1]


def motion_wrench(estimator, force):
    """Wrench about the base of a touch at 0.6 of the length [N, N·m], (6,)."""
    found = solve_frictionless(
        estimator.model.rod, estimator.model.gravity_base, 0.6 * estimator.model.rod.length, 1.57, force
    )
    return found.equilibrium.wrench_base


def test_a_sample_at_its_limit_spoils_its_mean(estimator, motion):
    """One of five at the full range, far within it in the mean."""

    def spoiled():
        for block in touch(motion):
            wrench = block.wrench_sensor.copy()
            if block.time[0] <= 0.5 < block.time[-1]:
                wrench[3, 1] = estimator.model.wrench_range[1]
            yield Block(block.time, wrench, block.gravity_base, block.received)
            if block.time[-1] > 1.0:
                return

    answers, _, _ = run(estimator, spoiled(), None, ProcessingOptions(TareWindow(0.0, 0.3), SAMPLES))
    bad = [a for a in answers if a.reading.fault]
    assert len(bad) == 1 and bad[0].estimate.result == "out_of_range" and bad[0].phase == ""


@pytest.mark.parametrize("seed", range(2))
def test_a_bias_that_walks_is_no_touch(seed, estimator, motion):
    """As fast as the test for touches allows for: since the tare, and over a touch in which nothing could follow it."""
    _, _, chain = run(estimator, touch(motion, walk=WALK_STEPS, seed=seed))
    assert len(chain.contacts) == 1 and chain.contacts[0].settled


def test_poses_of_the_simulated_robot_are_received_in_an_upright_world(motion):
    """What it sends, read as a robot's: gravity is down there, and the way is the base's."""
    model = motion.model
    robot = SimulatedRobot(motion, float, "127.0.0.1:1")
    stated = [parse_pose(decode_object(robot.datagram(t, t))).value for t in (0.0, 7.0, 7.01)]
    poses = BasePoses("robot", stated)
    assert poses.gravity(poses.at(0.0)) == pytest.approx(model.gravity_base, abs=1e-9)
    way = poses.at(7.0)[:3, :3].T @ (poses.at(7.0) - poses.at(0.0))[:3, 3]
    assert way == pytest.approx(motion.p_world_base(np.array([7.0]))[0], abs=1e-12)


@pytest.mark.parametrize("to", ["", "127.0.0.1", ":1", "127.0.0.1:0", "127.0.0.1:port"])
def test_a_robot_needs_an_address(to, motion):
    with pytest.raises(InputError, match="--pose-to"):
        SimulatedRobot(motion, float, to)


class Heard:
    """Poses as a robot sends them, 7 s ahead of the wrench's clock, each received 4 ms after its stamp."""

    def __init__(self, motion):
        stated = np.arange(-0.2, motion.cycle_time + 1.2, 1.0 / 125.0)
        at = motion.p_world_base(np.maximum(stated, 0.0))
        self._waiting = [TimedPose(t + 7.0, tuple(p), UPRIGHT) for t, p in zip(stated, at.tolist(), strict=True)]
        self.now = 0.0

    summary = "all"

    def pop_messages(self):
        return []

    def pop(self):
        while self._waiting and self._waiting[0].time - 7.0 + 0.004 <= self.now:
            pose = self._waiting.pop(0)
            yield pose.time - 7.0 + 0.004, pose, 0

    def close(self):
        pass


def test_a_recording_contains_the_received_poses_and_replays_exactly(estimator, motion, tmp_path, monkeypatch):
    """Another clock, a latency, poses from before the first reading; then the recording is its own --pose."""
    path, heard = tmp_path / "touch.mcap", Heard(motion)
    # every reading is in time
    monkeypatch.setattr("probedesign.live.processing.chain.monotonic", lambda: 0.0)
    down = ",".join(map(repr, motion.model.gravity_base.tolist()))
    poses = BasePoses("heard", heard, latency=0.004, gravity_world=motion.model.gravity_base)
    file, plan = McapRecorder(path, estimator.model), ProcessingOptions(TareWindow(0.0, 2.0), SAMPLES, 25.0)
    poses.on_pose = file.on_pose

    def stream():
        for block in touch(motion):
            heard.now = float(block.time[-1])
            yield replace(block, received=block.time)

    def stated(source, poses, sink=None):
        answers = estimate_stream(estimator, source, plan, print, sink, None, poses)
        return [json_line(estimate_row(a.reading, a.estimate) | world_row(a)) for a in answers]

    live = stated(stream(), poses, file)
    file.close()
    replay = ReplaySource(estimator.model, path, "speed=max")
    assert stated(replay, open_poses(str(path), gravity_world=down)) == live
    assert sum('"fused_result": "ok"' in line for line in live) > 25


def hum(time):
    """Hum of 3 mN in Fx and 0.3 N·mm in My at 50.02 Hz, (n, 6)."""
    return np.sin(2.0 * np.pi * 50.02 * time)[:, None] * np.array([3e-3, 0.0, 0.0, 0.0, 3e-4, 0.0])


@pytest.mark.parametrize("mains", [None, 50.0])
def test_hum_of_the_mains_is_stated_and_removed_by_means_of_whole_periods(estimator, motion, mains):
    time = np.arange(int((motion.cycle_time + 1.0) * RATE)) / RATE
    plan = ProcessingOptions(TareWindow(0.0, 2.0), None if mains else SAMPLES, 25.0, mains_hz=mains)
    stream = blocks(motion.model, motion.wrench_sensor(time) + hum(time) + BIAS, time)
    if mains is None:
        with pytest.raises(InputError, match=r"window.*; hum of the mains, 0.3 Nmm in My; with --mains-hz 50"):
            run(estimator, stream, reported_poses(motion), plan)
        return
    _, lines, chain = run(estimator, stream, reported_poses(motion), plan)
    assert "whole periods of 50 Hz: 10 are averaged to one" in lines
    (contact,) = chain.contacts
    assert contact.settled and contact.fused.ok
    off = contact.fused.p_surface_world - motion.objects[0].point
    assert off @ np.linalg.solve(contact.fused.cov_surface_world, off) < 16.3  # as without hum


def test_mains_need_a_rate_and_exclude_another_average(estimator, motion):
    time = np.arange(200) / 60.0
    stream = blocks(motion.model, np.tile(BIAS, (200, 1)), time)
    with pytest.raises(InputError, match="--mains-hz 50 needs 100 readings a second or more; these are 60"):
        run(estimator, stream, plan=ProcessingOptions(TareWindow(0.0, 1.0), None, mains_hz=50.0))
    with pytest.raises(InputError, match="exclude each other"):
        ProcessingOptions(samples=5, mains_hz=50.0)


def test_every_reading_of_a_burst_is_located(estimator, motion, monkeypatch):
    """Those of 0.1 s at once, which take 3 ms each: the last is 60 ms old when its turn comes."""
    now, stream = [0.0], touch(motion, size=50)
    monkeypatch.setattr("probedesign.live.processing.chain.monotonic", lambda: now[0])

    def bursts():
        for block in stream:
            now[0] = float(block.time[-1])
            yield replace(block, received=np.full(len(block), now[0]))

    for deadline, all_of_them in ((None, True), (0.012, False)):
        lines = []
        plan = ProcessingOptions(TareWindow(0.0, 2.0), SAMPLES, 100.0, deadline=deadline)
        chain, stream, now[0] = Chain(estimator, plan, None, lines.append), touch(motion, size=50), 0.0
        for block in bursts():
            for _ in chain.process(block):
                now[0] += 0.003
        list(chain.finish())
        assert (chain.scheduler.n_skipped == 0) == all_of_them
