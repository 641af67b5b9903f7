"""Synthetic readings for estimators: touches of random probes and of Table I, solved by the rod's reference mode."""

import csv
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from probedesign.core.frames import Array, pose
from probedesign.design import load_design
from probedesign.estimation import surface_contact_kernel as surface
from probedesign.estimation.error_sources import ErrorSources
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.multistart import placed
from probedesign.estimation.tolerances import Tolerances
from probedesign.probe import build_probe
from probedesign.rod.contact import SurfaceForce, solve_surface_force

ROOT = Path(__file__).parents[1]
TABLE_I = ROOT / "tests/data/table1.csv"
DECADES = {"1-10 mN": (1e-3, 1e-2), "10-100 mN": (1e-2, 1e-1), "0.1-1.5 N": (1e-1, 1.5)}
LENGTH, BASE, TAPER = (0.05, 0.18), (0.006, 0.014), (0.15, 0.6)
"""Length and base diameter [m], tip over base, of random probes, least and most."""
PLACE = (0.15, 0.97)
"""Of contacts, over the length."""
MOST_BENT = 2.0
"""F s²/(E I(0) r(s)/r(0)): the paper's hardest touches have 1.5."""


@dataclass(frozen=True)
class Touch:
    """One true touch.

    Attributes:
        model: of the probe.
        gravity: base axes [m/s²], (3,).
        s, angle, force: [m], [rad], [N].
        solved: in reference mode.
        rms: of the touched point by the Cramér–Rao bound of one reading without friction [m].
    """

    model: ProbeModel
    gravity: Array
    s: float
    angle: float
    force: float
    solved: SurfaceForce
    rms: float

    @property
    def wrench(self) -> Array:
        """Without noise, (6,)."""
        return self.solved.equilibrium.wrench_base

    @property
    def point(self) -> Array:
        """Centre of the touched section [m], (3,)."""
        return self.solved.equilibrium.p_contact_base


@cache
def paper_models() -> dict[str, ProbeModel]:
    """The paper's probes."""
    return {name: build_probe(load_design(ROOT / f"designs/{name}.toml")).model
            for name in ("large", "medium", "small")}  # fmt: skip


def touch(model: ProbeModel, gravity: Array, s: float, angle: float, force: float) -> Touch | None:
    """A touch solved in reference mode; None if the probe gives way."""
    solved = solve_surface_force(model.rod, gravity, s, angle + np.pi, force, (0.0, 0.0), "reference")
    if solved.result != "ok":
        return None
    rms = bound_of(model, gravity, solved)
    return Touch(model, gravity, s, angle, force, solved, rms) if np.isfinite(rms) else None


def bound_of(model: ProbeModel, gravity: Array, solved: SurfaceForce) -> float:
    """Return the RMS of the touched point by the Cramér–Rao bound of one reading, force normal to the surface [m].

    With the derivatives H of the base wrench and X of the touched point by arclength, angle and normal force and the
    covariance Σ of the reading, it is the root of the trace of X (Hᵀ Σ⁻¹ H)⁻¹ Xᵀ.
    """
    rod, eq, exact = model.rod, solved.equilibrium, Tolerances.none()
    sources = ErrorSources.of(model, exact, gravity, rod.solve(gravity))
    one, R = np.zeros(surface.TOUCH), eq.R_at(eq.s_contact)
    placed(rod.body, rod.flank_end, eq.s_contact, solved.force_base, R[:, 2].copy(), R[:, 0].copy(), one)
    one[surface.TIP :] = eq.tip
    lin, _ = sources.columns_at(one)
    normal = slice(surface.BY_TOUCH, surface.BY_TOUCH + 3)
    white = np.linalg.solve(np.linalg.cholesky(model.noise_base()), lin[:6, normal])
    scale = np.linalg.norm(white, axis=0)
    if not (np.isfinite(scale).all() and (scale > 0.0).all()):
        return float("inf")
    _, values, right = np.linalg.svd(white / scale)
    if values[-1] < 1e-12:
        return float("inf")
    by = lin[surface.POINT : surface.POINT + 3, normal] / scale @ right.T / values
    return float(np.linalg.norm(by))


