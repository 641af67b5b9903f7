"""CAD model of a design: every part as a solid placed in the sensor frame."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import combinations

import cadquery as cq
import numpy as np

from probedesign.cad.kernel import PRODUCT, location, mass_properties, meshed, placed
from probedesign.cad.solids import (
    ScrewGroup,
    clamp_ring_solid,
    fasteners,
    flange_adapter_solid,
    probe_solid,
    screw_groups,
    sensor_adapter_solid,
    sensor_envelope,
)
from probedesign.core.errors import CheckFailedError
from probedesign.core.frames import Array, inverse, pose
from probedesign.core.units import MM
from probedesign.design import Design
from probedesign.design.catalog import RIGID_DENSITY, STEEL_DENSITY
from probedesign.design.sensors import SensorInterface
from probedesign.geometry import ProbeGeometry
from probedesign.geometry.mass import MassProperties, combined
from probedesign.mount import FlangeAdapter, Mount, SensorAdapter
from probedesign.mount.mass import cylinder
from probedesign.mount.tolerance_stack import tolerance_stacks

IN_SENSOR_FRAME = pose()
COARSE_MM, COARSE_RAD = 0.02, 0.3  #: Tolerances of the facets of pictures: 0.02 mm is a fifth of a pixel.


@dataclass(frozen=True)
class CadPart:
    """One part, or one group of equal screws."""

    name: str  #: as in the files.
    shape: cq.Shape  #: in millimetres in the part's own frame; of a group, one piece.
    T_sensor_part: Array  #: pose of that frame in the sensor frame, (4, 4).
    frame: str  #: name of that frame.
    density: float  #: [kg/m³]; zero for the sensor, whose mass is not part of the mount.
    color: tuple[float, float, float]  #: (red, green, blue) 0 ... 1.
    printed: bool = True  #: whether it has a mesh of its own.
    standard: str = ""  #: of a purchased piece, such as ISO 4762 M2x6; groups of one standard share their shape.
    places: tuple[Array, ...] = (IN_SENSOR_FRAME,)  #: pose of each piece in the part's frame, (4, 4).
    ruled: cq.Shape | None = None  #: of a curved probe, the solid that has the facets, see `kernel.on_foot`.

    @property
    def Ts_sensor_piece(self) -> dict[str, Array]:
        """Return the pose of each piece in the sensor frame by its name: of a group numbered from 1."""
        poses = [self.T_sensor_part @ T for T in self.places]
        if len(poses) == 1:
            return {self.name: poses[0]}
        return {f"{self.name}_{number}": T for number, T in enumerate(poses, 1)}

    @cached_property
    def placed(self) -> cq.Shape:
        """Return the shape in the sensor frame: of a group, a compound of its pieces; of a curved probe the ruled
        solid, because the kernel takes long to intersect splines."""
        pieces = [placed(self.ruled or self.shape, T) for T in self.Ts_sensor_piece.values()]
        return pieces[0] if len(pieces) == 1 else cq.Compound.makeCompound(pieces)

    @cached_property
    def body(self) -> MassProperties:
        """Return the mass properties of the shape in its own frame."""
        return mass_properties(self.shape, self.density)

    @cached_property
    def displayed(self) -> cq.Shape:
        """Return a copy of the shape with the facets of pictures."""
        return meshed(self.ruled or self.shape, COARSE_MM, COARSE_RAD)

    @cached_property
    def box(self) -> Array:
        """Return the corners of the bounding box in the sensor frame [mm], (2, 3)."""
        return box_of(self.placed)  # costs as much as a small Boolean cut


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
    rigid = RIGID_DENSITY
    ruled = None if geometry.axis.is_straight else probe_solid(geometry, adapter, ruled=True)
    printed = [
        CadPart("probe", probe_solid(geometry, adapter), T, "base", probe_density, (0.93, 0.85, 0.6), ruled=ruled),
        CadPart("sensor_adapter", sensor_adapter_solid(adapter), IN_SENSOR_FRAME, "sensor", rigid, grey),
        CadPart("clamp_ring", clamp_ring_solid(adapter), T, "clamp_ring", rigid, (0.35, 0.5, 0.7)),
        CadPart("flange_adapter", flange_adapter_solid(plate), plate.T_sensor_robotflange, "robotflange", rigid, grey),
    ]
    loose = [
        CadPart(name, solid, IN_SENSOR_FRAME, "sensor", STEEL_DENSITY, steel, printed=False, standard=standard,
                places=poses)
        for name, standard, solid, poses in fasteners(adapter, plate, screws)
    ]  # fmt: skip
    envelope = CadPart("sensor", sensor_envelope(sensor), IN_SENSOR_FRAME, "sensor", 0.0, (0.6, 0.6, 0.65), False)
    return {part.name: part for part in [*printed, *loose, envelope]}


def overlaps(parts: dict[str, CadPart]) -> dict[str, float]:
    """Return the volume shared by each pair of parts whose bounding boxes meet [m³]; contact is zero."""
    pairs = [(a, b) for a, b in combinations(parts, 2) if boxes_meet(parts[a].box, parts[b].box)]
    return {f"{a} & {b}": shared_volume(parts[a].placed, parts[b].placed) for a, b in pairs}


def volume_inside(space: cq.Shape, parts: Iterable[CadPart]) -> float:
    """Return the volume of parts inside a space of the sensor frame [m³]."""
    box = box_of(space)
    return sum(shared_volume(space, part.placed) for part in parts if boxes_meet(box, part.box))


def shared_volume(a: cq.Shape, b: cq.Shape) -> float:
    """Return the volume common to two shapes [m³]."""
    return float(sum(solid.Volume() for solid in a.intersect(b).Solids())) * MM**3


def box_of(shape: cq.Shape) -> Array:
    """Return the corners of a shape's bounding box [mm], (2, 3)."""
    b = shape.BoundingBox()
    return np.array([[b.xmin, b.ymin, b.zmin], [b.xmax, b.ymax, b.zmax]])


