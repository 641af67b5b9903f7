"""Test the error budget: its sums and limits, and the errors of the estimator in drawn samples."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from probedesign.core.errors import InputError
from probedesign.design import check_design, load_design
from probedesign.design.catalog import RESINS
from probedesign.design.io import new
from probedesign.estimation.error_sources import parameters_of
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import SOURCES, Tolerances
from probedesign.geometry.cross_section import CrossSection
from probedesign.prediction.budget import CAUSES
from probedesign.prediction.monte_carlo import (
    MonteCarloPlan,
    PrintSamples,
    locate_draws,
    perturbed_rod,
    run_monte_carlo,
)
from probedesign.prediction.predict import predict, predict_touch
from probedesign.prediction.touches import SurfaceRod, slide
from probedesign.probe import build_probe
from probedesign.rod.contact import solve_surface_force
from probedesign.rod.kernels.surface_contact import POINT, VALUE

DESIGNS = Path(__file__).parents[2] / "designs"
GRAVITY = np.array([9.81, 0.0, 0.0])
TOUCH = (0.6, 0.05, "+y")


@pytest.fixture(scope="module")
def large():
    return build_probe(load_design(DESIGNS / "large.toml"))


def only(**some):
    """Return tolerances with a few error sources only."""
    return replace(Tolerances.none(), **some)


def surface_rod(large):
    free = large.rod.solve(GRAVITY)
    return SurfaceRod(large.rod, GRAVITY, large.model.mass, free)


def budget(large, known, touch=TOUCH, friction=None):
    """Return the RMS error of one touch by error source [mm]."""
    estimator = Estimator(large.model, known)
    return predict_touch(estimator if friction is None else estimator.with_friction(friction), *touch).budget_mm


# The touches beneath


@pytest.mark.parametrize(
    ("fraction", "phi", "force", "ratios"),
    [(0.4, -1.2, 0.1, (0.0, 0.0)), (0.8, 2.0, 0.03, (0.4, -0.3)), (1.0, 0.5, 0.01, (0, 0.6))],
)
def test_a_press_agrees_with_the_independent_solver(large, fraction, phi, force, ratios):
    on = surface_rod(large)
    press = on.begin_press(fraction * large.length, phi, ratios)
    assert press.increase_to(force) is not None
    around, along = ratios
    found = solve_surface_force(
        large.rod, GRAVITY, fraction * large.length, phi, force, (along, around), mode="reference"
    )
    # The fast rod: a micrometre, a millionth of the moment.
    np.testing.assert_allclose(press.lin[POINT : POINT + 3, VALUE], found.p_surface_base, atol=2e-6)
    wanted = found.equilibrium.wrench_base
    np.testing.assert_allclose(press.lin[0:6, VALUE], wanted, atol=3e-6 * np.abs(wanted).max())


def test_a_buckled_press_stays_buckled(large):
    press = surface_rod(large).begin_press(large.length, 1.5)
    stable = [press.increase_to(force) is not None for force in (0.01, 0.1, 1.0)]
    assert stable == [True, False, False]
    again = surface_rod(large).begin_press(large.length, 1.5)
    assert again.increase_to(0.98 * press.force) is not None and again.increase_to(1.05 * press.force) is None


def test_an_object_slides_off_a_soft_tip_and_stays_on_a_stiff_stem(large):
    on = surface_rod(large)
    forces = np.linspace(0.001, 0.005, 5)
    assert slide(on, 0.5 * large.length, -np.pi / 2, forces) < 1e-3
    assert slide(on, 0.97 * large.length, -np.pi / 2, np.linspace(0.01, 0.05, 5)) == np.inf


def test_a_slide_along_the_probe_does_not_end_where_an_object_without_friction_would_roll_off_its_side():
    # 122.4 x 12 x 2 mm at 0.8 L: at 4.9 mN it is deflected by its radius there, and the side becomes unstable.
    probe = build_probe(new(length_mm=122.4, base_d_mm=12.0, tip_d_mm=2.0))
    on = surface_rod(probe)
    slides = [
        slide(on, 0.8 * probe.length, -np.pi / 2, (0.5 * force, force)) for force in np.arange(0.003, 0.008, 5e-4)
    ]
    assert np.isfinite(slides).all() and np.ptp(np.diff(slides)) < 0.1 * slides[-1]  # smooth


# Sums and limits


def test_an_exact_model_leaves_noise_and_friction(large):
    found = budget(large, Tolerances.none())
    assert {name for name, rms in found.items() if rms > 1e-9} == {"noise", "friction"}


@pytest.mark.parametrize("friction", [0.0, 0.3, np.inf])
def test_the_causes_add_up_and_none_exceeds_the_total(large, friction):
    estimator = large.estimator().with_friction(friction)
    for fraction in (0.3, 0.6, 0.9):
        c = predict_touch(estimator, fraction, 0.02, "+y")
        assert tuple(c.budget_mm) == CAUSES
        whole = np.sqrt(sum(v**2 for v in c.budget_mm.values()))
        assert c.predicted_error_mm == pytest.approx(whole, rel=1e-6)  # rounding of a difference
        assert max(c.noise_error_mm, *c.budget_mm.values()) <= c.predicted_error_mm


def test_larger_tolerances_give_larger_errors(large):
    """A posterior covariance increases with every prior covariance."""
    names = [f.name for f in fields(Tolerances) if f.name not in ("tared", "youngs_modulus_by_diameter")]
    twice = Tolerances(**{name: 2.0 * getattr(Tolerances(), name) for name in names})
    once, more = (predict_touch(Estimator(large.model, t), *TOUCH).predicted_error_mm for t in (Tolerances(), twice))
    assert once < more < 2.0 * once


def test_identified_E_is_correlated_with_the_diameters(large):
    """E·d⁴ was measured: diameters that are all thicker by one share bend as before, by an E that is softer by d⁻⁴."""
    shared = only(diameter_share=0.01, youngs_modulus_by_diameter=-4.0)
    by = parameters_of(large.rod, shared)["diameter"][0]
    other = perturbed_rod(large.rod, by)
    for place in (0, -1):
        before, after = (rod.youngs_modulus * rod.radius[place] ** 4 for rod in (large.rod, other))
        assert after == pytest.approx(before, rel=1e-12)  # rounding


def hollow(large, tip_d_mm: float):
    tables = large.design.model_dump(by_alias=True, exclude_none=True, mode="json")
    tables["probe"] |= {"section": "hollow", "bore_ratio": 0.6, "tip_d_mm": tip_d_mm}
    return build_probe(check_design(tables))


def test_a_wider_bore_bends_and_weighs_like_one(large):
    """Against the exact section of a cylinder, by differences: the derivatives of the tip's place and of the weight."""
    probe, widened = hollow(large, 12.0), 0.01
    exact = replace(probe.rod, factors=CrossSection((7.2 + widened) / 12.0).factors)
    row = parameters_of(probe.rod, only(bore_mm=widened))["bore"][0]
    gravity, force = (9.81, 0.0, 0.0), (0.02, 0.01, 0.0)

    def change(rod):
        before, after = (one.solve(gravity, force, mode="reference") for one in (probe.rod, rod))
        return after.p_at(rod.length) - before.p_at(rod.length), (after.wrench_base - before.wrench_base)[:3]

    (moved, heavier), (moved_exact, heavier_exact) = change(perturbed_rod(probe.rod, row)), change(exact)
    # Shear, 0.5 % of the bending of this thick tube, changes with the area: three times as much, relative to bending,
    # of which the lost weight takes half back.
    assert moved == pytest.approx(moved_exact, abs=0.03 * np.linalg.norm(moved_exact))
    assert heavier == pytest.approx(heavier_exact, rel=5e-3, abs=1e-12)  # second order of 0.14 %
    assert np.linalg.norm(moved_exact) > 5e-6


