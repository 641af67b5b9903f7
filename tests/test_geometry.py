"""Geometry and sections: the radius that everything else is made of."""

import math

import numpy as np
import pytest

from probedesign.design import check_design
from probedesign.geometry import FLANGE_MIN_D, ProbeGeometry, build_geometry, flange_for
from probedesign.section import area, polar_moment, second_moment

EXACT = 1e-12
"""Relative: a handful of roundings of double precision."""


def geometry_of(shape="cone", length=150.0, base=12.0, tip=2.0, profile=None) -> ProbeGeometry:
    """Geometry of a probe by its dimensions [mm]."""
    probe = {"shape": shape, "length_mm": length, "base_d_mm": base, "tip_d_mm": tip, "profile_mm": profile}
    return build_geometry(check_design({"schema": 1, "name": "g", "probe": probe}))


def test_a_cone_is_straight_from_base_to_tip():
    cone = geometry_of()
    assert (cone.length, cone.base_radius, cone.tip_radius) == pytest.approx((0.15, 0.006, 0.001), rel=EXACT)
    assert cone.radius_at([0.0, 0.075, 0.15]) == pytest.approx([0.006, 0.0035, 0.001], rel=EXACT)


def test_a_cylinder_needs_no_tip_and_has_one_radius():
    cylinder = geometry_of("cylinder", tip=None)
    assert np.ptp(cylinder.radius_at(np.linspace(0, cylinder.length, 7))) == 0.0
    assert cylinder.tip_radius == pytest.approx(0.006, rel=EXACT)


def test_a_profile_goes_through_its_knots():
    stepped = geometry_of("profile", 100.0, 10.0, 2.0, [[0.0, 10.0], [20.0, 4.0], [60.0, 4.0], [100.0, 2.0]])
    assert stepped.radius_at(np.array([20.0, 40.0, 80.0]) * 1e-3) == pytest.approx(
        [0.002, 0.002, 0.0015], rel=EXACT
    )


def test_section_properties_of_a_round_section():
    """A = π d²/4, I = π d⁴/64, J = π d⁴/32: any table of sections."""
    cone, s = geometry_of(), np.linspace(0.0, 0.15, 5)
    d = 2.0 * cone.radius_at(s)
    assert area(cone, s) == pytest.approx(math.pi * d**2 / 4, rel=EXACT)
    assert second_moment(cone, s) == pytest.approx(math.pi * d**4 / 64, rel=EXACT)
    assert polar_moment(cone, s) == pytest.approx(math.pi * d**4 / 32, rel=EXACT)


def test_fingerprint_stands_for_the_dimensions_alone():
    assert geometry_of().fingerprint == geometry_of().fingerprint
    assert len(geometry_of().fingerprint) == 12
    as_profile = geometry_of("profile", profile=[[0.0, 12.0], [150.0, 2.0]])
    assert as_profile.fingerprint == geometry_of().fingerprint


@pytest.mark.parametrize(
    "change", [{"length": 150.01}, {"base": 12.01}, {"tip": 2.01}, {"shape": "cylinder", "tip": None}]
)
def test_fingerprint_sees_a_hundredth_of_a_millimetre(change):
    assert geometry_of(**change).fingerprint != geometry_of().fingerprint


def test_flange_carries_the_probe_and_covers_the_sensor():
    assert flange_for(0.012).diameter > 0.012
    assert flange_for(0.003).diameter == FLANGE_MIN_D
    assert geometry_of().flange == flange_for(geometry_of().base_radius * 2.0)
