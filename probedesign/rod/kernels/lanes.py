"""Integrate WIDE rods side by side, one per lane of a vector register: a step of each, and its error control.

All data are in one flat array, row by row: row r of lane l at r · WIDE + l. So the compiler sees that the lanes of a
row are contiguous, and one instruction operates on all of them. Lanes are independent: the result of one is identical
to the bit whatever the others compute. Rows of one plain array, not fields of a record: only so does the compiler
vectorise over the lanes.
"""

import numpy as np

from probedesign.rod.kernels import inlined, inner
from probedesign.rod.kernels.equations import (
    column_slopes,
    compliance,
    full_slopes,
    rest_at,
    round_column_slopes,
    round_compliance,
    round_slopes,
    section_properties,
)
from probedesign.rod.kernels.linalg import cross, minus
from probedesign.rod.kernels.steps import (
    C1,
    C2,
    C3,
    C4,
    C6,
    S0,
    S1,
    S2,
    S3,
    S4,
    S5,
    S6,
    S7,
    STAGES,
    STATE,
    WIDE,
    D,
    M,
    P,
    T,
    stage1,
    stage2,
    stage3,
    stage4,
    stage5,
    stage6,
    stage7,
    step_error,
    step_result,
)

NEXT = np.int64(STATE)
"""Row of the next state; the state [t, m, p, d] itself is in the first rows."""
TURN = 6
"""[θ, v] of a column."""
TIPS, TIPS_NEXT = np.array([2 * STATE, 2 * STATE + 3 * TURN])
"""Columns by turns of the tip about its section's x and y axes and its tangent, and the next columns."""
COLUMN1, COLUMN2, COLUMN3 = np.arange(0, 3 * TURN, TURN)
"""Their rows among those."""
S, H, TRIED, STOP, EVENT, STEPS, TRIES = np.arange(TIPS_NEXT + 3 * TURN, TIPS_NEXT + 3 * TURN + 7)
"""Arclength, the step to take, the one just tried, the arclength to stop at, the event, steps of the sweep, tries of
one step."""
ERRORS, TIPS_ERRORS, WANTS_TIPS = TRIES + 1, TRIES + 4, TRIES + 10
"""Errors of t, m and p, and of θ and v of each column; 1 where the tip's columns are wanted."""
MARGIN, BEND, E1, E2 = WANTS_TIPS + 1, WANTS_TIPS + 2, WANTS_TIPS + 3, WANTS_TIPS + 6
"""Margin of stability so far; how far the rod turned; two normals of the tangent that do not turn about it."""
TOL, SIZE, LENGTH, STEP_BUDGET, TIPS_ERROR, GOOD, FIRST_STEP = np.arange(E2 + 3, E2 + 10)
"""Error allowed a step, relative to the size; length of the body; most steps; the columns' error over what is allowed;
1 where the step just tried is taken; the first step of the sweep that was good."""
FORCE, GRAVITY, FRUSTUM, REST = FIRST_STEP + 1, FIRST_STEP + 4, FIRST_STEP + 7, FIRST_STEP + 22
"""The contact's force below it, else zero; gravity; `frustum_of`; `rest_of` without its first."""
NOTED, NOTE, ROUND_NOTE = REST + 6, 22, 18
"""Stored of each stage: [t, m, p', n, the properties that bend a round rod (6)]; then [e_y, the difference of the
bending compliances] for any rod."""
ROWS = NOTED + STAGES * NOTE

GOING, STOPPED, STUCK, READY = 0.0, 1.0, 2.0, 3.0
"""Events: none, the stop was reached, no step is accepted, a sweep is to start."""
HUGE = 1e12
"""Error of a step whose result is not finite: the step becomes a tenth."""


@inlined
def row3(lanes, row, lane):
    """Return three rows of a lane."""
    o = WIDE * row + lane
    return (lanes[o], lanes[o + WIDE], lanes[o + 2 * WIDE])


