"""Ground truth of simulated campaigns whose touches have friction."""

import numpy as np
import pytest

from probedesign.core.errors import InputError
from probedesign.prediction.table_one import paper_design
from probedesign.probe import build_probe
from probedesign.simulation.ground_truth import CampaignPlan, GroundTruth


@pytest.fixture(scope="module")
def model():
    return build_probe(paper_design("large")).model


def simulated_tests(model, **options):
    plan = CampaignPlan("stage", 3, exact=True, **options)
    return GroundTruth.draw(model, plan, np.random.default_rng(3)).tests()


def test_only_touches_have_friction(model):
    """Tests of the free probe stay as they are; a touch's force leaves the normal by its own friction."""
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
