"""One step of the state and, over the same stages, of its columns, by Verner's 6(5) Runge-Kutta pair.

The state's step stores at each stage what the columns' equations need. Columns step WIDE at a time, one per lane of a
vector register: their arrays are laid out so that the compiler sees it (one array, constant offsets, no record types,
whose fields it would not prove to be contiguous).

Source: J. H. Verner, SIAM J. Numer. Anal. 15 (1978) 772-790; the pair known as DVERK. Its order conditions are checked
in tests/rod/test_order.py. Written out because many coefficients are zero and the vectors are short.
"""

import numpy as np

from probedesign.rod.kernels import inline_always, inlined, inner
from probedesign.rod.kernels.equations import (
    bending_compliance,
    changed,
    column_slopes,
    full_slopes,
    rest_at,
    round_column_slopes,
    round_compliance,
    round_slopes,
    section_changes,
    section_properties,
)
from probedesign.rod.kernels.linalg import add, cross, minus, plus, put, take, times

STAGES = 8
C = np.array([0.0, 1 / 6, 4 / 15, 2 / 3, 5 / 6, 1.0, 1 / 15, 1.0])  #: Positions of the stages within the step.
A = np.zeros((STAGES, STAGES))
A[1, :1] = [1 / 6]
A[2, :2] = [4 / 75, 16 / 75]
A[3, :3] = [5 / 6, -8 / 3, 5 / 2]
A[4, :4] = [-165 / 64, 55 / 6, -425 / 64, 85 / 96]
A[5, :5] = [12 / 5, -8.0, 4015 / 612, -11 / 36, 88 / 255]
A[6, :5] = [-8263 / 15000, 124 / 75, -643 / 680, -81 / 250, 2484 / 10625]
A[7, :7] = [3501 / 1720, -300 / 43, 297275 / 52632, -319 / 2322, 24068 / 84065, 0.0, 3850 / 26703]
B = np.array([3 / 40, 0.0, 875 / 2244, 23 / 72, 264 / 1955, 0.0, 125 / 11592, 43 / 616])
B_LOW = np.array([13 / 160, 0.0, 2375 / 5984, 5 / 16, 12 / 85, 3 / 44, 0.0, 0.0])
E = B - B_LOW

(A10,) = A[1, :1].tolist()
A20, A21 = A[2, :2].tolist()
A30, A31, A32 = A[3, :3].tolist()
A40, A41, A42, A43 = A[4, :4].tolist()
A50, A51, A52, A53, A54 = A[5, :5].tolist()
A60, A61, A62, A63, A64 = A[6, :5].tolist()
A70, A71, A72, A73, A74, _, A76 = A[7, :7].tolist()
B0, _, B2, B3, B4, _, B6, B7 = B.tolist()
E0, _, E2, E3, E4, E5, E6, E7 = E.tolist()

ROUNDING = 4e-15  #: Rounding error of a slope, relative; error estimates below it are meaningless.


@inlined
def stage1(y, h, k0):
    """Return the state of stage 1."""
    a = h * A10
    return (y[0] + a * k0[0], y[1] + a * k0[1], y[2] + a * k0[2])


@inlined
def stage2(y, h, k0, k1):
    """Return the state of stage 2."""
    return (
        y[0] + h * (A20 * k0[0] + A21 * k1[0]),
        y[1] + h * (A20 * k0[1] + A21 * k1[1]),
        y[2] + h * (A20 * k0[2] + A21 * k1[2]),
    )


@inlined
def stage3(y, h, k0, k1, k2):
    """Return the state of stage 3."""
    return (
        y[0] + h * (A30 * k0[0] + A31 * k1[0] + A32 * k2[0]),
        y[1] + h * (A30 * k0[1] + A31 * k1[1] + A32 * k2[1]),
        y[2] + h * (A30 * k0[2] + A31 * k1[2] + A32 * k2[2]),
    )


@inlined
def stage4(y, h, k0, k1, k2, k3):
    """Return the state of stage 4."""
    return (
        y[0] + h * (A40 * k0[0] + A41 * k1[0] + A42 * k2[0] + A43 * k3[0]),
        y[1] + h * (A40 * k0[1] + A41 * k1[1] + A42 * k2[1] + A43 * k3[1]),
        y[2] + h * (A40 * k0[2] + A41 * k1[2] + A42 * k2[2] + A43 * k3[2]),
    )


