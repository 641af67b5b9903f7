"""Force thresholds along the probe: forces for an accuracy, and the largest one with what limits it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.prediction.touches import Touches

ACCURACIES_MM = (1.0, 2.0, 5.0)  #: RMS errors for which the required force is computed.
#: Forces that are evaluated, from a sixth of one reading's resolution up to the range of the finest calibration.
LADDER_N = tuple(float(f) for f in np.geomspace(5e-4, 12.0, 36))


@dataclass(frozen=True)
class ForceThresholds:
    """Force limits and thresholds at one position and direction; None where there is no such force."""

    contact_fraction: float  #: contact_fraction, direction: where and in which direction.
    direction: str
    #: force_mN_for_1_mm, force_mN_for_2_mm, force_mN_for_5_mm: smallest force at which the RMS error of one reading, by
    #: all error sources, is no larger.
    force_mN_for_1_mm: float | None
    force_mN_for_2_mm: float | None
    force_mN_for_5_mm: float | None
    greatest_force_N: float | None  #: largest force that can be read.
    #: what limits it: "sensor", a channel is at its range; "gives_way", the probe buckles; "slips_off", an object at
    #: constant distance from the base has reached the tip; "none" up to 12 N.
    limit: str
    deflection_mm: float | None  #: of the touched point at that force.


def force_thresholds(
    lines: Sequence[tuple[float, str]], touches: Mapping[float, Touches], end: float
) -> tuple[ForceThresholds, ...]:
    """Compute the thresholds of several lines.

    Args:
        lines: contact fraction and direction, among them one at `end` for each direction.
        touches: of these lines by force.
        end: fraction at which the flank ends, where objects slip off.
    """
    forces = np.array(sorted(touches))
    errors = np.array([touches[f].rms[0] for f in forces])
    use = np.array([touches[f].sensor_use for f in forces])
    bent = np.array([touches[f].deflection for f in forces])
    depth = np.array([touches[f].centre[:, 2] for f in forces])
    if touches[forces[0]].estimator.model.rod.is_curved:  # the tip of a curved probe is not its furthest point
        depth = np.full_like(depth, np.nan)
    max_stable_force = touches[forces[-1]].max_stable_force
    rows = []
    for i, (fraction, direction) in enumerate(lines):
        tip = lines.index((end, direction))
        slips = _slip_force(forces, depth[:, tip], depth[0, i], i == tip)
        max_force, limit = _max_force(forces, use[:, i], max_stable_force[i], slips)
        usable = use[:, i] <= 1.0
        needed = (force_for_accuracy(forces, errors[:, i], mm * MM, usable) for mm in ACCURACIES_MM)
        for_1, for_2, for_5 = (None if f is None or f > max_force else 1e3 * f for f in needed)
        there = np.isfinite(bent[:, i]) & (forces <= 1.3 * max_force)
        deflection = float(np.interp(max_force, forces[there], bent[there, i])) / MM if there.any() else None
        rows.append(ForceThresholds(fraction, direction, for_1, for_2, for_5, max_force, limit, deflection))
    return tuple(rows)


def _slip_force(forces: Array, tip_depth: Array, depth: float, at_tip: bool) -> float:
    """Return the force at which the tip, pushed itself, is as near to the base as the object; infinite if it never is.

    An object slides along the probe as the probe bends away; when it slips off it touches the tip.
    """
    good = np.isfinite(tip_depth)
    below = np.flatnonzero(good & (tip_depth <= depth))
    if at_tip or not len(below) or below[0] == 0:
        return float("inf")
    j = below[0]
    share = (tip_depth[j - 1] - depth) / (tip_depth[j - 1] - tip_depth[j])
    return float(forces[j - 1] + share * (forces[j] - forces[j - 1]))


def _max_force(forces: Array, use: Array, max_stable_force: float, slips: float) -> tuple[float, str]:
    """Return the largest force [N] and the code of its limit."""
    limits = {"slips_off": slips, "sensor": float("inf"), "gives_way": float("inf")}
    if max_stable_force < forces[-1]:
        limits["gives_way"] = float(max_stable_force)
    beyond = np.flatnonzero(use > 1.0)
    if len(beyond):
        j = int(beyond[0])
        limits["sensor"] = float(np.interp(1.0, use[j - 1 : j + 1], forces[j - 1 : j + 1])) if j else 0.0
    limit = min(limits, key=lambda name: limits[name])
    return (limits[limit], limit) if np.isfinite(limits[limit]) else (float(forces[-1]), "none")


def force_for_accuracy(
    forces: Array, errors: Array, accuracy: float, usable: NDArray[np.bool_] | None = None
) -> float | None:
    """Return the smallest force [N] with an error no larger than `accuracy`, interpolated linearly in logarithms.

    Args:
        forces: ascending [N], (n,).
        errors: at each force, (n,); NaN where there is none.
        accuracy: in the unit of the errors.
        usable: forces that may be the result, (n,); all if None.
    """
    enough = errors <= accuracy
    sufficient = np.flatnonzero(enough if usable is None else enough & usable)
    if not len(sufficient):
        return None
    j = int(sufficient[0])
    if not j or not np.isfinite(errors[j - 1]):
        return float(forces[j])
    x, y = np.log(forces[j - 1 : j + 1]), np.log(errors[j - 1 : j + 1])
    return float(np.exp(np.interp(-np.log(accuracy), -y, x)))
