"""Reads MCAP files without trusting them, and recovers files that were not closed or are damaged.

The `mcap` package parses the records; claimed lengths are checked here first, so that no file makes the program
allocate memory that the file does not fill.
"""

import json
import os
import re
import secrets
import struct
import zlib
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, TypeVar

import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.writer import Writer

from probedesign.core.errors import InputError
from probedesign.core.files import check_overwrite
from probedesign.live.recordings.schemas import (
    CLOCK_NAME,
    MCAP_MAGIC,
    OFFSET_KEY,
    RECORD_PREFIX,
    BagTopic,
    Message,
    ros_name,
)

#: Maximum length of a record and of an unpacked chunk [bytes]: writers use chunks of 1 MB, plus large images.
MAX_RECORD = 256 * 1024 * 1024
#: Maximum ratio of a chunk's size to that of its compressed content, from `FREE_SIZE` bytes on: readings without noise
#: reach 9, a file of zeros 30,000.
MAX_RATIO, FREE_SIZE = 200, 2_000_000
Record = TypeVar("Record", bound=records.McapRecord)
_MESSAGE_HEAD = struct.Struct("<HIQQ")


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
        chunk = _next_chunk(file, start + 1)
        if chunk is None:
            return
        file.seek(chunk)


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
            file.seek(offset)
            with suppress(DamagedError):
                opcode, content = next(walk(file))
                if opcode == Opcode.CHUNK:
                    unpack(content)
                    return offset
            failed += 1
            if failed == MAX_CANDIDATES:
                return None
        if len(data) < _SEARCHED:
            return None
        at += _SEARCHED - _BEFORE_COMPRESSION
    return None


def intact_records(file: BinaryIO, damage: Damage) -> Iterator[tuple[int, bytes | memoryview]]:
    """Yield records like `walk_intact`, and those in a chunk, up to its first damage, instead of the chunk."""
    for opcode, content in walk_intact(file, damage):
        if opcode != Opcode.CHUNK:
            yield opcode, content
            continue
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
    if size > min(MAX_RECORD, max(MAX_RATIO * len(chunk.data), FREE_SIZE)):
        raise DamagedError(f"a chunk of {len(chunk.data)} bytes claims to contain {size}")
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
        if not opcode or length > len(view) - at:
            raise DamagedError("a chunk ends in part of a record")
        yield opcode, view[at : at + length]
        at += length


def split_message(content: memoryview) -> tuple[int, int, int, int, memoryview]:
    """Return channel, sequence number, time of recording and of publication [ns], and data of a message record.

    Raises:
        DamagedError: it is too short.
    """
    if len(content) < _MESSAGE_HEAD.size:
        raise DamagedError("a message is too short")
    channel, sequence, logged, published = _MESSAGE_HEAD.unpack_from(content)
    return channel, sequence, logged, published, content[_MESSAGE_HEAD.size :]


OFFSET = re.compile(r"-?[0-9]{1,19}")
FOOTER_AND_MAGIC = 9 + 20 + 8
MAX_PROBE_BYTES = 10_000_000  #: Maximum length of an attachment that is read as a frozen probe [bytes].


