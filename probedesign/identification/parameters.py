"""Parameters that a campaign can identify, the nuisance parameters of its tests, and the rod and poses they imply.

All of them form one parameter vector: the blocks of `PARAMETERS` in order, the modes of the print's dimension errors,
and the steps of the sensor's bias from test to test. An entry of `PARAMETERS`, and its derivative in
`residuals.DERIVATIVES` unless it has a `step`, add a parameter; the solver, the checks, the report and the design
update iterate over them.
Priors are those of `Tolerances`, so that a fit, an estimate and a prediction take the same errors into account.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from probedesign.campaigns.manifest import LENGTH_SCALE
from probedesign.core.csv_tables import Frame
from probedesign.core.errors import InputError, unknown_name
from probedesign.core.frames import Array, inverse, pose, wrench_map
from probedesign.core.units import MM, MPA
from probedesign.estimation.bias import RAMP_STEPS
from probedesign.estimation.error_sources import BEFORE_KNOTS, bow_of, curvature_std, parameters_of, scaled_curvature
from probedesign.estimation.model import WALK_SECONDS, ProbeModel, Tolerances
from probedesign.rod.rod import Rod, bow_curvature

DEGREE = math.pi / 180.0
DEFAULT = ("E", "G")  #: Parameters identified unless others are requested: those of the paper.
ROOT_STEP = 0.02  #: Of root_rigid_radii for its central difference, whose relative truncation error is 1e-4.
ROOT_RANGE = (-0.98, 2.0)  #: Smallest and largest root_rigid_radii that the rod takes, with a margin of `ROOT_STEP`.
MAX_LOGARITHM = 3.0  #: Of a factor on the design value: no probe is twenty times stiffer than designed.
#: Fraction of the free probe's wrench that a tare with the probe hanging free absorbs as an error of its own weight.
#: Covers 1 % of density, 2 % of area and the change of the sag by a third of E (assumed).
TARE_FRACTION = 0.05

MAX_EXPONENT = 700.0  #: Of a factor in a report: the end of an interval that is not bounded stays a finite number.
#: Poisson's ratio of an elastomer and its standard deviation. Source: R. H. Pritchard, P. Lava, D. Debruyne, E. M.
#: Terentjev, Soft Matter 9, 2013, 6037: 0.49 to 0.5 for unfilled elastomers at small strain. The standard deviation is
#: assumed and covers the solid photopolymers, whose bulk modulus is not published.
POISSON, POISSON_STD = 0.49, 0.01
#: root_rigid_radii of a bonded base and of the exported soft flange. Source: docs/decisions/0006.
KNOWN_ROOTS = (0.12, -0.18)
#: Largest distance of a known root from the design's, in standard deviations of the prior, where the design does not
#: state a tolerance. A normal prior that is off by k of its standard deviations and contributes the fraction w of the
#: information leaves P(|√w k + √(1-w) z| < 1.96) in the 95 % interval: at least 94 % for any w up to k = 1.2, and 75 %
#: at k = 2 and w = 1/2.
MAX_ROOT_DEVIATION = 1.2
#: Standard deviation of the stiffness from test to test on an ordinary bench, relative (assumed), and the smallest one
#: that is used. Residuals of 16 touches do not reveal that a scatter is twice as large as stated, so a prior that is
#: too small makes the intervals of E too small.
ORDINARY_SCATTER, MIN_SCATTER = 0.02, 1e-4
#: Parameters that are estimated and reported with E although they are not requested: a probe's stiffness is that of all
#: three together.
IMPLIED = ("G", "root")


@dataclass(frozen=True)
class Parameter:
    """One entry of the parameter vector: its unit, prior and effect on the rod."""

    name: str  #: as `--for` requests it.
    labels: dict[str, str]  #: component name → description, in the order of the vector.
    #: standard deviation of the components about zero [vector unit]; 0 fixes them at the design value.
    prior: Callable[["CommonParameters"], ArrayLike]
    #: the rod with the parameter changed by a value, for the given model of the design; the same rod where it has no
    #: effect. None if the parameter does not change the rod.
    apply: Callable[[ProbeModel, Rod, float], Rod] | None = None
    #: of a central difference [vector unit], where the rod has no derivative by the parameter; 0 where it has.
    step: float = 0.0
    logarithm: bool = False  #: whether the vector has the logarithm of a factor on the design value.
    #: smallest and largest value in the reported unit; those of a logarithm are `MAX_LOGARITHM`.
    bounds: tuple[float, float] = (-math.inf, math.inf)
    #: largest useful standard deviation [vector unit]; a parameter that is known worse is not reported. None for a
    #: nuisance parameter, which cannot be requested.
    max_std: float | None = None
    unit: str = ""  #: of reported values; empty for plain factors.
    scale: float = 1.0  #: reported unit per unit of the vector.
    design_value: Callable[[ProbeModel], float] = lambda model: 0.0  #: design value in the reported unit.
    attribute: str = ""  #: name of the property in `Rod`, `Design` and `Tolerances`; empty if the design has none.
    design_key: str = ""  #: key of the design file that holds the value; empty if the design has none.
    prior_name: str = ""  #: what the prior knowledge concerns; parameters of one name are tested together.
    prior_source: str = ""  #: where the prior value is stated.

    @cached_property
    def columns(self) -> slice:
        """Position of its components in the parameter vector."""
        names = list(PARAMETERS)
        start = sum(len(PARAMETERS[name].labels) for name in names[: names.index(self.name)])
        return slice(start, start + len(self.labels))

    def reported(self, model: ProbeModel, x: float) -> float:
        """Return a component of the vector in the reported unit, for the given model of the design."""
        design = self.design_value(model)
        return design * math.exp(min(x, MAX_EXPONENT)) if self.logarithm else design + self.scale * x

    def format_std(self, std: float) -> str:
        """Return a standard deviation [vector unit] as text, `unbounded` beyond any meaningful value."""
        if self.logarithm:
            return f"{std:.0%}" if std < 10.0 else "unbounded"
        if self.unit == "deg" and std >= math.pi:
            return "unbounded"
        return f"{self.scale * std:.2g} {self.unit}".rstrip()


def _material(
    name: str, label: str, attribute: str, unit: str, si: float, max_std: float, *,
    design_key: str, prior_name: str = "", prior_source: str = "",
) -> Parameter:  # fmt: skip
    """Return the parameter of a material property, the logarithm of a factor on the design's."""

    def apply(_model: ProbeModel, rod: Rod, x: float) -> Rod:
        changes: dict[str, Any] = {attribute: getattr(rod, attribute) * math.exp(x)}
        return replace(rod, **changes)

    def prior(common: "CommonParameters") -> float:
        return 0.0 if name == "E" else float(getattr(common.tolerances, attribute))

    return Parameter(
        name, {name: label}, prior, apply, logarithm=True, max_std=max_std, unit=unit,
        design_value=lambda model: getattr(model.rod, attribute) / si, attribute=attribute, design_key=design_key,
        prior_name=prior_name, prior_source=prior_source,
    )  # fmt: skip


