"""Residuals of one test and of the weighing: whitened, with derivatives, in blocks that belong together."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from probedesign.core.frames import Array, skew
from probedesign.core.statistics import whiten
from probedesign.identification.parameters import (
    BASE_OFFSET,
    BASE_ROTATION,
    GRAVITY_COLUMNS,
    MOUNT_OFFSET,
    MOUNT_ROTATION,
    PARAMETERS,
    PRINT,
    ROOT_STEP,
    ParameterValues,
)
from probedesign.rod.equilibrium import Equilibrium, Sensitivity
from probedesign.rod.kernels import equations
from probedesign.rod.rod import Rod

FRICTION = 0.1
"""Standard deviation of the tangential fraction of a touch's force. A dry edge on this resin may well stick (assumed);
the sensor measures the force itself, so little is lost by trusting the surface little."""
_TANGENT_STEP = 1e-5  # of arclength, for the rotation of a section by a difference of its tangent [m]


@dataclass(frozen=True)
class MeasuredTest:
    """One state of the probe and what was measured of it, in SI; what was not measured is None or NaN.

    Attributes:
        name: of the test.
        T_world_base: pose of the base as stated, (4, 4).
        gravity_world: [m/s²], (3,).
        force_world: a known dead load [N], (3,); None for a touch whose force is not known.
        s_contact: arclength of the load [m].
        std_s: standard deviation of s_contact [m]; 0 if it is exact.
        p_touch_world: touched point of the surface, or of the centreline under a dead load [m], (3,).
        std_touch: standard deviation of p_touch_world on each axis [m].
        wrench_base: mean reading, about the base [N, N·m], (6,).
        cov_wrench: covariance of wrench_base, (6, 6).
        marker_s: arclengths of the markers that were seen [m], (m,).
        p_markers_world: [m], (m, 3).
        cov_markers: (m, 3, 3).
        marker_numbers: from 1 on, (m,).
        marker_side: side of the section that carries them [rad]; None if they are on the axis.
        sag: displacement of the tip along gravity from where it would be without weight [m].
        std_sag: [m].
    """

    name: str
    T_world_base: Array
    gravity_world: Array
    force_world: Array | None
    s_contact: float = np.nan
    std_s: float = 0.0
    p_touch_world: Array | None = None
    std_touch: float = np.nan
    wrench_base: Array | None = None
    cov_wrench: Array | None = None
    marker_s: Array = field(default_factory=lambda: np.empty(0))
    p_markers_world: Array = field(default_factory=lambda: np.empty((0, 3)))
    cov_markers: Array = field(default_factory=lambda: np.empty((0, 3, 3)))
    marker_numbers: tuple[int, ...] = ()
    marker_side: float | None = None
    sag: float = np.nan
    std_sag: float = np.nan

    @property
    def free(self) -> bool:
        """Whether its weight is its only load."""
        return self.force_world is not None and not np.any(self.force_world)

    @property
    def touched(self) -> bool:
        """Whether the force is unknown."""
        return self.force_world is None

    @property
    def s_estimated(self) -> bool:
        """Whether the arclength of the load is not known exactly."""
        return not self.free and not (np.isfinite(self.s_contact) and self.std_s == 0.0)

    @property
    def nuisance_size(self) -> int:
        """Number of nuisance parameters of this test: the force of a touch [N], and the arclength of a load [m]."""
        return 3 * self.touched + self.s_estimated

    @property
    def gravity_base(self) -> Array:
        """Gravity in base axes by the stated pose [m/s²], (3,)."""
        return np.asarray(self.T_world_base[:3, :3].T @ self.gravity_world)


class ResidualBlock(NamedTuple):
    """Residuals that one reading makes.

    Attributes:
        test: its name.
        kind: markers, wrenches, touches, places, sags, friction or scales.
        item: number of the marker in the test, from 1; 0 for the only one of its kind.
        r: measured minus modelled, whitened, (k,).
        J: derivatives of `r` by the parameter vector, (k, size).
        J_nuisance: and by the test's nuisance parameters, (k, nuisance_size).
        residual: measured minus modelled, in SI, (k,).
    """

    test: str
    kind: str
    item: int
    r: Array
    J: Array
    J_nuisance: Array
    residual: Array

    @property
    def squared_distance(self) -> float:
        """Squared Mahalanobis distance with the stated noise."""
        return float(self.r @ self.r)


class WithJacobian(NamedTuple):
    """A vector of the solved rod in base axes with its derivatives; further axes first for several vectors.

    Attributes:
        value: (3,), or (6,) for a wrench.
        by_rod: by the parameters of the rod's sensitivities, (., k).
        by_root: by root_rigid_radii, (.,).
    """

    value: Array
    by_rod: Array
    by_root: Array


@dataclass(frozen=True)
class SolvedTest:
    """A test solved at some parameter values.

    Attributes:
        measured: the test.
        values: of the parameters.
        nuisance: the test's own parameters: force of a touch in base axes [N], arclength of the load [m].
        eq: the equilibrium, with all sensitivities.
        root_solutions: with a root a step less and a step more; empty where its derivative is not needed.
        gravity_base: at these values [m/s²], (3,).
        d_gravity: derivative of gravity in base axes by its two rotations, (3, 2).
    """

    measured: MeasuredTest
    values: ParameterValues
    nuisance: Array
    eq: Equilibrium
    root_solutions: tuple[Equilibrium, ...]
    gravity_base: Array
    d_gravity: Array

    @property
    def ok(self) -> bool:
        """Whether the rod has a stable equilibrium."""
        return self.eq.ok and all(eq.ok for eq in self.root_solutions)

    @property
    def sensitivity(self) -> Sensitivity:
        """Sensitivities of the equilibrium."""
        assert self.eq.sensitivity is not None
        return self.eq.sensitivity

    @property
    def force(self) -> Array:
        """Force on the rod in base axes [N], (3,)."""
        return self.eq.load[0:3]

    def blocks(self) -> Iterator[ResidualBlock]:
        """Yield all residuals of the test."""
        if self.measured.wrench_base is not None:
            yield self._wrench()
        yield from self._markers()
        if self.measured.p_touch_world is not None and not self.measured.free:
            yield self._touch()
        if self.measured.s_estimated and np.isfinite(self.measured.s_contact):
            yield self._arclength()
        if self.measured.touched:
            yield self._friction()
        if np.isfinite(self.measured.sag):
            yield self._sag()

    def by_base_rotation(self, vector: WithJacobian) -> Array:
        """Return the derivative by the base's rotation in stated axes, through gravity and dead loads, (..., 3)."""
        return self._by_rotation(vector) @ self.values.T_stated_base[:3, :3].T

    def by_mount_rotation(self, vector: WithJacobian) -> Array:
        """Return the derivative by the rotation of the probe on the sensor, (..., 3)."""
        return self._by_rotation(vector) @ self.values.T_mount_error[:3, :3].T

    def _by_rotation(self, vector: WithJacobian) -> Array:
        d = vector.by_rod[..., GRAVITY_COLUMNS] @ skew(self.gravity_base)
        return d if self.measured.touched else np.asarray(d + vector.by_rod[..., 0:3] @ skew(self.force))

    def jacobian(self, vector: WithJacobian) -> Array:
        """Return derivatives of a vector in base axes by the parameter vector, (..., size), at fixed base axes."""
        J = np.zeros((*vector.value.shape, self.values.common.size))
        for parameter in PARAMETERS.values():
            if parameter.jacobian is not None:
                J[..., parameter.columns] = parameter.jacobian(self, vector)
        J[..., PRINT:] = vector.by_rod[..., equations.ALL_COLUMNS :] @ self.values.common.print_modes.T
        return J

    def nuisance_jacobian(self, vector: WithJacobian) -> Array:
        """Return derivatives of a vector in base axes by the test's nuisance parameters, (..., nuisance_size)."""
        force, s = 3 * self.measured.touched, int(self.measured.s_estimated)
        return np.concatenate([vector.by_rod[..., 0:force], vector.by_rod[..., 3 : 3 + s]], axis=-1)

    def in_world(self, vector: WithJacobian) -> tuple[Array, Array, Array]:
        """Return points of the rod in the world, with derivatives by the parameter vector and by the nuisance
        parameters."""
        values, R_stated = self.values, self.measured.T_world_base[:3, :3]
        T = self.measured.T_world_base @ values.T_stated_base
        R, R_sensor, mount = T[:3, :3], R_stated @ values.T_base_error[:3, :3], values.T_mount_error
        turned = vector.value @ mount[:3, :3].T
        J = R @ self.jacobian(vector)
        J[..., BASE_ROTATION] -= R_stated @ _skews((turned + mount[:3, 3]) @ values.T_base_error[:3, :3].T)
        J[..., MOUNT_ROTATION] -= R_sensor @ _skews(turned)
        J[..., BASE_OFFSET], J[..., MOUNT_OFFSET] = R_stated, R_sensor
        return vector.value @ R.T + T[:3, 3], J, R @ self.nuisance_jacobian(vector)

    def _wrench(self) -> ResidualBlock:
        X = self.values.mount_wrench_map
        by_root = self._by_root(lambda eq: eq.wrench_base)
        vector = WithJacobian(self.eq.wrench_base, self.sensitivity.d_wrench, by_root)
        modelled = X @ vector.value
        J, J_nuisance = X @ self.jacobian(vector), X @ self.nuisance_jacobian(vector)
        f, arm = skew(modelled[:3]), skew(self.values.T_mount_error[:3, 3])
        J[:3, MOUNT_ROTATION] -= f
        J[3:, MOUNT_ROTATION] -= skew(modelled[3:] - arm @ modelled[:3]) + arm @ f
        J[3:, MOUNT_OFFSET] -= f
        for parameter in PARAMETERS.values():
            if parameter.reading is not None:
                x = self.values.x[parameter.columns]
                modelled, by_wrench, by_parameter = parameter.reading(modelled, x)
                J, J_nuisance = by_wrench @ J, by_wrench @ J_nuisance
                J[:, parameter.columns] += by_parameter
        assert self.measured.wrench_base is not None and self.measured.cov_wrench is not None
        residual = self.measured.wrench_base - modelled
        return self._block("wrenches", 0, residual, J, J_nuisance, self.measured.cov_wrench)

    def _markers(self) -> Iterator[ResidualBlock]:
        measured = self.measured
        if not len(measured.marker_s):
            return
        p, d = self.eq.p_at(measured.marker_s), self.eq.d_p_at(measured.marker_s)
        by_root = self._by_root(lambda eq: eq.p_at(measured.marker_s))
        if measured.marker_side is not None:
            offset, d_offset = self._surface_offset(measured.marker_s, measured.marker_side)
            p, d = p + offset, d + d_offset
        modelled, J, J_nuisance = self.in_world(WithJacobian(p, d, by_root))
        residual = measured.p_markers_world - modelled
        for i, number in enumerate(measured.marker_numbers):
            yield self._block("markers", number, residual[i], J[i], J_nuisance[i], measured.cov_markers[i])

    def _surface_offset(self, s: Array, side: float) -> tuple[Array, Array]:
        """Return vectors from the axis to the surface on one side, (m, 3), and their derivatives, (m, 3, k).

        The section rotates with its tangent; a change of its twist, which round rods do not have, is neglected.
        """
        rod, R, section = self.values.rod, self.eq.R_at(s), self.values.common.model.cross_section
        radius = section.reach(side) * rod.radius_at(s)[:, None]
        offset = radius * (np.cos(side) * R[:, :, 0] + np.sin(side) * R[:, :, 1])
        low, high = np.maximum(s - _TANGENT_STEP, 0.0), np.minimum(s + _TANGENT_STEP, rod.length)
        across = (low <= self.eq.s_contact) & (self.eq.s_contact < high)  # the shear jumps at the load
        low = np.where(across, self.eq.s_contact - 2.0 * _TANGENT_STEP, low)
        high = np.where(across, self.eq.s_contact - _TANGENT_STEP, high)
        d_tangent = (self.eq.d_p_at(high) - self.eq.d_p_at(low)) / (high - low)[:, None, None]
        rotation = np.cross(R[:, :, 2][:, :, None], d_tangent, axis=1)
        return offset, np.cross(rotation, offset[:, :, None], axis=1)

    def _touch(self) -> ResidualBlock:
        measured = self.measured
        by_root = self._by_root(lambda eq: eq.p_contact_base)
        vector = WithJacobian(self.eq.p_contact_base, self.sensitivity.d_position, by_root)
        if measured.touched:
            offset, d_offset = self._contact_offset()
            vector = WithJacobian(vector.value + offset, vector.by_rod + d_offset, by_root)
        modelled, J, J_nuisance = self.in_world(vector)
        assert measured.p_touch_world is not None
        cov = measured.std_touch**2 * np.eye(3)
        return self._block("touches", 0, measured.p_touch_world - modelled, J, J_nuisance, cov)

    def _contact_offset(self) -> tuple[Array, Array]:
        """Return the vector from the axis to the touched surface, against the force [m], (3,), with derivatives by
        the parameters of the rod's sensitivities, (3, k)."""
        rod, s, size = self.values.rod, self.eq.s_contact, float(np.linalg.norm(self.force)) or 1.0
        u, slope, radius = self.force / size, rod.taper_at(s), float(rod.radius_at(s))
        reach = radius / np.hypot(1.0, slope)
        d = np.zeros((3, equations.ALL_COLUMNS + len(rod.s)))
        d[:, 0:3] = -reach / size * (np.eye(3) - np.outer(u, u))
        d[:, 3] = slope / radius * reach * u
        d[:, equations.PARAMETERS.index("log_diameter")] = -reach * u
        knots = np.array([np.interp(s, rod.s, one) for one in np.diag(rod.radius)]) / radius
        d[:, equations.ALL_COLUMNS :] = -reach * np.outer(u, knots)
        return -reach * u, d

    def _arclength(self) -> ResidualBlock:
        J_nuisance = np.zeros((1, self.measured.nuisance_size))
        J_nuisance[0, -1] = 1.0
        residual = np.array([self.measured.s_contact - self.nuisance[-1]])
        cov = np.array([[self.measured.std_s**2]])
        return self._block("places", 0, residual, np.zeros((1, self.values.common.size)), J_nuisance, cov)

    def _friction(self) -> ResidualBlock:
        """Return the residual of a force without a tangential part: F · t = -|F| sin α, t the tangent at the touch."""
        d, size = self.sensitivity, float(np.linalg.norm(self.force)) or 1.0
        t, dt = d.frame[0:3], d.d_contact[0:3]
        slope = self.values.rod.taper_at(self.eq.s_contact)
        share = (self.force @ t) / size + slope / np.hypot(1.0, slope)
        by_force = (t - (self.force @ t) / size**2 * self.force) / size
        root = self._by_root(lambda eq: eq.R_at(eq.s_contact)[:, 2])
        by_root = np.array([self.force @ root / size])
        vector = WithJacobian(np.zeros(1), (self.force @ dt / size)[None], by_root)
        J_nuisance = self.nuisance_jacobian(vector)
        J_nuisance[0, 0:3] += by_force
        cov = np.array([[FRICTION**2]])
        return self._block("friction", 0, np.array([-share]), self.jacobian(vector), J_nuisance, cov)

    def _sag(self) -> ResidualBlock:
        """Return the residual of the tip's displacement along gravity from the straight probe on the same base."""
        length, size = self.values.rod.length, float(np.linalg.norm(self.gravity_base))
        s, down = np.array([length]), self.gravity_base / size
        by_root = self._by_root(lambda eq: eq.p_at(s))[0]
        tip = WithJacobian(self.eq.p_at(s)[0] - [0.0, 0.0, length], self.eq.d_p_at(s)[0], by_root)
        gravity = WithJacobian(self.gravity_base, np.zeros_like(tip.by_rod), np.zeros(3))
        gravity.by_rod[:, GRAVITY_COLUMNS] = np.eye(3)
        J = down @ self.jacobian(tip) + tip.value @ self.jacobian(gravity) / size
        J_nuisance = (down @ self.nuisance_jacobian(tip))[None]
        residual = np.array([self.measured.sag - tip.value @ down])
        return self._block("sags", 0, residual, J[None], J_nuisance, np.array([[self.measured.std_sag**2]]))

    def _by_root(self, value: Callable[[Equilibrium], Array]) -> Array:
        """Return the derivative of a value of the equilibrium by root_rigid_radii; zero where it is not needed."""
        if not self.root_solutions:
            return np.zeros_like(value(self.eq))
        less, more = map(value, self.root_solutions)
        return np.asarray((more - less) / (2.0 * ROOT_STEP))

    def _block(
        self, kind: str, item: int, residual: Array, J: Array, J_nuisance: Array, cov: Array
    ) -> ResidualBlock:
        """Return the whitened block; residuals are measured minus modelled, so the derivatives change their sign."""
        W = whiten(cov)
        return ResidualBlock(self.measured.name, kind, item, W @ residual, -W @ J, -W @ J_nuisance,
                             residual)  # fmt: skip


