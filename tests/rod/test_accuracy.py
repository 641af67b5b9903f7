"""Compare the fast mode with the reference mode, and the equilibrium between its nodes."""

import numpy as np
import pytest
from rods import ALL_RODS, PROFILE, bending_force

from probedesign.geometry.cross_section import CrossSection
from probedesign.rod.rod import Rod

SAMPLE = 50


def random_rod(rng, kind):
    """A cone 30-200 mm long, 2-20 mm thick, 0.3-10 MPa; flattened to no less than half, or curved by up to a radian."""
    length, radius = rng.uniform(0.03, 0.2), rng.uniform(1e-3, 10e-3)
    modulus = np.exp(rng.uniform(np.log(0.3e6), np.log(10e6)))
    more = {}
    if kind in ("elliptic", "everything"):
        more["factors"] = CrossSection(flatness=rng.uniform(0.5, 1.0)).factors
    if kind in ("curved", "everything"):
        more["rest_curvature"] = rng.uniform(-1.0, 1.0, (2, 3)) / length
    if kind == "finite":
        more["finite_strain"] = True
    return Rod(
        s=np.array([0.0, length]),
        radius=radius * np.array([1.0, rng.uniform(0.1, 1.0)]),
        youngs_modulus=modulus,
        shear_modulus=rng.uniform(0.3, 0.4) * modulus,
        density=rng.uniform(900.0, 1200.0),
        rigid_length=rng.choice([0.0, 0.12, -0.2]) * radius,
        **more,
    )


def direction(rng):
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def random_load(rng, rod):
    """Gravity and a force of any direction, the force at 0.02 L ... tip and bending it by up to 1.5 rad."""
    s_c = rng.choice([rod.length, rng.uniform(0.02, 1.0) * rod.length])
    return 9.81 * direction(rng), bending_force(rod, s_c, rng.uniform(0.0, 1.5)) * direction(rng), s_c


@pytest.mark.parametrize("kind", ["round", "finite", "elliptic", "curved", "everything"])
def test_fast_is_within_a_micrometre_and_a_millionth_of_reference(kind):
    rng = np.random.default_rng(1)
    agreed = 0
    for _ in range(SAMPLE):
        rod = random_rod(rng, kind)
        load = random_load(rng, rod)
        fast, reference = rod.solve(*load), rod.solve(*load, mode="reference")
        assert fast.result == reference.result, (rod, load)
        if fast.result != "ok":
            continue
        s = np.linspace(0.0, rod.length, 9)
        gravity, force, s_c = load
        weight = rod.density * rod.body.volume_beyond[0] * np.linalg.norm(gravity)
        scale = np.linalg.norm(force) * s_c + weight * rod.length / 2.0
        # The documented accuracy of mode "fast" (probedesign/rod/rod.py).
        assert np.linalg.norm(fast.p_at(s) - reference.p_at(s), axis=1).max() <= 1e-6, (rod, load)
        assert np.linalg.norm(fast.wrench_base[3:] - reference.wrench_base[3:]) <= 1e-6 * scale, (rod, load)
        agreed += 1
    # Soft, long and thin ones cannot stand up against gravity or hold a push along the axis.
    assert agreed >= 0.8 * SAMPLE


@pytest.mark.parametrize("rod", ALL_RODS.values(), ids=ALL_RODS)
def test_between_the_nodes_the_answer_is_that_of_more_nodes(rod):
    force = bending_force(rod, 0.7 * rod.length, 0.8) * np.array([0.6, 0.8, 0.0])
    fast = rod.solve((9.81, 0, 0), force, 0.7 * rod.length)
    reference = rod.solve((9.81, 0, 0), force, 0.7 * rod.length, mode="reference")
    s = np.linspace(0.0, rod.length, 41)
    # One step of the same sixth order from the node above: no worse than the nodes' own micrometre.
    assert np.linalg.norm(fast.p_at(s) - reference.p_at(s), axis=1).max() <= 1e-6
    np.testing.assert_allclose(fast.R_at(s), reference.R_at(s), atol=1e-5)


@pytest.mark.parametrize("rod", ALL_RODS.values(), ids=ALL_RODS)
def test_at_the_nodes_nothing_is_interpolated(rod):
    eq = rod.solve((3, 4, -8), (0.001, 0.002, 0.003), 0.4 * rod.length)
    np.testing.assert_array_equal(eq.p_at(eq.s), eq.p_base)
    np.testing.assert_array_equal(eq.R_at(eq.s), eq.R_base)
    np.testing.assert_array_equal(eq.n_at(eq.s), eq.n_base)
    np.testing.assert_array_equal(eq.p_at(0.4 * rod.length), eq.p_contact_base)
    assert eq.s[0] == 0.0 and eq.s[-1] == rod.length and (np.diff(eq.s) > 0.0).all()


def test_one_arclength_gives_one_point_and_many_a_row_each():
    eq = PROFILE.solve((9.81, 0, 0))
    assert eq.p_at(0.05).shape == (3,) and eq.R_at(0.05).shape == (3, 3)
    assert eq.p_at([0.05, 0.06]).shape == (2, 3) and eq.R_at([0.05]).shape == (1, 3, 3)


def test_off_the_rod_there_is_nothing():
    eq = PROFILE.solve((9.81, 0, 0))
    off = np.array([-1e-3, PROFILE.length + 1e-3, np.nan])
    assert np.isnan(eq.p_at(off)).all() and np.isnan(eq.R_at(off)).all()


@pytest.mark.parametrize("gravity", [9.81, -500.0], ids=["off the rod", "unstable"])
def test_no_force_where_there_is_no_rod(gravity):
    eq = PROFILE.solve((0, 0, gravity))
    off = np.array([-1e-3, PROFILE.length + 1e-3])
    assert np.isnan(eq.n_at(off)).all()
