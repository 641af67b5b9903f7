"""Topics and ROS 2 messages of an MCAP recording: CDR encoding, message definitions and JSON schemas.

Source: OMG DDSI-RTPS, CDR encapsulation; the definitions are those of ROS 2's common_interfaces.
"""

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

MCAP_MAGIC = b"\x89MCAP0\r\n"
"""The first and the last bytes of an MCAP file."""
RECORD_PREFIX = struct.Struct("<BQ")
"""Opcode of a record and the length of its content, before the content."""


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
Bytes = NDArray[np.void]
"""Messages of equal length, (n,)."""

WRENCH = "geometry_msgs/msg/WrenchStamped"
POSE = "geometry_msgs/msg/PoseStamped"
UNCERTAIN_POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TEXT = "std_msgs/msg/String"

_HEADER = {"std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
           "builtin_interfaces/Time": "int32 sec\nuint32 nanosec"}  # fmt: skip
_POSE = {"geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
         "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
         "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w"}  # fmt: skip
_DEFINITIONS = {
    WRENCH: ("std_msgs/Header header\ngeometry_msgs/Wrench wrench",
             _HEADER | {"geometry_msgs/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque",
                        "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z"}),
    POSE: ("std_msgs/Header header\ngeometry_msgs/Pose pose", _HEADER | _POSE),
    UNCERTAIN_POSE: ("std_msgs/Header header\ngeometry_msgs/PoseWithCovariance pose", _HEADER
                     | {"geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance"}
                     | _POSE),
    TEXT: ("string data", {}),
}  # fmt: skip

CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
"""Encapsulation header of little-endian CDR. The fields after it are aligned as if it were at offset zero."""
_SEPARATOR = "\n" + 80 * "=" + "\n"
_SECONDS = (-(2**31), 2**31 - 1)
_MAX_SECONDS = 9e9
"""Maximum number of seconds in 63 bits of nanoseconds."""


def definition(name: str) -> bytes:
    """Return the definition of a message type with all types it contains, in the `ros2msg` format."""
    own, parts = _DEFINITIONS[name]
    return (_SEPARATOR.join([own, *(f"MSG: {part}\n{text}" for part, text in parts.items())]) + "\n").encode()


def nanoseconds(time: ArrayLike) -> Nanoseconds:
    """Return times [s] as integer nanoseconds, limited to what a header can represent."""
    seconds_known = np.nan_to_num(np.asarray(time, dtype=float))
    whole: Nanoseconds = np.rint(np.clip(seconds_known, -_MAX_SECONDS, _MAX_SECONDS) * 1e9).astype(np.int64)
    return whole


def stamped(frame: str, stamps: ArrayLike, values: ArrayLike) -> Bytes:
    """Return messages of a header and doubles: wrenches, poses, poses with covariance.

    Args:
        frame: frame of the values.
        stamps: time stamps of the headers [ns], (n,), limited to 32 bits of seconds.
        values: the doubles in message order [SI], (n, doubles).

    Returns:
        The messages, (n,), of equal length.
    """
    numbers = np.asarray(values, dtype=float)
    seconds, rest = np.divmod(np.asarray(stamps, dtype=np.int64), 1_000_000_000)
    name = frame.encode() + b"\0"
    packed = np.zeros(len(numbers), _message_dtype(len(name), numbers.shape[1]))
    packed["encapsulation"], packed["name"] = np.void(CDR_LITTLE_ENDIAN), np.void(name)
    packed["length"] = len(name)
    packed["second"] = np.clip(seconds, *_SECONDS)
    packed["rest"] = np.where(seconds < _SECONDS[0], 0, np.where(seconds > _SECONDS[1], 999_999_999, rest))
    packed["values"] = numbers
    return packed.view(f"V{packed.dtype.itemsize}")


