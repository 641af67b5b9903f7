"""Opens the poses that `--pose` names: a fixed base, a file, a bag of ROS 2, or a stream."""

from pathlib import Path
from pkgutil import resolve_name

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.live import Log
from probedesign.live.poses.base_poses import MAX_GAP, BasePoses, PoseStream, TimedPose
from probedesign.live.poses.pose_sources import POSE_STREAMS, read_pose_file
from probedesign.live.sources.rosbag import is_bag_path, read_bag_poses
from probedesign.live.sources.source import SourceParameter, parse_parameters

FIXED = "fixed"
MAX_LATENCY = 10.0  #: Maximum latency [s]; a larger value indicates a wrong unit.
GRAVITY_RANGE = (1.0, 30.0)  #: Range of the magnitude of gravity [m/s²], from the Moon's to the limit of recordings.


def open_poses(
    spec: str, latency_ms: float = 0.0, gravity_world: str | None = None, log: Log = lambda line: None
) -> BasePoses | None:
    """Return the poses that a specification names; None for a base fixed as the frozen probe states.

    Args:
        spec: `fixed`, `FILE.csv`, `FILE.jsonl`, `BAG?topic=/pose`, `BAG?world=map&base=probe`, or a stream of
            `POSE_STREAMS`, as `udp://[HOST]:PORT`; `limit_ms=50` may follow the question mark.
        latency_ms: latency stated by the user [ms].
        gravity_world: three numbers [m/s²], as "0,0,-9.81".

    Raises:
        InputError: the specification is unknown, cannot be read, or a number is out of range.
        MissingDependencyError: the package that reads it is not installed.
    """
    if not abs(latency_ms) <= 1e3 * MAX_LATENCY:
        raise InputError(f"--pose-latency-ms {latency_ms:g} must be within ±{1e3 * MAX_LATENCY:g}")
    latency, gravity = 1e-3 * latency_ms, parse_gravity(gravity_world)
    if spec == FIXED:
        if latency or gravity is not None:
            others = "a file of poses, a ROS 2 bag or a robot"
            raise InputError(f"--pose fixed has no latency and no world frame; use {others}")
        return None
    target, _, query = spec.partition("?")
    scheme, path = target.partition(":")[0], Path(target)
    stream = POSE_STREAMS.get(scheme) if ":" in target else None
    in_bag = stream is None and is_bag_path(path)
    limit = {"limit_ms": SourceParameter(1e3 * MAX_GAP, 1.0, 60_000.0)}
    topics = dict.fromkeys(("topic", "world", "base"), ()) if in_bag else {}
    numbers, texts = parse_parameters(f"--pose {target}", query, limit, topics)
    poses: PoseStream | list[TimedPose]
    if stream is not None:
        poses = listener = resolve_name(stream[1])(target)
        title, notes = listener.title, listener.notes
    else:
        poses = known = read_bag_poses(path, **texts) if in_bag else read_pose_file(path)
        title, notes = f"{len(known)} poses of {path}, {known[0].time:.9g} ... {known[-1].time:.9g} s", ()
    max_gap = 1e-3 * numbers["limit_ms"] if "limit_ms" in query else None
    return BasePoses(title, poses, latency=latency, max_gap=max_gap, gravity_world=gravity, notes=notes, log=log)


def parse_gravity(text: str | None) -> Array | None:
    """Return the vector of --gravity-world [m/s²], (3,); None if it is not given.

    Raises:
        InputError: it cannot be read, or is no gravity.
    """
    if text is None:
        return None
    try:
        gravity = np.array([float(part) for part in text.split(",")])
    except ValueError:
        gravity = np.zeros(0)
    if gravity.shape != (3,) or not GRAVITY_RANGE[0] <= float(np.linalg.norm(gravity)) <= GRAVITY_RANGE[1]:
        raise InputError(f"--gravity-world {text} must be three numbers in m/s², as 0,0,-9.81")
    return gravity
