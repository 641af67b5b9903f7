"""Print samples for Monte Carlo: probes perturbed by draws from the priors, and readings of their touches.

Every error source of `ErrorSources` is drawn once per sample: the rod itself, its root, its mount and gravity, the gain
of the sensor, the creep. Drawn for each touch are friction ratio, stiffness, noise, bias walk and robot error.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from probedesign.core.frames import Array, inverse, wrench_map
from probedesign.core.units import MM
from probedesign.estimation.error_sources import parameters_of, turns_of
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.surface_contact_kernel import POINT, VALUE
from probedesign.estimation.tolerances import Tolerances
from probedesign.prediction.touches import SurfaceRod
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.rod import Rod

_PER_TOUCH = ("creep", "stiffness scatter")
"""Sources that a single touch cannot distinguish: of fused touches the first grows, the second is drawn for each."""


@dataclass(frozen=True)
class PrintSample:
    """One perturbed probe with its mount and sensor.

    Attributes:
        model: the nominal probe, which the estimator uses.
        rod: as printed, before it creeps.
        gravity: in the true base frame [m/s²], (3,).
        gravity_in_model: the same in the model's base frame.
        R: rotation of the true base, (3, 3).
        translation: of the true base [m], (3,).
        gain: relative error of each channel of the sensor, (6,).
        creep: change of the logarithm of the stiffness at the last of several touches.
        tared: whether the sensor was tared with this probe free.
    """

    model: ProbeModel
    rod: Rod
    gravity: Array
    gravity_in_model: Array
    R: Array
    translation: Array
    gain: Array
    creep: float
    tared: bool

    @classmethod
    def draw(cls, model: ProbeModel, tolerances: Tolerances, rng: np.random.Generator) -> "PrintSample":
        """Draw one sample from the priors."""
        gravity = model.gravity_base
        parameters, turns = np.zeros(4 + len(model.rod.s)), np.zeros(9)
        for name, rows in parameters_of(model.rod, tolerances).items():
            z = rng.normal(size=len(rows))
            if name not in _PER_TOUCH:
                parameters += z @ rows
        for rows in turns_of(gravity, tolerances).values():
            turns += rng.normal(size=len(rows)) @ rows
        R = Rotation.from_rotvec(turns[3:6]).as_matrix()
        gravity_in_model = gravity + turns[6:9]
        rod = perturbed_rod(model.rod, parameters)
        base = float(rod.radius[0])
        root = rod.rigid_length + tolerances.root_radii * base * rng.normal()
        rod = replace(rod, rigid_length=min(max(root, -0.99 * base), 0.9 * rod.length))
        gain = tolerances.gain * rng.normal(size=6)
        creep = tolerances.creep * rng.normal()
        return cls(
            model,
            rod,
            R.T @ gravity_in_model,
            gravity_in_model,
            R,
            turns[0:3],
            gain,
            float(creep),
            tolerances.tared,
        )

    def press(
        self,
        fraction: float,
        phi: float,
        forces: Sequence[float],
        ratios: Array,
        log_stiffness: Array,
    ) -> tuple[Array, Array]:
        """Press one point of the surface.

        Args:
            fraction: arclength of the touched section over the length.
            phi: angle around the section [rad].
            forces: normal forces, ascending [N], (k,).
            ratios: of friction, around and along, (k, 2).
            log_stiffness: change of the logarithm of the stiffness at each touch, beside the creep, (k,).

        Returns:
            Readings without noise and touched points, both in the model's base frame, (k, 6) and (k, 3); NaN from the
            force on at which the probe buckles.
        """
        k = len(forces)
        ramp = np.ones(1) if k == 1 else np.linspace(0.0, 1.0, k)
        wrenches, points = np.full((k, 6), np.nan), np.full((k, 3), np.nan)
        for j, force in enumerate(forces):
            on = self._softened(float(ramp[j] * self.creep + log_stiffness[j]))
            press = on.begin_press(fraction * on.rod.length, phi, (float(ratios[j, 0]), float(ratios[j, 1])))
            if press.increase_to(float(force)) is None or press.lin is None:
                break
            wrenches[j] = self.reading(on.free, press.lin[0:6, VALUE], on)
            points[j] = self.point_in_model(press.lin[POINT : POINT + 3, VALUE])
        return wrenches, points

    def point_in_model(self, point: Array) -> Array:
        """Transform a point of the true base frame to the model's base frame [m], (3,)."""
        return np.asarray(self.R @ point + self.translation)

    def reading(self, free: Equilibrium, wrench: Array, on: SurfaceRod) -> Array:
        """Return the reading at the model's base, without noise, of a wrench (6,) at the true base."""
        model = self.model
        seen = self._in_nominal_frame(wrench)
        base_from_sensor = wrench_map(inverse(model.T_sensor_base))
        if self.tared:
            zero = self._in_nominal_frame(free.wrench_base)
            at = model.rod.solve(model.gravity_base).wrench_base
            change = seen - zero
            return np.asarray(at + change + base_from_sensor @ (self.gain * (self._to_sensor @ change)))
        hanging = base_from_sensor @ model.gravity_wrench_sensor(self.gravity_in_model - model.gravity_base)
        whole = seen + base_from_sensor @ model.gravity_wrench_sensor(self.gravity_in_model)
        return np.asarray(seen + hanging + base_from_sensor @ (self.gain * (self._to_sensor @ whole)))

    @cached_property
    def _to_sensor(self) -> Array:
        return wrench_map(self.model.T_sensor_base)

    def _in_nominal_frame(self, wrench: Array) -> Array:
        """Transform a wrench of the true base frame to the model's base frame, (6,)."""
        force, moment = self.R @ wrench[0:3], self.R @ wrench[3:6]
        return np.concatenate([force, moment + np.cross(self.translation, force)])

    def _softened(self, log_stiffness: float) -> SurfaceRod:
        """Return the rod with changed stiffness; the sensor counts as tared with it, as in the error sources."""
        factor = math.exp(log_stiffness)
        rod = replace(
            self.rod,
            youngs_modulus=factor * self.rod.youngs_modulus,
            shear_modulus=factor * self.rod.shear_modulus,
        )
        return SurfaceRod(rod, self.gravity, replace(self.model, rod=rod).mass, rod.solve(self.gravity))


