"""A touch at a point of the deformed surface: its couple about the axis, the touched point and the friction.

A force F acts at the point x = p(s) + r(s) c(φ) of the deformed surface, c = g e + k h with the outline's normal e(φ) =
R(s) [cos φ, sin φ, 0], h = ∂e/∂φ and the reach g (`probedesign.rod.contact.outline`; c = e if round); on the axis it
acts with the couple C = (x - p) × F. The couple depends on the deformed section and the section on the couple, so both
are solved for together by Newton's method with the rod's exact sensitivities. The force is that of the sensor and lies
in no given direction: its tangential part over its normal part has the prior N(0, μ²) in each direction, as in
`probedesign.estimation`.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from probedesign.core.frames import Array, skew
from probedesign.rod.contact import outline
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.kernels.equations import ALL_COLUMNS, COUPLE, PARAMETERS
from probedesign.rod.rod import Rod

#: Columns of the rod's sensitivities by the couple.
COUPLE_COLUMNS = slice(PARAMETERS.index("couple_x"), PARAMETERS.index("couple_z") + 1)
S_COLUMN, DIAMETER_COLUMN = PARAMETERS.index("s_contact"), PARAMETERS.index("log_diameter")
MAX_ITERATIONS = 12
#: Of the couple, relative to the force times the radius: a nanonewton metre for a touch of 20 mN.
COUPLE_TOLERANCE = 1e-5
MIN_NORMAL = 1e-3  #: Smallest normal force of a touch over its force: with less it would pull.


@dataclass(frozen=True)
class SurfaceTouch:
    """A solved touch."""

    rod: Rod  #: the rod.
    eq: Equilibrium  #: its equilibrium under force and couple, with all sensitivities.
    force: Array  #: on the rod [N], (3,).
    angle: float  #: φ of the outline's normal there about the tangent, from the section's x axis [rad].
    step_axes: Array  #: derivatives of the section's axes by the parameters with a step, (3, 3, n).

    @cached_property
    def _weights(self) -> Array:
        """Return the maps from the section's [t, x, p, y] to e and to the circumferential direction h, (2, 12)."""
        c, s = math.cos(self.angle), math.sin(self.angle)
        weights = np.zeros((2, 4))
        weights[0, [1, 3]] = c, s
        weights[1, [1, 3]] = -s, c
        return weights

    @cached_property
    def _outline(self) -> tuple[float, float]:
        """Return g and k of the outline's point."""
        reach, aside = outline(self.rod.flatness, math.cos(self.angle), math.sin(self.angle))
        return float(reach), float(aside)

    @cached_property
    def _spokes(self) -> tuple[Array, Array]:
        """Return the maps from [t, e, h] to c and to its derivative by φ, (3,) each."""
        reach, aside = self._outline
        return np.array([0.0, reach, aside]), np.array([0.0, 0.0, self.rod.flatness**2 / reach**3])

    @cached_property
    def _directions(self) -> tuple[Array, Array]:
        """Return [t, e, h], (3, 3), and their derivatives by the rod's parameters, (3, 3, k)."""
        assert self.eq.sensitivity is not None
        frame = self.eq.sensitivity.frame.reshape(4, 3)
        d = self.eq.sensitivity.d_contact.reshape(4, 3, -1)
        maps = np.vstack([[1.0, 0.0, 0.0, 0.0], self._weights])
        return maps @ frame, np.einsum("ij,jkl->ikl", maps, d)

    @cached_property
    def _by_steps(self) -> Array:
        """Return the derivatives of [t, e, h] by the parameters with a step at a given couple, (3, 3, n)."""
        maps = np.vstack([[0.0, 0.0, 1.0], np.pad(self._weights[:, [1, 3]], ((0, 0), (0, 1)))])
        return np.asarray(np.einsum("ij,kjn->ikn", maps, self.step_axes))

    @cached_property
    def radius(self) -> float:
        """Radius of the touched section [m]."""
        return float(self.rod.radius_at(self.eq.s_contact))

    @cached_property
    def _d_log_radius(self) -> Array:
        """Return the derivative of the logarithm of the radius by the rod's parameters, (k,)."""
        rod, s = self.rod, self.eq.s_contact
        d = np.zeros(ALL_COLUMNS + len(rod.s))
        d[S_COLUMN] = -rod.taper_at(s) / self.radius
        d[DIAMETER_COLUMN] = 1.0
        d[ALL_COLUMNS:] = np.array([np.interp(s, rod.s, one) for one in np.diag(rod.radius)]) / self.radius
        return d

    @property
    def couple(self) -> Array:
        """Couple of the force about the axis, by the section as it is [N·m], (3,)."""
        return np.asarray(-self.radius * (skew(self.force) @ (self._spokes[0] @ self._directions[0])))

    @cached_property
    def couple_jacobian(self) -> Array:
        """Derivatives of the couple by the rod's parameters, at a given section, (3, k)."""
        axes, d = self._directions
        spoke = self._spokes[0]
        J = -self.radius * skew(self.force) @ np.einsum("j,jkl->kl", spoke, d)
        J += np.outer(self.couple, self._d_log_radius)
        J[:, 0:3] += self.radius * skew(spoke @ axes)
        return np.asarray(J)

    @property
    def converged(self) -> bool:
        """Whether the couple of the equilibrium is that of its section."""
        error = np.linalg.norm(self.couple - self.eq.load[COUPLE : COUPLE + 3])
        return bool(error <= COUPLE_TOLERANCE * self.radius * np.linalg.norm(self.force) + 1e-15)

    @cached_property
    def couple_response(self) -> tuple[Array, Array, Array]:
        """Derivatives of the couple at equilibrium by the rod's parameters (3, k), the parameters with a step (3, n)
        and the angle (3,)."""
        J = self.couple_jacobian
        (spoke, by_angle), arm = self._spokes, -self.radius * skew(self.force)
        steps = arm @ np.einsum("j,jkn->kn", spoke, self._by_steps)
        direct = J.copy()
        direct[:, COUPLE_COLUMNS] = 0.0
        columns = np.column_stack([direct, steps, arm @ (by_angle @ self._directions[0])])
        found: Array = np.linalg.solve(np.eye(3) - J[:, COUPLE_COLUMNS], columns).astype(float, copy=False)
        return found[:, : J.shape[1]], found[:, J.shape[1] : -1], found[:, -1]

    @property
    def offset(self) -> tuple[Array, Array, Array, Array]:
        """Vector from the axis to the touched point [m], (3,), and its derivatives by the rod's parameters (3, k), the
        parameters with a step (3, n) and the angle (3,), at a given couple."""
        (axes, d), (spoke, by_angle) = self._directions, self._spokes
        by_rod = self.radius * (np.einsum("j,jkl->kl", spoke, d) + np.outer(spoke @ axes, self._d_log_radius))
        steps, angle = self.radius * np.einsum("j,jkn->kn", spoke, self._by_steps), self.radius * (by_angle @ axes)
        return self.radius * (spoke @ axes), by_rod, steps, angle

    @cached_property
    def _contact_maps(self) -> Array:
        """Return the maps from [t, e, h] to the inward normal, along the flank and around it, (3, 3)."""
        tan = self._outline[0] * self.rod.taper_at(self.eq.s_contact)
        cos, sin = 1.0 / math.hypot(1.0, tan), tan / math.hypot(1.0, tan)
        return np.array([[-sin, -cos, 0.0], [cos, -sin, 0.0], [0.0, 0.0, 1.0]])

    @property
    def pushes(self) -> bool:
        """Whether the force points into the surface. Where it does not, the friction ratios have no meaning."""
        normal = self._contact_maps[0] @ self._directions[0] @ self.force
        return bool(normal > MIN_NORMAL * np.linalg.norm(self.force))

    @property
    def friction(self) -> tuple[Array, Array, Array, Array]:
        """Tangential over normal force along the flank and around it, (2,), and its derivatives as in `offset`.

        Outward normal N = cos α e + sin α t, along the flank a = cos α t - sin α e; the ratios are F·a/(-F·N) and
        F·h/(-F·N). Defined where the force `pushes`.
        """
        (t, e, h), d = self._directions
        maps = self._contact_maps
        axes = maps @ np.stack([t, e, h])
        # The lean α turns the normal into the flank's own direction; tan α = -g dr/ds, and cos α stands in the maps.
        lean = maps[1, 0] ** 2 * self._outline[1] * float(self.rod.taper_at(self.eq.s_contact))
        by_angle = maps @ np.stack([np.zeros(3), h, -e]) + lean * np.stack([-axes[1], axes[0], np.zeros(3)])
        normal, *tangential = axes @ self.force
        ratio = np.array(tangential) / normal
        by_rod = np.einsum("ij,jkl->ikl", maps, d)
        moved = np.einsum("ikl,k->il", by_rod, self.force)
        moved[:, 0:3] += axes
        steps = np.einsum("ij,jkn,k->in", maps, self._by_steps, self.force)
        moved = np.column_stack([moved, steps, by_angle @ self.force])
        D = (moved[1:] - ratio[:, None] * moved[0]) / normal
        k = by_rod.shape[-1]
        return ratio, D[:, :k], D[:, k:-1], D[:, -1]


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
        matrix = np.eye(3) - touch.couple_jacobian[:, COUPLE_COLUMNS]  # a step of Newton's method
        couple, tip = couple + np.linalg.solve(matrix, touch.couple - couple), eq.tip
    return eq, False
