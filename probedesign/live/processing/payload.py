"""Calibration of bias, payload, mount and stiffness from a free probe or tool that rests in several orientations.

The reading at rest, in sensor axes, is linear in bias b, drift r, mass m and first moment q = m c of what hangs on the
sensor; the mount's rotation δ and a common factor on E and G, which changes the sag, are not:

    w = b + r t + [m g; q × g] + X rod(g; E),   g = exp(-δ) Rᵀ g_world.

Each channel has the noise of the mean of a rest, a random walk, and a scatter from rest to rest for whatever the model
does not describe. The last two are estimated from the readings by their restricted likelihood: every channel is
linear in time and gravity, so the residuals of that line tell them apart. The walk is at least the stated one.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from probedesign.core.errors import InputError
from probedesign.core.frames import Array, pose, skew
from probedesign.core.statistics import MISFIT_CHANCE, max_chi2
from probedesign.core.units import GRAM
from probedesign.design.catalog import Quantity
from probedesign.design.sensors import Noise
from probedesign.estimation.model import WALK_SECONDS, ProbeModel, Tolerances
from probedesign.geometry import Flange
from probedesign.geometry.mass import NOTHING
from probedesign.live import Log
from probedesign.live.blocks import Block, WrenchReading
from probedesign.live.poses.base_poses import BasePoses
from probedesign.live.processing.averaging import AveragedBatch, Averager
from probedesign.live.processing.drift import SLOW
from probedesign.live.processing.motion import MotionMonitor
from probedesign.live.processing.tare import CHANNELS, MAX_SCATTER, REST_TIME
from probedesign.rod.rod import Rod

SETTLE = 0.3  #: Time after a stop whose readings are not used, beside the sway of the probe [s]; assumed.
MIN_READINGS, MAX_REST = 5, 1000  #: Of a rest: three more than a line has parameters, and those that live keeps.
MIN_ORIENTATIONS = 6  #: As many as bias, payload, mount and E need for a test of the fit.
MIN_TURN = math.radians(15.0)  #: Least angle between the directions of gravity of two orientations.
#: Least standard deviation of the direction of gravity along an axis: six orientations along ± x, y, z have 0.58, and
#: the standard deviations of the results grow with its inverse. WANTED is what the guide asks for. Assumed.
MIN_SPREAD, WANTED_SPREAD = 0.1, 0.3
#: Standard deviation of the mount's rotation about each axis [rad]: clearance of pins and a flange that was turned by
#: eye. Assumed; readings determine it wherever the weight is more than noise.
MOUNT_STD = math.radians(3.0)
UNOBSERVED = 0.9  #: Share of a prior standard deviation: what is known no better is not observable.
OUTLIER_CHANCE = 1e-3  #: Chance that a rest like the others is dropped.
#: Parameters: bias, rate of its drift, mass, first moment, rotation of the mount, log of the factor on E and G.
BIAS, RATE, MASS, MOMENT, TURN, STIFFNESS, SIZE = slice(0, 6), slice(6, 12), 12, slice(13, 16), slice(16, 19), 19, 20
#: A wrong payload in a run: number of rests that show it, share of the squares that it may leave unexplained (touches
#: leave more), and its least effect in standard deviations of a reading. Assumed.
CHECK_RESTS, UNEXPLAINED, MIN_PAYLOAD = 4, 0.04, 5.0
#: Fits, each with the noise of the one before; parameters that each channel shares with the others.
ROUNDS, SHARED = 4, 8.0 / 6.0
_STEP = 0.05  #: Step of the derivative of the rod's wrench by gravity [m/s²].


@dataclass(frozen=True)
class Rest:
    """The mean reading of a base at rest."""

    time: float  #: mean time [s].
    wrench: Array  #: in the sensor frame, bias included [N, N·m], (6,).
    std: Array  #: standard deviation of that mean by the noise of the sensor, (6,).
    R: Array  #: R_world_base, or that of the robot's flange for a tool, (3, 3).


def tool_model() -> ProbeModel:
    """Return a stand-in for the model of a sensor whose tool has no probe: a rod without weight, and no limits.

    The page draws it in place of the tool, 80 mm long.
    """
    rod = Rod(np.array([0.0, 80e-3]), np.full(2, 8e-3), 1e9, 1e9, 1e-6)
    quantity = Quantity(1.0, "assumed", "stand-in")
    return ProbeModel(
        "tool", "none", Flange(20e-3, 3e-3), rod, np.array([0.0, 0.0, -9.81]), np.eye(4), NOTHING, np.full(6, 1e9),
        Noise.isotropic(1e6, 1e6), material=dict.fromkeys(("youngs_modulus", "shear_modulus", "density"), quantity),
    )  # fmt: skip


def spread_along(R: Sequence[Array], gravity_world: Array) -> tuple[float, int, Array]:
    """Return how little gravity changes along some direction, the axis (0, 1, 2) next to it, and the same by axis.

    It is the standard deviation of the direction of gravity, in the axes of the base.
    """
    down = np.array([each.T @ gravity_world for each in R]) / np.linalg.norm(gravity_world)
    values, vectors = np.linalg.eigh(np.cov(down.T, bias=True)) if len(R) > 1 else (np.zeros(3), np.eye(3))
    along = np.sqrt(np.maximum(values[0], 0.0))
    return float(along), int(np.argmax(np.abs(vectors[:, 0]))), down.std(axis=0)


def orientations(R: Sequence[Array], gravity_world: Array) -> Array:
    """Return the upward directions in the axes of the base that differ by `MIN_TURN`, (k, 3)."""
    directions = np.empty((0, 3))
    for each in R:
        up = -each.T @ gravity_world / np.linalg.norm(gravity_world)
        if (directions @ up < math.cos(MIN_TURN)).all():
            directions = np.vstack([directions, up])
    return directions


#: What the base is doing while it is calibrated.
MOVING, SWAYING, AVERAGING, MEASURED = (
    "moving",
    "hold still: the probe sways",
    "hold still",
    "measured: turn the base on",
)


class Guide(NamedTuple):
    """What was measured and what is missing; directions are upward ones in the axes of the base."""

    measured: Array  #: directions of the orientations that were measured, (k, 3).
    refused: Array  #: directions of the rests that were not used, (j, 3).
    now: Array | None  #: present direction, (3,); None without a pose.
    following: Array | None  #: direction that is to be measured next, ± an axis, (3,); None: any.
    text: str  #: `following` and what is missing, in one line.
    state: str  #: `MOVING` ... `MEASURED`, or why nothing is measured.
    progress: float = 0.0  #: share of the present rest that was averaged.

    @property
    def enough(self) -> bool:
        """Whether the orientations suffice."""
        return self.following is None


def guide(R: Sequence[Array], gravity_world: Array) -> Guide:
    """Return which orientation is next after those of the bases R, (3, 3) each."""
    measured, (*_, along) = orientations(R, gravity_world), spread_along(R or [np.eye(3)], gravity_world)
    missing = [axis for axis, spread in zip("xyz", along.tolist(), strict=True) if spread < WANTED_SPREAD]
    n = MIN_ORIENTATIONS - len(measured)
    text, following = "enough; more orientations narrow the result", None
    ends = np.vstack([np.eye(3), -np.eye(3)])
    near = (measured @ ends.T).max(axis=0, initial=-1.0) - 2.0 * np.array([axis in missing for axis in "xyzxyz"])
    if missing or n > 0:
        i = int(np.argmin(near))
        following = ends[i]
        needed = [f"{', '.join(missing)} up and down"] if missing else []
        needed += [f"{n} more orientation{'s' * (n > 1)}"] if n > 0 else []
        text = f"next: turn it so that {'xyz'[i % 3]} points {'up' if i < 3 else 'down'}; needed: {', '.join(needed)}"
    return Guide(measured, np.empty((0, 3)), None, following, text, "no reading")


class RestCollector:
    """Collects the rests of a base that turns, and guides the user.

    Attributes:
        rests: those that were completed.
        guide: what was measured, what is missing, and the present state; replaced with each reading.
        R: present rotation of the base in the world, (3, 3).
    """

    def __init__(self, model: ProbeModel, poses: BasePoses, log: Log, *, tool: bool = False) -> None:
        """Start with no readings; `log` receives what was done and what is missing."""
        self.rests: list[Rest] = []
        self.guide, self.R = guide((), poses.gravity_world), np.eye(3)
        self._model, self._poses, self._log, self._tool = model, poses, log, tool
        self._averager = Averager(1 if tool else None, model, log)
        self._motion = MotionMonitor(model, poses)
        self._waiting, self._still = deque[AveragedBatch](), list[AveragedBatch]()
        self._since = math.nan

    def add(self, block: Block) -> None:
        """Add readings."""
        if len(block) == 0:
            return
        self._poses.refresh(block)
        self._waiting.extend(self._averager.add(block))
        while self._waiting and not self._poses.may_arrive(self._waiting[0].reading.time, float(block.time[-1])):
            self._step(self._waiting.popleft())

    def finish(self) -> list[Rest]:
        """Return all rests after the last reading."""
        self._waiting.extend(self._averager.finish())
        while self._waiting:
            self._step(self._waiting.popleft())
        self._close()
        return self.rests

    def _step(self, batch: AveragedBatch) -> None:
        reading = batch.reading
        self._motion.update(reading.time)
        T = self._poses.track.at(reading.time)
        fault = "no pose of the base" if T is None else reading.fault
        if not fault and not self._model.in_range(reading.wrench_sensor):
            fault = "a reading is out of range"
        self.R = self.R if T is None else T[:3, :3]
        if fault or not (self._motion.at_rest and self._motion.explained):
            self._close()
            return self._show(fault or (SWAYING if self._motion.at_rest else MOVING))
        if math.isnan(self._since):
            self._since = reading.time
        if reading.time - self._since < SETTLE:
            return self._show(SWAYING)
        complete = self._complete
        self._still.append(batch)
        if self._complete and not complete:
            self._advise([*(rest.R for rest in self.rests), self.R])
            self._log(f"orientation {len(self.guide.measured)}: measured; {self.guide.text}")
        share = min((reading.time - self._still[0].reading.time) / REST_TIME, 1.0)
        self._show(MEASURED if self._complete else AVERAGING, share)

    def _advise(self, R: Sequence[Array]) -> None:
        self.guide = guide(R, self._poses.gravity_world)._replace(refused=self.guide.refused)

    def _show(self, state: str, progress: float = 0.0) -> None:
        g = self._poses.gravity_world
        up = -self.R.T @ g / np.linalg.norm(g)
        self.guide = self.guide._replace(now=up, state=state, progress=progress)

    @property
    def _complete(self) -> bool:
        n = len(self._still)
        return n >= MIN_READINGS and self._still[-1].reading.time - self._still[0].reading.time >= REST_TIME

    def _close(self) -> None:
        """End the present rest; keep it if it is long enough and does not scatter."""
        # A mean that reaches beyond the middle of the last one may end in motion.
        self._still = [b for b in self._still if b.block.time[-1] <= self._still[-1].reading.time]
        still, complete, self._still, self._since = self._still, self._complete, [], math.nan
        if complete:
            self._keep(still)
        if still:
            self._advise([rest.R for rest in self.rests])

    def _keep(self, still: list[AveragedBatch]) -> None:
        time, wrench = np.array([b.reading.time for b in still]), np.array([b.reading.wrench_sensor for b in still])
        since, n = time - time.mean(), len(time)
        line = np.outer(since, since @ wrench / float(since @ since))
        scatter = (wrench - wrench.mean(axis=0) - line).std(axis=0, ddof=2)
        noise = scatter if self._tool else self._model.noise.std
        T = self._poses.track.at(float(time[n // 2]))
        assert T is not None  # it was known for each reading
        if (scatter > MAX_SCATTER * noise).any():
            i = int(np.argmax(scatter / noise))
            self._log(f"the rest at {time[0]:.6g} s is not used: {CHANNELS[i]} scatters by {scatter[i] / noise[i]:.2g} "
                      "times its noise; touched or moving?")  # fmt: skip
            refused = orientations([T[:3, :3]], self._poses.gravity_world)
            self.guide = self.guide._replace(refused=np.vstack([self.guide.refused, refused]))
            return
        self.rests.append(Rest(float(time.mean()), wrench.mean(axis=0), noise / math.sqrt(n), T[:3, :3]))


class PayloadCheck:
    """Compares the readings of a run that turns with the payload of the frozen probe, and reports one that differs."""

    def __init__(self, model: ProbeModel, log: Log) -> None:
        """Start with no readings; `log` receives one line at most."""
        self._model, self._log, self._reported = model, log, False
        self._rests = deque[tuple[Array, Array]](maxlen=24)  # gravity and what the free probe does not explain
        self._readings = deque[WrenchReading](maxlen=MAX_REST)

    def add(self, reading: WrenchReading, rests: bool) -> None:
        """Add a reading; `rests` states whether the base rests and the probe does not sway."""
        if rests and not reading.fault:
            self._readings.append(reading)
            return
        readings = [*self._readings][:-1]  # the last mean may end in motion
        self._readings.clear()
        if self._reported or len(readings) < MIN_READINGS or readings[-1].time - readings[0].time < REST_TIME:
            return
        g, mean = readings[0].gravity_base, np.mean([each.wrench_sensor for each in readings], axis=0)
        self._rests.append((g, mean - self._model.to_sensor(self._model.rod.solve(g).wrench_base, g)))
        # A payload that explains what the free probe leaves is reported, where gravity has turned enough.
        g, left = (np.array(column) for column in zip(*self._rests, strict=True))
        down = g / np.linalg.norm(g, axis=1)[:, None]
        if len(g) < CHECK_RESTS or np.linalg.svd(down - down.mean(axis=0))[1][1] < math.sqrt(len(g)) * MIN_SPREAD:
            return
        std, seen = self._model.noise.std, g @ self._model.T_sensor_base[:3, :3].T
        A = np.concatenate([np.tile(np.eye(6), (len(g), 1, 1)), np.zeros((len(g), 6, 4))], axis=2)
        A[:, :3, 6], A[:, 3:, 7:] = seen, -skew(seen)
        B, y = (A / std[:, None]).reshape(-1, 10), (left / std).ravel()
        x = np.linalg.lstsq(B, y, rcond=None)[0]
        before = float(((left - left.mean(axis=0)) ** 2 / std**2).sum())
        after = float(((y - B @ x) ** 2).sum())
        size = abs(x[6]) * float(np.ptp(seen, axis=0).max()) / std[0]
        if after < UNEXPLAINED * before and size > MIN_PAYLOAD:
            self._reported = True
            differs = "heavier" if x[6] > 0.0 else "lighter"
            self._log(
                f"what hangs on the sensor is {abs(x[6]) / GRAM:.2g} g {differs} than the frozen probe states, by "
                f"{len(g)} orientations: positions are wrong; run probedesign calibrate"
            )


# The fit -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class FreeMotionFit:
    """Bias, payload, mount and stiffness with their covariance, and how well they explain the rests."""

    model: ProbeModel  #: the probe before it.
    rests: tuple[Rest, ...]  #: those that were used.
    gravity_world: Array  #: [m/s²], (3,).
    x: Array  #: the parameters, (20,).
    cov: Array  #: their covariance, (20, 20).
    R: Array  #: rotation of the base by the sensor against that by the poses, (3, 3).
    residuals: Array  #: of the rests without the walk of the bias [N, N·m], (n, 6).
    chi2: Array  #: of each channel with the stated noise and walk alone, of n - 3 degrees of freedom, (6,).
    noise: Array  #: standard deviation of the scatter from rest to rest and of the walk in a second, (2, 6).
    correlation: Array  #: of what is left of the channels, (6, 6).
    dropped: tuple[float, ...]  #: times of the rests that differ from all others [s].
    notes: tuple[str, ...]  #: what the user should know, one line each.
    tool: bool  #: whether there is no probe.
    _jacobian: Array  #: of the predictions, (n, 6, 20).
    _left: Array  #: residuals with it, (n, 6).
    _inverses: Array  #: inverse covariance of the residuals of each channel, (6, n, n).
    _time: float  #: of the bias [s].

    @property
    def verdict(self) -> str:
        """`ok`, or `inconsistent` where noise and drift do not explain the residuals."""
        return "inconsistent" if self.inconsistent else "ok"

    @property
    def inconsistent(self) -> tuple[str, ...]:
        """Channels whose residuals the stated noise and walk do not explain."""
        if self.tool:
            return ()
        limit = max_chi2(max(len(self.rests) - 3, 1), MISFIT_CHANCE)
        return tuple(name for name, chi2 in zip(CHANNELS, self.chi2.tolist(), strict=True) if chi2 > limit)

    @property
    def mass(self) -> float:
        """Mass of what hangs on the sensor, without the flexible part [kg]."""
        return max(float(self.x[MASS]), 0.0)

    @property
    def p_com(self) -> Array:
        """Its centre of mass in the sensor frame [m], (3,)."""
        return np.asarray(self.x[MOMENT] / self.mass if self.mass > 0.0 else np.zeros(3), dtype=float)

    @cached_property
    def cov_com(self) -> Array:
        """Covariance of the centre of mass [m²], (3, 3)."""
        if self.mass == 0.0:
            return np.full((3, 3), np.nan)
        D = np.zeros((3, SIZE))
        D[:, MASS], D[:, MOMENT] = -self.p_com / self.mass, np.eye(3) / self.mass
        return np.asarray(D @ self.cov @ D.T, dtype=float)

    @property
    def std(self) -> Array:
        """Standard deviations of the parameters, (20,)."""
        return np.sqrt(np.diag(self.cov))

    def predict(self, time: float, R: Array) -> tuple[Array, Array]:
        """Return the reading of a free probe at a time [s] and pose R_world_base (3, 3), and its covariance (6, 6).

        The walk of the bias is interpolated between the rests.
        """
        times, (scatter, walk) = np.array([rest.time for rest in self.rests]), self.noise
        w, J = _linearised(self.model, self.x, self.R, R.T @ self.gravity_world, time - self._time, self.tool)
        start = min(times.min(), time)
        near, mean = np.minimum(time, times) - start, w
        var = scatter**2 + walk**2 * (time - start) + np.mean([rest.std**2 for rest in self.rests], axis=0)
        for c in range(6):
            gain = walk[c] ** 2 * near @ self._inverses[c]
            mean[c] += gain @ self._left[:, c]
            var[c] -= walk[c] ** 2 * float(gain @ near)
            J[c] -= gain @ self._jacobian[:, c]
        return mean, np.sqrt(np.outer(var, var)) * self.correlation + J @ self.cov @ J.T

    def calibrated(self) -> ProbeModel:
        """Return the probe with this payload, stiffness and pose on the robot.

        The inertia of the payload grows with its mass: a free probe at rest does not show it.
        """
        model, share = self.model, math.exp(self.x[STIFFNESS])
        source = f"calibrated from free motion, {len(self.rests)} rests"
        known, spread = self.std[STIFFNESS] < UNOBSERVED * _stiffness_prior(model), model.stiffness_spread
        rod, material = model.rod, model.material
        if known:
            spread = float(self.std[STIFFNESS])
            rod = replace(rod, youngs_modulus=share * rod.youngs_modulus, shear_modulus=share * rod.shear_modulus)
            material = material | {
                name: Quantity(share * material[name].value, "identified", source)
                for name in ("youngs_modulus", "shear_modulus")
            }
        payload, T = model.payload, model.T_robotflange_base
        grown = self.mass / payload.mass if payload.mass > 0.0 else 0.0
        return replace(
            model, rod=rod, material=material, stiffness_spread=spread,
            payload=replace(payload, mass=self.mass, p_com=self.p_com, inertia=grown * payload.inertia),
            T_robotflange_base=None if T is None else T @ pose(self.R),
            assumptions=(*model.assumptions, f"payload {source}"),
        )  # fmt: skip

    def as_dict(self) -> dict[str, object]:
        """Return the result as plain data with units in the names."""
        from scipy.spatial.transform import Rotation

        std, rms = self.std, np.sqrt((self.residuals**2).mean(axis=0))
        return {
            "probe": None if self.tool else self.model.name,
            "verdict": self.verdict,
            "inconsistent_channels": self.inconsistent,
            "orientations": len(orientations([rest.R for rest in self.rests], self.gravity_world)),
            "rests": len(self.rests),
            "dropped_s": self.dropped,
            "time_s": self._time,
            "bias_force_N": self.x[0:3], "bias_moment_Nm": self.x[3:6],
            "bias_force_std_N": std[0:3], "bias_moment_std_Nm": std[3:6],
            "drift_force_N_s": self.x[6:9], "drift_moment_Nm_s": self.x[9:12],
            "drift_force_std_N_s": std[6:9], "drift_moment_std_Nm_s": std[9:12],
            "mass_kg": self.mass, "mass_std_kg": std[MASS],
            "p_com_m": self.p_com, "p_com_cov_m2": self.cov_com,
            "gravity_world_m_s2": self.gravity_world,
            "R_pose_sensor": self.R @ self.model.T_sensor_base[:3, :3].T,
            "mount_rotvec_rad": Rotation.from_matrix(self.R).as_rotvec(), "mount_rotvec_std_rad": std[TURN],
            "youngs_modulus_Pa": None if self.tool else math.exp(self.x[STIFFNESS]) * self.model.rod.youngs_modulus,
            "youngs_modulus_relative_std": None if self.tool else std[STIFFNESS],
            "residual_force_N": rms[:3], "residual_moment_Nm": rms[3:],
            "channel_chi2": None if self.tool else self.chi2,
            "channel_chi2_degrees": len(self.rests) - 3,
            "notes": self.notes,
        }  # fmt: skip


def calibrate(model: ProbeModel, rests: Sequence[Rest], gravity_world: Array, *, tool: bool = False) -> FreeMotionFit:
    """Fit bias, payload, mount and stiffness to rests of a free probe.

    Args:
        model: the probe; `tool_model()` with `tool`.
        rests: in order of time.
        gravity_world: [m/s²], (3,).
        tool: there is no probe: the mount may have any rotation, and the noise is that of the rests.

    Raises:
        InputError: gravity does not turn enough, or the payload has a negative mass.
    """
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    R = [rest.R for rest in rests]
    _check_turns(R, gravity_world, "flange" if tool else "base")
    time = np.array([rest.time for rest in rests])
    middle = float(time.mean())
    down = np.array([each.T @ gravity_world for each in R])
    x, turned = np.zeros(SIZE), np.eye(3)
    x[MASS], x[MOMENT] = model.payload.mass, model.payload.mass * model.payload.p_com
    wrench = np.array([rest.wrench for rest in rests])
    rod = np.array([_linearised(model, np.zeros(SIZE), turned, g, 0.0, tool)[0] for g in down])
    linear = np.column_stack([np.ones(len(rests)), down, *([time - middle] if len(rests) > 7 else [])])
    kept = _regular(linear, wrench - rod)
    dropped = tuple(float(t) for t in time[~kept])
    rests = [rest for rest, k in zip(rests, kept, strict=True) if k]
    time, down, wrench, rod, linear = (each[kept] for each in (time, down, wrench, rod, linear))
    n, std = len(rests), np.array([rest.std for rest in rests])
    if tool:
        by_gravity = np.linalg.lstsq(linear, wrench[:, :3], rcond=None)[0][1:4].T
        U, size, Vt = np.linalg.svd(by_gravity)
        sign = float(np.linalg.det(U @ Vt))
        turned = (sign * U @ Vt).T
        x[MASS] = sign * size.mean()
    priors = Tolerances.of(model)
    step = model.noise.std * math.sqrt(model.averaging_samples)
    least_walk = np.zeros(6) if tool else step * priors.walk_steps / math.sqrt(WALK_SECONDS)
    walked = np.minimum.outer(time - time[0], time - time[0])
    stated = [np.linalg.inv(np.diag(std[:, c] ** 2) + least_walk[c] ** 2 * walked) if not tool else np.eye(n)
              for c in range(6)]  # fmt: skip
    # Bias and payload are free; a weak prior on the drift keeps six orientations determined.
    prior = np.full(SIZE, math.inf)
    prior[TURN] = 1.0 if tool else MOUNT_STD
    prior[STIFFNESS] = 1e-9 if tool else _stiffness_prior(model)
    if not tool:
        prior[RATE] = SLOW * step

    def predicted(x: Array) -> tuple[Array, Array]:
        R = turned @ Rotation.from_rotvec(x[TURN]).as_matrix()
        rows = [_linearised(model, x, R, g, t - middle, tool) for g, t in zip(down, time, strict=True)]
        return np.array([w for w, _ in rows]), np.array([J for _, J in rows])

    line, y = linear, wrench - rod
    for _ in range(ROUNDS):
        noise = np.array([_variances(line, y[:, c], std[:, c], walked, least_walk[c]) for c in range(6)])
        inverses = np.array([
            np.linalg.inv(np.diag(std[:, c] ** 2 + noise[c, 0] ** 2) + noise[c, 1] ** 2 * walked) for c in range(6)
        ])  # fmt: skip
        roots = np.linalg.cholesky(inverses).transpose(0, 2, 1)

        def residual(x: Array, roots: Array = roots) -> Array:
            w, _ = predicted(x)
            return np.concatenate([*(roots[c] @ (w[:, c] - wrench[:, c]) for c in range(6)), x / prior])

        def slopes(x: Array, roots: Array = roots) -> Array:
            _, J = predicted(x)
            return np.concatenate([*(roots[c] @ J[:, c] for c in range(6)), np.diag(1.0 / prior)])

        x = np.asarray(least_squares(residual, x, slopes, method="lm", x_scale="jac").x, dtype=float)
        w, jacobian = predicted(x)
        # What the sensor gets wrong in proportion to gravity counts as scatter, too: a rigid payload does not have it.
        line = np.column_stack([np.ones(n), time - middle])
        y = (wrench - w) * math.sqrt(n / (n - SHARED))
    J = slopes(x)
    scale = np.linalg.norm(J, axis=0)
    cov = np.linalg.inv((J / scale).T @ (J / scale)) / np.outer(scale, scale)
    left = wrench - w
    white = np.stack([roots[c] @ left[:, c] for c in range(6)])
    # Drawn towards independent channels by as many rests as there are channels.
    correlation = np.corrcoef(white) * (n / (n + 6.0)) + np.eye(6) * (6.0 / (n + 6.0))
    residuals = left - np.stack([noise[c, 1] ** 2 * walked @ inverses[c] @ left[:, c] for c in range(6)], axis=1)
    mass_std = math.sqrt(cov[MASS, MASS])
    if x[MASS] < -2.0 * mass_std:
        raise InputError(
            f"the payload has a negative mass, {1e3 * x[MASS]:.3g} ± {1e3 * mass_std:.2g} g: check the sign of "
            "--gravity-world, the frame of the poses and the axes of the sensor"
        )
    R_turned = turned @ Rotation.from_rotvec(x[TURN]).as_matrix()
    chi2 = np.array([float(left[:, c] @ stated[c] @ left[:, c]) for c in range(6)])
    fit = FreeMotionFit(model, tuple(rests), gravity_world, x, cov, R_turned, residuals, chi2,
                        noise.T, correlation, dropped, (), tool, jacobian, left, inverses, middle)  # fmt: skip
    return replace(fit, notes=tuple(_notes(fit, prior)))


def _notes(fit: FreeMotionFit, prior: Array) -> list[str]:
    """Return what the user should know; `prior` has the standard deviations before the calibration, (20,)."""
    notes = [f"the rest at {t:.6g} s differs from all others and is not used: touched or moving?" for t in fit.dropped]
    if not fit.tool and fit.std[STIFFNESS] > UNOBSERVED * prior[STIFFNESS]:
        notes.append(f"E is not observable: the sag tells it no better than ± {prior[STIFFNESS]:.1%}, as it was known; "
                     "more orientations with the axis horizontal help")  # fmt: skip
    hidden = [axis for axis, s in zip("xyz", fit.std[TURN], strict=True) if s > UNOBSERVED * prior[TURN][0]]
    if hidden:
        notes.append(f"the mount's rotation about {', '.join(hidden)} is not observable: the weight is too small")
    if not fit.tool and float(np.linalg.norm(fit.x[TURN])) > 3.0 * MOUNT_STD:
        angle = math.degrees(float(np.linalg.norm(fit.x[TURN])))
        notes.append(
            f"the base is turned by {angle:.1f}° against the poses: is the tool centre point that of the probe?"
        )
    for name in fit.inconsistent:
        c = CHANNELS.index(name)
        factor = math.sqrt(fit.chi2[c] / max(len(fit.rests) - 3, 1))
        notes.append(f"{name} is off by {factor:.2g} times what noise and walk explain: touched, warming up or a "
                     "pulling cable? the stated covariance includes it")  # fmt: skip
    return notes


def _check_turns(R: Sequence[Array], gravity_world: Array, frame: str) -> None:
    """Raise InputError unless gravity turns enough; the message names the missing axis of the `frame`."""
    count, (least, axis, _) = len(orientations(R, gravity_world)), spread_along(R, gravity_world)
    if len(R) > 1 and least < MIN_SPREAD:
        raise InputError(
            f"gravity hardly changes along the {frame}'s {'xyz'[axis]} axis ({count} orientations): turn it so that "
            f"{'xyz'[axis]} points up in one and down in another orientation"
        )
    if count < MIN_ORIENTATIONS:
        raise InputError(f"{count} orientations are fewer than {MIN_ORIENTATIONS}: rest {REST_TIME + SETTLE:g} s in "
                         f"{MIN_ORIENTATIONS - count} more that differ by {math.degrees(MIN_TURN):.0f}°")  # fmt: skip


def _stiffness_prior(model: ProbeModel) -> float:  # standard deviation of the factor on E and G
    return max(Tolerances.of(model).youngs_modulus, 1e-3)


def _linearised(model: ProbeModel, x: Array, R: Array, gravity: Array, t: float, tool: bool) -> tuple[Array, Array]:
    """Return the reading (6,) and its derivative (6, 20) under gravity in the axes of the pose [m/s²], (3,).

    The rotation in the parameters `x` counts from `R`, R_pose_base, which includes it; `t` is since that of the bias.
    """
    R_sb, g = model.T_sensor_base[:3, :3], R.T @ gravity
    seen = R_sb @ g
    w, J = x[BIAS] + t * x[RATE], np.zeros((6, SIZE))
    J[:, BIAS], J[:, RATE] = np.eye(6), t * np.eye(6)
    w[:3] += x[MASS] * seen
    w[3:] += np.cross(x[MOMENT], seen)
    J[:3, MASS], J[3:, MOMENT] = seen, -skew(seen)
    by_gravity = np.concatenate([x[MASS] * R_sb, skew(x[MOMENT]) @ R_sb])
    if not tool:
        share = math.exp(x[STIFFNESS])

        def rod(at: Array, factor: float = 1.0) -> Array:
            stiff = {name: share * factor * getattr(model.rod, name) for name in ("youngs_modulus", "shear_modulus")}
            return model.to_sensor(replace(model.rod, **stiff).solve(at).wrench_base, np.zeros(3))

        w += rod(g)
        by_gravity = by_gravity + np.stack([rod(g + e) - rod(g - e) for e in _STEP * np.eye(3)], axis=1) / (2.0 * _STEP)
        J[:, STIFFNESS] = (rod(g, 1.01) - rod(g, 0.99)) / (math.log(1.01) - math.log(0.99))
    J[:, TURN] = by_gravity @ skew(g)
    return w, J


def _regular(linear: Array, wrench: Array) -> NDArray[np.bool_]:
    """Return which rests are like the others, (n,): the others predict each, by deleted residuals."""
    from scipy.special import stdtrit

    kept = np.ones(len(linear), dtype=bool)
    while (dof := int(kept.sum()) - linear.shape[1] - 1) >= 2:
        A, y = linear[kept], wrench[kept]
        Q, _ = np.linalg.qr(A)
        left = np.maximum(1.0 - (Q**2).sum(axis=1), 1e-6)[:, None]
        residual = y - Q @ (Q.T @ y)
        others = np.maximum((residual**2).sum(axis=0) - residual**2 / left, 1e-300) / dof
        worst = (np.abs(residual) / np.sqrt(others * left)).max(axis=1)
        if worst.max() < stdtrit(dof, 1.0 - OUTLIER_CHANCE / (12.0 * len(A))) or 4 * (~kept).sum() >= len(kept) - 4:
            break
        kept[np.flatnonzero(kept)[int(np.argmax(worst))]] = False
    return kept


def _variances(A: Array, y: Array, std: Array, walked: Array, least_walk: float) -> tuple[float, float]:
    """Return the scatter from rest to rest and the walk [1/√s] of a channel by its restricted likelihood.

    They are the means over all values, not the most likely ones, which few rests would set to zero. `A` is what the
    readings `y` are linear in, (n, k); `std` their noise; `walked` the covariance of a walk of one [s], (n, n).
    """
    residual = y - A @ np.linalg.lstsq(A, y, rcond=None)[0]
    size = math.sqrt(float(residual @ residual) / max(len(y) - A.shape[1], 1)) + 1e-12
    levels = np.append(0.0, size * np.geomspace(0.02, 3.0, 12))
    per_second = 1.0 / math.sqrt(max(float(walked.max()), 1e-9))
    scatter, walk = (axis.ravel() for axis in np.meshgrid(levels, np.maximum(per_second * levels, least_walk)))
    known = (scatter > 0.0) | (std.min() > 0.0)  # the walk alone leaves the first rest without an error
    scatter2, walk2 = scatter[known] ** 2, walk[known] ** 2
    roots = np.linalg.cholesky(
        (std**2 + scatter2[:, None])[:, :, None] * np.eye(len(y)) + walk2[:, None, None] * walked
    )
    B, z = np.linalg.solve(roots, A), np.linalg.solve(roots, y[:, None])
    Q, R = np.linalg.qr(B)
    r = z - Q @ (Q.transpose(0, 2, 1) @ z)
    value = 2.0 * np.log(np.diagonal(roots, axis1=1, axis2=2)).sum(axis=1) + np.square(r).sum(axis=(1, 2))
    value += 2.0 * np.log(np.abs(np.diagonal(R, axis1=1, axis2=2))).sum(axis=1)
    weights = np.exp(0.5 * (value.min() - value))
    return math.sqrt(weights @ scatter2 / weights.sum()), math.sqrt(weights @ walk2 / weights.sum())
