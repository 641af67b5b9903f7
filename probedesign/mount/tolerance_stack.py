"""Tolerance stacks of the mount, and the force that closes the clamp.

The stacks are compression of the flange, entry of each screw, room beyond each pin, and each fit.

Each is a sum of dimensions with their tolerances. The worst case adds all tolerances; the root sum of squares (RSS)
takes them as independent, each tolerance as three standard deviations, so that 0.27 % of all mounts lie
outside. Every stack must lie within its limits in the worst case.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

from probedesign.core.units import MM, MPA
from probedesign.design.catalog import SocketScrew
from probedesign.mount.flange_adapter import CENTRING_PIN_D, CENTRING_PIN_LENGTH, SENSOR_BODY_TOLERANCE, FlangeAdapter
from probedesign.mount.lip import MAX_BENDING_SHARE, pad_force
from probedesign.mount.sensor_adapter import (
    FACE_LOSS,
    MAX_SQUEEZE_SHARE,
    MIN_SQUEEZE,
    PEG_D,
    PIN_TOLERANCE,
    PRINTED_PIN_PLAY,
    RING_CLEARANCE,
    SENSOR_HOLE_DISTANCE,
    SETTLING,
    SensorAdapter,
    length_tolerance,
)

SENSOR_HOLE_TOLERANCE = 0.1 * MM  #: Tolerance ± of the depth of the sensor's dowel holes (assumed).
#: Deviations by ISO 286-2: least of a pin h8 and greatest of a pin m6 of 3 to 6 mm; thinner ones deviate less.
PIN_H8, PIN_M6 = -0.018 * MM, 0.012 * MM
_H7_MM = ((3.0, 0.010), (6.0, 0.012), (10.0, 0.015), (18.0, 0.018), (30.0, 0.021), (50.0, 0.025), (80.0, 0.030),
          (120.0, 0.035), (180.0, 0.040), (250.0, 0.046), (315.0, 0.052))  # fmt: skip
#: Greatest rotation of a part in the play of its pins: four standard deviations of the clocking (assumed).
MAX_CLOCKING_DEG = 2.0
SOFT_INTERFERENCE = 0.01  #: Oversize of the flange in its recess, relative: it is pressed in by hand (assumed).
#: Oversize of the peg in the flange's hole, relative: the resin stretches by several times that (assumed).
PEG_STRETCH = 0.2
#: Offset of the clamp ring from the probe's axis after it was centred by eye: two fifths of the gap (assumed).
RING_OFFSET = 0.2 * MM
MIN_PIN_HEIGHT = 1.0 * MM  #: Least height of a centring pin beside the sensor (assumed).
#: Greatest play of the sensor between its centring pins and of the spigot, or this fraction of the diameter where it is
#: more: half of it moves the base aside (assumed).
MAX_CENTRING_PLAY = 1.0 * MM, 0.02
#: Least entry of a robot bolt at the worst corner, in diameters; at nominal size it is 0.8 (assumed).
MIN_BOLT_THREADS = 0.6
CALIPERS = 0.05 * MM  #: Uncertainty of a depth or thickness measured with calipers in a printed part (assumed).
PRINTED, SCREWED = "print, ±0.5 %, at least ±0.15 mm (assumed)", "ISO 4759-1, js15"


def h7(d: float) -> float:
    """Return the greatest deviation [m] of a hole H7 of diameter d [m]; its least is zero. Source: ISO 286-1, IT7."""
    return next(deviation for up_to, deviation in _H7_MM if d / MM <= up_to + 1e-6) * MM


@dataclass(frozen=True)
class StackItem:
    """One dimension of a stack."""

    name: str  #: of the dimension.
    value: float  #: nominal, with the sign with which it counts [m].
    below: float  #: below, above: tolerances of the signed value, both positive [m].
    above: float
    source: str  #: of the tolerance.


@dataclass(frozen=True)
class Stack:
    """A sum of dimensions with its limits [m]."""

    name: str  #: of the stack.
    what: str  #: in words.
    items: tuple[StackItem, ...]  #: the dimensions.
    limits: tuple[float, float]  #: least and greatest allowed sum.
    remedy: str  #: what to change where the worst case lies outside of them: keys of the design or the sensor.

    @property
    def nominal(self) -> float:
        """Return the sum of the nominal dimensions [m]."""
        return sum(item.value for item in self.items)

    @property
    def worst(self) -> tuple[float, float]:
        """Return the least and the greatest sum [m]."""
        nominal = self.nominal
        return (nominal - sum(item.below for item in self.items), nominal + sum(item.above for item in self.items))

    @property
    def rss(self) -> tuple[float, float]:
        """Return the range of the sum with independent tolerances [m], about the middle of the worst case."""
        middle = sum(self.worst) / 2
        half = math.sqrt(sum(((item.below + item.above) / 2) ** 2 for item in self.items))
        return middle - half, middle + half

    @property
    def outside(self) -> float:
        """Return how far the worst case lies outside of the limits [m]; 0 up to a nanometre, the round-off of sums."""
        (low, high), (least, greatest) = self.worst, self.limits
        outside = max(least - low, high - greatest)
        return outside if outside > 1e-9 else 0.0

    @property
    def ok(self) -> bool:
        """Return whether the worst case lies within the limits."""
        return self.outside == 0.0

    def as_record(self) -> dict[str, Any]:
        """Return the record of the manifest, in millimetres."""
        return {
            "name": self.name,
            "what": self.what,
            "nominal_mm": _mm(self.nominal),
            "worst_mm": [_mm(x) for x in self.worst],
            "rss_mm": [_mm(x) for x in self.rss],
            "limits_mm": [_mm(x) for x in self.limits],
            "ok": self.ok,
            "items": [
                {"name": item.name, "value_mm": _mm(item.value), "tolerance_mm": [_mm(-item.below), _mm(item.above)],
                 "source": item.source}
                for item in self.items
            ],
        }  # fmt: skip


def _printed(name: str, value: float) -> StackItem:
    """Return a printed length with the sign with which it counts [m]."""
    return _within(name, value, length_tolerance(abs(value)), PRINTED)


def _within(name: str, value: float, tolerance: float, source: str = "assumed") -> StackItem:
    return StackItem(name, value, tolerance, tolerance, source)


def _screw(dimensions: SocketScrew, length: float) -> StackItem:
    return _within("length of the screw", length, dimensions.length_tolerance(length), SCREWED)


def _turned(radius: float) -> float:
    """Return the play that lets a part turn by the greatest rotation, the pins at that radius [m]."""
    return 2.0 * math.tan(math.radians(MAX_CLOCKING_DEG)) * radius


def tolerance_stacks(a: SensorAdapter, plate: FlangeAdapter) -> list[Stack]:
    """Return the stacks of a mount. Those across the axis, which centre and clock the parts, are on the diameter."""
    flange, dowels, robot, nut = a.flange, a.dowels, plate.robot, a.options.nut
    tool, mounting = a.tool, plate.mounting
    recess, apart = a.body_top - a.floor, a.dowel_distance
    slot, distance = length_tolerance(a.dowel_slot) / 2, length_tolerance(apart)
    hole_d, hole_bottom = plate.centring_hole
    recess_d = robot.spigot[0] + robot.spigot_play
    lost = StackItem("face compressed on the platform or sanded", 0.0, 0.0, FACE_LOSS, "assumed")
    settling = StackItem("head that settles in the resin", 0.0, 0.0, SETTLING, "assumed")
    by_eye = _within("twice the offset of the ring's centre", 0.0, 2 * RING_OFFSET, "by eye, assumed")

    def h8(value: float) -> StackItem:
        return StackItem("diameter of the pin", value, 0.0, -PIN_H8, "h8")

    def pin(length: float) -> StackItem:
        return _within("length of the pin", length, PIN_TOLERANCE, "ISO 2338")

    lip = "mount.squeeze_mm or mount.flange_thickness_mm"
    rows: list[tuple[str, str, tuple[StackItem, ...], tuple[float, float], str]] = [
        ("lip_squeeze", "compression of the flange's lip with the ring on the wall",
         (_printed("thickness of the flange", flange.thickness), _printed("depth of the recess", -recess)),
         (MIN_SQUEEZE, MAX_SQUEEZE_SHARE * flange.thickness), lip),
        ("groove_room", "room below the flange in the groove around the land",
         (_printed("depth of the groove", a.groove), _printed("depth of the recess", recess),
          _printed("thickness of the flange", -flange.thickness)),
         (0.0, recess), lip),
        ("sensor_adapter_screws_entry", "entry of the screws into the sensor's tool side",
         (_screw(tool.screw, tool.length), _printed("thickness under the head", -tool.grip), lost, settling),
         (tool.min_entry, tool.max_entry), "interface.tool of the sensor: min_entry_mm, max_entry_mm or screw"),
        ("mounting_screws_entry", "entry of the screws into the sensor's mounting side",
         (_screw(mounting.screw, mounting.length), _printed("thickness under the head", -mounting.grip), lost,
          settling),
         (mounting.min_entry, mounting.max_entry),
         "interface.mounting of the sensor: min_entry_mm, max_entry_mm or screw"),
        ("ring_screws_entry", "entry of the ring's screws below the face on which the nuts bear",
         (_screw(a.ring_screw, a.ring_screw_length), _printed("thickness of the ring", -a.ring_thickness),
          _printed("thickness above the nut", -a.nut_roof), lost, settling),
         (nut.height, a.nut_slot_z[1] - a.ring_hole_bottom), "mount.ring_screw"),
        ("robot_bolts_entry", "entry of the bolts into the robot's flange",
         (_screw(robot.screw, robot.bolt_length), _printed("thickness of the plate", -plate.plate_top), lost, settling),
         (MIN_BOLT_THREADS * robot.screw.nominal_d, robot.max_bolt_entry),
         "mount.flange.bolt_length_mm or mount.flange.max_bolt_entry_mm"),
        ("peg_below_ring", "room between the clocking peg and the ring",
         (_printed("depth of the recess", recess), _printed("height of the peg", a.floor - a.peg_top)),
         (0.0, recess), lip),
        ("flange_in_recess", "play of the probe's flange in its recess",
         (_printed("diameter of the recess", a.recess_d), _printed("diameter of the flange", -flange.diameter)),
         (-SOFT_INTERFERENCE * flange.diameter, 2 * RING_CLEARANCE), "mount.flange_lip_mm or probe.base_d_mm"),
        ("ring_gap", "gap between the ring, centred by eye, and the probe, on the diameter",
         (_printed("diameter of the ring's bore", a.ring_bore_d), _printed("diameter of the probe", -a.probe_d),
          by_eye),
         (0.0, flange.thickness), "mount.flange_thickness_mm or probe.base_d_mm"),
        ("peg_fit", "play of the clocking peg in the flange",
         (_printed("diameter of the hole", a.peg_hole_d), _printed("diameter of the peg", -PEG_D)),
         (-PEG_STRETCH * PEG_D, _turned(a.peg_x)), "mount.flange_lip_mm or probe.base_d_mm"),
    ]  # fmt: skip
    if a.p_dowels:
        rows += [
            ("dowel_pin_room", "room beyond the ends of a dowel pin",
             (_within("depth of the sensor's hole", dowels.depth, SENSOR_HOLE_TOLERANCE),
              _printed("depth of the adapter's hole", a.dowel_depth), pin(-dowels.pin_length),
              replace(lost, below=FACE_LOSS, above=0.0)),
             (0.0, a.dowel_depth), "interface.dowels of the sensor: depth_mm or pin_length_mm"),
            ("dowel_fit", "play of a dowel pin in the sensor adapter",
             (StackItem("diameter of the hole, drilled where it is tight", a.dowel_d, PRINTED_PIN_PLAY,
                        length_tolerance(a.dowel_d), PRINTED), h8(-dowels.diameter)),
             (0.0, _turned((apart or dowels.circle_d) / 2)), "interface.dowels of the sensor: circle_d_mm"),
        ]  # fmt: skip
    if len(a.p_dowels) > 1:
        rows.append(
            ("dowel_slot", "room of the second dowel pin at the ends of its slot",
             (_within("half the slot beyond its width", a.dowel_slot / 2, slot, PRINTED),
              StackItem("distance of the holes in the adapter", 0.0, distance, 0.0, PRINTED),
              StackItem("distance of the sensor's holes", 0.0, SENSOR_HOLE_DISTANCE, 0.0, "assumed")),
             (0.0, a.dowel_slot), "interface.dowels of the sensor: circle_d_mm")
        )  # fmt: skip
    if plate.p_centring_pins:
        rows += [
            ("centring_fit", "play of the sensor's body between its pins",
             (_printed("circle that the pins enclose", 2.0 * math.hypot(*plate.p_centring_pins[0]) - CENTRING_PIN_D),
              replace(h8(0.0), name="diameter of the pins"),
              _within("play of the pins in their holes", 0.0, hole_d - CENTRING_PIN_D),
              _within("diameter of the body", -plate.body_d, SENSOR_BODY_TOLERANCE)),
             (0.0, max(MAX_CENTRING_PLAY[0], MAX_CENTRING_PLAY[1] * plate.body_d)),
             "interface.body_d_mm of the sensor"),
            ("centring_pin_height", "height of the centring pins beside the sensor",
             (pin(CENTRING_PIN_LENGTH), _printed("depth of the hole", hole_bottom - plate.plate_top), lost),
             (MIN_PIN_HEIGHT, plate.free_height), "interface.cable of the sensor: free_height_mm"),
        ]  # fmt: skip
    if robot.pin_d > 0.0:
        rows.append((
            "robot_pin_fit", "play of the robot's dowel pin in its slot",
            (_printed("width of the slot", robot.pin_slot[0]),
             StackItem("diameter of the pin", -robot.pin_d, PIN_M6, 0.0, "m6")),
            (0.0, _turned(robot.bolt_circle_d / 2)), "mount.flange.pin_slot_mm, or mount.robot_flange",
        ))  # fmt: skip
    if robot.spigot[0] > 0.0:
        rows.append((
            "spigot_fit", "play of the spigot in the robot's recess",
            (StackItem("diameter of the robot's recess", recess_d, 0.0, h7(recess_d), "H7"),
             _printed("diameter of the spigot", -robot.spigot[0])),
            (0.0, max(MAX_CENTRING_PLAY[0], MAX_CENTRING_PLAY[1] * robot.spigot[0])),
            "mount.flange.spigot_mm or mount.flange.recess_d_mm",
        ))  # fmt: skip
    return [Stack(name, what, items, limits, f"change {keys}") for name, what, items, limits, keys in rows]


@dataclass(frozen=True)
class Measurement:
    """A dimension to measure before assembly, with its accepted range [m]."""

    what: str  #: the dimension.
    nominal: float  #: as drawn.
    accept: tuple[float, float]  #: least and greatest accepted value.
    otherwise: str  #: what to do with a part outside of it.

    def as_record(self) -> dict[str, Any]:
        """Return the record of the manifest, in millimetres."""
        accept = [_mm(x) for x in self.accept]
        return {"what": self.what, "nominal_mm": _mm(self.nominal), "accept_mm": accept, "otherwise": self.otherwise}


def measurements(a: SensorAdapter, plate: FlangeAdapter) -> list[Measurement]:
    """Return what to measure before the first screw; a screw that enters too deep destroys the sensor."""
    rows: list[tuple[str, float, float, float, str]] = []
    for part, pattern in (("sensor adapter", a.tool), ("flange adapter", plate.mounting)):
        length, screw, grip = pattern.length, pattern.screw, pattern.grip
        shortest, longest = (length + side * screw.length_tolerance(length) for side in (-1.0, 1.0))
        least, most = pattern.min_entry, pattern.max_entry - CALIPERS - SETTLING
        pressed = "in its hole, head pressed on its seat: its point beyond the sensor's face"
        rows += [
            (f"{part}: each {screw.thread}×{length / MM:g} {pressed}", length - grip, least, most,
             "more: do not use it, the sensor would be destroyed; less: the screw does not hold"),
            (f"{part}: thickness under each head of those screws", grip, longest - most, shortest - least,
             "thinner: print it again; thicker: print it again, never take a longer screw"),
        ]  # fmt: skip
    recess, groove, flange = a.body_top - a.floor, a.groove, a.flange.thickness
    rigid, soft, decided = length_tolerance(recess), length_tolerance(flange), "flange minus recess decides"
    rows += [
        ("sensor adapter: depth of the recess, to its land", recess, recess - rigid, recess + rigid, decided),
        ("sensor adapter: depth of the groove around the land, after its resin was cleared",
         groove, groove - rigid + CALIPERS, groove + rigid,
         "less: clear groove and notch of resin, or print it again; more: print it again"),
        ("probe: thickness of the flange's rim", flange, flange - soft, flange + soft, decided),
        ("flange minus recess: compression of the lip",
         a.squeeze, MIN_SQUEEZE + 2 * CALIPERS, MAX_SQUEEZE_SHARE * flange - 2 * CALIPERS,
         "less: the ring does not clamp, print the adapter again; more: the lip is overloaded"),
    ]  # fmt: skip
    return [Measurement(what, nominal, (low, high), otherwise) for what, nominal, low, high, otherwise in rows]


# the clamp: force of the lip against the preload of the screws, and the bending of the ring; see `lip`

#: Torque over preload and diameter, dry steel. Source: Shigley, Mechanical Engineering Design, table 8-15.
NUT_FACTOR = 0.2
#: Permanent pressure under a screw's head: a third of a rigid resin's strength of about 60 MPa (assumed; it creeps).
RESIN_PRESSURE = 20.0 * MPA
#: Finite elements over the formula for bases of 5 to 25 mm and the default lip (`benchmarks/clamp.py`, commit 04ffc97):
#: with faces that slip and a flange that does not touch the recess's wall, and with faces that stick and a flange that
#: moves out to the wall. Up to 2.2 if it has no play there from the beginning.
MODEL_RANGE = 0.7, 1.8
#: Three standard deviations of E, relative: published fits for Elastic 50A lie between 2.3 and 3.15 MPa (assumed for
#: other resins).
MODULUS_TOLERANCE = 0.3


def hand_torque(screw: SocketScrew, below_nut: float = math.inf) -> float:
    """Return the torque [N·m] that presses a head or a nut on its seat with `RESIN_PRESSURE`, one digit.

    Args:
        screw: the screw.
        below_nut: area on which a nut bears [m²]; infinite for a thread in metal.
    """
    below_head = math.pi / 4 * (screw.head_d**2 - screw.clearance_d**2)
    torque = NUT_FACTOR * RESIN_PRESSURE * min(below_head, below_nut) * screw.nominal_d
    digit = 10.0 ** math.floor(math.log10(torque))
    return float(f"{math.floor(torque / digit) * digit:.1g}")


def ring_torque(a: SensorAdapter) -> float:
    """Return the torque [N·m] of the ring's screws, which the resin below heads and nuts allows."""
    below_nut = math.sqrt(0.75) * a.options.nut.af**2 - math.pi / 4 * a.roof_hole_d**2
    return hand_torque(a.ring_screw, below_nut)