def boxes_meet(a: Array, b: Array) -> bool:
    """Return whether two boxes share a point."""
    return bool((a[0] <= b[1]).all() and (b[0] <= a[1]).all())


def assembly_of(parts: dict[str, CadPart], name: str, displayed: bool = False) -> cq.Assembly:
    """Return the parts, named, coloured and placed; equal screws are instances of one shape.

    The shapes have the facets of pictures where `displayed`.
    """
    assembly, shapes = cq.Assembly(name=name), dict[str, cq.Shape]()
    for part in parts.values():
        product, colour = part.standard or part.name, cq.Color(*part.color)
        shape = shapes.setdefault(product, part.displayed if displayed else part.shape)
        for piece, T in part.Ts_sensor_piece.items():
            assembly.add(shape, name=piece, color=colour, loc=location(T), metadata={PRODUCT: product})
    return assembly


#: Purchased parts on the sensor's tool side.
FASTENERS = ("sensor_adapter_screws", "ring_screws", "ring_nuts", "dowel_pins")


@dataclass(frozen=True)
class CadModel:
    """A design with all its solids."""

    design: Design  #: the design file's content.
    geometry: ProbeGeometry  #: of the probe; the mechanics use the same one.
    adapter: SensorAdapter  #: dimensions on the sensor's tool side.
    plate: FlangeAdapter  #: dimensions on the sensor's mounting side.
    screws: list[ScrewGroup]  #: every group of screws, entries checked.
    parts: dict[str, CadPart]  #: the solids by name.
    fingerprints: dict[str, str]  #: of each printed part and of the payload, see `Mount.fingerprints`.

    @property
    def printed(self) -> list[CadPart]:
        """Return the parts that are meshed and printed."""
        return [part for part in self.parts.values() if part.printed]

    @cached_property
    def bodies(self) -> dict[str, MassProperties]:
        """Return the mass properties of everything beyond the tool face, from the solids, in the sensor frame."""
        probe, T = self.parts["probe"], self.adapter.T_sensor_base
        wide = 2.0 * self.geometry.flange.diameter / MM  # the plane s = 0
        flange, flexible = sorted(
            probe.shape.split(cq.Face.makePlane(wide, wide)).Solids(), key=lambda solid: solid.BoundingBox().zmin
        )
        return {
            "flexible": mass_properties(placed(flexible, T), probe.density),
            "flange": mass_properties(placed(flange, T), probe.density),
            "sensor_adapter": self._mass_of("sensor_adapter"),
            "clamp_ring": self._mass_of("clamp_ring"),
            "fasteners": combined(self._mass_of(name) for name in FASTENERS if name in self.parts),
        }

    @cached_property
    def carried(self) -> MassProperties:
        """Return the mass properties of all that the robot carries, the sensor as a homogeneous cylinder about its
        centre of mass, without its cable; in the robot flange's frame."""
        of_tool_side = {"probe", "sensor", "sensor_adapter", "clamp_ring", *FASTENERS}
        sensor = self.design.sensor_model.interface
        d, h = sensor.body_d, sensor.height
        body = replace(cylinder(d, -h, 0.0, sensor.mass / (np.pi / 4.0 * d * d * h)), p_com=np.array(sensor.p_com))
        plate = [self._mass_of(name) for name in self.parts if name not in of_tool_side]
        return combined([*self.bodies.values(), body, *plate]).moved(inverse(self.plate.T_sensor_robotflange))

    @property
    def T_robotflange_base(self) -> Array:
        """Return the pose of the base in the robot flange's frame, (4, 4): along its z, turned about it."""
        return inverse(self.plate.T_sensor_robotflange) @ self.adapter.T_sensor_base

    @property
    def base_turn(self) -> float:
        """Return the angle of that turn [rad]."""
        return float(np.arctan2(self.T_robotflange_base[1, 0], self.T_robotflange_base[0, 0]))

    def _mass_of(self, name: str) -> MassProperties:
        part = self.parts[name]
        return mass_properties(part.placed, part.density)

    @cached_property
    def shared_volumes(self) -> dict[str, float]:
        """Return the volume shared by each pair of parts that come near each other [m³]; contact is zero."""
        return overlaps(self.parts)


