"""Dimensions and mass of the mount between robot, sensor and probe; needs no CAD."""

from probedesign.mount.flange_adapter import FlangeAdapter as FlangeAdapter
from probedesign.mount.flange_adapter import T_sensor_robotflange as T_sensor_robotflange
from probedesign.mount.flange_adapter import flange_adapter_for as flange_adapter_for
from probedesign.mount.mass import mount_mass_properties as mount_mass_properties
from probedesign.mount.mass import mount_part_masses as mount_part_masses
from probedesign.mount.mount import Mount as Mount
from probedesign.mount.mount import build_geometry as build_geometry
from probedesign.mount.mount import exported_root_radii as exported_root_radii
from probedesign.mount.mount import flange_of as flange_of
from probedesign.mount.mount import held_tolerances as held_tolerances
from probedesign.mount.mount import mount_options as mount_options
from probedesign.mount.mount import root_contradiction as root_contradiction
from probedesign.mount.mount import root_radii as root_radii
from probedesign.mount.sensor_adapter import MountOptions as MountOptions
from probedesign.mount.sensor_adapter import SensorAdapter as SensorAdapter
from probedesign.mount.sensor_adapter import max_ring_passage_d as max_ring_passage_d
from probedesign.mount.sensor_adapter import sensor_adapter_for as sensor_adapter_for
