"""Touches of one fixed point as residual blocks, and their common unknowns (compiled).

Common unknowns are the touched point X [m], the error sources m of `error_sources.py` (unit priors), the part f of the
friction ratios that all touches share (unit priors) and the bias β of the sensor in steps of its resolution, a random
walk over the readings. Unknown at pose k alone are its touch y (5) and how far its stiffness is off, e. To first order
about the last linearisation, with h the base wrench, x the touched point and H, X_y their derivatives by the touch:

    W (h + H δy + D m + D_e e + B β - w)            what was read, in the channels that count
    (a - c μ f)/(√(1 - c²) μ), two rows             the prior on friction
    e                                               the prior on the stiffness at this touch
    (T (x + X_y δy + Q m + Q_e e) - X)/σ_robot      the touched point stays where it is

The friction ratio a of every touch is N(0, μ²) per direction. Touches of one object by one probe are alike, and slip to
the same side: the share c² of that variance is common to them.

Householder reflections take y and e out of each pose's rows. What is left is accumulated in the order of time in the
information matrix of (X, m, f, β); β walks from pose to pose and is smoothed backward afterwards.
`tests/reference/fusion.py` solves the same dense system.
"""

import math

from probedesign.estimation.contact_fit import MIN_FRICTION
from probedesign.estimation.uncertainty_kernel import SourceArrays, error_columns
from probedesign.rod.kernels import inner, kernel
from probedesign.rod.kernels.equations import OK
from probedesign.rod.kernels.linalg import (
    backward,
    covariance_of,
    cross,
    dot,
    eliminate,
    factor,
    forward,
    invert_lower,
    scale_and_factor,
)
from probedesign.rod.kernels.surface_contact import (
    AROUND,
    BY_TOUCH,
    CENTRE,
    MOVE,
    POINT,
    TOUCH,
    UNKNOWNS,
    VALUE,
    WRENCH,
    advance,
    linearise,
    plan_move,
)

BIAS, FRICTION = 6, 2
LOCAL = UNKNOWNS + 1  #: Unknowns of a pose alone: its touch and its stiffness.
PINNED = 1e-6  #: Standard deviation of a bias, in steps, below which it counts as known.
EXACT = 1e-8  #: Standard deviation of the base's place [m] below which a robot counts as exact.


def columns(causes: int) -> int:
    """Return the number of columns of the reduced rows: X, error sources, common friction, bias, right-hand side."""
    return 3 + causes + FRICTION + BIAS + 1


def rows_of(channels: int) -> int:
    """Return the number of rows of a pose's block before its own unknowns are eliminated."""
    return channels + 6


@kernel
def linearise_keyframe(body, gravity, mass, tol, touch, rod, base, root, gain, payload_by_gravity, sensor_from_base,
                       base_from_sensor, reference, tared, work, lin, D):  # fmt: skip
    """Linearise the touch of a pose with its error columns.

    Args:
        rod, ... tared: the error sources, see `SourceArrays`; as arguments of their own they reach the kernel faster.

    Returns:
        Whether the probe holds it.
    """
    sources = SourceArrays(
        rod, base, root, gain, payload_by_gravity, sensor_from_base, base_from_sensor, reference, tared
    )
    parameters = rod.shape[1] + 3
    status, lack, margin, _size = linearise(body, gravity, mass, tol, 1.0, touch, parameters, work, lin)
    if status != OK or not lack < math.inf or not margin > 0.0:
        return False
    error_columns(body, gravity, lin, sources, D)
    return True


@inner
def column_of(D, r, c, scatter, creep, ramp):
    """Return an entry of an error column that is common to all poses: zero for the scatter, scaled for the creep."""
    if c == scatter:
        return 0.0
    return D[r, c] * (ramp if c == creep else 1.0)


