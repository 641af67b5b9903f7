"""The axis of a probe: closed forms, an independent integration, mass, and what a body cannot follow."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from probedesign.core.errors import InputError
from probedesign.design import check_design
from probedesign.geometry import Axis, CrossSection, Flange, ProbeGeometry
from probedesign.geometry.mass import flexible_part
from probedesign.probe import build_probe

L = 0.15
HELICES = [(60.0, 0.5, -90.0), (40.0, 1.0, 30.0), (30.0, -2.0, 0.0)]  # radius [mm], turns, azimuth [deg]


def design_of(**probe):
    return check_design(
        {"schema": 1, "name": "curved", "mount": {"root_rigid_radii": 0.0},
         "probe": {"shape": "cone", "length_mm": 150.0, "base_d_mm": 12.0, "tip_d_mm": 2.0} | probe}
    )  # fmt: skip


def whisker(kind="arc", **probe):
    return design_of(axis=kind, **probe)


def test_an_arc_is_a_circle_in_the_plane_of_its_azimuth():
    bend, azimuth = np.radians(90.0), np.radians(-90.0)
    s = np.linspace(0.0, L, 7)
    T, R = Axis.helix(L, bend, 0.0, azimuth).frames(s), L / bend
    np.testing.assert_allclose(T[:, 1, 3], -R * (1.0 - np.cos(s / R)), atol=1e-15)
    np.testing.assert_allclose(T[:, 2, 3], R * np.sin(s / R), atol=1e-15)
    np.testing.assert_allclose(T[-1, :3, :3], [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=1e-14)


@pytest.mark.parametrize(("radius", "turns", "azimuth"), HELICES)
def test_a_helix_bends_as_its_equation_says(radius, turns, azimuth):
    """dt/ds = κ (cos φ X + sin φ Y), dX/ds = -κ cos φ t, dY/ds = -κ sin φ t, by another integrator.

    The linear curvature between the knots may move the tip by 5 µm; the error falls with the cube of their distance.
    """
    kappa, start = 1e3 / radius, np.radians(azimuth)

    def rates(s, y):
        X, Y, t = y[3:6], y[6:9], y[9:12]
        phase = start + 2.0 * np.pi * turns * s / L
        x, y_ = kappa * np.cos(phase), kappa * np.sin(phase)
        return np.concatenate([t, -x * t, -y_ * t, x * X + y_ * Y])

    first = np.concatenate([np.zeros(3), np.eye(3).ravel()])
    s = np.linspace(0.0, L, 5)
    truth = solve_ivp(rates, (0.0, L), first, t_eval=s, rtol=1e-11, atol=1e-13).y.T
    T = Axis.helix(L, kappa * L, turns, start).frames(s)
    np.testing.assert_allclose(T[:, :3, 3], truth[:, :3], atol=5e-6)
    np.testing.assert_allclose(T[:, :3, :3].transpose(0, 2, 1).reshape(-1, 9), truth[:, 3:], atol=1e-4)


@pytest.mark.parametrize("turns", [0.0, 1.0])
def test_frames_are_rotations_that_do_not_depend_on_what_is_asked_for(turns):
    axis = Axis.helix(L, 3.0, turns, 0.4)
    T = axis.frames([L, 0.02, 0.1234])
    np.testing.assert_allclose(
        T[:, :3, :3].transpose(0, 2, 1) @ T[:, :3, :3], np.tile(np.eye(3), (3, 1, 1)), atol=1e-14
    )
    np.testing.assert_allclose(axis.frames([0.1234])[0], T[2], atol=1e-10)  # another grid: the error of the integration


def test_knots_of_a_constant_curvature_are_the_arc():
    knots = ((0.0, 0.0, -10.0), (40.0, 0.0, -10.0), (150.0, 0.0, -10.0))
    by_knots = design_of(axis="knots", axis_knots_mm_1_m=knots).probe.designed_axis
    arc = whisker(axis_bend_deg=np.degrees(1.5), axis_azimuth_deg=-90.0).probe.designed_axis
    np.testing.assert_allclose(by_knots.frames([0.05, L]), arc.frames([0.05, L]), atol=1e-13)


def test_a_quarter_of_a_torus_weighs_as_pappus_says():
    """V = π r² L; the centre lies (R + r²/(4R)) (sin θ/θ, (1 - cos θ)/θ) from the centre of curvature (∫ρ dA = A R,
    ∫ρ² dA = A (R² + r²/4)); the inertia about the torus' axis is M (R² + 3/4 r²)."""
    r, R = 0.006, 2.0 * L / np.pi
    arc = Axis.helix(L, np.pi / 2.0)
    body = ProbeGeometry(np.array([0.0, L]), np.array([r, r]), Flange(0.02, 0.003), curved=arc)
    mass = flexible_part(body, 1000.0)
    assert mass.volume == pytest.approx(np.pi * r**2 * L, rel=1e-12)
    centre = (R + r**2 / (4.0 * R)) * 2.0 / np.pi
    np.testing.assert_allclose(mass.p_com, [R - centre, 0.0, centre], atol=1e-12)
    about = mass.inertia_about(np.array([R, 0.0, 0.0]))[1, 1]
    assert about == pytest.approx(mass.mass * (R**2 + 0.75 * r**2), rel=1e-10)


