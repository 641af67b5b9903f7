"""Propagation of error sources and noise to a located contact (compiled).

One standard deviation of a source moves the reading of a touch by a column of D and its true point by one of Q.
A reading then has the covariance Σ = noise + drift + D Dᵀ, the fitted touch follows it by the gain K = C Hᵀ Σ⁻¹ with
C = (Hᵀ Σ⁻¹ H + prior)⁻¹, and the point is known to

    X C Xᵀ + Q Qᵀ - X K D Qᵀ - (X K D Qᵀ)ᵀ,

with H and X the derivatives of wrench and point by the touch. `tests/reference/uncertainty.py` does the same in numpy.
"""

import math
from typing import NamedTuple

from probedesign.core.frames import Array
from probedesign.estimation.candidates import is_curved
from probedesign.estimation.contact_fit import RESIDUALS, information, normal_equations, residuals
from probedesign.rod.kernels import inline_always, inner, kernel
from probedesign.rod.kernels.equations import BEND_X, BEND_Y, FLATNESS, OK
from probedesign.rod.kernels.linalg import (
    add,
    covariance_of,
    cross,
    dot,
    factor,
    invert_lower,
    minus,
    plus,
    principal_axis,
    put3,
    scale_and_factor,
    smallest_variance,
    solve_scaled,
    take,
    take3,
    times,
)
from probedesign.rod.kernels.surface_contact import (
    ALONG,
    AROUND,
    BY_E,
    BY_GRAVITY,
    BY_TOUCH,
    CENTRE,
    NORMAL,
    PHI,
    POINT,
    UNKNOWNS,
    VALUE,
    WRENCH,
    S,
    advance,
    linearise,
    outline_at,
    plan_move,
)

ROOT_CENTRE = 0.375  #: Where the root's compliance is centred, in base radii (`rod.ROOT_CENTRE`, docs/decisions/0006).


@inner
def _moved(lin, gravity, shift, turn, change, D, c):
    """Fill in the column of a base that is shifted and turned and of gravity that changes, in the modelled base frame.

    For a turn θ and a shift d of the base, δF = θ × F, δM = θ × M + d × F, δx = θ × x + d; gravity changes in the axes
    of the base by g × θ + δg, which acts by the derivatives of the linearisation.
    """
    seen = plus(cross(gravity, turn), change)
    F = cross(turn, take3(lin, WRENCH, VALUE))
    M = plus(cross(turn, take3(lin, WRENCH + 3, VALUE)), cross(shift, take3(lin, WRENCH, VALUE)))
    x = plus(cross(turn, take3(lin, POINT, VALUE)), shift)
    p = plus(cross(turn, take3(lin, CENTRE, VALUE)), shift)
    for q in range(3):
        F = add(F, seen[q], take3(lin, WRENCH, BY_GRAVITY + q))
        M = add(M, seen[q], take3(lin, WRENCH + 3, BY_GRAVITY + q))
        x = add(x, seen[q], take3(lin, POINT, BY_GRAVITY + q))
        p = add(p, seen[q], take3(lin, CENTRE, BY_GRAVITY + q))
    put3(D, WRENCH, c, F)
    put3(D, WRENCH + 3, c, M)
    put3(D, POINT, c, x)
    put3(D, CENTRE, c, p)


class SourceArrays(NamedTuple):
    """Error sources as `error_columns` takes them, one standard deviation each."""

    rod: Array  #: of log E and what follows it, a source a row, (a, 6 + K).
    #: of the base's shift and turn and of gravity [m, rad, m/s²], a source a row, (b, 9); with six more columns the
    #: shift and the turn of the points that no reading shows [m, rad].
    base: Array
    root: float  #: of the length of rigid rod at the root [m].
    gain: Array  #: of the sensor's channels, relative, (6,).
    payload_by_gravity: Array  #: wrench of what hangs on the sensor, by gravity, about the base, (6, 3).
    sensor_from_base: Array  #: sensor_from_base, base_from_sensor: carry wrenches, (6, 6).
    base_from_sensor: Array
    reference: Array  #: wrench at the base at which the sensor reads zero, (6,).
    tared: Array  #: columns of the free probe's reading, which a tare has taken away, (6, J).


