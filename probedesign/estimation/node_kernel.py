"""One pose of a tracked touch as a row of numbers, compiled: its mean reading, its push, and what that makes of it.

`pressed.py` and `equations.py` do the same with names; tests/estimation/test_tracker.py holds the two together.
"""

import math
from pathlib import Path

from probedesign.estimation import press_kernel
from probedesign.estimation.press_kernel import press_at
from probedesign.rod.kernels.body import BEND_X, BEND_Y, CONSTANTS, LOAD, SHEAR, STRETCH, TWIST, Body
from probedesign.rod.kernels.compiled import drop_stale, inner, kernel
from probedesign.rod.kernels.steps import BLOCK, COLUMN, STATE, WIDE
from probedesign.rod.kernels.steps import WORK as STEP_WORK
from probedesign.rod.kernels.vectors import add, cross, dot, put, take, times

drop_stale(Path(__file__).parent)

WRENCH, ROTATION, ORIGIN, GRAVITY, COUNT, TOUCHED, SHIFT = 0, 6, 15, 18, 21, 22, 23
"""The mean reading (6), pose of the base (3, 3), (3), gravity in base axes (3), readings, whether touched, and how far
the base was likely off there for itself (3)."""
PLACE, ANGLE, MAGNITUDE, FORCE, TIP, LOG_STIFFNESS = 26, 27, 28, 29, 32, 38
"""The push as it was linearised last, and the stiffness it was linearised at."""
MODELLED, BY_PLACE, BY_STIFFNESS = 39, 45, 63
"""The wrench it makes (6), by the fixed point (6, 3), and by log stiffness with that held (6)."""
FIXED, CONTACT, SURFACE = 69, 72, 75
"""Where the fixed point, the centreline's and the touched one are (3) each."""
BY_POINT, FIXED_BY_STIFFNESS, BY_PUSH, TOWARDS = 78, 87, 90, 102
"""The push by the fixed point (3, 3), that by log stiffness (3), the force by the push (3, 4), and what makes it
normal (3)."""
CONTACT_BY_POINT, CONTACT_BY_STIFFNESS = 105, 114
"""The centreline's point by the fixed one (3, 3), and by log stiffness with that held (3)."""
NODE = 117