@inlined
def put_row3(lanes, row, lane, x):
    """Set three rows of a lane."""
    o = WIDE * row + lane
    lanes[o] = x[0]
    lanes[o + WIDE] = x[1]
    lanes[o + 2 * WIDE] = x[2]


@inlined
def _frustum(lanes, lane):
    """Return the result of `frustum_of` from a lane."""
    a, b = row3(lanes, FRUSTUM, lane), row3(lanes, FRUSTUM + 3, lane)
    c, d = row3(lanes, FRUSTUM + 6, lane), row3(lanes, FRUSTUM + 9, lane)
    finite = row3(lanes, FRUSTUM + 12, lane)
    return a[0], a[1], a[2], b[0], b[1], (b[2], c[0], c[1]), c[2], d[0], (d[1], d[2]), finite


@inlined
def put_frustum(lanes, lane, frustum):
    """Store the result of `frustum_of` in a lane."""
    above, r1, slope, beyond, cone, bends, shear, stretch, root, finite = frustum
    put_row3(lanes, FRUSTUM, lane, (above, r1, slope))
    put_row3(lanes, FRUSTUM + 3, lane, (beyond, cone, bends[0]))
    put_row3(lanes, FRUSTUM + 6, lane, (bends[1], bends[2], shear))
    put_row3(lanes, FRUSTUM + 9, lane, (stretch, root[0], root[1]))
    put_row3(lanes, FRUSTUM + 12, lane, finite)


@inlined
def _keep(lanes, lane, j, t, m, p1, med):
    """Store what the tip's columns need of stage j."""
    row = NOTED + NOTE * j
    put_row3(lanes, row, lane, t)
    put_row3(lanes, row + 3, lane, m)
    put_row3(lanes, row + 6, lane, p1)
    put_row3(lanes, row + 9, lane, med[9])
    put_row3(lanes, row + 12, lane, (med[0], med[2], med[3]))
    put_row3(lanes, row + 15, lane, (med[4], med[6], med[7]))


@inlined
def _keep_direction(lanes, lane, j, e, med):
    """Store what the columns of an anisotropic or curved rod need in addition."""
    row = NOTED + NOTE * j + ROUND_NOTE
    put_row3(lanes, row, lane, e)
    lanes[WIDE * (row + 3) + lane] = med[1]


