"""How a touch's reading and point answer to what may differ between a probe and its model, compiled.

`causes.py` does the same with names; tests/estimation/test_doubt_kernel.py holds the two together.
"""

import math
from pathlib import Path

import numpy as np

from probedesign.estimation.fit import slope_at
from probedesign.rod.kernels.body import ALL_COLUMNS, DENSITY, PARAMETERS
from probedesign.rod.kernels.compiled import drop_stale, inner, merged
from probedesign.rod.kernels.vectors import add, cross, dot, minus, plus, take, times

drop_stale(Path(__file__).parent)

GRAVITY, LOG_DENSITY, LENGTH = map(PARAMETERS.index, ("gravity_x", "log_density", "log_diameter"))
"""Columns of the rod that are answers too, from the first of these on. That of all diameters, which those of the knots
tell as well, makes room for the length."""
OWN = 3
"""What is the rod's own among the answers: log E, log G, log density, log length, log of each knot's diameter."""
MOMENT, TANGENT, X_AXIS, POINT, Y_AXIS = np.arange(0, 15, 3)
"""Rows of the rod's columns: the base moment, then of the touch. As numpy's integers, since numba would compile what it
is given 0, 3, 6 ... for once for each."""
WEIGHT = TANGENT
"""Where an answer has the base's force."""
X, Y, Z = np.arange(3)
"""The columns by the touch's force."""


@inner
def _three(columns, row, j):
    """Three rows of a column."""
    return (columns[row, j], columns[row + 1, j], columns[row + 2, j])


@inner
def _put_three(columns, row, j, x):
    """Three rows of a column."""
    for q in range(3):
        columns[row + q, j] = x[q]


@inner
def _by_length(columns, force):
    """The column of the length's logarithm, diameters staying, in place of that of all diameters.

    A rod of λ times the size under λ² times the force and 1/λ times the density is the same rod: so growing at rest
    of load is known from the columns, and the diameters' growth is taken back.
    """
    last = columns.shape[1] - 1
    for r in range(15):
        power = 3.0 if r < MOMENT + 3 else 1.0 if POINT <= r < POINT + 3 else 0.0
        grown = power * columns[r, last] + columns[r, LOG_DENSITY] - columns[r, LENGTH]
        for q in range(3):
            grown -= 2.0 * columns[r, q] * force[q]
        columns[r, LENGTH] = grown


@inner
def _weights(columns, force, sine):
    """The push in the section's axes x, y and tangent."""
    last = columns.shape[1] - 1
    x, y = dot(_three(columns, X_AXIS, last), force), dot(_three(columns, Y_AXIS, last), force)
    cosine = math.sqrt(1.0 - sine * sine)
    across = math.sqrt(x * x + y * y)
    if not across > 0.0:
        return (cosine, 0.0, -sine)
    return (cosine * x / across, cosine * y / across, -sine)


@inner
def _leaning(columns, weights, sine):
    """How the unit push goes with the half-angle of the frustum."""
    last = columns.shape[1] - 1
    cosine = max(math.sqrt(1.0 - sine * sine), 1e-300)
    leant = times(-sine * weights[0] / cosine, _three(columns, X_AXIS, last))
    leant = add(leant, -sine * weights[1] / cosine, _three(columns, Y_AXIS, last))
    return add(leant, -cosine, _three(columns, TANGENT, last))


@inner
def _pushed(columns, weights, j):
    """Of the unit push by a column that moves the section's axes."""
    by_xy = add(times(weights[0], _three(columns, X_AXIS, j)), weights[1], _three(columns, Y_AXIS, j))
    return add(by_xy, weights[2], _three(columns, TANGENT, j))


@inner
def _by_slope(body, s, j):
    """Of the frustum's half-angle at s by an answer [rad]."""
    i = 0
    while i + 2 < body.knots.shape[0] and s > body.knots[i + 1]:
        i += 1
    apart = body.knots[i + 1] - body.knots[i]
    tan = (body.radii[i] - body.radii[i + 1]) / apart
    by, knot = 0.0, j - ALL_COLUMNS
    if j == LENGTH:
        by = -tan
    elif knot == i:
        by = body.radii[i] / apart
    elif knot == i + 1:
        by = -body.radii[i + 1] / apart
    return by / (1.0 + tan * tan)


