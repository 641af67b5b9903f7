"""Test the rounded tip: frusta around a sphere, equal in mechanics and CAD, and estimates of touches on it."""

import math

import numpy as np
import pytest

from probedesign.core.errors import InputError
from probedesign.design import Design, check_design, parse_design
from probedesign.geometry.mass import flexible_part
from probedesign.geometry.probe_geometry import DEVIATION_MM, filleted
from probedesign.mount import build_geometry
from probedesign.prediction.predict import predict_touch
from probedesign.probe import build_probe
from probedesign.rod.contact import solve_frictionless

BODIES = [
    {"length_mm": 150.0, "base_d_mm": 12.0, "tip_d_mm": 2.0},
    {"length_mm": 30.0, "base_d_mm": 25.0, "tip_d_mm": 1.2},  # the bluntest cone of the grid
    {"shape": "cylinder", "length_mm": 60.0, "base_d_mm": 12.0},
    {"shape": "profile", "length_mm": 60.0, "base_d_mm": 6.0, "profile_mm": [[0, 6], [30, 4], [60, 8]]},
]
IDS = ["large", "blunt cone", "cylinder", "widening"]


def design_of(tip: str = "rounded", **probe: object) -> Design:
    return check_design({"schema": 1, "name": "g", "probe": {**(probe or BODIES[0]), "tip": tip}})


def sphere(body: dict[str, object]) -> tuple[float, float]:
    """Height of the centre and radius of the sphere that touches flank and end plane [mm], from those two alone."""
    (s0, d0), (s1, d1) = design_of("blunt", **body).probe.knots_mm[-2:]
    tan = (d0 - d1) / 2 / (s1 - s0)
    # The centre at height L - R is R off the flank: (d1/2 + tan R) cos α = R.
    cos = 1 / math.hypot(1.0, tan)
    R = d1 / 2 * cos / (1 - tan * cos)
    return s1 - R, R


@pytest.mark.parametrize("body", BODIES, ids=IDS)
def test_every_facet_touches_the_sphere_and_none_deviates_far(body) -> None:
    design, blunt = design_of(**body), design_of("blunt", **body)
    centre, R = sphere(body)
    knots = np.array(design.probe.knots_mm) * [1.0, 0.5]
    start = len(blunt.probe.knots_mm) - 1
    corners = np.vstack([knots[start - 1 :], [design.probe.length_mm, 0.0]])  # to the middle of the flat end
    way = np.diff(corners, axis=0)
    off = np.abs(way[:, 0] * (0.0 - corners[:-1, 1]) - way[:, 1] * (centre - corners[:-1, 0]))
    assert off / np.linalg.norm(way, axis=1) == pytest.approx(R, rel=1e-9)  # tangent: rounding errors alone
    off = np.hypot(knots[start:, 0] - centre, knots[start:, 1]) - R
    assert 0.0 < off.max() <= DEVIATION_MM * (1 + 1e-9)


@pytest.mark.parametrize("body", BODIES, ids=IDS)
def test_the_rounding_takes_nothing_of_the_length_and_weighs_as_the_round_body(body) -> None:
    design = design_of(**body)
    geometry, blunt = build_geometry(design), build_geometry(design_of("blunt", **body))
    assert geometry.length == blunt.length and geometry.flange == blunt.flange
    assert geometry.radius_at(geometry.flank_end) == pytest.approx(blunt.radius_at(geometry.flank_end), rel=1e-12)
    # Of the sphere's own cap the frusta differ by a shell as thin as the deviation.
    centre, R = sphere(body)
    tan = (blunt.radius[-2] - blunt.radius[-1]) / (blunt.s[-1] - blunt.s[-2])
    touch = centre + R * tan / math.hypot(1.0, tan)  # where sphere and flank touch
    h = centre + R - touch
    cap = math.pi * h * h * (R - h / 3)
    r0, r1 = (1e3 * float(blunt.radius_at(z * 1e-3)) for z in (touch, touch + h))
    removed = math.pi * h / 3 * (r0 * r0 + r0 * r1 + r1 * r1) - cap
    thinner = 1e9 * (flexible_part(blunt, 1.0).volume - flexible_part(geometry, 1.0).volume)
    assert 0.0 <= removed - thinner <= 2 * math.pi * R * h * DEVIATION_MM


def test_a_blunt_tip_stays_what_it_was() -> None:
    blunt = build_geometry(design_of("blunt"))
    assert blunt.fingerprint == "dbfe02e41516" and blunt.flank_end == blunt.length
    assert build_geometry(design_of()).fingerprint != blunt.fingerprint


