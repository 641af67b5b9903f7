"""Former name of `probedesign.campaigns`; it can be imported from here for one release."""

from probedesign.campaigns import Campaign, Markers, Test, Weighing, read_campaign
from probedesign.core import warn_renamed

__all__ = ["Campaign", "Markers", "Test", "Weighing", "read_campaign"]

warn_renamed(__name__, "probedesign.campaigns")