def _skews(a: Array) -> Array:
    """Return `skew` of each vector, (..., 3, 3)."""
    return np.asarray(np.swapaxes(np.cross(a[..., None, :], np.eye(3)), -1, -2))


def solve_test(
    measured: MeasuredTest,
    values: ParameterValues,
    nuisance: Array,
    tip: Array | None = None,
    root: bool = False,
) -> SolvedTest:
    """Solve one test at some parameter values and nuisance parameters, (measured.nuisance_size,).

    Args:
        measured: the test.
        values: of the parameters.
        nuisance: the test's own parameters.
        tip: state of a neighbouring equilibrium, as the initial guess.
        root: whether derivatives by the root are needed.
    """
    R = (measured.T_world_base @ values.T_stated_base)[:3, :3]
    gravity, d_gravity = values.gravity(measured.gravity_world)
    gravity_base = R.T @ gravity
    force = nuisance[:3] if measured.force_world is None else R.T @ measured.force_world
    s = nuisance[-1] if measured.s_estimated else (None if measured.free else measured.s_contact)

    def solved(rod: Rod) -> Equilibrium:
        """Return the equilibrium under the load of the test."""
        return rod.solve(gravity_base, force, s, guess=tip, columns="all")

    steps = (-ROOT_STEP, ROOT_STEP) if root else ()
    return SolvedTest(measured, values, nuisance, solved(values.rod),
                      tuple(solved(values.with_root_step(step)) for step in steps), gravity_base,
                      R.T @ d_gravity)  # fmt: skip


@dataclass(frozen=True)
class MassMeasurement:
    """A weighing of the probe.

    Attributes:
        mass: measured [kg].
        std: standard deviation of the mass [kg].
        flange_volume: of printed material that was weighed with the flexible part, as drawn [m³].
    """

    mass: float
    std: float
    flange_volume: float

    def block(self, values: ParameterValues) -> ResidualBlock:
        """Return its residual, which depends on the density and on all diameters."""
        rod = values.rod
        total = rod.mass + rod.density * self.flange_volume
        J = np.zeros((1, values.common.size))
        J[0, PARAMETERS["density"].columns] = total
        J[0, PARAMETERS["diameters"].columns] = 2.0 * rod.mass
        J[0, PRINT:] = rod.density * rod.body.volume_by_knot[0] @ values.common.print_modes.T
        residual = np.array([self.mass - total])
        return ResidualBlock("", "scales", 0, residual / self.std, -J / self.std, np.zeros((1, 0)), residual)