@inner
def round_lanes_step(lanes):
    """Step [t, m, p] of WIDE round straight rods, and note the stages for their columns."""
    for lane in range(WIDE):
        s, h, frustum = lanes[WIDE * S + lane], lanes[WIDE * TRIED + lane], _frustum(lanes, lane)
        force, gravity = row3(lanes, FORCE, lane), row3(lanes, GRAVITY, lane)
        t, m = row3(lanes, T, lane), row3(lanes, M, lane)

        med = section_properties(s, frustum, force, gravity)
        t0, m0, p0 = round_slopes(t, m, med)
        _keep(lanes, lane, S0, t, m, p0, med)

        tj, mj = stage1(t, h, t0), stage1(m, h, m0)
        med = section_properties(s + C1 * h, frustum, force, gravity)
        t1, m1, p1 = round_slopes(tj, mj, med)
        _keep(lanes, lane, S1, tj, mj, p1, med)

        tj, mj = stage2(t, h, t0, t1), stage2(m, h, m0, m1)
        med = section_properties(s + C2 * h, frustum, force, gravity)
        t2, m2, p2 = round_slopes(tj, mj, med)
        _keep(lanes, lane, S2, tj, mj, p2, med)

        tj, mj = stage3(t, h, t0, t1, t2), stage3(m, h, m0, m1, m2)
        med = section_properties(s + C3 * h, frustum, force, gravity)
        t3, m3, p3 = round_slopes(tj, mj, med)
        _keep(lanes, lane, S3, tj, mj, p3, med)

        tj, mj = stage4(t, h, t0, t1, t2, t3), stage4(m, h, m0, m1, m2, m3)
        med = section_properties(s + C4 * h, frustum, force, gravity)
        t4, m4, p4 = round_slopes(tj, mj, med)
        _keep(lanes, lane, S4, tj, mj, p4, med)

        tj, mj = stage5(t, h, t0, t1, t2, t3, t4), stage5(m, h, m0, m1, m2, m3, m4)
        end = section_properties(s + h, frustum, force, gravity)
        t5, m5, p5 = round_slopes(tj, mj, end)
        _keep(lanes, lane, S5, tj, mj, p5, end)

        tj, mj = stage6(t, h, t0, t1, t2, t3, t4), stage6(m, h, m0, m1, m2, m3, m4)
        med = section_properties(s + C6 * h, frustum, force, gravity)
        t6, m6, p6 = round_slopes(tj, mj, med)
        _keep(lanes, lane, S6, tj, mj, p6, med)

        tj, mj = stage7(t, h, t0, t1, t2, t3, t4, t6), stage7(m, h, m0, m1, m2, m3, m4, m6)
        t7, m7, p7 = round_slopes(tj, mj, end)
        _keep(lanes, lane, S7, tj, mj, p7, end)

        put_row3(lanes, NEXT, lane, step_result(t, h, t0, t2, t3, t4, t6, t7))
        put_row3(lanes, NEXT + 3, lane, step_result(m, h, m0, m2, m3, m4, m6, m7))
        put_row3(lanes, NEXT + 6, lane, step_result(row3(lanes, P, lane), h, p0, p2, p3, p4, p6, p7))
        errors = (
            step_error(h, t0, t2, t3, t4, t5, t6, t7),
            step_error(h, m0, m2, m3, m4, m5, m6, m7),
            step_error(h, p0, p2, p3, p4, p5, p6, p7),
        )
        put_row3(lanes, ERRORS, lane, errors)


@inlined
def _stage_slopes(lanes, lane, s, j, t, m, d, frustum, rest, force, gravity):
    """Return the slopes of any rod at stage j, and store the stage for the columns."""
    med = section_properties(s, frustum, force, gravity)
    e = cross(t, d)
    t1, m1, p1, d1 = full_slopes(t, m, d, e, rest_at(s, rest), med)
    _keep(lanes, lane, j, t, m, p1, med)
    _keep_direction(lanes, lane, j, e, med)
    return t1, m1, p1, d1


