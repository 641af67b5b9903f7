"""The few ROS 2 messages of a recording as bytes: CDR, and the definition that lets any tool read them.

Source: OMG DDSI-RTPS, CDR encapsulation; the definitions are those of ROS 2's common_interfaces.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from probedesign.estimation.estimate import RESULTS
from probedesign.frames import Array
from probedesign.live.processing.estimates import COLUMNS, WORLD_COLUMNS

MCAP_MAGIC = b"\x89MCAP0\r\n"
"""The first and the last bytes of an MCAP file."""


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


Nanoseconds = NDArray[np.int64]
Bytes = NDArray[np.void]
"""Messages of one length, (n,)."""

WRENCH = "geometry_msgs/msg/WrenchStamped"
POSE = "geometry_msgs/msg/PoseStamped"
UNCERTAIN_POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TEXT = "std_msgs/msg/String"

_HEADER = {"std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
           "builtin_interfaces/Time": "int32 sec\nuint32 nanosec"}  # fmt: skip
_POSE = {"geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
         "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
         "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w"}  # fmt: skip
_PARTS = {
    WRENCH: ("std_msgs/Header header\ngeometry_msgs/Wrench wrench",
             _HEADER | {"geometry_msgs/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque",
                        "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z"}),
    POSE: ("std_msgs/Header header\ngeometry_msgs/Pose pose", _HEADER | _POSE),
    UNCERTAIN_POSE: ("std_msgs/Header header\ngeometry_msgs/PoseWithCovariance pose", _HEADER
                     | {"geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance"}
                     | _POSE),
    TEXT: ("string data", {}),
}  # fmt: skip

LITTLE = b"\x00\x01\x00\x00"
"""Encapsulation of little-endian CDR. What follows is aligned as if it began at zero."""
_RULE = "\n" + 80 * "=" + "\n"
_SECONDS = (-(2**31), 2**31 - 1)
_TELLABLE = 9e9
"""Seconds that 63 bits of nanoseconds hold."""


def definition(name: str) -> bytes:
    """The message's definition with all it consists of, as `ros2msg` has it."""
    own, parts = _PARTS[name]
    return (_RULE.join([own, *(f"MSG: {part}\n{text}" for part, text in parts.items())]) + "\n").encode()


def nanoseconds(time: ArrayLike) -> Nanoseconds:
    """Times [s] as whole nanoseconds, as near as a header can tell them."""
    told = np.nan_to_num(np.asarray(time, dtype=float))
    whole: Nanoseconds = np.rint(np.clip(told, -_TELLABLE, _TELLABLE) * 1e9).astype(np.int64)
    return whole


def stamped(frame: str, stamps: ArrayLike, values: ArrayLike) -> Bytes:
    """Messages that are a header and then doubles: wrenches, poses, poses with covariance.

    Args:
        frame: of the values.
        stamps: of the headers [ns], (n,); one that 32 bits of seconds do not hold is told as the nearest they do.
        values: [SI], as they stand in the message, (n, doubles).

    Returns:
        The messages, (n,), each of the same length.
    """
    numbers = np.asarray(values, dtype=float)
    seconds, rest = np.divmod(np.asarray(stamps, dtype=np.int64), 1_000_000_000)
    name = frame.encode() + b"\0"
    laid = np.zeros(len(numbers), _layout(len(name), numbers.shape[1]))
    laid["encapsulation"], laid["length"], laid["name"] = np.void(LITTLE), len(name), np.void(name)
    laid["second"] = np.clip(seconds, *_SECONDS)
    laid["rest"] = np.where(seconds < _SECONDS[0], 0, np.where(seconds > _SECONDS[1], 999_999_999, rest))
    laid["values"] = numbers
    return laid.view(f"V{laid.dtype.itemsize}")


@cache
def _layout(name: int, doubles: int) -> np.dtype[np.void]:
    """A message with a frame's name of so many bytes."""
    return np.dtype([
        ("encapsulation", "V4"), ("second", "<i4"), ("rest", "<u4"), ("length", "<u4"), ("name", f"V{name}"),
        ("padding", f"V{-(12 + name) % 8}"), ("values", "<f8", (doubles,)),
    ])  # fmt: skip


def texts(data: Sequence[str]) -> Bytes:
    """String messages, (n,), each filled up with spaces to the length of the longest: JSON does not mind."""
    contents = [each.encode() for each in data]
    length = max(map(len, contents))
    head = LITTLE + struct.pack("<I", length + 1)
    whole = b"".join(head + content.ljust(length) + b"\0" for content in contents)
    return np.frombuffer(whole, f"V{len(head) + length + 1}")


