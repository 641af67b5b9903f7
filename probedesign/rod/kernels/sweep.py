"""Integrate one rod from the free tip to the clamp, with shape, columns and stability margin, and evaluate the sweep.

`sensitivities` returns total derivatives at base and contact, `states_at` the state at any arclength, and
`linear_equilibrium` the equilibrium next to a guessed tip to first order, for solvers that also vary the load.
"""

import math

from probedesign.rod.kernels import inline_always, inlined, inner, kernel
from probedesign.rod.kernels.equations import (
    BEND_X,
    CONE,
    COUPLE,
    DENSITY,
    FORCE,
    GENERAL,
    GRAVITY,
    OK,
    PARAMETERS,
    ROOT_DEPTH,
    ROOT_REACH,
    S_CONTACT,
    STEP_LIMIT,
    TIP_MOMENT,
    frustum_at,
    frustum_of,
    full_margin,
    rest_at,
    rest_of,
    round_margin,
    round_slopes,
    section_properties,
    turning,
)
from probedesign.rod.kernels.linalg import add, cross, dot, minus, plus, put, put3, take, take3, times
from probedesign.rod.kernels.steps import (
    BLOCK,
    BY_LOAD,
    BY_WEIGHT,
    COLUMN,
    ERRORS,
    LOG_F,
    LOG_R,
    LOGS,
    MAX_STEPS,
    MAX_TRIES,
    MIN_STEP,
    NEXT,
    NOTED,
    REST,
    ROW,
    S0,
    S1,
    S2,
    STAGES,
    STATE,
    THETA,
    WIDE,
    C,
    D,
    M,
    P,
    Q,
    T,
    V,
    forced_columns_step,
    free_columns_step,
    full_step,
    round_columns_step,
    round_step,
)

# Lanes: 0, 1, 2 turn the tip about its section's x and y axes and its tangent; then the parameters.
L_S_CONTACT, L_FORCE, L_COUPLE, L_GRAVITY = 3, 4, 7, 10
L_E, L_G, L_DENSITY, L_DIAMETER, L_REST, L_KNOTS = 13, 14, 15, 16, 17, 19
REST_X = PARAMETERS.index("rest_x")  #: Its column; that of rest_y is the next.
FIRST_STEPS = 6.0  #: Length over the first step to try where nothing better is known.


@inlined
def lane_of(j):
    """Return the lane of PARAMETERS[j]."""
    return L_FORCE + j if j < 3 else L_S_CONTACT if j == 3 else L_COUPLE + j - 4


@inner
def begin(tip, blocks, chunks):
    """Set the columns at the tip: unit rotations about its axes, and unit parameters; tip [t, ..., d]."""
    t, d = take(tip, T), take(tip, tip.shape[0] - 3)
    for q in range(chunks * BLOCK if chunks > 1 else chunks * WIDE * COLUMN):
        blocks[q] = 0.0
    if chunks > 0:
        e = cross(t, d)
        for q in range(3):
            blocks[WIDE * q] = d[q]
            blocks[WIDE * q + 1] = e[q]
            blocks[WIDE * q + 2] = t[q]
    for lane in range(L_FORCE, WIDE * chunks):
        o = _column_at(lane, BLOCK)
        if lane < L_COUPLE:
            blocks[o + WIDE * (BY_LOAD + lane - L_FORCE)] = 1.0
        elif L_GRAVITY <= lane < L_E:
            blocks[o + WIDE * (BY_LOAD + 3 + lane - L_GRAVITY)] = 1.0
        elif lane in (L_E, L_G):
            blocks[o + WIDE * (LOGS + lane - L_E)] = 1.0
        elif L_REST <= lane < L_KNOTS:
            blocks[o + WIDE * (REST + lane - L_REST)] = 1.0


