"""The equilibrium next to a guessed tip, to first order, from one sweep: for solvers that move the load as well."""

import math

from probedesign.rod.kernels.body import GENERAL, OK
from probedesign.rod.kernels.compiled import inner
from probedesign.rod.kernels.outputs import sensitivities
from probedesign.rod.kernels.steps import COLUMN, STATE, WIDE, D, M, T
from probedesign.rod.kernels.sweep import sweep
from probedesign.rod.kernels.vectors import add, cross, dot, plus, put, take

MOST_LACK = 0.5
"""Misfit of the base [rad] up to which its linear answer is of any use."""


@inner
def linear_equilibrium(
    tip, load, body, tol, size, work, nodes, blocks, y, contact, turns, derivatives, change
):
    """Sweep from a guessed tip; what the base lacks of its clamp is taken back to first order everywhere.

    Args:
        tip: [t, d], (6,).
        load: (13,).
        tol: error allowed a step [rad], relative to size: how far the rod turned in the sweep before, at most 1.
        work, nodes, blocks, y, contact: as in `sweep`; nodes may be empty, blocks not.
        turns: (3, k).
        derivatives: as in `sensitivities`, (15, k + 1): by k parameters at the equilibrium, the last column
            [base moment, contact's frame] at it; all to first order in the misfit.
        change: turn of the tip that leads to the equilibrium, in base axes, (3,).

    Returns:
        Status, misfit at the base [rad], margin of stability, how far the rod turned.
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
    """Turn of the tip, in base axes, (3,), as the parameters take a step, (k,)."""
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
    """Three rows of one of the tip's columns."""
    return (
        columns[WIDE * row + lane],
        columns[WIDE * (row + 1) + lane],
        columns[WIDE * (row + 2) + lane],
    )


@inner
def _turned(columns, row, q0, q1, q2):
    """Three rows under a turn of the tip about its three axes."""
    a, b, c = _column(columns, row, 0), _column(columns, row, 1), _column(columns, row, 2)
    return (
        q0 * a[0] + q1 * b[0] + q2 * c[0],
        q0 * a[1] + q1 * b[1] + q2 * c[1],
        q0 * a[2] + q1 * b[2] + q2 * c[2],
    )
