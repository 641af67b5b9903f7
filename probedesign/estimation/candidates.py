"""Places where a contact may be, from one integration of the probe from its clamp with the measured wrench.

Up to the contact such a rod is the touched probe itself. Beyond it only the weight of the free part makes a moment;
where the integrated moment equals that, the contact may be. Nothing is iterated, so this costs less than one
equilibrium. Its errors grow with those of the reading, the more the thinner the probe gets, and it takes the free part
for as it is at rest: good for a start, not for an estimate.
"""

import math

from probedesign.rod.kernels import inner
from probedesign.rod.kernels.equations import (
    CONE,
    DENSITY,
    FLATNESS,
    ROOT_REACH,
    frustum_at,
    frustum_of,
    rest_at,
    rest_of,
    section_properties,
    turning,
)
from probedesign.rod.kernels.linalg import add, cross, dot, put, take, times
from probedesign.rod.kernels.newton import put_section
from probedesign.rod.kernels.steps import STATE as WIDTH
from probedesign.rod.kernels.steps import D, M, P, T, full_step
from probedesign.rod.kernels.surface_contact import (
    ALONG,
    AROUND,
    DEAD,
    NORMAL,
    PHI,
    TIP,
    S,
    offset_along,
    outline_at,
    radius_and_slope,
)

#: Stations evaluated at equal distances along the probe, as many as the scan of `force_moment` has at most.
STATIONS = 33
#: Numbers that a trace works in, and one more for each knot: states, misfits, first volume moments beyond stations of a
#: curved rod in section axes, whether it is curved, first volume moments beyond the knots of a straight one.
FREE = STATIONS * (WIDTH + 3)
CURVED = FREE + 3 * STATIONS
ROOM = CURVED + 1
ROUGH = 1e-3  #: Error of a step [rad] from which it is halved, and how often at most.
_HALVINGS = 4
#: Cosine of the turn from one station to the next, a 32nd of the probe, at which the trace ends: beyond the contact the
#: measured moment curls the thin tip up.
CURLED = 0.5
MODEL = 0.01  #: Error of the contact's moment by the model, over force and distance, beside the reading's; assumed.
DROOPS = 8  #: Steps along the free part.
#: Share of a force that friction around the section usually has, and has at most, in a guess.
USUAL, MAX_SINE = 0.6, 0.9
MIN_PUSH = 0.2  #: Share of a force that a guess takes for normal at least.


@inner
def is_curved(body):
    """Return whether a rod is curved at rest."""
    curved = False
    for q in range(body.rest.shape[0]):
        curved = curved or body.rest[q] != 0.0
    return curved


@inner
def _hanging(body, s, room):
    """Return the first moment of the mass beyond s about s [kg m] in section axes, with the free part as at rest."""
    if room[CURVED] != 0.0:
        x = s / body.knots[-1] * (STATIONS - 1)
        j = min(int(x), STATIONS - 2)
        low, high = take(room, FREE + 3 * j), take(room, FREE + 3 * j + 3)
        return times(body.constants[DENSITY], add(times(1.0 - x + j, low), x - j, high))
    i = frustum_at(body, s)
    height, r1 = body.knots[i + 1] - s, body.radii[i + 1]
    r = radius_and_slope(body, s)[0]
    inner_part = body.constants[CONE] * height * height * (r * r + 2.0 * r * r1 + 3.0 * r1 * r1) / 4.0
    along = room[ROOM + i + 1] + body.volume_beyond[i + 1] * height + inner_part
    return 0.0, 0.0, body.constants[DENSITY] * along


@inner
def _free_moment(body, s, t, d, gravity, room):
    """Return the moment about s of the weight beyond, where the section is t, d [N m]."""
    x, y, z = _hanging(body, s, room)
    return cross(add(add(times(x, d), y, cross(t, d)), z, t), gravity)


