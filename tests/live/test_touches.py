"""Stationarity of readings and base, and the phases of a touch."""

import numpy as np
import pytest

from probedesign.core.frames import pose
from probedesign.live.processing.motion import MAX_TRAVEL
from probedesign.live.processing.touches import SPAN, PhaseTracker, StationarityTest

RATE = 200.0
COUNT = int(SPAN * RATE)


def noise(model, n, seed=0):
    return np.random.default_rng(seed).multivariate_normal(np.zeros(6), model.noise_base(), n)


def seen(model, readings, poses=None):
    steadiness, states = StationarityTest(model, RATE), []
    for i, reading in enumerate(readings):
        steadiness.update(reading, None if poses is None else poses[i])
        states.append((steadiness.full, steadiness.stationary, steadiness.moving))
    return states


def test_noise_is_steady_once_a_span_is_full(model):
    """A false "unsteady" has a chance of 1.4e-6 a reading."""
    states = seen(model, noise(model, 2000))
    assert [full for full, *_ in states].index(True) == COUNT - 1
    assert {steady for full, steady, _ in states if full} == {True}
    assert not any(steady for full, steady, _ in states if not full)


@pytest.mark.parametrize("kind", ["step", "ramp", "sway"])
def test_a_change_of_a_few_deviations_is_not_steady(kind, model):
    """Each changes the torque about y by four deviations of one reading within the span, whose mean is known eight
    times better."""
    time = np.arange(2 * COUNT) / RATE
    course = {"step": time >= 1.5 * SPAN, "ramp": time / SPAN, "sway": np.sin(2.0 * np.pi * 6.0 * time)}[kind]
    change = np.zeros((len(time), 6))
    change[:, 4] = 4.0 * np.sqrt(model.noise_base()[4, 4]) * course
    assert not seen(model, noise(model, len(time)) + change)[-1][1]


def test_a_base_is_stationary_within_the_scatter_of_its_poses(model):
    still = [pose(p=(0.2 * MAX_TRAVEL * (-1) ** i, 0.0, 0.0)) for i in range(COUNT)]
    gone = [pose(p=(2.0 * MAX_TRAVEL * i / COUNT, 0.0, 0.0)) for i in range(COUNT)]
    a = 2.0 * MAX_TRAVEL / 0.1  # rotations count over a tenth of a metre
    spun = [
        pose(np.array([[np.cos(x), -np.sin(x), 0], [np.sin(x), np.cos(x), 0], [0, 0, 1]]))
        for x in np.linspace(0.0, a, COUNT)
    ]
    for poses, moves in ((still, False), (gone, True), (spun, True)):
        assert seen(model, noise(model, COUNT), poses)[-1][2] is moves
    assert seen(model, noise(model, COUNT))[-1][2] is None


def test_a_settled_touch_needs_a_still_base(model):
    """Readings that do not change while the base glides along an edge are not settled."""
    for speed, phase in ((0.0, "settled"), (0.01, "touching")):
        phases = PhaseTracker(model, RATE)
        for i, reading in enumerate(noise(model, 2 * COUNT)):
            states = phases.next("contact", reading, pose(p=(0.0, speed * i / RATE, 0.0)))
        assert states == phase


def test_a_released_probe_is_free_after_a_span(model):
    phases = PhaseTracker(model, RATE)
    touching = ["contact"] * 10 + ["lost"] + ["free"] * (COUNT + 5)
    states = [phases.next(t, r, pose()) for t, r in zip(touching, noise(model, len(touching)), strict=True)]
    assert states[10 : 10 + COUNT - 1] == ["released"] * (COUNT - 1)
    assert states[-1] == "free"
