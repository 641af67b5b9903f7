"""Find the tip's section for which the base is clamped: Newton's method, load continuation, and the final iterations.

`seek` brings the tip near the equilibrium, from a guess or along the path from no load; `polish` iterates it to the
tolerance. Their sweeps integrate the tip's columns only where a new matrix or the margin of stability is wanted.
`solve_cases` is the entry point from Python: one last sweep has all requested outputs. `ScratchBuffers` is its memory.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from probedesign.core.frames import Array
from probedesign.rod.kernels import inlined, inner, kernel
from probedesign.rod.kernels.equations import (
    COUPLE,
    FORCE,
    GENERAL,
    GRAVITY,
    LOAD,
    NOT_CONVERGED,
    OK,
    S_CONTACT,
    STEP_LIMIT,
    TIP_MOMENT,
    UNSTABLE,
    Body,
)
from probedesign.rod.kernels.linalg import add, cross, dot, put, take, times
from probedesign.rod.kernels.steps import BLOCK, COLUMN, STATE, WIDE, WORK, D, M, P, T
from probedesign.rod.kernels.sweep import FIRST_STEPS, row3, sensitivities, sweep

MAX_NEWTON = 12  #: Sweeps of Newton's method at one load: it converges quadratically in a few, or has left the branch.
MAX_TURN = 0.35  #: Largest turn of the tip [rad] between prediction and solution of a load step: keeps the branch.
MIN_LOAD_STEP = 1e-4  #: Smallest step along the load path, over the whole load: where even that fails, the branch ends.
#: Residual at the base [rad] of a predicted tip: above the first no second sweep is tried; load steps aim at the other.
BAD_GUESS, GOOD_GUESS = 0.8, 0.2
#: Integration steps that a path may take: a tenth of a second, a thousand times the usual; then the search ends.
MAX_WORK = 40_000


@inlined
def turn_tip(tip, turn):
    """Rotate a stored section [t, d], (6,), by a rotation vector [rad]."""
    angle = math.sqrt(dot(turn, turn))
    if angle > 0.0:
        co, si = math.cos(angle), math.sin(angle) / angle
        turns = (1.0 - co) / (angle * angle)
        t, d = take(tip, 0), take(tip, 3)
        t = add(add(times(co, t), si, cross(turn, t)), turns * dot(turn, t), turn)
        d = add(add(times(co, d), si, cross(turn, d)), turns * dot(turn, d), turn)
        put_section(tip, t, d)


@inlined
def put_section(tip, t, d):
    """Store [t, d], made a unit tangent and a unit normal of it."""
    t = times(1.0 / math.sqrt(dot(t, t)), t)
    d = add(d, -dot(d, t), t)
    put(tip, 0, t)
    put(tip, 3, times(1.0 / math.sqrt(dot(d, d)), d))


@inlined
def prepare(tip, t, d, thetas, general, inverse):
    """Compute, from the tip's columns at the base, the matrix that maps the base's residual to the tip's rotation.

    The residual is that of the base's tangent t and x axis d: (t_x, t_y, d_y), the last only of a rod that is not
    round and straight. Fills `inverse` with the turn in base axes, row by row, (9,).

    Args:
        tip: [t, d] at the tip, a pair.
        thetas: turns of the base by the tip's turns about its axes, three of (3,).

    Returns:
        Whether there is one: its determinant is not zero.
    """
    a, b, c = thetas
    axes = (tip[1], cross(tip[0], tip[1]), tip[0])
    u, v, w = cross(a, t), cross(b, t), cross(c, t)
    r0, r1, r2 = (u[0], v[0], w[0]), (u[1], v[1], w[1]), (0.0, 0.0, 1.0)
    if general:
        r2 = (cross(a, d)[1], cross(b, d)[1], cross(c, d)[1])
    else:  # turning a round section about its tangent moves nothing
        r0, r1 = (r0[0], r0[1], 0.0), (r1[0], r1[1], 0.0)
    c0, c1, c2 = cross(r1, r2), cross(r2, r0), cross(r0, r1)
    det = dot(r0, c0)
    if not abs(det) > 1e-300 or not math.isfinite(det):
        return False
    for q in range(3):
        inverse[3 * q] = (axes[0][q] * c0[0] + axes[1][q] * c0[1] + axes[2][q] * c0[2]) / det
        inverse[3 * q + 1] = (axes[0][q] * c1[0] + axes[1][q] * c1[1] + axes[2][q] * c1[2]) / det
        third = (axes[0][q] * c2[0] + axes[1][q] * c2[1] + axes[2][q] * c2[2]) / det
        inverse[3 * q + 2] = third if general else 0.0
    return True


@inlined
def misfit(t, d, general):
    """Return the residual of the base's tangent and x axis, zero where it is clamped: (t_x, t_y, d_y)."""
    return (t[0], t[1], d[1] if general else 0.0)


