"""Former name of `probedesign.estimation`; its documented modules can be imported from here for one release."""

from probedesign.core import warn_renamed

NAMES = ("detector", "estimate", "estimator", "model", "tolerances", "tracker")
"""Modules whose former import path the documentation named and whose own name stays."""

warn_renamed(__name__, "probedesign.estimation", {name: name for name in NAMES} | {"unknowns": "tolerances"})
