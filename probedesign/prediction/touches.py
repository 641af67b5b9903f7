"""Equilibrium touches of a probe's surface, and the error with which one reading of each locates it.

`SurfaceRod` and `ForceContinuation` follow a press from the free probe by continuation in the force; `touches_of`
solves a grid of positions, directions and forces.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.parallel import OnProgress, quiet
from probedesign.core.statistics import rms_each
from probedesign.estimation.error_sources import FINE, NOTHING, ErrorSources
from probedesign.estimation.estimator import Estimator
from probedesign.prediction.budget import ErrorBudget, error_budget, radii_95
from probedesign.rod.contact import outline
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.kernels import surface_contact as kernel
from probedesign.rod.kernels.surface_contact import (
    ALONG,
    AROUND,
    BY_TOUCH,
    CENTRE,
    DEAD,
    NORMAL,
    OWN,
    PHI,
    POINT,
    ROWS,
    TIP,
    TOUCH,
    TURN,
    UNKNOWNS,
    VALUE,
    S,
)
from probedesign.rod.rod import Rod

#: Force step, relative to the force reached, below which a press is not divided further: the probe buckles.
_MIN_STEP = 1e-3
_MAX_TURN = 0.3  #: Predicted rotation of the tip in one step [rad].
#: Rotation between the predicted and the solved tip [rad]; a larger one has left the solution branch.
_MAX_PREDICTION_ERROR = 0.15


_MAX_ITERATIONS = 12
_LATERAL_TOLERANCE = 1e-6  #: Distance from the straight line of a press, relative to the length, that counts as zero.
_MAX_SLIDE = 0.05  #: Slide in one iteration, relative to the length.
#: Direction in which the object pushes, as an angle about the tangent from the section's X axis [rad]. The axes X and Y
#: of a section are those of the base, carried along the axis of the probe without twist.
DIRECTIONS = {"+x": 0.0, "-x": math.pi, "+y": math.pi / 2, "-y": -math.pi / 2}
#: Directions of which a curved probe is predicted: it is not symmetric.
ALL_AROUND = ("+x", "45deg", "135deg", "-x", "225deg", "-y", "315deg", "+y")


def directions_of(rod: Rod) -> tuple[str, ...]:
    """Return the directions in which a probe is predicted to be pushed: `ALL_AROUND` if it is curved."""
    return ALL_AROUND if rod.is_curved else ("+x", "-x", "+y")


def angle_of(direction: str) -> float:
    """Return the angle of a direction [rad]: of a key of `DIRECTIONS`, or of degrees such as "30deg".

    Raises:
        InputError: the direction is neither.
    """
    if direction in DIRECTIONS:
        return DIRECTIONS[direction]
    try:
        angle = math.radians(float(direction.removesuffix("deg"))) if direction.endswith("deg") else math.nan
    except ValueError:
        angle = math.nan
    if not math.isfinite(angle):
        raise InputError(f"direction '{direction}' is unknown; known: {', '.join(DIRECTIONS)}, 30deg")
    return angle


@dataclass(frozen=True)
class SurfaceRod:
    """A rod under gravity whose surface is touched."""

    rod: Rod  #: the rod.
    gravity: Array  #: base axes [m/s²], (3,).
    mass: float  #: of the flexible part [kg].
    free: Equilibrium  #: the equilibrium without contact.

    def linearize(self, touch: Array) -> Array | None:
        """Solve a touch in place and return its linearisation.

        Args:
            touch: unknowns, dead loads and tip, (TOUCH,); dead loads and tip are made consistent with the unknowns.

        Returns:
            Values and derivatives by the touch, (ROWS, 1 + UNKNOWNS); None where the rod has no equilibrium.
        """
        lin = np.empty((ROWS, 1 + UNKNOWNS))
        work = np.empty(kernel.work_size(0))
        converged = kernel.linearise_touch(self.rod.body, self.gravity, self.mass, FINE, touch, True, 0, work, lin)
        return lin if converged else None

    def begin_press(self, s: float, phi: float, ratios: Sequence[float] = (0.0, 0.0)) -> "ForceContinuation":
        """Return a press of negligible force at a point of the surface.

        Args:
            s: arclength [m]; limited to the end of the flank.
            phi: angle around the section [rad].
            ratios: of tangential over normal force, around and along.
        """
        touch = np.zeros(TOUCH)
        touch[S], touch[PHI], touch[NORMAL] = min(s, self.rod.flank_end), phi, NOTHING
        touch[AROUND], touch[ALONG] = ratios
        touch[TIP:] = self.free.tip
        return ForceContinuation(self, touch, self.linearize(touch) if self.free.ok else None)


class ForceContinuation:
    """A press at one point of the surface, followed by continuation in the normal force.

    Attributes:
        on: the rod.
        touch: unknowns, dead loads and tip at the force reached, (TOUCH,).
        lin: its linearisation; None once a force without equilibrium was requested.
    """

    def __init__(self, on: SurfaceRod, touch: Array, lin: Array | None) -> None:
        """Start at a consistent touch."""
        self.on, self.touch, self.lin = on, touch, lin

    def increase_to(self, force: float) -> Array | None:
        """Return the touch at a larger normal force, (TOUCH,); None where the probe buckles before it.

        Args:
            force: [N], not less than at the previous call.
        """
        target = self.touch[:UNKNOWNS].copy()
        target[NORMAL] = force
        while self.lin is not None:
            goal = target - self.touch[:UNKNOWNS]
            turn = self.lin[TURN : TURN + 3, BY_TOUCH : BY_TOUCH + UNKNOWNS] @ goal
            share = first = min(1.0, _MAX_TURN / max(math.sqrt(turn @ turn), 1e-300))
            smallest = _MIN_STEP * max(first, self.force / max(abs(goal[NORMAL]), 1e-300))
            while not self._try_step(share * goal):
                share *= 0.3
                if share < min(smallest, 0.3 * first):
                    self.lin = None
                    return None
            if share == 1.0:
                return self.touch.copy()
        return None

    def _try_step(self, step: Array) -> bool:
        """Take a step if the rod has an equilibrium there on the same branch, and return whether it has."""
        assert self.lin is not None
        ahead = self.touch.copy()
        kernel.move_touch(ahead, self.lin, step, np.empty(kernel.MOVE))
        predicted = ahead[TIP:].copy()
        lin = self.on.linearize(ahead)
        error = ahead[TIP:] - predicted
        if lin is None or error @ error > _MAX_PREDICTION_ERROR**2:
            return False
        self.touch, self.lin = ahead, lin
        return True

    def shift(self, by_s: float) -> bool:
        """Move the touch along the surface [m] at constant force; return whether there is an equilibrium."""
        step = np.zeros(UNKNOWNS)
        step[S] = by_s
        return self.lin is not None and self._try_step(step)

    @property
    def force(self) -> float:
        """Return the normal force reached so far [N]."""
        return float(self.touch[NORMAL])


def slide(on: SurfaceRod, s: float, phi: float, forces: Sequence[float]) -> float:
    """Return how far a fixed object slides along the rod while the base presses on along a straight line.

    The base moves against the outward normal of the free rod. Friction along the rod, which would shorten the slide, is
    neglected: to stick, a straight press of a slender probe needs several times the normal force along it, because the
    surface rotates with the section. Around the rod friction holds the object: without it, no round rod could be
    pressed by more than its radius before the object passes it sideways.

    Args:
        on: the rod.
        s: arclength of the first touch [m].
        phi: angle around the section [rad].
        forces: ascending normal forces [N].

    Returns:
        Largest change of arclength from the first touch [m]; infinite where the object slips off the end of the flank
        or the probe buckles.
    """
    press, max_slide = on.begin_press(s, phi), 0.0
    if press.lin is None:
        return math.inf
    begin = float(press.touch[S])
    start = press.lin[POINT : POINT + 3, 0].copy()
    push = press.lin[0:3, BY_TOUCH + NORMAL]
    along = press.lin[POINT : POINT + 3, BY_TOUCH + S]
    along = along - (along @ push) / (push @ push) * push
    along /= np.linalg.norm(along)
    for force in forces:
        if press.increase_to(force) is None:
            return math.inf
        for _ in range(_MAX_ITERATIONS):
            assert press.lin is not None
            aside = along @ (press.lin[POINT : POINT + 3, 0] - start)
            if abs(aside) <= _LATERAL_TOLERANCE * on.rod.length:
                break
            newton = -float(aside / (along @ press.lin[POINT : POINT + 3, BY_TOUCH + S]))
            change = float(np.clip(newton, -_MAX_SLIDE * on.rod.length, _MAX_SLIDE * on.rod.length))
            if not 0.0 <= press.touch[S] + change <= on.rod.flank_end or not press.shift(change):
                return math.inf
        else:
            return math.inf
        max_slide = max(max_slide, abs(float(press.touch[S]) - begin))
    return max_slide


@dataclass(frozen=True)
class Touches:
    """Touches of n lines (a position and a direction each) at one normal force without friction.

    Rows are NaN where the probe buckles.
    """

    estimator: Estimator  #: whose priors and friction the error budget includes.
    sources: ErrorSources  #: its error sources under the mount's gravity.
    force_N: float  #: normal force [N].
    touch: Array  #: unknowns, dead loads and tip of each, (n, TOUCH).
    lin: Array  #: linearisations, (n, ROWS, 1 + UNKNOWNS + parameters), see `rod.kernels.surface_contact`.
    D: Array  #: one standard deviation of each error source, (n, 12, J), see `ErrorSources.columns_at`.
    max_stable_force: Array  #: largest normal force up to this one with an equilibrium [N], (n,).

    @cached_property
    def ok(self) -> NDArray[np.bool_]:
        """Return which touches have an equilibrium, (n,)."""
        return np.asarray(np.isfinite(self.lin[:, 0, VALUE]))

    @property
    def wrench(self) -> Array:
        """Return the wrenches at the base without noise [N, N·m], (n, 6)."""
        return self.lin[:, 0:6, VALUE]

    @property
    def centre(self) -> Array:
        """Return the points of the centreline where the forces act without a couple [m], (n, 3)."""
        return self.lin[:, CENTRE : CENTRE + 3, VALUE]

    @property
    def wrench_by_force(self) -> Array:
        """Return the derivative of the base wrench by the normal force, (n, 6)."""
        return self.lin[:, 0:6, BY_TOUCH + NORMAL]

    @cached_property
    def budget(self) -> ErrorBudget:
        """Return the error budget of each touch."""
        return error_budget(self.touch, self.lin, self.D, self.sources, self.estimator.model.friction)

    @cached_property
    def rms(self) -> tuple[Array, Array]:
        """Return the RMS error of the touched point by all error sources, and by sensor noise alone [m], (n,) each."""
        return rms_each(self.budget.total), rms_each(self.budget.cov_noise)

    @cached_property
    def within_95(self) -> tuple[Array, Array]:
        """Return the radius that contains 95 % of these errors [m], (n,) each."""
        return radii_95(self.budget.total), radii_95(self.budget.cov_noise)

    @cached_property
    def sensor_use(self) -> Array:
        """Return the largest fraction of a channel's range that each reading takes, (n,)."""
        model = self.estimator.model
        read = model.to_sensor(self.wrench, model.gravity_base)
        return np.asarray((np.abs(read) / model.wrench_range).max(axis=1))

    @cached_property
    def press_per_N(self) -> Array:
        """Return the derivative of the indentation along the force by the normal force [m/N], (n,)."""
        force = self.touch[:, DEAD : DEAD + 3]
        by = self.lin[:, POINT : POINT + 3, BY_TOUCH + NORMAL]
        return np.asarray(np.einsum("ni,ni->n", force, by) / np.linalg.norm(force, axis=1))

    @cached_property
    def free_centre(self) -> Array:
        """Return the touched points of the centreline on the free probe [m], (n, 3)."""
        rod, s = self.estimator.model.rod, np.nan_to_num(self.touch[:, S])
        phi = np.nan_to_num(self.touch[:, PHI])
        reach, _ = outline(rod.flatness, np.cos(phi), np.sin(phi))
        return self.estimator.free().p_at(np.clip(s - rod.radius_at(s) * reach**2 * rod.taper_at(s), 0.0, rod.length))

    @cached_property
    def deflection(self) -> Array:
        """Return the distance of each point from its place on the free probe [m], (n,)."""
        return np.asarray(np.linalg.norm(self.centre - self.free_centre, axis=1))

    def results(self) -> list[str]:
        """Return the estimator's result code for each reading without noise; "gives_way" where the probe buckles."""
        return [self._result(i) for i in range(len(self.touch))]

    def _result(self, i: int) -> str:
        if not self.ok[i]:
            return "gives_way"
        if self.sensor_use[i] > 1.0:
            return "out_of_range"
        if not self.estimator.detects(self.wrench[i]):
            return "no_contact"
        touch = self.touch[i]
        return self.estimator.result_at(float(touch[S]), float(self.budget.std_s[i]), touch[DEAD : DEAD + 3])


