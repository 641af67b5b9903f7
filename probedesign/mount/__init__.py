"""Dimensions and mass of the mount between robot, sensor and probe; needs no CAD."""

from probedesign.mount.adapters import FlangeAdapter as FlangeAdapter
from probedesign.mount.adapters import SensorAdapter as SensorAdapter
from probedesign.mount.adapters import exported_root_radii as exported_root_radii
from probedesign.mount.adapters import flange_adapter_for as flange_adapter_for
from probedesign.mount.adapters import max_ring_passage_d as max_ring_passage_d
from probedesign.mount.adapters import sensor_adapter_for as sensor_adapter_for
from probedesign.mount.mass import mount_mass_properties as mount_mass_properties
from probedesign.mount.mass import mount_part_masses as mount_part_masses