@inner
def _by_weight(body, gravity, j):
    """Of the flexible part's weight [N] by an answer."""
    rho, whole = body.constants[DENSITY], body.constants[DENSITY] * body.volume_beyond[0]
    if j < GRAVITY + 3:
        a = j - GRAVITY
        return (whole if a == 0 else 0.0, whole if a == 1 else 0.0, whole if a == 2 else 0.0)
    if j in (LOG_DENSITY, LENGTH):
        return times(whole, gravity)
    if j >= ALL_COLUMNS:
        return times(rho * body.volume_by_knot[0, j - ALL_COLUMNS], gravity)
    return (0.0, 0.0, 0.0)


@merged
def answer(body, gravity, force, s, columns):
    """Turn the rod's columns under a dead force into a touch's answers.

    Args:
        body: of the rod; gravity: [m/s²], (3,) tuple.
        force: of the touch [N], (3,) tuple; s: its arclength [m].
        columns: as `linear_equilibrium` leaves them, (15, ALL_COLUMNS + K + 1); from GRAVITY on their MOMENT, WEIGHT
            and POINT rows answer by gravity, log E, log G, log density, log length and each knot's log diameter.
    """
    size, sine = math.sqrt(dot(force, force)), slope_at(body, s)
    weights = _weights(columns, force, sine)
    leaning = times(size, _leaning(columns, weights, sine))
    _by_length(columns, force)
    # The force turns with the section: (1 - d push/d force)⁻¹ of what it would do dead.
    a = minus((1.0, 0.0, 0.0), times(size, _pushed(columns, weights, X)))
    b = minus((0.0, 1.0, 0.0), times(size, _pushed(columns, weights, Y)))
    c = minus((0.0, 0.0, 1.0), times(size, _pushed(columns, weights, Z)))
    bc, ca, ab = cross(b, c), cross(c, a), cross(a, b)
    det = dot(a, bc)
    for j in range(GRAVITY, columns.shape[1] - 1):
        dead = add(times(size, _pushed(columns, weights, j)), _by_slope(body, s, j), leaning)
        turning = (dot(bc, dead) / det, dot(ca, dead) / det, dot(ab, dead) / det)
        for row in (MOMENT, POINT):
            moved = _three(columns, row, j)
            for q in range(3):
                moved = add(moved, turning[q], _three(columns, row, q))
            _put_three(columns, row, j, moved)
        _put_three(columns, WEIGHT, j, plus(_by_weight(body, gravity, j), turning))


@merged
def by_causes(body, gravity, force, columns, own, turns, hanging, D, Q):
    """How one standard deviation of each cause moves reading and point as told in the model's base frame.

    Args:
        body, gravity, force: as in `answer`; columns: as that leaves them.
        own: one standard deviation a row, of log E and what follows it, (a, 4 + K).
        turns: likewise, of the base's shift and turn and of gravity [m, rad, m/s²], (b, 9).
        hanging: what hangs on the sensor, by gravity, told at the base, (6, 3).
        D: of the reading, filled, (6, a + b); Q: of the point [m], filled, (3, a + b).
    """
    last, first = columns.shape[1] - 1, GRAVITY + OWN
    for c in range(own.shape[0]):
        F, M, p = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        for j in range(own.shape[1]):
            if own[c, j] != 0.0:
                F = add(F, own[c, j], _three(columns, WEIGHT, first + j))
                M = add(M, own[c, j], _three(columns, MOMENT, first + j))
                p = add(p, own[c, j], _three(columns, POINT, first + j))
        _put_three(D, X, c, F)
        _put_three(D, TANGENT, c, M)
        _put_three(Q, X, c, p)
    weight = times(body.constants[DENSITY] * body.volume_beyond[0], gravity)
    at_F, at_M, at_p = plus(force, weight), _three(columns, MOMENT, last), _three(columns, POINT, last)
    for d in range(turns.shape[0]):
        shift, turn, change = take(turns[d], 0), take(turns[d], 3), take(turns[d], 6)
        # A turn of the base turns what it reads, and gravity the other way as seen from it.
        seen = plus(cross(gravity, turn), change)
        F, M, p = (
            cross(turn, at_F),
            plus(cross(turn, at_M), cross(shift, at_F)),
            plus(cross(turn, at_p), shift),
        )
        for q in range(3):
            F = add(F, seen[q], _three(columns, WEIGHT, GRAVITY + q))
            M = add(M, seen[q], _three(columns, MOMENT, GRAVITY + q))
            p = add(p, seen[q], _three(columns, POINT, GRAVITY + q))
            F = add(F, change[q], _three(hanging, X, q))
            M = add(M, change[q], _three(hanging, TANGENT, q))
        _put_three(D, X, own.shape[0] + d, F)
        _put_three(D, TANGENT, own.shape[0] + d, M)
        _put_three(Q, X, own.shape[0] + d, p)