def touches_of(
    estimator: Estimator, lines: Sequence[tuple[float, str]], forces_N: Sequence[float], on_progress: OnProgress = quiet
) -> dict[float, Touches]:
    """Solve all lines at all forces.

    Args:
        estimator: of a probe with a stable free equilibrium.
        lines: contact fraction (arclength of the touched section over the length) and direction of each.
        forces_N: normal forces [N], in any order.
        on_progress: receives the step and its share before each line.

    Returns:
        Touches by force.
    """
    model, forces = estimator.model, sorted(set(forces_N))
    gravity = model.gravity_base
    free = estimator.free()
    sources = ErrorSources.of(model, estimator.priors, gravity, free)
    on = SurfaceRod(model.rod, gravity, model.mass, free)
    n, m = len(lines), len(forces)
    touch = np.full((m, n, TOUCH), np.nan)
    lin = np.full((m, n, ROWS, 1 + UNKNOWNS + OWN + len(model.rod.s)), np.nan)
    D = np.full((m, n, 12, len(sources.names)), np.nan)
    max_stable_force = np.zeros((m, n))
    for i, (fraction, direction) in enumerate(lines):
        on_progress("touches", i / n)
        # An object that pushes towards +x touches the side at -x.
        press = on.begin_press(fraction * model.rod.length, angle_of(direction) + math.pi)
        for j, force in enumerate(forces):
            pressed = press.increase_to(force)
            max_stable_force[j:, i] = press.force
            if pressed is None:
                break
            touch[j, i] = pressed
            lin[j, i], D[j, i] = sources.columns_at(touch[j, i])
    return {
        force: Touches(estimator, sources, force, touch[j], lin[j], D[j], max_stable_force[j])
        for j, force in enumerate(forces)
    }


def check_grid(fractions: Sequence[float], forces_N: Sequence[float], directions: Sequence[str]) -> None:
    """Check a grid of touches.

    Raises:
        InputError: a fraction, force or direction is out of range.
    """
    for fraction in fractions:
        if not 0.0 < fraction <= 1.0:
            raise InputError(f"contact fraction {fraction:g} must lie in (0, 1]")
    for force in forces_N:
        if not 0.0 < force <= 100.0:
            raise InputError(f"force {force:g} N must lie in (0, 100]")
    for direction in directions:
        angle_of(direction)
