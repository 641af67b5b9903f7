"""Probes that differ from their model by draws from the priors, and readings of their touches: for Monte Carlo.

Every error source of `ErrorSources` is drawn: the rod itself, its root, its mount and gravity, the sensor's gain, how
much it creeps. Drawn for each touch are friction ratio, stiffness, noise, the walk of the bias and the robot's scatter.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from probedesign.estimation.error_sources import parameters_of, turns_of
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.surface_contact_kernel import POINT, VALUE
from probedesign.estimation.tolerances import Tolerances
from probedesign.frames import Array, inverse, wrench_map
from probedesign.prediction.model_touch import SurfaceRod
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.rod import Rod
from probedesign.units import MM

_SOFTER = ("creep", "stiffness scatter")
"""Sources that a single touch cannot tell apart; of fused ones the first grows, the second is drawn for each."""


@dataclass(frozen=True)
class World:
    """One probe, mount and sensor.

    Attributes:
        model: what the estimator believes.
        rod: as printed, before it creeps.
        gravity: as the true base sees it [m/s²], (3,); pulled: the same in the model's base axes.
        R: turn of the base, (3, 3); shift: of the base [m], (3,).
        gain: relative error of each channel of the sensor, (6,).
        creep: of the logarithm of the stiffness, at the last of several touches.
        tared: whether the sensor was tared with this probe free.
    """

    model: ProbeModel
    rod: Rod
    gravity: Array
    pulled: Array
    R: Array
    shift: Array
    gain: Array
    creep: float
    tared: bool

    @classmethod
    def draw(cls, model: ProbeModel, tolerances: Tolerances, rng: np.random.Generator) -> "World":
        """Draw one from the priors."""
        gravity = model.gravity_base
        parameters, turns = np.zeros(4 + len(model.rod.s)), np.zeros(9)
        for name, rows in parameters_of(model.rod, tolerances).items():
            z = rng.normal(size=len(rows))
            if name not in _SOFTER:
                parameters += z @ rows
        for rows in turns_of(gravity, tolerances).values():
            turns += rng.normal(size=len(rows)) @ rows
        R = Rotation.from_rotvec(turns[3:6]).as_matrix()
        pulled = gravity + turns[6:9]
        rod = printed(model.rod, parameters)
        base = float(rod.radius[0])
        root = rod.rigid_length + tolerances.root_radii * base * rng.normal()
        rod = replace(rod, rigid_length=min(max(root, -0.99 * base), 0.9 * rod.length))
        gain = tolerances.gain * rng.normal(size=6)
        creep = tolerances.creep * rng.normal()
        return cls(model, rod, R.T @ pulled, pulled, R, turns[0:3], gain, float(creep), tolerances.tared)

    def press(
        self,
        fraction: float,
        phi: float,
        forces: Sequence[float],
        ratios: Array,
        softer: Array,
    ) -> tuple[Array, Array]:
        """Touches of one place of the surface.

        Args:
            fraction: arclength of the touched section over the length; phi: angle around the section [rad].
            forces: normal forces, ascending [N], (k,).
            ratios: of friction, around and along, (k, 2).
            softer: logarithm of the stiffness at each for itself, beside the creep, (k,).

        Returns:
            Readings without noise and touched points, both in the model's base frame, (k, 6) and (k, 3); NaN from
            where the probe gives way on.
        """
        k = len(forces)
        ramp = np.ones(1) if k == 1 else np.linspace(0.0, 1.0, k)
        wrenches, points = np.full((k, 6), np.nan), np.full((k, 3), np.nan)
        for j, force in enumerate(forces):
            on = self._relaxed(float(ramp[j] * self.creep + softer[j]))
            press = on.press(fraction * on.rod.length, phi, (float(ratios[j, 0]), float(ratios[j, 1])))
            if press.to(float(force)) is None or press.lin is None:
                break
            wrenches[j] = self.read(on.free, press.lin[0:6, VALUE], on)
            points[j] = self.to_model(press.lin[POINT : POINT + 3, VALUE])
        return wrenches, points

    def to_model(self, point: Array) -> Array:
        """A point of the true base in the model's base frame [m], (3,)."""
        return np.asarray(self.R @ point + self.shift)

    def read(self, free: Equilibrium, wrench: Array, on: SurfaceRod) -> Array:
        """What a reading of a wrench (6,) at the true base gives at the model's base, without noise."""
        model = self.model
        seen = self._carried(wrench)
        base_from_sensor = wrench_map(inverse(model.T_sensor_base))
        if self.tared:
            zero = self._carried(free.wrench_base)
            at = model.rod.solve(model.gravity_base).wrench_base
            change = seen - zero
            return np.asarray(at + change + base_from_sensor @ (self.gain * (self._to_sensor @ change)))
        hanging = base_from_sensor @ model.gravity_wrench_sensor(self.pulled - model.gravity_base)
        whole = seen + base_from_sensor @ model.gravity_wrench_sensor(self.pulled)
        return np.asarray(seen + hanging + base_from_sensor @ (self.gain * (self._to_sensor @ whole)))

    @cached_property
    def _to_sensor(self) -> Array:
        return wrench_map(self.model.T_sensor_base)

    def _carried(self, wrench: Array) -> Array:
        """A wrench of the true base in the model's base frame, (6,)."""
        force, moment = self.R @ wrench[0:3], self.R @ wrench[3:6]
        return np.concatenate([force, moment + np.cross(self.shift, force)])

    def _relaxed(self, softer: float) -> SurfaceRod:
        """The rod that a touch finds; the sensor counts as tared with it, as the error sources have it."""
        factor = math.exp(softer)
        rod = replace(
            self.rod,
            youngs_modulus=factor * self.rod.youngs_modulus,
            shear_modulus=factor * self.rod.shear_modulus,
        )
        return SurfaceRod(rod, self.gravity, replace(self.model, rod=rod).mass, rod.solve(self.gravity))


