"""Topics and ROS 2 messages of a recording and of the Foxglove server: definitions, CDR encoding, QoS, JSON schemas.

Source: OMG DDSI-RTPS, CDR encapsulation; the definitions are those of ROS 2's common_interfaces and geometry2, from
rosbags; `probedesign_msgs/msg/Contact` is this project's.
"""

import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from probedesign.core.errors import one_line, require
from probedesign.core.frames import Array
from probedesign.estimation.estimate import RESULTS

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

MCAP_MAGIC = b"\x89MCAP0\r\n"  #: The first and the last bytes of an MCAP file.
RECORD_PREFIX = struct.Struct("<BQ")  #: Opcode of a record and the length of its content, before the content.


class BagTopic(NamedTuple):
    """A topic of a bag, the type of its messages, as geometry_msgs/msg/WrenchStamped, and their encoding."""

    topic: str
    type: str
    encoding: str = "cdr"


class Message(NamedTuple):
    """One message of a bag: its topic, the time of recording [ns], and the bytes in the topic's encoding."""

    topic: str
    logged: int
    data: bytes | memoryview


Nanoseconds = NDArray[np.int64]
Bytes = NDArray[np.void]  #: Messages of equal length, (n,).

WRENCH = "geometry_msgs/msg/WrenchStamped"
POSE = "geometry_msgs/msg/PoseStamped"
UNCERTAIN_POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TEXT = "std_msgs/msg/String"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
MARKERS = "visualization_msgs/msg/MarkerArray"
CONTACT_STATE = "probedesign_msgs/msg/Contact"

#: Phases in the order of their numbers in `CONTACT_STATE`.
PHASES = ("", "free", "moving", "touching", "settled", "released")


def _constants(names: Sequence[str], prefix: str = "") -> str:
    return "\n".join(f"uint8 {prefix}{(name or 'unknown').upper()}={i}" for i, name in enumerate(names))


_CONTACT = f"""std_msgs/Header header
float64 s_contact # arclength of the contact [m], NaN unless the result is OK, as all numbers below
float64 std_s # its standard deviation [m]
geometry_msgs/Point p_surface # touched point in the base frame [m]
geometry_msgs/Vector3 force # of the object on the probe, in base axes [N]
float64 force_norm # [N]
float64 force_normal # [N]
float64 force_tangential # [N]
float64 friction_ratio # tangential over normal force
float64 detection_chi2 # distance of the reading from that of the free probe, whatever the result
{_constants(tuple(RESULTS))}
uint8 result
{_constants(PHASES, "PHASE_")}
uint8 phase"""

#: Encapsulation header of little-endian CDR. The fields after it are aligned as if it were at offset zero.
CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
_SECONDS = (-(2**31), 2**31 - 1)
_MAX_SECONDS = 9e9  #: Maximum number of seconds in 63 bits of nanoseconds.


@cache
def type_store() -> "Typestore":
    """Return the message types of ROS 2, from Humble on, and our own.

    Raises:
        MissingDependencyError: rosbags, which has them, is not installed.
    """
    require("rosbags", "an MCAP recording or --foxglove", "live")
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(_CONTACT, CONTACT_STATE))
    return store


def definition(name: str) -> bytes:
    """Return the definition of a message type with all types it contains, in the `ros2msg` format."""
    text, _ = type_store().generate_msgdef(name, ros_version=2)
    _, separator, parts = text.partition("=" * 80)
    return (f"{_CONTACT}\n{separator}{parts}" if name == CONTACT_STATE else text).encode()  # ours has comments


def nanoseconds(time: ArrayLike) -> Nanoseconds:
    """Return times [s] as integer nanoseconds, limited to what a header can represent."""
    seconds_known = np.nan_to_num(np.asarray(time, dtype=float))
    whole: Nanoseconds = np.rint(np.clip(seconds_known, -_MAX_SECONDS, _MAX_SECONDS) * 1e9).astype(np.int64)
    return whole


def header_time(stamp: int) -> tuple[int, int]:
    """Return seconds, limited to the 32 bits of a header, and nanoseconds of a time stamp [ns]."""
    second, rest = divmod(stamp, 1_000_000_000)
    return max(min(second, _SECONDS[1]), _SECONDS[0]), rest


