"""Probes that differ from their model as the tolerances allow: one world a draw, for Monte Carlo."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from probedesign.estimation.causes import answers_of, parameters_of, turns_of
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.frames import Array, inverse, wrench_map
from probedesign.prediction.touches import DIRECTIONS
from probedesign.rod.batch import Rods, solve_batch
from probedesign.rod.contacts import Contacts, Start, follow_contacts, solve_contacts
from probedesign.rod.rod import Rod


@dataclass(frozen=True)
class Worlds:
    """n draws of all that a prediction does not know, noise apart.

    Attributes:
        model: of the probe.
        tolerances: it was drawn by.
        rods: as printed, one a draw.
        parameters: by which they differ: log E, log G, log density, log length, log diameters, (n, 4 + K).
        gravity: as each base sees it [m/s²], (n, 3).
        R: turn of each base, (n, 3, 3).
        shift: of each base [m], (n, 3).
        off: what each reading has too much, told at the model's base, since the sensor was tared with this probe or
            not at all, (n, 6).
    """

    model: ProbeModel
    tolerances: Tolerances
    rods: Rods
    parameters: Array
    gravity: Array
    R: Array
    shift: Array
    off: Array

    @classmethod
    def draw(cls, model: ProbeModel, tolerances: Tolerances, n: int, seed: int) -> "Worlds":
        """Draw them, the same for the same seed."""
        rng = np.random.default_rng(seed)
        gravity, K = model.gravity_base, len(model.rod.s)
        parameters, turns = np.zeros((n, 4 + K)), np.zeros((n, 9))
        for rows in parameters_of(model.rod, tolerances).values():
            parameters += rng.normal(size=(n, len(rows))) @ rows
        for rows in turns_of(gravity, tolerances).values():
            turns += rng.normal(size=(n, len(rows))) @ rows
        R = Rotation.from_rotvec(turns[:, 3:6]).as_matrix()
        pulled = gravity + turns[:, 6:9]
        seen = np.einsum("nji,nj->ni", R, pulled)
        rods = Rods.of([printed(model.rod, row) for row in parameters])
        worlds = cls(model, tolerances, rods, parameters, seen, R, turns[:, 0:3], np.zeros((n, 6)))
        return replace(worlds, off=worlds._off(pulled))

    def of_rods(self, rods: list[Rod]) -> "Worlds":
        """The same worlds with other probes, tared with these."""
        other = replace(self, rods=Rods.of(rods))
        return replace(other, off=other._off(np.einsum("nij,nj->ni", self.R, self.gravity)))

    def touched(self, fraction: float, force_N: float, direction: str) -> tuple[Array, Array]:
        """The touch in every world: reading without noise and true point, told in the model's base frame, (n, 6) and
        (n, 3); NaN where the probe gives way."""
        contacts = self.contacts(fraction, force_N, direction)
        return self.told(contacts.batch.wrench_base) + self.off, self.told_point(
            contacts.batch.p_contact_base
        )

    def contacts(self, fraction: float, force_N: float, direction: str) -> Contacts:
        """The touch in every world, as its own base sees it, without columns."""
        n, angle = len(self.rods), DIRECTIONS[direction]
        return solve_contacts(
            self.rods, self.gravity, fraction * self.rods.length, np.full(n, angle), np.full(n, force_N),
            start=self._start(fraction, force_N, angle), columns="none", threads=1,
        )  # fmt: skip

    def told_point(self, point: Array) -> Array:
        """Points of the true bases in the model's base frame [m], (n, 3)."""
        return np.asarray(np.einsum("nij,nj->ni", self.R, point) + self.shift)

    def noise(self, n: int, rng: np.random.Generator) -> Array:
        """Of n readings, with the drift of the bias, at the base, (n, 6)."""
        cov = self.model.noise_base()
        cov *= 1.0 + self.tolerances.drift_steps**2 * self.model.averaging_samples
        return np.asarray(rng.normal(size=(n, 6)) @ np.linalg.cholesky(cov).T)

    def _start(self, fraction: float, force_N: float, angle: float) -> Start | None:
        """The model's own touch, moved to first order to each world."""
        model, n = self.model, len(self.rods)
        step = follow_contacts(model.rod, model.gravity_base, np.array([fraction * model.rod.length]),
                               np.array([angle]), [force_N])[0]  # fmt: skip
        if not step.ok[0]:
            return None
        d_force = answers_of(step, model.rod, model.gravity_base).force[0]
        by = np.hstack([self.gravity - model.gravity_base, self.parameters])
        force = step.force + by @ d_force.T
        return Start(np.full(n, force_N), force, np.tile(step.tip, (n, 1)), np.zeros((n, 3)))

    def told(self, wrench: Array) -> Array:
        """Wrenches of the true bases in the model's base frame, (n, 6)."""
        force, moment = (np.einsum("nij,nj->ni", self.R, part) for part in (wrench[:, 0:3], wrench[:, 3:6]))
        return np.hstack([force, moment + np.cross(self.shift, force)])

    def _off(self, pulled: Array) -> Array:
        """See `off`; `pulled` is gravity in the model's base axes, (n, 3)."""
        model = self.model
        if not self.tolerances.tared:
            back = wrench_map(inverse(model.T_sensor_base))
            change = pulled - model.gravity_base
            return np.array([back @ model.gravity_wrench_sensor(g) for g in change])
        free = solve_batch(self.rods, self.gravity, (0.0, 0.0, 0.0), 0.0, threads=1)
        return np.asarray(model.rod.solve(model.gravity_base).wrench_base - self.told(free.wrench_base))


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
