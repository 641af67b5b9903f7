"""One test: the estimate beside the reference."""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from probedesign.campaigns.campaign import Campaign, Test
from probedesign.estimation.estimate import Estimate
from probedesign.estimation.estimator import Estimator, Method
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.frames import Array, inverse
from probedesign.rod.equilibrium import Equilibrium
from probedesign.validation.beforehand import predicted_error
from probedesign.validation.contact_error import Miss, miss_of
from probedesign.validation.taring import Reading, cov_of_pose, reading_of, tolerances_of

Kind = Literal["free", "weight", "touch"]
METHODS: dict[Kind, Method] = {"free": "ml", "weight": "force_moment", "touch": "ml"}
"""By which each kind is estimated. A known force is a dead load on the centreline, of any direction, which the
force–moment method locates; a touch acts on the surface, by a force whose friction has a prior."""


@dataclass(frozen=True, eq=False)
class Trial:
    """One test.

    Attributes:
        test: it is of.
        kind: free, with a known weight on it, or touched.
        method: it was estimated by.
        result: of the estimate; "no_reading" where the sensor was not read.
        estimate: None where there was none.
        shape: as estimated, of a free test as modelled; None where no place was told.
        force: on the probe [N]: as known, else by equation 5 from the readings; NaN where neither is.
        fraction: contact over length: known, else estimated; NaN where neither is.
        markers_base: as measured [m], (m, 3).
        markers_hat: the same of the shape [m], (m, 3); empty without a shape.
        markers_off: of them from the shape's axis [m], (m, 3).
        shape_rms: equation 6 [m]; NaN without shape or markers.
        reference_rms: what the reference's own errors make of it [m].
        contact_base: by the reference [m], (3,); None if it saw none.
        way: the object pushes, as the campaign says or the force has it, a key of `DIRECTIONS`; empty where neither is.
        predicted: error that `predict` tells of such a touch [m]; NaN of weights, which it does not predict.
        miss: of the contact; None where either side has none.
        readings: of the sensor.
        tares: free tests it was tared by.
    """

    test: Test
    kind: Kind
    method: Method
    result: str
    estimate: Estimate | None
    shape: Equilibrium | None
    force: float
    fraction: float
    markers_base: Array
    markers_hat: Array
    markers_off: Array
    shape_rms: float
    reference_rms: float
    contact_base: Array | None
    way: str
    predicted: float
    miss: Miss | None
    readings: int
    tares: int

    @property
    def markers_on_axis(self) -> Array:
        """The measured markers, moved onto the axis as the shape has it [m], (m, 3); as they are without a shape."""
        return self.markers_base - self.markers_off if len(self.markers_off) else self.markers_base

    @property
    def counts(self) -> bool:
        """Whether it counts among the touches whose stated errors come true or not: weights are told apart."""
        return self.kind == "touch" and self.miss is not None


def trial_of(campaign: Campaign, test: Test, estimator: Estimator, exact: bool) -> Trial:
    """Estimate one test and compare.

    Args:
        campaign: it is of.
        test: to look at.
        estimator: of the frozen probe, as `load_estimator` gives it.
        exact: take probe, mount and bench for exactly what the model says; noise and drift of the sensor and the prior
            on friction remain.
    """
    model = estimator.model
    kind: Kind = "touch" if test.force_world is None else "free" if test.free else "weight"
    reading = reading_of(campaign, test, estimator)
    used, method = _prepared(campaign, estimator, reading, exact), METHODS[kind]
    estimate = (
        used.estimate(reading.wrenches_base, reading.gravity_base, method=method)
        if len(reading.wrenches_base)
        else None
    )
    shape = _shape(estimator, kind, reading, estimate)
    T_base_world = inverse(test.T_world_base)
    seen, hat, off, cov = _markers(campaign, test, model, shape, T_base_world)
    contact = None if test.p_contact_world is None else _moved(T_base_world, test.p_contact_world)
    force, fraction = _force(test, reading, model), _place(test, estimate) / model.rod.length
    way = _way(test, reading, model)
    return Trial(
        test, kind, method, "no_reading" if estimate is None else estimate.result, estimate, shape,
        force=force,
        fraction=fraction,
        markers_base=seen,
        markers_hat=hat,
        markers_off=off,
        shape_rms=math.sqrt(float(np.mean(np.sum((hat - seen) ** 2, axis=1)))) if len(hat) else math.nan,
        reference_rms=math.sqrt(float(np.mean(np.trace(cov, axis1=1, axis2=2)))) if len(seen) else math.nan,
        contact_base=contact,
        way=way,
        predicted=predicted_error(model, fraction, force, way) if kind == "touch" else math.nan,
        miss=miss_of(campaign, test, estimate, contact),
        readings=len(reading.wrenches_base),
        tares=reading.tares,
    )  # fmt: skip


