"""Poses of the base by the clock of the wrench: from any source that `--pose` names, with a check of their latency."""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic
from urllib.parse import parse_qsl, urlsplit

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.live import Log
from probedesign.live.poses.pose_sources import PoseListener, read_pose_file
from probedesign.live.poses.track import MAX_GAP, MAX_POSES, ClockOffset, PoseTrack, TimedPose
from probedesign.live.processing.blocks import Block

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
        on_pose: callback for each pose, once and in order, as the readings reach it; a recording needs them for replay.
    """

    def __init__(
        self,
        title: str,
        poses: list[TimedPose] | PoseListener,
        *,
        latency: float = 0.0,
        max_gap: float = MAX_GAP,
        gravity_world: Array | None = None,
        notes: tuple[str, ...] = (),
        log: Log = lambda line: None,
    ) -> None:
        """Start with the given poses.

        Args:
            title: one line that describes the poses.
            poses: all poses by the wrench's clock, or a listener that receives them.
            latency: stated latency [s].
            max_gap: see `PoseTrack` [s].
            gravity_world: gravity vector [m/s²]; None is 9.81 m/s² along -z.
            notes: notes for the user.
            log: callback for messages to the user.
        """
        self.title, self.notes, self.latency = title, notes, latency
        self.gravity_world = np.array(GRAVITY_WORLD if gravity_world is None else gravity_world, dtype=float)
        self._log = log
        self._listener = poses if isinstance(poses, PoseListener) else None
        if isinstance(poses, PoseListener):
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
        self._report_until(float(block.time[-1]) if self._listener is None else math.inf)

    def _report_until(self, time: float) -> None:
        for pose in self.track.spanning(self._since, time):
            if pose.time > self._reported:
                self._reported, self._since = pose.time, max(pose.time, self._since)
                self.on_pose(pose)

    def _receive(self, listener: PoseListener, block: Block) -> None:
        for line in listener.pop_messages():
            self._log(line)
        now = monotonic()
        for time, received in zip(block.time.tolist(), block.received.tolist(), strict=True):
            self._wrench.add(time, received if math.isfinite(received) else now)
        for arrival, pose, session in listener.pop_poses():
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
LOCAL = "127.0.0.1"
KINDS = "fixed, a file of poses, a ROS 2 bag and udp://:PORT"
MAX_LATENCY = 10.0
"""Maximum latency [s]; a larger value indicates a wrong unit."""
GRAVITY_RANGE = (1.0, 30.0)
"""Range of the magnitude of gravity [m/s²], from the Moon's to the limit of recordings."""


def open_poses(
    spec: str, latency_ms: float = 0.0, gravity_world: str | None = None, log: Log = lambda line: None
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
    from probedesign.live.sources.rosbag import (
        is_bag_path,
        read_bag_poses,
    )  # the recordings import this module

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

    Attributes:
        whiten: whitening matrix of one reading, (6, 6).
    """

    whiten: Array
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
        residuals = np.array(
            [_residual(np.interp(time[inside] + s, time, travel), wrench[inside]) for s in shifts]
        )
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
