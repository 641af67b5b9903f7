"""All parts of a mounted probe, placed in the sensor frame, and the room that must stay free."""

import math
from dataclasses import dataclass
from itertools import combinations

import cadquery as cq
import numpy as np

from probedesign.cad.flange_adapter import flange_adapter_solid
from probedesign.cad.kernel import block, cylinder, location, placed
from probedesign.cad.probe_solid import probe_solid
from probedesign.cad.screws import ScrewUse, nut_solids, screw_solids
from probedesign.cad.sensor_adapter import clamp_ring_solid, sensor_adapter_solid
from probedesign.frames import Array, pose
from probedesign.geometry import ProbeGeometry
from probedesign.materials import RIGID_DENSITY
from probedesign.mount import FlangeAdapter, SensorAdapter
from probedesign.mount.fasteners import STEEL_DENSITY
from probedesign.mount.sensor_adapter import DOWEL_PIN_LENGTH, on_circle
from probedesign.sensor import ScrewPattern, SensorModel
from probedesign.units import MM

AIR = 0.5 * MM
"""Least air beside the sensor's body and its cable: what bridges the split line takes load past the gauges."""
IN_SENSOR_FRAME = pose()
SECTOR_REACH = 40.0 * MM
"""How far out the cable's sector is checked; beyond every part of ours."""
# Room that the cable's exit takes: width, reach from the axis, height above the mounting face (ATI's Nano17 drawing).
CABLE_BLOCK = (3.8 * MM, 11.7 * MM, (0.3 * MM, 4.1 * MM))


@dataclass(frozen=True)
class Part:
    """One part, or one group of equal screws.

    Attributes:
        name: in the files.
        shape: in millimetres in the part's own frame.
        T_sensor_part: pose of that frame in the sensor frame, (4, 4).
        frame: what the own frame is called.
        density: [kg/m³]; zero for the sensor, which is not ours to weigh.
        color: (red, green, blue) 0 ... 1.
        printed: whether it has a mesh of its own.
    """

    name: str
    shape: cq.Shape
    T_sensor_part: Array
    frame: str
    density: float
    color: tuple[float, float, float]
    printed: bool = True

    @property
    def placed(self) -> cq.Shape:
        """The shape in the sensor frame."""
        return placed(self.shape, self.T_sensor_part)


def build_parts(
    geometry: ProbeGeometry,
    probe_density: float,
    sensor: SensorModel,
    adapter: SensorAdapter,
    plate: FlangeAdapter,
    screws: list[ScrewUse],
) -> dict[str, Part]:
    """Every part of the assembly by name, the printed ones first."""
    T, grey, steel = adapter.T_sensor_base, (0.75, 0.75, 0.72), (0.45, 0.47, 0.5)
    printed = [
        Part("probe", probe_solid(geometry, adapter), T, "base", probe_density, (0.93, 0.85, 0.6)),
        Part("sensor_adapter", sensor_adapter_solid(adapter), IN_SENSOR_FRAME, "sensor", RIGID_DENSITY, grey),
        Part("clamp_ring", clamp_ring_solid(adapter), T, "clamp_ring", RIGID_DENSITY, (0.35, 0.5, 0.7)),
        Part("flange_adapter", flange_adapter_solid(plate), plate.T_sensor_robotflange, "robotflange",
             RIGID_DENSITY, grey),
    ]  # fmt: skip
    bought = {use.name: screw_solids(use) for use in screws}
    bought |= {"ring_nuts": nut_solids(adapter), "dowel_pins": _dowel_pins(adapter, sensor)}
    loose = [
        Part(name, shape, IN_SENSOR_FRAME, "sensor", STEEL_DENSITY, steel, printed=False)
        for name, shape in bought.items()
    ]
    envelope = Part(
        "sensor", sensor_envelope(sensor), IN_SENSOR_FRAME, "sensor", 0.0, (0.6, 0.6, 0.65), False
    )
    return {part.name: part for part in [*printed, *loose, envelope]}


