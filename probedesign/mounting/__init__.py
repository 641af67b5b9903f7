"""How a probe hangs on its sensor and the sensor on the robot: dimensions and mass, for all who need no CAD."""

from probedesign.mounting.adapter import SensorAdapter as SensorAdapter
from probedesign.mounting.adapter import sensor_adapter_for as sensor_adapter_for
from probedesign.mounting.adapter import widest_through_ring as widest_through_ring
from probedesign.mounting.flange_adapter import FlangeAdapter as FlangeAdapter
from probedesign.mounting.flange_adapter import flange_adapter_for as flange_adapter_for
from probedesign.mounting.hanging import hanging_mass as hanging_mass
from probedesign.mounting.hanging import hanging_parts as hanging_parts
from probedesign.mounting.root import exported_root_radii as exported_root_radii
