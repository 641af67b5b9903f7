"""Writing MCAP: the `mcap` package's records, but the messages of a block laid out at once.

The package's own writer takes six microseconds of Python a message; at 7000 readings a second that is taken from
whoever estimates. Here numpy lays out the messages of a block together; every other record is the package's.

Source: the MCAP specification, version 0, mcap.dev/spec.
"""

import json
import math
import struct
import time
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

from probedesign.deployment import freeze
from probedesign.estimation.model import ProbeModel
from probedesign.frames import Array
from probedesign.live.poses.track import TimedPose
from probedesign.live.processing.blocks import Block
from probedesign.live.processing.estimates import Answer, estimate_row, json_line, world_row
from probedesign.live.recordings import require, schemas
from probedesign.live.recordings.append_file import Pieces
from probedesign.live.recordings.schemas import (
    MCAP_MAGIC,
    OURS,
    Bytes,
    Nanoseconds,
    nanoseconds,
    stamped,
    texts,
)

_PREFIX = struct.Struct("<BQ")
_HEAD = [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("logged", "<u8"),
         ("published", "<u8")]  # fmt: skip
_BEFORE_DATA = 22
"""Of a message's length: channel, sequence and two times."""


class McapWriter:
    """A file of chunks, each a whole piece of it."""

    def __init__(self, pieces: Pieces, profile: str, library: str) -> None:
        """Begin the file; for profile and library see the specification."""
        self._pieces = pieces
        self._schemas: dict[str, records.Schema] = {}
        self._channels: list[records.Channel] = []
        self._indexes: list[records.McapRecord] = []
        self._counts: dict[int, int] = {}
        self._chunks, self._span = 0, (2**63, 0)
        self._begin_chunk()
        pieces.write(MCAP_MAGIC)
        self._write(records.Header(profile, library))

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Attach a file."""
        now, offset = time.time_ns(), self._pieces.tell()
        length = self._write(records.Attachment(now, now, name, media_type, data))
        self._indexes.append(records.AttachmentIndex(offset, length, now, now, len(data), name, media_type))

    def note(self, name: str, known: Mapping[str, str]) -> None:
        """Add metadata."""
        offset = self._pieces.tell()
        length = self._write(records.Metadata(name=name, metadata=dict(known)))
        self._indexes.append(records.MetadataIndex(offset, length, name))

    def register(self, topic: str, kind: str, definition: bytes, known: Mapping[str, str]) -> int:
        """The number of a new channel of CDR messages of that type."""
        if kind not in self._schemas:
            number = len(self._schemas) + 1
            self._schemas[kind] = records.Schema(id=number, data=definition, encoding="ros2msg", name=kind)
            self._hold(_bytes(self._schemas[kind]))
        number = len(self._channels) + 1
        self._channels.append(records.Channel(number, topic, "cdr", dict(known), self._schemas[kind].id))
        self._hold(_bytes(self._channels[-1]))
        return number

    def add(self, channel: int, logged: Nanoseconds, data: Bytes, sequence: int = 0) -> None:
        """Add messages of one length.

        Args:
            channel: of all of them.
            logged: times [ns], (n,).
            data: of each, (n,).
            sequence: of the first; those after it count on.
        """
        n, length = len(data), data.dtype.itemsize
        laid = np.empty(n, np.dtype([*_HEAD, ("data", f"V{length}")]))
        laid["opcode"], laid["length"], laid["channel"] = Opcode.MESSAGE, _BEFORE_DATA + length, channel
        laid["sequence"] = np.arange(sequence, sequence + n) % 2**32
        laid["logged"] = laid["published"] = logged
        laid["data"] = data
        offsets = self._held + laid.dtype.itemsize * np.arange(n)
        self._index.setdefault(channel, []).append(np.stack([logged, offsets], axis=1))
        self._counts[channel] = self._counts.get(channel, 0) + n
        self._hold(laid.tobytes())

    def flush(self) -> None:
        """End the chunk and hand it to the operating system.

        Raises:
            OSError: it does not take it; the file ends where it ended before.
        """
        if self._index:
            self._write_chunk()
            self._begin_chunk()
        self._pieces.flush()

    def finish(self) -> None:
        """Write what lets others find their way, and the end."""
        self.flush()
        self._write(records.DataEnd(0))
        start = self._pieces.tell()
        statistics = records.Statistics(
            attachment_count=sum(isinstance(index, records.AttachmentIndex) for index in self._indexes),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=self._chunks,
            message_count=sum(self._counts.values()),
            metadata_count=sum(isinstance(index, records.MetadataIndex) for index in self._indexes),
            message_start_time=min(self._span[0], self._span[1]),
            message_end_time=self._span[1],
            schema_count=len(self._schemas),
        )
        summary = b"".join(
            map(_bytes, [*self._schemas.values(), *self._channels, statistics, *self._indexes])
        )
        told = _PREFIX.pack(Opcode.FOOTER, 20) + struct.pack("<QQ", start, 0)
        self._pieces.write(summary)
        self._write(records.Footer(start, 0, zlib.crc32(told, zlib.crc32(summary))))
        self._pieces.write(MCAP_MAGIC)
        self._pieces.flush()

    def _begin_chunk(self) -> None:
        self._parts: list[bytes] = []
        self._held = 0
        self._index: dict[int, list[Nanoseconds]] = {}

    def _hold(self, part: bytes) -> None:
        self._parts.append(part)
        self._held += len(part)

    def _write_chunk(self) -> None:
        data = b"".join(self._parts)
        entries = {channel: np.concatenate(index) for channel, index in self._index.items()}
        first = min(int(index[:, 0].min()) for index in entries.values())
        last = max(int(index[:, 0].max()) for index in entries.values())
        packed = zstandard.compress(data)
        start = self._pieces.tell()
        length = self._write(records.Chunk("zstd", packed, last, first, zlib.crc32(data), len(data)))
        offsets = {}
        for channel, index in entries.items():
            offsets[channel] = self._pieces.tell()
            content = struct.pack("<HI", channel, index.nbytes) + index.astype("<u8").tobytes()
            self._pieces.write(_PREFIX.pack(Opcode.MESSAGE_INDEX, len(content)) + content)
        self._indexes.append(
            records.ChunkIndex(
                chunk_length=length,
                chunk_start_offset=start,
                compression="zstd",
                compressed_size=len(packed),
                message_end_time=last,
                message_index_length=self._pieces.tell() - start - length,
                message_index_offsets=offsets,
                message_start_time=first,
                uncompressed_size=len(data),
            )
        )
        self._chunks += 1
        self._span = min(self._span[0], first), max(self._span[1], last)

    def _write(self, record: records.McapRecord) -> int:
        """Write a record; its length."""
        return self._pieces.write(_bytes(record))


def _bytes(record: records.McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    written: bytes = builder.end()
    return written


PROFILE = "ros2"
JSON = "application/json"
UNITS = {
    "unit_of_force": "N",
    "unit_of_moment": "N m",
    "unit_of_position": "m",
    "unit_in_json": "as names end",
}
MAX_BLOCK = 700
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
        self._channels = {topic.name: self._channel(topic) for topic in schemas.TOPICS}
        try:
            self._pieces.flush()
        except OSError:
            self._pieces.abandon()
            raise

    def read(self, block: Block) -> None:
        """Held until the chunk ends, or until a block comes that is not alike."""
        if self._held and not (_alike(self._held[0], block) and self._count < MAX_BLOCK):
            self._write_held()
        self._held.append(block)
        self._count += len(block)

    def _write_held(self) -> None:
        """The answers; then every reading as a wrench, and one line with what their headers cannot tell."""
        self._write_answers()
        if not self._held:
            return
        block, self._held, self._count = _joined_blocks(self._held), [], 0
        stamps = schemas.nanoseconds(block.time)
        if len(block):
            self._add(
                schemas.RAW, stamps, schemas.stamped("sensor", stamps, block.wrench_sensor), self._first
            )
        known = {
            "first": self._first,
            "time_s": block.time.tolist(),
            "gravity_base_m_s2": block.gravity_base.tolist(),
            "stretch": block.stretch,
            "fault": block.fault,
        }
        self._first += len(block)
        self._add(schemas.BLOCK, stamps[-1:], schemas.texts([json.dumps(known)]))

    def answered(self, answer: Answer) -> None:
        """Held as long as the readings are."""
        self._answers.append(answer)

    def _write_answers(self) -> None:
        answers, self._answers = self._answers, []
        for topic, stamps, data in messages_of(answers):
            self._add(topic, stamps, data)

    def posed(self, pose: TimedPose) -> None:
        """Where the base was, as it was told."""
        stamp = schemas.nanoseconds([pose.time])
        self._add(schemas.BASE, stamp, schemas.stamped("world", stamp, [[*pose.p, *pose.q]]))

    def told(self, time: float, line: str) -> None:
        """An event."""
        known = time if math.isfinite(time) else None
        stamp = schemas.nanoseconds([] if known is None else [time])
        self._add(schemas.EVENT, stamp, schemas.texts([json.dumps({"time_s": known, "event": line})]))

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

    def _channel(self, topic: schemas.Topic) -> int:
        told = {"json_schema": json.dumps(topic.schema)} if topic.schema else {}
        return self._writer.register(topic.name, topic.type, schemas.definition(topic.type), told)

    def _add(self, topic: schemas.Topic, stamps: Nanoseconds, data: schemas.Bytes, sequence: int = 0) -> None:
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


def _joined_blocks(blocks: list[Block]) -> Block:
    """Blocks that are alike as one."""
    if len(blocks) == 1:
        return blocks[0]
    time, wrench, received = (
        np.concatenate([getattr(block, name) for block in blocks])
        for name in ("time", "wrench_sensor", "received")
    )
    return replace(blocks[0], time=time, wrench_sensor=wrench, received=received, truths=())


UNKNOWN_ROTATION_VAR = math.pi**2
"""Variance of each angle of a contact's orientation [rad²], which is not estimated: half a turn either way."""

