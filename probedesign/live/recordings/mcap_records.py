"""Records of an MCAP file that is not trusted: lengths, checksums, and the search for the next intact chunk.

The `mcap` package parses the records; claimed lengths are checked here first, so that no file makes the program
allocate memory that the file does not fill.
"""

import os
import re
import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import BinaryIO, TypeVar

import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode

from probedesign.live.recordings.schemas import RECORD_PREFIX

#: Maximum length of a record and of an unpacked chunk [bytes]: writers use chunks of 1 MB, plus large images.
MAX_RECORD = 256 * 1024 * 1024
Record = TypeVar("Record", bound=records.McapRecord)
_MESSAGE_HEAD = struct.Struct("<HIQQ")

#: Channel, sequence number, time of recording and of publication [ns], and data.
RawMessage = tuple[int, int, int, int, memoryview]


class DamagedError(Exception):
    """The file is damaged; the text describes how."""


def walk(file: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and content of each record up to and including the footer.

    Raises:
        DamagedError: the file ends before the footer, or a record is too long.
    """
    opcode, end = 0, os.fstat(file.fileno()).st_size
    while opcode != Opcode.FOOTER:
        prefix = file.read(RECORD_PREFIX.size)
        if len(prefix) < RECORD_PREFIX.size:
            raise DamagedError("it was cut off")
        opcode, length = RECORD_PREFIX.unpack(prefix)
        if not 0 < opcode < 128 or length > MAX_RECORD:
            raise DamagedError(f"a record of kind {opcode} claims {length} bytes")
        if length > end - file.tell():
            raise DamagedError("it was cut off")
        yield opcode, file.read(length)


class Damage:
    """The damage found in a file: the first place, and how many there are."""

    def __init__(self) -> None:
        self._first, self._count = "", 0

    def add(self, text: str) -> None:
        """Count a damaged place."""
        self._first, self._count = self._first or text, self._count + 1

    def __str__(self) -> str:
        return self._first + (f", and damage at {self._count - 1} more places" if self._count > 1 else "")


#: Maximum number of places that look like a chunk and are none, before the search for one ends: each is unpacked.
MAX_CANDIDATES = 16
#: The compression in a chunk, by which its beginning is found.
_COMPRESSIONS = re.compile(rb"\x04\0\0\0zstd|\x03\0\0\0lz4")
#: Length of a chunk record before its compression: prefix, two times, uncompressed size and checksum [bytes].
_BEFORE_COMPRESSION = RECORD_PREFIX.size + 28
_SEARCHED = 1 << 20


def walk_intact(file: BinaryIO, damage: Damage) -> Iterator[tuple[int, bytes]]:
    """Yield records like `walk`; after a damaged prefix it continues at the next intact chunk."""
    while True:
        start = file.tell()
        try:
            for opcode, content in walk(file):
                yield opcode, content
                start = file.tell()
            return
        except DamagedError as error:
            damage.add(str(error))
        found = _next_chunk(file, start + 1)
        if found is None:
            return
        file.seek(found)


def _next_chunk(file: BinaryIO, start: int) -> int | None:
    """Return the offset of the next chunk that matches its checksum, from an offset on; None if there is none."""
    failed, at = 0, start
    while failed < MAX_CANDIDATES:
        file.seek(at)
        data = file.read(_SEARCHED)
        for match in _COMPRESSIONS.finditer(data):
            offset = at + match.start() - _BEFORE_COMPRESSION
            if offset < start:
                continue
            if _is_chunk(file, offset):
                return offset
            failed += 1
            if failed == MAX_CANDIDATES:
                return None
        if len(data) < _SEARCHED:
            return None
        at += _SEARCHED - _BEFORE_COMPRESSION
    return None


def _is_chunk(file: BinaryIO, offset: int) -> bool:
    file.seek(offset)
    try:
        opcode, content = next(walk(file))
        if opcode == Opcode.CHUNK:
            unpack(content)
    except DamagedError:
        return False
    return opcode == Opcode.CHUNK


def split_intact(content: bytes, damage: Damage) -> Iterator[tuple[int, memoryview]]:
    """Yield opcode and content of the records of a chunk, up to its first damage."""
    try:
        yield from split(unpack(content))
    except DamagedError as error:
        damage.add(str(error))


def parse(kind: type[Record], content: bytes) -> Record:
    """Return a record parsed by the `mcap` package.

    Raises:
        DamagedError: it cannot be parsed.
    """
    try:
        record: Record = kind.read(ReadDataStream(BytesIO(content)))  # type: ignore[attr-defined]  # not in its stubs
    except Exception as error:  # the package does not validate: any exception is the file's fault
        raise DamagedError(f"a {kind.__name__} record cannot be read ({type(error).__name__})") from None
    return record


def unpack(content: bytes) -> bytes:
    """Return the content of a chunk.

    Raises:
        DamagedError: the content does not match the length or the checksum of the chunk.
    """
    chunk = parse(records.Chunk, content)
    size = chunk.uncompressed_size
    if size > MAX_RECORD:
        raise DamagedError(f"a chunk claims {size} bytes")
    try:
        match chunk.compression:
            case "":
                data = chunk.data
            case "zstd":
                data = zstandard.ZstdDecompressor().stream_reader(chunk.data).read(size + 1)
            case "lz4":
                data = LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
            case other:
                raise DamagedError(f"a chunk is compressed by {other[:20]!r}; zstd and lz4 are known")
    except (zstandard.ZstdError, RuntimeError, MemoryError):
        raise DamagedError("a chunk does not unpack") from None
    if len(data) != size or (chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc):
        raise DamagedError("a chunk does not match its own checksum")
    return bytes(data)


def split(data: bytes) -> Iterator[tuple[int, memoryview]]:
    """Yield opcode and content of each record in a chunk.

    Raises:
        DamagedError: the last record does not end with the chunk.
    """
    at, view = 0, memoryview(data)
    while at < len(view):
        if at + RECORD_PREFIX.size > len(view):
            raise DamagedError("a chunk ends in part of a record")
        opcode, length = RECORD_PREFIX.unpack_from(view, at)
        at += RECORD_PREFIX.size
        if length > len(view) - at:
            raise DamagedError("a chunk ends in part of a record")
        yield opcode, view[at : at + length]
        at += length


def split_message(content: memoryview) -> RawMessage:
    """Return the fields of a message record.

    Raises:
        DamagedError: it is too short.
    """
    if len(content) < _MESSAGE_HEAD.size:
        raise DamagedError("a message is too short")
    channel, sequence, logged, published = _MESSAGE_HEAD.unpack_from(content)
    return channel, sequence, logged, published, content[_MESSAGE_HEAD.size :]