@inner
def error_columns(body, gravity, lin, sources, D):
    """Fill D with what one standard deviation of each error source does to base wrench, touched and centreline point.

    Args:
        body: of the rod; gravity: [m/s²], (3,).
        lin: linearisation with all parameters, see `rod.kernels.surface_contact`.
        sources: `SourceArrays`.
        D: filled, (12, J), J = a + b + 7.
    """
    rod, base = sources.rod, sources.base
    a, b = rod.shape[0], base.shape[0]
    for c in range(a):
        for r in range(12):
            total = 0.0
            for j in range(rod.shape[1]):
                if rod[c, j] != 0.0:
                    total += rod[c, j] * lin[r, BY_E + j]
            D[r, c] = total
    for d in range(b):
        c = a + d
        change = take(base[d], 6)
        _moved(lin, gravity, take(base[d], 0), take(base[d], 3), change, D, c)
        for r in range(6):
            for q in range(3):
                D[r, c] += sources.payload_by_gravity[r, q] * change[q]
        if base.shape[1] > 9:
            of_touched = cross(take(base[d], 12), take3(lin, POINT, VALUE))
            of_centre = cross(take(base[d], 12), take3(lin, CENTRE, VALUE))
            for q in range(3):
                D[POINT + q, c] += base[d, 9 + q] + of_touched[q]
                D[CENTRE + q, c] += base[d, 9 + q] + of_centre[q]
    c = a + b
    r0 = body.radii[0]
    bend = sources.root / (r0 * r0 * r0 * r0)
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
            read += sources.sensor_from_base[i, q] * (lin[WRENCH + q, VALUE] - sources.reference[q])
        for r in range(6):
            D[r, c] = sources.gain[i] * sources.base_from_sensor[r, i] * read
            D[6 + r, c] = 0.0
    for r in range(6):
        for c in range(D.shape[1]):
            D[r, c] -= sources.tared[r, c]


@inner
def measurement_covariance(noise, D, cov):
    """Fill in Σ = noise + D Dᵀ of a reading, (6, 6); noise includes the drift."""
    for i in range(6):
        for j in range(i + 1):
            total = noise[i, j]
            for c in range(D.shape[1]):
                total += D[i, c] * D[j, c]
            cov[i, j] = total
            cov[j, i] = total


@inner
def whitening(cov, work, whiten):
    """Fill in lower triangular W with Wᵀ W the inverse of a covariance (6, 6); return whether that is positive."""
    for i in range(6):
        for j in range(6):
            work[i, j] = cov[i, j]
    if not factor(work, 6):
        return False
    invert_lower(work, 6, whiten)
    return True


@inner
def _point_covariance(row, lin, J, whiten, D, C, W6, out):
    """Fill in the covariance of a point whose rows in lin and D begin at `row`, (3, 3).

    Args:
        J: residuals' derivatives by the touch, (8, 5); C: covariance of the touch, (5, 5); W6: scratch, (3, 6 + J).
    """
    sources = D.shape[1]
    # W6 = X C (W H)ᵀ W, the gain of the point on the reading; the first rows of J are W H.
    for i in range(3):
        for q in range(6):
            W6[i, q] = 0.0
        for u in range(UNKNOWNS):
            xc = 0.0
            for v in range(UNKNOWNS):
                xc += lin[row + i, BY_TOUCH + v] * C[v, u]
            for q in range(6):
                for m in range(q + 1):
                    W6[i, m] += xc * J[q, u] * whiten[q, m]
        for c in range(sources):
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
            for c in range(sources):
                total += D[row + i, c] * D[row + k, c]
                total -= W6[i, 6 + c] * D[row + k, c] + W6[k, 6 + c] * D[row + i, c]
            out[i, k] = total


@inner
def posterior(lin, touch, J, whiten, D, by_s, work, W6, fit):
    """Fill in the covariances of a fitted touch to first order; return whether they exist.

    Args:
        J: residuals' derivatives by the touch, (8, 5).
        by_s: of s_contact by the touch, (5,).
        work: scratch, FIT_SCRATCH; W6: scratch, (3, 6 + columns of D).
        fit: filled, `multistart.FIT`.
    """
    H, rows, C, scale = work.H[:, :], work.identity[:, :], fit.cov_touch[:, :], work.scale[:]
    information(J, H)
    for u in range(UNKNOWNS):
        for v in range(UNKNOWNS):
            rows[u, v] = 1.0 if u == v else 0.0
    force = touch[NORMAL] ** 2 * (1.0 + touch[AROUND] ** 2 + touch[ALONG] ** 2)
    lever = 0.0
    for q in range(3):
        lever += lin[WRENCH + 3 + q, BY_TOUCH + S] ** 2
    fit.lever = math.sqrt(lever / max(force, 1e-300))
    if not scale_and_factor(H, UNKNOWNS, scale):
        return False
    covariance_of(H, UNKNOWNS, scale, rows, UNKNOWNS, work.solved[:, :], C)
    total = 0.0
    for u in range(UNKNOWNS):
        for v in range(UNKNOWNS):
            total += by_s[u] * C[u, v] * by_s[v]
    fit.var_s = total
    _point_covariance(POINT, lin, J, whiten, D, C, W6, fit.cov_surface)
    _point_covariance(CENTRE, lin, J, whiten, D, C, W6, fit.cov_centre)
    for i in range(3):
        for j in range(3):
            fit.cov_linear_surface[i, j] = fit.cov_surface[i, j]
            fit.cov_linear_centre[i, j] = fit.cov_centre[i, j]
    return True


