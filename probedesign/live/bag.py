"""Bags of ROS 2 messages, whatever keeps them: an MCAP file, or what `ros2 bag` and rosbags read."""

import difflib
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

from probedesign.core.csv_tables import plain, shown
from probedesign.errors import InputError, MissingDependencyError
from probedesign.live.mcap import require

MCAP, SQLITE = b"\x89MCAP0\r\n", b"SQLite format 3\0"
"""How the two kinds of files begin."""


@dataclass(frozen=True)
class Channel:
    """What a topic holds.

    Attributes:
        topic: its name.
        type: of its messages, as geometry_msgs/msg/WrenchStamped.
        encoding: of its messages; CDR in every bag of ROS 2.
    """

    topic: str
    type: str
    encoding: str = "cdr"


@dataclass(frozen=True)
class Message:
    """One message.

    Attributes:
        topic: it stands in.
        logged: when it was recorded [ns].
        data: in the topic's encoding.
    """

    topic: str
    logged: int
    data: bytes | memoryview


class Bag(Protocol):
    """Messages in the order in which they were recorded."""

    path: Path
    damage: str
    """How the bag is hurt, as far as it was read; empty while it is whole."""

    def channels(self) -> list[Channel]:
        """All there are."""
        ...

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """The topics' messages; of a damaged bag those before the damage."""
        ...


@runtime_checkable
class Attached(Bag, Protocol):
    """A bag that holds more than messages.

    Attributes:
        metadata: by name.
        probe: the frozen probe that is attached to it, if there is one.
    """

    metadata: dict[str, dict[str, str]]
    probe: dict[str, object] | None


def is_bag(path: Path) -> bool:
    """Whether a file or folder is a bag, by what it begins with; by its name if it begins with nothing."""
    try:
        if path.is_dir():
            return (path / "metadata.yaml").exists()
        with path.open("rb") as file:
            start = file.read(16)
    except (OSError, ValueError):
        return False
    return start.startswith(MCAP) or start == SQLITE or path.suffix in (".mcap", ".db3")


def open_bag(path: Path) -> Bag:
    """The bag at a path.

    Raises:
        InputError: there is none, or it cannot be read.
        MissingDependencyError: what reads it is not installed.
    """
    if path.suffix == ".db3" or path.is_dir():
        return RosBag(path)
    require()
    from probedesign.live.mcap.reading import McapBag

    return McapBag(path)


def choose(bag: Bag, types: Collection[str], topic: str = "") -> Channel:
    """The channel to read.

    Args:
        bag: that holds it.
        types: of messages that will do.
        topic: its name; may be empty if there is only one.

    Raises:
        InputError: there is none, or several and no name.
    """
    found = {channel.topic: channel for channel in bag.channels()}
    fit = [name for name, channel in found.items() if channel.type in types and channel.encoding == "cdr"]
    wanted = " or ".join(sorted(name.rpartition("/")[2] for name in types))
    listed = ", ".join(map(shown, fit[:10])) or "none"
    if topic and topic in found and topic not in fit:
        other = shown(found[topic].type)
        raise InputError(f"{bag.path}: topic {topic} holds {other}, not {wanted}; such are: {listed}")
    if topic and topic not in fit:
        near = difflib.get_close_matches(topic, fit, 1)
        hint = f"did you mean {near[0]}? " if near else ""
        raise InputError(f"{bag.path}: has no topic {topic!r}; {hint}topics of {wanted}: {listed}")
    if not fit:
        raise InputError(f"{bag.path}: holds no topic of {wanted}")
    if len(fit) > 1 and not topic:
        raise InputError(f"{bag.path}: holds several topics of {wanted}: {listed}; choose one with ?topic=")
    return found[topic or fit[0]]


class RosBag:
    """A folder with metadata.yaml, or a database of `ros2 bag`, read by rosbags."""

    def __init__(self, path: Path) -> None:
        """Open it for a moment, to see what is in it.

        Raises:
            InputError: it cannot be read.
            MissingDependencyError: rosbags is not installed.
        """
        try:
            from rosbags.rosbag2 import Reader
        except ImportError:
            raise MissingDependencyError('ROS 2 bags need: pip install "probedesign[live]"') from None
        self.path, self.damage = path, ""
        self._reader = Reader
        try:
            with Reader(path) as reader:
                self._channels = [Channel(str(c.topic), str(c.msgtype)) for c in reader.connections]
        except Exception as error:
            raise self._unreadable(error) from None

    def channels(self) -> list[Channel]:
        """See `Bag`."""
        return list(dict.fromkeys(self._channels))

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """See `Bag`.

        Raises:
            InputError: the bag cannot be read further.
        """
        try:
            with self._reader(self.path) as reader:
                wanted = [connection for connection in reader.connections if connection.topic in topics]
                for connection, logged, data in reader.messages(wanted) if wanted else ():
                    if not isinstance(data, bytes) or not isinstance(
                        logged, int
                    ):  # a database holds anything
                        raise ValueError(f"a message of {connection.topic} is no message")
                    yield Message(connection.topic, logged, data)
        except InputError:
            raise
        except Exception as error:
            raise self._unreadable(error) from None

    def _unreadable(self, error: Exception) -> InputError:
        """rosbags is written for honest bags: whatever it meets is told as the bag's fault."""
        told = plain(str(error), 200) or type(error).__name__
        return InputError(f"{self.path}: cannot be read as a ROS 2 bag: {told}")
