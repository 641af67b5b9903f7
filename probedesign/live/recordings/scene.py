"""The bent probe, the sensor and the contact as a `MarkerArray`, which RViz and Foxglove draw."""

from typing import Any

import numpy as np

from probedesign.core.frames import Array, pose
from probedesign.core.statistics import ellipsoid_95
from probedesign.estimation.model import ProbeModel
from probedesign.geometry.tube import TubeMesh
from probedesign.live.poses.base_poses import pose_from_matrix
from probedesign.live.processing.estimates import EstimateUpdate, bent_shape, contact_marker
from probedesign.live.recordings.schemas import MARKERS, Bytes, header_time, type_store

SCENE_PERIOD = 0.1  #: Minimum interval of the source's clock between two scenes [s]: a scene takes some 15 kB.
RINGS, SIDES = 12, 8
CONTACT_LIFETIME = 1  #: Time after which a contact without a newer scene disappears [s].
MIN_DIAMETER = 1.8e-3  #: Minimum diameter of the drawn ellipsoid [m], so that it is visible.
ARROW = 0.030  #: Length of the arrow of the force [m].
ARROW_SIZE = (1.2e-3, 3.2e-3, 3.2e-3)  #: Diameters of its shaft and head, and length of the head [m].
UNSCALED = (1.0, 1.0, 1.0)
#: Colours: red, green, blue, opacity.
PROBE, SENSOR, CONTACT = (0.93, 0.57, 0.26, 0.6), (0.24, 0.25, 0.28, 1.0), (0.91, 0.28, 0.26, 1.0)


class SceneEncoder:
    """Encodes what is drawn of an estimate; a result other than `ok` removes the contact."""

    def __init__(self, model: ProbeModel, frames: str = "") -> None:
        """Prepare the mesh; `frames` is the prefix of the probe's frames."""
        rod, self._frames = model.rod, frames
        self._tube = TubeMesh(rod.s, rod.radius, model.cross_section.flatness, RINGS, SIDES)
        self._size = (model.sensor_d, model.sensor_d, model.sensor_height)
        self._T_sensor = pose(np.eye(3), np.array([0.0, 0.0, -0.5 * model.sensor_height]))  # below its tool face

    def encode(self, update: EstimateUpdate, stamp: int) -> Bytes:
        """Return the message, (1,), with a time stamp [ns]; the shape of the probe is solved here."""
        store = type_store()
        types: dict[str, Any] = {name.rpartition("/")[2]: kind for name, kind in store.types.items()}
        Marker, time, no_time = types["Marker"], types["Time"](*header_time(stamp)), types["Time"](0, 0)
        no_image = types["CompressedImage"](types["Header"](no_time, ""), "", np.zeros(0, np.uint8))
        no_mesh = types["MeshFile"]("", np.zeros(0, np.uint8))

        def marker(
            name: str, number: int, frame: str, kind: int, T: Array, colour: Any, size: Any, points: Any = ()
        ) -> Any:
            at = pose_from_matrix(0.0, T)
            return Marker(
                types["Header"](time, frame), name, number, kind, Marker.DELETE if size is None else Marker.ADD,
                types["Pose"](types["Point"](*at.p), types["Quaternion"](*at.q)),
                types["Vector3"](*(size or UNSCALED)), types["ColorRGBA"](*colour),
                types["Duration"](CONTACT_LIFETIME if name == "contact" else 0, 0), True,
                [types["Point"](*point) for point in np.reshape(points, (-1, 3)).tolist()], [], "", no_image, [], "",
                "", no_mesh, False,
            )  # fmt: skip

        shape, contact, base = bent_shape(update), contact_marker(update), f"{self._frames}base"
        markers = [marker("sensor", 0, f"{self._frames}sensor", Marker.CYLINDER, self._T_sensor, SENSOR, self._size)]
        if shape is not None:
            corners = self._tube.vertices(shape)[self._tube.faces]
            markers.append(marker("probe", 0, base, Marker.TRIANGLE_LIST, np.eye(4), PROBE, UNSCALED, corners))
        frame, T, ball, arrow = base, np.eye(4), None, None
        ends: tuple[Array, ...] = ()
        if contact is not None:
            frame = "world" if contact.in_world else base
            half_axes, axes = ellipsoid_95(contact.cov)
            T, arrow = pose(axes, contact.p_surface), ARROW_SIZE
            ball = tuple(np.maximum(2.0 * half_axes, MIN_DIAMETER).tolist())
            tail = contact.p_surface - ARROW * contact.force / np.linalg.norm(contact.force)
            ends = (tail, contact.p_surface)
        markers.append(marker("contact", 0, frame, Marker.SPHERE, T, CONTACT, ball))
        markers.append(marker("contact", 1, frame, Marker.ARROW, np.eye(4), CONTACT, arrow, ends))
        message = bytes(store.serialize_cdr(types["MarkerArray"](markers), MARKERS))
        return np.frombuffer(message, f"V{len(message)}")