NEAR_END = 0.3  #: Share of the way to a node up to which the growth of the misfit there is not compared.
MIN_SHARE = 0.05  #: Least share of the way to a node of the valley that second differences are divided by.
#: Standard deviations to either side at which the valley is evaluated: the nodes of Gauss-Hermite quadrature.
NODE = math.sqrt(3.0)
#: Sagitta of the valley, over the smallest standard deviation of the point, that a linear covariance may neglect.
FLAT_ENOUGH = 0.2
#: Factor on the mean square of what bows. b δ² has the long tail of a χ² with one degree of freedom: with its mean
#: square alone the 95 % ellipsoid of a bow much wider than the rest holds 92 %, with 2.32 times that 95 % (the integral
#: of the standard normal over δ² + δ⁴/(3 TAIL) + χ²₁ <= χ²₃(95 %)).
TAIL = 2.32
#: Curvature of the valley times the length, at most: a probe bent to a quarter of a circle over its outer fifth.
MAX_CURVATURE = 8.0
#: Standard deviation of the point, over the length, from which the curve is evaluated on both sides; where it is less,
#: the inner side is taken for both.
WIDE = 0.02
BESIDE = 1e4  #: Weight that keeps a point on the valley at its distance from the estimate, over its information.

#: Square of the correlation of touched point and centreline point along their principal axes from which both are
#: evaluated at the same places of one valley.
SAME_VALLEY = 0.99


class _Valley(NamedTuple):
    """The linear valley of likely touches along the principal axis of a point."""

    variance: float  #: of the point along the axis [m²].
    along: Array  #: derivatives by the touch of the point's place along the axis, (5,).
    change: Array  #: of the touch one standard deviation along the valley, (5,).


@inner
def _find_valley(lin, row, cov, C, axis, along, change):
    """Find the touch one standard deviation along the principal axis of a point on the linear valley.

    Args:
        row: of the point in lin; cov: its covariance, (3, 3); C: covariance of the touch, (5, 5).
        axis: scratch, (3,).
        along, change: filled, see `_Valley`.

    Returns:
        The variance along the axis [m²]; 0 where there is none.
    """
    variance, spread = principal_axis(cov, axis), 0.0
    if not (variance > 0.0 and math.isfinite(variance)):
        return 0.0
    for i in range(UNKNOWNS):
        along[i] = 0.0
        for q in range(3):
            along[i] += lin[row + q, BY_TOUCH + i] * axis[q]
    for i in range(UNKNOWNS):
        change[i] = 0.0
        for j in range(UNKNOWNS):
            change[i] += C[i, j] * along[j]
        spread += along[i] * change[i]
    if not spread > 0.0:
        return 0.0
    for i in range(UNKNOWNS):
        change[i] /= math.sqrt(spread)
    return spread


@inner
def _correlation(J, v, w):
    """Return the correlation of two unit directions of the touch, (J v) · (J w)."""
    total = 0.0
    for i in range(RESIDUALS):
        a, b = 0.0, 0.0
        for j in range(UNKNOWNS):
            a += J[i, j] * v[j]
            b += J[i, j] * w[j]
        total += a * b
    return total


@inner
def _share_within(touch, end, change):
    """Return the share of a change of the touch that stays on the probe and keeps pushing.

    At most 0.75 of the normal force is removed.
    """
    share, ahead = 1.0, touch[S] + change[S]
    if ahead > end:
        share = min((end - touch[S]) / change[S], 1.0)
    elif ahead < 0.0:
        share = min(-touch[S] / change[S], 1.0)
    if change[NORMAL] < 0.0:
        share = min(share, 0.75 * touch[NORMAL] / abs(change[NORMAL]))
    return share


