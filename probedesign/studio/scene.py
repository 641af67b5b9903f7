"""The studio in three dimensions: the bent probe coloured by its error, its mount, and a touch that can be dragged."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import viser
from scipy.spatial.transform import Rotation

from probedesign.core.files import exports_of
from probedesign.core.frames import Array
from probedesign.core.statistics import ellipsoid_95
from probedesign.core.statistics import rms as rms_of
from probedesign.core.units import MM
from probedesign.estimation.estimate import Estimate
from probedesign.geometry.tube import BentShape, TubeMesh, centreline
from probedesign.probe import Probe
from probedesign.rod.equilibrium import Equilibrium
from probedesign.studio.figures import DesignFigures, DrawnTouch, errors_along, touched_shape
from probedesign.studio.session import TOUCH_RANGE, StudioTouch, knots_of
from probedesign.web.scene import (
    ARROW,
    CONTACT,
    MIN_HALF_AXIS,
    PART_COLOURS,
    SPREAD,
    STALE_COLOUR,
    UNIT,
    Stage,
    arrow,
    error_colours,
    level_rotation,
    quaternion,
    rigid_parts,
    update,
)

SLICES = 96  #: Of the drawn probe, each of one colour.
PLACES = (np.arange(SLICES) + 0.5) / SLICES  #: Of their middles, fractions of the length.
OVERLAP = 1.2  #: Length of a slice over their distance, so that a bent probe has no gaps.
#: A slice of radius and length 1.
SLICE = TubeMesh(np.array([0.0, 1.0]), np.ones(2), rings=2, sides=20)
STRAIGHT = BentShape(np.array([0.0, 1.0]), np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.tile(np.eye(3), (2, 1, 1)))
KNOT_COLOUR = (38, 84, 124)
GHOST_COLOUR, FORMER_COLOUR = (120, 126, 132), (38, 84, 124)  #: Of a pinned probe, and of the one before a change.
MAX_KNOTS = 12  #: Number of diameters of a profile that can be dragged; a profile with more is changed in its file.
FIELD_OF_VIEW = math.radians(40.0)
MOUNT_LENGTH = 0.03  #: Length behind the base that is seen as well: sensor and adapters [m].
#: Distance of the camera and width of the scene at least [lengths of probe and mount], and the lengths, over that at
#: which the camera was placed, between which it stays, and the change of the tip's place beside the axis of the base,
#: over the length.
DISTANCE, SHOWN_WIDTH, MIN_GROWTH, MAX_GROWTH, MAX_ASIDE = 1.95, 1.3, 0.4, 1.3, 0.2
BELOW = 0.02  #: Height of the lowest point above the floor when the camera is placed [m].


class StudioScene:
    """The objects of the scene, in the frame of the probe's base."""

    def __init__(self, scene: viser.SceneApi, on_change: Callable[[str, Any], None]) -> None:
        """Create all objects.

        Args:
            scene: of the page.
            on_change: receives a key of the touch, `touch.fraction`, `touch.angle_deg` or `touch.force_mN`, or
                `knot.INDEX`, and its new value when something is dragged.
        """
        self._on_change, self._scene, self._stage = on_change, scene, Stage(scene)
        self._shown: tuple[Probe, DrawnTouch | None, BentShape] | None = None
        self._stands = False  # the probe does not buckle
        self._grabbed = (0.0, np.zeros(3))  # diameter of a knot and pointer in base axes when its drag began [m]
        self._base = scene.add_frame("/base", show_axes=False)
        nowhere, corners = np.zeros((SLICES, 3)), SLICE.vertices(STRAIGHT)
        corners[2 * SLICE.sides :, :2] *= 0.93  # the ends, so that their edges stay within the next slice
        self._probe = scene.add_batched_meshes_simple(
            "/base/probe", corners, SLICE.faces, np.tile((1.0, 0.0, 0.0, 0.0), (SLICES, 1)), nowhere,
            batched_scales=nowhere + 1.0, batched_colors=np.full((SLICES, 3), 150, dtype=np.uint8), lod="off",
            cast_shadow=False,
        )  # fmt: skip
        self._contact = scene.add_icosphere("/base/contact", UNIT * 1.8e-3, CONTACT, cast_shadow=False)
        for node in (self._probe, self._contact):
            node.on_drag(self._drag_place)
        self._end = scene.add_icosphere("/base/force_end", UNIT * 1.8e-3, CONTACT, cast_shadow=False)
        self._end.on_drag(self._drag_force)
        self._spread = scene.add_icosphere("/base/spread", 1.0, SPREAD, opacity=0.35, cast_shadow=False)
        self._force = arrow(scene, "/base/force", CONTACT)
        self._force_label = scene.add_label("/base/force_label", "", anchor="bottom-center")
        self._spread_label = scene.add_label("/base/spread_label", "", anchor="bottom-center")
        self._cloud = scene.add_point_cloud(
            "/base/cloud", np.zeros((1, 3)), CONTACT, point_size=UNIT * 7e-4, point_shape="circle", visible=False
        )
        self._knots = [
            scene.add_icosphere(f"/base/knot/{i}", UNIT * 1.6e-3, KNOT_COLOUR, visible=False, cast_shadow=False)
            for i in range(MAX_KNOTS)
        ]
        for i, node in enumerate(self._knots):
            node.on_drag(lambda event, i=i: self._drag_knot(i, event))  # type: ignore[misc]  # viser: any event
        self._length = 1.0  # of the longest probe [m]
        # Length [m], direction of the probe and tip beside it [m] that the camera fits.
        self._framed = (1.0, np.array([0.0, 0.0, 1.0]), np.zeros(3))
        self._ghosts: dict[str, viser.MeshHandle] = {}
        self._parts: dict[str, viser.MeshHandle] = {}
        self._parts_of = ""
        self._hull = np.zeros((0, 3))  # points of the rigid parts in base axes [m]

    def show_shape(
        self, probe: Probe, drawn: DrawnTouch | None, touch: StudioTouch, pinned: Sequence[Probe], former: Probe | None
    ) -> None:
        """Draw a probe, its mount and a touch, and other probes under the same touch as shadows of it.

        Args:
            probe: the probe; its colours remain those of `show_errors`.
            drawn: the touch; None where the probe buckles under it.
            touch: its values.
            pinned: probes to compare.
            former: the probe before the change that goes on.
        """
        model = probe.model
        T = level_rotation(model.gravity_base)
        self._base.wxyz = quaternion(T)
        eq = drawn.contact.equilibrium if drawn else model.rod.solve(model.gravity_base)
        bent = _bent(eq, probe)
        self._shown, self._stands = (probe, drawn, bent), eq.ok
        self._length = max(each.length for each in (probe, *pinned))
        p, x, y = centreline(bent, PLACES * probe.length)
        R = np.stack([x, y, np.cross(x, y)], axis=-1)
        radius, step = np.interp(PLACES * probe.length, probe.geometry.s, probe.geometry.radius), probe.length / SLICES
        self._probe.batched_wxyzs = Rotation.from_matrix(R).as_quat()[:, [3, 0, 1, 2]].astype(np.float32)
        self._probe.batched_positions = (UNIT * (p - 0.5 * step * R[:, :, 2])).astype(np.float32)
        size = [radius, (probe.design.probe.flatness or 1.0) * radius, np.full(SLICES, OVERLAP * step)]
        self._probe.batched_scales = (UNIT * np.stack(size, axis=1)).astype(np.float32)
        self._show_knots(bent, probe)
        self._contact.visible = self._force.visible = self._end.visible = self._force_label.visible = drawn is not None
        self._cloud.visible = False
        if drawn is None:
            self._spread.visible = self._spread_label.visible = False
        else:
            tail = drawn.p_surface - arrow_length(touch.force_mN) * drawn.normal
            self._contact.position, self._end.position = UNIT * drawn.p_surface, UNIT * tail
            self._force.points = (UNIT * np.array([[tail, drawn.p_surface]])).astype(np.float32)
            self._force_label.position = UNIT * (tail - 4e-3 * drawn.normal)
            self._force_label.text = f"{touch.force_mN:g} mN"
        self._show_parts(probe)
        self._shade()
        ghosts = {f"pinned/{i}": (other, GHOST_COLOUR) for i, other in enumerate(pinned)}
        if former is not None:
            ghosts["former"] = former, FORMER_COLOUR
        for name in self._ghosts.keys() - ghosts.keys():
            self._ghosts.pop(name).remove()
        for name, (other, colour) in ghosts.items():
            tube = _tube(other, 0.97)  # hidden where both are the same
            vertices = (UNIT * tube.vertices(_bent(touched_shape(other, touch), other))).astype(np.float32)
            if name in self._ghosts:
                update(self._ghosts[name], vertices, tube.faces)
            else:
                self._ghosts[name] = self._scene.add_mesh_simple(
                    f"/base/{name}", vertices, tube.faces, color=colour, opacity=0.3, cast_shadow=False
                )

    def show_errors(self, figures: DesignFigures, estimate: Estimate | None, touch: StudioTouch) -> None:
        """Colour the probe by its predicted error, and draw the covariance of the touch.

        Args:
            figures: of the probe that is drawn.
            estimate: of the touch that is drawn; None without one.
            touch: its values.
        """
        errors = errors_along(figures, 1e-3 * touch.force_mN) if self._stands else {}  # grey: it buckles
        # viser takes the colours of instances as linear.
        self._probe.batched_colors = np.round(255.0 * (error_colours(errors, PLACES) / 255.0) ** 2.2).astype(np.uint8)
        self._spread.visible = self._spread_label.visible = estimate is not None and estimate.ok
        if estimate is not None and estimate.ok:
            half_axes, axes = ellipsoid_95(estimate.cov_surface_base)
            self._spread.position = UNIT * estimate.p_surface_base
            self._spread.scale = tuple(UNIT * np.maximum(half_axes, MIN_HALF_AXIS))
            self._spread.wxyz = quaternion(axes)
            up = level_rotation(figures.probe.model.gravity_base)[2]
            self._spread_label.position = UNIT * (estimate.p_surface_base + 0.015 * up)
            self._spread_label.text = f"95 % region, {rms_of(estimate.cov_surface_base) / MM:.2g} mm RMS"

    def show_cloud(self, points: Array) -> None:
        """Draw located points of the touch, (k, 3) [m]; none hides them."""
        self._cloud.visible = len(points) > 0
        if len(points):
            self._cloud.points = (UNIT * points).astype(np.float16)

    def end_change(self) -> None:
        """Remove the shape before the last change."""
        if "former" in self._ghosts:
            self._ghosts.pop("former").remove()

    def _show_knots(self, bent: BentShape, probe: Probe) -> None:
        knots = knots_of(probe.design)[:MAX_KNOTS]
        for node in self._knots[len(knots) :]:
            node.visible = False
        if knots:
            p, x, _ = centreline(bent, np.array([s for _, s, _ in knots]))
            for node, point, side, (_, _, diameter) in zip(self._knots, p, x, knots, strict=False):
                node.visible, node.position = True, UNIT * (point + 0.5 * diameter * side)

    def _show_parts(self, probe: Probe) -> None:
        model, folder = probe.model, exports_of() / probe.design.name
        exported = folder / "manifest.json"  # fits one probe; else the parts of the mount decide
        key = f"{exported.stat().st_mtime} {model.fingerprint}" if exported.exists() else ""
        key += str([model.flange, model.sensor, *(v for k, v in model.parts.items() if k not in ("probe", "payload"))])
        if key == self._parts_of:
            return
        self._parts_of = key
        from probedesign.web.home import adapters  # the page of a design, which no studio shows

        parts = {part.name: part for part in rigid_parts(model, folder, adapters(probe.design, model))[0]}
        self._hull = np.concatenate([part.vertices for part in parts.values()])
        for name in self._parts.keys() - parts.keys():
            self._parts.pop(name).remove()
        for name, part in parts.items():
            vertices, faces = (UNIT * part.vertices).astype(np.float32), part.faces.astype(np.uint32)
            if name in self._parts:
                update(self._parts[name], vertices, faces)
            else:
                self._parts[name] = self._scene.add_mesh_simple(
                    f"/base/part/{name}", vertices, faces, color=PART_COLOURS.get(name, STALE_COLOUR),
                    cast_shadow=False,
                )  # fmt: skip

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
        return self.has_turned or aside or not MIN_GROWTH < grown < MAX_GROWTH

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
        self._shade(place_floor=True)

    def _shade(self, place_floor: bool = False) -> None:
        """Draw the shadows, after placing the floor below probe and mount if `place_floor`."""
        if self._shown is None:
            return
        probe, _, bent = self._shown
        T, tube = level_rotation(probe.model.gravity_base), _tube(probe)
        body, mount = tube.vertices(bent) @ T.T, self._hull @ T.T
        if place_floor:
            low, high = (getattr(np.concatenate([body, mount]), end)(axis=0) for end in ("min", "max"))
            front, tail = low - (0.0, 0.02, BELOW), low - (0.0, 0.01, -0.005)
            front[0] = 0.5 * (low[0] + high[0])
            self._stage.put(front[2], front, tail, bool(np.any(probe.model.gravity_base)))
        self._stage.shade("probe", body, tube.faces)
        self._stage.shade("mount", mount)

    # Drags

    def _in_base(self, event: Any) -> Array | None:
        """Return the pointer in base axes [m]; None before anything was drawn."""
        if self._shown is None:
            return None
        T = level_rotation(self._shown[0].model.gravity_base)
        return np.asarray(T.T @ np.asarray(event.end_position, dtype=float) / UNIT)

    def _drag_place(self, event: Any) -> None:
        pointer = self._in_base(event)
        if pointer is None or self._shown is None:
            return
        probe, _, bent = self._shown
        s = np.linspace(0.0, probe.length, 201)
        nearest = int(np.argmin(np.linalg.norm(centreline(bent, s)[0] - pointer, axis=1)))
        self._on_change("touch.fraction", round(float(np.clip(s[nearest] / probe.length, *TOUCH_RANGE["fraction"])), 3))

    def _drag_force(self, event: Any) -> None:
        """Turn the force to the pointer; its distance from the touch sets the magnitude."""
        pointer, (_, drawn, bent) = self._in_base(event), self._shown or (None, None, None)
        if pointer is None or drawn is None or bent is None:
            return
        arm = drawn.p_surface - pointer
        _, x, y = centreline(bent, np.array([drawn.s]))
        force = np.clip(force_of_arrow(float(np.linalg.norm(arm))), *TOUCH_RANGE["force_mN"])
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


def _tube(probe: Probe, width: float = 1.0) -> TubeMesh:
    return TubeMesh(
        probe.geometry.s, width * probe.geometry.radius, probe.design.probe.flatness or 1.0, rings=24, sides=16
    )