def test_the_bore_is_a_cause_of_hollow_probes_alone(large):
    assert budget(large, Tolerances())["bore"] == 0.0
    probe = hollow(large, 6.0)
    narrow, wide = (budget(probe, only(bore_mm=std))["bore"] for std in (0.05, 0.1))
    assert narrow > 0.0 and wide == pytest.approx(2.0 * narrow, rel=5e-3)  # linear, where the error is small
    # β⁴/(1 - β⁴) = 0.149 over β = 0.6: a quarter of the effect of the same deviation outside, and a little weight.
    outer = budget(probe, only(diameter_mm=0.1, diameter_share=0.0))["diameter"]
    assert 0.15 * outer < wide < 0.35 * outer


def test_a_tare_removes_the_error_of_gravitys_direction(large):
    with_, without = (
        budget(large, only(gravity_deg=0.2, tared=tared), (0.6, 0.005, "+y"), 0.0)["gravity"] for tared in (True, False)
    )
    assert with_ < 0.1 * without  # what is left is how the sag bends what the touch does


def test_clocking_does_not_matter_for_a_round_probe(large):
    off = budget(large, only(clocking_deg=5.0))["clocking"]
    assert off < 1e-5  # by symmetry none; what is left is the columns' rounding


# The real estimator


@pytest.mark.parametrize(
    ("some", "cause"),
    [
        ({"youngs_modulus": 0.02}, "E"),
        ({"density": 0.05}, "density"),
        ({"length_mm": 0.1}, "length"),
        ({"diameter_mm": 0.03}, "diameter"),
        ({"creep": 0.02}, "creep"),
        ({"root_radii": 0.2}, "root"),
        ({"gain": 0.01}, "gain"),
        ({"base_mm": 0.1}, "base place"),
        ({"tilt_deg": 0.2}, "base tilt"),
        ({"gravity_deg": 0.4, "tared": False}, "gravity"),
    ],
)
def test_one_error_source_gives_the_error_of_the_budget(large, some, cause):
    """Return readings without noise and friction of samples with one error source drawn."""
    model, n = replace(large.model, friction=0.0), 8
    known = only(**some)
    samples = PrintSamples.draw(model, known, n, 1)
    wrenches, points = samples.simulate_touches(0.6, -np.pi / 2, (0.05,), np.random.default_rng(1))
    estimator = Estimator(model, known)
    off = [
        estimator.estimate(w).candidates[0].p_surface_base - p
        for w, p in zip(wrenches[:, 0], points[:, 0], strict=True)
    ]
    share = (1e3 * np.linalg.norm(off, axis=1) / budget(large, known, friction=0.0)[cause]) ** 2
    # The sum of n squares of at least one normal number each; not beyond one chance in ten thousand either way. Beyond
    # the budget a fast solve is off by a micrometre.
    assert stats.chi2(n).ppf(1e-4) * 0.9 < share.sum() < stats.chi2(n).ppf(1.0 - 1e-4) * 1.1