@inline_always
def _offsets_beside(measured, whiten, tol, touch, lin, chi2, valley, side, memory, work, offsets):
    """Evaluate both points on the valley NODE standard deviations from the estimate, by one Gauss-Newton step from
    the linear valley.

    Args:
        measured, whiten, tol, touch, lin, memory, work: as in `add_curvature`; chi2: misfit at the estimate.
        valley: where it leads; side: 0 against its change of the touch, 1 along it.
        offsets: filled: how far touched point (3) and centreline point (3) lie from the linear valley there [m], (6,).

    Returns:
        By how much the misfit grows to there, over 3, as for a normal posterior; inf where the node is far off because
        of the end of the probe or of the force; NaN where there is no equilibrium.
    """
    at, J, r, H, b, lin_at = work.at[:], work.beside, work.r, work.H[:, :], work.b[:], memory.lin_touch
    scale, move, change = work.scale[:], work.move[:], work.change[:]
    for i in range(UNKNOWNS):
        change[i] = NODE * valley.change[i] if side else -NODE * valley.change[i]
    share = _share_within(touch, measured.end, change)
    plan_move(lin, change, move)
    advance(at, touch, share, change, move)
    at[S] = min(max(at[S], 0.0), measured.end)  # rounding
    status, lack, _margin, _size = linearise(
        measured.body, measured.gravity, measured.mass, tol, 1.0, at, 0, memory.sweep, lin_at
    )
    if status != OK or not lack < math.inf:
        return math.nan
    residuals(lin_at, at, measured.wrench, whiten, measured.friction, J, r)
    normal_equations(J, r, H, b)
    for i in range(UNKNOWNS):
        for j in range(UNKNOWNS):
            H[i, j] += BESIDE / valley.variance * valley.along[i] * valley.along[j]
    if not scale_and_factor(H, UNKNOWNS, scale):
        return math.nan
    solve_scaled(H, UNKNOWNS, scale, b)
    grown = -chi2
    for i in range(RESIDUALS):
        for j in range(UNKNOWNS):
            r[i] += J[i, j] * b[j]
        grown += r[i] * r[i]
    for q in range(6):  # rows of POINT and, after them, of CENTRE
        x = lin_at[POINT + q, VALUE] - lin[POINT + q, VALUE]
        for i in range(UNKNOWNS):
            x += lin_at[POINT + q, BY_TOUCH + i] * b[i] - share * lin[POINT + q, BY_TOUCH + i] * change[i]
        # The offset goes with the square of the share; the floor keeps the digits of a node near the end of the probe.
        offsets[q] = x / max(share, MIN_SHARE) ** 2
    return grown / (NODE * share) ** 2 if share > NEAR_END else math.inf


@inner
def _add_turn_around(lin, left, cov):
    """Add to the covariance of the touched point, (3, 3), the bow of its angle ψ varying by √left beside the valley.

    Returns:
        The bow for an angle one standard deviation off [m], (3,).
    """
    # ρ δψ²/2 has the mean square 3 bow²; a whole turn has one of 3/2 ρ².
    outward = minus(take3(lin, POINT, VALUE), take3(lin, CENTRE, VALUE))
    bow = times(-0.5 * min(left, math.sqrt(2.0)), outward)
    for i in range(3):
        for j in range(3):
            cov[i, j] += 3.0 * TAIL * bow[i] * bow[j]
    return bow


