"""The common unknowns of a fusion from the reduced rows of `keyframe_kernel.py` (compiled).

The rows are accumulated in the order of time in the information matrix of (X, m, f, β). β walks from pose to pose and
is smoothed backward afterwards. `tests/reference/fusion.py` solves the same dense system.
"""

import math

from probedesign.estimation.keyframe_kernel import BIAS, FRICTION, LOCAL, column_of, columns, own_unknowns
from probedesign.rod.kernels import inner, kernel
from probedesign.rod.kernels.linalg import backward, covariance_of, factor, forward, invert_lower, scale_and_factor
from probedesign.rod.kernels.surface_contact import BY_TOUCH, CENTRE, UNKNOWNS, VALUE

PINNED = 1e-6
"""Standard deviation of a bias, in steps, below which it counts as known."""


@inner
def _walk(A, eta, n, variance, M, L, inverse, link):
    """Let the bias, the last six of the n unknowns, take a random step of such a variance on each.

    With S the information of the old bias, T what ties it to the others and q the inverse of the variance, M = S + q I:
    Λ_oo - T M⁻¹ Tᵀ, Λ_ob = q T M⁻¹, Λ_bb = q (I - q M⁻¹). Returns what is taken off the misfit.

    Args:
        link: filled with what gives the old bias again, M⁻¹ (η - Tᵀ o + q β): M⁻¹, M⁻¹ Tᵀ and M⁻¹ η, (BIAS, n + 1).
    """
    o = n - BIAS
    q = 1.0 / variance
    for i in range(BIAS):
        for j in range(BIAS):
            M[i, j] = A[o + i, o + j] + (q if i == j else 0.0)
    if not factor(M, BIAS):
        return math.nan
    invert_lower(M, BIAS, L)
    for i in range(BIAS):
        for j in range(BIAS):
            total = 0.0
            for k in range(max(i, j), BIAS):
                total += L[k, i] * L[k, j]
            inverse[i, j] = total
            link[i, j] = total
    taken = 0.0
    for i in range(BIAS):
        for j in range(BIAS):
            taken += eta[o + i] * inverse[i, j] * eta[o + j]
    for r in range(o):
        # The row of T M⁻¹, in M's place.
        for i in range(BIAS):
            total = 0.0
            for j in range(BIAS):
                total += A[r, o + j] * inverse[j, i]
            M[0, i] = total
            link[i, BIAS + r] = total
        for i in range(BIAS):
            eta[r] -= M[0, i] * eta[o + i]
        for c in range(r + 1):
            total = 0.0
            for i in range(BIAS):
                total += M[0, i] * A[c, o + i]
            A[r, c] -= total
            A[c, r] = A[r, c]
        for i in range(BIAS):
            M[1, i] = q * M[0, i]
        for i in range(BIAS):
            A[o + i, r] = M[1, i]
    for r in range(o):
        for i in range(BIAS):
            A[r, o + i] = A[o + i, r]
    for i in range(BIAS):
        total = 0.0
        for j in range(BIAS):
            total += inverse[i, j] * eta[o + j]
        link[i, n] = total
        M[2, i] = q * total
        for j in range(BIAS):
            A[o + i, o + j] = q * ((1.0 if i == j else 0.0) - q * inverse[i, j])
    for i in range(BIAS):
        eta[o + i] = M[2, i]
    return taken


def solve_work(causes: int) -> int:
    """Return the size of the scratch array of `solve_reduced`."""
    n = columns(causes) - 1
    return n * n + 2 * n + 3 * BIAS * BIAS + 6 * n


