"""The bent probe, the sensor and the contact as a `SceneUpdate`, which Foxglove draws."""

import numpy as np

from probedesign.core.frames import Array, pose
from probedesign.core.statistics import ellipsoid_95
from probedesign.estimation.model import ProbeModel
from probedesign.geometry.tube import TubeMesh
from probedesign.live.poses.base_poses import pose_from_matrix
from probedesign.live.processing.estimates import EstimateUpdate, bent_shape, contact_marker
from probedesign.live.recordings.schemas import Bytes, CdrBuilder

SCENE_PERIOD = 0.1  #: Minimum interval of the source's clock between two scenes [s]: a scene takes some 20 kB.
RINGS, SIDES = 16, 12
CONTACT_LIFETIME = 1.0  #: Time after which a contact without a newer scene disappears [s].
MIN_DIAMETER = 1.8e-3  #: Minimum diameter of the drawn ellipsoid [m], so that it is visible.
ARROW, SHAFT, HEAD = 0.030, 1.2e-3, 3.2e-3  #: Length of the arrow of the force, and diameters of shaft and head [m].
#: Colours: red, green, blue, opacity.
PROBE, SENSOR, CONTACT = (0.93, 0.57, 0.26, 0.6), (0.24, 0.25, 0.28, 1.0), (0.91, 0.28, 0.26, 1.0)
#: Kinds of primitives of an entity, in the order arrows, cubes, spheres, cylinders, lines, triangles, texts, models.
N_PRIMITIVES = 8
UPRIGHT = (0.0, 0.0, 0.0, 1.0)  #: Quaternion of the axes of the entity's frame.
ARROWS, SPHERES, CYLINDERS, TRIANGLES = 0, 2, 3, 5


class SceneEncoder:
    """Encodes what is drawn of an estimate; a result other than `ok` removes the contact."""

    def __init__(self, model: ProbeModel) -> None:
        rod = model.rod
        self._tube = TubeMesh(rod.s, rod.radius, model.cross_section.flatness, RINGS, SIDES)
        self._faces = self._tube.faces.reshape(-1)
        self._body_d, self._height = model.sensor_d, model.sensor_height

    def encode(self, update: EstimateUpdate, stamp: int) -> Bytes:
        """Return the message, (1,), with a time stamp [ns]; the shape of the probe is solved here."""
        shape, marker = bent_shape(update), contact_marker(update, 1)
        scene = CdrBuilder()
        if marker is None:
            scene.pack("I", 1).time(stamp).pack("B", 0).string("contact")
        else:
            scene.pack("I", 0)
        scene.pack("I", 1 + (shape is not None) + (marker is not None))
        self._sensor(scene, stamp)
        if shape is not None:
            _begin(scene, "probe", "base", stamp, 0.0)
            for kind in range(N_PRIMITIVES):
                scene.pack("I", kind == TRIANGLES)
                if kind == TRIANGLES:
                    scene.pack("d", 0.0, 0.0, 0.0, *UPRIGHT).array(self._tube.vertices(shape), "<f8").pack("d", *PROBE)
                    scene.pack("I", 0).array(self._faces, "<u4")
        if marker is not None:
            _begin(scene, "contact", "world" if marker.in_world else "base", stamp, CONTACT_LIFETIME)
            half_axes, axes = ellipsoid_95(marker.cov)
            for kind in range(N_PRIMITIVES):
                scene.pack("I", kind in (ARROWS, SPHERES))
                if kind == ARROWS:
                    R = _x_along(marker.force)
                    _pose(scene, pose(R, marker.p_surface - ARROW * R[:, 0]))
                    scene.pack("d", ARROW - HEAD, SHAFT, HEAD, HEAD, *CONTACT)
                elif kind == SPHERES:
                    diameters = np.maximum(2.0 * half_axes, MIN_DIAMETER)
                    _pose(scene, pose(axes, marker.p_surface)).pack("d", *diameters, *CONTACT)
        return scene.message()

    def _sensor(self, scene: CdrBuilder, stamp: int) -> None:
        """Append the body of the sensor; its tool face is the origin of the sensor's frame."""
        _begin(scene, "sensor", "sensor", stamp, 0.0)
        for kind in range(N_PRIMITIVES):
            scene.pack("I", kind == CYLINDERS)
            if kind == CYLINDERS:
                scene.pack("d", 0.0, 0.0, -0.5 * self._height, *UPRIGHT)
                scene.pack("d", self._body_d, self._body_d, self._height, 1.0, 1.0, *SENSOR)


def _begin(scene: CdrBuilder, name: str, frame: str, stamp: int, lifetime: float) -> None:
    """Append an entity up to its primitives; it follows its frame."""
    scene.time(stamp).string(frame).string(name).time(round(lifetime * 1e9)).pack("?", True).pack("I", 0)


def _pose(scene: CdrBuilder, T: Array) -> CdrBuilder:
    """Append a pose (4, 4)."""
    return scene.pack("d", *T[:3, 3], *pose_from_matrix(0.0, T).q)


def _x_along(force: Array) -> Array:
    x = force / np.linalg.norm(force)
    z = np.cross(x, np.eye(3)[int(np.argmin(np.abs(x)))])
    z /= np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z], axis=1)
