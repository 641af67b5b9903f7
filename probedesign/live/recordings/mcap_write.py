"""Writes MCAP recordings: raw readings, estimates, poses, events and the frozen probe.

The writer of the `mcap` package takes 6 µs of Python per message; at 7000 readings per second that time is taken from
the estimator. Here numpy lays out all messages of a block at once; every other record is the package's.

Source: the MCAP specification, version 0, mcap.dev/spec.
"""

import json
import struct
import time
import zlib
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

from probedesign.estimation.model import ProbeModel
from probedesign.frozen_probe import freeze
from probedesign.live.recordings import AppendFile, require_mcap, schemas
from probedesign.live.recordings.messages import MessageEncoder, ProbeEncoder
from probedesign.live.recordings.schemas import (
    CLOCK_NAME,
    MCAP_MAGIC,
    METADATA_NAME,
    OFFSET_KEY,
    RECORD_PREFIX,
    Bytes,
    Nanoseconds,
    Topic,
)

_HEAD = [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("logged", "<u8"),
         ("published", "<u8")]  # fmt: skip
_BEFORE_DATA = 22  #: Length of a message record before its data: channel, sequence number and two times [bytes].


class McapWriter:
    """Writes an MCAP file of CDR messages in chunks; each chunk is written completely or not at all."""

    def __init__(self, file: AppendFile, profile: str, library: str) -> None:
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
        """Register a channel; return its number. It is outside the chunks, which may be damaged."""
        if type_name not in self._schemas:
            number = len(self._schemas) + 1
            self._schemas[type_name] = records.Schema(id=number, data=definition, encoding="ros2msg", name=type_name)
            self._write(self._schemas[type_name])
        number = len(self._channels) + 1
        self._channels.append(records.Channel(number, topic, "cdr", dict(metadata), self._schemas[type_name].id))
        self._write(self._channels[-1])
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
        self._chunk.append(laid.tobytes())
        self._pending += laid.nbytes

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
        attachments, metadata = (sum(isinstance(index, kind) for index in self._indexes)
                                 for kind in (records.AttachmentIndex, records.MetadataIndex))  # fmt: skip
        statistics = records.Statistics(
            attachments, len(self._channels), self._counts, self._chunks, sum(self._counts.values()), self._span[1],
            min(self._span), metadata, len(self._schemas),
        )  # fmt: skip
        summary = b"".join(map(_bytes, [*self._schemas.values(), *self._channels, statistics, *self._indexes]))
        footer = RECORD_PREFIX.pack(Opcode.FOOTER, 20) + struct.pack("<QQ", start, 0)
        self._file.write(summary)
        self._write(records.Footer(start, 0, zlib.crc32(footer, zlib.crc32(summary))))
        self._file.write(MCAP_MAGIC)
        self._file.flush()

    def _begin_chunk(self) -> None:
        self._chunk: list[bytes] = []
        self._pending = 0
        self._index: dict[int, list[Nanoseconds]] = {}

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
        end = self._file.tell() - start - length
        chunk = records.ChunkIndex(length, start, "zstd", len(packed), last, end, offsets, first, len(data))
        self._indexes.append(chunk)
        self._chunks += 1
        self._span = min(self._span[0], first), max(self._span[1], last)

    def _write(self, record: records.McapRecord) -> int:
        return self._file.write(_bytes(record))


def _bytes(record: records.McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    written: bytes = builder.end()
    return written


PROFILE = "ros2"
JSON = "application/json"
UNITS = {"unit_of_force": "N", "unit_of_moment": "N m", "unit_of_position": "m", "unit_in_json": "as names end"}


class McapRecorder(MessageEncoder):
    """Records everything to MCAP, for ROS 2 tools and for replay; called from one thread (see `RecordingFile`)."""

    def __init__(
        self, path: Path, *models: ProbeModel, force: bool = False, about: Mapping[str, str] | None = None
    ) -> None:
        """Create the file, with probe and metadata before the first message.

        Args:
            path: path; its folder is created if necessary.
            models: the probe on the sensor, or all of a run with several.
            force: replace an existing file.
            about: additional metadata: the source, the options.

        Raises:
            InputError: the file exists and `force` is not set, it is being written, or it cannot be written.
            MissingDependencyError: the MCAP package is not installed.
        """
        require_mcap()
        super().__init__(*models)
        self._file = AppendFile(path, force)
        self._n_encoded, self.readings = 0, 0
        frozen = [freeze(model) for model in models]
        self._writer = McapWriter(self._file, PROFILE, frozen[0]["written_by"])
        for model, content in zip(models, frozen, strict=True):
            self._writer.attach(f"{model.name}.probe.json", JSON, (json.dumps(content, indent=2) + "\n").encode())
        metadata = {
            "probe": ", ".join(model.name for model in models),
            "fingerprint": ", ".join(model.fingerprint for model in models),
            "written_by": frozen[0]["written_by"],
        }
        started = {"started": datetime.now(UTC).isoformat(timespec="seconds")}
        self._writer.add_metadata(METADATA_NAME, metadata | started | UNITS | dict(about or {}))
        for name, policies in schemas.QOS_METADATA.items():
            self._writer.add_metadata(name, policies)
        self._channels = {
            topic.path: self._writer.register(topic.path, topic.type, schemas.definition(topic.type), topic.metadata)
            for topic in self.topics
        }
        try:
            self._file.flush()
        except OSError:
            self._file.discard()
            raise

    def add(self, topic: Topic, logged: Nanoseconds, data: Bytes, sequence: int = 0) -> None:
        """Add messages to the chunk; see `MessageEncoder`."""
        self._n_encoded += len(data) if topic.name == schemas.RAW.name else 0
        self._writer.add(self._channels[topic.path], logged, data, sequence)

    def on_clock(self, encoder: ProbeEncoder) -> None:
        """Write the offset of the clocks, with which a replay restores the source's clock of a header exactly.

        The static transform follows, so that its time is within that of the recording.
        """
        of = {"probe": encoder.probe} if encoder.probe else {}
        self._writer.add_metadata(CLOCK_NAME, {OFFSET_KEY: str(encoder.clock_offset)} | of)
        encoder.encode_static()

    @property
    def size(self) -> int:
        """Length of the file, with what waits for the next flush [bytes]."""
        return self._file.tell()

    def flush(self) -> None:
        """End the chunk and pass it to the operating system."""
        self.encode()
        self._writer.flush()
        self.readings = self._n_encoded

    def close(self) -> None:
        """Write the summary and close the file."""
        try:
            self.flush()
            self._writer.finish()
        finally:
            self._file.close()
