"""The rod's equations, docs/decisions/0001: what a section yields, the state's slopes, and those of a column.

In base axes, with n, m what the material beyond s does to the material before it:

    n = F [s ≤ s_c] + ρ V(s) g                                         closed form, V(s) the volume beyond s
    p' = t + (n - t (t·n))/(k G A) + ε t,   ε = e + h₂ (e² + c₅ f B),   e = t·n/(E A)
    m' = -p' × n
    ω  = R (f β diag(1/(E I_xx), 1/(E I_yy), 1/(f β G J)) Rᵀ m + u_rest),   R = [d, t × d, t]
    t' = ω × t,  d' = ω × d

f(s) is the bonded root, docs/decisions/0006: bending compliance is missing near the clamp. β and h₂ are the
finite strain of a round section, β = 1 + h₂ (3 e + c₄ B) with B = (m⊥ r/(E I))², h₂ = 0 for linear elasticity.

A column is how all that moves with a parameter: the section turns by θ (δR = θ × R), the moment by v, the
point by q. What turns with the section drops out, so with w = v - θ × m and z = δn - θ × n its slopes are those
of the compliances alone:

    θ' = ∂ω/∂m w + ∂ω/∂n z + δω,   q' = θ × p' + ∂p'/∂n z + ∂p'/∂m w + δp',   v' = -q' × n - p' × δn

with δω, δp' from the section's own change (E, G, radius, f).
"""

from probedesign.rod.kernels.body import (
    BEND_X,
    BEND_Y,
    CONE,
    DENSITY,
    FINITE_BEND,
    FINITE_STRETCH,
    ROOT_DEPTH,
    ROOT_REACH,
    SHEAR,
    STRETCH,
    TWIST,
)
from probedesign.rod.kernels.compiled import inlined
from probedesign.rod.kernels.vectors import add, cross, dot, minus, take, times


@inlined
def frustum_of(body, i, in_root):
    """What `medium` needs of frustum i, taken out of the arrays once for many steps.

    Args:
        in_root: whether the steps lie where the clamp still stiffens.
    """
    above, r1 = body.knots[i + 1], body.radii[i + 1]
    slope = (body.radii[i] - r1) / (above - body.knots[i])
    c = body.constants
    volume, rho = body.volume_beyond[i + 1], c[DENSITY]
    bends = (c[BEND_X], c[BEND_Y] - c[BEND_X], c[TWIST])
    root = (c[ROOT_DEPTH] if in_root else 0.0, 1.0 / c[ROOT_REACH])
    finite = (c[FINITE_BEND], c[FINITE_STRETCH], 1.0 if c[FINITE_BEND] > 0.0 else 0.0)
    return above, r1, slope, rho * volume, rho * c[CONE], bends, c[SHEAR], c[STRETCH], root, finite


@inlined
def medium(s, frustum, force, gravity):
    """What a frustum is at s, and the internal force there.

    Args:
        force: beyond s, (3,): the contact's on its base's side.
        gravity: (3,).

    Returns:
        f/EI_xx, f (1/EI_yy - 1/EI_xx), 1/GJ, 1/kGA, 1/EA, ρ V(s), c₄ (r/EI)² and c₅ f (r/EI)² or zeros, 3 h₂, n.
    """
    above, r1, slope, beyond, cone, bends, shear, stretch, root, finite = frustum
    height = above - s
    r = r1 + slope * height
    weight = beyond + cone * height * (r * r + r * r1 + r1 * r1)
    thin = 1.0 / (r * r)
    soft = thin * thin
    x = 1.0 - s * root[1]
    f = 1.0 - root[0] * (x * x * x)
    c = soft * bends[0]
    large = c * c * r * r
    n = add(force, weight, gravity)
    return (
        f * c,
        f * soft * bends[1],
        soft * bends[2],
        thin * shear,
        thin * stretch,
        weight,
        finite[0] * large,
        finite[1] * f * large,
        3.0 * finite[2],
        n,
    )


@inlined
def rest_of(body, i):
    """Curvature and twist of the unloaded rod in frustum i: at its upper knot, and per length below; section axes."""
    height = body.knots[i + 1] - body.knots[i]
    at, below = take(body.rest, 3 * i + 3), take(body.rest, 3 * i)
    return body.knots[i + 1], at, times(1.0 / height, minus(below, at))


@inlined
def rest_at(s, rest):
    """The same at s."""
    above, at, slope = rest
    return add(at, above - s, slope)


@inlined
def _strains(t, m, med):
    """t·m, e, β, and the strain ε along the axis."""
    _cx, _cyx, _gj, _a, b, _weight, c4, c5, three, n = med
    tm, e = dot(t, m), b * dot(t, n)
    square = dot(m, m) - tm * tm
    return tm, e, 1.0 + three * e + c4 * square, e + three * e * e * (1.0 / 3.0) + c5 * square