@inner
def _reshape(s, h, i, in_root, blocks, chunks, body, work):
    """Set the change of radius and weight by density and diameters at each stage of the step from s by h."""
    below, above = body.knots[i], body.knots[i + 1]
    r0, r1 = body.radii[i], body.radii[i + 1]
    rho, cone = body.constants[DENSITY], body.constants[CONE]
    knots = body.knots.shape[0]
    depth, reach = body.constants[ROOT_DEPTH] if in_root else 0.0, body.constants[ROOT_REACH]
    for j in range(STAGES):
        height = above - (s + C[j] * h)
        y = 1.0 - (above - height) / reach
        # The reach of the root is a number of base radii: δf = -3 depth y² (1 - y) δ log r₀.
        by_base = -3.0 * depth * y * y * (1.0 - y) / (1.0 - depth * y * y * y)
        x = height / (above - below)
        r = r1 + (r0 - r1) * x
        weight = work[NOTED + ROW * j + 20]
        for lane in range(L_DENSITY, min(WIDE * chunks, L_KNOTS + knots)):
            log_r, by_weight = 0.0, weight if lane == L_DENSITY else 0.0
            if lane == L_DIAMETER:
                log_r, by_weight = 1.0, 2.0 * weight
            elif lane >= L_KNOTS:
                k = lane - L_KNOTS
                dr0, dr1 = (r0 if k == i else 0.0), (r1 if k == i + 1 else 0.0)
                dr = x * dr0 + (1.0 - x) * dr1
                log_r = dr / r
                grown = height * ((2.0 * r + r1) * dr + (r + 2.0 * r1) * dr1)
                by_weight = rho * (body.volume_by_knot[i + 1, k] + cone * grown)
            o = _column_at(lane, BLOCK)
            blocks[o + WIDE * (LOG_R + j)] = log_r
            blocks[o + WIDE * (LOG_F + j)] = by_base if lane in (L_DIAMETER, L_KNOTS) else 0.0
            blocks[o + WIDE * (BY_WEIGHT + j)] = by_weight


@inline_always
def step_columns(s, h, i, in_root, work, blocks, chunks, body, gravity, on):
    """Step the columns over the stages of the state's step; those of force and couple are zero beyond the contact."""
    if chunks > 0:
        free_columns_step(h, blocks[:BLOCK], work)
    if chunks * WIDE > L_DENSITY:
        _reshape(s, h, i, in_root, blocks, chunks, body, work)
    for c in range(1, chunks):
        # Where gravity is not requested, the last block has the couple alone, beside lanes that nobody reads.
        zero = on == 0.0 and ((c + 1) * WIDE <= L_GRAVITY or chunks * WIDE < L_E)
        if not zero:
            forced_columns_step(h, blocks[c * BLOCK : (c + 1) * BLOCK], work, gravity)


@inlined
def _jacobi_error(blocks, axes, bend, tol):
    """Return the largest error of the tip's columns over a thousand times the state's tolerance, at most 1e-2.

    On a straight rod nothing else sees the steps, and long ones would pass over conjugate points.
    """
    loose = min(1000.0 * tol, 1e-2)
    worst = 0.0
    for lane in range(3 if axes else 2):
        size = abs(blocks[lane]) + abs(blocks[WIDE + lane]) + abs(blocks[2 * WIDE + lane])
        error = max(blocks[WIDE * ERRORS + lane], bend * blocks[WIDE * (ERRORS + 1) + lane])
        error = error / (max(1.0, size) * loose)
        if not error <= worst:
            worst = error
    return worst


@inline_always
def _advance(s, stop, h, i, in_root, frustum, work, blocks, chunks, body, load, tol, size, on, axes):
    """Take one accepted step towards `stop`; return new s, next step and tries, new s = NaN if none is accepted.

    Errors of tangents [rad] and of moments, by the bend they cause, are relative to how far the rod turns at all
    (`size`), so that a bend of a micrometre keeps its digits; those of points are relative to the length.
    """
    length = body.knots[-1]
    force, gravity = times(on, take(load, FORCE)), take(load, GRAVITY)
    tries = 0
    while tries < MAX_TRIES:
        tries += 1
        last = s + 1.1 * h <= stop  # a step up to 10 % longer avoids a tiny step after it
        hs = stop - s if last else h
        if axes:
            et, em, ep = full_step(s, hs, work, frustum, rest_of(body, i), force, gravity, on)
        else:
            et, em, ep = round_step(s, hs, work, frustum, force, gravity, on, chunks > 0)
        r = frustum[1] + frustum[2] * (frustum[0] - s)
        bend = body.constants[BEND_X] * length / (r * r * r * r)
        error = max(max(et, bend * em) / (size * tol), ep / (length * tol))
        if not (et == et and em == em and ep == ep):
            error = math.inf
        if chunks > 0 and error <= 1.0:
            if axes:
                step_columns(s, hs, i, in_root, work, blocks, chunks, body, gravity, on)
            else:
                round_columns_step(hs, blocks, work)
            jacobi = _jacobi_error(blocks, axes, bend, tol)
            error = jacobi if not jacobi <= error else error
        if error <= 1.0:
            # Order 6: the error goes with h⁶. 0.9 keeps most next steps acceptable; the growth is limited because the
            # error is known to first order only.
            factor = min(5.0, 0.9 * max(error, 1e-6) ** (-1.0 / 6.0))
            # A step cut short by a stop gives no estimate of the next one.
            return stop if last else s + hs, h if last and factor > 1.0 and hs > h else hs * factor, tries
        h = hs * (max(0.1, 0.9 * error ** (-1.0 / 6.0)) if math.isfinite(error) else 0.1)
        if -h < MIN_STEP * length:
            break
    return math.nan, h, tries