def _prepared(campaign: Campaign, estimator: Estimator, reading: Reading, exact: bool) -> Estimator:
    """Return the estimator with the tolerances that hold in this campaign, or with those of bias and tare alone."""
    if not len(reading.wrenches_base):
        return estimator
    known = tolerances_of(campaign, estimator.model, reading)
    if exact:
        known = replace(Tolerances.none(), drift_steps=known.drift_steps, tared=known.tared)
    return estimator.with_tolerances(known)


def _shape(
    estimator: Estimator, kind: Kind, reading: Reading, estimate: Estimate | None
) -> Equilibrium | None:
    """Of a free probe the modelled one: that nothing touches it is known."""
    if kind == "free":
        free = estimator.free(reading.gravity_base)
        return free if free.ok else None
    return None if estimate is None else estimate.shape


def _force(test: Test, reading: Reading, model: ProbeModel) -> float:
    return float(np.linalg.norm(_force_base(test, reading, model)))


def _force_base(test: Test, reading: Reading, model: ProbeModel) -> Array:
    """As known, else by equation 5 [N], (3,); NaN where neither is."""
    if test.force_world is not None:
        return np.asarray(test.T_world_base[:3, :3].T @ test.force_world)
    if not len(reading.wrenches_base):
        return np.full(3, math.nan)
    return np.asarray(reading.wrenches_base.mean(axis=0)[:3] - model.mass * reading.gravity_base)


def _way(test: Test, reading: Reading, model: ProbeModel) -> str:
    """The direction that is said, else the one nearest to the force."""
    across = _force_base(test, reading, model)[:2]
    if test.direction or not across.any() or math.isnan(across[0]):
        return test.direction
    axis = int(np.argmax(np.abs(across)))
    return f"{'+' if across[axis] > 0.0 else '-'}{'xy'[axis]}"


def _place(test: Test, estimate: Estimate | None) -> float:
    if not math.isnan(test.s_contact) or estimate is None:
        return test.s_contact
    return estimate.s_contact


def _markers(
    campaign: Campaign, test: Test, model: ProbeModel, shape: Equilibrium | None, T_base_world: Array
) -> tuple[Array, Array, Array, Array]:
    """Measured and estimated markers in the base frame, the latter's way from the axis, and the reference's covariance
    of each."""
    none = np.zeros((0, 3))
    if test.markers is None:
        return none, none, none, np.zeros((0, 3, 3))
    R = T_base_world[:3, :3]
    seen = test.markers.p_world @ R.T + T_base_world[:3, 3]
    cov = R @ test.markers.cov_world @ R.T + cov_of_pose(campaign, seen)
    if shape is None:
        return seen, none, none, cov
    s = np.minimum(campaign.marker_s[test.markers.numbers], model.rod.length)
    hat, off = shape.p_at(s), np.zeros((len(s), 3))
    if campaign.marker_side is not None:
        side, axes = campaign.marker_side, shape.R_at(s)
        radius = model.cross_section.reach(side) * np.interp(s, model.rod.s, model.rod.radius)
        off = radius[:, None] * (math.cos(side) * axes[:, :, 0] + math.sin(side) * axes[:, :, 1])
    return seen, hat + off, off, cov


def _moved(T: Array, p: Array) -> Array:
    return np.asarray(T[:3, :3] @ p + T[:3, 3])