@kernel
def reduce_keyframe(touch, lin, D, wrench, pose, channels, whiten, bias, friction, common, repeat, scatter, creep, ramp,
                    block, local, reduced):  # fmt: skip
    """Fill the rows of one pose with its own unknowns eliminated.

    Args:
        touch, lin, D: as linearised, (TOUCH,), (ROWS, ...), (12, J).
        wrench: read at the base, (6,); pose: of the base in the world, (4, 4).
        channels: what of a wrench at the base counts, (m, 6); whiten: of these, lower triangular, (m, m).
        bias: channels by the bias in steps, (m, 6).
        friction: prior standard deviation of the ratio; inf: none.
        common: c², the share of its variance that all touches have in common, below 1.
        repeat: standard deviation of the base's place at this pose alone [m].
        scatter, creep: columns of D that scatter from touch to touch, and that grow by `ramp`; -1: none.
        block: scratch, (m + 6, LOCAL + columns).
        local: filled: rows that give the pose's own unknowns from the common ones, (LOCAL, LOCAL + columns).
        reduced: filled, (m, columns).
    """
    m, J = channels.shape[0], D.shape[1]
    width = LOCAL + 3 + J + FRICTION + BIAS + 1
    rhs, first_bias = width - 1, width - 1 - BIAS
    rows = m + 6
    for i in range(rows):
        for c in range(width):
            block[i, c] = 0.0
    for i in range(m):
        for q in range(i + 1):
            w = whiten[i, q]
            for a in range(6):
                share = w * channels[q, a]
                if share == 0.0:
                    continue
                for u in range(UNKNOWNS):
                    block[i, u] += share * lin[WRENCH + a, BY_TOUCH + u]
                if scatter >= 0:
                    block[i, UNKNOWNS] += share * D[a, scatter]
                for c in range(J):
                    block[i, LOCAL + 3 + c] += share * column_of(D, a, c, scatter, creep, ramp)
                block[i, rhs] += share * (wrench[a] - lin[WRENCH + a, VALUE])
            for c in range(BIAS):
                block[i, first_bias + c] += w * bias[q, c]
    if friction < math.inf:
        own = math.sqrt(1.0 - common)
        per = 1.0 / (own * max(friction, MIN_FRICTION))
        for a in range(FRICTION):
            block[m + a, AROUND + a] = per
            block[m + a, LOCAL + 3 + J + a] = -math.sqrt(common) / own
            block[m + a, rhs] = -per * touch[AROUND + a]
    block[m + 2, UNKNOWNS] = 1.0
    place = 1.0 / max(repeat, EXACT)
    for i in range(3):
        row = m + 3 + i
        at = pose[i, 3]
        for q in range(3):
            turn = place * pose[i, q]
            at += pose[i, q] * lin[POINT + q, VALUE]
            for u in range(UNKNOWNS):
                block[row, u] += turn * lin[POINT + q, BY_TOUCH + u]
            if scatter >= 0:
                block[row, UNKNOWNS] += turn * D[POINT + q, scatter]
            for c in range(J):
                block[row, LOCAL + 3 + c] += turn * column_of(D, POINT + q, c, scatter, creep, ramp)
        block[row, LOCAL + i] = -place
        block[row, rhs] = -place * at
    eliminate(block, rows, width, LOCAL)
    for i in range(LOCAL):
        for c in range(width):
            local[i, c] = block[i, c]
    for i in range(m):
        for c in range(width - LOCAL):
            reduced[i, c] = block[LOCAL + i, LOCAL + c]


@kernel
def reduce_free(D, free, wrench, channels, whiten, bias, reduced):
    """Fill the rows of a reading of the free probe, which constrains the bias.

    Args:
        D: error columns of the free probe's reading, (6, J); free: the free probe's wrench, (6,).
        The others as in `reduce_keyframe`.
    """
    m, J = channels.shape[0], D.shape[1]
    rhs = 3 + J + FRICTION + BIAS
    for i in range(m):
        for c in range(rhs + 1):
            reduced[i, c] = 0.0
        for q in range(i + 1):
            w = whiten[i, q]
            for a in range(6):
                share = w * channels[q, a]
                for c in range(J):
                    reduced[i, 3 + c] += share * D[a, c]
                reduced[i, rhs] += share * (wrench[a] - free[a])
            for c in range(BIAS):
                reduced[i, 3 + J + FRICTION + c] += w * bias[q, c]


