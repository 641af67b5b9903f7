"""Checks of a campaign: a column in a wrong unit, a sign, a factor or a count that is wrong throughout are refused."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from probedesign import build_probe, new
from probedesign.campaigns import Campaign, read_campaign
from probedesign.campaigns import campaign as tables
from probedesign.campaigns.checks import check_probe
from probedesign.core.errors import InputError
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel
from probedesign.identification.identify import data_of
from probedesign.simulation.campaign_folder import make_campaign
from probedesign.simulation.ground_truth import CampaignPlan
from probedesign.validation.validate import validate

NAMES = ("small", "medium", "large")
N_TO_MN = np.array([1e3, 1e3, 1e3, 1.0, 1.0, 1.0])
NM_TO_NMM = N_TO_MN[::-1]


def changed(campaign: Campaign, change: Callable[[tables.Test], tables.Test]) -> Campaign:
    return replace(campaign, tests=tuple(change(test) for test in campaign.tests))


def in_base(campaign: Campaign, model: ProbeModel) -> Campaign:

    def converted(test: tables.Test) -> tables.Test:
        gravity = test.T_world_base[:3, :3].T @ campaign.gravity_world
        return replace(test, wrenches=model.to_base(test.wrenches, gravity), frame="base")

    return changed(campaign, converted)


def scaled(factors: np.ndarray) -> Callable[[tables.Test], tables.Test]:
    return lambda test: replace(test, wrenches=test.wrenches * factors)


def contact_times(factor: float) -> Callable[[tables.Test], tables.Test]:
    return lambda t: t if t.p_contact_world is None else replace(t, p_contact_world=factor * t.p_contact_world)


def is_accepted(campaign: Campaign, model: ProbeModel) -> bool:
    """Return whether the checks pass; a refusal raises."""
    check_probe(campaign, model)
    return True


def refusal(campaign: Campaign, model: ProbeModel) -> str:
    with pytest.raises(InputError) as caught:
        check_probe(campaign, model)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("plan", [
    CampaignPlan("cameras", 1), CampaignPlan("cameras", 2, exact=True), CampaignPlan("stage", 1),
    CampaignPlan("cameras", 3, marker_noise=20e-3)])  # fmt: skip
def test_valid_campaigns_are_accepted(models, made, name, plan):
    """The roughest simulated reference is included."""
    campaign = made(name, plan)
    assert is_accepted(campaign, models[name])
    assert is_accepted(in_base(campaign, models[name]), models[name])


def test_the_sag_of_a_curved_probe_is_that_from_its_own_axis(tmp_path):
    """Pointing down, the tip of this arc is 54 mm above that of a straight probe."""
    probe = build_probe(new(length_mm=150.0, base_d_mm=12.0, axis="arc", axis_bend_deg=90.0, points="down"))
    campaign = read_campaign(make_campaign(probe.model, tmp_path / "arc", CampaignPlan("cameras", 1)).folder)
    assert max(test.tip_sag for test in campaign.tests if test.free) > 0.0
    assert is_accepted(campaign, probe.model)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("frame", ["sensor", "base"])
@pytest.mark.parametrize("factors", [N_TO_MN, NM_TO_NMM, 1e3 * np.ones(6), 1.0 / N_TO_MN],
                         ids=["mN as N", "Nmm as Nm", "both", "N as mN"])  # fmt: skip
def test_forces_or_moments_of_another_unit(models, made, name, frame, factors):
    campaign = made(name, CampaignPlan("stage", 1))
    if frame == "base":
        campaign = in_base(campaign, models[name])
    message = refusal(changed(campaign, scaled(factors)), models[name])
    assert "wrenches.csv: test " in message and ("in a column of N" in message or "units of their columns?" in message)


def test_a_few_readings_beyond_the_range_are_accepted(models, made):
    campaign = made("large", CampaignPlan("stage", 1))
    last = campaign.tests[-2]
    over = replace(last, wrenches=last.wrenches * 1e3)
    assert is_accepted(changed(campaign, lambda test: over if test is last else test), models["large"])


def test_places_and_arclengths_in_metres(models, made):
    campaign = made("large", CampaignPlan("cameras", 1))
    message = refusal(changed(campaign, contact_times(1e-3)), models["large"])
    assert "tests.csv: test touch-01: contact is 2" in message and "large is 150 mm long; a wrong unit" in message
    # the world's origin at the base: all places shrink to it
    at_base = changed(campaign, lambda t: t if t.p_contact_world is None else replace(
        t, p_contact_world=t.T_world_base[:3, 3] + 1e-3 * (t.p_contact_world - t.T_world_base[:3, 3])))  # fmt: skip
    message = refusal(at_base, models["large"])
    assert "mm from the base, the farthest" in message and "metres in a column of millimetres?" in message
    campaign = made("large", CampaignPlan("stage", 1))
    message = refusal(changed(campaign, lambda test: replace(test, s_contact=1e-3 * test.s_contact)), models["large"])
    assert "tests.csv: test " in message and "is the largest, large is 150 mm long; metres in a column" in message


def test_a_marker_at_the_base_only(models, made):
    campaign = made("large", CampaignPlan("cameras", 3, marker_noise=20e-3))

    def shrunk(test: tables.Test) -> tables.Test:
        if test.markers is None:
            return test
        p = test.T_world_base[:3, 3]
        return replace(test, markers=replace(test.markers, p_world=p + 1e-3 * (test.markers.p_world - p)))

    message = refusal(changed(campaign, shrunk), models["large"])
    assert "markers.csv: test " in message and "metres in a column of millimetres?" in message


def test_a_sag_longer_than_the_probe_upwards_or_in_centimetres(models, made):
    """The large probe sags by 13 mm as designed; the standard deviation is 0.5 mm."""
    campaign = made("large", CampaignPlan("cameras", 1))
    hang = campaign.tests[0]
    for factor, std, words in ((1e3, 1.0, "large is 150 mm long; a wrong unit?"),
                               (-1.0, 0.1, "a tip hangs below its undeformed place"),
                               (0.1, 0.1, "a sag of 13.2 mm as designed")):  # fmt: skip
        wrong = replace(hang, tip_sag=factor * hang.tip_sag, std_sag=std * hang.std_sag)
        message = refusal(changed(campaign, lambda t, wrong=wrong: wrong if t is hang else t), models["large"])
        assert "tests.csv: test hang-1: tip_sag_mm = " in message and words in message


def test_known_weights_in_millinewtons(models, made):
    """A weight of 50 mN: as newtons it exceeds the sensor."""
    campaign = made("large", CampaignPlan("cameras", 1))
    heavy = changed(
        campaign, lambda test: test if test.force_world is None else replace(test, force_world=1e3 * test.force_world)
    )
    assert "tests.csv: test weight-2: known force of 50 N exceeds the sensor's range" in refusal(heavy, models["large"])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (3.0 * np.eye(3), "times what the sensor read; is it the right weight"),
        (0.1 * np.eye(3), "times what the sensor read; is it the right weight"),
        (-np.eye(3), "the opposite of what the sensor read"),
        (Rotation.from_euler("x", 90, degrees=True).as_matrix(), "in another direction than was read"),
    ],
)
def test_known_forces_that_contradict_the_readings(models, made, change, words):
    """Drift and noise change what was read of the lightest load, 18 mN, by less than a fifth. One wrong load alone is
    an outlier of the fit, and a sensor may have been zeroed with the probe on it."""
    campaign = in_base(made("large", CampaignPlan("cameras", 1)), models["large"])

    def wrong(test):
        return test if test.force_world is None else replace(test, force_world=change @ test.force_world)

    line = refusal(changed(campaign, wrong), models["large"])
    assert "tests.csv: test weight-" in line and words in line
    assert is_accepted(changed(campaign, lambda t: wrong(t) if t.name == "weight-1" else t), models["large"])
    free = next(test for test in campaign.tests if test.free).wrenches.mean(axis=0)
    assert is_accepted(changed(campaign, lambda t: replace(t, wrenches=t.wrenches - free)), models["large"])


def test_both_commands_refuse(models, made):
    wrong = changed(made("large", CampaignPlan("stage", 1)), scaled(N_TO_MN))
    with pytest.raises(InputError, match="mN in a column of N"):
        data_of(wrong, models["large"], 0.0)
    with pytest.raises(InputError, match="mN in a column of N"):
        validate(Estimator(models["large"]), wrong)


def test_a_mass_in_kilograms_is_refused(made, models):
    campaign = made("large", CampaignPlan(seed=3))
    assert campaign.weighing is not None
    wrong = replace(campaign, weighing=replace(campaign.weighing, mass=1e-3 * campaign.weighing.mass))
    assert is_accepted(campaign, models["large"])
    with pytest.raises(InputError, match=r"mass_g = .* grams\?"):
        check_probe(wrong, models["large"])