@inlined
def stage5(y, h, k0, k1, k2, k3, k4):
    """Return the state of stage 5."""
    return (
        y[0] + h * (A50 * k0[0] + A51 * k1[0] + A52 * k2[0] + A53 * k3[0] + A54 * k4[0]),
        y[1] + h * (A50 * k0[1] + A51 * k1[1] + A52 * k2[1] + A53 * k3[1] + A54 * k4[1]),
        y[2] + h * (A50 * k0[2] + A51 * k1[2] + A52 * k2[2] + A53 * k3[2] + A54 * k4[2]),
    )


@inlined
def stage6(y, h, k0, k1, k2, k3, k4):
    """Return the state of stage 6."""
    return (
        y[0] + h * (A60 * k0[0] + A61 * k1[0] + A62 * k2[0] + A63 * k3[0] + A64 * k4[0]),
        y[1] + h * (A60 * k0[1] + A61 * k1[1] + A62 * k2[1] + A63 * k3[1] + A64 * k4[1]),
        y[2] + h * (A60 * k0[2] + A61 * k1[2] + A62 * k2[2] + A63 * k3[2] + A64 * k4[2]),
    )


@inlined
def stage7(y, h, k0, k1, k2, k3, k4, k6):
    """Return the state of stage 7."""
    return (
        y[0] + h * (A70 * k0[0] + A71 * k1[0] + A72 * k2[0] + A73 * k3[0] + A74 * k4[0] + A76 * k6[0]),
        y[1] + h * (A70 * k0[1] + A71 * k1[1] + A72 * k2[1] + A73 * k3[1] + A74 * k4[1] + A76 * k6[1]),
        y[2] + h * (A70 * k0[2] + A71 * k1[2] + A72 * k2[2] + A73 * k3[2] + A74 * k4[2] + A76 * k6[2]),
    )


@inlined
def step_result(y, h, k0, k2, k3, k4, k6, k7):
    """Return the result of the step of order 6."""
    return (
        y[0] + h * (B0 * k0[0] + B2 * k2[0] + B3 * k3[0] + B4 * k4[0] + B6 * k6[0] + B7 * k7[0]),
        y[1] + h * (B0 * k0[1] + B2 * k2[1] + B3 * k3[1] + B4 * k4[1] + B6 * k6[1] + B7 * k7[1]),
        y[2] + h * (B0 * k0[2] + B2 * k2[2] + B3 * k3[2] + B4 * k4[2] + B6 * k6[2] + B7 * k7[2]),
    )


@inlined
def step_error(h, k0, k2, k3, k4, k5, k6, k7):
    """Return the 1-norm of the difference of orders 6 and 5, less the rounding error of the stages."""
    x = E0 * k0[0] + E2 * k2[0] + E3 * k3[0] + E4 * k4[0] + E5 * k5[0] + E6 * k6[0] + E7 * k7[0]
    y = E0 * k0[1] + E2 * k2[1] + E3 * k3[1] + E4 * k4[1] + E5 * k5[1] + E6 * k6[1] + E7 * k7[1]
    z = E0 * k0[2] + E2 * k2[2] + E3 * k3[2] + E4 * k4[2] + E5 * k5[2] + E6 * k6[2] + E7 * k7[2]
    size = abs(k0[0]) + abs(k0[1]) + abs(k0[2]) + abs(k7[0]) + abs(k7[1]) + abs(k7[2])
    return abs(h) * (abs(x) + abs(y) + abs(z) - ROUNDING * size)


STATE = 12  #: [t, m, p, d]: tangent, moment, point, the section's x axis.
T, M, P, D = range(0, STATE, 3)  #: Offsets of the parts of a state.
ROW = 30  #: Numbers stored of a stage: [t, m, p', n, e, the rest of `section_properties`, `bending_compliance`, on].
NOTED = 2 * STATE
#: Numbers that a step works in: the state, the next state, and what is stored of the stages.
WORK = NOTED + STAGES * ROW
WIDE = 4  #: Columns that step together: the lanes of a vector register of 256 bits.
#: Most steps of one sweep at an error of 1e-7 a step, more where it is smaller: usual sweeps take tens of steps, so a
#: load that needs more ends as STEP_LIMIT instead of blocking its caller.
MAX_STEPS = 1000
#: Tries of one step: each refusal shortens it to 0.1 to 0.9 of itself, so that this number in a row is no progress.
MAX_TRIES = 60
#: Shortest step over the length: below it, rounding of the arclength exceeds the errors that the step control sees.
MIN_STEP = 1e-10
COLUMN = 9  #: [θ, v, q] of a column.
#: Rows of a block of WIDE columns after the columns themselves: the next columns, errors of θ and v, their derivatives
#: of force and gravity, of log E and log G, of the curvature at rest, and at each stage of log radius, log f and the
#: weight factor.
NEXT, ERRORS, BY_LOAD, LOGS, REST, LOG_R, LOG_F, BY_WEIGHT = 9, 18, 20, 26, 28, 30, 38, 46
BLOCK = (BY_WEIGHT + STAGES) * WIDE