@inner
def full_lanes_step(lanes):
    """Step [t, m, p, d] of WIDE rods of any kind."""
    for lane in range(WIDE):
        s, h, frustum = lanes[WIDE * S + lane], lanes[WIDE * TRIED + lane], _frustum(lanes, lane)
        f, g = row3(lanes, FORCE, lane), row3(lanes, GRAVITY, lane)
        rest = (frustum[0], row3(lanes, REST, lane), row3(lanes, REST + 3, lane))
        t, m, d = row3(lanes, T, lane), row3(lanes, M, lane), row3(lanes, D, lane)
        t0, m0, p0, d0 = _stage_slopes(lanes, lane, s, S0, t, m, d, frustum, rest, f, g)

        tj, mj, dj = stage1(t, h, t0), stage1(m, h, m0), stage1(d, h, d0)
        t1, m1, _p, d1 = _stage_slopes(lanes, lane, s + C1 * h, S1, tj, mj, dj, frustum, rest, f, g)

        tj, mj, dj = stage2(t, h, t0, t1), stage2(m, h, m0, m1), stage2(d, h, d0, d1)
        t2, m2, p2, d2 = _stage_slopes(lanes, lane, s + C2 * h, S2, tj, mj, dj, frustum, rest, f, g)

        tj, mj = stage3(t, h, t0, t1, t2), stage3(m, h, m0, m1, m2)
        dj = stage3(d, h, d0, d1, d2)
        t3, m3, p3, d3 = _stage_slopes(lanes, lane, s + C3 * h, S3, tj, mj, dj, frustum, rest, f, g)

        tj, mj = stage4(t, h, t0, t1, t2, t3), stage4(m, h, m0, m1, m2, m3)
        dj = stage4(d, h, d0, d1, d2, d3)
        t4, m4, p4, d4 = _stage_slopes(lanes, lane, s + C4 * h, S4, tj, mj, dj, frustum, rest, f, g)

        tj, mj = stage5(t, h, t0, t1, t2, t3, t4), stage5(m, h, m0, m1, m2, m3, m4)
        dj = stage5(d, h, d0, d1, d2, d3, d4)
        t5, m5, p5, d5 = _stage_slopes(lanes, lane, s + h, S5, tj, mj, dj, frustum, rest, f, g)

        tj, mj = stage6(t, h, t0, t1, t2, t3, t4), stage6(m, h, m0, m1, m2, m3, m4)
        dj = stage6(d, h, d0, d1, d2, d3, d4)
        t6, m6, p6, d6 = _stage_slopes(lanes, lane, s + C6 * h, S6, tj, mj, dj, frustum, rest, f, g)

        tj, mj = stage7(t, h, t0, t1, t2, t3, t4, t6), stage7(m, h, m0, m1, m2, m3, m4, m6)
        dj = stage7(d, h, d0, d1, d2, d3, d4, d6)
        t7, m7, p7, d7 = _stage_slopes(lanes, lane, s + h, S7, tj, mj, dj, frustum, rest, f, g)

        put_row3(lanes, NEXT, lane, step_result(t, h, t0, t2, t3, t4, t6, t7))
        put_row3(lanes, NEXT + 3, lane, step_result(m, h, m0, m2, m3, m4, m6, m7))
        put_row3(lanes, NEXT + 6, lane, step_result(row3(lanes, P, lane), h, p0, p2, p3, p4, p6, p7))
        put_row3(lanes, NEXT + 9, lane, step_result(d, h, d0, d2, d3, d4, d6, d7))
        errors = (
            step_error(h, t0, t2, t3, t4, t5, t6, t7) + step_error(h, d0, d2, d3, d4, d5, d6, d7),
            step_error(h, m0, m2, m3, m4, m5, m6, m7),
            step_error(h, p0, p2, p3, p4, p5, p6, p7),
        )
        put_row3(lanes, ERRORS, lane, errors)


@inlined
def _round_stage(lanes, lane, j):
    """Return what was stored of stage j of a round rod, with its compliance."""
    row = NOTED + NOTE * j
    t, m, p1 = row3(lanes, row, lane), row3(lanes, row + 3, lane), row3(lanes, row + 6, lane)
    n, x, y = row3(lanes, row + 9, lane), row3(lanes, row + 12, lane), row3(lanes, row + 15, lane)
    med = (x[0], 0.0, x[1], x[2], y[0], 0.0, y[1], y[2], 3.0 * lanes[WIDE * (FRUSTUM + 14) + lane], n)
    return t, m, p1, (0.0, 0.0, 0.0), med, round_compliance(t, m, med)


@inlined
def _stage(lanes, lane, j):
    """Return what was stored of stage j of any rod, with its compliance."""
    row = NOTED + NOTE * j + ROUND_NOTE
    t, m, p1, _e, (cx, _zero, gj, a, b, weight, c4, c5, three, n), _yields = _round_stage(lanes, lane, j)
    e, cyx = row3(lanes, row, lane), lanes[WIDE * (row + 3) + lane]
    med = (cx, cyx, gj, a, b, weight, c4, c5, three, n)
    bend, beta, by_e, _turns, _points = compliance(t, m, e, med)
    return t, m, p1, e, med, (bend, beta, by_e)


