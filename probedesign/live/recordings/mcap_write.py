"""Writes MCAP recordings: raw readings, estimates, poses, events and the frozen probe.

The writer of the `mcap` package takes 6 µs of Python per message; at 7000 readings per second that time is taken from
the estimator. Here numpy lays out all messages of a block at once; every other record is the package's.

Source: the MCAP specification, version 0, mcap.dev/spec.
"""

import json
import math
import struct
import time
import zlib
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

from probedesign.core.frames import Array
from probedesign.estimation.model import ProbeModel
from probedesign.frozen_probe import freeze
from probedesign.live.poses.track import TimedPose
from probedesign.live.processing.blocks import Block, joined
from probedesign.live.processing.estimates import EstimateUpdate, estimate_row, json_line, world_row
from probedesign.live.recordings import AppendFile, require_mcap, schemas
from probedesign.live.recordings.schemas import (
    MCAP_MAGIC,
    METADATA_NAME,
    RECORD_PREFIX,
    Bytes,
    Nanoseconds,
    nanoseconds,
    stamped,
    texts,
)

_HEAD = [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("logged", "<u8"),
         ("published", "<u8")]  # fmt: skip
_BEFORE_DATA = 22
"""Length of a message record before its data: channel, sequence number and two times [bytes]."""


class McapWriter:
    """Writes an MCAP file in chunks; each chunk is written completely or not at all."""

    def __init__(self, file: AppendFile, profile: str, library: str) -> None:
        """Start the file; see the specification for profile and library."""
        self._file = file
        self._schemas: dict[str, records.Schema] = {}
        self._channels: list[records.Channel] = []
        self._indexes: list[records.McapRecord] = []
        self._counts: dict[int, int] = {}
        self._chunks, self._span = 0, (2**63, 0)
        self._begin_chunk()
        file.write(MCAP_MAGIC)
        self._write(records.Header(profile, library))

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Add an attachment."""
        now, offset = time.time_ns(), self._file.tell()
        length = self._write(records.Attachment(now, now, name, media_type, data))
        self._indexes.append(records.AttachmentIndex(offset, length, now, now, len(data), name, media_type))

    def add_metadata(self, name: str, metadata: Mapping[str, str]) -> None:
        """Add a metadata record."""
        offset = self._file.tell()
        length = self._write(records.Metadata(name=name, metadata=dict(metadata)))
        self._indexes.append(records.MetadataIndex(offset, length, name))

    def register(self, topic: str, type_name: str, definition: bytes, metadata: Mapping[str, str]) -> int:
        """Register a channel of CDR messages of a type; return its number."""
        if type_name not in self._schemas:
            number = len(self._schemas) + 1
            self._schemas[type_name] = records.Schema(
                id=number, data=definition, encoding="ros2msg", name=type_name
            )
            self._append(_bytes(self._schemas[type_name]))
        number = len(self._channels) + 1
        self._channels.append(
            records.Channel(number, topic, "cdr", dict(metadata), self._schemas[type_name].id)
        )
        self._append(_bytes(self._channels[-1]))
        return number

    def add(self, channel: int, logged: Nanoseconds, data: Bytes, sequence: int = 0) -> None:
        """Add messages of equal length.

        Args:
            channel: number of the channel.
            logged: times of recording [ns], (n,).
            data: the messages, (n,).
            sequence: sequence number of the first; the others are consecutive.
        """
        n, length = len(data), data.dtype.itemsize
        laid = np.empty(n, np.dtype([*_HEAD, ("data", f"V{length}")]))
        laid["opcode"], laid["length"], laid["channel"] = Opcode.MESSAGE, _BEFORE_DATA + length, channel
        laid["sequence"] = np.arange(sequence, sequence + n) % 2**32
        laid["logged"] = laid["published"] = logged
        laid["data"] = data
        offsets = self._pending + laid.dtype.itemsize * np.arange(n)
        self._index.setdefault(channel, []).append(np.stack([logged, offsets], axis=1))
        self._counts[channel] = self._counts.get(channel, 0) + n
        self._append(laid.tobytes())

    def flush(self) -> None:
        """End the chunk and pass it to the operating system.

        Raises:
            OSError: it cannot be written; the file is unchanged.
        """
        if self._index:
            self._write_chunk()
            self._begin_chunk()
        self._file.flush()

    def finish(self) -> None:
        """Write the summary and the end of the file."""
        self.flush()
        self._write(records.DataEnd(0))
        start = self._file.tell()
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
        metadata = RECORD_PREFIX.pack(Opcode.FOOTER, 20) + struct.pack("<QQ", start, 0)
        self._file.write(summary)
        self._write(records.Footer(start, 0, zlib.crc32(metadata, zlib.crc32(summary))))
        self._file.write(MCAP_MAGIC)
        self._file.flush()

    def _begin_chunk(self) -> None:
        self._chunk: list[bytes] = []
        self._pending = 0
        self._index: dict[int, list[Nanoseconds]] = {}

    def _append(self, data: bytes) -> None:
        self._chunk.append(data)
        self._pending += len(data)

    def _write_chunk(self) -> None:
        data = b"".join(self._chunk)
        entries = {channel: np.concatenate(index) for channel, index in self._index.items()}
        first = min(int(index[:, 0].min()) for index in entries.values())
        last = max(int(index[:, 0].max()) for index in entries.values())
        packed = zstandard.compress(data)
        start = self._file.tell()
        length = self._write(records.Chunk("zstd", packed, last, first, zlib.crc32(data), len(data)))
        offsets = {}
        for channel, index in entries.items():
            offsets[channel] = self._file.tell()
            content = struct.pack("<HI", channel, index.nbytes) + index.astype("<u8").tobytes()
            self._file.write(RECORD_PREFIX.pack(Opcode.MESSAGE_INDEX, len(content)) + content)
        self._indexes.append(
            records.ChunkIndex(
                chunk_length=length,
                chunk_start_offset=start,
                compression="zstd",
                compressed_size=len(packed),
                message_end_time=last,
                message_index_length=self._file.tell() - start - length,
                message_index_offsets=offsets,
                message_start_time=first,
                uncompressed_size=len(data),
            )
        )
        self._chunks += 1
        self._span = min(self._span[0], first), max(self._span[1], last)

    def _write(self, record: records.McapRecord) -> int:
        """Write a record; return its length."""
        return self._file.write(_bytes(record))


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
"""Maximum number of readings described by one block message: 0.1 s of the fastest source, so that encoding it does not
occupy the interpreter for long."""
_MAX_NS = 4 * 10**18
"""Half the range of 63-bit nanoseconds."""


class McapRecorder:
    """Records everything to MCAP, for ROS 2 tools and for replay; called from one thread (see `RecordingFile`)."""

    def __init__(
        self, path: Path, model: ProbeModel, force: bool = False, about: Mapping[str, str] | None = None
    ) -> None:
        """Create the file, with probe and metadata before the first message.

        Args:
            path: path; its folder is created if necessary.
            model: probe on the sensor.
            force: replace an existing file.
            about: additional metadata: the source, the options.

        Raises:
            InputError: the file exists and `force` is not set, or it cannot be written.
            MissingDependencyError: the MCAP package is not installed.
        """
        require_mcap()
        self._file = AppendFile(path, force)
        self._pending: list[Block] = []
        self._updates: list[EstimateUpdate] = []
        self._count = 0
        self._first, self._logged, self._epoch = 0, time.time_ns(), (0, 0)
        frozen = freeze(model)
        self._writer = McapWriter(self._file, PROFILE, frozen["written_by"])
        probe = (json.dumps(frozen, indent=2) + "\n").encode()
        self._writer.attach(f"{model.name}.probe.json", JSON, probe)
        metadata = {"probe": model.name, "fingerprint": model.fingerprint, "written_by": frozen["written_by"]}
        started = {"started": datetime.now(UTC).isoformat(timespec="seconds")}
        self._writer.add_metadata(METADATA_NAME, metadata | started | UNITS | dict(about or {}))
        self._channels = {topic.name: self._channel(topic) for topic in schemas.TOPICS}
        try:
            self._file.flush()
        except OSError:
            self._file.discard()
            raise

    def on_samples(self, block: Block) -> None:
        """Buffer readings until the chunk ends or the state of the source changes."""
        if self._pending and not (_same_state(self._pending[0], block) and self._count < MAX_BLOCK):
            self._write_pending()
        self._pending.append(block)
        self._count += len(block)

    def _write_pending(self) -> None:
        """Write the estimates, the readings as wrenches, and one message with what their headers do not contain."""
        updates, self._updates = self._updates, []
        for topic, stamps, data in update_messages(updates):
            self._add(topic, stamps, data)
        if not self._pending:
            return
        block, self._pending, self._count = joined(self._pending), [], 0
        stamps = schemas.nanoseconds(block.time)
        if len(block):
            self._add(
                schemas.RAW, stamps, schemas.stamped("sensor", stamps, block.wrench_sensor), self._first
            )
        metadata = {
            "first": self._first,
            "time_s": block.time.tolist(),
            "gravity_base_m_s2": block.gravity_base.tolist(),
            "stretch": block.stretch,
            "fault": block.fault,
        }
        self._first += len(block)
        self._add(schemas.BLOCK, stamps[-1:], schemas.texts([json.dumps(metadata)]))

    def on_estimate(self, update: EstimateUpdate) -> None:
        """Buffer an estimate as long as the readings."""
        self._updates.append(update)

    def on_pose(self, pose: TimedPose) -> None:
        """Write a pose of the base, as received."""
        stamp = schemas.nanoseconds([pose.time])
        self._add(schemas.BASE, stamp, schemas.stamped("world", stamp, [[*pose.p, *pose.q]]))

    def on_event(self, time: float, line: str) -> None:
        """Write an event."""
        metadata = time if math.isfinite(time) else None
        stamp = schemas.nanoseconds([] if metadata is None else [time])
        self._add(schemas.EVENT, stamp, schemas.texts([json.dumps({"time_s": metadata, "event": line})]))

    def on_dropped(self, readings: int, others: int) -> None:
        """Write the numbers of dropped readings and others as an event, and count the readings."""
        self._write_pending()
        self._first += readings
        self.on_event(
            math.nan, f"the disk was too slow: {readings} readings and {others} other messages dropped here"
        )

    def flush(self) -> None:
        """End the chunk and pass it to the operating system."""
        self._write_pending()
        self._writer.flush()

    def close(self) -> None:
        """Write the summary and close the file."""
        try:
            self._write_pending()
            self._writer.finish()
        finally:
            self._file.close()

    def _channel(self, topic: schemas.Topic) -> int:
        metadata = {"json_schema": json.dumps(topic.schema)} if topic.schema else {}
        return self._writer.register(topic.name, topic.type, schemas.definition(topic.type), metadata)

    def _add(self, topic: schemas.Topic, stamps: Nanoseconds, data: schemas.Bytes, sequence: int = 0) -> None:
        """Add messages, logged at the computer's time of the first message plus the source's time since then.

        A message without time stamp is logged at the time of the last one.
        """
        if len(stamps):
            near = np.clip(stamps, -_MAX_NS, _MAX_NS)
            self._epoch = self._epoch if self._epoch[1] else (int(near[0]), time.time_ns())
            stamp, now = self._epoch
            logged = now + np.clip(near - stamp, -now, 2 * _MAX_NS - now)
            self._logged = int(logged[-1])
        else:
            logged = np.array([self._logged])
        self._writer.add(self._channels[topic.name], logged, data, sequence)


def _same_state(a: Block, b: Block) -> bool:
    """Return whether one block message can describe both blocks."""
    return (a.fault, a.stretch) == (b.fault, b.stretch) and np.array_equal(a.gravity_base, b.gravity_base)


UNKNOWN_ROTATION_VAR = math.pi**2
"""Variance of each angle of a contact's orientation [rad²], which is not estimated: π in each direction."""


