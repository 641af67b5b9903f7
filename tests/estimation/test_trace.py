"""Where the trace says that a contact may lie, against the scan of whole equilibria."""

import numpy as np
import pytest

from probedesign.design import check_design
from probedesign.estimation.likelihood import Fitter
from probedesign.estimation.locate import Scan
from probedesign.estimation.observation import Observation
from probedesign.probe import build_probe
from probedesign.rod.contact import solve_frictionless

SHAPES = {
    "cylinder": {"shape": "cylinder", "length_mm": 100.0, "base_d_mm": 6.0},
    "swelling": {
        "shape": "profile",
        "length_mm": 120.0,
        "base_d_mm": 10.0,
        "profile_mm": [[0.0, 10.0], [40.0, 5.0], [80.0, 6.0], [120.0, 2.0]],
    },
    "hollow": {
        "shape": "cone",
        "length_mm": 120.0,
        "base_d_mm": 10.0,
        "tip_d_mm": 4.0,
        "section": "hollow",
        "bore_ratio": 0.5,
    },
}


def fitter_of(model, gravity, wrench):
    free = model.rod.solve(gravity).wrench_base
    seen = Observation.of(model, wrench[None], gravity, free)
    return Fitter(model.rod, seen, Scan.of(model.rod, seen))


def noisy(model, gravity, count, rng):
    """Readings of touches that the probe holds, places, angles and forces drawn."""
    while count:
        s, angle = rng.uniform(0.2, 1.0) * model.rod.length, rng.uniform(-np.pi, np.pi)
        touch = solve_frictionless(model.rod, gravity, s, angle, np.exp(rng.uniform(*np.log((3e-3, 0.3)))))
        if touch.result == "ok":
            yield touch.equilibrium.wrench_base + rng.multivariate_normal(np.zeros(6), model.noise_base())
            count -= 1


@pytest.mark.parametrize("name", ["large", "medium", "small"])
def test_no_place_that_the_scan_finds_is_missed(name, probes, gravity):
    model, compared = probes[name].model, 0
    for wrench in noisy(model, gravity, 40, np.random.default_rng(3)):
        fitter = fitter_of(model, gravity, wrench)
        traced, force = fitter.traced(), fitter.seen.force
        scanned = fitter.places(
            (tip, force, s) for s, tip in Scan(model.rod, gravity, force, wrench[3:]).starts
        )
        for place in scanned:
            if traced and fitter.explains(place):
                assert any(fitter._same(place, other) for other in traced)
                compared += 1
    # Where the trace finds nothing the scan is asked anyhow; that must stay the exception.
    assert compared >= 38


@pytest.mark.parametrize("shape", SHAPES)
def test_other_shapes_are_traced_too(shape):
    probe_table = {**SHAPES[shape]}
    model = build_probe(check_design({"schema": 1, "name": "it", "probe": probe_table})).model
    gravity = np.array([3.0, 2.0, -9.0])
    for fraction, force in ((0.4, 0.05), (0.7, 0.03), (0.95, 0.01)):
        s = fraction * model.rod.length
        touch = solve_frictionless(model.rod, gravity, s, 0.7, force, "reference")
        assert touch.result == "ok"
        wrench = touch.equilibrium.wrench_base
        traced = fitter_of(model, gravity, wrench).traced()
        # Without noise the fit ends at the truth; 0.01 mm is the project's own figure.
        assert traced
        assert min(abs(place.s_contact - s) for place in traced) <= 1e-5
