"""Poses of the base by the clock of the wrench: from any source that `--pose` names, with a check of their latency."""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from pkgutil import resolve_name
from time import monotonic

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.live import Log
from probedesign.live.poses.pose_sources import POSE_STREAMS, PoseStream, read_pose_file
from probedesign.live.poses.track import MAX_GAP, MAX_POSES, ClockOffset, PoseTrack, TimedPose
from probedesign.live.processing.blocks import Block
from probedesign.live.sources.source import SourceParameter, parse_parameters

POSE_WAIT = 2.0
"""Maximum wait of an estimate for the next pose, in units of the maximum gap."""
GRAVITY_WORLD = (0.0, 0.0, -9.81)
"""Gravity in a world whose z axis points up [m/s²]."""


class BasePoses:
    """Pose of the base at any time that is enclosed by poses.

    Poses of a file or a bag are by the wrench's clock already. Poses of a listener are by the robot's clock: both
    clocks are related to this machine's by the minimum delay of their messages.

    Attributes:
        title: one line that describes the poses.
        notes: notes for the user, one line each.
        gravity_world: gravity vector in the world [m/s²], (3,).
        latency: delay of a pose's time stamp relative to a reading of the same instant [s].
        track: the poses by the wrench's clock, corrected for latency.
        on_pose: callback for each pose, once and in order, as the readings reach it; a recording needs them for
            replay.
    """

    def __init__(
        self,
        title: str,
        poses: list[TimedPose] | PoseStream,
        *,
        latency: float = 0.0,
        max_gap: float = MAX_GAP,
        gravity_world: Array | None = None,
        notes: tuple[str, ...] = (),
        log: Log = lambda line: None,
    ) -> None:
        """Start with all poses by the wrench's clock, or with a listener that receives them.

        `max_gap` is that of `PoseTrack` [s]; gravity is 9.81 m/s² along -z if it is None.
        """
        self.title, self.notes, self.latency = title, notes, latency
        self.gravity_world = np.array(GRAVITY_WORLD if gravity_world is None else gravity_world, dtype=float)
        self._log = log
        self._listener = None if isinstance(poses, list) else poses
        if not isinstance(poses, list):
            self.track = PoseTrack(max_gap, MAX_POSES)
        else:
            self.track = PoseTrack.of((self._delayed(pose, -latency) for pose in poses), max_gap)
        self._wrench, self._robot = ClockOffset(), ClockOffset()
        self._session = 0
        self._cached: tuple[float, Array | None] = (math.nan, None)
        self._reported, self._since = -math.inf, math.nan
        self.on_pose: Callable[[TimedPose], None] = lambda pose: None

    def refresh(self, block: Block) -> None:
        """Process the poses received since the last call and the readings' clock; report each pose to `on_pose`."""
        if len(block) == 0:
            return
        if math.isnan(self._since):
            self._since = float(block.time[0])
        if self._listener is not None:
            self._receive(self._listener, block)
        for pose in self.track.spanning(self._since, math.inf if self._listener else float(block.time[-1])):
            if pose.time > self._reported:
                self._reported, self._since = pose.time, max(pose.time, self._since)
                self.on_pose(pose)

    def _receive(self, listener: PoseStream, block: Block) -> None:
        for line in listener.pop_messages():
            self._log(line)
        now = monotonic()
        for time, received in zip(block.time.tolist(), block.received.tolist(), strict=True):
            self._wrench.add(time, received if math.isfinite(received) else now)
        for arrival, pose, session in listener.pop():
            if session != self._session:
                self._session, self._robot = session, ClockOffset()
            ahead = self._robot.add(pose.time, arrival) - self._wrench.value
            self.track.add(self._delayed(pose, ahead - self.latency))

    def at(self, time: float) -> Array | None:
        """Return T_world_base (4, 4) at a time [s]; None if no reliable pose is known."""
        if time != self._cached[0] or self._cached[1] is None:  # a batch needs the same pose several times
            self._cached = (time, self.track.at(time))
        return self._cached[1]

    def may_arrive(self, time: float, newest: float) -> bool:
        """Return whether the pose after a time may still arrive, with the newest reading at `newest` [s]."""
        if self._listener is None or self.track.end >= time:
            return False
        return newest - time < POSE_WAIT * self.track.max_gap

    def reason(self, time: float) -> str:
        """Return why there is no pose at a time."""
        return f"no pose of the base at {time:.6g} s: {self.track.reason(time)}"

    def gravity(self, T_world_base: Array) -> Array:
        """Return the gravity vector in base axes [m/s²], (3,)."""
        return np.asarray(T_world_base[:3, :3].T @ self.gravity_world, dtype=float)

    def close(self) -> None:
        """Stop the listener and report its counts."""
        if self._listener is not None:
            self._listener.close()
            for line in (*self._listener.pop_messages(), f"{self.title}: {self._listener.summary}"):
                self._log(line)

    @staticmethod
    def _delayed(pose: TimedPose, seconds: float) -> TimedPose:
        """Return the pose with a later time stamp, rounded to nanoseconds so that a recording of it is exact."""
        return TimedPose(round(pose.time + seconds, 9), pose.p, pose.q)


