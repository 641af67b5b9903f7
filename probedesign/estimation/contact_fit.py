"""The contact that explains a reading best: Gauss-Newton on the five unknowns of a touch (compiled).

Equilibrium and contact are found together: the equilibrium next to a guess follows to first order from one sweep
(`rod.kernels.surface_contact`), so each iteration costs one sweep. Minimised is

    |W (h(y) - w)|² + (a_1/μ)² + (a_2/μ)²,

the misfit of the base wrench whitened by its covariance, and the prior on friction.
"""

import math
from typing import NamedTuple

import numpy as np

from probedesign.core.frames import Array
from probedesign.rod.kernels import inner
from probedesign.rod.kernels.equations import OK, Body
from probedesign.rod.kernels.linalg import scale_and_factor, solve_scaled
from probedesign.rod.kernels.surface_contact import (
    AROUND,
    BY_TOUCH,
    CLAMPED,
    MOVE,
    NORMAL,
    PHI,
    TOUCH,
    UNKNOWNS,
    VALUE,
    WRENCH,
    S,
    advance,
    linearise,
    plan_move,
)

#: Outcomes of a fit: a minimum of the misfit; one at an end of the probe; no lower misfit found although this is no
#: minimum, as where no contact explains the reading; no equilibrium.
FITTED, AT_END, STALLED, LOST = 0, 1, 2, 3
RESIDUALS = 8  #: Six channels and two components of the friction.
#: A smaller prior standard deviation of the friction ratio is taken for this one: the force is then normal to within a
#: hundredth of the angle that any sensor resolves.
MIN_FRICTION = 1e-4
#: Error of a sweep's step [rad]: that of the rod's fast mode or, where the reading's noise hides more, so many standard
#: deviations of the moment over the moment itself, up to the last.
FINEST, COARSEST, OF_NOISE = 5e-7, 1e-5, 3e-3
CLOSE = 1e-7  #: Step of arclength over length at which the fit ends.
#: Decrease of the misfit by a step at which the fit also ends: a hundredth of a standard deviation. That last step is
#: taken, to first order.
FLAT = 1e-4
JITTER = 1e-3  #: Increase of the misfit by the sweeps' errors that is accepted, in addition to a ten-thousandth of it.
#: Sweeps of one fit: it takes 3 to 10 from a good guess; more means that it creeps along a flat valley.
MAX_ITERATIONS = 30
#: Largest changes of arclength over length, of the tip [rad] and around the section [rad] in one iteration: within them
#: the linearisation is useful.
MAX_STEP, MAX_TURN, MAX_AROUND = 0.06, 0.5, 0.7
MIN_PUSH = 0.25  #: Share of the normal force that one iteration leaves at least: a contact pushes.
#: Sweeps that end at the limit of their steps before a fit is given up; one costs as much as a hundred others.
MAX_FAILED = 2
_SMALLEST = 1e-4  #: Share of a step below which it is not shortened any more.
#: Memory that a fit works in beside its sweeps: of Gauss-Newton the touch before a step, residuals, their derivatives,
#: normal equations and the step; of a profile the touch to go on from; of the weights the whitening by noise alone and
#: a covariance; of the covariance the derivatives of s_contact, and touch, residuals and directions of the valley (see
#: `uncertainty_kernel`).
FIT_SCRATCH = np.dtype([
    ("before", "f8", TOUCH), ("kept", "f8", TOUCH), ("J", "f8", (RESIDUALS, UNKNOWNS)), ("r", "f8", RESIDUALS),
    ("H", "f8", (UNKNOWNS, UNKNOWNS)), ("full", "f8", (UNKNOWNS, UNKNOWNS)), ("b", "f8", UNKNOWNS),
    ("step", "f8", UNKNOWNS), ("scale", "f8", UNKNOWNS), ("move", "f8", MOVE),
    ("noise_whiten", "f8", (6, 6)), ("cov", "f8", (6, 6)), ("factor", "f8", (6, 6)), ("by_s", "f8", UNKNOWNS),
    ("identity", "f8", (UNKNOWNS, UNKNOWNS)), ("solved", "f8", (UNKNOWNS, UNKNOWNS)),
    ("at", "f8", TOUCH), ("change", "f8", UNKNOWNS), ("beside", "f8", (RESIDUALS, UNKNOWNS)), ("axis", "f8", 3),
    ("along", "f8", UNKNOWNS), ("valley", "f8", (2, UNKNOWNS)), ("offsets", "f8", (2, 6)),
])  # fmt: skip


