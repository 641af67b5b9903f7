"""Test mass properties against textbook solids and quadrature, and under changes of the frame."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.spatial.transform import Rotation

from probedesign.core.frames import pose, wrench_map
from probedesign.geometry import Flange, ProbeGeometry
from probedesign.geometry.cross_section import FULL_ROUND, CrossSection
from probedesign.geometry.mass import NOTHING, MassProperties, combined, flange_part, flexible_part, frustum

DENSITY = 1010.0
EXACT = 1e-12  #: Relative tolerance of two closed forms, for a few dozen roundings in double precision.
QUADRATURE = 1e-9  #: Relative tolerance of `quad`.

radii = st.floats(1e-4, 0.03)
heights = st.floats(1e-3, 0.4)


def body(*knots_mm: tuple[float, float], section: CrossSection = FULL_ROUND) -> ProbeGeometry:
    """Return a geometry with given (s, radius) [mm]."""
    s, r = np.array(knots_mm).T * 1e-3
    return ProbeGeometry(s, r, Flange(0.02, 0.003), section)


def by_quadrature(geometry: ProbeGeometry) -> MassProperties:
    """Integrate the mass properties of the flexible part over ellipses of semi-axes a and b.

    Of each, A = π a b, ∫y² = π a b³/4 and ∫x² = π a³ b/4.
    """

    def along(f: Callable[[float, float, float], float]) -> float:
        def at(z: float) -> float:
            a = float(geometry.radius_at(z))
            return math.pi * f(a, geometry.cross_section.flatness * a, z)

        pieces = zip(geometry.s[:-1], geometry.s[1:], strict=True)
        return sum(quad(at, z0, z1, epsrel=QUADRATURE, epsabs=0)[0] for z0, z1 in pieces)

    volume = along(lambda a, b, _: a * b)
    z_com = along(lambda a, b, z: a * b * z) / volume
    y2, x2 = along(lambda a, b, _: a * b**3 / 4), along(lambda a, b, _: a**3 * b / 4)
    z2 = along(lambda a, b, z: a * b * (z - z_com) ** 2)
    inertia = DENSITY * np.diag([y2 + z2, x2 + z2, x2 + y2])
    return MassProperties(volume, DENSITY * volume, np.array([0.0, 0.0, z_com]), inertia)


def assert_same(a: MassProperties, b: MassProperties, rel: float) -> None:
    size = math.sqrt(np.trace(b.inertia) / b.mass)  # radius of gyration, the body's own length
    assert a.volume == pytest.approx(b.volume, rel=rel)
    assert a.mass == pytest.approx(b.mass, rel=rel)
    assert a.p_com == pytest.approx(b.p_com, abs=rel * (size + np.linalg.norm(b.p_com)))
    reach = b.mass * (size**2 + b.p_com @ b.p_com)
    assert a.inertia == pytest.approx(b.inertia, abs=rel * reach)


def test_a_cone_as_in_the_textbook():
    """V = π R² h/3, centre at h/4, I_axial = 3 m R²/10, I_lateral = 3 m R²/20 + 3 m h²/80."""
    R, h = 0.006, 0.15
    cone = frustum(R, 0.0, h, 0.0, DENSITY)
    m = DENSITY * math.pi * R**2 * h / 3
    lateral = 3 * m * R**2 / 20 + 3 * m * h**2 / 80
    wanted = MassProperties(m / DENSITY, m, np.array([0, 0, h / 4]), np.diag([lateral, lateral, 3 * m * R**2 / 10]))
    assert_same(cone, wanted, EXACT)


@pytest.mark.parametrize(
    "geometry",
    [
        body((0.0, 6.0), (150.0, 1.0)),
        body((0.0, 6.0), (20.0, 2.0), (60.0, 2.0), (90.0, 3.5), (150.0, 1.0)),
        body((0.0, 0.15), (400.0, 30.0)),
        *(body((0.0, 6.0), (20.0, 2.0), (60.0, 2.0), (90.0, 3.5), (150.0, 1.0), section=CrossSection(flatness=flatness))
          for flatness in (0.2, 0.6, 0.999)),
    ],
)  # fmt: skip
def test_any_profile_against_quadrature(geometry):
    assert_same(flexible_part(geometry, DENSITY), by_quadrature(geometry), 10 * QUADRATURE)


@given(radii, radii, heights, st.floats(0.05, 0.9))
def test_a_hollow_frustum_and_its_core_are_the_full_one(r1, r2, height, bore_ratio):
    tube = frustum(r1, r2, height, 0.0, DENSITY, CrossSection(bore_ratio=bore_ratio))
    core = frustum(bore_ratio * r1, bore_ratio * r2, height, 0.0, DENSITY)
    assert_same(combined([tube, core]), frustum(r1, r2, height, 0.0, DENSITY), EXACT)


@given(radii, radii, heights, st.floats(0.05, 0.95))
def test_a_body_cut_in_two_is_the_same_body(r1, r2, height, cut):
    s = np.array([0.0, cut * height, height])
    r = np.array([r1, r1 + cut * (r2 - r1), r2])
    whole = frustum(r1, r2, height, 0.0, DENSITY)
    assert_same(flexible_part(ProbeGeometry(s, r, Flange(0.02, 0.003)), DENSITY), whole, EXACT)


def test_parallel_axes_against_quadrature_about_the_base():
    """The integral ∫(r⁴/4 + r² z²) about the base agrees with the parallel-axis theorem."""
    geometry = body((0.0, 6.0), (150.0, 1.0))

    def disc(z: float) -> float:
        r = float(geometry.radius_at(z))
        return DENSITY * math.pi * (r**4 / 4 + r**2 * z**2)

    about_base = flexible_part(geometry, DENSITY).inertia_about(np.zeros(3))
    assert about_base[0, 0] == pytest.approx(quad(disc, 0.0, 0.15, epsrel=QUADRATURE)[0], rel=10 * QUADRATURE)


def test_combined_balances_about_its_centre():
    a, b = frustum(0.006, 0.001, 0.15, 0.0, DENSITY), frustum(0.01, 0.01, 0.003, -0.003, 1180.0)
    both = combined([a, b])
    assert both.mass == pytest.approx(a.mass + b.mass, rel=EXACT)
    assert both.mass * both.p_com == pytest.approx(a.mass * a.p_com + b.mass * b.p_com, rel=EXACT)
    p = np.array([0.01, -0.02, 0.03])  # about any point, inertias simply add
    assert both.inertia_about(p) == pytest.approx(a.inertia_about(p) + b.inertia_about(p), rel=1e-10, abs=1e-18)


def test_an_empty_body_has_zero_mass():
    assert combined([]).mass == 0.0
    a = frustum(0.006, 0.001, 0.15, 0.0, DENSITY)
    assert_same(combined([NOTHING, a]), a, EXACT)


T_A_B = pose(Rotation.from_rotvec([0.4, -1.1, 0.6]).as_matrix(), [0.02, -0.03, 0.05])


def test_a_moved_body_is_the_same_body():
    b = combined([frustum(0.006, 0.001, 0.15, 0.0, DENSITY), frustum(0.01, 0.01, 0.003, -0.003, DENSITY)])
    a = b.moved(T_A_B)
    assert (a.mass, a.volume) == (b.mass, b.volume)
    # Moments of 1e-7 to 1e-5 kg·m²: 1e-12 relative to the largest.
    assert np.linalg.eigvalsh(a.inertia) == pytest.approx(np.linalg.eigvalsh(b.inertia), abs=1e-17)
    p_b = np.array([0.01, 0.02, -0.03])
    p_a = (T_A_B @ np.append(p_b, 1.0))[:3]
    R = T_A_B[:3, :3]
    assert a.inertia_about(p_a) == pytest.approx(R @ b.inertia_about(p_b) @ R.T, abs=1e-17)


def test_moving_and_combining_commute():
    parts = [frustum(0.006, 0.001, 0.15, 0.0, DENSITY), frustum(0.01, 0.012, 0.02, -0.02, 1180.0)]
    assert_same(combined(p.moved(T_A_B) for p in parts), combined(parts).moved(T_A_B), EXACT)


def test_the_weight_is_the_same_wrench_in_every_frame():
    body_b = frustum(0.006, 0.001, 0.15, 0.0, DENSITY)
    gravity_b = np.array([9.81, 0.5, -1.0])
    in_frame_a = body_b.moved(T_A_B).wrench(T_A_B[:3, :3] @ gravity_b)
    assert in_frame_a == pytest.approx(wrench_map(T_A_B) @ body_b.wrench(gravity_b), abs=1e-15)


def test_the_weight_of_a_horizontal_probe_bends_about_y():
    """Gravity along +x on a mass at +z: force +x, moment z × x = +y, m g z_com."""
    probe = frustum(0.006, 0.001, 0.15, 0.0, DENSITY)
    wrench = probe.wrench(np.array([9.81, 0.0, 0.0]))
    weight = probe.mass * 9.81
    assert wrench == pytest.approx([weight, 0, 0, 0, weight * probe.p_com[2], 0], rel=EXACT)


def test_the_flange_hangs_below_the_base():
    geometry = body((0.0, 6.0), (150.0, 1.0))
    flange = flange_part(geometry, DENSITY)
    assert flange.p_com[2] == pytest.approx(-geometry.flange.thickness / 2, rel=EXACT)
    volume = math.pi / 4 * geometry.flange.diameter**2 * geometry.flange.thickness
    assert flange.volume == pytest.approx(volume, rel=EXACT)


def test_the_flange_has_the_bore_of_a_hollow_probe():
    """The bore of the flange has its width at s = 0; the flange of a flattened probe is round."""
    knots = ((0.0, 6.0), (150.0, 1.0))
    whole = flange_part(body(*knots), DENSITY)
    holed = flange_part(body(*knots, section=CrossSection(bore_ratio=0.5)), DENSITY)
    assert_same(combined([holed, frustum(0.003, 0.003, 0.003, -0.003, DENSITY)]), whole, EXACT)
    assert_same(flange_part(body(*knots, section=CrossSection(flatness=0.5)), DENSITY), whole, EXACT)
