"""A drifting zero is followed or named, a leap is told from a touch, and a tare by the user ends every deadlock."""

import math
from dataclasses import replace

import numpy as np
import pytest

from probedesign.core.errors import InputError
from probedesign.core.statistics import FALSE_ALARM, max_chi2
from probedesign.estimation.estimator import Estimator
from probedesign.live.blocks import Block, WrenchReading
from probedesign.live.poses.base_poses import BasePoses, TimedPose
from probedesign.live.processing.chain import Chain, ProcessingOptions
from probedesign.live.processing.tare import TareWindow, take_tare
from probedesign.live.processing.touches import touch_changes
from probedesign.rod.contact import solve_frictionless, solve_surface_force

RATE = 50.0  #: Of the means [Hz].
BIAS = np.array([0.3, -0.2, 0.5, 0.002, -0.003, 0.001])
TARE = ProcessingOptions(TareWindow(0.0, 2.0), 1)


@pytest.fixture(scope="module")
def steps(model):
    """One step of the resolution in each channel: the noise of one sample."""
    return model.noise.std * math.sqrt(model.averaging_samples)


@pytest.fixture(scope="module")
def touch_wrench(model):
    """What a touch of 15 mN at 0.7 of the length adds to the free probe's wrench."""
    touch = solve_frictionless(model.rod, model.gravity_base, 0.7 * model.rod.length, 0.5, 15e-3)
    return touch.equilibrium.wrench_base - model.rod.solve(model.gravity_base).wrench_base


def run(estimator, bias, *, touch=(0.0, 0.0), wrench=None, options=TARE, ask=(), seed=1):
    """Updates, lines and chain for a bias (n, 6) over the constant one; touched by `wrench` between two times."""
    model, rng, n = estimator.model, np.random.default_rng(seed), len(bias)
    t = np.arange(n) / RATE
    at_base = np.tile(model.rod.solve(model.gravity_base).wrench_base, (n, 1))
    if wrench is not None:
        at_base[(t >= touch[0]) & (t < touch[1])] += wrench
    read = model.to_sensor(at_base, model.gravity_base) + BIAS + bias + model.noise.std * rng.standard_normal((n, 6))
    lines, updates, asked = [], [], list(ask)
    chain = Chain(estimator, options, None, lines.append)
    for i in range(0, n, 10):
        part = slice(i, i + 10)
        updates += chain.process(Block(t[part], read[part], model.gravity_base, np.full(len(t[part]), np.nan)))
        if asked and t[part][-1] >= asked[0][0]:
            try:
                lines.append(chain.take_tare(asked.pop(0)[1]))
            except InputError as error:
                lines.append(f"tare refused: {error}")
    return [*updates, *chain.finish()], lines, chain


def seconds(duration):
    return np.arange(int(duration * RATE))[:, None] / RATE


def results(updates, start=0.0, end=math.inf):
    return {u.estimate.result for u in updates if start <= u.reading.time < end}


@pytest.mark.parametrize("options", [TARE, ProcessingOptions(None, 1, zero="auto")])
def test_a_fast_warm_up_has_no_position_until_it_has_levelled_off(options, estimator, steps):
    """14 steps with a time constant of 3 s, as a real Nano17 shows. After 30 s, a 1500th of the drift is left."""
    t = seconds(45.0)
    bias = 14.0 * (1.0 - np.exp(-t / 3.0)) * np.array([0.1, 0.3, 0.4, 1.0, -0.5, 1.0]) * steps
    updates, lines, chain = run(estimator, bias, options=options)
    assert results(updates, end=8.0) == {"warming_up"}
    # Between, it may be followed already; a reading that is off by less than the drift is no position.
    assert results(updates) <= {"warming_up", "no_contact"} and results(updates, start=35.0) == {"no_contact"}
    assert chain.contacts == ()
    (tare,) = [line for line in lines if line.startswith("tare from")]
    (begins,) = [line for line in lines if line.startswith("the sensor is warming up")]
    assert sum(line.startswith("the drift of the sensor's zero is followed again") for line in lines) == 1
    # The rate of the first seconds: 280 steps a minute at once, 140 after 2 s.
    for line, before in ((tare, "drifts by "), (begins, "drifts by ")):
        assert 120.0 < float(line.split(before)[1].split()[0]) < 300.0
    assert 3.0 < float(begins.split("for about ")[1].split()[0]) < 60.0


