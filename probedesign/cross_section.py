"""Former path of `probedesign.geometry.cross_section`; its names can be imported from here for one release."""

from probedesign.core import warn_renamed
from probedesign.geometry.cross_section import *  # noqa: F403  the former path has every name

warn_renamed(__name__, "probedesign.geometry.cross_section")
