"""What the scenes of the home page, `live --view` and the studio share: light, floor, colours, and the rigid parts."""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from probedesign.core.frames import Array, inverse, is_pose
from probedesign.core.units import MM
from probedesign.estimation.model import ProbeModel
from probedesign.geometry.tube import tube_faces
from probedesign.reports.chart import ORDERED

if TYPE_CHECKING:
    import viser

UNIT = 20.0  #: Scene units per metre: viser's lights, camera and shadows suit objects of a few units.
MIN_HALF_AXIS = 0.9e-3  #: Minimum half-axis of the drawn ellipsoid [m], so that it is visible.
ARROW = 0.03  #: Length of the force arrow [m]; its label states the force.
PROBE, CONTACT, SPREAD, STALE_COLOUR = (236, 148, 66), (150, 10, 30), (232, 72, 66), (150, 150, 150)
METAL = (132, 142, 154)
PART_COLOURS = {"sensor": (60, 64, 72), "flange": PROBE, "clamp_ring": (112, 122, 136),
                "flange_adapter": (150, 158, 168)}  # fmt: skip
BEST_MM, WORST_MM = 1.0, 30.0  #: Errors at the ends of the colours.
SHADOW, SHADOW_OPACITY = (0.2, 0.3), 0.16  #: Way of a shadow along x and y per height above the floor.
SCALE_BAR = 0.05  #: Length of the bar on the floor [m].


def error_colours(errors_mm: Mapping[float, float | None], fractions: Array) -> NDArray[np.uint8]:
    """Return the colour of places of the probe by the error of a touch there, interpolated in its logarithm, (k, 3).

    Args:
        errors_mm: by fraction of the length; None where a touch is not located, which is grey.
        fractions: of the places, (k,).
    """
    palette = np.array([list(bytes.fromhex(colour[1:])) for colour in ORDERED], dtype=float)
    known = sorted(errors_mm)
    values = [math.nan if errors_mm[x] is None else math.log(errors_mm[x] or BEST_MM) for x in known]
    at = np.interp(fractions, known, values) if known else np.full(len(fractions), math.nan)
    share = np.clip((at - math.log(BEST_MM)) / math.log(WORST_MM / BEST_MM), 0.0, 1.0) * (len(palette) - 1)
    colours = np.stack([np.interp(share, range(len(palette)), channel) for channel in palette.T], axis=1)
    colours[np.isnan(at)] = STALE_COLOUR
    return colours.round().astype(np.uint8)


def colour_bar(text: str) -> str:
    """Return the bar of `error_colours` as HTML, with a text between its ends."""
    return (
        f'<div style="height:8px;border-radius:4px;background:linear-gradient(to right,{",".join(ORDERED)})"></div>'
        f'<div style="display:flex;justify-content:space-between;gap:8px;margin:4px 0 8px;font-size:14px">'
        f"<span>{BEST_MM:g}&nbsp;mm</span><span>{escape(text)}</span><span>{WORST_MM:g}&nbsp;mm</span></div>"
    )


class Stage:
    """Light, a floor with a scale bar, and the direction of gravity; the scene's z axis points up.

    Shadows are flat meshes on the floor: those of viser, and reflections of an environment, take nine tenths of a
    frame's time in a browser without a GPU.
    """

    def __init__(self, scene: "viser.SceneApi") -> None:
        """Create all objects; `put` places them."""
        self._scene, self.floor = scene, 0.0  # its height [m]
        scene.set_up_direction("+z")
        scene.configure_environment_map(None)
        scene.configure_default_lights(False)
        scene.add_light_hemisphere("/sky", sky_color=(255, 255, 255), ground_color=(150, 146, 140), intensity=1.5)
        scene.add_light_directional("/sun", intensity=2.2, position=(-8.0, -12.0, 20.0))
        grey = (150, 156, 162)
        self._grid = scene.add_grid(
            "/floor", UNIT * 0.5, UNIT * 0.5, cell_size=UNIT * 0.01, section_size=UNIT * 0.05, cell_color=grey,
            section_color=(124, 132, 140), shadow_opacity=0.0, fade_distance=UNIT * 0.3, fade_from="origin",
        )  # fmt: skip
        bar = UNIT * np.array([SCALE_BAR, 1e-3, 1e-3])
        self._bar = [scene.add_box("/scale", (96, 104, 112), bar, cast_shadow=False),
                     scene.add_label("/scale_label", f"{SCALE_BAR / MM:g} mm", anchor="top-center"),
                     ]  # fmt: skip
        self._gravity = [arrow(scene, "/gravity", grey), scene.add_label("/gravity_label", "gravity")]
        self._shadows: dict[str, viser.MeshHandle] = {}

    def put(self, floor: float, bar: Array, gravity: Array, has_gravity: bool = True) -> None:
        """Place the floor in height, the middle of the scale bar on it, and the tail of the arrow of gravity [m]."""
        self.floor = floor
        self._grid.position = (0.0, 0.0, UNIT * floor)
        for node in self._bar:
            node.position = UNIT * np.array([*bar[:2], floor + 1e-3])
        points = np.array([[gravity, gravity - (0.0, 0.0, 0.6 * ARROW)]])
        self._gravity[0].points, self._gravity[1].position = (UNIT * points).astype(np.float32), UNIT * points[0, 1]
        for node in self._gravity:
            node.visible = has_gravity

    def shade(self, name: str, points: Array, faces: NDArray[Any] | None = None) -> None:
        """Draw the shadow of a mesh, or of the convex hull of points, (k, 3), in the scene [m].

        Each pixel must be darkened once: the upper faces of a tube cover it once, those of several parts do not.
        """
        height = points[:, 2:] - self.floor
        flat = np.hstack(
            [points[:, :2] + height * SHADOW, np.full_like(height, self.floor + (1e-4 if faces is None else 2e-4))]
        )
        if faces is None:
            from scipy.spatial import ConvexHull

            flat = flat[ConvexHull(flat[:, :2]).vertices]
            faces = np.array([[0, k, k + 1] for k in range(1, len(flat) - 1)])
        vertices, faces = (UNIT * flat).astype(np.float32), faces.astype(np.uint32)
        if name in self._shadows:
            update(self._shadows[name], vertices, faces)
        else:
            self._shadows[name] = self._scene.add_mesh_simple(
                f"/shadow/{name}", vertices, faces, color=(0, 0, 0), opacity=SHADOW_OPACITY, cast_shadow=False,
                receive_shadow=False,
            )  # fmt: skip


