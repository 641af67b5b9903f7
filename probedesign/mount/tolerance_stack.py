"""Tolerance stacks of the mount: compression of the flange, entry of each screw, room beyond each pin.

Each is a sum of dimensions with their tolerances. The worst case adds all tolerances; the root sum of squares (RSS)
takes them as independent, each tolerance as three standard deviations, so that 0.27 % of all mounts lie
outside. Every stack must lie within its limits in the worst case.
"""

import math
from dataclasses import dataclass
from typing import Any

from probedesign.core.units import MM
from probedesign.design.catalog import SocketScrew
from probedesign.design.sensors import ScrewPattern
from probedesign.mount.flange_adapter import FlangeAdapter
from probedesign.mount.sensor_adapter import (
    MAX_SQUEEZE_SHARE,
    MIN_SQUEEZE,
    PIN_TOLERANCE,
    SensorAdapter,
    length_tolerance,
)

SANDING = 0.2 * MM
"""Material that sanding the foot, or a head that settles in the resin, may remove below a head (assumed)."""
SENSOR_HOLE_TOLERANCE = 0.1 * MM
"""Tolerance ± of the depth of the sensor's dowel holes (assumed)."""
MIN_BOLT_THREADS = 0.6
"""Least entry of a robot bolt at the worst corner, in diameters; at nominal size it is 0.8 (assumed)."""
CALIPERS = 0.05 * MM
"""Uncertainty of a depth measured with calipers in a printed part (assumed)."""
PRINTED, SCREWED = "print, ±0.5 %, at least ±0.15 mm (assumed)", "ISO 4759-1, js15"
MILLED = "drawing, ±0.05 mm; ISO 2768-1, fine, up to 6 mm (assumed beyond)"


@dataclass(frozen=True)
class StackItem:
    """One dimension of a stack.

    Attributes:
        name: of the dimension.
        value: nominal, with the sign with which it counts [m].
        below, above: tolerances of the signed value, both positive [m].
        source: of the tolerance.
    """

    name: str
    value: float
    below: float
    above: float
    source: str


@dataclass(frozen=True)
class Stack:
    """A sum of dimensions with its limits [m].

    Attributes:
        name: of the stack.
        what: in words.
        items: the dimensions.
        limits: least and greatest allowed sum.
    """

    name: str
    what: str
    items: tuple[StackItem, ...]
    limits: tuple[float, float]

    @property
    def nominal(self) -> float:
        """Return the sum of the nominal dimensions [m]."""
        return sum(item.value for item in self.items)

    @property
    def worst(self) -> tuple[float, float]:
        """Return the least and the greatest sum [m]."""
        nominal = self.nominal
        return (
            nominal - sum(item.below for item in self.items),
            nominal + sum(item.above for item in self.items),
        )

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
                {
                    "name": item.name,
                    "value_mm": _mm(item.value),
                    "tolerance_mm": [_mm(-item.below), _mm(item.above)],
                    "source": item.source,
                }
                for item in self.items
            ],
        }


