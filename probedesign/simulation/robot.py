"""Motion of simulated robots: cyclic presses for the Net F/T box, a trajectory for a mapping run, poses sent by UDP.

`BaseMotion` presses the objects of a scene cyclically; `SimulatedTrajectory` is built point by point while a run is
simulated; `SimulatedRobot` sends the poses of a `BaseMotion` for `live --pose udp://`.
"""

import json
import math
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from time import monotonic
from urllib.parse import urlsplit

import numpy as np
from numpy.typing import NDArray

from probedesign.core.errors import InputError
from probedesign.core.frames import Array, pose, skew
from probedesign.core.units import MM
from probedesign.estimation.bias import WALK_STEPS
from probedesign.estimation.model import ProbeModel
from probedesign.live.blocks import Block
from probedesign.live.poses.base_poses import TimedPose, pose_from_matrix
from probedesign.simulation.scenes import PressedObject

# cyclic motion

REST_TIME = 5.0  #: Free time at the start of a cycle [s], for a tare.
#: Durations of the move to the next object, of the press and of the retraction, and of the dwell [s].
MOVE_TIME, PRESS_TIME, CYCLE_DWELL_TIME = 1.0, 1.5, 3.0


@dataclass(frozen=True)
class BaseMotion:
    """Cyclic motion of the base: rest, then press, hold and retract for each object."""

    model: ProbeModel  #: the probe.
    objects: tuple[PressedObject, ...]  #: objects in the order in which they are pressed.

    @property
    def cycle_time(self) -> float:
        """Duration of a cycle [s]."""
        return REST_TIME + len(self.objects) * self._object_time

    @property
    def _object_time(self) -> float:
        return MOVE_TIME + 2.0 * PRESS_TIME + CYCLE_DWELL_TIME

    def wrench_sensor(self, time: Array) -> Array:
        """Return the wrench at the sensor without bias and noise [N, N·m], (n, 6), at times [s], (n,)."""
        index, travel, retracting = self._at(time)
        wrench = np.tile(self._free, (len(time), 1))
        for i in np.unique(index[index >= 0]):
            obj = self.objects[i]
            on, off = (index == i) & ~retracting, (index == i) & retracting
            wrench[on] = _interpolated(travel[on], obj.travel, obj.wrench_base)
            wrench[off] = _interpolated(travel[off], obj.travel_back, obj.wrench_back)
        return self.model.to_sensor(wrench, self.model.gravity_base)

    def p_world_base(self, time: Array) -> Array:
        """Return the position of the base [m], (n, 3), in a world that coincides with the base at rest.

        The objects are fixed in that world.
        """
        index, travel, _ = self._at(time)
        p = np.zeros((len(time), 3))
        for i in np.unique(index[index >= 0]):
            here = index == i
            p[here] = travel[here, None] * self.objects[i].direction
        return p

    def _at(self, time: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return the index of the object, -1 for none, the travel towards it [m], and whether the base retracts."""
        since = np.mod(time, self.cycle_time) - REST_TIME
        index = np.floor(since / self._object_time).astype(int)
        index = np.where(since < 0.0, -1, np.minimum(index, len(self.objects) - 1))
        phase = since - index * self._object_time
        knots = np.cumsum([0.0, MOVE_TIME, PRESS_TIME, CYCLE_DWELL_TIME, PRESS_TIME])
        fraction = np.interp(phase, knots, [0.0, 0.0, 1.0, 1.0, 0.0])
        ends = np.array([obj.travel[-1] for obj in self.objects] + [0.0])  # index -1 selects the last entry
        return index, fraction * ends[index], phase > MOVE_TIME + PRESS_TIME + CYCLE_DWELL_TIME

    @cached_property
    def _free(self) -> Array:
        return self.model.rod.solve(self.model.gravity_base, mode="reference").wrench_base


def _interpolated(at: Array, knots: Array, values: Array) -> Array:
    fraction = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, len(knots) - 2)
    low, high = knots[fraction], knots[fraction + 1]
    weight = np.clip((at - low) / (high - low), 0.0, 1.0)[:, None]
    between: Array = (1.0 - weight) * values[fraction] + weight * values[fraction + 1]
    return between


# trajectory of a mapping run

TARE_TIME = 4.0  #: Free time at the start [s], for a tare.
#: Durations of the move to the next object, of the approach and the retreat, and from one press to the next [s].
TRAVEL_TIME, APPROACH_TIME, STEP_TIME = 1.5, 1.0, 0.4
DWELL_TIME, FREE_TIME = 1.0, 2.0  #: Durations of the dwell at each press, and free before and after each touch [s].
#: Rates of sensor samples and of robot poses [Hz]. A Net F/T box sends 7000 samples; fewer make smaller files.
SAMPLE_RATE, POSE_RATE = 3500.0, 50.0
BLOCK_LENGTH = 200  #: Number of samples of a block.
STD_OFFSET_STEPS = 50.0  #: Standard deviation of the constant bias, in steps of the resolution.


@dataclass
class SimulatedTrajectory:
    """Trajectory of the base, linear between waypoints, with the wrench and the sensor bias at each of them."""

    R_world_base: Array  #: rotation of the base, which is constant, (3, 3).
    wrench_free: Array  #: wrench of the free probe at the base [N, N·m], (6,).
    rng: np.random.Generator  #: random numbers of the bias.
    time_scale: float = 1.0  #: factor on all durations; sample and pose rates are divided by it.
    bias_rate: float = WALK_STEPS  #: random walk of the bias, in steps of the sensor's resolution per √s.
    times: list[float] = field(default_factory=list)  #: times of the waypoints [s].
    positions: list[Array] = field(default_factory=list)  #: positions of the base reported by the robot [m], (3,) each.
    wrenches: list[Array] = field(default_factory=list)  #: wrenches of the probe at its base [N, N·m], (6,) each.
    biases: list[Array] = field(default_factory=list)  #: bias of the sensor, in steps of its resolution, (6,) each.

    def __post_init__(self) -> None:
        """Start free in front of the house."""
        self._add(0.0, np.array([0.0, -0.2, 0.0]), self.wrench_free, np.zeros(6))
        self._dwell(TARE_TIME)

    @property
    def end(self) -> float:
        """Time of the last waypoint [s]."""
        return self.times[-1]

    def travel_to(self, p: Array) -> None:
        """Move the free probe to a position before an object [m], (3,), and dwell there."""
        self._move(TRAVEL_TIME, p, self.wrench_free)
        self._dwell(FREE_TIME)

    def approach(self, p: Array) -> None:
        """Move to the position of first contact [m], (3,)."""
        self._move(0.5 * APPROACH_TIME, p, self.wrench_free)

    def press(self, p: Array, wrench_base: Array) -> None:
        """Move to a press at a position [m], (3,), with its wrench [N, N·m], (6,), and dwell there."""
        self._move(STEP_TIME, p, wrench_base)
        self._dwell(DWELL_TIME)

    def retreat(self, p: Array) -> None:
        """Leave the object for a position [m], (3,), and dwell there."""
        self._move(APPROACH_TIME, p, self.wrench_free)
        self._dwell(FREE_TIME)

    def press_positions(self, n_presses: int) -> list[Array]:
        """Return the positions of the base at the presses of the object just left [m], (3,) each."""
        return self.positions[-2 * n_presses - 1 : -2 : 2]

    def poses(self) -> list[TimedPose]:
        """Return the poses that the robot reports."""
        time = self._sample_times(POSE_RATE)
        p = np.stack([np.interp(time, self.times, [p[i] for p in self.positions]) for i in range(3)], axis=1)
        q = pose_from_matrix(0.0, pose(self.R_world_base)).q
        return [TimedPose(t, tuple(at), q) for t, at in zip(time.tolist(), p.tolist(), strict=True)]

    def blocks(self, model: ProbeModel, rng: np.random.Generator) -> Iterator[Block]:
        """Yield single samples of the sensor: constant bias, random walk, white noise and finite resolution."""
        gravity = self.R_world_base.T @ np.array([0.0, 0.0, -9.81])
        step = model.noise.std * math.sqrt(
            model.averaging_samples
        )  # the noise of one sample is one step of the resolution
        time = self._sample_times(SAMPLE_RATE)
        wrench = model.to_sensor(self._interpolate(time, self.wrenches), gravity)
        offset = rng.normal(0.0, STD_OFFSET_STEPS, 6)
        steps = offset + self._interpolate(time, self.biases) + rng.standard_normal(wrench.shape)
        wrench = np.round(wrench / step + steps) * step
        for i in range(0, len(time), BLOCK_LENGTH):
            part = slice(i, i + BLOCK_LENGTH)
            yield Block(time[part], wrench[part], gravity, np.full(len(time[part]), np.nan))

    def _sample_times(self, rate: float) -> Array:
        return np.arange(0.0, self.end, self.time_scale / rate)

    def _interpolate(self, time: Array, values: list[Array]) -> Array:
        columns = np.array(values)
        return np.stack([np.interp(time, self.times, columns[:, i]) for i in range(6)], axis=1)

    def _move(self, seconds: float, p: Array, wrench_base: Array) -> None:
        seconds *= self.time_scale
        # The bias also walks during the dwell before the move; that part is added here.
        walk = self.rng.normal(0.0, self.bias_rate * math.sqrt(self.end - self.times[-2] + seconds), 6)
        self._add(self.end + seconds, p, wrench_base, self.biases[-1] + walk)

    def _dwell(self, seconds: float) -> None:
        time = self.end + self.time_scale * seconds
        self._add(time, self.positions[-1], self.wrenches[-1], self.biases[-1])

    def _add(self, time: float, p: Array, wrench_base: Array, bias: Array) -> None:
        self.times.append(time)
        self.positions.append(p)
        self.wrenches.append(wrench_base)
        self.biases.append(bias)


# poses sent by UDP

POSE_PERIOD = 0.008  #: Interval between poses [s], as of a robot controller.


class SimulatedRobot:
    """Sends the pose of the base in a world whose z axis points up. Use it as a context manager."""

    def __init__(self, motion: BaseMotion, motion_time: Callable[[], float], target: str) -> None:
        """Resolve the receiver.

        Args:
            motion: motion of the base.
            motion_time: returns the time since the motion started [s].
            target: HOST:PORT.

        Raises:
            InputError: this is not an address.
        """
        self._motion, self._motion_time = motion, motion_time
        try:
            parts = urlsplit(f"//{target}")
            self._target = (socket.gethostbyname(parts.hostname) if parts.hostname else "", parts.port or 0)
        except (ValueError, OSError):
            self._target = ("", 0)
        if not all(self._target):
            raise InputError(f"--pose-to {target} must be HOST:PORT, as 127.0.0.1:30010")
        self._R = upright_rotation(motion.model.gravity_base)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._send, name="robot", daemon=True)

    def __enter__(self) -> "SimulatedRobot":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def datagram(self, time: float, motion_time: float) -> bytes:
        """Return the datagram at a time by the robot's clock [s], `motion_time` after the motion started [s]."""
        p = self._R @ self._motion.p_world_base(np.array([motion_time]))[0]
        q = pose_from_matrix(time, pose(self._R)).q
        fields = zip(("time_s", "x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw"), (time, *p / MM, *q), strict=True)
        return json.dumps({"frame": "world", **{name: float(value) for name, value in fields}}).encode()

    def _send(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
            while not self._ended.wait(POSE_PERIOD):
                with suppress(OSError):  # there is no listener
                    udp.sendto(self.datagram(monotonic(), self._motion_time()), self._target)


def upright_rotation(gravity_base: Array) -> Array:
    """Return R_world_base of the base at rest (3, 3): the shortest rotation that turns gravity to -z."""
    down = gravity_base / np.linalg.norm(gravity_base)
    axis, cosine = np.cross(down, (0.0, 0.0, -1.0)), -float(down[2])
    if cosine < -1.0 + 1e-9:  # gravity points up: rotate by π about x
        return np.diag([1.0, -1.0, -1.0])
    K = skew(axis)
    return np.asarray(np.eye(3) + K + K @ K / (1.0 + cosine))
