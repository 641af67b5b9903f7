"""The studio in three dimensions: the bent probe coloured by its error, its mount, and a touch that can be dragged."""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from probedesign.core.frames import Array
from probedesign.core.statistics import ellipsoid_95
from probedesign.estimation.estimate import Estimate
from probedesign.geometry.tube import BentShape, centreline, disc_faces, tube_faces, tube_rings
from probedesign.probe import Probe
from probedesign.rod.equilibrium import Equilibrium
from probedesign.studio.figures import DesignFigures, DrawnTouch, segment_colours, touched_shape
from probedesign.studio.session import StudioTouch, knots_of
from probedesign.web.scene import (
    ARROW,
    CONTACT,
    MIN_HALF_AXIS,
    PART_COLOURS,
    SPREAD,
    STALE_COLOUR,
    UNIT,
    level_rotation,
    quaternion,
    rigid_parts,
)

#: Coloured segments of the drawn probe, rings of each, points of a ring: without a GPU, the triangles of the probe take
#: half of a frame's time.
SEGMENTS, RINGS, RING_POINTS = 20, 3, 20
EDGES = np.linspace(0.0, 1.0, SEGMENTS + 1)  #: Fractions of the length between which the segments are.
KNOT_COLOUR = (38, 84, 124)
GHOST_RINGS, GHOST_COLOUR = 40, (120, 126, 132)  #: Rings and colour of a pinned probe.
MAX_KNOTS = 12  #: Number of diameters of a profile that can be dragged; a profile with more is changed in its file.
FIELD_OF_VIEW = math.radians(40.0)
MOUNT_LENGTH = 0.03  #: Length behind the base that is seen as well: sensor and adapters [m].
#: Distance of the camera and width of the scene at least [lengths of probe and mount], and the changes of the probe's
#: length and of its tip's place beside the axis of the base, over the length, that the camera follows.
DISTANCE, SHOWN_WIDTH, MAX_GROWTH, MAX_ASIDE = 1.95, 1.3, 1.25, 0.2
MIN_FRACTION, MAX_FORCE_MN, MIN_FORCE_MN = 0.05, 200.0, 0.5  #: Range of the touch that is drawn.


