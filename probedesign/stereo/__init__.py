"""Former name of `probedesign.vision`; its documented modules can be imported from here for one release."""

import importlib
import sys
import warnings

ALIASES = ("calibrate", "camera", "triangulate")
"""Modules whose former import path the documentation named."""

warnings.warn(
    "probedesign.stereo was renamed probedesign.vision; the former name is removed in the next release",
    DeprecationWarning,
    stacklevel=2,
)
for _name in ALIASES:
    sys.modules[f"{__name__}.{_name}"] = importlib.import_module(f"probedesign.vision.{_name}")