def scaled_diameters(rod: Rod, factor: float | Array) -> Rod:
    """Return the rod with its diameters times a factor, one for all or one per knot; the root scales with the base."""
    radius = rod.radius * factor
    return replace(rod, radius=radius, rigid_length=rod.rigid_length * float(radius[0] / rod.radius[0]))


CHANNELS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")


def _xyz(name: str, label: str) -> dict[str, str]:
    return {f"{name}_{axis}": label.format(axis) for axis in "xyz"}


def _bow(axis: int) -> Parameter:
    """Return the parameter of a constant curvature, as the deviation of the unloaded tip [m]."""

    def apply(_model: ProbeModel, rod: Rod, x: float) -> Rod:
        if x == 0.0:  # a straight rod is solved faster
            return rod
        rest = np.zeros((len(rod.s), 3)) if rod.rest_curvature is None else rod.rest_curvature
        return replace(rod, rest_curvature=rest + np.append(x * bow_curvature(rod.length)[axis], 0.0))

    def design(model: ProbeModel) -> float:
        return float(bow_of(model, model.rod)[axis]) / MM

    letter = "xy"[axis]
    return Parameter(
        f"bow_{letter}", {f"bow_{letter}": f"deviation of the unloaded tip towards {letter}"},
        lambda common: common.tolerances.bow_mm * MM, apply, max_std=1.0 * MM, unit="mm", scale=1.0 / MM,
        design_value=design, design_key="probe.bow_mm", prior_name="bent print",
        prior_source="the probe by eye: write its bow into the design with measured --bow-mm, or raise bow_mm in "
        "[tolerances]",
    )  # fmt: skip


