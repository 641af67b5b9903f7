"""An MCAP file as a bag: also one that was never closed, up to where it is whole."""

import json
from collections.abc import Collection, Iterator
from pathlib import Path

from mcap import records
from mcap.opcode import Opcode

from probedesign.errors import InputError
from probedesign.live.bag import MCAP, Channel, Message
from probedesign.live.mcap.walk import DamagedError, message, parse, split, unpack, walk

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
                    number, _, logged, _, data = message(memoryview(content))
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
            file.seek(len(MCAP))
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
            if file.read(len(MCAP)) != MCAP:
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
            file.seek(max(size - FOOTER_AND_MAGIC, len(MCAP)))
            footers = [
                parse(records.Footer, content) for opcode, content in walk(file) if opcode == Opcode.FOOTER
            ]
            if len(footers) != 1 or file.read() != MCAP or not 0 < footers[0].summary_start < size:
                raise DamagedError("it has no summary")
            file.seek(footers[0].summary_start)
            for opcode, content in walk(file):
                self._learn(opcode, content)
