"""One design drawn: the dimensions of its mount, its screws, all its parts, and what they weigh."""

from dataclasses import dataclass
from functools import cached_property

from probedesign.cad.assembly import Part, build_parts, overlaps
from probedesign.cad.kernel import cylinder, mass_of, placed
from probedesign.cad.screws import ScrewUse, screws_of
from probedesign.design import Design
from probedesign.geometry import ProbeGeometry, build_geometry
from probedesign.mass import MassProperties, combined
from probedesign.mount import FlangeAdapter, SensorAdapter, flange_adapter_for, sensor_adapter_for

FASTENERS = ("sensor_adapter_screws", "ring_screws", "ring_nuts", "dowel_pins")
"""What of the bought parts hangs on the sensor's tool side."""


@dataclass(frozen=True)
class Drawing:
    """A design with everything that was drawn for it.

    Attributes:
        design: what was asked for.
        geometry: of the probe; the mechanics read the same one.
        adapter: dimensions on the sensor's tool side.
        plate: dimensions on the sensor's mounting side.
        screws: every screw, entries checked.
        parts: the solids by name.
    """

    design: Design
    geometry: ProbeGeometry
    adapter: SensorAdapter
    plate: FlangeAdapter
    screws: list[ScrewUse]
    parts: dict[str, Part]

    @property
    def printed(self) -> list[Part]:
        """The parts that get a mesh."""
        return [part for part in self.parts.values() if part.printed]

    @cached_property
    def bodies(self) -> dict[str, MassProperties]:
        """Mass properties, from the solids, of everything beyond the tool face, in the sensor frame."""
        probe, T = self.parts["probe"], self.adapter.T_sensor_base
        above = cylinder(1.0, 0.0, 2 * self.geometry.length)  # 1 m wide: all the room that a probe may fill
        flexible, flange = probe.shape.intersect(above), probe.shape.cut(above)
        return {
            "flexible": mass_of(placed(flexible, T), probe.density),
            "flange": mass_of(placed(flange, T), probe.density),
            "sensor_adapter": self._weighed("sensor_adapter"),
            "clamp_ring": self._weighed("clamp_ring"),
            "fasteners": combined(self._weighed(name) for name in FASTENERS),
        }

    def _weighed(self, name: str) -> MassProperties:
        part = self.parts[name]
        return mass_of(part.placed, part.density)

    @cached_property
    def shared_volumes(self) -> dict[str, float]:
        """Volume shared by each two parts that come near each other [m³]; contact is zero."""
        return overlaps(self.parts)


def draw(design: Design) -> Drawing:
    """Draw a design.

    Raises:
        InputError: the mount cannot hold this probe.
        CheckFailedError: a screw would enter too deep, or a part is not one valid solid.
    """
    geometry, sensor = build_geometry(design), design.sensor_model
    adapter = sensor_adapter_for(geometry, sensor, design.name)
    plate = flange_adapter_for(sensor, design.robot_flange, geometry.fingerprint, design.name)
    screws = screws_of(adapter, plate, sensor)
    parts = build_parts(geometry, design.density.value, sensor, adapter, plate, screws)
    return Drawing(design, geometry, adapter, plate, screws, parts)