@inlined
def is_clamped(t, d, general, most):
    """Return whether the base is clamped within `most` [rad], and not the other way round."""
    r = misfit(t, d, general)
    return t[2] > 0.0 and (not general or d[0] > 0.0) and dot(r, r) <= most * most


@inlined
def target_rotation(t, d, general, inverse):
    """Return the rotation of the tip by Newton's method."""
    r = misfit(t, d, general)
    return (-dot(take(inverse, 0), r), -dot(take(inverse, 3), r), -dot(take(inverse, 6), r))


@inlined
def is_judged(load):
    """Return whether stability is tested: dead forces and gravity have a potential, a dead moment has none."""
    m = take(load, TIP_MOMENT)
    return m[0] == 0.0 and m[1] == 0.0 and m[2] == 0.0


COLD, WARM, WARM_ONLY = 0, 1, 2  #: Start from no load; from a guess, else from no load; from a guess or not at all.
#: Error of a sweep's step on the way to the whole load [rad]; only the end of the way is reported.
PATH_TOLERANCE = 1e-4
CAREFUL_TOLERANCE = 1e-9  #: The same in a second try along the path.
#: Margin of stability on the path from which it is not computed again: those sweeps have it to a hundredth.
SAFE_MARGIN = 0.3
NEAR = 3e-3  #: Turn of the tip [rad] from which the equilibrium of the whole load is polished.
ROUNDING = 1e-14  #: Rounding error of the tip's turn [rad]; what it grows to at the base is accepted as residual.
MAX_GROWTH = 1e4  #: Growth of a turn of the tip beyond which smaller steps do not help, as rounding dominates.
MAX_POLISH = 12  #: Sweeps of polishing: with a fixed matrix each halves the residual at least, usually a thousandfold.

#: State and memory of the solver for one case. The status, the margin of stability, the residual at the base [rad], how
#: far the rod turned, at most 1, and the growth of a turn of the tip on its way to the base. Of Newton's method: the
#: tip's section and its guess, how far the tip came from it, the first residual [rad], and the matrix that gives the
#: tip's turn from the base's residual, (3, 3). Of the load path: the load applied and the whole load, the tips of the
#: last three solutions, and the integration steps of all sweeps. Of the sweeps: the first step that the sweep before
#: found and the error that was allowed it, the states at the base and at the contact, the tip's columns, and what a
#: step works in.
CASE = np.dtype([
    ("status", "f8"), ("margin", "f8"), ("residual", "f8"), ("turned", "f8"), ("growth", "f8"),
    ("tip", "f8", 6), ("guess", "f8", 6), ("away", "f8"), ("first_residual", "f8"), ("inverse", "f8", 9),
    ("load", "f8", LOAD), ("whole_load", "f8", LOAD), ("path_tips", "f8", 18), ("steps", "f8"),
    ("first_step", "f8"), ("first_allowed", "f8"), ("y", "f8", STATE), ("contact", "f8", STATE + WIDE * COLUMN),
    ("blocks", "f8", BLOCK), ("work", "f8", WORK),
])  # fmt: skip