def test_coverage_of_the_95_percent_ellipsoids(large):
    """Check the coverage at two places with all error sources and friction drawn from their priors."""
    n = 150
    samples = PrintSamples.draw(large.model, large.tolerances, n, 3)
    for fraction in (0.4, 0.7):
        answers = locate_draws(samples, fraction, 0.03, np.pi / 2, None, np.random.default_rng(5))
        located = [a for a in answers if a.result == "ok"]
        assert len(located) >= 0.97 * n
        inside = sum(a.inside for a in located)
        # One chance in a thousand of fewer where 95 of 100 lie inside; 2 of 100 are left to what is not linear.
        assert inside >= stats.binom(len(located), 0.93).ppf(1e-3)


def test_monte_carlo_agrees_with_the_budget(large):
    prediction = predict(large.model, (0.3, 0.8), (0.02,), ("+y",))
    found = run_monte_carlo(MonteCarloPlan(large.model, prediction.tolerances, 150, 2), prediction, workers=1)
    for row in found:
        # 4 of its own standard errors, and what the second order may be where the place is vague to 3 mm.
        assert abs(row.error_mm - row.first_order_mm) < 4.0 * row.standard_error_mm + 0.05 * row.first_order_mm
        assert 0 < row.located <= row.draws == 150


# What the object feels


def test_the_force_threshold_gives_the_requested_error(large):
    reach = predict(large.model, (0.4,), (0.02,), ("+y",)).reach[0]
    for accuracy, force in ((2.0, reach.force_mN_for_2_mm), (5.0, reach.force_mN_for_5_mm)):
        # Straight in logarithms between forces a third apart.
        assert predict_touch(large.estimator(), 0.4, 1e-3 * force, "+y").predicted_error_mm == pytest.approx(
            accuracy, rel=0.02
        )
    assert reach.force_mN_for_1_mm > reach.force_mN_for_2_mm > reach.force_mN_for_5_mm