def arrow(scene: "viser.SceneApi", name: str, colour: tuple[int, int, int], **options: Any) -> Any:
    """Add an arrow with a head; its points are set later."""
    return scene.add_arrows(
        name, np.zeros((1, 2, 3)), colour, shaft_radius=UNIT * 0.6e-3, head_radius=UNIT * 1.7e-3,
        head_length=UNIT * 4.5e-3, **options,
    )  # fmt: skip


def update(mesh: "viser.MeshHandle", vertices: NDArray[Any], faces: NDArray[Any]) -> None:
    """Replace vertices and faces of a mesh; unchanged faces are not sent again."""
    mesh.vertices = vertices
    if not np.array_equal(mesh.faces, faces):
        mesh.faces = faces


def level_rotation(gravity_base: Array) -> Array:
    """Return the rotation of the base that points gravity down, the nearest to upright, (3, 3)."""
    g = np.asarray(gravity_base, dtype=float)
    if not np.linalg.norm(g) > 0.0:
        return np.eye(3)
    up = -g / np.linalg.norm(g)  # world z in base axes
    side = np.array([1.0, 0.0, 0.0]) if abs(up[0]) < 0.9 else np.array([0.0, 0.0, 1.0])
    x = side - (side @ up) * up
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(up, x), up])


def quaternion(R: Array) -> Array:
    """Return the quaternion w, x, y, z of a rotation, as viser reads it."""
    from viser import transforms  # the run itself, which describes the rigid parts, needs no viser

    return np.asarray(transforms.SO3.from_matrix(R).wxyz, dtype=float)


EXPORTED = ("sensor_adapter", "clamp_ring", "flange_adapter")
MAX_FACETS = 200_000
#: A triangle of a binary STL file.
RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
PREAMBLE = 84  #: Bytes before the first triangle: 80 of header, and their number.
CYLINDER_SIDES = 48
CHAMFER = 0.5 * MM  #: Of the cylinders; assumed.


@dataclass(frozen=True)
class RigidPart:
    """A rigid part that moves with the base."""

    name: str  #: name of the part.
    vertices: Array  #: points in base axes [m], (i, 3).
    faces: NDArray[Any]  #: triangles, (j, 3).


def rigid_parts(model: ProbeModel, folder: Path, adapters: Sequence[RigidPart] = ()) -> tuple[list[RigidPart], str]:
    """Return sensor, adapters and the probe's flange, and a note on what is simplified.

    Args:
        model: of the probe.
        folder: with the exported parts, which are drawn where they fit the model.
        adapters: drawn without exported parts; a cylinder of their height if empty.
    """
    flange, T_base_sensor = model.flange, inverse(model.T_sensor_base)
    plain = [cylinder("sensor", model.sensor_d, -model.sensor_height, 0.0, T_base_sensor),
             cylinder("flange", flange.diameter, -flange.thickness, 0.0, np.eye(4))]  # fmt: skip
    try:
        return plain + _exported(model, folder), ""
    except FileNotFoundError:
        why = "there is no manifest.json"
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        why = " ".join(str(error).split()) or "unreadable"
    adapter = cylinder("adapter", flange.diameter, float(T_base_sensor[2, 3]), -flange.thickness, np.eye(4))
    return [*plain, *(adapters or [adapter])], f"parts of {folder}: {why}; plain cylinders are drawn instead"


