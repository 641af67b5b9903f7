"""Residuals of one test, of the weighing and of Poisson's ratio: whitened, with derivatives, in blocks."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from probedesign.campaigns.manifest import WEIGHT_STD
from probedesign.core.frames import Array, inverse, skew, wrench_map
from probedesign.core.statistics import whiten
from probedesign.identification.parameters import (
    BASE_OFFSET,
    BASE_POSE,
    BASE_ROTATION,
    MOUNT_OFFSET,
    MOUNT_ROTATION,
    PARAMETERS,
    POISSON,
    POISSON_STD,
    ParameterValues,
)
from probedesign.identification.surface_touch import COUPLE_COLUMNS, SurfaceTouch, solve_touch
from probedesign.rod.equilibrium import Equilibrium, Sensitivity
from probedesign.rod.kernels import equations
from probedesign.rod.rod import Rod, bow_curvature

MIN_FRICTION = 1e-3  #: Smallest prior standard deviation of the friction ratio, as in `probedesign.estimation`.
SCALE, CREEP = PARAMETERS["length_scale"].columns.start, PARAMETERS["creep"].columns.start
GAIN, BIAS = PARAMETERS["gain"].columns, PARAMETERS["bias"].columns
GRAVITY = slice(7, 10)  #: Columns of the rod's sensitivities by gravity in base axes.
_TANGENT_STEP = 1e-5  # of arclength, for the rotation of a section by a difference of its tangent [m]


@dataclass(frozen=True)
class MeasuredTest:
    """One state of the probe and what was measured of it, in SI; what was not measured is None or NaN."""

    name: str  #: of the test.
    T_world_base: Array  #: pose of the base as stated, (4, 4).
    gravity_world: Array  #: [m/s²], (3,).
    force_world: Array | None  #: a known dead load [N], (3,); None for a touch whose force is not known.
    s_contact: float = np.nan  #: arclength of the load [m]: of the touched section, or of a dead load on the axis.
    std_s: float = 0.0  #: standard deviation of s_contact [m]; 0 if it is exact.
    #: touched point of the surface, or of the centreline under a dead load [m], (3,).
    p_touch_world: Array | None = None
    std_touch: float = np.nan  #: standard deviation of p_touch_world on each axis [m].
    wrench_base: Array | None = None  #: mean reading, about the base [N, N·m], (6,).
    cov_wrench: Array | None = None  #: covariance of wrench_base, (6, 6).
    marker_s: Array = field(default_factory=lambda: np.empty(0))  #: arclengths of the markers that were seen [m], (m,).
    p_markers_world: Array = field(default_factory=lambda: np.empty((0, 3)))  #: [m], (m, 3).
    cov_markers: Array = field(default_factory=lambda: np.empty((0, 3, 3)))  #: (m, 3, 3).
    marker_numbers: tuple[int, ...] = ()  #: from 1 on, (m,).
    marker_side: float | None = None  #: side of the section that carries them [rad]; None if they are on the axis.
    sag: float = np.nan  #: displacement of the tip along gravity from where it would be without weight [m].
    std_sag: float = np.nan  #: [m].
    epoch: int = 0  #: position among the tests in the order of time, for the walk of the sensor's bias.
    #: part of the creep that has passed since the middle of the campaign, -1/2 at the first test and 1/2 at the last.
    creep_ramp: float = 0.0
    #: std_place, std_turn: standard deviations of the pose of this test alone, on each axis [m, rad]; 0: it is exact.
    std_place: float = 0.0
    std_turn: float = 0.0
    digest: str = ""  #: `campaigns.Test.digest` of it.

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

    @cached_property
    def nuisance(self) -> dict[str, slice]:
        """Position of the nuisance parameters of this test by name: the force of a touch in base axes [N] and the
        angle of the touched point about the section [rad], the relative error of a known load, the arclength of either
        [m], the logarithm of the factor on its stiffness, and the error of its base pose [rad, m]."""
        sizes = {
            "force": 3 * self.touched,
            "angle": int(self.touched),
            "weight": int(not self.touched and not self.free),
            "s": int(self.s_estimated),
            "stiffness": int(not self.free),
            "pose": 6 * (self.std_place > 0.0),
        }
        ends = np.cumsum(list(sizes.values())).tolist()
        return {name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True) if size}

    @cached_property
    def nuisance_size(self) -> int:
        """Number of nuisance parameters of this test."""
        return max((columns.stop for columns in self.nuisance.values()), default=0)

    @property
    def gravity_base(self) -> Array:
        """Gravity in base axes by the stated pose [m/s²], (3,)."""
        return np.asarray(self.T_world_base[:3, :3].T @ self.gravity_world)


BlockKey = tuple[str, str, int]  #: Test, kind and item of a reading.


class ResidualBlock(NamedTuple):
    """Residuals that one reading makes."""

    test: str  #: its name.
    kind: str  #: markers, wrenches, touches, places, sags, friction, weights, stiffness, poses, poisson or scales.
    item: int  #: number of the marker in the test, from 1; 0 for the only one of its kind.
    r: Array  #: measured minus modelled, whitened, (k,).
    J: Array  #: derivatives of `r` by the parameter vector, then by the test's nuisance parameters, (k, n).
    residual: Array  #: measured minus modelled, in SI, (k,).

    @property
    def key(self) -> BlockKey:
        """Which reading it is of."""
        return self.test, self.kind, self.item

    @property
    def squared_distance(self) -> float:
        """Squared Mahalanobis distance with the stated noise."""
        return float(self.r @ self.r)


class RodVector(NamedTuple):
    """A vector of the solved rod in base axes with its derivatives; further axes first for several vectors."""

    value: Array  #: (3,), or (6,) for a wrench.
    #: by the parameters of the rod's sensitivities, those of `SolvedTest.stepped`, and the angle of the touched point,
    #: (., k + n + 1).
    J: Array

    def by(self, *names: str) -> Array:
        """Return the derivatives by parameters of the rod's sensitivities, (., n)."""
        return np.asarray(self.J[..., [equations.PARAMETERS.index(name) for name in names]])

    @property
    def by_stiffness(self) -> Array:
        """Derivative by the logarithm of E and G together, (., 1)."""
        return np.asarray(self.by("log_E", "log_G").sum(axis=-1, keepdims=True))