def test_a_slow_warm_up_is_followed_and_touches_are_located(estimator, steps, touch_wrench):
    """16 steps with 120 s: the drift during the touch of 10 s, 1.2 steps, is predicted from the rate before it."""
    t = seconds(45.0)
    bias = 16.0 * (1.0 - np.exp(-t / 120.0)) * np.array([1.0, -1.0, 0.5, 1.0, -0.5, 1.0]) * steps
    updates, _, chain = run(estimator, bias, touch=(30.0, 40.0), wrench=touch_wrench)
    assert results(updates, end=29.5) == results(updates, start=41.0) == {"no_contact"}
    assert results(updates, 31.0, 39.5) == {"ok"} and len(chain.contacts) == 1
    s = [u.estimate.s_contact for u in updates if 38.0 < u.reading.time < 39.5]
    std = [u.estimate.std_s for u in updates if 38.0 < u.reading.time < 39.5]
    # The mean of so many readings is off by the bias alone; four of its standard deviations.
    assert abs(np.mean(s) - 0.7 * estimator.model.rod.length) < 4.0 * np.mean(std)


@pytest.mark.parametrize("channel", range(6))
def test_a_leap_of_one_channel_is_followed_and_is_no_touch(channel, estimator, steps):
    """By 8 steps: 25 mN, or 0.12 N·mm, of which no place of the probe can be the origin. A leap of Mx or My alone may
    be a touch so light that its force is lost in the noise, and stays one until the user states otherwise."""
    bias = np.where(seconds(20.0) >= 10.0, 1.0, 0.0) * np.eye(6)[channel] * 8.0 * steps
    updates, lines, chain = run(estimator, bias)
    leaps = [line for line in lines if "leapt by" in line]
    if channel in (3, 4):  # followed or not, by the noise; never a position
        assert "ok" not in results(updates) and len(leaps) + len(chain.contacts) >= 1
        return
    assert len(leaps) == 1 and ("Fx", "Fy", "Fz", "Mx", "My", "Mz")[channel] in leaps[0]
    assert results(updates, 11.5) == {"no_contact"} and updates[-1].phase == "free" and chain.contacts == ()


def test_a_touch_is_no_leap(estimator, touch_wrench):
    bias = np.zeros((len(seconds(20.0)), 6))
    updates, lines, chain = run(estimator, bias, touch=(8.0, 18.0), wrench=touch_wrench)
    assert not [line for line in lines if "leapt" in line or "warming" in line]
    assert results(updates, 9.0, 17.5) == {"ok"} and len(chain.contacts) == 1


def test_no_light_touch_of_one_channel_is_a_leap(model, steps):
    """Drawn touches with friction, of a print whose E is off by 3 %, under any gravity: where noise leaves one channel
    alone, the nearest touch that is compared explains the rest. The leap's limit is beyond all of 100 such touches."""
    rng, singles, left = np.random.default_rng(5), 0, []
    limit = max_chi2(5, FALSE_ALARM)
    while singles < 100:
        gravity = rng.normal(size=3)
        gravity *= 9.81 / np.linalg.norm(gravity)
        rod = replace(model.rod, youngs_modulus=model.rod.youngs_modulus * math.exp(0.03 * rng.normal()))
        ratio, angle = rng.uniform(0.0, 0.8), rng.uniform(-math.pi, math.pi)
        touch = solve_surface_force(
            rod, gravity, rng.uniform() * rod.length, rng.uniform(-math.pi, math.pi),
            0.2e-3 * 20.0 ** rng.uniform(), (ratio * math.cos(angle), ratio * math.sin(angle)),
        )  # fmt: skip
        change = touch.equilibrium.wrench_base - rod.solve(gravity).wrench_base
        std = rng.choice([0.06, 0.1, 0.3])
        in_noise = model.to_sensor(change, np.zeros(3)) / steps / std + rng.standard_normal(6)
        chi2 = float(in_noise @ in_noise)
        if chi2 - np.square(in_noise).max() < limit < chi2:
            singles += 1
            left.append(chi2 - max(float((touch_changes(model, gravity) @ in_noise).max()), 0.0) ** 2)
    assert max(left) < limit


@pytest.mark.parametrize(("push", "end", "leaps"), [(-8.0, 14.0, 0), (8.0, math.inf, 1)])
def test_a_push_on_the_end_is_a_touch_and_a_pull_is_a_leap(push, end, leaps, model, steps):
    """A probe that hangs down is pushed along its axis by 25 mN: Fz alone changes. Nothing pulls at it."""
    hanging = Estimator(replace(model, gravity_base=np.array([0.0, 0.0, 9.81])))
    updates, lines, chain = run(hanging, np.zeros((800, 6)), touch=(8.0, end), wrench=push * steps * np.eye(6)[2])
    assert len([line for line in lines if "Fz leapt by 25 mN" in line]) == leaps
    assert len(chain.contacts) == 1 - leaps and updates[-1].phase == "free"