@inner
def _sweep(case, body, allowed, size, with_tips):
    """Sweep from the case's tip under its load; allowed, size: `tol` and `size` of `sweep`.

    Args:
        with_tips: whether the tip's columns are integrated, which Newton's matrix and the margin need.

    Returns:
        Status, margin of stability, how far the rod turned.
    """
    first, error = -body.knots[-1] / FIRST_STEPS, allowed * size
    if case.first_allowed > 0.0:  # the first step that the sweep before would have taken with this error
        first = max(first, case.first_step * (error / case.first_allowed) ** (1.0 / 6.0))
    blocks = case.blocks[: BLOCK if with_tips else 0]
    status, _count, margin, turned, steps, first = sweep(
        case.tip[:], case.y[:], case.work[:], blocks, body, case.load[:], allowed, size, first,
        body.constants[GENERAL] != 0.0, case.work[:0], case.contact[:],
    )  # fmt: skip
    case.steps += steps
    case.first_allowed, case.first_step = error, first
    return status, margin, turned


@inner
def _newton(case, body, tol, until, reach):
    """Turn the tip from its guess until the next rotation would be below `until` [rad]; return whether it converged.

    Gives up as soon as the tip has left its guess by more than `reach` [rad]; a guess that nothing predicted
    (`reach` negative) is first turned once, which is the linear solution, and that is what must not be left.
    """
    general = body.constants[GENERAL] != 0.0
    for q in range(6):
        case.guess[q] = case.tip[q]
    case.away, case.first_residual, case.status, case.margin = 0.0, 0.0, NOT_CONVERGED, -1.0
    for iteration in range(MAX_NEWTON):
        status, margin, turned = _sweep(case, body, tol, 1.0, True)
        if status != OK:
            case.status = STEP_LIMIT
            return False
        t, d = take(case.y, T), take(case.y, D)
        r = misfit(t, d, general)
        if iteration == 0:
            case.first_residual = math.sqrt(dot(r, r)) if t[2] > 0.0 else 2.0
            if case.first_residual > BAD_GUESS and reach > 0.0:
                case.away = case.first_residual
                return False
        # The tip alone does not decide: in a soft hanging rod a tiny error there is a large one at the base.
        clamped = is_clamped(t, d, general, 10.0 * until)
        columns = row3(case.blocks, 0), row3(case.blocks, 1), row3(case.blocks, 2)
        if not prepare((take(case.tip, 0), take(case.tip, 3)), t, d, columns, general, case.inverse):
            return False
        turn = target_rotation(t, d, general, case.inverse)
        angle = math.sqrt(dot(turn, turn))
        if not math.isfinite(angle):
            return False
        # At most 1 rad: beyond, the linearisation does not hold for the direction either.
        turn_tip(case.tip[:], times(min(1.0, 1.0 / max(angle, 1e-300)), turn))
        if iteration == 0 and reach < 0.0:
            for q in range(6):
                case.guess[q] = case.tip[q]
        dt = add(take(case.tip, 0), -1.0, take(case.guess, 0))
        dd = add(take(case.tip, 3), -1.0, take(case.guess, 3))
        case.away = math.sqrt(dot(dt, dt) + (dot(dd, dd) if general else 0.0))
        if angle > 1.0 or case.away > abs(reach):
            case.away = max(case.away, angle)
            return False
        if angle < until and clamped:
            case.margin = margin
            case.turned = max(turned, min(angle, 1.0))
            stable = margin > 0.0 or not is_judged(case.load[:])
            case.status = OK if stable else UNSTABLE
            return stable
        # A thousandth of the tolerance: the iteration has converged, but clamps the base the other way round.
        if angle < 1e-3 * until and t[2] <= 0.0:
            return False
    return False


@inlined
def _apply(case, fraction, moment_first):
    """Apply a fraction of the load: of all of it together, or of the tip moment first and then of the rest."""
    rest = max(0.0, 2.0 * fraction - 1.0) if moment_first else fraction
    first = min(1.0, 2.0 * fraction) if moment_first else fraction
    whole, part = case.whole_load, case.load
    for q in range(3):
        part[FORCE + q], part[GRAVITY + q] = rest * whole[FORCE + q], rest * whole[GRAVITY + q]
        part[TIP_MOMENT + q], part[COUPLE + q] = first * whole[TIP_MOMENT + q], rest * whole[COUPLE + q]
    part[S_CONTACT] = whole[S_CONTACT]