@pytest.mark.parametrize("section", [CrossSection(), CrossSection(bore_ratio=0.5), CrossSection(flatness=0.6)])
def test_the_mass_of_a_nearly_straight_axis_is_that_of_the_straight_one(section):
    straight = ProbeGeometry(np.array([0.0, 0.07, L]), np.array([6e-3, 4e-3, 1e-3]), Flange(0.02, 0.003), section)
    curved = replace(straight, curved=Axis.helix(L, 1e-7))
    ours, frusta = flexible_part(curved, 1010.0), flexible_part(straight, 1010.0)
    assert ours.mass == pytest.approx(frusta.mass, rel=1e-12)
    np.testing.assert_allclose(ours.p_com, frusta.p_com, atol=1e-7 * L)  # the tip moves by half of that
    np.testing.assert_allclose(ours.inertia, frusta.inertia, rtol=1e-6, atol=1e-6 * frusta.inertia[0, 0])


@pytest.mark.parametrize(("radius", "turns", "azimuth"), HELICES)
def test_the_unloaded_rod_lies_on_the_axis_and_a_loaded_one_on_that_of_many_knots(radius, turns, azimuth):
    """Against a rod whose curvature is that of the exact helix at 800 knots: 20 µm and 3e-4 of the moment."""
    bend = 150.0 / radius
    probe = build_probe(whisker("helix", axis_bend_deg=np.degrees(bend), axis_turns=turns, axis_azimuth_deg=azimuth))
    at_rest = probe.rod.solve(mode="reference")
    np.testing.assert_allclose(at_rest.p_base, probe.geometry.axis.frames(at_rest.s)[:, :3, 3], atol=1e-9)
    s = np.linspace(0.0, L, 801)
    angle = np.radians(azimuth) + 2.0 * np.pi * turns * s / L
    fine = replace(
        probe.rod, s=s, radius=probe.rod.radius_at(s),
        rest_curvature=bend / L * np.stack([-np.sin(angle), np.cos(angle), 0.0 * s], axis=1),
    )  # fmt: skip
    load = {"gravity": (9.81, 0.0, 0.0), "force": (0.012, -0.016, 0.008), "s_contact": 0.8 * L}
    ours, exact = probe.rod.solve(**load, mode="reference"), fine.solve(**load, mode="reference")
    assert np.linalg.norm(ours.p_contact_base - exact.p_contact_base) < 20e-6
    moments = ours.wrench_base[3:], exact.wrench_base[3:]
    assert np.linalg.norm(moments[0] - moments[1]) < 3e-4 * np.linalg.norm(moments[1])


def test_the_fingerprint_tells_axes_apart():
    bends = [None, 0.0, 40.0, 40.000000001, 41.0]
    designs = [design_of() if bend is None else whisker(axis_bend_deg=bend) for bend in bends]
    straight, a, b, c, d = (build_probe(design).geometry.fingerprint for design in designs)
    assert straight == a != b == c != d != a


BAD = [
    ({"axis": "arc"}, "axis_bend_deg is missing"),
    ({"axis": "helix", "axis_bend_deg": 90.0}, "axis_turns is missing"),
    ({"axis": "knots"}, "axis_knots_mm_1_m is missing"),
    ({"axis_bend_deg": 90.0}, 'axis_bend_deg is only for axis = "arc" or "helix"'),
    ({"axis": "arc", "axis_bend_deg": 90.0, "axis_turns": 1.0}, 'axis_turns is only for axis = "helix"'),
    ({"axis": "arc", "axis_bend_deg": 1000.0}, "axis_bend_deg = 1000 has a radius of curvature of 8.59 mm at s = 0 mm; "
     "at least 12 mm"),
    ({"axis": "arc", "axis_bend_deg": 200.0}, "axis_bend_deg = 200 returns into the mount"),
    ({"axis": "helix", "axis_bend_deg": 700.0, "axis_turns": 1.5, "base_d_mm": 20.0}, "axis_bend_deg = 700"),
    ({"axis": "knots", "axis_knots_mm_1_m": ((0, 1, 1), (5, 2, 2), (3, 3, 3), (150, 1, 1))}, "triple 3: s = 3.0"),
    ({"axis": "knots", "axis_knots_mm_1_m": ((0, 1, 1), (149, 1, 1))}, "must equal length_mm = 150.0"),
    ({"axis": "knots", "axis_knots_mm_1_m": ((0, 1, float("nan")), (150, 1, 1))}, "finite"),
]  # fmt: skip


@pytest.mark.parametrize(("probe", "message"), BAD)
def test_an_impossible_axis_names_key_value_and_limit(probe, message):
    with pytest.raises(InputError, match=message.replace("(", r"\(")):
        design_of(**probe)


def test_the_largest_bend_that_a_message_names_is_accepted():
    with pytest.raises(InputError, match="at most") as refused:
        whisker(axis_bend_deg=200.0)
    most = float(str(refused.value).split("at most ")[1].split()[0])
    assert 170.0 < most < 200.0 and whisker(axis_bend_deg=most).probe.axis_bend_deg == most


def test_a_body_that_meets_itself_is_refused():
    """A circle of more than a turn at 45 degrees to the mount's face meets itself after the turn."""
    s = np.array([0.0, 0.02, 0.0201, L])
    k = np.array([[0.0, 0.0], [0.0, 0.0], [60.0, 0.0], [60.0, 0.0]])
    assert "meet itself" in Axis(s, k).conflict(np.array([0.0, L]), np.array([1e-3, 1e-3]))
