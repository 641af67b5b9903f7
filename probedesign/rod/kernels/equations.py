"""The rod's data and equations (docs/decisions/0001): section properties, derivatives of state and sensitivities.

In base axes, with n, m what the material beyond s does to the material before it:

    n = F [s ≤ s_c] + ρ V(s) g                                         closed form, V(s) the volume beyond s
    p' = t + (n - t (t·n))/(k G A) + ε t,   ε = e + h₂ (e² + c₅ f B),   e = t·n/(E A)
    m' = -p' × n
    ω  = R (f β diag(1/(E I_xx), 1/(E I_yy), 1/(f β G J)) Rᵀ m + u_rest),   R = [d, t × d, t]
    t' = ω × t,  d' = ω × d

f(s) is the bonded root, docs/decisions/0006: it reduces the bending compliance near the clamp. β and h₂ are the
finite strain of a round section, β = 1 + h₂ (3 e + c₄ B) with B = (m⊥ r/(E I))², h₂ = 0 for linear elasticity.

A column is the derivative of the state by a parameter: the section rotates by θ (δR = θ × R), the moment changes by
v, the point by q. What rotates with the section drops out, so with w = v - θ × m and z = δn - θ × n its slopes are
those of the compliances alone:

    θ' = ∂ω/∂m w + ∂ω/∂n z + δω,   q' = θ × p' + ∂p'/∂n z + ∂p'/∂m w + δp',   v' = -q' × n - p' × δn

with δω, δp' from the section's own change (E, G, radius, f), and δω = R δu_rest.
"""

from typing import NamedTuple

from probedesign.core.frames import Array
from probedesign.rod.kernels import inlined, inner
from probedesign.rod.kernels.linalg import add, cross, dot, minus, take, times


class Body(NamedTuple):
    """A rod as arrays, in SI units."""

    knots: Array  #: arclengths where the taper changes [m], (K,).
    radii: Array  #: half-widths along the section's x axis at the knots [m], (K,).
    volume_beyond: Array  #: from each knot to the tip [m³], (K,).
    volume_by_knot: Array  #: its derivative by the logarithm of each knot's radius [m³], (K, K).
    rest: Array  #: curvature and twist of the unloaded rod at the knots, in section axes, linear between [1/m], (3 K,).
    constants: Array  #: see the indices below, (13,).


#: Compliances of a section of half-width 1 m in bending about x and about y, twist [m²/N], shear and stretch [m²/N];
#: density [kg/m³]; volume of a cone over r² h; 1 where bending is anisotropic or the rod is curved at rest, 0 where it
#: is round and straight.
BEND_X, BEND_Y, TWIST, SHEAR, STRETCH, DENSITY, CONE, GENERAL = range(8)
#: Depth and reach of the bonded root, f(s) = 1 - depth (1 - s/reach)³ up to the reach [m], 1 beyond.
ROOT_DEPTH, ROOT_REACH = 8, 9
FINITE_BEND, FINITE_STRETCH = 10, 11  #: c₄ and c₅ of the section's finite strain; zeros: linear elasticity.
FLATNESS = 12  #: Half-width of the outline along y over that along x.

LOAD = 13
#: Offsets in a load of force [N], gravity [m/s²], moment at the tip and couple at the contact [N·m], all dead and in
#: base axes, and s_contact [m].
FORCE, GRAVITY, TIP_MOMENT, COUPLE, S_CONTACT = 0, 3, 6, 9, 12

#: Parameters of the sensitivities; after these, the logarithm of the diameter at each knot. rest_x and rest_y are a
#: constant curvature of the unloaded rod about its section's x and y axes [1/m], added to that at the knots.
PARAMETERS = (
    "force_x", "force_y", "force_z", "s_contact", "couple_x", "couple_y", "couple_z",
    "gravity_x", "gravity_y", "gravity_z", "log_E", "log_G", "log_density", "log_diameter", "rest_x", "rest_y",
)  # fmt: skip
LOAD_COLUMNS = 4
CONTACT_COLUMNS = 7
ALL_COLUMNS = len(PARAMETERS)