@inner
def own_unknowns(local, x, n, rhs, step):
    """Compute the step of a pose's touch and its stiffness from the common unknowns by back substitution, (LOCAL,)."""
    for i in range(LOCAL - 1, -1, -1):
        total = local[i, rhs]
        for c in range(n):
            total -= local[i, LOCAL + c] * x[c]
        for c in range(i + 1, LOCAL):
            total -= local[i, c] * step[c]
        pivot = local[i, i]
        step[i] = total / pivot if abs(pivot) > 1e-300 else 0.0


@kernel
def step_keyframe(touch, lin, local, x, share, max_step, end, work):
    """Move a pose's touch to the solution of the common unknowns, or part of the way if that is far.

    Args:
        touch: as linearised, moved in place, (TOUCH,).
        local: from `reduce_keyframe`; x: from `solve_reduced`.
        share: of the step to go at most; max_step: of arclength [m].
        end: furthest arclength at which a touch acts [m].
        work: scratch, (60,).

    Returns:
        Size of the whole step in standard deviations of the pose's own unknowns, given the common ones.
    """
    n = x.shape[0]
    step, move, before = work[:LOCAL], work[LOCAL : LOCAL + MOVE], work[30 : 30 + TOUCH]
    own_unknowns(local, x, n, LOCAL + n, step)
    size = 0.0
    for i in range(LOCAL):
        total = 0.0
        for c in range(i, UNKNOWNS):
            total += local[i, c] * step[c]
        size += total * total
    share = min(share, max_step / max(abs(step[0]), 1e-300), 0.7 / max(abs(step[1]), 1e-300))
    for a in range(AROUND, AROUND + 2):
        share = min(share, 1.0 / max(abs(step[a]), 1e-300))
    ahead = touch[0] + share * step[0]
    if ahead < 0.0 or ahead > end:
        share_s = (min(max(ahead, 0.0), end) - touch[0]) / step[0]
        step[0] *= share_s / share if share > 0.0 else 0.0
    plan_move(lin, step, move)
    turn = 0.0
    for q in range(3):
        turn += abs(move[6 + q]) + abs(move[15 + q])
    share = min(share, 0.5 / max(turn, 1e-300))
    for q in range(TOUCH):
        before[q] = touch[q]
    advance(touch, before, share, step, move)
    return math.sqrt(size)


@kernel
def admit(wrench, T, gravity_world, sensor_from_base, payload, limit, gravity):
    """Return whether a reading is finite, within the range of the sensor and at a valid pose.

    Args:
        wrench: at the base, (6,); T: of the base in the world, (4, 4).
        gravity_world: [m/s²], (3,).
        sensor_from_base, payload, limit: as in `observe`.
        gravity: in base axes, filled, (3,).
    """
    for i in range(3):
        gravity[i] = 0.0
        for j in range(3):
            square = -1.0 if i == j else 0.0
            for q in range(3):
                square += T[i, q] * T[j, q]
            if not abs(square) <= 1e-6 or not math.isfinite(T[i, 3]) or not abs(T[3, i]) <= 1e-6:
                return False
            gravity[i] += T[j, i] * gravity_world[j]
    x, y = (T[0, 0], T[1, 0], T[2, 0]), (T[0, 1], T[1, 1], T[2, 1])
    if not dot(cross(x, y), (T[0, 2], T[1, 2], T[2, 2])) > 0.0 or not abs(T[3, 3] - 1.0) <= 1e-6:
        return False
    for i in range(6):
        read = 0.0
        for j in range(6):
            read += sensor_from_base[i, j] * wrench[j]
        for j in range(3):
            read += payload[i, j] * gravity[j]
        if not abs(read) <= limit[i] or not math.isfinite(wrench[i]):
            return False
    return True


@kernel
def apart(a, b):
    """Return the distance of two poses [m]; a rotation of one radian counts as a tenth of a metre."""
    moved = turned = 0.0
    for i in range(3):
        moved += (a[i, 3] - b[i, 3]) ** 2
        for j in range(3):
            turned += (a[i, j] - b[i, j]) ** 2
    return math.sqrt(moved) + 0.1 * math.sqrt(0.5 * turned)


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
