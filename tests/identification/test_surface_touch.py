"""A touch of given force, section and side is the same as the rod's own solution for a force in surface axes."""

import numpy as np
import pytest

from probedesign.estimation.model import ProbeModel
from probedesign.identification.surface_touch import SurfaceTouch, solve_touch
from probedesign.rod.contact import solve_surface_force


@pytest.mark.parametrize("ratios", [(0.0, 0.0), (0.5, 0.0), (0.0, -0.5), (-0.3, 0.4)])
def test_a_touch_with_friction_is_the_rods_own(ratios: tuple[float, float], model: ProbeModel) -> None:
    """The reference takes friction ratios, the touch the force; wrench, touched point and ratios agree."""
    s, angle = 0.6 * model.rod.length, 2.0
    expected = solve_surface_force(model.rod, model.gravity_base, s, angle, 0.05, ratios)
    assert expected.result == "ok"
    eq, ok = solve_touch(model.rod, model.gravity_base, expected.force_base, s, angle, None, np.zeros(3))
    touch = SurfaceTouch(model.rod, eq, expected.force_base, angle, np.zeros((3, 3)))
    assert ok and touch.converged
    # the couple is found to 1e-5 of force times radius: 2 nN·m here, and a ten-thousandth of a millimetre
    assert eq.wrench_base == pytest.approx(expected.equilibrium.wrench_base, abs=5e-9)
    assert eq.p_contact_base + touch.offset[0] == pytest.approx(expected.p_surface_base, abs=1e-7)
    assert touch.friction[0] == pytest.approx(ratios, abs=1e-4)
