"""Prediction for several fused touches of one point: press schedule, error budget, and a grid of conditions.

Readings of the model's own touches are linearised as in `Estimator.fuse` (`estimation/fusion.py`). With C the
covariance of the common unknowns, the residuals of one error source contribute C A C to it, A their part of the
information matrix: the contributions of all sources add up to C. For the error sources, whose prior is one residual
each, this is a product of C's own columns; for errors that are independent at each touch it is half the derivative by
the logarithm of the standard deviation, taken by differences. The budget is that of contacts without friction, μ = 0;
the source "friction" is what the prior on friction adds to their sum.

The covariance is first-order. `Fusion.curvature` adds the curve of the likely points to the result of the estimator; it
solves the fusion again at four or more points, which for each condition takes three times as long as the budget, and is
therefore not included here. With the large probe it increases the RMS error by 2 % in the median where the error is
below 2 mm, by 3 % (by a third in a tenth of the conditions) at 2 to 5 mm, and by 8 % beyond.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array, pose
from probedesign.core.parallel import OnProgress, quiet
from probedesign.core.statistics import UNIFORM_STD, rms, rms_each, whiten
from probedesign.core.units import MM
from probedesign.estimation.error_sources import CAUSES as SOURCES
from probedesign.estimation.estimate import MomentsAbout
from probedesign.estimation.fusion import Fusion, Reading
from probedesign.estimation.fusion_state import channels_of
from probedesign.estimation.model import ProbeModel, Tolerances, covariance
from probedesign.prediction.budget import radius_95
from probedesign.prediction.touches import Touches
from probedesign.rod.kernels.surface_contact import POINT, VALUE

MAX_TOUCHES = 20


@dataclass(frozen=True)
class PressSchedule:
    """How several touches of one point are made and fused: the base presses on, in equal steps of the force."""

    touches: int = 5  #: number of touches of one fixed point of the world, the base oriented as in its mount.
    #: point whose moments alone are used; None: forces too, as `live` and `explore` do.
    moments_about: MomentsAbout | None = None

    def __post_init__(self) -> None:
        """Raise InputError if the number of touches is out of range."""
        if not 2 <= self.touches <= MAX_TOUCHES:
            raise InputError(f"touches = {self.touches} must lie in 2 ... {MAX_TOUCHES} to be fused")

    def forces(self, greatest_N: float) -> tuple[float, ...]:
        """Return the normal force of each touch in the order of time [N]; the last is the largest."""
        return (*(greatest_N * k / self.touches for k in range(1, self.touches)), greatest_N)

    @property
    def text(self) -> str:
        """Return the description for users."""
        about = self.moments_about
        counted = f"moments about the {about} alone" if about else "forces and moments"
        return f"{self.touches} touches fused as the base presses on, {counted}"


FUSED_CAUSES = (*SOURCES, "friction", "robot", "object")  #: Error sources of fused touches, in the order of the tables.
_STEP = 2e-3  #: Relative step of the differences; their error is its square.
_SCATTER = "stiffness scatter"


@dataclass(frozen=True)
class FusedErrorBudget:
    """Error budget of one point that is touched several times."""

    #: of the touched point in the world [m²] by error source, (causes, 3, 3), in the order of `FUSED_CAUSES`.
    cov: Array
    total: Array  #: by all error sources, without the curvature [m²], (3, 3).
    cov_noise: Array  #: by sensor noise and the prior on friction, all else exactly known [m²], (3, 3).

    @property
    def rms(self) -> Array:
        """Return the RMS error by source [m], (causes,)."""
        return rms_each(self.cov)


class LinearizedPresses:
    """Touches of one point by the model, linearised as the estimator fuses them.

    Attributes:
        converged: whether every touch has an equilibrium; nothing else is valid if not.
    """

    def __init__(
        self, model: ProbeModel, priors: Tolerances, gravity: Array, touches: Array, schedule: PressSchedule
    ) -> None:
        """Linearise touches of one point.

        Args:
            model: of the probe.
            priors: standard deviations of the error sources.
            gravity: base axes [m/s²], (3,).
            touches: unknowns, dead loads and tip of each, in the order of time, (k, TOUCH).
            schedule: how they are made.
        """
        channels = channels_of(model, schedule.moments_about)
        # The places, which follow below, differ from touch to touch.
        readings = tuple(Reading(np.zeros(6), model.noise_base(), pose(p=(float(k), 0.0, 0.0)), gravity, True)
                         for k in range(len(touches)))  # fmt: skip
        state = Fusion(model, readings, priors, channels, gravity).state(touches)
        self.state, self.converged = state, state.linearise()
        if self.converged:
            state.wrench[:] = state.lin[:, 0:6, VALUE]
            state.pose[:, :3, 3] = -state.lin[:, POINT : POINT + 3, VALUE]
            state.whiten[:] = whiten(channels @ np.array([covariance(model, w) for w in state.wrench]) @ channels.T)

    @property
    def wrenches(self) -> Array:
        """Return the wrenches at the base without noise, (k, 6)."""
        return self.state.wrench

    def cov(self, priors: Tolerances | None = None, D: Array | None = None, friction: float | None = None) -> Array:
        """Return the covariance of the touched point to first order [m²], (3, 3).

        Args:
            priors: of bias and robot; those of the presses if None.
            D: error columns; those of the presses if None.
            friction: prior standard deviation of the friction ratio; that of the model if None.
        """
        return self.state.solved(priors, D, friction=friction)[2]

    def split(self) -> FusedErrorBudget:
        """Return the covariance by error source."""
        priors = self.state.priors
        total = self.cov()
        exact = replace(priors, robot_mm=0.0, drift_steps=0.0, walk_steps=0.0, object_compliance=0.0)
        noise = self.cov(exact, np.zeros_like(self.state.D))
        whole = self.cov(friction=0.0)
        with_sources = self.state.cov_with_sources()
        parts = {}
        for name in SOURCES[2:]:
            here = with_sources[:, [c for c, of in enumerate(self.state.sources[0].names) if of == name]]
            parts[name] = here @ here.T
        parts["object"] = with_sources[:, -1:] @ with_sources[:, -1:].T
        parts["drift"] = self._by(lambda f: (replace(priors, drift_steps=f * priors.drift_steps,
                                                     walk_steps=f * priors.walk_steps), None))  # fmt: skip
        parts["robot"] = self._by(lambda f: (replace(priors, robot_mm=f * priors.robot_mm), None))
        if _SCATTER in self.state.sources[0].names:
            parts[_SCATTER] = self._by(lambda f: (priors, self._scattered(f)))
        parts["noise"] = whole - sum(parts.values())
        parts["friction"] = total - whole
        return FusedErrorBudget(np.array([parts[name] for name in FUSED_CAUSES]), total, noise)

    def _by(self, changed: Callable[[float], tuple[Tolerances, Array | None]]) -> Array:
        """Return C A C of a source whose standard deviation is scaled by a factor."""
        more, less = (self.cov(*changed(1.0 + sign * _STEP), friction=0.0) for sign in (1.0, -1.0))
        return np.asarray((more - less) / (4.0 * _STEP))

    def _scattered(self, factor: float) -> Array:
        D = self.state.D.copy()
        D[:, :, self.state.sources[0].names.index(_SCATTER)] *= factor
        return D


SHOWN_N = 0.005  #: Largest force at which fused touches are shown: too light for a single touch to be located well.
Line = tuple[float, str]  #: Contact fraction and direction.


@dataclass(frozen=True)
class PredictedTouch:
    """What is predicted of one touch and of several fused ones. Numbers that do not exist are None."""

    contact_fraction: float  #: arclength of the touched section over length.
    force_N: float  #: normal force; of fused touches that of the last one, up to which the others are equal steps.
    direction: str  #: in which the object pushes, a key of `DIRECTIONS` or degrees such as "45deg" (`angle_of`).
    #: result code of the estimator; "ok" is a located contact, "gives_way" a probe that buckles. Of fused touches
    #: "gives_way" and "out_of_range" refer to the last one.
    result: str
    #: RMS distance between true and estimated contact point, the touched point of the surface, by all error sources of
    #: `budget_mm`; of fused touches in the world, to first order.
    predicted_error_mm: float | None = None
    predicted_error_95_mm: float | None = None  #: radius that contains 95 % of the errors.
    #: RMS distance by sensor noise and the prior on friction, all else exactly known.
    noise_error_mm: float | None = None
    noise_error_95_mm: float | None = None  #: its 95 % radius.
    #: RMS distance by error source; the squares add up to that of predicted_error_mm.
    budget_mm: dict[str, float] | None = None


@dataclass(frozen=True)
class FusedCondition(PredictedTouch):
    """Prediction for several touches of one point as the base presses on."""

    touches: int = 0  #: number of touches.


@dataclass(frozen=True)
class FusedHeadline:
    """The figure by which fused touches are compared: their error at one position, in the worst direction."""

    touches: int  #: number of touches of one point, in equal steps of the force.
    force_N: float  #: normal force of the last touch.
    contact_fraction: float  #: arclength of the touched section over the length.
    #: RMS distance by all error sources; None if touches of any direction are not located.
    predicted_error_mm: float | None

    @property
    def label(self) -> str:
        """Return the condition in words."""
        where = f"{1e3 * self.force_N:g} mN at {self.contact_fraction:g} L"
        return f"{self.touches} touches up to {where}, worst direction"


def fused_headline_of(conditions: Sequence[FusedCondition], touches: int, contact_fraction: float) -> FusedHeadline:
    """Return the headline of a grid of fused touches at one position."""
    here = [c for c in conditions if (c.contact_fraction, c.force_N) == (contact_fraction, SHOWN_N)]
    errors = [c.predicted_error_mm for c in here if c.predicted_error_mm is not None]
    worst = max(errors) if errors and len(errors) == len(here) else None
    return FusedHeadline(touches, SHOWN_N, contact_fraction, worst)


T = TypeVar("T", bound=PredictedTouch)


def worst(conditions: Sequence[T], force_N: float) -> list[T]:
    """Return the direction with the largest error at each position, at the grid's force nearest to `force_N`."""
    nearest = min((c.force_N for c in conditions), key=lambda force: abs(force - force_N), default=0.0)
    here = [c for c in conditions if c.force_N == nearest and c.budget_mm is not None]
    fractions = sorted({c.contact_fraction for c in here})
    return [
        max((c for c in here if c.contact_fraction == fraction), key=lambda c: c.predicted_error_mm or 0.0)
        for fraction in fractions
    ]


