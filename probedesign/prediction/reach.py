"""What a touch costs the object, place by place: the least force that tells something, and the most that is borne."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from probedesign.frames import Array
from probedesign.prediction.touches import Touches
from probedesign.units import MM

ACCURACIES_MM = (1.0, 2.0, 5.0)
"""RMS errors for which the force is told."""
LADDER_N = tuple(float(f) for f in np.geomspace(5e-4, 12.0, 36))
"""Forces that are looked at, from a sixth of one reading's step up to the range of the finest calibration."""


@dataclass(frozen=True)
class Reach:
    """What can be done at one place from one side; None where there is no such force.

    Attributes:
        contact_fraction, direction: where and from which side.
        force_mN_for_1_mm, force_mN_for_2_mm, force_mN_for_5_mm: from which the RMS error of one reading, all causes
            together, is no greater.
        greatest_force_N: up to which the touch can be read.
        limit: what ends it: "sensor", a channel is at its range; "gives_way", the probe buckles or bends away;
            "slips_off", an object that keeps its distance from the base has come to the tip; "none" up to 12 N.
        deflection_mm: of the touched point there.
    """

    contact_fraction: float
    direction: str
    force_mN_for_1_mm: float | None
    force_mN_for_2_mm: float | None
    force_mN_for_5_mm: float | None
    greatest_force_N: float | None
    limit: str
    deflection_mm: float | None


def reach_of(
    lines: Sequence[tuple[float, str]], touches: Mapping[float, Touches], end: float
) -> tuple[Reach, ...]:
    """Along the probe.

    Args:
        lines: contact fraction and direction, among them one at `end` of each direction.
        touches: of these lines by force.
        end: the fraction where the flank ends, from which objects slip.
    """
    forces = np.array(sorted(touches))
    errors = np.array([touches[f].rms[0] for f in forces])
    use = np.array([touches[f].sensor_use for f in forces])
    bent = np.array([touches[f].deflection for f in forces])
    depth = np.array([touches[f].centre[:, 2] for f in forces])
    held = touches[forces[-1]].held
    found = []
    for i, (fraction, direction) in enumerate(lines):
        tip = lines.index((end, direction))
        most, limit = _greatest(
            forces, use[:, i], held[i], _slips(forces, depth[:, tip], depth[0, i], i == tip)
        )
        for_1, for_2, for_5 = (
            _needed(forces, errors[:, i], use[:, i], accuracy * MM, most) for accuracy in ACCURACIES_MM
        )
        there = np.isfinite(bent[:, i]) & (forces <= 1.3 * most)
        deflection = float(np.interp(most, forces[there], bent[there, i])) / MM if there.any() else None
        found.append(Reach(fraction, direction, for_1, for_2, for_5, most, limit, deflection))
    return tuple(found)


def _slips(forces: Array, tip_depth: Array, depth: float, at_tip: bool) -> float:
    """Force at which the tip, pushed itself, has come as near to the base as the object is; infinite if it never does.

    An object slides along the probe as that bends away, and where it leaves, it touches the tip.
    """
    good = np.isfinite(tip_depth)
    below = np.flatnonzero(good & (tip_depth <= depth))
    if at_tip or not len(below) or below[0] == 0:
        return float("inf")
    j = below[0]
    share = (tip_depth[j - 1] - depth) / (tip_depth[j - 1] - tip_depth[j])
    return float(forces[j - 1] + share * (forces[j] - forces[j - 1]))


def _greatest(forces: Array, use: Array, held: float, slips: float) -> tuple[float, str]:
    """The greatest force and what ends it."""
    limits = {"slips_off": slips, "sensor": float("inf"), "gives_way": float("inf")}
    if held < forces[-1]:
        limits["gives_way"] = float(held)
    beyond = np.flatnonzero(use > 1.0)
    if len(beyond):
        j = int(beyond[0])
        limits["sensor"] = float(np.interp(1.0, use[j - 1 : j + 1], forces[j - 1 : j + 1])) if j else 0.0
    limit = min(limits, key=lambda name: limits[name])
    return (limits[limit], limit) if np.isfinite(limits[limit]) else (float(forces[-1]), "none")


def _needed(forces: Array, errors: Array, use: Array, accuracy: float, most: float) -> float | None:
    """The least force [mN] from which the error is that small; straight in logarithms between the forces."""
    good = np.isfinite(errors) & (use <= 1.0)
    enough = np.flatnonzero(good & (errors <= accuracy))
    if not len(enough):
        return None
    j = int(enough[0])
    force = float(forces[j])
    if j and np.isfinite(errors[j - 1]):
        x, y = np.log(forces[j - 1 : j + 1]), np.log(errors[j - 1 : j + 1])
        force = float(np.exp(np.interp(-np.log(accuracy), -y, x)))
    return 1e3 * force if force <= most else None
