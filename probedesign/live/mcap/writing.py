"""Writing MCAP: the `mcap` package's records, but the messages of a block laid out at once.

The package's own writer takes six microseconds of Python a message; at 7000 readings a second that is taken from
whoever estimates. Here numpy lays out the messages of a block together; every other record is the package's.

Source: the MCAP specification, version 0, mcap.dev/spec.
"""

import struct
import time
import zlib
from collections.abc import Mapping

import numpy as np
import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

from probedesign.live.bag import MCAP
from probedesign.live.mcap.messages import Bytes, Nanoseconds
from probedesign.live.pieces import Pieces

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
        pieces.write(MCAP)
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
        self._pieces.write(MCAP)
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