def forces_of(schedule: PressSchedule, forces_N: Sequence[float]) -> set[float]:
    """Return the forces of all touches of presses up to the given forces [N]."""
    return {force for greatest in forces_N for force in schedule.forces(greatest)}


def fused_conditions(
    lines: Sequence[Line],
    touches: Mapping[float, Touches],
    forces_N: Sequence[float],
    schedule: PressSchedule,
    on_progress: OnProgress = quiet,
) -> tuple[FusedCondition, ...]:
    """Predict all lines at each largest force.

    Args:
        lines: the first of the lines that were solved.
        touches: by force, at least those of `forces_of`.
        forces_N: largest forces [N].
        schedule: how the touches are made.
        on_progress: receives the step and its share before each condition.
    """
    fractions = list(dict.fromkeys(fraction for fraction, _ in lines))
    conditions = []
    for k, fraction in enumerate(fractions):
        for force in forces_N:
            pressed = [touches[f] for f in schedule.forces(force)]
            for i, line in enumerate(lines):
                if line[0] == fraction:
                    on_progress("fused touches", k / len(fractions))
                    conditions.append(_condition(line, pressed, i, force, schedule))
    return tuple(conditions)


def _condition(line: Line, touches: Sequence[Touches], i: int, force: float, schedule: PressSchedule) -> FusedCondition:
    """Predict one condition, the i-th line of touches in the order of time, the last one of a force [N]."""
    buckled = FusedCondition(line[0], force, line[1], "gives_way", touches=schedule.touches)
    if not all(of.ok[i] for of in touches):
        return buckled
    estimator, pressed = touches[-1].estimator, np.array([of.touch[i] for of in touches])
    model = estimator.model
    press = LinearizedPresses(model, estimator.priors, model.gravity_base, pressed, schedule)
    if not press.converged:
        return buckled
    budget = press.split()
    error, within = _mm(budget.total)
    if touches[-1].sensor_use[i] > 1.0:
        return replace(buckled, result="out_of_range")
    if not error * MM < model.rod.length * UNIFORM_STD:
        return replace(buckled, result="unobservable" if schedule.moments_about else "too_light")
    noise, noise_within = _mm(budget.cov_noise)
    by_source = dict(zip(FUSED_CAUSES, (budget.rms / MM).tolist(), strict=True))
    return replace(
        buckled, result="ok", predicted_error_mm=error, predicted_error_95_mm=within, noise_error_mm=noise,
        noise_error_95_mm=noise_within, budget_mm=by_source,
    )  # fmt: skip


def _mm(cov: Array) -> tuple[float, float]:
    """Return the RMS error and the 95 % radius of a covariance [mm]."""
    return rms(cov) / MM, radius_95(cov) / MM
