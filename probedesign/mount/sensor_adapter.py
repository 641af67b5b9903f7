"""Dimensions of the sensor adapter and its clamp ring, which clamp the probe's flange to the sensor's tool face.

From bottom to top in the sensor frame: foot on the tool face; cone that widens to the rim; floor with countersunk
screws into the sensor; recess with the probe's flange, clocked by a peg at +X; clamp ring on the flange's lip, with
screws into nuts in slots that open at the rim. Both parts print on their datum faces, directly on the platform.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array, pose
from probedesign.core.units import MM
from probedesign.design.catalog import M2, NUTS, PRINT_TOLERANCE, Nut, SocketScrew
from probedesign.design.sensors import DowelPattern, ScrewPattern, SensorModel
from probedesign.geometry import FLANGE_LIP, Flange, ProbeGeometry, fingerprint_of
from probedesign.mount.engraving import CELL, NOTHING_CUT, XY, Engraving, engrave, free_arcs
from probedesign.mount.lip import (
    MIN_LIP,
    MIN_RELIEF,
    RIGID_MODULUS,
    STIFF_RESIN,
    land_diameter,
    pad_force,
    plate_bending,
    stiff_thickness,
)

HEAD_SUNK = 0.2 * MM  #: A head lies this far below the face, so that it cannot dent the part that rests on it.
FOOT_HEIGHT = 0.6 * MM  #: Height of the foot's edge above the tool face: clearance to the sensor's body and its cable.
MAX_OVERHANG = 1.0 * MM  #: Longest horizontal overhang that prints without supports. Source: Formlabs' design guide.
FOOT_LEDGE = 0.4 * MM  #: Horizontal overhang at the foot's edge.
#: Angle of the underside to the horizontal: from 19° it prints without supports (Formlabs' design guide).
UNDERSIDE_DEG = 22.0
SLIP = 0.2 * MM  # on the diameter, rigid resin (assumed)
MIN_SQUEEZE = 0.1 * MM  #: Least compression of the flange's lip at the worst corner of the tolerances (assumed).
#: Greatest compression over the thickness: static face seals of elastomer are used up to about 0.3 (assumed).
MAX_SQUEEZE_SHARE = 0.25
PEG_D = 1.9 * MM
#: From the peg's top up to the ring: more than both tolerances, so that the ring never rests on the peg.
PEG_BELOW_RING = 0.4 * MM
#: Radial clearance of the ring's bore at s = 0 to a probe of up to 30 mm, more by the tolerance of a wider one; the
#: bore then widens by 45° to clear the bending probe.
RING_CLEARANCE = 0.5 * MM
RING_AZIMUTHS_DEG = (45.0, 135.0, 225.0, 315.0)
WALL = 0.6 * MM  #: Between a nut's slot and the recess, and outside a hole.
THIN_WALL = 0.4 * MM  #: Below a ring screw's blind hole: a wall that is supported on all sides.
ROOF = 1.0 * MM  #: Least thickness above a nut, which the screw presses against the ring.
NUT_PLAY = 0.2 * MM
TIP_ROOM = 0.85 * MM  #: Depth of the blind hole below the point of a ring screw: more than its tolerances.
HEAD_EDGE = 0.8 * MM  # ring outside a screw's head
LETTER_EDGE = 0.8 * MM  #: Distance from a hole or a screw head's seat to the nearest character.
#: Offset inward from the middle of the lip: outside the hole the soft lip keeps 0.8 mm, twice the minimum wall
#: (assumed), and the ring presses all around it.
PEG_INWARD = 0.05 * MM
MARK_FLAT = 0.8 * MM  #: Depth of the flat on the adapter's rim that marks +X on the outside.
WINDOW_EDGE = 0.4 * MM  #: Between the sides of the window at -X and the characters behind it.
#: Of the notches at +X through the recess's wall and across the ring's underside: on the platform, resin and air pass
#: through them, and they show the clocking.
VENT_WIDTH = 2.0 * MM
RING_VENT_HEIGHT = 0.6 * MM
#: On the diameter: a hole prints undersize by as much, which makes a press or slip fit (assumed).
PRINTED_PIN_PLAY = 0.1 * MM
PIN_TOLERANCE = 0.25 * MM  #: Tolerance ± of a dowel pin's length, ISO 2338.
PIN_ROOM = 0.1 * MM  #: Least room beyond a dowel pin's end, so that the pin never lifts the adapter off the tool face.
SENSOR_HOLE_DISTANCE = 0.05 * MM  #: Tolerance ± of the distance between the sensor's dowel holes (assumed).
#: Material that a printed face may lose on the platform, where the first layers are compressed, or by sanding (assumed:
#: no number is published for the printers).
FACE_LOSS = 0.15 * MM
#: Depth to which a screw's head settles in printed resin after it was tightened (assumed: the resin creeps).
SETTLING = 0.05 * MM


@dataclass(frozen=True)
class MountOptions:
    """Choices of `[mount]` that shape the adapters."""

    ring_screw: SocketScrew = M2  #: of the clamp ring, M2 or M3.
    lip: float = FLANGE_LIP  #: radial width of the flange under the clamp ring [m].
    squeeze: float | None = None  #: nominal compression of the lip [m]; None for the least that the tolerances allow.
    lip_modulus: float = STIFF_RESIN  #: E of the flange that the ring's thickness is chosen for [Pa].

    @property
    def nut(self) -> Nut:
        """Return the nut of the ring's screws."""
        return NUTS[self.ring_screw.thread]