def stamped(frame: str, stamps: ArrayLike, values: ArrayLike, codes: ArrayLike | None = None) -> Bytes:
    """Return messages of a header, doubles and codes: wrenches, poses, poses with covariance, states of the contact.

    Args:
        frame: frame of the values.
        stamps: time stamps of the headers [ns], (n,), limited to 32 bits of seconds.
        values: the doubles in message order [SI], (n, doubles).
        codes: numbers of enumerations after the doubles, (n, codes); none by default.

    Returns:
        The messages, (n,), of equal length.
    """
    numbers = np.asarray(values, dtype=float)
    seconds, rest = np.divmod(np.asarray(stamps, dtype=np.int64), 1_000_000_000)
    name = frame.encode() + b"\0"
    last = np.zeros((len(numbers), 0), np.uint8) if codes is None else np.asarray(codes, np.uint8)
    packed = np.zeros(len(numbers), _message_dtype(len(name), numbers.shape[1], last.shape[1]))
    packed["encapsulation"], packed["name"] = np.void(CDR_LITTLE_ENDIAN), np.void(name)
    packed["length"] = len(name)
    packed["second"] = np.clip(seconds, *_SECONDS)
    packed["rest"] = np.where(seconds < _SECONDS[0], 0, np.where(seconds > _SECONDS[1], 999_999_999, rest))
    packed["values"], packed["codes"] = numbers, last
    return packed.view(f"V{packed.dtype.itemsize}")


@cache
def _message_dtype(name: int, doubles: int, codes: int = 0) -> np.dtype[np.void]:
    return np.dtype([
        ("encapsulation", "V4"), ("second", "<i4"), ("rest", "<u4"), ("length", "<u4"), ("name", f"V{name}"),
        ("padding", f"V{-(12 + name) % 8}"), ("values", "<f8", (doubles,)),
        ("codes", "u1", (codes,)),
    ])  # fmt: skip


def texts(data: Sequence[str]) -> Bytes:
    """Return string messages, (n,), padded with spaces to equal length, which JSON ignores."""
    contents = [each.encode() for each in data]
    length = max(map(len, contents))
    head = CDR_LITTLE_ENDIAN + struct.pack("<I", length + 1)
    whole = b"".join(head + content.ljust(length) + b"\0" for content in contents)
    return np.frombuffer(whole, f"V{len(head) + length + 1}")


def transform(parent: str, child: str, stamp: int, p: Sequence[float], q: Sequence[float]) -> Bytes:
    """Return a TF message with one transform, (1,).

    Args:
        parent: frame in which the pose is given.
        child: frame whose pose it is.
        stamp: time stamp [ns].
        p: origin of the child [m], three numbers.
        q: orientation as a quaternion x, y, z, w.
    """
    data = struct.pack("<IiI", 1, *header_time(stamp))
    for name, alignment in ((parent, 4), (child, 8)):  # of what follows
        data += struct.pack("<I", len(name.encode()) + 1) + name.encode() + b"\0"
        data += bytes(-len(data) % alignment)
    message = CDR_LITTLE_ENDIAN + data + struct.pack("<7d", *p, *q)
    return np.frombuffer(message, f"V{len(message)}")


def decode(data: bytes | memoryview, name: str) -> Any:
    """Return the message of a type from its bytes.

    Raises:
        ValueError: the bytes are not such a message.
    """
    try:
        return type_store().deserialize_cdr(bytes(data), name)
    except Exception as error:  # rosbags may raise anything on invalid bytes
        raise ValueError(one_line(str(error), 120) or type(error).__name__) from None


def read_wrenches(messages: Sequence[bytes | memoryview]) -> Array:
    """Return the wrenches of our own messages, (n, 6), without headers, all decoded at once.

    Raises:
        ValueError: they are not messages of one length, as this program writes them.
    """
    if not messages:
        return np.empty((0, 6))
    ((length, start, name), *others) = {(len(each), bytes(each[:4]), bytes(each[12:16])) for each in messages}
    frame = int.from_bytes(name, "little")
    if others or start != CDR_LITTLE_ENDIAN or frame > length or _message_dtype(frame, 6).itemsize != length:
        raise ValueError("its wrenches are not those of one writer")
    return np.frombuffer(b"".join(messages), _message_dtype(frame, 6))["values"]


METADATA_NAME = "probedesign"  #: Name of the metadata record of our recordings.
#: Name of the metadata record with the offset of the clocks, and its key.
CLOCK_NAME, OFFSET_KEY = "probedesign_clock", "wall_minus_source_ns"