def tolerance_stacks(a: SensorAdapter, plate: FlangeAdapter) -> list[Stack]:
    """Return the stacks of a mount."""

    def rigid(name: str, value: float) -> StackItem:
        tolerance = length_tolerance(abs(value), a.options.milled)
        return StackItem(name, value, tolerance, tolerance, MILLED if a.options.milled else PRINTED)

    def soft(name: str, value: float) -> StackItem:
        tolerance = length_tolerance(abs(value))
        return StackItem(name, value, tolerance, tolerance, PRINTED)

    def screw(dimensions: SocketScrew, length: float) -> StackItem:
        tolerance = dimensions.length_tolerance(length)
        return StackItem("length of the screw", length, tolerance, tolerance, SCREWED)

    def into_sensor(name: str, side: str, pattern: ScrewPattern) -> Stack:
        return Stack(
            name,
            f"entry of the screws into the sensor's {side} side",
            (
                screw(pattern.screw, pattern.length),
                rigid("thickness under the head", -pattern.grip),
                StackItem("foot sanded or head settled", 0.0, 0.0, SANDING, "assumed"),
            ),
            (pattern.min_entry, pattern.max_entry),
        )

    flange, dowels, robot, nut = a.flange, a.dowels, plate.robot, a.options.nut
    recess = a.body_top - a.floor
    hole = SENSOR_HOLE_TOLERANCE
    return [
        Stack(
            "lip_squeeze",
            "compression of the flange's lip with the ring on the wall",
            (soft("thickness of the flange", flange.thickness), rigid("depth of the recess", -recess)),
            (MIN_SQUEEZE, MAX_SQUEEZE_SHARE * flange.thickness),
        ),
        into_sensor("sensor_adapter_screws_entry", "tool", a.tool),
        into_sensor("mounting_screws_entry", "mounting", plate.mounting),
        Stack(
            "ring_screws_entry",
            "entry of the ring's screws below the face on which the nuts bear",
            (
                screw(a.ring_screw, a.ring_screw_length),
                rigid("thickness of the ring", -a.ring_thickness),
                rigid("thickness above the nut", -a.nut_roof),
            ),
            (nut.height, a.nut_slot_z[1] - a.ring_hole_bottom),
        ),
        Stack(
            "robot_bolts_entry",
            "entry of the bolts into the robot's flange",
            (screw(robot.screw, robot.bolt_length), rigid("thickness of the plate", -plate.plate_top)),
            (MIN_BOLT_THREADS * robot.screw.nominal_d, robot.max_bolt_entry),
        ),
        Stack(
            "peg_below_ring",
            "room between the clocking peg and the ring",
            (rigid("depth of the recess", recess), rigid("height of the peg", a.floor - a.peg_top)),
            (0.0, recess),
        ),
        Stack(
            "dowel_pin_room",
            "room beyond the ends of a dowel pin",
            (
                StackItem("depth of the sensor's hole", dowels.depth, hole, hole, "assumed"),
                rigid("depth of the adapter's hole", a.dowel_depth),
                StackItem("length of the pin", -dowels.pin_length, PIN_TOLERANCE, PIN_TOLERANCE, "ISO 2338"),
            ),
            (0.0, a.dowel_depth),
        ),
    ]


@dataclass(frozen=True)
class Measurement:
    """A dimension to measure before assembly, with its accepted range [m].

    Attributes:
        what: the dimension.
        nominal: as drawn.
        accept: least and greatest accepted value.
        otherwise: what to do with a part outside of it.
    """

    what: str
    nominal: float
    accept: tuple[float, float]
    otherwise: str

    def as_record(self) -> dict[str, Any]:
        """Return the record of the manifest, in millimetres."""
        return {
            "what": self.what,
            "nominal_mm": _mm(self.nominal),
            "accept_mm": [_mm(x) for x in self.accept],
            "otherwise": self.otherwise,
        }


def measurements(a: SensorAdapter, plate: FlangeAdapter) -> list[Measurement]:
    """Return what to measure before the first screw; a screw that enters too deep destroys the sensor."""
    rows = []
    for part, pattern in (("sensor adapter", a.tool), ("flange adapter", plate.mounting)):
        length, screw = pattern.length, pattern.screw
        tolerance = screw.length_tolerance(length)
        rows += [
            Measurement(
                f"{part}: each {screw.thread}×{length / MM:g} in its hole, head pressed on its seat: its point beyond "
                "the sensor's face",
                length - pattern.grip,
                (pattern.min_entry, pattern.max_entry - CALIPERS),
                "more: do not use it, the sensor would be destroyed; less: the screw does not hold",
            ),
            Measurement(
                f"{part}: thickness under each head of those screws",
                pattern.grip,
                (length + tolerance - pattern.max_entry + CALIPERS, length - tolerance - pattern.min_entry),
                "thinner: print it again; thicker: print it again, never take a longer screw",
            ),
        ]
    recess, flange = a.body_top - a.floor, a.flange.thickness
    rigid, soft = length_tolerance(recess, a.options.milled), length_tolerance(flange)
    return [
        *rows,
        Measurement(
            "sensor adapter: depth of the recess",
            recess,
            (recess - rigid, recess + rigid),
            "decided by the difference below",
        ),
        Measurement(
            "probe: thickness of the flange's rim",
            flange,
            (flange - soft, flange + soft),
            "decided by the difference below",
        ),
        Measurement(
            "flange minus recess: compression of the lip",
            a.squeeze,
            (MIN_SQUEEZE, MAX_SQUEEZE_SHARE * flange),
            "less: the ring does not clamp, print the adapter again; more: the lip is overloaded",
        ),
    ]


def _mm(value: float) -> float:
    return round(value / MM, 4) + 0.0
