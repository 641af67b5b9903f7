"""The contact that explains a reading best, compiled: equilibrium and contact are found together.

Unknown are the force F and its arclength s. The equilibrium under a guess is known to first order from one sweep
(`rod/kernels/linear.py`), so each iteration of Gauss and Newton costs one sweep, and none is spent on equilibria
that nobody asked for. Without friction the force is normal to the bent surface,

    F · t + |F| sin α = 0,

which takes one of the four unknowns away: what is left are arclength, angle around the section and magnitude.
"""

import math
from pathlib import Path

from probedesign.rod.kernels.body import FORCE, GRAVITY, OK, S_CONTACT
from probedesign.rod.kernels.compiled import drop_stale, inner, merged
from probedesign.rod.kernels.linear import MOST_LACK, linear_equilibrium, tips_turn
from probedesign.rod.kernels.newton import turn_tip
from probedesign.rod.kernels.vectors import add, take

drop_stale(Path(__file__).parent)

FITTED, AT_END, STALLED, LOST = 0, 1, 2, 3
"""What became of a fit: a least misfit; one held by an end of the probe; no lower misfit to be found though this is
no least one, as where no contact explains the reading; no equilibrium."""
TIP, PUSH, PLACE = 0, 6, 9
STATE = 10
"""Where in the unknowns stand the tip's section (6), the force (3) and s_contact; and how many they are."""
UNKNOWNS = 4
"""Force and arclength."""

FINEST, COARSEST, OF_NOISE = 5e-7, 1e-5, 3e-3
"""Error of a sweep's step [rad]: that of the rod's fast mode or, where the reading's noise hides more, so many
standard deviations of the moment over the moment itself, up to the last."""
CLOSE = 1e-7
"""Step of arclength over length, at which the fit ends."""
FLAT = 1e-4
"""What a step would still take off the whitened misfit squared, at which the fit ends too: a hundredth of a standard
deviation. That last step is taken, to first order."""
JITTER = 1e-3
"""What the sweeps' errors may add to the whitened misfit squared, beside a ten-thousandth of it."""
SIDE = 1e-2
"""How much a force that is not normal yet counts beside the misfit."""
CLAMPED = 1e-4
"""Misfit of the base [rad] up to which its linear answer is exact: an error of its square."""
MAX_ITERATIONS = 30
MAX_STEP, MAX_TURN = 0.06, 0.5
"""Of arclength over length, and of the tip [rad], in one iteration."""
_SMALLEST = 1e-4
"""Share of a step below which it is not halved any more."""
WORK, STEP = 72, 49
"""Numbers that a fit works in, and where its last step stands among them."""


@inner
def slope_at(body, s):
    """sin α of the frustum that s lies in."""
    i = 0
    while i + 2 < body.knots.shape[0] and s > body.knots[i + 1]:
        i += 1
    tan = (body.radii[i] - body.radii[i + 1]) / (body.knots[i + 1] - body.knots[i])
    return tan / math.sqrt(1.0 + tan * tan)


@inner
def radius_at(body, s):
    """Of the section [m]."""
    i = 0
    while i + 2 < body.knots.shape[0] and s > body.knots[i + 1]:
        i += 1
    share = (s - body.knots[i]) / (body.knots[i + 1] - body.knots[i])
    return body.radii[i] + share * (body.radii[i + 1] - body.radii[i])


@inner
def tolerance(wrench, whiten):
    """Error of a sweep's step [rad] that such a reading does not feel."""
    size = math.sqrt(wrench[3] ** 2 + wrench[4] ** 2 + wrench[5] ** 2)
    return min(max(OF_NOISE / max(whiten[3, 3] * size, 1e-300), FINEST), COARSEST)


@inner
def normality(force, sine, derivatives, gradient):
    """F · t + |F| sin α [N] and its derivatives by force and arclength, (4,)."""
    size = math.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
    k = derivatives.shape[1] - 1
    off = size * sine
    for q in range(3):
        off += force[q] * derivatives[3 + q, k]
    for j in range(UNKNOWNS):
        gradient[j] = 0.0
        for q in range(3):
            gradient[j] += force[q] * derivatives[3 + q, j]
    for q in range(3):
        gradient[q] += derivatives[3 + q, k] + (sine * force[q] / size if size > 0.0 else 0.0)
    return off


@inner
def whitened(wrench, weight, force, whiten, derivatives, J, r):
    """The misfit of the base wrench, r (6,), and its derivatives by force and arclength, J (24,), both whitened."""
    k = derivatives.shape[1] - 1
    for i in range(6):
        r[i] = 0.0
        for j in range(UNKNOWNS):
            J[UNKNOWNS * i + j] = 0.0
        for q in range(i + 1):  # whiten is lower triangular
            w = whiten[i, q]
            if q < 3:
                r[i] += w * (force[q] + weight[q] - wrench[q])
                J[UNKNOWNS * i + q] += w
            else:
                r[i] += w * (derivatives[q - 3, k] - wrench[q])
                for j in range(UNKNOWNS):
                    J[UNKNOWNS * i + j] += w * derivatives[q - 3, j]


