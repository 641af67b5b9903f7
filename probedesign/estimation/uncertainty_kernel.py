"""How error sources and noise propagate to a located contact (compiled).

A source of one standard deviation moves the true reading of a touch by a column of D and its true point by one of Q.
A reading is then known to Σ = noise + drift + D Dᵀ, the nearest touch answers it by the gain K = C Hᵀ Σ⁻¹ with
C = (Hᵀ Σ⁻¹ H + prior)⁻¹, and the point is known to

    X C Xᵀ + Q Qᵀ - X K D Qᵀ - (X K D Qᵀ)ᵀ,

with H and X the derivatives of wrench and point by the touch. `tests/reference/uncertainty.py` does the same in numpy.
"""

import math
from pathlib import Path

import numpy as np

from probedesign.estimation.contact_fit import RESIDUALS, normal_equations, residuals
from probedesign.estimation.linalg_kernel import (
    covariance_of,
    factor,
    invert_lower,
    scale_and_factor,
    solve_scaled,
)
from probedesign.estimation.surface_contact_kernel import (
    ALONG,
    AROUND,
    BY_E,
    BY_GRAVITY,
    BY_TOUCH,
    CENTRE,
    MOVE,
    NORMAL,
    PHI,
    POINT,
    TOUCH,
    UNKNOWNS,
    VALUE,
    WRENCH,
    S,
    advance,
    linearise,
    linearise_touch,
    plan_move,
    radius_and_slope,
)
from probedesign.rod.kernels.body import BEND_X, BEND_Y, OK
from probedesign.rod.kernels.compiled import drop_stale, inner, kernel
from probedesign.rod.kernels.vectors import add, cross, plus, take, times

drop_stale(Path(__file__).parent)

ROOT, GAINS = 1, 6
"""Columns after those of the rod and of the turns: compliance of the root, and gain of each channel of the sensor."""
ROOT_CENTRE = 0.375
"""Where the root's compliance is centred, in base radii (`rod.ROOT_CENTRE`, docs/decisions/0006)."""
FORCE, MOMENT = np.arange(0, 6, 3)


@inner
def _row3(A, row, j):
    return (A[row, j], A[row + 1, j], A[row + 2, j])


@inner
def _put3(A, row, j, x):
    for q in range(3):
        A[row + q, j] = x[q]


@inner
def _moved(lin, gravity, shift, turn, change, D, c):
    """The column of a base that is shifted and turned and of gravity that changes, as seen in the modelled base frame.

    A turn of the base turns what it reads, and gravity the other way as seen from it.
    """
    seen = plus(cross(gravity, turn), change)
    F = cross(turn, _row3(lin, WRENCH, VALUE))
    M = plus(cross(turn, _row3(lin, WRENCH + 3, VALUE)), cross(shift, _row3(lin, WRENCH, VALUE)))
    x = plus(cross(turn, _row3(lin, POINT, VALUE)), shift)
    p = plus(cross(turn, _row3(lin, CENTRE, VALUE)), shift)
    for q in range(3):
        F = add(F, seen[q], _row3(lin, WRENCH, BY_GRAVITY + q))
        M = add(M, seen[q], _row3(lin, WRENCH + 3, BY_GRAVITY + q))
        x = add(x, seen[q], _row3(lin, POINT, BY_GRAVITY + q))
        p = add(p, seen[q], _row3(lin, CENTRE, BY_GRAVITY + q))
    _put3(D, WRENCH, c, F)
    _put3(D, WRENCH + 3, c, M)
    _put3(D, POINT, c, x)
    _put3(D, CENTRE, c, p)


