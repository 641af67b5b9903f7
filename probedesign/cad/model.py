"""CAD model of a design: every part as a solid, placed in the sensor frame, and the volumes kept clear."""

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import cadquery as cq
import numpy as np

from probedesign.cad.kernel import block, cylinder, location, mass_properties, placed
from probedesign.cad.parts import (
    ScrewGroup,
    clamp_ring_solid,
    flange_adapter_solid,
    nut_solids,
    probe_solid,
    screw_groups,
    screw_solids,
    sensor_adapter_solid,
)
from probedesign.core.frames import Array, pose
from probedesign.core.units import MM
from probedesign.design import Design
from probedesign.design.catalog.materials import RIGID_DENSITY
from probedesign.design.catalog.sensors import ScrewPattern, SensorModel
from probedesign.geometry import ProbeGeometry, build_geometry
from probedesign.geometry.mass import MassProperties, combined
from probedesign.mount import FlangeAdapter, SensorAdapter, flange_adapter_for, sensor_adapter_for
from probedesign.mount.fasteners import STEEL_DENSITY
from probedesign.mount.sensor_adapter import DOWEL_PIN_LENGTH, on_circle

MIN_CLEARANCE = 0.5 * MM
"""Minimum clearance to the sensor's body and cable: a contact across the split line would bypass the strain gauges."""
IN_SENSOR_FRAME = pose()
SECTOR_REACH = 40.0 * MM
"""Radius up to which the cable's sector is checked; it exceeds every part of the mount."""
# Volume of the cable's exit: width, reach from the axis, height above the mounting face (ATI's Nano17 drawing).
CABLE_BLOCK = (3.8 * MM, 11.7 * MM, (0.3 * MM, 4.1 * MM))


@dataclass(frozen=True)
class CadPart:
    """One part, or one group of equal screws.

    Attributes:
        name: as in the files.
        shape: in millimetres in the part's own frame.
        T_sensor_part: pose of that frame in the sensor frame, (4, 4).
        frame: name of that frame.
        density: [kg/m³]; zero for the sensor, whose mass is not part of the mount.
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
        """Return the shape in the sensor frame."""
        return placed(self.shape, self.T_sensor_part)


def build_parts(
    geometry: ProbeGeometry,
    probe_density: float,
    sensor: SensorModel,
    adapter: SensorAdapter,
    plate: FlangeAdapter,
    screws: list[ScrewGroup],
) -> dict[str, CadPart]:
    """Return every part of the assembly by name, the printed ones first."""
    T, grey, steel = adapter.T_sensor_base, (0.75, 0.75, 0.72), (0.45, 0.47, 0.5)
    printed = [
        CadPart("probe", probe_solid(geometry, adapter), T, "base", probe_density, (0.93, 0.85, 0.6)),
        CadPart("sensor_adapter", sensor_adapter_solid(adapter), IN_SENSOR_FRAME, "sensor", RIGID_DENSITY, grey),
        CadPart("clamp_ring", clamp_ring_solid(adapter), T, "clamp_ring", RIGID_DENSITY, (0.35, 0.5, 0.7)),
        CadPart("flange_adapter", flange_adapter_solid(plate), plate.T_sensor_robotflange, "robotflange",
             RIGID_DENSITY, grey),
    ]  # fmt: skip
    bought = {use.name: screw_solids(use) for use in screws}
    bought |= {"ring_nuts": nut_solids(adapter), "dowel_pins": _dowel_pins(adapter, sensor)}
    loose = [
        CadPart(name, shape, IN_SENSOR_FRAME, "sensor", STEEL_DENSITY, steel, printed=False)
        for name, shape in bought.items()
    ]
    envelope = CadPart(
        "sensor", sensor_envelope(sensor), IN_SENSOR_FRAME, "sensor", 0.0, (0.6, 0.6, 0.65), False
    )
    return {part.name: part for part in [*printed, *loose, envelope]}


def sensor_envelope(sensor: SensorModel) -> cq.Shape:
    """Return the sensor's body with its holes and its cable's exit, in the sensor frame."""
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


def clearance_volumes(sensor: SensorModel) -> list[cq.Shape]:
    """Return the volumes around the sensor's body, tool face and cable exit that must stay empty."""
    h, r = sensor.height, sensor.body_d / 2
    width, reach, (low, high) = CABLE_BLOCK
    shell = cylinder(2 * (r + MIN_CLEARANCE), -h, MIN_CLEARANCE).cut(cylinder(2 * r, -h, MIN_CLEARANCE))
    side = width / 2 + MIN_CLEARANCE
    # Within the rim no part lies above the mounting face; from there the clearance is measured obliquely.
    inward = math.sqrt(MIN_CLEARANCE**2 - low**2)
    exit_room = block(
        (r - inward, reach + MIN_CLEARANCE),
        (-side, side),
        (low - MIN_CLEARANCE - h, high + MIN_CLEARANCE - h),
    )
    return [shell, exit_room.rotate((0, 0, 0), (0, 0, 1), sensor.cable_azimuth_deg)]


