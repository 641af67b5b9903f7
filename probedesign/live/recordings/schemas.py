"""Topics and ROS 2 messages of a recording and of the Foxglove server: definitions, CDR encoding, QoS, JSON schemas.

Source: OMG DDSI-RTPS, CDR encapsulation; the definitions are those of ROS 2's common_interfaces and geometry2, and of
foxglove_msgs 3 (`SceneUpdate`); `probedesign_msgs/msg/Contact` is this project's.
"""

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from probedesign.core.frames import Array
from probedesign.estimation.estimate import RESULTS
from probedesign.live.processing.estimates import COLUMNS, WORLD_COLUMNS

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
SCENE_UPDATE = "foxglove_msgs/msg/SceneUpdate"
CONTACT_STATE = "probedesign_msgs/msg/Contact"

#: Phases in the order of their numbers in `CONTACT_STATE`.
PHASES = ("", "free", "moving", "touching", "settled", "released")

_HEADER = {"std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
           "builtin_interfaces/Time": "int32 sec\nuint32 nanosec"}  # fmt: skip
_POSE = {"geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
         "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
         "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w"}  # fmt: skip
_VECTOR = {"geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z"}


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

_PRIMITIVE = "geometry_msgs/Pose pose\n{}\nfoxglove_msgs/Color color"
_COLOURED = "geometry_msgs/Point[] points\nfoxglove_msgs/Color color\nfoxglove_msgs/Color[] colors\nuint32[] indices"
_TIME = {"builtin_interfaces/Time": "int32 sec\nuint32 nanosec"}
_SCENE = _TIME | _POSE | _VECTOR | {
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
    "foxglove_msgs/SceneEntityDeletion":
        "builtin_interfaces/Time timestamp\nuint8 MATCHING_ID=0\nuint8 ALL=1\nuint8 type\nstring id",
    "foxglove_msgs/SceneEntity":
        "builtin_interfaces/Time timestamp\nstring frame_id\nstring id\nbuiltin_interfaces/Duration lifetime\n"
        "bool frame_locked\nfoxglove_msgs/KeyValuePair[] metadata\nfoxglove_msgs/ArrowPrimitive[] arrows\n"
        "foxglove_msgs/CubePrimitive[] cubes\nfoxglove_msgs/SpherePrimitive[] spheres\n"
        "foxglove_msgs/CylinderPrimitive[] cylinders\nfoxglove_msgs/LinePrimitive[] lines\n"
        "foxglove_msgs/TriangleListPrimitive[] triangles\nfoxglove_msgs/TextPrimitive[] texts\n"
        "foxglove_msgs/ModelPrimitive[] models",
    "foxglove_msgs/KeyValuePair": "string key\nstring value",
    "foxglove_msgs/Color": "float64 r\nfloat64 g\nfloat64 b\nfloat64 a",
    "foxglove_msgs/ArrowPrimitive": _PRIMITIVE.format(
        "float64 shaft_length\nfloat64 shaft_diameter\nfloat64 head_length\nfloat64 head_diameter"),
    "foxglove_msgs/CubePrimitive": _PRIMITIVE.format("geometry_msgs/Vector3 size"),
    "foxglove_msgs/SpherePrimitive": _PRIMITIVE.format("geometry_msgs/Vector3 size"),
    "foxglove_msgs/CylinderPrimitive": _PRIMITIVE.format(
        "geometry_msgs/Vector3 size\nfloat64 bottom_scale\nfloat64 top_scale"),
    "foxglove_msgs/LinePrimitive":
        "uint8 LINE_STRIP=0\nuint8 LINE_LOOP=1\nuint8 LINE_LIST=2\nuint8 type\ngeometry_msgs/Pose pose\n"
        f"float64 thickness\nbool scale_invariant\n{_COLOURED}",
    "foxglove_msgs/TriangleListPrimitive": f"geometry_msgs/Pose pose\n{_COLOURED}",
    "foxglove_msgs/TextPrimitive": "geometry_msgs/Pose pose\nbool billboard\nfloat64 font_size\n"
        "bool scale_invariant\nfoxglove_msgs/Color color\nstring text",
    "foxglove_msgs/ModelPrimitive": "geometry_msgs/Pose pose\ngeometry_msgs/Vector3 scale\n"
        "foxglove_msgs/Color color\nbool override_color\nstring url\nstring media_type\nuint8[] data",
}  # fmt: skip
_DEFINITIONS = {
    WRENCH: ("std_msgs/Header header\ngeometry_msgs/Wrench wrench",
             _HEADER | _VECTOR
             | {"geometry_msgs/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque"}),
    POSE: ("std_msgs/Header header\ngeometry_msgs/Pose pose", _HEADER | _POSE),
    UNCERTAIN_POSE: ("std_msgs/Header header\ngeometry_msgs/PoseWithCovariance pose", _HEADER
                     | {"geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance"}
                     | _POSE),
    TEXT: ("string data", {}),
    TRANSFORMS: ("geometry_msgs/TransformStamped[] transforms", _HEADER | _VECTOR | {
        "geometry_msgs/TransformStamped":
            "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform",
        "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
        "geometry_msgs/Quaternion": _POSE["geometry_msgs/Quaternion"]}),
    CONTACT_STATE: (_CONTACT, _HEADER | _VECTOR | {"geometry_msgs/Point": _POSE["geometry_msgs/Point"]}),
    SCENE_UPDATE: ("foxglove_msgs/SceneEntityDeletion[] deletions\nfoxglove_msgs/SceneEntity[] entities", _SCENE),
}  # fmt: skip

