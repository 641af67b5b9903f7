"""Former name of `probedesign.vision`; its documented modules can be imported from here for one release."""

from probedesign.core import warn_renamed

NAMES = ("calibrate", "camera", "triangulate")
"""Modules whose former import path the documentation named."""

warn_renamed(__name__, "probedesign.vision", {name: name for name in NAMES})
