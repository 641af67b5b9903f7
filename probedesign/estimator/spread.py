"""How well a fitted contact is known, compiled: Cramér and Rao's bound, and how the curve of the probe bends it.

The places that explain a reading lie on a curve far narrower than it is bowed and twisted, p + a δ + b δ² + c δ³ for a
standard normal δ, with the mean square a aᵀ + 3 (a cᵀ + c aᵀ) + 3 b bᵀ + 15 c cᵀ about p. It is looked at √3 standard
deviations to either side, Gauss and Hermite's places. And s is known less well where the force would be less: where it
goes as one over a force known to a share σ, its variance is 1 + 6 σ² greater than at the estimate, and the mean fourth
power, on which bows depend, about 1 + 30 σ².
"""

import math
from pathlib import Path

from probedesign.estimator.fit import (
    LOST,
    PLACE,
    PUSH,
    STATE,
    UNKNOWNS,
    bent_aside,
    fit_contact,
    free,
    made_normal,
    normality,
    reduced,
    slope_at,
    whitened,
)
from probedesign.estimator.fit import WORK as FIT_WORK
from probedesign.rod.kernels.compiled import drop_stale, inner, kernel

drop_stale(Path(__file__).parent)

CHI2, STD, LEVER, POINT, COV = 0, 1, 2, 3, 6
"""Where in an answer stand the misfit, the standard deviation of s [m], how much the base moment changes with s over
the force, the contact's point [m], (3,), and its covariance [m²], (9,)."""
ANSWER = 15
WORK = FIT_WORK + 28 + 111
"""Numbers that locating works in."""
ASIDE = math.sqrt(3.0)
NUMERICAL = 0.08e-6
"""Error that a fast rod leaves at a contact [m], at most in 450 touches of random probes: none is known better."""
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
    body, gravity, weight, wrench, whiten, load, sweep_work, nodes, blocks, y, contact, fitted_turns, derivatives,
    work, state, step, point,
):  # fmt: skip
    """The contact's point (3,) and the variance of s after a step of force and arclength, (4,), the force then fitted
    anew; infinite where that is off the probe or has no equilibrium."""
    place = state[PLACE] + step[3]
    if not 0.0 < place <= body.knots[-1]:
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
        point[q] = derivatives[9 + q, UNKNOWNS]
        for j in range(3):
            point[q] += derivatives[9 + q, j] * change[j]
    return cov[15]


@inner
def _curved(point, along, ahead, behind, wide_ahead, wide_behind, variance, cov_p):
    """Add to the linear covariance of the point what its curve makes of it."""
    both = math.isfinite(wide_ahead) and math.isfinite(wide_behind)
    if both:
        wider = 2.0 / 3.0 + (wide_ahead + wide_behind) / (6.0 * variance)
        high = wider**5
        for i in range(3):
            bow_i = (ahead[i] + behind[i] - 2.0 * point[i]) / 6.0
            twist_i = ((ahead[i] - behind[i]) / (2.0 * ASIDE) - along[i]) / 3.0
            for j in range(3):
                bow_j = (ahead[j] + behind[j] - 2.0 * point[j]) / 6.0
                twist_j = ((ahead[j] - behind[j]) / (2.0 * ASIDE) - along[j]) / 3.0
                turned = (along[i] + 3.0 * twist_i) * (along[j] + 3.0 * twist_j)
                cov_p[3 * i + j] += wider * turned - along[i] * along[j]
                cov_p[3 * i + j] += high * (3.0 * bow_i * bow_j + 6.0 * twist_i * twist_j)
    elif math.isfinite(wide_ahead) or math.isfinite(wide_behind):  # close to the tip there is one side only
        seen, side = (ahead, ASIDE) if math.isfinite(wide_ahead) else (behind, -ASIDE)
        for i in range(3):
            bow_i = (seen[i] - point[i]) / (side * side) - along[i] / side
            for j in range(3):
                bow_j = (seen[j] - point[j]) / (side * side) - along[j] / side
                cov_p[3 * i + j] += 3.0 * bow_i * bow_j


@kernel
def locate_contact(
    body, gravity, weight, wrench, whiten, low, high, load, sweep_work, nodes, blocks, y, contact, turns,
    derivatives, work, state, answer,
):  # fmt: skip
    """Fit a contact from a guess and tell how well it is known.

    Args:
        answer: see the indices above, (ANSWER,), filled unless the fit is lost.
        work: (WORK,).
        The others as in `fit_contact`.

    Returns:
        What became of the fit.
    """
    fitting, own = work[:FIT_WORK], work[FIT_WORK:]
    status, square, _iterations = fit_contact(
        body, gravity, weight, wrench, whiten, low, high, load, sweep_work, nodes, blocks, y, contact, turns,
        derivatives, fitting, state,
    )  # fmt: skip
    if status == LOST:
        return status
    J, r, gradient, H, b = fitting[0:24], fitting[24:30], fitting[30:34], fitting[34:43], fitting[43:46]
    cov, cov_p, by_load, point = own[0:16], answer[COV : COV + 9], fitting[46:58], answer[POINT : POINT + 3]
    along, ahead, behind, step = fitting[58:61], fitting[61:64], fitting[64:67], fitting[67:71]
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
    size = math.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
    answer[CHI2], answer[LEVER] = square, math.sqrt(lever) / max(size, 1e-300)
    std = math.sqrt(cov[15]) if known else math.inf
    answer[STD] = std
    for i in range(3):
        along[i] = 0.0
        for j in range(UNKNOWNS):
            along[i] += by_load[UNKNOWNS * i + j] * cov[UNKNOWNS * j + 3] / std if known else 0.0
        for k in range(3):
            total = NUMERICAL * NUMERICAL if i == k else 0.0
            for j in range(UNKNOWNS):
                for n in range(UNKNOWNS):
                    total += by_load[UNKNOWNS * i + j] * cov[UNKNOWNS * j + n] * by_load[UNKNOWNS * k + n]
            cov_p[3 * i + k] = total if known else math.inf
    if not std < KNOWN * body.knots[-1]:
        return status
    fitted_turns = own[16:28].reshape((3, UNKNOWNS))
    for q in range(3):
        for j in range(UNKNOWNS):
            fitted_turns[q, j] = turns[q, j]
    for j in range(UNKNOWNS):
        step[j] = ASIDE * cov[UNKNOWNS * j + 3] / std
    wide_ahead = _look(
        body, gravity, weight, wrench, whiten, load, sweep_work, nodes, blocks, y, contact, fitted_turns, derivatives,
        own[28:], state, step, ahead,
    )  # fmt: skip
    for j in range(UNKNOWNS):
        step[j] = -step[j]
    wide_behind = _look(
        body, gravity, weight, wrench, whiten, load, sweep_work, nodes, blocks, y, contact, fitted_turns, derivatives,
        own[28:], state, step, behind,
    )  # fmt: skip
    _curved(point, along, ahead, behind, wide_ahead, wide_behind, cov[15], cov_p)
    return status