#: Encapsulation header of little-endian CDR. The fields after it are aligned as if it were at offset zero.
CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
_SEPARATOR = "\n" + 80 * "=" + "\n"
_SECONDS = (-(2**31), 2**31 - 1)
_MAX_SECONDS = 9e9  #: Maximum number of seconds in 63 bits of nanoseconds.


def definition(name: str) -> bytes:
    """Return the definition of a message type with all types it contains, in the `ros2msg` format."""
    own, parts = _DEFINITIONS[name]
    return (_SEPARATOR.join([own, *(f"MSG: {part}\n{text}" for part, text in parts.items())]) + "\n").encode()


def nanoseconds(time: ArrayLike) -> Nanoseconds:
    """Return times [s] as integer nanoseconds, limited to what a header can represent."""
    seconds_known = np.nan_to_num(np.asarray(time, dtype=float))
    whole: Nanoseconds = np.rint(np.clip(seconds_known, -_MAX_SECONDS, _MAX_SECONDS) * 1e9).astype(np.int64)
    return whole


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


class CdrBuilder:
    """Builds one message of any type, field by field; each is aligned to its size."""

    def __init__(self) -> None:
        self._data = bytearray(CDR_LITTLE_ENDIAN)

    def pack(self, kind: str, *values: float) -> "CdrBuilder":
        """Append numbers of one `struct` kind: b, B, ?, i, I, d."""
        self._align(struct.calcsize(f"<{kind}"))
        self._data += struct.pack(f"<{len(values)}{kind}", *values)
        return self

    def time(self, stamp: int) -> "CdrBuilder":
        """Append a time stamp [ns], limited to 32 bits of seconds."""
        second, rest = divmod(stamp, 1_000_000_000)
        return self.pack("i", max(min(second, _SECONDS[1]), _SECONDS[0])).pack("I", rest)

    def string(self, text: str) -> "CdrBuilder":
        """Append a string."""
        content = text.encode() + b"\0"
        self.pack("I", len(content))
        self._data += content
        return self

    def array(self, values: NDArray[Any], kind: str) -> "CdrBuilder":
        """Append a sequence: the number of rows, then all numbers as one `numpy` kind: <f8, <u4."""
        self.pack("I", len(values))
        if len(values):
            data = np.ascontiguousarray(values, kind)
            self._align(data.itemsize)
            self._data += data.tobytes()
        return self

    def message(self) -> Bytes:
        """Return the message, (1,)."""
        return np.frombuffer(bytes(self._data), f"V{len(self._data)}")

    def _align(self, size: int) -> None:
        self._data += bytes(-(len(self._data) - len(CDR_LITTLE_ENDIAN)) % size)