UNKNOWNS = 7
"""The fixed point (3), log stiffness, the base's offset (3): as in `equations.py`."""
STIFFNESS, OFFSET = 3, 4
NEAREST, MOST_AROUND = 0.02, 0.5
"""Nearest to the base over the length, and the most that the push turns around in one step [rad]."""
_CHUNKS = -(-(3 + press_kernel.COLUMNS) // WIDE)
_CONTACT_ROOM = STATE + WIDE * COLUMN * _CHUNKS
_ROOM = LOAD + STEP_WORK + _CHUNKS * BLOCK + STATE + _CONTACT_ROOM + 3 * press_kernel.COLUMNS
WORK = _ROOM + 15 * (press_kernel.COLUMNS + 1) + 27 + press_kernel.ANSWER + CONSTANTS + 24
"""Numbers that linearising works in."""


@kernel
def admit(wrench, T, gravity_world, sensor_from_base, hanging, most, gravity):
    """Whether such a reading can be: finite, within the sensor's range, at a pose that is one.

    Args:
        wrench: at the base, (6,); T: of the base in the world, (4, 4).
        gravity_world: [m/s²], (3,).
        sensor_from_base, hanging, most: as in `observe`.
        gravity: in base axes, filled, (3,).
    """
    for i in range(3):
        gravity[i] = 0.0
        for j in range(3):
            square = -1.0 if i == j else 0.0
            for q in range(3):
                square += T[i, q] * T[j, q]
            if not abs(square) <= 1e-6 or not math.isfinite(T[i, 3]) or not abs(T[3, i]) <= 1e-6:
                return False
            gravity[i] += T[j, i] * gravity_world[j]
    x, y = (T[0, 0], T[1, 0], T[2, 0]), (T[0, 1], T[1, 1], T[2, 1])
    if not dot(cross(x, y), (T[0, 2], T[1, 2], T[2, 2])) > 0.0 or not abs(T[3, 3] - 1.0) <= 1e-6:
        return False
    for i in range(6):
        told = 0.0
        for j in range(6):
            told += sensor_from_base[i, j] * wrench[j]
        for j in range(3):
            told += hanging[i, j] * gravity[j]
        if not abs(told) <= most[i] or not math.isfinite(wrench[i]):
            return False
    return True


@kernel
def apart(row, T):
    """How far a pose is from a node's [m]; a radian of turn counts as a tenth of a metre."""
    moved = turned = 0.0
    for i in range(3):
        moved += (T[i, 3] - row[ORIGIN + i]) ** 2
        for j in range(3):
            turned += (T[i, j] - row[ROTATION + 3 * i + j]) ** 2
    return math.sqrt(moved) + 0.1 * math.sqrt(0.5 * turned)


@kernel
def take_in(row, wrench, most):
    """One more reading into a node's mean, which counts no more than `most`."""
    row[COUNT] = min(row[COUNT] + 1.0, most)
    for q in range(6):
        row[WRENCH + q] += (wrench[q] - row[WRENCH + q]) / row[COUNT]


@inner
def from_world(row, v):
    """A vector of the world's in the node's base axes."""
    o = ROTATION
    x, y, z = take(row, o), take(row, o + 3), take(row, o + 6)
    return add(add(times(v[0], x), v[1], y), v[2], z)


@inner
def to_world(row, v):
    """A vector of the node's base in the world's axes."""
    o = ROTATION
    return (dot(take(row, o), v), dot(take(row, o + 3), v), dot(take(row, o + 6), v))


@inner
def seen_at(row, x):
    """Where the fixed point is seen from the node's base, that being off by the common offset alone."""
    p = from_world(row, add(take(x, 0), -1.0, take(row, ORIGIN)))
    return add(p, -1.0, take(x, OFFSET))


@inner
def _moved(row, x, end, around_by_force):
    """The push moved to where the unknowns put the fixed point, to first order."""
    more = x[STIFFNESS] - row[LOG_STIFFNESS]
    way = add(add(seen_at(row, x), 1.0, take(row, SHIFT)), -1.0, take(row, FIXED))
    way = add(way, -more, take(row, FIXED_BY_STIFFNESS))
    o = BY_POINT
    step = (dot(take(row, o), way), dot(take(row, o + 3), way), dot(take(row, o + 6), way))
    share = min(1.0, 0.1 * end / max(abs(step[0]), 1e-300))
    if not around_by_force:
        share = min(share, MOST_AROUND / max(abs(step[1]), 1e-300))
    for q in range(3):
        b = BY_PUSH + 4 * q
        by = row[b] * step[0] + row[b + 1] * step[1] + row[b + 2] * step[2] + row[b + 3] * more
        row[FORCE + q] += row[TOWARDS + q] + share * by
    row[PLACE] = min(max(row[PLACE] + share * step[0], NEAREST * end), end)
    if around_by_force:
        along, aside = row[MAGNITUDE] + share * step[2], share * step[1]
        row[ANGLE] += math.atan2(aside, along)
        row[MAGNITUDE] = math.sqrt(along * along + aside * aside)
    else:
        row[ANGLE] += share * step[1]
        row[MAGNITUDE] += share * step[2]


@kernel
def linearise(body, end, mass, x, move, around_by_force, row, work):
    """Solve a node's touch and linearise it.

    Args:
        body: of the rod; end: the furthest arclength at which a touch acts [m]; mass: of the flexible part [kg].
        x: the unknowns, (UNKNOWNS,).
        move: whether the push is first moved to where they put the fixed point, or taken as it stands.
        around_by_force: whether the centreline's point is the one that stands still.
        row: the node, (NODE,); only its push is changed where there is no equilibrium.
        work: (WORK,).

    Returns:
        Whether there is an equilibrium.
    """
    k = press_kernel.COLUMNS
    a = LOAD
    b = a + STEP_WORK
    c = b + _CHUNKS * BLOCK
    d = c + STATE
    e = d + _CONTACT_ROOM
    f = e + 3 * k
    g = f + 15 * (k + 1)
    h = g + 27
    i = h + press_kernel.ANSWER
    answer, constants = work[h:i], work[i : i + CONSTANTS]
    if move:
        _moved(row, x, end, around_by_force)
    softer = math.exp(-x[STIFFNESS])
    for q in range(CONSTANTS):
        constants[q] = body.constants[q]
    for q in (BEND_X, BEND_Y, TWIST, SHEAR, STRETCH):
        constants[q] *= softer
    soft = Body(body.knots, body.radii, body.volume_beyond, body.volume_by_knot, body.rest, constants)
    for q in range(LOAD):
        work[q] = 0.0
    if not press_at(
        soft, row[GRAVITY : GRAVITY + 3], row[PLACE], row[ANGLE], row[MAGNITUDE], row[FORCE : FORCE + 3],
        around_by_force, work[:a], work[a:b], work[h:h], work[b:c], work[c:d], work[d:e],
        work[e:f].reshape((3, k)), work[f:g].reshape((15, k + 1)), work[g:h], row[TIP : TIP + 6], answer,
    ):  # fmt: skip
        return False
    row[LOG_STIFFNESS] = x[STIFFNESS]
    _note(mass, around_by_force, answer, work[i + CONSTANTS :], row)
    return True


@inner
def _note(mass, around_by_force, answer, work, row):
    """What a press answered, told by the fixed point instead of by the push."""
    kernel_point = press_kernel.D_POINT if around_by_force else press_kernel.D_SURFACE
    put(row, CONTACT, take(answer, press_kernel.POINT))
    put(row, SURFACE, take(answer, press_kernel.SURFACE))
    put(row, FIXED, take(row, CONTACT if around_by_force else SURFACE))
    for q in range(3):
        row[TOWARDS + q] = answer[press_kernel.TOWARDS + q]
        row[MODELLED + q] = row[FORCE + q] + row[TOWARDS + q] + mass * row[GRAVITY + q]
        row[MODELLED + 3 + q] = answer[press_kernel.MOMENT + q]
        row[FIXED_BY_STIFFNESS + q] = answer[kernel_point + 4 * q + 3]
        for j in range(4):
            row[BY_PUSH + 4 * q + j] = answer[press_kernel.D_FORCE + 4 * q + j]
    _inverted(answer, kernel_point, work, row)
    for q in range(9):  # force, moment, and the centreline's point
        by = press_kernel.D_FORCE + 4 * q if q < 3 else press_kernel.D_MOMENT + 4 * (q - 3)
        by = press_kernel.D_POINT + 4 * (q - 6) if q >= 6 else by
        place = BY_PLACE + 3 * q if q < 6 else CONTACT_BY_POINT + 3 * (q - 6)
        held = answer[by + 3]
        for j in range(3):
            row[place + j] = 0.0
            for u in range(3):
                row[place + j] += answer[by + u] * row[BY_POINT + 3 * u + j]
            held -= row[place + j] * row[FIXED_BY_STIFFNESS + j]
        row[BY_STIFFNESS + q if q < 6 else CONTACT_BY_STIFFNESS + q - 6] = held


@inner
def _inverted(answer, by_push, work, row):
    """The push by the fixed point, from the fixed point by the push; columns scaled: metres beside newtons."""
    A, V, size = work[0:9], work[9:18], work[18:21]
    for j in range(3):
        square = 0.0
        for q in range(3):
            square += answer[by_push + 4 * q + j] ** 2
        size[j] = math.sqrt(square) + 1e-300
        for q in range(3):
            A[3 * q + j] = answer[by_push + 4 * q + j] / size[j]
    press_kernel.inverted(A, V)
    for j in range(3):
        for q in range(3):
            row[BY_POINT + 3 * j + q] = V[3 * j + q] / size[j]