@pytest.mark.parametrize(("fraction", "limit"), [(0.1, "sensor"), (0.6, "gives_way")])
def test_the_maximum_force_is_where_the_result_changes(large, fraction, limit):
    reach = predict(large.model, (fraction,), (0.02,), ("+y",)).reach[0]
    assert reach.limit == limit
    below, above = (
        predict_touch(large.estimator(), fraction, share * reach.greatest_force_N, "+y").result for share in (0.95, 1.1)
    )
    assert below == "ok" and above == {"sensor": "out_of_range"}.get(limit, limit)


# Tolerances


def test_tolerances_come_from_the_design(large):
    data = large.design.model_dump(by_alias=True, exclude_none=True)
    data["tolerances"] = {"diameter_mm": 0.02, "tared": False}
    data["material"]["stiffness_spread"] = 0.07
    tolerances = build_probe(check_design(data)).tolerances
    assert (tolerances.diameter_mm, tolerances.tared, tolerances.youngs_modulus) == (0.02, False, 0.07)
    assert tolerances.sources()["diameter_mm"] == "design" and tolerances.sources()["length_mm"].startswith("assumed")
    assert set(tolerances.sources()) == set(SOURCES)
    assert set(SOURCES) == {f.name for f in fields(Tolerances)} - {"tared"}


@pytest.mark.parametrize("resin", sorted(RESINS))
def test_the_sources_of_tolerances_cite_the_resin_of_the_design(large, resin):
    data = large.design.model_dump(by_alias=True, exclude_none=True)
    probe = build_probe(check_design({**data, "material": {"resin": resin}}))
    sources = probe.tolerances.sources(probe.model.resin)
    product = RESINS[resin].product
    for name in ("density", "diameter_mm", "bow_mm", "creep", "stiffness_scatter"):
        assert product in sources[name], name
    assert probe.tolerances.youngs_modulus == RESINS[resin].stiffness_spread.value
    assert RESINS[resin].stiffness_spread.source in sources["youngs_modulus"]
    for other in {one.product for one in RESINS.values()} - {product}:
        assert all(other not in text or text.startswith("assumed: 1 %, as of") for text in sources.values())
    assert not any("{" in text for text in Tolerances().sources().values())


BAD = [{"bow_mm": -1.0}, {"bow_mm": float("nan")}, {"bow_mm": 150.0}, {"diameter_mm": -0.1}, {"creep": float("nan")},
       {"diametre_mm": 0.1}]  # fmt: skip


@pytest.mark.parametrize("bad", BAD)
def test_invalid_tolerances_are_refused(large, bad):
    data = large.design.model_dump(by_alias=True, exclude_none=True)
    with pytest.raises(InputError, match="tolerances"):
        check_design({**data, "tolerances": bad})


def test_a_print_is_bent_by_a_share_of_its_length_unless_the_design_says_how_much(large):
    data = large.design.model_dump(by_alias=True, exclude_none=True)
    data["probe"] |= {"length_mm": 60.0}
    short = build_probe(check_design(data)).tolerances
    assert short.bow_mm == pytest.approx(0.4) and short.sources(length=0.06)["bow_mm"].startswith("assumed")
    stated = build_probe(check_design({**data, "tolerances": {"bow_mm": 0.2}})).tolerances
    assert stated.bow_mm == 0.2 and stated.sources(length=0.06)["bow_mm"] == "design"


def test_a_bow_as_large_as_the_probe_is_long_is_refused(large):
    with pytest.raises(InputError, match="bow_mm = 150 must be smaller than the length of the probe, 150 mm"):
        parameters_of(large.rod, Tolerances(bow_mm=150.0))


def test_a_bow_moves_the_free_tip_by_its_standard_deviation(large):
    """Without gravity the tip is w off towards x or y; the arc's rise is w but for (w/L)²/3 of it."""
    for row, axis in zip(parameters_of(large.rod, only(bow_mm=1.5))["bow"], (0, 1), strict=True):
        tip = perturbed_rod(large.rod, row).solve().p_at(large.rod.length)
        np.testing.assert_allclose(tip[:2], 1.5e-3 * np.eye(2)[axis], atol=2e-4 * 1.5e-3)
