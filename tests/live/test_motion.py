"""A moving base is no touch: truth by the modes of a beam, which the estimator does not use, and by rigid bodies."""

import math

import numpy as np
import pytest

from probedesign.core.frames import pose
from probedesign.live.blocks import Block
from probedesign.live.poses.base_poses import BasePoses, TimedPose, pose_from_matrix
from probedesign.live.processing.chain import Chain, ProcessingOptions
from probedesign.live.processing.motion import DAMPING, LIMIT, SPAN, MotionMonitor, fit_sway
from probedesign.live.processing.tare import TareWindow
from probedesign.live.processing.touches import StationarityTest
from probedesign.simulation import scenes
from tests.reference.beam import SwayingBeam

RATE = 2000.0  #: Of the samples [Hz].
QUIET = 3.0  #: Time before a motion, with a tare of 2 s [s].
ALONG = np.array([0.6, 0.64, 0.48])


def jerk_limited(t, duration, distance):
    x = np.clip(t / duration, 0.0, 1.0)
    return distance * x**3 * (10.0 - 15.0 * x + 6.0 * x**2)


def readings(model, travel, along, wrench, damping, rng, held=None):
    """Of the sensor (n, 6): quasi-static wrench (n, 6), sway by base and impact, inertia of the payload, and noise."""
    a = np.gradient(np.gradient(travel, 1.0 / RATE), 1.0 / RATE)
    beam = SwayingBeam.of(model.rod)
    load = beam.base_load(a, RATE, damping)
    if held is not None:
        at, s = held
        load[at:] = SwayingBeam.of(model.rod, s).base_load(a[at:], RATE, damping, RATE * (travel[at] - travel[at - 1]))
    x, y, z = along
    sway = np.stack(
        [x * load[:, 0], y * load[:, 0], -z * beam.rigid[0] * a, -y * load[:, 1], x * load[:, 1], 0.0 * a], 1
    )
    read = (
        model.to_sensor(wrench + sway, np.zeros(3))
        + (model.gravity_base - np.outer(a, along)) @ model.payload_by_gravity.T
    )
    return read + model.noise.std * math.sqrt(model.averaging_samples) * rng.standard_normal(read.shape)


def run(estimator, travel, along, read):
    model, t = estimator.model, np.arange(len(travel)) / RATE
    p = travel[::16, None] * along
    stated = [TimedPose(at, tuple(x), (0.0, 0.0, 0.0, 1.0)) for at, x in zip(t[::16].tolist(), p.tolist(), strict=True)]
    poses = BasePoses("stated", stated, gravity_world=model.gravity_base)
    chain, updates = Chain(estimator, ProcessingOptions(TareWindow(0.0, 2.0), 36), poses, lambda line: None), []
    for i in range(0, len(t), 100):
        part = slice(i, i + 100)
        updates += chain.process(Block(t[part], read[part], model.gravity_base, np.full(len(t[part]), math.nan)))
    return [*updates, *chain.finish()], chain


@pytest.mark.parametrize("noise", [0.0, 1.0])
@pytest.mark.parametrize("hertz", [7.0, 12.0, 25.0])
def test_a_sway_is_fitted_beside_a_parabola(hertz, noise):
    """Two modes of one frequency in two planes, 20 standard deviations, at 56 readings a second for a quarter of one.

    Without noise it is found to the last digits. Seven unknowns in 84 readings leave √(12/84) of the noise.
    """
    rng, k = np.random.default_rng(1), np.arange(14)
    wave = np.exp((-0.05 + 1j) * 2.0 * math.pi * hertz / 56.0 * k)
    sway = (20.0 * wave[:, None] * (rng.normal(size=6) + 1j * rng.normal(size=6))).real
    values = sway + np.outer(1.0 + 0.3 * k - 0.02 * k**2, rng.normal(size=6)) + noise * rng.normal(size=(14, 6))
    fitted, left = fit_sway(values, k)
    assert np.sqrt(np.mean((fitted - sway) ** 2)) < (0.6 if noise else 1e-4)
    assert left == pytest.approx(noise * (6 * 9 - 2), abs=1e-6 + noise * 3.0 * math.sqrt(2.0 * 52.0))


@pytest.mark.parametrize("extra", [0, 3])
def test_the_sway_of_single_readings_is_that_of_their_means(extra, model):
    """A thousand readings a second, of which four make a value of the span: a mean over 4 ms has less of 13 Hz by half
    a percent. The base moves on with a constant speed; where it shakes by a tenth of a millimetre, nothing is known."""
    t = np.arange(256 + extra) / 1000.0
    wave = np.exp((-4.0 + 2j * math.pi * 13.0) * t)
    sway = 50.0 * model.noise.std * wave.real[:, None]
    readings = sway + model.noise.std * np.stack([t, t * t, t, t, t * t, t], axis=1)
    for shake in (0.0, 1e-4):
        stationarity = StationarityTest(model, 1000.0)
        for time, reading in zip(t.tolist(), readings, strict=True):
            x = 0.02 * time + shake * math.sin(2.0 * math.pi * 13.0 * time)
            stationarity.update(reading, pose(np.eye(3), np.array([x, 0.0, 0.0])))
        found = stationarity.sway(20, 0.05)
        if shake:
            assert found is None
        else:
            assert (np.abs(found - sway[-20:]) < 0.01 * np.abs(sway).max(axis=0)).all()


