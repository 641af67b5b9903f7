"""What tolerances make of one touch, compiled: how its reading is known with them, and how its point then is.

`doubts.py` does the same with names; tests/estimation/test_doubt_kernel.py holds the two together.
"""

import math
from pathlib import Path

from probedesign.estimation.cause_kernel import POINT, answer, by_causes
from probedesign.estimation.fit import (
    CLAMPED,
    COARSEST,
    PLACE,
    PUSH,
    STATE,
    TIP,
    UNKNOWNS,
    made_normal,
    normality,
    reduced,
    slope_at,
    whitened,
)
from probedesign.estimation.spread import covariance
from probedesign.rod.kernels.body import ALL_COLUMNS, FORCE, LOAD, OK, S_CONTACT
from probedesign.rod.kernels.body import GRAVITY as LOAD_GRAVITY
from probedesign.rod.kernels.compiled import drop_stale, inner, kernel, merged
from probedesign.rod.kernels.linear import linear_equilibrium
from probedesign.rod.kernels.newton import turn_tip
from probedesign.rod.kernels.steps import BLOCK, COLUMN, WIDE
from probedesign.rod.kernels.steps import STATE as RODS_STATE
from probedesign.rod.kernels.steps import WORK as STEP_WORK
from probedesign.rod.kernels.vectors import take

drop_stale(Path(__file__).parent)

TRIES = 4
"""Sweeps at most until a place that was found by another reading is an equilibrium."""
ALGEBRA = 24 + 6 + 4 + 9 + 3 + 16 + 18 + 36 + 36 + STATE
"""Numbers that weighing works in beside the sweep."""
WHITEN, COV, KNOWN = 0, 36, 45
"""Where in what is told stand the whitening of the reading (6, 6), the covariance of the point to first order [m²]
(3, 3), and whether that is finite."""
TOLD = 46