class McapBag:
    """An MCAP file as a bag, see `Bag`; damaged parts are skipped, and metadata precede the first message."""

    def __init__(self, path: Path) -> None:
        """Read the records before the first message.

        Raises:
            InputError: the file is not MCAP.
        """
        self.path, self._damage = path, Damage()
        self.clock_offsets, self.metadata = dict[str, int](), dict[str, dict[str, str]]()
        self.probes, self._channels, self._schemas = list[dict[str, object]](), dict[int, BagTopic](), dict[int, str]()
        try:
            with path.open("rb") as file:
                if file.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
                    raise InputError(f"{path}: not an MCAP file: wrong first bytes")
                for opcode, content in walk(file):
                    if opcode == Opcode.ATTACHMENT and len(content) < MAX_PROBE_BYTES:
                        attachment = parse(records.Attachment, content)
                        if attachment.name.endswith(".probe.json"):
                            try:
                                probe = json.loads(attachment.data)
                            except (ValueError, RecursionError):
                                raise DamagedError("the frozen probe in it is not JSON") from None
                            self.probes += [probe] if isinstance(probe, dict) else []
                    elif opcode in (Opcode.METADATA, Opcode.SCHEMA, Opcode.CHANNEL):
                        self._register(opcode, content)
                    elif opcode not in (Opcode.HEADER, Opcode.ATTACHMENT):
                        break
        except DamagedError as error:
            self._damage.add(str(error))
        except OSError as error:
            missing = isinstance(error, FileNotFoundError)
            why = "no such recording" if missing else f"cannot be read: {error.strerror}"
            raise InputError(f"{path}: {why}") from None

    @property
    def damage(self) -> str:
        """Description of the damage, as far as the file was read; empty if none."""
        return str(self._damage)

    def channels(self) -> list[BagTopic]:
        """Return all channels, from the summary at the end or by reading the whole file; see `Bag`."""
        try:
            with self.path.open("rb") as file:
                size = file.seek(0, 2)
                file.seek(max(size - FOOTER_AND_MAGIC, len(MCAP_MAGIC)))
                footers = [parse(records.Footer, content) for opcode, content in walk(file) if opcode == Opcode.FOOTER]
                if len(footers) != 1 or file.read() != MCAP_MAGIC or not 0 < footers[0].summary_start < size:
                    raise DamagedError("it has no summary")
                file.seek(footers[0].summary_start)
                for opcode, content in walk(file):
                    self._register(opcode, content)
        except DamagedError:
            for _ in self.messages(()):
                pass
        return list(dict.fromkeys(self._channels.values()))

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Yield the messages of the topics; see `Bag`."""
        self._channels, self._schemas, self._damage = {}, {}, Damage()
        try:
            with self.path.open("rb") as file:
                file.seek(len(MCAP_MAGIC))
                for opcode, content in intact_records(file, self._damage):
                    if opcode == Opcode.DATA_END:
                        return
                    try:
                        if opcode != Opcode.MESSAGE:
                            self._register(opcode, bytes(content))
                            continue
                        number, _, logged, _, data = split_message(memoryview(content))
                        channel = self._channels.get(number)
                        if channel is None:
                            raise DamagedError(f"a message belongs to channel {number}, which does not exist")
                    except DamagedError as error:
                        self._damage.add(str(error))
                        continue
                    if channel.topic in topics:
                        yield Message(channel.topic, logged, data)
        except OSError as error:
            raise InputError(f"{self.path}: cannot be read: {error.strerror}") from None

    def _register(self, opcode: int, content: bytes) -> None:
        """Store a schema, a channel or metadata."""
        if opcode == Opcode.SCHEMA:
            schema = parse(records.Schema, content)
            self._schemas[schema.id] = schema.name
        elif opcode == Opcode.CHANNEL:
            channel = parse(records.Channel, content)
            name = self._schemas.get(channel.schema_id, "")
            self._channels[channel.id] = BagTopic(channel.topic, name, channel.message_encoding)
        elif opcode == Opcode.METADATA:
            metadata = parse(records.Metadata, content)
            self.metadata.setdefault(metadata.name, metadata.metadata)
            if metadata.name == CLOCK_NAME and OFFSET.fullmatch(text := metadata.metadata.get(OFFSET_KEY, "")):
                probe = metadata.metadata.get("probe", "")
                self.clock_offsets[f"/{ros_name(probe)}/" if probe else ""] = int(text)


@dataclass(frozen=True)
class RecoveryResult:
    """Result of a recovery."""

    path: Path | None  #: path of the new file; None if the old file is not damaged.
    messages: int  #: number of messages.
    seconds: float  #: time from the first to the last message [s].
    damage: str  #: description of the damage of the old file.


class _RecordCopier:
    """Copies records of one file to another and renumbers schemas and channels."""

    def __init__(self, writer: Writer) -> None:
        self._writer, self._schemas, self._channels = writer, {0: 0}, dict[int, int]()
        self.messages, self.first, self.last = 0, 0, 0

    def copy(self, file: BinaryIO) -> str:
        """Copy a file record by record; return its damage, empty at a regular end."""
        damage, ended = Damage(), False
        try:
            for i, (opcode, content) in enumerate(intact_records(file, damage)):
                if i == 0 and opcode != Opcode.HEADER:
                    return "its records do not begin with a header"
                ended = ended or opcode == Opcode.DATA_END
                if not ended and (i == 0 or opcode != Opcode.HEADER):
                    try:
                        self._copy_record(opcode, bytes(content))
                    except DamagedError as error:
                        damage.add(str(error))
        except struct.error:
            return "it names more channels than there can be"
        if not str(damage) and not (ended and file.read() == MCAP_MAGIC):
            return "it was cut off"
        return str(damage)

    def _copy_record(self, opcode: int, content: bytes) -> None:
        writer = self._writer
        if opcode == Opcode.HEADER:
            header = parse(records.Header, content)
            writer.start(header.profile, header.library)
        elif opcode == Opcode.ATTACHMENT:
            a = parse(records.Attachment, content)
            writer.add_attachment(a.create_time, a.log_time, a.name, a.media_type, a.data)
        elif opcode == Opcode.METADATA:
            metadata = parse(records.Metadata, content)
            writer.add_metadata(metadata.name, metadata.metadata)
        elif opcode == Opcode.SCHEMA:
            schema = parse(records.Schema, content)
            if schema.id not in self._schemas:
                self._schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
        elif opcode == Opcode.CHANNEL:
            channel = parse(records.Channel, content)
            if channel.schema_id not in self._schemas:
                raise DamagedError(f"channel {channel.id} has no schema")
            if channel.id not in self._channels:
                self._channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, self._schemas[channel.schema_id], channel.metadata
                )
        elif opcode == Opcode.MESSAGE:
            number, sequence, logged, published, data = split_message(memoryview(content))
            if number not in self._channels:
                raise DamagedError(f"a message belongs to channel {number}, which does not exist")
            writer.add_message(self._channels[number], logged, bytes(data), published, sequence)
            self.first = min(self.first, logged) if self.messages else logged
            self.messages, self.last = self.messages + 1, max(self.last, logged)


def recover(path: Path, out: Path, force: bool = False) -> RecoveryResult:
    """Copy the undamaged parts of an MCAP file to a new file that every tool can open.

    Args:
        path: path of the truncated or damaged file.
        out: path of the new file.
        force: replace an existing file.

    Raises:
        InputError: the file does not exist, contains no readable message, or `out` exists or cannot be written.
    """
    check_overwrite(out, force)
    if out.exists() and out.samefile(path):
        raise InputError(f"{out}: is the input file; choose another name")
    temporary = out.with_name(f".{out.name}.{secrets.token_hex(4)}")
    try:
        with path.open("rb") as file:
            if file.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
                raise InputError(f"{path}: not an MCAP file: wrong first bytes")
            out.parent.mkdir(parents=True, exist_ok=True)
            with temporary.open("xb") as written:
                writer = Writer(written)
                copier = _RecordCopier(writer)
                damage = copier.copy(file)
                if damage and copier.messages:
                    writer.finish()
        if damage and not copier.messages:
            raise InputError(f"{path}: contains no readable message: {damage}")
        seconds = (copier.last - copier.first) / 1e9
        if not damage:
            return RecoveryResult(None, copier.messages, seconds, "")
        os.replace(temporary, out)
        return RecoveryResult(out, copier.messages, seconds, damage)
    except FileNotFoundError:
        raise InputError(f"{path}: no such recording") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be recovered to {out}: {error.strerror}") from None
    finally:
        temporary.unlink(missing_ok=True)