@dataclass(frozen=True)
class SensorAdapter:
    """Dimensions of the adapter on the tool side, in the sensor frame [m]."""

    tool: ScrewPattern  #: tool, dowels: the holes in the sensor's tool face.
    dowels: DowelPattern
    options: MountOptions  #: choices of the design.
    floor: float  #: tool face to the flange's underside, on which the land supports it.
    #: land_d, groove: diameter of the land, the raised middle of the floor, and depth of the floor around it. The ring
    #: presses the lip against the land only.
    land_d: float
    groove: float
    foot_d: float  #: foot_d, foot_height: the disc that rests on the tool face.
    foot_height: float
    #: cone_d, cone_top: diameter at which the underside's cone begins, at `foot_height`, and z where it meets the rim.
    cone_d: float
    cone_top: float
    body_d: float  #: body_d, body_top: the plate above the cone.
    body_top: float
    recess_d: float  #: diameter of the flange's seat, from `floor` up.
    mark_x: float  #: distance of the +X flat from the axis.
    #: dowel_d, dowel_depth, p_dowels: blind holes from below for the sensor's dowel pins; the first is round, the
    #: second a slot that points to the first.
    dowel_d: float
    dowel_depth: float
    p_dowels: tuple[XY, ...]
    peg_top: float  #: peg_top, peg_x: the clocking peg on the floor, at y = 0.
    peg_x: float
    peg_hole_d: float  #: in the flange.
    flange: Flange  #: the probe's flange.
    squeeze: float  #: nominal compression of the flange's lip when the ring rests on the wall.
    probe_d: float  #: greatest diameter of the probe, over which the ring passes.
    ring_bore_d: float  #: ring_bore_d, ring_bore_top_d, ring_thickness: of the clamp ring; its rim is `body_d`.
    ring_bore_top_d: float
    ring_thickness: float
    ring_screw_length: float  #: a stock length under the head.
    ring_circle_d: float  #: of the ring's screws.
    #: nut_slot_width, nut_slot_z, nut_slot_reach: slots from the rim inward: width, lower and upper face, and the
    #: distance of the round inner end's centre inward from the screw.
    nut_slot_width: float
    nut_slot_z: tuple[float, float]
    nut_slot_reach: float
    ring_hole_bottom: float  #: of the blind hole below each nut.
    window_half: float  #: half width of the window in the recess's wall at -X, through which the flange's rim is read.
    #: on_flange, on_wall, on_ring: engravings of the flange's rim (base frame), of the wall around the recess (sensor
    #: frame) and of the ring's top (its own frame).
    on_flange: Engraving = NOTHING_CUT
    on_wall: Engraving = NOTHING_CUT
    on_ring: Engraving = NOTHING_CUT

    @property
    def fingerprints(self) -> dict[str, str]:
        """Return the fingerprint of each of both parts, of all its dimensions."""
        screws = [x for p in (*self.p_tool_screws, *self.p_dowels, *self.p_ring_screws) for x in p]
        adapter = [
            self.floor, self.land_d, self.groove, self.foot_d, self.foot_height, self.cone_d, self.cone_top,
            self.body_d, self.body_top, self.recess_d, self.mark_x, self.dowel_d, self.dowel_depth, self.dowel_slot,
            self.peg_top, self.peg_x, self.tool.grip, self.tool.screw.clearance_d, self.tool.screw.counterbore_d,
            self.roof_hole_d, self.ring_screw.clearance_d, self.ring_hole_bottom, self.nut_slot_width,
            *self.nut_slot_z, self.nut_slot_reach, self.window_half,
        ]  # fmt: skip
        ring = [self.body_d, self.ring_bore_d, self.ring_bore_top_d, self.ring_thickness, self.ring_vent_width,
                self.ring_screw.clearance_d, *(x for p in self.p_ring_screws for x in p)]  # fmt: skip
        return {"sensor_adapter": fingerprint_of([*adapter, *screws]), "clamp_ring": fingerprint_of(ring)}

    @property
    def T_sensor_base(self) -> Array:
        """Return the pose of the base frame in the sensor frame, (4, 4): along the axis, x axes parallel."""
        return pose(p=[0.0, 0.0, self.floor + self.flange.thickness])

    @property
    def groove_floor(self) -> float:
        """Return z of the floor around the land [m]."""
        return self.floor - self.groove

    @property
    def ring_screw(self) -> SocketScrew:
        """Return the dimensions of the ring's screws."""
        return self.options.ring_screw

    def ring_bending(self, force: float) -> tuple[float, float]:
        """Return by how much the ring's inner edge bends under a force of the lip [m], see `lip.plate_bending`."""
        load_d = (self.ring_bore_d + self.land_d) / 2
        return plate_bending(RIGID_MODULUS, self.ring_thickness, self.ring_bore_d, self.recess_d, load_d, force)

    @cached_property
    def pressed_share(self) -> float:
        """Return the fraction of the ring between bore and land whose lip is pressed between rigid faces: without the
        rooms of the screws' heads in the land, the clocking hole and the notch in the ring above it."""
        nodes, weights = np.polynomial.legendre.leggauss(64)
        middle, half = (self.land_d + self.ring_bore_d) / 4, (self.land_d - self.ring_bore_d) / 4
        r = middle + half * nodes

        def covered(apart: float, d: float) -> Array:
            """Return half the angle of each circle of radius r that lies in one of diameter d about a point."""
            apart = max(apart, 1e-9 * d)  # on the axis, all of a circle or nothing
            return np.arccos(np.clip((r * r + apart**2 - d * d / 4) / (2 * r * apart), -1.0, 1.0))

        heads = len(self.p_tool_screws) * covered(self.tool.bolt_circle_d / 2, self.tool.screw.counterbore_d)
        notch = np.arcsin(np.minimum(self.ring_vent_width / 2 / r, 1.0))
        open_angle = 2.0 * np.minimum(heads + np.maximum(notch, covered(self.peg_x, self.peg_hole_d)), np.pi)
        return float(1.0 - weights * r @ open_angle / (2.0 * np.pi) / (weights @ r))

    @property
    def p_tool_screws(self) -> tuple[XY, ...]:
        """Return (x, y) of the screws into the sensor [m]."""
        return on_circle(self.tool.bolt_circle_d, self.tool.azimuths_deg)

    @property
    def p_ring_screws(self) -> tuple[XY, ...]:
        """Return (x, y) of the ring's screws [m]."""
        return on_circle(self.ring_circle_d, RING_AZIMUTHS_DEG)

    @property
    def ring_vent_width(self) -> float:
        """Return the width of the notch across the ring's underside [m]: half a narrow bore at most."""
        return min(VENT_WIDTH, 0.5 * self.ring_bore_d)

    @property
    def ring_top(self) -> float:
        """Return z of the face under the heads of the ring's screws, the lip uncompressed [m]."""
        return self.floor + self.flange.thickness + self.ring_thickness

    @property
    def nut_roof(self) -> float:
        """Return the thickness between a nut and the ring [m]."""
        return self.body_top - self.nut_slot_z[1]

    @property
    def roof_hole_d(self) -> float:
        """Return the diameter of a ring screw's hole above its nut [m]: so wide that the roof prints unsupported.

        Beyond the hole's radius h along the slot, bridges of half length b cross it. The point of the hole's edge that
        is farthest from a bridge and from the slot's side has the same distance m to both: (b - m)² + (h - m)² = h².
        """
        half, m = self.nut_slot_width / 2, MAX_OVERHANG
        return max(self.ring_screw.clearance_d, _up(((half - m) ** 2 + m**2) / m))

    @property
    def roof_overhang(self) -> float:
        """Return m of `roof_hole_d`, the horizontal overhang of a nut slot's roof [m]."""
        half, h = self.nut_slot_width / 2, self.roof_hole_d / 2
        return (half + h - math.sqrt((half + h) ** 2 - 2 * half**2)) / 2

    @property
    def dowel_distance(self) -> float:
        """Return the distance between the dowel holes [m]; 0 for fewer than two."""
        return math.dist(self.p_dowels[0], self.p_dowels[-1]) if self.p_dowels else 0.0

    @property
    def tool_play(self) -> float:
        """Return the greatest play of the screws into the sensor in their holes, on the diameter [m]."""
        return self.tool.screw.clearance_d + PRINT_TOLERANCE - self.tool.screw.nominal_d

    @property
    def tool_play_deg(self) -> float:
        """Return the greatest angle ± by which the adapter turns in the play of its screws [deg]; 0 with two dowels,
        90 where one screw on the axis and no dowel leave any turn."""
        centre = self.p_dowels[0] if self.p_dowels else (0.0, 0.0)
        reach = max(math.dist(centre, p) for p in self.p_tool_screws)
        return 0.0 if len(self.p_dowels) > 1 else math.degrees(math.atan2(self.tool_play / 2, reach))

    @property
    def dowel_slot(self) -> float:
        """Return the length of the second dowel's slot beyond its width [m].

        It takes the tolerances of the slot and of the distance between the holes, in adapter and sensor.
        """
        apart = length_tolerance(self.dowel_distance) + SENSOR_HOLE_DISTANCE
        return _up(2 * apart + PRINT_TOLERANCE)

    def dowel_slot_deg(self, number: int) -> float | None:
        """Return the direction of a dowel hole's slot in the sensor frame [deg]; None for a round hole."""
        if number == 0:
            return None
        (x0, y0), (x, y) = self.p_dowels[0], self.p_dowels[number]
        return math.degrees(math.atan2(y0 - y, x0 - x))


