"""The normal equations of a fusion over nodes as they are linearised, compiled; `equations.py` has them in words."""

import math
from pathlib import Path

from probedesign.estimation.node_kernel import (
    BY_PLACE,
    BY_STIFFNESS,
    CONTACT,
    CONTACT_BY_POINT,
    CONTACT_BY_STIFFNESS,
    COUNT,
    FIXED,
    LOG_STIFFNESS,
    MAGNITUDE,
    MODELLED,
    OFFSET,
    ROTATION,
    SHIFT,
    STIFFNESS,
    SURFACE,
    TOUCHED,
    UNKNOWNS,
    WRENCH,
    seen_at,
    to_world,
)
from probedesign.rod.kernels.compiled import drop_stale, inner, kernel
from probedesign.rod.kernels.vectors import add, take

drop_stale(Path(__file__).parent)

STEP, COV, CHI2, AT_CONTACT, AT_SURFACE, COV_CONTACT, PULLS = 0, 7, 56, 57, 60, 63, 72
"""Where in a result stand the step of the unknowns (7), their covariance (7, 7), the misfit with the priors, how far
the contact's and the touched point lie from the fixed one in the world, the means (3) each, the contact's covariance
(3, 3), and whether an object would have to pull somewhere."""
RESULT = 73
COLUMNS = UNKNOWNS + 1
MOST_STIFFER = 0.2
"""Of log stiffness in one step."""
UNSEEN = 1e-13
"""Least information of a direction, over the greatest."""


def work_for(nodes: int, channels: int) -> int:
    """Numbers that so many nodes take."""
    n = nodes * channels
    return n * n + n * COLUMNS + n + 2 * UNKNOWNS * UNKNOWNS + 3 * UNKNOWNS


@kernel
def normal_step(rows, x, most, channels, sample, prior, repeat, bias, walk, creep, work, result):
    """One step of Gauss and Newton, and what is known after it.

    Args:
        rows: nodes in the order of time, (k, NODE).
        x: the unknowns, (UNKNOWNS,), moved by the step or the share of it that may be taken.
        most: how far the fixed point moves at most [m].
        channels: what of a wrench counts, (m, 6).
        sample: covariance of one sample's channels that count, (m, m).
        prior: standard deviations of stiffness and offset, (4,).
        repeat: of the base at each pose [m]; bias, walk: of the sensor, in its samples' standard deviations; creep.
        work: (work_for(k, m),).
        result: filled, (RESULT,).

    Returns:
        Whether there is a step.
    """
    k, m = rows.shape[0], channels.shape[0]
    n = k * m
    V, at = work[: n * n].reshape((n, n)), n * n
    A, at = work[at : at + n * COLUMNS].reshape((n, COLUMNS)), at + n * COLUMNS
    left, at = work[at : at + n], at + n
    H, inverse = work[at : at + 49].reshape((7, 7)), work[at + 49 : at + 98].reshape((7, 7))
    cov, B = result[COV : COV + 49].reshape((7, 7)), work[at + 98 : at + 119].reshape((3, 7))
    _design(rows, x, channels, A)
    _covariance(rows, channels, sample, repeat, bias, walk, creep, A, V)
    if not factored(V) or not _solved(V, A, x, prior, H, inverse, cov, result):
        return False
    _shift(rows, channels, repeat, V, A, result, left)
    _tell(rows, cov, B, result)
    _go(x, result[STEP:COV], most)
    return True


@inner
def _go(x, step, most):
    """Take a step, but not too far at once, nor so that the stiffness changes by more than a fifth."""
    far = math.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
    share = min(1.0, most / max(far, 1e-300), MOST_STIFFER / max(abs(step[STIFFNESS]), 1e-300))
    for u in range(UNKNOWNS):
        x[u] += share * step[u]


@inner
def _design(rows, x, channels, A):
    """By the unknowns, and last what was read beyond what is modelled, of the channels that count."""
    m = channels.shape[0]
    for k in range(rows.shape[0]):
        row = rows[k]
        off = add(seen_at(row, x), -1.0, take(row, FIXED))
        more = x[STIFFNESS] - row[LOG_STIFFNESS]
        for i in range(m):
            line = A[m * k + i]
            for j in range(COLUMNS):
                line[j] = 0.0
            for c in range(6):
                share = channels[i, c]
                if share == 0.0:
                    continue
                o = BY_PLACE + 3 * c
                by = take(row, o)
                world = to_world(row, by)
                modelled = row[MODELLED + c] + row[BY_STIFFNESS + c] * more
                for q in range(3):
                    modelled += by[q] * off[q]
                    line[q] += share * world[q]
                    line[OFFSET + q] -= share * by[q]
                line[STIFFNESS] += share * row[BY_STIFFNESS + c]
                line[UNKNOWNS] += share * (row[WRENCH + c] - modelled)


@inner
def _covariance(rows, channels, sample, repeat, bias, walk, creep, A, V):
    """Of all readings together: noise, the bias and its walk, the base's scatter, creep."""
    k, m = rows.shape[0], channels.shape[0]
    for a in range(k):
        for b in range(a, k):
            walked = bias * bias + walk * walk * (a + 1.0)
            grown = creep * creep * a * b / max(k - 1.0, 1.0) ** 2
            for i in range(m):
                for j in range(m):
                    u, v = m * a + i, m * b + j
                    V[u, v] = walked * sample[i, j] + grown * A[u, STIFFNESS] * A[v, STIFFNESS]
                    if a == b:
                        V[u, v] += sample[i, j] / rows[a, COUNT]
                        for q in range(3):
                            V[u, v] += repeat * repeat * A[u, OFFSET + q] * A[v, OFFSET + q]


