"""Campaigns of a laboratory whose bench has flaws: true probes, poses, sensors, frictions and drifts are drawn.

The true touches are solved by `rod.contact` for a force in the axes of the touched surface, which `identification` does
not use, or by the reference rod of `tests/reference`; sensor, drift and reference are written anew here.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from probedesign.campaigns.manifest import LENGTH_SCALE, WEIGHT_STD, WRIST
from probedesign.core.frames import Array, pose, wrench_map
from probedesign.core.units import MM
from probedesign.estimation.error_sources import parameters_of, turns_of
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import WALK_SECONDS, Tolerances
from probedesign.identification.identify import IdentificationData
from probedesign.identification.parameters import (
    DEGREE,
    POISSON,
    POISSON_STD,
    CommonParameters,
)
from probedesign.identification.residuals import MeasuredTest
from probedesign.identification.whole_probe import MassMeasurement
from probedesign.prediction.monte_carlo import perturbed_rod
from probedesign.prediction.touches import DIRECTIONS
from probedesign.rod.contact import solve_surface_force
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.rod import Rod
from tests.reference.cosserat import solve
from tests.reference.round_rods import Probes

STD_BASE, STD_TILT = 0.2 * MM, 0.2 * DEGREE
"""Of the base in the world: what `campaign.toml` assumes."""
ROWS = 20
"""Readings a test."""


@dataclass(frozen=True)
class Kind:
    """How a laboratory measures.

    Attributes:
        name: of it.
        words: how well it sees.
        touches: fraction of the length and newtons; each is done from every side.
        sides: words.
        weights: dead loads on threads, fraction of the length and newtons.
        hangs: how often the free probe is measured, between the touches.
        marker: standard deviation of a marker on each axis [m]; 0: no markers.
        touch: of the touched place on each axis [m].
        s: of its arclength [m].
    """

    name: str
    words: str
    touches: tuple[tuple[float, float], ...]
    sides: tuple[str, ...]
    weights: tuple[tuple[float, float], ...]
    hangs: int
    marker: float
    touch: float
    s: float


CAMERAS = Kind("cameras", "markers to 3.6 mm", ((0.4, 0.2), (0.55, 0.1), (0.7, 0.06), (0.85, 0.04)),
             ("+x", "-x", "+y", "-y"), ((0.4, 0.05), (0.8, 0.005)), 4, 3.6 * MM, 3.6 * MM, 1.0 * MM)  # fmt: skip
STAGE = Kind("stage", "places to 0.05 mm", ((0.35, 0.2), (0.5, 0.1), (0.65, 0.05), (0.8, 0.025)),
             ("+x", "-x", "+y", "-y"), (), 4, 0.0, 0.05 * MM, 0.05 * MM)  # fmt: skip
"""The large probe bent by 5 to 70 mm. 3.6 mm is the paper's RMS of a marker, here on each axis, and of the contact by
its cameras; a pencil mark gives the contact's position on the probe to a millimetre (assumed)."""
DIMENSIONS = ("diameter", "diameter scatter", "length")
MARKERS = np.linspace(10.0, 150.0, 15) * MM


@dataclass(frozen=True)
class Flaws:
    """What a bench does beside the noise of its readings; the default is a bench without.

    Attributes:
        friction: largest friction coefficient; that of the campaign is uniform up to it, and the tangential force of
            each touch anywhere inside its cone.
        stiffness_scatter: standard deviation of the stiffness from touch to touch, relative.
        gain: of the gain of each channel of the sensor, relative.
        seconds: from one test to the next; the bias walks meanwhile. 0: it does not.
        root: root_rigid_radii of the print; None for the design's.
        root_drawn: whether the root is drawn by its tolerance instead.
        reference: whether length scale, weights, poses of tests and creep have errors by their priors.
        stated: tolerances that the design states because of the bench, by name.
        independent: whether the true touches and the free probe are solved by the reference rod of `tests/reference`,
            which shares no code with the package's; for laboratories without markers.
    """

    friction: float = 0.0
    stiffness_scatter: float = 0.0
    gain: float = 0.0
    seconds: float = 0.0
    root: float | None = None
    root_drawn: bool = False
    reference: bool = False
    stated: dict[str, float] = field(default_factory=dict)
    independent: bool = False


FLAWLESS = Flaws()


@dataclass(frozen=True)
class Truth:
    """One world.

    Attributes:
        rod: as perturbed_rod.
        factors: logarithms by which E, G, density, length and diameters differ from the design, (4 + K).
        T_mount: true pose of the base relative to its stated pose, (4, 4).
        T_seat: of the base in its seat on the sensor.
        gravity_base: in the true base frame [m/s²].
        gravity_mount: in the stated base frame [m/s²].
    """

    rod: Rod
    factors: Array
    T_mount: Array
    T_seat: Array
    gravity_base: Array
    gravity_mount: Array