@inlined
def _slopes_at(s, i, in_root, state, m, force, body, load):
    """Return rotation ω, m' and p' of a section under a moment m and the contact's force, or a part of them."""
    t, d = take(state, T), take(state, D)
    med = section_properties(s, frustum_of(body, i, in_root), force, take(load, GRAVITY))
    _t1, m1, p1 = round_slopes(t, m, med)
    return turning(t, m, d, cross(t, d), rest_at(s, rest_of(body, i)), med), m1, p1


@inner
def _add_slopes(lane, change, s, i, in_root, y, blocks, body, load, on):
    """Add to a column `change` times the state's slopes at s, as rotation, moment and point."""
    rows = _slopes_at(s, i, in_root, y, take(y, M), times(on, take(load, FORCE)), body, load)
    o = _column_at(lane, BLOCK)
    for j in range(3):
        for q in range(3):
            blocks[o + WIDE * (3 * j + q)] += change * rows[j][q]


@inner
def _cross_contact(s, i, in_root, y, blocks, chunks, body, load):
    """Pass the contact: add the couple to the state, and the motion of the contact to the columns."""
    if chunks > 1:
        _add_slopes(L_S_CONTACT, 1.0, s, i, in_root, y, blocks, body, load, 0.0)
    put(y, M, plus(take(y, M), take(load, COUPLE)))
    if chunks > 1:
        _add_slopes(L_S_CONTACT, -1.0, s, i, in_root, y, blocks, body, load, 1.0)
    for lane in range(L_COUPLE, min(L_GRAVITY, WIDE * chunks)):
        blocks[_column_at(lane, BLOCK) + WIDE * (3 + lane - L_COUPLE)] += 1.0


@inlined
def _margin(blocks):
    """Return the margin of any rod after a step; negative too if two fields turned over within the step."""
    a, b, c = row3(blocks, S0), row3(blocks, S1), row3(blocks, S2)
    o = WIDE * NEXT
    x, y, z = row3(blocks, o + S0), row3(blocks, o + S1), row3(blocks, o + S2)
    trace, minors, det = full_margin(a, b, c, x, y, z)
    return det if trace > 0.0 and minors > 0.0 else -abs(det)


@inlined
def _carried(e, t, new):
    return add(e, -dot(e, new) / (1.0 + dot(t, new)), plus(t, new))


@inlined
def row3(columns, o):
    """Return three rows of a column, from offset o on."""
    return (columns[o], columns[o + WIDE], columns[o + 2 * WIDE])


@inlined
def _accept(blocks, chunks):
    for c in range(chunks):
        o = c * BLOCK
        for q in range(WIDE * COLUMN):
            blocks[o + q] = blocks[o + WIDE * NEXT + q]


@inlined
def _note(y, blocks, chunks, row):
    for q in range(STATE):
        row[q] = y[q]
    for c in range(chunks):
        for q in range(WIDE * COLUMN):
            row[STATE + c * WIDE * COLUMN + q] = blocks[c * BLOCK + q]


