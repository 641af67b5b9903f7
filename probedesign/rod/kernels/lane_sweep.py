"""Sweep in a lane: integrate from the tip over contact, knots and root to the base."""

import math

from probedesign.rod.kernels.compiled import inline_always, inlined, inner
from probedesign.rod.kernels.equations import (
    COUPLE,
    FORCE,
    GRAVITY,
    ROOT_REACH,
    S_CONTACT,
    TIP_MOMENT,
    Body,
    frustum_of,
    rest_of,
)
from probedesign.rod.kernels.lanes import (
    BEND,
    E1,
    E2,
    EVENT,
    FIRST_STEP,
    GOING,
    LENGTH,
    MARGIN,
    REST,
    SIZE,
    STEP_BUDGET,
    STEPS,
    STOP,
    TIPS,
    TOL,
    TRIES,
    TURN,
    WANTS_TIPS,
    H,
    S,
    choose,
    full_lanes_step,
    full_tips_step,
    judge,
    judge_tips,
    put_frustum,
    put_row3,
    round_lanes_step,
    round_tips_step,
    row3,
    take_states,
    take_tips,
)
from probedesign.rod.kernels.lanes import (
    FORCE as FORCE_ROW,
)
from probedesign.rod.kernels.lanes import (
    GRAVITY as GRAVITY_ROW,
)
from probedesign.rod.kernels.linalg import cross, plus, take
from probedesign.rod.kernels.steps import STATE, WIDE, D, M, P, T

MAX_STEPS = 1000
"""Of one sweep at an error of 1e-7 a step; more where it is less: a hang is not an answer."""

TIP, LOAD_NOW, PASSED, KNOT, BEGIN, ALLOWED, WITHIN, OF_SIZE, WITH_TIPS, SEEN = (
    0,
    6,
    19,
    20,
    21,
    22,
    23,
    24,
    25,
    26,
)
"""Offsets in a case's solver state: the tip's section, the load, whether the contact is passed, the frustum, the
first step of the sweep before and the error that was allowed it; of the one to come the error allowed a step,
relative to how far the rod turns, at most 1, and whether it takes the tip's columns along; the state at the contact."""
SWEEP = SEEN + STATE


@inlined
def body_of(bodies, b):
    """Return one of the bodies whose arrays are stacked."""
    return Body(
        bodies.knots[b],
        bodies.radii[b],
        bodies.volume_beyond[b],
        bodies.volume_by_knot[b],
        bodies.rest[b],
        bodies.constants[b],
    )


@inlined
def put_row(lanes, row, lane, x):
    """Set one row of a lane."""
    lanes[WIDE * row + lane] = x


@inlined
def _pass_contact(lanes, lane, state, o):
    """Add the couple at the contact, and apply its force from here on."""
    put_row3(lanes, M, lane, plus(row3(lanes, M, lane), take(state, o + LOAD_NOW + COUPLE)))
    put_row3(lanes, FORCE_ROW, lane, take(state, o + LOAD_NOW + FORCE))
    state[o + PASSED] = 1.0
    for q in range(STATE):
        state[o + SEEN + q] = lanes[WIDE * q + lane]


@inner
def arrive(lanes, lane, state, o, body, general):
    """Update a lane at a stop: force, frustum and the next stop.

    Returns:
        Whether this is the base.
    """
    s, s_c = lanes[WIDE * S + lane], state[o + LOAD_NOW + S_CONTACT]
    if state[o + PASSED] == 0.0 and s <= s_c:
        _pass_contact(lanes, lane, state, o)
    if s <= 0.0:
        state[o + BEGIN] = lanes[WIDE * FIRST_STEP + lane]
        return True
    i = int(state[o + KNOT])
    while i > 0 and s <= body.knots[i]:
        i -= 1
    state[o + KNOT] = i
    reach = body.constants[ROOT_REACH]
    put_frustum(lanes, lane, frustum_of(body, i, s <= reach))
    if general:
        _above, at, slope = rest_of(body, i)
        put_row3(lanes, REST, lane, at)
        put_row3(lanes, REST + 3, lane, slope)
    ahead = s_c if state[o + PASSED] == 0.0 else 0.0
    put_row(lanes, STOP, lane, max(body.knots[i], ahead, 0.0 if s <= reach else reach))
    put_row(lanes, EVENT, lane, GOING)
    return False


