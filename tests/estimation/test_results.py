"""Every reading gets its code, and only "ok" carries a position."""

import numpy as np
import pytest

from probedesign.errors import InputError
from probedesign.estimation.estimate import RESULTS

MOUNTS = [(9.81, 0, 0), (0, -9.81, 0), (0, 0, 9.81), (0, 0, -9.81), (5.66, 5.66, -5.66)]


def assert_no_position(c):
    assert c.result in RESULTS and c.result != "ok" and not c.ok
    assert np.isnan([c.s_contact, c.std_s]).all()
    assert np.isnan(c.p_contact_base).all() and np.isnan(c.p_surface_base).all()
    assert np.isnan(c.cov_contact_base).all()


@pytest.mark.parametrize("mount", MOUNTS)
@pytest.mark.parametrize("name", ["large", "medium", "small"])
def test_a_free_probe_is_free(name, mount, probes):
    probe = probes[name]
    c = probe.estimator().estimate(probe.solve(mount).wrench_base, mount)
    assert c.result == "no_contact"
    assert c.detection_chi2 == 0.0
    assert_no_position(c)
    np.testing.assert_array_equal(c.shape.p_base, probe.solve(mount).p_base)


def test_a_touch_below_the_noise_is_no_contact_and_above_it_is_one(large, gravity, touched):
    codes = []
    for force in (1e-5, 1e-4, 1e-3, 1e-2, 1e-1):
        wrench = touched(0.06, force)
        codes.append(large.estimator().estimate(wrench, gravity).result)
    assert codes[0] == "no_contact" and codes[-1] == "ok"
    order = ["no_contact", "too_light", "ok"]
    assert [order.index(code) for code in codes] == sorted(order.index(code) for code in codes)


def test_a_force_that_tells_no_place_is_too_light(large, gravity, touched):
    # Noisy forces, sharp moments: felt by the moment, but the lever arm M/F is as vague as F.
    blunt = large.estimator().with_noise(force_N=0.05, moment_Nm=2.6e-6)
    c = blunt.estimate(touched(0.09, 0.02), gravity)
    assert c.result == "too_light"
    assert_no_position(c)


@pytest.mark.parametrize("channel", range(6))
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_reading_that_is_no_number_is_out_of_range(channel, bad, large, gravity):
    wrench = large.solve(gravity, 0.06, (0.0, 0.05, 0.0)).wrench_base.copy()
    wrench[channel] = bad
    c = large.estimator().estimate(wrench, gravity)
    assert c.result == "out_of_range"
    assert_no_position(c)


@pytest.mark.parametrize("channel", range(6))
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_saturated_channel_is_out_of_range(channel, sign, large, gravity):
    model = large.model
    reading = np.zeros(6)
    reading[channel] = sign * 1.001 * model.wrench_range[channel]
    c = large.estimator().estimate(model.to_base(reading, gravity), gravity)
    assert c.result == "out_of_range"
    assert_no_position(c)


@pytest.mark.parametrize("shape", [(5,), (7,), (6, 1), (0, 6), (1, 2, 6), ()])
def test_a_reading_of_the_wrong_shape_is_refused(shape, large):
    with pytest.raises(InputError, match="wrench_base"):
        large.estimator().estimate(np.zeros(shape))


@pytest.mark.parametrize("bad", [(0, 0), (0, 0, np.nan), (0, 0, np.inf), ((0, 0, 9.81),)])
def test_a_gravity_that_is_none_is_refused(bad, large):
    with pytest.raises(InputError, match="gravity_base"):
        large.estimator().estimate(np.zeros(6), bad)


def test_a_lever_arm_beyond_the_tip_is_out_of_range(large, gravity):
    for force in ((0.0, 0.02, 0.0), (-0.02, 0.0, 0.0), (0.01, -0.01, 0.0)):
        eq = large.solve(gravity, large.length, force)
        wrench = eq.wrench_base.copy()
        wrench[3:] += 0.2 * np.cross(eq.p_contact_base, force)
        c = large.estimator().estimate(wrench, gravity, method="paper")
        assert c.result == "out_of_range", force
        assert_no_position(c)
        c = large.estimator().estimate(wrench, gravity)  # such a force is not normal to the surface either
        assert c.result in ("out_of_range", "inconsistent"), force
        assert_no_position(c)


@pytest.mark.parametrize("push", [-0.02, 0.02, 0.3])
def test_a_push_along_the_axis_of_a_straight_probe_leaves_no_trace(push, large):
    for gravity in ((0, 0, 9.81), (0, 0, -9.81)):
        wrench = large.solve(gravity, 0.06, (0.0, 0.0, push)).wrench_base
        c = large.estimator().estimate(wrench, gravity)
        assert c.result == "unobservable"
        assert_no_position(c)
        np.testing.assert_allclose(c.force_base, (0.0, 0.0, push), atol=1e-12)


def test_two_contacts_are_not_explained_by_one(large, gravity):
    """Two forces at right angles near base and tip: their moments' sum is not at right angles to their sum."""
    free = large.solve(gravity).wrench_base
    one = large.solve(gravity, 0.03, (0.0, 0.1, 0.0)).wrench_base
    other = large.solve(gravity, 0.12, (0.05, 0.0, 0.0)).wrench_base
    c = large.estimator().estimate(one + other - free, gravity)
    assert c.result == "inconsistent"
    assert_no_position(c)


@pytest.mark.parametrize("torque", [3e-5, 1e-4, -1e-3])
def test_a_torque_about_the_axis_is_not_explained_by_a_contact_on_it(torque, large, gravity, touched):
    wrench = touched(0.09, 0.05)
    assert large.estimator().estimate(wrench, gravity).ok
    wrench[5] += torque
    c = large.estimator().estimate(wrench, gravity)
    assert c.result == "inconsistent"
    assert_no_position(c)


def test_a_couple_without_a_force_is_no_contact_on_the_probe(large, gravity):
    wrench = large.solve(gravity).wrench_base + np.array([0, 0, 0, 0, 1e-3, 0])
    c = large.estimator().estimate(wrench, gravity)
    assert c.result in ("out_of_range", "inconsistent")  # an endless lever arm
    assert_no_position(c)


@pytest.mark.parametrize("noise", [(0.0, 1e-6), (-1e-3, 1e-6), (np.nan, 1e-6), (1e-3, np.inf), (1e-3, 0.0)])
def test_a_noise_that_cannot_be_is_refused(noise, large):
    with pytest.raises(InputError, match="positive"):
        large.estimator().with_noise(*noise)


def test_another_noise_is_another_estimator(large, gravity, touched):
    estimator = large.estimator()
    wrench = touched(0.06, 0.05)
    loud = estimator.with_noise(force_N=2e-3, moment_Nm=1e-5)
    assert loud.estimate(wrench, gravity).std_s > estimator.estimate(wrench, gravity).std_s
    assert estimator.model.noise == large.model.noise


@pytest.mark.parametrize("method", ["ml", "paper"])
def test_candidates_are_listed_best_first(method, large, gravity, touched):
    c = large.estimator().estimate(touched(0.06, 0.3), gravity, method=method)
    assert c.result == "ok" and len(c.candidates) >= 1
    assert [k.chi2 for k in c.candidates] == sorted(k.chi2 for k in c.candidates)
    assert c.candidates[0].s_contact == c.s_contact


def test_a_probe_that_cannot_stand_says_so(large):
    c = large.estimator().estimate(np.array([0, 0, -70.0, 0, 0, 0]) / 10, (0, 0, -981.0))
    assert c.result in ("not_converged", "out_of_range")
    assert_no_position(c)
