"""Sweep in lanes: step control, and integration from the tip over contact, knots and root to the base."""

import math

import numpy as np

from probedesign.rod.kernels import inline_always, inlined, inner
from probedesign.rod.kernels import lanes as rows
from probedesign.rod.kernels.equations import (
    COUPLE,
    FORCE,
    GRAVITY,
    LOAD,
    ROOT_REACH,
    S_CONTACT,
    TIP_MOMENT,
    Body,
    frustum_of,
    full_margin,
    rest_of,
    round_margin,
)
from probedesign.rod.kernels.lanes import (
    GOING,
    HUGE,
    STOPPED,
    STUCK,
    full_lanes_step,
    full_tips_step,
    put_frustum,
    put_row3,
    round_lanes_step,
    round_tips_step,
    row3,
)
from probedesign.rod.kernels.linalg import add, cross, dot, plus, take
from probedesign.rod.kernels.steps import MAX_STEPS, MAX_TRIES, MIN_STEP, STATE, WIDE, D, M, P, T

SOLVER_STATE = np.dtype([
    ("tip", "f8", 6), ("load", "f8", LOAD), ("passed", "f8"), ("frustum", "f8"), ("contact", "f8", STATE),
    ("base", "f8", STATE), ("first_step", "f8"), ("first_allowed", "f8"), ("allowed", "f8"), ("size", "f8"),
    ("with_tips", "f8"),
    ("turns", "f8"), ("until", "f8"), ("reach", "f8"), ("away", "f8"), ("first_residual", "f8"), ("status", "f8"),
    ("turned", "f8"), ("margin", "f8"), ("guess", "f8", 6), ("inverse", "f8", 9),
    ("steps", "f8"), ("fraction", "f8"), ("fraction_1", "f8"), ("fraction_2", "f8"), ("goal", "f8"),
    ("increment", "f8"), ("moment_first", "f8"), ("path_tips", "f8", 18), ("whole_load", "f8", LOAD),
    ("phase", "f8"), ("start", "f8"), ("careful", "f8"), ("tolerance", "f8"), ("residual", "f8"),
    ("residual_before", "f8"), ("polishes", "f8"), ("growth", "f8"),
])  # fmt: skip
"""State of the solver for one case.

Of the sweep: the tip's section and the load; whether the contact is passed, the frustum, the states at the contact and
at the base; the first step that the sweep before found and the error that was allowed it; the error allowed a step of
the sweep to come, relative to how far the rod turns, at most 1 (`size`), and whether it takes the tip's columns along.

Of Newton's method (`newton`): sweeps so far, the turn of the tip [rad] that is small enough, how far the tip may come
from its guess and how far it came, the first residual [rad], the status, how far the rod turned, the margin of
stability, the guessed tip, and the matrix that gives the tip's turn from the base's residual, (3, 3).

Of the load path: steps of all its sweeps, fractions of the load solved last, one before and two before that, the
fraction tried and how much to add, whether the tip moment is applied first, the tips of those three, the whole load.

Of the search: its phase, where it starts from, whether this is the second try along the path, the sweeps' tolerance,
residual at the base now and before [rad], sweeps of polishing, and how much a turn of the tip grows on its way.
"""


@inner
def choose(lanes):
    """Set the step of each lane: to its stop if that is about as far as the step."""
    for lane in range(WIDE):
        left = lanes[WIDE * rows.STOP + lane] - lanes[WIDE * rows.S + lane]
        h = lanes[WIDE * rows.H + lane]
        # A step up to 10 % longer avoids a tiny step after it.
        lanes[WIDE * rows.TRIED + lane] = left if 1.1 * h <= left else h


@inlined
def _larger(a, b):
    return a if a > b else b


@inlined
def _smaller(a, b):
    return a if a < b else b


@inlined
def _root(x):
    """Return about x^(1/6), as x^(1/8 + 1/32) by square roots, which every machine rounds alike."""
    eighth = math.sqrt(math.sqrt(math.sqrt(x)))
    return eighth * math.sqrt(math.sqrt(eighth))


