"""Integrate one rod from the free tip to the clamp, with shape, columns and stability margin."""

import math

from probedesign.rod.kernels import inline_always, inlined, inner
from probedesign.rod.kernels.equations import (
    BEND_X,
    CONE,
    COUPLE,
    DENSITY,
    FORCE,
    GENERAL,
    GRAVITY,
    OK,
    ROOT_DEPTH,
    ROOT_REACH,
    S_CONTACT,
    STEP_LIMIT,
    TIP_MOMENT,
    frustum_of,
    full_margin,
    rest_at,
    rest_of,
    round_margin,
    round_slopes,
    section_properties,
    turning,
)
from probedesign.rod.kernels.linalg import cross, plus, put, take, times
from probedesign.rod.kernels.steps import (
    BLOCK,
    BY_LOAD,
    BY_WEIGHT,
    COLUMN,
    ERRORS,
    LOG_F,
    LOG_R,
    LOGS,
    NEXT,
    NOTED,
    ROW,
    S0,
    S1,
    S2,
    STAGES,
    STATE,
    WIDE,
    C,
    D,
    M,
    P,
    T,
    forced_columns_step,
    free_columns_step,
    full_step,
)

# Lanes: 0, 1, 2 turn the tip about its section's x and y axes and its tangent; then the parameters.
L_S_CONTACT, L_FORCE, L_COUPLE, L_GRAVITY = 3, 4, 7, 10
L_E, L_G, L_DENSITY, L_DIAMETER, L_KNOTS = 13, 14, 15, 16, 17

MAX_STEPS = 1000
"""Of one sweep at an error of 1e-7 a step; more where it is less: a hang is not an answer."""


@inlined
def lane_of(j):
    """Return the lane of PARAMETERS[j]."""
    return L_FORCE + j if j < 3 else L_S_CONTACT if j == 3 else L_COUPLE + j - 4


@inner
def begin(tip, blocks, chunks):
    """Set the columns at the tip: unit rotations about its axes, and unit parameters; tip [t, ..., d]."""
    t, d = take(tip, T), take(tip, tip.shape[0] - 3)
    for q in range(chunks * BLOCK):
        blocks[q] = 0.0
    if chunks > 0:
        e = cross(t, d)
        for q in range(3):
            blocks[WIDE * q] = d[q]
            blocks[WIDE * q + 1] = e[q]
            blocks[WIDE * q + 2] = t[q]
    for lane in range(L_FORCE, WIDE * chunks):
        o = lane // WIDE * BLOCK + lane % WIDE
        if lane < L_COUPLE:
            blocks[o + WIDE * (BY_LOAD + lane - L_FORCE)] = 1.0
        elif L_GRAVITY <= lane < L_E:
            blocks[o + WIDE * (BY_LOAD + 3 + lane - L_GRAVITY)] = 1.0
        elif lane in (L_E, L_G):
            blocks[o + WIDE * (LOGS + lane - L_E)] = 1.0


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
        # The root reaches so many base radii: δf = -3 depth y² (1 - y) δ log r₀.
        by_base = -3.0 * depth * y * y * (1.0 - y) / (1.0 - depth * y * y * y)
        x = height / (above - below)
        r = r1 + (r0 - r1) * x
        weight = work[NOTED + ROW * j + 20]
        for lane in range(L_DENSITY, min(WIDE * chunks, L_KNOTS + knots)):
            log_r, by_weight = 0.0, weight
            if lane == L_DIAMETER:
                log_r, by_weight = 1.0, 2.0 * weight
            elif lane >= L_KNOTS:
                k = lane - L_KNOTS
                dr0, dr1 = (r0 if k == i else 0.0), (r1 if k == i + 1 else 0.0)
                dr = x * dr0 + (1.0 - x) * dr1
                log_r = dr / r
                grown = height * ((2.0 * r + r1) * dr + (r + 2.0 * r1) * dr1)
                by_weight = rho * (body.volume_by_knot[i + 1, k] + cone * grown)
            o = lane // WIDE * BLOCK + lane % WIDE
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
        # Where gravity is not asked for, the last block has the couple alone, beside lanes that nobody reads.
        zero = on == 0.0 and ((c + 1) * WIDE <= L_GRAVITY or chunks * WIDE < L_E)
        if not zero:
            forced_columns_step(h, blocks[c * BLOCK : (c + 1) * BLOCK], work, gravity)