def random_touches(decade: tuple[float, float], rng: np.random.Generator) -> Iterator[Touch]:
    """Endless touches of random probes under random gravity, forces even in their logarithm."""
    while True:
        model, gravity = random_model(rng), 9.81 * direction(rng)
        rod, s = model.rod, float(rng.uniform(*PLACE)) * model.rod.length
        force = float(np.exp(rng.uniform(*np.log(decade))))
        stiffness = rod.youngs_modulus * np.pi / 4.0 * rod.radius[0] ** 3 * rod.radius_at(s)
        if force * s * s > MOST_BENT * stiffness:
            continue
        found = touch(model, gravity, s, float(rng.uniform(-np.pi, np.pi)), force)
        if found is not None:
            yield found


def random_model(rng: np.random.Generator) -> ProbeModel:
    """A cone of the paper's resin on the paper's sensor."""
    large = paper_models()["large"]
    length, radius, taper = rng.uniform(*LENGTH), rng.uniform(*BASE) / 2.0, rng.uniform(*TAPER)
    rod = replace(large.rod, s=np.array([0.0, length]), radius=np.array([radius, taper * radius]),
                  rigid_length=large.rod.rigid_length / large.rod.radius[0] * radius)  # fmt: skip
    return replace(large, name="random", rod=rod)


def table_one() -> list[Touch]:
    """The paper's 23 conditions, pushed sideways to gravity without friction, as far as the probe holds them.

    The medium one, of the paper's E, gives way under 0.26 N at 0.7 L: without friction it holds no more than 0.12 N.
    """
    with TABLE_I.open() as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    gravity, found = np.array([9.81, 0.0, 0.0]), []
    for row in rows:
        model = paper_models()[row["probe"]]
        s = float(row["contact_fraction"]) * model.rod.length
        one = touch(model, gravity, s, np.pi / 2.0, float(row["force_N"]))
        if one is not None:
            found.append(one)
    return found


@dataclass(frozen=True)
class Presses:
    """Touches of one point, the world's origin, as the base presses on.

    Attributes:
        model: of the probe.
        gravity: base axes and world's [m/s²], (3,).
        touches: one a pose.
        Ts: poses, (k, 4, 4).
    """

    model: ProbeModel
    gravity: Array
    touches: tuple[Touch, ...]
    Ts: Array

    @property
    def wrenches(self) -> Array:
        """Without noise, (k, 6)."""
        return np.array([one.wrench for one in self.touches])


def surface_point(one: Touch) -> Array:
    """Return the touched point [m], (3,)."""
    return one.solved.p_surface_base


def presses(model: ProbeModel, gravity: Array, s: float, angle: float, forces: Array) -> Presses | None:
    """The probe pressed on against a sharp point, which stays where it is on the probe; None if that gives way."""
    touches = [touch(model, gravity, s, angle, float(force)) for force in forces]
    solved = tuple(one for one in touches if one is not None)
    if len(solved) < len(touches):
        return None
    return Presses(model, gravity, solved, np.array([pose(np.eye(3), -surface_point(one)) for one in solved]))


def random_presses(decade: tuple[float, float], rng: np.random.Generator) -> Iterator[Presses]:
    """Endless presses of random probes under random gravity; the decade is of the strongest touch."""
    for one in random_touches(decade, rng):
        pressed = presses(one.model, one.gravity, one.s, one.angle, one.force * np.linspace(0.2, 1.0, 5))
        if pressed is not None:
            yield pressed


def stiffened(pressed: Presses, stiffness: float) -> tuple[Touch, ...]:
    """The same forces at the same places of a probe that is so many times as stiff as its model says."""
    model, rod = pressed.model, pressed.model.rod
    stiff = replace(model, rod=replace(rod, youngs_modulus=stiffness * rod.youngs_modulus,
                                       shear_modulus=stiffness * rod.shear_modulus))  # fmt: skip
    touches = [touch(stiff, one.gravity, one.s, one.angle, one.force) for one in pressed.touches]
    return tuple(one for one in touches if one is not None)


def read(wrenches: Array, model: ProbeModel, rng: np.random.Generator) -> Array:
    """With the sensor's noise, told at the base, (k, 6)."""
    return wrenches + rng.multivariate_normal(np.zeros(6), model.noise_base(), len(wrenches))


def direction(rng: np.random.Generator) -> Array:
    """Of any, (3,)."""
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)