THETA, V, Q = range(0, COLUMN, 3)  #: Rows of a column.
S0, S1, S2, S3, S4, S5, S6, S7 = range(STAGES)  #: The stages.
C1, C2, C3, C4, C6 = (float(C[j]) for j in (1, 2, 3, 4, 6))


@inlined
def _keep(work, j, t, m, p1, med, bending, on):
    """Store what the columns need of stage j."""
    o = NOTED + ROW * j
    bend, beta, by_e = bending
    put(work, o, t)
    put(work, o + 3, m)
    put(work, o + 6, p1)
    put(work, o + 9, med[9])
    put(work, o + 15, (med[0], med[1], med[2]))
    put(work, o + 18, (med[3], med[4], med[5]))
    put(work, o + 21, (med[6], med[7], med[8]))
    put(work, o + 24, bend)
    put(work, o + 27, (beta, by_e, on))


@inlined
def _stage_slopes(s, j, t, m, d, work, rod, on, axes, columns):
    """Return the slopes at stage j, and store the stage for the columns if there are any."""
    frustum, rest, force, gravity = rod
    med = section_properties(s, frustum, force, gravity)
    if axes:
        e = cross(t, d)
        t1, m1, p1, d1 = full_slopes(t, m, d, e, rest_at(s, rest), med)
    else:
        d1 = d  # nothing depends on it
        t1, m1, p1 = round_slopes(t, m, med)
    if columns:
        bending = bending_compliance(t, m, e, med) if axes else round_compliance(t, m, med)
        _keep(work, j, t, m, p1, med, bending, on)
        if axes:
            put(work, NOTED + ROW * j + 12, e)
    return t1, m1, p1, d1


@inlined
def _step(s, h, work, rod, on, axes, columns):
    """Step as `full_step` and `round_step` do; axes: whether the section's axes are integrated."""
    t, m, d = take(work, T), take(work, M), take(work, D)
    t0, m0, p0, d0 = _stage_slopes(s, S0, t, m, d, work, rod, on, axes, columns)

    tj, mj, dj = stage1(t, h, t0), stage1(m, h, m0), stage1(d, h, d0)
    t1, m1, _p, d1 = _stage_slopes(s + C1 * h, S1, tj, mj, dj, work, rod, on, axes, columns)

    tj, mj, dj = stage2(t, h, t0, t1), stage2(m, h, m0, m1), stage2(d, h, d0, d1)
    t2, m2, p2, d2 = _stage_slopes(s + C2 * h, S2, tj, mj, dj, work, rod, on, axes, columns)

    tj, mj = stage3(t, h, t0, t1, t2), stage3(m, h, m0, m1, m2)
    dj = stage3(d, h, d0, d1, d2)
    t3, m3, p3, d3 = _stage_slopes(s + C3 * h, S3, tj, mj, dj, work, rod, on, axes, columns)

    tj, mj = stage4(t, h, t0, t1, t2, t3), stage4(m, h, m0, m1, m2, m3)
    dj = stage4(d, h, d0, d1, d2, d3)
    t4, m4, p4, d4 = _stage_slopes(s + C4 * h, S4, tj, mj, dj, work, rod, on, axes, columns)

    tj, mj = stage5(t, h, t0, t1, t2, t3, t4), stage5(m, h, m0, m1, m2, m3, m4)
    dj = stage5(d, h, d0, d1, d2, d3, d4)
    t5, m5, p5, d5 = _stage_slopes(s + h, S5, tj, mj, dj, work, rod, on, axes, columns)

    tj, mj = stage6(t, h, t0, t1, t2, t3, t4), stage6(m, h, m0, m1, m2, m3, m4)
    dj = stage6(d, h, d0, d1, d2, d3, d4)
    t6, m6, p6, d6 = _stage_slopes(s + C6 * h, S6, tj, mj, dj, work, rod, on, axes, columns)

    tj, mj = stage7(t, h, t0, t1, t2, t3, t4, t6), stage7(m, h, m0, m1, m2, m3, m4, m6)
    dj = stage7(d, h, d0, d1, d2, d3, d4, d6)
    t7, m7, p7, d7 = _stage_slopes(s + h, S7, tj, mj, dj, work, rod, on, axes, columns)

    put(work, STATE + T, step_result(t, h, t0, t2, t3, t4, t6, t7))
    put(work, STATE + M, step_result(m, h, m0, m2, m3, m4, m6, m7))
    put(work, STATE + P, step_result(take(work, P), h, p0, p2, p3, p4, p6, p7))
    error = step_error(h, t0, t2, t3, t4, t5, t6, t7)
    if axes:
        put(work, STATE + D, step_result(d, h, d0, d2, d3, d4, d6, d7))
        error += step_error(h, d0, d2, d3, d4, d5, d6, d7)
    return error, step_error(h, m0, m2, m3, m4, m5, m6, m7), step_error(h, p0, p2, p3, p4, p5, p6, p7)


