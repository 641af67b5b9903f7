"""All tests of a campaign beside what a frozen probe estimates of them."""

import csv
import io
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from probedesign.campaigns.campaign import Campaign
from probedesign.campaigns.reading import check_probe
from probedesign.errors import InputError
from probedesign.estimation.estimate import RESULTS, Estimate
from probedesign.estimation.estimator import Estimator
from probedesign.units import MM
from probedesign.validation.coverage import Honesty, honesty_of
from probedesign.validation.validated_test import Trial, trial_of

COLUMNS = ("probe", "length_mm", "test", "kind", "force_N", "contact_fraction", "direction", "method", "result",
           "shape_rms_mm", "shape_rms_percent", "reference_rms_mm", "contact_error_mm", "stated_error_mm",
           "predicted_error_mm", "reference_error_mm", "within_95", "nees", "z_x", "z_y", "z_z", "markers", "readings",
           "tares", "force_normal_N", "force_tangential_N", "friction_ratio")  # fmt: skip
"""Of validation.csv; those of the paper's Table I keep their names."""
WHY: dict[str, str] = {
    **{str(code): words for code, words in RESULTS.items()},
    "no_reading": "the sensor was not read",
}
"""Codes in words."""
AS_IT_SHOULD = {
    "free": ("no_contact", "too_light", "out_of_range", "unobservable", "no_reading"),
    "weight": ("ok",),
    "touch": ("ok",),
}
"""Codes that a test of a kind should have. Where nothing touches, the drift of the bias may be felt, but no place
told."""


@dataclass(frozen=True)
class Mean:
    """Of several numbers.

    Attributes:
        count: how many.
        mean, rms, largest: of them; None of none.
    """

    count: int
    mean: float | None
    rms: float | None
    largest: float | None

    @classmethod
    def of(cls, values: Iterable[float]) -> "Mean":
        """Of those that are numbers."""
        known = np.array([value for value in values if not math.isnan(value)])
        if not len(known):
            return cls(0, None, None, None)
        return cls(len(known), float(known.mean()), float(np.sqrt(np.mean(known**2))), float(known.max()))


@dataclass(frozen=True, eq=False)
class Validation:
    """What `validate` found.

    Attributes:
        estimator: of the frozen probe.
        campaign: the data.
        exact: the probe was taken for exactly what its model says.
        trials: free ones first, then along the probe and from strong to weak, as Table I.
        honesty: whether stated errors come true.
    """

    estimator: Estimator
    campaign: Campaign
    exact: bool
    trials: tuple[Trial, ...]
    honesty: Honesty

    @property
    def astray(self) -> tuple[Trial, ...]:
        """Tests with another code than they should have."""
        return tuple(trial for trial in self.trials if trial.result not in AS_IT_SHOULD[trial.kind])

    @property
    def summary(self) -> dict[str, dict[str, Mean]]:
        """Shape and contact errors [mm] by kind of test."""
        found = {}
        for kind in ("free", "weight", "touch"):
            here = [trial for trial in self.trials if trial.kind == kind]
            if here:
                found[kind] = {
                    "shape_rms_mm": Mean.of(trial.shape_rms / MM for trial in here),
                    "contact_error_mm": Mean.of(t.miss.size / MM for t in here if t.miss is not None),
                }
        return found

    @property
    def notes(self) -> tuple[str, ...]:
        """What a user should know, each one line."""
        told = list(self.campaign.notes)
        for trial in self.astray:
            told.append(f"{trial.test.name} ({trial.kind}): {trial.result}: {WHY[trial.result]}")
        untared = [
            trial for trial in self.trials if not trial.tares and trial.readings and trial.kind != "free"
        ]
        if untared:
            told.append(f"{len(untared)} tests had no free test with readings to be tared by: what print and mount "
                        "make the free probe read otherwise is in their errors")  # fmt: skip
        if all(trial.test.markers is None for trial in self.trials):
            told.append("no markers: no shape errors")
        return tuple(told)

    def rows(self) -> list[dict[str, Any]]:
        """One a test, by `COLUMNS`; None where there is no number."""
        return [self._row(trial) for trial in self.trials]

    def _row(self, trial: Trial) -> dict[str, Any]:
        miss, length = trial.miss, self.estimator.model.rod.length
        z = list(miss.z) if miss is not None and miss.dof == 3 else [math.nan] * 3
        found = trial.estimate or Estimate("out_of_range")
        friction = (found.force_normal, found.force_tangential, found.friction_ratio)
        stated = (
            (miss.size, miss.expected, trial.predicted, math.sqrt(np.trace(miss.cov_reference)))
            if miss
            else (math.nan, math.nan, trial.predicted, math.nan)
        )
        values = (
            self.estimator.model.name, length / MM, trial.test.name, trial.kind, trial.force, trial.fraction,
            trial.way, trial.method, trial.result, trial.shape_rms / MM,
            100.0 * trial.shape_rms / length, trial.reference_rms / MM, *(value / MM for value in stated),
            miss.within_95 if miss else None, miss.nees if miss else None, *z, len(trial.markers_base),
            trial.readings, trial.tares, *friction,
        )  # fmt: skip
        return {name: _plain(value) for name, value in zip(COLUMNS, values, strict=True)}

    def csv(self) -> bytes:
        """The rows as CSV with a header."""
        return csv_of(self.rows(), COLUMNS)

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {
            "schema": 1,
            "probe": self.estimator.model.name,
            "fingerprint": self.estimator.model.fingerprint,
            "assumptions": self.estimator.model.assumptions,
            "data": str(self.campaign.folder),
            "exact_model": self.exact,
            "tests": self.rows(),
            "summary": {kind: {name: asdict(mean) for name, mean in means.items()}
                        for kind, means in self.summary.items()},
            "honesty": {name: _plain(value) for name, value in asdict(self.honesty).items()},
            "notes": self.notes,
        }  # fmt: skip


