"""`--pose`: which poses of the base are meant."""

from collections.abc import Callable
from pathlib import Path
from urllib.parse import parse_qsl, urlsplit

import numpy as np

from probedesign.errors import InputError
from probedesign.frames import Array
from probedesign.live.poses.base_poses import Poses
from probedesign.live.poses.listener import Listener
from probedesign.live.poses.pose_file import read_file
from probedesign.live.poses.track import MAX_GAP
from probedesign.live.sources.rosbag import looks_like_bag, read_poses

FIXED = "fixed"
LOCAL = "127.0.0.1"
KINDS = "fixed, a file of poses, a ROS 2 bag and udp://:PORT"
MOST_LATENCY = 10.0
"""No pose is older when it comes [s]: it is a wrong unit."""
GRAVITIES = (1.0, 30.0)
"""What gravity can be, Moon to the ceiling of recordings [m/s²]."""


def open_poses(
    spec: str,
    latency_ms: float = 0.0,
    gravity_world: str | None = None,
    say: Callable[[str], None] = lambda line: None,
) -> Poses | None:
    """The poses that a specification names; None for a base that stands where the frozen probe says.

    Args:
        spec: `fixed`, `FILE.csv`, `FILE.jsonl`, `BAG?topic=/pose`, `BAG?world=map&base=probe` or `udp://[HOST]:PORT`;
            `limit_ms=50` may follow the question mark.
        latency_ms: as stated by the user.
        gravity_world: three numbers [m/s²], as "0,0,-9.81".
        say: takes each line that a user should know while it runs.

    Raises:
        InputError: there is nothing of that kind, it cannot be read, or a number makes no sense.
        MissingDependencyError: what it is read with is not installed.
    """
    latency, gravity = _latency(latency_ms), _gravity(gravity_world)
    if spec == FIXED:
        if latency or gravity is not None:
            raise InputError(
                f"--pose fixed has no latency and no world; say --pose {KINDS.split(', ', 1)[1]}"
            )
        return None
    place, _, query = spec.partition("?")
    said = _parameters(spec, query)
    limit = _limit(spec, said.pop("limit_ms", ""))
    if place.startswith("udp:"):
        _no_more(spec, said)
        listener = Listener(*_address(place))
        host, port = listener.address
        notes = (
            f"poses are heard on {host}:{port}"
            + ("" if host.startswith("127.") else ": anyone there can send"),
        )
        return Poses(f"poses by UDP to {host}:{port}", listener, latency=latency, limit=limit,
                     gravity_world=gravity, notes=notes, say=say)  # fmt: skip
    path = Path(place)
    if looks_like_bag(path):
        poses = read_poses(path, said.pop("topic", ""), said.pop("world", ""), said.pop("base", ""))
    else:
        poses = read_file(path)
    _no_more(spec, said)
    title = f"{len(poses)} poses of {path}, {poses[0].time:.9g} ... {poses[-1].time:.9g} s"
    return Poses(title, poses, latency=latency, limit=limit, gravity_world=gravity, say=say)


def _latency(milliseconds: float) -> float:
    if not abs(milliseconds) <= MOST_LATENCY / 1e-3:
        raise InputError(f"--pose-latency-ms {milliseconds:g} must be within ±{MOST_LATENCY / 1e-3:g}")
    return milliseconds * 1e-3


def _gravity(text: str | None) -> Array | None:
    if text is None:
        return None
    try:
        gravity = np.array([float(part) for part in text.split(",")])
    except ValueError:
        gravity = np.zeros(0)
    if gravity.shape != (3,) or not GRAVITIES[0] <= float(np.linalg.norm(gravity)) <= GRAVITIES[1]:
        raise InputError(f"--gravity-world {text} must be three numbers in m/s², as 0,0,-9.81")
    return gravity


def _parameters(spec: str, query: str) -> dict[str, str]:
    try:
        pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
    except ValueError:
        raise InputError(f"--pose {spec}: write parameters as name=value&name=value") from None
    if len(dict(pairs)) < len(pairs):
        raise InputError(f"--pose {spec}: a parameter is said twice; keep one")
    return dict(pairs)


def _no_more(spec: str, left: dict[str, str]) -> None:
    if left:
        known = "limit_ms, and of a bag topic, or world and base"
        raise InputError(f"--pose {spec}: {', '.join(left)} is no parameter of it; known: {known}")


def _limit(spec: str, text: str) -> float:
    if not text:
        return MAX_GAP
    try:
        milliseconds = float(text)
    except ValueError:
        milliseconds = 0.0
    if not 1.0 <= milliseconds <= 60_000.0:
        raise InputError(f"--pose {spec}: limit_ms must be in 1 ... 60000")
    return milliseconds * 1e-3


def _address(place: str) -> tuple[str, int]:
    try:
        parts = urlsplit(place)
        host, port = parts.hostname or LOCAL, parts.port
    except ValueError:
        host, port = "", None
    if not host or port is None or parts.scheme != "udp" or parts.path.strip("/"):
        raise InputError(f"--pose {place}: write udp://:PORT, or udp://0.0.0.0:PORT for every network")
    return host, port