def _exported(model: ProbeModel, folder: Path) -> list[RigidPart]:
    """Return the printed parts, in base axes."""
    manifest = dict(json.loads((folder / "manifest.json").read_text(encoding="utf-8")))
    from probedesign.frozen_probe import stale_parts  # the studio shows designs without an export

    if stale := stale_parts(model.parts or {"probe": model.fingerprint}, manifest):
        raise ValueError(stale)
    T_base_sensor = inverse(model.T_sensor_base)
    parts = []
    for name in EXPORTED:
        T = np.asarray(manifest["parts"][name]["T_sensor_part"], dtype=float)
        if not is_pose(T):
            raise ValueError(f"the manifest has an invalid pose of {name}")
        file = folder / f"{name}.stl"
        listed = manifest.get("files", {}).get(file.name, {}).get("sha256")
        if listed is not None and listed != hashlib.sha256(file.read_bytes()).hexdigest():
            raise ValueError(f"{file.name} is not the file that the manifest lists; export the design again")
        vertices, index = np.unique(read_stl(file).reshape(-1, 3), axis=0, return_inverse=True)
        parts.append(_part(name, vertices, index.reshape(-1, 3), T_base_sensor @ T))
    return parts


def read_stl(path: Path) -> Array:
    """Return the corners of a binary STL's triangles [m], (j, 3, 3); the file is in millimetres.

    Raises:
        OSError: there is no such file.
        ValueError: it is not a binary STL.
    """
    with path.open("rb") as file:
        content = file.read(PREAMBLE + MAX_FACETS * RECORD.itemsize + 1)
    count = int.from_bytes(content[80:PREAMBLE], "little")
    if len(content) != PREAMBLE + count * RECORD.itemsize or not 0 < count <= MAX_FACETS:
        raise ValueError(f"{path.name} is not a binary STL")
    corners = np.frombuffer(content, RECORD, offset=PREAMBLE)["corners"].astype(float) * MM
    if not np.isfinite(corners).all():
        raise ValueError(f"{path.name} has a non-finite corner")
    return corners


def _part(name: str, vertices: Array, faces: NDArray[Any], T: Array) -> RigidPart:
    points, faces = creased(vertices, faces)
    return RigidPart(name, points @ T[:3, :3].T + T[:3, 3], faces)


def creased(vertices: Array, faces: NDArray[Any]) -> tuple[Array, NDArray[Any]]:
    """Return a mesh whose faces share vertices only where they meet at less than 37°: shading is smooth, edges sharp.

    Args:
        vertices: points, (i, 3).
        faces: triangles, (j, 3).
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    # The ends of each edge of a face as corners 3 face + k, the one at the lower vertex first; equal edges meet.
    corner = np.arange(faces.size).reshape(-1, 3)
    ends = np.stack([corner, np.roll(corner, -1, axis=1)], axis=-1).reshape(-1, 2)
    at = faces.ravel()[ends]
    ends = np.where((at[:, :1] > at[:, 1:]), ends[:, ::-1], ends)
    order = np.lexsort(np.sort(at, axis=1).T)
    first, second = ends[order[:-1]], ends[order[1:]]
    meet = (faces.ravel()[first] == faces.ravel()[second]).all(axis=1)
    meet &= np.sum(normal[first[:, 0] // 3] * normal[second[:, 0] // 3], axis=1) > 0.8
    rows, columns = first[meet].ravel(), second[meet].ravel()
    graph = coo_array((np.ones(len(rows)), (rows, columns)), (faces.size, faces.size))
    _, labels = connected_components(graph, directed=False)
    _, where = np.unique(labels, return_index=True)
    return vertices[faces.ravel()[where]], labels.reshape(-1, 3)


def cylinder(name: str, diameter: float, low: float, high: float, T: Array) -> RigidPart:
    """Return a cylinder with chamfers along z from low to high [m]."""
    r, c = 0.5 * diameter, min(CHAMFER, 0.2 * (high - low), 0.2 * diameter)
    rim = [(r - c, low), (r, low + c), (r, high - c), (r - c, high)]
    return revolved(name, [(0.0, low), *rim, (0.0, high)], T)


def revolved(name: str, outline: Sequence[tuple[float, float]], T: Array) -> RigidPart:
    """Return a body of revolution about z of an outline of radius and z [m], with the body on its left."""
    angle = np.linspace(0.0, 2.0 * np.pi, CYLINDER_SIDES, endpoint=False)
    r, z = np.repeat(np.array(outline), CYLINDER_SIDES, axis=0).T
    vertices = np.stack([r * np.tile(np.cos(angle), len(outline)), r * np.tile(np.sin(angle), len(outline)), z], axis=1)
    faces = tube_faces(len(outline), CYLINDER_SIDES)
    return _part(name, vertices, faces[np.count_nonzero(r[faces] == 0.0, axis=1) < 2], T)  # none of no area
