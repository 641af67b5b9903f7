"""A guess at all that the tests share: the rod, the base's pose and gravity that it means."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from probedesign.frames import Array, pose, wrench_map
from probedesign.identification.parameters import (
    BIAS,
    FALL,
    PRINT,
    SEAT_SHIFT,
    SEAT_TURN,
    SHIFT,
    TURN,
    Shared,
)
from probedesign.rod.rod import Rod

ROOT_STEP = 0.02
"""Of root_rigid_radii, for the one derivative that the rod does not carry: taken from both sides, it leaves 1e-4 of
itself."""
ROOT_RANGE = (-0.98, 2.0)


@dataclass(frozen=True)
class Guess:
    """Values of the shared vector.

    Attributes:
        shared: whose vector it is.
        x: the vector, (size,).
    """

    shared: Shared
    x: Array

    @property
    def root(self) -> float:
        """Compliance that the base lacks, in base radii."""
        rod = self.shared.model.rod
        return float(np.clip(rod.rigid_length / rod.radius[0] + self.x[4], *ROOT_RANGE))

    @cached_property
    def rod(self) -> Rod:
        """The probe as guessed."""
        rod, (E, G, density, diameters) = self.shared.model.rod, self.x[:4]
        radius = rod.radius * np.exp(diameters + self.x[PRINT:] @ self.shared.print_rows)
        return replace(
            rod, radius=radius, youngs_modulus=rod.youngs_modulus * float(np.exp(E)),
            shear_modulus=rod.shear_modulus * float(np.exp(G)), density=rod.density * float(np.exp(density)),
            rigid_length=self.root * float(radius[0]),
        )  # fmt: skip

    def rooted(self, more: float) -> Rod:
        """The same with another root."""
        return replace(self.rod, rigid_length=self.rod.rigid_length + more * float(self.rod.radius[0]))

    @cached_property
    def T_mount_base(self) -> Array:
        """The base where it is, in the base as it was told, (4, 4)."""
        return np.asarray(self.T_mount @ self.T_seat)

    @cached_property
    def T_mount(self) -> Array:
        """What bears the seat, where it is, in the base as it was told, (4, 4)."""
        return pose(Rotation.from_rotvec(self.x[TURN]).as_matrix(), self.x[SHIFT])

    @cached_property
    def T_seat(self) -> Array:
        """The base in its seat on the sensor, (4, 4)."""
        return pose(Rotation.from_rotvec(self.x[SEAT_TURN]).as_matrix(), self.x[SEAT_SHIFT])

    @cached_property
    def to_seat(self) -> Array:
        """Carries base wrenches to where the sensor takes the base to be, (6, 6)."""
        return wrench_map(self.T_seat)

    @property
    def bias(self) -> Array:
        """Of the readings, (6,)."""
        return self.x[BIAS]

    def gravity(self, gravity_world: Array) -> tuple[Array, Array]:
        """Gravity in the world [m/s²], (3,), and its derivatives by its two turns, (3, 2)."""
        across = np.linalg.svd(gravity_world[None])[2][1:] if gravity_world.any() else np.zeros((2, 3))
        turn = self.x[FALL] @ across
        return Rotation.from_rotvec(turn).as_matrix() @ gravity_world, np.cross(across, gravity_world).T