@inlined
def _extrapolate(case, goal, last, second, third):
    """Predict the tip's section at the fraction `goal` of the load by the parabola through the last three solutions.

    Equal fractions represent points that are not there yet.
    """
    w0, w1, w2 = 1.0, 0.0, 0.0
    if second > third:
        w0 = (goal - second) * (goal - third) / ((last - second) * (last - third))
        w1 = (goal - last) * (goal - third) / ((second - last) * (second - third))
        w2 = (goal - last) * (goal - second) / ((third - last) * (third - second))
    elif last > second:
        w0, w1 = (goal - second) / (last - second), (last - goal) / (last - second)
    tips = case.path_tips
    t = add(add(times(w0, take(tips, 0)), w1, take(tips, 6)), w2, take(tips, 12))
    d = add(add(times(w0, take(tips, 3)), w1, take(tips, 9)), w2, take(tips, 15))
    put_section(case.tip[:], t, d)


@inner
def _follow_path(case, body, tol, moment_first):
    """Follow the equilibrium from the stored tip, that of no load; return whether the whole load was reached.

    The whole load is tried at once. The residual of a parabola's prediction grows with the cube of the step.
    """
    for q in range(18):
        case.path_tips[q] = case.tip[q % 6]
    last = second = third = 0.0  # fractions of the load solved
    increment, case.steps = 1.0, 0.0
    while True:
        goal = min(1.0, last + increment)
        _apply(case, goal, moment_first)
        _extrapolate(case, goal, last, second, third)
        if _newton(case, body, tol, NEAR, MAX_TURN if last > 0.0 else -MAX_TURN):
            for q in range(12):
                case.path_tips[17 - q] = case.path_tips[11 - q]
            for q in range(6):
                case.path_tips[q] = case.tip[q]
            residual = max(case.first_residual, 1e-9)  # no division by zero; the factor is limited to 4 in any case
            increment = (goal - last) * min(4.0, max(0.5, (GOOD_GUESS / residual) ** (1.0 / 3.0)))
            last, second, third = goal, last, second
            if goal >= 1.0:
                return True
        else:
            # So that the tip would come to 0.8 of the allowed turn, but at most half and at least a fifth of this step.
            increment = (goal - last) * max(0.2, min(0.5, 0.8 * MAX_TURN / max(case.away, 1e-9)))
            if increment < MIN_LOAD_STEP or case.steps > MAX_WORK:
                return False


@inner
def _from_no_load(case, body, tol, careful):
    """Follow the path from the straight rod, or from its shape at rest; return whether the tip is NEAR."""
    judged = is_judged(case.whole_load[:])
    put(case.tip, 0, (0.0, 0.0, 1.0))
    put(case.tip, 3, (1.0, 0.0, 0.0))
    if body.constants[GENERAL] != 0.0:
        _apply(case, 0.0, False)
        status, _margin, _turned = _sweep(case, body, 1e-9, 1.0, False)  # the start of every path, and only one sweep
        if status != OK:
            case.status = STEP_LIMIT
            return False
        t, d = take(case.y, T), take(case.y, D)
        e = cross(t, d)
        put(case.tip, 0, (d[2], e[2], t[2]))
        put(case.tip, 3, (d[0], e[0], t[0]))
    # A very soft rod magnifies the errors of the steps themselves; under a moment, the path matters.
    tol = CAREFUL_TOLERANCE if careful and judged else max(tol, PATH_TOLERANCE)
    return _follow_path(case, body, tol, careful and not judged)


@inner
def seek(case, load, start, body, tol):
    """Bring the tip NEAR the equilibrium under a load; return whether it is, else `case.status` is why not.

    Args:
        start: COLD, WARM or WARM_ONLY; the stored tip is the guess unless it is COLD.
    """
    for q in range(LOAD):
        case.whole_load[q] = load[q]
    case.residual, case.first_allowed, case.steps = math.inf, 0.0, 0.0
    near = False
    if start != COLD:
        _apply(case, 1.0, False)
        near = _newton(case, body, max(tol, PATH_TOLERANCE), NEAR, MAX_TURN)
    if start != WARM_ONLY:
        for careful in (False, True):
            near = near or _from_no_load(case, body, tol, careful)
    if near:
        case.growth = 1.0
        for axis in range(3 if body.constants[GENERAL] != 0.0 else 2):
            x, y, z = row3(case.blocks, axis)
            case.growth = max(case.growth, max(abs(x), max(abs(y), abs(z))))
    return near


