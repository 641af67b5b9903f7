"""Test the derivatives and bounds that `python -m benchmarks coverage` compares the estimators with."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks.coverage import bounds
from benchmarks.reference_probes import PRESS_SOURCES, SOURCES, Perturbations, PriorStds
from benchmarks.reference_touches import cramer_rao, evaluate_readings, fused_cramer_rao, position_rms, solve_presses
from probedesign.design import load_design
from probedesign.probe import build_probe
from tests.reference.cosserat import solve

MODEL = build_probe(load_design(Path(__file__).parents[2] / "designs/large.toml")).model
SINGLE = tuple(source for source in SOURCES if source not in PRESS_SOURCES)


def touched(perturbations, z):
    samples = perturbations.samples(z)
    touches = solve(samples.at_touch(0), samples.gravity, 0.6 * samples.probes.length, 0.7, (0.05, 0.01, -0.02),
                    axes="surface")  # fmt: skip
    assert touches.ok.all()
    return samples, touches


def test_error_columns_are_the_derivatives_of_reading_and_point():
    perturbations = Perturbations.of(MODEL, PriorStds.of(MODEL).only(SINGLE))
    samples, touches = touched(perturbations, np.zeros((1, perturbations.size)))
    readings = evaluate_readings(samples, np.zeros((1, perturbations.size)), touches, samples.free_wrench())
    step = 0.3
    z = step * np.eye(perturbations.size)
    others, moved = touched(perturbations, z)
    wrench = others.reading(moved.wrench, others.free_wrench(), 0, readings.wrench[0] - _added(samples, touches))
    point = others.point_in_nominal_frame(moved.p_surface)
    noise = np.sqrt(np.diag(MODEL.noise_base()))
    for name, slot in perturbations.slots.items():
        for j in range(slot.start, slot.stop):
            # The second order at a third of a standard deviation, and 1e-3 for the grid.
            got, expected = (wrench[j] - readings.wrench[0]) / noise, step * readings.D[0, :, j] / noise
            assert_allclose(got, expected, atol=0.02 * np.abs(expected).max() + 1e-3, err_msg=name)
            got, expected = point[j] - readings.point[0], step * readings.Q[0, :, j]
            assert_allclose(got, expected, atol=0.02 * np.abs(expected).max() + 1e-7, err_msg=name)


def _added(samples, touches):
    """Return the difference that a touch makes to the wrench of the probe as designed."""
    return (touches.wrench - samples.free_wrench())[0]


def test_touch_columns_are_the_derivatives_of_reading_and_point():
    perturbations = Perturbations.of(MODEL, PriorStds.of(MODEL).only(()))
    z = np.zeros((5, 0))
    samples = perturbations.samples(z)
    steps = np.array([1e-4, 1e-3, 1e-4, 1e-4, 1e-4])
    s, phi = 0.09 + steps[0] * np.eye(5)[0], 0.7 + steps[1] * np.eye(5)[1]
    force = np.array([0.05, 0.01, -0.02]) + steps[2] * np.eye(5)[:, 2:]
    first = solve(samples.probes, samples.gravity, 0.09, 0.7, (0.05, 0.01, -0.02), axes="surface")
    moved = solve(samples.probes, samples.gravity, s, phi, force, axes="surface")
    readings = evaluate_readings(samples, z, first, samples.free_wrench())
    for j in range(5):
        change = (moved.wrench[j] - first.wrench[j]) / steps[j]
        assert_allclose(readings.J[0, :, j], change, atol=0.01 * np.abs(change).max())
        change = (moved.p_surface[j] - first.p_surface[j]) / steps[j]
        assert_allclose(readings.P[0, :, j], change, atol=0.01 * np.abs(change).max())


def test_bounds_of_one_touch_agree_with_an_independent_computation():
    """The bounds of the large probe across gravity agree to two percent."""
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


def test_pressing_on_lowers_the_bound_and_moments_alone_need_a_friction_prior():
    perturbations = Perturbations.of(MODEL, PriorStds.of(MODEL).only(("E", "G", "drift", "robot")), 5)
    z = np.zeros((1, perturbations.size))
    pressed = solve_presses(perturbations.samples(z), z, 0.8, np.array([math.pi / 2.0]), np.zeros((1, 2)), 5e-3,
                            np.zeros(1), columns=True)  # fmt: skip
    assert pressed.ok.all()
    noise = MODEL.noise_base()
    last = position_rms(cramer_rao(pressed.readings[-1], noise, 0.6))

    def bound(friction, moments_only):
        return position_rms(fused_cramer_rao(pressed, noise, friction, moments_only)[:, :3, :3])

    every, moments = bound(0.6, False), bound(0.6, True)
    assert every < moments < 0.5 * last
    free = bound(math.inf, True)
    assert not free < 10.0 * moments


@pytest.mark.parametrize(("place", "newtons", "expected"), [
    (0.8, 2e-3, (1.87, 2.8, 8.7)), (0.5, 5e-3, (2.19, 9.2, 11.3)),
])  # fmt: skip
def test_bounds_with_an_unknown_compliance_agree_with_an_independent_computation(place, newtons, expected):
    """The bounds for a rigid object, 20 N/m with a prior of 0.05 m/N, and 5 N/m with a prior of 0.2 m/N.

    The independent computation has one bias for all touches and numbers of two digits.
    """
    stated = {"youngs_modulus": 0.03, "diameter_mm": 0.0, "diameter_share": 0.01, "tilt_deg": 0.2, "robot_mm": 0.02,
              "drift_steps": 0.2, "object_compliance": 1.0}  # fmt: skip
    sources = ("E", "diameter", "base tilt", "robot", "drift", "object")
    perturbations = Perturbations.of(MODEL, PriorStds(PriorStds.of(MODEL).by_name | stated).only(sources), 5)
    phi = np.linspace(-np.pi, np.pi, 4, endpoint=False)
    z = np.zeros((len(phi), perturbations.size))
    pressed = solve_presses(perturbations.samples(z), z, place, phi, np.zeros((len(phi), 2)), newtons,
                            np.zeros(len(phi)), columns=True)  # fmt: skip
    drift = perturbations.slots["drift"]
    for one in pressed.readings:
        one.D[:, :, drift.start + 6 : drift.stop] = 0.0
    for compliance, rms in zip((0.0, 0.05, 0.2), expected, strict=True):
        priors = PriorStds(perturbations.priors.by_name | {"object_compliance": compliance})
        samples = replace(pressed.samples, perturbations=replace(perturbations, priors=priors),
                          compliance=np.full(len(phi), compliance))  # fmt: skip
        cov = fused_cramer_rao(replace(pressed, samples=samples), MODEL.noise_base(), 0.6, False)
        found = np.sqrt(np.mean(position_rms(cov[:, :3, :3]) ** 2))
        assert_allclose(found, 1e-3 * rms, rtol=0.03)
        assert (cov[:, 3, 3] <= compliance**2).all()


def test_an_object_that_yields_follows_the_force():
    perturbations = Perturbations.of(MODEL, PriorStds.of(MODEL).only(("object",)), 5)
    z = perturbations.draw(4, np.random.default_rng(1))
    pressed = solve_presses(perturbations.samples(z), z, 0.7, np.zeros(4), np.full((4, 2), 0.2), 5e-3, np.zeros(4))
    compliance = np.abs(z[:, 0]) * PriorStds.of(MODEL)["object_compliance"]
    for k, one in enumerate(pressed.readings):
        moved = pressed.places[:, k] + one.point
        assert_allclose(moved, -compliance[:, None] * one.touches.force, atol=1e-12)


@pytest.mark.parametrize("aside", [None, np.full(4, 0.05)], ids=["slides", "sticks"])
def test_pressed_touches_are_at_the_point_that_the_robot_reports(aside):
    rng = np.random.default_rng(3)
    perturbations = Perturbations.of(MODEL, PriorStds.of(MODEL).only(("base place", "base tilt", "diameter")), 5)
    z = perturbations.draw(4, rng)
    samples = perturbations.samples(z)
    pressed = solve_presses(
        samples, z, 0.5, rng.uniform(-3.0, 3.0, 4), np.full((4, 2), 0.2), 5e-3, np.full(4, 1e-3), aside=aside
    )
    assert pressed.ok.all()
    for k, one in enumerate(pressed.readings):
        assert_allclose(pressed.places[:, k] + one.point, 0.0, atol=1e-9)
    normal = np.array([one.touches.surface_force[:, 0] for one in pressed.readings])
    assert (np.diff(normal, axis=0) > 0.0).all()
