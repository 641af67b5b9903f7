"""Synthetic touches of random probes and of the paper's Table I, solved in the reference mode of the rod."""

import csv
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.cases import GRAVITY, random_directions
from probedesign.core.frames import Array, pose
from probedesign.design import check_design, load_design
from probedesign.design.edit import tables_of
from probedesign.estimation.error_sources import ErrorSources
from probedesign.estimation.model import ProbeModel, Tolerances
from probedesign.estimation.multistart import placed
from probedesign.probe import build_probe
from probedesign.rod.contact import RodContact, solve_surface_force
from probedesign.rod.kernels import surface_contact as surface

ROOT = Path(__file__).parents[1]
TABLE_I_FILE = ROOT / "tests/data/table1.csv"
DECADES = {"1-10 mN": (1e-3, 1e-2), "10-100 mN": (1e-2, 1e-1), "0.1-1.5 N": (1e-1, 1.5)}
#: Ranges of length and base diameter [m] and of tip over base diameter of random probes.
LENGTH, BASE, TAPER = (0.05, 0.18), (0.006, 0.014), (0.15, 0.6)
PLACE = (0.15, 0.97)  #: Range of the contact place over the length.
MAX_BEND = 2.0  #: Largest F s²/(E I(0) r(s)/r(0)) of random touches; the touches of Table I reach 1.5.


@dataclass(frozen=True)
class Touch:
    """A frictionless touch with known truth."""

    model: ProbeModel  #: model of the probe.
    gravity: Array  #: in base axes [m/s²], (3,).
    s: float  #: s, angle, force: arclength [m], angle about the section [rad] and normal force [N].
    angle: float
    force: float
    solved: RodContact  #: solution in reference mode.
    bound: float  #: Cramér–Rao bound of the RMS error of the touched point, from one reading without friction [m].

    @property
    def wrench(self) -> Array:
        """Base wrench without noise, (6,)."""
        return self.solved.equilibrium.wrench_base

    @property
    def p_surface(self) -> Array:
        """Touched point of the surface [m], (3,)."""
        return self.solved.p_surface_base


@cache
def paper_models(flatness: float = 1.0, axis: tuple[float, ...] = (0.0, 0.0)) -> dict[str, ProbeModel]:
    """Return the models of the paper's probes by name.

    Args:
        flatness: of their sections, of the same width along x.
        axis: bend [deg], turns and azimuth [deg]; it bends towards -y at the base without an azimuth.
    """
    designs = {name: load_design(ROOT / f"designs/{name}.toml") for name in ("large", "medium", "small")}
    values: dict[str, object] = {}
    if flatness < 1.0:
        values = {"section": "elliptic", "flatness": flatness}
    if axis[0] > 0.0:
        values |= {"axis": "helix", "axis_bend_deg": axis[0], "axis_turns": axis[1],
                   "axis_azimuth_deg": axis[2] if len(axis) > 2 else -90.0}  # fmt: skip
    tables = {name: tables_of(design) for name, design in designs.items()}  # E and G as well known as of the paper's
    changed = {name: check_design(of | {"probe": of["probe"] | values}) for name, of in tables.items()}
    return {name: build_probe(design).model for name, design in changed.items()}


def touch(model: ProbeModel, gravity: Array, s: float, angle: float, force: float) -> Touch | None:
    """Return a touch solved in reference mode, or None if the probe buckles or the bound is infinite."""
    solved = solve_surface_force(model.rod, gravity, s, angle + np.pi, force, (0.0, 0.0), "reference")
    if solved.result != "ok":
        return None
    bound = cramer_rao(model, gravity, solved)
    return Touch(model, gravity, s, angle, force, solved, bound) if np.isfinite(bound) else None


