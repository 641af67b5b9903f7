"""Former name of `probedesign.estimation`; its documented modules can be imported from here for one release."""

import importlib
import sys
import warnings

ALIASES = ("detector", "estimate", "estimator", "model", "tolerances", "tracker", "unknowns")
"""Modules whose former import path the documentation named."""

warnings.warn(
    "probedesign.estimator was renamed probedesign.estimation; the former name is removed in the next release",
    DeprecationWarning,
    stacklevel=2,
)
for _name in ALIASES:
    sys.modules[f"{__name__}.{_name}"] = importlib.import_module(f"probedesign.estimation.{_name}")
