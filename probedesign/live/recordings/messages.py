"""What a run delivers as ROS 2 messages: one encoder for recordings and for the Foxglove server.

Messages of equal length are laid out by numpy, all of a block at once: at 7000 readings per second the time that one
message takes in Python is taken from the estimator.
"""

import json
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from probedesign.core.errors import InputError
from probedesign.core.frames import Array, inverse, pose
from probedesign.core.statistics import ellipsoid_95
from probedesign.estimation.estimate import RESULTS
from probedesign.estimation.model import ProbeModel
from probedesign.geometry.tube import TubeMesh
from probedesign.live.blocks import Block, joined
from probedesign.live.outputs.sinks import Sink
from probedesign.live.poses.base_poses import TimedPose, pose_from_matrix
from probedesign.live.processing.estimates import EstimateUpdate, bent_shape, contact_marker, json_line, update_row
from probedesign.live.recordings import schemas
from probedesign.live.recordings.schemas import (
    MARKERS,
    Bytes,
    Nanoseconds,
    Topic,
    header_time,
    nanoseconds,
    stamped,
    texts,
    type_store,
)

#: Maximum number of readings described by one block message: 0.1 s of the fastest source, so that encoding it does not
#: occupy the interpreter for long.
MAX_BLOCK = 700
#: Largest magnitude of a source's time, and largest log time [ns]: 127 years, and the year 2223. Their sums and
#: differences fit in 64 bits, which cannot count beyond 292 years.
MAX_TIME, MAX_LOG_TIME = 4 * 10**18, 8 * 10**18


class MessageEncoder(Sink, ABC):
    """Encodes readings, estimates, poses and events of a run; called from one thread (see `RecordingFile`).

    With several probes each has its own topics and frames, which begin with its name.
    """

    def __init__(self, *models: ProbeModel, frames: bool = False) -> None:
        """Start without messages; with `frames`, the frames of a single probe begin with its name, too."""
        several = len(models) > 1
        self._encoders = {
            model.name if several else "": ProbeEncoder(
                model, self, model.name if several else "", f"{schemas.ros_name(model.name)}/" * (several or frames)
            )
            for model in models
        }

    @abstractmethod
    def add(self, topic: Topic, logged: Nanoseconds, data: Bytes, sequence: int = 0) -> None:
        """Take messages, (n,), with their times [ns], (n,); `sequence` is the number of the first."""

    def is_wanted(self, topic: Topic) -> bool:
        """Return whether messages of a topic are used; others are not encoded."""
        return True

    def on_clock(self, encoder: "ProbeEncoder") -> None:
        """Handle that the offset of a probe's clocks has become known, before its first message with a time."""
        return None

    @property
    def topics(self) -> list[Topic]:
        """Every topic."""
        return [*{t.path: t for name in self._encoders for t in schemas.topics_of(name)}.values()]

    def pass_on(self, call: str, *data: Any) -> None:
        """Encode readings, an estimate or a pose of a probe; see `ProbeEncoder`."""
        for each in data:
            getattr(self._encoders[each.probe], call)(each)

    def on_event(self, time: float, line: str) -> None:
        """Encode an event of the probe whose name it begins with, otherwise of the first."""
        name, _, text = line.partition(": ")
        if name in self._encoders:
            self._encoders[name].on_event(time, text)
        else:
            next(iter(self._encoders.values())).on_event(time, line)

    def on_dropped(self, readings: int, others: int, probe: str = "") -> None:
        """Encode what was dropped; see `ProbeEncoder`."""
        self._encoders[probe].on_dropped(readings, others)

    def encode_static(self) -> None:
        """Encode what does not change."""
        for encoder in self._encoders.values():
            encoder.encode_static()

    def encode(self) -> None:
        """Encode what is buffered."""
        for encoder in self._encoders.values():
            encoder.encode()


