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


JSON = "application/json"
UNITS = {"unit_of_force": "N", "unit_of_moment": "N m", "unit_of_position": "m", "unit_in_json": "as names end"}


class McapRecorder(MessageEncoder):
    """Records everything to MCAP, for ROS 2 tools and for replay; called from one thread (see `RecordingFile`).

    Messages are in chunks, each of which is written completely or not at all.
    """

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
        self._file, self._n_encoded, self.readings = AppendFile(path, force), 0, 0
        self._schemas, self._channels = dict[str, records.Schema](), dict[str, records.Channel]()
        self._indexes, self._counts = list[records.McapRecord](), dict[int, int]()
        self._chunks, self._span = 0, (2**63, 0)
        self._begin_chunk()
        frozen = [freeze(model) for model in models]
        self._file.write(MCAP_MAGIC)
        self._write(records.Header("ros2", frozen[0]["written_by"]))
        for model, content in zip(models, frozen, strict=True):
            name, data = f"{model.name}.probe.json", (json.dumps(content, indent=2) + "\n").encode()
            now, offset = time.time_ns(), self._file.tell()
            length = self._write(records.Attachment(now, now, name, JSON, data))
            self._indexes.append(records.AttachmentIndex(offset, length, now, now, len(data), name, JSON))
        metadata = {
            "probe": ", ".join(model.name for model in models),
            "fingerprint": ", ".join(model.fingerprint for model in models),
            "written_by": frozen[0]["written_by"],
            "started": datetime.now(UTC).isoformat(timespec="seconds"),
        }
        self._add_metadata(METADATA_NAME, metadata | UNITS | dict(about or {}))
        for name, policies in schemas.QOS_METADATA.items():
            self._add_metadata(name, policies)
        for topic in self.topics:  # outside the chunks, which may be damaged
            if topic.type not in self._schemas:
                schema = records.Schema(
                    id=len(self._schemas) + 1, data=schemas.definition(topic.type), encoding="ros2msg", name=topic.type
                )
                self._schemas[topic.type] = schema
                self._write(schema)
            schema_id, number = self._schemas[topic.type].id, len(self._channels) + 1
            self._channels[topic.path] = records.Channel(number, topic.path, "cdr", topic.metadata, schema_id)
            self._write(self._channels[topic.path])
        try:
            self._file.flush()
        except OSError:
            self._file.discard()
            raise

    def add(self, topic: Topic, logged: Nanoseconds, data: Bytes, sequence: int = 0) -> None:
        """Add messages of equal length to the chunk; see `MessageEncoder`."""
        n, length, channel = len(data), data.dtype.itemsize, self._channels[topic.path].id
        self._n_encoded += n if topic.name == schemas.RAW.name else 0
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

    def on_clock(self, encoder: ProbeEncoder) -> None:
        """Write the offset of the clocks, with which a replay restores the source's clock of a header exactly.

        The static transform follows, so that its time is within that of the recording.
        """
        of = {"probe": encoder.probe} if encoder.probe else {}
        self._add_metadata(CLOCK_NAME, {OFFSET_KEY: str(encoder.clock_offset)} | of)
        encoder.encode_static()

    def flush(self) -> None:
        """End the chunk and pass it to the operating system; raises OSError, which leaves the file unchanged."""
        self.encode()
        if self._index:
            self._write_chunk()
            self._begin_chunk()
        self._file.flush()
        self.readings = self._n_encoded

    def close(self) -> None:
        """Write the summary and close the file."""
        try:
            self.flush()
            self._write(records.DataEnd(0))
            start = self._file.tell()
            attachments, metadata = (sum(isinstance(index, kind) for index in self._indexes)
                                     for kind in (records.AttachmentIndex, records.MetadataIndex))  # fmt: skip
            statistics = records.Statistics(
                attachments, len(self._channels), self._counts, self._chunks, sum(self._counts.values()),
                self._span[1], min(self._span), metadata, len(self._schemas),
            )  # fmt: skip
            rows = [*self._schemas.values(), *self._channels.values(), statistics, *self._indexes]
            summary = b"".join(map(_bytes, rows))
            footer = RECORD_PREFIX.pack(Opcode.FOOTER, 20) + struct.pack("<QQ", start, 0)
            self._file.write(summary)
            self._write(records.Footer(start, 0, zlib.crc32(footer, zlib.crc32(summary))))
            self._file.write(MCAP_MAGIC)
            self._file.flush()
        finally:
            self._file.close()

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

    def _add_metadata(self, name: str, metadata: Mapping[str, str]) -> None:
        offset = self._file.tell()
        length = self._write(records.Metadata(name=name, metadata=dict(metadata)))
        self._indexes.append(records.MetadataIndex(offset, length, name))

    def _write(self, record: records.McapRecord) -> int:
        return self._file.write(_bytes(record))


def _bytes(record: records.McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    written: bytes = builder.end()
    return written