@inner
def full_step(s, h, work, frustum, rest, force, gravity, on):
    """Step [t, m, p, d] of any rod from s by h (negative: towards the base), and store its stages for the columns.

    Args:
        work: state, next state, and what is stored of the stages, (WORK,).
        frustum: from `frustum_of`; rest: from `rest_of`.
        force: the contact's on its base's side, else zero, (3,) tuple; gravity (3,) tuple.
        on: 1 on the contact's base's side, else 0.

    Returns:
        Error estimates of t and d, of m and of p.
    """
    return _step(s, h, work, (frustum, rest, force, gravity), on, True, True)


@inner
def round_step(s, h, work, frustum, force, gravity, on, columns):
    """Step [t, m, p] of a round straight rod, which need no section axes; columns: whether the stages are stored."""
    zero = (0.0, 0.0, 0.0)
    return _step(s, h, work, (frustum, (0.0, zero, zero), force, gravity), on, False, columns)


@inlined
def _stage(work, j):
    o = NOTED + ROW * j
    med = (*take(work, o + 15), *take(work, o + 18), *take(work, o + 21), take(work, o + 9))
    bending = take(work, o + 24), work[o + 27], work[o + 28]
    return take(work, o), take(work, o + 3), take(work, o + 6), take(work, o + 12), med, bending


@inlined
def _changing_stage(work, j):
    t, m, p1, e, med, bending = _stage(work, j)
    return t, m, p1, e, med, bending, section_changes(t, m, med, bending), work[NOTED + ROW * j + 29], cross(e, t)


@inlined
def _row3(block, row, lane):
    o = WIDE * row
    return (block[o + lane], block[o + WIDE + lane], block[o + 2 * WIDE + lane])


@inlined
def _put3(block, row, lane, x):
    o = WIDE * row
    block[o + lane] = x[0]
    block[o + WIDE + lane] = x[1]
    block[o + 2 * WIDE + lane] = x[2]


@inlined
def _round_slopes(theta, v, stage, j, block, lane, gravity):
    t, m, p1, _e, med, bending = stage
    w = minus(v, cross(theta, m))
    turn, q1 = round_column_slopes(theta, w, cross(med[9], theta), t, m, p1, med, bending)
    return turn, cross(med[9], q1), q1


@inlined
def _free_slopes(theta, v, stage, j, block, lane, gravity):
    t, m, p1, e, med, bending = stage
    turn, q1 = column_slopes(theta, v, cross(med[9], theta), t, m, p1, e, med, bending)
    return turn, cross(med[9], q1), q1