def cable_sector(sensor: SensorModel) -> cq.Shape:
    """Return the sector around the cable that only the sensor may occupy, in the sensor frame."""
    width, z = 2 * sensor.cable_half_width_deg, -sensor.height
    wedge = cq.Solid.makeCylinder(
        SECTOR_REACH / MM, sensor.cable_free_height / MM, cq.Vector(0, 0, z / MM), angleDegrees=width
    )
    wedge = wedge.rotate((0, 0, 0), (0, 0, 1), sensor.cable_azimuth_deg - width / 2)
    return wedge.cut(cylinder(sensor.body_d, z, 0.0))


def overlaps(parts: dict[str, CadPart]) -> dict[str, float]:
    """Return the volume shared by each pair of parts whose bounding boxes meet [m³]; contact is zero."""
    shapes = {name: part.placed for name, part in parts.items()}
    boxes = {name: box_of(shape) for name, shape in shapes.items()}
    pairs = ((a, b) for a, b in combinations(shapes, 2) if boxes_meet(boxes[a], boxes[b]))
    return {f"{a} & {b}": shared_volume(shapes[a], shapes[b]) for a, b in pairs}


def shared_volume(a: cq.Shape, b: cq.Shape) -> float:
    """Return the volume common to two shapes [m³]."""
    return float(sum(solid.Volume() for solid in a.intersect(b).Solids())) * MM**3


def box_of(shape: cq.Shape) -> Array:
    """Return the corners of a shape's bounding box [mm], (2, 3); this costs as much as a small Boolean cut."""
    b = shape.BoundingBox()
    return np.array([[b.xmin, b.ymin, b.zmin], [b.xmax, b.ymax, b.zmax]])


def boxes_meet(a: Array, b: Array) -> bool:
    """Return whether two boxes share a point."""
    return bool((a[0] <= b[1]).all() and (b[0] <= a[1]).all())


def assembly_of(parts: dict[str, CadPart], name: str) -> cq.Assembly:
    """Return the parts, named, coloured and placed, for a STEP file; screws of a group as separate solids.

    Readers drop the colour of a compound, hence one solid per screw.
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


FASTENERS = ("sensor_adapter_screws", "ring_screws", "ring_nuts", "dowel_pins")
"""Purchased parts on the sensor's tool side."""


@dataclass(frozen=True)
class CadModel:
    """A design with all its solids.

    Attributes:
        design: the design file's content.
        geometry: of the probe; the mechanics use the same one.
        adapter: dimensions on the sensor's tool side.
        plate: dimensions on the sensor's mounting side.
        screws: every group of screws, entries checked.
        parts: the solids by name.
    """

    design: Design
    geometry: ProbeGeometry
    adapter: SensorAdapter
    plate: FlangeAdapter
    screws: list[ScrewGroup]
    parts: dict[str, CadPart]

    @property
    def printed(self) -> list[CadPart]:
        """Return the parts that are meshed and printed."""
        return [part for part in self.parts.values() if part.printed]

    @cached_property
    def bodies(self) -> dict[str, MassProperties]:
        """Return the mass properties of everything beyond the tool face, from the solids, in the sensor frame."""
        probe, T = self.parts["probe"], self.adapter.T_sensor_base
        above = cylinder(1.0, 0.0, 2 * self.geometry.length)  # 1 m wide: more than any probe
        flexible, flange = probe.shape.intersect(above), probe.shape.cut(above)
        return {
            "flexible": mass_properties(placed(flexible, T), probe.density),
            "flange": mass_properties(placed(flange, T), probe.density),
            "sensor_adapter": self._mass_of("sensor_adapter"),
            "clamp_ring": self._mass_of("clamp_ring"),
            "fasteners": combined(self._mass_of(name) for name in FASTENERS),
        }

    def _mass_of(self, name: str) -> MassProperties:
        part = self.parts[name]
        return mass_properties(part.placed, part.density)

    @cached_property
    def shared_volumes(self) -> dict[str, float]:
        """Return the volume shared by each pair of parts that come near each other [m³]; contact is zero."""
        return overlaps(self.parts)


def build_cad(design: Design) -> CadModel:
    """Build the CAD model of a design.

    Raises:
        InputError: the mount cannot clamp this probe.
        CheckFailedError: a screw would enter too deep, or a part is not one valid solid.
    """
    geometry, sensor = build_geometry(design), design.sensor_model
    adapter = sensor_adapter_for(geometry, sensor, design.name)
    plate = flange_adapter_for(sensor, design.robot_flange, geometry.fingerprint, design.name)
    screws = screw_groups(adapter, plate, sensor)
    parts = build_parts(geometry, design.density.value, sensor, adapter, plate, screws)
    return CadModel(design, geometry, adapter, plate, screws, parts)
