"""A pose in words: the names of a packet, a line of JSON and a column of CSV, the same for all three."""

import json
import math
from collections.abc import Mapping
from typing import Any

from probedesign.errors import InputError
from probedesign.live.pose.timed import TimedPose, timed_pose
from probedesign.units import MM

NAMES = ("time_s", "x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw")


def pose_of(said: Mapping[str, Any]) -> TimedPose:
    """The pose that `NAMES` tell; other names are left alone.

    Raises:
        InputError: a name is missing, a value is no number, or they make no pose.
    """
    missing = [name for name in NAMES if name not in said]
    if missing:
        raise InputError(f"has no {', '.join(missing)}; a pose has {', '.join(NAMES)}")
    time, x, y, z, *q = (_number(name, said[name]) for name in NAMES)
    return timed_pose(time, [x * MM, y * MM, z * MM], q)


def pose_of_json(text: str | bytes) -> tuple[TimedPose, str]:
    """The pose of a JSON object, and the frame that it is told in, if it says `frame`.

    Raises:
        InputError: it is none.
    """
    try:
        said = json.loads(text)
    except (ValueError, RecursionError):
        raise InputError("is no JSON") from None
    if not isinstance(said, dict):
        raise InputError("is no JSON object")
    return pose_of(said), str(said.get("frame", ""))


def _number(name: str, value: Any) -> float:
    try:
        number = math.nan if isinstance(value, bool) or value is None else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"{name} = {str(value)[:40]!r} is not a finite number")
    return number
