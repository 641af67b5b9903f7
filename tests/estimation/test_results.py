"""Every reading gets its code, and only "ok" carries a position."""

import math
from dataclasses import replace

import numpy as np
import pytest

from probedesign.core.errors import InputError
from probedesign.core.statistics import NORMAL_FORCE
from probedesign.estimation.estimate import RESULTS
from probedesign.estimation.estimator import ALARM_CHI2, Estimator
from probedesign.estimation.model import Tolerances
from tests.estimation.true_touches import EXACT, settle, sources_of

MOUNTS = [(9.81, 0, 0), (0, -9.81, 0), (0, 0, 9.81), (0, 0, -9.81), (5.66, 5.66, -5.66)]
PRIORS = {"exact": EXACT, "all": Tolerances()}


@pytest.fixture(params=PRIORS)
def estimator(request, large):
    """With the error sources of the design, and with none."""
    return Estimator(large.model, PRIORS[request.param])


def assert_no_position(c):
    assert c.result in RESULTS and c.result != "ok" and not c.ok
    assert np.isnan([c.s_contact, c.std_s, c.force_normal, c.force_tangential, c.friction_ratio]).all()
    for array in (c.p_contact_base, c.p_surface_base, c.cov_contact_base, c.cov_surface_base):
        assert np.isnan(array).all()


# No contact


@pytest.mark.parametrize("mount", MOUNTS)
@pytest.mark.parametrize("name", ["large", "medium", "small"])
def test_a_free_probe_is_free(name, mount, probes):
    probe = probes[name]
    c = probe.estimator().estimate(probe.solve(mount).wrench_base, mount)
    assert c.result == "no_contact"
    assert c.detection_chi2 == 0.0
    assert_no_position(c)
    np.testing.assert_array_equal(c.shape.p_base, probe.solve(mount).p_base)


def test_a_touch_below_the_noise_is_no_contact_and_above_it_is_one(estimator, gravity, touched):
    codes = [estimator.estimate(touched(0.06, force), gravity).result for force in (1e-5, 1e-4, 1e-3, 1e-2, 1e-1)]
    assert codes[0] == "no_contact" and codes[-1] == "ok"
    order = ["no_contact", "too_light", "interval_only", "ok"]
    assert [order.index(code) for code in codes] == sorted(order.index(code) for code in codes)


def test_a_free_probe_whose_bias_was_taken_with_the_probe_mounted_has_no_tare(estimator, large, gravity):
    """The sensor then reads zero on all channels, which the weight of the probe would have to be balanced for."""
    rng, model = np.random.default_rng(3), large.model
    for _ in range(15):
        read = np.repeat([model.noise.force, model.noise.moment], 3) * rng.normal(size=6)
        c = estimator.estimate(model.to_base(read, gravity), gravity)
        assert c.result == "no_tare"
        assert_no_position(c)


@pytest.mark.parametrize("method", ["ml", "force_moment"])
def test_a_reading_of_zero_at_the_base_has_no_tare(method, estimator, gravity):
    """So reads who passes on what the sensor shows; the payload of this probe is far beyond the noise."""
    model = estimator.model
    assert np.abs(model.gravity_wrench_sensor(gravity)).max() > 100.0 * model.noise.force
    noise = np.linalg.cholesky(model.noise_base()) @ np.random.default_rng(5).normal(size=6)
    for wrench in (np.zeros(6), noise, np.tile(noise, (4, 1))):
        c = estimator.estimate(wrench, gravity, method=method)
        assert c.result == "no_tare"
        assert_no_position(c)


def test_a_reading_of_zero_of_a_weightless_probe_is_no_contact(estimator):
    assert estimator.estimate(np.zeros(6), (0.0, 0.0, 0.0)).result == "no_contact"


def test_a_drifting_free_probe_is_no_contact_where_drift_is_counted(large, gravity):
    """The bias is the only error source, as some commands set it; a step is 6 times the noise."""
    rng, model, steps = np.random.default_rng(4), large.model, 1.0
    estimator = Estimator(model, replace(EXACT, drift_steps=steps))
    step = np.linalg.cholesky(model.noise_base() * model.averaging_samples)
    free = large.rod.solve(gravity).wrench_base
    for _ in range(15):
        drift = steps * step @ rng.normal(size=6)
        noise = rng.multivariate_normal(np.zeros(6), model.noise_base())
        assert estimator.estimate(free + drift + noise, gravity).result == "no_contact"


