"""Whether every screw, nut and pin gets to its place, and a key to every screw, past all that is mounted before."""

from dataclasses import dataclass

import cadquery as cq

from probedesign.cad.assembly import Part, box_of, boxes_meet, shared_volume
from probedesign.cad.kernel import cylinder, hexagon, placed, revolved
from probedesign.cad.screws import ScrewUse
from probedesign.frames import pose
from probedesign.mount import SensorAdapter
from probedesign.mount.fasteners import M2_NUT_AF
from probedesign.mount.sensor_adapter import DOWEL_PIN_LENGTH
from probedesign.sensor import SensorModel
from probedesign.units import MM

CORRIDOR = 60.0 * MM
"""How far below the adapter the ways of nuts and pins are looked at: it is on the bench, nothing else is there."""


@dataclass(frozen=True)
class Stage:
    """What stands where while one of the steps of `steps.py` is done.

    Attributes:
        comes: names of what is mounted by it.
        onto: names of what it is mounted on or beside: all that stands there already.
    """

    comes: tuple[str, ...]
    onto: tuple[str, ...]


_SENSOR = ("sensor", "flange_adapter", "mounting_screws")
_ROBOT = (*_SENSOR, "robot_bolts")
_BASE = ("sensor_adapter", "ring_nuts", "dowel_pins")
_MOUNT = (*_ROBOT, *_BASE, "sensor_adapter_screws")
STAGES = (
    Stage(("flange_adapter", "mounting_screws"), ("sensor", "flange_adapter")),
    Stage(("robot_bolts",), _SENSOR),
    Stage(("ring_nuts", "dowel_pins"), ("sensor_adapter",)),
    Stage(("sensor_adapter_screws",), (*_ROBOT, *_BASE)),
    Stage(("probe",), _MOUNT),
    Stage(("clamp_ring", "ring_screws"), (*_MOUNT, "probe", "clamp_ring")),
)


def obstructed(
    parts: dict[str, Part], screws: list[ScrewUse], adapter: SensorAdapter, sensor: SensorModel
) -> dict[str, float]:
    """What stands in the way of each group of screws, nuts and pins, and of the ring.

    Args:
        parts: of the assembly.
        screws: with their heads' seats and ways in.
        adapter, sensor: between which they go.

    Returns:
        By name, the volume [m³] of parts mounted before in the way in and in the way of the key; zero if it is free.
    """
    ways = {use.name: screw_ways(use) for use in screws} | _other_ways(parts, adapter, sensor)
    shapes = {name: part.placed for name, part in parts.items()}
    boxes = {name: box_of(shape) for name, shape in shapes.items()}
    found = {}
    for stage in STAGES:
        for name in (name for name in stage.comes if name in ways):
            way = cq.Compound.makeCompound(ways[name])
            box = box_of(way)
            there = [other for other in stage.onto if other != name and boxes_meet(box, boxes[other])]
            found[name] = sum(shared_volume(way, shapes[other]) for other in there)
    return found


def screw_ways(use: ScrewUse) -> list[cq.Solid]:
    """Of each screw: where its shank will be, and above it a way in as wide as the head and as long as the key."""
    out = -1.0 if use.up else 1.0  # from point to head
    seat, head, shank = use.seat, use.screw.head_d / 2, use.screw.pitch_d / 2
    point, free = seat - out * use.length, seat + out * (use.screw.head_height + use.screw.key_length)
    outline = [(0.0, point), (shank, point), (shank, seat), (head, seat), (head, free), (0.0, free)]
    way = revolved(outline)
    return [placed(way, pose(p=[*p, 0.0])) for p in use.points]


def _other_ways(parts: dict[str, Part], a: SensorAdapter, sensor: SensorModel) -> dict[str, list[cq.Solid]]:
    """Of nuts and pins, from below the adapter before it is on the sensor; of the ring, from above the tip."""
    tip = float(parts["probe"].placed.BoundingBox().zmax) * MM
    ring = cylinder(a.body_d, a.ring_top, tip).cut(cylinder(a.ring_bore_d, a.ring_top, tip))
    return {
        "ring_nuts": [hexagon(M2_NUT_AF, -CORRIDOR, a.nut_pocket_top, p) for p in a.p_ring_screws],
        "dowel_pins": [
            cylinder(sensor.dowel_d, -CORRIDOR, DOWEL_PIN_LENGTH - sensor.dowel_depth, p) for p in a.p_dowels
        ],
        "clamp_ring": [ring],
    }
