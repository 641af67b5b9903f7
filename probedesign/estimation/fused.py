"""The result of a fusion: one fixed point touched from several poses."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from probedesign.core.frames import Array
from probedesign.estimation.estimate import Result

MomentsAbout = Literal["base", "sensor"]
"""Where the moments are taken about that count alone: the base's origin, or the sensor's own."""


def _nan(*shape: int) -> Array:
    return np.full(shape, np.nan)


@dataclass(frozen=True)
class FusedEstimate:
    """One fixed point touched from several poses. With any result but "ok" the position is NaN.

    Attributes:
        result: one of `estimate.RESULTS`.
        p_surface_world: the touched point of the object, which does not move [m], (3,).
        cov_surface_world: its covariance with every error source counted [m²], (3, 3).
        p_contact_world: point of the centreline where the force's line of action comes nearest, the mean over the poses
            [m], (3,).
        cov_contact_world: its covariance [m²], (3, 3).
        s_contact: arclength of that point at each pose, NaN where free [m], (k,).
        force_base: at each pose [N], (k, 3).
        force_normal, force_tangential: at each pose [N], NaN where free, (k,).
        friction_ratio: tangential over normal force at each pose, (k,).
        stiffness, std_stiffness: factor on E, and its standard deviation.
        chi2, dof: misfit of all readings and priors, and its degrees of freedom.
        rms: root of the trace of cov_surface_world [m].
        rms_without: the same if one group of error sources were gone: "stiffness", "bias" or "robot" [m].
        rms_with: the same with "one more touch" like the last, a "further press" as far again, or the "stiffness" known
            to half its standard deviation [m].
        iterations: of Gauss-Newton.
        candidates_world: touched point of every solution that explains the readings about as well, best first [m],
            (j, 3).
    """

    result: Result
    p_surface_world: Array = field(default_factory=lambda: _nan(3))
    cov_surface_world: Array = field(default_factory=lambda: _nan(3, 3))
    p_contact_world: Array = field(default_factory=lambda: _nan(3))
    cov_contact_world: Array = field(default_factory=lambda: _nan(3, 3))
    s_contact: Array = field(default_factory=lambda: _nan(0))
    force_base: Array = field(default_factory=lambda: _nan(0, 3))
    force_normal: Array = field(default_factory=lambda: _nan(0))
    force_tangential: Array = field(default_factory=lambda: _nan(0))
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

    @property
    def friction_ratio(self) -> Array:
        """Tangential over normal force at each pose, (k,)."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(self.force_tangential / self.force_normal)


Fused = FusedEstimate
"""Former name."""