@inner
def made_normal(J, r, gradient, off):
    """The misfit once one of the force's unknowns has taken care of its being normal, in place of r.

    A force that is not quite normal fits better than it may, so steps cannot be judged by their misfit as it is.
    Returns which unknown that is, and the misfit squared.
    """
    out = 0
    for q in range(1, 3):
        if abs(gradient[q]) > abs(gradient[out]):
            out = q
    square = 0.0
    for i in range(6):
        r[i] -= J[UNKNOWNS * i + out] * off / gradient[out]
        square += r[i] * r[i]
    return out, square


@inner
def reduced(J, r, gradient, out, H, b):
    """Normal equations of the three unknowns left beside the one that keeps the force normal."""
    for q in range(9):
        H[q] = 0.0
    for q in range(3):
        b[q] = 0.0
    for i in range(6):
        o = UNKNOWNS * i
        for u in range(3):
            ju = free(out, u)
            a = J[o + ju] - J[o + out] * gradient[ju] / gradient[out]
            b[u] -= a * r[i]
            for v in range(3):
                jv = free(out, v)
                H[3 * u + v] += a * (J[o + jv] - J[o + out] * gradient[jv] / gradient[out])


@inner
def free(out, u):
    """The u-th unknown left: two of the force's, then arclength."""
    return 3 if u == 2 else (out + 1 + u) % 3


@inner
def solve_3(H, b, x):
    """H x = b for a symmetric positive H (9,), scaled first: newtons beside metres. Whether it could be."""
    d0, d1, d2 = math.sqrt(H[0]), math.sqrt(H[4]), math.sqrt(H[8])
    if not (d0 > 0.0 and d1 > 0.0 and d2 > 0.0):
        return False
    a, c, e = H[1] / (d0 * d1), H[2] / (d0 * d2), H[5] / (d1 * d2)
    p = 1.0 - a * a + 1e-14
    m = e - a * c
    n = 1.0 - c * c - m * m / p + 1e-14
    if not (p > 0.0 and n > 0.0):
        return False
    y0 = b[0] / d0
    y1 = b[1] / d1 - a * y0
    y2 = (b[2] / d2 - c * y0 - m * y1 / p) / n
    z1 = (y1 - m * y2) / p
    x[0], x[1], x[2] = (y0 - a * z1 - c * y2) / d0, z1 / d1, y2 / d2
    return math.isfinite(x[0]) and math.isfinite(x[1]) and math.isfinite(x[2])


@inner
def _held(H, b, way, x):
    """The two unknowns beside an arclength that goes `way` and no further."""
    b0, b1 = b[0] - H[2] * way, b[1] - H[5] * way
    det = H[0] * H[4] - H[1] * H[1]
    x[0], x[1], x[2] = (b0 * H[4] - b1 * H[1]) / det, (b1 * H[0] - b0 * H[1]) / det, way


@inner
def _step(state, H, b, gradient, off, out, low, high, x, step):
    """The step of force and arclength that the linear equations ask for; whether an end holds it, or -1."""
    if not solve_3(H, b, x):
        return -1
    held = 0
    way = min(max(x[2], low - state[PLACE]), high - state[PLACE])
    if way != x[2]:
        held = 1
        _held(H, b, way, x)
    dependent = off
    for u in range(3):
        j = free(out, u)
        step[j] = x[u]
        dependent += gradient[j] * x[u]
    step[out] = -dependent / gradient[out]
    for j in range(UNKNOWNS):
        if not math.isfinite(step[j]):
            return -1
    return held


@inner
def _share(step, change, way, length):
    """The share of a step that neither goes too far nor turns the tip too much."""
    turn = 0.0
    for q in range(3):
        turn += abs(change[q]) + abs(way[q])
    return min(1.0, MAX_STEP * length / max(abs(step[3]), 1e-300), MAX_TURN / max(turn, 1e-300))


@inner
def _go(state, before, share, step, change, way):
    """From where the step was made take a share of it; the tip is put into its equilibrium anyhow."""
    for q in range(STATE):
        state[q] = before[q]
    turn_tip(state, TIP, add(take(change, 0), share, take(way, 0)))
    for q in range(UNKNOWNS):
        state[PUSH + q] += share * step[q]


