"""Touches with friction are located without noise: readings of an independent rod and of finite elements."""

import math
from dataclasses import replace

import numpy as np
import pytest

from probedesign.core.errors import InputError
from probedesign.design import check_design
from probedesign.estimation.estimator import Estimator
from probedesign.probe import build_probe
from tests.estimation.true_touches import EXACT
from tests.reference.cosserat import solve
from tests.reference.round_rods import Probes
from tests.rod.test_fem_surface import CASES, rod_of

SHAPES = {
    "cylinder": {"shape": "cylinder", "length_mm": 100.0, "base_d_mm": 6.0},
    "profile that swells": {
        "shape": "profile",
        "length_mm": 120.0,
        "base_d_mm": 10.0,
        "profile_mm": [[0.0, 10.0], [40.0, 5.0], [80.0, 6.0], [120.0, 2.0]],
    },
    "bent print": {"length_mm": 150.0, "base_d_mm": 12.0, "tip_d_mm": 2.0, "bow_mm": [3.0, -1.5]},
    "elliptic": {"length_mm": 120.0, "base_d_mm": 14.0, "tip_d_mm": 4.0, "section": "elliptic", "flatness": 0.5},
}
NAMES = ["large", "medium", "small", *SHAPES]
FRACTIONS = (0.2, 0.4, 0.6, 0.8, 0.9, 0.97)
#: Force over 3 E I/s², with I at the touched place, which is about the bending angle there [rad].
BENDS = (0.05, 0.3, 1.0)
FRICTIONS = (0.0, 0.2, 0.5, 0.8)
SHARP = {"force_N": 1e-6, "moment_Nm": 1e-8}
#: Both rods agree to about 1e-6 of the moment, where 1e-3 of it is a millimetre; of a fit that ends within a hundredth
#: of a standard deviation its last step leaves less than a third of that.
POINT_M, FORCE_SHARE, LEFT = 2e-6, 1e-5, 3e-3
#: Smallest cosine of the rotation of the touched section for which all touches must be located: 60 degrees.
UPRIGHT = 0.5


def model_of(name, probes):
    if name in probes:
        return probes[name].model
    return build_probe(check_design({"schema": 1, "name": "shape", "probe": SHAPES[name]})).model


def reference_touches(model, gravity, frictions=FRICTIONS, upright=UPRIGHT):
    """Return touches of all places, forces and frictions in many directions, solved by `tests/reference`."""
    rows = []
    for k, (fraction, bend, mu) in enumerate((f, b, mu) for f in FRACTIONS for b in BENDS for mu in frictions):
        s = fraction * model.rod.length
        EI = model.rod.factors[1] * model.rod.youngs_modulus * math.pi / 4.0 * model.rod.radius_at(s) ** 4
        normal = min(3.0 * bend * EI / s**2, 0.5)
        # Golden angles spread directions evenly without a grid.
        phi, way = 2.399963 * k, 1.3 + 2.399963 * 2.0 * k
        rows.append((s, phi, normal, normal * mu * math.cos(way), normal * mu * math.sin(way)))
    table = np.array(rows)
    rods = Probes.of([model.rod] * len(table))
    touches = solve(rods, gravity, table[:, 0], table[:, 1], table[:, 2:], axes="surface")
    return touches.take(np.flatnonzero(touches.ok & (touches.R[:, 2, 2] > upright))), len(table)


def assert_located(c, estimator, touches, i):
    """Return the true touched point and force."""
    noise, where = estimator.model.noise.force, (touches.s[i], touches.surface_force[i])
    off = np.linalg.norm(c.p_surface_base - touches.p_surface[i])
    assert off <= POINT_M + LEFT * c.candidates[0].rms, where
    off = np.linalg.norm(c.force_base - touches.force[i])
    assert off <= FORCE_SHARE * np.linalg.norm(touches.force[i]) + LEFT * noise, where


