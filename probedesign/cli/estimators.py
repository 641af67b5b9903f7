"""The estimator of a frozen probe as the options of `estimate` and `live` have it."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from probedesign.estimation.estimator import Estimator


def loaded_estimator(
    bundle: Path, manifest: Path | None, exact_model: bool, friction: float | None
) -> "Estimator":
    """Return the estimator of a frozen probe.

    Args:
        bundle: NAME.probe.json.
        manifest: of the printed parts, to check against.
        exact_model: take probe, mount and bench as exact. The drift of the sensor's bias still counts: a reading that
            the drift alone explains must not be located.
        friction: prior instead of the bundle's; None keeps that.

    Raises:
        InputError: the file is unreadable, or the friction is NaN or below 0.
    """
    from probedesign.deployment import load_estimator
    from probedesign.estimation.tolerances import Tolerances

    estimator = load_estimator(bundle, manifest)
    if exact_model:
        estimator = estimator.with_tolerances(Tolerances.exact_probe(estimator.model))
    return estimator if friction is None else estimator.with_friction(friction)