_BASE_ROTATION = ("rotation of the base",
                  "rotation_world_deg and std_deg in campaign.toml, or the base pose of each test")  # fmt: skip
_MOUNTING = ("mounting of the probe on the sensor",
             "the frame of wrenches.csv, and the tolerances base_mm, tilt_deg and clocking_deg")  # fmt: skip

#: By name. Of two parameters that cannot be separated, the later one stays at the design value. Base and mount rotate
#: about their own axes [rad] and shift along them [m]; gravity rotates about two axes perpendicular to it [rad]; the
#: bias is about the base [N, N·m]. Limits `max_std`: published values of E of one resin, 1.6 to 3.2 MPa, spread by 30
#: %; G has a tenth, since a full round probe shows it by a shear of a tenth of a millimetre alone, which any other
#: small error of the model makes as well; the others are assumed.
PARAMETERS: dict[str, Parameter] = {
    parameter.name: parameter
    for parameter in (
        _material("E", "Young's modulus", "youngs_modulus", "MPa", MPA, 0.3, design_key="material.youngs_modulus_mpa"),
        _material("density", "density", "density", "kg/m³", 1.0, 0.1, design_key="material.density_kg_m3",
                  prior_name="design density",
                  prior_source="density_kg_m3 in the design, its tolerance, and the weighing"),
        _material("G", "shear modulus", "shear_modulus", "MPa", MPA, 0.1, design_key="material.shear_modulus_mpa",
                  prior_name="design shear modulus",
                  prior_source="shear_modulus_mpa in the design, and its tolerance"),
        Parameter("root", {"root": "compliance that the base lacks, in base radii"},
                  lambda common: common.root_std,
                  lambda _, rod, x: replace(rod, rigid_length=rod.rigid_length + x * float(rod.radius[0])),
                  step=ROOT_STEP, bounds=ROOT_RANGE, max_std=0.3,
                  design_value=lambda model: float(model.rod.rigid_length / model.rod.radius[0]),
                  attribute="root_radii",
                  design_key="mount.root_rigid_radii", prior_name="root of the probe",
                  prior_source="root_rigid_radii in the design (-0.18 is computed for the exported flange), and the "
                  "tolerance root_radii"),
        _bow(0),
        _bow(1),
        Parameter("curvature", {"curvature": "curvature of a helix or of knots over the design's"},
                  lambda common: curvature_std(common.model, common.tolerances), scaled_curvature, step=0.005,
                  bounds=(0.5, 1.5), max_std=0.02, design_value=lambda model: 1.0, design_key="probe.axis",
                  prior_name="bent print", prior_source="the axis of the print: measured --axis, or bow_mm in "
                  "[tolerances]"),
        Parameter("tilt", {"tilt_x": "rotation about x", "tilt_y": "rotation about y"},
                  lambda common: common.std_tilt, max_std=2.0 * DEGREE, unit="deg", scale=1.0 / DEGREE,
                  prior_name=_BASE_ROTATION[0], prior_source=_BASE_ROTATION[1]),
        Parameter("clocking", {"clocking": "rotation about z"},
                  lambda common: common.std_tilt, max_std=5.0 * DEGREE, unit="deg", scale=1.0 / DEGREE,
                  prior_name=_BASE_ROTATION[0], prior_source=_BASE_ROTATION[1]),
        Parameter("offset", _xyz("offset", "position of the base along its {} axis"), lambda common: common.std_base,
                  max_std=2.0 * MM, unit="mm", scale=1.0 / MM, prior_name="position of the base",
                  prior_source="p_world_mm and std_mm in campaign.toml, or the base pose of each test"),
        Parameter("gravity", {"gravity_1": "rotation of gravity about the first axis perpendicular to it",
                              "gravity_2": "rotation of gravity about the second axis perpendicular to it"},
                  lambda common: common.tolerances.gravity_deg * DEGREE, max_std=2.0 * DEGREE,
                  unit="deg", scale=1.0 / DEGREE, prior_name="direction of gravity",
                  prior_source="world_m_s2 in campaign.toml, and the tolerance gravity_deg"),
        Parameter("diameters", {"diameters": "all diameters over the design's"}, lambda common: 0.0,
                  lambda _, rod, x: scaled_diameters(rod, math.exp(x)), logarithm=True,
                  max_std=0.1, design_value=lambda model: 1.0),
        Parameter("mount_rotation", _xyz("mount_rotation", "rotation of the probe on the sensor about {}"),
                  lambda common: [common.tolerances.tilt_deg * DEGREE] * 2 + [common.tolerances.clocking_deg * DEGREE],
                  prior_name=_MOUNTING[0], prior_source=_MOUNTING[1]),
        Parameter("mount_offset", _xyz("mount_offset", "position of the probe on the sensor along {}"),
                  lambda common: common.tolerances.base_mm * MM,
                  prior_name=_MOUNTING[0], prior_source=_MOUNTING[1]),
        Parameter("bias", {f"bias_{channel}": f"bias of {channel}" for channel in CHANNELS},
                  lambda common: common.bias_std,
                  prior_name="bias of the sensor",
                  prior_source="when the sensor was zeroed: before the probe is mounted, or with it hanging free"),
        Parameter("gain", {f"gain_{channel}": f"gain of {channel}" for channel in CHANNELS},
                  lambda common: common.tolerances.gain, prior_name="gain of the sensor",
                  prior_source="the sensor's calibration, the units of wrenches.csv, and the tolerance gain"),
        Parameter("length_scale", {"length_scale": "length scale of the reference"}, lambda common: LENGTH_SCALE,
                  prior_name="length scale of the reference",
                  prior_source="the control points of the cameras, or the stage"),
        Parameter("creep", {"creep": "loss of stiffness from the first test to the last"},
                  lambda common: common.tolerances.creep, prior_name="creep",
                  prior_source="the temperature and the rests between tests, and the tolerance "
                  "creep"),
    )
}  # fmt: skip