@dataclass(frozen=True)
class PrintSamples:
    """Draws of everything that a prediction does not know, except noise.

    Attributes:
        model: of the nominal probe.
        tolerances: standard deviations they were drawn with.
        samples: the draws.
    """

    model: ProbeModel
    tolerances: Tolerances
    samples: tuple[PrintSample, ...]

    @classmethod
    def draw(cls, model: ProbeModel, tolerances: Tolerances, n: int, seed: int) -> "PrintSamples":
        """Draw n samples; the same seed gives the same samples."""
        rng = np.random.default_rng(seed)
        return cls(model, tolerances, tuple(PrintSample.draw(model, tolerances, rng) for _ in range(n)))

    def simulate_touches(
        self, fraction: float, phi: float, forces: Sequence[float], rng: np.random.Generator
    ) -> tuple[Array, Array]:
        """Press the same position of every sample, friction and stiffness drawn for each touch.

        Returns:
            Readings without noise and touched points in the model's base frame, (n, k, 6) and (n, k, 3); NaN where
            the probe buckles.
        """
        n, k = len(self.samples), len(forces)
        friction = self.model.friction if math.isfinite(self.model.friction) else 1.0
        ratios = friction * rng.normal(size=(n, k, 2))
        log_stiffness = self.tolerances.stiffness_scatter * rng.normal(size=(n, k))
        found = [
            sample.press(fraction, phi, forces, ratios[i], log_stiffness[i])
            for i, sample in enumerate(self.samples)
        ]
        wrenches, points = (np.array(part) for part in zip(*found, strict=True))
        return wrenches, points

    def draw_noise(self, n: int, k: int, rng: np.random.Generator) -> Array:
        """Draw noise, bias since the tare and its walk for n presses of k readings, at the base, (n, k, 6)."""
        root = np.linalg.cholesky(self.model.noise_base())
        steps = np.full((1, k, 1), self.tolerances.walk_steps)
        steps[0, 0] = self.tolerances.drift_steps
        bias = math.sqrt(self.model.averaging_samples) * np.cumsum(steps * rng.normal(size=(n, k, 6)), axis=1)
        return np.asarray((rng.normal(size=(n, k, 6)) + bias) @ root.T)

    def draw_robot_error(self, n: int, k: int, rng: np.random.Generator) -> Array:
        """Draw the error of the reported base positions [m], (n, k, 3)."""
        return np.asarray(rng.normal(0.0, self.tolerances.robot_mm * MM, (n, k, 3)))


def perturbed_rod(rod: Rod, by: Array) -> Rod:
    """Return a rod with changed logarithms of E, G, density, length and radii.

    Args:
        rod: nominal.
        by: changes, (4 + knots,).
    """
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
