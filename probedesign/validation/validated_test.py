"""One test of a campaign: tared, estimated and compared with the reference; the error of its contact and covariance."""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.special import chdtri

from probedesign.campaigns.campaign import Campaign, Test
from probedesign.campaigns.manifest import LENGTH_SCALE
from probedesign.core.frames import Array, inverse
from probedesign.core.statistics import rms
from probedesign.core.units import MM
from probedesign.estimation.estimate import Estimate
from probedesign.estimation.estimator import Estimator, Method
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import WALK_SECONDS, Tolerances
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
        own = cov_of_reference(campaign, contact) + max(test.std_contact, MIN_REFERENCE_STD) ** 2 * np.eye(3)
        return ContactError(estimate.p_surface_base - contact, estimate.cov_surface_base + own, own)
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


def predicted_error(model: ProbeModel, fraction: float, force: float, push_direction: str) -> float:
    """Return the RMS error that `predict` states for such a touch, full error budget: one reading, the design's own
    mount and tolerances, no reference [m]. NaN if it predicts no location, or if an argument is missing.

    Args:
        model: of the probe.
        fraction: contact over length.
        force: [N].
        push_direction: of the object, a key of `DIRECTIONS`.
    """
    if not 0.0 < fraction <= 1.0 or not force > 0.0 or not push_direction:
        return math.nan
    predicted = predict_touch(Estimator(model), fraction, force, push_direction)
    if predicted.result != "ok" or predicted.predicted_error_mm is None:
        return math.nan
    return predicted.predicted_error_mm * MM


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
    predicted: float  #: error that `predict` states for such a touch [m]; NaN for weights, which it does not predict.
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
    fraction = s / model.rod.length
    shape_rms = math.sqrt(float(np.mean(np.sum((hat - markers) ** 2, axis=1)))) if len(hat) else math.nan
    reference_rms = math.sqrt(float(np.mean(np.trace(cov, axis1=1, axis2=2)))) if len(markers) else math.nan
    return ValidatedTest(
        test, kind, method, "no_reading" if estimate is None else estimate.result, estimate, shape, force, fraction,
        markers, hat, off, shape_rms, reference_rms, contact, direction,
        predicted=predicted_error(model, fraction, force, direction) if kind == "touch" else math.nan,
        contact_error=contact_error(campaign, test, estimate, contact),
        readings=len(reading.wrenches_base), tares=reading.tares,
        served=test.digest in model.identified_tests,
    )  # fmt: skip


def tared_reading(campaign: Campaign, test: Test, estimator: Estimator) -> TaredReading:
    """Return the readings of one test, tared by free tests with readings; a free test by the others.

    A free test in a pose of its own is tared by the free tests of other poses: they share the sensor's bias, and errors
    of the probe's weight remain, each with the difference of the model in both poses.
    """
    gravity, own = test.gravity_base, test.wrenches_base(estimator.model)
    free = [one for one in campaign.tests if one.free and len(one.wrenches) and one is not test]
    tares = [one for one in free
             if one.gravity_base @ gravity >= SAME_GRAVITY * np.linalg.norm(one.gravity_base) * np.linalg.norm(gravity)
             ]  # fmt: skip
    same_pose = bool(tares) or not test.free
    tares = tares if same_pose else free
    offsets = [one.mean_wrench_base(estimator.model) - estimator.free(one.gravity_base).wrench_base for one in tares]
    weights, walked = tare_weights(test.time, np.array([one.time for one in tares]))
    tared = own - weights @ np.array(offsets) if offsets else own
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