def printed_solid(design: Design, part: str, ruled: bool = False) -> cq.Solid:
    """Return one printed part in its own frame, in millimetres, without building the others.

    Args:
        design: of the part.
        part: its name.
        ruled: whether a curved probe is drawn for its facets, see `kernel.on_foot`.

    Raises:
        InputError: the mount cannot clamp this probe.
        CheckFailedError: a screw would enter too deep at the worst corner of the tolerances, or the part is not one
            valid solid.
    """
    mount = Mount.of(design)
    adapter, plate = mount.sensor_adapter, mount.flange_adapter
    screw_groups(adapter, plate)
    for stack in tolerance_stacks(adapter, plate):
        if not stack.ok:
            raise CheckFailedError(
                f"{design.name}: the {stack.what} is {stack.outside / MM:.2g} mm beyond its limits at the worst corner "
                f"of the tolerances; {stack.remedy}"
            )
    draw: dict[str, Callable[[], cq.Solid]] = {
        "probe": lambda: probe_solid(mount.geometry, adapter, ruled),
        "sensor_adapter": lambda: sensor_adapter_solid(adapter),
        "clamp_ring": lambda: clamp_ring_solid(adapter),
        "flange_adapter": lambda: flange_adapter_solid(plate),
    }
    return draw[part]()


@lru_cache(maxsize=2)  # a script draws, mounts and exports the parts of one design
def build_cad(design: Design) -> CadModel:
    """Build the CAD model of a design.

    Raises:
        InputError: the mount cannot clamp this probe.
        CheckFailedError: a screw would enter too deep, or a part is not one valid solid.
    """
    mount, sensor = Mount.of(design), design.sensor_model
    geometry, adapter, plate = mount.geometry, mount.sensor_adapter, mount.flange_adapter
    screws = screw_groups(adapter, plate)
    parts = build_parts(geometry, design.density.value, sensor.interface, adapter, plate, screws)
    return CadModel(design, geometry, adapter, plate, screws, parts, mount.fingerprints)