@inner
def polish(case, body, tol, until, near_enough):
    """Iterate a tip NEAR the equilibrium to the tolerance, with the matrix there; `case.status` is the result.

    Args:
        until: residual allowed at the base [rad]; near_enough: residual [rad] from which one more turn converges, 0
            where state and contact are wanted; both relative to how far the rod turns.
    """
    general = body.constants[GENERAL] != 0.0
    tol = tol / min(case.growth, MAX_GROWTH)
    before = math.inf
    for _ in range(MAX_POLISH):
        status, _margin, size = _sweep(case, body, tol, case.turned, False)
        if status != OK:
            case.status = STEP_LIMIT
            return
        case.turned = size
        t, d = take(case.y, T), take(case.y, D)
        r = misfit(t, d, general)
        residual = case.residual = math.sqrt(dot(r, r))
        unsure = is_judged(case.whole_load[:]) and case.margin < SAFE_MARGIN  # of the sweeps of the path
        if is_clamped(t, d, general, max(until * size, ROUNDING * case.growth)):
            case.status = OK
            if unsure:
                status, case.margin, case.turned = _sweep(case, body, tol, size, True)
                case.status = STEP_LIMIT if status != OK else OK if case.margin > 0.0 else UNSTABLE
            return
        if not residual < 0.5 * before:  # the path's matrix does not converge: compute it anew
            # The tip is NEAR: a tenth of a radian from there is another branch.
            if not _newton(case, body, tol, 1e-6, 0.1):
                return
            before = math.inf
            continue
        turn_tip(case.tip[:], target_rotation(t, d, general, case.inverse))
        if residual < near_enough * size and not unsure:
            case.status = OK
            return
        before = residual
    case.status = NOT_CONVERGED


# solving cases one after the other

#: Result of one case: status, margin of stability, residual at the base [rad], number of nodes filled, section of the
#: tip, base moment [N·m], and tangent and position from the base [m] of the contact.
SOLUTION = np.dtype([
    ("status", "f8"), ("margin", "f8"), ("residual", "f8"), ("count", "f8"), ("tip", "f8", 6), ("moment", "f8", 3),
    ("tangent", "f8", 3), ("point", "f8", 3),
])  # fmt: skip
#: Times the tolerance, the residual from which one more turn of the tip is enough: Newton's matrix, computed NEAR the
#: equilibrium, leaves a thousandth of it.
INITIAL_TOLERANCE = 200.0
SINGLE_ROD = np.zeros(1, dtype=np.int64)  #: Index of the rod of a single case.


class ScratchBuffers(NamedTuple):
    """Memory of `solve_cases`, which allocates nothing: one set per thread; of the last case on return."""

    case: NDArray[Any]  #: CASE, (1,).
    nodes: Array  #: shape and columns, (m · (1 + STATE + 36 chunks),), may be none.
    blocks: Array  #: columns at the base, (chunks · BLOCK,), may be none.
    y: Array  #: state at the base, (STATE,).
    contact: Array  #: state and columns at s_c, (STATE + 36 chunks,).
    turns: Array  #: rotations of the tip, see `sensitivities`, (3, k).