@kernel
def solve_reduced(reduced, order, walk, start, causes, chain, work, x, cov):
    """Solve for the common unknowns from the rows of all poses in the order of time.

    Args:
        reduced: (poses, m, columns).
        order: which of them count, in the order of time, (p,).
        walk: variance of the bias's step before each of those, in steps² (the first is not used), (p,).
        start: standard deviation of the bias at the first pose, in steps.
        causes: J.
        chain: filled with what gives the bias before each step again, (len(order), BIAS, n + 1).
        work: scratch, (solve_work(J),); the factor of the information and its scale stay at its front.
        x: filled: X, m, f, β of the last pose, (n,).
        cov: of X, filled, (3, 3).

    Returns:
        The least misfit squared, priors counted; NaN where there is none.
    """
    n = reduced.shape[2] - 1
    A = work[: n * n].reshape((n, n))
    o = n * n
    scale, eta = work[o : o + n], work[o + n : o + 2 * n]
    o += 2 * n
    M = work[o : o + 36].reshape((BIAS, BIAS))
    L = work[o + 36 : o + 72].reshape((BIAS, BIAS))
    inverse = work[o + 72 : o + 108].reshape((BIAS, BIAS))
    o += 108
    rows, solved = work[o : o + 3 * n].reshape((3, n)), work[o + 3 * n : o + 6 * n].reshape((3, n))
    for i in range(n):
        eta[i] = 0.0
        for j in range(n):
            A[i, j] = 0.0
    for i in range(3, n - BIAS):
        A[i, i] = 1.0
    for i in range(n - BIAS, n):
        A[i, i] = 1.0 / max(start, PINNED) ** 2
    chi2 = 0.0
    for at in range(order.shape[0]):
        k = order[at]
        if at > 0 and walk[at] > 0.0:
            chi2 -= _walk(A, eta, n, walk[at], M, L, inverse, chain[at])
        for r in range(reduced.shape[1]):
            b = reduced[k, r, n]
            chi2 += b * b
            for i in range(n):
                share = reduced[k, r, i]
                if share != 0.0:
                    eta[i] += share * b
                    for j in range(i + 1):
                        A[i, j] += share * reduced[k, r, j]
        for i in range(n):
            for j in range(i):
                A[j, i] = A[i, j]
    if not scale_and_factor(A, n, scale):
        return math.nan
    for i in range(n):
        x[i] = eta[i] / scale[i]
    forward(A, n, x)
    for i in range(n):
        chi2 -= x[i] * x[i]
    backward(A, n, x)
    for i in range(n):
        x[i] /= scale[i]
    for a in range(3):
        for i in range(n):
            rows[a, i] = 1.0 if i == a else 0.0
    covariance_of(A, n, scale, rows, 3, solved, cov)
    return chi2


@kernel
def smooth_bias(chain, order, walk, x, xs):
    """Fill the common unknowns at each pose, which differ in the bias.

    Args:
        chain, order, walk, x: of `solve_reduced`.
        xs: filled where `order` points to, (poses, n).
    """
    n, o = x.shape[0], x.shape[0] - BIAS
    after = x
    for at in range(order.shape[0] - 1, -1, -1):
        here = xs[order[at]]
        for i in range(n):
            here[i] = after[i]
        if at + 1 < order.shape[0] and walk[at + 1] > 0.0:
            link, q = chain[at + 1], 1.0 / walk[at + 1]
            for i in range(BIAS):
                total = link[i, n]
                for r in range(o):
                    total -= link[i, BIAS + r] * x[r]
                for j in range(BIAS):
                    total += q * link[i, j] * after[o + j]
                here[o + i] = total
        after = here


@inner
def _pass_on(rows, g, link, q, half, scattered):
    """Express rows by the bias after its step instead of the bias before it.

    Args:
        rows: (3, n), the last six columns g; scattered: what the step itself contributes is added, (3, 3).
        half: scratch, (BIAS,).
    """
    o = rows.shape[1] - BIAS
    for i in range(3):
        for a in range(BIAS):
            half[a] = 0.0
            for b in range(BIAS):
                half[a] += g[i, b] * link[b, a]
        for j in range(i, 3):
            share = 0.0
            for a in range(BIAS):
                share += half[a] * g[j, a]
            scattered[i, j] += share
            if j > i:
                scattered[j, i] += share
        for r in range(o):
            for a in range(BIAS):
                rows[i, r] -= g[i, a] * link[a, BIAS + r]
    for i in range(3):
        for a in range(BIAS):
            half[a] = 0.0
            for b in range(BIAS):
                half[a] += g[i, b] * link[b, a]
        for a in range(BIAS):
            g[i, a] = q * half[a]


