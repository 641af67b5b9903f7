"""Poses of a ROS 2 bag, sqlite3 or MCAP: a topic of PoseStamped, or two frames of TF."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from probedesign.errors import InputError, MissingDependencyError
from probedesign.live.pose.timed import TimedPose, timed_pose
from probedesign.live.pose.tree import Tree

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

POSE = "geometry_msgs/msg/PoseStamped"
TF = "tf2_msgs/msg/TFMessage"
STATIC = "/tf_static"


def is_bag(path: Path) -> bool:
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
    with _opened(path) as reader:
        found = _from_tf(reader, path, world, base) if world else _from_topic(reader, path, topic)
    found.sort(key=lambda pose: pose.time)
    return found


def _from_topic(reader: "AnyReader", path: Path, topic: str) -> list[TimedPose]:
    topics = {c.topic: c for c in reader.connections if c.msgtype == POSE}
    name = topic or (next(iter(topics)) if len(topics) == 1 else "")
    if name not in topics:
        there = f"there are {', '.join(sorted(topics))[:200]}" if topics else "there are none"
        raise InputError(
            f"{path}: topic {topic or 'not named'}; of poses (PoseStamped) {there}; say ?topic=/NAME"
        )
    found, frames = [], set()
    for _, message in _messages(reader, path, topics[name].msgtype, name):
        frames.add(message.header.frame_id)
        place, turn = message.pose.position, message.pose.orientation
        found.append(_pose(path, name, message.header.stamp, place, turn))
    if not found:
        raise InputError(f"{path}: topic {name} holds no poses")
    if len(frames) > 1:
        told = ", ".join(sorted(frames))[:80]
        raise InputError(f"{path}: topic {name} tells poses in several frames, {told}; one is needed")
    return found


def _from_tf(reader: "AnyReader", path: Path, world: str, base: str) -> list[TimedPose]:
    tree = Tree()
    for topic, message in _messages(reader, path, TF):
        for edge in message.transforms:
            move = edge.transform
            pose = _pose(path, topic, edge.header.stamp, move.translation, move.rotation)
            tree.add(edge.header.frame_id, edge.child_frame_id, pose, topic == STATIC)
    try:
        return tree.poses(world, base)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _messages(reader: "AnyReader", path: Path, kind: str, topic: str = "") -> Iterator[tuple[str, Any]]:
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


def _pose(path: Path, topic: str, stamp: Any, place: Any, turn: Any) -> TimedPose:
    try:
        time = stamp.sec + stamp.nanosec * 1e-9
        return timed_pose(time, (place.x, place.y, place.z), (turn.x, turn.y, turn.z, turn.w))
    except InputError as error:
        raise InputError(f"{path}: a pose on {topic}: {error}") from None


@contextmanager
def _opened(path: Path) -> Iterator["AnyReader"]:
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