def update_messages(updates: Sequence[EstimateUpdate]) -> Iterator[tuple[schemas.Topic, Nanoseconds, Bytes]]:
    """Yield for each topic the times [ns], (n,), and the messages, (n,), of estimates.

    Messages are encoded together: one by one they take five times as long.
    """
    contacts = [(a.reading.time, a.estimate) for a in updates if a.estimate.ok]
    fused = [(a.reading.time, a.fused) for a in updates if a.fused is not None and a.fused.ok]
    wrenches = [(a.reading.time, a.wrench_base.tolist()) for a in updates if np.isfinite(a.wrench_base).all()]
    found = [(t, _pose_values(e.p_surface_base, e.cov_surface_base)) for t, e in contacts]
    found_world = [(t, _pose_values(f.p_surface_world, f.cov_surface_world)) for t, f in fused]
    for topic, frame, values in (
        (schemas.WITHOUT_BIAS, "base", wrenches),
        (schemas.CONTACT, "base", found),
        (schemas.CONTACT_WORLD, "world", found_world),
    ):
        if values:
            stamps = nanoseconds([time for time, _ in values])
            yield topic, stamps, stamped(frame, stamps, [numbers for _, numbers in values])
    if updates:
        stamps = nanoseconds([update.reading.time for update in updates])
        yield schemas.ESTIMATE, stamps, texts([_estimate_json(update) for update in updates])


def _pose_values(p: Array, cov: Array) -> list[float]:
    """Return a point as a pose with covariance, (43,), with unknown orientation."""
    whole = UNKNOWN_ROTATION_VAR * np.eye(6)
    whole[:3, :3] = cov
    return [*p.tolist(), 0.0, 0.0, 0.0, 1.0, *whole.ravel().tolist()]


def _estimate_json(update: EstimateUpdate) -> str:
    """Return the estimate as JSON with the exact pose of the base, which a quaternion does not represent."""
    world = world_row(update) if update.fused is not None else {}
    line, T = json_line(estimate_row(update.reading, update.estimate) | world), update.T_world_base
    return f'{line[:-1]}, "T_world_base": {json.dumps(T.tolist())}}}' if np.isfinite(T).all() else line
