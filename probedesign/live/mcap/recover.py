"""Making an MCAP file whole that was never closed: everything that can be read, in a new file."""

import os
import struct
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from mcap import records
from mcap.opcode import Opcode
from mcap.writer import Writer

from probedesign.errors import InputError
from probedesign.live.bag import MCAP
from probedesign.live.mcap.walk import DamagedError, message, parse, split, unpack, walk


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
            number, sequence, logged, published, data = message(content)
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
            if file.read(len(MCAP)) != MCAP:
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
    return "" if ended and file.read() == MCAP else "it was cut off"
