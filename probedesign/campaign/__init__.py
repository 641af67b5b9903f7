"""Former name of `probedesign.campaigns`; it can be imported from here for one release."""

import warnings

from probedesign.campaigns import Campaign, Markers, Test, Weighing, read_campaign

__all__ = ["Campaign", "Markers", "Test", "Weighing", "read_campaign"]

warnings.warn(
    "probedesign.campaign was renamed probedesign.campaigns; the former name is removed in the next release",
    DeprecationWarning,
    stacklevel=2,
)