#: Derivative of a vector in base axes (...) by a parameter's components, (..., k).
Derivative = Callable[["SolvedTest", RodVector], Array]
#: By the entries of `PARAMETERS` that change the solved rod and have no `step`; the others change axes and readings.
DERIVATIVES: dict[str, Derivative] = {
    "E": lambda test, vector: vector.by("log_E"),
    "density": lambda test, vector: vector.by("log_density"),
    "G": lambda test, vector: vector.by("log_G"),
    "bow_x": lambda test, vector: vector.by("rest_x", "rest_y") @ bow_curvature(test.rod.length)[0][:, None],
    "bow_y": lambda test, vector: vector.by("rest_x", "rest_y") @ bow_curvature(test.rod.length)[1][:, None],
    "tilt": lambda test, vector: test.by_rotation(vector, test.values.T_stated_base)[..., 0:2],
    "clocking": lambda test, vector: test.by_rotation(vector, test.values.T_stated_base)[..., 2:3],
    "gravity": lambda test, vector: vector.J[..., GRAVITY] @ test.d_gravity,
    "diameters": lambda test, vector: vector.by("log_diameter"),
    "mount_rotation": lambda test, vector: test.by_rotation(vector, test.values.T_mount_error),
    "creep": lambda test, vector: -test.measured.creep_ramp * vector.by_stiffness,
}
#: By the nuisance parameters; the error of the pose acts on blocks as the common one does.
NUISANCE_DERIVATIVES: dict[str, Derivative] = {
    "force": lambda test, vector: vector.J[..., 0:3],
    "angle": lambda test, vector: vector.J[..., -1:],
    "weight": lambda test, vector: (vector.J[..., 0:3] @ test.known_force)[..., None],
    "s": lambda test, vector: vector.by("s_contact"),
    "stiffness": lambda test, vector: vector.by_stiffness,
}


