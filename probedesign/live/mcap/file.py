"""Writing a recording in MCAP: raw readings, what was made of them, events, and the frozen probe itself."""

import json
import math
import time
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from probedesign.deployment import freeze
from probedesign.estimation.model import ProbeModel
from probedesign.live.answer import Answer
from probedesign.live.block import Block
from probedesign.live.mcap import messages, require, topics
from probedesign.live.mcap.answers import messages_of
from probedesign.live.mcap.messages import Nanoseconds
from probedesign.live.mcap.topics import OURS
from probedesign.live.pieces import Pieces
from probedesign.live.pose.timed import TimedPose

PROFILE = "ros2"
JSON = "application/json"
UNITS = {
    "unit_of_force": "N",
    "unit_of_moment": "N m",
    "unit_of_position": "m",
    "unit_in_json": "as names end",
}
MOST = 700
"""Readings that one line tells of: a tenth of a second of the fastest source, so that nobody waits long for Python's
lock while it is written."""
_FAR = 4 * 10**18
"""Half of the nanoseconds that are counted in 63 bits."""


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
        from probedesign.live.mcap.writing import McapWriter

        self._pieces = Pieces(path, force)
        self._held: list[Block] = []
        self._answers: list[Answer] = []
        self._count = 0
        self._first, self._logged, self._begin = 0, time.time_ns(), (0, 0)
        frozen = freeze(model)
        self._writer = McapWriter(self._pieces, PROFILE, frozen["written_by"])
        probe = (json.dumps(frozen, indent=2) + "\n").encode()
        self._writer.attach(f"{model.name}.probe.json", JSON, probe)
        known = {"probe": model.name, "fingerprint": model.fingerprint, "written_by": frozen["written_by"]}
        started = {"started": datetime.now(UTC).isoformat(timespec="seconds")}
        self._writer.note(OURS, known | started | UNITS | dict(about or {}))
        self._channels = {topic.name: self._channel(topic) for topic in topics.TOPICS}
        try:
            self._pieces.flush()
        except OSError:
            self._pieces.abandon()
            raise

    def read(self, block: Block) -> None:
        """Held until the chunk ends, or until a block comes that is not alike."""
        if self._held and not (_alike(self._held[0], block) and self._count < MOST):
            self._write_held()
        self._held.append(block)
        self._count += len(block)

    def _write_held(self) -> None:
        """The answers; then every reading as a wrench, and one line with what their headers cannot tell."""
        self._write_answers()
        if not self._held:
            return
        block, self._held, self._count = _joined(self._held), [], 0
        stamps = messages.nanoseconds(block.time)
        if len(block):
            self._add(
                topics.RAW, stamps, messages.stamped("sensor", stamps, block.wrench_sensor), self._first
            )
        known = {
            "first": self._first,
            "time_s": block.time.tolist(),
            "gravity_base_m_s2": block.gravity_base.tolist(),
            "stretch": block.stretch,
            "fault": block.fault,
        }
        self._first += len(block)
        self._add(topics.BLOCK, stamps[-1:], messages.texts([json.dumps(known)]))

    def answered(self, answer: Answer) -> None:
        """Held as long as the readings are."""
        self._answers.append(answer)

    def _write_answers(self) -> None:
        answers, self._answers = self._answers, []
        for topic, stamps, data in messages_of(answers):
            self._add(topic, stamps, data)

    def posed(self, pose: TimedPose) -> None:
        """Where the base was, as it was told."""
        stamp = messages.nanoseconds([pose.time])
        self._add(topics.BASE, stamp, messages.stamped("world", stamp, [[*pose.p, *pose.q]]))

    def told(self, time: float, line: str) -> None:
        """An event."""
        known = time if math.isfinite(time) else None
        stamp = messages.nanoseconds([] if known is None else [time])
        self._add(topics.EVENT, stamp, messages.texts([json.dumps({"time_s": known, "event": line})]))

    def left_out(self, readings: int, others: int) -> None:
        """Readings and answers that did not come here, as an event and in the count of readings."""
        self._write_held()
        self._first += readings
        self.told(math.nan, f"the disk was too slow: {readings} readings and {others} others left out here")

    def flush(self) -> None:
        """End the chunk and hand it to the operating system."""
        self._write_held()
        self._writer.flush()

    def close(self) -> None:
        """Write what lets other tools find their way, and close."""
        try:
            self._write_held()
            self._writer.finish()
        finally:
            self._pieces.close()

    def _channel(self, topic: topics.Topic) -> int:
        told = {"json_schema": json.dumps(topic.schema)} if topic.schema else {}
        return self._writer.register(topic.name, topic.type, messages.definition(topic.type), told)

    def _add(self, topic: topics.Topic, stamps: Nanoseconds, data: messages.Bytes, sequence: int = 0) -> None:
        """Add messages; logged at the computer's time of the first, moved on by the source's clock. One without a
        stamp is logged with the last."""
        if len(stamps):
            near = np.clip(stamps, -_FAR, _FAR)
            self._begin = self._begin if self._begin[1] else (int(near[0]), time.time_ns())
            stamp, now = self._begin
            logged = now + np.clip(near - stamp, -now, 2 * _FAR - now)
            self._logged = int(logged[-1])
        else:
            logged = np.array([self._logged])
        self._writer.add(self._channels[topic.name], logged, data, sequence)


def _alike(a: Block, b: Block) -> bool:
    """Whether one line can tell of both."""
    return (a.fault, a.stretch) == (b.fault, b.stretch) and np.array_equal(a.gravity_base, b.gravity_base)


def _joined(blocks: list[Block]) -> Block:
    """Blocks that are alike as one."""
    if len(blocks) == 1:
        return blocks[0]
    time, wrench, received = (
        np.concatenate([getattr(block, name) for block in blocks])
        for name in ("time", "wrench_sensor", "received")
    )
    return replace(blocks[0], time=time, wrench_sensor=wrench, received=received, truths=())