OK, NOT_CONVERGED, UNSTABLE, STEP_LIMIT = 0, 1, 2, 3


@inner
def frustum_at(body, s):
    """Return the frustum that s lies in, the lower one at a knot."""
    i = 0
    while i + 2 < body.knots.shape[0] and s > body.knots[i + 1]:
        i += 1
    return i


@inlined
def frustum_of(body, i, in_root):
    """Return the data of frustum i for `section_properties`, read from the arrays once for many steps.

    Args:
        in_root: whether the steps are within the reach of the bonded root.
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
def section_properties(s, frustum, force, gravity):
    """Return the properties of a frustum's section at s, and the internal force there.

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
    """Return curvature and twist of the unloaded rod in frustum i: at its upper knot, and their slope; section axes."""
    height = body.knots[i + 1] - body.knots[i]
    at, below = take(body.rest, 3 * i + 3), take(body.rest, 3 * i)
    return body.knots[i + 1], at, times(1.0 / height, minus(below, at))


@inlined
def rest_at(s, rest):
    """Return curvature and twist of the unloaded rod at s."""
    above, at, slope = rest
    return add(at, above - s, slope)


@inlined
def _strains(t, m, med):
    """Return t·m, e, β and the strain ε along the axis.

    Each step of the integration waits for these numbers, so the terms are in the order of the shortest chain.
    """
    _cx, _cyx, _gj, _a, b, _weight, c4, c5, three, n = med
    tm, e = dot(t, m), b * dot(t, n)
    square = dot(m, m) - tm * tm
    return tm, e, (1.0 + c4 * square) + three * e, e * (1.0 + three * (1.0 / 3.0) * e) + c5 * square


@inlined
def round_slopes(t, m, med):
    """Return t', m', p' of a round straight rod, which need no section axes."""
    cx, _cyx, _gj, a, _b, _weight, _c4, _c5, _three, n = med
    _tm, _e, beta, epsilon = _strains(t, m, med)
    along = (1.0 - a * dot(t, n)) + epsilon
    return times(beta * cx, cross(m, t)), times(along, cross(n, t)), add(times(along, t), a, n)


@inlined
def turning(t, m, d, e_y, rest, med):
    """Return ω of any rod; of a round straight one it does not depend on d and e_y."""
    cx, cyx, gj, _a, _b, _weight, _c4, _c5, _three, _n = med
    tm, _e, beta, _epsilon = _strains(t, m, med)
    turn = add(times(beta * cx, m), beta * cyx * dot(e_y, m) + rest[1], e_y)
    return add(add(turn, (gj - beta * cx) * tm + rest[2], t), rest[0], d)


@inlined
def full_slopes(t, m, d, e_y, rest, med):
    """Return t', m', p', d' of any rod; e_y = t × d."""
    _cx, _cyx, _gj, a, _b, _weight, _c4, _c5, _three, n = med
    _tm, _e, _beta, epsilon = _strains(t, m, med)
    along = (1.0 - a * dot(t, n)) + epsilon
    turn = turning(t, m, d, e_y, rest, med)
    return cross(turn, t), times(along, cross(n, t)), add(times(along, t), a, n), cross(turn, d)


@inlined
def bending_compliance(t, m, e_y, med):
    """Return the local compliance that all columns share: f S m⊥ (the curvature by bending), β and ∂ε/∂e."""
    cx, cyx, _gj, _a, _b, _weight, _c4, _c5, three, _n = med
    tm, e, beta, _epsilon = _strains(t, m, med)
    bend = add(add(times(cx, m), cyx * dot(e_y, m), e_y), -cx * tm, t)
    return bend, beta, 1.0 + three * e * (2.0 / 3.0)


