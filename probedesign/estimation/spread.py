"""How well a fitted contact is known, compiled: Cramér and Rao's bound, and how the curve of the probe bends it.

The places that explain a reading lie on a curve far narrower than it is bowed and twisted, p + a δ + b δ² + c δ³ for a
standard normal δ, with the mean square a aᵀ + 3 (a cᵀ + c aᵀ) + 3 b bᵀ + 15 c cᵀ about p. It is looked at √3 standard
deviations to one side, one of Gauss and Hermite's places: where it is and where it goes there tell b and c. And s is
known less well where the force would be less: as 1/(1 - σδ) where it goes as one over a force known to a share σ. Its
variance is then 1 + 6 σ² greater than at the estimate, and the mean fourth power, on which bows depend, about
1 + 30 σ².
"""

import math
from pathlib import Path

from probedesign.estimation.fit import (
    LOST,
    PLACE,
    PUSH,
    STATE,
    STEP,
    UNKNOWNS,
    bent_aside,
    fit_contact,
    free,
    made_normal,
    normality,
    radius_at,
    reduced,
    slope_at,
    whitened,
)
from probedesign.estimation.fit import WORK as FIT_WORK
from probedesign.rod.kernels.compiled import drop_stale, inner

drop_stale(Path(__file__).parent)

CHI2, STD, LEVER, POINT, COV, SURFACE, LINEAR = 0, 1, 2, 3, 6, 15, 18
"""Where in an answer stand the misfit, the standard deviation of s [m], how much the base moment changes with s over
the force, the contact's point [m], (3,), its covariance [m²], (9,), the touched point [m], (3,), and the covariance
to first order alone [m²], (9,)."""
ANSWER = 27
WORK = FIT_WORK + 32 + 111
"""Numbers that locating works in."""
ASIDE = math.sqrt(3.0)
NUMERICAL, NUMERICAL_SHARE = 5e-9, 3e-5
"""Error that the fast rod leaves at a contact, each axis: [m], and over the standard deviation of s, since its steps
are chosen by the reading's noise (`fit.tolerance`). RMS of 1500 touches of random probes: 3e-9 at forces of 0.1 N and
more, 2e-5 to 4e-5 of the bound below."""
WEAKEST = 0.2
"""Share to which a force is known at worst where a place is told (`estimator.LEAST_FORCE`). Towards a thin tip s may
be known far better: that is no force's doing and says nothing of the other side."""
KNOWN = 0.25
"""Of the length: where s is known no better, nothing is told of its place anyhow."""


@inner
def covariance(gradient, out, H, cov):
    """Of force and arclength, (16,): N (Nᵀ Jᵀ J N)⁻¹ Nᵀ with N the directions that keep the force normal.

    Returns whether it is finite.
    """
    d0, d1, d2 = math.sqrt(H[0]), math.sqrt(H[4]), math.sqrt(H[8])
    if not (d0 > 0.0 and d1 > 0.0 and d2 > 0.0):
        return False
    a, c, e = H[1] / (d0 * d1), H[2] / (d0 * d2), H[5] / (d1 * d2)
    m00, m01, m02 = 1.0 - e * e, c * e - a, a * e - c
    m11, m12, m22 = 1.0 - c * c, a * c - e, 1.0 - a * a
    det = m00 + a * m01 + c * m02
    if not det > 1e-14:
        return False
    V = (
        m00 / (d0 * d0 * det), m01 / (d0 * d1 * det), m02 / (d0 * d2 * det),
        m01 / (d0 * d1 * det), m11 / (d1 * d1 * det), m12 / (d1 * d2 * det),
        m02 / (d0 * d2 * det), m12 / (d1 * d2 * det), m22 / (d2 * d2 * det),
    )  # fmt: skip
    for u in range(3):
        for v in range(3):
            cov[UNKNOWNS * free(out, u) + free(out, v)] = V[3 * u + v]
    for v in range(3):
        total = 0.0
        for u in range(3):
            total -= gradient[free(out, u)] / gradient[out] * V[3 * u + v]
        cov[UNKNOWNS * out + free(out, v)] = cov[UNKNOWNS * free(out, v) + out] = total
    total = 0.0
    for v in range(3):
        total -= gradient[free(out, v)] / gradient[out] * cov[UNKNOWNS * out + free(out, v)]
    cov[UNKNOWNS * out + out] = total
    return True