@inlined
def _state_error(lanes, lane, bend):
    """Return the largest error over the error allowed; HUGE where a number is not finite.

    Errors of tangents [rad] and of moments, by the bend they cause, are relative to how far the rod turns at all, so
    that a bend of a micrometre keeps its digits; those of points are relative to the length.
    """
    et, em, ep = row3(lanes, rows.ERRORS, lane)
    tol, size, length = (
        lanes[WIDE * rows.TOL + lane],
        lanes[WIDE * rows.SIZE + lane],
        lanes[WIDE * rows.LENGTH + lane],
    )
    error = _larger(_larger(et, bend * em) / size, ep / length) / tol
    return error if et + em + ep < math.inf else HUGE


@inlined
def _tips_error(lanes, lane, c, bend):
    """Return the same for column c of the tip, with a thousand times the tolerance, at most 1e-2.

    On a straight rod nothing else sees the steps, and long ones would pass over conjugate points.
    """
    a, o = row3(lanes, rows.TIPS + c, lane), WIDE * (rows.TIPS_ERRORS + c // 3) + lane
    loose = _smaller(1000.0 * lanes[WIDE * rows.TOL + lane], 1e-2)
    size = _larger(1.0, abs(a[0]) + abs(a[1]) + abs(a[2]))
    theta, v = lanes[o], lanes[o + WIDE]
    error = _larger(theta, bend * v) / (size * loose)
    return error if theta + v < math.inf else HUGE


@inlined
def _full_margin(lanes, lane):
    """Return the margin of any rod after a step; negative too if two fields turned over within the step."""
    a, b, c = (
        row3(lanes, rows.TIPS, lane),
        row3(lanes, rows.TIPS + rows.TURN, lane),
        row3(lanes, rows.TIPS + 2 * rows.TURN, lane),
    )
    x, y, z = (
        row3(lanes, rows.TIPS_NEXT, lane),
        row3(lanes, rows.TIPS_NEXT + rows.TURN, lane),
        row3(lanes, rows.TIPS_NEXT + 2 * rows.TURN, lane),
    )
    trace, minors, det = full_margin(a, b, c, x, y, z)
    return det if _smaller(trace, minors) > 0.0 else -abs(det)


@inlined
def _carried(e, t, new):
    """Return the normal e of the tangent t, transported to the tangent `new` without rotation about it."""
    return add(e, -dot(e, new) / (1.0 + dot(t, new)), plus(t, new))


@inlined
def _bend(lanes, lane):
    """Return the rotation [rad] by 1 N·m of a body with the section here over its whole length."""
    a, b = row3(lanes, rows.FRUSTUM, lane), row3(lanes, rows.FRUSTUM + 3, lane)
    r = a[1] + a[2] * (a[0] - lanes[WIDE * rows.S + lane])
    return b[2] * lanes[WIDE * rows.LENGTH + lane] / (r * r * r * r)


@inner
def judge_tips(lanes, general):
    """Set the columns' error of each lane."""
    for lane in range(WIDE):
        bend = _bend(lanes, lane)
        error = _larger(_tips_error(lanes, lane, rows.COLUMN1, bend), _tips_error(lanes, lane, rows.COLUMN2, bend))
        if general:
            error = _larger(error, _tips_error(lanes, lane, rows.COLUMN3, bend))
        lanes[WIDE * rows.TIPS_ERROR + lane] = error if lanes[WIDE * rows.WANTS_TIPS + lane] > 0.0 else 0.0


@inner
def judge(lanes, tips):
    """Accept or reject the step of each lane, and choose its next step from the error."""
    for lane in range(WIDE):
        s, h, tried = (lanes[WIDE * rows.S + lane], lanes[WIDE * rows.H + lane], lanes[WIDE * rows.TRIED + lane])
        stop, length = lanes[WIDE * rows.STOP + lane], lanes[WIDE * rows.LENGTH + lane]
        error = _larger(
            _state_error(lanes, lane, _bend(lanes, lane)), lanes[WIDE * rows.TIPS_ERROR + lane] if tips else 0.0
        )
        good, last = error <= 1.0, tried == stop - s
        # Order 6: the error goes with h⁶. 0.9 keeps most next steps acceptable; growth and reduction are limited
        # because the error is known to first order only.
        factor = _smaller(5.0, _larger(0.1, 0.9 / _root(_larger(error, 1e-6))))
        # A step cut short by a stop gives no estimate of the next one.
        keeps = good and last and factor > 1.0 and tried > h
        h = h if keeps else tried * factor
        tries = 0.0 if good else lanes[WIDE * rows.TRIES + lane] + 1.0
        steps = lanes[WIDE * rows.STEPS + lane] + 1.0
        stuck = (not good and (tries >= MAX_TRIES or -h < MIN_STEP * length)) or steps > lanes[
            WIDE * rows.STEP_BUDGET + lane
        ]
        first = lanes[WIDE * rows.FIRST_STEP + lane]
        lanes[WIDE * rows.FIRST_STEP + lane] = tried * _smaller(1.0, factor) if s == length else first
        lanes[WIDE * rows.GOOD + lane] = 1.0 if good else 0.0
        lanes[WIDE * rows.S + lane] = (stop if last else s + tried) if good else s
        lanes[WIDE * rows.H + lane], lanes[WIDE * rows.TRIES + lane], lanes[WIDE * rows.STEPS + lane] = (
            h,
            tries,
            steps,
        )
        lanes[WIDE * rows.EVENT + lane] = STUCK if stuck else STOPPED if good and last else GOING


@inlined
def _take3(lanes, lane, row, to, good):
    """Set three rows to the result of the step if it is accepted."""
    a, b = row3(lanes, to, lane), row3(lanes, row, lane)
    put_row3(lanes, row, lane, (a[0] if good else b[0], a[1] if good else b[1], a[2] if good else b[2]))


@inner
def take_tips(lanes, general):
    """Set the columns to the result of accepted steps, and update the stability margin."""
    for lane in range(WIDE):
        good = lanes[WIDE * rows.GOOD + lane] > 0.0
        before = lanes[WIDE * rows.MARGIN + lane]
        if general:
            margin = _full_margin(lanes, lane)
        else:
            t, new = row3(lanes, T, lane), row3(lanes, rows.NEXT, lane)
            e1 = _carried(row3(lanes, rows.E1, lane), t, new)
            e2 = _carried(row3(lanes, rows.E2, lane), t, new)
            a, b = row3(lanes, rows.TIPS_NEXT, lane), row3(lanes, rows.TIPS_NEXT + rows.TURN, lane)
            det, half_trace = round_margin(a, b, e1, e2)
            margin = _smaller(det, half_trace)
            a, b = row3(lanes, rows.E1, lane), row3(lanes, rows.E2, lane)
            put_row3(lanes, rows.E1, lane, (e1[0] if good else a[0], e1[1] if good else a[1], e1[2] if good else a[2]))
            put_row3(lanes, rows.E2, lane, (e2[0] if good else b[0], e2[1] if good else b[1], e2[2] if good else b[2]))
        lanes[WIDE * rows.MARGIN + lane] = _smaller(before, margin) if good else before
        for c in range(0, 12, 3):
            _take3(lanes, lane, rows.TIPS + c, rows.TIPS_NEXT + c, good)
        if general:
            _take3(lanes, lane, rows.TIPS + 12, rows.TIPS_NEXT + 12, good)
            _take3(lanes, lane, rows.TIPS + 15, rows.TIPS_NEXT + 15, good)


@inner
def take_states(lanes, general):
    """Set the states to the result of accepted steps."""
    for lane in range(WIDE):
        good = lanes[WIDE * rows.GOOD + lane] > 0.0
        new, before = row3(lanes, rows.NEXT, lane), lanes[WIDE * rows.BEND + lane]
        turned = math.sqrt(new[0] * new[0] + new[1] * new[1] + (new[2] - 1.0) ** 2)
        lanes[WIDE * rows.BEND + lane] = _larger(before, turned) if good else before
        for c in range(0, 9, 3):
            _take3(lanes, lane, c, rows.NEXT + c, good)
        if general:
            _take3(lanes, lane, 9, rows.NEXT + 9, good)


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
def _pass_contact(lanes, lane, state):
    """Add the couple at the contact, and apply its force from here on."""
    put_row3(lanes, M, lane, plus(row3(lanes, M, lane), take(state.load, COUPLE)))
    put_row3(lanes, rows.FORCE, lane, take(state.load, FORCE))
    state.passed = 1.0
    for q in range(STATE):
        state.contact[q] = lanes[WIDE * q + lane]


@inner
def arrive(lanes, lane, state, body, general):
    """Update a lane at a stop: force, frustum and the next stop.

    Returns:
        Whether this is the base.
    """
    s, s_c = lanes[WIDE * rows.S + lane], state.load[S_CONTACT]
    if state.passed == 0.0 and s <= s_c:
        _pass_contact(lanes, lane, state)
    if s <= 0.0:
        state.first_step = lanes[WIDE * rows.FIRST_STEP + lane]
        return True
    i = int(state.frustum)
    while i > 0 and s <= body.knots[i]:
        i -= 1
    state.frustum = i
    reach = body.constants[ROOT_REACH]
    put_frustum(lanes, lane, frustum_of(body, i, s <= reach))
    if general:
        _above, at, slope = rest_of(body, i)
        put_row3(lanes, rows.REST, lane, at)
        put_row3(lanes, rows.REST + 3, lane, slope)
    ahead = s_c if state.passed == 0.0 else 0.0
    put_row(lanes, rows.STOP, lane, max(body.knots[i], ahead, 0.0 if s <= reach else reach))
    put_row(lanes, rows.EVENT, lane, GOING)
    return False


@inlined
def intend(state, within, of_size, with_tips):
    """Set the next sweep: the error allowed per step, relative to the size; 1 with the tip's columns, else 0."""
    state.allowed, state.size, state.with_tips = within, of_size, with_tips


@inlined
def _first_step(state, length, allowed):
    """Return the first step that the previous sweep would have taken with this error allowed."""
    first = -length / 6.0
    if state.first_allowed > 0.0:
        first = max(first, state.first_step * (allowed / state.first_allowed) ** (1.0 / 6.0))
    state.first_allowed, state.first_step = allowed, first
    return first


@inner
def launch(lanes, lane, state, body, general):
    """Start the sweep that the solver state describes, from the tip."""
    tol, size = state.allowed, state.size
    t, d, length = take(state.tip, 0), take(state.tip, 3), body.knots[-1]
    e = cross(t, d)
    put_row3(lanes, T, lane, t)
    put_row3(lanes, M, lane, take(state.load, TIP_MOMENT))
    put_row3(lanes, P, lane, (0.0, 0.0, 0.0))
    put_row3(lanes, D, lane, d)
    for row, axis in ((rows.TIPS, d), (rows.TIPS + rows.TURN, e), (rows.TIPS + 2 * rows.TURN, t)):
        put_row3(lanes, row, lane, axis)
        put_row3(lanes, row + 3, lane, (0.0, 0.0, 0.0))
    put_row3(lanes, rows.E1, lane, d)
    put_row3(lanes, rows.E2, lane, e)
    put_row(lanes, rows.WANTS_TIPS, lane, state.with_tips)
    put_row(lanes, rows.MARGIN, lane, 1.0)
    # A straight rod has a size of 1e-9, so that errors relative to it stay finite.
    put_row(lanes, rows.BEND, lane, max(1e-9, math.sqrt(t[0] * t[0] + t[1] * t[1] + (t[2] - 1.0) ** 2)))
    put_row(lanes, rows.TOL, lane, tol)
    put_row(lanes, rows.SIZE, lane, size)
    put_row(lanes, rows.LENGTH, lane, length)
    put_row(lanes, rows.STEP_BUDGET, lane, MAX_STEPS * max(1.0, (1e-7 / tol) ** (1.0 / 6.0)))
    put_row(lanes, rows.S, lane, length)
    put_row(lanes, rows.H, lane, _first_step(state, length, tol * size))
    put_row(lanes, rows.STEPS, lane, 0.0)
    put_row(lanes, rows.TRIES, lane, 0.0)
    put_row3(lanes, rows.FORCE, lane, (0.0, 0.0, 0.0))
    put_row3(lanes, rows.GRAVITY, lane, take(state.load, GRAVITY))
    state.passed, state.frustum = 0.0, body.knots.shape[0] - 2
    arrive(lanes, lane, state, body, general)


@inline_always
def tick(lanes, directed, tips):
    """Take one step in every lane.

    Args:
        directed: None for round straight rods, so that the code for others is compiled only where it is used; else 0.
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
