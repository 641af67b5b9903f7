"""Synthetic campaigns whose touches have friction."""

import numpy as np
import pytest

from probedesign.errors import InputError
from probedesign.simulation.ground_truth import World
from probedesign.simulation.plan import Plan


def states(model, **options):
    plan = Plan("stage", 3, exact=True, **options)
    return World.draw(model, plan, np.random.default_rng(3)).states()


def test_friction_is_in_the_touches_alone(models):
    """Tests of the free probe stay as they are; a touch's force leaves the normal by its own friction."""
    plain, rubbed = (states(models["large"], friction=mu) for mu in (0.0, 0.6))
    for one, other in zip(plain, rubbed, strict=True):
        if one.p_surface_base is None:
            assert np.array_equal(one.wrench_sensor, other.wrench_sensor) and other.friction == 0.0
    touched = [state for state in rubbed if state.p_surface_base is not None]
    ratios = np.array([state.friction for state in touched])
    assert len(set(ratios)) == len(ratios) and (ratios > 0.0).all() and (ratios < 2.0).all()
    for state in touched:
        F, eq = state.equilibrium.load[0:3], state.equilibrium
        arm = state.p_surface_base - eq.p_contact_base
        slope = models["large"].rod.taper_at(eq.s_contact)
        normal = arm / np.linalg.norm(arm) + slope * eq.R_at(eq.s_contact)[:, 2]
        pushes = -float(F @ normal) / np.linalg.norm(normal)
        assert np.sqrt(F @ F - pushes**2) / pushes == pytest.approx(state.friction, rel=1e-5)


def test_what_is_no_friction(models):
    with pytest.raises(InputError, match=r"--friction -0.5 must lie in 0 \.\.\. 3"):
        Plan(friction=-0.5)
    with pytest.raises(InputError, match=r"--friction-spread 2 must lie in 0 \.\.\. 1"):
        Plan(friction_spread=2.0)
