"""What `predict` says of a touch before it is made, to stand beside what came of it."""

import math

from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel
from probedesign.prediction.predict import predict_touch
from probedesign.units import MM


def predicted_error(model: ProbeModel, fraction: float, force: float, way: str) -> float:
    """RMS distance by all causes that `predict` states for such a touch: one reading, the design's own mount and
    tolerances, no reference [m]; NaN where it says that none is located, or where it cannot be asked.

    Args:
        model: of the probe.
        fraction: contact over length; NaN if not known.
        force: [N]; NaN if not known.
        way: the object pushes, a key of `DIRECTIONS`; empty if not known.
    """
    if not 0.0 < fraction <= 1.0 or not force > 0.0 or not way:
        return math.nan
    told = predict_touch(Estimator(model), fraction, force, way)
    return (
        told.predicted_error_mm * MM
        if told.result == "ok" and told.predicted_error_mm is not None
        else math.nan
    )