class StudioScene:
    """The objects of the scene, in the frame of the probe's base."""

    def __init__(self, scene: viser.SceneApi, on_change: Callable[[str, Any], None]) -> None:
        """Create all objects.

        Args:
            scene: of the page.
            on_change: receives a key of the touch, `touch.fraction`, `touch.angle_deg` or `touch.force_mN`, or
                `knot.INDEX`, and its new value when something is dragged.
        """
        self._on_change, self._scene = on_change, scene
        self._shown: tuple[Probe, DrawnTouch | None, BentShape] | None = None
        self._stands = False  # the probe does not buckle
        self._grabbed = (0.0, np.zeros(3))  # diameter of a knot and pointer in base axes when its drag began [m]
        scene.set_up_direction("+z")
        # Reflections of an environment and shadows take nine tenths of a frame's time in a browser without a GPU.
        scene.configure_environment_map(None)
        scene.configure_default_lights(True, cast_shadow=False)
        scene.add_light_hemisphere("/sky", ground_color=(150, 150, 150), intensity=2.5)
        self._base = scene.add_frame("/base", show_axes=False)
        nothing, faces = np.zeros((RINGS * RING_POINTS + 1, 3)), _tube_faces(RINGS)
        self._segments = [
            scene.add_mesh_simple(f"/base/probe/{i}", nothing, faces, color=STALE_COLOUR, cast_shadow=False)
            for i in range(SEGMENTS)
        ]
        self._contact = scene.add_icosphere("/base/contact", UNIT * 1.8e-3, CONTACT, cast_shadow=False)
        for node in (*self._segments, self._contact):
            node.on_drag(self._drag_place)
        self._end = scene.add_icosphere("/base/force_end", UNIT * 1.8e-3, CONTACT, cast_shadow=False)
        self._end.on_drag(self._drag_force)
        self._spread = scene.add_icosphere("/base/spread", 1.0, SPREAD, cast_shadow=False)
        self._force = scene.add_arrows(
            "/base/force", np.zeros((1, 2, 3)), CONTACT, shaft_radius=UNIT * 0.5e-3, head_radius=UNIT * 1.4e-3,
            head_length=UNIT * 3.5e-3,
        )  # fmt: skip
        self._knots = [
            scene.add_icosphere(f"/base/knot/{i}", UNIT * 1.6e-3, KNOT_COLOUR, visible=False, cast_shadow=False)
            for i in range(MAX_KNOTS)
        ]
        for i, node in enumerate(self._knots):
            node.on_drag(lambda event, i=i: self._drag_knot(i, event))  # type: ignore[misc]  # viser: any event
        self._length = 1.0  # of the longest probe [m]
        # Length [m], direction of the probe and tip beside it [m] that the camera fits.
        self._framed = (1.0, np.array([0.0, 0.0, 1.0]), np.zeros(3))
        self._ghosts: list[viser.MeshHandle] = []
        self._parts: list[viser.MeshHandle] = []
        self._parts_of = ""

    def show_shape(self, probe: Probe, drawn: DrawnTouch | None, touch: StudioTouch, pinned: Sequence[Probe]) -> None:
        """Draw a probe, its mount and a touch, and pinned probes under the same touch as grey shadows.

        Args:
            probe: the probe; its colours remain those of `show_errors`.
            drawn: the touch; None where the probe buckles under it.
            touch: its values.
            pinned: probes to compare.
        """
        model = probe.model
        self._base.wxyz = quaternion(level_rotation(model.gravity_base))
        eq = drawn.contact.equilibrium if drawn else model.rod.solve(model.gravity_base)
        bent = _bent(eq, probe)
        self._shown, self._stands = (probe, drawn, bent), eq.ok
        self._length = max(each.length for each in (probe, *pinned))
        for mesh, (low, high) in zip(self._segments, pairwise(EDGES), strict=True):
            mesh.vertices = _tube(bent, probe, np.linspace(low, high, RINGS))
        self._show_knots(bent, probe)
        self._contact.visible = self._force.visible = self._end.visible = drawn is not None
        if drawn is None:
            self._spread.visible = False
        else:
            tail = drawn.p_surface - arrow_length(touch.force_mN) * drawn.normal
            self._contact.position, self._end.position = UNIT * drawn.p_surface, UNIT * tail
            self._force.points = (UNIT * np.array([[tail, drawn.p_surface]])).astype(np.float32)
        self._show_parts(probe)
        while len(self._ghosts) > len(pinned):
            self._ghosts.pop().remove()
        for i, other in enumerate(pinned):
            vertices = _tube(_bent(touched_shape(other, touch), other), other, np.linspace(0.0, 1.0, GHOST_RINGS))
            if i < len(self._ghosts):
                self._ghosts[i].vertices = vertices
            else:
                mesh = self._scene.add_mesh_simple(
                    f"/base/pinned/{i}", vertices, _tube_faces(GHOST_RINGS), color=GHOST_COLOUR, opacity=0.35,
                    cast_shadow=False,
                )  # fmt: skip
                self._ghosts.append(mesh)

    def show_errors(self, figures: DesignFigures, estimate: Estimate | None, touch: StudioTouch) -> None:
        """Colour the probe by its predicted error, and draw the covariance of the touch.

        Args:
            figures: of the probe that is drawn.
            estimate: of the touch that is drawn; None without one.
            touch: its values.
        """
        colours = segment_colours(figures, EDGES, 1e-3 * touch.force_mN)
        for mesh, colour in zip(self._segments, colours, strict=True):
            now = colour if self._stands else STALE_COLOUR  # grey: it buckles
            if mesh.color != now:
                mesh.color = now
        self._spread.visible = estimate is not None and estimate.ok
        if estimate is not None and estimate.ok:
            half_axes, axes = ellipsoid_95(estimate.cov_surface_base)
            self._spread.position = UNIT * estimate.p_surface_base
            self._spread.scale = tuple(UNIT * np.maximum(half_axes, MIN_HALF_AXIS))
            self._spread.wxyz = quaternion(axes)

    def _show_knots(self, bent: BentShape, probe: Probe) -> None:
        knots = knots_of(probe.design)[:MAX_KNOTS]
        for node in self._knots[len(knots) :]:
            node.visible = False
        if knots:
            p, x, _ = centreline(bent, np.array([s for _, s, _ in knots]))
            for node, point, side, (_, _, diameter) in zip(self._knots, p, x, knots, strict=False):
                node.visible, node.position = True, UNIT * (point + 0.5 * diameter * side)

    def _show_parts(self, probe: Probe) -> None:
        """Draw sensor, flange and adapter when they have changed."""
        model = probe.model
        key = f"{model.flange} {model.sensor} {model.gravity_base}"
        if key == self._parts_of:
            return
        self._parts_of = key
        for part in self._parts:
            part.remove()
        parts, _ = rigid_parts(model, Path())
        self._parts = [
            self._scene.add_mesh_simple(
                f"/base/part/{part.name}", UNIT * part.vertices, part.faces,
                color=PART_COLOURS.get(part.name, STALE_COLOUR), flat_shading=True,
            )
            for part in parts
        ]  # fmt: skip

    # Camera

    @property
    def has_turned(self) -> bool:
        """Whether the probe points elsewhere than when the camera was placed."""
        if self._shown is None:
            return False
        along = level_rotation(self._shown[0].model.gravity_base)[:, 2]
        return bool(along @ self._framed[1] < math.cos(math.radians(15.0)))

    @property
    def is_out_of_frame(self) -> bool:
        """Whether length or direction of the probe have changed much since the camera was placed."""
        if self._shown is None:
            return False
        grown = self._length / self._framed[0]
        aside = float(np.linalg.norm(self._aside - self._framed[2])) > MAX_ASIDE * self._length
        return self.has_turned or aside or not 1.0 / MAX_GROWTH < grown < MAX_GROWTH

    @property
    def _aside(self) -> Array:
        """Return how far the unloaded tip is beside the axis of the base, in world axes [m], (3,)."""
        if self._shown is None:
            return np.zeros(3)
        probe = self._shown[0]
        tip = probe.axis.frames([probe.length])[0, :3, 3] * (1.0, 1.0, 0.0)
        return np.asarray(level_rotation(probe.model.gravity_base) @ tip)

    def set_camera(self, camera: Any, aspect: float = 1.0, direction: Array | None = None) -> None:
        """Place a camera so that the whole probe is seen.

        Args:
            camera: of a browser, or the initial one of all.
            aspect: width of the scene over its height.
            direction: from the probe to the camera; beside and slightly above the probe if None.
        """
        if self._shown is None:
            return
        probe = self._shown[0]
        along = level_rotation(probe.model.gravity_base)[:, 2]
        if direction is None:
            side = np.cross(along, (0.0, 0.0, 1.0))
            side = side / np.linalg.norm(side) if np.linalg.norm(side) > 0.2 else np.array([0.0, -1.0, 0.0])
            direction = 2.2 * side + np.array([0.0, 0.0, 0.7]) + 0.4 * along
        tangent = math.tan(0.5 * FIELD_OF_VIEW)
        whole = self._length + MOUNT_LENGTH
        distance = UNIT * whole * max(DISTANCE, 0.5 * SHOWN_WIDTH / (tangent * max(aspect, 0.1)))
        middle = UNIT * ((0.5 * whole - MOUNT_LENGTH) * along + 0.5 * self._aside)
        camera.fov = FIELD_OF_VIEW
        camera.position = middle + distance * direction / np.linalg.norm(direction)
        camera.look_at = middle  # last: the position moves it too
        self._framed = self._length, along, self._aside

    # Drags

    def _in_base(self, event: Any) -> Array | None:
        """Return the pointer in base axes [m]; None before anything was drawn."""
        if self._shown is None:
            return None
        T = level_rotation(self._shown[0].model.gravity_base)
        return np.asarray(T.T @ np.asarray(event.end_position, dtype=float) / UNIT)

    def _drag_place(self, event: Any) -> None:
        """Move the touch to the section nearest to the pointer."""
        pointer = self._in_base(event)
        if pointer is None or self._shown is None:
            return
        probe, _, bent = self._shown
        s = np.linspace(0.0, probe.length, 201)
        nearest = int(np.argmin(np.linalg.norm(centreline(bent, s)[0] - pointer, axis=1)))
        self._on_change("touch.fraction", round(float(np.clip(s[nearest] / probe.length, MIN_FRACTION, 1.0)), 3))

    def _drag_force(self, event: Any) -> None:
        """Turn the force to the pointer; its distance from the touch sets the magnitude."""
        pointer, (_, drawn, bent) = self._in_base(event), self._shown or (None, None, None)
        if pointer is None or drawn is None or bent is None:
            return
        arm = drawn.p_surface - pointer
        _, x, y = centreline(bent, np.array([drawn.s]))
        force = np.clip(force_of_arrow(float(np.linalg.norm(arm))), MIN_FORCE_MN, MAX_FORCE_MN)
        self._on_change("touch.angle_deg", float(round(math.degrees(math.atan2(arm @ y[0], arm @ x[0])))))
        self._on_change("touch.force_mN", round(2.0 * float(force)) / 2.0)

    def _drag_knot(self, i: int, event: Any) -> None:
        """Change the diameter of a knot by twice the way of the pointer across the probe since the drag began."""
        pointer = self._in_base(event)
        if pointer is None or self._shown is None:
            return
        probe, _, bent = self._shown
        index, s, diameter = knots_of(probe.design)[i]
        if event.phase == "start":
            self._grabbed = diameter, pointer
        before, start = self._grabbed
        across = float((pointer - start) @ centreline(bent, np.array([s]))[1][0])
        self._on_change(f"knot.{index}", round(1e3 * max(before + 2.0 * across, 0.0), 1))