Values = Sequence[tuple[float, list[float]]]
"""Each with its time [s]."""


def messages_of(answers: Sequence[Answer]) -> Iterator[tuple[schemas.Topic, Nanoseconds, Bytes]]:
    """What was said, and what was said it from: by topic the times [ns], (n,), and the messages, (n,)."""
    for topic, frame, values in (
        (schemas.WITHOUT_BIAS, "base", _wrenches(answers)),
        (schemas.CONTACT, "base", _contacts(answers)),
        (schemas.CONTACT_WORLD, "world", _contacts_world(answers)),
    ):
        if values:
            stamps = nanoseconds([time for time, _ in values])
            yield topic, stamps, stamped(frame, stamps, [numbers for _, numbers in values])
    if answers:
        stamps = nanoseconds([answer.reading.time for answer in answers])
        yield schemas.ESTIMATE, stamps, texts([_estimate_json(answer) for answer in answers])


def _wrenches(answers: Sequence[Answer]) -> Values:
    return [(a.reading.time, a.wrench_base.tolist()) for a in answers if np.isfinite(a.wrench_base).all()]


def _contacts(answers: Sequence[Answer]) -> Values:
    found = [(a.reading.time, a.estimate) for a in answers if a.estimate.ok]
    return [(time, _pose_values(e.p_surface_base, e.cov_surface_base)) for time, e in found]


def _contacts_world(answers: Sequence[Answer]) -> Values:
    found = [(a.reading.time, a.fused) for a in answers if a.fused is not None and a.fused.ok]
    return [(time, _pose_values(f.p_surface_world, f.cov_surface_world)) for time, f in found]


def _pose_values(p: Array, cov: Array) -> list[float]:
    """A point as a pose with covariance, (43,); nothing is said of its orientation."""
    whole = UNKNOWN_ROTATION_VAR * np.eye(6)
    whole[:3, :3] = cov
    return [*p.tolist(), 0.0, 0.0, 0.0, 1.0, *whole.ravel().tolist()]


def _estimate_json(answer: Answer) -> str:
    """What was said as JSON, with the pose to the last bit, which a quaternion does not tell."""
    world = world_row(answer) if answer.fused is not None else {}
    line, T = json_line(estimate_row(answer.reading, answer.estimate) | world), answer.T_world_base
    return f'{line[:-1]}, "T_world_base": {json.dumps(T.tolist())}}}' if np.isfinite(T).all() else line