@inlined
def round_slopes(t, m, med):
    """t', m', p' of a round straight rod: they need no section axes."""
    cx, _cyx, _gj, a, _b, _weight, _c4, _c5, _three, n = med
    _tm, _e, beta, epsilon = _strains(t, m, med)
    along = 1.0 + epsilon - a * dot(t, n)
    return times(beta * cx, cross(m, t)), times(along, cross(n, t)), add(times(along, t), a, n)


@inlined
def turning(t, m, d, e_y, rest, med):
    """ω of any rod; of a round straight one whatever d and e_y are."""
    cx, cyx, gj, _a, _b, _weight, _c4, _c5, _three, _n = med
    tm, _e, beta, _epsilon = _strains(t, m, med)
    turn = add(times(beta * cx, m), beta * cyx * dot(e_y, m) + rest[1], e_y)
    return add(add(turn, (gj - beta * cx) * tm + rest[2], t), rest[0], d)


@inlined
def full_slopes(t, m, d, e_y, rest, med):
    """t', m', p', d' of any rod; e_y = t × d."""
    _cx, _cyx, _gj, a, _b, _weight, _c4, _c5, _three, n = med
    _tm, _e, _beta, epsilon = _strains(t, m, med)
    along = 1.0 + epsilon - a * dot(t, n)
    turn = turning(t, m, d, e_y, rest, med)
    return cross(turn, t), times(along, cross(n, t)), add(times(along, t), a, n), cross(turn, d)


@inlined
def yielding(t, m, e_y, med):
    """Of one place of the rod, what all columns share: how it bends, and what softening it would do.

    Returns:
        f S m⊥ (how it bends), β, ∂ε/∂e, and the turn and the strain that a logarithm of E, G, radius and f take away
        or (f) add.
    """
    cx, cyx, gj, a, _b, _weight, c4, c5, three, n = med
    tm, e, beta, _epsilon = _strains(t, m, med)
    tn = dot(t, n)
    square = dot(m, m) - tm * tm
    bend = add(add(times(cx, m), cyx * dot(e_y, m), e_y), -cx * tm, t)
    by_e = 1.0 + three * e * (2.0 / 3.0)
    twist, across = times(gj * tm, t), times(a, add(n, -tn, t))
    turn_E = times(beta + three * e + 2.0 * c4 * square, bend)
    turn_r = add(times(4.0 * beta + 2.0 * three * e + 6.0 * c4 * square, bend), 4.0, twist)
    strain_E, strain_r = e * by_e + 2.0 * c5 * square, 2.0 * e * by_e + 6.0 * c5 * square
    point_r = add(times(strain_r, t), 2.0, across)
    turns = (turn_E, twist, turn_r, times(beta, bend))
    return bend, beta, by_e, turns, (times(strain_E, t), across, point_r, times(c5 * square, t))


@inlined
def round_yields(t, m, med):
    """What `yielding` says of bending alone, at a place of a round straight rod."""
    cx, _cyx, _gj, _a, _b, _weight, _c4, _c5, three, _n = med
    tm, e, beta, _epsilon = _strains(t, m, med)
    return times(cx, add(m, -tm, t)), beta, 1.0 + three * e * (2.0 / 3.0)


@inlined
def round_column_slopes(theta, w, z, t, m, p1, med, yields):
    """θ' and q' of a column whose section neither changes nor knows direction; z = δn - θ × n, w = v - θ × m."""
    cx, _cyx, gj, a, b, _weight, c4, c5, three, _n = med
    bend, beta, by_e = yields
    tw, tz = dot(t, w), dot(t, z)
    mw = 2.0 * (dot(m, w) - dot(t, m) * tw)
    turn = add(times(beta * cx, w), (gj - beta * cx) * tw, t)
    turn = add(turn, three * b * tz + c4 * mw, bend)
    return turn, add(add(cross(theta, p1), a, z), (by_e * b - a) * tz + c5 * mw, t)


@inlined
def column_slopes(theta, v, z, t, m, p1, e_y, med, yields):
    """The same of any rod."""
    w = minus(v, cross(theta, m))
    turn, q1 = round_column_slopes(theta, w, z, t, m, p1, med, yields)
    return add(turn, yields[1] * med[1] * dot(e_y, w), e_y), q1


@inlined
def changed(turn, q1, yields, log_E, log_G, log_r, log_f):
    """θ' and q' with the section's own change."""
    turns, points = yields
    turn = add(add(turn, -log_E, turns[0]), -log_G, turns[1])
    turn = add(add(turn, -log_r, turns[2]), log_f, turns[3])
    q1 = add(add(q1, -log_E, points[0]), -log_G, points[1])
    return turn, add(add(q1, -log_r, points[2]), log_f, points[3])