@inlined
def section_changes(t, m, med, bending):
    """Return derivatives of rotation and strain by log E, log G, log radius (subtracted) and log f (added)."""
    _cx, _cyx, gj, a, _b, _weight, c4, c5, three, n = med
    bend, beta, by_e = bending
    tm, e, _beta, _epsilon = _strains(t, m, med)
    tn = dot(t, n)
    square = dot(m, m) - tm * tm
    twist, across = times(gj * tm, t), times(a, add(n, -tn, t))
    turn_E = times(beta + three * e + 2.0 * c4 * square, bend)
    turn_r = add(times(4.0 * beta + 2.0 * three * e + 6.0 * c4 * square, bend), 4.0, twist)
    strain_E, strain_r = e * by_e + 2.0 * c5 * square, 2.0 * e * by_e + 6.0 * c5 * square
    point_r = add(times(strain_r, t), 2.0, across)
    turns = (turn_E, twist, turn_r, times(beta, bend))
    return turns, (times(strain_E, t), across, point_r, times(c5 * square, t))


@inlined
def round_compliance(t, m, med):
    """Return `bending_compliance` of a round straight rod, which needs no section axes."""
    cx, _cyx, _gj, _a, _b, _weight, _c4, _c5, three, _n = med
    tm, e, beta, _epsilon = _strains(t, m, med)
    return times(cx, add(m, -tm, t)), beta, 1.0 + three * e * (2.0 / 3.0)


@inlined
def round_column_slopes(theta, w, z, t, m, p1, med, compliances):
    """Return θ' and q' of a column for an isotropic, unchanged section; z = δn - θ × n, w = v - θ × m."""
    cx, _cyx, gj, a, b, _weight, c4, c5, three, _n = med
    bend, beta, by_e = compliances
    tw, tz = dot(t, w), dot(t, z)
    mw = dot(times(2.0, add(m, -dot(t, m), t)), w)
    turn = add(times(beta * cx, w), (gj - beta * cx) * tw, t)
    turn = add(turn, three * b * tz + c4 * mw, bend)
    return turn, add(add(cross(theta, p1), a, z), c5 * mw + (by_e * b - a) * tz, t)


@inlined
def column_slopes(theta, v, z, t, m, p1, e_y, med, compliances):
    """Return θ' and q' of a column for any unchanged section."""
    w = minus(v, cross(theta, m))
    turn, q1 = round_column_slopes(theta, w, z, t, m, p1, med, compliances)
    return add(turn, compliances[1] * med[1] * dot(e_y, w), e_y), q1


@inlined
def changed(turn, q1, changes, log_E, log_G, log_r, log_f):
    """Return θ' and q' including the change of the section; changes: `section_changes`."""
    turns, points = changes
    turn = add(add(turn, -log_E, turns[0]), -log_G, turns[1])
    turn = add(add(turn, -log_r, turns[2]), log_f, turns[3])
    q1 = add(add(q1, -log_E, points[0]), -log_G, points[1])
    return turn, add(add(q1, -log_r, points[2]), log_f, points[3])


@inlined
def round_margin(a, b, e1, e2):
    """Return determinant and half trace of the free tip's Jacobi fields of a round rod; the smaller is the margin.

    They are the identity at the tip. The first zero of the determinant is a point conjugate to the free end; the second
    variation of the energy is positive as long as there is none before the clamp. At a doubly degenerate one (a
    straight column) the determinant stays positive, but the trace changes its sign.

    Args:
        a, b: rotations of the section by unit rotations of the tip about its x and y axes, (3,).
        e1, e2: two normals of the tangent that do not rotate about it, (3,).
    """
    xx, xy, yx, yy = dot(a, e1), dot(b, e1), dot(a, e2), dot(b, e2)
    return xx * yy - xy * yx, 0.5 * (xx + yy)


@inlined
def full_margin(a, b, c, x, y, z):
    """Return trace, sum of minors and determinant that decide the stability of any rod over one step.

    The step takes the Jacobi fields A = (a, b, c) to B = (x, y, z). Where two eigenvalues of B A⁻¹ become negative, its
    determinant stays positive, but its trace or the sum of its minors does not; unlike those of A or B they do not
    depend on axes.
    """
    trace = dot(x, cross(b, c)) + dot(y, cross(c, a)) + dot(z, cross(a, b))
    minors = dot(a, cross(y, z)) + dot(b, cross(z, x)) + dot(c, cross(x, y))
    return trace, minors, dot(x, cross(y, z))
