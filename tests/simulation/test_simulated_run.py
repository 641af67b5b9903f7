"""Tests of the simulated mapping run with friction."""

import numpy as np
import pytest

from probedesign.core.units import MILLINEWTON
from probedesign.geometry import Axis
from probedesign.simulation.scenes import touch_targets
from probedesign.simulation.simulated_run import FIRM_FORCE, LIGHT_FORCE, RunErrors, base_rotation, simulate_run
from tests.live.conftest import bundle as bundle
from tests.live.conftest import estimator as estimator


@pytest.fixture(scope="module")
def touches(estimator):
    """Two targets with friction, without any other error."""
    only_friction = RunErrors(stiffness=0.0, base_offset=0.0, base_repeat=0.0, bias_rate=0.0, friction=0.5)
    return simulate_run(estimator.model, touch_targets()[8:10], np.random.default_rng(2), only_friction).touches


def test_each_touch_has_its_own_friction_and_stays_in_its_cone(touches):
    """The first press slides; while the force decreases the tangential force reverses."""
    assert touches[0].friction != touches[1].friction
    for touch in touches:
        assert (touch.friction_ratios <= touch.friction * (1.0 + 1e-9)).all()
        assert touch.friction_ratios.max() == pytest.approx(touch.friction, rel=1e-6)


def test_the_touched_point_lies_on_the_edge_and_the_force_is_as_intended(touches):
    """With the depth to 1 µm the firm force is reached within 2 %; it stays below 5 mN."""
    for touch in touches:
        off = touch.p_world - touch.target.p_world
        assert np.linalg.norm(off - (off @ touch.target.card.along) * touch.target.card.along) < 1e-6
        assert touch.force == pytest.approx(FIRM_FORCE, rel=0.02)
        assert touch.force < 5.0 * MILLINEWTON


def test_a_run_is_reproducible(estimator, touches):
    only_friction = RunErrors(stiffness=0.0, base_offset=0.0, base_repeat=0.0, bias_rate=0.0, friction=0.5)
    again = simulate_run(estimator.model, touch_targets()[8:9], np.random.default_rng(2), only_friction).touches[0]
    assert np.array_equal(again.wrenches_base, touches[0].wrenches_base)


def test_a_card_that_yields_is_pressed_with_the_same_force_and_its_point_at_rest_is_the_truth(estimator, touches):
    """The base travels further by the compliance times the change of the force, without friction along the push."""
    errors = RunErrors(stiffness=0.0, base_offset=0.0, base_repeat=0.0, bias_rate=0.0, friction=0.0)
    rigid, soft = (
        simulate_run(
            estimator.model, touch_targets(lambda c=c: c)[8:9], np.random.default_rng(2), errors
        ).touches[0]
        for c in (0.0, 0.2)
    )  # fmt: skip
    assert soft.force == pytest.approx(FIRM_FORCE, rel=0.02)
    off, along = soft.p_world - soft.target.p_world, soft.target.card.along
    assert np.linalg.norm(off - (off @ along) * along) < 1e-6
    light, firm = ((one.Ts_world_base[1] - one.Ts_world_base[0])[:3, 3] @ one.target.direction for one in (rigid, soft))
    # Both depths have the tolerance of a micrometre; the force has the direction of the push within a tenth.
    assert firm - light == pytest.approx(0.2 * (FIRM_FORCE - LIGHT_FORCE), rel=0.05)


def test_a_base_that_comes_short_presses_on_from_the_true_contact(estimator):
    """By half a millimetre, which is more than the light press goes: a robot goes on until it measures a force."""
    errors = RunErrors(stiffness=0.0, base_offset=0.5e-3, base_repeat=0.0, bias_rate=0.0)
    for seed in range(4):
        (touch,) = simulate_run(estimator.model, touch_targets()[:1], np.random.default_rng(seed), errors).touches
        assert touch.force > FIRM_FORCE - LIGHT_FORCE  # it goes on by the difference from a light press that touches


def test_a_curved_probe_comes_from_above_and_is_pushed_across_its_plane():
    """At three quarters of its length it points along y; the base lies above, and the plane of bending is upright."""
    axis = Axis.helix(0.15, 1.5, 0.0, -0.5 * np.pi)
    R, T = base_rotation(0.0, axis), axis.frames([0.0, 0.75 * 0.15])
    np.testing.assert_allclose(R @ T[1, :3, 2], [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    way = R @ T[1, :3, 3]
    assert abs(way[0]) < 1e-12 and way[2] < 0.0 and np.linalg.det(R) > 0.0
