"""What the scenes of `live --view` and the studio share: scale, colours, rotations, and the rigid parts as meshes."""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from probedesign.core.frames import Array, inverse, is_pose
from probedesign.core.units import MM
from probedesign.estimation.model import ProbeModel

UNIT = 20.0  #: Scene units per metre: viser's lights, camera and shadows suit objects of a few units.
MIN_HALF_AXIS = 0.9e-3  #: Minimum half-axis of the drawn ellipsoid [m], so that it is visible.
ARROW = 0.03  #: Length of the force arrow [m]; its label states the force.
PROBE, CONTACT, SPREAD, STALE_COLOUR = (236, 148, 66), (150, 10, 30), (232, 72, 66), (150, 150, 150)
METAL = (132, 142, 154)
PART_COLOURS = {"sensor": (60, 64, 72), "flange": PROBE, "clamp_ring": (112, 122, 136),
                "flange_adapter": (150, 158, 168)}  # fmt: skip


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


@dataclass(frozen=True)
class RigidPart:
    """A rigid part that moves with the base."""

    name: str  #: name of the part.
    vertices: Array  #: points in base axes [m], (i, 3).
    faces: NDArray[np.integer]  #: triangles, (j, 3).


def rigid_parts(model: ProbeModel, folder: Path) -> tuple[list[RigidPart], str]:
    """Return sensor, adapters and the probe's flange, and a note on them, from the folder of the exported parts."""
    flange, T_base = model.flange, np.eye(4)
    sensor = _cylinder("sensor", model.sensor_d, -model.sensor_height, 0.0, inverse(model.T_sensor_base))
    plain = [sensor, _cylinder("flange", flange.diameter, -flange.thickness, 0.0, T_base)]
    try:
        return plain + _exported(model, folder), ""
    except FileNotFoundError:
        why = "there is no manifest.json"
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        why = " ".join(str(error).split()) or "unreadable"
    bottom = float(inverse(model.T_sensor_base)[2, 3])
    adapter = _cylinder("adapter", flange.diameter, bottom, -flange.thickness, T_base)
    return [*plain, adapter], f"parts of {folder}: {why}; plain cylinders are drawn instead"


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
        parts.append(_placed(name, read_stl(file), T_base_sensor @ T))
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


def _placed(name: str, corners: Array, T: Array) -> RigidPart:
    vertices, faces = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return RigidPart(name, vertices @ T[:3, :3].T + T[:3, 3], faces.reshape(-1, 3))


def _cylinder(name: str, diameter: float, low: float, high: float, T: Array) -> RigidPart:
    """Return a cylinder along z from low to high [m]."""
    angle = np.linspace(0.0, 2.0 * np.pi, CYLINDER_SIDES, endpoint=False)
    a = 0.5 * diameter * np.stack([np.cos(angle), np.sin(angle), np.zeros(CYLINDER_SIDES)], axis=1)
    b = np.roll(a, -1, axis=0)
    down, up = np.array([0.0, 0.0, low]), np.array([0.0, 0.0, high])
    corners = [
        np.stack([a + down, b + down, b + up], axis=1),
        np.stack([a + down, b + up, a + up], axis=1),
        np.stack([b + down, a + down, np.tile(down, (CYLINDER_SIDES, 1))], axis=1),
        np.stack([a + up, b + up, np.tile(up, (CYLINDER_SIDES, 1))], axis=1),
    ]
    return _placed(name, np.concatenate(corners), T)