@inlined
def _jacobi_error(blocks, bend, tol):
    """Return the largest error of the tip's columns over a thousand times the state's tolerance.

    On a straight rod nothing else sees the steps, and long ones would pass over conjugate points.
    """
    loose = min(1000.0 * tol, 1e-2)
    worst = 0.0
    for lane in range(3):
        size = abs(blocks[lane]) + abs(blocks[WIDE + lane]) + abs(blocks[2 * WIDE + lane])
        error = max(blocks[WIDE * ERRORS + lane], bend * blocks[WIDE * (ERRORS + 1) + lane])
        error = error / (max(1.0, size) * loose)
        if not error <= worst:
            worst = error
    return worst


@inline_always
def _advance(s, stop, h, i, in_root, work, blocks, chunks, body, load, tol, size, on):
    """Take one accepted step towards `stop`; return new s, next step and tries, new s = NaN if none is accepted.

    Tangents [rad] and moments, by the bend they cause, are held relative to how far the rod turns at all
    (`size`), so that a bend of a micrometre keeps its digits; points to the body's own length.
    """
    length = body.knots[-1]
    frustum, rest = frustum_of(body, i, in_root), rest_of(body, i)
    force, gravity = times(on, take(load, FORCE)), take(load, GRAVITY)
    tries = 0
    while tries < 60:
        tries += 1
        last = s + 1.1 * h <= stop  # rather a slightly longer step than a sliver after it
        hs = stop - s if last else h
        et, em, ep = full_step(s, hs, work, frustum, rest, force, gravity, on)
        r = frustum[1] + frustum[2] * (frustum[0] - s)
        bend = body.constants[BEND_X] * length / (r * r * r * r)
        error = max(max(et, bend * em) / (size * tol), ep / (length * tol))
        if not (et == et and em == em and ep == ep):
            error = math.inf
        if chunks > 0 and error <= 1.0:
            step_columns(s, hs, i, in_root, work, blocks, chunks, body, gravity, on)
            jacobi = _jacobi_error(blocks, bend, tol)
            error = jacobi if not jacobi <= error else error
        if error <= 1.0:
            factor = min(5.0, 0.9 * max(error, 1e-6) ** (-1.0 / 6.0))
            # A step cut short by a break says little of the step to take after it.
            return stop if last else s + hs, h if last and factor > 1.0 and hs > h else hs * factor, tries
        h = hs * (max(0.1, 0.9 * error ** (-1.0 / 6.0)) if math.isfinite(error) else 0.1)
        if -h < 1e-10 * length:
            break
    return math.nan, h, tries


@inner
def _add_slopes(lane, change, s, i, in_root, y, blocks, body, load, on):
    """Add to a column `change` times the state's slopes at s, as rotation, moment and point."""
    t, m, d = take(y, T), take(y, M), take(y, D)
    force = times(on, take(load, FORCE))
    med = section_properties(s, frustum_of(body, i, in_root), force, take(load, GRAVITY))
    turn = turning(t, m, d, cross(t, d), rest_at(s, rest_of(body, i)), med)
    _t1, m1, p1 = round_slopes(t, m, med)
    rows = (turn, m1, p1)
    o = lane // WIDE * BLOCK + lane % WIDE
    for j in range(3):
        for q in range(3):
            blocks[o + WIDE * (3 * j + q)] += change * rows[j][q]


