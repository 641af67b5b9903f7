"""Validation of frozen probes: the tests of a campaign beside their estimates, and the coverage of stated covariances.

The empirical coverage is how often the reference lies within the stated 95 % ellipsoid; the NEES, normalised estimation
error squared, is χ² with as many degrees of freedom as axes if the covariances are correct.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from itertools import count
from typing import Any, Literal

import numpy as np
from scipy.special import chdtri
from scipy.stats import binomtest, chi2

from probedesign.campaigns.campaign import Campaign, Test
from probedesign.campaigns.checks import check_probe
from probedesign.campaigns.manifest import LENGTH_SCALE
from probedesign.core import csv_tables
from probedesign.core.errors import InputError
from probedesign.core.frames import Array, inverse
from probedesign.core.statistics import rms
from probedesign.core.units import MM
from probedesign.estimation.estimate import RESULTS, Estimate
from probedesign.estimation.estimator import Estimator, Method
from probedesign.estimation.model import WALK_SECONDS, ProbeModel, Tolerances
from probedesign.prediction.predict import predict_touch
from probedesign.rod.equilibrium import Equilibrium

TestKind = Literal["free", "weight", "touch"]
#: Estimation method by kind. A known force is a dead load on the centreline, of any direction, which the force–moment
#: method locates; a touch acts on the surface, by a force whose friction has a prior.
METHODS: dict[TestKind, Method] = {"free": "ml", "weight": "force_moment", "touch": "ml"}
#: Cosine between directions of gravity up to which a free test tares another test.
SAME_GRAVITY = math.cos(math.radians(1.0))
TAIL = 0.05  #: Probability outside a 95 % ellipsoid.
MIN_REFERENCE_STD = 1e-3 * MM  #: Smallest standard deviation of a reference [m], which keeps its covariance regular.


# error of a contact


@dataclass(frozen=True, eq=False)
class ContactError:
    """Error of an estimated contact against the reference, in the base frame."""

    error: Array  #: estimated minus measured [m]: of the point (3,), or of the arclength alone (1,).
    cov: Array  #: of estimate and reference together, as stated [m²], (d, d).
    cov_reference: Array  #: the reference's share, with the pose of the base [m²], (d, d).

    @property
    def size(self) -> float:
        """Norm of the error [m]."""
        return float(np.linalg.norm(self.error))

    @property
    def expected(self) -> float:
        """RMS of the norm by the stated covariance [m]."""
        return rms(self.cov)

    @property
    def nees(self) -> float:
        """Normalised estimation error squared: χ² with `dof` degrees of freedom if the covariance is correct."""
        return float(self.error @ np.linalg.solve(self.cov, self.error))

    @property
    def dof(self) -> int:
        """Degrees of freedom: number of axes."""
        return len(self.error)

    @property
    def within_95(self) -> bool:
        """Whether the reference lies within the 95 % ellipsoid."""
        return bool(self.nees <= chdtri(self.dof, TAIL))

    @property
    def z(self) -> Array:
        """Error over its standard deviation, axis by axis, (d,)."""
        return np.asarray(self.error / np.sqrt(np.diag(self.cov)))


def contact_error(
    campaign: Campaign, test: Test, estimate: Estimate | None, contact: Array | None
) -> ContactError | None:
    """Return the error of the touched point if the reference measured it, else of the arclength if that is known.

    `contact` is the measured point in the base frame [m], (3,).
    """
    if estimate is None or not estimate.ok:
        return None
    if contact is not None:
        cov_reference = cov_of_reference(campaign, contact) + max(test.std_contact, MIN_REFERENCE_STD) ** 2 * np.eye(3)
        return ContactError(estimate.p_surface_base - contact, estimate.cov_surface_base + cov_reference, cov_reference)
    if not math.isnan(test.s_contact):
        reference = np.array([[max(test.std_s, MIN_REFERENCE_STD) ** 2]])
        error = np.array([estimate.s_contact - test.s_contact])
        return ContactError(error, reference + estimate.std_s**2, reference)
    return None


def cov_of_reference(campaign: Campaign, p_base: Array) -> Array:
    """Return the covariance of points of the base frame by the uncertainty of its pose and of the reference's length
    scale [m²], (..., 3) → (..., 3, 3)."""
    squared = np.einsum("...i,...i->...", p_base, p_base)[..., None, None] * np.eye(3)
    along = p_base[..., :, None] * p_base[..., None, :]
    pose = campaign.std_base**2 * np.eye(3) + campaign.std_tilt**2 * (squared - along)
    return np.asarray(pose + LENGTH_SCALE**2 * along)


# the test


@dataclass(frozen=True, eq=False)
class TaredReading:
    """Readings of one test at the base, tared by free tests."""

    wrenches_base: Array  #: [N, N·m], (n, 6).
    gravity_base: Array  #: by the stated pose [m/s²], (3,).
    weights: Array  #: of the free tests that it was tared by; empty without.
    walked: float  #: time [s] over which the bias walks at random between the test and its tares, in effect.
    #: whether these hung in the pose of the test, so that they absorb the errors of the probe's own weight.
    same_pose: bool = True

    @property
    def tares(self) -> int:
        """Number of free tests that it was tared by."""
        return int(np.count_nonzero(self.weights))


@dataclass(frozen=True, eq=False)
class ValidatedTest:
    """Estimate of one test beside the reference."""

    test: Test  #: the test.
    kind: TestKind  #: free, with a known weight, or touched.
    method: Method  #: of the estimation.
    result: str  #: of the estimate; "no_reading" if the sensor was not read.
    estimate: Estimate | None  #: None without readings.
    shape: Equilibrium | None  #: as estimated, of a free test as modelled; None if no contact was located.
    force: float  #: on the probe [N]: as known, else by equation 5 from the readings; NaN if neither is available.
    fraction: float  #: contact over length: known, else estimated; NaN if neither is available.
    markers_base: Array  #: as measured [m], (m, 3).
    markers_hat: Array  #: as estimated [m], (m, 3); empty without a shape.
    markers_off: Array  #: estimated ones relative to the shape's axis [m], (m, 3).
    shape_rms: float  #: equation 6 [m]; NaN without shape or markers.
    reference_rms: float  #: contribution of the reference's own errors [m].
    contact_base: Array | None  #: by the reference [m], (3,); None if not measured.
    #: of the object, as stated or by the force, a key of `DIRECTIONS`; empty if neither is available.
    push_direction: str
    #: RMS error that `predict` states for such a touch [m]: full budget, one reading, the design's own mount and
    #: tolerances, no reference; NaN for what it does not locate, and for weights, which it does not predict.
    predicted: float
    contact_error: ContactError | None  #: None if either side has no contact.
    readings: int  #: number of readings.
    tares: int  #: number of free tests that it was tared by.
    #: whether the parameters of the frozen probe were identified from it, so that it proves nothing of them.
    served: bool = False

    @property
    def markers_on_axis(self) -> Array:
        """Measured markers, moved onto the axis by the estimated shape [m], (m, 3); unchanged without a shape."""
        return self.markers_base - self.markers_off if len(self.markers_off) else self.markers_base

    @property
    def measured(self) -> bool:
        """Whether it is a touch that was both located and measured by the reference."""
        return self.kind == "touch" and self.contact_error is not None


def validate_test(campaign: Campaign, test: Test, estimator: Estimator, exact: bool) -> ValidatedTest:
    """Estimate one test and compare it with the reference.

    `exact` takes probe, mount and bench as exactly known; noise and drift of the sensor and the prior on friction
    remain.
    """
    model = estimator.model
    kind: TestKind = "touch" if test.force_world is None else "free" if test.free else "weight"
    reading, method = tared_reading(campaign, test, estimator), METHODS[kind]
    estimate = None
    if len(reading.wrenches_base):
        known = campaign_tolerances(campaign, model, reading)
        if exact:
            known = replace(Tolerances.none(), drift_steps=known.drift_steps, tared=known.tared)
        estimate = estimator.with_tolerances(known).estimate(reading.wrenches_base, reading.gravity_base, method=method)
    shape = None if estimate is None else estimate.shape
    if kind == "free":  # it is known that nothing touches
        free = estimator.free(reading.gravity_base)
        shape = free if free.ok else None
    T_base_world = inverse(test.T_world_base)
    markers, hat, off, cov = _markers(campaign, test, model, shape, T_base_world)
    contact = None
    if test.p_contact_world is not None:
        contact = np.asarray(T_base_world[:3, :3] @ test.p_contact_world + T_base_world[:3, 3])
    force_base, direction = test.force_base, test.direction
    if force_base is None:  # by equation 5
        readings = reading.wrenches_base[:, :3]
        force_base = (
            readings.mean(axis=0) - model.mass * reading.gravity_base if len(readings) else np.full(3, math.nan)
        )
    force, across = float(np.linalg.norm(force_base)), force_base[:2]
    if not direction and across.any() and not math.isnan(across[0]):
        axis = int(np.argmax(np.abs(across)))
        direction = f"{'+' if across[axis] > 0.0 else '-'}{'xy'[axis]}"
    s = estimate.s_contact if math.isnan(test.s_contact) and estimate is not None else test.s_contact
    fraction, predicted_mm = s / model.rod.length, None
    if kind == "touch" and 0.0 < fraction <= 1.0 and force > 0.0 and direction:
        touch = predict_touch(Estimator(model), fraction, force, direction)
        predicted_mm = touch.predicted_error_mm if touch.result == "ok" else None
    shape_rms = math.sqrt(float(np.mean(np.sum((hat - markers) ** 2, axis=1)))) if len(hat) else math.nan
    reference_rms = math.sqrt(float(np.mean(np.trace(cov, axis1=1, axis2=2)))) if len(markers) else math.nan
    return ValidatedTest(
        test, kind, method, "no_reading" if estimate is None else estimate.result, estimate, shape, force, fraction,
        markers, hat, off, shape_rms, reference_rms, contact, direction,
        predicted=math.nan if predicted_mm is None else predicted_mm * MM,
        contact_error=contact_error(campaign, test, estimate, contact),
        readings=len(reading.wrenches_base), tares=reading.tares,
        served=test.digest in model.identified_tests,
    )  # fmt: skip


def tared_reading(campaign: Campaign, test: Test, estimator: Estimator) -> TaredReading:
    """Return the readings of one test, tared by free tests with readings; a free test by the others.

    A free test in a pose of its own is tared by the free tests of other poses: they share the sensor's bias, and errors
    of the probe's weight remain, each with the difference of the model in both poses.
    """
    gravity, wrenches = test.gravity_base, test.wrenches_base(estimator.model)
    free = [other for other in campaign.tests if other.free and len(other.wrenches) and other is not test]
    down, limit = gravity / np.linalg.norm(gravity), SAME_GRAVITY * np.linalg.norm(gravity)
    tares = [other for other in free if other.gravity_base @ down >= limit]  # gravity has one size in a campaign
    same_pose = bool(tares) or not test.free
    tares = tares if same_pose else free
    offsets = [
        other.mean_wrench_base(estimator.model) - estimator.free(other.gravity_base).wrench_base for other in tares
    ]
    weights, walked = tare_weights(test.time, np.array([other.time for other in tares]))
    tared = wrenches - weights @ np.array(offsets) if offsets else wrenches
    return TaredReading(tared, gravity, weights, walked, same_pose)


def tare_weights(time: float, times: Array) -> tuple[Array, float]:
    """Return the weights of tares for a reading at some time, and the time over which the bias walks, in effect [s].

    A bias that walks at random between two tares, at t_1 and t_2, is known best by interpolation, with the variance
    of a walk over (t - t_1) (t_2 - t) / (t_2 - t_1); before the first and after the last tare, by the nearest one. All
    tares count alike where times are not known.

    Args:
        time: of the reading [s]; NaN if it is not known.
        times: of the tares [s], (k,).
    """
    weights = np.zeros(len(times))
    if not len(times):
        return weights, 0.0
    if not np.isfinite([time, *times]).all() or len(np.unique(times)) < len(times):
        return weights + 1.0 / len(times), 0.0
    before, after = np.flatnonzero(times <= time), np.flatnonzero(times > time)
    if not len(before) or not len(after):
        nearest = int(np.argmin(np.abs(times - time)))
        weights[nearest] = 1.0
        return weights, abs(float(times[nearest]) - time)
    first, last = before[np.argmax(times[before])], after[np.argmin(times[after])]
    span = float(times[last] - times[first])
    weights[last] = (time - times[first]) / span
    weights[first] = 1.0 - weights[last]
    return weights, float(weights[last] * weights[first]) * span


def campaign_tolerances(campaign: Campaign, model: ProbeModel, reading: TaredReading) -> Tolerances:
    """Return the probe's tolerances in this campaign: the direction of gravity includes the base's tilt, the bias the
    error of the tare.

    A tare by weighted tests drifts as they did, its noise is that of as many readings as they had, taken for as many as
    the test's own, and the bias walks from the tares to the test.
    """
    known = Tolerances.of(model)
    gravity_deg = math.hypot(known.gravity_deg, math.degrees(campaign.std_tilt))
    if not reading.tares:
        return replace(known, gravity_deg=gravity_deg, tared=False)
    squares = float(reading.weights @ reading.weights)
    noise = squares / (model.averaging_samples * len(reading.wrenches_base))
    walked = known.walk_steps**2 * reading.walked / WALK_SECONDS
    drift = math.sqrt(known.drift_steps**2 * (1.0 + squares) + walked + noise)
    return replace(known, gravity_deg=gravity_deg, drift_steps=drift, tared=reading.same_pose)


def _markers(
    campaign: Campaign, test: Test, model: ProbeModel, shape: Equilibrium | None, T_base_world: Array
) -> tuple[Array, Array, Array, Array]:
    """Return measured and estimated markers in the base frame, the latter's offset from the axis, and the reference's
    covariance of each."""
    none = np.zeros((0, 3))
    if test.markers is None:
        return none, none, none, np.zeros((0, 3, 3))
    R = T_base_world[:3, :3]
    measured = test.markers.p_world @ R.T + T_base_world[:3, 3]
    cov = R @ test.markers.cov_world @ R.T + cov_of_reference(campaign, measured)
    if shape is None:
        return measured, none, none, cov
    s = np.minimum(campaign.marker_s[test.markers.numbers], model.rod.length)
    axis, off = shape.p_at(s), np.zeros((len(s), 3))
    if campaign.marker_side is not None:
        side, axes = campaign.marker_side, shape.R_at(s)
        radius = model.cross_section.reach(side) * model.rod.radius_at(s)
        off = radius[:, None] * (math.cos(side) * axes[:, :, 0] + math.sin(side) * axes[:, :, 1])
    return measured, axis + off, off, cov


#: Result codes in words.
WHY: dict[str, str] = {**{str(code): words for code, words in RESULTS.items()}, "no_reading": "the sensor was not read"}
#: Result codes expected of each kind. For a free probe the drift of the bias may be detected, but not located.
EXPECTED_RESULTS = {
    "free": ("no_contact", "too_light", "interval_only", "out_of_range", "unobservable", "no_reading"),
    "weight": ("ok",),
    "touch": ("ok",),
}
#: Touches from which on the coverage can be judged: of 20, 15 to 20 within are compatible with correct covariances.
MIN_TOUCHES = 20
NOMINAL = 0.95
#: Level of the intervals by which fewer than `MIN_TOUCHES` are judged: touches of one print share its errors, so of a
#: few an interval of 95 % excludes the stated errors too often (assumed).
FEW_LEVEL = 0.999
LARGER = 1.5  #: Factor on the stated errors that a validation should notice (assumed).
#: Verdicts on the stated errors in words.
VERDICTS = {
    "consistent": "The stated errors agree with the reference",
    "too_few": "The touches are too few for a verdict on the stated errors",
    "too_small": "The stated errors are too small",
    "conservative": "The stated errors are larger than necessary",
    "not_judged": "The stated errors cannot be judged",
}


# coverage


@dataclass(frozen=True)
class Coverage:
    """Coverage of the touches that were located and measured by the reference."""

    verdict: str  #: a key of `VERDICTS`.
    sentence: str  #: the verdict with its numbers.
    touches: int = 0  #: number of them.
    within: int = 0  #: number within their 95 % ellipsoid.
    needed: int = 0  #: `touches_needed` to notice errors `LARGER` times as large as stated.
    low: float = math.nan  #: low, high: 95 % interval of the coverage (Clopper and Pearson).
    high: float = math.nan
    #: mean squared error over the stated; 1 if the covariances are correct, more if they are too small.
    nees_ratio: float = math.nan
    #: ratio_low, ratio_high: 95 % interval of that ratio, if the errors of the touches are independent.
    ratio_low: float = math.nan
    ratio_high: float = math.nan
    nees_low: float = math.nan  #: nees_low, nees_high: 95 % interval of that mean if the covariances are correct.
    nees_high: float = math.nan
    words: tuple[str, ...] = ()  #: further lines of the assessment.


def touches_needed(larger: float, dof: int) -> int:
    """Return how many touches tell the stated errors from ones `larger` times as large with a probability of 95 %.

    The squared errors over the stated ones of n touches, each of d degrees of freedom, sum to χ² of n d degrees of
    freedom if the covariances are correct, and to larger² times that if they are too small. The verdict is "too_small"
    above the quantile 1 - α/2, so n is the smallest number with larger² χ²(0.05; n d) ≥ χ²(1 - α/2; n d). α is 5 %, and
    0.1 % of fewer than `MIN_TOUCHES`. Errors that the touches share, as of one print, count as those of fewer touches.

    Args:
        larger: factor on the errors, more than 1.
        dof: degrees of freedom of each touch: 3 for a point, 1 for an arclength.
    """
    return next(
        n for n in count(1)
        if larger**2 * chi2.ppf(1.0 - NOMINAL, n * dof) >= chi2.ppf(0.5 * (1.0 + _level(n)), n * dof)
    )  # fmt: skip


def _level(n: int) -> float:
    return NOMINAL if n >= MIN_TOUCHES else FEW_LEVEL


def coverage_of(tests: Sequence[ValidatedTest], exact: bool) -> Coverage:
    """Return the coverage of the touches among some tests; `exact` if the probe was taken as exactly known."""
    errors = [test.contact_error for test in tests if test.measured and test.contact_error is not None]
    n, within = len(errors), sum(error.within_95 for error in errors)
    if not n:
        none = "no touch was both located and measured by the reference"
        return Coverage("not_judged", f"{VERDICTS['not_judged']}: {none}.", words=_of_weights(tests))
    share = binomtest(within, n).proportion_ci(NOMINAL)
    dof = sum(error.dof for error in errors)
    ratio = sum(error.nees for error in errors) / dof
    expected_low, expected_high = (float(chi2.ppf(tail, dof)) / dof for tail in (0.025, 0.975))
    ratio_low, ratio_high = ratio / expected_high, ratio / expected_low
    level, needed = _level(n), touches_needed(LARGER, min(error.dof for error in errors))
    if binomtest(within, n).proportion_ci(level).high < NOMINAL or chi2.sf(ratio * dof, dof) < 0.5 * (1.0 - level):
        verdict = "too_small"
    elif chi2.cdf(ratio * dof, dof) < 0.5 * (1.0 - level):
        verdict = "conservative"
    else:
        verdict = "consistent" if n >= MIN_TOUCHES else "too_few"
    sentence = (f"{VERDICTS[verdict]}: {within} of {n} touches lie within their 95 % ellipsoid ({within / n:.0%}, "
                f"95 % interval {share.low:.0%} to {share.high:.0%}); squared errors are {ratio:.2g} times the stated "
                f"ones (95 % interval {ratio_low:.2g} to {ratio_high:.2g}).")  # fmt: skip
    words = []
    excluded = sum(test.kind == "touch" for test in tests) - n
    if excluded:
        words.append(f"{excluded} more touches were not located, or not measured by the reference, and are excluded")
    if verdict == "too_small":
        remedy = "; try without --exact-model" if exact else ": probe, mount, bench or reference"
        words.append(f"something is less certain than stated{remedy}")
    words.append(f"to tell the stated errors from ones {LARGER:g} times as large with 95 %, {needed} held-out touches "
                 f"with independent errors are needed; these are {n}")  # fmt: skip
    words.append("touches of one print share the errors of its stiffness, size and pose, so these intervals are "
                 "narrower than one campaign justifies")  # fmt: skip
    return Coverage(verdict, sentence, n, within, needed, float(share.low), float(share.high), ratio, ratio_low,
                    ratio_high, expected_low, expected_high, (*words, *_of_weights(tests)))  # fmt: skip


def _of_weights(tests: Sequence[ValidatedTest]) -> tuple[str, ...]:
    errors = [test.contact_error for test in tests if test.kind == "weight" and test.contact_error is not None]
    if not errors:
        return ()
    within = sum(error.within_95 for error in errors)
    return (f"weights, counted separately: {within} of {len(errors)} weights lie within their 95 % interval",)


# report


@dataclass(frozen=True)
class ErrorStatistics:
    """Mean, RMS and largest of several errors."""

    count: int  #: number of them.
    mean: float | None  #: mean, rms, largest: None if there are none.
    rms: float | None
    largest: float | None

    @classmethod
    def of(cls, values: Iterable[float]) -> "ErrorStatistics":
        """Return the statistics of the values that are not NaN."""
        known = np.array([value for value in values if not math.isnan(value)])
        if not len(known):
            return cls(0, None, None, None)
        return cls(len(known), float(known.mean()), float(np.sqrt(np.mean(known**2))), float(known.max()))


@dataclass(frozen=True, eq=False)
class ValidationReport:
    """Result of a validation."""

    estimator: Estimator  #: of the frozen probe.
    campaign: Campaign  #: the data.
    exact: bool  #: whether the probe was taken as exactly known.
    tests: tuple[ValidatedTest, ...]  #: free ones first, then along the probe and from strong to weak, as Table I.
    include_identified: bool = False  #: whether tests that served the identification are judged as well.

    @property
    def judged(self) -> tuple[ValidatedTest, ...]:
        """Tests that the statistics are of: those held out of the identification, if not all are included; free ones
        always."""
        return tuple(test for test in self.tests if self.include_identified or not test.served or test.kind == "free")

    @cached_property
    def coverage(self) -> Coverage:
        """Coverage of the stated covariances, by the tests that are judged."""
        return coverage_of(self.judged, self.exact)

    @property
    def unexpected(self) -> tuple[ValidatedTest, ...]:
        """Tests with a result that is not expected of their kind."""
        return tuple(test for test in self.tests if test.result not in EXPECTED_RESULTS[test.kind])

    @property
    def summary(self) -> dict[str, dict[str, ErrorStatistics]]:
        """Shape and contact errors [mm] of the judged tests by kind."""
        statistics = {}
        for kind in ("free", "weight", "touch"):
            here = [test for test in self.judged if test.kind == kind]
            errors = (test.contact_error.size / MM for test in here if test.contact_error is not None)
            if here:
                statistics[kind] = {"shape_rms_mm": ErrorStatistics.of(test.shape_rms / MM for test in here),
                               "contact_error_mm": ErrorStatistics.of(errors)}  # fmt: skip
        return statistics

    @property
    def notes_on_identification(self) -> tuple[str, ...]:
        """Notes on tests from which the probe's parameters were identified, each one line."""
        lines = list[str]()
        served = [test for test in self.tests if test.served and test.kind != "free"]
        if served and self.include_identified:
            lines.append(f"{len(served)} of the tests judged served the identification of this probe, which fits its "
                         "parameters to them; leave out --include-identified")  # fmt: skip
        elif served:
            touches = sum(test.kind == "touch" for test in served)
            left = sum(test.kind == "touch" for test in self.judged)
            lines.append(f"{len(served)} tests served the identification of this probe and are listed, not judged: "
                         f"{touches} touches; held out: {left} touches")  # fmt: skip
            if not left:
                lines.append("measure touches with use = validate in tests.csv, which identify leaves out, or judge "
                             "all with --include-identified")  # fmt: skip
        return tuple(lines)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user, each one line."""
        lines = [*self.campaign.notes, *self.notes_on_identification]
        for test in self.unexpected:
            lines.append(f"{test.test.name} ({test.kind}): {test.result}: {WHY[test.result]}")
        untared = [test for test in self.tests if not test.tares and test.readings and test.kind != "free"]
        if untared:
            lines.append(f"{len(untared)} tests were not tared, for lack of a free test with readings: their errors "
                         "include those of print and mount in the free probe's reading")  # fmt: skip
        if all(test.test.markers is None for test in self.tests):
            lines.append("no markers: no shape errors")
        return tuple(lines)

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per test; None where there is no number. Columns of the paper's Table I keep their names."""
        return [self._row(test) for test in self.tests]

    def _row(self, test: ValidatedTest) -> dict[str, Any]:
        model, length, error = self.estimator.model, self.estimator.model.rod.length, test.contact_error
        estimate = test.estimate or Estimate("out_of_range")
        z = error.z if error is not None and error.dof == 3 else [None] * 3
        row = {
            "probe": model.name, "length_mm": length / MM, "test": test.test.name, "kind": test.kind,
            "force_N": test.force, "contact_fraction": test.fraction, "direction": test.push_direction,
            "method": test.method, "result": test.result, "shape_rms_mm": test.shape_rms / MM,
            "shape_rms_percent": 100.0 * test.shape_rms / length, "reference_rms_mm": test.reference_rms / MM,
            "contact_error_mm": error.size / MM if error else None,
            "stated_error_mm": error.expected / MM if error else None, "predicted_error_mm": test.predicted / MM,
            "reference_error_mm": rms(error.cov_reference) / MM if error else None,
            "within_95": error.within_95 if error else None, "nees": error.nees if error else None,
            **{f"z_{axis}": value for axis, value in zip("xyz", z, strict=True)},
            "markers": len(test.markers_base), "readings": test.readings, "tares": test.tares,
            "force_normal_N": estimate.force_normal, "force_tangential_N": estimate.force_tangential,
            "friction_ratio": estimate.friction_ratio, "held_out": not test.served,
        }  # fmt: skip
        return {name: _plain(value) for name, value in row.items()}

    def csv(self) -> bytes:
        """Return the rows as CSV with a header."""
        rows = self.rows()
        return csv_tables.write(list(rows[0]), rows, ".6g")

    def as_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {
            "schema": 1,
            "probe": self.estimator.model.name,
            "fingerprint": self.estimator.model.fingerprint,
            "assumptions": self.estimator.model.assumptions,
            "data": str(self.campaign.folder),
            "exact_model": self.exact,
            "include_identified": self.include_identified,
            "verdict": self.coverage.verdict,
            "tests": self.rows(),
            "summary": {kind: {name: asdict(statistics) for name, statistics in errors.items()}
                        for kind, errors in self.summary.items()},
            "coverage": {name: _plain(value) for name, value in asdict(self.coverage).items()},
            "notes": self.notes,
        }  # fmt: skip


