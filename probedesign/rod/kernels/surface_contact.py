"""One contact at a point of the deformed surface, linearised from one sweep of the rod (compiled).

The contact model: a force of any direction acts at the point x of the surface,

    x = p(s) + ρ,   ρ = r(s) (g e + k τ₁),   e = cos φ X + sin φ Y,   g² = cos² φ + f² sin² φ,   k = dg/dφ,
    F = f_n (-N + a_1 τ₁ + a_2 τ₂),
    N = cos α e + sin α t,   τ₁ = t × e,   τ₂ = cos α t - sin α e,   tan α = -g dr/ds,

with the section's axes X, Y and the tangent t of the bent rod, the half-widths r along X and f r along Y of its
elliptic outline, and φ the direction of its normal, at which the outline reaches r g far (its support function); a
round section has f = g = 1 and k = 0. N is the outward normal, so that f_n > 0 pushes; a_1 and a_2 are the ratios of
friction around the section and towards the tip. On the rod acts F on the centreline and the couple C = ρ × F. Both turn
with the section; the rod is swept under dead loads (F, C), and what the section's turn makes of them is solved for in
the linearisation: with θ the section's turn,

    δF = ∂F + θ × F,   δC = ∂C + θ × C,   θ = θ_F δF + θ_C δC + θ_s δs + θ_p δp.

`tests/reference/surface_contact.py` does the same with names.
"""

import math
from typing import NamedTuple

from probedesign.core.frames import Array
from probedesign.rod.kernels import inner, kernel
from probedesign.rod.kernels.equations import (
    ALL_COLUMNS,
    BEND_X,
    BEND_Y,
    CONTACT_COLUMNS,
    COUPLE,
    DENSITY,
    FLATNESS,
    FORCE,
    GRAVITY,
    LOAD,
    OK,
    S_CONTACT,
    frustum_at,
    rest_at,
    rest_of,
)
from probedesign.rod.kernels.linalg import add, cross, dot, minus, plus, put3, solve_square, take, take3, times
from probedesign.rod.kernels.newton import turn_tip
from probedesign.rod.kernels.steps import BLOCK, COLUMN, STATE, WIDE, M
from probedesign.rod.kernels.steps import WORK as STEP_WORK
from probedesign.rod.kernels.sweep import linear_equilibrium

S, PHI, NORMAL, AROUND, ALONG = range(5)
#: Of a touch: arclength [m], direction of the normal around the section [rad], normal force [N], ratios of friction
#: around and along.
UNKNOWNS = 5
#: After them in a touch: force and couple that the rod is swept under (6), and the tip's section (6).
DEAD, TIP, TOUCH = 5, 11, 17

#: Rows of a linearisation: base wrench (6), touched point (3) and point of the centreline (3) [m], what the dead force
#: and couple lack of those of the touch (6), and the turn of the tip (3), which `advance` needs.
WRENCH, POINT, CENTRE, LOADS, TURN, ROWS = 0, 6, 9, 12, 18, 21
#: Columns: the values, their derivatives by the unknowns, and by gravity (3), log E, log G, log density, log length (of
#: the axis with its shape at rest, diameters kept), a constant curvature at rest about the section's x and y axes (2)
#: and each knot's log diameter.
VALUE, BY_TOUCH, BY_PARAMETER = 0, 1, 1 + UNKNOWNS
OWN = 9  #: Parameters before the knots.
BY_GRAVITY, BY_E = BY_PARAMETER, BY_PARAMETER + 3

R_TANGENT, R_X, R_P, R_Y = range(3, 15, 3)  #: Rows of the rod's columns after those of the base moment.
#: Columns of the rod; the first three are by the force.
ROD_S, ROD_COUPLE, ROD_GRAVITY, ROD_DENSITY, ROD_DIAMETER = 3, 4, 7, 12, 13

MAX_LACK = 0.5  #: Misfit at the clamp [rad] up to which a linear solution is useful.
CLAMPED = 1e-4  #: Misfit at the clamp [rad] up to which it is exact: an error of its square.