def on_circle(diameter: float, azimuths_deg: Iterable[float]) -> tuple[XY, ...]:
    """Return points on a circle about the origin; diameter [m], azimuths [deg]."""
    angles = np.radians(list(azimuths_deg))
    return tuple((float(diameter / 2 * np.cos(a)), float(diameter / 2 * np.sin(a))) for a in angles)


def sensor_adapter_for(
    geometry: ProbeGeometry, sensor: SensorModel, name: str = "", options: MountOptions | None = None
) -> SensorAdapter:
    """Return the adapter that mounts a probe on a sensor; `name` is engraved after the fingerprint as far as it fits.

    Raises:
        InputError: the probe is too wide above its base for any ring that could still clamp the flange, or the lip
            cannot be clamped at every corner of the tolerances.
    """
    options = options or MountOptions()
    flange, screw, nut = geometry.flange, options.ring_screw, options.nut
    tool, dowels = sensor.interface.tool, sensor.interface.dowels
    squeeze = _squeeze(flange, options)
    recess_d = flange.diameter + SLIP

    width = nut.af + SLIP
    # The nut's two inner corners, at (af/√12, af/2) from its axis, touch the slot's round end.
    reach = _up(nut.af / math.sqrt(12.0) - math.sqrt((width / 2) ** 2 - (nut.af / 2) ** 2))
    circle_d = _up(recess_d + 2 * (WALL + width / 2 + reach))
    # The ring passes over the tip and the widest section.
    probe_d, max_d = 2.0 * float(geometry.radius.max()), max_ring_passage_d(flange)
    if probe_d > max_d + 1e-9:  # round-off of sums
        raise InputError(
            f"probe.profile_mm: {probe_d / MM:g} mm at its widest, so the clamp ring cannot pass; at most "
            f"{max_d / MM:.4g} mm with a base of {2 * geometry.base_radius / MM:g} mm"
        )
    bore_d = probe_d + 2 * (RING_CLEARANCE + length_tolerance(probe_d) - PRINT_TOLERANCE)
    land_d = land_diameter(2 * geometry.base_radius, options.lip, flange.diameter, bore_d, tool, WALL)
    if not tool.bolt_circle_d and land_d < (around := tool.screw.counterbore_d + 2 * WALL):
        raise InputError(
            f"mount.flange_lip_mm = {options.lip / MM:g} leaves no land around the head of the sensor's screw on the "
            f"axis; at least {(around / 2 + MIN_RELIEF) / MM - geometry.base_radius / MM:.3g} mm"
        )
    stock = [n * MM for n in screw.stock_mm]
    thickest = stock[-1] - ROOF - nut.height - nut_slack(screw, stock[-1])
    force = pad_force(options.lip_modulus, bore_d, land_d, flange.thickness, squeeze)
    thinnest = (2.5 if screw is M2 else 4.0) * MM
    stiff = stiff_thickness(RIGID_MODULUS, thinnest, bore_d, recess_d, (bore_d + land_d) / 2, force, squeeze)
    ring_thickness = min(stiff, thickest)
    needed = ring_thickness + ROOF + nut.height
    length = next(n for n in stock if n >= needed + nut_slack(screw, n) - 1e-9)
    roof = length - ring_thickness - nut.height - nut_slack(screw, length)
    pin_beyond = dowels.pin_length - dowels.depth
    dowel_depth = (pin_beyond + PIN_TOLERANCE + PRINT_TOLERANCE + FACE_LOSS + PIN_ROOM) * bool(dowels.azimuths_deg)
    body_d = circle_d + screw.head_d + 2 * HEAD_EDGE
    head_clear_d = circle_d - screw.counterbore_d  # the heads need a seat beside the bore
    foot_d, cone_d = tool.face_d, tool.face_d + 2 * FOOT_LEDGE
    rise = math.tan(math.radians(UNDERSIDE_DEG))
    cone_top = FOOT_HEIGHT + rise * (body_d - cone_d) / 2
    cone_at_hole = FOOT_HEIGHT + rise * (circle_d + screw.clearance_d - cone_d) / 2
    # From the floor up; a wide rim has a high cone, on which the floor must lie higher than its screws require.
    wall = flange.thickness - squeeze
    slot_bottom = wall - roof - nut.height - NUT_PLAY
    hole_bottom = wall + ring_thickness - length - TIP_ROOM
    groove = _up(squeeze + length_tolerance(flange.thickness) + 2 * PRINT_TOLERANCE)
    lowest = max(
        cone_top + WALL - slot_bottom,
        cone_at_hole + THIN_WALL - hole_bottom,
        cone_top + WALL + groove,
        dowel_depth + THIN_WALL + groove,
    )
    floor = tool.grip + tool.screw.head_height + HEAD_SUNK
    if tool.bolt_circle_d + tool.screw.counterbore_d > land_d:  # the heads lie below the groove as well
        floor += groove
    floor = max(floor, _up(lowest))
    body_top = floor + wall
    peg_x, peg_hole_d = (flange.diameter - options.lip) / 2 - PEG_INWARD, PEG_D + 0.1 * MM
    mark_x = body_d / 2 - MARK_FLAT
    letters = (recess_d / 2 + mark_x) / 2

    # The window ends a wall before the nut slots beside it; a digit is three cells wide, and one apart from the next.
    digits = int(((circle_d / 2 - reach) / math.sqrt(2.0) - width / 2 - WALL - WINDOW_EDGE) / (2.0 * CELL))
    window_half = 2.0 * CELL * min(digits, len(geometry.fingerprint)) + WINDOW_EDGE

    def engraved(part: str, radius: float, top: float, azimuths_deg: tuple[float, ...], hole_d: float) -> Engraving:
        clear = [hole_d / 2 + LETTER_EDGE] * len(azimuths_deg)
        if part == "sensor_adapter":
            azimuths_deg, clear = (*azimuths_deg, 180.0), [*clear, window_half + LETTER_EDGE]
        arcs = free_arcs(radius, np.radians(azimuths_deg).tolist(), clear)
        return engrave(fingerprints[part], name, radius, top, arcs)

    plain = SensorAdapter(
        tool=tool,
        dowels=dowels,
        options=options,
        floor=floor,
        land_d=land_d,
        groove=groove,
        foot_d=foot_d,
        foot_height=FOOT_HEIGHT,
        cone_d=cone_d,
        cone_top=cone_top,
        body_d=body_d,
        body_top=body_top,
        recess_d=recess_d,
        mark_x=mark_x,
        dowel_d=dowels.diameter + PRINTED_PIN_PLAY,
        dowel_depth=dowel_depth,
        p_dowels=on_circle(dowels.circle_d, dowels.azimuths_deg),
        peg_top=body_top - PEG_BELOW_RING,
        peg_x=peg_x,
        peg_hole_d=peg_hole_d,
        flange=flange,
        squeeze=squeeze,
        probe_d=probe_d,
        ring_bore_d=bore_d,
        ring_bore_top_d=min(bore_d + 2 * ring_thickness, head_clear_d, flange.diameter - 2 * RING_CLEARANCE),
        ring_thickness=ring_thickness,
        ring_screw_length=length,
        ring_circle_d=circle_d,
        nut_slot_width=width,
        nut_slot_z=(floor + slot_bottom, body_top - roof),
        nut_slot_reach=reach,
        ring_hole_bottom=floor + hole_bottom,
        window_half=window_half,
    )
    first, fingerprints = geometry.fingerprint[:digits], plain.fingerprints
    step = 4.0 * CELL / (flange.diameter / 2)
    azimuths = tuple(math.pi + step * (i - (len(first) - 1) / 2) for i in range(len(first)))
    return replace(
        plain,
        on_flange=Engraving(first, flange.diameter / 2, azimuths, -flange.thickness / 2, on_side=True),
        on_wall=engraved("sensor_adapter", letters, body_top, (0.0, *RING_AZIMUTHS_DEG), screw.clearance_d),
        on_ring=engraved("clamp_ring", letters, ring_thickness, RING_AZIMUTHS_DEG, screw.head_d),
    )