@inlined
def _forced_slopes(theta, v, stage, j, block, lane, gravity):
    """Return the slopes of a column that changes load or section, at stage j."""
    t, m, p1, e, med, bending, changes, on, d = stage
    force, g = _row3(block, BY_LOAD, lane), _row3(block, BY_LOAD + 3, lane)
    by_weight = block[WIDE * (BY_WEIGHT + j) + lane]
    h = add(add(times(on, force), med[5], g), by_weight, gravity)
    n = med[9]
    turn, q1 = column_slopes(theta, v, plus(h, cross(n, theta)), t, m, p1, e, med, bending)
    log_E, log_G = block[WIDE * LOGS + lane], block[WIDE * (LOGS + 1) + lane]
    log_r, log_f = block[WIDE * (LOG_R + j) + lane], block[WIDE * (LOG_F + j) + lane]
    turn, q1 = changed(turn, q1, changes, log_E, log_G, log_r, log_f)
    turn = add(add(turn, block[WIDE * REST + lane], d), block[WIDE * (REST + 1) + lane], e)
    return turn, minus(cross(n, q1), cross(p1, h)), q1


@inline_always
def _columns_step(h, block, work, stage, slopes, points, gravity):
    """Step WIDE columns over the stages of the state's step.

    Args:
        block: (BLOCK,); gravity: (3,) tuple.
        stage, slopes: functions, what is read of a stage, and the slopes of a column there.
        points: whether q is integrated.

    The types of functions contain their addresses, so this one is compiled as a part of its callers: no other process
    would find its file.
    """
    s0, s1, s2, s3 = stage(work, S0), stage(work, S1), stage(work, S2), stage(work, S3)
    s4, s5, s6, s7 = stage(work, S4), stage(work, S5), stage(work, S6), stage(work, S7)
    for lane in range(WIDE):
        a, v = _row3(block, THETA, lane), _row3(block, V, lane)
        a0, v0, q0 = slopes(a, v, s0, S0, block, lane, gravity)
        aj, vj = stage1(a, h, a0), stage1(v, h, v0)
        a1, v1, _q = slopes(aj, vj, s1, S1, block, lane, gravity)
        aj, vj = stage2(a, h, a0, a1), stage2(v, h, v0, v1)
        a2, v2, q2 = slopes(aj, vj, s2, S2, block, lane, gravity)
        aj, vj = stage3(a, h, a0, a1, a2), stage3(v, h, v0, v1, v2)
        a3, v3, q3 = slopes(aj, vj, s3, S3, block, lane, gravity)
        aj, vj = stage4(a, h, a0, a1, a2, a3), stage4(v, h, v0, v1, v2, v3)
        a4, v4, q4 = slopes(aj, vj, s4, S4, block, lane, gravity)
        aj, vj = stage5(a, h, a0, a1, a2, a3, a4), stage5(v, h, v0, v1, v2, v3, v4)
        a5, v5, _q = slopes(aj, vj, s5, S5, block, lane, gravity)
        aj, vj = stage6(a, h, a0, a1, a2, a3, a4), stage6(v, h, v0, v1, v2, v3, v4)
        a6, v6, q6 = slopes(aj, vj, s6, S6, block, lane, gravity)
        aj, vj = stage7(a, h, a0, a1, a2, a3, a4, a6), stage7(v, h, v0, v1, v2, v3, v4, v6)
        a7, v7, q7 = slopes(aj, vj, s7, S7, block, lane, gravity)
        _put3(block, NEXT, lane, step_result(a, h, a0, a2, a3, a4, a6, a7))
        _put3(block, NEXT + 3, lane, step_result(v, h, v0, v2, v3, v4, v6, v7))
        if points:
            q = _row3(block, Q, lane)
            _put3(block, NEXT + 6, lane, step_result(q, h, q0, q2, q3, q4, q6, q7))
        block[WIDE * ERRORS + lane] = step_error(h, a0, a2, a3, a4, a5, a6, a7)
        block[WIDE * (ERRORS + 1) + lane] = step_error(h, v0, v2, v3, v4, v5, v6, v7)


@inner
def round_columns_step(h, block, work):
    """Step [θ, v] of WIDE columns of a round straight rod that move neither load nor section."""
    _columns_step(h, block, work, _stage, _round_slopes, False, (0.0, 0.0, 0.0))


@inner
def free_columns_step(h, block, work):
    """Step WIDE columns that move neither load nor section over the stages of the state's step."""
    _columns_step(h, block, work, _stage, _free_slopes, True, (0.0, 0.0, 0.0))


@inner
def forced_columns_step(h, block, work, gravity):
    """Step WIDE columns that change load or section over the stages of the state's step."""
    _columns_step(h, block, work, _changing_stage, _forced_slopes, True, gravity)
