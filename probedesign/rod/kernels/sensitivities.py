"""Evaluate a finished sweep: exact sensitivities, the state between its nodes, and the linearised equilibrium.

`sensitivities` returns total derivatives at base and contact, `states_at` the state at any arclength, and
`linear_equilibrium` the equilibrium next to a guessed tip to first order, for solvers that also vary the load.
"""

import math

from probedesign.rod.kernels import inlined, inner, kernel
from probedesign.rod.kernels.equations import (
    FORCE,
    GENERAL,
    GRAVITY,
    OK,
    ROOT_REACH,
    S_CONTACT,
    frustum_of,
    rest_at,
    rest_of,
    round_slopes,
    section_properties,
    turning,
)
from probedesign.rod.kernels.linalg import add, cross, dot, minus, plus, put, take, times
from probedesign.rod.kernels.steps import (
    BLOCK,
    COLUMN,
    NEXT,
    S0,
    S1,
    S2,
    STATE,
    THETA,
    WIDE,
    D,
    M,
    P,
    Q,
    T,
    V,
    full_step,
)
from probedesign.rod.kernels.sweep import (
    begin,
    lane_of,
    step_columns,
    sweep,
)


@inlined
def _theta(columns, o):
    return (columns[o], columns[o + WIDE], columns[o + 2 * WIDE])


