"""CAD model of a design: every part as a solid placed in the sensor frame, its screws, and the volumes kept clear.

Solids are in millimetres, each in its part's own frame.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any

import cadquery as cq
import numpy as np

from probedesign.cad.kernel import (
    block,
    cylinder,
    engraving_cuts,
    frusta,
    hexagon,
    location,
    mass_properties,
    placed,
    revolved,
    round_slot,
    single_solid,
)
from probedesign.core.errors import CheckFailedError
from probedesign.core.frames import Array, pose
from probedesign.core.units import MM
from probedesign.design import Design
from probedesign.design.catalog import STEEL_DENSITY, SocketScrew
from probedesign.design.sensors import CableExit, ScrewPattern, SensorInterface
from probedesign.geometry import ProbeGeometry, build_geometry
from probedesign.geometry.mass import MassProperties, combined
from probedesign.mount import (
    FlangeAdapter,
    SensorAdapter,
    flange_adapter_for,
    mount_options,
    sensor_adapter_for,
)
from probedesign.mount.engraving import XY
from probedesign.mount.flange_adapter import CENTRING_PIN_D, CENTRING_PIN_LENGTH, TIE_SLOT
from probedesign.mount.sensor_adapter import DOWEL_SLOT, PEG_D, RING_VENT_HEIGHT, VENT_WIDTH, on_circle

MIN_CLEARANCE = 0.5 * MM
"""Minimum clearance to the sensor's body and cable: a contact across the split line would bypass the strain gauges."""
IN_SENSOR_FRAME = pose()
SECTOR_REACH = 31.5 * MM
"""Distance from the sensor's body up to which the cable's sector is checked; it exceeds every part of the mount."""


@dataclass(frozen=True)
class ScrewGroup:
    """Equal screws that fasten one part to another; lengths [m], positions in the sensor frame.

    Attributes:
        name: of the group.
        into: the part or thread that they enter.
        screw: dimensions of the standard.
        length: under the head.
        grip: thickness between head and thread.
        entry_limits: minimum and maximum allowed entry.
        points: (x, y) of each.
        seat: z of the face under the heads.
        up: whether the screws point to +z.
    """

    name: str
    into: str
    screw: SocketScrew
    length: float
    grip: float
    entry_limits: tuple[float, float]
    points: tuple[XY, ...]
    seat: float
    up: bool

    @property
    def entry(self) -> float:
        """Return the depth of thread engagement [m]."""
        return self.length - self.grip

    def check(self) -> None:
        """Check that the length is a stock length and the entry within its limits.

        Raises:
            CheckFailedError: names the screw, its entry and the allowed range.
        """
        low, high = self.entry_limits
        if not low - 1e-9 <= self.entry <= high + 1e-9:  # a nanometre for round-off of sums
            raise CheckFailedError(
                f"{self.name}: {self.screw.thread}×{self.length / MM:g} would enter {self.into} by "
                f"{self.entry / MM:.2f} mm; allowed {low / MM:g} to {high / MM:g} mm"
            )
        if not any(abs(self.length - n * MM) < 1e-9 for n in self.screw.stock_mm):
            raise CheckFailedError(
                f"{self.name}: {self.screw.thread}×{self.length / MM:g} is not a stock length"
            )

    def as_record(self) -> dict[str, Any]:
        """Return the record of the manifest, in millimetres."""
        return {
            "name": self.name,
            "screw": f"ISO 4762 {self.screw.thread}x{self.length / MM:g}",
            "count": len(self.points),
            "into": self.into,
            "length_mm": round(self.length / MM, 6),
            "grip_mm": round(self.grip / MM, 6),
            "entry_mm": round(self.entry / MM, 6),
            "entry_allowed_mm": [round(limit / MM, 6) for limit in self.entry_limits],
        }


