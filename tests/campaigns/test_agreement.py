"""A sign, a factor or a count that is wrong throughout a campaign: refused before anything is fitted to it."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from probedesign.campaigns import Campaign
from probedesign.campaigns.reading import check_probe
from probedesign.simulation.plan import Plan
from tests.campaigns.test_checks import NAMES, changed, in_base, refusal, scaled

CAMERAS = Plan("cameras", 1)


def numbered(campaign: Campaign, by: int) -> Campaign:
    """Every marker takes the number of the one so many further on, and the last ones are lost."""

    def told(test):
        if test.markers is None:
            return test
        m = test.markers
        kept = m.numbers + by < len(campaign.marker_s)
        return replace(test, markers=replace(m, numbers=m.numbers[kept] + by, p_world=m.p_world[kept],
                                             cov_world=m.cov_world[kept]))  # fmt: skip

    return changed(campaign, told)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("factor", [10.0, 0.1])
def test_readings_of_another_size_than_the_known_loads(models, made, name, factor):
    """Told about the base, so that the weight of what hangs on the sensor does not count. Drift and noise change what
    was read of the lightest load, 18 mN, by less than a fifth."""
    wrong = changed(in_base(made(name, CAMERAS), models[name]), scaled(factor * np.ones(6)))
    line = refusal(wrong, models[name])
    told = re.search(
        r"tests.csv: test weight-\d: known force of \S+ N is (\S+) times what the sensor read", line
    )
    assert told is not None and float(told[1]) == pytest.approx(1.0 / factor, rel=0.2), line


@pytest.mark.parametrize("name", NAMES)
def test_readings_of_the_opposite_sign(models, made, name):
    wrong = changed(in_base(made(name, CAMERAS), models[name]), scaled(-np.ones(6)))
    assert "the opposite of what the sensor read" in refusal(wrong, models[name])


def test_loads_that_pull_another_way(models, made):
    campaign = made("large", CAMERAS)
    turn = Rotation.from_euler("x", 90, degrees=True).as_matrix()
    line = refusal(
        changed(
            campaign, lambda t: t if t.force_world is None else replace(t, force_world=turn @ t.force_world)
        ),
        models["large"],
    )
    assert "in another direction than was read" in line


def test_one_wrong_load_is_left_to_the_fit(models, made):
    """Which names it as an outlier."""
    campaign = made("large", CAMERAS)
    check_probe(
        changed(
            campaign, lambda t: replace(t, force_world=3.0 * t.force_world) if t.name == "weight-1" else t
        ),
        models["large"],
    )


def test_touches_that_were_read_the_other_way_round(models, made):
    stage = in_base(made("medium", Plan("stage", 1)), models["medium"])
    line = refusal(changed(stage, scaled(-np.ones(6))), models["medium"])
    assert "wrenches.csv: test touch-" in line and "turn the sign of the columns, or of direction" in line


def test_a_sensor_zeroed_with_the_probe_on_it(models, made):
    """What the free hangs read is then nothing; loads and touches are known all the same."""
    campaign = in_base(made("large", CAMERAS), models["large"])
    free = next(test for test in campaign.tests if test.free).wrenches.mean(axis=0)
    check_probe(changed(campaign, lambda t: replace(t, wrenches=t.wrenches - free)), models["large"])


@pytest.mark.parametrize("name", NAMES)
def test_markers_numbered_one_too_high(models, made, name):
    line = refusal(numbered(made(name, CAMERAS), 1), models[name])
    assert "markers lie " in line and "are they numbered 1 too high" in line


def test_markers_near_the_base_that_were_not_seen(models, made):
    """Nothing is then told of how they are numbered, and bent probes are shorter from end to end."""
    campaign = made("large", CAMERAS)

    def far(test):
        if test.markers is None:
            return test
        m = test.markers
        kept = m.numbers >= len(campaign.marker_s) // 2
        return replace(
            test,
            markers=replace(m, numbers=m.numbers[kept], p_world=m.p_world[kept], cov_world=m.cov_world[kept]),
        )

    check_probe(changed(campaign, far), models["large"])