@pytest.mark.parametrize(("duration", "damping"), [(0.5, 0.05), (0.5, 0.1), (1.0, 0.05), (2.0, 0.1), (4.0, 0.05)])
def test_moves_of_a_free_probe_are_no_touches(duration, damping, estimator, model):
    """100 mm there and back. The sway ends within the stated time, after which everything is free again."""
    t = np.arange(int((QUIET + 2.0 * duration + 6.0) * RATE)) / RATE - QUIET
    travel = jerk_limited(t, duration, 0.1) - jerk_limited(t - duration - 1.5, duration, 0.1)
    free = np.tile(model.rod.solve(model.gravity_base).wrench_base, (len(t), 1))
    read = readings(model, travel, ALONG, free, damping, np.random.default_rng(1))
    updates, chain = run(estimator, travel, ALONG, read)
    assert chain.contacts == ()
    assert {u.estimate.result for u in updates} <= {"no_contact", "in_motion"}
    assert not any(u.fused.ok for u in updates)
    if duration <= 1.0:  # 0.6 m/s² and more move the readings by 4 mN and more
        assert "in_motion" in {u.estimate.result for u in updates}
        assert "moving" in {u.phase for u in updates if u.estimate.result == "in_motion"}
    end = QUIET + 2.0 * duration + 1.5
    (last,) = [u for u in updates if u.reading.time > end + SPAN][:1]
    rest = last.reading.time + last.time_to_rest
    after = [u for u in updates if u.reading.time > rest + SPAN]
    assert len(after) > 10 and {(u.phase, u.estimate.result) for u in after} == {("free", "no_contact")}
    assert all(u.time_to_rest == 0.0 for u in after)


@pytest.mark.parametrize(("speed", "damping"), [(0.02, 0.1), (0.05, 0.05), (0.1, 0.05)])
def test_a_fast_press_is_located_soon_after_it_stops(speed, damping, estimator, model, monkeypatch):
    """An edge at 0.6 of the length, hit from 40 mm away: located for good 0.7 s after the stop, of which the poses and
    the contact test take 0.25 s each, with the error at rest, and within the ellipsoid (χ² of three degrees of freedom
    below 16.3 in 999 of 1000 cases). The sway after 100 mm/s is then up to 60 standard deviations of a reading."""
    monkeypatch.setitem(scenes.SCENES, "edge", (scenes.SceneObject("edge", 0.6, 0.0),))
    (pressed,) = scenes.press_scene(model, "edge", friction=0.0)
    distance, ramp = 0.04 + float(pressed.travel[-1]), speed / 2.0
    stop = distance / speed + ramp
    t = np.arange(int((QUIET + stop + 2.0) * RATE)) / RATE - QUIET
    c = np.clip(t, 0.0, stop)
    up, down = np.minimum(c, ramp), np.maximum(c - stop + ramp, 0.0)
    travel = (up**2 - down**2) + speed * np.maximum(c - ramp, 0.0) - 0.04  # 2 m/s²
    wrench = np.stack([np.interp(travel, pressed.travel, pressed.wrench_base[:, i]) for i in range(6)], axis=1)
    hit = int(np.argmax(np.linalg.norm(wrench - wrench[0], axis=1) > 1e-7))
    read = readings(
        model, travel, pressed.direction, wrench, damping, np.random.default_rng(2), (hit, 0.6 * model.rod.length)
    )
    updates, chain = run(estimator, travel, pressed.direction, read)
    assert {u.estimate.result for u in updates if u.reading.time < QUIET + t[hit]} <= {"no_contact", "in_motion"}
    assert not any(u.fused.ok for u in updates if u.reading.time < QUIET + t[hit])
    later = [u for u in updates if u.reading.time > QUIET + stop + 0.7]
    assert {u.fused.result for u in later} == {"ok"} and len(chain.contacts) == 1
    assert {u.estimate.result for u in later[-10:]} == {"ok"}
    # Fourteen readings of the span know the place nearly as well as a hundred.
    assert later[0].fused.rms < 1.3 * later[-1].fused.rms
    for u in later:
        off = u.fused.p_surface_world - pressed.point
        assert off @ np.linalg.solve(u.fused.cov_surface_world, off) < 16.3


