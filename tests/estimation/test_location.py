"""Contacts are found where they are: without noise to a hundredth of a millimetre, all over the probes."""

import math

import numpy as np
import pytest

from probedesign.deployment import load_estimator, write_frozen
from probedesign.design import check_design
from probedesign.probe import build_probe
from probedesign.rod.contact import solve_frictionless

FRACTIONS = (0.05, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0)
FORCES = (0.002, 0.01, 0.05, 0.2, 1.0)
ANGLES = (0.0, 0.8, math.pi, -2.0)
NEXT_TO_NONE = {"force_N": 1e-7, "moment_Nm": 1e-9}
ASKED = 1e-5
"""[m], the project's own: 0.01 mm without noise."""


def touches(probe, gravity):
    """Every frictionless touch that the probe can hold, solved to reference accuracy."""
    for fraction in FRACTIONS:
        for force in FORCES:
            for angle in ANGLES:
                touch = solve_frictionless(
                    probe.rod, gravity, fraction * probe.length, angle, force, "reference"
                )
                if touch.result == "ok":
                    yield fraction, force, angle, touch


@pytest.mark.parametrize("name", ["large", "medium", "small"])
def test_without_noise_every_touch_is_found(name, probes, gravity):
    probe = probes[name]
    sharp, usual = probe.estimator().with_noise(**NEXT_TO_NONE), probe.estimator()
    found = 0
    for *where, touch in touches(probe, gravity):
        eq = touch.equilibrium
        c = sharp.estimate(eq.wrench_base, gravity)
        assert c.result == "ok", where
        assert np.linalg.norm(c.p_contact_base - eq.p_contact_base) <= ASKED, where
        # Where the probe is about to give way, s and force know each other well: a micrometre is 1e-5 of the force.
        np.testing.assert_allclose(c.force_base, touch.force_base, rtol=0, atol=1e-5 * where[1] + 1e-9)
        seen = usual.estimate(eq.wrench_base, gravity)
        assert seen.result in ("ok", "too_light", "no_contact"), where
        if seen.result == "ok":
            assert np.linalg.norm(seen.p_contact_base - eq.p_contact_base) <= ASKED, where
        found += 1
    # Soft towards the tip, a probe cannot hold a hard push there; half of the grid and more it can.
    assert found >= 0.5 * len(FRACTIONS) * len(FORCES) * len(ANGLES)


@pytest.mark.parametrize(
    ("name", "force", "fraction", "angle"),
    [
        ("large", 0.1, 0.825, 1.57),
        ("large", 0.05, 0.93125, 0.0),
        ("large", 0.05, 0.921875, 3.14),
        ("large", 0.03, 0.988, 0.0),
        ("medium", 0.03, 0.95625, 0.0),
        ("small", 0.05, 0.803125, 0.0),
    ],
)
def test_just_before_the_probe_gives_way_it_is_still_located(name, force, fraction, angle, probes, gravity):
    """Near the fold the equilibria end between two stations of the scan, and a step may lead off them."""
    probe = probes[name]
    touch = solve_frictionless(probe.rod, gravity, fraction * probe.length, angle, force, "reference")
    c = probe.estimator().estimate(touch.equilibrium.wrench_base, gravity)
    assert (touch.result, c.result) == ("ok", "ok")
    assert np.linalg.norm(c.p_contact_base - touch.equilibrium.p_contact_base) <= ASKED


SHAPES = {
    "cylinder": {"shape": "cylinder", "length_mm": 100.0, "base_d_mm": 6.0},
    "profile that swells": {
        "shape": "profile",
        "length_mm": 120.0,
        "base_d_mm": 10.0,
        "profile_mm": [[0.0, 10.0], [40.0, 5.0], [80.0, 6.0], [120.0, 2.0]],
    },
}


@pytest.mark.parametrize("pull", [(9.81, 0, 0), (0, 0, 9.81), (0, 0, -9.81), (5.0, -5.0, -6.0)])
@pytest.mark.parametrize("shape", SHAPES)
def test_every_shape_is_located_however_gravity_pulls(shape, pull):
    """From a bend of a thousandth of a radian, where the scan's own errors show, to a radian and more."""
    probe = build_probe(check_design({"schema": 1, "name": "shape", "probe": SHAPES[shape]}))
    estimator = probe.estimator().with_noise(**NEXT_TO_NONE)
    for fraction in (0.02, 0.3, 0.7, 1.0):
        s = fraction * probe.length
        EI = probe.rod.youngs_modulus * math.pi / 4.0 * float(probe.geometry.radius_at(s)) ** 4
        for bend in (0.05, 1.0):
            touch = solve_frictionless(probe.rod, pull, s, 0.7, min(bend * EI / s**2, 1.0), "reference")
            c = estimator.estimate(touch.equilibrium.wrench_base, gravity_base=pull)
            assert (touch.result, c.result) == ("ok", "ok"), (fraction, bend)
            assert np.linalg.norm(c.p_contact_base - touch.equilibrium.p_contact_base) <= ASKED, (
                fraction,
                bend,
            )