def scratch_buffers(k: int, room: int) -> ScratchBuffers:
    """Return buffers for k sensitivities and `room` nodes of the shape."""
    chunks = -(-(3 + k) // WIDE) if k else 0  # of the k columns and the three rotations of the tip
    width = 1 + STATE + WIDE * COLUMN * chunks  # of a node: arclength, state, columns
    return ScratchBuffers(
        case=np.empty(1, dtype=CASE), nodes=np.empty(room * width), blocks=np.empty(chunks * BLOCK), y=np.empty(STATE),
        contact=np.empty(width - 1), turns=np.empty((3, k)),
    )  # fmt: skip


@inlined
def _body_of(bodies, b):
    return Body(
        bodies.knots[b], bodies.radii[b], bodies.volume_beyond[b], bodies.volume_by_knot[b], bodies.rest[b],
        bodies.constants[b],
    )  # fmt: skip


@inner
def _report(case, scratch, body, load, tol, until):
    """Sweep a solved case once more, with the outputs beside base and contact; its tip is turned where necessary.

    Args:
        tol: error allowed a step [rad]; until: residual allowed at the base [rad];
            both relative to how far the rod turns.

    Returns:
        How many nodes were filled.
    """
    general, growth, size = body.constants[GENERAL] != 0.0, case.growth, case.turned
    first = -body.knots[-1] / FIRST_STEPS
    tol = tol / min(growth, MAX_GROWTH)
    for _ in range(6):  # the sweep with all outputs takes other steps than the search: one or two turns correct that
        status, count, margin, size, _steps, _first = sweep(
            case.tip[:], scratch.y, case.work[:], scratch.blocks, body, load, tol, size, first, True, scratch.nodes,
            scratch.contact,
        )  # fmt: skip
        case.status = status
        if scratch.blocks.shape[0] > 0:
            case.margin = margin
        if status != OK:
            case.residual = math.inf
            return 0
        t, d = take(scratch.y, T), take(scratch.y, D)
        r = misfit(t, d, general)
        case.residual = math.sqrt(dot(r, r))
        if is_clamped(t, d, general, max(max(until, tol) * size, ROUNDING * growth)):
            case.status = OK if case.margin > 0.0 or not is_judged(load) else UNSTABLE
            return count
        turn_tip(case.tip[:], target_rotation(t, d, general, case.inverse))
    case.status = NOT_CONVERGED
    return 0


@inlined
def _write(solution, case, y, contact, count):
    solution.status, solution.margin, solution.residual, solution.count = case.status, case.margin, case.residual, count
    for q in range(6):
        solution.tip[q] = case.tip[q]
    for q in range(3):
        solution.moment[q] = y[M + q]
        solution.tangent[q] = contact[T + q]
        solution.point[q] = contact[P + q] - y[P + q]


@kernel
def solve_cases(first, last, bodies, which, loads, start, chained, tol, until, scratch, solutions, derivatives):
    """Solve for the equilibria of the cases first ... last - 1.

    Args:
        bodies: Body of stacked arrays, one row a rod; which: the rod of each case, (n,).
        loads: (n, LOAD).
        start: COLD, WARM or WARM_ONLY; from a guess: the tip in the case's row of `solutions`.
        chained: whether each case starts from the one before it, until one has no solution. If not, the solutions do
            not depend on their order.
        tol: error allowed a step [rad]; until: residual allowed at the base [rad]; both relative to how far the rod
            turns.
        scratch: ScratchBuffers. With neither nodes nor blocks there is no last sweep, no section axes, and `y` and
            `contact` stay as they are.
        solutions: SOLUTION, (n,).
        derivatives: of the base moment (3) and the contact's [t, x axis, position, y axis] (12), by k parameters,
            and in the last column those twelve themselves, (n, 15, k + 1); filled if k > 0.

    Returns:
        How many cases were done.
    """
    reports = scratch.nodes.shape[0] > 0 or scratch.blocks.shape[0] > 0
    near_enough = INITIAL_TOLERANCE * tol if reports else 0.0
    case = scratch.case[0]
    for i in range(first, last):
        body, load, solution = _body_of(bodies, which[i]), loads[i], solutions[i]
        follows = chained and i > first
        for q in range(6):
            case.tip[q] = solutions[i - 1 if follows else i].tip[q]
        if seek(case, load, WARM if follows else start, body, tol):
            polish(case, body, tol, until, near_enough)
        if reports and case.status == OK:
            count = _report(case, scratch, body, load, tol, until)
            _write(solution, case, scratch.y, scratch.contact, count)
        else:
            _write(solution, case, case.y, case.contact, 0)
        if chained and case.status != OK:
            return i + 1 - first
        if scratch.turns.shape[1] > 0 and case.status == OK:
            sensitivities(scratch.y, scratch.blocks, scratch.contact, body, load, scratch.turns, derivatives[i])
    return last - first