@inner
def add_curvature(measured, whiten, tol, touch, lin, J, memory, work, fit):
    """Add to the covariances what the curve of the valley of likely touches makes of them.

    The touches that explain a reading lie on a curve x + a δ + b δ² + c δ³ far narrower than it is bowed; its mean
    square about x is a aᵀ + 3 (a cᵀ + c aᵀ) + 3 b bᵀ + 15 c cᵀ for a standard normal δ. It is evaluated √3 standard
    deviations to either side. Around the section, ρ = r (cos ψ, f sin ψ) bows by ρ δψ²/2, dψ/dφ = f/g²; to one side
    with b, both together have b βᵀ + β bᵀ more, where β is that bow for one standard deviation.

    Args:
        measured: what the touch is fitted to; whiten: of the reading, (6, 6); tol: of sweeps [rad].
        lin: at the estimate; touch: the estimate, as linearised; J: derivatives of the residuals there, (8, 5).
        memory: scratch, `FitMemory`; work: scratch, FIT_SCRATCH; J may be its own.
        fit: `multistart.FIT`, added to.
    """
    of_point, of_centre, offsets, body = work.valley[0], work.valley[1], work.offsets, measured.body
    C, evaluated, around = fit.cov_touch[:, :], 0, (0.0, 0.0, 0.0)
    at = outline_at(body, 0.0, touch[PHI])
    by_phi = body.constants[FLATNESS] / (at.reach * at.reach)
    for point in range(2):
        row = POINT if point == 0 else CENTRE
        cov = fit.cov_surface if point == 0 else fit.cov_centre
        change = of_point if point == 0 else of_centre
        variance = _find_valley(lin, row, cov, C, work.axis, work.along, change)
        if variance == 0.0:
            return
        std, thin = math.sqrt(variance), math.sqrt(smallest_variance(cov))
        if point == 0:
            left = max(C[PHI, PHI] - change[PHI] * change[PHI], 0.0)
            around = _add_turn_around(lin, by_phi * by_phi * left, cov)
        curvature = MAX_CURVATURE / body.knots[-1] + abs(change[PHI]) / std
        checked = point == 0 and is_curved(body)
        if 0.5 * variance * curvature < FLAT_ENOUGH * thin and not checked:
            continue
        if evaluated and _correlation(J, of_point, of_centre) ** 2 >= SAME_VALLEY:
            change = of_point
        else:
            evaluated = 0
            valley, inward = _Valley(variance, work.along, change), 1 if change[S] < 0.0 else 0
            for other in range(2 if std > WIDE * body.knots[-1] or checked else 1):
                side = inward if other == 0 else 1 - inward
                grown = _offsets_beside(
                    measured, whiten, tol, touch, lin, fit.chi2, valley, side, memory, work, offsets[side]
                )
                if not math.isnan(grown):
                    evaluated += 1 + side
                if checked:
                    fit.growth = min(fit.growth, grown) if not math.isnan(grown) else 0.0
        if evaluated:
            # The side that was not evaluated counts as the other one.
            low, high = int(evaluated == 2), int(evaluated != 1)
            beside = around if point == 0 else (0.0, 0.0, 0.0)
            _add_bow(lin, row, change, offsets[low, 3 * point :], offsets[high, 3 * point :], beside, cov)


@inner
def _add_bow(lin, row, v, low, high, beside, cov):
    """Add to a covariance, (3, 3), how far a point is off the straight valley on its two sides, low and high (3,), and
    the product with its bow beside the valley, of an independent standard deviation.

    Error sources that move point and touch against each other may leave the point less uncertain than a, its change
    along the valley: a is then shortened to one standard deviation, so that cov - a aᵀ, and with it the sum, stays
    positive.
    """
    a = (0.0, 0.0, 0.0)
    for q in range(UNKNOWNS):
        a = add(a, v[q], take3(lin, row, BY_TOUCH + q))
    x, y, z = take3(cov, 0, 0), take3(cov, 0, 1), take3(cov, 0, 2)
    solved = add(add(times(a[0], cross(y, z)), a[1], cross(z, x)), a[2], cross(x, y))
    a = times(1.0 / math.sqrt(max(dot(a, solved) / max(dot(x, cross(y, z)), 1e-300), 1.0)), a)
    b = times(1.0 / 6.0, (low[0] + high[0], low[1] + high[1], low[2] + high[2]))
    c = times(1.0 / (6.0 * NODE), (high[0] - low[0], high[1] - low[1], high[2] - low[2]))
    for i in range(3):
        for j in range(3):
            cov[i, j] += 3.0 * (a[i] * c[j] + c[i] * a[j]) + 15.0 * c[i] * c[j]
            cov[i, j] += TAIL * (3.0 * b[i] * b[j] + b[i] * beside[j] + beside[i] * b[j])


@kernel
def columns_of(body, gravity, lin, rod, base, root, gain, payload_by_gravity, sensor_from_base, base_from_sensor,
               reference, tared, D):  # fmt: skip
    """Run `error_columns` for callers in Python; arguments of their own reach a kernel faster than `SourceArrays`."""
    sources = SourceArrays(
        rod, base, root, gain, payload_by_gravity, sensor_from_base, base_from_sensor, reference, tared
    )
    error_columns(body, gravity, lin, sources, D)