@dataclass(frozen=True)
class SolvedTest:
    """A test solved at some parameter values."""

    measured: MeasuredTest  #: the test.
    values: ParameterValues  #: of the parameters.
    nuisance: Array  #: the test's own parameters, (measured.nuisance_size,).
    rod: Rod  #: with these values, and the test's own stiffness.
    eq: Equilibrium  #: the equilibrium, with all sensitivities.
    touch: SurfaceTouch | None  #: of a touched probe; None for others.
    #: with a parameter a step less and a step more, at the same couple, by its name, where its derivative is needed.
    stepped: dict[str, tuple[Equilibrium, Equilibrium]]
    gravity_base: Array  #: at these values [m/s²], (3,).
    d_gravity: Array  #: derivative of gravity in base axes by its two rotations, (3, 2).
    ok: bool  #: whether the rod has a stable equilibrium.

    @property
    def sensitivity(self) -> Sensitivity:
        """Sensitivities of the equilibrium."""
        assert self.eq.sensitivity is not None
        return self.eq.sensitivity

    @property
    def known_force(self) -> Array:
        """Known load in base axes at these values [N], (3,)."""
        assert self.measured.force_world is not None
        R = (self.measured.T_world_base @ self.values.T_stated_base)[:3, :3]
        return np.asarray(R.T @ self.measured.force_world)

    def blocks(self) -> Iterator[ResidualBlock]:
        """Yield all residuals of the test."""
        measured, friction = self.measured, self.values.common.model.friction
        if measured.wrench_base is not None:
            yield from self._wrench()
        if len(measured.marker_s):
            yield from self._markers()
        if measured.p_touch_world is not None and not measured.free:
            yield from self._touch()
        if measured.s_estimated and np.isfinite(measured.s_contact):
            yield self._own("places", "s", measured.std_s, measured.s_contact)
        if self.touch is not None and np.isfinite(friction):
            vector = self.vector(*self.touch.friction)  # of a force without tangential parts
            cov = max(friction, MIN_FRICTION) ** 2 * np.eye(2)
            yield from self._whitened("friction", -vector.value, self.jacobian(vector), cov)
        if "weight" in measured.nuisance:
            yield self._own("weights", "weight", WEIGHT_STD)
        if "stiffness" in measured.nuisance:
            yield self._own("stiffness", "stiffness", self.values.common.stiffness_std)
        if "pose" in measured.nuisance:
            yield self._own("poses", "pose", np.repeat([measured.std_turn, measured.std_place], 3))
        if np.isfinite(measured.sag):
            yield from self._sag()

    # derivatives

    def by_rotation(self, vector: RodVector, T_rotated: Array) -> Array:
        """Return the derivative by a rotation about the axes that a pose maps to, through gravity and dead loads,
        (..., 3)."""
        d = vector.J[..., GRAVITY] @ skew(self.gravity_base)
        if not self.measured.touched:
            d = d + vector.J[..., 0:3] @ skew(self.eq.load[0:3])
        return np.asarray(d @ T_rotated[:3, :3].T)

    def jacobian(self, vector: RodVector) -> Array:
        """Return derivatives of a vector in base axes, at fixed base axes, by all unknowns, (..., n): the parameter
        vector, then the test's nuisance parameters."""
        common = self.values.common
        J = np.zeros((*vector.value.shape, common.size + self.measured.nuisance_size))
        for name, derivative in DERIVATIVES.items():
            J[..., PARAMETERS[name].columns] = derivative(self, vector)
        steps = equations.ALL_COLUMNS + common.print_modes.shape[1]
        for i, name in enumerate(self.stepped, steps):
            J[..., PARAMETERS[name].columns] = vector.J[..., i : i + 1]
        J[..., common.print_columns] = vector.J[..., equations.ALL_COLUMNS : steps] @ common.print_modes.T
        for name in NUISANCE_DERIVATIVES.keys() & self.measured.nuisance.keys():
            J[..., self._columns(name)] = NUISANCE_DERIVATIVES[name](self, vector)
        return J

    def _columns(self, name: str) -> slice:
        at, size = self.measured.nuisance[name], self.values.common.size
        return slice(size + at.start, size + at.stop)

    def vector(self, value: Array, J: Array) -> RodVector:
        """Return a vector in base axes with its total derivatives, through the couple of a touch, by its value and its
        derivatives at a given couple."""
        if self.touch is None:
            return RodVector(value, J)
        total = J + J[..., COUPLE_COLUMNS] @ self.touch.couple_response
        total[..., COUPLE_COLUMNS] = 0.0
        return RodVector(value, total)

    def _of_equilibrium(self, value: Callable[[Equilibrium], Array], by_rod: Array) -> tuple[Array, Array]:
        """Return a value of the equilibrium and its derivatives at a given couple, of which `by_rod` are the rod's."""
        at, steps = value(self.eq), differences(self.stepped, value, by_rod.shape[:-1])
        return at, np.concatenate([by_rod, steps, np.zeros((*at.shape, 1))], axis=-1)

    def in_world(self, vector: RodVector) -> tuple[Array, Array]:
        """Return points of the rod in the world as the reference measures them, with derivatives by all unknowns."""
        values, R_stated = self.values, self.measured.T_world_base[:3, :3]
        T = self.measured.T_world_base @ values.T_stated_base
        R, R_sensor, mount = T[:3, :3], R_stated @ values.T_base_error[:3, :3], values.T_mount_error
        turned = vector.value @ mount[:3, :3].T
        J = R @ self.jacobian(vector)
        J[..., BASE_ROTATION] -= R_stated @ skew((turned + mount[:3, 3]) @ values.T_base_error[:3, :3].T)
        J[..., MOUNT_ROTATION] -= R_sensor @ skew(turned)
        J[..., BASE_OFFSET], J[..., MOUNT_OFFSET] = R_stated, R_sensor
        scale, origin = 1.0 + values.x[SCALE], self.measured.T_world_base[:3, 3]
        from_origin = vector.value @ R.T + (T[:3, 3] - origin)
        J *= scale
        J[..., SCALE] = from_origin
        return origin + scale * from_origin, J

    # residuals

    def _whitened(
        self, kind: str, residual: Array, J: Array, cov: Array, items: Sequence[int] = (0,)
    ) -> Iterator[ResidualBlock]:
        """Yield the whitened blocks of one reading (k,), or of several (m, k). Residuals are measured minus modelled,
        so the derivatives of the modelled change their sign."""
        if "pose" in self.measured.nuisance:
            J[..., self._columns("pose")] = J[..., BASE_POSE]
        W = whiten(cov)
        r, J = (W @ residual[..., None])[..., 0], -W @ J
        for i, item in enumerate(items):
            parts = (r[i], J[i], residual[i]) if residual.ndim > 1 else (r, J, residual)
            yield ResidualBlock(self.measured.name, kind, item, *parts)

    def _own(self, kind: str, name: str, std: ArrayLike, stated: float = 0.0) -> ResidualBlock:
        residual = stated - self.nuisance[self.measured.nuisance[name]]
        inverse = 1.0 / np.broadcast_to(std, residual.shape)
        J = np.zeros((len(residual), self.values.common.size + self.measured.nuisance_size))
        J[:, self._columns(name)] = -np.diag(inverse)
        return ResidualBlock(self.measured.name, kind, 0, inverse * residual, J, residual)

    def _wrench(self) -> Iterator[ResidualBlock]:
        measured, common, X = self.measured, self.values.common, wrench_map(self.values.T_mount_error)
        vector = self.vector(*self._of_equilibrium(lambda eq: eq.wrench_base, self.sensitivity.d_wrench))
        modelled, J = X @ vector.value, X @ self.jacobian(vector)
        f, arm = skew(modelled[:3]), skew(self.values.T_mount_error[:3, 3])
        J[:3, MOUNT_ROTATION] -= f
        J[3:, MOUNT_ROTATION] -= skew(modelled[3:] - arm @ modelled[:3]) + arm @ f
        J[3:, MOUNT_OFFSET] -= f
        # gain and bias of the sensor, whose reading includes the weight between base and sensor
        to_sensor = wrench_map(common.model.T_sensor_base)
        to_base = wrench_map(inverse(common.model.T_sensor_base))
        reading = common.model.to_sensor(modelled, measured.gravity_base)
        gain = to_base * self.values.x[GAIN]  # to_base @ diag(gain)
        J = (np.eye(6) + gain @ to_sensor) @ J
        J[:, GAIN] += to_base * reading
        J[:, BIAS] += np.eye(6)
        J[:, common.walk_columns(measured.epoch)] += common.walk_modes(measured.epoch)
        modelled = modelled + gain @ reading + self.values.bias(measured.epoch)
        assert measured.wrench_base is not None and measured.cov_wrench is not None
        return self._whitened("wrenches", measured.wrench_base - modelled, J, measured.cov_wrench)

    def _markers(self) -> Iterator[ResidualBlock]:
        measured = self.measured
        d, offset = self.eq.d_p_at(measured.marker_s), np.zeros(3)
        if measured.marker_side is not None:
            offset, d_offset = self._surface_offset(measured.marker_s, measured.marker_side)
            d = d + d_offset
        p, J = self._of_equilibrium(lambda eq: eq.p_at(measured.marker_s), d)
        modelled, J = self.in_world(self.vector(p + offset, J))
        residual = measured.p_markers_world - modelled
        return self._whitened("markers", residual, J, measured.cov_markers, measured.marker_numbers)

    def _surface_offset(self, s: Array, side: float) -> tuple[Array, Array]:
        """Return vectors from the axis to the surface on one side, (m, 3), and their derivatives, (m, 3, k).

        The section rotates with its tangent; a change of its twist, which round rods do not have, is neglected.
        """
        rod, R, section = self.rod, self.eq.R_at(s), self.values.common.model.cross_section
        radius = section.reach(side) * rod.radius_at(s)[:, None]
        offset = radius * (np.cos(side) * R[:, :, 0] + np.sin(side) * R[:, :, 1])
        low, high = np.maximum(s - _TANGENT_STEP, 0.0), np.minimum(s + _TANGENT_STEP, rod.length)
        across = (low <= self.eq.s_contact) & (self.eq.s_contact < high)  # the shear jumps at the load
        low = np.where(across, self.eq.s_contact - 2.0 * _TANGENT_STEP, low)
        high = np.where(across, self.eq.s_contact - _TANGENT_STEP, high)
        d_tangent = (self.eq.d_p_at(high) - self.eq.d_p_at(low)) / (high - low)[:, None, None]
        rotation = np.cross(R[:, :, 2][:, :, None], d_tangent, axis=1)
        return offset, np.cross(rotation, offset[:, :, None], axis=1)

    def _touch(self) -> Iterator[ResidualBlock]:
        measured = self.measured
        p, J = self._of_equilibrium(lambda eq: eq.p_contact_base, self.sensitivity.d_position)
        if self.touch is not None:
            offset, d_offset = self.touch.offset
            p, J = p + offset, J + d_offset
        modelled, J = self.in_world(self.vector(p, J))
        assert measured.p_touch_world is not None
        return self._whitened("touches", measured.p_touch_world - modelled, J, measured.std_touch**2 * np.eye(3))

    def _sag(self) -> Iterator[ResidualBlock]:
        """Yield the residual of the tip's displacement along gravity from the designed probe without weight."""
        length, size = self.rod.length, float(np.linalg.norm(self.gravity_base))
        s, down = np.array([length]), self.gravity_base / size
        p, d = self._of_equilibrium(lambda eq: eq.p_at(s)[0], self.eq.d_p_at(s)[0])
        tip = self.vector(p - self.values.common.model.rod.sag_origin, d)
        gravity = RodVector(self.gravity_base, np.zeros_like(tip.J))
        gravity.J[:, GRAVITY] = np.eye(3)
        scale, sag = 1.0 + self.values.x[SCALE], float(tip.value @ down)
        J = scale * (down @ self.jacobian(tip) + tip.value @ self.jacobian(gravity) / size)
        J[SCALE] = sag
        residual = np.array([self.measured.sag - scale * sag])
        return self._whitened("sags", residual, J[None], np.array([[self.measured.std_sag**2]]))