@inlined
def intend(state, o, within, of_size, with_tips):
    """Set the next sweep: the error allowed per step, relative to the size; 1 with the tip's columns, else 0."""
    state[o + WITHIN], state[o + OF_SIZE], state[o + WITH_TIPS] = within, of_size, with_tips


@inlined
def _first_step(state, o, length, allowed):
    """Return the first step that the previous sweep would have taken with this error allowed."""
    first = -length / 6.0
    if state[o + ALLOWED] > 0.0:
        first = max(first, state[o + BEGIN] * (allowed / state[o + ALLOWED]) ** (1.0 / 6.0))
    state[o + ALLOWED], state[o + BEGIN] = allowed, first
    return first


@inner
def launch(lanes, lane, state, o, body, general):
    """Start the sweep that the solver state describes, from the tip."""
    tol, size = state[o + WITHIN], state[o + OF_SIZE]
    t, d, length = take(state, o + TIP), take(state, o + TIP + 3), body.knots[-1]
    e = cross(t, d)
    put_row3(lanes, T, lane, t)
    put_row3(lanes, M, lane, take(state, o + LOAD_NOW + TIP_MOMENT))
    put_row3(lanes, P, lane, (0.0, 0.0, 0.0))
    put_row3(lanes, D, lane, d)
    for row, axis in ((TIPS, d), (TIPS + TURN, e), (TIPS + 2 * TURN, t)):
        put_row3(lanes, row, lane, axis)
        put_row3(lanes, row + 3, lane, (0.0, 0.0, 0.0))
    put_row3(lanes, E1, lane, d)
    put_row3(lanes, E2, lane, e)
    put_row(lanes, WANTS_TIPS, lane, state[o + WITH_TIPS])
    put_row(lanes, MARGIN, lane, 1.0)
    put_row(lanes, BEND, lane, max(1e-9, math.sqrt(t[0] * t[0] + t[1] * t[1] + (t[2] - 1.0) ** 2)))
    put_row(lanes, TOL, lane, tol)
    put_row(lanes, SIZE, lane, size)
    put_row(lanes, LENGTH, lane, length)
    put_row(lanes, STEP_BUDGET, lane, MAX_STEPS * max(1.0, (1e-7 / tol) ** (1.0 / 6.0)))
    put_row(lanes, S, lane, length)
    put_row(lanes, H, lane, _first_step(state, o, length, tol * size))
    put_row(lanes, STEPS, lane, 0.0)
    put_row(lanes, TRIES, lane, 0.0)
    put_row3(lanes, FORCE_ROW, lane, (0.0, 0.0, 0.0))
    put_row3(lanes, GRAVITY_ROW, lane, take(state, o + LOAD_NOW + GRAVITY))
    state[o + PASSED], state[o + KNOT] = 0.0, body.knots.shape[0] - 2
    arrive(lanes, lane, state, o, body, general)


@inline_always
def tick(lanes, directed, tips):
    """Take one step in every lane.

    Args:
        directed: None for round straight rods, so that nobody compiles for others what he does not use; else 0.
        tips: whether a lane wants the tip's columns.
    """
    choose(lanes)
    if directed is None:
        round_lanes_step(lanes)
        if tips:
            round_tips_step(lanes)
    else:
        full_lanes_step(lanes)
        if tips:
            full_tips_step(lanes)
    general = directed is not None
    if tips:
        judge_tips(lanes, general)
    judge(lanes, tips)
    if tips:
        take_tips(lanes, general)
    take_states(lanes, general)
