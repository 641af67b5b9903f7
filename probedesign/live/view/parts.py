"""What the probe hangs on: the exported parts where they lie beside the frozen probe, else plain cylinders."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from probedesign.estimation.model import ProbeModel
from probedesign.frames import Array, inverse, is_pose
from probedesign.sensor import NANO17
from probedesign.units import MM

EXPORTED = ("sensor_adapter", "clamp_ring", "flange_adapter")
FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
HEADER = 84
MOST_FACETS = 200_000
AROUND = 48


@dataclass(frozen=True)
class Part:
    """A rigid thing that moves with the base.

    Attributes:
        name: what it is.
        vertices: in base axes [m], (i, 3).
        faces: triangles, (j, 3).
    """

    name: str
    vertices: Array
    faces: NDArray[np.integer]


def parts_of(model: ProbeModel, folder: Path) -> tuple[list[Part], str]:
    """Sensor, adapters and the probe's own flange, and what to say of them.

    Args:
        model: the probe on the sensor.
        folder: where the frozen probe lies, and its exported parts perhaps.
    """
    plain = [_sensor(model), _flange(model)]
    try:
        return plain + _exported(model, folder), ""
    except (OSError, ValueError, KeyError, TypeError) as error:
        why = (
            "no manifest.json lies there"
            if isinstance(error, FileNotFoundError)
            else str(error) or "unreadable"
        )
        return [
            *plain,
            _adapter(model),
        ], f"parts of {folder}: {' '.join(why.split())}; plain cylinders are drawn instead"


def _exported(model: ProbeModel, folder: Path) -> list[Part]:
    """The printed parts, in base axes.

    Raises:
        OSError, ValueError, KeyError, TypeError: they are not there, or not this probe's.
    """
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    if manifest["fingerprint"] != model.fingerprint:
        raise ValueError(f"they are of probe {manifest['fingerprint']}, not {model.fingerprint}")
    T_base_sensor = inverse(model.T_sensor_base)
    parts = []
    for name in EXPORTED:
        T = np.asarray(manifest["parts"][name]["T_sensor_part"], dtype=float)
        if not is_pose(T):
            raise ValueError(f"the manifest's pose of {name} is none")
        parts.append(_placed(name, read_stl(folder / f"{name}.stl"), T_base_sensor @ T))
    return parts


def read_stl(path: Path) -> Array:
    """Corners of a binary STL's triangles [m], (j, 3, 3); its numbers are millimetres.

    Raises:
        OSError: there is no such file.
        ValueError: it is no binary STL.
    """
    with path.open("rb") as file:
        content = file.read(HEADER + MOST_FACETS * FACET.itemsize + 1)
    count = int.from_bytes(content[80:HEADER], "little")
    if len(content) != HEADER + count * FACET.itemsize or not 0 < count <= MOST_FACETS:
        raise ValueError(f"{path.name} is no binary STL")
    corners = np.frombuffer(content, FACET, offset=HEADER)["corners"].astype(float) * MM
    if not np.isfinite(corners).all():
        raise ValueError(f"{path.name} holds a corner that is nowhere")
    return corners


def _placed(name: str, corners: Array, T: Array) -> Part:
    vertices, faces = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return Part(name, vertices @ T[:3, :3].T + T[:3, 3], faces.reshape(-1, 3))


def _sensor(model: ProbeModel) -> Part:
    """The Nano17's body; its tool face is the sensor frame's origin."""
    return _cylinder("sensor", NANO17.body_d, -NANO17.height, 0.0, inverse(model.T_sensor_base))


def _flange(model: ProbeModel) -> Part:
    """The disc below the base, of one piece with the probe."""
    return _cylinder("flange", model.flange.diameter, -model.flange.thickness, 0.0, np.eye(4))


def _adapter(model: ProbeModel) -> Part:
    """As wide as the flange, from the sensor's face to it."""
    bottom = float(inverse(model.T_sensor_base)[2, 3])
    return _cylinder("adapter", model.flange.diameter, bottom, -model.flange.thickness, np.eye(4))


def _cylinder(name: str, diameter: float, low: float, high: float, T: Array) -> Part:
    """Along z from low to high [m]."""
    angle = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)
    a = 0.5 * diameter * np.stack([np.cos(angle), np.sin(angle), np.zeros(AROUND)], axis=1)
    b = np.roll(a, -1, axis=0)
    down, up = np.array([0.0, 0.0, low]), np.array([0.0, 0.0, high])
    corners = [
        np.stack([a + down, b + down, b + up], axis=1),
        np.stack([a + down, b + up, a + up], axis=1),
        np.stack([b + down, a + down, np.tile(down, (AROUND, 1))], axis=1),
        np.stack([a + up, b + up, np.tile(up, (AROUND, 1))], axis=1),
    ]
    return _placed(name, np.concatenate(corners), T)
