"""The equilibrium of one rod under one load: the tip found, polished, and one last sweep with all asked for."""

import math

from probedesign.rod.kernels.body import GENERAL, LOAD, NOT_CONVERGED, OK, UNSTABLE
from probedesign.rod.kernels.compiled import inlined, merged
from probedesign.rod.kernels.newton import (
    CAREFUL_TOLERANCE,
    MAX_TURN,
    PATH_TOLERANCE,
    PATHS,
    is_clamped,
    is_judged,
    misfit,
    newton,
    trace,
    turn_tip,
    unbent,
    wanted_turn,
)
from probedesign.rod.kernels.steps import BLOCK, STATE, WIDE, WORK
from probedesign.rod.kernels.sweep import sweep
from probedesign.rod.kernels.vectors import cross, dot, put, take

COLD, WARM, WARM_ONLY = 0, 1, 2
"""Start from no load; from a guess, else from no load; from a guess or not at all."""
SAFE_MARGIN = 0.3
"""Of stability on the path, from which its sweeps need no second judgement: they know it to a hundredth."""
NEAR = 3e-3
"""How close [rad] the path has to come to the whole load's equilibrium before it is polished."""
ROUNDING = 1e-14
"""Of the tip's turn [rad]; what grows of it on the way is no misfit."""
NEAR_ENOUGH = 200.0
"""Times the tolerance: Newton's matrix, taken NEAR the answer, makes a thousandth of a misfit."""
MAX_GROWTH = 1e4
"""Beyond which smaller steps help no more."""
AT_CONTACT = STATE + 36
SCRATCH = STATE + WORK + AT_CONTACT + BLOCK + 9 + PATHS
"""Numbers that finding the tip works in."""


@inlined
def _parts(scratch):
    """State, what a step works in, the contact, one block of columns, Newton's matrix, loads and tips."""
    o = STATE + WORK
    p = o + AT_CONTACT
    q = p + BLOCK
    return (
        scratch[:STATE],
        scratch[STATE:o],
        scratch[o:p],
        scratch[p:q],
        scratch[q : q + 9],
        scratch[q + 9 : SCRATCH],
    )


@inlined
def tip_growth(blocks):
    """How much larger than at the tip a small turn of it is at the base; at least 1."""
    growth = 1.0
    for q in range(3 * WIDE):
        if q % WIDE < 3:
            growth = max(growth, abs(blocks[q]))
    return growth


@merged
def _start(tip, y, work, contact, blocks, paths, body):
    """The tip of the rod without load: where it stands straight, or as it is curved by nature."""
    unbent(tip)
    if body.constants[GENERAL] != 0.0:
        for q in range(LOAD):
            paths[q] = 0.0
        full = body.constants[GENERAL] != 0.0
        sweep(tip, y, work, blocks[:0], body, paths[:LOAD], 1e-9, 1.0, full, work[:0], contact)
        t, d = take(y, 0), take(y, 9)
        e = cross(t, d)
        put(tip, 0, (d[2], e[2], t[2]))
        put(tip, 3, (d[0], e[0], t[0]))


@merged
def _approach(tip, start, scratch, body, load, path_tol, near):
    """The tip within `near` [rad] of the equilibrium, by sweeps of that tolerance; Newton's matrix there.

    Returns:
        status, how far the rod turned, the margin of stability.
    """
    y, work, contact, blocks, inverse, paths = _parts(scratch)
    judged = is_judged(load)
    status, size, margin = NOT_CONVERGED, 1.0, -1.0
    if start != COLD:
        status, _away, _first, size, margin, _steps = newton(
            tip, y, work, contact, blocks, inverse, body, load, path_tol, near, judged, MAX_TURN
        )
    for careful in range(2):
        if status == OK or start == WARM_ONLY:
            break
        # A very soft rod magnifies the errors of the steps themselves; under a moment, the way matters.
        with_tol = CAREFUL_TOLERANCE if careful and judged else path_tol
        moment_first = careful == 1 and not judged
        _start(tip, y, work, contact, blocks, paths, body)
        status, size, margin, _steps = trace(
            tip, y, work, contact, blocks, inverse, paths, body, load, with_tol, near, moment_first
        )
    return status, size, margin