@pytest.mark.parametrize("name", NAMES)
def test_without_noise_every_touch_is_found(name, probes):
    model, gravity = model_of(name, probes), np.array([(9.81, 0.0, 0.0), (-3.0, 2.0, -9.0)][NAMES.index(name) % 2])
    usual = Estimator(model, EXACT).with_friction(math.inf)
    sharp = usual.with_noise(**SHARP)
    touches, asked = reference_touches(model, gravity)
    located = 0
    for i, wrench in enumerate(touches.wrench):
        normal, *friction = touches.surface_force[i]
        for estimator in (sharp, usual):
            c = estimator.estimate(wrench, gravity)
            assert c.result in (("ok",) if estimator is sharp else ("ok", "interval_only", "too_light", "no_contact"))
            if c.ok:
                assert_located(c, estimator, touches, i)
                noise = estimator.model.noise.force
                assert c.force_normal == pytest.approx(normal, abs=1e-4 * normal + 0.1 * noise)
                assert c.force_tangential == pytest.approx(math.hypot(*friction), abs=1e-4 * normal + 0.1 * noise)
            located += estimator is usual and c.result in ("ok", "interval_only")
    # Most touches of the grid have an equilibrium, and a third of them are heavy enough for the noise.
    assert len(touches.s) > 0.7 * asked and located > 0.33 * len(touches.s)


@pytest.mark.parametrize("name", NAMES)
def test_without_friction_the_frictionless_prior_finds_the_same(name, probes, gravity):
    model = model_of(name, probes)
    estimator = Estimator(model, EXACT).with_friction(0.0).with_noise(**SHARP)
    touches, _asked = reference_touches(model, gravity, frictions=(0.0,))
    for i, wrench in enumerate(touches.wrench):
        c = estimator.estimate(wrench, gravity)
        assert c.result == "ok"
        assert_located(c, estimator, touches, i)
        # A friction of 1e-4 replaces none.
        assert c.friction_ratio < 1e-4


@pytest.mark.parametrize("case", CASES, ids=[case["id"] for case in CASES])
def test_finite_element_touches_are_found(case, probes):
    """Within a tenth of a millimetre: the target of the estimate. The worst of all is off by 0.018 mm, by the patch."""
    model = replace(probes[case["design"]].model, rod=rod_of(case))
    # With half of the noise the lightest have a point too.
    noise = {"force_N": 0.5 * model.noise.force, "moment_Nm": 0.5 * model.noise.moment}
    estimator = Estimator(model, EXACT).with_friction(math.inf).with_noise(**noise)
    c = estimator.estimate(case["wrench_base"], case["gravity_base_m_s2"])
    assert c.result == "ok"
    assert np.linalg.norm(c.p_surface_base - case["p_surface_section_base_m"]) < 3e-5
    ratio = np.linalg.norm(case["friction_section"])
    assert c.friction_ratio == pytest.approx(ratio, abs=0.02)


def test_no_prior_hides_a_large_friction(large, gravity, exact, touched):
    """With a prior of 0.6, a ratio of 0.8 along the probe is estimated to half its standard deviation."""
    wrench = touched(0.075, 0.1, around=0.3, along=0.8)
    free, prior = exact.with_friction(math.inf).estimate(wrench, gravity), exact.estimate(wrench, gravity)
    assert free.ok and prior.ok
    off = np.linalg.norm(free.p_surface_base - prior.p_surface_base)
    assert off < 0.5 * math.sqrt(np.trace(prior.cov_surface_base))
    assert prior.friction_ratio == pytest.approx(math.hypot(0.3, 0.8), rel=0.1)


# The force–moment method


def test_the_published_method_takes_the_couple_of_friction_for_a_lever_arm(exact, gravity, touched):
    """A ratio of 0.3 leaves a couple of r F 0.3, which displaces its point by as much."""
    wrench = touched(0.075, 0.05, along=0.3)
    published, maximum = (exact.estimate(wrench, gravity, method=name) for name in ("force_moment", "ml"))
    assert published.result == maximum.result == "ok"
    assert np.linalg.norm(published.p_contact_base - maximum.p_contact_base) < 3e-3


