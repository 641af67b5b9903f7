"""The error budget: its derivatives, its sums and limits, and that the real estimator errs as it says."""

import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from probedesign.design import check_design, load_design
from probedesign.errors import InputError
from probedesign.estimation.bound import contact_bound
from probedesign.estimation.causes import CAUSES, answers_of, parameters_of
from probedesign.estimation.tolerances import SOURCES, Tolerances
from probedesign.prediction.budget import budget_of
from probedesign.prediction.monte_carlo import Plan, sample
from probedesign.prediction.predict import predict, predict_touch
from probedesign.prediction.worlds import Worlds, printed
from probedesign.probe import build_probe
from probedesign.rod.contact import solve_frictionless
from probedesign.rod.contacts import follow_contacts, solve_contacts

DESIGNS = Path(__file__).parents[1] / "designs"
GRAVITY = np.array([9.81, 0.0, 0.0])
PLACES, ANGLES, FORCE = np.array([0.4, 0.8, 1.0]), np.array([0.3, 1.5, -2.0]), 0.02
OWN = ("E", "G", "density", "diameter", "diameter scatter", "length", "creep")


@pytest.fixture(scope="module")
def large():
    return build_probe(load_design(DESIGNS / "large.toml"))


@pytest.fixture(scope="module")
def contacts(large):
    return follow_contacts(large.rod, GRAVITY, PLACES * large.length, ANGLES, [0.005, FORCE])[-1]


def only(**some):
    """Tolerances with a few causes alone."""
    return replace(Tolerances.none(), **some)


# The contacts beneath


def test_many_contacts_are_each_one(large):
    rng = np.random.default_rng(0)
    s, angle = rng.uniform(0.1, 1.0, 12) * large.length, rng.uniform(-3.0, 3.0, 12)
    size = rng.uniform(0.002, 0.2, 12)
    many = solve_contacts(large.rod, GRAVITY, s, angle, size)
    for i in range(12):
        one = solve_frictionless(large.rod, GRAVITY, s[i], angle[i], size[i])
        assert (one.result == "ok") == many.ok[i]
        if many.ok[i]:
            # One Newton step after a misfit of 1e-4 leaves its square; the fast rod 1e-6.
            np.testing.assert_allclose(many.force[i], one.force_base, atol=1e-6 * size[i])
            np.testing.assert_allclose(many.d_touch[i], one.d_force, atol=1e-5 * np.abs(one.d_force).max())


def test_touches_followed_are_those_solved_alone(large):
    s, angle = np.array([0.2, 0.6, 0.9, 1.0]) * large.length, np.array([0.3, 1.5, -2.0, 3.0])
    forces = np.geomspace(0.002, 0.02, 12)
    for step, force in zip(follow_contacts(large.rod, GRAVITY, s, angle, forces), forces, strict=True):
        alone = solve_contacts(large.rod, GRAVITY, s, angle, np.full(4, force), columns="all")
        assert step.ok.all()
        # Followed touches are left alone once they are within the fast rod's error, 1e-6; its columns are good to 1e-5.
        for found, wanted, share in ((step.force, alone.force, 2e-6), (step.d_touch, alone.d_touch, 1e-5),
                                     (step.batch.wrench_base, alone.batch.wrench_base, 2e-6)):  # fmt: skip
            np.testing.assert_allclose(found, wanted, atol=share * np.abs(wanted).max())


def test_a_touch_that_gave_way_stays_given_way(large):
    steps = follow_contacts(
        large.rod, GRAVITY, np.array([1.0]) * large.length, np.array([1.5]), [0.01, 0.1, 1.0]
    )
    assert [bool(step.ok[0]) for step in steps] == [True, False, False]
    held = steps[-1].held[0]
    assert solve_frictionless(large.rod, GRAVITY, large.length, 1.5, 0.98 * held).result == "ok"
    assert solve_frictionless(large.rod, GRAVITY, large.length, 1.5, 1.05 * held).result != "ok"


# Derivatives


def moved(rod, name, h):
    """The rod with a logarithm of it grown."""
    if name == "log_length":
        return replace(rod, s=rod.s * np.exp(h))
    if name.startswith("log_diameter"):
        radius = rod.radius.copy()
        radius[int(name[13:])] *= np.exp(h)
        return replace(rod, radius=radius, rigid_length=rod.rigid_length * radius[0] / rod.radius[0])
    key = {"log_E": "youngs_modulus", "log_G": "shear_modulus", "log_density": "density"}[name]
    return replace(rod, **{key: getattr(rod, key) * np.exp(h)})


