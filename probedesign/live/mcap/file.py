"""Writing a recording in MCAP: raw readings, what was made of them, events, and the frozen probe itself."""

import json
import math
import time
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from probedesign.deployment import freeze
from probedesign.estimator.model import ProbeModel
from probedesign.frames import Array
from probedesign.live.answer import Answer
from probedesign.live.block import Block
from probedesign.live.mcap import messages, require, topics
from probedesign.live.mcap.topics import OURS
from probedesign.live.pieces import Pieces
from probedesign.live.row import json_line, row

PROFILE = "ros2"
JSON = "application/json"
UNITS = {
    "unit_of_force": "N",
    "unit_of_moment": "N m",
    "unit_of_position": "m",
    "unit_in_json": "as names end",
}
UNTOLD = math.pi**2
"""Variance of each angle of a contact's orientation [rad²], which is not estimated: half a turn either way."""


class McapFile:
    """A recording that any tool of ROS 2 or of MCAP opens. A `File`: called from one thread."""

    def __init__(
        self, path: Path, model: ProbeModel, force: bool = False, about: Mapping[str, str] | None = None
    ) -> None:
        """Make the file, with the probe and what is to know in it from the first byte.

        Args:
            path: where; its folder is made if missing.
            model: the probe on the sensor.
            force: replace a file that stands there.
            about: what else is to know: the source, the options.

        Raises:
            InputError: the file exists and `force` is not said, or it cannot be written.
            MissingDependencyError: the MCAP package is not installed.
        """
        require()
        from mcap.writer import Writer

        self._pieces = Pieces(path, force)
        self._writer = Writer(self._pieces)  # type: ignore[arg-type]  # all that it asks of a stream
        self._first, self._wall, self._logged = 0, 0, time.time_ns()
        frozen = freeze(model)
        self._writer.start(PROFILE, frozen["written_by"])
        probe = (json.dumps(frozen, indent=2) + "\n").encode()
        self._writer.add_attachment(self._logged, self._logged, f"{model.name}.probe.json", JSON, probe)
        known = {"probe": model.name, "fingerprint": model.fingerprint, "written_by": frozen["written_by"]}
        started = {"started": datetime.now(UTC).isoformat(timespec="seconds")}
        self._writer.add_metadata(OURS, known | started | UNITS | dict(about or {}))
        self._channels = self._registered()
        self._pieces.flush()

    def read(self, block: Block) -> None:
        """Every reading as a wrench; then one line with what their headers cannot tell."""
        stamps = messages.nanoseconds(block.time).tolist()
        rows = zip(stamps, block.wrench_sensor.tolist(), strict=True)
        for i, (stamp, wrench) in enumerate(rows, self._first):
            self._add(topics.RAW, stamp, messages.stamped("sensor", stamp, wrench), i)
        known = {
            "first": self._first,
            "time_s": block.time.tolist(),
            "gravity_base_m_s2": block.gravity_base.tolist(),
            "stretch": block.stretch,
            "fault": block.fault,
        }
        self._first += len(block)
        self._add(topics.BLOCK, stamps[-1] if stamps else None, messages.text(json.dumps(known)))

    def answered(self, answer: Answer) -> None:
        """What was said, and what was said it from."""
        stamp = int(messages.nanoseconds(answer.reading.time))
        said = row(answer.reading, answer.estimate)
        pose = answer.T_world_base
        if np.isfinite(answer.wrench_base).all():
            wrench = messages.stamped("base", stamp, answer.wrench_base.tolist())
            self._add(topics.WITHOUT_BIAS, stamp, wrench)
        if np.isfinite(pose).all():
            self._add(topics.BASE, stamp, messages.stamped("world", stamp, _pose(pose)))
        if answer.estimate.ok:
            place = _place(answer.estimate.p_contact_base, answer.estimate.cov_contact_base)
            self._add(topics.CONTACT, stamp, messages.stamped("base", stamp, place))
        if answer.fused is not None and answer.fused.ok:
            place = _place(answer.fused.p_contact_world, answer.fused.cov_contact_world)
            self._add(topics.CONTACT_WORLD, stamp, messages.stamped("world", stamp, place))
        self._add(topics.ESTIMATE, stamp, messages.text(_with_pose(json_line(said), pose)))

    def told(self, time: float, line: str) -> None:
        """An event."""
        known = time if math.isfinite(time) else None
        stamp = int(messages.nanoseconds(time)) if known is not None else None
        self._add(topics.EVENT, stamp, messages.text(json.dumps({"time_s": known, "event": line})))

    def left_out(self, readings: int, others: int) -> None:
        """Readings and answers that did not come here, as an event and in the count of readings."""
        self._first += readings
        self.told(math.nan, f"the disk was too slow: {readings} readings and {others} others left out here")

    def flush(self) -> None:
        """End the chunk and hand it to the operating system."""
        self._writer.flush()

    def close(self) -> None:
        """Write what lets other tools find their way, and close."""
        try:
            self._writer.finish()
            self._pieces.flush()
        finally:
            self._pieces.close()

    def _registered(self) -> dict[str, int]:
        """The topics' channels, each type's definition once."""
        schemas = {
            name: self._writer.register_schema(name, "ros2msg", messages.definition(name))
            for name in dict.fromkeys(topic.type for topic in topics.TOPICS)
        }
        told = {
            topic: {"json_schema": json.dumps(topic.schema)} if topic.schema else {}
            for topic in topics.TOPICS
        }
        return {
            topic.name: self._writer.register_channel(topic.name, "cdr", schemas[topic.type], metadata)
            for topic, metadata in told.items()
        }

    def _add(self, topic: topics.Topic, stamp: int | None, data: bytes, sequence: int = 0) -> None:
        """Add a message; logged at the computer's time of the first, moved on by the source's clock."""
        if stamp is not None:
            self._wall = self._wall or time.time_ns() - stamp
            self._logged = min(max(stamp + self._wall, 0), 2**63 - 1)
        channel = self._channels[topic.name]
        self._writer.add_message(channel, self._logged, data, self._logged, sequence % 2**32)


def _pose(T: Array) -> list[float]:
    """Position and quaternion x, y, z, w."""
    return [*T[:3, 3].tolist(), *Rotation.from_matrix(T[:3, :3]).as_quat().tolist()]


def _place(p: Array, cov: Array) -> list[float]:
    """A point as a pose with covariance, (43,); nothing is said of its orientation."""
    whole = UNTOLD * np.eye(6)
    whole[:3, :3] = cov
    return [*p.tolist(), 0.0, 0.0, 0.0, 1.0, *whole.ravel().tolist()]


def _with_pose(line: str, T_world_base: Array) -> str:
    """The JSON line with the pose to the last bit, which a quaternion does not tell."""
    if not np.isfinite(T_world_base).all():
        return line
    return json.dumps(json.loads(line) | {"T_world_base": T_world_base.tolist()})
