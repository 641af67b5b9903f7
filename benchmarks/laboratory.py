"""Campaigns of a laboratory that knows no more than its tolerances say: true probes, poses and sensors are drawn."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from probedesign.core.frames import Array, pose, wrench_map
from probedesign.core.units import MM
from probedesign.estimation.error_sources import parameters_of, turns_of
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.identification.identify import IdentificationData
from probedesign.identification.parameters import DEGREE, CommonParameters
from probedesign.identification.residuals import MassMeasurement, MeasuredTest
from probedesign.prediction.monte_carlo import perturbed_rod
from probedesign.prediction.touches import DIRECTIONS
from probedesign.rod.contact import FrictionlessContact, solve_frictionless
from probedesign.rod.rod import Rod

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
        hangs: how often the free probe is measured.
        marker: standard deviation of a marker on each axis [m]; 0: no markers.
        touch: of the touched place on each axis [m].
        s: of its arclength [m].
    """

    name: str
    words: str
    touches: tuple[tuple[float, float], ...]
    sides: tuple[str, ...]
    hangs: int
    marker: float
    touch: float
    s: float


CAMERAS = Kind("cameras", "markers to 3.6 mm", ((0.4, 0.2), (0.55, 0.1), (0.7, 0.06), (0.85, 0.04)),
             ("+x", "-x", "+y", "-y", "+x", "-x", "+y", "-y"), 4, 3.6 * MM, 3.6 * MM, 1.0 * MM)  # fmt: skip
STAGE = Kind("stage", "places to 0.05 mm", ((0.35, 0.2), (0.5, 0.1), (0.65, 0.05), (0.8, 0.025)),
             ("+x", "-x", "+y", "-y", "+x", "-x", "+y", "-y"), 4, 0.0, 0.05 * MM, 0.05 * MM)  # fmt: skip
"""The large probe bent by 5 to 70 mm. 3.6 mm is the paper's RMS of a marker, here on each axis, and of the contact by
its cameras; a pencil mark gives the contact's position on the probe to a millimetre (assumed)."""
DIMENSIONS = ("diameter", "diameter scatter", "length")
MARKERS = np.linspace(10.0, 150.0, 15) * MM


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
         tolerances: Tolerances | None = None, weighed: bool = False) -> tuple[IdentificationData, Truth]:  # fmt: skip
    """A campaign and the truth behind it.

    Args:
        model: of the probe as designed.
        kind: of laboratory.
        seed: of everything.
        dimensions: whether the print's dimensions differ as the tolerances have it; else they are as designed.
        spread: of log E about the design's, standard deviation.
        tolerances: of all else; the design's if None.
        weighed: whether the flexible part was weighed, to 0.01 g.
    """
    rng = np.random.default_rng(seed)
    tolerances = tolerances or Tolerances.of(model)
    truth = _truth(model, tolerances, rng, dimensions, spread)
    shared = CommonParameters(model, tolerances, STD_BASE, STD_TILT)
    off = _tare(model, truth) if tolerances.tared else np.zeros(6)
    trials = [
        _measured(name, contact, truth, shared, kind, off, rng) for name, contact in _tests(truth, kind)
    ]
    scales = MassMeasurement(truth.rod.mass + 1e-5 * rng.normal(), 1e-5, 0.0) if weighed else None
    return IdentificationData(shared, tuple(trials), scales, f"{kind.name} {seed}"), truth


def _truth(
    model: ProbeModel, tolerances: Tolerances, rng: np.random.Generator, dimensions: bool, spread: float
) -> Truth:
    K = len(model.rod.s)
    factors = np.zeros(4 + K)
    causes = parameters_of(
        model.rod, replace(tolerances, youngs_modulus=spread, creep=0.0, stiffness_scatter=0.0)
    )
    for cause, rows in causes.items():
        drawn = rng.normal(size=len(rows)) @ rows
        factors += drawn if dimensions or cause not in DIMENSIONS else 0.0
    turns = sum(
        rng.normal(size=len(rows)) @ rows for rows in turns_of(model.gravity_base, tolerances).values()
    )
    T_seat = pose(Rotation.from_rotvec(turns[3:6]).as_matrix(), turns[0:3])
    turn, shift = STD_TILT * rng.normal(size=3), STD_BASE * rng.normal(size=3)
    T_mount = pose(Rotation.from_rotvec(turn).as_matrix(), shift) @ T_seat
    pulled = model.gravity_base + turns[6:9]
    return Truth(
        perturbed_rod(model.rod, factors), factors, T_mount, T_seat, T_mount[:3, :3].T @ pulled, pulled
    )


def _tests(truth: Truth, kind: Kind) -> Iterator[tuple[str, FrictionlessContact | None]]:
    """The free probe first, which the sensor is tared with; touches that the true probe does not bear are left out."""
    for i in range(kind.hangs):
        yield f"free-{i + 1}", None
    for fraction, force in kind.touches:
        for i, side in enumerate(kind.sides):
            s = fraction * truth.rod.length
            contact = solve_frictionless(truth.rod, truth.gravity_base, s, DIRECTIONS[side], force)
            if contact.result == "ok":
                yield f"touch-{fraction:g}-{force:g}-{side}-{i + 1}", contact


def _tare(model: ProbeModel, truth: Truth) -> Array:
    """What every reading has too much, since the sensor was tared to the design's free wrench."""
    free = truth.rod.solve(truth.gravity_base)
    return np.asarray(
        model.rod.solve(model.gravity_base).wrench_base - wrench_map(truth.T_seat) @ free.wrench_base
    )


def _measured(name: str, contact: FrictionlessContact | None, truth: Truth, shared: CommonParameters, kind: Kind,
              off: Array, rng: np.random.Generator) -> MeasuredTest:  # fmt: skip
    """Return one measured test in the world, which is the stated base frame."""
    model, T = shared.model, truth.T_mount
    eq = truth.rod.solve(truth.gravity_base) if contact is None else contact.equilibrium
    cov = model.noise_base() / ROWS + shared.drift_cov
    wrench = wrench_map(truth.T_seat) @ eq.wrench_base + off + np.linalg.cholesky(cov) @ rng.normal(size=6)
    trial = MeasuredTest(name, np.eye(4), model.gravity_base, None if contact else np.zeros(3),
                  wrench_base=wrench, cov_wrench=cov)  # fmt: skip
    if contact is not None:
        reach = truth.rod.radius_at(eq.s_contact) / np.hypot(1.0, truth.rod.taper_at(eq.s_contact))
        touched = eq.p_contact_base - reach * contact.force_base / np.linalg.norm(contact.force_base)
        place = T[:3, :3] @ touched + T[:3, 3] + kind.touch * rng.normal(size=3)
        trial = replace(trial, s_contact=eq.s_contact + kind.s * rng.normal(), std_s=kind.s, p_touch_world=place,
                        std_touch=kind.touch)  # fmt: skip
    if kind.marker == 0.0:
        return trial
    seen = eq.p_at(np.minimum(MARKERS, truth.rod.length)) @ T[:3, :3].T + T[:3, 3]
    seen = seen + kind.marker * rng.normal(size=seen.shape)
    cov_markers = np.tile(kind.marker**2 * np.eye(3), (len(MARKERS), 1, 1))
    numbers = tuple(range(1, len(MARKERS) + 1))
    return replace(
        trial, marker_s=MARKERS, p_markers_world=seen, cov_markers=cov_markers, marker_numbers=numbers
    )
