"""Ground truth of a simulated campaign: its plan, the probe as printed, its pose, and the equilibrium of each test."""

import math
from dataclasses import dataclass, replace
from itertools import cycle
from typing import Literal, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from probedesign.campaigns.manifest import LENGTH_SCALE, WEIGHT_STD, WRIST
from probedesign.core.errors import InputError
from probedesign.core.frames import Array, pose, rotation_under_gravity, wrench_map
from probedesign.core.units import MM
from probedesign.design.catalog import CONDITIONS
from probedesign.estimation.error_sources import BEFORE_KNOTS, curvature_std, parameters_of, scaled_curvature, turns_of
from probedesign.estimation.model import ProbeModel, Tolerances
from probedesign.prediction.monte_carlo import perturbed_rod
from probedesign.prediction.touches import DIRECTIONS
from probedesign.rod.contact import solve_contact
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.friction import ASSUMED_SPREAD, MAX_FRICTION, draw_friction
from probedesign.rod.rod import Rod

CampaignKind = Literal["cameras", "stage"]
LARGE_LENGTH, LARGE_BASE_RADIUS, LARGE_TIP_RADIUS = 150.0 * MM, 6.0 * MM, 1.0 * MM
LARGE_MODULUS = 2.32e6  #: Dimensions [m] and modulus [Pa] of the paper's large probe, from which forces are scaled.
MARKER_SPACING = 10.0 * MM  #: Of equidistant markers [m]: that of the paper, about a centimetre.
TIP_MARGIN = 2.0 * MM  #: Distance of the last marker from the tip [m], for the size of a dot (assumed).
#: Dead loads on the large probe, fraction of the length and force [N]: the first is that of the paper's figure 3.
WEIGHTS = ((0.4, 0.014), (0.4, 0.05), (0.6, 0.01), (0.8, 0.005))
BASE_POSITION = (0.0, 0.0, 0.25)  #: Stated position of the base in the world [m]: above a table.
#: Standard deviations of the base pose, on each axis [m], [rad]: assumed, a bracket measured by the cameras; a stage's
#: repeatability over the length of a probe.
STD_BASE = {"cameras": (0.2 * MM, math.radians(0.2)), "stage": (0.05 * MM, math.radians(0.05))}
MAX_HALVINGS = 12  #: Of a force under which the probe buckles.


# the plan


@dataclass(frozen=True)
class CampaignPlan:
    """How a simulated campaign is measured."""

    #: "cameras": free, with weights and touched, with markers, as in the paper; "stage": touched at places known to a
    #: twentieth of a millimetre, without cameras.
    kind: CampaignKind = "cameras"
    seed: int = 0  #: of all random numbers.
    #: youngs_modulus, shear_modulus: of the true probe [Pa]; None draws them about the design's by its tolerances.
    youngs_modulus: float | None = None
    shear_modulus: float | None = None
    marker_noise: float | None = None  #: of markers by another reference, on each axis [m]; None for two cameras.
    readings: int = 5  #: of the sensor in each test, each the mean of the design's averaging_samples.
    exact: bool = False  #: the true probe is the design's and at the stated pose; only readings and pictures are noisy.
    #: median friction coefficient μ of touches; 0 is without friction. None: [contact] friction of the design with
    #: flaws of the bench, else 0.
    friction: float | None = None
    friction_spread: float = ASSUMED_SPREAD  #: standard deviation of ln μ from test to test.
    hold_out: bool = False  #: mark every second touch as one for `validate`, which `identify` leaves out.
    flaws: bool = False  #: whether the bench has the flaws of the design's tolerances; an exact probe's has none.

    def __post_init__(self) -> None:
        """Raise InputError where a number is out of range or two options exclude each other."""
        moduli = {"youngs": self.youngs_modulus, "shear": self.shear_modulus}
        limited = [(f"{name}-modulus-mpa", value, 1e3, 1e11, 1e6) for name, value in moduli.items()] + [
            ("marker-noise-mm", self.marker_noise, 0.001 * MM, 20.0 * MM, MM),
            ("readings", self.readings, 1, 1000, 1),
            ("friction", self.friction, 0.0, MAX_FRICTION, 1.0),
            ("friction-spread", self.friction_spread, 0.0, 1.0, 1.0),
        ]
        for option, value, low, high, unit in limited:
            if value is not None and not low <= value <= high:
                raise InputError(f"--{option} {value / unit:g} must lie in {low / unit:g} ... {high / unit:.6g}")
        if self.seed < 0:
            raise InputError(f"--seed {self.seed} must not be negative")
        if self.kind == "stage" and self.marker_noise is not None:
            raise InputError("--stage has no markers: leave out --marker-noise-mm")