@dataclass(frozen=True)
class ClampForce:
    """Force of the lip against the preload of the ring's screws [N]."""

    nominal: float  #: force of the lip at the nominal compression.
    range: tuple[float, float]  #: its range with the tolerances of compression, E and formula, taken as independent.
    preload: float  #: of all screws of the ring together, at the torque of the bill of materials.
    torque: float  #: of one screw [N·m].
    screws: int  #: their number.
    #: of the ring's inner edge at the nominal force, with the rim clamped and simply supported [m].
    bending: tuple[float, float]
    squeeze: float  #: nominal compression of the lip between rigid parts [m].
    pressed_share: float  #: of the land, see `SensorAdapter.pressed_share`.

    @property
    def bending_share(self) -> float:
        """Return the ring's bending, the mean of both supports, over the compression of the lip."""
        return sum(self.bending) / 2.0 / self.squeeze

    def as_record(self) -> dict[str, Any]:
        """Return the record of the manifest."""
        return {
            "lip_force_N": round(self.nominal, 1),
            "pressed_share": round(self.pressed_share, 3),
            "lip_force_range_N": [round(force, 1) for force in self.range],
            "preload_N": round(self.preload, 1),
            "torque_Nm": self.torque,
            "screws": self.screws,
            "ring_bending_mm": [round(bending / MM, 3) for bending in self.bending],
            "closes": self.range[1] <= self.preload and self.bending_share <= MAX_BENDING_SHARE * (1.0 + 1e-9),
            "source": "computed, not measured: Gent and Lindley 1959 and finite elements for the lip; Roark's formulas "
            f"for the ring; preload from the torque with a nut factor of {NUT_FACTOR:g} (Shigley)",
        }