def test_the_least_feature_is_that_of_the_flank() -> None:
    """The print check uses the width of the tip, not that of the end of the sphere."""
    assert build_geometry(design_of()).thinnest == pytest.approx(2e-3, rel=0.03)


def test_a_round_end_that_does_not_fit_is_one_line() -> None:
    with pytest.raises(InputError, match=r'tip = "rounded" takes the last 4\.\d+ mm and only 2 mm .* at most') as error:
        design_of(shape="profile", length_mm=50.0, base_d_mm=10.0, profile_mm=[[0, 10], [48, 9], [50, 8.5]])
    assert "\n" not in str(error.value)
    with pytest.raises(InputError, match=r'would close the bore .* use tip = "blunt"'):
        design_of(**BODIES[0], section="hollow", bore_ratio=0.5)


@pytest.mark.parametrize("s_mm", [120.0, 145.0, 148.9])
def test_touches_of_the_flank_are_located_up_to_the_rounding(s_mm: float) -> None:
    probe = build_probe(design_of())
    touch = solve_frictionless(probe.rod, probe.estimator().model.gravity_base, 1e-3 * s_mm, 0.9, 0.01)
    found = probe.estimator().estimate(touch.equilibrium.wrench_base)
    # Noise-free: 0.002 mm, as for blunt tips (tests/estimation/test_location.py).
    assert found.ok and found.p_contact_base == pytest.approx(touch.equilibrium.p_contact_base, abs=2e-6)


STUBBY = {"length_mm": 60.0, "base_d_mm": 12.0, "tip_d_mm": 6.0}


@pytest.mark.parametrize("lean_deg", [15.0, 60.0])
@pytest.mark.parametrize(("body", "force_N"), [(BODIES[0], 0.005), (STUBBY, 0.02), (STUBBY, 0.15)])
def test_a_touch_of_the_round_end_is_located_at_the_centre_of_its_sphere(
    body: dict[str, object], force_N: float, lean_deg: float
) -> None:
    """All normals of the spherical end intersect the axis at its centre."""
    probe = build_probe(design_of(**body))
    s, lean = 1e-3 * sphere(body)[0], math.radians(lean_deg)
    eq = probe.solve()
    for _ in range(60):  # the push turns with the bent tip
        push = math.cos(lean) * eq.R_at(s)[:, 1] - math.sin(lean) * eq.R_at(s)[:, 2]
        eq = probe.solve(s_contact=s, force_base=force_N * push)
        assert eq.ok
    found = probe.estimator().estimate(eq.wrench_base)
    end = [c for c in found.candidates if abs(c.s_contact - s) < 1e-9]
    if end:  # a bent probe may be touched elsewhere to the same effect; then its result is not ok
        assert found.result in ("ok", "ambiguous", "interval_only")  # 5 mN are light
        assert end[0].force_base == pytest.approx(force_N * push, abs=1e-4 * force_N)
        assert end[0].p_contact_base == pytest.approx(eq.p_contact_base, abs=2e-6)
        touched = eq.p_contact_base - push * (probe.length - s)
        assert end[0].p_surface_base == pytest.approx(touched, abs=1e-5)
    else:  # too light for the lean to show: the flank close by explains it as well
        best = found.candidates[0]
        assert found.result in ("ok", "interval_only") and abs(best.s_contact - s) < 3.0 * best.std_s


@pytest.mark.parametrize(("side_deg", "lean_deg"), [(20.0, 30.0), (90.0, 45.0), (140.0, 60.0)])
def test_a_touch_of_the_round_end_of_an_elliptic_probe_is_located_on_its_ellipsoid(
    side_deg: float, lean_deg: float
) -> None:
    """The push acts where the ellipsoid with the semi-axes R, f R, R has its direction as normal."""
    probe = build_probe(design_of(**STUBBY, section="elliptic", flatness=0.6))
    s, side, lean = 1e-3 * sphere(STUBBY)[0], math.radians(side_deg), math.radians(lean_deg)
    inward = -np.array([math.cos(lean) * math.cos(side), math.cos(lean) * math.sin(side), math.sin(lean)])
    semi_axes = (probe.length - s) * np.array([1.0, 0.6, 1.0])
    arm = -(semi_axes**2) * inward / np.linalg.norm(semi_axes * inward)
    eq = probe.rod.solve(probe.model.gravity_base)
    for _ in range(60):  # the push turns with the bent tip
        R = eq.R_at(s)
        push = 0.04 * R @ inward
        eq = probe.rod.solve(probe.model.gravity_base, push, s, couple=np.cross(R @ arm, push))
        assert eq.ok
    found = probe.estimator().estimate(eq.wrench_base)
    (end,) = (c for c in found.candidates if abs(c.s_contact - s) < 1e-9)
    assert found.result in ("ok", "ambiguous")
    assert end.force_base == pytest.approx(push, abs=1e-5)
    # The search ends within a thousandth of a standard deviation, of a hundredth of a millimetre or so.
    assert end.p_surface_base == pytest.approx(eq.p_contact_base + R @ arm, abs=1e-5)