@merged
def fit_contact(
    body, gravity, weight, wrench, whiten, low, high, most, load, sweep_work, nodes, blocks, y, contact, turns,
    derivatives, work, state,
):  # fmt: skip
    """Least whitened misfit of the base wrench over contacts without friction, from a guess.

    Args:
        body: of the rod.
        gravity: [m/s²], (3,); weight: of the flexible part [N], (3,).
        wrench: read, at the base, (6,).
        whiten: lower triangular, with whitenᵀ whiten the inverse covariance of the wrench, (6, 6).
        low, high: where s_contact may lie [m].
        most: iterations.
        load, sweep_work, nodes, blocks, y, contact, turns: scratch of the sweep (`linear_equilibrium`), for
            four columns.
        derivatives: at the contact found but for the last step, (15, 5).
        work: scratch, (WORK,); the last step from STEP on, (4,).
        state: the unknowns, a guess and then the answer, (STATE,).

    Returns:
        What became of it (FITTED, ...), the whitened misfit squared, iterations.
    """
    J, r, gradient, H, b, x = work[0:24], work[24:30], work[30:34], work[34:43], work[43:46], work[46:49]
    step, way, change, before = work[STEP : STEP + UNKNOWNS], work[53:56], work[56:59], work[59:69]
    lacking = work[69:72]
    length, tol = body.knots[-1], tolerance(wrench, whiten)
    least, share, size, square = math.inf, 1.0, 1.0, math.inf
    for q in range(UNKNOWNS):
        step[q] = 0.0
    for q in range(3):
        load[GRAVITY + q] = gravity[q]
    for iteration in range(most):
        for q in range(3):
            load[FORCE + q] = state[PUSH + q]
        load[S_CONTACT] = state[PLACE]
        status, lack, margin, size = linear_equilibrium(
            state[TIP:PUSH], load, body, tol, max(size, 1e-6), sweep_work, nodes, blocks, y, contact, turns,
            derivatives, lacking,
        )  # fmt: skip
        off, out, merit = 0.0, 0, math.inf
        if status == OK and lack < MOST_LACK:
            whitened(wrench, weight, state[PUSH:PLACE], whiten, derivatives, J, r)
            off = normality(state[PUSH:PLACE], slope_at(body, state[PLACE]), derivatives, gradient)
            out, square = made_normal(J, r, gradient, off)
            merit = square + (off * whiten[0, 0]) ** 2 * SIDE
        if not (math.isfinite(merit) and merit <= least * (1.0 + 1e-4) + JITTER):
            if not math.isfinite(least) or share < _SMALLEST:
                return (STALLED if math.isfinite(least) else LOST), least, iteration
            share *= 0.25
            _go(state, before, share, step, change, way)
            continue
        least = merit
        reduced(J, r, gradient, out, H, b)
        held = _step(state, H, b, gradient, off, out, low, high, x, step)
        if held < 0:
            return LOST, square, iteration
        for q in range(STATE):
            before[q] = state[q]
        for q in range(3):
            change[q] = lacking[q]
        tips_turn(state[TIP:PUSH], turns, step, way)
        share = _share(step, change, way, length)
        gain = b[0] * x[0] + b[1] * x[1] + b[2] * x[2]
        small = abs(step[3]) <= CLOSE * length or (held == 0 and gain <= FLAT * (1.0 + square))
        if share == 1.0 and small and lack <= CLAMPED:
            _go(state, before, 1.0, step, change, way)
            return (LOST if not margin > 0.0 else AT_END if held else FITTED), square, iteration
        _go(state, before, share, step, change, way)
    return (STALLED if math.isfinite(least) else LOST), least, most


@merged
def bent_aside(
    body, gravity, whiten, wrench, load, sweep_work, nodes, blocks, y, contact, fitted_turns, derivatives, work, state,
    step, there,
):  # fmt: skip
    """The equilibrium as force and arclength take a step, from one sweep.

    Args:
        state: fitted; step: of force and arclength, (4,).
        fitted_turns: turns of the tip by these, as the fit left them, (3, 4).
        there: the unknowns after the step, (STATE,), filled.
        The others as in `fit_contact`.

    Returns:
        Whether there is an equilibrium.
    """
    way, change = work[0:3], work[3:6]
    turns = work[6 : 6 + 3 * UNKNOWNS].reshape((3, UNKNOWNS))
    for q in range(3):
        change[q] = 0.0
        load[GRAVITY + q] = gravity[q]
    tips_turn(state[TIP:PUSH], fitted_turns, step, way)
    _go(there, state, 1.0, step, change, way)
    for q in range(3):
        load[FORCE + q] = there[PUSH + q]
    load[S_CONTACT] = there[PLACE]
    status, lack, _margin, _size = linear_equilibrium(
        there[TIP:PUSH], load, body, tolerance(wrench, whiten), 1.0, sweep_work, nodes, blocks, y, contact, turns,
        derivatives, change,
    )  # fmt: skip
    return status == OK and lack < MOST_LACK
