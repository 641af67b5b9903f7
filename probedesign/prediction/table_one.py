"""The paper's Table I, predicted: one setting for the sensor, one for the stereo reference, none for any row.

Source of the measured errors: "Spatial Position Estimation of Lightweight and Delicate Objects using a Soft haptic
Probe", Table I (`data/table1.csv`): the distance between the estimated contact point and the one that two cameras
reconstructed. The text speaks of 25 experiments, the table has 23 rows. Which way each was pushed is not told: x, y or
z; predicted is the root of the mean square over the four sides that pushed without friction.
"""

import csv
import io
import math
from dataclasses import asdict, dataclass, replace
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from scipy.stats import spearmanr

from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.prediction.budget import CAUSES, unweighted_budget_of
from probedesign.prediction.touches import DIRECTIONS, touches_of
from probedesign.units import MM

REFERENCE_MM = 1.0
"""RMS error of the stereo reference at the contact. Assumed, a round number: the paper tells none; its smallest errors
are 0.7 mm and hold it, and its shapes are off by 3.6 mm, of which a contact point cannot have much. `by_reference`
tells what other numbers give."""
FACTOR = 2.0
THICKER_MM = (-0.5, -0.2, 0.2, 0.5)
REFERENCES_MM = (0.0, 0.5, 0.7, 1.0, 1.3, 1.6, 2.0)


@dataclass(frozen=True)
class Row:
    """One condition of the table.

    Attributes:
        probe, force_N, contact_fraction: which.
        measured_error_mm: the paper's.
        predicted_error_mm: by all causes and the reference, RMS; None where the probe gives way without friction.
        own_error_mm: the same without the reference.
        noise_error_mm: by the sensor's noise alone.
        largest_cause: of the probe's own.
        within: whether predicted and measured differ by no more than a factor of two.
        why: what is known of a miss, else empty.
    """

    probe: str
    force_N: float
    contact_fraction: float
    measured_error_mm: float
    predicted_error_mm: float | None
    own_error_mm: float | None
    noise_error_mm: float | None
    largest_cause: str
    within: bool
    why: str


@dataclass(frozen=True)
class Score:
    """How well a setting agrees with the table.

    Attributes:
        setting: which.
        within: rows within a factor of two, of all.
        predicted: rows that there is a prediction of.
        rank_correlation: Spearman's, of the rows predicted.
    """

    setting: str
    within: int
    predicted: int
    rank_correlation: float


@dataclass(frozen=True)
class TableOne:
    """The table, predicted.

    Attributes:
        rows: as the paper orders them.
        score: of these.
        reference_mm: of the stereo reference.
        noise_force_mN, noise_moment_Nmm: of one reading.
        by_reference: scores with other references.
        by_diameter: scores with all diameters so much thicker or thinner, and with the tip alone so.
    """

    rows: tuple[Row, ...]
    score: Score
    reference_mm: float
    noise_force_mN: float
    noise_moment_Nmm: float
    by_reference: tuple[Score, ...]
    by_diameter: tuple[Score, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {"schema": 1, **asdict(self)}


def table_one(
    models: dict[str, tuple[ProbeModel, Tolerances]], reference_mm: float = REFERENCE_MM
) -> TableOne:
    """Predict the table.

    Args:
        models: of the three probes, with how well each is known, by name: large, medium, small.
        reference_mm: RMS error of the stereo reference.
    """
    rows = rows_of(models, reference_mm)
    noise = models["large"][0].noise
    own = [row.own_error_mm for row in rows]
    references = tuple(_score(f"reference {r:g} mm", [_with(row, e, r) for row, e in zip(rows, own, strict=True)])
                       for r in REFERENCES_MM)  # fmt: skip
    thicker = [_score(f"all diameters {by:+g} mm", rows_of(_thickened(models, by, by), reference_mm))
               for by in THICKER_MM]  # fmt: skip
    tips = [
        _score(f"tips {by:+g} mm", rows_of(_thickened(models, 0.0, by), reference_mm)) for by in THICKER_MM
    ]
    return TableOne(tuple(rows), _score("as designed", rows), reference_mm, 1e3 * noise.force, 1e3 * noise.moment,
                    references, (*thicker, *tips))  # fmt: skip


def rows_of(models: dict[str, tuple[ProbeModel, Tolerances]], reference_mm: float) -> list[Row]:
    """Each row beside what is predicted."""
    return [_row(*models[said["probe"]], said, reference_mm) for said in measured()]


@cache
def measured() -> tuple[dict[str, str], ...]:
    """The table's rows as they stand in the file."""
    text = files("probedesign.prediction").joinpath("data/table1.csv").read_text()
    return tuple(csv.DictReader(line for line in io.StringIO(text) if not line.startswith("#")))


def _row(model: ProbeModel, tolerances: Tolerances, said: dict[str, str], reference_mm: float) -> Row:
    force, fraction = float(said["force_N"]), float(said["contact_fraction"])
    lines = [(fraction, direction) for direction in DIRECTIONS]
    touches = touches_of(Estimator(model, tolerances), lines, [force])[force]
    held, own, noise, largest = touches.ok, None, None, "none"
    if held.any():
        # As the published method: neither the error sources nor friction weigh on its readings.
        cov = unweighted_budget_of(touches.lin[held], touches.D[held], touches.sources, model.friction)
        squares = np.trace(cov, axis1=2, axis2=3).mean(axis=0)
        own, noise = math.sqrt(squares.sum()) / MM, math.sqrt(squares[0]) / MM
        largest = CAUSES[int(np.argmax(squares))]
    row = Row(
        said["probe"], force, fraction, float(said["contact_error_mm"]), None, own, noise, largest, False, ""
    )
    return _with(row, own, reference_mm)


def _with(row: Row, own: float | None, reference_mm: float) -> Row:
    """The row with a reference."""
    if own is None:
        why = (
            "without friction the probe gives way under less; the paper's blade must have held it by friction"
        )
        return replace(row, predicted_error_mm=None, within=False, why=why)
    predicted = math.hypot(own, reference_mm)
    ratio = predicted / row.measured_error_mm
    within = 1.0 / FACTOR <= ratio <= FACTOR
    more = "more" if ratio > 1.0 else "less"
    why = (
        ""
        if within
        else f"{max(ratio, 1 / ratio):.2g} times {more} than measured; largest here: {row.largest_cause}"
    )
    return replace(row, predicted_error_mm=predicted, within=within, why=why)


def _score(setting: str, rows: list[Row]) -> Score:
    held = [row for row in rows if row.predicted_error_mm is not None]
    predicted = np.array([row.predicted_error_mm for row in held], dtype=float)
    seen = np.array([row.measured_error_mm for row in held])
    return Score(
        setting, sum(row.within for row in rows), len(held), float(spearmanr(predicted, seen).statistic)
    )


def _thickened(
    models: dict[str, tuple[ProbeModel, Tolerances]], base_mm: float, tip_mm: float
) -> dict[str, tuple[ProbeModel, Tolerances]]:
    """The same probes with other diameters."""
    found = {}
    for name, (model, tolerances) in models.items():
        by = np.interp(model.rod.s, [0.0, model.rod.length], [base_mm, tip_mm]) * MM / 2.0
        radius = model.rod.radius + by
        rigid = model.rod.rigid_length * float(radius[0] / model.rod.radius[0])
        found[name] = replace(model, rod=replace(model.rod, radius=radius, rigid_length=rigid)), tolerances
    return found
