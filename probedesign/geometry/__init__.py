"""The geometry of a probe, its cross sections and its mass properties: what CAD and mechanics share."""

from probedesign.geometry.axis import Axis as Axis
from probedesign.geometry.cross_section import FULL_ROUND as FULL_ROUND
from probedesign.geometry.cross_section import CrossSection as CrossSection
from probedesign.geometry.probe_geometry import FLANGE_LIP as FLANGE_LIP
from probedesign.geometry.probe_geometry import FLANGE_THICKNESS as FLANGE_THICKNESS
from probedesign.geometry.probe_geometry import Flange as Flange
from probedesign.geometry.probe_geometry import ProbeGeometry as ProbeGeometry
from probedesign.geometry.probe_geometry import fingerprint_of as fingerprint_of
from probedesign.geometry.probe_geometry import flange_for as flange_for
