"""The worlds of `python -m benchmarks coverage`: their columns are the readings' own, their bounds the known ones."""

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks.coverage import bounds
from benchmarks.reference_worlds import FIELDS, Priors, Sources, bound, fused_bound, presses, read, rms
from probedesign.design import load_design
from probedesign.probe import build_probe
from tests.reference.cosserat import solve

MODEL = build_probe(load_design(Path(__file__).parents[2] / "designs/large.toml")).model
SINGLE = tuple(source for source in FIELDS if source != "robot")


def touched(sources, z):
    """A touch at the same place over the length with the same force in every world."""
    worlds = sources.worlds(z)
    touches = solve(worlds.at_touch(0), worlds.gravity, 0.6 * worlds.probes.length, 0.7, (0.05, 0.01, -0.02),
                    axes="surface")  # fmt: skip
    assert touches.ok.all()
    return worlds, touches


def test_every_error_source_moves_reading_and_point_by_its_columns():
    sources = Sources.of(MODEL, Priors.of(MODEL).only(SINGLE))
    worlds, touches = touched(sources, np.zeros((1, sources.size)))
    readings = read(worlds, np.zeros((1, sources.size)), touches, worlds.free())
    step = 0.3
    z = step * np.eye(sources.size)
    others, moved = touched(sources, z)
    wrench = others.reading(moved.wrench, others.free(), 0, readings.wrench[0] - _added(worlds, touches))
    point = others.point_in_nominal_frame(moved.p_surface)
    noise = np.sqrt(np.diag(MODEL.noise_base()))
    for name, slot in sources.slots.items():
        for j in range(slot.start, slot.stop):
            # Of second order in a third of a standard deviation, and 1e-3 of the grid.
            got, expected = (wrench[j] - readings.wrench[0]) / noise, step * readings.D[0, :, j] / noise
            assert_allclose(got, expected, atol=0.02 * np.abs(expected).max() + 1e-3, err_msg=name)
            got, expected = point[j] - readings.point[0], step * readings.Q[0, :, j]
            assert_allclose(got, expected, atol=0.02 * np.abs(expected).max() + 1e-7, err_msg=name)


def _added(worlds, touches):
    """What a touch adds to the free probe's wrench in worlds that are all as designed."""
    return (touches.wrench - worlds.free())[0]


def test_a_touch_moves_reading_and_point_by_its_columns():
    sources = Sources.of(MODEL, Priors.of(MODEL).only(()))
    z = np.zeros((5, 0))
    worlds = sources.worlds(z)
    steps = np.array([1e-4, 1e-3, 1e-4, 1e-4, 1e-4])
    s, phi = 0.09 + steps[0] * np.eye(5)[0], 0.7 + steps[1] * np.eye(5)[1]
    force = np.array([0.05, 0.01, -0.02]) + steps[2] * np.eye(5)[:, 2:]
    first = solve(worlds.probes, worlds.gravity, 0.09, 0.7, (0.05, 0.01, -0.02), axes="surface")
    moved = solve(worlds.probes, worlds.gravity, s, phi, force, axes="surface")
    readings = read(worlds, z, first, worlds.free())
    for j in range(5):
        change = (moved.wrench[j] - first.wrench[j]) / steps[j]
        assert_allclose(readings.J[0, :, j], change, atol=0.01 * np.abs(change).max())
        change = (moved.p_surface[j] - first.p_surface[j]) / steps[j]
        assert_allclose(readings.P[0, :, j], change, atol=0.01 * np.abs(change).max())


def test_bounds_of_one_touch_are_the_known_ones():
    """Of the large probe across gravity: two independent computations agree to two percent."""
    known = {
        (0.4, 5): (7.12, 7.15, 7.16, 7.16), (0.4, 20): (1.78, 1.79, 1.79, 1.79), (0.4, 50): (0.72, 0.72, 0.72, 0.72),
        (0.6, 5): (10.28, 10.29, 10.29, 10.29), (0.6, 20): (2.55, 2.58, 2.58, 2.58),
        (0.6, 50): (0.94, 1.04, 1.04, 1.04), (0.8, 5): (13.05, 13.41, 13.45, 13.46),
        (0.8, 20): (2.21, 3.40, 3.41, 3.41), (0.8, 50): (0.41, 1.44, 1.44, 1.44),
        (0.95, 5): (8.14, 14.09, 15.41, 16.01), (0.95, 20): (0.57, 4.01, 4.35, 4.48),
    }  # fmt: skip
    for row in bounds():
        expected = known[row["contact_fraction"], row["force_mN"]]
        # The numbers have two decimals.
        assert_allclose(list(row["bound_mm"].values()), expected, rtol=0.02, atol=0.005)


def test_pressing_on_locates_better_and_needs_a_friction_prior_for_moments_alone():
    sources = Sources.of(MODEL, Priors.of(MODEL).only(("E", "G", "drift", "robot")), 5)
    z = np.zeros((1, sources.size))
    pressed = presses(sources.worlds(z), z, 0.8, np.array([math.pi / 2.0]), np.zeros((1, 2)), 5e-3, np.zeros(1),
                      columns=True)  # fmt: skip
    assert pressed.ok.all()
    noise = MODEL.noise_base()
    last = rms(bound(pressed.readings[-1], noise, 0.6))
    every, moments = (rms(fused_bound(pressed, noise, 0.6, only)) for only in (False, True))
    assert every < moments < 0.5 * last
    free = rms(fused_bound(pressed, noise, math.inf, True))
    assert not free < 10.0 * moments


@pytest.mark.parametrize("aside", [None, np.full(4, 0.05)], ids=["slides", "sticks"])
def test_pressed_touches_lie_where_the_robot_reports_the_point(aside):
    rng = np.random.default_rng(3)
    sources = Sources.of(MODEL, Priors.of(MODEL).only(("base place", "base tilt", "diameter")), 5)
    z = sources.draw(4, rng)
    worlds = sources.worlds(z)
    pressed = presses(
        worlds, z, 0.5, rng.uniform(-3.0, 3.0, 4), np.full((4, 2), 0.2), 5e-3, np.full(4, 1e-3), aside
    )
    assert pressed.ok.all()
    for k, one in enumerate(pressed.readings):
        assert_allclose(pressed.places[:, k] + one.point, 0.0, atol=1e-9)
    normal = np.array([one.touches.surface_force[:, 0] for one in pressed.readings])
    assert (np.diff(normal, axis=0) > 0.0).all()