def test_the_example_of_the_contract(large, gravity):
    """A dead load of 0.014 N at 0.06 m, along gravity; as it is not quite normal to the bent surface, only "paper",
    which takes a force of any direction, finds it exactly."""
    eq = large.solve(gravity, 0.06, (0.014, 0.0, 0.0))
    for method, asked in (
        ("ml", 5e-4),
        ("paper", ASKED),
    ):  # 1.6 mN along the probe, 3 deviations: 0.15 of std_s
        c = large.estimator().estimate(eq.wrench_base, gravity_base=(9.81, 0.0, 0.0), method=method)
        assert c.result == "ok" and c.ok
        assert c.s_contact == pytest.approx(0.06, abs=asked)
        np.testing.assert_allclose(c.p_contact_base, eq.p_contact_base, atol=asked)
        np.testing.assert_allclose(c.force_base, (0.014, 0.0, 0.0), atol=2e-3 if method == "ml" else 1e-12)
        assert c.cov_contact_base.shape == (3, 3) and np.isfinite(c.cov_contact_base).all()
        np.testing.assert_allclose(c.shape.p_base[-1], eq.p_base[-1], atol=asked)


def test_a_dead_force_of_any_direction_is_found_by_the_papers_method(large):
    """There friction is not assumed away: nine oblique forces and mounts, found where they act."""
    rng = np.random.default_rng(3)
    sharp = large.estimator().with_noise(**NEXT_TO_NONE)
    for _ in range(9):
        g, way = rng.normal(size=(2, 3))
        gravity, s = 9.81 * g / np.linalg.norm(g), rng.uniform(0.1, 0.7) * large.length
        eq = large.solve(gravity, s, 0.02 * way / np.linalg.norm(way), mode="reference")
        c = sharp.estimate(eq.wrench_base, gravity, method="paper")
        assert c.result == "ok"
        assert np.linalg.norm(c.p_contact_base - eq.p_contact_base) <= ASKED


@pytest.fixture(scope="module")
def estimated(large, gravity):
    """(fraction, estimate) of the large probe's touches."""
    sharp = large.estimator().with_noise(**NEXT_TO_NONE)
    return [(fraction, sharp.estimate(touch.equilibrium.wrench_base, gravity))
            for fraction, _force, _angle, touch in touches(large, gravity)]  # fmt: skip


def test_the_surface_point_lies_on_the_bent_surface(large, estimated):
    s = np.linspace(0.0, large.length, 3001)
    for _fraction, c in estimated:
        arms, tangents = c.p_surface_base - c.shape.p_at(s), c.shape.R_at(s)[:, :, 2]
        ahead = np.einsum("ki,ki->k", arms, tangents)
        close = (
            np.linalg.norm(arms, axis=1) < 2.0 * large.rod.radius[0]
        )  # a bent rod has other sections behind it
        section = int(np.argmin(np.where(close, np.abs(ahead), np.inf)))
        # A station lies within L/6000 of the section, where the radius differs by a thirtieth of that; on the
        # rim of the tip, where the touched section would lie past the end, r sin² α is left: 1 µm each.
        radius = np.interp(s[section], large.rod.s, large.rod.radius)
        assert np.linalg.norm(arms[section]) == pytest.approx(radius, abs=2e-6)


def test_the_force_points_from_the_surface_point_to_the_axis(estimated):
    for fraction, c in estimated:
        push = c.force_base / np.linalg.norm(c.force_base)
        arm = c.p_contact_base - c.p_surface_base
        assert arm @ push > 0.0
        if fraction < 1.0:  # on the tip's rim the touched section would lie past the end
            # Over the 0.2 mm from one section to the other the axis bends by at most κ (r tan α)²: 1 µm.
            assert np.linalg.norm(np.cross(arm, push)) <= 5e-6


@pytest.mark.parametrize("method", ["ml", "paper"])
def test_the_frozen_probe_estimates_the_same_to_the_last_bit(method, large, gravity, touched, tmp_path):
    path = tmp_path / "large.probe.json"
    write_frozen(large.model, path)
    live, frozen = large.estimator(), load_estimator(path)
    for fraction, force in ((0.3, 0.05), (0.6, 0.02), (1.0, 0.01)):
        wrench = touched(fraction * large.length, force, 1.2)
        a, b = (either.estimate(wrench, gravity, method=method) for either in (live, frozen))
        assert a.result == b.result == "ok"
        for name in ("s_contact", "std_s", "p_contact_base", "p_surface_base", "force_base",
                     "cov_contact_base", "detection_chi2"):  # fmt: skip
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        np.testing.assert_array_equal(a.shape.p_base, b.shape.p_base)


def test_the_mounts_own_gravity_is_taken_where_none_is_said(large, gravity, touched):
    wrench = touched(0.06, 0.05)
    a, b = large.estimator().estimate(wrench), large.estimator().estimate(wrench, gravity)
    assert a.s_contact == b.s_contact
