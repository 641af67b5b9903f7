"""The records of an MCAP file, read by somebody who trusts nothing in it.

What the records say is parsed by the `mcap` package; how long they claim to be is checked here first, so that
no file makes us take memory that it does not itself fill.
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

from probedesign.errors import InputError
from probedesign.live.recordings.schemas import MCAP_MAGIC, Channel, Message

MAX_RECORD = 256 * 1024 * 1024
"""No record and no unpacked chunk is longer [bytes]: writers aim at one megabyte, large images included."""
Record = TypeVar("Record", bound=records.McapRecord)
_PREFIX = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<HIQQ")

RawMessage = tuple[int, int, int, int, memoryview]
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
        if not 0 < opcode < 128 or length > MAX_RECORD:
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


def split_message(content: memoryview) -> RawMessage:
    """The message that a record holds.

    Raises:
        DamagedError: it is too short for one.
    """
    if len(content) < _MESSAGE_HEAD.size:
        raise DamagedError("a message is too short")
    channel, sequence, logged, published = _MESSAGE_HEAD.unpack_from(content)
    return channel, sequence, logged, published, content[_MESSAGE_HEAD.size :]


FOOTER_AND_MAGIC = 9 + 20 + 8
SMALL = 10_000_000
"""An attachment that is longer is no frozen probe [bytes]."""


class McapBag:
    """An MCAP file.

    Attributes:
        path: of the file.
        damage: how it is hurt, as far as it was read; empty while it is whole.
        metadata: by name, as far as it stands before the first message.
        probe: the frozen probe that is attached to it, if there is one.
    """

    def __init__(self, path: Path) -> None:
        """Read what stands before the first message.

        Raises:
            InputError: it is no MCAP file.
        """
        self.path, self.damage = path, ""
        self.metadata: dict[str, dict[str, str]] = {}
        self.probe: dict[str, object] | None = None
        self._channels: dict[int, Channel] = {}
        self._schemas: dict[int, str] = {}
        try:
            self._read_head()
        except FileNotFoundError:
            raise InputError(f"{path}: no such recording") from None
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror}") from None

    def channels(self) -> list[Channel]:
        """See `Bag`: from the summary at the end, or by reading everything."""
        try:
            self._read_summary()
        except DamagedError:
            for _ in self.messages(()):
                pass
        return list(dict.fromkeys(self._channels.values()))

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """See `Bag`."""
        self._channels, self._schemas = {}, {}
        try:
            for opcode, content in self._flat():
                if opcode == Opcode.MESSAGE:
                    number, _, logged, _, data = split_message(memoryview(content))
                    channel = self._channels.get(number)
                    if channel is None:
                        raise DamagedError(f"a message belongs to channel {number}, which there is not")
                    if channel.topic in topics:
                        yield Message(channel.topic, logged, data)
                else:
                    self._learn(opcode, bytes(content))
        except DamagedError as error:
            self.damage = str(error)
        except OSError as error:
            raise InputError(f"{self.path}: cannot be read: {error.strerror}") from None

    def _flat(self) -> Iterator[tuple[int, bytes | memoryview]]:
        """All records up to the end of the data, those in chunks too."""
        with self.path.open("rb") as file:
            file.seek(len(MCAP_MAGIC))
            for opcode, content in walk(file):
                if opcode == Opcode.CHUNK:
                    yield from split(unpack(content))
                elif opcode == Opcode.DATA_END:
                    return
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
                    yield opcode, content

    def _learn(self, opcode: int, content: bytes) -> None:
        """A schema or a channel."""
        if opcode == Opcode.SCHEMA:
            schema = parse(records.Schema, content)
            self._schemas[schema.id] = schema.name
        elif opcode == Opcode.CHANNEL:
            channel = parse(records.Channel, content)
            name = self._schemas.get(channel.schema_id, "")
            self._channels[channel.id] = Channel(channel.topic, name, channel.message_encoding)

    def _read_head(self) -> None:
        with self.path.open("rb") as file:
            if file.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
                raise InputError(f"{self.path}: is no MCAP file: it does not begin like one")
            try:
                for opcode, content in walk(file):
                    if opcode == Opcode.ATTACHMENT and len(content) < SMALL:
                        self._attached(parse(records.Attachment, content))
                    elif opcode == Opcode.METADATA:
                        metadata = parse(records.Metadata, content)
                        self.metadata[metadata.name] = metadata.metadata
                    elif opcode not in (Opcode.HEADER, Opcode.ATTACHMENT):
                        return
            except DamagedError as error:
                self.damage = str(error)

    def _attached(self, attachment: records.Attachment) -> None:
        if attachment.name.endswith(".probe.json"):
            try:
                probe = json.loads(attachment.data)
            except (ValueError, RecursionError):
                raise DamagedError("the frozen probe in it is not JSON") from None
            self.probe = probe if isinstance(probe, dict) else None

    def _read_summary(self) -> None:
        """Schemas and channels from the end of the file.

        Raises:
            DamagedError: the file was never closed, or its end is no such thing.
        """
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
                self._learn(opcode, content)


@dataclass(frozen=True)
class Recovered:
    """What was saved.

    Attributes:
        path: of the new file; None if the old one is whole.
        messages: that are in it.
        seconds: from the first to the last of them.
        damage: what ended the old file.
    """

    path: Path | None
    messages: int
    seconds: float
    damage: str


class _Copy:
    """Records of one file written to another, with numbers of its own."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._schemas: dict[int, int] = {0: 0}
        self._channels: dict[int, int] = {}
        self.messages, self.first, self.last = 0, 0, 0

    def outer(self, opcode: int, content: bytes) -> None:
        """A record of the file."""
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
                self._inner(inner, part)
            self._writer.flush()
        else:
            self._inner(opcode, memoryview(content))

    def _inner(self, opcode: int, content: memoryview) -> None:
        """A record of a chunk, or one that stands alone though it might be in one."""
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
                raise DamagedError(f"a message belongs to channel {number}, which there is not")
            self._writer.add_message(self._channels[number], logged, bytes(data), published, sequence)
            self.first = min(self.first, logged) if self.messages else logged
            self.messages, self.last = self.messages + 1, max(self.last, logged)


