"""The way of a simulated base: poses that it tells, what the sensor feels there, how its bias walks."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from probedesign.estimation.detector import DRIFT_STEPS
from probedesign.estimation.model import ProbeModel
from probedesign.frames import Array, pose
from probedesign.live.poses.track import TimedPose, pose_from_matrix
from probedesign.live.processing.blocks import Block

REST = 4.0
"""Free of everything at the start [s]: time for a tare."""
MOVE, APPROACH, STEP = 1.5, 1.0, 0.4
"""To the next object, onto it or off it, from one press to the next [s]."""
STAND, FREE = 1.0, 2.0
"""At each pose; before and after a touch [s]."""
RATE, POSES = 3500.0, 50.0
"""Of the sensor's single samples and of told poses [Hz]. A Net F/T box sends 7000 samples; fewer make smaller files."""
AT_ONCE = 200
"""Readings to a block."""


@dataclass
class Way:
    """Knots, between which all goes along straight lines.

    Attributes:
        R_world_base: of the base, which does not turn, (3, 3).
        free: wrench of the free probe at the base [N, N·m], (6,).
        rng: of the bias.
        pace: how many times as long everything takes, readings and poses coming so many times more slowly.
        walk: of the bias in a second, in steps of the sensor's resolution.
        times: of the knots [s].
        told: where the robot says that the base is [m], (3,) each.
        felt: what the rod does to its mount [N, N·m], (6,) each.
        bias: of the sensor, in steps of its resolution, (6,) each.
    """

    R_world_base: Array
    free: Array
    rng: np.random.Generator
    pace: float = 1.0
    walk: float = DRIFT_STEPS
    times: list[float] = field(default_factory=list)
    told: list[Array] = field(default_factory=list)
    felt: list[Array] = field(default_factory=list)
    bias: list[Array] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Stand free in front of the house."""
        self._knot(0.0, np.array([0.0, -0.2, 0.0]), self.free, np.zeros(6))
        self._stay(REST)

    @property
    def now(self) -> float:
        """Time of the last knot [s]."""
        return self.times[-1]

    def go(self, p: Array) -> None:
        """Free, to before an object, and stand."""
        self._to(MOVE, p, self.free)
        self._stay(FREE)

    def comes(self, p: Array) -> None:
        """To where the object is first touched."""
        self._to(0.5 * APPROACH, p, self.free)

    def press(self, p: Array, felt: Array) -> None:
        """To the next press, and stand."""
        self._to(STEP, p, felt)
        self._stay(STAND)

    def leave(self, p: Array) -> None:
        """Off the object, and stand."""
        self._to(APPROACH, p, self.free)
        self._stay(FREE)

    def last_told(self, presses: int) -> list[Array]:
        """Where the base stood at the presses of the object that it has just left, (3,) each."""
        return self.told[-2 * presses - 1 : -2 : 2]

    def poses(self) -> list[TimedPose]:
        """As a robot tells them."""
        time = self._clock(POSES)
        at = np.stack([np.interp(time, self.times, [p[i] for p in self.told]) for i in range(3)], axis=1)
        q = pose_from_matrix(0.0, pose(self.R_world_base)).q
        return [TimedPose(t, tuple(p), q) for t, p in zip(time.tolist(), at.tolist(), strict=True)]

    def _clock(self, rate: float) -> Array:
        return np.arange(0.0, self.now, self.pace / rate)

    def blocks(self, model: ProbeModel, rng: np.random.Generator) -> Iterator[Block]:
        """Single samples of the sensor: a constant bias, its walk, noise, and the steps of its resolution.

        Args:
            model: the probe, for its noise, which is that of a mean of its `averaging_samples`.
            rng: of noise and constant bias.
        """
        gravity = self.R_world_base.T @ np.array([0.0, 0.0, -9.81])
        step = np.sqrt(
            np.diag(model.noise.covariance()) * model.averaging_samples
        )  # one sample's noise is one step
        time = self._clock(RATE)
        wrench = model.to_sensor(self._between(time, self.felt), gravity)
        steps = rng.normal(0.0, 50.0, 6) + self._between(time, self.bias) + rng.standard_normal(wrench.shape)
        wrench = np.round(wrench / step + steps) * step
        for i in range(0, len(time), AT_ONCE):
            part = slice(i, i + AT_ONCE)
            yield Block(time[part], wrench[part], gravity, np.full(len(time[part]), np.nan))

    def _between(self, time: Array, knots: list[Array]) -> Array:
        values = np.array(knots)
        return np.stack([np.interp(time, self.times, values[:, i]) for i in range(6)], axis=1)

    def _to(self, seconds: float, p: Array, felt: Array) -> None:
        self._knot(self.now + self.pace * seconds, p, felt, self._walked(self.pace * seconds))

    def _stay(self, seconds: float) -> None:
        self._knot(self.now + self.pace * seconds, self.told[-1], self.felt[-1], self.bias[-1])

    def _walked(self, seconds: float) -> Array:
        """The bias, which walks while the base moves as far as it would since it stood last, too."""
        stood = self.now - self.times[-2]
        walked: Array = self.bias[-1] + self.rng.normal(0.0, self.walk * np.sqrt(stood + seconds), 6)
        return walked

    def _knot(self, time: float, p: Array, felt: Array, bias: Array) -> None:
        self.times.append(time)
        self.told.append(p)
        self.felt.append(felt)
        self.bias.append(bias)
