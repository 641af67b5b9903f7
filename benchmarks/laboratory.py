"""Simulate campaigns of a laboratory with systematic errors, independently of `probedesign.identification`.

True probes, poses, sensors, friction and drift are drawn at random. The true touches are solved by `rod.contact` for a
force in the axes of the touched surface, which `identification` does not use, or by the reference rod of
`tests/reference`. Sensor, drift and reference measurements are implemented here.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from probedesign.campaigns.manifest import LENGTH_SCALE, WEIGHT_STD, WRIST
from probedesign.core.frames import Array, pose, wrench_map
from probedesign.core.units import MM
from probedesign.estimation.error_sources import BEFORE_KNOTS, parameters_of, turns_of
from probedesign.estimation.model import WALK_SECONDS, ProbeModel, Tolerances
from probedesign.identification.identify import IdentificationData
from probedesign.identification.parameters import DEGREE, POISSON, POISSON_STD, CommonParameters
from probedesign.identification.residuals import MassMeasurement, MeasuredTest
from probedesign.prediction.monte_carlo import perturbed_rod
from probedesign.prediction.touches import DIRECTIONS
from probedesign.rod.contact import solve_surface_force
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.rod import Rod
from tests.reference.cosserat import solve
from tests.reference.round_rods import Probes

#: Standard deviations of the base pose in the world, the defaults of `campaign.toml`.
STD_BASE, STD_TILT = 0.2 * MM, 0.2 * DEGREE
ROWS = 20  #: Readings of each test.


@dataclass(frozen=True)
class Kind:
    """Instruments and tests of a laboratory."""

    name: str  #: name of the laboratory.
    words: str  #: description of its accuracy.
    #: places over the length and forces [N]; each touch is repeated from every side.
    touches: tuple[tuple[float, float], ...]
    sides: tuple[str, ...]  #: directions of the touches.
    weights: tuple[tuple[float, float], ...]  #: places over the length and forces [N] of dead loads on threads.
    hangs: int  #: number of tests of the free probe, between the touches.
    marker: float  #: standard deviation of a marker on each axis [m]; 0 for no markers.
    touch: float  #: standard deviation of the touched point on each axis [m].
    s: float  #: standard deviation of its arclength [m].


CAMERAS = Kind("cameras", "markers to 3.6 mm", ((0.4, 0.2), (0.55, 0.1), (0.7, 0.06), (0.85, 0.04)),
             ("+x", "-x", "+y", "-y"), ((0.4, 0.05), (0.8, 0.005)), 4, 3.6 * MM, 3.6 * MM, 1.0 * MM)  # fmt: skip
#: The large probe is bent by 5 to 70 mm. 3.6 mm is the RMS error of a marker in the paper, here on each axis, and of
#: the contact by its cameras; a pencil mark determines the contact's arclength to a millimetre (assumed).
STAGE = Kind("stage", "places to 0.05 mm", ((0.35, 0.2), (0.5, 0.1), (0.65, 0.05), (0.8, 0.025)),
             ("+x", "-x", "+y", "-y"), (), 4, 0.0, 0.05 * MM, 0.05 * MM)  # fmt: skip
DIMENSIONS = ("diameter", "diameter scatter", "length")
MARKERS = np.linspace(10.0, 150.0, 15) * MM


@dataclass(frozen=True)
class Flaws:
    """Errors of a bench in addition to the noise of its readings; the default has none."""

    #: largest friction coefficient. The coefficient of a campaign is uniform below it, and the tangential force of each
    #: touch is uniform in the friction cone.
    friction: float = 0.0
    stiffness_scatter: float = 0.0  #: relative standard deviation of the stiffness between touches.
    gain: float = 0.0  #: relative standard deviation of the gain of each channel of the sensor.
    seconds: float = 0.0  #: time between tests, over which the bias has a random walk [s]; 0 for a constant bias.
    drift: float = 1.0  #: factor on that walk, which the design does not state.
    root: float | None = None  #: root_rigid_radii of the print; None for the design's value.
    root_drawn: bool = False  #: whether the root is drawn from its tolerance instead.
    #: whether length scale, weights, poses of tests and creep have errors drawn from their priors.
    reference: bool = False
    stated: dict[str, float] = field(default_factory=dict)  #: tolerances by name that the design states for this bench.
    #: whether the true touches and the free probe are solved by the reference rod of `tests/reference`, which shares no
    #: code with the package's; for laboratories without markers.
    independent: bool = False


FLAWLESS = Flaws()


@dataclass(frozen=True)
class Truth:
    """True probe and bench of a campaign."""

    rod: Rod  #: true rod.
    factors: Array  #: what `perturbed_rod` changed of the rod as designed, (6 + K).
    T_mount: Array  #: true pose of the base relative to its stated pose, (4, 4).
    T_seat: Array  #: true pose of the base relative to its stated pose on the sensor, (4, 4).
    gravity_base: Array  #: in the true base frame [m/s²].
    gravity_mount: Array  #: in the stated base frame [m/s²].


def draw(model: ProbeModel, kind: Kind, seed: int, *, dimensions: bool = False, spread: float = 0.1,
         tolerances: Tolerances | None = None, weighed: bool = False,
         flaws: Flaws = FLAWLESS) -> tuple[IdentificationData, Truth]:  # fmt: skip
    """Draw a campaign and return its data and its truth.

    Args:
        model: model of the probe as designed.
        kind: laboratory.
        seed: seed of all draws.
        dimensions: whether the dimensions of the print are drawn from their tolerances; otherwise they are as designed.
        spread: standard deviation of log E about the design's value.
        tolerances: of all other quantities; None for the design's.
        weighed: whether the flexible part was weighed, to 0.01 g.
        flaws: errors of the bench.
    """
    rng = np.random.default_rng(seed)
    tolerances = replace(tolerances or Tolerances.of(model), **flaws.stated)
    truth = _truth(model, tolerances, rng, dimensions, spread, flaws)
    bench = _Bench(model, kind, truth, flaws, tolerances, rng)
    tests = bench.tests()
    walk = (flaws.seconds,) * (len(tests) - 1) if flaws.seconds else ()
    shared = CommonParameters(model, tolerances, STD_BASE, STD_TILT, walk)
    scales = MassMeasurement(truth.rod.mass + 1e-5 * rng.normal(), 1e-5, 0.0) if weighed else None
    return IdentificationData(shared, tests, scales, f"{kind.name} {seed}"), truth


def _truth(
    model: ProbeModel, tolerances: Tolerances, rng: np.random.Generator, dimensions: bool, spread: float, flaws: Flaws
) -> Truth:
    K = len(model.rod.s)
    factors = np.zeros(BEFORE_KNOTS + K)
    sources = parameters_of(model.rod, replace(tolerances, youngs_modulus=spread, creep=0.0, stiffness_scatter=0.0))
    for source, rows in sources.items():
        deviation = rng.normal(size=len(rows)) @ rows
        factors += deviation if dimensions or source not in DIMENSIONS else 0.0
    poisson = min(POISSON + POISSON_STD * rng.normal(), 0.4999)
    ratio = model.rod.youngs_modulus / model.rod.shear_modulus
    factors[1] = factors[0] + math.log(ratio / (2.0 * (1.0 + poisson)))
    mounting = sum(rng.normal(size=len(rows)) @ rows for rows in turns_of(model.gravity_base, tolerances).values())
    T_seat = pose(Rotation.from_rotvec(mounting[3:6]).as_matrix(), mounting[0:3])
    rotation, shift = STD_TILT * rng.normal(size=3), STD_BASE * rng.normal(size=3)
    T_mount = pose(Rotation.from_rotvec(rotation).as_matrix(), shift) @ T_seat
    gravity_mount = model.gravity_base + mounting[6:9]
    rod = perturbed_rod(model.rod, factors)
    radius, drawn_root = float(rod.radius[0]), tolerances.root_radii * rng.normal()
    if flaws.root_drawn:
        rod = replace(rod, rigid_length=rod.rigid_length + drawn_root * radius)
    elif flaws.root is not None:
        rod = replace(rod, rigid_length=flaws.root * radius)
    return Truth(rod, factors, T_mount, T_seat, T_mount[:3, :3].T @ gravity_mount, gravity_mount)


class _Bench:
    """Bench that performs the tests of one campaign in sequence."""

    def __init__(self, model: ProbeModel, kind: Kind, truth: Truth, flaws: Flaws, tolerances: Tolerances,
                 rng: np.random.Generator) -> None:  # fmt: skip
        self.model, self.kind, self.truth, self.flaws, self.rng = model, kind, truth, flaws, rng
        errors = 1.0 if flaws.reference else 0.0
        self.gain = np.diag(flaws.gain * rng.normal(size=6))
        self.scale = 1.0 + errors * LENGTH_SCALE * rng.normal()
        self.stated_pose = tolerances.robot_mm * MM
        self.std_pose, self.std_weight = errors * self.stated_pose, errors * WEIGHT_STD
        self.creep = errors * tolerances.creep * rng.normal()
        self.mu = flaws.friction * rng.random()
        steps = np.linalg.cholesky(model.averaging_samples * model.noise_base())
        self.walk = flaws.drift * tolerances.walk_steps * math.sqrt(flaws.seconds / WALK_SECONDS) * steps
        self.bias = tolerances.drift_steps * steps @ rng.normal(size=6)
        if tolerances.tared:
            self.bias -= self._true_reading(truth.rod.solve(truth.gravity_base).wrench_base)
            self.bias += model.rod.solve(model.gravity_base).wrench_base

    def tests(self) -> tuple[MeasuredTest, ...]:
        """Return the tests without the touches for which the true probe has no equilibrium."""
        loads: list[tuple[str, float, float, str]] = [("weight", s, force, "") for s, force in self.kind.weights]
        loads += [("touch", s, force, side) for s, force in self.kind.touches for side in self.kind.sides]
        interval = math.ceil(len(loads) / max(self.kind.hangs - 1, 1))
        plan: list[tuple[str, float, float, str]] = []
        for i, load in enumerate(loads):
            plan += [("free", 0.0, 0.0, "")] if i % interval == 0 else []
            plan.append(load)
        plan.append(("free", 0.0, 0.0, ""))
        found = []
        for i, (kind, fraction, force, side) in enumerate(plan):
            test = self._test(f"{kind}-{i + 1}", kind, fraction, force, side, i / (len(plan) - 1))
            if test is not None:
                found.append(test)
        return tuple(replace(test, epoch=k if self.flaws.seconds else 0) for k, test in enumerate(found))

    def _test(self, name: str, kind: str, fraction: float, force: float, side: str, passed: float
              ) -> MeasuredTest | None:  # fmt: skip
        truth, rng, model = self.truth, self.rng, self.model
        stiffness = math.exp(
            self.flaws.stiffness_scatter * rng.normal() * (kind != "free") - self.creep * (passed - 0.5)
        )
        rod = replace(truth.rod, youngs_modulus=stiffness * truth.rod.youngs_modulus,
                      shear_modulus=stiffness * truth.rod.shear_modulus)  # fmt: skip
        s, ratio, angle = (fraction * rod.length, self.mu * math.sqrt(rng.random()), 2.0 * math.pi * rng.random())
        error = np.concatenate([rng.normal(size=3) / WRIST, rng.normal(size=3)]) * self.std_pose
        T = pose(Rotation.from_rotvec(error[:3]).as_matrix(), error[3:]) @ truth.T_mount
        gravity = T[:3, :3].T @ truth.gravity_mount
        surface, known = None, None if kind == "touch" else np.zeros(3)
        eq: Equilibrium | None = None
        if kind == "touch":
            ratios = (ratio * math.cos(angle), ratio * math.sin(angle))
            phi = DIRECTIONS[side] + math.pi
            if self.flaws.independent:
                along, around = ratios
                found = solve(Probes.of(rod), gravity, s, phi, (force, around * force, along * force), axes="surface")
                ok, wrench, surface = bool(found.ok[0]), found.wrench[0], found.p_surface[0]
            else:
                touch = solve_surface_force(rod, gravity, s, phi, force, ratios)
                eq, surface, ok = touch.equilibrium, touch.p_surface_base, touch.result == "ok"
        elif kind == "weight":
            known = force * model.gravity_base / np.linalg.norm(model.gravity_base)
            eq = rod.solve(gravity, (1.0 + self.std_weight * rng.normal()) * T[:3, :3].T @ known, s)
            ok = eq.ok
        elif self.flaws.independent:
            found = solve(Probes.of(rod), gravity)
            ok, wrench = bool(found.ok[0]), found.wrench[0]
        else:
            eq = rod.solve(gravity)
            ok = eq.ok
        if not ok:
            return None
        if eq is not None:
            wrench = eq.wrench_base
        cov = model.noise_base() / ROWS
        wrench = self._true_reading(wrench) + self.bias + np.linalg.cholesky(cov) @ rng.normal(size=6)
        self.bias = self.bias + self.walk @ rng.normal(size=6)
        test = MeasuredTest(name, np.eye(4), model.gravity_base, known, wrench_base=wrench, cov_wrench=cov,
                             creep_ramp=passed - 0.5, std_place=self.stated_pose,
                             std_turn=self.stated_pose / WRIST)  # fmt: skip
        if kind != "free":
            test = replace(test, s_contact=s + self.kind.s * rng.normal(), std_s=self.kind.s)
        if surface is not None:
            place = self._measured(surface[None], T)[0] + self.kind.touch * rng.normal(size=3)
            test = replace(test, p_touch_world=place, std_touch=self.kind.touch)
        return self._with_markers(test, eq, T) if self.kind.marker and eq is not None else test

    def _true_reading(self, wrench: Array) -> Array:
        """Return the reading of a wrench of the true probe, about the stated base."""
        model, truth = self.model, self.truth
        about_seat = wrench_map(truth.T_seat) @ wrench
        reading = model.to_sensor(about_seat, model.gravity_base)
        return np.asarray(about_seat + wrench_map(np.linalg.inv(model.T_sensor_base)) @ (self.gain @ reading))

    def _measured(self, points: Array, T: Array) -> Array:
        """Return points of the true base frame as measured by the reference in the world, which is the stated frame."""
        return np.asarray(self.scale * (points @ T[:3, :3].T + T[:3, 3]))

    def _with_markers(self, test: MeasuredTest, eq: Equilibrium, T: Array) -> MeasuredTest:
        points = self._measured(eq.p_at(np.minimum(MARKERS, self.truth.rod.length)), T)
        points = points + self.kind.marker * self.rng.normal(size=points.shape)
        cov = np.tile(self.kind.marker**2 * np.eye(3), (len(MARKERS), 1, 1))
        numbers = tuple(range(1, len(MARKERS) + 1))
        return replace(test, marker_s=MARKERS, p_markers_world=points, cov_markers=cov, marker_numbers=numbers)
