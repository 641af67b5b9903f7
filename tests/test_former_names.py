"""Former import paths that the documentation named: they give the same objects for one release, with a warning."""

import importlib
import sys

import pytest

FORMER = {
    "probedesign.cross_section": ("probedesign.geometry", "CrossSection"),
    "probedesign.campaign": ("probedesign.campaigns", "read_campaign"),
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