@inner
def error_columns(body, gravity, lin, own, turns, root, gain, hanging, sensor_from_base, base_from_sensor, reference,
                  still, D):  # fmt: skip
    """One standard deviation of each error source, as it moves base wrench, touched point and centreline point.

    Args:
        body: of the rod; gravity: [m/s²], (3,).
        lin: linearisation with all parameters, see `surface_contact_kernel`.
        own: one standard deviation a row, of log E and what follows it, (a, 4 + K).
        turns: one standard deviation a row, of the base's shift and turn and of gravity [m, rad, m/s²], (b, 9).
        root: of the length of rigid rod at the root [m].
        gain: of the sensor's channels, relative, (6,).
        hanging: wrench of what hangs on the sensor, by gravity, about the base, (6, 3).
        sensor_from_base, base_from_sensor: carry wrenches, (6, 6).
        reference: wrench at the base at which the sensor reads zero, (6,).
        still: columns of the free probe's reading, which a tare has taken away, (6, J).
        D: filled, (12, J), J = a + b + 7.
    """
    a, b = own.shape[0], turns.shape[0]
    for c in range(a):
        for r in range(12):
            total = 0.0
            for j in range(own.shape[1]):
                if own[c, j] != 0.0:
                    total += own[c, j] * lin[r, BY_E + j]
            D[r, c] = total
    for d in range(b):
        c = a + d
        change = take(turns[d], 6)
        _moved(lin, gravity, take(turns[d], 0), take(turns[d], 3), change, D, c)
        for r in range(6):
            for q in range(3):
                D[r, c] += hanging[r, q] * change[q]
    c = a + b
    r0 = body.radii[0]
    bend = root / (r0 * r0 * r0 * r0)
    turn = (
        -bend * body.constants[BEND_X] * lin[WRENCH + 3, VALUE],
        -bend * body.constants[BEND_Y] * lin[WRENCH + 4, VALUE],
        0.0,
    )
    shift = times(-1.0, cross(turn, (0.0, 0.0, ROOT_CENTRE * r0)))
    _moved(lin, gravity, shift, turn, (0.0, 0.0, 0.0), D, c)
    for i in range(6):
        c = a + b + 1 + i
        read = 0.0
        for q in range(6):
            read += sensor_from_base[i, q] * (lin[WRENCH + q, VALUE] - reference[q])
        for r in range(6):
            D[r, c] = gain[i] * base_from_sensor[r, i] * read
            D[6 + r, c] = 0.0
    for r in range(6):
        for c in range(D.shape[1]):
            D[r, c] -= still[r, c]


@inner
def measurement_covariance(noise, D, cov):
    """Σ = noise + D Dᵀ of a reading, (6, 6); noise holds the drift as well."""
    for i in range(6):
        for j in range(i + 1):
            total = noise[i, j]
            for c in range(D.shape[1]):
                total += D[i, c] * D[j, c]
            cov[i, j] = total
            cov[j, i] = total


@inner
def whitening(cov, work, whiten):
    """Lower triangular, with whitenᵀ whiten the inverse of a covariance (6, 6), which stays; whether it is positive."""
    for i in range(6):
        for j in range(6):
            work[i, j] = cov[i, j]
    if not factor(work, 6):
        return False
    invert_lower(work, 6, whiten)
    return True


CHI2, CHI2_FRICTION, LEVER, VAR_S, COV_TOUCH, COV_POINT, COV_CENTRE, LINEAR, RESULT = (
    0,
    1,
    2,
    3,
    4,
    29,
    38,
    47,
    65,
)
"""Where in a result stand the misfit squared, the part of it that is friction's, how much the base moment changes with
s over the force, the variance of s_contact [m²], the covariance of the touch (5, 5), those of the touched point and of
the centreline point [m²] (3, 3), and both to first order alone."""