def screw_groups(a: SensorAdapter, plate: FlangeAdapter) -> list[ScrewGroup]:
    """Return all screws of the assembly, checked.

    Raises:
        CheckFailedError: a screw enters too little or too deep.
    """
    T, robot, tool, mounting = plate.T_sensor_robotflange, plate.robot, a.tool, plate.mounting
    bolt = robot.screw
    ring_grip = a.ring_thickness + a.nut_roof  # with the ring pressed onto the wall
    nut = (a.options.nut.height, a.nut_slot_z[1] - a.ring_hole_bottom)
    thread = (0.8 * bolt.nominal_d, robot.max_bolt_entry)  # 0.8 d of thread engagement suffices in aluminium
    uses = [
        ScrewGroup("sensor_adapter_screws", "sensor tool side", tool.screw, tool.length, tool.grip,
                   (tool.min_entry, tool.max_entry), a.p_tool_screws, tool.grip, up=False),
        ScrewGroup("ring_screws", "nuts in the sensor adapter", a.ring_screw, a.ring_screw_length, ring_grip,
                   nut, a.p_ring_screws, a.ring_top, up=False),
        ScrewGroup("mounting_screws", "sensor mounting side", mounting.screw, mounting.length, mounting.grip,
                   (mounting.min_entry, mounting.max_entry), _in_frame(plate.p_mounting_screws, T),
                   float(T[2, 3]) + plate.counterbore_top, up=True),
        ScrewGroup("robot_bolts", "robot flange", bolt, robot.bolt_length, plate.plate_top,
                   thread, _in_frame(plate.p_bolts, T), float(T[2, 3]) + plate.plate_top, up=False),
    ]  # fmt: skip
    for use in uses:
        use.check()
    return uses


def screw_solids(use: ScrewGroup) -> cq.Compound:
    """Return the screws as solids, in millimetres in the sensor frame; threads drawn at their pitch diameter."""
    return cq.Compound.makeCompound([_screw(use, p) for p in use.points])


def nut_solids(a: SensorAdapter) -> cq.Compound:
    """Return the nuts at the top of their slots, two sides along the slot."""
    nut, screw = a.options.nut, a.ring_screw
    z = (a.nut_slot_z[1] - nut.height, a.nut_slot_z[1])
    return cq.Compound.makeCompound(
        [
            single_solid(hexagon(nut.af, *z, p, 30.0).cut(cylinder(screw.pitch_d, *z, p)))
            for p in a.p_ring_screws
        ]
    )


def centring_pin_solids(plate: FlangeAdapter) -> cq.Compound:
    """Return the pins around the sensor's body, in millimetres in the sensor frame, on the bottom of their holes."""
    T, bottom = plate.T_sensor_robotflange, plate.centring_hole[1]
    z = float(T[2, 3]) + bottom
    points = _in_frame(plate.p_centring_pins, T)
    return cq.Compound.makeCompound([cylinder(CENTRING_PIN_D, z, z + CENTRING_PIN_LENGTH, p) for p in points])


def _screw(use: ScrewGroup, p: XY) -> cq.Solid:
    s, seat = use.screw, use.seat
    axis = 1.0 if use.up else -1.0  # from head to point
    top = seat - axis * s.head_height
    head = cylinder(s.head_d, *_between(seat, top), p)
    shank = cylinder(s.pitch_d, *_between(seat, seat + axis * use.length), p)
    socket = hexagon(s.socket_af, *_between(top, top + axis * s.socket_depth), p)
    return single_solid(head.fuse(shank).cut(socket))


def _between(a: float, b: float) -> tuple[float, float]:
    return min(a, b), max(a, b)


def _in_frame(points: Iterable[XY], T_a_b: Array) -> tuple[XY, ...]:
    """Return points (x, y) of frame b in frame a; the z axes are parallel."""
    R, t = T_a_b[:2, :2], T_a_b[:2, 3]
    return tuple((float(q[0]), float(q[1])) for q in (R @ p + t for p in points))


def probe_solid(geometry: ProbeGeometry, adapter: SensorAdapter) -> cq.Solid:
    """Return the flexible part and its flange in one solid.

    Args:
        geometry: of the probe.
        adapter: its peg passes through the flange, where the hole at +x is the clocking mark; it also defines the
            engraving of the lip.

    Returns:
        The solid in millimetres in the base frame: flexible part above z = 0, flange below.
    """
    mark = cylinder(adapter.peg_hole_d, -geometry.flange.thickness, 0.0, (adapter.peg_x, 0.0))
    body = _turned(geometry) if geometry.cross_section.full_round else _ruled(geometry)
    return single_solid(body.cut(mark, *engraving_cuts(adapter.on_flange)))


