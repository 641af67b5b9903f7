"""Reads MCAP files without trusting them, and recovers files that were not closed.

The `mcap` package parses the records; claimed lengths are checked here first, so that no file makes the program
allocate memory that the file does not fill.
"""

import json
import os
import struct
import tempfile
import zlib
from collections.abc import Collection, Iterator
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
from probedesign.live.recordings.schemas import MCAP_MAGIC, RECORD_PREFIX, BagTopic, Message

MAX_RECORD = 256 * 1024 * 1024
"""Maximum length of a record and of an unpacked chunk [bytes]: writers use chunks of 1 MB, plus large images."""
Record = TypeVar("Record", bound=records.McapRecord)
_MESSAGE_HEAD = struct.Struct("<HIQQ")

RawMessage = tuple[int, int, int, int, memoryview]
"""Channel, sequence number, time of recording and of publication [ns], and data."""


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


FOOTER_AND_MAGIC = 9 + 20 + 8
MAX_PROBE_BYTES = 10_000_000
"""Maximum length of an attachment that is read as a frozen probe [bytes]."""


class McapBag:
    """An MCAP file as a bag; a damaged file is read up to the damage.

    Attributes:
        path: path of the file.
        damage: description of the damage, as far as the file was read; empty if none.
        metadata: metadata by name, as far as they precede the first message.
        probe: attached frozen probe, if any.
    """

    def __init__(self, path: Path) -> None:
        """Read the records before the first message.

        Raises:
            InputError: the file is not MCAP.
        """
        self.path, self.damage = path, ""
        self.metadata: dict[str, dict[str, str]] = {}
        self.probe: dict[str, object] | None = None
        self._channels: dict[int, BagTopic] = {}
        self._schemas: dict[int, str] = {}
        try:
            self._read_head()
        except FileNotFoundError:
            raise InputError(f"{path}: no such recording") from None
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror}") from None

    def channels(self) -> list[BagTopic]:
        """Return all channels, from the summary at the end or by reading the whole file; see `Bag`."""
        try:
            self._read_summary()
        except DamagedError:
            for _ in self.messages(()):
                pass
        return list(dict.fromkeys(self._channels.values()))

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Yield the messages of the topics; see `Bag`."""
        self._channels, self._schemas = {}, {}
        try:
            for opcode, content in self._records():
                if opcode == Opcode.MESSAGE:
                    number, _, logged, _, data = split_message(memoryview(content))
                    channel = self._channels.get(number)
                    if channel is None:
                        raise DamagedError(f"a message belongs to channel {number}, which does not exist")
                    if channel.topic in topics:
                        yield Message(channel.topic, logged, data)
                else:
                    self._register(opcode, bytes(content))
        except DamagedError as error:
            self.damage = str(error)
        except OSError as error:
            raise InputError(f"{self.path}: cannot be read: {error.strerror}") from None

    def _records(self) -> Iterator[tuple[int, bytes | memoryview]]:
        """Yield all records up to the end of the data, including those in chunks."""
        with self.path.open("rb") as file:
            file.seek(len(MCAP_MAGIC))
            for opcode, content in walk(file):
                if opcode == Opcode.CHUNK:
                    yield from split(unpack(content))
                elif opcode == Opcode.DATA_END:
                    return
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
                    yield opcode, content

    def _register(self, opcode: int, content: bytes) -> None:
        """Store a schema or a channel."""
        if opcode == Opcode.SCHEMA:
            schema = parse(records.Schema, content)
            self._schemas[schema.id] = schema.name
        elif opcode == Opcode.CHANNEL:
            channel = parse(records.Channel, content)
            name = self._schemas.get(channel.schema_id, "")
            self._channels[channel.id] = BagTopic(channel.topic, name, channel.message_encoding)

    def _read_head(self) -> None:
        with self.path.open("rb") as file:
            if file.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
                raise InputError(f"{self.path}: not an MCAP file: wrong first bytes")
            try:
                for opcode, content in walk(file):
                    if opcode == Opcode.ATTACHMENT and len(content) < MAX_PROBE_BYTES:
                        self._read_attachment(parse(records.Attachment, content))
                    elif opcode == Opcode.METADATA:
                        metadata = parse(records.Metadata, content)
                        self.metadata[metadata.name] = metadata.metadata
                    elif opcode not in (Opcode.HEADER, Opcode.ATTACHMENT):
                        return
            except DamagedError as error:
                self.damage = str(error)

    def _read_attachment(self, attachment: records.Attachment) -> None:
        if attachment.name.endswith(".probe.json"):
            try:
                probe = json.loads(attachment.data)
            except (ValueError, RecursionError):
                raise DamagedError("the frozen probe in it is not JSON") from None
            self.probe = probe if isinstance(probe, dict) else None

    def _read_summary(self) -> None:
        """Read schemas and channels from the end of the file."""
        with self.path.open("rb") as file:
            size = file.seek(0, 2)
            file.seek(max(size - FOOTER_AND_MAGIC, len(MCAP_MAGIC)))
            footers = [
                parse(records.Footer, content) for opcode, content in walk(file) if opcode == Opcode.FOOTER
            ]
            if len(footers) != 1 or file.read() != MCAP_MAGIC or not 0 < footers[0].summary_start < size:
                raise DamagedError("it has no summary")
            file.seek(footers[0].summary_start)
            for opcode, content in walk(file):
                self._register(opcode, content)


@dataclass(frozen=True)
class RecoveryResult:
    """Result of a recovery.

    Attributes:
        path: path of the new file; None if the old file is not damaged.
        messages: number of messages.
        seconds: time from the first to the last message [s].
        damage: damage at which the old file ends.
    """

    path: Path | None
    messages: int
    seconds: float
    damage: str


class _RecordCopier:
    """Copies records of one file to another and renumbers schemas and channels."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._schemas: dict[int, int] = {0: 0}
        self._channels: dict[int, int] = {}
        self.messages, self.first, self.last = 0, 0, 0

    def copy_record(self, opcode: int, content: bytes) -> None:
        """Copy a record of the file."""
        if opcode == Opcode.HEADER:
            header = parse(records.Header, content)
            self._writer.start(header.profile, header.library)
        elif opcode == Opcode.ATTACHMENT:
            a = parse(records.Attachment, content)
            self._writer.add_attachment(a.create_time, a.log_time, a.name, a.media_type, a.data)
        elif opcode == Opcode.METADATA:
            metadata = parse(records.Metadata, content)
            self._writer.add_metadata(metadata.name, metadata.metadata)
        elif opcode == Opcode.CHUNK:
            for inner, part in split(unpack(content)):
                self._copy_inner(inner, part)
            self._writer.flush()
        else:
            self._copy_inner(opcode, memoryview(content))

    def _copy_inner(self, opcode: int, content: memoryview) -> None:
        """Copy a schema, channel or message record, in a chunk or outside."""
        if opcode == Opcode.SCHEMA:
            schema = parse(records.Schema, bytes(content))
            if schema.id not in self._schemas:
                self._schemas[schema.id] = self._writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
        elif opcode == Opcode.CHANNEL:
            channel = parse(records.Channel, bytes(content))
            if channel.schema_id not in self._schemas:
                raise DamagedError(f"channel {channel.id} has no schema")
            if channel.id not in self._channels:
                schema_id = self._schemas[channel.schema_id]
                self._channels[channel.id] = self._writer.register_channel(
                    channel.topic, channel.message_encoding, schema_id, channel.metadata
                )
        elif opcode == Opcode.MESSAGE:
            number, sequence, logged, published, data = split_message(content)
            if number not in self._channels:
                raise DamagedError(f"a message belongs to channel {number}, which does not exist")
            self._writer.add_message(self._channels[number], logged, bytes(data), published, sequence)
            self.first = min(self.first, logged) if self.messages else logged
            self.messages, self.last = self.messages + 1, max(self.last, logged)