@cache
def _message_dtype(name: int, doubles: int) -> np.dtype[np.void]:
    """Return the layout of a message whose frame name has `name` bytes."""
    return np.dtype([
        ("encapsulation", "V4"), ("second", "<i4"), ("rest", "<u4"), ("length", "<u4"), ("name", f"V{name}"),
        ("padding", f"V{-(12 + name) % 8}"), ("values", "<f8", (doubles,)),
    ])  # fmt: skip


def texts(data: Sequence[str]) -> Bytes:
    """Return string messages, (n,), padded with spaces to equal length, which JSON ignores."""
    contents = [each.encode() for each in data]
    length = max(map(len, contents))
    head = CDR_LITTLE_ENDIAN + struct.pack("<I", length + 1)
    whole = b"".join(head + content.ljust(length) + b"\0" for content in contents)
    return np.frombuffer(whole, f"V{len(head) + length + 1}")


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
    """Return the byte order of the encapsulation header, as a `struct` character."""
    if len(data) < 4 or data[0] != 0 or data[1] not in (0, 1):
        raise ValueError("not a CDR message")
    return "<" if data[1] else ">"


def _string(data: bytes | memoryview) -> str:
    return bytes(data).rstrip(b"\0").decode("utf-8", errors="replace")


METADATA_NAME = "probedesign"
"""Name of the metadata record of our recordings."""


@dataclass(frozen=True, eq=False)
class Topic:
    """A topic of our recordings.

    Attributes:
        name: name in ROS.
        type: type of its messages.
        schema: JSON Schema of the JSON in its strings; empty for other messages.
    """

    name: str
    type: str
    schema: dict[str, Any]


def _object(title: str, required: list[str], properties: dict[str, Any]) -> dict[str, Any]:
    """Return the JSON Schema of a flat object; additional properties are allowed."""
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": title, "type": "object"}
    return head | {"properties": properties, "required": required}


NUMBER = {"type": "number"}
NUMBER_OR_NULL = {"type": ["number", "null"]}
TEXT_VALUE = {"type": "string"}
NUMBERS = {"type": "array", "items": NUMBER}

RAW = Topic("/probedesign/wrench_raw", WRENCH, {})
"""Every reading as the sensor delivered it, in the sensor frame, bias included."""
BLOCK = Topic(
    "/probedesign/block",
    TEXT,
    _object(
        "A block of readings: the raw wrenches since the last block, and what their headers do not contain",
        ["first", "time_s", "gravity_base_m_s2", "stretch", "fault"],
        {
            "first": {
                "type": "integer",
                "description": "number of readings before it, including dropped ones",
            },
            "time_s": {**NUMBERS, "description": "time of each reading, by the source's clock, exact"},
            "gravity_base_m_s2": {**NUMBERS, "minItems": 3, "maxItems": 3},
            "stretch": {"type": "integer", "description": "number of the uninterrupted stretch of readings"},
            "fault": {**TEXT_VALUE, "description": "fault of all readings; empty if none"},
        },
    ),
)
WITHOUT_BIAS = Topic("/probedesign/wrench", WRENCH, {})
"""The wrench that was located: without bias, averaged, at the base."""
CONTACT = Topic("/probedesign/contact", UNCERTAIN_POSE, {})
"""Touched point in the base frame, for each result `ok`."""
CONTACT_WORLD = Topic("/probedesign/contact_world", UNCERTAIN_POSE, {})
"""Touched point from all readings of a touch, for each fused result `ok`."""
BASE = Topic("/probedesign/base", POSE, {})
"""Each pose of the base in the world that is used, by the source's clock."""
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
EVENT = Topic(
    "/probedesign/event",
    TEXT,
    _object("An event", ["event"], {"time_s": NUMBER_OR_NULL, "event": TEXT_VALUE}),
)
"""Tares, marks, silence, loss, faults."""
TOPICS = (RAW, BLOCK, WITHOUT_BIAS, CONTACT, CONTACT_WORLD, BASE, ESTIMATE, EVENT)
