"""Values in a wrong unit: one column of a good campaign off by a thousand, and the line that says so."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from probedesign.campaigns import Campaign
from probedesign.campaigns import campaign as tables
from probedesign.campaigns.reading import check_probe
from probedesign.errors import InputError
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel
from probedesign.identification.identify import data_of
from probedesign.simulation.plan import Plan
from probedesign.validation.validate import validate

NAMES = ("small", "medium", "large")
N_TO_MN = np.array([1e3, 1e3, 1e3, 1.0, 1.0, 1.0])
NM_TO_NMM = N_TO_MN[::-1]


def changed(campaign: Campaign, change: Callable[[tables.Test], tables.Test]) -> Campaign:
    return replace(campaign, tests=tuple(change(test) for test in campaign.tests))


def in_base(campaign: Campaign, model: ProbeModel) -> Campaign:
    """The same readings told about the base."""

    def told(test: tables.Test) -> tables.Test:
        gravity = test.T_world_base[:3, :3].T @ campaign.gravity_world
        return replace(test, wrenches=model.to_base(test.wrenches, gravity), frame="base")

    return changed(campaign, told)


def scaled(factors: np.ndarray) -> Callable[[tables.Test], tables.Test]:
    return lambda test: replace(test, wrenches=test.wrenches * factors)


def contact_times(factor: float) -> Callable[[tables.Test], tables.Test]:
    return lambda t: (
        t if t.p_contact_world is None else replace(t, p_contact_world=factor * t.p_contact_world)
    )


def refusal(campaign: Campaign, model: ProbeModel) -> str:
    with pytest.raises(InputError) as caught:
        check_probe(campaign, model)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("plan", [Plan("cameras", 1), Plan("cameras", 2, exact=True), Plan("stage", 1),
                                  Plan("cameras", 3, marker_noise=20e-3)])  # fmt: skip
def test_honest_campaigns_pass(models, made, name, plan):
    """The roughest reference that can be made up included."""
    campaign = made(name, plan)
    check_probe(campaign, models[name])
    check_probe(in_base(campaign, models[name]), models[name])


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("told", ["sensor", "base"])
@pytest.mark.parametrize("factors", [N_TO_MN, NM_TO_NMM, 1e3 * np.ones(6), 1.0 / N_TO_MN],
                         ids=["mN as N", "Nmm as Nm", "both", "N as mN"])  # fmt: skip
def test_forces_or_moments_of_another_unit(models, made, name, told, factors):
    campaign = made(name, Plan("stage", 1))
    if told == "base":
        campaign = in_base(campaign, models[name])
    says = refusal(changed(campaign, scaled(factors)), models[name])
    assert "wrenches.csv: test " in says and ("in a column of N" in says or "units of their columns?" in says)


def test_a_few_readings_beyond_the_sensor_are_no_wrong_unit(models, made):
    campaign = made("large", Plan("stage", 1))
    last = campaign.tests[-2]
    over = replace(last, wrenches=last.wrenches * 1e3)
    check_probe(changed(campaign, lambda test: over if test is last else test), models["large"])


def test_places_in_metres(models, made):
    campaign = made("large", Plan("cameras", 1))
    says = refusal(changed(campaign, contact_times(1e-3)), models["large"])
    assert "tests.csv: test touch-01: contact is 2" in says and "large is 150 mm long; a wrong unit" in says
    # the world's origin at the base: all places shrink to it
    at_base = changed(campaign, lambda t: t if t.p_contact_world is None else replace(
        t, p_contact_world=t.T_world_base[:3, 3] + 1e-3 * (t.p_contact_world - t.T_world_base[:3, 3])))  # fmt: skip
    says = refusal(at_base, models["large"])
    assert "mm from the base, the farthest" in says and "metres in a column of millimetres?" in says


def test_arclengths_in_metres(models, made):
    campaign = made("large", Plan("stage", 1))
    says = refusal(
        changed(campaign, lambda test: replace(test, s_contact=1e-3 * test.s_contact)), models["large"]
    )
    assert "tests.csv: test " in says and "is the largest, large is 150 mm long; metres in a column" in says


def test_a_marker_at_the_base_only(models, made):
    campaign = made("large", Plan("cameras", 3, marker_noise=20e-3))

    def shrunk(test: tables.Test) -> tables.Test:
        if test.markers is None:
            return test
        p = test.T_world_base[:3, 3]
        return replace(test, markers=replace(test.markers, p_world=p + 1e-3 * (test.markers.p_world - p)))

    says = refusal(changed(campaign, shrunk), models["large"])
    assert "markers.csv: test " in says and "metres in a column of millimetres?" in says


def test_a_sag_longer_than_the_probe(models, made):
    campaign = made("large", Plan("cameras", 1))
    hang = campaign.tests[0]
    long = replace(hang, tip_sag=1e3 * hang.tip_sag)
    says = refusal(changed(campaign, lambda test: long if test is hang else test), models["large"])
    assert "tests.csv: test hang-1: tip_sag_mm = " in says and says.endswith("a wrong unit?")


def test_a_sag_upwards_or_in_centimetres(models, made):
    """Of the large probe, 13 mm as designed, told to 0.5 mm."""
    campaign = made("large", Plan("cameras", 1))
    hang = campaign.tests[0]
    for factor, words in ((-1.0, "a tip hangs below its unbent place"), (0.1, "as designed hangs 13.2 mm")):
        wrong = replace(hang, tip_sag=factor * hang.tip_sag, std_sag=0.1 * hang.std_sag)
        says = refusal(changed(campaign, lambda t, wrong=wrong: wrong if t is hang else t), models["large"])
        assert "tests.csv: test hang-1: tip_sag_mm = " in says and words in says


def test_known_weights_in_millinewtons(models, made):
    """5, 10, 14 and 50 of them: as newtons one is beyond the sensor; and without it all are far from what was read."""
    campaign = made("large", Plan("cameras", 1))
    heavy = changed(
        campaign,
        lambda test: test if test.force_world is None else replace(test, force_world=1e3 * test.force_world),
    )
    assert "tests.csv: test weight-2: known force of 50 N is more than the sensor" in refusal(
        heavy, models["large"]
    )
    light = replace(heavy, tests=tuple(test for test in heavy.tests if test.name != "weight-2"))
    says = refusal(light, models["large"])
    assert "times what the sensor read; millinewtons in a column of newtons?" in says


def test_both_commands_refuse(models, made):
    wrong = changed(made("large", Plan("stage", 1)), scaled(N_TO_MN))
    with pytest.raises(InputError, match="mN in a column of N"):
        data_of(wrong, models["large"], 0.0)
    with pytest.raises(InputError, match="mN in a column of N"):
        validate(Estimator(models["large"]), wrong)


def test_a_mass_in_kilograms_is_refused(made, models):
    campaign = made("large", Plan(seed=3))
    assert campaign.weighing is not None
    wrong = replace(campaign, weighing=replace(campaign.weighing, mass=1e-3 * campaign.weighing.mass))
    check_probe(campaign, models["large"])
    with pytest.raises(InputError, match=r"mass_g = .* grams\?"):
        check_probe(wrong, models["large"])