def room_for(knots: int, causes: int) -> int:
    """Numbers that `weigh` works in, of a rod with so many knots and so many causes."""
    k = ALL_COLUMNS + knots
    chunks = -(-(3 + k) // WIDE)
    sweep = LOAD + STEP_WORK + chunks * BLOCK + 2 * RODS_STATE + WIDE * COLUMN * chunks + 3 * k + 3
    return sweep + 15 * (k + 1) + ALGEBRA + 3 * causes


@inner
def _factor(A, size):
    """Lower Cholesky factor of a symmetric positive matrix, in its place; whether it is one."""
    for i in range(size):
        for j in range(i + 1):
            total = A[i, j]
            for q in range(j):
                total -= A[i, q] * A[j, q]
            if i > j:
                A[i, j] = total / A[j, j]
            elif total > 0.0:
                A[i, i] = math.sqrt(total)
            else:
                return False
        for j in range(i + 1, size):
            A[i, j] = 0.0
    return True


@inner
def _inverted(L, size, inverse):
    """Inverse of a lower triangle."""
    for j in range(size):
        for i in range(size):
            total = 1.0 if i == j else 0.0
            for q in range(j, i):
                total -= L[i, q] * inverse[q, j]
            inverse[i, j] = total / L[i, i] if i >= j else 0.0


@inner
def _known(whiten, drift, D, noise, wide):
    """Covariance of a reading by its noise and drift, and by the causes as well, (6, 6) each.

    Args:
        whiten: of the noise alone; drift: covariance to add to it.
        D: one standard deviation of each cause a column, (6, causes).
    """
    _inverted(whiten, 6, wide)
    for i in range(6):
        for j in range(6):
            noise[i, j] = drift[i, j]
            for q in range(6):
                noise[i, j] += wide[i, q] * wide[j, q]
    for i in range(6):
        for j in range(6):
            wide[i, j] = noise[i, j]
            for c in range(D.shape[1]):
                wide[i, j] += D[i, c] * D[j, c]


@inner
def _gained(columns, whiten, J, cov, gain):
    """How the nearest touch's point moves with the reading, (3, 6): P (Jᵀ J)⁻¹ Jᵀ whiten.

    Args:
        columns: by force and arclength first; J: of the whitened reading by these, (24,).
        cov: of force and arclength, (16,).
    """
    for i in range(3):
        for m in range(6):
            gain[i, m] = 0.0
        for n in range(UNKNOWNS):
            share = 0.0
            for j in range(UNKNOWNS):
                share += columns[POINT + i, j] * cov[UNKNOWNS * j + n]
            for m in range(6):
                for q in range(m, 6):  # whiten is lower triangular
                    gain[i, m] += share * J[UNKNOWNS * q + n] * whiten[q, m]


@inner
def _spread(gain, noise, D, Q, off, cov_p):
    """Covariance of the point: gain noise gainᵀ + (gain D - Q) (gain D - Q)ᵀ, (9,); off: scratch, (3, causes)."""
    for c in range(D.shape[1]):
        for i in range(3):
            off[i, c] = -Q[i, c]
            for q in range(6):
                off[i, c] += gain[i, q] * D[q, c]
    for i in range(3):
        for k in range(3):
            total = 0.0
            for q in range(6):
                for m in range(6):
                    total += gain[i, q] * noise[q, m] * gain[k, m]
            for c in range(D.shape[1]):
                total += off[i, c] * off[k, c]
            cov_p[3 * i + k] = total


@merged
def _settled(body, gravity, force, s, tip, work, columns):
    """Sweep a touch with the columns of everything; whether it is an equilibrium that the probe holds."""
    k = columns.shape[1] - 1
    chunks = -(-(3 + k) // WIDE)
    a = LOAD
    b = a + STEP_WORK
    c = b + chunks * BLOCK
    d = c + RODS_STATE
    e = d + RODS_STATE + WIDE * COLUMN * chunks
    f = e + 3 * k
    load, lacking = work[:a], work[f : f + 3]
    for q in range(LOAD):
        load[q] = 0.0
    for q in range(3):
        load[FORCE + q], load[LOAD_GRAVITY + q] = force[q], gravity[q]
    load[S_CONTACT] = s
    for _ in range(TRIES):
        status, lack, margin, _size = linear_equilibrium(
            tip, load, body, COARSEST, 1.0, work[a:b], work[f:f], work[b:c], work[c:d], work[d:e],
            work[e:f].reshape((3, k)), columns, lacking,
        )  # fmt: skip
        if status != OK or not margin > 0.0:
            return False
        if lack <= CLAMPED:
            return True
        turn_tip(tip, 0, take(lacking, 0))
    return False


@merged
def _tell(body, weight, wrench, white, noise, force, s, columns, D, Q, off, work, told):
    """The covariance of the point into what is told, and whether there is one."""
    J, r, gradient, H, cov = work[0:24], work[24:30], work[30:34], work[34:43], work[46:62]
    gain = work[62:80].reshape((3, 6))
    whitened(wrench, weight, force, white, columns, J, r)
    lack = normality(force, slope_at(body, s), columns, gradient)
    out, _square = made_normal(J, r, gradient, lack)
    reduced(J, r, gradient, out, H, work[43:46])
    told[KNOWN] = 0.0
    if covariance(gradient, out, H, cov):
        _gained(columns, white, J, cov, gain)
        _spread(gain, noise, D, Q, off, told[COV:KNOWN])
        told[KNOWN] = 1.0


@kernel
def weigh(body, gravity, weight, wrench, whiten, drift, own, turns, hanging, still, state, work, D, Q, told):
    """How a reading is known at a touch that may have made it, with the tolerances.

    Args:
        body: of the rod.
        gravity: [m/s²], (3,); weight: of the flexible part [N], (3,).
        wrench: read at the base, (6,); whiten: by its noise alone, lower triangular, (6, 6).
        drift: covariance to add to the noise's, (6, 6).
        own, turns, hanging: as in `by_causes`, (a, 4 + K), (b, 9), (6, 3).
        still: of the free probe's reading by each cause, which a tare has taken away, (6, a + b).
        state: of the touch, (STATE,).
        work: scratch, (room_for(K, a + b),).
        D: of the reading by each cause, filled, (6, a + b); Q: of the point [m], filled, (3, a + b).
        told: filled, (TOLD,).

    Returns:
        Whether the probe holds that touch.
    """
    k, causes = ALL_COLUMNS + body.knots.shape[0], D.shape[1]
    a = 15 * (k + 1)
    b = a + 3 * causes
    c = b + ALGEBRA
    columns, off, algebra = work[:a].reshape((15, k + 1)), work[a:b].reshape((3, causes)), work[b:c]
    there, g, force, s = algebra[152:], take(gravity, 0), take(state, PUSH), state[PLACE]
    for q in range(STATE):
        there[q] = state[q]
    if not _settled(body, gravity, force, s, there[TIP:PUSH], work[c:], columns):
        return False
    answer(body, g, force, s, columns)
    by_causes(body, g, force, columns, own, turns, hanging, D, Q)
    for i in range(6):
        for j in range(causes):
            D[i, j] -= still[i, j]
    noise, wide = algebra[80:116].reshape((6, 6)), algebra[116:152].reshape((6, 6))
    white = told[WHITEN:COV].reshape((6, 6))
    _known(whiten, drift, D, noise, wide)
    if not _factor(wide, 6):
        return False
    _inverted(wide, 6, white)
    _tell(body, weight, wrench, white, noise, there[PUSH:PLACE], s, columns, D, Q, off, algebra, told)
    return True