@inner
def _point_covariance(row, lin, whiten, D, C, W6, out):
    """cov of a point whose rows in lin and D begin at `row`, (3, 3) into out (9,).

    Args:
        C: covariance of the touch, (5, 5); W6: scratch, (3, 6 + J).
    """
    J = D.shape[1]
    # share = X C (W H)ᵀ W, the gain of the point on the reading.
    for i in range(3):
        for q in range(6):
            W6[i, q] = 0.0
        for u in range(UNKNOWNS):
            xc = 0.0
            for v in range(UNKNOWNS):
                xc += lin[row + i, BY_TOUCH + v] * C[v, u]
            for q in range(6):
                # (W H) column u, then back through Wᵀ
                wh = 0.0
                for m in range(q + 1):
                    wh += whiten[q, m] * lin[WRENCH + m, BY_TOUCH + u]
                for m in range(q + 1):
                    W6[i, m] += xc * wh * whiten[q, m]
        for c in range(J):
            total = 0.0
            for q in range(6):
                total += W6[i, q] * D[q, c]
            W6[i, 6 + c] = total
    for i in range(3):
        for k in range(3):
            total = 0.0
            for u in range(UNKNOWNS):
                for v in range(UNKNOWNS):
                    total += lin[row + i, BY_TOUCH + u] * C[u, v] * lin[row + k, BY_TOUCH + v]
            for c in range(J):
                total += D[row + i, c] * D[row + k, c]
                total -= W6[i, 6 + c] * D[row + k, c] + W6[k, 6 + c] * D[row + i, c]
            out[3 * i + k] = total


@inner
def posterior(lin, touch, J, whiten, D, by_s, work, result):
    """Covariances of a fitted touch, to first order, into the result; whether it is known at all.

    Args:
        J: residuals' derivatives by the touch, (8, 5).
        by_s: of s_contact by the touch, (5,).
        work: scratch, (posterior_size(columns of D),).
    """
    H, scale = work[:25].reshape((UNKNOWNS, UNKNOWNS)), work[25:30]
    rows = work[30:55].reshape((UNKNOWNS, UNKNOWNS))
    solved = work[55:80].reshape((UNKNOWNS, UNKNOWNS))
    W6 = work[80:][: 3 * (6 + D.shape[1])].reshape((3, 6 + D.shape[1]))
    for u in range(UNKNOWNS):
        for v in range(UNKNOWNS):
            total = 0.0
            for i in range(RESIDUALS):
                total += J[i, u] * J[i, v]
            H[u, v] = total
            rows[u, v] = 1.0 if u == v else 0.0
    force = touch[NORMAL] ** 2 * (1.0 + touch[AROUND] ** 2 + touch[ALONG] ** 2)
    lever = 0.0
    for q in range(3):
        lever += lin[WRENCH + 3 + q, BY_TOUCH + S] ** 2
    result[LEVER] = math.sqrt(lever / max(force, 1e-300))
    if not scale_and_factor(H, UNKNOWNS, scale):
        return False
    C = result[COV_TOUCH:COV_POINT].reshape((UNKNOWNS, UNKNOWNS))
    covariance_of(H, UNKNOWNS, scale, rows, UNKNOWNS, solved, C)
    total = 0.0
    for u in range(UNKNOWNS):
        for v in range(UNKNOWNS):
            total += by_s[u] * C[u, v] * by_s[v]
    result[VAR_S] = total
    _point_covariance(POINT, lin, whiten, D, C, W6, result[COV_POINT:COV_CENTRE])
    _point_covariance(CENTRE, lin, whiten, D, C, W6, result[COV_CENTRE:LINEAR])
    for i in range(18):
        result[LINEAR + i] = result[COV_POINT + i]
    return True


ASIDE = math.sqrt(3.0)
"""Standard deviations to either side at which the valley is looked at: places of Gauss and Hermite's quadrature."""
FLAT_ENOUGH = 0.2
"""Sagitta of the valley, over the smallest standard deviation of the point, that a linear covariance may neglect."""
TAIL = 2.0
"""Factor on the mean square of what bows. b δ² has the long tail of a χ² with one degree of freedom: with its mean
square alone the 95 % ellipsoid of a bow much wider than the rest holds 92 %, with twice that 94.6 % (the integral of
the standard normal over δ² + δ⁴/(3 TAIL) + χ²₁ <= χ²₃(95 %))."""
MAX_CURVATURE = 8.0
"""Curvature of the valley times the length, at most: a probe bent to a quarter of a circle over its outer fifth."""
WIDE = 0.02
"""Standard deviation of the point, over the length, from which the curve is evaluated on both sides; where it is less,
the inner side is taken for both."""
BESIDE = 1e4
"""Weight that keeps a point on the valley at its distance from the estimate, over its information."""


