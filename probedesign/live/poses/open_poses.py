"""Opens the poses of the base that `--pose` specifies."""

from pathlib import Path
from urllib.parse import parse_qsl, urlsplit

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.live import Log
from probedesign.live.poses.base_poses import BasePoses
from probedesign.live.poses.listener import PoseListener
from probedesign.live.poses.pose_file import read_pose_file
from probedesign.live.poses.track import MAX_GAP
from probedesign.live.sources.rosbag import is_bag_path, read_bag_poses

FIXED = "fixed"
LOCAL = "127.0.0.1"
KINDS = "fixed, a file of poses, a ROS 2 bag and udp://:PORT"
MAX_LATENCY = 10.0
"""Maximum latency [s]; a larger value indicates a wrong unit."""
GRAVITY_RANGE = (1.0, 30.0)
"""Range of the magnitude of gravity [m/s²], from the Moon's to the limit of recordings."""


def open_poses(
    spec: str,
    latency_ms: float = 0.0,
    gravity_world: str | None = None,
    log: Log = lambda line: None,
) -> BasePoses | None:
    """Return the poses that a specification names; None for a base fixed as the frozen probe states.

    Args:
        spec: `fixed`, `FILE.csv`, `FILE.jsonl`, `BAG?topic=/pose`, `BAG?world=map&base=probe` or `udp://[HOST]:PORT`;
            `limit_ms=50` may follow the question mark.
        latency_ms: latency stated by the user [ms].
        gravity_world: three numbers [m/s²], as "0,0,-9.81".
        log: callback for messages to the user.

    Raises:
        InputError: the specification is unknown, cannot be read, or a number is out of range.
        MissingDependencyError: the package that reads it is not installed.
    """
    latency, gravity = _latency(latency_ms), _gravity(gravity_world)
    if spec == FIXED:
        if latency or gravity is not None:
            raise InputError(
                f"--pose fixed has no latency and no world frame; use --pose {KINDS.split(', ', 1)[1]}"
            )
        return None
    target, _, query = spec.partition("?")
    parameters = _parameters(spec, query)
    max_gap = _max_gap(spec, parameters.pop("limit_ms", ""))
    if target.startswith("udp:"):
        _refuse_unknown(spec, parameters)
        listener = PoseListener(*_address(target))
        host, port = listener.address
        notes = (
            f"listening for poses on {host}:{port}"
            + ("" if host.startswith("127.") else ": anyone on that network can send"),
        )
        return BasePoses(f"poses by UDP to {host}:{port}", listener, latency=latency, max_gap=max_gap,
                     gravity_world=gravity, notes=notes, log=log)  # fmt: skip
    path = Path(target)
    if is_bag_path(path):
        poses = read_bag_poses(
            path, parameters.pop("topic", ""), parameters.pop("world", ""), parameters.pop("base", "")
        )
    else:
        poses = read_pose_file(path)
    _refuse_unknown(spec, parameters)
    title = f"{len(poses)} poses of {path}, {poses[0].time:.9g} ... {poses[-1].time:.9g} s"
    return BasePoses(title, poses, latency=latency, max_gap=max_gap, gravity_world=gravity, log=log)


def _latency(milliseconds: float) -> float:
    if not abs(milliseconds) <= MAX_LATENCY / 1e-3:
        raise InputError(f"--pose-latency-ms {milliseconds:g} must be within ±{MAX_LATENCY / 1e-3:g}")
    return milliseconds * 1e-3


def _gravity(text: str | None) -> Array | None:
    if text is None:
        return None
    try:
        gravity = np.array([float(part) for part in text.split(",")])
    except ValueError:
        gravity = np.zeros(0)
    if gravity.shape != (3,) or not GRAVITY_RANGE[0] <= float(np.linalg.norm(gravity)) <= GRAVITY_RANGE[1]:
        raise InputError(f"--gravity-world {text} must be three numbers in m/s², as 0,0,-9.81")
    return gravity


def _parameters(spec: str, query: str) -> dict[str, str]:
    try:
        pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
    except ValueError:
        raise InputError(f"--pose {spec}: write parameters as name=value&name=value") from None
    if len(dict(pairs)) < len(pairs):
        raise InputError(f"--pose {spec}: a parameter is given twice; keep one")
    return dict(pairs)


def _refuse_unknown(spec: str, unknown: dict[str, str]) -> None:
    if unknown:
        known = "limit_ms, and of a bag topic, or world and base"
        raise InputError(f"--pose {spec}: {', '.join(unknown)} is not a parameter; known: {known}")


def _max_gap(spec: str, text: str) -> float:
    if not text:
        return MAX_GAP
    try:
        milliseconds = float(text)
    except ValueError:
        milliseconds = 0.0
    if not 1.0 <= milliseconds <= 60_000.0:
        raise InputError(f"--pose {spec}: limit_ms must be in 1 ... 60000")
    return milliseconds * 1e-3


def _address(target: str) -> tuple[str, int]:
    try:
        parts = urlsplit(target)
        host, port = parts.hostname or LOCAL, parts.port
    except ValueError:
        host, port = "", None
    if not host or port is None or parts.scheme != "udp" or parts.path.strip("/"):
        raise InputError(f"--pose {target}: write udp://:PORT, or udp://0.0.0.0:PORT for every network")
    return host, port