def draw(model: ProbeModel, kind: Kind, seed: int, *, dimensions: bool = False, spread: float = 0.1,
         tolerances: Tolerances | None = None, weighed: bool = False,
         flaws: Flaws = FLAWLESS) -> tuple[IdentificationData, Truth]:  # fmt: skip
    """A campaign and the truth behind it.

    Args:
        model: of the probe as designed.
        kind: of laboratory.
        seed: of everything.
        dimensions: whether the print's dimensions differ as the tolerances have it; else they are as designed.
        spread: of log E about the design's, standard deviation.
        tolerances: of all else; the design's if None.
        weighed: whether the flexible part was weighed, to 0.01 g.
        flaws: of the bench.
    """
    rng = np.random.default_rng(seed)
    tolerances = replace(tolerances or Tolerances.of(model), **flaws.stated)
    truth = _truth(model, tolerances, rng, dimensions, spread, flaws)
    bench = _Bench(model, kind, truth, flaws, tolerances, rng)
    trials = bench.tests()
    walk = (flaws.seconds,) * (len(trials) - 1) if flaws.seconds else ()
    shared = CommonParameters(model, tolerances, STD_BASE, STD_TILT, walk)
    scales = MassMeasurement(truth.rod.mass + 1e-5 * rng.normal(), 1e-5, 0.0) if weighed else None
    return IdentificationData(shared, trials, scales, f"{kind.name} {seed}"), truth


def _truth(
    model: ProbeModel,
    tolerances: Tolerances,
    rng: np.random.Generator,
    dimensions: bool,
    spread: float,
    flaws: Flaws,
) -> Truth:
    K = len(model.rod.s)
    factors = np.zeros(4 + K)
    causes = parameters_of(
        model.rod, replace(tolerances, youngs_modulus=spread, creep=0.0, stiffness_scatter=0.0)
    )
    for cause, rows in causes.items():
        drawn = rng.normal(size=len(rows)) @ rows
        factors += drawn if dimensions or cause not in DIMENSIONS else 0.0
    poisson = min(POISSON + POISSON_STD * rng.normal(), 0.4999)
    ratio = model.rod.youngs_modulus / model.rod.shear_modulus
    factors[1] = factors[0] + math.log(ratio / (2.0 * (1.0 + poisson)))
    turns = sum(
        rng.normal(size=len(rows)) @ rows for rows in turns_of(model.gravity_base, tolerances).values()
    )
    T_seat = pose(Rotation.from_rotvec(turns[3:6]).as_matrix(), turns[0:3])
    turn, shift = STD_TILT * rng.normal(size=3), STD_BASE * rng.normal(size=3)
    T_mount = pose(Rotation.from_rotvec(turn).as_matrix(), shift) @ T_seat
    pulled = model.gravity_base + turns[6:9]
    rod = perturbed_rod(model.rod, factors)
    radius, drawn_root = float(rod.radius[0]), tolerances.root_radii * rng.normal()
    if flaws.root_drawn:
        rod = replace(rod, rigid_length=rod.rigid_length + drawn_root * radius)
    elif flaws.root is not None:
        rod = replace(rod, rigid_length=flaws.root * radius)
    return Truth(rod, factors, T_mount, T_seat, T_mount[:3, :3].T @ pulled, pulled)