@pytest.mark.parametrize(
    ("j", "name"),
    list(
        enumerate(
            ["log_E", "log_G", "log_density", "log_length", "log_diameter_0", "log_diameter_1"], start=3
        )
    ),
)
def test_answers_are_the_rods_differences(large, contacts, j, name):
    answers, h = answers_of(contacts, large.rod, GRAVITY), 1e-4
    for i in range(3):
        low, high = (
            solve_frictionless(
                rod, GRAVITY, PLACES[i] * rod.length, ANGLES[i], FORCE, "reference"
            ).equilibrium
            for rod in (moved(large.rod, name, -h), moved(large.rod, name, h))
        )
        # The fast rod's columns are good to 1e-5; G moves things a hundred times less than the others.
        for found, ends in ((answers.wrench, (low.wrench_base, high.wrench_base)),
                            (answers.point, (low.p_contact_base, high.p_contact_base))):  # fmt: skip
            wanted = (ends[1] - ends[0]) / (2.0 * h)
            np.testing.assert_allclose(found[i, :, j], wanted, atol=1e-4 * np.abs(wanted).max() + 1e-9)


# Sums and limits


def test_with_everything_known_only_the_noise_is_left(large, contacts):
    budget = budget_of(contacts, large.model, GRAVITY, Tolerances.none())
    for i in range(3):
        one = solve_frictionless(large.rod, GRAVITY, PLACES[i] * large.length, ANGLES[i], FORCE)
        bound = contact_bound(one, large.model.noise_base())
        # The same columns of the same rod; forces agree to 1e-7.
        np.testing.assert_allclose(budget.total[i], bound.cov_p, atol=1e-5 * np.abs(bound.cov_p).max())
        assert (budget.rms[i, 1:] == 0.0).all()


def test_the_causes_add_up(large, contacts):
    whole = budget_of(contacts, large.model, GRAVITY, Tolerances(), weighed=False)
    few = only(youngs_modulus=0.03, diameter_mm=0.075)
    parts = budget_of(contacts, large.model, GRAVITY, few, weighed=False)
    total = np.sqrt(np.trace(whole.total, axis1=1, axis2=2))
    np.testing.assert_allclose(total, np.sqrt((whole.rms**2).sum(axis=1)), rtol=1e-12)  # rounding
    for name in ("noise", "E"):
        k = CAUSES.index(name)
        np.testing.assert_allclose(parts.cov[:, k], whole.cov[:, k], rtol=1e-9)  # no cause knows of another


def test_each_cause_is_proportional_to_its_tolerance(large, contacts):
    twice = Tolerances(
        **{f.name: 2.0 * getattr(Tolerances(), f.name) for f in fields(Tolerances) if f.name != "tared"}
    )
    once, doubled = (
        budget_of(contacts, large.model, GRAVITY, t, weighed=False).rms for t in (Tolerances(), twice)
    )
    np.testing.assert_allclose(doubled[:, 1:], 2.0 * once[:, 1:], rtol=1e-9, atol=1e-15)  # linear; rounding


def test_identified_E_goes_with_the_diameters(large):
    """E·d⁴ was measured: diameters that are all thicker by one share bend as before, by an E that is softer by d⁻⁴."""
    shared = only(diameter_share=0.01, youngs_modulus_by_diameter=-4.0)
    by = parameters_of(large.rod, shared)["diameter"][0]
    other = printed(large.rod, by)
    for place in (0, -1):
        before, after = (rod.youngs_modulus * rod.radius[place] ** 4 for rod in (large.rod, other))
        assert after == pytest.approx(before, rel=1e-12)  # rounding


def test_E_that_goes_with_the_diameters_is_counted_less(large):
    """0.075 mm on the diameters make 3 % of stiffness, E's own standard deviation 1 %: most of both is gone."""
    touch = follow_contacts(large.rod, GRAVITY, np.array([0.8 * large.length]), np.array([1.5]), [0.05])[0]
    apart = only(youngs_modulus=0.01, diameter_mm=0.075)
    together = replace(apart, youngs_modulus_by_diameter=-4.7)  # as identified by cameras on this probe
    predicted = [np.trace(budget_of(touch, large.model, GRAVITY, t).total[0]) for t in (apart, together)]
    assert predicted[1] < 0.5 * predicted[0]
    told = [
        large.estimator().with_tolerances(t).estimate(touch.batch.wrench_base[0]) for t in (apart, together)
    ]
    assert [one.result for one in told] == ["ok", "ok"]
    assert told[1].std_s < 0.7 * told[0].std_s


