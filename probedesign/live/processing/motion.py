"""Motion of the base: what it adds to the readings, and how much of it is not explained.

An accelerated base acts as gravity g - a, and a turning one adds the inertia of the parts on the sensor. Both come from
a parabola through the poses of the last `SPAN`, so they are `SPAN`/2 late. What this does not explain is bounded: the
change of the acceleration within that delay, and the sway of the probe, by one mode with the first natural frequency ω
and an assumed damping ratio ζ,

    ÿ + 2 ζ ω ẏ + ω² y = ω² a,   sway² = |y - a|² + |ẏ - ȧ|²/ω².

A probe that hits an object at a speed v starts with a sway of ω v. With the change of the reading by gravity this is a
number of standard deviations of one reading; below `LIMIT` of them the motion is explained within the noise, after

    time to rest = ln(sway / limit) / (ζ ω).
"""

import math
from functools import cache

import numpy as np

from probedesign.core.frames import Array
from probedesign.estimation.model import ProbeModel
from probedesign.live.poses.base_poses import BasePoses
from probedesign.rod.rod import natural_frequency

#: Damping ratio of the first mode. Assumed: the least of printed elastic resins and silicones; with more the sway ends
#: earlier than stated, and readings at rest confirm it.
DAMPING = 0.05
SPAN, POINTS = 0.1, 11  #: Length of the parabola [s], and number of poses in it.
STEP = SPAN / (POINTS - 1)
LIMIT = 1.0  #: Unexplained motion in standard deviations of a reading; its mean square adds half of the noise's.
#: Factor on all that for the modes beyond the first, a frequency that is off by ten percent, and an acceleration that
#: changes faster than before. Assumed.
MARGIN = 1.5
#: Travel of the base below which it rests [m]: five times the scatter of a robot's poses (`Tolerances.robot_mm`,
#: assumed); a rotation of 1 rad counts as 0.1 m, as in the tracker.
MAX_TRAVEL, LEVER = 50e-6, 0.1

#: Least number of periods of a sway in the readings that it is fitted to, and of readings in a period: with fewer, it
#: passes for a part of the parabola, and the variance of their mean grows by more than a fifth.
MIN_PERIODS, MIN_READINGS = 1.5, 2.0
SWAY_DAMPINGS, SWAY_STEPS = (0.03, 0.1, 0.2), 4  #: Of the first guesses of a sway, and steps from the best of them.

_t = np.linspace(-0.5 * SPAN, 0.5 * SPAN, POINTS)
#: Weights of the poses for the velocity at the end of the parabola and for the acceleration.
_FIT = np.linalg.pinv(np.stack([np.ones(POINTS), _t, 0.5 * _t * _t], axis=1))
_VELOCITY, _ACCELERATION = _FIT[1] + 0.5 * SPAN * _FIT[2], _FIT[2]


@cache
def parabola(n: int) -> Array:
    """Return an orthonormal basis of the parabolas through n values at equal intervals, (n, 3)."""
    return np.asarray(np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, n), 3))[0], dtype=float)


@cache
def _guesses(n: int) -> tuple[Array, Array]:
    """Return exponents of oscillations at n equal intervals, (k, 2), and an orthonormal basis of each, (k, n, 2)."""
    angles = np.arange(2.0 * math.pi * MIN_PERIODS / n, 2.0 * math.pi / MIN_READINGS, 1.0 / n)
    exponents = np.array([(-damping * angle, angle) for angle in angles for damping in SWAY_DAMPINGS])
    return exponents, np.stack([_oscillation(n, *exponent) for exponent in exponents])


def _oscillation(n: int, decay: float, angle: float) -> Array:
    """Return an orthonormal basis of Re(A exp((decay + i angle) k)) without its part that is a parabola, (n, 2)."""
    z = np.exp((decay + 1j * angle) * np.arange(n))
    basis = np.stack([z.real, z.imag], axis=1)
    return np.asarray(np.linalg.qr(basis - parabola(n) @ (parabola(n).T @ basis))[0], dtype=float)