def arrow_length(force_mN: float) -> float:
    """Return the length of the drawn arrow [m]: half of `ARROW` for each decade above 0.1 mN."""
    return 0.5 * ARROW * (math.log10(max(force_mN, 0.2)) + 1.0)


def force_of_arrow(length: float) -> float:
    """Return the force [mN] of an arrow of a length [m]."""
    return float(10.0 ** (length / (0.5 * ARROW) - 1.0))


def _bent(eq: Equilibrium, probe: Probe) -> BentShape:
    if eq.ok:
        return BentShape(eq.s, eq.p_base, eq.R_base)
    s = np.linspace(0.0, probe.length, 30)
    T = probe.axis.frames(s)
    return BentShape(s, T[:, :3, 3], T[:, :3, :3])


def _tube_faces(rings: int) -> NDArray[np.uint32]:
    disc = disc_faces((rings - 1) * RING_POINTS, rings * RING_POINTS, RING_POINTS)
    return np.concatenate([tube_faces(rings, RING_POINTS), disc]).astype(np.uint32)


def _tube(shape: BentShape, probe: Probe, fractions: Array) -> NDArray[np.float32]:
    geometry, s = probe.geometry, fractions * probe.length
    radius = np.interp(s, geometry.s, geometry.radius)
    rings = tube_rings(shape, s, radius, probe.design.probe.flatness or 1.0, RING_POINTS)
    end = centreline(shape, s[-1:])[0]
    return (UNIT * np.vstack([rings.reshape(-1, 3), end])).astype(np.float32)
