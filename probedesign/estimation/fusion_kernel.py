"""Touches of one fixed point as residual blocks, and their common unknowns (compiled).

Common unknowns are the error sources m of `error_sources.py` (unit priors), the part f of the friction ratios that all
touches share (unit priors), the compliance c of the object, the touched point at rest X [m], and the bias β of the
sensor in steps of its resolution, a random walk over the readings; X walks too if the object stands loose. Unknown at
pose k alone are its touch y (5) and how far its stiffness is off, e. To first order about the last linearisation, with
h the base wrench, x the touched point, F the force on the probe, and H, X_y, F_y their derivatives by the touch:

    W (h + H δy + D m + D_e e + B β - w)            what was read, in the channels that count
    (a - c_f μ f)/(d_f μ), two rows                 the prior on friction
    e                                               the prior on the stiffness at this touch
    (T (x + X_y δy + Q m + Q_e e) + R (c F + c₀ F_y δy) - X)/σ_robot      the touched point yields by -c F

Here c = c̄ + σ_c z with the unit prior of z, the mean and the standard deviation of the half-normal prior of c
(`fusion.py` integrates over the prior itself), and c₀ is the last c.

The friction ratio a of every touch is N(0, μ²) per direction. Touches of one object by one probe are alike, and slip to
the same side as the base presses on: a part of standard deviation c_f μ is common to them, one of d_f μ is not.

Householder reflections take y and e out of each pose's rows. What is left is accumulated in the order of time in the
information matrix of (m, f, z, X, β); β, and X with it, walks from pose to pose and is smoothed backward afterwards.
`tests/reference/fusion.py` solves the same dense system.
"""

import math

from probedesign.estimation.contact_fit import MIN_FRICTION
from probedesign.rod.kernels import inner, kernel
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
    MOVE,
    POINT,
    TOUCH,
    UNKNOWNS,
    VALUE,
    WRENCH,
    advance,
    plan_move,
)

BIAS, FRICTION = 6, 2
AFTER_SOURCES = FRICTION + 1  #: Common unknowns between the error sources and the point: friction and compliance.
WALKING = 3 + BIAS  #: Unknowns that may walk, the last ones: the touched point and the bias.
LOCAL = UNKNOWNS + 1  #: Unknowns of a pose alone: its touch and its stiffness.
PINNED = 1e-6  #: Standard deviation of a bias, in steps, below which it counts as known.
#: Standard deviation of the step of a bias, in steps, with which a point walks where the bias does not: less would cost
#: digits.
STANDING = 1e-4
STATED = 5  #: Unknowns at most whose covariance is computed.
EXACT = 1e-8  #: Standard deviation of the base's place [m] below which a robot counts as exact.


def columns(causes: int) -> int:
    """Return the number of columns of the reduced rows: error sources, friction, compliance, X, bias, right-hand
    side."""
    return causes + AFTER_SOURCES + WALKING + 1


def rows_of(channels: int) -> int:
    """Return the number of rows of a pose's block before its own unknowns are eliminated."""
    return channels + 6


@inner
def column_of(D, r, c, scatter, creep, ramp):
    """Return an entry of an error column that is common to all poses: zero for the scatter, scaled for the creep."""
    if c == scatter:
        return 0.0
    return D[r, c] * (ramp if c == creep else 1.0)


