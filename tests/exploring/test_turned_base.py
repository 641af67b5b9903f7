"""A base that is turned by more than its poses say: where its points come to lie."""

import numpy as np
import pytest

from probedesign.errors import InputError
from probedesign.estimation.unknowns import Unknowns
from probedesign.exploring.base import Base
from probedesign.exploring.card_house import spots
from probedesign.exploring.located import _by_turn
from probedesign.exploring.rehearsal import Errors, rehearse
from probedesign.units import MM

TURN = np.radians([0.4, 0.4, 1.0])
"""Two standard deviations of what tolerances assume."""


@pytest.fixture(scope="module")
def houses(estimator):
    """(without a turn, with a drawn one), nothing else being off."""
    told = []
    for turn in ((0.0, 0.0, 0.0), tuple(TURN)):
        errors = Errors(stiffness=0.0, base_offset=0.0, base_repeat=0.0, walk=0.0, turn=turn, friction=0.0)
        told.append(rehearse(estimator.model, spots()[9:10], np.random.default_rng(2), errors))
    return told


def found(estimator, house):
    """With the free probe read before and after, as `explore` does: gravity's part of a turn is then the bias'."""
    (touch,) = house.touches
    wrenches = np.vstack([house.free, touch.wrenches, house.free])
    Ts = np.concatenate([touch.Ts_told[:1], touch.Ts_told, touch.Ts_told[-1:]])
    touched = [False, *[True] * len(touch.wrenches), False]
    answer = estimator.fuse(
        wrenches, Ts, (0.0, 0.0, -9.81), touched=touched, unknowns=Unknowns(1e-6, bias_steps=10.0)
    )
    assert answer.ok
    return answer.p_surface_world


def test_the_point_lies_beside_the_true_one_by_the_turn_about_the_base(estimator, houses):
    """But for the sag: the probe hangs down however its base is turned, so its sag is not carried along. A tenth."""
    (still,), (turned,) = (house.touches for house in houses)
    assert found(estimator, houses[0]) == pytest.approx(
        still.p_world, abs=0.02 * MM
    )  # the mean of six places
    assert turned.Ts_told[0][:3, :3] == pytest.approx(still.Ts_told[0][:3, :3])
    drawn = np.random.default_rng(2).spawn(1)[0].normal(0.0, TURN)
    by = _by_turn(turned.p_world, turned.Ts_told[0]) @ drawn
    assert np.linalg.norm(by) > 0.3 * MM
    off = turned.p_world - found(estimator, houses[1])
    assert np.linalg.norm(off - by) < 0.1 * np.linalg.norm(by) + 0.02 * MM


def test_where_the_base_goes_is_taught_by_feel(houses):
    """So a turn changes the force only as it changes the way of the push across the probe: by a hundredth."""
    (still,), (turned,) = (house.touches for house in houses)
    assert turned.force == pytest.approx(still.force, rel=0.02)


def test_what_is_said_of_the_base(estimator):
    base = Base.of(estimator.model)
    assert base == Base(0.05, 0.01, 0.2, 0.5) and base.turn == pytest.approx(np.radians([0.2, 0.2, 0.5]))
    unknowns = Base(0.3, 0.02).unknowns(estimator.model)
    assert (unknowns.base_offset, unknowns.base_repeat) == pytest.approx((0.3 * MM, 0.02 * MM))
    with pytest.raises(InputError, match="--clocking-deg 11"):
        Base(clocking_deg=11.0)