class ProbeEncoder:
    """Encodes what belongs to one probe.

    Time stamps are wall clock: the arrival of the first block, plus the time elapsed on the source's clock since then.

    Attributes:
        probe: name of the probe in a run with several; otherwise empty.
        clock_offset: wall clock minus the source's clock [ns]; None before the first message with a time.
    """

    def __init__(self, model: ProbeModel, output: MessageEncoder, probe: str, frames: str) -> None:
        """Start without messages; `frames` is the prefix of the probe's frames."""
        self._model, self._output, self.probe, self._frames = model, output, probe, frames
        self._topics = {topic.name: topic for topic in schemas.topics_of(probe)}
        self._scene = SceneEncoder(model, frames)
        self._pending: list[Block] = []
        self._updates: list[EstimateUpdate] = []
        self._count = self._first = 0
        self._logged = time.time_ns()
        self._scene_due = -math.inf
        self.clock_offset: int | None = None

    def _add(self, topic: Topic, logged: Nanoseconds, data: Bytes, sequence: int = 0) -> None:
        self._output.add(self._topics[topic.name], logged, data, sequence)

    def on_samples(self, block: Block) -> None:
        """Buffer readings until `encode` or until the state of the source changes.

        Raises:
            InputError: a time cannot be recorded; so do `on_pose` and `on_event`.
        """
        if len(block):
            if self.clock_offset is None:
                self._start_clock(block.time[-1], float(block.received[-1]))
            self._wall(block.time[[0, -1]])  # time does not decrease
        if self._pending:
            first = self._pending[0]
            same = (first.fault, first.stretch) == (block.fault, block.stretch)
            if not (same and np.array_equal(first.gravity_base, block.gravity_base) and self._count < MAX_BLOCK):
                self.encode()
        self._pending.append(block)
        self._count += len(block)

    def on_estimate(self, update: EstimateUpdate) -> None:
        """Buffer an estimate as long as the readings."""
        self._updates.append(update)

    def on_pose(self, pose: TimedPose) -> None:
        """Encode a pose of the base, as received."""
        stamp = self._wall([pose.time])
        self._add(schemas.BASE, stamp, stamped("world", stamp, [[*pose.p, *pose.q]]))
        self._add(schemas.TF, stamp, schemas.transform("world", f"{self._frames}base", int(stamp[0]), pose.p, pose.q))

    def on_event(self, time: float, line: str) -> None:
        """Encode an event; without a time it has that of the last reading or message."""
        known = math.isfinite(time)
        stamp = self._wall([time]) if known else np.array([self._logged])
        event = {"time_s": time if known else None, "event": line}
        self._add(schemas.EVENT, stamp, texts([json.dumps(event)]))

    def on_dropped(self, readings: int, others: int) -> None:
        """Encode the numbers of dropped readings and others as an event, and count the readings."""
        self.encode()
        self._first += readings
        lost = f"{readings} readings and {others} other messages dropped here"
        self.on_event(math.nan, f"the disk was too slow: {lost}")

    def encode_static(self) -> None:
        """Encode what does not change: the pose of the sensor."""
        at = pose_from_matrix(0.0, inverse(self._model.T_sensor_base))
        message = schemas.transform(f"{self._frames}base", f"{self._frames}sensor", self._logged, at.p, at.q)
        self._add(schemas.TF_STATIC, np.array([self._logged]), message)

    def encode(self) -> None:
        """Encode the buffer: estimates, readings as wrenches, and what their headers do not contain."""
        updates, self._updates = self._updates, []
        if updates:
            stamps = self._wall([update.reading.time for update in updates])
            for topic, chosen, data in update_messages(updates, stamps, self._frames):
                self._add(topic, chosen, data)
            for update, stamp in zip(updates, stamps, strict=True) if self._output.is_wanted(schemas.SCENE) else ():
                if not self._scene_due - 1.0 <= update.reading.time < self._scene_due:
                    self._scene_due = update.reading.time + 0.9 * SCENE_PERIOD
                    self._add(schemas.SCENE, np.array([stamp]), self._scene.encode(update, int(stamp)))
        if not self._pending:
            return
        block, self._pending, self._count = joined(self._pending), [], 0
        stamps = self._wall(block.time) if len(block) else np.array([self._logged])
        if len(block) and self._output.is_wanted(schemas.RAW):
            self._add(schemas.RAW, stamps, stamped(f"{self._frames}sensor", stamps, block.wrench_sensor), self._first)
        if self._output.is_wanted(schemas.BLOCK):
            content = {
                "first": self._first,
                "readings": len(block),
                "gravity_base_m_s2": block.gravity_base.tolist(),
                "stretch": block.stretch,
                "fault": block.fault,
            }
            self._add(schemas.BLOCK, stamps[-1:], texts([json.dumps(content)]))
        self._first += len(block)

    def _start_clock(self, source_time: float, received: float = math.nan) -> None:
        """Relate a time of the source [s] to the wall clock at its arrival by `time.monotonic` [s], or now."""
        age = time.monotonic() - received
        now = time.time_ns() - (round(1e9 * age) if math.isfinite(age) else 0)
        self.clock_offset, self._logged = now - int(nanoseconds(source_time)), now
        self._output.on_clock(self)

    def _wall(self, times: ArrayLike) -> Nanoseconds:
        """Return the wall clock [ns] at times of the source [s], (n,).

        Raises:
            InputError: a time is beyond what a log time can represent.
        """
        stamps = nanoseconds(times)
        if self.clock_offset is None:
            self._start_clock(np.ravel(times)[0])
        assert self.clock_offset is not None
        earliest, latest = max(-MAX_TIME, -self.clock_offset), min(MAX_TIME, MAX_LOG_TIME - self.clock_offset)
        beyond = np.ravel(times)[(stamps < earliest) | (stamps > latest)]
        if len(beyond):
            raise InputError(
                f"time {beyond[0]:.6g} s is outside {earliest / 1e9:.6g} ... {latest / 1e9:.6g} s, which an MCAP "
                "recording can state; record to NAME.csv, or restart the source's clock"
            )
        wall: Nanoseconds = stamps + self.clock_offset
        self._logged = int(wall[-1])
        return wall


