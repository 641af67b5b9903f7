"""The probe's skin: a smooth closed mesh around a bent centreline."""

import json
from collections import deque
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from probedesign.estimation.model import ProbeModel
from probedesign.frames import Array, inverse, is_pose
from probedesign.live.view.snapshot import STRIP, Shape
from probedesign.sensor import NANO17
from probedesign.units import MILLINEWTON, MM

STATIONS, AROUND = 72, 36


@dataclass(frozen=True)
class Tube:
    """A round or flattened body of varying width, by arclength.

    Attributes:
        s: knots [m], (k,).
        radius: half-width along the section's x there, linear between [m], (k,).
        flatness: half-width along y over that along x.
    """

    s: Array
    radius: Array
    flatness: float = 1.0

    @cached_property
    def stations(self) -> Array:
        """Arclengths of the rings [m]: evenly along the probe, and wherever its width bends."""
        even = np.linspace(self.s[0], self.s[-1], STATIONS)
        knots = self.s if len(self.s) <= STATIONS else self.s[:: len(self.s) // STATIONS]
        found: Array = np.unique(np.concatenate([even, knots, self.s[-1:]]))
        return found

    @cached_property
    def faces(self) -> Array:
        """Triangles, seen from outside anticlockwise, (j, 3): the rings, then a cap at either end."""
        rings, ring = len(self.stations), np.arange(AROUND)
        after = (ring + 1) % AROUND
        first = AROUND * np.arange(rings - 1)[:, None]
        a, b = first + ring, first + after
        side = np.stack([a, b, b + AROUND, a, b + AROUND, a + AROUND], axis=-1).reshape(-1, 3)
        base = rings * AROUND  # the caps have rims of their own, so that their edge stays sharp
        tip = base + AROUND + 1
        caps = [
            np.stack([base + after, base + ring, np.full(AROUND, base + AROUND)], axis=1),
            np.stack([tip + ring, tip + after, np.full(AROUND, tip + AROUND)], axis=1),
        ]
        return np.concatenate([side, *caps]).astype(np.uint32)

    def vertices(self, shape: Shape) -> Array:
        """Points of the skin [m], (i, 3), in base axes."""
        p, x, y = centreline(shape, self.stations)
        angle = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)
        round_x, round_y = np.cos(angle)[:, None], self.flatness * np.sin(angle)[:, None]
        radius = np.interp(self.stations, self.s, self.radius)[:, None, None]
        rings = p[:, None] + radius * (round_x * x[:, None] + round_y * y[:, None])
        caps = [np.vstack([rings[end], p[end]]) for end in (0, -1)]
        found: Array = np.concatenate([rings.reshape(-1, 3), *caps])
        return found


def centreline(shape: Shape, s: Array) -> tuple[Array, Array, Array]:
    """Points and the section's x and y axes at arclengths s, each (k, 3).

    Cubic between the nodes of the solve, by their tangents; the rod's stretch, some thousandths, is left out of
    these, so that it is a picture and no measure.
    """
    i = np.clip(np.searchsorted(shape.s, s, side="right") - 1, 0, len(shape.s) - 2)
    step = shape.s[i + 1] - shape.s[i]
    t = ((s - shape.s[i]) / step)[:, None]
    p0, p1 = shape.p_base[i], shape.p_base[i + 1]
    m0, m1 = (step[:, None] * shape.R_base[j][:, :, 2] for j in (i, i + 1))
    p = (
        (1 + 2 * t) * (1 - t) ** 2 * p0
        + t * (1 - t) ** 2 * m0
        + t**2 * (3 - 2 * t) * p1
        + t**2 * (t - 1) * m1
    )
    slope = 6 * t * (1 - t) * (p1 - p0) + (1 - t) * (1 - 3 * t) * m0 + t * (3 * t - 2) * m1
    tangent = slope / np.linalg.norm(slope, axis=1, keepdims=True)
    x = (1 - t) * shape.R_base[i][:, :, 0] + t * shape.R_base[i + 1][:, :, 0]
    x = x - np.sum(x * tangent, axis=1, keepdims=True) * tangent
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return p, x, np.cross(tangent, x)


EXPORTED = ("sensor_adapter", "clamp_ring", "flange_adapter")
FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
HEADER = 84
MOST_FACETS = 200_000
CYLINDER_SIDES = 48


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
    plain = [_sensor_part(model), _flange_part(model)]
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
            _adapter_part(model),
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