@inner
def sweep(tip, y, work, blocks, body, load, tol, size, first, axes, nodes, contact):
    """Integrate from the tip to the base.

    Args:
        tip: unit tangent and section x axis at the tip, (6,).
        y: state at the base on return, (STATE,).
        work: scratch, (WORK,).
        blocks: columns, (chunks · BLOCK,), WIDE to a block, may be none; at the base on return.
        tol: error allowed a step, relative to size; size: how far the rod turns from the axis, at most 1.
        first: step from the tip to try first [m], negative.
        axes: whether the section's axes are integrated; without them (round straight rods only) `y`, `nodes` and
            `contact` keep those of the tip.
        nodes: rows [s, state, columns] from tip to base, (m · (1 + STATE + 36 chunks),); m may be 0.
        contact: state and columns at s_c, (STATE + 36 chunks,), filled on passing it.

    Returns:
        Status, nodes filled, margin of stability (negative: unstable), how far the rod turned, steps tried, and
        the first step that was accepted [m].
    """
    out = work[STATE : 2 * STATE]
    chunks = blocks.shape[0] // BLOCK
    general = body.constants[GENERAL] != 0.0
    width = 1 + STATE + WIDE * COLUMN * chunks
    # A contact at -1e-18 by rounding would never be passed, and `contact` would keep what was there.
    s_c, reach = max(load[S_CONTACT], 0.0), body.constants[ROOT_REACH]
    put(y, T, take(tip, T))
    put(y, M, take(load, TIP_MOMENT))
    put(y, P, (0.0, 0.0, 0.0))
    put(y, D, take(tip, M))  # a tip is [t, d]
    begin(tip, blocks, chunks)
    for q in range(STATE):
        work[q] = out[q] = y[q]
    i, s, h = body.knots.shape[0] - 2, body.knots[-1], first
    stop, frustum = s, frustum_of(body, i, s <= reach)
    max_steps = MAX_STEPS * max(1.0, (1e-7 / tol) ** (1.0 / 6.0))
    # A straight rod has a size of 1e-9, so that errors relative to it stay finite.
    on, margin, steps, count, bend = 0.0, 1.0, 0, 0, 1e-9
    e1, e2 = take(tip, M), cross(take(tip, T), take(tip, M))
    while True:
        in_root = s <= reach
        if on == 0.0 and s <= s_c:
            _cross_contact(s, i, in_root, y, blocks, chunks, body, load)
            on = 1.0
            put(work, M, take(y, M))
            _note(y, blocks, chunks, contact)
        if (count + 1) * width <= nodes.shape[0]:
            nodes[count * width] = s
            _note(y, blocks, chunks, nodes[count * width + 1 : (count + 1) * width])
            count += 1
        bend = max(bend, math.sqrt(y[0] * y[0] + y[1] * y[1] + (y[2] - 1.0) ** 2))
        if s <= 0.0:
            return OK, count, margin, min(bend, 1.0), steps, first
        if s == stop:  # only there, another frustum or the root begins
            while i > 0 and s <= body.knots[i]:
                i -= 1
            frustum = frustum_of(body, i, in_root)
        stop = max(body.knots[i], s_c if on == 0.0 else 0.0, 0.0 if in_root else reach)
        start = s
        s, h, tries = _advance(s, stop, h, i, in_root, frustum, work, blocks, chunks, body, load, tol, size, on, axes)
        if steps == 0:
            first = max(s - start, h)
        steps += tries
        if steps > max_steps or math.isnan(s):
            return STEP_LIMIT, count, -1.0, 1.0, steps, first
        if chunks > 0 and general:
            margin = min(margin, _margin(blocks))
            _accept(blocks, chunks)
        elif chunks > 0:
            _accept(blocks, chunks)
            t, new = take(y, T), take(out, T)
            e1, e2 = _carried(e1, t, new), _carried(e2, t, new)
            det, half_trace = round_margin(row3(blocks, S0), row3(blocks, S1), e1, e2)
            margin = min(margin, min(det, half_trace))
        for q in range(STATE):
            y[q] = work[q] = out[q]


@inlined
def _column_at(lane, stride):
    return lane // WIDE * stride + lane % WIDE


@inner
def _tips_for(columns, x):
    a, b, c = row3(columns, S0), row3(columns, S1), row3(columns, S2)
    det = dot(a, cross(b, c))
    return dot(x, cross(b, c)) / det, dot(x, cross(c, a)) / det, dot(x, cross(a, b)) / det


@inlined
def _turned(columns, row, tips):
    o = WIDE * row
    turned = add(times(tips[0], row3(columns, o)), tips[1], row3(columns, o + 1))
    return add(turned, tips[2], row3(columns, o + 2))


@inlined
def _total(columns, stride, lane, row, turns):
    o = WIDE * row
    a, b, c = row3(columns, o), row3(columns, o + 1), row3(columns, o + 2)
    x = row3(columns, o + _column_at(lane, stride))
    return add(add(add(x, turns[0], a), turns[1], b), turns[2], c)