def _turned(geometry: ProbeGeometry) -> cq.Shape:
    rim, underside = geometry.flange.diameter / 2, -geometry.flange.thickness
    taper = _taper(geometry)
    return revolved([(0.0, underside), (rim, underside), (rim, 0.0), *taper, (0.0, geometry.length)])


def _ruled(geometry: ProbeGeometry) -> cq.Shape:
    """Loft a body of any cross-section.

    A hollow one is not revolved: the kernel confuses a cone of a thin bore with a cylinder, and meshes it with hundreds
    of thousands of triangles.
    """
    section, taper = geometry.cross_section, _taper(geometry)
    disc = cylinder(geometry.flange.diameter, -geometry.flange.thickness, 0.0)
    body = disc.fuse(frusta(taper, section.flatness))
    if not section.hollow:
        return body
    # Open from tip to underside, so that resin drains at both ends.
    bore = [(section.bore_ratio * r, s) for r, s in taper]
    return body.cut(frusta([(geometry.bore_radius, -geometry.flange.thickness), *bore]))


def _taper(geometry: ProbeGeometry) -> list[XY]:
    """Return (radius, s) at the knots [m]."""
    return [(float(r), float(s)) for s, r in zip(geometry.s, geometry.radius, strict=True)]


def sensor_adapter_solid(a: SensorAdapter) -> cq.Solid:
    """Return the sensor adapter, in millimetres in the sensor frame: its foot rests on the tool face, z = 0."""
    foot, cone, rim, recess = a.foot_d / 2, a.cone_d / 2, a.body_d / 2, a.recess_d / 2
    outline = [
        (0.0, 0.0), (foot, 0.0), (foot, a.foot_height), (cone, a.foot_height), (rim, a.cone_top),
        (rim, a.body_top), (recess, a.body_top), (recess, a.floor), (0.0, a.floor),
    ]  # fmt: skip
    hole_d, (slot_z0, slot_z1) = a.ring_screw.clearance_d, a.nut_slot_z
    circle = a.ring_circle_d / 2
    holes = [
        block((a.mark_x, rim), (-rim, rim), (a.cone_top, a.body_top)),
        block((a.peg_x, a.mark_x), (-VENT_WIDTH / 2, VENT_WIDTH / 2), (a.floor, a.body_top)),
        *(cylinder(a.tool.screw.clearance_d, 0.0, a.tool.grip, p) for p in a.p_tool_screws),
        *(cylinder(a.tool.screw.counterbore_d, a.tool.grip, a.floor, p) for p in a.p_tool_screws),
        *(_dowel_hole(a, number) for number in range(len(a.p_dowels))),
        *(cylinder(hole_d, slot_z1, a.body_top, p) for p in a.p_ring_screws),
        *(cylinder(hole_d, a.ring_hole_bottom, slot_z0, p) for p in a.p_ring_screws),
        *(round_slot(a.nut_slot_width, (circle - a.nut_slot_reach, 1.2 * rim), a.nut_slot_z, (0.0, 0.0),
                     math.degrees(math.atan2(p[1], p[0]))) for p in a.p_ring_screws),
        *engraving_cuts(a.on_wall),
    ]  # fmt: skip
    peg = cylinder(PEG_D, a.floor, a.peg_top, (a.peg_x, 0.0))
    return single_solid(revolved(outline).cut(*holes).fuse(peg))


def _dowel_hole(a: SensorAdapter, number: int) -> cq.Solid:
    slot_deg, p, half = a.dowel_slot_deg(number), a.p_dowels[number], DOWEL_SLOT / 2
    if slot_deg is None:
        return cylinder(a.dowel_d, 0.0, a.dowel_depth, p)
    return round_slot(a.dowel_d, (-half, half), (0.0, a.dowel_depth), p, slot_deg, both_ends=True)


def clamp_ring_solid(a: SensorAdapter) -> cq.Solid:
    """Return the clamp ring, in millimetres in its own frame: underside at z = 0, which lies on the base plane."""
    bore, top = a.ring_bore_d / 2, a.ring_bore_top_d / 2
    height = a.ring_thickness
    body = cylinder(a.body_d, 0.0, height).cut(
        revolved([(0.0, 0.0), (bore, 0.0), (top, height), (0.0, height)]),
        *(cylinder(a.ring_screw.clearance_d, 0.0, height, p) for p in a.p_ring_screws),
        block((0.0, a.body_d), (-a.ring_vent_width / 2, a.ring_vent_width / 2), (0.0, RING_VENT_HEIGHT)),
        *engraving_cuts(a.on_ring),
    )
    return single_solid(body)