@inner
def factored(V):
    """V = Uᵀ U in the upper half of V, row by row; whether it is positive."""
    n = V.shape[0]
    for j in range(n):
        if not V[j, j] > 0.0:
            return False
        size = 1.0 / math.sqrt(V[j, j])
        for c in range(j, n):
            V[j, c] *= size
        for i in range(j + 1, n):
            share = V[j, i]
            for c in range(i, n):
                V[i, c] -= share * V[j, c]
    return True


@inner
def lowered(V, A):
    """A becomes U⁻ᵀ A."""
    n, width = A.shape
    for j in range(n):
        size = 1.0 / V[j, j]
        for c in range(width):
            A[j, c] *= size
        for i in range(j + 1, n):
            share = V[j, i]
            for c in range(width):
                A[i, c] -= share * A[j, c]


@inner
def _solved(V, A, x, prior, H, inverse, cov, result):
    """Covariance, step and misfit, from the whitened design; whether there is a step."""
    n = A.shape[0]
    lowered(V, A)
    for u in range(7):
        for v in range(7):
            H[u, v] = 0.0
    chi2 = 0.0
    lack = inverse[0]
    for u in range(7):
        lack[u] = 0.0
    for i in range(n):
        chi2 += A[i, UNKNOWNS] ** 2
        for u in range(7):
            lack[u] += A[i, u] * A[i, UNKNOWNS]
            for v in range(7):
                H[u, v] += A[i, u] * A[i, v]
    for u in range(4):
        H[3 + u, 3 + u] += 1.0 / prior[u] ** 2
        lack[3 + u] -= x[3 + u] / prior[u] ** 2
        chi2 += (x[3 + u] / prior[u]) ** 2
    for u in range(7):
        result[STEP + u] = lack[u]
    result[CHI2] = chi2
    if not _inverse(H, inverse, cov):
        return False
    for u in range(7):
        inverse[0, u] = result[STEP + u]
    finite = True
    for u in range(7):
        total = 0.0
        for v in range(7):
            total += cov[u, v] * inverse[0, v]
        result[STEP + u] = total
        finite = finite and math.isfinite(total)
    return finite


@inner
def _inverse(H, work, cov):
    """Inverse of a symmetric matrix (7, 7), scaled first, no direction known less than UNSEEN allows."""
    for u in range(7):
        cov[u, u] = math.sqrt(H[u, u]) if H[u, u] > 0.0 else 1.0
    for u in range(7):
        for v in range(7):
            if u != v:
                cov[u, v] = 0.0
            H[u, v] /= cov[u, u] * cov[v, v]
    for u in range(7):
        H[u, u] += UNSEEN
    for u in range(7):
        for v in range(7):
            work[u, v] = 1.0 / cov[u, u] if u == v else 0.0
    if not factored(H):
        return False
    lowered(H, work)  # U⁻ᵀ D⁻¹, whose square is the inverse
    for u in range(7):
        for v in range(7):
            total = 0.0
            for i in range(7):
                total += work[i, u] * work[i, v]
            cov[u, v] = total
    return True


@inner
def _shift(rows, channels, repeat, V, A, result, left):
    """How far each base was likely off for itself, after the step: repeat² Jᵀ V⁻¹ (r - A step)."""
    n, m = A.shape[0], channels.shape[0]
    for i in range(n):
        left[i] = A[i, UNKNOWNS]
        for u in range(7):
            left[i] -= A[i, u] * result[STEP + u]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            left[i] -= V[i, j] * left[j]
        left[i] /= V[i, i]
    for k in range(rows.shape[0]):
        for q in range(3):
            total = 0.0
            for i in range(m):
                by = 0.0
                for c in range(6):
                    by += channels[i, c] * rows[k, BY_PLACE + 3 * c + q]
                total += by * left[m * k + i]
            rows[k, SHIFT + q] = repeat * repeat * total


@inner
def _tell(rows, cov, B, result):
    """The centreline's and the touched point beside the fixed one, the means over the touches, and what is known."""
    touched = 0.0
    for q in range(6):
        result[AT_CONTACT + q] = 0.0
    for q in range(3):
        for u in range(7):
            B[q, u] = 0.0
    result[PULLS] = 0.0
    for k in range(rows.shape[0]):
        row = rows[k]
        if row[TOUCHED] > 0.0:
            touched += 1.0
            result[PULLS] = max(result[PULLS], 1.0 if row[MAGNITUDE] < 0.0 else 0.0)
            fixed = take(row, FIXED)
            contact = to_world(row, add(take(row, CONTACT), -1.0, fixed))
            surface = to_world(row, add(take(row, SURFACE), -1.0, fixed))
            for q in range(3):
                result[AT_CONTACT + q] += contact[q]
                result[AT_SURFACE + q] += surface[q]
            _contact_by_unknowns(row, B)
    for q in range(6):
        result[AT_CONTACT + q] /= touched
    for q in range(3):
        for w in range(3):
            total = 0.0
            for u in range(7):
                for v in range(7):
                    total += B[q, u] * cov[u, v] * B[w, v]
            result[COV_CONTACT + 3 * q + w] = total / (touched * touched)


@inner
def _contact_by_unknowns(row, B):
    """Add how a node's centreline point moves in the world with the unknowns."""
    for q in range(3):
        r = take(row, ROTATION + 3 * q)
        for j in range(3):
            turned = 0.0
            for i in range(3):
                turned += r[i] * row[CONTACT_BY_POINT + 3 * i + j]
            for w in range(3):
                B[q, w] += turned * row[ROTATION + 3 * w + j]
            B[q, OFFSET + j] += r[j] - turned
            B[q, STIFFNESS] += r[j] * row[CONTACT_BY_STIFFNESS + j]