def clamp_force(a: SensorAdapter, plate: FlangeAdapter, modulus: float) -> ClampForce:
    """Return the force that closes the clamp.

    The range takes the compression at the root sum of squares of its tolerances. With more force than the preload the
    ring does not reach the wall: the lip is compressed less, and not evenly.

    Args:
        a, plate: of the mount.
        modulus: E of the probe's resin [Pa].
    """
    squeeze = next(stack for stack in tolerance_stacks(a, plate) if stack.name == "lip_squeeze")

    def force(compression: float) -> float:
        return a.pressed_share * pad_force(modulus, a.ring_bore_d, a.land_d, a.flange.thickness, compression)

    nominal = force(squeeze.nominal)
    least, greatest = (math.hypot(force(end) / nominal - 1.0, MODULUS_TOLERANCE) for end in squeeze.rss)
    low, high = MODEL_RANGE
    torque, screws = ring_torque(a), len(a.p_ring_screws)
    return ClampForce(
        nominal=nominal,
        range=(low * nominal * max(1.0 - least, 0.0), high * nominal * (1.0 + greatest)),
        preload=screws * torque / (NUT_FACTOR * a.ring_screw.nominal_d),
        torque=torque,
        screws=screws,
        bending=a.ring_bending(nominal),
        squeeze=squeeze.nominal,
        pressed_share=a.pressed_share,
    )


def _mm(value: float) -> float:
    return round(value / MM, 4) + 0.0