@inner
def _cross_contact(s, i, in_root, y, blocks, chunks, body, load):
    """Pass the contact: add the couple to the state, and the motion of the contact to the columns."""
    if chunks > 0:
        _add_slopes(L_S_CONTACT, 1.0, s, i, in_root, y, blocks, body, load, 0.0)
    put(y, M, plus(take(y, M), take(load, COUPLE)))
    if chunks > 0:
        _add_slopes(L_S_CONTACT, -1.0, s, i, in_root, y, blocks, body, load, 1.0)
    for lane in range(L_COUPLE, min(L_GRAVITY, WIDE * chunks)):
        blocks[lane // WIDE * BLOCK + lane % WIDE + WIDE * (3 + lane - L_COUPLE)] += 1.0


@inlined
def _margin(blocks):
    """Return the margin of any rod after a step; negative too if two fields turned over within the step."""
    a, b, c = take3(blocks, S0), take3(blocks, S1), take3(blocks, S2)
    o = NEXT
    x = (blocks[WIDE * o], blocks[WIDE * (o + 1)], blocks[WIDE * (o + 2)])
    y = (blocks[WIDE * o + 1], blocks[WIDE * (o + 1) + 1], blocks[WIDE * (o + 2) + 1])
    z = (blocks[WIDE * o + 2], blocks[WIDE * (o + 1) + 2], blocks[WIDE * (o + 2) + 2])
    trace, minors, det = full_margin(a, b, c, x, y, z)
    return det if trace > 0.0 and minors > 0.0 else -abs(det)


@inlined
def take3(blocks, lane):
    """Return θ of one of the first columns."""
    return (blocks[lane], blocks[WIDE + lane], blocks[2 * WIDE + lane])


@inlined
def _accept(blocks, chunks):
    """Set the columns to the result of the step."""
    for c in range(chunks):
        o = c * BLOCK
        for q in range(WIDE * COLUMN):
            blocks[o + q] = blocks[o + WIDE * NEXT + q]


@inlined
def _note(y, blocks, chunks, row):
    """Store state and columns in a row."""
    for q in range(STATE):
        row[q] = y[q]
    for c in range(chunks):
        for q in range(WIDE * COLUMN):
            row[STATE + c * WIDE * COLUMN + q] = blocks[c * BLOCK + q]


@inner
def sweep(tip, y, work, blocks, body, load, tol, size, nodes, contact):
    """Integrate from the tip to the base.

    Args:
        tip: unit tangent and section x axis at the tip, (6,).
        y: state at the base on return, (STATE,).
        work: scratch, (WORK,).
        blocks: columns, (chunks · BLOCK,), WIDE to a block, may be none; at the base on return.
        tol: error allowed a step, relative to size; size: how far the rod turns from the axis, at most 1.
        nodes: rows [s, state, columns] from tip to base, (m · (1 + STATE + 36 chunks),); m may be 0.
        contact: state and columns at s_c, (STATE + 36 chunks,), filled on passing it.

    Returns:
        status, nodes filled, margin of stability (negative: unstable), how far the rod turned, steps taken.
    """
    out = work[STATE : 2 * STATE]
    chunks = blocks.shape[0] // BLOCK
    general = body.constants[GENERAL] != 0.0
    width = 1 + STATE + WIDE * COLUMN * chunks
    s_c, reach = load[S_CONTACT], body.constants[ROOT_REACH]
    put(y, T, take(tip, T))
    put(y, M, take(load, TIP_MOMENT))
    put(y, P, (0.0, 0.0, 0.0))
    put(y, D, take(tip, M))  # a tip is [t, d]
    begin(tip, blocks, chunks)
    for q in range(STATE):
        work[q] = out[q] = y[q]
    i, s, h = body.knots.shape[0] - 2, body.knots[-1], -body.knots[-1] / 6.0
    most = MAX_STEPS * max(1.0, (1e-7 / tol) ** (1.0 / 6.0))
    on, margin, steps, count, bend = 0.0, 1.0, 0, 0, 1e-9
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
            return OK, count, margin, min(bend, 1.0), steps
        while i > 0 and s <= body.knots[i]:
            i -= 1
        stop = max(body.knots[i], s_c if on == 0.0 else 0.0, 0.0 if in_root else reach)
        s, h, tries = _advance(s, stop, h, i, in_root, work, blocks, chunks, body, load, tol, size, on)
        steps += tries
        if steps > most or math.isnan(s):
            return STEP_LIMIT, count, -1.0, 1.0, steps
        if chunks > 0 and general:
            margin = min(margin, _margin(blocks))
            _accept(blocks, chunks)
        elif chunks > 0:
            _accept(blocks, chunks)
            e1 = take(out, D)
            e2 = cross(take(out, T), e1)
            det, half_trace = round_margin(take3(blocks, S0), take3(blocks, S1), e1, e2)
            margin = min(margin, min(det, half_trace))
        for q in range(STATE):
            y[q] = work[q] = out[q]
