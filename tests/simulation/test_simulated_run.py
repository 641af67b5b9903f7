"""A rehearsal whose edges stick and slip."""

import numpy as np
import pytest

from probedesign.simulation.card_house import spots
from probedesign.simulation.simulated_run import FIRM, Errors, rehearse
from probedesign.units import MILLINEWTON
from tests.live.conftest import bundle as bundle
from tests.live.conftest import estimator as estimator


@pytest.fixture(scope="module")
def touches(estimator):
    """Two spots with friction, nothing else being off."""
    still = Errors(stiffness=0.0, base_offset=0.0, base_repeat=0.0, walk=0.0, friction=0.5)
    return rehearse(estimator.model, spots()[8:10], np.random.default_rng(2), still).touches


def test_each_touch_has_its_own_friction_and_stays_in_its_cone(touches):
    """The first press slides; a rod that is pressed less again drags the other way."""
    assert touches[0].friction != touches[1].friction
    for touch in touches:
        assert (touch.friction_ratios <= touch.friction * (1.0 + 1e-9)).all()
        assert touch.friction_ratios.max() == pytest.approx(touch.friction, rel=1e-6)


def test_the_touched_point_lies_on_the_edge_and_the_press_is_as_firm_as_meant(touches):
    """Known to 1 µm of depth, the firm press is met within 2 %; 5 mN are never reached."""
    for touch in touches:
        off = touch.p_world - touch.spot.p_world
        assert np.linalg.norm(off - (off @ touch.spot.card.along) * touch.spot.card.along) < 1e-6
        assert touch.force == pytest.approx(FIRM, rel=0.02)
        assert touch.force < 5.0 * MILLINEWTON


def test_a_rehearsal_repeats(estimator, touches):
    still = Errors(stiffness=0.0, base_offset=0.0, base_repeat=0.0, walk=0.0, friction=0.5)
    again = rehearse(estimator.model, spots()[8:9], np.random.default_rng(2), still).touches[0]
    assert np.array_equal(again.wrenches, touches[0].wrenches)