def csv_of(rows: Iterable[dict[str, Any]], columns: Sequence[str]) -> bytes:
    """Some columns of rows as CSV with a header."""
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({name: f"{v:.6g}" if isinstance(v, float) else v for name, v in row.items()})
    return text.getvalue().encode()


def validate(
    estimator: Estimator,
    campaign: Campaign,
    exact: bool = False,
    tell: Callable[[float], None] = lambda share: None,
) -> Validation:
    """Compare a frozen probe with a campaign of its print.

    Args:
        estimator: as `load_estimator` gives it.
        campaign: from `read_campaign`.
        exact: take probe, mount and bench for exactly what the model says; else all tolerances count.
        tell: told the share done.

    Raises:
        InputError: the campaign is of another probe, or holds nothing to compare.
    """
    model = estimator.model
    check_probe(campaign, model)
    if not any(len(test.wrenches) for test in campaign.tests):
        raise InputError(f"{campaign.folder}: holds no wrenches.csv; there is nothing to estimate from")
    if not any(_seen(test.markers, test.p_contact_world, test.s_contact) for test in campaign.tests):
        raise InputError(
            f"{campaign.folder}: no test has markers, a contact or s_contact_mm; nothing to compare with"
        )
    trials = []
    for i, test in enumerate(campaign.tests):
        tell(i / len(campaign.tests))
        trials.append(trial_of(campaign, test, estimator, exact))
    trials.sort(key=_place)
    return Validation(estimator, campaign, exact, tuple(trials), honesty_of(trials, exact))


def _seen(markers: object, contact: object, s_contact: float) -> bool:
    return markers is not None or contact is not None or not math.isnan(s_contact)


def _place(trial: Trial) -> tuple[int, float, float]:
    """As Table I orders them; what has no place comes last."""
    kinds = ("free", "weight", "touch")
    fraction = 2.0 if math.isnan(trial.fraction) else round(trial.fraction, 2)
    return kinds.index(trial.kind), fraction, -trial.force


def _plain(value: Any) -> Any:
    """No number as None, numpy's own as Python's."""
    value = value.item() if hasattr(value, "item") else value
    return None if isinstance(value, float) and math.isnan(value) else value