@merged
def _find(tip, start, scratch, body, load, tol, until, near_enough):
    """Tip (6,), state at base and contact of the equilibrium, in `scratch`.

    Args:
        near_enough: misfit [rad] from which one more turn leads home: none where state and contact are wanted.

    Returns:
        status, residual at the base [rad], how far the rod turned, the margin of stability.
    """
    status, size, margin = _approach(tip, start, scratch, body, load, max(tol, PATH_TOLERANCE), NEAR)
    if status != OK:
        return status, math.inf, size, margin
    y, work, contact, blocks, inverse, _paths = _parts(scratch)
    general = body.constants[GENERAL] != 0.0
    growth = tip_growth(blocks)
    tol, before = tol / min(growth, MAX_GROWTH), math.inf
    for _ in range(12):
        status, _count, _margin, size, _steps = sweep(
            tip, y, work, blocks[:0], body, load, tol, size, general, work[:0], contact
        )
        if status != OK:
            return status, math.inf, size, margin
        r = misfit(y, general)
        residual = math.sqrt(dot(r, r))
        if is_clamped(y, general, max(until * size, ROUNDING * growth)):
            if is_judged(load) and margin < SAFE_MARGIN:
                _s, _c, margin, _b, _n = sweep(
                    tip, y, work, blocks, body, load, tol, size, general, work[:0], contact
                )
                return (OK if margin > 0.0 else UNSTABLE), residual, size, margin
            return OK, residual, size, margin
        if not residual < 0.5 * before:  # the path's matrix does not lead on: take it anew
            status, _away, _first, size, margin, _steps = newton(
                tip, y, work, contact, blocks, inverse, body, load, tol, 1e-6, is_judged(load), 0.1
            )
            if status != OK:
                return status, residual, size, margin
            residual = math.inf
        else:
            turn_tip(tip, wanted_turn(y, general, inverse))
            if residual < near_enough * size and not (is_judged(load) and margin < SAFE_MARGIN):
                return OK, residual, size, margin
        before = residual
    return NOT_CONVERGED, residual, size, margin


@merged
def solve(tip, start, scratch, body, load, tol, until, nodes, blocks, y, contact):
    """Find the equilibrium, and sweep it once more with what is asked for beside base and contact.

    Args:
        tip: section at the tip [t, d], (6,): a guess unless COLD, the solution on return.
        start: COLD, WARM or WARM_ONLY.
        scratch: (SCRATCH,).
        load: (13,), see `body`.
        tol: error allowed a step [rad]; until: residual allowed at the base [rad];
            both relative to how far the rod turns.
        nodes: for shape and columns, (m · (1 + STATE + 36 chunks),).
        blocks: columns at the base, (chunks · BLOCK,), may be none. With neither nodes nor blocks there is no last
            sweep and there are no section axes.
        y, contact: state at the base, (STATE,), state and columns at s_c, (STATE + 36 chunks,).

    Returns:
        status, nodes filled, margin of stability, residual at the base [rad].
    """
    report = nodes.shape[0] > 0 or blocks.shape[0] > 0
    status, residual, size, margin = _find(
        tip, start, scratch, body, load, tol, until, NEAR_ENOUGH * tol if report else 0.0
    )
    path_y, work, path_contact, path_blocks, inverse, _paths = _parts(scratch)
    if status != OK or not report:
        for q in range(STATE):
            y[q], contact[q] = path_y[q], path_contact[q]
        return status, 0, margin, residual
    growth = tip_growth(path_blocks)
    tol = tol / min(growth, MAX_GROWTH)
    general, path_margin = body.constants[GENERAL] != 0.0, margin
    for _ in range(6):
        status, count, margin, size, _steps = sweep(
            tip, y, work, blocks, body, load, tol, size, report, nodes, contact
        )
        margin = margin if blocks.shape[0] > 0 else path_margin
        if status != OK:
            return status, 0, margin, math.inf
        r = misfit(y, general)
        residual = math.sqrt(dot(r, r))
        if is_clamped(y, general, max(max(until, tol) * size, ROUNDING * growth)):
            stable = margin > 0.0 or not is_judged(load)
            return (OK if stable else UNSTABLE), count, margin, residual
        turn_tip(tip, wanted_turn(y, general, inverse))
    return NOT_CONVERGED, 0, margin, residual