class Measured(NamedTuple):
    """What a touch is fitted to."""

    body: Body  #: of the rod.
    end: float  #: the furthest arclength at which a touch acts [m].
    gravity: Array  #: base axes [m/s²], (3,).
    mass: float  #: of the flexible part [kg].
    wrench: Array  #: read at the base, (6,).
    friction: float  #: prior standard deviation of the friction ratio; inf: the direction is free.


class FitMemory(NamedTuple):
    """Memory of a fit beside `FIT_SCRATCH`."""

    sweep: Array  #: of sweeps, (work_size(parameters),).
    lin: Array  #: linearisation with all parameters of the rod, (ROWS, 1 + UNKNOWNS + parameters).
    D: Array  #: error columns, (12, J).
    gain: Array  #: gains of a point on the reading, (3, 6 + J).
    lin_touch: Array  #: linearisation by the touch alone, (ROWS, 1 + UNKNOWNS).
    room: Array  #: of the trace, (candidates.ROOM + K,).


@inner
def sweep_tolerance(wrench, whiten):
    """Return the error of a sweep's step [rad] that is negligible beside the noise of such a reading."""
    size = math.sqrt(wrench[3] ** 2 + wrench[4] ** 2 + wrench[5] ** 2)
    return min(max(OF_NOISE / max(whiten[3, 3] * size, 1e-300), FINEST), COARSEST)


@inner
def residuals(lin, touch, wrench, whiten, friction, J, r):
    """Fill in the whitened misfit and the friction over its prior, r (8,), with derivatives by the touch, J (8, 5).

    Args:
        friction: standard deviation of the ratio; inf leaves the direction of the force free.

    Returns:
        |r|².
    """
    square = 0.0
    for i in range(6):
        r[i] = 0.0
        for j in range(UNKNOWNS):
            J[i, j] = 0.0
        for q in range(i + 1):  # whiten is lower triangular
            w = whiten[i, q]
            r[i] += w * (lin[WRENCH + q, VALUE] - wrench[q])
            for j in range(UNKNOWNS):
                J[i, j] += w * lin[WRENCH + q, BY_TOUCH + j]
        square += r[i] * r[i]
    per = 1.0 / max(friction, MIN_FRICTION)
    for a in range(2):
        for j in range(UNKNOWNS):
            J[6 + a, j] = 0.0
        r[6 + a] = touch[AROUND + a] * per
        J[6 + a, AROUND + a] = per
        square += r[6 + a] * r[6 + a]
    return square


@inner
def normal_equations(J, r, H, b):
    """Fill in H = Jᵀ J (5, 5) and b = -Jᵀ r (5,)."""
    information(J, H)
    for u in range(UNKNOWNS):
        b[u] = 0.0
        for i in range(RESIDUALS):
            b[u] -= J[i, u] * r[i]


@inner
def information(J, H):
    """Fill in H = Jᵀ J (5, 5)."""
    for u in range(UNKNOWNS):
        for v in range(u + 1):
            total = 0.0
            for i in range(RESIDUALS):
                total += J[i, u] * J[i, v]
            H[u, v] = total
            H[v, u] = total