def test_the_follower_learns_nothing_while_the_base_turns(estimator, model, steps):
    """A drift of 6 steps a minute while the base rests. While it turns about the vertical, readings creep by as much
    the other way, as by an error of gravity: the known rate stays, and is right 15 s after the base has stopped."""
    t, rng = np.arange(int(60.0 * RATE)) / RATE, np.random.default_rng(4)
    rate = np.where((t >= 25.0) & (t < 31.0), -0.1, 0.1)
    read = BIAS + np.outer(np.cumsum(rate) / RATE, steps) + model.noise.std * rng.standard_normal((len(t), 6))
    read += model.to_sensor(model.rod.solve(model.gravity_base).wrench_base, model.gravity_base)
    up = -model.gravity_base / np.linalg.norm(model.gravity_base)
    turned = [0.1 * np.clip(at - 25.0, 0.0, 6.0) for at in t]
    stated = [TimedPose(at, (0.0, 0.0, 0.0), (*np.sin(a / 2.0) * up, np.cos(a / 2.0)))
              for at, a in zip(t.tolist(), turned, strict=True)]  # fmt: skip
    poses = BasePoses("stated", stated, gravity_world=model.gravity_base)
    chain, known = Chain(estimator, TARE, poses, lambda line: None), []
    for i in range(len(t)):
        block = Block(t[i : i + 1], read[i : i + 1], model.gravity_base, np.full(1, math.nan))
        known += [(u.reading.time, u.phase, chain._monitor._follower.rate) for u in chain.process(block)]
    at, rates = np.array([row[0] for row in known]), np.array([row[2] for row in known])
    assert {phase for time, phase, _ in known if 25.5 < time < 31.0} == {"moving"}
    assert len(set(rates[(at > 25.5) & (at < 31.0)])) == 1
    # The slowest filter that is in use knows the rate to about a tenth of it.
    for when in ((at > 20.0) & (at < 31.0), at > 46.0):
        np.testing.assert_allclose(rates[when], 0.1, atol=0.03)


def test_a_leap_of_all_channels_ends_with_a_tare_by_the_user(estimator, steps, touch_wrench):
    """It looks like a touch: a program is refused, and a person who sees the free probe is not."""
    bias = np.where(seconds(30.0) >= 10.0, 1.0, 0.0) * 8.0 * steps + 0.0
    updates, lines, _ = run(estimator, bias, ask=[(14.0, False), (16.0, True)])
    assert any(line.startswith("tare refused: the probe is settled") and "force" in line for line in lines)
    (stated,) = [line for line in lines if "was taken to be free although" in line]
    assert "it counted as settled" in stated and "standard deviations" in stated
    assert results(updates, 19.0) == {"no_contact"} and updates[-1].phase == "free"


def reading_rows(model, excess):
    free = model.to_sensor(model.rod.solve(model.gravity_base).wrench_base, model.gravity_base)
    return [WrenchReading(i / RATE, free + row, model.gravity_base) for i, row in enumerate(excess)]


def test_level_and_rate_of_a_tare_have_their_covariance(estimator, model, steps):
    """400 windows of noise over a line: the mean χ² of 12 degrees of freedom is 12 ± 0.25 (one standard deviation)."""
    rng, n = np.random.default_rng(2), 100
    t = np.arange(n)[:, None] / RATE
    rate, chi2 = 2.0 * steps, []
    for _ in range(400):
        excess = BIAS + rate * (t - t.mean()) + model.noise.std * rng.standard_normal((n, 6))
        tare = take_tare(reading_rows(model, excess), TareWindow(0.0, 2.0), estimator)
        off = np.stack([tare.bias_sensor - BIAS, tare.rate_sensor - rate]) / model.noise.std
        chi2.append(float(np.einsum("ic,ij,jc->", off, np.linalg.inv(tare.cov), off)))
    assert abs(np.mean(chi2) - 12.0) < 4.0 * 0.25
    assert tare.steps_min == pytest.approx(120.0, rel=0.1)  # the fastest of six, of which each is known to 2 %


@pytest.mark.parametrize("size", [2.0, 3.0, 8.0])
def test_a_step_in_an_automatic_window_is_a_touch_and_a_line_is_a_drift(size, estimator, model, steps):
    """In standard deviations of a reading. A step of 1.0 shows in 50 readings, one of 2.0 as a step."""
    rng, n = np.random.default_rng(3), 50
    noise = model.noise.std * rng.standard_normal((n, 6))
    step = np.zeros((n, 6))
    step[n // 2 :, 3] = size * model.noise.std[3]
    with pytest.raises(InputError, match="touched"):
        take_tare(reading_rows(model, noise + step), TareWindow(0.0, 1.0), estimator, steady=True)
    line = np.zeros((n, 6))
    line[:, 3] = 2.0 * size * model.noise.std[3] * np.arange(n) / n
    assert take_tare(reading_rows(model, noise + line), TareWindow(0.0, 1.0), estimator, steady=True).rate_sensor[3] > 0