def test_what_is_predicted_is_what_the_estimator_states(large):
    """To first order, of the same touch: budget and estimate share columns and weights, but not their code."""
    touch = follow_contacts(large.rod, GRAVITY, np.array([0.6 * large.length]), np.array([1.5]), [0.05])[0]
    told = large.estimator().with_tolerances(Tolerances()).estimate(touch.batch.wrench_base[0])
    total = budget_of(touch, large.model, GRAVITY, Tolerances()).total[0]
    # The estimate ends within a hundredth of a standard deviation of the touch.
    np.testing.assert_allclose(told.candidates[0].cov_linear_base, total, atol=1e-2 * np.abs(total).max())


def test_weighing_helps_where_causes_outweigh_the_noise(large):
    hard = follow_contacts(large.rod, GRAVITY, np.array([0.5 * large.length]), np.array([0.0]), [0.1])[0]
    weighed, exact = (
        np.trace(budget_of(hard, large.model, GRAVITY, Tolerances(), weighed=w).total[0])
        for w in (True, False)
    )
    assert weighed < exact


def test_a_tare_takes_gravitys_direction_off_a_light_touch(large):
    light = follow_contacts(large.rod, GRAVITY, np.array([0.6 * large.length]), np.array([1.5]), [0.005])[0]
    k = CAUSES.index("gravity")
    with_, without = (
        budget_of(light, large.model, GRAVITY, only(gravity_deg=0.2, tared=tared)).rms[0, k]
        for tared in (True, False)
    )
    assert with_ < 0.05 * without  # what is left is how the sag bends what the touch does


def test_without_gravity_its_direction_is_no_cause(large):
    model = replace(large.model, gravity_base=np.zeros(3))
    touch = follow_contacts(large.rod, np.zeros(3), np.array([0.1]), np.array([1.5]), [0.01])[0]
    assert budget_of(touch, model, np.zeros(3), Tolerances()).rms[0, CAUSES.index("gravity")] == 0.0


# The real estimator


TOUCH = (0.6, 0.05, "+y")


def misled(large, known):
    """How far the estimates of readings without noise are off in a few worlds that are so badly known, the worlds, and
    the covariance of the one cause there is."""
    worlds = Worlds.draw(large.model, known, 3, 1)
    wrenches, points = worlds.touched(*TOUCH)
    estimator = large.estimator().with_tolerances(known)
    near = [estimator.estimate(wrench).candidates[0].p_contact_base for wrench in wrenches]
    touch = follow_contacts(
        large.rod, GRAVITY, np.array([0.6 * large.length]), np.array([np.pi / 2]), [0.05]
    )[0]
    budget = budget_of(touch, large.model, GRAVITY, known)
    (cause,) = np.flatnonzero(budget.rms[0, 1:]) + 1
    return np.array(near) - points, worlds, budget.cov[0, cause]


@pytest.mark.parametrize(
    ("some", "column", "of_one"),
    [
        ({"youngs_modulus": 0.01}, 0, 0.01),
        ({"density": 0.02}, 2, 0.02),
        ({"length_mm": 0.1}, 3, 0.1 / 150.0),
        ({"diameter_mm": 0.02}, 4, 0.02 / 12.0),
        ({"creep": 0.01}, 0, 0.01),
    ],
    ids=["E", "density", "length", "diameter", "creep"],
)
def test_a_wrong_rod_misleads_the_estimator_as_the_budget_says(large, some, column, of_one):
    off, worlds, cov = misled(large, only(**some))
    drawn = np.abs(worlds.parameters[:, column]) / of_one
    # The second order of a percent or two of stiffness, and two fast solves, a third of a micrometre together.
    np.testing.assert_allclose(
        np.linalg.norm(off, axis=1), drawn * np.sqrt(np.trace(cov)), rtol=0.05, atol=1e-6
    )


@pytest.mark.parametrize(
    "some",
    [{"base_mm": 0.02}, {"tilt_deg": 0.1}, {"gravity_deg": 0.2, "tared": False}],
    ids=["place", "tilt", "gravity"],
)
def test_a_wrong_mount_misleads_the_estimator_as_the_budget_says(large, some):
    off, _, cov = misled(large, only(**some))
    size = np.sqrt(np.einsum("ni,ij,nj->n", off, np.linalg.pinv(cov, rcond=1e-6), off))
    # So many standard deviations as were drawn: of nine normal numbers none is beyond 4.5, nor are all next to none.
    assert (size < 4.5).all() and np.sqrt((size**2).mean()) > 0.2


