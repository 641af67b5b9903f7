"""ROS 2 bags, as MCAP or sqlite3: channels, messages, wrenches and poses."""

import difflib
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, Protocol

from probedesign.core.errors import InputError, MissingDependencyError, one_line, quoted
from probedesign.live.poses.base_poses import TimedPose, TransformTree, timed_pose
from probedesign.live.recordings import require_mcap
from probedesign.live.recordings.schemas import MCAP_MAGIC, POSE, TRANSFORMS, BagTopic, Message, decode

SQLITE_MAGIC = b"SQLite format 3\0"  #: The first bytes of a `.db3` file.


class Bag(Protocol):
    """A bag: messages in the order in which they were recorded."""

    path: Path
    metadata: dict[str, dict[str, str]]  #: Metadata by name; only MCAP has them.
    probes: list[dict[str, object]]  #: Attached frozen probes.
    #: Clock of the headers minus the source's clock [ns], by the beginning of topics; only in our own recordings.
    clock_offsets: dict[str, int]

    @property
    def damage(self) -> str:
        """Description of the damage, as far as the bag was read; empty if none."""

    def channels(self) -> list[BagTopic]:
        """Return all channels."""

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Yield the messages of the topics; of a damaged bag those that are intact."""


def is_bag(path: Path) -> bool:
    """Return whether a file or folder is a bag, by its first bytes, or by its suffix."""
    try:
        if path.is_dir():
            return (path / "metadata.yaml").exists()
        with path.open("rb") as file:
            start = file.read(16)
    except (OSError, ValueError):
        return False
    return start.startswith(MCAP_MAGIC) or start == SQLITE_MAGIC or path.suffix in (".mcap", ".db3")


def open_bag(path: Path) -> Bag:
    """Open the bag at a path.

    Raises:
        InputError: there is no bag, or it cannot be read.
        MissingDependencyError: the package that reads it is not installed.
    """
    if path.suffix == ".db3" or path.is_dir():
        return RosBag(path)
    require_mcap()
    from probedesign.live.recordings.mcap_read import McapBag

    return McapBag(path)


def select_channel(bag: Bag, types: Collection[str], topic: str = "") -> BagTopic:
    """Select the channel of one of these message types; `topic` may be empty if there is only one.

    Raises:
        InputError: there is no such channel, or there are several and no name is given.
    """
    fit = {channel.topic: channel for channel in bag.channels() if channel.type in types and channel.encoding == "cdr"}
    wanted = " or ".join(sorted(name.rpartition("/")[2] for name in types))
    listed = ", ".join(map(quoted, list(fit)[:10])) or "none"
    if topic and topic not in fit:
        near = difflib.get_close_matches(topic, fit, 1)
        hint = f"did you mean {near[0]}? " if near else ""
        raise InputError(f"{bag.path}: has no topic {topic!r} of {wanted}; {hint}available are: {listed}")
    if not fit:
        raise InputError(f"{bag.path}: has no topic of {wanted}" + (f" (damaged: {bag.damage})" if bag.damage else ""))
    if len(fit) > 1 and not topic:
        raise InputError(f"{bag.path}: has several topics of {wanted}: {listed}; select one with ?topic=")
    return fit[topic or next(iter(fit))]


class RosBag:
    """A folder with metadata.yaml, or a database of `ros2 bag`, read with rosbags."""

    def __init__(self, path: Path) -> None:
        """Read the list of channels.

        Raises:
            InputError: the bag cannot be read.
            MissingDependencyError: rosbags is not installed.
        """
        try:
            from rosbags.rosbag2 import Reader
        except ImportError:
            raise MissingDependencyError.of_extra("reading a bag", "rosbags", "live") from None
        self.path, self.damage = path, ""
        self.clock_offsets, self.metadata, self.probes = dict[str, int](), dict[str, dict[str, str]](), list[Any]()
        self._reader = Reader
        try:
            with Reader(path) as reader:
                self._channels = [BagTopic(str(c.topic), str(c.msgtype)) for c in reader.connections]
        except Exception as error:
            raise self._unreadable(error) from None

    def channels(self) -> list[BagTopic]:
        """Return all channels; see `Bag`."""
        return list(dict.fromkeys(self._channels))

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Yield the messages of the topics; see `Bag`."""
        try:
            with self._reader(self.path) as reader:
                wanted = [connection for connection in reader.connections if connection.topic in topics]
                for connection, logged, data in reader.messages(wanted) if wanted else ():
                    # a database may contain anything
                    if not isinstance(data, bytes) or not isinstance(logged, int):
                        raise ValueError(f"a message of {connection.topic} is not a message")
                    yield Message(connection.topic, logged, data)
        except InputError:
            raise
        except Exception as error:
            raise self._unreadable(error) from None

    def _unreadable(self, error: Exception) -> InputError:
        text = one_line(str(error), 200) or type(error).__name__
        return InputError(f"{self.path}: cannot be read as a ROS 2 bag: {text}")