@inner
def principal_axis(cov, u):
    """Direction of the largest variance of a covariance (9,), into u (3,); returns that variance."""
    u[0], u[1], u[2] = 1.0, 1.0, 1.0
    for j in range(3):
        if cov[4 * j] >= cov[0] and cov[4 * j] >= cov[4] and cov[4 * j] >= cov[8]:
            for q in range(3):
                u[q] = cov[3 * q + j]
    size = 0.0
    for _ in range(12):
        x = cov[0] * u[0] + cov[1] * u[1] + cov[2] * u[2]
        y = cov[3] * u[0] + cov[4] * u[1] + cov[5] * u[2]
        z = cov[6] * u[0] + cov[7] * u[1] + cov[8] * u[2]
        size = math.sqrt(x * x + y * y + z * z)
        if not size > 0.0:
            return 0.0
        u[0], u[1], u[2] = x / size, y / size, z / size
    return size


@inner
def smallest_variance(cov):
    """det over the product of the other two, from the invariants of a covariance (9,): a lower estimate is enough."""
    trace = cov[0] + cov[4] + cov[8]
    minors = (
        cov[0] * cov[4]
        - cov[1] * cov[3]
        + cov[0] * cov[8]
        - cov[2] * cov[6]
        + cov[4] * cov[8]
        - cov[5] * cov[7]
    )
    det = (
        cov[0] * (cov[4] * cov[8] - cov[5] * cov[7])
        - cov[1] * (cov[3] * cov[8] - cov[5] * cov[6])
        + cov[2] * (cov[3] * cov[7] - cov[4] * cov[6])
    )
    return max(det / max(minors, 1e-300), 0.0) if trace > 0.0 else 0.0


