"""Tests of located touches of a base with a rotation error that its poses do not contain."""

import math
from dataclasses import replace

import numpy as np
import pytest

from probedesign.core.errors import InputError
from probedesign.core.statistics import max_chi2
from probedesign.core.units import MM
from probedesign.estimation.estimate import FusedEstimate
from probedesign.estimation.fusion import Fusion, Reading
from probedesign.estimation.fusion_state import HALF_NORMAL, channels_of
from probedesign.estimation.model import Tolerances
from probedesign.mapping.contact_map import build_map
from probedesign.mapping.touch_point import ConditionalPoint, describe_base, with_base
from probedesign.simulation.scenes import touch_targets
from probedesign.simulation.simulated_run import RunErrors, simulate_run
from tests.mapping.synthetic_touches import touch

GRAVITY = np.array([0.0, 0.0, -9.81])
TURN = np.radians([0.4, 0.4, 1.0])  #: Two standard deviations of the assumed tolerances.
SOFT = 0.04  #: Compliance of an object [m/N].


@pytest.fixture(scope="module")
def houses(estimator):
    """Return runs without and with a rotation error, without any other error."""
    runs = []
    for turn in ((0.0, 0.0, 0.0), tuple(TURN)):
        errors = RunErrors(stiffness=0.0, base_offset=0.0, base_repeat=0.0, bias_rate=0.0, rotation=turn, friction=0.0)
        runs.append(simulate_run(estimator.model, touch_targets()[9:10], np.random.default_rng(2), errors))
    return runs


def found(estimator, house, **priors):
    """Return the fusion with readings of the free probe before and after, which determine the bias, as in `explore`."""
    model, (touch,) = estimator.model, house.touches
    wrenches = np.vstack([house.wrench_free, touch.wrenches_base, house.wrench_free])
    Ts = np.concatenate([touch.Ts_world_base[:1], touch.Ts_world_base, touch.Ts_world_base[-1:]])
    touched = [False, *[True] * len(touch.wrenches_base), False]
    readings = tuple(
        Reading(w, model.noise_base(), T, GRAVITY @ T[:3, :3], c) for w, T, c in zip(wrenches, Ts, touched, strict=True)
    )
    known = replace(Tolerances.none(), youngs_modulus=1e-6, drift_steps=10.0, walk_steps=0.2, robot_mm=0.01, **priors)
    fusion = Fusion(model, readings, known, channels_of(model, None), GRAVITY)
    best = fusion.solutions()[0]
    state = fusion.state(best.touches)
    assert state.linearise()
    state.solved()
    return best, state


def carried(touch):
    """Return the derivative of the touched point by a rotation of the base about its axes [m/rad], (3, 3)."""
    T = touch.Ts_world_base[0]
    return np.cross(T[:3, :3].T, touch.p_world - T[:3, 3]).T


def test_a_rotation_error_rotates_the_point_about_the_base(estimator, houses):
    """Up to the sag, a tenth: gravity acts downwards for any rotation, so the sag is not rotated."""
    (still,), (turned,) = (house.touches for house in houses)
    assert found(estimator, houses[0])[0].x == pytest.approx(still.p_world, abs=0.02 * MM)  # the mean of six places
    assert turned.Ts_world_base[0][:3, :3] == pytest.approx(still.Ts_world_base[0][:3, :3])
    drawn = np.random.default_rng(2).spawn(1)[0].normal(0.0, TURN)
    by = carried(turned) @ drawn
    assert np.linalg.norm(by) > 0.3 * MM
    off = turned.p_world - found(estimator, houses[1])[0].x
    assert np.linalg.norm(off - by) < 0.1 * np.linalg.norm(by) + 0.02 * MM


def test_the_rotation_is_a_common_error_source(estimator, houses):
    """Given the rotation, the point agrees with the simulated one, sag included, to a twentieth and 0.01 mm."""
    best, state = found(estimator, houses[0], tilt_deg=0.2, clocking_deg=0.5)
    located = ConditionalPoint.from_fusion(state, FusedEstimate("ok", state.point, state.cov[:3, :3]))
    columns = [i for i, name in enumerate(located.names) if name in ("base tilt", "clocking")]
    drawn = np.random.default_rng(2).spawn(1)[0].normal(0.0, TURN)
    moved = located.sensitivity[:, columns] @ (drawn / np.radians([0.2, 0.2, 0.5]))
    off = houses[1].touches[0].p_world - found(estimator, houses[1])[0].x
    assert np.linalg.norm(off - moved) < 0.05 * np.linalg.norm(off) + 0.01 * MM
    # The parts are those of the fusion: with the unit priors put back they give its point and covariance.
    cov = np.linalg.inv(np.eye(len(located.information_vector)) + located.information)
    assert located.position(cov @ located.information_vector) == pytest.approx(best.x, abs=1e-9)
    assert located.covariance(cov) == pytest.approx(best.cov, rel=1e-6, abs=1e-14)


def test_touches_of_one_object_share_its_compliance(estimator):
    """Two touches of one point by different places of the probe know the compliance, if it is that of both."""
    errors = RunErrors(stiffness=0.0, base_offset=0.0, base_repeat=0.0, bias_rate=0.0, friction=0.0)
    targets = touch_targets(lambda: SOFT)
    (again,) = (target for target in targets if target.repeated and np.array_equal(target.p_world, targets[0].p_world))
    house = simulate_run(estimator.model, (targets[0], again), np.random.default_rng(2), errors)
    parts = [found(estimator, replace(house, touches=(part,)), object_compliance=0.05)[1] for part in house.touches]

    def mapped(one_object):
        fused = [FusedEstimate("ok", state.point, state.cov[:3, :3]) for state in parts]
        points = [ConditionalPoint.from_fusion(*each, one_object) for each in zip(parts, fused, strict=True)]
        touches = [replace(touch(i, (0, 0, 0), 1e-3), point=point) for i, point in enumerate(points)]
        return build_map(touches, 1e-6, 0.1, 0.05)

    together, apart = mapped(True), mapped(False)
    assert len(together.points) == len(apart.points) == 1 and math.isnan(apart.object_compliance)
    assert together.object_compliance == pytest.approx(SOFT, abs=2.5 * together.std_object_compliance)
    alone = HALF_NORMAL[1] * 0.05 * min(math.sqrt(state.cov[3, 3]) for state in parts)
    assert together.std_object_compliance < 0.7 * alone
    off = together.points[0].p_world - house.touches[0].p_world
    assert off @ np.linalg.solve(together.points[0].cov_world, off) < max_chi2(3, 0.01)


def test_the_simulated_robot_stops_at_a_force(houses):
    """A rotation changes the force only through the direction of the push relative to the probe: by a hundredth."""
    (still,), (turned,) = (house.touches for house in houses)
    assert turned.force == pytest.approx(still.force, rel=0.02)


def test_the_base_uncertainty_replaces_that_of_the_tolerances(estimator):
    priors = with_base(estimator.priors, base_offset_mm=0.3, base_repeat_mm=0.02, tilt_deg=None)
    assert priors == replace(estimator.priors, base_mm=0.3, robot_mm=0.02, pose_deg=0.0)
    assert describe_base(priors).endswith("0.3 mm common, 0.02 mm per pose, tilt 0.2°, clocking 0.5°")
    with pytest.raises(InputError, match="--clocking-deg 11"):
        with_base(priors, clocking_deg=11.0)