def monitor(model, positions, rotations=None):
    """A monitor after poses at 125 Hz."""
    t = np.arange(len(positions)) / 125.0
    turns = rotations if rotations is not None else [np.eye(3)] * len(t)
    poses = [pose_from_matrix(float(at), pose(R, p)) for at, R, p in zip(t, turns, positions, strict=True)]
    followed = MotionMonitor(model, BasePoses("stated", poses, gravity_world=(0.0, 0.0, -9.81)))
    for at in t[:-1].tolist():
        followed.update(at)
    return followed, poses[-2]


def test_a_constant_acceleration_is_gravity_and_is_explained(model):
    """0.2 m/s² for 4 s: the sway of its beginning, 20 noises, has died away with exp(-ζ ω t), a four-thousandth."""
    t = np.arange(500) / 125.0
    followed, _ = monitor(model, 0.1 * t[:, None] ** 2 * np.array([1.0, 0.0, 0.0]))
    # Between poses 8 ms apart the straight line is off by a Δt²/8 = 1.6 µm, a thousandth over the span.
    assert followed.gravity(np.eye(4)) == pytest.approx([-0.2, 0.0, -9.81], abs=2e-4)
    assert followed.explained and followed.time_to_rest == 0.0


def test_a_base_at_rest_has_no_motion(model):
    """Poses that scatter by 5 µm: nothing is derived from them, and gravity is exactly that of the pose."""
    followed, _ = monitor(model, 5e-6 * np.random.default_rng(1).standard_normal((200, 3)))
    assert followed.sway == followed.speed == followed.time_to_rest == 0.0
    assert np.array_equal(followed.gravity(np.eye(4)), [0.0, 0.0, -9.81])


def test_the_time_to_rest_follows_its_formula(model):
    """After a stop from 50 mm/s it counts down: the sway decays as exp(-ζ ω t)."""
    positions = 0.05 * np.minimum(np.arange(200) / 125.0, 1.0)[:, None] * np.array([1.0, 0.0, 0.0])
    early, late = (monitor(model, positions[:n])[0] for n in (150, 190))
    assert early.time_to_rest - late.time_to_rest == pytest.approx(40 / 125.0, abs=0.02)  # up to a step of 10 ms
    assert late.time_to_rest == pytest.approx(math.log(late.sway / LIMIT) / (DAMPING * 2.0 * math.pi * 6.60), rel=2e-3)


def test_rod_and_payload_of_a_turning_base_obey_newton_and_euler(model):
    """Eight point masses with the mass properties of the payload, and the sections of the rod, on a base that turns
    about a tilted axis with constant angular acceleration through a small angle: their inertia, less that of the
    effective gravity."""
    payload, axis, alpha = model.payload, np.array([0.6, 0.0, 0.8]), 2.0
    t = np.arange(40) / 125.0 - 38 / 125.0

    def turn(angle):
        K = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
        return np.eye(3) + math.sin(angle) * K + (1.0 - math.cos(angle)) * K @ K

    # The fit is a parabola: at its middle, half a span ago, the base rests for an instant and only accelerates.
    turns = [turn(0.5 * alpha * (x + SPAN / 2) ** 2) for x in t.tolist()]
    followed, R = monitor(model, np.zeros((40, 3)), turns)[0], turns[-2]
    T = pose(R, np.zeros(3))
    values, vectors = np.linalg.eigh(payload.inertia)
    second = np.maximum(0.5 * values.sum() - values, 0.0)  # ∫ d² dm along each principal axis
    corners = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]) * np.sqrt(second / payload.mass)
    points = payload.p_com + corners @ vectors.T  # in sensor axes
    R_sb, origin = model.T_sensor_base[:3, :3], model.T_sensor_base[:3, 3]
    expected = np.zeros(6)
    g = np.array([0.0, 0.0, -9.81])
    effective = R_sb @ (followed.gravity(T) - T[:3, :3].T @ g)
    for r in points:
        at = R_sb.T @ (r - origin)  # in base axes, from the base's origin, which does not move
        force = payload.mass / 8.0 * (-R_sb @ np.cross(alpha * axis, at) - effective)
        expected += np.concatenate([force, np.cross(r, force)])
    rod = model.rod.solve((0.0, 0.0, 0.0))
    sections = model.rod.radius_at(rod.s) ** 2 * np.gradient(rod.s)
    sections *= model.mass / sections.sum()
    com = sections @ rod.p_base / model.mass  # where the effective gravity is that of the rod
    for p, mass in zip(rod.p_base, sections, strict=True):
        force = -mass * (R_sb @ np.cross(alpha * axis, p - com))
        expected += np.concatenate([force, np.cross(R_sb @ p + origin, force)])
    # Speeds of up to 0.1 rad/s add 1 % of centripetal acceleration, and the turn of 0.1° as much.
    assert followed.inertia(T) == pytest.approx(expected, rel=0.03, abs=0.02 * np.abs(expected[3:]).max())
