"""Prediction of curved probes over the direction of the force: symmetry, limits, and bounds computed elsewhere."""

from dataclasses import replace

import numpy as np
import pytest

from probedesign.design import check_design
from probedesign.estimation.estimator import Estimator
from probedesign.prediction.predict import errors_over_directions, predict, tip_sag_mm
from probedesign.prediction.touches import touches_of
from probedesign.probe import build_probe

#: Priors of the table of bounds: E, G 3 %, diameters 1 %, density 1 %, mount 0.2°, bias 0.2 steps; curvature apart.
PRIORS = {"youngs_modulus": 0.03, "shear_modulus": 0.03, "density": 0.01, "diameter_mm": 0.0, "diameter_share": 0.01,
          "diameter_scatter_mm": 0.0, "length_mm": 0.0, "length_share": 0.0, "base_mm": 0.0, "tilt_deg": 0.2,
          "clocking_deg": 0.2, "gravity_deg": 0.0, "creep": 0.0, "root_radii": 0.0, "gain": 0.0,
          "stiffness_scatter": 0.0, "drift_steps": 0.2}  # fmt: skip


def probe_of(gravity=(9.81, 0.0, 0.0), **probe):
    return build_probe(check_design(
        {"schema": 1, "name": "curved", "mount": {"gravity_base_m_s2": list(gravity)}, "contact": {"friction": 0.6},
         "probe": {"shape": "cone", "length_mm": 150.0, "base_d_mm": 12.0, "tip_d_mm": 2.0} | probe}
    ))  # fmt: skip


def arc(radius=150.0, **probe):
    return {"axis": "arc", "axis_bend_deg": np.degrees(150.0 / radius), "axis_azimuth_deg": -90.0} | probe


def helix(radius, turns):
    return arc(radius, axis="helix", axis_turns=turns)


def errors(probe, force):
    return errors_over_directions(Estimator(probe.model), (0.8,), (force,))[0]


# Bounds from elsewhere

#: RMS over eight directions and median [mm] of a Cramér-Rao bound that was computed apart from this package, with the
#: same priors, for a horizontal large probe along each axis, by place and force [N].
BOUNDS = [(arc(150.0), 0.5, 0.005, 9.9, 9.1), (arc(150.0), 0.8, 0.005, 8.0, 5.6),
          (arc(100.0), 0.5, 0.005, 8.2, 7.0), (arc(100.0), 0.8, 0.005, 5.9, 4.1),
          (helix(60.0, 0.5), 0.8, 0.005, 4.9, 3.5), ({}, 0.8, 0.005, 21.3, 21.3),
          ({}, 0.5, 0.005, 13.9, 13.9)]  # fmt: skip


@pytest.mark.parametrize(("probe", "fraction", "force", "rms", "median"), BOUNDS)
def test_errors_over_the_direction_agree_with_bounds_computed_elsewhere(probe, fraction, force, rms, median):
    """15 %: the eight directions of the table are not stated, taken 10° off the axes here, and the error near the blind
    plane depends on them; its prior is 2 % of the curvature along it, here a bow of 1 % in its plane and across.
    """
    curved = probe_of(**probe)
    bow_mm = 0.01 * 150.0 * np.radians(probe.get("axis_bend_deg", 0.0)) / 2.0
    estimator = Estimator(curved.model, replace(curved.tolerances, **PRIORS, bow_mm=bow_mm))
    eight = touches_of(estimator, [(fraction, f"{10 + 45 * k}deg") for k in range(8)], [force])[force].rms[0]
    assert 1e3 * np.sqrt(np.mean(eight**2)) == pytest.approx(rms, rel=0.15)
    over = errors_over_directions(estimator, (fraction,), (force,))[0]
    assert over.median_error_mm == pytest.approx(median, rel=0.15)


# Symmetry and limits


def test_errors_turn_with_the_plane_of_the_axis():
    """Without gravity the azimuth turns probe and forces together; the axes of the sensor have the same noise here."""
    plain, turned = (errors(probe_of((0.0, 0.0, 0.0), **arc(axis_azimuth_deg=azimuth)), 0.005).errors_mm
                     for azimuth in (0.0, 90.0))  # fmt: skip
    np.testing.assert_allclose(np.roll(plain, 6), turned, rtol=1e-4)  # the nano17's noise about x and y is the same


def test_a_planar_arc_is_blind_to_forces_in_its_plane_and_best_across_it():
    over = errors(probe_of(**arc()), 0.005).errors_mm
    straight = errors(probe_of(), 0.005).rms_error_mm
    across, in_plane = [over[0], over[12]], [over[6], over[18]]
    assert max(across) < straight / 3.0
    assert np.allclose(in_plane, straight, rtol=0.1)  # M/F alone, at a lever that is a little shorter


def test_a_vanishing_bend_is_the_straight_probe():
    """A thousandth of a degree moves the tip by 1.3 µm."""
    bent, straight = (errors(probe_of(**probe), 0.01) for probe in (arc(axis_bend_deg=1e-3), {}))
    np.testing.assert_allclose(bent.errors_mm, straight.errors_mm, rtol=1e-4)


def test_sag_of_a_curved_probe_is_measured_from_its_unloaded_tip():
    assert abs(tip_sag_mm(Estimator(probe_of((1e-6, 0.0, 0.0), **arc(axis_azimuth_deg=0.0)).model))) < 1e-4
    heavy = tip_sag_mm(Estimator(probe_of(**arc()).model))
    assert 1.0 < heavy < 2.0 * tip_sag_mm(Estimator(probe_of().model))  # it bends as its straight twin does


def test_a_curved_probe_is_predicted_all_around_and_a_straight_one_as_before():
    curved, straight = (predict(probe_of(**probe).model, (0.8,), (0.01,)) for probe in (arc(), {}))
    assert len({c.direction for c in curved.conditions}) == 8
    assert [c.direction for c in straight.conditions] == ["+x", "-x", "+y"] and not straight.over_directions
    over = curved.over_directions[0]
    by_angle = {c.direction: c.predicted_error_mm for c in curved.conditions}
    assert by_angle["+y"] == pytest.approx(over.errors_mm[6]) and by_angle["45deg"] == pytest.approx(over.errors_mm[3])
    assert over.median_error_mm < over.rms_error_mm < over.worst_error_mm
    assert "worst direction" in curved.verdict and "worst direction" not in straight.verdict