def flange_adapter_solid(a: FlangeAdapter) -> cq.Solid:
    """Return the flange adapter, in millimetres in the robot flange's frame: spigot below z = 0, flat top."""
    spigot_d, spigot_height = a.robot.spigot
    width, length = a.robot.pin_slot
    reach, screw, top = a.robot.bolt_circle_d / 2, a.mounting.screw, a.plate_top
    body = cylinder(a.plate_d, 0.0, top)
    if spigot_height:
        body = body.fuse(cylinder(spigot_d, -spigot_height, 0.0))
    radial, tangential = (side / 2 for side in TIE_SLOT)
    holes = [
        *(cylinder(a.robot.screw.clearance_d, 0.0, top, p) for p in a.p_bolts),
        *(cylinder(screw.counterbore_d, -spigot_height, a.counterbore_top, p) for p in a.p_mounting_screws),
        *(cylinder(screw.clearance_d, a.counterbore_top, top, p) for p in a.p_mounting_screws),
        _turned_to(block(*a.cable_pocket), a.cable_deg),
        *(cylinder(a.centring_hole[0], a.centring_hole[1], top, p) for p in a.p_centring_pins),
        *(_turned_to(block((-radial, radial), (-tangential, tangential), (0.0, top)), a.cable_deg, p)
          for p in a.p_tie_slots),
        *engraving_cuts(a.on_plate),
    ]  # fmt: skip
    if width:
        sides = (reach - length / 2, reach + length / 2), (-width / 2, width / 2)
        holes.append(block(*sides, (0.0, a.plate_top)))
    return single_solid(body.cut(*holes))


def _turned_to(shape: cq.Solid, azimuth_deg: float, p: XY = (0.0, 0.0)) -> cq.Shape:
    """Return a shape turned about z and moved to p [m]."""
    turned = shape.rotate((0, 0, 0), (0, 0, 1), azimuth_deg)
    return placed(turned, pose(p=[*p, 0.0]))


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
    sensor: SensorInterface,
    adapter: SensorAdapter,
    plate: FlangeAdapter,
    screws: list[ScrewGroup],
) -> dict[str, CadPart]:
    """Return every part of the assembly by name, the printed ones first."""
    T, grey, steel = adapter.T_sensor_base, (0.75, 0.75, 0.72), (0.45, 0.47, 0.5)
    rigid = adapter.options.density
    printed = [
        CadPart("probe", probe_solid(geometry, adapter), T, "base", probe_density, (0.93, 0.85, 0.6)),
        CadPart("sensor_adapter", sensor_adapter_solid(adapter), IN_SENSOR_FRAME, "sensor", rigid, grey),
        CadPart("clamp_ring", clamp_ring_solid(adapter), T, "clamp_ring", rigid, (0.35, 0.5, 0.7)),
        CadPart("flange_adapter", flange_adapter_solid(plate), plate.T_sensor_robotflange, "robotflange",
             rigid, grey),
    ]  # fmt: skip
    bought = {use.name: screw_solids(use) for use in screws}
    dowels, z = adapter.dowels, -adapter.dowels.depth
    pins = [cylinder(dowels.diameter, z, z + dowels.pin_length, p) for p in adapter.p_dowels]
    bought |= {"ring_nuts": nut_solids(adapter), "dowel_pins": cq.Compound.makeCompound(pins)}
    if plate.p_centring_pins:
        bought["centring_pins"] = centring_pin_solids(plate)
    loose = [
        CadPart(name, shape, IN_SENSOR_FRAME, "sensor", STEEL_DENSITY, steel, printed=False)
        for name, shape in bought.items()
    ]
    envelope = CadPart(
        "sensor", sensor_envelope(sensor), IN_SENSOR_FRAME, "sensor", 0.0, (0.6, 0.6, 0.65), False
    )
    return {part.name: part for part in [*printed, *loose, envelope]}