@inner
def _turn_rest(co, si, columns):
    """Turn the columns of the curvature at rest from the tip's section axes to those with e_x at the base."""
    for r in range(columns.shape[0]):
        x, y = columns[r, REST_X], columns[r, REST_X + 1]
        columns[r, REST_X], columns[r, REST_X + 1] = co * x + si * y, co * y - si * x


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
    i = frustum_at(body, s)
    in_root = s <= body.constants[ROOT_REACH]
    turn_s, _m1, p_s = _slopes_at(s, i, in_root, contact, take(contact, M), take(load, FORCE), body, load)
    there = contact[STATE:]
    for j in range(k):
        lane = lane_of(j)
        tips = times(-1.0, _tips_for(blocks, row3(blocks, _column_at(lane, BLOCK))))
        v = _total(blocks, BLOCK, lane, V, tips)
        theta = _total(there, WIDE * COLUMN, lane, THETA, tips)
        q = minus(_total(there, WIDE * COLUMN, lane, Q, tips), _total(blocks, BLOCK, lane, Q, tips))
        if j == 3:
            theta, q = plus(theta, turn_s), plus(q, p_s)
        dt, dx, dy = cross(theta, t), cross(theta, x_axis), cross(theta, y_axis)
        put3(turns, 0, j, tips)
        put3(derivatives, 0, j, v)
        put3(derivatives, 3, j, dt)
        put3(derivatives, 6, j, dx)
        put3(derivatives, 9, j, q)
        put3(derivatives, 12, j, dy)
    if k > REST_X:
        _turn_rest(co, si, turns)
        _turn_rest(co, si, derivatives)
    put3(derivatives, 3, k, t)
    put3(derivatives, 6, k, x_axis)
    put3(derivatives, 9, k, place)
    put3(derivatives, 12, k, y_axis)


@kernel
def contact_curvature(s, state, body, load, omega):
    """Fill in the rotation of the section per arclength [1/m], (3,), at the contact: the mean of its two sides.

    Curvature and twist jump there by what the contact's couple does. A force that moves over the surface does the work
    of their mean, because the elastic energy is quadratic in the moment.

    Args:
        s: of the contact [m], or any arclength of a rod without one; state: there, on the base's side, (STATE,).
    """
    i, in_root = frustum_at(body, s), s <= body.constants[ROOT_REACH]
    m, force = add(take(state, M), -0.5, take(load, COUPLE)), times(0.5, take(load, FORCE))
    put(omega, 0, _slopes_at(s, i, in_root, state, m, force, body, load)[0])


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
            i = frustum_at(body, at)
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
def linear_equilibrium(tip, load, body, tol, size, work, nodes, blocks, y, contact, turns, derivatives, change):
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
    first = -body.knots[-1] / FIRST_STEPS
    status, _count, margin, size, _steps, _first = sweep(
        tip, y, work, blocks, body, load, tol, size, first, True, nodes, contact
    )
    if status != OK:
        return status, math.inf, -1.0, 1.0
    sensitivities(y, blocks, contact, body, load, turns, derivatives)
    k = turns.shape[1]
    t, d = take(y, T), take(y, D)
    lack = cross(t, (0.0, 0.0, 1.0))
    if body.constants[GENERAL] != 0.0:
        lack = plus(lack, (0.0, 0.0, cross(d, (1.0, 0.0, 0.0))[2]))
    misfit = math.sqrt(dot(lack, lack)) if t[2] > 0.0 else 2.0
    tips = _tips_for(blocks, lack)
    there = contact[STATE : STATE + WIDE * COLUMN]
    moment, at_base = _turned(blocks, 3, tips), _turned(blocks, 6, tips)
    theta, at_contact = _turned(there, 0, tips), _turned(there, 6, tips)
    turned_t, turned_x = cross(theta, take3(derivatives, 3, k)), cross(theta, take3(derivatives, 6, k))
    turned_y = cross(theta, take3(derivatives, 12, k))
    e = cross(take(tip, 0), take(tip, 3))
    for r in range(3):
        derivatives[r, k] = y[M + r] + moment[r]
        derivatives[3 + r, k] += turned_t[r]
        derivatives[6 + r, k] += turned_x[r]
        derivatives[9 + r, k] += at_contact[r] - at_base[r]
        derivatives[12 + r, k] += turned_y[r]
        change[r] = tips[0] * tip[3 + r] + tips[1] * e[r] + tips[2] * tip[r]
    return status, misfit, margin, size
