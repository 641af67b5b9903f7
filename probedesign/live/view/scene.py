"""Content of the page without viser: probe mesh, rigid parts, covariance ellipsoid and chart data."""

import json
from collections import deque
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from probedesign.core.frames import Array, inverse, is_pose
from probedesign.core.units import MILLINEWTON, MM
from probedesign.estimation.model import ProbeModel
from probedesign.live.outputs.drawing import BentShape, TubeMesh
from probedesign.live.view.state import STRIP

EXPORTED = ("sensor_adapter", "clamp_ring", "flange_adapter")
MAX_FACETS = 200_000
RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
"""A triangle of a binary STL file."""
PREAMBLE = 84
"""Bytes before the first triangle: 80 of header, and their number."""
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
    plain = [_sensor_part(model), _cylinder("flange", flange.diameter, -flange.thickness, 0.0, T_base)]
    try:
        return plain + _exported(model, folder), ""
    except FileNotFoundError:
        why = "there is no manifest.json"
    except (OSError, ValueError, KeyError, TypeError) as error:
        why = " ".join(str(error).split()) or "unreadable"
    bottom = float(inverse(model.T_sensor_base)[2, 3])
    adapter = _cylinder("adapter", flange.diameter, bottom, -flange.thickness, T_base)
    return [*plain, adapter], f"parts of {folder}: {why}; plain cylinders are drawn instead"


def _exported(model: ProbeModel, folder: Path) -> list[RigidPart]:
    """Return the printed parts, in base axes."""
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    if manifest["fingerprint"] != model.fingerprint:
        raise ValueError(f"they belong to probe {manifest['fingerprint']}, not {model.fingerprint}")
    T_base_sensor = inverse(model.T_sensor_base)
    parts = []
    for name in EXPORTED:
        T = np.asarray(manifest["parts"][name]["T_sensor_part"], dtype=float)
        if not is_pose(T):
            raise ValueError(f"the manifest has an invalid pose of {name}")
        parts.append(_placed(name, read_stl(folder / f"{name}.stl"), T_base_sensor @ T))
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


def _sensor_part(model: ProbeModel) -> RigidPart:
    """Return the body of the sensor; its tool face is the sensor frame's origin."""
    return _cylinder("sensor", model.sensor_d, -model.sensor_height, 0.0, inverse(model.T_sensor_base))


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


@dataclass(frozen=True)
class SceneSetup:
    """Static content of the page."""

    title: str  #: title of the page.
    host: str  #: host, port: address of the server; the next free port is used.
    port: int
    tube: TubeMesh  #: mesh of the probe.
    free: BentShape  #: shape of the free probe.
    parts: tuple[RigidPart, ...]  #: parts at its base.
    gravity_base: Array  #: gravity vector [m/s²], (3,).
    note: str = ""  #: note on what is drawn, if any.
    token: str = ""  #: secret that a browser must know; empty on an address of this machine only.


CHART_SECONDS = 15.0
CHART_POINTS = 450
"""Points of a chart: 30 per second."""
REDRAW_PERIOD = 0.1
"""Minimum interval between redraws [s]: all points are sent each time."""
S, STD, FORCE = STRIP.index("s"), STRIP.index("std_s"), STRIP.index("force")


class StripCharts:
    """Data of the strip charts over the last seconds; NaN where unknown."""

    def __init__(self) -> None:
        self._rows: deque[Array] = deque(maxlen=CHART_POINTS)
        self._due = self._last_drawn = -np.inf

    def add(self, strip: Array) -> bool:
        """Add rows of `STRIP`, thinned; return whether to redraw. Decreasing time clears the charts."""
        for row in strip:
            if row[0] < self._due - 2.0 * CHART_SECONDS / CHART_POINTS:
                self._rows.clear()
                self._due = self._last_drawn = -np.inf
            if row[0] >= self._due:
                self._rows.append(row)
                self._due = row[0] + 0.9 * CHART_SECONDS / CHART_POINTS
        due = self._due >= self._last_drawn + REDRAW_PERIOD
        if due:
            self._last_drawn = self._due
        return due

    def lines(self, age: float = 0.0) -> dict[str, tuple[Array, ...]]:
        """Return the data of the charts, each after the times [s], which are negative: seconds before now.

        Position s [mm] with its 95 % interval, contact force [mN], and force [mN] and moment [N·mm] at the base.

        Args:
            age: time since the last row [s]: old data move out of the charts.
        """
        rows = self._recent(age)
        last = float(self._rows[-1][0]) if self._rows else 0.0
        time, s, wide = rows[:, 0] - last - age, rows[:, S] / MM, 1.96 * rows[:, STD] / MM
        return {
            "place": (time, s, s - wide, s + wide),
            "push": (time, rows[:, FORCE] / MILLINEWTON),
            "forces": (time, *(rows[:, 1:4] / MILLINEWTON).T),
            "moments": (time, *(rows[:, 4:7] / MM).T),
        }

    def _recent(self, age: float) -> Array:
        rows = np.array(self._rows).reshape(-1, len(STRIP))
        recent: Array = rows[rows[:, 0] >= rows[-1, 0] + age - CHART_SECONDS] if len(rows) else rows
        return recent if len(recent) else np.full((1, len(STRIP)), np.nan)