@kernel
def reduce_keyframe(touch, lin, D, wrench, pose, channels, whiten, bias, friction, common, alone, weight, compliance,
                    repeat, scatter, creep, ramp, block, local, reduced):  # fmt: skip
    """Fill the rows of one pose with its own unknowns eliminated.

    Args:
        touch, lin, D: as linearised, (TOUCH,), (ROWS, ...), (12, J).
        wrench: read at the base, (6,); pose: of the base in the world, (4, 4).
        channels: what of a wrench at the base counts, (m, 6); whiten: of these, lower triangular, (m, m).
        bias: channels by the bias in steps, (m, 6).
        friction: prior standard deviation of the ratio; inf: none.
        common, alone: standard deviations c_f of its part that all touches have in common and d_f of the other, which
            is above 0, over that one.
        weight: of the probe in base axes [N], (3,).
        compliance: of the object [m/N]: where it is linearised, mean and standard deviation of its prior, (3,).
        repeat: standard deviation of the base's place at this pose alone [m].
        scatter, creep: columns of D that scatter from touch to touch, and that grow by `ramp`; -1: none.
        block: scratch, (m + 6, LOCAL + columns).
        local: filled: rows that give the pose's own unknowns from the common ones, (LOCAL, LOCAL + columns).
        reduced: filled, (m, columns).
    """
    m, J = channels.shape[0], D.shape[1]
    width = LOCAL + J + AFTER_SOURCES + WALKING + 1
    rhs, first_bias, first_point = width - 1, width - 1 - BIAS, width - 1 - WALKING
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
                    block[i, LOCAL + c] += share * column_of(D, a, c, scatter, creep, ramp)
                block[i, rhs] += share * (wrench[a] - lin[WRENCH + a, VALUE])
            for c in range(BIAS):
                block[i, first_bias + c] += w * bias[q, c]
    if friction < math.inf:
        per = 1.0 / (alone * max(friction, MIN_FRICTION))
        for a in range(FRICTION):
            block[m + a, AROUND + a] = per
            block[m + a, LOCAL + J + a] = -common / alone
            block[m + a, rhs] = -per * touch[AROUND + a]
    block[m + 2, UNKNOWNS] = 1.0
    place = 1.0 / max(repeat, EXACT)
    for i in range(3):
        row = m + 3 + i
        at, force = pose[i, 3], 0.0
        for q in range(3):
            turn = place * pose[i, q]
            at += pose[i, q] * lin[POINT + q, VALUE]
            # Of the base wrench the force is that of the contact and the weight; an error source moves it by what the
            # object's yielding does not show.
            force += pose[i, q] * (lin[WRENCH + q, VALUE] - weight[q])
            for u in range(UNKNOWNS):
                by_touch = lin[POINT + q, BY_TOUCH + u] + compliance[0] * lin[WRENCH + q, BY_TOUCH + u]
                block[row, u] += turn * by_touch
            if scatter >= 0:
                block[row, UNKNOWNS] += turn * D[POINT + q, scatter]
            for c in range(J):
                block[row, LOCAL + c] += turn * column_of(D, POINT + q, c, scatter, creep, ramp)
        block[row, first_point - 1] = place * compliance[2] * force
        block[row, first_point + i] = -place
        block[row, rhs] = -place * (at + compliance[1] * force)
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
    rhs = J + AFTER_SOURCES + WALKING
    for i in range(m):
        for c in range(rhs + 1):
            reduced[i, c] = 0.0
        for q in range(i + 1):
            w = whiten[i, q]
            for a in range(6):
                share = w * channels[q, a]
                for c in range(J):
                    reduced[i, c] += share * D[a, c]
                reduced[i, rhs] += share * (wrench[a] - free[a])
            for c in range(BIAS):
                reduced[i, rhs - BIAS + c] += w * bias[q, c]


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
def step_keyframe(touch, lin, local, x, share, max_step, end, beyond, work):
    """Move a pose's touch to the solution of the common unknowns, or part of the way if that is far.

    Args:
        touch: as linearised, moved in place, (TOUCH,).
        local: from `reduce_keyframe`; x: from `solve_reduced`.
        share: of the step to go at most; max_step: of arclength [m].
        end: furthest arclength at which a touch acts [m].
        beyond: how far beyond it the errors may place a touch that stays there [m].
        work: scratch, (60,).

    Returns:
        Size of the whole step in standard deviations of the pose's own unknowns, given the common ones.
    """
    n = x.shape[0]
    step, move, before = work[:LOCAL], work[LOCAL : LOCAL + MOVE], work[30 : 30 + TOUCH]
    own_unknowns(local, x, n, LOCAL + n, step)
    if touch[0] >= end and 0.0 < step[0] <= beyond:
        step[0] = 0.0  # the point of the linear model lies beyond the end, as on a longer rod
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


@inner
def _walk(A, eta, n, steps, M, L, inverse, link):
    """Let the last unknowns take a random step each; return what is taken off the misfit.

    With S the information of their old values b, T what ties them to the others o and Q the inverse of the steps'
    variances, M = S + Q: Λ_oo - T M⁻¹ Tᵀ, Λ_ob = T M⁻¹ Q, Λ_bb = Q - Q M⁻¹ Q.

    Args:
        A, eta: information matrix (n, n) and vector (n,), changed in place.
        steps: inverse variances of the steps, (w,); w is the number of the unknowns that walk.
        M, L, inverse: scratch, (WALKING, WALKING) each.
        link: filled with what gives the old values again, M⁻¹ (η - Tᵀ o + Q b): M⁻¹, M⁻¹ Tᵀ and M⁻¹ η, (w, n + 1).
    """
    w = steps.shape[0]
    o = n - w
    for i in range(w):
        for j in range(w):
            M[i, j] = A[o + i, o + j] + (steps[i] if i == j else 0.0)
    if not factor(M, w):
        return math.nan
    invert_lower(M, w, L)
    for i in range(w):
        for j in range(w):
            total = 0.0
            for k in range(max(i, j), w):
                total += L[k, i] * L[k, j]
            inverse[i, j] = total
            link[i, j] = total
    taken = 0.0
    for i in range(w):
        for j in range(w):
            taken += eta[o + i] * inverse[i, j] * eta[o + j]
    for r in range(o):
        # The row of T M⁻¹, in M's memory.
        for i in range(w):
            total = 0.0
            for j in range(w):
                total += A[r, o + j] * inverse[j, i]
            M[0, i] = total
            link[i, w + r] = total
        for i in range(w):
            eta[r] -= M[0, i] * eta[o + i]
        for c in range(r + 1):
            total = 0.0
            for i in range(w):
                total += M[0, i] * A[c, o + i]
            A[r, c] -= total
            A[c, r] = A[r, c]
        for i in range(w):
            A[o + i, r] = steps[i] * M[0, i]
    for r in range(o):
        for i in range(w):
            A[r, o + i] = A[o + i, r]
    for i in range(w):
        total = 0.0
        for j in range(w):
            total += inverse[i, j] * eta[o + j]
        link[i, n] = total
        M[2, i] = steps[i] * total
        for j in range(w):
            A[o + i, o + j] = (steps[i] if i == j else 0.0) - steps[i] * inverse[i, j] * steps[j]
    for i in range(w):
        eta[o + i] = M[2, i]
    return taken