def touched_part(geometry: ProbeGeometry, a: SensorAdapter) -> str:
    """Return what of the mount a curved body touches above its base, within the tolerance of a print; empty if nothing.

    Looked at are the ring with its bore, which widens from the base plane up, and the heads of its screws.
    """
    s, side = np.linspace(0.0, geometry.length, 400), np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    ring = np.stack([np.cos(side), geometry.cross_section.flatness * np.sin(side)])
    T = geometry.axis.frames(s)
    p = T[:, None, :3, 3] + np.einsum("ksa,an->kns", T[:, :3, :2], ring) * geometry.radius_at(s)[:, None, None]
    away, z, clear = np.hypot(p[..., 0], p[..., 1]), p[..., 2], PRINT_TOLERANCE
    bore = a.ring_bore_d / 2 + (a.ring_bore_top_d - a.ring_bore_d) / 2 * np.clip(z / a.ring_thickness, 0.0, 1.0)
    in_ring = (z < a.ring_thickness + clear) & (away > bore - clear) & (away < a.body_d / 2 + clear)
    in_ring &= (z < a.ring_thickness) | (away > a.ring_bore_top_d / 2)
    from_heads = np.min([np.hypot(p[..., 0] - x, p[..., 1] - y) for x, y in a.p_ring_screws], axis=0)
    top = a.ring_thickness + a.ring_screw.head_height + clear
    in_heads = (z < top) & (from_heads < a.ring_screw.head_d / 2 + clear)
    for what, touches in (("a screw's head on the clamp ring", in_heads), ("the clamp ring", in_ring)):
        if touches.any():
            return f"{what} at s = {s[int(touches.any(axis=1).argmax())] / MM:.3g} mm"
    return ""


