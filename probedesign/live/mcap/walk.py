"""The records of an MCAP file, read by somebody who trusts nothing in it.

What the records say is parsed by the `mcap` package; how long they claim to be is checked here first, so that
no file makes us take memory that it does not itself fill.
"""

import os
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

LONGEST = 256 * 1024 * 1024
"""No record and no unpacked chunk is longer [bytes]: writers aim at one megabyte, large images included."""
Record = TypeVar("Record", bound=records.McapRecord)
_PREFIX = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")

Message = tuple[int, int, int, int, memoryview]
"""Channel, sequence, when it was logged and when published [ns], and data."""


class DamagedError(Exception):
    """The file goes on in a way that no writer meant; the text says how."""


def walk(file: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Opcode and content of each record from here to the footer, which comes too.

    Raises:
        DamagedError: the file ends before the footer, or a record is longer than any.
    """
    opcode, end = 0, os.fstat(file.fileno()).st_size
    while opcode != Opcode.FOOTER:
        prefix = file.read(_PREFIX.size)
        if len(prefix) < _PREFIX.size:
            raise DamagedError("it was cut off")
        opcode, length = _PREFIX.unpack(prefix)
        if not 0 < opcode < 128 or length > LONGEST:
            raise DamagedError(f"a record of kind {opcode} claims {length} bytes")
        if length > end - file.tell():
            raise DamagedError("it was cut off")
        yield opcode, file.read(length)


def parse(kind: type[Record], content: bytes) -> Record:
    """A record as the `mcap` package reads it.

    Raises:
        DamagedError: it is none.
    """
    try:
        record: Record = kind.read(ReadDataStream(BytesIO(content)))  # type: ignore[attr-defined]
    except Exception as error:  # it was written for honest files: whatever it meets here is the file's fault
        raise DamagedError(f"a {kind.__name__} record cannot be read ({type(error).__name__})") from None
    return record


def unpack(content: bytes) -> bytes:
    """What a chunk holds.

    Raises:
        DamagedError: it does not unpack to what it says it does.
    """
    chunk = parse(records.Chunk, content)
    size = chunk.uncompressed_size
    if size > LONGEST:
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
    """Opcode and content of each record in a chunk.

    Raises:
        DamagedError: the last does not end with the chunk.
    """
    at, view = 0, memoryview(data)
    while at < len(view):
        if at + _PREFIX.size > len(view):
            raise DamagedError("a chunk ends in part of a record")
        opcode, length = _PREFIX.unpack_from(view, at)
        at += _PREFIX.size
        if length > len(view) - at:
            raise DamagedError("a chunk ends in part of a record")
        yield opcode, view[at : at + length]
        at += length


def message(content: memoryview) -> Message:
    """The message that a record holds.

    Raises:
        DamagedError: it is too short for one.
    """
    if len(content) < _MESSAGE.size:
        raise DamagedError("a message is too short")
    channel, sequence, logged, published = _MESSAGE.unpack_from(content)
    return channel, sequence, logged, published, content[_MESSAGE.size :]