@inner
def _steps_of(walk, memory):
    """Compute the inverse variances of a step of the point and the bias, or of the bias alone.

    Args:
        walk: variances of the bias's step on each channel [steps²] and of the point's on each axis [m²], (2,).
        memory: filled from the returned index on, (WALKING,).

    Returns:
        Where they begin; WALKING without a step.
    """
    for i in range(3):
        memory[i] = 1.0 / walk[1] if walk[1] > 0.0 else 0.0
    for i in range(3, WALKING):
        memory[i] = 1.0 / max(walk[0], STANDING * STANDING)
    return 0 if walk[1] > 0.0 else (3 if walk[0] > 0.0 else WALKING)


def solve_work(causes: int) -> int:
    """Return the size of the scratch array of `solve_reduced`."""
    n = columns(causes) - 1
    return n * n + 2 * n + 3 * WALKING * WALKING + 2 * STATED * n


@kernel
def solve_reduced(reduced, order, walk, start, stated, chain, work, x, cov):
    """Solve for the common unknowns from the rows of all poses in the order of time.

    Args:
        reduced: (poses, m, columns).
        order: which of them count, in the order of time, (p,).
        walk: variance of the step before each of those (that of the first is not used), of the bias [steps²] and of
            the point [m²], (p, 2).
        start: standard deviation of the bias at the first pose, in steps.
        stated: the unknowns whose covariance is computed, (j,).
        chain: filled with what gives bias and point before each step again, (len(order), WALKING, n + 1).
        work: scratch, (solve_work(J),); the factor of the information and its scale stay at its front.
        x: filled: m, f, z, X and β of the last pose, (n,).
        cov: of those, filled, (j, j).

    Returns:
        The least misfit squared, priors counted; NaN where there is none.
    """
    n = reduced.shape[2] - 1
    first_point = n - WALKING
    A = work[: n * n].reshape((n, n))
    o = n * n
    scale, eta = work[o : o + n], work[o + n : o + 2 * n]
    o += 2 * n
    three = work[o : o + 3 * WALKING * WALKING].reshape((3, WALKING, WALKING))
    M, L, inverse = three[0], three[1], three[2]
    o += 3 * WALKING * WALKING
    pair = work[o : o + 2 * STATED * n].reshape((2, STATED, n))
    rows, solved = pair[0], pair[1]
    for i in range(n):
        eta[i] = 0.0
        for j in range(n):
            A[i, j] = 0.0
    for i in range(first_point):
        A[i, i] = 1.0
    for i in range(n - BIAS, n):
        A[i, i] = 1.0 / max(start, PINNED) ** 2
    chi2 = 0.0
    for at in range(order.shape[0]):
        k = order[at]
        if at > 0:
            first = _steps_of(walk[at], solved[0])
            if first < WALKING:
                chi2 -= _walk(A, eta, n, solved[0, first:WALKING], M, L, inverse, chain[at])
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
    for a in range(stated.shape[0]):
        for i in range(n):
            rows[a, i] = 0.0
        rows[a, stated[a]] = 1.0
    covariance_of(A, n, scale, rows, stated.shape[0], solved, cov)
    return chi2


@kernel
def smooth(chain, order, walk, x, xs, memory):
    """Fill the common unknowns at each pose, which differ in bias and point.

    Args:
        chain, order, walk, x: of `solve_reduced`.
        xs: filled where `order` points to, (poses, n).
        memory: scratch, (WALKING,).
    """
    n = x.shape[0]
    after = x
    for at in range(order.shape[0] - 1, -1, -1):
        here = xs[order[at]]
        for i in range(n):
            here[i] = after[i]
        if at + 1 < order.shape[0]:
            first, link = _steps_of(walk[at + 1], memory), chain[at + 1]
            steps, w = memory[first:WALKING], WALKING - first
            o = n - w
            for i in range(w):
                total = link[i, n]
                for r in range(o):
                    total -= link[i, w + r] * after[r]
                for j in range(w):
                    total += link[i, j] * steps[j] * after[o + j]
                here[o + i] = total
        after = here