def validate(
    estimator: Estimator,
    campaign: Campaign,
    exact: bool = False,
    include_identified: bool = False,
    on_progress: Callable[[float], None] = lambda share: None,
) -> ValidationReport:
    """Compare a frozen probe with a campaign of its print.

    Args:
        estimator: as `load_estimator` gives it.
        campaign: from `read_campaign`.
        exact: take probe, mount and bench as exactly known; else all tolerances count.
        include_identified: judge also tests that the parameters of the probe were identified from.
        on_progress: called with the fraction done.

    Raises:
        InputError: the campaign is of another probe, or has nothing to compare.
    """
    model = estimator.model
    check_probe(campaign, model)
    if not any(len(test.wrenches) for test in campaign.tests):
        raise InputError(f"{campaign.folder}: has no wrenches.csv; there is nothing to estimate from")
    if not any(
        test.markers is not None or test.p_contact_world is not None or not math.isnan(test.s_contact)
        for test in campaign.tests
    ):
        raise InputError(f"{campaign.folder}: no test has markers, a contact or s_contact_mm; nothing to compare with")
    tests = []
    for i, test in enumerate(campaign.tests):
        on_progress(i / len(campaign.tests))
        tests.append(validate_test(campaign, test, estimator, exact))
    kinds = ("free", "weight", "touch")
    tests.sort(key=lambda test: (kinds.index(test.kind), 2.0 if math.isnan(test.fraction) else round(test.fraction, 2),
                                 -test.force))  # fmt: skip
    return ValidationReport(estimator, campaign, exact, tuple(tests), include_identified)


def _plain(value: Any) -> Any:
    value = value.item() if hasattr(value, "item") else value
    return None if isinstance(value, float) and math.isnan(value) else value