@inner
def refitted(gradient, out, H, b, change, off):
    """The change of the force, kept where it is and normal, that brings the wrench nearest to the reading, (3,).

    H and b are the normal equations, off is what the force lacks of being normal.
    """
    det = H[0] * H[4] - H[1] * H[1]
    x0, x1 = (b[0] * H[4] - b[1] * H[1]) / det, (b[1] * H[0] - b[0] * H[1]) / det
    first, second = free(out, 0), free(out, 1)
    change[first], change[second] = x0, x1
    change[out] = -(off + gradient[first] * x0 + gradient[second] * x1) / gradient[out]


@inner
def _look(
    body, gravity, weight, wrench, whiten, high, load, sweep_work, nodes, blocks, y, contact, fitted_turns,
    derivatives, work, state, step, point, tangent,
):  # fmt: skip
    """The contact's point (3,), how it goes on with s (3,) and the variance of s after a step of force and arclength,
    (4,), the force then fitted anew; infinite where that is off the probe or has no equilibrium."""
    place = state[PLACE] + step[3]
    if not 0.0 < place <= high:
        return math.inf
    there, J, r, gradient = work[0:STATE], work[10:34], work[34:40], work[40:44]
    H, b, change, cov = work[44:53], work[53:56], work[56:59], work[59:75]
    if not bent_aside(
        body, gravity, whiten, wrench, load, sweep_work, nodes, blocks, y, contact, fitted_turns, derivatives,
        work[75:111], state, step, there,
    ):  # fmt: skip
        return math.inf
    force = there[PUSH:PLACE]
    whitened(wrench, weight, force, whiten, derivatives, J, r)
    off = normality(force, slope_at(body, place), derivatives, gradient)
    out, _square = made_normal(J, r, gradient, off)
    reduced(J, r, gradient, out, H, b)
    if not covariance(gradient, out, H, cov):
        return math.inf
    refitted(gradient, out, H, b, change, off)
    for q in range(3):
        point[q], tangent[q] = derivatives[9 + q, UNKNOWNS], derivatives[9 + q, 3]
        for j in range(3):
            point[q] += derivatives[9 + q, j] * change[j]
            tangent[q] += derivatives[9 + q, j] * cov[UNKNOWNS * j + 3] / cov[15]
    return cov[15]


@inner
def _curved(point, along, seen, tangent, std, side, wide, cov_p):
    """Add to the linear covariance of the point what its curve makes of it.

    Args:
        point, along: the estimate's and how it goes with δ, (3,).
        seen, tangent: of the place `side` standard deviations on, how it goes there with s, (3,).
        std: of s at the estimate [m]; wide: its variance there, over that at the estimate.
        cov_p: (9,), added to.
    """
    share = (1.0 - 1.0 / math.sqrt(wide)) / side
    share = max(share * side, -WEAKEST * ASIDE) / side
    # The mean of 1/(1 - share δ)² over Gauss and Hermite's three places.
    wider = 2.0 / 3.0 + (wide + 1.0 / (1.0 + side * share) ** 2) / 6.0
    high = wider**5
    for i in range(3):
        bow_i, twist_i = _bend(i, point, along, seen, tangent, std, side)
        for j in range(3):
            bow_j, twist_j = _bend(j, point, along, seen, tangent, std, side)
            turned = (along[i] + 3.0 * twist_i) * (along[j] + 3.0 * twist_j)
            cov_p[3 * i + j] += wider * turned - along[i] * along[j]
            cov_p[3 * i + j] += high * (3.0 * bow_i * bow_j + 6.0 * twist_i * twist_j)


@inner
def _bend(i, point, along, seen, tangent, std, side):
    """b and c of component i, from where the curve is and where it goes at the place seen."""
    apart = ((seen[i] - point[i]) / side - along[i]) / side  # b + c side
    turned = (std * tangent[i] - along[i]) / side  # 2 b + 3 c side
    return 3.0 * apart - turned, (turned - 2.0 * apart) / side


