"""The figures of the studio: the numbers of `predict`, and one bent touch."""

import math

import numpy as np
import pytest

from probedesign.design.io import load_design
from probedesign.prediction.predict import FORCES_N
from probedesign.probe import build_probe
from probedesign.studio.figures import (
    PREVIEWED,
    complete,
    direction_figure,
    drawn_touch,
    errors_along,
    estimate_cloud,
    located,
    preview,
    summary_table,
)
from probedesign.studio.scene import arrow_length, force_of_arrow
from probedesign.studio.session import PinnedDesign, Session, StudioTouch
from probedesign.web.scene import STALE_COLOUR, error_colours


@pytest.mark.parametrize("name", ["large", "small"])
def test_the_preview_has_the_numbers_of_predict(name):
    design = load_design(name)
    full = complete(design).prediction  # that of `predict`, see below
    quick = preview(build_probe(design), FORCES_N).prediction
    assert quick.verdict == full.verdict
    at_every = [c for c in full.conditions if c.contact_fraction in PREVIEWED]
    for a, b in zip(quick.conditions, at_every, strict=True):
        assert (a.result, a.contact_fraction, a.force_N, a.direction) == (
            b.result, b.contact_fraction, b.force_N, b.direction)  # fmt: skip
        # Another sequence of forces leads to the same equilibrium within the solver's tolerance.
        for key in ("predicted_error_mm", "noise_error_mm"):
            assert_close(getattr(a, key), getattr(b, key))
    felt = [d for d in full.detection if d.contact_fraction in PREVIEWED]
    for a, b in zip(quick.detection, felt, strict=True):
        assert_close(a.detectable_force_mN, b.detectable_force_mN)


def assert_close(a, b):
    assert (a is None) is (b is None)
    assert a is None or a == pytest.approx(b, rel=1e-5)


def test_all_figures_are_those_of_predict():
    design = load_design("small")
    full, figures = build_probe(design).predict(), complete(design)
    assert figures.complete and figures.prediction.as_dict() == full.as_dict()
    rows = {row.name: row.value for row in figures.summary()}
    assert rows["tip sag"] == full.tip_sag_mm and rows["mass"] == full.mass_g
    largest = min(r.greatest_force_N for r in full.reach if r.contact_fraction == 0.8)
    assert rows["largest force at 0.8 L"] == 1e3 * largest


def test_a_buckled_probe_has_figures_and_no_touch():
    session = Session(load_design("large"))
    changes = {"probe.base_d_mm": 3.0, "probe.tip_d_mm": 2.0, "mount.gravity_base_m_s2": [0.0, 0.0, -9.81],
               "probe.length_mm": 200.0}  # fmt: skip
    assert session.change(changes, now=0.0), session.refused
    figures = preview(build_probe(session.design), (0.01,))
    assert (
        figures.buckles
        and drawn_touch(figures.probe, StudioTouch()) is None
        and math.isnan(figures.frequency)
        and "buckles" in figures.prediction.verdict
    )
    assert any(row.value is None for row in figures.summary())


@pytest.mark.parametrize("angle", [-90.0, 0.0, 60.0])
def test_the_drawn_touch_is_located_where_it_is_drawn(angle):
    probe = build_probe(load_design("large"))
    drawn = drawn_touch(probe, StudioTouch(0.7, angle, 20.0))
    assert drawn is not None
    estimate = located(probe, drawn)
    assert estimate.ok
    # The estimator of the same rod; the linearised surface of the drawing differs by a thousandth of the radius.
    assert estimate.p_surface_base == pytest.approx(drawn.p_surface, abs=2e-5)
    assert np.linalg.norm(drawn.normal) == pytest.approx(1.0, abs=1e-12)


def test_the_probe_has_the_colour_of_its_error_and_grey_where_a_touch_is_not_located():
    figures = preview(build_probe(load_design("large")), (0.01,))
    errors = errors_along(figures, 0.01)
    assert errors[0.2] < errors[0.8]
    near, far, unknown = error_colours({0.2: errors[0.2], 0.8: errors[0.8], 1.0: None}, np.array([0.2, 0.8, 1.0]))
    # Viridis, dark where the error is small: its green component grows with the error.
    assert near[1] < far[1] and tuple(unknown) == STALE_COLOUR


def test_the_cloud_spreads_as_the_estimator_states():
    """Estimates on 200 prints drawn from the priors, along the longest axis of the stated region.

    The region is a tenth of a millimetre thin, less than a point moves by the curvature of the probe.
    """
    probe, touch = build_probe(load_design("small")), StudioTouch(0.6, 90.0, 20.0)
    drawn = drawn_touch(probe, touch)
    off = estimate_cloud(probe, drawn, touch, lambda *_: None) - drawn.p_surface
    variance, axes = np.linalg.eigh(located(probe, drawn).cov_surface_base)
    inside = np.abs(off @ axes[:, 2]) <= 1.96 * math.sqrt(variance[2])
    # Three standard deviations of a count of 200 of which 95 % are expected.
    assert len(off) > 180 and abs(np.mean(inside) - 0.95) < 0.047


def test_a_pinned_design_is_shown_with_the_difference():
    large, small = complete(load_design("large")), complete(load_design("small"))
    pin = PinnedDesign("pin 1", load_design("large"))
    table = summary_table(small, [(pin, large)])
    change = small.prediction.mass_g / large.prediction.mass_g - 1.0
    assert f"{change:+.0%}" in table and 'class="better"' in table and 'class="worse"' in table


@pytest.mark.parametrize("force", [0.5, 10.0, 200.0])
def test_the_arrow_has_the_length_of_its_force(force):
    assert force_of_arrow(arrow_length(force)) == pytest.approx(force, rel=1e-12)


def test_a_curved_probe_has_its_error_over_the_direction_at_once():
    session = Session(load_design("large"))
    assert session.change({"probe.axis": "arc", "probe.axis_azimuth_deg": 90.0}, now=0.0), session.refused
    probe = build_probe(session.design)
    quick, full = preview(probe, (0.005, 0.01)).prediction, probe.predict((0.6, 0.8), (0.005, 0.01))
    assert quick.verdict == full.verdict and "median" in quick.verdict
    row, *_ = [o for o in full.over_directions if (o.contact_fraction, o.force_N) == (0.8, 0.01)]
    assert quick.over_directions[1].errors_mm == pytest.approx(row.errors_mm, rel=1e-5)  # as above
    figures = preview(probe, (0.005, 0.01))
    assert [entry.name for entry in direction_figure(figures, (), (0.005, 0.01)).legend] == ["5 mN", "10 mN"]
    assert direction_figure(preview(build_probe(load_design("large")), (0.01,)), (), (0.01,)) is None
