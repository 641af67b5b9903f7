"""Former path of `probedesign.geometry.cross_section`; its names can be imported from here for one release."""

import warnings

from probedesign.geometry.cross_section import *  # noqa: F403  the former path has every name

warnings.warn(
    "probedesign.cross_section was renamed probedesign.geometry.cross_section; the former name is removed in the next "
    "release",
    DeprecationWarning,
    stacklevel=2,
)