@inner
def _solved_tips(columns, stride, lane):
    """Return the rotations of the tip about its three axes that cancel a column's rotation of the base."""
    a, b, c = _theta(columns, S0), _theta(columns, S1), _theta(columns, S2)
    x = _theta(columns, lane // WIDE * stride + lane % WIDE)
    det = dot(a, cross(b, c))
    return -dot(x, cross(b, c)) / det, -dot(x, cross(c, a)) / det, -dot(x, cross(a, b)) / det


@inlined
def _total(columns, stride, lane, row, turns):
    """Return three rows of a column with the tip rotated so that the base remains fixed."""
    o = WIDE * row
    a, b, c = _theta(columns, o), _theta(columns, o + 1), _theta(columns, o + 2)
    x = _theta(columns, o + lane // WIDE * stride + lane % WIDE)
    return add(add(add(x, turns[0], a), turns[1], b), turns[2], c)


@inner
def sensitivities(y, blocks, contact, body, load, turns, derivatives):
    """Fill in the total derivatives of the base moment and of the contact's frame and position.

    Args:
        y, blocks, contact: as `solve` left them.
        turns: filled, rotations of the tip's section about its axes, for derivatives at other arclengths, (3, k).
        derivatives: (15, k + 1): of the base moment (3), of the contact's [t, x axis, position from the base,
            y axis] (12); in its last column those twelve themselves.

    The contact moves along the body with s_contact, so that column also holds the slopes there.
    """
    k = turns.shape[1]
    # The x axis of a round section is arbitrary at the tip; a rotation about the tangent makes it e_x at the base.
    norm = math.hypot(y[9], y[10])
    co, si = y[9] / norm, -y[10] / norm
    t, d = take(contact, T), take(contact, D)
    e = cross(t, d)
    x_axis = add(times(co, d), si, e)
    y_axis = cross(t, x_axis)
    place = minus(take(contact, P), take(y, P))
    s = load[S_CONTACT]
    i = body.knots.shape[0] - 2
    while i > 0 and s <= body.knots[i]:
        i -= 1
    med = section_properties(
        s, frustum_of(body, i, s <= body.constants[ROOT_REACH]), take(load, FORCE), take(load, GRAVITY)
    )
    turn_s = turning(t, take(contact, M), d, e, rest_at(s, rest_of(body, i)), med)
    _t1, _m1, p_s = round_slopes(t, take(contact, M), med)
    there = contact[STATE:]
    for j in range(k):
        lane = lane_of(j)
        tips = _solved_tips(blocks, BLOCK, lane)
        v = _total(blocks, BLOCK, lane, V, tips)
        theta = _total(there, WIDE * COLUMN, lane, THETA, tips)
        q = minus(_total(there, WIDE * COLUMN, lane, Q, tips), _total(blocks, BLOCK, lane, Q, tips))
        if j == 3:
            theta, q = plus(theta, turn_s), plus(q, p_s)
        dt, dx, dy = cross(theta, t), cross(theta, x_axis), cross(theta, y_axis)
        for r in range(3):
            turns[r, j] = tips[r]
            derivatives[r, j] = v[r]
            derivatives[3 + r, j] = dt[r]
            derivatives[6 + r, j] = dx[r]
            derivatives[9 + r, j] = q[r]
            derivatives[12 + r, j] = dy[r]
    for r in range(3):
        derivatives[3 + r, k] = t[r]
        derivatives[6 + r, k] = x_axis[r]
        derivatives[9 + r, k] = place[r]
        derivatives[12 + r, k] = y_axis[r]


@kernel
def states_at(s, nodes, count, body, load, work, blocks, result):
    """Fill in states and columns at arclengths s (j,), by one step from the node above each.

    Args:
        nodes: as `solve` filled them, `count` rows.
        work: (WORK,); blocks: (chunks · BLOCK,).
        result: (j, STATE + 36 chunks).
    """
    chunks = blocks.shape[0] // BLOCK
    width = 1 + STATE + WIDE * COLUMN * chunks
    begin(nodes[1 : 1 + STATE], blocks, chunks)
    for j in range(s.shape[0]):
        row = 0
        while row + 1 < count and nodes[(row + 1) * width] >= s[j]:
            row += 1
        o = row * width
        at = nodes[o]
        for q in range(width - 1):
            result[j, q] = nodes[o + 1 + q]
        if at > s[j]:
            i = body.knots.shape[0] - 2
            while i > 0 and at <= body.knots[i]:
                i -= 1
            in_root, on = at <= body.constants[ROOT_REACH], 1.0 if at <= load[S_CONTACT] else 0.0
            for q in range(STATE):
                work[q] = nodes[o + 1 + q]
            for c in range(chunks):
                for q in range(WIDE * COLUMN):
                    blocks[c * BLOCK + q] = nodes[o + 1 + STATE + c * WIDE * COLUMN + q]
            frustum, rest, gravity = frustum_of(body, i, in_root), rest_of(body, i), take(load, GRAVITY)
            force = times(on, take(load, FORCE))
            full_step(at, s[j] - at, work, frustum, rest, force, gravity, on)
            step_columns(at, s[j] - at, i, in_root, work, blocks, chunks, body, gravity, 1.0)
            for q in range(STATE):
                result[j, q] = work[STATE + q]
            for c in range(chunks):
                for q in range(WIDE * COLUMN):
                    result[j, STATE + c * WIDE * COLUMN + q] = blocks[c * BLOCK + WIDE * NEXT + q]


@inner
def linear_equilibrium(
    tip, load, body, tol, size, work, nodes, blocks, y, contact, turns, derivatives, change
):
    """Sweep from a guessed tip, and correct the residual at the base to first order everywhere.

    Args:
        tip: [t, d], (6,).
        load: (13,).
        tol: error allowed a step [rad], relative to size: how far the rod turned in the sweep before, at most 1.
        work, nodes, blocks, y, contact: as in `sweep`; nodes may be empty, blocks not.
        turns: (3, k).
        derivatives: as in `sensitivities`, (15, k + 1): by k parameters at the equilibrium, the last column
            [base moment, contact's frame] at it; all to first order in the residual.
        change: rotation of the tip that leads to the equilibrium, in base axes, (3,).

    Returns:
        Status, residual at the base [rad], stability margin, largest rotation of the rod.
    """
    status, _count, margin, size, _steps = sweep(tip, y, work, blocks, body, load, tol, size, nodes, contact)
    if status != OK:
        return status, math.inf, -1.0, 1.0
    sensitivities(y, blocks, contact, body, load, turns, derivatives)
    k = turns.shape[1]
    t, d = take(y, T), take(y, D)
    lack = cross(t, (0.0, 0.0, 1.0))
    if body.constants[GENERAL] != 0.0:
        lack = plus(lack, (0.0, 0.0, cross(d, (1.0, 0.0, 0.0))[2]))
    misfit = math.sqrt(dot(lack, lack)) if t[2] > 0.0 else 2.0
    a, b, c = _column(blocks, 0, 0), _column(blocks, 0, 1), _column(blocks, 0, 2)
    det = dot(a, cross(b, c))
    q0, q1, q2 = dot(lack, cross(b, c)) / det, dot(lack, cross(c, a)) / det, dot(lack, cross(a, b)) / det
    there = contact[STATE : STATE + WIDE * COLUMN]
    moment, at_base = _turned(blocks, 3, q0, q1, q2), _turned(blocks, 6, q0, q1, q2)
    theta, at_contact = _turned(there, 0, q0, q1, q2), _turned(there, 6, q0, q1, q2)
    frame = derivatives[3:, k]
    turned_t = cross(theta, (frame[0], frame[1], frame[2]))
    turned_x = cross(theta, (frame[3], frame[4], frame[5]))
    turned_y = cross(theta, (frame[9], frame[10], frame[11]))
    e = cross(take(tip, 0), take(tip, 3))
    for r in range(3):
        derivatives[r, k] = y[M + r] + moment[r]
        derivatives[3 + r, k] += turned_t[r]
        derivatives[6 + r, k] += turned_x[r]
        derivatives[9 + r, k] += at_contact[r] - at_base[r]
        derivatives[12 + r, k] += turned_y[r]
        change[r] = q0 * tip[3 + r] + q1 * e[r] + q2 * tip[r]
    return status, misfit, margin, size


@inner
def tips_turn(tip, turns, step, way):
    """Fill in the rotation of the tip, in base axes, (3,), for a step of the parameters, (k,)."""
    t, d = take(tip, 0), take(tip, 3)
    e = cross(t, d)
    turn = (0.0, 0.0, 0.0)
    for j in range(step.shape[0]):
        turn = add(
            add(add(turn, turns[0, j] * step[j], d), turns[1, j] * step[j], e), turns[2, j] * step[j], t
        )
    put(way, 0, turn)


@inner
def _column(columns, row, lane):
    """Return three rows of one of the tip's columns."""
    return (
        columns[WIDE * row + lane],
        columns[WIDE * (row + 1) + lane],
        columns[WIDE * (row + 2) + lane],
    )


@inner
def _turned(columns, row, q0, q1, q2):
    """Return three rows under a rotation of the tip about its three axes."""
    a, b, c = _column(columns, row, 0), _column(columns, row, 1), _column(columns, row, 2)
    return (
        q0 * a[0] + q1 * b[0] + q2 * c[0],
        q0 * a[1] + q1 * b[1] + q2 * c[1],
        q0 * a[2] + q1 * b[2] + q2 * c[2],
    )