def recover(path: Path, out: Path, force: bool = False) -> RecoveryResult:
    """Copy the undamaged part of an MCAP file to a new file that every tool can open.

    Args:
        path: path of the truncated file.
        out: path of the new file.
        force: replace an existing file.

    Raises:
        InputError: the file does not exist, contains no readable message, or `out` exists or cannot be written.
    """
    check_overwrite(out, force)
    if out.exists() and out.samefile(path):
        raise InputError(f"{out}: is the input file; choose another name")
    temporary = ""
    try:
        with path.open("rb") as file:
            if file.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
                raise InputError(f"{path}: not an MCAP file: wrong first bytes")
            out.parent.mkdir(parents=True, exist_ok=True)
            handle, temporary = tempfile.mkstemp(dir=out.parent, prefix=f".{out.name}.")
            with os.fdopen(handle, "wb") as written:
                writer = Writer(written)
                copier = _RecordCopier(writer)
                damage = _copy_records(copier, file)
                if damage and copier.messages:
                    writer.finish()
        if damage and not copier.messages:
            raise InputError(f"{path}: contains no readable message: {damage}")
        seconds = (copier.last - copier.first) / 1e9
        if not damage:
            return RecoveryResult(None, copier.messages, seconds, "")
        os.chmod(temporary, 0o644)
        os.replace(temporary, out)
        return RecoveryResult(out, copier.messages, seconds, damage)
    except FileNotFoundError:
        raise InputError(f"{path}: no such recording") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be recovered to {out}: {error.strerror}") from None
    finally:
        if temporary and os.path.exists(temporary):
            os.unlink(temporary)


def _copy_records(copier: _RecordCopier, file: BinaryIO) -> str:
    """Copy record by record; return the damage, empty at a regular end."""
    try:
        ended = False
        for i, (opcode, content) in enumerate(walk(file)):
            if (i == 0) != (opcode == Opcode.HEADER):
                return "its records do not begin with a header"
            ended = ended or opcode == Opcode.DATA_END
            if not ended:
                copier.copy_record(opcode, content)
    except DamagedError as error:
        return str(error)
    except struct.error:
        return "it names more channels than there can be"
    return "" if ended and file.read() == MCAP_MAGIC else "it was cut off"