@inner
def _pass_on(rows, steps, link, half, scattered):
    """Express rows by bias and point after their step instead of before it.

    Args:
        rows: (3, n); steps: inverse variances, (w,); link: of `_walk`.
        half: scratch, (3, WALKING); scattered: what the step itself contributes is added, (3, 3).
    """
    w = steps.shape[0]
    o = rows.shape[1] - w
    for i in range(3):
        for a in range(w):
            half[i, a] = 0.0
            for b in range(w):
                half[i, a] += rows[i, o + b] * link[b, a]
    for i in range(3):
        for j in range(3):
            for a in range(w):
                scattered[i, j] += half[i, a] * rows[j, o + a]
    for i in range(3):
        for r in range(o):
            for a in range(w):
                rows[i, r] -= rows[i, o + a] * link[a, w + r]
        for a in range(w):
            rows[i, o + a] = half[i, a] * steps[a]


@kernel
def last_point(
    lins, Ds, locals_, poses, order, touched, walk, chain, xs, scatter, creep, ramps, first, work, solve_memory, point,
    cov,
):  # fmt: skip
    """Compute a point of the last touch in the world, and its covariance.

    Bias and point at a pose are linear functions of what is common and of their values after the next step, and an
    error independent of both.

    Args:
        lins, Ds, locals_, poses, touched: of all poses.
        order, walk, chain: as in `solve_reduced`; xs: of `smooth`.
        ramps: how far creep has gone at each pose.
        first: its first row in a linearisation, POINT or CENTRE.
        work: scratch, (6 n + 100,); solve_memory: as `solve_reduced` left its work.
        point: filled [m], (3,); cov: filled [m²], (3, 3).
    """
    n, J = xs.shape[1], Ds.shape[2]
    A = solve_memory[: n * n].reshape((n, n))
    scale = solve_memory[n * n : n * n + n]
    rows, solved = work[: 3 * n].reshape((3, n)), work[3 * n : 6 * n].reshape((3, n))
    o = 6 * n
    G, local_part = work[o : o + 6 * LOCAL].reshape((2, 3, LOCAL))
    o += 6 * LOCAL
    scattered = work[o : o + 9].reshape((3, 3))
    half = work[o + 9 : o + 9 + 3 * WALKING].reshape((3, WALKING))
    step = half[0]
    last = order.shape[0] - 1
    while not touched[order[last]]:
        last -= 1
    k = order[last]
    lin, D, local, x = lins[k], Ds[k], locals_[k], xs[k]
    own_unknowns(local, x, n, LOCAL + n, step)
    for i in range(3):
        at = poses[k, i, 3]
        for c in range(n):
            rows[i, c] = 0.0
        for u in range(LOCAL):
            G[i, u] = 0.0
        for q in range(3):
            turn = poses[k, i, q]
            at += turn * lin[first + q, VALUE]
            for u in range(UNKNOWNS):
                G[i, u] += turn * lin[first + q, BY_TOUCH + u]
            if scatter >= 0:
                G[i, UNKNOWNS] += turn * D[first + q, scatter]
            for c in range(J):
                by = turn * column_of(D, first + q, c, scatter, creep, ramps[k])
                rows[i, c] += by
                at += by * x[c]
        for u in range(LOCAL):
            at += G[i, u] * step[u]
        point[i] = at
        # local_part = G R⁻¹, row by row: solve local_part R = G.
        for u in range(LOCAL):
            left = G[i, u]
            for v in range(u):
                left -= local_part[i, v] * local[v, u]
            local_part[i, u] = left / local[u, u] if abs(local[u, u]) > 1e-300 else 0.0
        for c in range(n):
            for u in range(LOCAL):
                rows[i, c] -= local_part[i, u] * local[u, LOCAL + c]
    for i in range(3):
        for j in range(3):
            scattered[i, j] = 0.0
            for u in range(LOCAL):
                scattered[i, j] += local_part[i, u] * local_part[j, u]
    for at_k in range(last + 1, order.shape[0]):
        walks = _steps_of(walk[at_k], solved[0])
        if walks < WALKING:
            _pass_on(rows, solved[0, walks:WALKING], chain[at_k], half, scattered)
    covariance_of(A, n, scale, rows, 3, solved, cov)
    for i in range(3):
        for j in range(3):
            cov[i, j] += scattered[i, j]
