"""Ground truth of simulated campaigns whose touches have friction."""

import numpy as np
import pytest

from probedesign.campaigns.manifest import LENGTH_SCALE, WEIGHT_STD
from probedesign.core.errors import InputError
from probedesign.design.io import load_design
from probedesign.probe import build_probe
from probedesign.simulation.ground_truth import CampaignPlan, GroundTruth


@pytest.fixture(scope="module")
def model():
    return build_probe(load_design("large")).model


def simulated_tests(model, **options):
    plan = CampaignPlan("stage", 3, exact=True, **options)
    return GroundTruth.draw(model, plan, np.random.default_rng(3)).tests()


def test_only_touches_have_friction(model):
    """Friction does not change tests of the free probe; it inclines the force of each touch independently."""
    plain, rough = (simulated_tests(model, friction=mu) for mu in (0.0, 0.6))
    for one, other in zip(plain, rough, strict=True):
        if one.p_surface_base is None:
            assert np.array_equal(one.wrench_sensor, other.wrench_sensor) and other.friction == 0.0
    touched = [test for test in rough if test.p_surface_base is not None]
    ratios = np.array([test.friction for test in touched])
    assert len(set(ratios)) == len(ratios) and (ratios > 0.0).all() and (ratios < 2.0).all()
    for test in touched:
        F, eq = test.equilibrium.load[0:3], test.equilibrium
        arm = test.p_surface_base - eq.p_contact_base
        slope = model.rod.taper_at(eq.s_contact)
        normal = arm / np.linalg.norm(arm) + slope * eq.R_at(eq.s_contact)[:, 2]
        pushes = -float(F @ normal) / np.linalg.norm(normal)
        assert np.sqrt(F @ F - pushes**2) / pushes == pytest.approx(test.friction, rel=1e-5)


def test_invalid_friction_is_refused():
    with pytest.raises(InputError, match=r"--friction -0.5 must lie in 0 \.\.\. 3"):
        CampaignPlan(friction=-0.5)
    with pytest.raises(InputError, match=r"--friction-spread 2 must lie in 0 \.\.\. 1"):
        CampaignPlan(friction_spread=2.0)


def _bench(model, flaws: bool):
    plan = CampaignPlan("cameras", 4, flaws=flaws, friction=0.0)
    return GroundTruth.draw(model, plan, np.random.default_rng(4))


def test_lengths_of_the_reference_have_its_scale(model):
    """Distances from the stated base are longer by the drawn fraction, and exact without errors of the bench."""
    points = np.array([[0.0, 0.0, 0.1], [0.01, 0.02, 0.15]])
    exact, flawed = _bench(model, False), _bench(model, True)
    T = flawed.T_world_true
    true = points @ T[:3, :3].T + T[:3, 3] - flawed.T_world_base[:3, 3]
    scale = 1.0 + flawed.flaws.length_scale
    assert exact.flaws.length_scale == 0.0 and abs(flawed.flaws.length_scale) < 4 * LENGTH_SCALE
    assert flawed.to_world(points) - flawed.T_world_base[:3, 3] == pytest.approx(scale * true, abs=1e-15)


def test_each_test_has_its_own_pose_and_each_weight_its_own_error(model):
    """The repeatability of 0.01 mm moves each base, and a weight pulls with another force than the stated one."""
    exact, flawed = _bench(model, False).tests(), _bench(model, True).tests()
    for tests, differ in ((exact, False), (flawed, True)):
        places = np.array([one.bench.T_world_true[:3, 3] for one in tests])
        assert (len(np.unique(places, axis=0)) == len(tests)) == differ
        assert np.abs(places - places[0]).max() < 6 * np.sqrt(2.0) * 1e-5  # six standard deviations of a difference
        weights = [one for one in tests if one.weight is not None and one.weight.any()]
        ratios = np.array([np.linalg.norm(one.equilibrium.load[:3]) / np.linalg.norm(one.weight) for one in weights])
        assert (len(np.unique(np.round(ratios, 9))) == len(weights)) == differ
        assert np.abs(ratios - 1.0).max() < (4 * WEIGHT_STD if differ else 1e-9)