def _up(length: float) -> float:
    """Return a length rounded up to 0.1 mm, for drawings [m]."""
    return math.ceil(length / (0.1 * MM) - 1e-6) * 0.1 * MM


def nut_slack(screw: SocketScrew, length: float) -> float:
    """Return how much less [m] a ring screw may enter its nut at the worst corner: screw, ring and roof."""
    return screw.length_tolerance(length) + 2 * PRINT_TOLERANCE


def length_tolerance(length: float) -> float:
    """Return the tolerance ± [m] of a printed length [m]."""
    return max(PRINT_TOLERANCE, 0.005 * length)


def _squeeze(flange: Flange, options: MountOptions) -> float:
    """Return the nominal compression of the lip [m], which is positive at every corner of the tolerances."""
    slack = length_tolerance(flange.thickness) + PRINT_TOLERANCE
    low, high = MIN_SQUEEZE + slack, MAX_SQUEEZE_SHARE * flange.thickness - slack
    if low > high + 1e-9:
        least = (low + slack) / MAX_SQUEEZE_SHARE
        raise InputError(
            f"mount.flange_thickness_mm = {flange.thickness / MM:g} cannot be clamped within its tolerances; "
            f"at least {math.ceil(least / MM * 20 - 1e-6) / 20:g} mm"
        )
    squeeze = low if options.squeeze is None else options.squeeze
    if not low - 1e-9 <= squeeze <= high + 1e-9:
        raise InputError(
            f"mount.squeeze_mm = {squeeze / MM:g} does not clamp the lip within its tolerances; "
            f"allowed is {low / MM:.3g} ... {high / MM:.3g} mm"
        )
    return squeeze


def max_ring_passage_d(flange: Flange) -> float:
    """Return the largest probe diameter over which a ring passes that still clamps the flange [m]."""
    rest = flange.diameter - 2 * (MIN_RELIEF + MIN_LIP + RING_CLEARANCE)
    return rest - 2 * (length_tolerance(rest) - PRINT_TOLERANCE)
