"""Where the error of several fused touches comes from: its covariance by cause, to first order.

Readings of the model's own touches are linearised as `Estimator.fuse` does it (`estimation/fusion.py`), so the total is
the covariance that it states. With C the covariance of the common unknowns, the residuals of a cause contribute
C A C to it, A their part of the information matrix: the contributions of all causes add up to C. Of the error sources,
whose prior is one residual each, that is a product of C's own columns; of what each touch has for itself it is half the
derivative by the logarithm of the standard deviation, taken by differences. The causes are those of contacts without
friction, μ = 0; the cause "friction" is what the prior on friction adds to their sum.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from probedesign.estimation.error_sources import CAUSES as SOURCES
from probedesign.estimation.fusion import Fusion, Reading, channels_of
from probedesign.estimation.fusion_state import FusionState
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.observation import covariance
from probedesign.estimation.surface_contact_kernel import POINT, VALUE
from probedesign.estimation.tolerances import Tolerances
from probedesign.frames import Array, pose
from probedesign.prediction.budget import rms_of
from probedesign.prediction.press_schedule import PressSchedule

FUSED_CAUSES = (*SOURCES, "friction", "robot")
"""Of the error of fused touches, in the order of the tables."""
_STEP = 2e-3
"""Relative step of the differences: their error is its square."""
_SCATTER = "stiffness scatter"


@dataclass(frozen=True)
class FusedBudget:
    """Errors of one point that is touched several times.

    Attributes:
        cov: of the touched point in the world [m²] by cause, (causes, 3, 3), as `FUSED_CAUSES` names them.
        total: as the estimator states it, by all causes [m²], (3, 3).
        cov_noise: by the sensor's noise and the prior on friction where all else is exactly known [m²], (3, 3).
    """

    cov: Array
    total: Array
    cov_noise: Array

    @property
    def rms(self) -> Array:
        """Of each cause [m], (causes,)."""
        return rms_of(self.cov)


class ModelPress:
    """Touches of one point by the model, ready for the estimator's own linearisation."""

    def __init__(
        self, model: ProbeModel, priors: Tolerances, gravity: Array, touches: Array, schedule: PressSchedule
    ) -> None:
        """Args:
        model: of the probe.
        priors: standard deviations of the error sources.
        gravity: base axes [m/s²], (3,).
        touches: unknowns, dead loads and tip of each, in the order of time, (k, TOUCH).
        schedule: how they are made.
        """
        cov, none = model.noise_base(), np.zeros(6)
        readings = tuple(Reading(none, cov, np.eye(4), gravity, True) for _ in touches)
        self.fusion = Fusion(model, readings, priors, channels_of(model, schedule.moments_about), gravity)
        self.state = FusionState(self.fusion, touches.copy())
        self.held = self.state.linearise()
        if not self.held:
            return
        wrenches = self.state.lin[:, 0:6, VALUE]
        points = self.state.lin[:, POINT : POINT + 3, VALUE]
        readings = tuple(
            Reading(w.copy(), covariance(model, w), pose(p=-p), gravity, True)
            for w, p in zip(wrenches, points, strict=True)
        )
        sources = self.fusion.sources  # of the same gravity at all poses
        self.fusion = replace(self.fusion, readings=readings)
        self.fusion.__dict__["sources"] = sources
        self.state.fusion = self.fusion

    @property
    def wrenches(self) -> Array:
        """At the base, without noise, (k, 6)."""
        return np.array([reading.wrench for reading in self.fusion.readings])

    @property
    def Ts_world_base(self) -> Array:
        """Poses that put the touched point at the world's origin, (k, 4, 4)."""
        return np.array([reading.T_world_base for reading in self.fusion.readings])

    def cov(
        self, priors: Tolerances | None = None, D: Array | None = None, friction: float | None = None
    ) -> Array:
        """Covariance of the touched point that `Estimator.fuse` states [m²], (3, 3).

        Args:
            priors: of bias and robot; those of the press if None.
            D: error columns; those of the press if None.
            friction: prior standard deviation of its ratio; that of the model if None.
        """
        return self.state.solved(priors or self.fusion.priors, D, friction=friction)[2]

    def split(self) -> FusedBudget:
        """The covariance by cause."""
        priors = self.fusion.priors
        total = self.cov()
        noise = self.cov(
            replace(priors, robot_mm=0.0, drift_steps=0.0, walk_steps=0.0), np.zeros_like(self.state.D)
        )
        whole = self.cov(friction=0.0)
        with_sources = self.state.cov_with_sources()
        parts = {}
        for name in SOURCES[2:]:
            here = with_sources[:, [c for c, of in enumerate(self.fusion.sources[0].names) if of == name]]
            parts[name] = here @ here.T
        parts["drift"] = self._by(lambda f: (replace(priors, drift_steps=f * priors.drift_steps,
                                                     walk_steps=f * priors.walk_steps), None))  # fmt: skip
        parts["robot"] = self._by(lambda f: (replace(priors, robot_mm=f * priors.robot_mm), None))
        if _SCATTER in self.fusion.sources[0].names:
            parts[_SCATTER] = self._by(lambda f: (priors, self._scattered(f)))
        parts["noise"] = whole - sum(parts.values())
        parts["friction"] = total - whole
        return FusedBudget(np.array([parts[name] for name in FUSED_CAUSES]), total, noise)

    def _by(self, changed: Callable[[float], tuple[Tolerances, Array | None]]) -> Array:
        """C A C of a cause whose standard deviation is changed by a factor."""
        more, less = (self.cov(*changed(1.0 + sign * _STEP), friction=0.0) for sign in (1.0, -1.0))
        return np.asarray((more - less) / (4.0 * _STEP))

    def _scattered(self, factor: float) -> Array:
        D = self.state.D.copy()
        D[:, :, self.fusion.sources[0].names.index(_SCATTER)] *= factor
        return D