class _Bench:
    """The tests of one campaign, one after the other."""

    def __init__(self, model: ProbeModel, kind: Kind, truth: Truth, flaws: Flaws, tolerances: Tolerances,
                 rng: np.random.Generator) -> None:  # fmt: skip
        self.model, self.kind, self.truth, self.flaws, self.rng = model, kind, truth, flaws, rng
        own = 1.0 if flaws.reference else 0.0
        self.gain = np.diag(flaws.gain * rng.normal(size=6))
        self.scale = 1.0 + own * LENGTH_SCALE * rng.normal()
        self.stated_pose = tolerances.robot_mm * MM
        self.std_pose, self.std_weight = own * self.stated_pose, own * WEIGHT_STD
        self.creep = own * tolerances.creep * rng.normal()
        self.mu = flaws.friction * rng.random()
        steps = np.linalg.cholesky(model.averaging_samples * model.noise_base())
        self.walk = tolerances.walk_steps * math.sqrt(flaws.seconds / WALK_SECONDS) * steps
        self.bias = tolerances.drift_steps * steps @ rng.normal(size=6)
        if tolerances.tared:
            self.bias -= self._true_reading(truth.rod.solve(truth.gravity_base).wrench_base)
            self.bias += model.rod.solve(model.gravity_base).wrench_base

    def tests(self) -> tuple[MeasuredTest, ...]:
        """Return the tests; touches that the true probe does not bear are left out."""
        loads: list[tuple[str, float, float, str]] = [
            ("weight", s, force, "") for s, force in self.kind.weights
        ]
        loads += [("touch", s, force, side) for s, force in self.kind.touches for side in self.kind.sides]
        every = math.ceil(len(loads) / max(self.kind.hangs - 1, 1))
        plan: list[tuple[str, float, float, str]] = []
        for i, load in enumerate(loads):
            plan += [("free", 0.0, 0.0, "")] if i % every == 0 else []
            plan.append(load)
        plan.append(("free", 0.0, 0.0, ""))
        found = []
        for i, (what, fraction, force, side) in enumerate(plan):
            trial = self._test(f"{what}-{i + 1}", what, fraction, force, side, i / (len(plan) - 1))
            if trial is not None:
                found.append(trial)
        return tuple(replace(trial, epoch=k if self.flaws.seconds else 0) for k, trial in enumerate(found))

    def _test(self, name: str, what: str, fraction: float, force: float, side: str, passed: float
              ) -> MeasuredTest | None:  # fmt: skip
        truth, rng, model = self.truth, self.rng, self.model
        stiffer = math.exp(
            self.flaws.stiffness_scatter * rng.normal() * (what != "free") - self.creep * (passed - 0.5)
        )
        rod = replace(truth.rod, youngs_modulus=stiffer * truth.rod.youngs_modulus,
                      shear_modulus=stiffer * truth.rod.shear_modulus)  # fmt: skip
        s, size, turn = fraction * rod.length, self.mu * math.sqrt(rng.random()), 2.0 * math.pi * rng.random()
        own = np.concatenate([rng.normal(size=3) / WRIST, rng.normal(size=3)]) * self.std_pose
        T = pose(Rotation.from_rotvec(own[:3]).as_matrix(), own[3:]) @ truth.T_mount
        gravity = T[:3, :3].T @ truth.gravity_mount
        surface, known = None, None if what == "touch" else np.zeros(3)
        eq: Equilibrium | None = None
        if what == "touch":
            ratios = (size * math.cos(turn), size * math.sin(turn))
            phi = DIRECTIONS[side] + math.pi
            if self.flaws.independent:
                along, around = ratios
                found = solve(
                    Probes.of(rod), gravity, s, phi, (force, around * force, along * force), axes="surface"
                )
                ok, wrench, surface = bool(found.ok[0]), found.wrench[0], found.p_surface[0]
            else:
                touch = solve_surface_force(rod, gravity, s, phi, force, ratios)
                eq, surface, ok = touch.equilibrium, touch.p_surface_base, touch.result == "ok"
        elif what == "weight":
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
        trial = MeasuredTest(name, np.eye(4), model.gravity_base, known, wrench_base=wrench, cov_wrench=cov,
                             creep_ramp=passed - 0.5, std_place=self.stated_pose,
                             std_turn=self.stated_pose / WRIST)  # fmt: skip
        if what != "free":
            trial = replace(trial, s_contact=s + self.kind.s * rng.normal(), std_s=self.kind.s)
        if surface is not None:
            place = self._seen(surface[None], T)[0] + self.kind.touch * rng.normal(size=3)
            trial = replace(trial, p_touch_world=place, std_touch=self.kind.touch)
        return self._with_markers(trial, eq, T) if self.kind.marker and eq is not None else trial

    def _true_reading(self, wrench: Array) -> Array:
        """Return what the sensor reads of a wrench of the true probe, about the stated base."""
        model, truth = self.model, self.truth
        about_seat = wrench_map(truth.T_seat) @ wrench
        reading = model.to_sensor(about_seat, model.gravity_base)
        return np.asarray(about_seat + wrench_map(np.linalg.inv(model.T_sensor_base)) @ (self.gain @ reading))

    def _seen(self, points: Array, T: Array) -> Array:
        """Return points in the true base frame as the reference has them in the world, which is the stated frame."""
        return np.asarray(self.scale * (points @ T[:3, :3].T + T[:3, 3]))

    def _with_markers(self, trial: MeasuredTest, eq: Equilibrium, T: Array) -> MeasuredTest:
        seen = self._seen(eq.p_at(np.minimum(MARKERS, self.truth.rod.length)), T)
        seen = seen + self.kind.marker * self.rng.normal(size=seen.shape)
        cov = np.tile(self.kind.marker**2 * np.eye(3), (len(MARKERS), 1, 1))
        numbers = tuple(range(1, len(MARKERS) + 1))
        return replace(trial, marker_s=MARKERS, p_markers_world=seen, cov_markers=cov, marker_numbers=numbers)