FIXED = "fixed"
MAX_LATENCY = 10.0
"""Maximum latency [s]; a larger value indicates a wrong unit."""
GRAVITY_RANGE = (1.0, 30.0)
"""Range of the magnitude of gravity [m/s²], from the Moon's to the limit of recordings."""


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
    latency, gravity = 1e-3 * latency_ms, _gravity(gravity_world)
    if spec == FIXED:
        if latency or gravity is not None:
            others = "a file of poses, a ROS 2 bag or a robot"
            raise InputError(f"--pose fixed has no latency and no world frame; use {others}")
        return None
    target, _, query = spec.partition("?")
    # imported here, since the recordings import this module
    from probedesign.live.sources.rosbag import is_bag_path, read_bag_poses

    scheme, path = target.partition(":")[0], Path(target)
    stream = POSE_STREAMS.get(scheme) if ":" in target else None
    in_bag = stream is None and is_bag_path(path)
    limit = {"limit_ms": SourceParameter(1e3 * MAX_GAP, 1.0, 60_000.0)}
    topics = dict.fromkeys(("topic", "world", "base") if in_bag else stream[2] if stream else (), ())
    numbers, texts = parse_parameters(f"--pose {target}", query, limit, topics)
    max_gap = 1e-3 * numbers["limit_ms"]
    if stream is not None:
        poses: PoseStream = resolve_name(stream[1])(target, texts)
        return BasePoses(
            poses.title, poses, latency=latency, max_gap=max_gap, gravity_world=gravity, notes=poses.notes, log=log
        )
    known = read_bag_poses(path, **texts) if in_bag else read_pose_file(path)
    title = f"{len(known)} poses of {path}, {known[0].time:.9g} ... {known[-1].time:.9g} s"
    return BasePoses(title, known, latency=latency, max_gap=max_gap, gravity_world=gravity, log=log)


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


MAX_SHIFT = 0.200
"""Maximum shift that is tested, in both directions [s]."""
STEP = 0.004
"""Step between shifts [s]."""
MIN_REPORTED = 0.010
"""Minimum latency that is reported [s]: at 10 mm/s it is 0.1 mm, the tolerance of a tracker's keyframe."""
MIN_CHI2_GAIN = 25.0
"""Minimum decrease of χ² by the shift: five standard deviations."""
MAX_STD_SHARE = 0.2
"""Maximum standard deviation of the shift, as a fraction of `MIN_REPORTED`."""
MIN_TRAVEL = 0.5e-3
"""Minimum travel of the base [m]."""
GAP = 0.1
"""Maximum interval between readings of a touch [s]."""
MIN_READINGS = 20
"""Minimum number of readings within the range of all shifts."""
SPAN = 4.0
"""Length of the last part of a touch that is used [s]."""
MAX_READINGS = 800
"""Maximum number of readings: `SPAN` at 7000/36 readings per second."""


@dataclass
class LatencyCheck:
    """Collects the readings of one touch and estimates the latency of its poses.

    While the probe touches, its wrench follows the base: a press that starts or stops must show in both at once. The
    base's travel along its principal direction and the wrench along its own are compared with a time shift; the shift
    at which a parabola of the travel fits the wrench best is the remaining latency. The probe is assumed to follow
    without delay; a soft probe that creeps looks like poses that are early.
    """

    whiten: Array  #: whitening matrix of one reading, (6, 6).
    _readings: deque[tuple[float, Array, Array]] = field(default_factory=lambda: deque(maxlen=MAX_READINGS))

    def add(self, time: float, p_world_base: Array, wrench: Array) -> None:
        """Add a reading of the touch [s, m, N and N·m]; a gap starts another touch."""
        if self._readings and time - self._readings[-1][0] > GAP:
            self.reset()
        self._readings.append((time, p_world_base, self.whiten @ wrench))
        while time - self._readings[0][0] > SPAN:
            self._readings.popleft()

    def reset(self) -> None:
        """Discard the readings: the touch is over."""
        self._readings.clear()

    def delay(self) -> float:
        """Return by how much the poses are later than stated [s]; NaN if the touch does not determine it."""
        if len(self._readings) < MIN_READINGS:
            return math.nan
        time = np.array([t for t, _, _ in self._readings])
        travel = _principal_component(np.array([p for _, p, _ in self._readings]))
        wrench = _principal_component(np.array([w for _, _, w in self._readings]))
        inside = (time >= time[0] + MAX_SHIFT) & (time <= time[-1] - MAX_SHIFT)
        if inside.sum() < MIN_READINGS or np.ptp(travel[inside]) < MIN_TRAVEL:
            return math.nan
        shifts = np.arange(-MAX_SHIFT, MAX_SHIFT + 0.5 * STEP, STEP)
        residuals = np.array([_residual(np.interp(time[inside] + s, time, travel), wrench[inside]) for s in shifts])
        i = int(np.argmin(residuals))
        noise = max(1.0, residuals[i] / (inside.sum() - 4))
        unshifted = residuals[len(shifts) // 2]
        if unshifted - residuals[i] < MIN_CHI2_GAIN * noise:
            return 0.0
        if i in (0, len(shifts) - 1):
            return math.nan
        before, here, after = residuals[i - 1 : i + 2]
        bend = before - 2.0 * here + after
        delay = float(shifts[i] + 0.5 * STEP * (before - after) / bend)
        std = STEP * math.sqrt(2.0 * noise / bend)  # where χ² increases by one
        return delay if std < MAX_STD_SHARE * MIN_REPORTED else math.nan


def _principal_component(rows: Array) -> Array:
    """Return the rows (n, k) along their principal direction, (n,)."""
    centred = rows - rows.mean(axis=0)
    return np.asarray(centred @ np.linalg.svd(centred, full_matrices=False)[2][0], dtype=float)


def _residual(travel: Array, wrench: Array) -> float:
    """Return the sum of squares of the wrench after fitting a parabola of the travel."""
    columns = np.stack([np.ones_like(travel), travel, travel * travel], axis=1)
    return float(np.sum((wrench - columns @ np.linalg.lstsq(columns, wrench)[0]) ** 2))