@inner
def _volume_moments(body, room):
    """Fill in the first moments of the volume beyond each knot of a straight rod, or each station of a curved one [m⁴].

    In section axes that of a curved rod is c with c' = -V e_z - u × c, V the volume beyond and u the curvature at rest,
    integrated from the tip by midpoints.
    """
    last, room[CURVED] = body.knots.shape[0] - 1, 1.0 if is_curved(body) else 0.0
    if room[CURVED] == 0.0:
        room[ROOM + last] = 0.0
        for i in range(last - 1, -1, -1):
            height, r, r1 = body.knots[i + 1] - body.knots[i], body.radii[i], body.radii[i + 1]
            inner_part = body.constants[CONE] * height * height * (r * r + 2.0 * r * r1 + 3.0 * r1 * r1) / 4.0
            room[ROOM + i] = room[ROOM + i + 1] + body.volume_beyond[i + 1] * height + inner_part
        return
    h = body.knots[-1] / (STATIONS - 1)
    put(room, FREE + 3 * (STATIONS - 1), (0.0, 0.0, 0.0))
    for j in range(STATIONS - 1, 0, -1):
        c = take(room, FREE + 3 * j)
        half = add(c, 0.5 * h, _growth(body, h * j, c))
        put(room, FREE + 3 * j - 3, add(c, h, _growth(body, h * (j - 0.5), half)))


@inner
def _growth(body, s, c):
    """Return by how much the first moment c of a curved rod grows towards the base at s, V e_z + u × c."""
    i = frustum_at(body, s)
    height, r1 = body.knots[i + 1] - s, body.radii[i + 1]
    r = radius_and_slope(body, s)[0]
    beyond = body.volume_beyond[i + 1] + body.constants[CONE] * height * (r * r + r * r1 + r1 * r1)
    return add((0.0, 0.0, beyond), 1.0, cross(rest_at(s, rest_of(body, i)), c))


@inner
def _carry(body, s, end, work, force, gravity, on):
    """Integrate the state in work from s on to `end`, over knots and the root's edge; whether it stays finite."""
    i, reach = 0, body.constants[ROOT_REACH]
    while s < end:
        while i + 2 < body.knots.shape[0] and s >= body.knots[i + 1]:
            i += 1
        in_root = s < reach
        stop = min(end, body.knots[i + 1] if i + 2 < body.knots.shape[0] else end)
        stop = min(stop, reach) if in_root else stop
        frustum, rest = frustum_of(body, i, in_root), rest_of(body, i)
        h = stop - s
        for halved in range(_HALVINGS + 1):
            et, _em, _ep = full_step(s, h, work, frustum, rest, force, gravity, on)
            if et <= ROUGH or halved == _HALVINGS:
                break
            h *= 0.5
        if not et < 1.0:
            return False
        for q in range(WIDTH):
            work[q] = work[WIDTH + q]
        s = stop if h == stop - s else s + h
    return True


