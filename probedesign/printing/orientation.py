"""Printing orientation of each rigid part: upright or upside down on the platform, whichever needs fewer supports."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

from probedesign.core.units import MM
from probedesign.mount import FlangeAdapter, SensorAdapter
from probedesign.mount import sensor_adapter as rigid
from probedesign.mount.interior import clamp_ring_interior, flange_adapter_interior, sensor_adapter_interior
from probedesign.printing.layers import Interior, LayerReport, Mask, examine_layers

Side = Literal["upright", "upside down"]
MAX_OVERHANG = rigid.MAX_OVERHANG / MM
"""Longest horizontal overhang without supports [mm]."""
MAX_BRIDGE = 10.0
"""Longest bridge without supports [mm]: about half of the guide's 21 mm for a beam 5 mm wide and 3 mm thick."""
MAX_CUP_D = 10.0
"""Largest circle in a cup that the peel of a rigid resin stands [mm] (assumed)."""
PIXEL, LAYER = 0.2, 0.1
"""Raster of the check [mm]."""


@dataclass(frozen=True)
class OrientedPart:
    """A rigid part on the platform."""

    name: str  #: of the part.
    side: Side  #: which way it stands.
    rests_on: str  #: the face on the platform.
    report: LayerReport  #: of its layers.

    @property
    def z_direction(self) -> tuple[float, float, float]:
        """Return the direction of the part's z axis on the printer."""
        return (0.0, 0.0, 1.0 if self.side == "upright" else -1.0)

    @property
    def needs_supports(self) -> bool:
        """Return whether anything hangs that the platform or the layers below do not carry."""
        return self.report.hanging_area > 0.0 or self.report.islands > 0

    def as_record(self) -> dict[str, Any]:
        """Return the orientation for the manifest and for the print job."""
        return {
            "side": self.side,
            "z_direction": list(self.z_direction),
            "rests_on": self.rests_on,
            "supports": self.needs_supports,
        }

    @property
    def cost(self) -> tuple[float, int, float, float]:
        """Return the order of preference: supports on datum faces, islands, supports, cups."""
        report = self.report
        return (report.datum_area, report.islands, report.hanging_area, max(report.cup_d - MAX_CUP_D, 0.0))


@dataclass(frozen=True)
class _RigidPart:
    """A part in its own frame [m]: interior, rim, lowest and highest z, and its downward and upward datum faces."""

    name: str
    interior: Callable[..., Mask]
    reach: float
    z: tuple[float, float]
    down: tuple[float, ...]
    up: tuple[float, ...]
    faces: tuple[str, str]

    @property
    def best(self) -> OrientedPart:
        """Return the part in its better orientation."""
        upright = self.oriented("upright")
        if upright.cost[:3] == (0.0, 0, 0.0):  # needs no supports
            return upright
        return min((upright, self.oriented("upside down")), key=lambda one: one.cost)

    def oriented(self, side: Side) -> OrientedPart:
        """Return the part in an orientation."""
        low, high = self.z
        upright = side == "upright"

        def height(z: float) -> float:
            return (z - low if upright else high - z) / MM

        def inside(x, y, z):  # type: ignore[no-untyped-def]
            return self.interior(x * MM, (y if upright else -y) * MM, low + z * MM if upright else high - z * MM)

        interior: Interior = inside
        datums = tuple(height(z) for z in (self.down if upright else self.up))
        size = (self.reach / MM, (high - low) / MM)
        # A part wider than 60 mm is checked on a coarser raster, in the same time.
        pixel = PIXEL * max(1.0, size[0] / 32.0)
        report = examine_layers(interior, size, datums, MAX_OVERHANG, MAX_BRIDGE, pixel, LAYER)
        return OrientedPart(self.name, side, self.faces[0 if upright else 1], report)


def oriented_parts(a: SensorAdapter, plate: FlangeAdapter) -> list[OrientedPart]:
    """Return every rigid part in the orientation in which it is to be printed, directly on the platform."""
    spigot = plate.robot.spigot[1]
    parts = [
        _RigidPart(
            "sensor_adapter", lambda x, y, z: sensor_adapter_interior(a, x, y, z), a.body_d / 2, (0.0, a.body_top),
            (0.0,), (a.floor, a.body_top), ("its foot", "the wall around its recess"),
        ),
        _RigidPart(
            "clamp_ring", lambda x, y, z: clamp_ring_interior(a, x, y, z), a.body_d / 2, (0.0, a.ring_thickness),
            (0.0,), (), ("its underside", "its engraved top"),
        ),
        _RigidPart(
            "flange_adapter", lambda x, y, z: flange_adapter_interior(plate, x, y, z), plate.plate_d / 2,
            (-spigot, plate.plate_top), (0.0,), (plate.plate_top,),
            ("its spigot" if spigot > 0.0 else "its face to the robot", "the sensor's seat"),
        ),
    ]  # fmt: skip
    return [part.best for part in parts]