def transform(parent: str, child: str, stamp: int, p: Sequence[float], q: Sequence[float]) -> Bytes:
    """Return a TF message with one transform, (1,).

    Args:
        parent: frame in which the pose is given.
        child: frame whose pose it is.
        stamp: time stamp [ns].
        p: origin of the child [m], three numbers.
        q: orientation as a quaternion x, y, z, w.
    """
    builder = CdrBuilder().pack("I", 1).time(stamp).string(parent).string(child)
    return builder.pack("d", *p, *q).message()


def read_stamped(data: bytes | memoryview, doubles: int) -> tuple[int, str, tuple[float, ...]]:
    """Return time stamp [ns], frame and doubles of a message with a header.

    Raises:
        ValueError: the bytes are not such a message.
    """
    order = _order(data)
    try:
        second, rest, length = struct.unpack_from(f"{order}iII", data, 4)
        start = 16 + length + -(12 + length) % 8
        values = struct.unpack_from(f"{order}{doubles}d", data, start)
    except struct.error:
        raise ValueError(f"{len(data)} bytes are too short") from None
    return second * 1_000_000_000 + rest, _string(data[16 : 16 + length]), values


def read_wrenches(messages: Sequence[bytes | memoryview]) -> Array:
    """Return the wrenches of messages, (n, 6), without headers; messages of one writer are decoded at once.

    Raises:
        ValueError: the bytes of one are not such a message.
    """
    if messages and len({(len(each), bytes(each[:4]), bytes(each[12:16])) for each in messages}) == 1:
        first = messages[0]
        length = int.from_bytes(first[12:16], "little")  # of the frame's name
        if bytes(first[:4]) == CDR_LITTLE_ENDIAN and len(first) >= 16 and length < len(first):
            dtype = _message_dtype(length, 6)
            if dtype.itemsize == len(first):
                return np.frombuffer(b"".join(messages), dtype)["values"]
    return np.array([read_stamped(each, 6)[2] for each in messages]).reshape(-1, 6)


def read_text(data: bytes | memoryview) -> str:
    """Return the text of a string message.

    Raises:
        ValueError: the bytes are not such a message.
    """
    order = _order(data)
    if len(data) < 8 or len(data) < 8 + (length := struct.unpack_from(f"{order}I", data, 4)[0]):
        raise ValueError(f"{len(data)} bytes are too short")
    return _string(data[8 : 8 + length])


def _order(data: bytes | memoryview) -> str:
    if len(data) < 4 or data[0] != 0 or data[1] not in (0, 1):
        raise ValueError("not a CDR message")
    return "<" if data[1] else ">"


def _string(data: bytes | memoryview) -> str:
    return bytes(data).rstrip(b"\0").decode("utf-8", errors="replace")


METADATA_NAME = "probedesign"  #: Name of the metadata record of our recordings.
#: Name of the metadata record with the offset of the clocks, and its key.
CLOCK_NAME, OFFSET_KEY = "probedesign_clock", "wall_minus_source_ns"


@dataclass(frozen=True, eq=False)
class Topic:
    """A topic of our recordings."""

    name: str  #: name in ROS.
    type: str  #: type of its messages.
    schema: dict[str, Any]  #: JSON Schema of the JSON in its strings; empty for other messages.
    #: whether a subscriber receives the last message even if it was sent before (transient local).
    latched: bool = False

    @property
    def metadata(self) -> dict[str, str]:
        """Metadata of the channel: the QoS profile that rosbag2 needs to play it, and the JSON Schema."""
        known = {"json_schema": json.dumps(self.schema)} if self.schema else {}
        return {"offered_qos_profiles": _qos(self.latched)} | known


#: Metadata record without which newer versions of rosbag2 expect the policies of a QoS profile as words. Source:
#: rosbag2_storage_mcap, `MCAPStorage::read_metadata`; rosbag2_storage, `qos.cpp`.
QOS_METADATA = {"rosbag2": {"offered_qos_profiles": "numbers, as in version 8 of rosbag2's metadata"}}
_FOREVER = "\n    sec: 9223372036\n    nsec: 854775807"