@inner
def add_curvature(
    body, end, gravity, mass, wrench, whiten, friction, tol, touch, lin, sweep_work, brief, work, result
):
    """Add to the covariances what the curve of the valley of likely touches makes of them.

    The touches that explain a reading lie on a curve x + a δ + b δ² + c δ³ far narrower than it is bowed; its mean
    square about x is a aᵀ + 3 (a cᵀ + c aᵀ) + 3 b bᵀ + 15 c cᵀ for a standard normal δ. It is evaluated √3 standard
    deviations aside, one Gauss-Newton step beside the linear valley. Around the section, x bows by r e δφ²/2.

    Args:
        lin: at the estimate; touch: the estimate, as linearised.
        brief: scratch, (ROWS, 1 + UNKNOWNS); sweep_work: scratch, (work_size(0),).
        work: scratch, (CURVE_WORK,).
        result: see CHI2 ... RESULT, added to.
    """
    u, v, at = work[0:3], work[3:8], work[8 : 8 + TOUCH]
    J, r = work[25:65].reshape((RESIDUALS, UNKNOWNS)), work[65:73]
    H, b = work[73:98].reshape((UNKNOWNS, UNKNOWNS)), work[98:103]
    scale, move, along = work[103:108], work[108 : 108 + MOVE], work[126:131]
    sides = work[131:143]
    C = result[COV_TOUCH:COV_POINT]
    for row, cov in ((POINT, result[COV_POINT:COV_CENTRE]), (CENTRE, result[COV_CENTRE:LINEAR])):
        variance = principal_axis(cov, u)
        if not (variance > 0.0 and math.isfinite(variance)):
            return
        # The touch on the linear valley one standard deviation on: v = C Xᵀ u over its own spread along u.
        spread = 0.0
        for i in range(UNKNOWNS):
            along[i] = 0.0
            for q in range(3):
                along[i] += lin[row + q, BY_TOUCH + i] * u[q]
        for i in range(UNKNOWNS):
            v[i] = 0.0
            for j in range(UNKNOWNS):
                v[i] += C[UNKNOWNS * i + j] * along[j]
        for i in range(UNKNOWNS):
            spread += along[i] * v[i]
        if not spread > 0.0:
            return
        std = math.sqrt(spread)
        for i in range(UNKNOWNS):
            v[i] /= std
        thin = math.sqrt(smallest_variance(cov))
        radius, _tan = radius_and_slope(body, touch[S])
        if row == POINT:
            left = max(C[UNKNOWNS * PHI + PHI] - v[PHI] * v[PHI], 0.0)
            bow = TAIL * min(0.75 * left * left, 1.5) * radius * radius
            for i in range(3):
                for j in range(3):
                    e_i = (lin[POINT + i, VALUE] - lin[CENTRE + i, VALUE]) / radius
                    e_j = (lin[POINT + j, VALUE] - lin[CENTRE + j, VALUE]) / radius
                    cov[3 * i + j] += bow * e_i * e_j
        curvature = MAX_CURVATURE / body.knots[-1] + abs(v[PHI]) / std
        if 0.5 * spread * curvature < FLAT_ENOUGH * thin:
            continue
        seen = 0
        inward = 1 if v[S] < 0.0 else 0
        for other in range(2 if std > WIDE * body.knots[-1] else 1):
            side = inward if other == 0 else 1 - inward
            way = ASIDE if side else -ASIDE
            ahead = touch[S] + way * v[S]
            share = 1.0
            if ahead < 0.0 or ahead > end:
                share = (
                    max(min((end - touch[S]) / (way * v[S]), 1.0), 0.05)
                    if way * v[S] > 0.0
                    else max(min(-touch[S] / (way * v[S]), 1.0), 0.05)
                )
            if way * v[NORMAL] < 0.0:
                share = min(share, 0.75 * touch[NORMAL] / abs(way * v[NORMAL]))
            for i in range(UNKNOWNS):
                b[i] = way * v[i]
            plan_move(lin, b, move)
            advance(at, touch, share, b, move)
            status, lack, _margin, _size = linearise(body, gravity, mass, tol, 1.0, at, 0, sweep_work, brief)
            if status != OK or not lack < math.inf:
                continue
            residuals(brief, at, wrench, whiten, friction, J, r)
            normal_equations(J, r, H, b)
            weight = BESIDE / spread
            for i in range(UNKNOWNS):
                for j in range(UNKNOWNS):
                    H[i, j] += weight * along[i] * along[j]
            if not scale_and_factor(H, UNKNOWNS, scale):
                continue
            solve_scaled(H, UNKNOWNS, scale, b)
            for q in range(3):
                x = brief[row + q, VALUE]
                for i in range(UNKNOWNS):
                    x += brief[row + q, BY_TOUCH + i] * b[i]
                a = 0.0
                for i in range(UNKNOWNS):
                    a += lin[row + q, BY_TOUCH + i] * v[i]
                # What lies beside the straight way, as if looked at √3 standard deviations away.
                sides[3 * side + q] = (x - lin[row + q, VALUE] - share * way * a) / (share * share)
                sides[6 + q] = a
            seen += 1 + side
        if seen == 0:
            continue
        for q in range(3):
            low = sides[q] if seen != 2 else sides[3 + q]
            high = sides[3 + q] if seen != 1 else sides[q]
            sides[q], sides[3 + q] = (low + high) / 6.0, (high - low) / (6.0 * ASIDE)
        for i in range(3):
            for j in range(3):
                b_i, b_j, c_i, c_j = sides[i], sides[j], sides[3 + i], sides[3 + j]
                a_i, a_j = sides[6 + i], sides[6 + j]
                cov[3 * i + j] += 3.0 * (a_i * c_j + c_i * a_j) + 3.0 * TAIL * b_i * b_j + 15.0 * c_i * c_j


CURVE_WORK = 143
"""Numbers that `add_curvature` works in."""


@kernel
def columns_of(body, gravity, mass, tol, touch, own, turns, root, gain, hanging, sensor_from_base, base_from_sensor,
               reference, still, work, lin, D):  # fmt: skip
    """A touch settled and linearised with its error columns, see `linearise_touch` and `error_columns`.

    Returns:
        Whether the probe holds the touch.
    """
    parameters = own.shape[1] + 3
    if not linearise_touch(body, gravity, mass, tol, touch, parameters, work, lin):
        return False
    error_columns(body, gravity, lin, own, turns, root, gain, hanging, sensor_from_base, base_from_sensor, reference,
                  still, D)  # fmt: skip
    return True