def cramer_rao(model: ProbeModel, gravity: Array, solved: RodContact) -> float:
    """Return the Cramér–Rao bound of the RMS error of the touched point, from one reading without friction [m].

    The bound is √tr(X (Hᵀ Σ⁻¹ H)⁻¹ Xᵀ) with the derivatives H of the base wrench and X of the touched point by
    arclength, angle and normal force, and the covariance Σ of the reading.
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
    root = lin[surface.POINT : surface.POINT + 3, normal] / scale @ right.T / values
    return float(np.linalg.norm(root))


def random_touches(decade: tuple[float, float], rng: np.random.Generator) -> Iterator[Touch]:
    """Yield touches of random probes under random gravity without end; forces are log-uniform in the range [N]."""
    while True:
        model, gravity = random_model(rng), 9.81 * random_directions(1, rng)[0]
        rod, s = model.rod, float(rng.uniform(*PLACE)) * model.rod.length
        force = float(np.exp(rng.uniform(*np.log(decade))))
        stiffness = rod.youngs_modulus * np.pi / 4.0 * rod.radius[0] ** 3 * rod.radius_at(s)
        if force * s * s > MAX_BEND * stiffness:
            continue
        found = touch(model, gravity, s, float(rng.uniform(-np.pi, np.pi)), force)
        if found is not None:
            yield found


def random_model(rng: np.random.Generator) -> ProbeModel:
    """Return a random cone of the paper's resin on the paper's sensor."""
    large = paper_models()["large"]
    length, radius, taper = rng.uniform(*LENGTH), rng.uniform(*BASE) / 2.0, rng.uniform(*TAPER)
    rod = replace(large.rod, s=np.array([0.0, length]), radius=np.array([radius, taper * radius]),
                  rigid_length=large.rod.rigid_length / large.rod.radius[0] * radius)  # fmt: skip
    return replace(large, name="random", rod=rod)


def table_one() -> list[Touch]:
    """Return the paper's 23 conditions as frictionless touches across gravity, without those that have no equilibrium.

    The medium probe with the paper's E buckles under 0.26 N at 0.7 L; without friction it bears at most 0.12 N there.
    """
    with TABLE_I_FILE.open() as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    found = []
    for row in rows:
        model = paper_models()[row["probe"]]
        s = float(row["contact_fraction"]) * model.rod.length
        one = touch(model, GRAVITY, s, np.pi / 2.0, float(row["force_N"]))
        if one is not None:
            found.append(one)
    return found


@dataclass(frozen=True)
class Presses:
    """Touches of one point, the world's origin, with increasing force."""

    model: ProbeModel  #: model of the probe.
    gravity: Array  #: in base axes, which are parallel to those of the world [m/s²], (3,).
    touches: tuple[Touch, ...]  #: one for each pose.
    Ts: Array  #: poses of the base, (k, 4, 4).

    @property
    def wrenches(self) -> Array:
        """Base wrenches without noise, (k, 6)."""
        return np.array([one.wrench for one in self.touches])


def presses(model: ProbeModel, gravity: Array, s: float, angle: float, forces: Array) -> Presses | None:
    """Press a probe against a point that stays at one place of the probe; return None if the probe buckles."""
    touches = [touch(model, gravity, s, angle, float(force)) for force in forces]
    solved = tuple(one for one in touches if one is not None)
    if len(solved) < len(touches):
        return None
    return Presses(model, gravity, solved, np.array([pose(np.eye(3), -one.p_surface) for one in solved]))


def random_presses(decade: tuple[float, float], rng: np.random.Generator) -> Iterator[Presses]:
    """Yield presses of random probes under random gravity without end; the range is of the largest force [N]."""
    for one in random_touches(decade, rng):
        pressed = presses(one.model, one.gravity, one.s, one.angle, one.force * np.linspace(0.2, 1.0, 5))
        if pressed is not None:
            yield pressed


def stiffened(pressed: Presses, factor: float) -> tuple[Touch, ...]:
    """Return the touches of a press for a probe whose E and G are multiplied by a factor."""
    model, rod = pressed.model, pressed.model.rod
    stiff = replace(model, rod=replace(rod, youngs_modulus=factor * rod.youngs_modulus,
                                       shear_modulus=factor * rod.shear_modulus))  # fmt: skip
    touches = [touch(stiff, one.gravity, one.s, one.angle, one.force) for one in pressed.touches]
    return tuple(one for one in touches if one is not None)


def with_noise(wrenches: Array, model: ProbeModel, rng: np.random.Generator) -> Array:
    """Return wrenches with the noise of the sensor, at the base, (k, 6)."""
    return wrenches + rng.multivariate_normal(np.zeros(6), model.noise_base(), len(wrenches))