class TouchMemory(NamedTuple):
    """Memory of `linearise`: views of one array. k columns of the rod, n of the linearisation."""

    load: Array  #: of the rod, (LOAD,).
    steps: Array  #: of the integration, (STEP_WORK,).
    nodes: Array  #: none are recorded, (0,).
    blocks: Array  #: columns of the rod at the base.
    base: Array  #: state at the base, (STATE,).
    contact: Array  #: state and columns at the contact.
    turns: Array  #: rotation of the tip by the rod's columns, (3, k).
    columns: Array  #: base moment and contact by the rod's columns, then their values, (15, k + 1).
    change: Array  #: rotation of the tip that leads to the equilibrium, (3,).
    system: Array  #: of the loads that turn with the section, (6, 6).
    loads: Array  #: its right sides, then its solution: changes of force and couple, (6, n).
    total: Array  #: as `columns`, by what is linearised, (15, n).


def _sizes(parameters):
    k = CONTACT_COLUMNS if parameters == 0 else ALL_COLUMNS + parameters - OWN
    n, chunks = 1 + UNKNOWNS + parameters, -(-(3 + k) // WIDE)
    blocks, contact = chunks * BLOCK, STATE + WIDE * COLUMN * chunks
    whole = LOAD + STEP_WORK + blocks + STATE + contact + 3 * k + 15 * (k + 1) + 3 + 36 + 21 * n
    return k, n, blocks, contact, whole


_sizes_kernel = inner(_sizes)


def work_size(parameters: int) -> int:
    """Return how many numbers `linearise` works in, for so many parameters of the rod (0, or OWN and the knots)."""
    return int(_sizes(parameters)[-1])


@inner
def _memory(parameters, work):
    k, n, blocks, contact, _whole = _sizes_kernel(parameters)
    load, work = work[:LOAD], work[LOAD:]
    steps, nodes, work = work[:STEP_WORK], work[:0], work[STEP_WORK:]
    of_blocks, work = work[:blocks], work[blocks:]
    base, work = work[:STATE], work[STATE:]
    of_contact, work = work[:contact], work[contact:]
    turns, work = work[: 3 * k].reshape((3, k)), work[3 * k :]
    columns, work = work[: 15 * (k + 1)].reshape((15, k + 1)), work[15 * (k + 1) :]
    change, system, work = work[:3], work[3:39].reshape((6, 6)), work[39:]
    loads, total = work[: 6 * n].reshape((6, n)), work[6 * n : 21 * n].reshape((15, n))
    return TouchMemory(load, steps, nodes, of_blocks, base, of_contact, turns, columns, change, system, loads, total)


@inner
def radius_and_slope(body, s):
    """Return r(s) [m] and -dr/ds."""
    i = frustum_at(body, s)
    slope = (body.radii[i] - body.radii[i + 1]) / (body.knots[i + 1] - body.knots[i])
    return body.radii[i] - slope * (s - body.knots[i]), slope


class Outline(NamedTuple):
    """Point of a section's outline."""

    reach: float  #: g, how far the outline reaches along its normal e, over the half-width r.
    aside: float  #: k, how far the point lies aside of that, along τ₁, over r.
    curved: float  #: g + dk/dφ, radius of curvature of the outline over r.
    slope: float  #: -dr/ds.
    sin: float  #: sin, cos: of α, by which the normal leans.
    cos: float
    lean_by: float  #: dα/dφ.


@inner
def outline_at(body, slope, phi):
    """Return the `Outline` of a section with slope = -dr/ds, at the normal's direction φ [rad]."""
    f, x, y = body.constants[FLATNESS], math.cos(phi), math.sin(phi)
    reach = math.sqrt(x * x + f * f * y * y)
    aside = (f * f - 1.0) * x * y / reach
    tan = slope * reach
    cos = 1.0 / math.sqrt(1.0 + tan * tan)
    return Outline(reach, aside, f * f / (reach * reach * reach), slope, tan * cos, cos, cos * cos * slope * aside)


@inner
def _turned(columns, j, in_frame):
    by_xy = add(times(in_frame[0], take3(columns, R_X, j)), in_frame[1], take3(columns, R_Y, j))
    return add(by_xy, in_frame[2], take3(columns, R_TANGENT, j))


@inner
def _grow_at_rest(columns, force, couple):
    """Put the column of the length's logarithm, diameters kept, in place of that of all diameters.

    A rod of λ times the size under λ² times the force, λ³ times the couple and 1/λ times the density is the same rod;
    growing under the loads as they are follows from the columns, and the diameters' growth is taken back.
    """
    last = columns.shape[1] - 1
    for r in range(15):
        power = 3.0 if r < 3 else 1.0 if 9 <= r < 12 else 0.0
        grown = power * columns[r, last] + columns[r, ROD_DENSITY] - columns[r, ROD_DIAMETER]
        for q in range(3):
            grown -= 2.0 * columns[r, q] * force[q] + 3.0 * columns[r, ROD_COUPLE + q] * couple[q]
        columns[r, ROD_DIAMETER] = grown


@inner
def _weight_by(body, gravity, parameter):
    """Return the derivative of the flexible part's weight [N] by a parameter, counted from gravity on."""
    rho = body.constants[DENSITY]
    whole = rho * body.volume_beyond[0]
    if parameter < 3:
        return (whole if parameter == 0 else 0.0, whole if parameter == 1 else 0.0, whole if parameter == 2 else 0.0)
    if parameter == 5 or parameter == 6:
        return times(whole, gravity)
    if parameter >= OWN:
        return times(rho * body.volume_by_knot[0, parameter - OWN], gravity)
    return (0.0, 0.0, 0.0)


@inner
def _section_by(body, s, i, parameter):
    """Return the derivatives of the radius at s [m] and of -dr/ds there by a parameter, counted from gravity on."""
    apart = body.knots[i + 1] - body.knots[i]
    share = (s - body.knots[i]) / apart
    if parameter == 6:
        return 0.0, -(body.radii[i] - body.radii[i + 1]) / apart
    if parameter == OWN + i:
        return (1.0 - share) * body.radii[i], body.radii[i] / apart
    if parameter == OWN + i + 1:
        return share * body.radii[i + 1], -body.radii[i + 1] / apart
    return 0.0, 0.0


@inner
def offset_along(r, at, touch):
    """Return how far beyond the touched section the force's line of action comes nearest to the centreline [m], δ, and
    its derivatives by φ, a_1, a_2, r and -dr/ds.

    δ = -(ρ·F)(F·t)/|t × F|² = -r (g b + k a_1) a/(b² + a_1²) with a = F·t/f_n, b = F·e/f_n.

    Args:
        at: the `Outline` at the touched point.
    """
    a1, a2 = touch[AROUND], touch[ALONG]
    b, a = -at.cos - a2 * at.sin, -at.sin + a2 * at.cos
    inward, square = at.reach * b + at.aside * a1, max(b * b + a1 * a1, 1e-300)
    per_r = -inward * a / square
    by_a, by_inward, by_square = -r * inward / square, -r * a / square, -r * per_r / square
    by_b = by_inward * at.reach + by_square * 2.0 * b
    by_1 = by_inward * at.aside + by_square * 2.0 * a1
    by_lean = by_a * b - by_b * a
    by_reach = by_inward * b
    by_phi = by_reach * at.aside + by_inward * a1 * (at.curved - at.reach) + by_lean * at.lean_by
    return r * per_r, by_phi, by_1, by_a * at.cos - by_b * at.sin, per_r, by_lean * at.cos * at.cos * at.reach


@inner
def linearise(body, gravity, mass, tol, size, touch, parameters, work, lin):
    """Sweep a touch and linearise what it makes.

    Args:
        body: of the rod.
        gravity: [m/s²], (3,).
        mass: of the flexible part [kg].
        tol, size: as in `linear_equilibrium`.
        touch: (TOUCH,).
        parameters: of the rod to differentiate by: 0, or OWN and the knots.
        work: scratch, (work_size(parameters),).
        lin: filled, (ROWS, 1 + UNKNOWNS + parameters).

    Returns:
        Status, misfit at the clamp [rad] (inf: nothing was linearised), margin of stability, how far the rod turned.
    """
    memory = _memory(parameters, work)
    load, contact, turns, columns = memory.load, memory.contact, memory.turns, memory.columns
    A, B, total = memory.system, memory.loads, memory.total
    k, n_cols = turns.shape[1], B.shape[1]
    s = touch[S]
    for q in range(LOAD):
        load[q] = 0.0
    for q in range(3):
        load[FORCE + q], load[COUPLE + q] = touch[DEAD + q], touch[DEAD + 3 + q]
        load[GRAVITY + q] = gravity[q]
    load[S_CONTACT] = s
    status, lack, margin, size = linear_equilibrium(
        touch[TIP:], load, body, tol, size, memory.steps, memory.nodes, memory.blocks, memory.base, contact, turns,
        columns, memory.change,
    )  # fmt: skip
    if status != OK or not lack < MAX_LACK:
        return status, math.inf, -1.0, size
    change = (memory.change[0], memory.change[1], memory.change[2])
    beyond = minus(take(contact, M), take(load, COUPLE))
    on_base_side = take(contact, M)
    t, x_axis, y_axis = take3(columns, R_TANGENT, k), take3(columns, R_X, k), take3(columns, R_Y, k)
    r, slope = radius_and_slope(body, s)
    at = outline_at(body, slope, touch[PHI])
    co, si = math.cos(touch[PHI]), math.sin(touch[PHI])
    e = add(times(co, x_axis), si, y_axis)
    around = add(times(-si, x_axis), co, y_axis)
    spoke = add(times(at.reach, e), at.aside, around)
    normal = add(times(at.cos, e), at.sin, t)
    along = add(times(at.cos, t), -at.sin, e)
    fn, a1, a2 = touch[NORMAL], touch[AROUND], touch[ALONG]
    way = add(add(times(-1.0, normal), a1, around), a2, along)
    force = times(fn, way)
    arm = times(r, spoke)
    couple = cross(arm, force)
    f_frame = (dot(force, x_axis), dot(force, y_axis), dot(force, t))
    c_frame = (dot(couple, x_axis), dot(couple, y_axis), dot(couple, t))
    if parameters > 0:
        _grow_at_rest(columns, take(load, FORCE), take(load, COUPLE))
    for q in range(6):
        j = q if q < 3 else ROD_COUPLE + q - 3
        by_F, by_C = _turned(columns, j, f_frame), _turned(columns, j, c_frame)
        for i in range(3):
            A[i, q], A[3 + i, q] = -by_F[i], -by_C[i]
        A[q, q] += 1.0
    put3(B, 0, VALUE, minus(force, take(load, FORCE)))
    put3(B, 3, VALUE, minus(couple, take(load, COUPLE)))
    put3(B, 0, BY_TOUCH + S, _turned(columns, ROD_S, f_frame))
    put3(B, 3, BY_TOUCH + S, add(_turned(columns, ROD_S, c_frame), -slope, cross(spoke, force)))
    by_lean = times(fn, add(times(-1.0, along), -a2, normal))
    by_angle = times(fn, add(times(-at.cos - a2 * at.sin, around), -a1, e))
    by_angle = add(by_angle, at.lean_by, by_lean)
    put3(B, 0, BY_TOUCH + PHI, by_angle)
    put3(B, 3, BY_TOUCH + PHI, plus(cross(times(r * at.curved, around), force), cross(arm, by_angle)))
    for j in range(3):
        way = way if j == 0 else times(fn, around) if j == 1 else times(fn, along)
        put3(B, 0, BY_TOUCH + NORMAL + j, way)
        put3(B, 3, BY_TOUCH + NORMAL + j, cross(arm, way))
    i = frustum_at(body, s)
    for j in range(parameters):
        r_by, slope_by = _section_by(body, s, i, j)
        leaning = times(at.cos * at.cos * at.reach * slope_by, by_lean)
        column = ROD_GRAVITY + j
        put3(B, 0, BY_PARAMETER + j, plus(_turned(columns, column, f_frame), leaning))
        turned = add(_turned(columns, column, c_frame), r_by, cross(spoke, force))
        put3(B, 3, BY_PARAMETER + j, plus(turned, cross(arm, leaning)))
    if not solve_square(A, 6, B):
        return status, math.inf, -1.0, size
    for row in range(15):
        for j in range(n_cols):
            x = columns[row, k] if j == VALUE else 0.0
            if j == BY_TOUCH + S:
                x = columns[row, ROD_S]
            elif j >= BY_PARAMETER:
                x = columns[row, ROD_GRAVITY + j - BY_PARAMETER]
            for q in range(3):
                x += columns[row, q] * B[q, j] + columns[row, ROD_COUPLE + q] * B[3 + q, j]
            total[row, j] = x
    _outputs(body, gravity, mass, touch, i, r, at, on_base_side, beyond, B, total, lin)
    _tips(touch, turns, change, B, lin)
    return status, lack, margin, size


@inner
def _tips(touch, turns, change, B, lin):
    """Fill in the rows that carry dead loads and tip along: their first column is the residual of the equilibrium."""
    t, d = take(touch, TIP), take(touch, TIP + 3)
    axes = (d, cross(t, d), t)
    for j in range(lin.shape[1]):
        turn = change if j == VALUE else (0.0, 0.0, 0.0)
        for a in range(3):
            by = turns[a, ROD_S] if j == BY_TOUCH + S else 0.0
            if j >= BY_PARAMETER:
                by = turns[a, ROD_GRAVITY + j - BY_PARAMETER]
            for q in range(3):
                by += turns[a, q] * B[q, j] + turns[a, ROD_COUPLE + q] * B[3 + q, j]
            turn = add(turn, by, axes[a])
        for q in range(6):
            lin[LOADS + q, j] = B[q, j]
        put3(lin, TURN, j, turn)


@inner
def _outputs(body, gravity, mass, touch, i, r, at, on_base_side, beyond, B, total, lin):
    """Fill in base wrench, touched point and centreline point from force, couple, frame and position at the contact."""
    s, n_cols = touch[S], lin.shape[1]
    for q in range(3):
        lin[q, VALUE] = touch[DEAD + q] + B[q, VALUE] + mass * gravity[q]
        lin[3 + q, VALUE] = total[q, VALUE]
        for j in range(1, n_cols):
            lin[q, j], lin[3 + q, j] = B[q, j], total[q, j]
    shift, by_phi, by_1, by_2, per_r, by_slope = offset_along(r, at, touch)
    t = take3(total, R_TANGENT, VALUE)
    x_axis, y_axis = take3(total, R_X, VALUE), take3(total, R_Y, VALUE)
    co, si = math.cos(touch[PHI]), math.sin(touch[PHI])
    x, y = at.reach * co - at.aside * si, at.reach * si + at.aside * co
    spoke = add(times(x, x_axis), y, y_axis)
    # The centreline curves on its way from the touched section to where the line of action comes nearest.
    moment = on_base_side if shift < 0.0 else beyond
    thin = 1.0 / (r * r)
    bend_x, bend_y = body.constants[BEND_X] * dot(moment, x_axis), body.constants[BEND_Y] * dot(moment, y_axis)
    bend = times(thin * thin, add(times(bend_x, x_axis), bend_y, y_axis))
    rest = rest_at(s, rest_of(body, i))
    curve = cross(add(add(bend, rest[0], x_axis), rest[1], y_axis), t)
    for j in range(n_cols):
        p, dt = take3(total, R_P, j), take3(total, R_TANGENT, j)
        dspoke = add(times(x, take3(total, R_X, j)), y, take3(total, R_Y, j))
        by_r, by_shift = 0.0, 0.0
        if j == VALUE:
            put3(lin, POINT, j, add(p, r, spoke))
            put3(lin, CENTRE, j, add(add(p, shift, t), 0.5 * shift * shift, curve))
            continue
        if j == BY_TOUCH + S:
            by_r = -at.slope
            by_shift = -at.slope * per_r
        elif j == BY_TOUCH + PHI:
            dspoke = add(add(dspoke, -at.curved * si, x_axis), at.curved * co, y_axis)
            by_shift = by_phi
        elif j == BY_TOUCH + NORMAL:
            pass
        elif j == BY_TOUCH + AROUND:
            by_shift = by_1
        elif j == BY_TOUCH + ALONG:
            by_shift = by_2
        else:
            by_r, slope_by = _section_by(body, s, i, j - BY_PARAMETER)
            by_shift = per_r * by_r + by_slope * slope_by
            weight = _weight_by(body, gravity, j - BY_PARAMETER)
            for q in range(3):
                lin[q, j] += weight[q]
        put3(lin, POINT, j, add(add(p, r, dspoke), by_r, spoke))
        put3(lin, CENTRE, j, add(add(p, shift, dt), by_shift, t))


@inner
def s_contact(body, touch):
    """Return the arclength of the centreline's point where the force's line of action comes nearest [m]."""
    r, slope = radius_and_slope(body, touch[S])
    return touch[S] + offset_along(r, outline_at(body, slope, touch[PHI]), touch)[0]


#: Numbers that carry a touch along a step: what its dead loads (6) and tip (3) lack, and how the step moves them.
MOVE = 18


@inner
def plan_move(lin, step, move):
    """Fill in what carries a touch from where it was linearised along a step of its unknowns, (MOVE,)."""
    for q in range(9):
        total = 0.0
        for j in range(UNKNOWNS):
            total += lin[LOADS + q, BY_TOUCH + j] * step[j]
        move[q], move[9 + q] = lin[LOADS + q, VALUE], total


@inner
def advance(touch, before, share, step, move):
    """Carry a touch along a share of a step, its dead loads and its tip with it.

    Args:
        touch: filled, (TOUCH,); before: as it was linearised, (TOUCH,), which may be the same array.
        step: of the unknowns, (UNKNOWNS,); move: from `plan_move`.
    """
    for j in range(TOUCH):
        touch[j] = before[j] + (share * step[j] if j < UNKNOWNS else 0.0)
    for q in range(6):
        touch[DEAD + q] += move[q] + share * move[9 + q]
    turn_tip(touch[TIP:], add(take(move, 6), share, take(move, 15)))


@inner
def settle(body, gravity, mass, tol, touch, parameters, work, lin):
    """Run `linearise` after dead loads and tip of the touch have been made consistent.

    Returns:
        Whether there is a stable equilibrium.
    """
    size = 1.0
    for _ in range(30):  # converges quadratically, in a few sweeps, where there is an equilibrium near
        status, lack, margin, size = linearise(body, gravity, mass, tol, size, touch, parameters, work, lin)
        if status != OK or not lack < math.inf:
            return False
        off, force = 0.0, 1e-12  # [N], so that no force at all counts as consistent
        for q in range(3):
            off = max(off, abs(lin[LOADS + q, VALUE]))
            force = max(force, abs(touch[DEAD + q]))
        for q in range(6):
            touch[DEAD + q] += lin[LOADS + q, VALUE]
        turn_tip(touch[TIP:], take3(lin, LOADS + 6, VALUE))
        if lack <= CLAMPED and off <= 1e-4 * force:  # the step just taken leaves the square of that
            return margin > 0.0
    return False


@kernel
def linearise_touch(body, gravity, mass, tol, touch, settled, parameters, work, lin):
    """Run `settle` or, where dead loads and tip need not be `settled`, `linearise` for callers in Python.

    Returns:
        Whether there is a stable equilibrium.
    """
    if settled:
        return settle(body, gravity, mass, tol, touch, parameters, work, lin)
    status, lack, margin, _size = linearise(body, gravity, mass, tol, 1.0, touch, parameters, work, lin)
    return status == OK and lack < math.inf and margin > 0.0


@kernel
def move_touch(touch, lin, step, move):
    """Run `advance` for callers in Python: carry a touch along a step of its unknowns from where it was linearised.

    Args:
        touch: moved in place, (TOUCH,); lin: its linearisation; step: of the unknowns, (UNKNOWNS,).
        move: scratch, (MOVE,).
    """
    plan_move(lin, step, move)
    advance(touch, touch, 1.0, step, move)
