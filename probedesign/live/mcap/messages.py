"""The few ROS 2 messages of a recording as bytes: CDR, and the definition that lets any tool read them.

Source: OMG DDSI-RTPS, CDR encapsulation; the definitions are those of ROS 2's common_interfaces.
"""

import struct
from collections.abc import Sequence
from functools import cache

import numpy as np

from probedesign.frames import Array

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


def nanoseconds(time: float | Array) -> Array:
    """Times [s] as whole nanoseconds, as near as a header can tell them."""
    return np.rint(np.clip(np.nan_to_num(time), -_TELLABLE, _TELLABLE) * 1e9).astype(np.int64)


def stamped(frame: str, nanosecond: int, values: Sequence[float]) -> bytes:
    """A message that is a header and then doubles: a wrench, a pose, a pose with covariance.

    Args:
        frame: of the values.
        nanosecond: the header's stamp; one that 32 bits of seconds do not hold is told as the nearest that they do.
        values: [SI], as they stand in the message.
    """
    layout, name = _layout(frame, len(values))
    second, rest = divmod(nanosecond, 1_000_000_000)
    if not _SECONDS[0] <= second <= _SECONDS[1]:
        second, rest = (_SECONDS[0], 0) if second < 0 else (_SECONDS[1], 999_999_999)
    return layout.pack(LITTLE, second, rest, len(name), name, *values)


@cache
def _layout(frame: str, doubles: int) -> tuple[struct.Struct, bytes]:
    name = frame.encode() + b"\0"
    padding = -(12 + len(name)) % 8
    return struct.Struct(f"<4siII{len(name)}s{padding}x{doubles}d"), name


def text(data: str) -> bytes:
    """A string message."""
    content = data.encode() + b"\0"
    return LITTLE + struct.pack("<I", len(content)) + content


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