def test_a_dead_force_on_the_centreline_is_found_by_the_published_method(large, exact):
    """Nine oblique forces and mounts are located correctly."""
    rng = np.random.default_rng(3)
    sharp = exact.with_noise(1e-7, 1e-9)
    for _ in range(9):
        g, way = rng.normal(size=(2, 3))
        gravity, s = 9.81 * g / np.linalg.norm(g), rng.uniform(0.1, 0.7) * large.length
        eq = large.rod.solve(gravity, 0.02 * way / np.linalg.norm(way), s, mode="reference")
        c = sharp.estimate(eq.wrench_base, gravity, method="force_moment")
        assert c.result == "ok"
        assert np.linalg.norm(c.p_contact_base - eq.p_contact_base) <= 1e-5


def test_a_method_that_is_none_is_refused(exact):
    with pytest.raises(InputError, match="method"):
        exact.estimate(np.zeros(6), method="guess")


# What an estimate holds


def test_the_surface_point_lies_on_the_bent_surface(large, gravity, exact, touched):
    for fraction, friction in ((0.3, 0.0), (0.6, 0.5), (0.9, -0.5)):
        c = exact.estimate(touched(fraction * large.length, 0.02, 0.7, friction, friction), gravity)
        assert c.ok and c.shape is not None
        s = np.linspace(0.0, large.length, 3001)
        arms, tangents = c.p_surface_base - c.shape.p_at(s), c.shape.R_at(s)[:, :, 2]
        section = int(np.argmin(np.abs(np.einsum("ki,ki->k", arms, tangents))))
        # A station lies within L/6000 of the section, where the radius differs by a thirtieth of that: 1 µm.
        radius = large.rod.radius_at(s[section])
        assert np.linalg.norm(arms[section]) == pytest.approx(radius, abs=2e-6)


def test_the_mounts_own_gravity_is_taken_where_none_is_given(large, gravity, exact, touched):
    wrench = touched(0.06, 0.05)
    assert exact.estimate(wrench).s_contact == exact.estimate(wrench, gravity).s_contact


# Windows and neighbours


def test_a_window_is_as_good_as_its_mean_and_better_than_one(large, gravity, exact, touched):
    rng, model = np.random.default_rng(2), large.model
    window = touched(0.09, 0.03) + rng.multivariate_normal(np.zeros(6), model.noise_base(), 25)
    c, one = exact.estimate(window, gravity), exact.estimate(window[0], gravity)
    sharp = exact.with_noise(model.noise.force / 5.0, model.noise.moment / 5.0)
    mean = sharp.estimate(window.mean(axis=0), gravity)
    assert c.result == "ok"
    assert c.s_contact == pytest.approx(mean.s_contact, abs=1e-3 * c.std_s)
    assert c.std_s == pytest.approx(mean.std_s, rel=1e-3)
    # The single reading is linearised where its own noise puts the force.
    assert c.std_s == pytest.approx(one.std_s / 5.0, rel=0.1)
    window[3, 2] = np.nan
    assert exact.estimate(window, gravity).result == "out_of_range"


@pytest.mark.parametrize("neighbour", [(0.09, 0.03, 0.4), (0.03, 0.3, -1.0)], ids=["near", "far"])
def test_from_a_neighbour_it_finds_the_same(neighbour, large, gravity, touched):
    estimator = large.estimator()
    wrench = touched(0.092, 0.031, 0.42, 0.3, -0.2)
    a = estimator.estimate(wrench, gravity)
    b = estimator.estimate(wrench, gravity, near=estimator.estimate(touched(*neighbour), gravity))
    assert a.result == b.result == "ok"
    assert a.s_contact == pytest.approx(b.s_contact, abs=1e-2 * a.std_s)
    np.testing.assert_allclose(a.p_surface_base, b.p_surface_base, atol=1e-2 * a.candidates[0].rms)