@inner
def trace(body, end, gravity, force, moment, std_force, std_moment, arm, work, room):
    """Integrate the probe from its clamp with the measured wrench.

    What the moment has more than the free part makes vanishes at a contact. Of a straight rod it is left as it is. On a
    curved one its part along p(s) does not depend on the force, M·p(s) = 0, and is known better than the others: it is
    divided by its standard deviations, so that a root of that equation is a minimum even where the force disagrees.

    Args:
        body: of the rod; end: the furthest arclength at which a touch acts [m], where the last station lies.
        gravity: [m/s²], (3,) tuple; force: of the contact [N], moment: read at the base [N·m], (3,) tuples.
        std_force, std_moment: of the reading's channels [N, N·m]; arm: of friction around the section over the radius.
        work: scratch of a step, (steps.WORK,).
        room: (ROOM + knots,): states at the stations, then what the moment there is more than the free part makes.

    Returns:
        How many stations were reached.
    """
    _volume_moments(body, room)
    put(work, T, (0.0, 0.0, 1.0))
    put(work, M, moment)
    put(work, P, (0.0, 0.0, 0.0))
    put(work, D, (1.0, 0.0, 0.0))
    for j in range(STATIONS):
        s = end * j / (STATIONS - 1)
        if j and not _carry(body, end * (j - 1) / (STATIONS - 1), s, work, force, gravity, 1.0):
            return j
        if j and dot(take(work, T), take(room, WIDTH * (j - 1) + T)) < CURLED:
            return j
        for q in range(WIDTH):
            room[WIDTH * j + q] = work[q]
        free = _free_moment(body, s, take(work, T), take(work, D), gravity, room)
        misfit = add(take(work, M), -1.0, free)
        if room[CURVED] != 0.0:
            p = take(work, P)
            reach = max(math.sqrt(dot(p, p)), 1e-300)
            size = math.sqrt(dot(force, force))
            square = std_moment * std_moment + (MODEL * size * reach) ** 2
            across = 1.0 / math.sqrt(square + std_force * std_force * reach * reach)
            more, t = (1.0 / math.sqrt(square) - across) / (reach * reach), take(work, T)
            misfit = add(times(across, misfit), more * dot(misfit, p), p)
            # The couple of friction is about the tangent: its whitened column c, of one standard deviation.
            c = times(arm * size * radius_and_slope(body, s)[0], add(times(across, t), more * dot(t, p), p))
            known = dot(c, c)
            share = (1.0 / math.sqrt(1.0 + known) - 1.0) / max(known, 1e-300)
            misfit = add(misfit, share * dot(misfit, c), c)
        put(room, STATIONS * WIDTH + 3 * j, misfit)
    return STATIONS


@inner
def _misfit(room, j):
    off = take(room, STATIONS * WIDTH + 3 * j)
    return dot(off, off)


@inner
def is_least(room, j, reached):
    """Return whether the misfit at station j is a local minimum or, on a curved probe, may hide one: where it grows by
    less than on both sides."""
    at = _misfit(room, j)
    before = at - _misfit(room, j - 1) if j > 0 else -math.inf
    after = _misfit(room, j + 1) - at if j + 1 < reached else math.inf
    if before <= 0.0 <= after or room[CURVED] == 0.0 or not 1 < j < reached - 2:
        return before <= 0.0 <= after
    if before > 0.0:
        return after < before and after < _misfit(room, j + 2) - _misfit(room, j + 1)
    return before > after and before > _misfit(room, j - 1) - _misfit(room, j - 2)


@inner
def least(end, room, j, reached):
    """Return the least misfit about station j [N·m], linear between stations, and its arclength [m]."""
    at, best, square = take(room, STATIONS * WIDTH + 3 * j), 0.0, _misfit(room, j)
    for way in (-1, 1):
        if 0 <= j + way < reached:
            slope = add(take(room, STATIONS * WIDTH + 3 * (j + way)), -1.0, at)
            x = min(max(-dot(at, slope) / max(dot(slope, slope), 1e-300), 0.0), 1.0)
            off = add(at, x, slope)
            if dot(off, off) < square:
                best, square = way * x, dot(off, off)
    return math.sqrt(square), end * (j + best) / (STATIONS - 1)


@inner
def _droop(body, s, gravity, room, state):
    """Turn a section, [t, d] in state, from s to the tip, the free part hanging from it; by midpoints.

    Its moment is taken from what lies beyond each place, not carried along: carried through the thin tip, the
    smallest error would bend that to a ring.
    """
    h = (body.knots[-1] - s) / DROOPS
    for _ in range(DROOPS):
        t, d = take(state, TIP), take(state, TIP + 3)
        turn = _hang(body, s, t, d, gravity, room)
        half_t, half_d = add(t, 0.5 * h, cross(turn, t)), add(d, 0.5 * h, cross(turn, d))
        turn = _hang(body, s + 0.5 * h, half_t, half_d, gravity, room)
        put_section(state[TIP:], add(t, h, cross(turn, half_t)), add(d, h, cross(turn, half_d)))
        s += h