def differences(
    stepped: dict[str, tuple[Equilibrium, Equilibrium]], value: Callable[[Equilibrium], Array], shape: tuple[int, ...]
) -> Array:
    """Return the central differences of a value of an equilibrium by the stepped parameters, (*shape, n)."""
    by = [(value(more) - value(less)) / (2.0 * PARAMETERS[name].step) for name, (less, more) in stepped.items()]
    return np.stack(by, axis=-1) if by else np.zeros((*shape, 0))


def solve_test(
    measured: MeasuredTest,
    values: ParameterValues,
    nuisance: Array,
    last: SolvedTest | None = None,
    stepped: Sequence[str] = (),
) -> SolvedTest:
    """Solve one test at some parameter values and nuisance parameters, (measured.nuisance_size,).

    Args:
        measured: the test.
        values: of the parameters.
        nuisance: the test's own parameters.
        last: the test at neighbouring values, as the initial guess.
        stepped: parameters with a step whose derivatives are needed.
    """
    at = measured.nuisance
    if "pose" in at:
        values = values.with_pose_error(nuisance[at["pose"]])
    R = (measured.T_world_base @ values.T_stated_base)[:3, :3]
    gravity, d_gravity = values.gravity(measured.gravity_world)
    gravity_base = R.T @ gravity
    tip = None if last is None else last.eq.tip
    if measured.force_world is None:
        force = nuisance[at["force"]]
    else:
        force = R.T @ measured.force_world * (1.0 + (nuisance[at["weight"]][0] if "weight" in at else 0.0))
    s = nuisance[at["s"]][0] if "s" in at else (None if measured.free else measured.s_contact)
    scatter = nuisance[at["stiffness"]][0] if "stiffness" in at else 0.0
    factor = math.exp(scatter - values.x[CREEP] * measured.creep_ramp)
    rod, touch = values.rod, None
    if factor != 1.0:
        rod = replace(rod, youngs_modulus=factor * rod.youngs_modulus, shear_modulus=factor * rod.shear_modulus)
    if measured.touched:
        assert s is not None
        angle, couple = nuisance[at["angle"]][0], np.zeros(3) if last is None else last.eq.load[9:12]
        eq, ok = solve_touch(rod, gravity_base, force, s, angle, tip, couple)
    else:
        eq = rod.solve(gravity_base, force, s, guess=tip, columns="all")
        ok = eq.ok
    others: dict[str, tuple[Equilibrium, Equilibrium]] = {}
    for name in stepped if ok else ():
        apply, step = PARAMETERS[name].apply, PARAMETERS[name].step
        assert apply is not None
        less, more = (
            apply(values.common.model, rod, x).solve(gravity_base, force, s, couple=eq.load[9:12], guess=eq.tip)
            for x in (-step, step)
        )
        others[name] = (less, more)
        ok = ok and less.ok and more.ok
    if ok and measured.touched:
        touch = SurfaceTouch(
            rod, eq, force, angle, differences(others, lambda solved: solved.R_at(eq.s_contact), (3, 3))
        )
    return SolvedTest(measured, values, nuisance, rod, eq, touch, others, gravity_base, R.T @ d_gravity, ok)