def read_stamped(data: bytes | memoryview, doubles: int) -> tuple[int, str, tuple[float, ...]]:
    """Stamp [ns], frame and doubles of a message that `stamped` or anybody else made.

    Raises:
        ValueError: it is no such message.
    """
    order = _order(data)
    try:
        second, rest, length = struct.unpack_from(f"{order}iII", data, 4)
        start = 16 + length + -(12 + length) % 8
        values = struct.unpack_from(f"{order}{doubles}d", data, start)
    except struct.error:
        raise ValueError(f"{len(data)} bytes are too few for it") from None
    return second * 1_000_000_000 + rest, _string(data[16 : 16 + length]), values


def read_wrenches(messages: Sequence[bytes | memoryview]) -> Array:
    """What wrenches say, (n, 6), without their headers; those of one writer are read at once.

    Raises:
        ValueError: one is no such message.
    """
    if messages and len({(len(each), bytes(each[:4]), bytes(each[12:16])) for each in messages}) == 1:
        first = messages[0]
        if bytes(first[:4]) == LITTLE and len(first) >= 16:
            layout = _layout(_frame_length(first), 6) if _frame_length(first) < len(first) else None
            if layout is not None and layout.itemsize == len(first):
                return np.frombuffer(b"".join(messages), layout)["values"]
    return np.array([read_stamped(each, 6)[2] for each in messages]).reshape(-1, 6)


def _frame_length(message: bytes | memoryview) -> int:
    """Of the frame's name in a little-endian header."""
    return int.from_bytes(message[12:16], "little")


def read_text(data: bytes | memoryview) -> str:
    """What a string message says.

    Raises:
        ValueError: it is no such message.
    """
    order = _order(data)
    if len(data) < 8:
        raise ValueError(f"{len(data)} bytes are too few for it")
    (length,) = struct.unpack_from(f"{order}I", data, 4)
    if len(data) < 8 + length:
        raise ValueError(f"{len(data)} bytes are too few for it")
    return _string(data[8 : 8 + length])


def _order(data: bytes | memoryview) -> str:
    """How struct calls the byte order that the encapsulation names."""
    if len(data) < 4 or data[0] != 0 or data[1] not in (0, 1):
        raise ValueError("it is not CDR")
    return "<" if data[1] else ">"


def _string(data: bytes | memoryview) -> str:
    return bytes(data).rstrip(b"\0").decode("utf-8", errors="replace")


OURS = "probedesign"
"""Metadata of this name stand in our recordings."""


@dataclass(frozen=True, eq=False)
class Topic:
    """One topic.

    Attributes:
        name: in ROS.
        type: of its messages.
        schema: of the JSON that its strings hold, as JSON Schema; empty where they hold none.
    """

    name: str
    type: str
    schema: dict[str, Any]


def _object(title: str, required: list[str], properties: dict[str, Any]) -> dict[str, Any]:
    """A JSON Schema of one flat object; what it does not name may be there too."""
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": title, "type": "object"}
    return head | {"properties": properties, "required": required}


NUMBER = {"type": "number"}
NUMBER_OR_NULL = {"type": ["number", "null"]}
TEXT_VALUE = {"type": "string"}
NUMBERS = {"type": "array", "items": NUMBER}

RAW = Topic("/probedesign/wrench_raw", WRENCH, {})
"""Every reading as the sensor gave it, in its frame, bias included."""
BLOCK = Topic(
    "/probedesign/block",
    TEXT,
    _object(
        "Readings that came together: the raw wrenches since the last of these, and what their headers cannot tell",
        ["first", "time_s", "gravity_base_m_s2", "stretch", "fault"],
        {
            "first": {
                "type": "integer",
                "description": "readings before it, those included that were left out",
            },
            "time_s": {**NUMBERS, "description": "of each, by the source's clock, to the last bit"},
            "gravity_base_m_s2": {**NUMBERS, "minItems": 3, "maxItems": 3},
            "stretch": {"type": "integer", "description": "counts what was read without an interruption"},
            "fault": {**TEXT_VALUE, "description": "what is wrong with all of them; empty if nothing"},
        },
    ),
)
WITHOUT_BIAS = Topic("/probedesign/wrench", WRENCH, {})
"""What was estimated from: without bias, averaged, at the base."""
CONTACT = Topic("/probedesign/contact", UNCERTAIN_POSE, {})
"""The touched point in the base frame, with each result `ok`."""
CONTACT_WORLD = Topic("/probedesign/contact_world", UNCERTAIN_POSE, {})
"""The touched point of all readings of a touch, with each fused result `ok`."""
BASE = Topic("/probedesign/base", POSE, {})
"""Each pose of the base in the world that counts, by the source's clock."""
ESTIMATE = Topic(
    "/probedesign/estimate",
    TEXT,
    _object(
        "What the probe says; null where the result does not tell",
        ["time_s", "result"],
        {
            **{name: NUMBER_OR_NULL for name in (*COLUMNS, *WORLD_COLUMNS)},
            **{name: TEXT_VALUE for name in ("phase", "fused_result", "stale")},
            "time_s": NUMBER,
            "result": {"enum": list(RESULTS)},
            "T_world_base": {"type": "array", "items": NUMBERS, "description": "4 × 4, where it is known"},
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