def _sensor_part(model: ProbeModel) -> Part:
    """The Nano17's body; its tool face is the sensor frame's origin."""
    return _cylinder("sensor", NANO17.body_d, -NANO17.height, 0.0, inverse(model.T_sensor_base))


def _flange_part(model: ProbeModel) -> Part:
    """The disc below the base, of one piece with the probe."""
    return _cylinder("flange", model.flange.diameter, -model.flange.thickness, 0.0, np.eye(4))


def _adapter_part(model: ProbeModel) -> Part:
    """As wide as the flange, from the sensor's face to it."""
    bottom = float(inverse(model.T_sensor_base)[2, 3])
    return _cylinder("adapter", model.flange.diameter, bottom, -model.flange.thickness, np.eye(4))


def _cylinder(name: str, diameter: float, low: float, high: float, T: Array) -> Part:
    """Along z from low to high [m]."""
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
class Setup:
    """Everything that does not change.

    Attributes:
        title: of the page.
        host, port: where it listens; the next free port is taken.
        tube: the probe's skin.
        free: the untouched probe.
        parts: what it hangs on.
        gravity_base: [m/s²], (3,).
        note: on what is drawn, if there is something to say.
    """

    title: str
    host: str
    port: int
    tube: Tube
    free: Shape
    parts: tuple[Part, ...]
    gravity_base: Array
    note: str = ""


RADIUS_95 = 2.7955
"""Standard deviations within which a point of three dimensions lies 95 times in 100: √ of that quantile of χ² of three
degrees of freedom."""


def ellipsoid(cov: Array) -> tuple[Array, Array]:
    """Half-axes of the 95 % ellipsoid [m], (3,), and their directions as the columns of a rotation, (3, 3)."""
    variances, axes = np.linalg.eigh(cov)
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] = -axes[:, 0]
    half_axes: Array = RADIUS_95 * np.sqrt(np.maximum(variances, 0.0))
    return half_axes, axes


SECONDS = 15.0
POINTS = 450
"""Of a chart: 30 a second."""
AGAIN = 0.1
"""They are drawn anew when so much has come [s]: all their points are sent each time."""
S, STD, FORCE = STRIP.index("s"), STRIP.index("std_s"), STRIP.index("force")


class Charts:
    """What the charts show, as new rows come; NaN where nothing is known."""

    def __init__(self) -> None:
        self._rows: deque[Array] = deque(maxlen=POINTS)
        self._due = self._drawn = -np.inf

    def add(self, strip: Array) -> bool:
        """Take in rows of `STRIP`, thinned; whether it is worth to draw anew. Time that runs backward begins anew."""
        for row in strip:
            if row[0] < self._due - 2.0 * SECONDS / POINTS:
                self._rows.clear()
                self._due = self._drawn = -np.inf
            if row[0] >= self._due:
                self._rows.append(row)
                self._due = row[0] + 0.9 * SECONDS / POINTS
        worth = self._due >= self._drawn + AGAIN
        if worth:
            self._drawn = self._due
        return worth

    def lines(self) -> dict[str, tuple[Array, ...]]:
        """What is to be drawn: s [mm] and the ends of its 95 %, the contact's force [mN], and force [mN] and moment
        [N·mm] at the base, each after the times [s]."""
        rows = self._last()
        time, s, wide = rows[:, 0], rows[:, S] / MM, 1.96 * rows[:, STD] / MM
        return {
            "place": (time, s, s - wide, s + wide),
            "push": (time, rows[:, FORCE] / MILLINEWTON),
            "forces": (time, *(rows[:, 1:4] / MILLINEWTON).T),
            "moments": (time, *(rows[:, 4:7] / MM).T),
        }

    def window(self) -> tuple[float, float]:
        """From when to when the charts reach [s]."""
        end = float(self._rows[-1][0]) if self._rows else 0.0
        return max(end, SECONDS) - SECONDS, max(end, SECONDS)

    def _last(self) -> Array:
        rows = np.array(self._rows).reshape(-1, len(STRIP))
        kept: Array = rows[rows[:, 0] >= self.window()[0]]
        return kept if len(kept) else np.full((1, len(STRIP)), np.nan)