@inlined
def _round_slopes(theta, v, stage):
    """Return θ' and v' of a rotation of a round rod's tip."""
    t, m, p1, _e, med, compliances = stage
    w = minus(v, cross(theta, m))
    turn, q1 = round_column_slopes(theta, w, cross(med[9], theta), t, m, p1, med, compliances)
    return turn, cross(med[9], q1)


@inlined
def _slopes(theta, v, stage):
    """Return θ' and v' of a rotation of any rod's tip."""
    t, m, p1, e, med, compliances = stage
    turn, q1 = column_slopes(theta, v, cross(med[9], theta), t, m, p1, e, med, compliances)
    return turn, cross(med[9], q1)


@inlined
def _tip_column(slopes, lanes, lane, c, stages):
    """Step column c of a lane over the stored stages; slopes: `_round_slopes` or `_slopes`."""
    s0, s1, s2, s3, s4, s5, s6, s7 = stages
    h, row = lanes[WIDE * TRIED + lane], TIPS + c
    a, v = row3(lanes, row, lane), row3(lanes, row + 3, lane)
    a0, v0 = slopes(a, v, s0)
    a1, v1 = slopes(stage1(a, h, a0), stage1(v, h, v0), s1)
    a2, v2 = slopes(stage2(a, h, a0, a1), stage2(v, h, v0, v1), s2)
    a3, v3 = slopes(stage3(a, h, a0, a1, a2), stage3(v, h, v0, v1, v2), s3)
    aj, vj = stage4(a, h, a0, a1, a2, a3), stage4(v, h, v0, v1, v2, v3)
    a4, v4 = slopes(aj, vj, s4)
    aj, vj = stage5(a, h, a0, a1, a2, a3, a4), stage5(v, h, v0, v1, v2, v3, v4)
    a5, v5 = slopes(aj, vj, s5)
    aj, vj = stage6(a, h, a0, a1, a2, a3, a4), stage6(v, h, v0, v1, v2, v3, v4)
    a6, v6 = slopes(aj, vj, s6)
    aj, vj = stage7(a, h, a0, a1, a2, a3, a4, a6), stage7(v, h, v0, v1, v2, v3, v4, v6)
    a7, v7 = slopes(aj, vj, s7)
    row = TIPS_NEXT + c
    put_row3(lanes, row, lane, step_result(a, h, a0, a2, a3, a4, a6, a7))
    put_row3(lanes, row + 3, lane, step_result(v, h, v0, v2, v3, v4, v6, v7))
    o = WIDE * (TIPS_ERRORS + c // 3) + lane
    lanes[o] = step_error(h, a0, a2, a3, a4, a5, a6, a7)
    lanes[o + WIDE] = step_error(h, v0, v2, v3, v4, v5, v6, v7)


@inlined
def _stages(stage, lanes, lane):
    """Return all stages of a lane."""
    s0, s1 = stage(lanes, lane, S0), stage(lanes, lane, S1)
    s2, s3 = stage(lanes, lane, S2), stage(lanes, lane, S3)
    s4, s5 = stage(lanes, lane, S4), stage(lanes, lane, S5)
    return s0, s1, s2, s3, s4, s5, stage(lanes, lane, S6), stage(lanes, lane, S7)


@inner
def round_tips_step(lanes):
    """Step the tip's columns of round rods over the stored stages; the rotation about the tangent has none."""
    for lane in range(WIDE):
        stages = _stages(_round_stage, lanes, lane)
        _tip_column(_round_slopes, lanes, lane, COLUMN1, stages)
        _tip_column(_round_slopes, lanes, lane, COLUMN2, stages)


@inner
def full_tips_step(lanes):
    """Step all three columns of the tip of any rods over the stored stages."""
    for lane in range(WIDE):
        stages = _stages(_stage, lanes, lane)
        _tip_column(_slopes, lanes, lane, COLUMN1, stages)
        _tip_column(_slopes, lanes, lane, COLUMN2, stages)
        _tip_column(_slopes, lanes, lane, COLUMN3, stages)