def recover(path: Path, out: Path, force: bool = False) -> Recovered:
    """Copy what is whole of an MCAP file into a new one that every tool opens.

    Args:
        path: of the file that was cut off.
        out: of the new one.
        force: replace a file that stands there.

    Raises:
        InputError: there is no such file, nothing of it can be read, or `out` exists or cannot be written.
    """
    if out.exists() and (not force or out.samefile(path)):
        raise InputError(
            f"{out}: exists; " + ("it is the file itself" if force else "say --force to replace it")
        )
    aside = ""
    try:
        with path.open("rb") as file:
            if file.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
                raise InputError(f"{path}: is no MCAP file: it does not begin like one")
            out.parent.mkdir(parents=True, exist_ok=True)
            handle, aside = tempfile.mkstemp(dir=out.parent, prefix=f".{out.name}.")
            with os.fdopen(handle, "wb") as written:
                writer = Writer(written)
                copy = _Copy(writer)
                damage = _copied(copy, file)
                if damage and copy.messages:
                    writer.finish()
        if damage and not copy.messages:
            raise InputError(f"{path}: holds no message that can be read: {damage}")
        seconds = (copy.last - copy.first) / 1e9
        if not damage:
            return Recovered(None, copy.messages, seconds, "")
        os.chmod(aside, 0o644)
        os.replace(aside, out)
        return Recovered(out, copy.messages, seconds, damage)
    except FileNotFoundError:
        raise InputError(f"{path}: no such recording") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be recovered to {out}: {error.strerror}") from None
    finally:
        if aside and os.path.exists(aside):
            os.unlink(aside)


def _copied(copy: _Copy, file: BinaryIO) -> str:
    """Copy record by record; what ended it, empty if that was the end."""
    try:
        ended = False
        for i, (opcode, content) in enumerate(walk(file)):
            if (i == 0) != (opcode == Opcode.HEADER):
                return "its records do not begin with a header"
            ended = ended or opcode == Opcode.DATA_END
            if not ended:
                copy.outer(opcode, content)
    except DamagedError as error:
        return str(error)
    except struct.error:
        return "it names more channels than there can be"
    return "" if ended and file.read() == MCAP_MAGIC else "it was cut off"