def fit_sway(values: Array, at: Array) -> tuple[Array, float]:
    """Fit a parabola and one damped oscillation, Re(A exp(λ k)) with one λ, to values at equal intervals.

    Least squares with the amplitudes eliminated (variable projection).

    Args:
        values: k = 0, 1 ... of them, (n, m).
        at: numbers k at which the oscillation is wanted, (j,).

    Returns:
        The oscillation there, (j, m), and the sum of squares that is left.

    Source: G. H. Golub, V. Pereyra, SIAM J. Numer. Anal. 10, 1973.
    """
    n = len(values)
    rest = values - parabola(n) @ (parabola(n).T @ values)
    limits = (-0.5, 2.0 * math.pi * MIN_PERIODS / n), (0.0, 2.0 * math.pi / MIN_READINGS)
    exponents, bases = _guesses(n)
    exponent = exponents[int(np.argmax(np.square(bases.transpose(0, 2, 1) @ rest).sum(axis=(1, 2))))]

    def left(exponent: Array) -> Array:
        basis = _oscillation(n, *exponent)
        return np.asarray((rest - basis @ (basis.T @ rest)).ravel(), dtype=float)

    for _ in range(SWAY_STEPS):  # Gauss-Newton
        here = left(exponent)
        J = np.stack([left(exponent + step) - here for step in 1e-5 * np.eye(2)], axis=1) / 1e-5
        exponent = np.clip(exponent - np.linalg.lstsq(J, here)[0], *limits)
    z, z_at = (np.exp(complex(*exponent) * k) for k in (np.arange(n), at))
    amplitudes = np.linalg.lstsq(np.column_stack([parabola(n), z.real, z.imag]), values)[0]
    sway = np.stack([z_at.real, z_at.imag], axis=1) @ amplitudes[3:]
    return np.asarray(sway, dtype=float), float(np.square(left(exponent)).sum())