# Too light, unobservable


def test_a_force_that_leaves_the_place_open_is_too_light(exact, gravity, touched):
    # Noisy forces, sharp moments: felt by the moment, but the lever arm M/F is as vague as F.
    blunt = exact.with_noise(force_N=0.5, moment_Nm=2.6e-6)
    c = blunt.estimate(touched(0.09, 0.02), gravity)
    assert c.result == "too_light"
    assert_no_position(c)


def test_a_force_that_drift_may_be_has_an_interval_and_no_point(large, gravity, touched):
    """Half as much again as the force that is normal by noise alone; with drift its standard deviation is 3.2 times."""
    wrench = touched(0.09, 1.5 * NORMAL_FORCE * large.model.noise.force)
    assert Estimator(large.model, EXACT).estimate(wrench, gravity).ok
    c = Estimator(large.model, replace(EXACT, drift_steps=0.5)).estimate(wrench, gravity)
    assert c.result == "interval_only"
    assert_no_position(c)
    low, high = c.s_interval_95
    # Skewed: the far end is further off than the near one, here by the ratio (1 + 1.96/4.9)/(1 - 1.96/4.9) = 2.3, which
    # the tip cuts off.
    assert 0.0 < low < 0.09 < high <= large.length and high - 0.09 > 1.2 * (0.09 - low)


def test_below_the_force_that_is_normal_there_is_no_point_and_above_it_nothing_changes(exact, gravity, touched):
    force = NORMAL_FORCE * exact.model.noise.force
    below, above = (exact.estimate(touched(0.09, share * force), gravity) for share in (0.99, 1.01))
    assert below.result == "interval_only" and above.ok
    assert_no_position(below)
    # The interval is that of a touch a fiftieth heavier, but for that fiftieth: its ends move by as much as 1/F does.
    assert below.s_interval_95 == pytest.approx(above.s_interval_95, rel=0.02)
    # One pose says no more to a fusion.
    T = np.eye(4)[None]
    fused = [exact.fuse(touched(0.09, share * force)[None], T, gravity).result for share in (0.99, 1.01)]
    assert fused == ["too_light", "ok"]


@pytest.mark.parametrize("push", [-0.02, 0.02, 0.1])
@pytest.mark.parametrize("mount", [(0, 0, 9.81), (0, 0, -9.81)])
def test_a_push_along_the_axis_of_a_straight_probe_leaves_no_trace(push, mount, large, estimator):
    wrench = large.rod.solve(mount, (0.0, 0.0, push), 0.06).wrench_base
    c = estimator.estimate(wrench, mount)
    # Along the axis a normal force needs friction of ten times itself or more.
    assert c.result in ("unobservable", "inconsistent", "out_of_range")
    assert_no_position(c)
    free = estimator.with_friction(math.inf).estimate(wrench, mount)
    assert free.result in ("unobservable", "inconsistent", "out_of_range")
    assert_no_position(free)
    assert estimator.estimate(wrench, mount, method="force_moment").result == "unobservable"


# Out of range


@pytest.mark.parametrize("channel", range(6))
def test_a_channel_that_is_no_number_or_saturated_is_out_of_range(channel, large, gravity):
    model, touched = large.model, large.solve(gravity, 0.06, (0.0, 0.05, 0.0)).wrench_base
    wrenches = [np.where(np.arange(6) == channel, bad, touched) for bad in (np.nan, np.inf, -np.inf)]
    limit = 1.001 * model.wrench_range * (np.arange(6) == channel)
    wrenches += [model.to_base(reading, gravity) for reading in (limit, -limit)]
    for wrench in wrenches:
        c = large.estimator().estimate(wrench, gravity)
        assert c.result == "out_of_range"
        assert_no_position(c)


def test_a_lever_arm_beyond_the_tip_is_not_on_the_probe(large, gravity, estimator):
    for force in ((0.0, 0.02, 0.0), (-0.02, 0.0, 0.0), (0.01, -0.01, 0.0)):
        eq = large.rod.solve(gravity, force, large.length)
        wrench = eq.wrench_base.copy()
        wrench[3:] += 0.2 * np.cross(eq.p_contact_base, force)
        for method in ("ml", "force_moment"):
            c = estimator.estimate(wrench, gravity, method=method)
            assert c.result in ("out_of_range", "inconsistent"), (force, method)
            assert_no_position(c)