@dataclass(frozen=True)
class Worlds:
    """n draws of all that a prediction does not know, noise apart.

    Attributes:
        model: of the probe.
        tolerances: they were drawn from.
        each: the draws.
    """

    model: ProbeModel
    tolerances: Tolerances
    each: tuple[World, ...]

    @classmethod
    def draw(cls, model: ProbeModel, tolerances: Tolerances, n: int, seed: int) -> "Worlds":
        """Draw them, the same for the same seed."""
        rng = np.random.default_rng(seed)
        return cls(model, tolerances, tuple(World.draw(model, tolerances, rng) for _ in range(n)))

    def touched(
        self, fraction: float, phi: float, forces: Sequence[float], rng: np.random.Generator
    ) -> tuple[Array, Array]:
        """The same place pressed in every world, friction and stiffness drawn for each touch: readings without noise
        and touched points in the model's base frame, (n, k, 6) and (n, k, 3); NaN where the probe gives way."""
        n, k = len(self.each), len(forces)
        friction = self.model.friction if math.isfinite(self.model.friction) else 1.0
        ratios = friction * rng.normal(size=(n, k, 2))
        softer = self.tolerances.stiffness_scatter * rng.normal(size=(n, k))
        found = [
            world.press(fraction, phi, forces, ratios[i], softer[i]) for i, world in enumerate(self.each)
        ]
        wrenches, points = (np.array(part) for part in zip(*found, strict=True))
        return wrenches, points

    def noise(self, n: int, k: int, rng: np.random.Generator) -> Array:
        """Of n presses of k readings, with the bias since the tare and its walk, at the base, (n, k, 6)."""
        root = np.linalg.cholesky(self.model.noise_base())
        steps = np.full((1, k, 1), self.tolerances.walk_steps)
        steps[0, 0] = self.tolerances.drift_steps
        bias = math.sqrt(self.model.averaging_samples) * np.cumsum(steps * rng.normal(size=(n, k, 6)), axis=1)
        return np.asarray((rng.normal(size=(n, k, 6)) + bias) @ root.T)

    def robot(self, n: int, k: int, rng: np.random.Generator) -> Array:
        """How far the robot reports each base amiss [m], (n, k, 3)."""
        return np.asarray(rng.normal(0.0, self.tolerances.robot_mm * MM, (n, k, 3)))


def printed(rod: Rod, by: Array) -> Rod:
    """A rod whose logarithms differ by these."""
    E, G, density, length = np.exp(by[:4]).tolist()
    radius = rod.radius * np.exp(by[4:])
    return replace(
        rod,
        s=rod.s * length,
        radius=radius,
        youngs_modulus=rod.youngs_modulus * E,
        shear_modulus=rod.shear_modulus * G,
        density=rod.density * density,
        rigid_length=rod.rigid_length * float(radius[0] / rod.radius[0]),
        rounded_from=None if rod.rounded_from is None else rod.rounded_from * length,
    )
