"""What one series tells: its dwells and the free probe before and after, fused in one batch."""

from dataclasses import dataclass, replace

import numpy as np

from probedesign.estimation.estimate import RESULTS
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.fused import FusedEstimate
from probedesign.estimation.fusion import Fusion, Reading, channels_of
from probedesign.estimation.fusion_state import FusionState
from probedesign.estimation.observation import covariance
from probedesign.estimation.tolerances import Tolerances
from probedesign.frames import Array
from probedesign.live.processing.touches import BIAS_STEPS
from probedesign.mapping.dwell import Dwell
from probedesign.mapping.located import Located
from probedesign.mapping.segmentation import Series

OPEN_STEPS = 10.0
"""Of the bias, in steps of the sensor's resolution, where the free probe beside the touch ties it down: as good as not
known. An hour of the assumed walk makes 3 (`detector.DRIFT_STEPS`)."""
NEVER_SETTLED = "never_settled"
MEANINGS: dict[str, str] = {
    **{str(result): meaning for result, meaning in RESULTS.items()},
    NEVER_SETTLED: "the base or the readings did not stand while it touched",
}
"""Of each result, in words."""


@dataclass(frozen=True)
class Touched:
    """One touch and what it tells.

    Attributes:
        series: it.
        result: one of `MEANINGS`.
        located: the touched point of the object, with "ok".
        force: the strongest of its dwells' [N]; NaN unless ok.
        direction: of that force on the probe in the world, unit, (3,).
        s_contact: from the first dwell's to the last one's [m], (k,).
        rms: of the point by itself [m].
    """

    series: Series
    result: str
    located: Located | None = None
    force: float = float("nan")
    direction: Array | None = None
    s_contact: Array | None = None
    rms: float = float("nan")


def touched(series: Series, estimator: Estimator, priors: Tolerances, gravity_world: Array) -> Touched:
    """Return the point that a series touches.

    Args:
        series: one touch.
        estimator: of the probe.
        priors: standard deviations of the error sources; the bias is replaced by `OPEN_STEPS` or `BIAS_STEPS`.
        gravity_world: [m/s²], (3,).
    """
    if not series.dwells:
        return Touched(series, NEVER_SETTLED)
    fusion = _fusion(series, estimator, priors, gravity_world)
    if fusion is None:
        return Touched(series, "out_of_range")
    found = fusion.solutions()
    if isinstance(found, FusedEstimate):
        return Touched(series, found.result)
    answer = fusion.answer(found, brief=True)
    if not answer.ok:
        return Touched(series, answer.result)
    state = FusionState(fusion, found[0].touches.copy())
    if not state.linearise():
        return Touched(series, "not_converged")
    _chi2, _x, cov = state.solved(fusion.priors)
    located = Located.of(state, answer.cov_surface_world - cov)
    sizes = np.linalg.norm(answer.force_base, axis=1)
    strongest = int(np.argmax(sizes))
    R = fusion.readings[strongest].T_world_base[:3, :3]
    direction = R @ answer.force_base[strongest] / sizes[strongest]
    s_contact = answer.s_contact[np.isfinite(answer.s_contact)]
    return Touched(series, "ok", located, float(sizes[strongest]), direction, s_contact, answer.rms)


def _fusion(series: Series, estimator: Estimator, priors: Tolerances, gravity_world: Array) -> Fusion | None:
    """Return the readings to be fused; None if the sensor cannot have read them or the free probe cannot stand."""
    model = estimator.model
    free = [dwell for dwell in (series.before,) if dwell is not None]
    last = [dwell for dwell in (series.after,) if dwell is not None]
    kept = [*((dwell, False) for dwell in free), *((dwell, True) for dwell in series.dwells),
            *((dwell, False) for dwell in last)]  # fmt: skip
    for dwell, _ in kept:
        read = model.to_sensor(dwell.wrench, dwell.gravity)
        if not (np.isfinite(read).all() and (np.abs(read) <= model.readable).all()):
            return None
        if not estimator.free(dwell.gravity).ok:
            return None
    bias = OPEN_STEPS if free or last else BIAS_STEPS
    readings = tuple(_reading(dwell, contact, estimator) for dwell, contact in kept)
    return Fusion(model, readings, replace(priors, drift_steps=bias), channels_of(model, None), gravity_world)


def _reading(dwell: Dwell, contact: bool, estimator: Estimator) -> Reading:
    cov = covariance(estimator.model, dwell.wrench, dwell.readings)
    return Reading(dwell.wrench, cov, dwell.T_world_base, dwell.gravity, contact)
