"""Test the radius of the profile and the properties of sections."""

import math

import numpy as np
import pytest

from probedesign.design import check_design
from probedesign.design.sensor_catalog import SENSORS
from probedesign.geometry import ProbeGeometry, flange_for
from probedesign.mount import build_geometry

EXACT = 1e-12  #: Relative tolerance for a few roundings in double precision.


def geometry_of(
    shape="cone", length=150.0, base=12.0, tip=2.0, profile=None, bore_ratio=None, flatness=None
) -> ProbeGeometry:
    """Return the geometry of a probe with given dimensions [mm]."""
    probe = {"shape": shape, "length_mm": length, "base_d_mm": base, "tip_d_mm": tip, "profile_mm": profile}
    probe["section"] = "hollow" if bore_ratio else "elliptic" if flatness else "round"
    probe |= {"bore_ratio": bore_ratio, "flatness": flatness}
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
    assert stepped.radius_at(np.array([20.0, 40.0, 80.0]) * 1e-3) == pytest.approx([0.002, 0.002, 0.0015], rel=EXACT)


def test_section_properties_are_those_of_any_table():
    """A, I_xx and I_yy of a tube with d = 0.6 D, and of an ellipse with semi-axes a and b = a/2."""
    s = np.linspace(0.0, 0.15, 5)
    a = geometry_of().radius_at(s)
    D, d, b = 2.0 * a, 1.2 * a, 0.5 * a
    ring = math.pi * (D**4 - d**4) / 64
    for section, (A, xx, yy) in (
        ({}, (math.pi * D**2 / 4, math.pi * D**4 / 64, math.pi * D**4 / 64)),
        ({"bore_ratio": 0.6}, (math.pi * (D**2 - d**2) / 4, ring, ring)),
        ({"flatness": 0.5}, (math.pi * a * b, math.pi * a * b**3 / 4, math.pi * a**3 * b / 4)),
    ):
        body = geometry_of(**section)
        assert body.area_at(s) == pytest.approx(A, rel=EXACT, abs=0)
        assert body.second_moment_xx_at(s) == pytest.approx(xx, rel=EXACT, abs=0)
        assert body.second_moment_yy_at(s) == pytest.approx(yy, rel=EXACT, abs=0)


def test_what_is_thinnest_is_a_wall_or_a_diameter():
    assert geometry_of().thinnest == pytest.approx(2e-3, rel=EXACT)
    assert geometry_of(bore_ratio=0.6).thinnest == pytest.approx(0.4e-3, rel=EXACT)
    assert geometry_of(flatness=0.5).thinnest == pytest.approx(1e-3, rel=EXACT)


def test_fingerprint_depends_on_the_dimensions_alone():
    assert geometry_of().fingerprint == geometry_of().fingerprint
    assert len(geometry_of().fingerprint) == 12
    as_profile = geometry_of("profile", profile=[[0.0, 12.0], [150.0, 2.0]])
    assert as_profile.fingerprint == geometry_of().fingerprint


def test_fingerprint_of_a_round_probe_never_changes():
    """The fingerprint of the large probe, which printed parts and frozen probes have, has not changed."""
    assert geometry_of().fingerprint == "dbfe02e41516"
    assert geometry_of(flatness=1.0).fingerprint == "dbfe02e41516"  # it is the same body


def test_fingerprint_sees_a_hundredth_of_a_millimetre_and_the_section():
    changes = [{}, {"length": 150.01}, {"base": 12.01}, {"tip": 2.01}, {"shape": "cylinder", "tip": None},
               *({key: value} for key in ("bore_ratio", "flatness") for value in (0.5, 0.501))]  # fmt: skip
    assert len({geometry_of(**change).fingerprint for change in changes}) == len(changes)


def test_flange_carries_the_probe_and_covers_the_sensor():
    assert flange_for(0.012, 0.017).diameter > 0.017
    assert flange_for(0.003, 0.017).diameter == 0.017
    assert geometry_of().flange == flange_for(geometry_of().base_radius * 2.0, SENSORS["nano17"].interface.tool.face_d)
