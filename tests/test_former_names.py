"""Former import paths that the documentation named: they give the same objects for one release, with a warning."""

import importlib
import sys

import pytest

FORMER = {
    "probedesign.cross_section": ("probedesign.geometry", "CrossSection"),
    "probedesign.campaign": ("probedesign.campaigns", "read_campaign"),
    "probedesign.estimator.detector": ("probedesign.estimation.detector", "Detector"),
    "probedesign.estimator.estimate": ("probedesign.estimation.estimate", "Estimate"),
    "probedesign.estimator.estimator": ("probedesign.estimation.estimator", "Estimator"),
    "probedesign.estimator.model": ("probedesign.estimation.model", "ProbeModel"),
    "probedesign.estimator.tolerances": ("probedesign.estimation.tolerances", "Tolerances"),
    "probedesign.estimator.tracker": ("probedesign.estimation.tracker", "Tracker"),
    "probedesign.estimator.unknowns": ("probedesign.estimation.tolerances", "Unknowns"),
    "probedesign.stereo.calibrate": ("probedesign.vision.calibrate", "calibrate"),
    "probedesign.stereo.camera": ("probedesign.vision.camera", "Camera"),
    "probedesign.stereo.triangulate": ("probedesign.vision.triangulate", "triangulate"),
}


@pytest.mark.parametrize("former", FORMER)
def test_a_former_import_path_warns_and_gives_the_same_object(former):
    module, name = FORMER[former]
    package = ".".join(former.split(".")[:2])
    for loaded in [loaded for loaded in sys.modules if loaded == package or loaded.startswith(f"{package}.")]:
        del sys.modules[loaded]
    with pytest.warns(DeprecationWarning, match=f"{package} was renamed"):
        found = getattr(importlib.import_module(former), name)
    assert found is getattr(importlib.import_module(module), name)


@pytest.mark.parametrize(
    "module, name",
    [
        ("probedesign.estimation.detector", "Detector"),
        ("probedesign.identification.identify", "data_of"),
        ("probedesign.prediction.predict", "predict_touch"),
        ("probedesign.rod.batch", "solve_batch"),
        ("probedesign.rod.contact", "solve_frictionless"),
        ("probedesign.rod.friction", "CoulombSolver"),
        ("probedesign.rod.obstacle", "press_against_line"),
        ("probedesign.rod.rod", "Rod"),
    ],
)
def test_a_documented_path_that_did_not_move_is_importable(module, name):
    assert getattr(importlib.import_module(module), name)