def test_a_load_beyond_the_flank_is_no_touch() -> None:
    """The line of action passes the centre at nearly the radius, which needs friction far beyond the prior. A touch of
    the flank explains it with a friction of 1, which the prior of 0.6 still allows and one of 0.2 does not."""
    probe = build_probe(design_of())
    eq = probe.solve(s_contact=probe.length, force_base=(0.0, 0.05, 0.0))
    assert eq.ok  # the rod holds it, and thin as it is there, nothing jumps
    assert np.linalg.norm(eq.p_at(probe.length) - eq.p_at(probe.geometry.flank_end)) < 1.5e-3
    found = probe.estimator().with_friction(0.2).estimate(eq.wrench_base)
    assert found.result in ("inconsistent", "out_of_range", "unobservable")
    assert np.isnan(found.p_surface_base).all()


def test_what_is_predicted_at_the_tip_is_a_touch_of_the_flank() -> None:
    """The slope of a facet must not appear as an inclination of the force; the blunt probe has the same reading."""
    rounded, blunt = (build_probe(design_of(tip)) for tip in ("rounded", "blunt"))
    tip = predict_touch(rounded.estimator(), 1.0, 0.005, "+y")
    same = predict_touch(blunt.estimator(), rounded.geometry.flank_end / blunt.length, 0.005, "+y")
    # A milligram less at the tip bends it by a few parts in a thousand less.
    assert tip.moment_per_N_Nmm == pytest.approx(same.moment_per_N_Nmm, rel=0.005)
    assert tip.predicted_error_mm == pytest.approx(same.predicted_error_mm, rel=0.02)


@pytest.mark.parametrize(("base_d", "tip_d", "radius"), [(12.0, 12.0, 1.5), (12.0, 2.0, 2.0), (12.0, 4.0, 0.5)])
def test_the_fillet_lies_on_a_circle_that_touches_flange_and_flank(base_d, tip_d, radius):
    blunt = ((0.0, base_d), (60.0, tip_d))
    knots, height = filleted(blunt, radius)
    z, r = np.array(knots).T * [[1.0], [0.5]]
    slope = (base_d - tip_d) / 2 / 60.0
    assert z[0] == 0.0 and height == z[-1] and (np.diff(z) > 0).all() and (np.diff(r) < 0).all()
    assert r[-1] == pytest.approx(base_d / 2 - slope * z[-1])  # on the flank
    centre = np.array([r[0], radius])
    assert np.hypot(r - centre[0], z - centre[1]) == pytest.approx(radius)
    to_flank = (centre[0] - (base_d / 2 - slope * radius)) * np.cos(np.arctan(slope))
    assert to_flank == pytest.approx(radius)  # tangent
    sagitta = radius - np.hypot((r[1:] + r[:-1]) / 2 - centre[0], (z[1:] + z[:-1]) / 2 - centre[1])
    assert (sagitta <= DEVIATION_MM + 1e-9).all()


def test_a_fillet_widens_base_and_flange_and_nothing_above_it():
    text = 'schema = 1\nname = "x"\n[probe]\nlength_mm = 60.0\nbase_d_mm = 12.0\ntip_d_mm = 6.0\n'
    plain, wide = (build_geometry(parse_design(text + more)) for more in ("", "base_fillet_mm = 1.5\n"))
    s = np.linspace(2e-3, 60e-3, 50)
    assert wide.radius_at(s) == pytest.approx(plain.radius_at(s), rel=1e-12)
    assert wide.base_radius > plain.base_radius and wide.flange.diameter > plain.flange.diameter
    assert wide.fingerprint != plain.fingerprint
    with pytest.raises(InputError, match=r"base_fillet_mm = 5 ends at s = "):
        parse_design(text.replace("60.0", "5.0").replace("6.0", "12.0") + "base_fillet_mm = 5.0\n")