@dataclass(frozen=True)
class MassMeasurement:
    """A weighing of the probe."""

    mass: float  #: measured [kg].
    std: float  #: standard deviation of the mass [kg].
    flange_volume: float  #: of printed material that was weighed with the flexible part, as drawn [m³].

    def block(self, values: ParameterValues) -> ResidualBlock:
        """Return its residual, which depends on the density and on all diameters."""
        rod = values.rod
        total = rod.mass + rod.density * self.flange_volume
        J = np.zeros((1, values.common.size))
        J[0, PARAMETERS["density"].columns] = total
        J[0, PARAMETERS["diameters"].columns] = 2.0 * rod.mass
        J[0, values.common.print_columns] = rod.density * rod.body.volume_by_knot[0] @ values.common.print_modes.T
        residual = np.array([self.mass - total])
        return ResidualBlock("", "scales", 0, residual / self.std, -J / self.std, residual)


def poisson_block(values: ParameterValues) -> ResidualBlock:
    """Return the residual of Poisson's ratio from its prior, which ties G to E: E = 2 (1 + ν) G."""
    rod = values.rod
    std = POISSON_STD / (1.0 + POISSON)  # of the logarithm of E/G
    J = np.zeros((1, values.common.size))
    J[0, PARAMETERS["E"].columns], J[0, PARAMETERS["G"].columns] = 1.0, -1.0
    residual = np.array([np.log(2.0 * (1.0 + POISSON)) - np.log(rod.youngs_modulus / rod.shear_modulus)])
    return ResidualBlock("", "poisson", 0, residual / std, -J / std, residual)