#: Variance of each angle of a contact's orientation [rad²], which is not estimated: π in each direction.
UNKNOWN_ROTATION_VAR = math.pi**2


def update_messages(
    updates: Sequence[EstimateUpdate], stamps: Nanoseconds, frames: str
) -> Iterator[tuple[Topic, Nanoseconds, Bytes]]:
    """Yield for each topic the time stamps [ns], (n,), and the messages, (n,), of estimates with these stamps.

    `frames` is the prefix of the probe's frames.

    Messages are encoded together: one by one they take five times as long.
    """
    numbered = list(zip(stamps, updates, strict=True))
    wrenches = [(t, a.wrench_base.tolist()) for t, a in numbered if np.isfinite(a.wrench_base).all()]
    contacts = [(t, a.estimate) for t, a in numbered if a.estimate.ok]
    fused = [(t, a.fused) for t, a in numbered if a.fused is not None and a.fused.ok]
    points = [(t, _pose_values(e.p_surface_base, e.cov_surface_base)) for t, e in contacts]
    points_world = [(t, _pose_values(f.p_surface_world, f.cov_surface_world)) for t, f in fused]
    for topic, frame, values in (
        (schemas.WITHOUT_BIAS, f"{frames}base", wrenches),
        (schemas.CONTACT, f"{frames}base", points),
        (schemas.CONTACT_WORLD, "world", points_world),
    ):
        if values:
            chosen = np.array([stamp for stamp, _ in values])
            yield topic, chosen, stamped(frame, chosen, [numbers for _, numbers in values])
    numbers, codes, lines = [], [], []
    for update in updates:
        estimate = update.estimate
        contact = [estimate.s_contact, estimate.std_s, *estimate.p_surface_base, *estimate.force_base]
        contact += [float(np.linalg.norm(estimate.force_base)), estimate.force_normal, estimate.force_tangential]
        contact.append(estimate.friction_ratio)
        if not estimate.ok:
            contact = [math.nan] * len(contact)
        numbers.append([*map(float, contact), float(estimate.detection_chi2)])
        codes.append((_RESULT_CODES[estimate.result], schemas.PHASES.index(update.phase)))
        known = {"T_world_base": update.T_world_base.tolist()} if np.isfinite(update.T_world_base).all() else {}
        lines.append(json_line(update_row(update) | known))
    yield schemas.STATE, stamps, stamped(f"{frames}base", stamps, numbers, codes)
    yield schemas.ESTIMATE, stamps, texts(lines)


_RESULT_CODES = {result: code for code, result in enumerate(RESULTS)}


def _pose_values(p: Array, cov: Array) -> list[float]:
    whole = UNKNOWN_ROTATION_VAR * np.eye(6)
    whole[:3, :3] = cov
    return [*p.tolist(), 0.0, 0.0, 0.0, 1.0, *whole.ravel().tolist()]


# scene

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