def _qos(latched: bool) -> str:
    """Return the QoS profile of a publisher as YAML: keep last, reliable, volatile or transient local, automatic."""
    history, depth, reliability, durability, liveliness = 1, 10, 1, 1 if latched else 2, 1
    return (
        f"- history: {history}\n  depth: {depth}\n  reliability: {reliability}\n  durability: {durability}\n"
        f"  deadline:{_FOREVER}\n  lifespan:{_FOREVER}\n  liveliness: {liveliness}\n"
        f"  liveliness_lease_duration:{_FOREVER}\n  avoid_ros_namespace_conventions: false"
    )


def _object(title: str, required: list[str], properties: dict[str, Any]) -> dict[str, Any]:
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": title, "type": "object"}
    return head | {"properties": properties, "required": required}


NUMBER = {"type": "number"}
NUMBER_OR_NULL = {"type": ["number", "null"]}
TEXT_VALUE = {"type": "string"}
NUMBERS = {"type": "array", "items": NUMBER}

#: Every reading as the sensor delivered it, in the sensor frame, bias included.
RAW = Topic("/probedesign/wrench_raw", WRENCH, {})
BLOCK = Topic(
    "/probedesign/block",
    TEXT,
    _object(
        "A block of readings: the raw wrenches since the last block, and what their headers do not contain",
        ["first", "readings", "gravity_base_m_s2", "stretch", "fault"],
        {
            "first": {"type": "integer", "description": "number of readings before it, including dropped ones"},
            "readings": {"type": "integer", "description": "number of its readings, the last ones on the topic"},
            "gravity_base_m_s2": {**NUMBERS, "minItems": 3, "maxItems": 3},
            "stretch": {"type": "integer", "description": "number of the uninterrupted stretch of readings"},
            "fault": {**TEXT_VALUE, "description": "fault of all readings; empty if none"},
        },
    ),
)
#: The wrench that was located: without bias, averaged, at the base.
WITHOUT_BIAS = Topic("/probedesign/wrench", WRENCH, {})
CONTACT = Topic("/probedesign/contact", UNCERTAIN_POSE, {})  #: Touched point in the base frame, for each result `ok`.
#: Touched point from all readings of a touch, for each fused result `ok`.
CONTACT_WORLD = Topic("/probedesign/contact_world", UNCERTAIN_POSE, {})
BASE = Topic("/probedesign/base", POSE, {})  #: Each pose of the base in the world that is used, by the source's clock.
ESTIMATE = Topic(
    "/probedesign/estimate",
    TEXT,
    _object(
        "An estimate; null where unknown",
        ["time_s", "result"],
        {
            **{name: NUMBER_OR_NULL for name in (*COLUMNS, *WORLD_COLUMNS)},
            **{name: TEXT_VALUE for name in ("phase", "fused_result", "stale")},
            "time_s": NUMBER,
            "result": {"enum": list(RESULTS)},
            "T_world_base": {"type": "array", "items": NUMBERS, "description": "4 × 4, if known"},
        },
    ),
)
#: Tares, marks, silence, loss, faults.
EVENT = Topic(
    "/probedesign/event", TEXT, _object("An event", ["event"], {"time_s": NUMBER_OR_NULL, "event": TEXT_VALUE})
)
#: The numbers of each estimate with its result and its phase, for plots.
STATE = Topic("/probedesign/state", CONTACT_STATE, {})
#: The bent probe, the sensor, and the contact with its 95 % ellipsoid and its force.
SCENE = Topic("/probedesign/scene", SCENE_UPDATE, {})
TF = Topic("/tf", TRANSFORMS, {})  #: Pose of the base in the world, as `BASE`.
TF_STATIC = Topic("/tf_static", TRANSFORMS, {}, latched=True)  #: Pose of the sensor in the base.
TOPICS = (RAW, BLOCK, WITHOUT_BIAS, CONTACT, CONTACT_WORLD, BASE, ESTIMATE, EVENT, STATE, SCENE, TF, TF_STATIC)