@inner
def _hang(body, s, t, d, gravity, room):
    """Return the rate of turn of the free part by s where the section is t, d."""
    i = 0
    while i + 2 < body.knots.shape[0] and s >= body.knots[i + 1]:
        i += 1
    med = section_properties(s, frustum_of(body, i, s < body.constants[ROOT_REACH]), (0.0, 0.0, 0.0), gravity)
    m = _free_moment(body, s, t, d, gravity, room)
    return turning(t, m, d, cross(t, d), rest_at(s, rest_of(body, i)), med)


@inner
def guess(body, end, gravity, force, std_force, std_moment, work, room, s, reached, touch):
    """Fill in a guess (TOUCH,) of the contact whose line of action crosses the centreline at s; return whether there is
    one. std_force, std_moment: of the reading's channels [N, N·m]."""
    start = min(max(math.floor(s / end * (STATIONS - 1)), 0), reached - 1)
    for q in range(WIDTH):
        work[q] = room[WIDTH * start + q]
    if not _carry(body, end * start / (STATIONS - 1), s, work, force, gravity, 1.0):
        return False
    t, x_axis = take(work, T), take(work, D)
    twist = dot(add(take(work, M), -1.0, _free_moment(body, s, t, x_axis, gravity, room)), t)
    lever = cross(take(work, P), t)  # of the force about the tangent: short on a straight probe
    known_twist = math.sqrt(std_moment * std_moment + std_force * std_force * dot(lever, lever))
    place_touch(body, end, s, force, t, x_axis, twist, known_twist, touch)
    put(touch, TIP, t)
    put(touch, TIP + 3, x_axis)
    _droop(body, s, gravity, room, touch)
    return True


@inner
def place_touch(body, end, s, force, t, x_axis, twist, known_twist, touch):
    """Fill a touch (but for its tip) whose force comes nearest to the centreline at s where the section is t, x_axis.

    The force points away from the touched side of the section, but for the friction around it. It acts at the point
    r (cos ψ, f sin ψ) of the outline, whose normal has tan φ = tan ψ/f: across the section with size w and direction
    β it twists by r w (cos ψ sin β - f sin ψ cos β) = r w D sin(γ - ψ), which has one ψ on the pushed side. Where the
    twist is less well known than by the friction, it is taken towards that of no friction.
    """
    y_axis = cross(t, x_axis)
    across = add(force, -dot(force, t), t)
    size = math.sqrt(dot(force, force))
    wide = math.sqrt(dot(across, across))
    # A force along the tangent to 1e-6 has no direction around the section.
    x, y = (dot(across, x_axis) / wide, dot(across, y_axis) / wide) if wide > 1e-6 * size else (-1.0, 0.0)
    f, couple = body.constants[FLATNESS], max(radius_and_slope(body, s)[0] * wide, 1e-300)
    full, gamma, free = math.sqrt(y * y + f * f * x * x), math.atan2(y, f * x), math.atan2(-f * y, -x)
    frictionless = full * math.sin(gamma - free)
    known = (twist / couple - frictionless) / (1.0 + (known_twist / (USUAL * couple)) ** 2)
    psi = gamma - math.pi + math.asin(min(max((frictionless + known) / full, -MAX_SINE), MAX_SINE))
    phi = math.atan2(math.sin(psi), f * math.cos(psi))
    e = add(times(math.cos(phi), x_axis), math.sin(phi), y_axis)
    around = cross(t, e)
    touch[S], touch[PHI] = s, phi
    for _ in range(2):  # the radius at the touched section differs from that at s by tan² α: twice is enough
        r, slope = radius_and_slope(body, touch[S])
        at = outline_at(body, slope, phi)
        touch[NORMAL] = max(-at.cos * dot(force, e) - at.sin * dot(force, t), MIN_PUSH * size)
        touch[AROUND] = dot(force, around) / max(touch[NORMAL], 1e-300)
        touch[ALONG] = (at.cos * dot(force, t) - at.sin * dot(force, e)) / max(touch[NORMAL], 1e-300)
        touch[S] = min(max(s - offset_along(r, at, touch)[0], 0.0), end)
    put(touch, DEAD, force)
    put(touch, DEAD + 3, cross(times(r, add(times(at.reach, e), at.aside, around)), force))
