"""Bags of ROS 2 messages, whatever keeps them: an MCAP file, or what `ros2 bag` and rosbags read."""

import difflib
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from probedesign.errors import InputError, MissingDependencyError
from probedesign.frames import Array
from probedesign.live.poses.track import TimedPose, Tree, timed_pose
from probedesign.live.recordings import require
from probedesign.live.recordings.schemas import MCAP_MAGIC, WRENCH, Channel, Message, read_stamped
from probedesign.tables.text_table import plain, shown

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader


SQLITE_MAGIC = b"SQLite format 3\0"
"""The first bytes of a `.db3` file."""


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
    return start.startswith(MCAP_MAGIC) or start == SQLITE_MAGIC or path.suffix in (".mcap", ".db3")


def open_bag(path: Path) -> Bag:
    """The bag at a path.

    Raises:
        InputError: there is none, or it cannot be read.
        MissingDependencyError: what reads it is not installed.
    """
    if path.suffix == ".db3" or path.is_dir():
        return RosBag(path)
    require()
    from probedesign.live.recordings.mcap_read import McapBag

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


BLOCK_SIZE = 256
"""Readings to a block: few enough to be soon there, enough to be cheap."""
Wrenches = tuple[Array, Array]
"""Times [s], (n,), and wrenches as published, (n, 6)."""


@dataclass(frozen=True)
class Published:
    """A topic of wrenches.

    Attributes:
        bag: that holds it.
        channel: of it.
        frame_id: that its first message names.
        unstamped: whether its headers say no time, so that the time of recording counts.
    """

    bag: Bag
    channel: Channel
    frame_id: str
    unstamped: bool

    def wrenches(self) -> Iterator[Wrenches]:
        """Times and wrenches, some at once.

        Raises:
            InputError: a message is none.
        """
        messages = self.bag.messages({self.channel.topic})
        while batch := list(islice(messages, BLOCK_SIZE)):
            read = [_read_wrench(self.bag, message) for message in batch]
            pairs = zip(batch, read, strict=True)
            stamps = [message.logged if self.unstamped else stamp for message, (stamp, _, _) in pairs]
            yield np.array(stamps, dtype=float) / 1e9, np.array([values for _, _, values in read])


def find_wrenches(bag: Bag, topic: str = "") -> Published:
    """The topic of wrenches in a bag.

    Args:
        bag: to read.
        topic: its name; may be empty if there is only one.

    Raises:
        InputError: there is none, it holds nothing, or there are several and no name.
    """
    channel = choose(bag, {WRENCH}, topic)
    first = next(iter(bag.messages({channel.topic})), None)
    if first is None:
        raise InputError(
            f"{bag.path}: topic {plain(channel.topic)} holds no messages" + (bag.damage and f"; {bag.damage}")
        )
    stamp, frame_id, _ = _read_wrench(bag, first)
    return Published(bag, channel, frame_id, stamp == 0)


def _read_wrench(bag: Bag, message: Message) -> tuple[int, str, tuple[float, ...]]:
    try:
        return read_stamped(message.data, 6)
    except ValueError as error:
        at = f"{message.logged / 1e9:.9g} s"
        raise InputError(f"{bag.path}: a message of {shown(message.topic)} logged at {at}: {error}") from None


POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
TF = "tf2_msgs/msg/TFMessage"
STATIC = "/tf_static"


def looks_like_bag(path: Path) -> bool:
    """Whether a path looks like a bag: a folder, or one of its files."""
    return path.is_dir() or path.suffix in (".mcap", ".db3")


def read_poses(path: Path, topic: str = "", world: str = "", base: str = "") -> list[TimedPose]:
    """Poses of the base, each at its header's time, in order.

    Args:
        path: of the bag's folder, or of its one file.
        topic: of PoseStamped; the only one there is if empty.
        world: frame of TF that counts as the world; with it `base` is needed and `topic` is not.
        base: frame of TF that is the probe's base.

    Raises:
        InputError: it is no bag, or holds no such poses, or one that is none.
        MissingDependencyError: rosbags is not installed.
    """
    if bool(world) != bool(base) or (world and topic):
        raise InputError(f"--pose {path}: say topic=/NAME, or world=FRAME&base=FRAME")
    with _pose_reader(path) as reader:
        found = _poses_from_tf(reader, path, world, base) if world else _poses_from_topic(reader, path, topic)
    found.sort(key=lambda pose: pose.time)
    return found


def _poses_from_topic(reader: "AnyReader", path: Path, topic: str) -> list[TimedPose]:
    topics = {c.topic: c for c in reader.connections if c.msgtype == POSE_STAMPED}
    name = topic or (next(iter(topics)) if len(topics) == 1 else "")
    if name not in topics:
        there = f"there are {', '.join(sorted(topics))[:200]}" if topics else "there are none"
        raise InputError(
            f"{path}: topic {topic or 'not named'}; of poses (PoseStamped) {there}; say ?topic=/NAME"
        )
    found, frames = [], set()
    for _, message in _deserialized(reader, path, topics[name].msgtype, name):
        frames.add(message.header.frame_id)
        place, turn = message.pose.position, message.pose.orientation
        found.append(_timed_pose(path, name, message.header.stamp, place, turn))
    if not found:
        raise InputError(f"{path}: topic {name} holds no poses")
    if len(frames) > 1:
        told = ", ".join(sorted(frames))[:80]
        raise InputError(f"{path}: topic {name} tells poses in several frames, {told}; one is needed")
    return found


def _poses_from_tf(reader: "AnyReader", path: Path, world: str, base: str) -> list[TimedPose]:
    tree = Tree()
    for topic, message in _deserialized(reader, path, TF):
        for edge in message.transforms:
            move = edge.transform
            pose = _timed_pose(path, topic, edge.header.stamp, move.translation, move.rotation)
            tree.add(edge.header.frame_id, edge.child_frame_id, pose, topic == STATIC)
    try:
        return tree.poses(world, base)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _deserialized(reader: "AnyReader", path: Path, kind: str, topic: str = "") -> Iterator[tuple[str, Any]]:
    """Topic and message of all of that kind, and of that topic if one is named."""
    chosen = [c for c in reader.connections if c.msgtype == kind and topic in ("", c.topic)]
    if not chosen:
        return
    try:
        for connection, _, raw in reader.messages(connections=chosen):
            yield connection.topic, reader.deserialize(raw, connection.msgtype)
    except InputError:
        raise
    except Exception as error:  # whatever a reader makes of bytes that are none
        raise InputError(f"{path}: is damaged: {' '.join(str(error).split())[:120]}") from None


def _timed_pose(path: Path, topic: str, stamp: Any, place: Any, turn: Any) -> TimedPose:
    try:
        time = stamp.sec + stamp.nanosec * 1e-9
        return timed_pose(time, (place.x, place.y, place.z), (turn.x, turn.y, turn.z, turn.w))
    except InputError as error:
        raise InputError(f"{path}: a pose on {topic}: {error}") from None


@contextmanager
def _pose_reader(path: Path) -> Iterator["AnyReader"]:
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise MissingDependencyError("reading a bag needs rosbags; install probedesign[live]") from None
    try:
        reader = AnyReader([path], default_typestore=get_typestore(Stores.LATEST))
        reader.open()
    except Exception as error:  # rosbags raises what its files happen to break in
        why = " ".join(str(error).split())[:120] or type(error).__name__
        mend = "; if it was cut off: probedesign recover" if path.suffix == ".mcap" else ""
        raise InputError(f"{path}: cannot be read as a ROS 2 bag: {why}{mend}") from None
    try:
        yield reader
    finally:
        reader.close()