class PlannedTouch(NamedTuple):
    """A planned touch: fraction of the length, force [N] and direction of the push."""

    fraction: float
    force: float
    direction: str


def planned_touches(model: ProbeModel) -> list[PlannedTouch]:
    """Return the touches of Table I: a paper probe's own, for any other those of the large one, with forces that bend
    it alike, scaled by E d⁴ / L² at the touched place."""
    is_papers = model.name in CONDITIONS
    return [
        PlannedTouch(fraction, force if is_papers else force * stiffness_ratio(model.rod, fraction), direction)
        for (fraction, force), direction in zip(CONDITIONS[model.name if is_papers else "large"], cycle(DIRECTIONS))
    ]


def planned_weights(model: ProbeModel) -> list[tuple[float, float]]:
    """Return dead loads of a probe: fraction of the length and force [N]."""
    return [(fraction, force * stiffness_ratio(model.rod, fraction)) for fraction, force in WEIGHTS]


def stiffness_ratio(rod: Rod, fraction: float) -> float:
    """Return the ratio of forces at a fraction of the length that bend a rod like the paper's large probe."""
    radius = float(rod.radius_at(fraction * rod.length))
    large = LARGE_BASE_RADIUS + fraction * (LARGE_TIP_RADIUS - LARGE_BASE_RADIUS)
    return (rod.youngs_modulus / LARGE_MODULUS) * (radius / large) ** 4 * (LARGE_LENGTH / rod.length) ** 2


def marker_arclengths(length: float) -> list[float]:
    """Return the arclengths of the markers [m]."""
    count = int(np.floor((length - TIP_MARGIN) / MARKER_SPACING + 1e-9))
    return [MARKER_SPACING * (i + 1) for i in range(count)] or [0.5 * length]


# the truth


@dataclass(frozen=True, eq=False)
class BenchFlaws:
    """What a bench does beside the noise of its readings, drawn from the tolerances."""

    friction: float  #: median friction coefficient of touches.
    gain: Array  #: relative error of each channel of the sensor, (6,).
    root: float  #: error of root_rigid_radii, in base radii.
    creep: float  #: relative loss of stiffness from the first test to the last.
    stiffness_scatter: float  #: standard deviation of the stiffness of each loaded test, relative.
    drift_steps: float  #: drift_steps, walk_steps: of the sensor's bias, as in `Tolerances`.
    walk_steps: float
    length_scale: float  #: relative error of the lengths that the reference measures.
    #: standard deviation of the base's position in each test, on each axis [m], and of its rotation times `WRIST`.
    std_pose: float
    std_weight: float  #: standard deviation of each known load, relative.

    @classmethod
    def draw(cls, model: ProbeModel, plan: CampaignPlan, tolerances: Tolerances) -> "BenchFlaws":
        """Draw the flaws of a plan's bench."""
        rng, t = np.random.default_rng([plan.seed, 4]), tolerances if plan.flaws else Tolerances.none()
        friction = 0.0 if plan.exact or not plan.flaws else min(model.friction, MAX_FRICTION)
        bench = float(plan.flaws and not plan.exact)
        return cls(friction if plan.friction is None else plan.friction, t.gain * rng.normal(size=6),
                   t.root_radii * rng.normal(), t.creep * rng.normal(), t.stiffness_scatter, tolerances.drift_steps,
                   t.walk_steps, bench * LENGTH_SCALE * rng.normal(), t.robot_mm * MM,
                   bench * WEIGHT_STD)  # fmt: skip