def is_bag_path(path: Path) -> bool:
    """Return whether a path is a bag by its name: a folder, or a file with the suffix of a bag."""
    return path.is_dir() or path.suffix in (".mcap", ".db3")


def read_bag_poses(path: Path, topic: str = "", world: str = "", base: str = "") -> list[TimedPose]:
    """Read the poses of the base, in order of the time in their headers.

    Args:
        path: path of the bag's folder, or of its single file.
        topic: topic of PoseStamped; empty if there is only one.
        world: TF frame of the world; requires `base` and excludes `topic`.
        base: TF frame of the probe's base.

    Raises:
        InputError: the path is not a bag, is damaged, has no such poses, or an invalid one.
        MissingDependencyError: the package that reads it is not installed.
    """
    if bool(world) != bool(base) or (world and topic):
        raise InputError(f"--pose {path}: use topic=/NAME, or world=FRAME&base=FRAME")
    bag = open_bag(path)
    if world:
        poses = _poses_from_tf(bag, world, base)
    else:
        name, frames = select_channel(bag, {POSE}, topic).topic, set()
        poses = []
        for message in bag.messages({name}):
            try:
                decoded = decode(message.data, POSE)
                poses.append(_at(bag, message, name, decoded.header, decoded.pose.position, decoded.pose.orientation))
            except ValueError as error:
                raise InputError(f"{path}: a pose on {name}: {error}") from None
            frames.add(decoded.header.frame_id)
        if not poses:
            raise InputError(f"{path}: topic {name} has no poses" + (bag.damage and f"; {bag.damage}"))
        if len(frames) > 1:
            text = ", ".join(sorted(frames))[:80]
            raise InputError(f"{path}: topic {name} has poses in several frames, {text}; one frame is required")
    if bag.damage:
        raise InputError(f"{path}: is damaged: {bag.damage}; probedesign recover copies what is left")
    return sorted(poses, key=lambda pose: pose.time)


def _poses_from_tf(bag: Bag, world: str, base: str) -> list[TimedPose]:
    edges, tree = [], TransformTree()
    for message in bag.messages({channel.topic for channel in bag.channels() if channel.type == TRANSFORMS}):
        try:
            for edge in decode(message.data, TRANSFORMS).transforms:
                child, at = edge.child_frame_id, edge.transform
                pose = _at(bag, message, f"/{child}", edge.header, at.translation, at.rotation)
                edges.append((edge.header.frame_id, child, pose, message.topic == "/tf_static"))
        except ValueError as error:
            raise InputError(f"{bag.path}: a transform on {message.topic}: {error}") from None
    try:
        for parent, child, pose, static in sorted(edges, key=lambda edge: edge[2].time):
            tree.add(parent, child, pose, static)
        return tree.poses(world, base)
    except InputError as error:
        raise InputError(f"{bag.path}: {error}") from None


def clock_offset(bag: Bag, name: str) -> int:
    """Return the offset of the clocks for a topic, or a frame after a slash [ns]; 0 in the bag of another program."""
    of_probe = [offset for start, offset in bag.clock_offsets.items() if start and name.startswith(start)]
    return of_probe[0] if of_probe else bag.clock_offsets.get("", 0)


def header_stamp(header: Any) -> int:
    """Return the time stamp of a header [ns]."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def _at(bag: Bag, message: Message, name: str, header: Any, p: Any, q: Any) -> TimedPose:
    """Return a pose at the time of its header; in our own recordings that of its log time, which ends later."""
    offset = clock_offset(bag, name)
    second, nanosecond = divmod((message.logged if offset else header_stamp(header)) - offset, 1_000_000_000)
    return timed_pose(second + nanosecond * 1e-9, (p.x, p.y, p.z), (q.x, q.y, q.z, q.w))