@inner
def bounded_step(H, b, scale, low, high, touch, step, full):
    """Solve the normal equations H step = b, with the arclength kept between low and high [m].

    Args:
        step: filled, (5,); scale, full: scratch, (5,) and (5, 5).

    Returns:
        1 where a bound limits the step, 0 where none does, -1 if there is no solution.
    """
    for u in range(UNKNOWNS):
        step[u] = b[u]
        for v in range(UNKNOWNS):
            full[u, v] = H[u, v]
    if not scale_and_factor(full, UNKNOWNS, scale):
        return -1
    solve_scaled(full, UNKNOWNS, scale, step)
    bounded = 0
    way = min(max(step[S], low - touch[S]), high - touch[S])
    if way != step[S]:
        bounded = 1
        for u in range(UNKNOWNS):
            step[u] = way if u == S else b[u] - H[u, S] * way
            for v in range(UNKNOWNS):
                full[u, v] = H[u, v] if u != S and v != S else 1.0 if u == v else 0.0
        if not scale_and_factor(full, UNKNOWNS, scale):
            return -1
        solve_scaled(full, UNKNOWNS, scale, step)
        step[S] = way
    for u in range(UNKNOWNS):
        if not math.isfinite(step[u]):
            return -1
    return bounded


@inner
def step_share(step, touch, move, length):
    """Return the share of a step that neither goes too far, nor turns the tip too much, nor pulls."""
    turn = 0.0
    for q in range(3):
        turn += abs(move[6 + q]) + abs(move[15 + q])
    share = min(1.0, MAX_STEP * length / max(abs(step[S]), 1e-300), MAX_TURN / max(turn, 1e-300))
    share = min(share, MAX_AROUND / max(abs(step[PHI]), 1e-300))
    if step[NORMAL] < 0.0:
        share = min(share, (MIN_PUSH - 1.0) * touch[NORMAL] / step[NORMAL])
    return share


@inner
def fit_touch(measured, whiten, low, high, max_iterations, touch, sweep_work, lin, work):
    """Minimise the misfit over touches of the surface, from a guess.

    Args:
        measured: what it is fitted to.
        whiten: lower triangular, with whitenᵀ whiten the inverse covariance of the wrench, (6, 6).
        low, high: arclengths between which the touch may lie [m].
        max_iterations: after which the fit is given up.
        touch: the guess, then the fit, (TOUCH,).
        sweep_work: scratch, (work_size(0),); lin: at the last linearisation but for the last step,
            (ROWS, 1 + UNKNOWNS).
        work: scratch, FIT_SCRATCH.

    Returns:
        What became of it (FITTED, ...), the misfit squared, iterations.
    """
    before, J, r, H, b = work.before[:], work.J, work.r, work.H[:, :], work.b[:]
    step, move, length = work.step[:], work.move[:], measured.body.knots[-1]
    tol = sweep_tolerance(measured.wrench, whiten)
    least, share, size, failed = math.inf, 1.0, 1.0, 0
    for iteration in range(max_iterations):
        # A size below 1e-6 would ask for steps finer than rounding.
        status, lack, margin, size = linearise(
            measured.body, measured.gravity, measured.mass, tol, max(size, 1e-6), touch, 0, sweep_work, lin
        )
        merit = math.inf
        if status == OK and lack < math.inf:
            merit = residuals(lin, touch, measured.wrench, whiten, measured.friction, J, r)
        failed += status != OK
        if not (math.isfinite(merit) and merit <= least * (1.0 + 1e-4) + JITTER):
            if not math.isfinite(least) or share < _SMALLEST or failed > MAX_FAILED:
                return (STALLED if math.isfinite(least) else LOST), least, iteration
            share *= 0.25  # the misfit is far from quadratic here: halving would take many sweeps
            advance(touch, before, share, step, move)
            continue
        least = merit
        normal_equations(J, r, H, b)
        bounded = bounded_step(H, b, work.scale[:], low, high, touch, step, work.full[:, :])
        if bounded < 0:
            return LOST, merit, iteration
        gain = 0.0
        for u in range(UNKNOWNS):
            gain += b[u] * step[u]
        for q in range(TOUCH):
            before[q] = touch[q]
        plan_move(lin, step, move)
        share = step_share(step, touch, move, length)
        small = gain <= FLAT * (1.0 + merit) or (bounded == 0 and abs(step[S]) <= CLOSE * length)
        advance(touch, before, share, step, move)
        if share == 1.0 and small and lack <= CLAMPED:
            return (LOST if not margin > 0.0 else AT_END if bounded else FITTED), merit, iteration
    return (STALLED if math.isfinite(least) else LOST), least, max_iterations