# Inconsistent


def test_two_contacts_are_not_explained_by_one(large, gravity, estimator):
    """Two forces at right angles near base and tip: their moments' sum is not at right angles to their sum."""
    free = large.rod.solve(gravity).wrench_base
    one = large.rod.solve(gravity, (0.0, 0.1, 0.0), 0.03).wrench_base
    other = large.rod.solve(gravity, (0.05, 0.0, 0.0), 0.12).wrench_base
    c = estimator.estimate(one + other - free, gravity)
    assert c.result == "inconsistent"
    assert_no_position(c)


@pytest.mark.parametrize("ratios", [(0.0, 0.0), (0.3, -0.3)])
@pytest.mark.parametrize("fraction", [0.3, 0.6, 0.85])
def test_a_pull_is_inconsistent(fraction, ratios, gravity, exact_sources, large, estimator):
    """The object pulls the surface outward. On the other side of the section it would push: only the couple r × F of
    what friction it would take there contradicts that, so nothing does where there is none."""
    s = fraction * large.length
    y = np.array([s, 0.6, 0.03, *ratios])
    touch = settle(exact_sources, y)
    # Turned about: the same point under the opposite force, by hand on the rod.
    rod, x = large.rod, touch.p_surface
    force = -touch.force
    eq = rod.solve(gravity, force, s)
    for _ in range(30):
        R = eq.R_at(s)
        arm = rod.radius_at(s) * (math.cos(0.6) * R[:, 0] + math.sin(0.6) * R[:, 1])
        eq = rod.solve(gravity, force, s, couple=np.cross(arm, force), guess=eq.tip)
    x = eq.p_at(s) + arm
    c = estimator.estimate(eq.wrench_base, gravity)
    if c.ok:  # then as a push from the other side, where the point is not the true one but the force's line is
        assert c.force_normal > 0.0
        off = np.cross(x - c.p_surface_base, force)
        assert np.linalg.norm(off) <= 3.0 * np.linalg.norm(force) * c.candidates[0].rms
    else:
        assert_no_position(c)


@pytest.mark.parametrize("couple", [1e-3, -1e-3])
def test_a_couple_about_the_normal_beyond_friction_is_inconsistent(couple, gravity, exact_sources, large):
    """A soft finger's torsion would be μ F a, with a patch of a tenth of a radius: this is a hundred times that."""
    touch = settle(exact_sources, np.array([0.09, 0.4, 0.05, 0.0, 0.0]))
    eq = large.rod.solve(gravity, touch.force, 0.09, couple=touch.touch[8:11])
    normal = -touch.force / np.linalg.norm(touch.force)
    twisted = large.rod.solve(gravity, touch.force, 0.09, couple=touch.touch[8:11] + couple * normal, guess=eq.tip)
    for priors in PRIORS.values():
        estimator = Estimator(large.model, priors)
        assert estimator.estimate(eq.wrench_base, gravity).ok
        c = estimator.estimate(twisted.wrench_base, gravity)
        assert c.result in ("inconsistent", "out_of_range")
        assert_no_position(c)


def test_a_torsion_that_friction_may_make_is_a_touch(gravity, exact, touched, large):
    """A circumferential ratio of one standard deviation is consistent with the prior, ten are not."""
    wrench = touched(0.09, 0.05)
    radius = float(large.rod.radius_at(0.09))
    for ratio, ok in ((0.6, True), (10.0, False)):
        more = wrench.copy()
        more[5] += ratio * 0.05 * radius
        assert exact.estimate(more, gravity).ok == ok
    assert not exact.with_friction(0.0).estimate(touched(0.09, 0.05, around=0.6), gravity).ok


def test_a_couple_without_a_force_is_no_contact_on_the_probe(large, gravity, estimator):
    wrench = large.rod.solve(gravity).wrench_base + np.array([0, 0, 0, 0, 1e-3, 0])
    c = estimator.estimate(wrench, gravity)
    assert c.result in ("out_of_range", "inconsistent")  # an endless lever arm
    assert_no_position(c)