def test_a_round_probe_may_be_turned_about_its_axis(large):
    off = predict_touch(large.estimator(), *TOUCH, only(clocking_deg=5.0)).budget_mm["clocking"]
    assert off < 1e-6  # by symmetry none; what is left is the columns' rounding


def test_monte_carlo_agrees(large):
    prediction = predict(large.model, (0.3, 0.8), (0.02,), ("+y",))
    found = sample(Plan(large.model, prediction.tolerances, 150, 2), prediction, None, workers=1)
    for row in found:
        # 4 of its own standard errors, and what the second order may be where the place is vague to 3 mm.
        assert (
            abs(row.error_mm - row.first_order_mm) < 4.0 * row.standard_error_mm + 0.05 * row.first_order_mm
        )
        assert 0 < row.located <= row.draws == 150


def test_monte_carlo_goes_on_where_it_stopped(large, tmp_path):
    prediction = predict(large.model, (0.3, 0.5, 0.8), (0.02,), ("+y",))
    plan = Plan(large.model, Tolerances(), 5, 2)
    whole = sample(plan, prediction, None, workers=1)
    calls = []

    def stop(share):
        calls.append(share)
        if len(calls) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt, match="2 of 3 conditions are kept"):
        sample(plan, prediction, tmp_path, stop, workers=1)
    (kept,) = tmp_path.iterdir()
    assert len(json.loads(kept.read_text())["conditions"]) == 2
    calls.clear()
    assert sample(plan, prediction, tmp_path, calls.append, workers=1) == whole
    assert calls == [1.0]


def test_another_plan_is_another_file_and_a_broken_one_is_named(large, tmp_path):
    prediction = predict(large.model, (0.5,), (0.02,), ("+y",))
    one, other = Plan(large.model, Tolerances(), 4, 2), Plan(large.model, Tolerances(), 4, 3)
    assert one.key != other.key != replace(one, tolerances=Tolerances(density=0.02)).key
    (tmp_path / f"monte-carlo-{one.key}.json").write_text('{"conditions": {"[0.5')
    with pytest.raises(InputError, match="is not what a Monte Carlo left"):
        sample(one, prediction, tmp_path, workers=1)


# What the object feels


def test_the_force_needed_is_where_the_error_is_met(large):
    reach = predict(large.model, (0.4,), (0.02,), ("+y",)).reach[0]
    for accuracy, force in ((2.0, reach.force_mN_for_2_mm), (5.0, reach.force_mN_for_5_mm)):
        # Straight in logarithms between forces a third apart.
        assert predict_touch(large.estimator(), 0.4, 1e-3 * force, "+y").total_error_mm == pytest.approx(
            accuracy, rel=0.02
        )
    assert reach.force_mN_for_1_mm > reach.force_mN_for_2_mm > reach.force_mN_for_5_mm


@pytest.mark.parametrize(("fraction", "limit"), [(0.1, "sensor"), (0.6, "gives_way")])
def test_the_greatest_force_is_where_it_ends(large, fraction, limit):
    reach = predict(large.model, (fraction,), (0.02,), ("+y",)).reach[0]
    assert reach.limit == limit
    below, above = (predict_touch(large.estimator(), fraction, share * reach.greatest_force_N, "+y").result
                    for share in (0.95, 1.1))  # fmt: skip
    assert below == "ok" and above == {"sensor": "out_of_range"}.get(limit, limit)


# Tolerances


def test_tolerances_come_from_the_design(large):
    data = large.design.model_dump(by_alias=True, exclude_none=True)
    data["tolerances"] = {"diameter_mm": 0.02, "tared": False}
    data["material"]["stiffness_spread"] = 0.07
    said = build_probe(check_design(data)).tolerances
    assert (said.diameter_mm, said.tared, said.youngs_modulus) == (0.02, False, 0.07)
    assert said.sources()["diameter_mm"] == "design" and said.sources()["length_mm"].startswith("assumed")
    assert set(SOURCES) == {f.name for f in fields(Tolerances)} - {"tared"}


@pytest.mark.parametrize("bad", [{"diameter_mm": -0.1}, {"creep": float("nan")}, {"diametre_mm": 0.1}])
def test_tolerances_that_are_none_are_refused(large, bad):
    data = large.design.model_dump(by_alias=True, exclude_none=True)
    with pytest.raises(InputError, match="tolerances"):
        check_design({**data, "tolerances": bad})
