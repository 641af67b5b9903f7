"""What a fusion answers."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from probedesign.estimation.estimate import Result
from probedesign.frames import Array

Fixed = Literal["surface", "contact"]
"""What of the touch stays at one point of the world: the touched point of the surface, as on a tip or an edge; or the
point of the centreline, where the force's line meets it."""
MomentsAbout = Literal["base", "sensor"]
"""Where the moments are told about that count alone: the base's origin, or the sensor's own."""


def _nan(*shape: int) -> Array:
    return np.full(shape, np.nan)


@dataclass(frozen=True)
class Fused:
    """One fixed point touched from several poses. With any result but "ok" the position is NaN.

    Attributes:
        result: one of `estimate.RESULTS`.
        p_contact_world: point of the centreline where the force acts, the mean over the poses [m], (3,).
        p_surface_world: the touched point, likewise [m], (3,).
        cov_contact_world: covariance of p_contact_world with everything unknown counted [m²], (3, 3).
        cov_fixed_world: likewise of the point that stands still, one of the two [m²], (3, 3).
        fixed: which of the two points the readings say stands still: "surface" or "contact".
        s_contact: arclength of the contact at each pose, NaN where free [m], (k,).
        force_base: at each pose [N], (k, 3).
        stiffness, std_stiffness: factor on E and G, and its standard deviation.
        chi2, dof: how well it all fits.
        rms: of the position [m].
        rms_without: the same if one source of error were gone: "stiffness", "bias" or "robot" [m].
        rms_with: the same with "one more touch" like the last, a "further press" as far again, or the
            "stiffness" known half as vaguely [m].
        iterations: of Gauss and Newton.
        candidates_world: the centreline's mean point of every place that explains the readings about as well, best
            first [m], (j, 3).
    """

    result: Result
    p_contact_world: Array = field(default_factory=lambda: _nan(3))
    p_surface_world: Array = field(default_factory=lambda: _nan(3))
    cov_contact_world: Array = field(default_factory=lambda: _nan(3, 3))
    cov_fixed_world: Array = field(default_factory=lambda: _nan(3, 3))
    fixed: Fixed | None = None
    s_contact: Array = field(default_factory=lambda: _nan(0))
    force_base: Array = field(default_factory=lambda: _nan(0, 3))
    stiffness: float = float("nan")
    std_stiffness: float = float("nan")
    chi2: float = float("nan")
    dof: int = 0
    rms: float = float("nan")
    rms_without: dict[str, float] = field(default_factory=dict)
    rms_with: dict[str, float] = field(default_factory=dict)
    iterations: int = 0
    candidates_world: Array = field(default_factory=lambda: _nan(0, 3))

    @property
    def ok(self) -> bool:
        """Whether the point was located."""
        return self.result == "ok"
