"""A touch at a point of the deformed surface: its couple about the axis, the touched point and the friction.

A force F acts at the point x = p(s) + r(s) c(φ) of the deformed surface, c = g e + k h with the outline's normal e(φ) =
R(s) [cos φ, sin φ, 0], h = ∂e/∂φ and the reach g (`probedesign.rod.contact.outline`; c = e if round); on the axis it
acts with the couple C = (x - p) × F. The couple depends on the deformed section and the section on the couple, so both
are solved for together by Newton's method with the rod's exact sensitivities. The force is that of the sensor and lies
in no given direction: its tangential part over its normal part has the prior N(0, μ²) in each direction, as in
`probedesign.estimation`.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from probedesign.core.frames import Array
from probedesign.rod.contact import outline
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.friction import cross, dot
from probedesign.rod.kernels.equations import ALL_COLUMNS, COUPLE, PARAMETERS
from probedesign.rod.rod import Rod

#: Columns of the rod's sensitivities by the couple.
COUPLE_COLUMNS = slice(PARAMETERS.index("couple_x"), PARAMETERS.index("couple_z") + 1)
MAX_ITERATIONS = 12
#: Of the couple, relative to the force times the radius: a nanonewton metre for a touch of 20 mN.
COUPLE_TOLERANCE = 1e-5
MIN_NORMAL = 1e-3  #: Smallest normal force of a touch over its force: with less it would pull.
_IMAGINARY = 1e-30  # complex step of the derivatives: so small that no digit is lost


@dataclass(frozen=True)
class SurfaceTouch:
    """A solved touch.

    Derivatives of its values, at a given couple, are columns: by the rod's parameters, by those with a step, and by the
    angle, (., k + n + 1).
    """

    rod: Rod  #: the rod.
    eq: Equilibrium  #: its equilibrium under force and couple, with all sensitivities.
    force: Array  #: on the rod [N], (3,).
    angle: float  #: φ of the outline's normal there about the tangent, from the section's x axis [rad].
    step_axes: Array  #: derivatives of the section's axes by the parameters with a step, (3, 3, n).

    @cached_property
    def radius(self) -> float:
        """Radius of the touched section [m]."""
        return float(self.rod.radius_at(self.eq.s_contact))

    @cached_property
    def _values(self) -> tuple[Array, Array]:
        """Offset, couple, friction ratios and normal force, (9,), with their derivatives, (9, k + n + 1).

        Outward normal N = cos α e + sin α t, along the flank a = cos α t - sin α e; the ratios are F·a/(-F·N) and
        F·h/(-F·N).
        """
        rod, s, sensitivity = self.rod, self.eq.s_contact, self.eq.sensitivity
        assert sensitivity is not None
        z = np.concatenate([sensitivity.frame, self.force, [1.0, self.angle]])  # the radius over its value
        z = z[:, None] + 1j * _IMAGINARY * np.eye(len(z))
        t, x, y, F, angle = z[0:3], z[3:6], z[9:12], z[12:15], z[16]
        e, h = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x
        reach, aside = outline(rod.flatness, np.cos(angle), np.sin(angle))
        arm = self.radius * z[15] * (reach * e + aside * h)
        tan = reach * float(rod.taper_at(s))
        cos = 1.0 / np.sqrt(1.0 + tan * tan)
        normal = -cos * dot(F, e + tan * t)
        values = np.stack([*arm, *cross(arm, F), cos * dot(F, t - tan * e) / normal, dot(F, h) / normal, normal])
        by = values.imag / _IMAGINARY
        d_log_radius = np.zeros(ALL_COLUMNS + len(rod.s))
        d_log_radius[PARAMETERS.index("s_contact")] = -rod.taper_at(s) / self.radius
        d_log_radius[PARAMETERS.index("log_diameter")] = 1.0
        d_log_radius[ALL_COLUMNS:] = [np.interp(s, rod.s, knot) / self.radius for knot in np.diag(rod.radius)]
        by_rod = by[:, 0:12] @ sensitivity.d_contact + np.outer(by[:, 15], d_log_radius)
        by_rod[:, 0:3] += by[:, 12:15]
        of_axes = np.stack([by[:, 3:6], by[:, 9:12], by[:, 0:3]], axis=-1)  # as step_axes has them
        by_steps = np.einsum("ijk,jkn->in", of_axes, self.step_axes)
        return values[:, 0].real, np.column_stack([by_rod, by_steps, by[:, 16]])

    @property
    def offset(self) -> tuple[Array, Array]:
        """Vector from the axis to the touched point [m], (3,), and its derivatives."""
        return self._values[0][0:3], self._values[1][0:3]

    @property
    def friction(self) -> tuple[Array, Array]:
        """Tangential over normal force along the flank and around it, (2,), and its derivatives.

        Defined where the force `pushes`.
        """
        return self._values[0][6:8], self._values[1][6:8]

    @property
    def couple(self) -> tuple[Array, Array]:
        """Couple of the force about the axis, by the section as it is [N·m], (3,), and its derivatives."""
        return self._values[0][3:6], self._values[1][3:6]

    @property
    def converged(self) -> bool:
        """Whether the couple of the equilibrium is that of its section."""
        error = np.linalg.norm(self.couple[0] - self.eq.load[COUPLE : COUPLE + 3])
        return bool(error <= COUPLE_TOLERANCE * self.radius * np.linalg.norm(self.force) + 1e-15)

    @property
    def pushes(self) -> bool:
        """Whether the force points into the surface. Where it does not, the friction ratios have no meaning."""
        return bool(self._values[0][8] > MIN_NORMAL * np.linalg.norm(self.force))

    @cached_property
    def couple_response(self) -> Array:
        """Derivatives of the couple at equilibrium, (3, k + n + 1)."""
        direct = self.couple[1].copy()
        by_couple = direct[:, COUPLE_COLUMNS].copy()
        direct[:, COUPLE_COLUMNS] = 0.0
        return np.asarray(np.linalg.solve(np.eye(3) - by_couple, direct), dtype=float)


def solve_touch(
    rod: Rod, gravity: Array, force: Array, s: float, angle: float, tip: Array | None, couple: Array
) -> tuple[Equilibrium, bool]:
    """Solve for the rod under a force at a point of its deformed surface.

    Args:
        rod: the rod.
        gravity: in base axes [m/s²], (3,).
        force: in base axes [N], (3,).
        s: arclength of the touched section [m].
        angle: of the outline's normal about the tangent, from the section's x axis [rad].
        tip: state of a neighbouring equilibrium, as the initial guess.
        couple: initial guess [N·m], (3,).

    Returns:
        The equilibrium with all sensitivities, and whether it was found with its couple and the force pushes.
    """
    for _ in range(MAX_ITERATIONS):
        eq = rod.solve(gravity, force, s, couple=couple, guess=tip, columns="all")
        if not eq.ok:
            return eq, False
        touch = SurfaceTouch(rod, eq, force, angle, np.zeros((3, 3, 0)))
        if touch.converged:
            return eq, touch.pushes
        of_section, J = touch.couple
        step = np.linalg.solve(np.eye(3) - J[:, COUPLE_COLUMNS], of_section - couple)  # of Newton's method
        couple, tip = couple + step, eq.tip
    return eq, False