def sensor_envelope(sensor: SensorInterface) -> cq.Shape:
    """Return the sensor's body with its holes and its cable's exit, in the sensor frame."""
    h, cable, dowels = sensor.height, sensor.cable, sensor.dowels
    low, high = cable.heights
    exit_block = block((0.0, cable.reach), (-cable.width / 2, cable.width / 2), (low - h, high - h))
    return cylinder(sensor.body_d, -h, 0.0).fuse(_at_cable(exit_block, cable)).cut(
        *_threads(sensor.tool, -sensor.tool.max_entry, 0.0),
        *_threads(sensor.mounting, -h, sensor.mounting.max_entry - h),
        *(cylinder(dowels.diameter, -dowels.depth, 0.0, p) for p in on_circle(dowels.circle_d, dowels.azimuths_deg)),
    )  # fmt: skip


def _threads(pattern: ScrewPattern, z0: float, z1: float) -> list[cq.Solid]:
    d, points = pattern.screw.nominal_d, on_circle(pattern.bolt_circle_d, pattern.azimuths_deg)
    return [cylinder(d, z0, z1, p) for p in points]


def _at_cable(shape: cq.Shape, cable: CableExit, turn_deg: float = 0.0) -> cq.Shape:
    """Return a shape that is drawn about +x turned to the cable."""
    return shape.rotate((0, 0, 0), (0, 0, 1), cable.azimuth_deg + turn_deg)


def clearance_volumes(sensor: SensorInterface) -> list[cq.Shape]:
    """Return the volumes around the sensor's body, tool face and cable exit that must stay empty."""
    h, r, cable, gap = sensor.height, sensor.body_d / 2, sensor.cable, MIN_CLEARANCE
    # The centring pins touch the mounting side only, below the cable's free height.
    shell = cylinder(2 * (r + gap), cable.free_height - h, gap).cut(
        cylinder(2 * r, cable.free_height - h, gap)
    )
    side, (low, high) = cable.width / 2 + gap, cable.heights
    # Within the rim no part lies above the mounting face; from there the clearance is measured obliquely.
    inward = math.sqrt(max(gap**2 - low**2, 0.0))
    exit_room = block((r - inward, cable.reach + gap), (-side, side), (low - gap - h, high + gap - h))
    return [shell, _at_cable(exit_room, cable)]


def cable_sector(sensor: SensorInterface) -> cq.Shape:
    """Return the sector around the cable that only the sensor may occupy, in the sensor frame."""
    cable, z = sensor.cable, -sensor.height
    wedge = cq.Solid.makeCylinder(
        (sensor.body_d / 2 + SECTOR_REACH) / MM, cable.free_height / MM, cq.Vector(0, 0, z / MM),
        angleDegrees=2 * cable.half_width_deg,
    )  # fmt: skip
    return _at_cable(wedge, cable, -cable.half_width_deg).cut(cylinder(sensor.body_d, z, 0.0))


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


def printed_solid(design: Design, part: str) -> cq.Solid:
    """Return one printed part in its own frame, in millimetres, without building the others.

    Raises:
        InputError: the mount cannot clamp this probe.
        CheckFailedError: a screw would enter too deep, or the part is not one valid solid.
    """
    geometry, sensor, options = build_geometry(design), design.sensor_model, mount_options(design)
    plate = flange_adapter_for(sensor, design.robot_flange, geometry.fingerprint, design.name, options)
    adapter = sensor_adapter_for(geometry, sensor, design.name, options)
    screw_groups(adapter, plate)
    match part:
        case "probe":
            return probe_solid(geometry, adapter)
        case "sensor_adapter":
            return sensor_adapter_solid(adapter)
        case "clamp_ring":
            return clamp_ring_solid(adapter)
        case _:
            return flange_adapter_solid(plate)


def build_cad(design: Design) -> CadModel:
    """Build the CAD model of a design.

    Raises:
        InputError: the mount cannot clamp this probe.
        CheckFailedError: a screw would enter too deep, or a part is not one valid solid.
    """
    geometry, sensor = build_geometry(design), design.sensor_model
    options = mount_options(design)
    adapter = sensor_adapter_for(geometry, sensor, design.name, options)
    plate = flange_adapter_for(sensor, design.robot_flange, geometry.fingerprint, design.name, options)
    screws = screw_groups(adapter, plate)
    parts = build_parts(geometry, design.density.value, sensor.interface, adapter, plate, screws)
    return CadModel(design, geometry, adapter, plate, screws, parts)