@dataclass(frozen=True, eq=False)
class Topic:
    """A topic of our recordings."""

    name: str  #: name in ROS.
    type: str  #: type of its messages.
    #: whether a subscriber receives the last message even if it was sent before (transient local).
    latched: bool = False
    probe: str = ""  #: name of the probe in a run with several.

    @property
    def path(self) -> str:
        """Name of the topic, which begins with that of the probe in a run with several; transforms share a topic."""
        return f"/{ros_name(self.probe)}{self.name}" if self.probe and self.type != TRANSFORMS else self.name

    @property
    def metadata(self) -> dict[str, str]:
        """Metadata of the channel: the QoS profile that rosbag2 needs to play it.

        A publisher keeps the last messages, is reliable, volatile or transient local, and its liveliness automatic.
        """
        history, depth, reliability, durability, liveliness = 1, 10, 1, 1 if self.latched else 2, 1
        qos = (
            f"- history: {history}\n  depth: {depth}\n  reliability: {reliability}\n  durability: {durability}\n"
            f"  deadline:{_FOREVER}\n  lifespan:{_FOREVER}\n  liveliness: {liveliness}\n"
            f"  liveliness_lease_duration:{_FOREVER}\n  avoid_ros_namespace_conventions: false"
        )
        return {"offered_qos_profiles": qos}


#: Metadata record without which newer versions of rosbag2 expect the policies of a QoS profile as words. Source:
#: rosbag2_storage_mcap, `MCAPStorage::read_metadata`; rosbag2_storage, `qos.cpp`.
QOS_METADATA = {"rosbag2": {"offered_qos_profiles": "numbers, as in version 8 of rosbag2's metadata"}}
_FOREVER = "\n    sec: 9223372036\n    nsec: 854775807"


def ros_name(name: str) -> str:
    """Return a name as topics and frames of ROS 2 may have it: letters, digits and underscores, no digit first."""
    text = re.sub(r"\W", "_", name, flags=re.ASCII)
    return f"probe_{text}" if text[:1].isdigit() else text


#: Every reading as the sensor delivered it, in the sensor frame, bias included.
RAW = Topic("/probedesign/wrench_raw", WRENCH)
#: JSON of a block of readings, the last ones on `RAW`, and what their headers do not contain: `first`, the number of
#: readings before it, including dropped ones; `readings`; `gravity_base_m_s2`; `stretch`, the number of the
#: uninterrupted stretch of readings; `fault` of all readings.
BLOCK = Topic("/probedesign/block", TEXT)
#: The wrench that was located: without bias, averaged, at the base.
WITHOUT_BIAS = Topic("/probedesign/wrench", WRENCH)
CONTACT = Topic("/probedesign/contact", UNCERTAIN_POSE)  #: Touched point in the base frame, for each result `ok`.
#: Touched point from all readings of a touch, for each fused result `ok`.
CONTACT_WORLD = Topic("/probedesign/contact_world", UNCERTAIN_POSE)
BASE = Topic("/probedesign/base", POSE)  #: Each pose of the base in the world that is used, by the source's clock.
ESTIMATE = Topic("/probedesign/estimate", TEXT)  #: JSON of an estimate as of `live --json`, null if unknown.
EVENT = Topic("/probedesign/event", TEXT)  #: JSON of a tare, a mark, silence, loss, a fault: `time_s` and `event`.
#: The numbers of each estimate with its result and its phase, for plots.
STATE = Topic("/probedesign/state", CONTACT_STATE)
#: The bent probe, the sensor, and the contact with its 95 % ellipsoid and its force.
SCENE = Topic("/probedesign/scene", MARKERS)
#: Pose of the base at the first contact of the touch that `explore --suggest` suggests; not recorded.
NEXT_TOUCH = Topic("/probedesign/next_touch", POSE)
MAP = Topic("/probedesign/map", TEXT)  #: Shapes and next touch of `explore` as JSON; not recorded.
TF = Topic("/tf", TRANSFORMS)  #: Pose of the base in the world, as `BASE`.
TF_STATIC = Topic("/tf_static", TRANSFORMS, latched=True)  #: Pose of the sensor in the base.
TOPICS = (RAW, BLOCK, WITHOUT_BIAS, CONTACT, CONTACT_WORLD, BASE, ESTIMATE, EVENT, STATE, SCENE, TF, TF_STATIC)


@cache
def topics_of(probe: str) -> tuple[Topic, ...]:
    """Return the topics of a probe in a run with several; without a name those of a single one."""
    return tuple(replace(topic, probe=probe) for topic in TOPICS) if probe else TOPICS
