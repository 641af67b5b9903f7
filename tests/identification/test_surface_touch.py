"""A touch of given force, section and side is the same as the rod's own solution for a force in surface axes."""

from dataclasses import replace

import numpy as np
import pytest

from probedesign.estimation.model import ProbeModel
from probedesign.geometry.cross_section import CrossSection
from probedesign.identification.surface_touch import COUPLE_COLUMNS, SurfaceTouch, solve_touch
from probedesign.rod.contact import solve_surface_force


@pytest.mark.parametrize("ratios", [(0.0, 0.0), (0.5, 0.0), (0.0, -0.5), (-0.3, 0.4)])
@pytest.mark.parametrize("flatness", [1.0, 0.7])
def test_a_touch_with_friction_is_the_rods_own(ratios: tuple[float, float], flatness: float, model: ProbeModel) -> None:
    """The reference takes friction ratios, the touch the force; wrench, touched point and ratios agree."""
    rod = replace(model.rod, finite_strain=False, factors=CrossSection(flatness=flatness).factors)
    s, angle = 0.6 * rod.length, 2.0
    expected = solve_surface_force(rod, model.gravity_base, s, angle, 0.01, ratios)
    assert expected.result == "ok"
    eq, ok = solve_touch(rod, model.gravity_base, expected.force_base, s, angle, None, np.zeros(3))
    touch = SurfaceTouch(rod, eq, expected.force_base, angle, np.zeros((3, 3, 0)))
    assert ok and touch.converged
    # the couple is found to 1e-5 of force times radius: 0.4 nN·m here, and a ten-thousandth of a millimetre
    assert eq.wrench_base == pytest.approx(expected.equilibrium.wrench_base, abs=5e-9)
    assert eq.p_contact_base + touch.offset[0] == pytest.approx(expected.p_surface_base, abs=1e-7)
    assert touch.friction[0] == pytest.approx(ratios, abs=1e-4)


@pytest.mark.parametrize("flatness", [1.0, 0.7])
def test_derivatives_by_the_angle_and_the_force_are_differences(flatness: float, model: ProbeModel) -> None:
    """Of the couple, the touched point and the friction, at the section as it is."""
    rod = replace(model.rod, finite_strain=False, factors=CrossSection(flatness=flatness).factors)
    s, angle, force, h = 0.6 * rod.length, 0.8, np.array([-0.008, -0.006, 0.002]), 1e-5
    eq = rod.solve(model.gravity_base, force, s, columns="all")

    def at(angle: float, force: np.ndarray) -> np.ndarray:
        touch = SurfaceTouch(rod, eq, force, angle, np.zeros((3, 3, 0)))
        return np.concatenate([touch.couple[0], touch.offset[0], touch.friction[0]])

    touch = SurfaceTouch(rod, eq, force, angle, np.zeros((3, 3, 0)))
    found = at(angle + h, force) - at(angle - h, force)
    couple = (np.eye(3) - touch.couple[1][:, COUPLE_COLUMNS]) @ touch.couple_response[:, -1]
    wanted = 2.0 * h * np.concatenate([couple, touch.offset[1][:, -1], touch.friction[1][:, -1]])
    np.testing.assert_allclose(found, wanted, atol=1e-8 * h, rtol=1e-6)
    along = np.array([1.0, -2.0, 0.5]) * 1e-7
    moved = at(angle, force + along) - at(angle, force - along)
    explicit = np.cross(touch.offset[0], 2.0 * along)
    np.testing.assert_allclose(moved[:3], explicit, atol=1e-15)