class MotionMonitor:
    """Follows the acceleration of the base and bounds what it does not explain.

    Attributes:
        sway: bound of the unexplained part in standard deviations of one reading.
        free_sway: the same without the sway by a contact.
        speed: of the base or of the tip, of the faster one [m/s].
        at_rest, turning: whether the base has neither moved nor turned for `SPAN`, and whether it has turned.
    """

    def __init__(self, model: ProbeModel, poses: BasePoses) -> None:
        self._model, self._poses = model, poses
        self._omega = 2.0 * math.pi * natural_frequency(model.rod)
        rest = model.rod.solve((0.0, 0.0, 0.0))
        self._ends = np.stack([np.array([0.0, 0.0, 0.0, 1.0]), np.append(rest.p_base[-1], 1.0)], axis=1)
        weights = np.gradient(rest.s) * model.rod.radius_at(rest.s) ** 2
        self._com = weights @ rest.p_base / weights.sum()  # of the rod, in base axes
        T = model.T_sensor_base
        from_com = rest.p_base - self._com
        spread = model.mass * (weights / weights.sum() * from_com.T) @ from_com
        rod_inertia = np.trace(spread) * np.eye(3) - spread  # about its centre of mass, in base axes
        self._inertia = model.payload.inertia + T[:3, :3] @ rod_inertia @ T[:3, :3].T
        self._payload_com = T[:3, :3].T @ (model.payload.p_com - T[:3, 3])
        g = model.gravity_base
        rod = np.stack([model.rod.solve(g + e).wrench_base - model.rod.solve(g - e).wrench_base for e in np.eye(3)]) / 2
        payload = -np.stack([model.to_base(np.zeros(6), e) for e in np.eye(3)])
        self._per_rod = float(np.linalg.norm(model.whiten @ rod.T, 2))  # standard deviations per m/s²
        self._per_all = float(np.linalg.norm(model.whiten @ (rod + payload).T, 2))
        self.reset()

    def reset(self) -> None:
        """Forget all poses: the base has leapt, or poses are missing."""
        self._rows, self._filled, self._next = np.zeros((POINTS, 12)), 0, math.nan
        self._accelerations = np.zeros((POINTS // 2 + 1, 12))  # the last one is the present one
        self._y, self._dy, self._impact = np.zeros(3), np.zeros(3), 0.0
        self.sway = self.free_sway = self.speed = 0.0
        self.at_rest = self.turning = False

    @property
    def explained(self) -> bool:
        """Whether the motion is explained within the noise."""
        return self.sway <= LIMIT

    @property
    def time_to_rest(self) -> float:
        """Time until the sway is within the noise if the base rests from now on [s]."""
        return 0.0 if self.explained else math.log(self.sway / LIMIT) / (DAMPING * self._omega)

    def update(self, time: float) -> None:
        """Take in the poses up to a time [s]."""
        if math.isnan(self._next) or time - self._next > 1.0:
            self.reset()
            self._next = time
        while self._next <= time:
            T = self._poses.track.at(self._next)
            self._next += STEP
            if T is None:
                following = self._next
                self.reset()
                self._next = following
                continue
            self._rows[:-1] = self._rows[1:]
            self._rows[-1] = T[:3].ravel()
            self._filled = min(self._filled + 1, POINTS)
            if self._filled == POINTS:
                self._advance()

    def on_contact(self) -> None:
        """Account for a contact: the touched part of the probe stops."""
        self._impact = max(self._impact, self._omega * self.speed)
        self.sway = max(self.sway, MARGIN * self._per_rod * self._impact)

    def on_smooth(self) -> None:
        """Account for readings that do not sway."""
        self._y, self._dy, self._impact = self._at(self._com), np.zeros(3), 0.0
        self.sway = self.free_sway = 0.0

    def gravity(self, T_world_base: Array) -> Array:
        """Return the effective gravity g - a at the rod's centre of mass, in base axes [m/s²], (3,)."""
        return np.asarray(T_world_base[:3, :3].T @ (self._poses.gravity_world - self._at(self._com)), dtype=float)

    def inertia(self, T_world_base: Array) -> Array:
        """Return what rod and parts on the sensor add to its reading because the base turns [N, N·m], (6,).

        With the angular velocity Ω and acceleration α in base axes: force -m R̈ (c - c_rod) of the centre of mass and
        moment -(J α + Ω × J Ω) about it; g - a at the rod's centre is in the effective gravity.
        """
        present = self._accelerations[-1].reshape(3, 4)[:, :3]
        if not present.any():
            return np.zeros(6)
        R, payload = T_world_base[:3, :3], self._model.payload
        R_sb = self._model.T_sensor_base[:3, :3]
        A, W = R.T @ present, R.T @ (_VELOCITY @ self._rows).reshape(3, 4)[:, :3]
        alpha, omega = (0.5 * R_sb @ np.array([X[2, 1] - X[1, 2], X[0, 2] - X[2, 0], X[1, 0] - X[0, 1]])
                        for X in (A, W))  # fmt: skip
        force = -payload.mass * (R_sb @ R.T) @ (self._at(self._payload_com) - self._at(self._com))
        moment = np.cross(payload.p_com, force) - self._inertia @ alpha - np.cross(omega, self._inertia @ omega)
        return np.concatenate([force, moment])

    def _at(self, p_base: Array) -> Array:
        """Return the acceleration of a point that moves with the base, in the world [m/s²], (3,)."""
        rows = self._accelerations[-1].reshape(3, 4)
        return np.asarray(rows[:, 3] + rows[:, :3] @ p_base, dtype=float)

    def _advance(self) -> None:
        """Advance by `STEP`."""
        squares = np.square(self._rows - self._rows[-1]).reshape(POINTS, 3, 4)
        turns = LEVER / math.sqrt(2.0) * np.sqrt(squares[:, :, :3].sum(axis=(1, 2)))
        self.turning = float(turns.max()) >= MAX_TRAVEL
        self.at_rest = float((np.sqrt(squares[:, :, 3].sum(axis=1)) + turns).max()) < MAX_TRAVEL
        speeds = np.linalg.norm((_VELOCITY @ self._rows).reshape(3, 4) @ self._ends, axis=0)
        self.speed = 0.0 if self.at_rest else float(speeds.max())
        self._accelerations[:-1] = self._accelerations[1:]
        self._accelerations[-1] = 0.0 if self.at_rest else _ACCELERATION @ self._rows
        a, before = self._at(self._com), self._accelerations[0].reshape(3, 4)
        last = before[:, 3] + before[:, :3] @ self._com
        da = (a - last) / (SPAN / 2.0)
        # One step of the mode by its exact solution about the present acceleration, which is constant in it.
        decay, turn = DAMPING * self._omega, self._omega * math.sqrt(1.0 - DAMPING**2)
        u, v, kept = self._y - a, self._dy, math.exp(-decay * STEP)
        c, s = math.cos(turn * STEP), math.sin(turn * STEP)
        v0 = (v + decay * u) / turn
        self._y = a + kept * (c * u + s * v0)
        self._dy = kept * (turn * (c * v0 - s * u)) - decay * (self._y - a)
        self._impact *= kept
        sway = float(np.linalg.norm(np.concatenate([self._y - a, (self._dy - da) / self._omega])))
        self.free_sway = MARGIN * (self._per_rod * sway + self._per_all * float(np.linalg.norm(a - last)))
        self.sway = self.free_sway + MARGIN * self._per_rod * self._impact