@pytest.mark.parametrize(("fraction", "force"), [(0.4, 0.2), (0.6, 0.1)])
@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_a_stiffness_that_is_off_by_a_fifth_is_inconsistent_or_counted(factor, fraction, force, large, gravity):
    """Where the force is known to be normal an exact probe that bends far contradicts the reading; with a fifth as its
    prior it is located. Where friction may turn the force, it explains the reading: one touch cannot observe both."""
    rod = large.rod
    other = replace(rod, youngs_modulus=factor * rod.youngs_modulus, shear_modulus=factor * rod.shear_modulus)
    sources = sources_of(replace(large.model, rod=other), gravity)
    touch = settle(sources, np.array([fraction * large.length, 0.7, force, 0.0, 0.0]))
    exact = Estimator(large.model, EXACT).with_friction(0.0)
    assert exact.estimate(touch.wrench, gravity).result == "inconsistent"
    counting = exact.with_tolerances(replace(EXACT, youngs_modulus=0.2, shear_modulus=0.2))
    c = counting.estimate(touch.wrench, gravity)
    assert c.ok
    off = c.p_surface_base - touch.p_surface
    assert off @ np.linalg.solve(c.cov_surface_base, off) < 11.3  # χ² of three, 1 %


def test_a_probe_that_cannot_stand_has_no_estimate(large):
    c = large.estimator().estimate(np.array([0, 0, -70.0, 0, 0, 0]) / 10, (0, 0, -981.0))
    assert c.result in ("not_converged", "out_of_range")
    assert_no_position(c)


# Input and what is listed


@pytest.mark.parametrize("shape", [(5,), (7,), (6, 1), (0, 6), (1, 2, 6), ()])
def test_a_reading_of_the_wrong_shape_is_refused(shape, large):
    with pytest.raises(InputError, match="wrench_base"):
        large.estimator().estimate(np.zeros(shape))


@pytest.mark.parametrize("bad", [(0, 0), (0, 0, np.nan), (0, 0, np.inf), ((0, 0, 9.81),)])
def test_a_gravity_that_is_none_is_refused(bad, large):
    with pytest.raises(InputError, match="gravity_base"):
        large.estimator().estimate(np.zeros(6), bad)


@pytest.mark.parametrize("noise", [(0.0, 1e-6), (-1e-3, 1e-6), (np.nan, 1e-6), (1e-3, np.inf), (1e-3, 0.0)])
def test_a_noise_that_cannot_be_is_refused(noise, large):
    with pytest.raises(InputError, match="positive"):
        large.estimator().with_noise(*noise)


@pytest.mark.parametrize("friction", [-0.1, np.nan])
def test_a_friction_that_is_none_is_refused(friction, large):
    with pytest.raises(InputError, match="friction"):
        large.estimator().with_friction(friction)


def test_another_noise_is_another_estimator_with_the_same_priors(large, gravity, touched):
    estimator, wrench = large.estimator(), touched(0.06, 0.05)
    loud = estimator.with_noise(force_N=2e-3, moment_Nm=1e-5)
    assert loud.estimate(wrench, gravity).std_s > estimator.estimate(wrench, gravity).std_s
    assert estimator.model.noise == large.model.noise
    assert estimator.with_tolerances(EXACT).with_noise(1e-3, 1e-5).with_friction(0.1).priors == EXACT


@pytest.mark.parametrize("method", ["ml", "force_moment"])
def test_candidates_are_listed_best_first(method, large, gravity, touched):
    c = large.estimator().estimate(touched(0.06, 0.3), gravity, method=method)
    assert c.result == "ok" and len(c.candidates) >= 1
    assert [k.chi2 for k in c.candidates] == sorted(k.chi2 for k in c.candidates)
    assert c.candidates[0].s_contact == c.s_contact
    assert c.detection_chi2 > ALARM_CHI2


def test_an_estimate_prints_itself_in_one_line(estimator, gravity, touched):
    located, free = estimator.estimate(touched(0.06, 0.05), gravity), estimator.estimate(touched(0.06, 1e-5), gravity)
    assert str(located).startswith(f"ok: s = {1e3 * located.s_contact:.1f} ± ") and str(located).endswith("mN")
    assert str(free) == "no_contact: the reading is that of the free probe under gravity"
    assert all("\n" not in str(each) for each in (located, free))