@dataclass(frozen=True, eq=False)
class SimulatedTest:
    """Ground truth of one test."""

    name: str  #: of the test.
    bench: "GroundTruth"  #: probe, poses and gravity during the test.
    equilibrium: Equilibrium  #: of the true probe in its true base.
    p_surface_base: Array | None  #: touched point [m], (3,); None for free probes and weights.
    direction: str  #: of the push of a touch.
    weight: Array | None  #: known force in the world, straight down [N], (3,); zero for a free probe, None for a touch.
    wrench_sensor: Array  #: reading of a perfect sensor [N, N·m], (6,).
    s_contact: float  #: arclength where the force's line of action passes the axis [m].
    friction: float = 0.0  #: tangential over normal force of a touch.


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """Ground truth of a campaign: the probe as printed, its pose and gravity."""

    model: ProbeModel  #: of the probe as designed.
    plan: CampaignPlan  #: of the campaign.
    rod: Rod  #: as printed.
    curvature: float  #: of a helix or of knots, over the designed one.
    T_world_base: Array  #: pose of the base as the campaign states it, (4, 4).
    T_world_mount: Array  #: true pose of that frame, (4, 4).
    T_world_true: Array  #: true pose of the base of the print, (4, 4).
    stated_gravity: Array  #: as the campaign states it [m/s²], (3,).
    gravity_world: Array  #: true gravity.
    tolerances: Tolerances  #: from which it was drawn.
    flaws: BenchFlaws  #: of the bench.

    @classmethod
    def draw(cls, model: ProbeModel, plan: CampaignPlan, rng: np.random.Generator) -> "GroundTruth":
        """Draw a ground truth by the design's tolerances; refuse a design that is mounted without gravity."""
        size = float(np.linalg.norm(model.gravity_base))
        if size == 0.0:
            raise InputError("mount.gravity_base_m_s2 is zero; a campaign needs gravity")
        tolerances = Tolerances.none() if plan.exact else Tolerances.of(model)
        stated, T = np.array([0.0, 0.0, -size]), pose(rotation_under_gravity(model.gravity_base), BASE_POSITION)
        std_place, std_turn = (0.0, 0.0) if plan.exact else STD_BASE[plan.kind]
        mount = T @ _displacement(rng.normal(size=3) * std_place, rng.normal(size=3) * std_turn)
        turns = np.zeros(9)
        for rows in turns_of(stated, tolerances).values():
            turns += rng.normal(size=len(rows)) @ rows
        true = mount @ _displacement(turns[0:3], turns[3:6])
        flaws = BenchFlaws.draw(model, plan, tolerances)
        factor = 1.0 + curvature_std(model, tolerances) * np.random.default_rng([plan.seed, 7]).normal()
        rod = scaled_curvature(model, _rod(model, plan, tolerances, flaws, rng), factor - 1.0)
        return cls(model, plan, rod, factor, T, mount, true, stated,
                   stated + turns[6:9], tolerances, flaws)  # fmt: skip

    def tests(self) -> list[SimulatedTest]:
        """Return every test: free, weights, touches, free again; refuse a probe that has no stable equilibrium."""
        weights = planned_weights(self.model) if self.plan.kind == "cameras" else []
        touches = planned_touches(self.model)
        benches = iter(self._benches(len(weights) + len(touches)))
        tests = [next(benches)._free("hang-1")]
        for i, (fraction, newtons) in enumerate(weights, 1):
            tests.append(next(benches)._loaded(f"weight-{i}", fraction, newtons))
        for i, touch in enumerate(touches, 1):
            tests.append(next(benches)._touched(f"touch-{i:02d}", *touch))
        return [*tests, next(benches)._free("hang-2")]

    def _benches(self, loaded: int) -> list["GroundTruth"]:
        """Return the truth during each test: the stiffness creeps and scatters, and each pose has an error of its own;
        the first and the last are free."""
        rng, rod = np.random.default_rng([self.plan.seed, 5]), self.rod
        scatter = np.concatenate([[0.0], self.flaws.stiffness_scatter * rng.normal(size=loaded), [0.0]])
        factors = np.exp(scatter - self.flaws.creep * (np.linspace(0.0, 1.0, loaded + 2) - 0.5)).tolist()
        truths = []
        for f in factors:
            shift, turn = self.flaws.std_pose * rng.normal(size=(2, 3)) / [[1.0], [WRIST]]
            T = self.T_world_base @ _displacement(shift, turn) @ np.linalg.inv(self.T_world_base)
            softer = replace(rod, youngs_modulus=f * rod.youngs_modulus, shear_modulus=f * rod.shear_modulus)
            truths.append(
                replace(self, rod=softer, T_world_mount=T @ self.T_world_mount, T_world_true=T @ self.T_world_true)
            )
        return truths

    @property
    def gravity_base(self) -> Array:
        """Gravity in the axes of the true base [m/s²], (3,)."""
        return np.asarray(self.T_world_true[:3, :3].T @ self.gravity_world)

    def to_world(self, points_base: Array) -> Array:
        """Return points of the true base's frame in the world as the reference measures it [m], (..., 3).

        Its lengths have the error `length_scale`, from the stated position of the base on.
        """
        p_world = points_base @ self.T_world_true[:3, :3].T + self.T_world_true[:3, 3]
        return np.asarray(p_world + self.flaws.length_scale * (p_world - self.T_world_base[:3, 3]))

    def _free(self, name: str) -> SimulatedTest:
        return self._test(name, self.rod.solve(self.gravity_base), None, "", np.zeros(3))

    def _loaded(self, name: str, fraction: float, newtons: float) -> SimulatedTest:
        """Return a weight on a thread around the probe, a dead force on its axis, halved until the probe is stable."""
        rng = np.random.default_rng([self.plan.seed, 6, int(name.rsplit("-", 1)[1])])
        pull = (1.0 + self.flaws.std_weight * rng.normal()) * self.gravity_world / np.linalg.norm(self.gravity_world)
        for _ in range(MAX_HALVINGS):
            force_base = self.T_world_true[:3, :3].T @ (newtons * pull)
            eq = self.rod.solve(self.gravity_base, force_base, fraction * self.rod.length)
            if eq.ok:
                break
            newtons /= 2.0
        return self._test(name, eq, None, "", np.array([0.0, 0.0, -newtons]))

    def _touched(self, name: str, fraction: float, newtons: float, direction: str) -> SimulatedTest:
        """Return a touch, halved until the probe is stable.

        With friction the force lies within Coulomb's cone, its tangential part uniform in the circle of radius μ F_n.
        """
        ratios, size = None, 0.0
        if self.flaws.friction > 0.0:
            rng = np.random.default_rng([self.plan.seed, 2, int(name.rsplit("-", 1)[1])])
            mu = draw_friction(self.flaws.friction, self.plan.friction_spread, rng)
            size, turn = mu * math.sqrt(rng.random()), 2.0 * math.pi * rng.random()
            ratios = (size * math.cos(turn), size * math.sin(turn))
        s, angle = fraction * self.rod.length, DIRECTIONS[direction]
        for _ in range(MAX_HALVINGS):
            contact = solve_contact(self.rod, self.gravity_base, s, angle, newtons, ratios)
            if contact.result == "ok":
                break
            newtons /= 2.0
        eq = contact.equilibrium
        surface = contact.p_surface_base if eq.ok else None
        return self._test(name, eq, surface, direction, None, contact.s_contact, size)

    def _test(
        self,
        name: str,
        eq: Equilibrium,
        surface: Array | None,
        direction: str,
        weight: Array | None,
        s_contact: float | None = None,
        friction: float = 0.0,
    ) -> SimulatedTest:
        if not eq.ok:
            raise InputError(f"test {name}: the probe has no stable equilibrium ({eq.result}); a campaign needs one")
        mount_true = np.linalg.inv(self.T_world_mount) @ self.T_world_true
        wrench_mount = wrench_map(mount_true) @ eq.wrench_base
        gravity_mount = self.T_world_mount[:3, :3].T @ self.gravity_world
        reading = self.model.to_sensor(wrench_mount, gravity_mount)
        s = eq.s_contact if s_contact is None else s_contact
        return SimulatedTest(name, self, eq, surface, direction, weight, reading, s, friction)


def _displacement(shift: Array, turn: Array) -> Array:
    return pose(Rotation.from_rotvec(turn).as_matrix(), shift)


def _rod(
    model: ProbeModel, plan: CampaignPlan, tolerances: Tolerances, flaws: BenchFlaws, rng: np.random.Generator
) -> Rod:
    """Return the probe as printed; moduli of the plan are exact.

    Creep and the stiffness scatter between touches are not properties of the print.
    """
    by = np.zeros(BEFORE_KNOTS + len(model.rod.s))
    for rows in parameters_of(model.rod, replace(tolerances, stiffness_scatter=0.0, creep=0.0)).values():
        by += rng.normal(size=len(rows)) @ rows
    if plan.youngs_modulus is not None:
        by[0] = math.log(plan.youngs_modulus / model.rod.youngs_modulus)
    if plan.shear_modulus is not None:
        by[1] = math.log(plan.shear_modulus / model.rod.shear_modulus)
    rod = perturbed_rod(model.rod, by)
    return replace(rod, rigid_length=rod.rigid_length + flaws.root * float(rod.radius[0]))