@kernel
def mean_centre(
    lins, Ds, locals_, poses, order, touched, walk, chain, xs, scatter, creep, ramps, work, solve_memory, mean, cov
):
    """Compute the mean of the centreline points of the touches in the world, and its covariance.

    The bias at a pose is a linear function of what is common and of the bias after it, and an error independent of
    both: `g`, the derivative by the bias at hand, is carried from the first pose to the last.

    Args:
        lins, Ds, locals_, poses, touched: of all poses.
        order, walk, chain: as in `solve_reduced`; xs: of `smooth_bias`.
        ramps: how far creep has gone at each pose.
        work: scratch, (6 n + 100,); solve_memory: as `solve_reduced` left its work.
        mean: filled [m], (3,); cov: filled [m²], (3, 3).
    """
    n = xs.shape[1]
    o, J = n - BIAS, n - BIAS - FRICTION - 3
    A = solve_memory[: n * n].reshape((n, n))
    scale = solve_memory[n * n : n * n + n]
    rows = work[: 3 * n].reshape((3, n))
    solved = work[3 * n : 6 * n].reshape((3, n))
    G = work[6 * n : 6 * n + 3 * LOCAL].reshape((3, LOCAL))
    own = work[6 * n + 3 * LOCAL : 6 * n + 6 * LOCAL].reshape((3, LOCAL))
    step = work[6 * n + 6 * LOCAL : 6 * n + 7 * LOCAL]
    scattered = work[6 * n + 7 * LOCAL : 6 * n + 7 * LOCAL + 9].reshape((3, 3))
    half = work[6 * n + 7 * LOCAL + 9 : 6 * n + 7 * LOCAL + 9 + BIAS]
    g = rows[:, o:]
    total_touched = 0.0
    for i in range(3):
        mean[i] = 0.0
        for c in range(n):
            rows[i, c] = 0.0
        for j in range(3):
            scattered[i, j] = 0.0
    for at_k in range(order.shape[0]):
        if at_k > 0 and walk[at_k] > 0.0:
            _pass_on(rows, g, chain[at_k], 1.0 / walk[at_k], half, scattered)
        k = order[at_k]
        if not touched[k]:
            continue
        total_touched += 1.0
        lin, D, local, x = lins[k], Ds[k], locals_[k], xs[k]
        own_unknowns(local, x, n, LOCAL + n, step)
        for i in range(3):
            at = poses[k, i, 3]
            for u in range(LOCAL):
                G[i, u] = 0.0
            for q in range(3):
                turn = poses[k, i, q]
                at += turn * lin[CENTRE + q, VALUE]
                for u in range(UNKNOWNS):
                    G[i, u] += turn * lin[CENTRE + q, BY_TOUCH + u]
                if scatter >= 0:
                    G[i, UNKNOWNS] += turn * D[CENTRE + q, scatter]
                for c in range(J):
                    by = turn * column_of(D, CENTRE + q, c, scatter, creep, ramps[k])
                    rows[i, 3 + c] += by
                    at += by * x[3 + c]
            for u in range(LOCAL):
                at += G[i, u] * step[u]
            mean[i] += at
            # own = G R⁻¹, row by row: solve own R = G.
            for u in range(LOCAL):
                left = G[i, u]
                for v in range(u):
                    left -= own[i, v] * local[v, u]
                own[i, u] = left / local[u, u] if abs(local[u, u]) > 1e-300 else 0.0
            for c in range(n):
                for u in range(LOCAL):
                    rows[i, c] -= own[i, u] * local[u, LOCAL + c]
        for i in range(3):
            for j in range(3):
                for u in range(LOCAL):
                    scattered[i, j] += own[i, u] * own[j, u]
    for i in range(3):
        mean[i] /= total_touched
        for c in range(n):
            rows[i, c] /= total_touched
    covariance_of(A, n, scale, rows, 3, solved, cov)
    for i in range(3):
        for j in range(3):
            cov[i, j] += scattered[i, j] / (total_touched * total_touched)


@kernel
def standard_deviation(solve_memory, n, j, work):
    """Return the standard deviation of a common unknown from the factor that `solve_reduced` left; work: scratch,
    (n,).
    """
    A = solve_memory[: n * n].reshape((n, n))
    for i in range(n):
        work[i] = 0.0
    work[j] = 1.0 / solve_memory[n * n + j]
    forward(A, n, work)
    total = 0.0
    for i in range(n):
        total += work[i] * work[i]
    return math.sqrt(total)