@inner
def locate_contact(
    body, gravity, weight, wrench, whiten, low, high, most, load, sweep_work, nodes, blocks, y, contact, turns,
    derivatives, work, state, rough, answer,
):  # fmt: skip
    """Fit a contact from a guess and tell how well it is known.

    Args:
        rough: whether its covariance is not asked for beyond the first order.
        answer: see the indices above, (ANSWER,), filled unless the fit is lost.
        work: (WORK,).
        The others as in `fit_contact`.

    Returns:
        What became of the fit.
    """
    fitting, own = work[:FIT_WORK], work[FIT_WORK:]
    status, square, _iterations = fit_contact(
        body, gravity, weight, wrench, whiten, low, high, most, load, sweep_work, nodes, blocks, y, contact, turns,
        derivatives, fitting, state,
    )  # fmt: skip
    if status == LOST:
        return status
    J, r, gradient, H, b = fitting[0:24], fitting[24:30], fitting[30:34], fitting[34:43], fitting[43:46]
    cov, cov_p, by_load, point = own[0:16], answer[COV : COV + 9], fitting[46:58], answer[POINT : POINT + 3]
    along, seen, tangent, step = fitting[58:61], fitting[61:64], fitting[64:67], fitting[67:71]
    last = own[28:32]
    for j in range(UNKNOWNS):
        last[j] = fitting[STEP + j]
    force, lever = state[PUSH:PLACE], 0.0
    whitened(wrench, weight, force, whiten, derivatives, J, r)
    off = normality(force, slope_at(body, state[PLACE]), derivatives, gradient)
    out, _square = made_normal(J, r, gradient, off)
    reduced(J, r, gradient, out, H, b)
    known = covariance(gradient, out, H, cov)
    for q in range(3):
        point[q] = derivatives[9 + q, UNKNOWNS]
        lever += derivatives[q, 3] ** 2
        for j in range(UNKNOWNS):
            by_load[UNKNOWNS * q + j] = derivatives[9 + q, j]
            point[q] += derivatives[9 + q, j] * last[j]
    size = math.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
    sine = slope_at(body, state[PLACE])
    reach = radius_at(body, state[PLACE]) * math.sqrt(1.0 - sine * sine) / max(size, 1e-300)
    for q in range(3):
        answer[SURFACE + q] = point[q] - reach * force[q]
    answer[CHI2], answer[LEVER] = square, math.sqrt(lever) / max(size, 1e-300)
    std = math.sqrt(cov[15]) if known else math.inf
    answer[STD] = std
    floor = NUMERICAL * NUMERICAL + (NUMERICAL_SHARE * std) ** 2
    for i in range(3):
        along[i] = 0.0
        for j in range(UNKNOWNS):
            along[i] += by_load[UNKNOWNS * i + j] * cov[UNKNOWNS * j + 3] / std if known else 0.0
        for k in range(3):
            total = floor if i == k else 0.0
            for j in range(UNKNOWNS):
                for n in range(UNKNOWNS):
                    total += by_load[UNKNOWNS * i + j] * cov[UNKNOWNS * j + n] * by_load[UNKNOWNS * k + n]
            cov_p[3 * i + k] = answer[LINEAR + 3 * i + k] = total if known else math.inf
    if rough or not std < KNOWN * body.knots[-1]:
        return status
    fitted_turns = own[16:28].reshape((3, UNKNOWNS))
    for q in range(3):
        for j in range(UNKNOWNS):
            fitted_turns[q, j] = turns[q, j]
    side = ASIDE if state[PLACE] + ASIDE * std <= high else -ASIDE
    for j in range(UNKNOWNS):
        step[j] = side * cov[UNKNOWNS * j + 3] / std
    wide = _look(
        body, gravity, weight, wrench, whiten, high, load, sweep_work, nodes, blocks, y, contact, fitted_turns,
        derivatives, own[32:], state, step, seen, tangent,
    )  # fmt: skip
    if math.isfinite(wide):
        _curved(point, along, seen, tangent, std, side, wide / cov[15], cov_p)
    return status