REQUESTABLE = tuple(name for name, parameter in PARAMETERS.items() if parameter.max_std is not None)
COMPONENTS = tuple(label for parameter in PARAMETERS.values() for label in parameter.labels)
#: Parameter that each entry of the vector belongs to.
OWNER = tuple(parameter for parameter in PARAMETERS.values() for _ in parameter.labels)
#: First entry of the print's dimension modes and, after them, of the steps of the bias; all have unit normal priors.
PRINT = len(COMPONENTS)


def _span(first: str, last: str) -> slice:
    return slice(PARAMETERS[first].columns.start, PARAMETERS[last].columns.stop)


BASE_ROTATION, BASE_OFFSET = _span("tilt", "clocking"), PARAMETERS["offset"].columns
BASE_POSE = _span("tilt", "offset")
MOUNT_ROTATION, MOUNT_OFFSET = PARAMETERS["mount_rotation"].columns, PARAMETERS["mount_offset"].columns
LOG_E, LOG_G = PARAMETERS["E"].columns.start, PARAMETERS["G"].columns.start
DIAMETERS = PARAMETERS["diameters"].columns.start


def check_requested(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of `--for` in the order of `PARAMETERS`; refuse none, and unknown ones."""
    for name in names:
        if name not in REQUESTABLE:
            raise unknown_name("--for", name, REQUESTABLE)
    if not names:
        raise InputError(f"--for: no parameter is named; known: {', '.join(REQUESTABLE)}")
    return tuple(name for name in REQUESTABLE if name in names)


def columns_of(names: Sequence[str]) -> list[int]:
    """Return the positions of some parameters' components in the parameter vector."""
    return [i for name in names for i in range(PARAMETERS[name].columns.start, PARAMETERS[name].columns.stop)]


@dataclass(frozen=True)
class CommonParameters:
    """The parameters that all tests of a campaign share, with their priors."""

    model: ProbeModel  #: of the probe as designed.
    tolerances: Tolerances  #: of probe, mount and gravity.
    std_base: float  #: std_base, std_tilt: standard deviations of the stated base pose [m, rad].
    std_tilt: float
    walk_seconds: tuple[float, ...] = ()  #: time from each test to the next, in the order of their `epoch` [s].
    frame: Frame = "base"  #: of the columns of wrenches.csv.
    drift: tuple[float, ...] = (1.0,) * 6  #: drift of each channel of the sensor over that by `walk_modes`.

    @cached_property
    def print_modes(self) -> Array:
        """Change of the logarithms of the knots' diameters by unit normal numbers, (q, K): all diameters together,
        each by itself, and the length, which changes the diameter at a given place of a cone."""
        rod = self.model.rod
        sources = parameters_of(rod, self.tolerances)
        taper = -np.gradient(rod.radius, rod.s) * rod.s / rod.radius
        rows = np.concatenate([sources["diameter"][:, BEFORE_KNOTS:], sources["diameter scatter"][:, BEFORE_KNOTS:],
                               (taper * sources["length"][0, 3])[None]])  # fmt: skip
        return np.asarray(rows[np.abs(rows).max(axis=1) > 0.0], dtype=float)

    @property
    def size(self) -> int:
        """Length of the parameter vector."""
        return PRINT + len(self.print_modes) + 6 * (1 + len(self.walk_seconds))

    @cached_property
    def print_columns(self) -> slice:
        """Position of the print's dimension modes in the parameter vector."""
        return slice(PRINT, PRINT + len(self.print_modes))

    def walk_columns(self, epoch: int) -> slice:
        """Return the position of the rate of the bias and of its steps before a test in the parameter vector."""
        return slice(self.print_columns.stop, self.print_columns.stop + 6 * (1 + epoch))

    @cached_property
    def steps(self) -> Array:
        """Changes of the reading at the base by a step of the resolution in each channel [N, N·m], (6, 6)."""
        to_base = wrench_map(inverse(self.model.T_sensor_base))
        return np.asarray(to_base @ np.linalg.cholesky(self.model.averaging_samples * self.model.noise.cov))

    def walk_modes(self, epoch: int) -> Array:
        """Return the change of the bias up to a test by unit normal numbers [N, N·m], (6, 6 + 6 epoch).

        As in `live`, the bias has a rate of `RAMP_STEPS`, the first six, and walks: the variance of its change is
        (walk_steps of the resolution)² in `WALK_SECONDS` and grows with time. Both are times `drift` of the channel.
        """
        seconds = np.array(self.walk_seconds[:epoch])
        walk = self.tolerances.walk_steps
        sizes = [RAMP_STEPS * seconds.sum() * (walk > 0.0), *(walk * np.sqrt(seconds / WALK_SECONDS))]
        return np.kron(sizes, self.steps * self.drift)

    @property
    def root_std(self) -> float:
        """Standard deviation of the root, in base radii: the tolerance, or as wide as `MAX_ROOT_DEVIATION` asks where
        that is the assumed default, because the kind of base is then not known."""
        stated, rod = self.tolerances.root_radii, self.model.rod
        if stated != Tolerances.root_radii:
            return stated
        design = float(rod.rigid_length / rod.radius[0])
        return max(stated, max(abs(design - root) for root in KNOWN_ROOTS) / MAX_ROOT_DEVIATION)

    @property
    def stiffness_std(self) -> float:
        """Standard deviation of the stiffness from test to test, relative: the tolerance, or `ORDINARY_SCATTER` where
        that is the assumed default, because how a bench rests the probe between tests is then not known."""
        stated = self.tolerances.stiffness_scatter
        return max(stated if stated != Tolerances.stiffness_scatter else ORDINARY_SCATTER, MIN_SCATTER)

    @property
    def bias_std(self) -> Array:
        """Standard deviations of the first test's bias [N, N·m], (6,): drift, and what a tare absorbed.

        A tare absorbs the errors of the free probe's wrench, and those of the weight between base and sensor, which
        the sensor's gain and the tilt of the base change.
        """
        variance = self.tolerances.drift_steps**2 * self.model.averaging_samples * np.diag(self.model.noise_base())
        free = self.model.rod.solve(self.model.gravity_base)
        if self.tolerances.tared and free.ok:
            force, moment = np.linalg.norm(free.wrench_base.reshape(2, 3), axis=1)
            payload = np.linalg.norm((self.model.payload_by_gravity @ self.model.gravity_base).reshape(2, 3), axis=1)
            error = math.hypot(self.tolerances.gain, self.std_tilt)
            absorbed = [TARE_FRACTION * force + error * payload[0], TARE_FRACTION * moment + error * payload[1]]
            variance = variance + np.repeat(np.square(absorbed), 3)
        return np.asarray(np.sqrt(variance))

    @cached_property
    def prior(self) -> Array:
        """Standard deviations of the vector about zero, (size,); zero for what is fixed at the design value."""
        std = np.ones(self.size)
        for parameter in PARAMETERS.values():
            std[parameter.columns] = parameter.prior(self)
        return std

    @cached_property
    def bounds(self) -> Array:
        """Smallest and largest values of the vector, (2, size)."""
        bounds = np.full((2, self.size), np.inf) * [[-1.0], [1.0]]
        for parameter in PARAMETERS.values():
            design = parameter.design_value(self.model)
            ends = [(end - design) / parameter.scale for end in parameter.bounds]
            bounds[:, parameter.columns] = np.array(
                [(-MAX_LOGARITHM, MAX_LOGARITHM) if parameter.logarithm else ends]
            ).T
        return bounds

    def prior_without(self, requested: Sequence[str]) -> Array:
        """Return the prior with infinite standard deviations for the requested parameters, (size,)."""
        std = self.prior.copy()
        std[columns_of(requested)] = math.inf
        if "E" in requested:
            std[columns_of(["G"])] = math.inf  # Poisson's ratio determines it with E, see `PoissonPrior`
        together = self.tolerances.diameter_mm > 0.0 or self.tolerances.diameter_share > 0.0
        if "diameters" in requested and together:
            std[PRINT] = 0.0  # the first print mode is the same factor on all diameters: one of the two is enough
        return std


@dataclass(frozen=True)
class ParameterValues:
    """Values of the parameter vector: the rod, the poses and the gravity that they imply."""

    common: CommonParameters  #: the parameters.
    x: Array  #: the vector, (size,).

    @cached_property
    def rod(self) -> Rod:
        """The rod with these values."""
        rod = self.common.model.rod
        for parameter in PARAMETERS.values():
            if parameter.apply is not None:
                rod = parameter.apply(self.common.model, rod, float(self.x[parameter.columns][0]))
        return scaled_diameters(rod, np.exp(self.x[self.common.print_columns] @ self.common.print_modes))

    def with_pose_error(self, error: Array) -> "ParameterValues":
        """Return the values with a further error of the base pose: rotation [rad] and position [m], (6,)."""
        x = self.x.copy()
        x[BASE_POSE] += error
        moved = ParameterValues(self.common, x)
        moved.__dict__["rod"] = self.rod  # poses do not change it
        return moved

    def bias(self, epoch: int) -> Array:
        """Return the bias of the sensor at a test, at the base [N, N·m], (6,)."""
        walked = self.common.walk_modes(epoch) @ self.x[self.common.walk_columns(epoch)]
        return np.asarray(self.x[PARAMETERS["bias"].columns] + walked)

    @cached_property
    def T_base_error(self) -> Array:
        """Actual pose of the sensor's base frame in the base frame as the campaign states it, (4, 4)."""
        return pose(Rotation.from_rotvec(self.x[BASE_ROTATION]).as_matrix(), self.x[BASE_OFFSET])

    @cached_property
    def T_mount_error(self) -> Array:
        """Actual pose of the probe's base in the base frame of the sensor, (4, 4)."""
        return pose(Rotation.from_rotvec(self.x[MOUNT_ROTATION]).as_matrix(), self.x[MOUNT_OFFSET])

    @cached_property
    def T_stated_base(self) -> Array:
        """Actual pose of the probe's base in the base frame as the campaign states it, (4, 4)."""
        return np.asarray(self.T_base_error @ self.T_mount_error)

    def gravity(self, gravity_world: Array) -> tuple[Array, Array]:
        """Return gravity in the world [m/s²], (3,), and its derivatives by its two rotations, (3, 2)."""
        axes = np.linalg.svd(gravity_world[None])[2][1:] if gravity_world.any() else np.zeros((2, 3))
        R = Rotation.from_rotvec(self.x[PARAMETERS["gravity"].columns] @ axes).as_matrix()
        return R @ gravity_world, np.cross(axes, gravity_world).T