def sensor_envelope(sensor: SensorModel) -> cq.Shape:
    """The sensor's body with its holes and the room of its cable's exit, in the sensor frame."""
    h = sensor.height
    width, reach, (low, high) = CABLE_BLOCK
    cable = block((0.0, reach), (-width / 2, width / 2), (low - h, high - h))
    cable = cable.rotate((0, 0, 0), (0, 0, 1), sensor.cable_azimuth_deg)
    p_dowels = on_circle(sensor.tool.bolt_circle_d, sensor.dowel_azimuths_deg)
    return cylinder(sensor.body_d, -h, 0.0).fuse(cable).cut(
        *_threads(sensor.tool, -sensor.tool.max_entry, 0.0),
        *_threads(sensor.mounting, -h, sensor.mounting.max_entry - h),
        *(cylinder(sensor.dowel_d, -sensor.dowel_depth, 0.0, p) for p in p_dowels),
    )  # fmt: skip


def _threads(pattern: ScrewPattern, z0: float, z1: float) -> list[cq.Solid]:
    return [cylinder(2.0 * MM, z0, z1, p) for p in on_circle(pattern.bolt_circle_d, pattern.azimuths_deg)]


def _dowel_pins(a: SensorAdapter, sensor: SensorModel) -> cq.Compound:
    z = -sensor.dowel_depth
    return cq.Compound.makeCompound(
        [cylinder(sensor.dowel_d, z, z + DOWEL_PIN_LENGTH, p) for p in a.p_dowels]
    )


def air_of(sensor: SensorModel) -> list[cq.Shape]:
    """What must stay empty around the sensor's body, up past the tool face, and around its cable's exit."""
    h, r = sensor.height, sensor.body_d / 2
    width, reach, (low, high) = CABLE_BLOCK
    shell = cylinder(2 * (r + AIR), -h, AIR).cut(cylinder(2 * r, -h, AIR))
    side = width / 2 + AIR
    # Inside the rim there is nothing of ours above the mounting face, and from there the air goes aslant.
    inward = math.sqrt(AIR**2 - low**2)
    exit_room = block((r - inward, reach + AIR), (-side, side), (low - AIR - h, high + AIR - h))
    return [shell, exit_room.rotate((0, 0, 0), (0, 0, 1), sensor.cable_azimuth_deg)]


def cable_sector(sensor: SensorModel) -> cq.Shape:
    """The room about the cable that only the sensor itself may use, in the sensor frame."""
    width, z = 2 * sensor.cable_half_width_deg, -sensor.height
    wedge = cq.Solid.makeCylinder(
        SECTOR_REACH / MM, sensor.cable_free_height / MM, cq.Vector(0, 0, z / MM), angleDegrees=width
    )
    wedge = wedge.rotate((0, 0, 0), (0, 0, 1), sensor.cable_azimuth_deg - width / 2)
    return wedge.cut(cylinder(sensor.body_d, z, 0.0))


def overlaps(parts: dict[str, Part]) -> dict[str, float]:
    """Volume shared by each two parts whose boxes meet [m³]; contact is zero."""
    shapes = {name: part.placed for name, part in parts.items()}
    boxes = {name: box_of(shape) for name, shape in shapes.items()}
    pairs = ((a, b) for a, b in combinations(shapes, 2) if boxes_meet(boxes[a], boxes[b]))
    return {f"{a} & {b}": shared_volume(shapes[a], shapes[b]) for a, b in pairs}


def shared_volume(a: cq.Shape, b: cq.Shape) -> float:
    """Volume common to two shapes [m³]."""
    return float(sum(solid.Volume() for solid in a.intersect(b).Solids())) * MM**3


def box_of(shape: cq.Shape) -> Array:
    """Lowest and highest corner of the box around a shape [mm], (2, 3); telling takes as long as a small cut."""
    b = shape.BoundingBox()
    return np.array([[b.xmin, b.ymin, b.zmin], [b.xmax, b.ymax, b.zmax]])


def boxes_meet(a: Array, b: Array) -> bool:
    """Whether two boxes share a point."""
    return bool((a[0] <= b[1]).all() and (b[0] <= a[1]).all())


def assembly_of(parts: dict[str, Part], name: str) -> cq.Assembly:
    """The parts, named, coloured and placed, for a STEP file; of a group of screws, each one too.

    Readers drop the colour of a compound, hence a solid for each screw.
    """
    assembly = cq.Assembly(name=name)
    for part in parts.values():
        where, colour, solids = location(part.T_sensor_part), cq.Color(*part.color), part.shape.Solids()
        if len(solids) == 1:
            assembly.add(part.shape, name=part.name, color=colour, loc=where)
            continue
        group = cq.Assembly(name=part.name)
        for number, solid in enumerate(solids, 1):
            group.add(solid, name=f"{part.name}_{number}", color=colour)
        assembly.add(group, name=part.name, loc=where)
    return assembly
