"""The compiled rod: sweeps from the free tip to the base with exact sensitivities, and the solve on top of them.

Formulation (docs/decisions/0001). For a straight, round, initially untwisted rod the paper's equations 1
and 2 close in base axes on the tangent t and the moment m alone:

    n(s) = F [s < s_c] + ρ V(s) g                    closed form, V(s) the volume beyond s
    p'   = t + (n - t (t·n))/(k G A) + t (t·n)/(E A)
    m'   = -p' × n
    t'   = m × t/(E I)
    d'   = ω × d,  ω = (m - t (t·m))/(E I) + t (t·m)/(G J)      d: the section's x axis, for output

At the free tip m is known (zero, or the tip moment), so the unknown is the tip's tangent: two numbers.
The residual is the base's tangent, which the clamp holds at e_z. Columns of the tangent-linear equations
ride along each step, so Jacobian and sensitivities are those of the very numbers computed.

Steps: Verner's 6(5) pair, eight stages, step size by its error estimate. Source: J. H. Verner, SIAM
J. Numer. Anal. 15 (1978) 772-790; the pair known as DVERK.
Its order conditions are checked in tests/rod/test_order.py.

Everything here works on flat arrays, allocates nothing and calls only this file (numba's cache does not
see a change in another file).
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from probedesign.frames import Array

# Blocks of the state. A block is [t, m] while Newton runs and [t, m, p, d] in the last sweep.
# Block 0 is the state, blocks 1 and 2 its derivatives by the tip's tangent, the rest by parameters:
PARAMETERS = (
    "force_x", "force_y", "force_z", "s_contact", "gravity_x", "gravity_y", "gravity_z",
    "log_E", "log_G", "log_density", "log_diameter",
)  # fmt: skip
LOAD_COLUMNS = 4  # the first four: force and s_contact
ALL_COLUMNS = len(PARAMETERS)

OK, NOT_CONVERGED, UNSTABLE, STEP_LIMIT = 0, 1, 2, 3


class Body(NamedTuple):
    """What a rod is made of, as arrays for the kernels.

    Attributes:
        knots: arclengths where the taper changes [m], (K,).
        radii: at the knots [m], (K,).
        volume_beyond: from each knot to the tip [m³], (K,).
        material: [E, G, shear coefficient, density, rigid length, 1 if extensible and shearable else 0].
    """

    knots: Array
    radii: Array
    volume_beyond: Array
    material: Array


# load = [Fx, Fy, Fz, gx, gy, gz, Mx, My, Mz of the tip moment, s_c]

_C = np.array([0.0, 1 / 6, 4 / 15, 2 / 3, 5 / 6, 1.0, 1 / 15, 1.0])
_A = np.zeros((8, 7))
_A[1, :1] = [1 / 6]
_A[2, :2] = [4 / 75, 16 / 75]
_A[3, :3] = [5 / 6, -8 / 3, 5 / 2]
_A[4, :4] = [-165 / 64, 55 / 6, -425 / 64, 85 / 96]
_A[5, :5] = [12 / 5, -8.0, 4015 / 612, -11 / 36, 88 / 255]
_A[6, :5] = [-8263 / 15000, 124 / 75, -643 / 680, -81 / 250, 2484 / 10625]
_A[7, :7] = [3501 / 1720, -300 / 43, 297275 / 52632, -319 / 2322, 24068 / 84065, 0.0, 3850 / 26703]
_B = np.array([3 / 40, 0.0, 875 / 2244, 23 / 72, 264 / 1955, 0.0, 125 / 11592, 43 / 616])
_B_LOW = np.array([13 / 160, 0.0, 2375 / 5984, 5 / 16, 12 / 85, 3 / 44, 0.0, 0.0])
_E = _B - _B_LOW

ROUNDING = 4e-15  # of a step's change, below which an error estimate says nothing
CAREFUL_TOLERANCE = 1e-9  # of a second try along the path
MAX_STEPS = 1000  # of one sweep at an error of 1e-7 a step; more where it is less: a hang is not an answer
COLD, WARM, WARM_ONLY = (
    0,
    1,
    2,
)  # start from no load; from a guess, else from no load; from a guess or not at all
SCRATCH = 9 * 12 * (3 + ALL_COLUMNS)  # doubles that `solve` works in
MAX_NEWTON = 12
MAX_TURN = (
    0.35  # largest turn of the tip [rad] between prediction and solution of a load step: keeps the branch
)
PATH_TOLERANCE = 1e-4  # of sweeps on the way to the whole load [rad]; only where they end is reported
MIN_LOAD_STEP = 1e-4
ACROSS = 0.5  # sine from which a force counts as across the free rod
ALONG = 0.26  # sine of 15°: a contact pushing closer to the surface would need a friction coefficient of 3.7


kernel = njit(cache=True, nogil=True, error_model="numpy")
"""Compiled once and cached; division by zero gives inf or NaN, which the step control refuses."""
inner = njit(cache=True, nogil=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
"""The same for what only kernels call."""


@inner
def _medium(s, i, body, load, on, rigid):
    """Compliances 1/EI, 1/GJ, 1/kGA, 1/EA at s in frustum i, the weight factor ρV and the internal force n."""
    knots, radii, volume_beyond, mat = body
    h = knots[i + 1] - s
    r1 = radii[i + 1]
    r = r1 + (radii[i] - r1) * h / (knots[i + 1] - knots[i])
    weight = mat[3] * (volume_beyond[i + 1] + math.pi / 3.0 * h * (r * r + r * r1 + r1 * r1))
    area = math.pi * r * r
    free = 0.0 if rigid else 1.0
    c = free * 4.0 / (mat[0] * area * r * r)
    gj = free * 2.0 / (mat[1] * area * r * r)
    a = mat[5] / (mat[2] * mat[1] * area)
    b = mat[5] / (mat[0] * area)
    nx = load[0] * on + weight * load[3]
    ny = load[1] * on + weight * load[4]
    nz = load[2] * on + weight * load[5]
    return c, gj, a, b, weight, nx, ny, nz


@inner
def _parameter(j, medium, load, on):
    """What parameter j does to n, 1/EI, 1/GJ, 1/kGA and 1/EA: (hx, hy, hz, dc, dgj, da, db)."""
    c, gj, a, b, weight, _nx, _ny, _nz = medium
    wx, wy, wz = weight * load[3], weight * load[4], weight * load[5]
    if j < 0 or j == 3:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    if j < 3:
        return on * (j == 0), on * (j == 1), on * (j == 2), 0.0, 0.0, 0.0, 0.0
    if j < 7:
        return weight * (j == 4), weight * (j == 5), weight * (j == 6), 0.0, 0.0, 0.0, 0.0
    if j == 7:
        return 0.0, 0.0, 0.0, -c, 0.0, 0.0, -b
    if j == 8:
        return 0.0, 0.0, 0.0, 0.0, -gj, -a, 0.0
    if j == 9:
        return wx, wy, wz, 0.0, 0.0, 0.0, 0.0
    return 2.0 * wx, 2.0 * wy, 2.0 * wz, -4.0 * c, -4.0 * gj, -2.0 * a, -2.0 * b


@inner
def _state_rates(y, f, nb, medium):
    """d/ds of the state block."""
    c, gj, a, b, _weight, nx, ny, nz = medium
    tx, ty, tz, mx, my, mz = y[0], y[1], y[2], y[3], y[4], y[5]
    stretch = (b - a) * (tx * nx + ty * ny + tz * nz)
    px, py, pz = tx + a * nx + stretch * tx, ty + a * ny + stretch * ty, tz + a * nz + stretch * tz
    f[0], f[1], f[2] = c * (my * tz - mz * ty), c * (mz * tx - mx * tz), c * (mx * ty - my * tx)
    f[3], f[4], f[5] = ny * pz - nz * py, nz * px - nx * pz, nx * py - ny * px
    if nb == 12:
        f[6], f[7], f[8] = px, py, pz
        twist = (gj - c) * (tx * mx + ty * my + tz * mz)
        wx, wy, wz = c * mx + twist * tx, c * my + twist * ty, c * mz + twist * tz
        dx, dy, dz = y[9], y[10], y[11]
        f[9], f[10], f[11] = wy * dz - wz * dy, wz * dx - wx * dz, wx * dy - wy * dx


@inner
def _column_rates(y, f, nb, o, j, medium, load, on):
    """d/ds of the column at offset o, the derivative by parameter j (j < 0: by the tip's tangent)."""
    c, gj, a, b, _weight, nx, ny, nz = medium
    hx, hy, hz, dc, dgj, da, db = _parameter(j, medium, load, on)
    tx, ty, tz, mx, my, mz = y[0], y[1], y[2], y[3], y[4], y[5]
    ux, uy, uz, vx, vy, vz = y[o], y[o + 1], y[o + 2], y[o + 3], y[o + 4], y[o + 5]
    tn = tx * nx + ty * ny + tz * nz
    ba = b - a
    stretch = 1.0 + ba * tn
    px, py, pz = a * nx + stretch * tx, a * ny + stretch * ty, a * nz + stretch * tz
    along = ba * (ux * nx + uy * ny + uz * nz + tx * hx + ty * hy + tz * hz) + (db - da) * tn
    gx = stretch * ux + a * hx + da * nx + along * tx
    gy = stretch * uy + a * hy + da * ny + along * ty
    gz = stretch * uz + a * hz + da * nz + along * tz
    f[o] = c * (vy * tz - vz * ty + my * uz - mz * uy) + dc * (my * tz - mz * ty)
    f[o + 1] = c * (vz * tx - vx * tz + mz * ux - mx * uz) + dc * (mz * tx - mx * tz)
    f[o + 2] = c * (vx * ty - vy * tx + mx * uy - my * ux) + dc * (mx * ty - my * tx)
    f[o + 3] = ny * gz - nz * gy + hy * pz - hz * py
    f[o + 4] = nz * gx - nx * gz + hz * px - hx * pz
    f[o + 5] = nx * gy - ny * gx + hx * py - hy * px
    if nb == 12:
        f[o + 6], f[o + 7], f[o + 8] = gx, gy, gz
        e, de = gj - c, dgj - dc
        tm = tx * mx + ty * my + tz * mz
        twist = e * (ux * mx + uy * my + uz * mz + tx * vx + ty * vy + tz * vz) + de * tm
        wx, wy, wz = c * mx + e * tm * tx, c * my + e * tm * ty, c * mz + e * tm * tz
        ox = c * vx + dc * mx + e * tm * ux + twist * tx
        oy = c * vy + dc * my + e * tm * uy + twist * ty
        oz = c * vz + dc * mz + e * tm * uz + twist * tz
        dx, dy, dz, kx, ky, kz = y[9], y[10], y[11], y[o + 9], y[o + 10], y[o + 11]
        f[o + 9] = wy * kz - wz * ky + oy * dz - oz * dy
        f[o + 10] = wz * kx - wx * kz + oz * dx - ox * dz
        f[o + 11] = wx * ky - wy * kx + ox * dy - oy * dx


@inner
def _rates(s, i, y, f, nb, blocks, body, load, on, rigid):
    """Right-hand side of the rod equations and of their columns, d/ds at s in frustum i, into f."""
    medium = _medium(s, i, body, load, on, rigid)
    _state_rates(y, f, nb, medium)
    for block in range(1, blocks):
        _column_rates(y, f, nb, nb * block, block - 3, medium, load, on)


@inner
def _combine(y, h, weights, k, count, n, out):
    """out = y + h Σ weights[j] k_j over the first `count` stages; the inner loop is a plain vector sum."""
    for q in range(n):
        out[q] = y[q]
    for j in range(count):
        w = h * weights[j]
        if w != 0.0:
            o = j * n
            for q in range(n):
                out[q] += w * k[o + q]


@inner
def _step(s, h, i, y, out, k, n, nb, blocks, body, load, on, rigid):
    """One step of Verner's pair from s by h (negative: towards the base); the stages are left in k."""
    _rates(s, i, y, k[:n], nb, blocks, body, load, on, rigid)
    for stage in range(1, 8):
        _combine(y, h, _A[stage], k, stage, n, out)
        _rates(s + _C[stage] * h, i, out, k[stage * n : (stage + 1) * n], nb, blocks, body, load, on, rigid)
    _combine(y, h, _B, k, 8, n, out)


@inner
def _estimate(h, k, n, q):
    """Error estimate of one component of a step, less what is only rounding of the stages' sum."""
    e = 0.0
    for j in range(8):
        e += _E[j] * k[j * n + q]
    e = abs(h * e)
    rounding = ROUNDING * abs(h) * (abs(k[q]) + abs(k[7 * n + q]))
    return e if not e <= rounding else 0.0  # NaN stays NaN


@inner
def _error(h, y, k, n, nb, bend, length, size, tol):
    """Largest error estimate of a step over what is allowed: at most 1 for a good step.

    Tangents [rad] and moments, by the bend they cause, are held relative to how far the rod turns at all
    (`size`), so that a bend of a micrometre keeps its digits; p and d hold the body's own size. The Jacobi
    fields are held too, a thousand times more loosely: on a straight rod nothing else sees the steps, and
    long ones would pass over conjugate points.
    """
    worst = 0.0
    for q in range(nb):
        if q < 6:
            scale = (bend if q >= 3 else 1.0) / size
        else:
            scale = 1.0 / length if q < 9 else 1.0
        e = _estimate(h, k, n, q) * scale / tol
        if not e <= worst:
            worst = e
    loose = min(1000.0 * tol, 1e-2)
    for o in range(nb, 3 * nb, nb):
        grown = max(1.0, abs(y[o]) + abs(y[o + 1]) + abs(y[o + 2])) * loose
        for q in range(o, o + 6):
            e = _estimate(h, k, n, q) * (bend if q >= o + 3 else 1.0) / grown
            if not e <= worst:
                worst = e
    return worst


@inner
def _advance(s, stop, h, i, y, out, k, n, nb, blocks, body, load, tol, size, on, rigid):
    """One accepted step towards `stop`: (new s, next step, tries), new s = NaN where none is accepted."""
    length = body.knots[-1]
    tries = 0
    while tries < 60:
        tries += 1
        last = s + 1.1 * h <= stop  # rather a slightly longer step than a sliver after it
        hs = stop - s if last else h
        _step(s, hs, i, y, out, k, n, nb, blocks, body, load, on, rigid)
        c = 4.0 / (body.material[0] * math.pi * max(_radius(s, i, body), 1e-300) ** 4)
        error = _error(hs, y, k, n, nb, c * length, length, size, tol)
        if error <= 1.0:
            factor = min(5.0, 0.9 * max(error, 1e-6) ** (-1.0 / 6.0))
            # A step cut short by a break says little of the step to take after it.
            return stop if last else s + hs, h if last and factor > 1.0 and hs > h else hs * factor, tries
        h = hs * (max(0.1, 0.9 * error ** (-1.0 / 6.0)) if math.isfinite(error) else 0.1)
        if -h < 1e-10 * length:
            break
    return math.nan, h, tries


@inner
def _radius(s, i, body):
    """Radius at s in frustum i."""
    x = (body.knots[i + 1] - s) / (body.knots[i + 1] - body.knots[i])
    return body.radii[i + 1] + (body.radii[i] - body.radii[i + 1]) * x


@inner
def _normals(t):
    """Two unit normals of t that make a right-handed frame with it; they span the unknowns at the tip."""
    if abs(t[0]) < 0.9:
        ex, ey, ez = 0.0, t[2], -t[1]
    else:
        ex, ey, ez = -t[2], 0.0, t[0]
    norm = math.sqrt(ex * ex + ey * ey + ez * ez)
    ex, ey, ez = ex / norm, ey / norm, ez / norm
    return ex, ey, ez, t[1] * ez - t[2] * ey, t[2] * ex - t[0] * ez, t[0] * ey - t[1] * ex


@inner
def _start(t, y, n, nb, load):
    """State and columns at the tip: tangent t, the tip moment, unit turns about the two normals."""
    for q in range(n):
        y[q] = 0.0
    e = _normals(t)
    for q in range(3):
        y[q] = t[q]
        y[3 + q] = load[6 + q]
        y[nb + q] = e[q]
        y[2 * nb + q] = e[3 + q]
        if nb == 12:
            y[9 + q] = e[q]
            y[nb + 9 + q] = -t[q]  # d stays a unit normal of t: δd = -t (δt·d)
    return e


@inner
def _carried(e, y, out):
    """The normals e of the tangent y carried to the tangent `out` without turning about it."""
    g = 1.0 + y[0] * out[0] + y[1] * out[1] + y[2] * out[2]
    w = (e[0] * out[0] + e[1] * out[1] + e[2] * out[2]) / g
    v = (e[3] * out[0] + e[4] * out[1] + e[5] * out[2]) / g
    zx, zy, zz = y[0] + out[0], y[1] + out[1], y[2] + out[2]
    return (e[0] - w * zx, e[1] - w * zy, e[2] - w * zz, e[3] - v * zx, e[4] - v * zy, e[5] - v * zz)


@inner
def _positive(e, y, nb):
    """Whether the Jacobi fields of the free tip, seen in the carried normals, have not yet vanished.

    They are the identity at the tip; where their determinant first vanishes lies a point conjugate to the
    free end, and the second variation of the energy is positive as long as there is none before the clamp.
    A doubly degenerate one (a straight column) keeps the determinant positive and turns the trace.
    """
    a = y[nb] * e[0] + y[nb + 1] * e[1] + y[nb + 2] * e[2]
    c = y[nb] * e[3] + y[nb + 1] * e[4] + y[nb + 2] * e[5]
    b = y[2 * nb] * e[0] + y[2 * nb + 1] * e[1] + y[2 * nb + 2] * e[2]
    d = y[2 * nb] * e[3] + y[2 * nb + 1] * e[4] + y[2 * nb + 2] * e[5]
    return a * d - b * c > 0.0 and a + d > 0.0


@inner
def _copy(n, source, target):
    """target[:n] = source[:n], without the text of an error message to compile."""
    for q in range(n):
        target[q] = source[q]


@inner
def _jump(s, i, y, column, change, k, n, body, load, on, on_below, rigid, rigid_below):
    """Add to a column what moving the break at s towards the tip does: change · (rate above - rate below)."""
    above, below = k[:n], k[n : 2 * n]
    _rates(s, i, y, above, 12, 1, body, load, on, rigid)
    _rates(s, i, y, below, 12, 1, body, load, on_below, rigid_below)
    for q in range(12):
        y[12 * column + q] += change * (above[q] - below[q])


@inner
def _cross(s, i, y, k, n, blocks, body, load, on, rigid):
    """Columns over the breaks at s: the contact moves with s_contact, the rigid root's end with the diameter."""
    s_c, rigid_end = load[9], body.material[4]
    for column in (6, 13):
        at_contact = column == 6
        here = (on == 0.0 and s <= s_c) if at_contact else (not rigid and s <= rigid_end)
        if here:
            on_below, rigid_below = (1.0, rigid) if at_contact else (on, True)
            if column < blocks:
                change = 1.0 if at_contact else rigid_end
                _jump(s, i, y, column, change, k, n, body, load, on, on_below, rigid, rigid_below)
            on, rigid = on_below, rigid_below
    return on, rigid


@kernel
def sweep(t_tip, y, k, out, nb, blocks, body, load, tol, size, nodes, contact):
    """Integrate from the tip to the base.

    Args:
        t_tip: tangent at the tip, (3,), unit.
        y: state and columns at the base on return, (n,), n = nb · blocks.
        k, out: scratch, (8 n,), (n,).
        nb: 6 or 12, size of a block; blocks: 3 + number of parameters.
        nodes: (m, 13) rows [s, t, m, p, d] from tip to base, filled if nb is 12.
        tol: error allowed a step, relative to size; size: how far the rod turns from the axis, at most 1.
        contact: state and columns at s_c, (n,), filled on passing it.

    Returns:
        status, nodes filled, whether the second variation is positive, how far the rod turned.
    """
    n = nb * blocks
    s_c, rigid_end = load[9], body.material[4]
    e = _start(t_tip, y, n, nb, load)
    i, s, h = body.knots.shape[0] - 2, body.knots[-1], -body.knots[-1] / 6.0
    most = MAX_STEPS * max(1.0, (1e-7 / tol) ** (1.0 / 6.0))
    on, rigid, stable, steps, count, bend = 0.0, False, True, 0, 0, 1e-9
    while True:
        reached = on == 0.0 and s <= s_c
        on, rigid = _cross(s, i, y, k, n, blocks, body, load, on, rigid)
        if reached:
            _copy(n, y, contact)
        if count < nodes.shape[0]:
            nodes[count, 0] = s
            _copy(12, y, nodes[count, 1:])
            count += 1
        bend = max(bend, math.sqrt(y[0] * y[0] + y[1] * y[1] + (y[2] - 1.0) ** 2))
        if s <= 0.0:
            return OK, count, stable, min(bend, 1.0)
        while i > 0 and s <= body.knots[i]:
            i -= 1
        stop = max(body.knots[i], s_c if on == 0.0 else 0.0, 0.0 if rigid else rigid_end)
        s, h, tries = _advance(s, stop, h, i, y, out, k, n, nb, blocks, body, load, tol, size, on, rigid)
        steps += tries
        if steps > most or math.isnan(s):
            return STEP_LIMIT, count, False, 1.0
        e = _carried(e, y, out)
        _copy(n, out, y)
        stable = stable and _positive(e, y, nb)


@inner
def _turn(t, nb, y):
    """Turn the tip tangent t by Newton's step, in place, at most 1 rad; the wanted angle, or -1 if none."""
    det = y[nb] * y[2 * nb + 1] - y[2 * nb] * y[nb + 1]
    if not abs(det) > 1e-300 or not math.isfinite(det):
        return -1.0
    alpha = (y[2 * nb] * y[1] - y[2 * nb + 1] * y[0]) / det
    beta = (y[nb + 1] * y[0] - y[nb] * y[1]) / det
    angle = math.sqrt(alpha * alpha + beta * beta)
    if not math.isfinite(angle):
        return -1.0
    e = _normals(t)
    shrink = min(1.0, 1.0 / max(angle, 1e-300))
    turned = shrink * angle
    co, si = math.cos(turned), math.sin(turned) / turned * shrink if turned > 0.0 else 0.0
    norm = 0.0
    for q in range(3):
        t[q] = co * t[q] + si * (alpha * e[q] + beta * e[3 + q])
        norm += t[q] * t[q]
    norm = math.sqrt(norm)
    for q in range(3):
        t[q] /= norm
    return angle


@inner
def _newton(t, scratch, body, load, tol, until, judged, reach):
    """Newton on the tip tangent t (3,), in place, until the next step would be below `until` [rad].

    Gives up as soon as t has left its guess by more than `reach` [rad].

    Returns:
        status, how far t came from its guess, or wanted to [rad], and how far the rod turned.
    """
    k, y, out, contact = scratch[:144], scratch[144:162], scratch[162:180], scratch[180:198]
    none = scratch[:0].reshape((0, 13))
    gx, gy, gz = t[0], t[1], t[2]
    away = 0.0
    for _ in range(MAX_NEWTON):
        status, _count, stable, bend = sweep(t, y, k, out, 6, 3, body, load, tol, 1.0, none, contact)
        if status != OK:
            return status, away, bend
        # The tip alone does not tell: what it lacks by a hair, a soft hanging rod lacks by turns at its base.
        clamped = y[2] > 0.0 and y[0] * y[0] + y[1] * y[1] < 100.0 * until * until
        angle = _turn(t, 6, y)
        away = math.sqrt((t[0] - gx) ** 2 + (t[1] - gy) ** 2 + (t[2] - gz) ** 2)
        if angle < 0.0 or angle > 1.0 or away > reach:
            return NOT_CONVERGED, max(away, angle), bend
        if angle < until and clamped:
            return (OK if stable or not judged else UNSTABLE), away, max(bend, min(angle, 1.0))
    return NOT_CONVERGED, away, 1.0


@inner
def _is_judged(load):
    """Dead forces and gravity have a potential; a dead moment has none, so no second variation judges it."""
    return load[6] == 0.0 and load[7] == 0.0 and load[8] == 0.0


@inner
def _extrapolate(t_old, t, ahead, out):
    """Unit tangent on from t_old over t by `ahead` times their distance."""
    norm = 0.0
    for q in range(3):
        out[q] = t[q] + ahead * (t[q] - t_old[q])
        norm += out[q] * out[q]
    norm = math.sqrt(norm)
    for q in range(3):
        out[q] /= norm


@inner
def _trace(t, scratch, body, load, tol, until, moment_first):
    """Follow the equilibrium from no load to the whole load; t (3,) is the tip tangent on return.

    Force, gravity and tip moment grow together, or the moment grows first and the others after it.
    """
    part, t_old, t_try = scratch[200:210], scratch[210:213], scratch[213:216]
    t[0], t[1], t[2] = 0.0, 0.0, 1.0
    _copy(3, t, t_old)
    judged = _is_judged(load)
    at, at_old, step, bend = 0.0, 0.0, 1.0, 1.0
    while at < 1.0:
        goal = min(1.0, at + step)
        for q in range(6):
            part[q] = (max(0.0, 2.0 * goal - 1.0) if moment_first else goal) * load[q]
        for q in range(6, 9):
            part[q] = (min(1.0, 2.0 * goal) if moment_first else goal) * load[q]
        part[9] = load[9]
        _extrapolate(t_old, t, (goal - at) / (at - at_old) if at > at_old else 0.0, t_try)
        close = until if goal >= 1.0 else 1e-2
        status, away, bend = _newton(t_try, scratch, body, part, tol, close, judged, MAX_TURN)
        if status == OK:
            _copy(3, t, t_old)
            _copy(3, t_try, t)
            at_old, at = at, goal
            step = 2.0 * step
        else:
            step = (goal - at) * max(0.2, min(0.5, 0.8 * MAX_TURN / max(away, 1e-9)))
            if step < MIN_LOAD_STEP:
                return status, bend
    return OK, bend


@inner
def _rounding(y):
    """What of the base's residual is only the tip's last digits, grown on the way [rad]."""
    growth = max(abs(y[12]), abs(y[13]), abs(y[24]), abs(y[25]))
    return 1e-14 * growth


@kernel
def solve(t, start, scratch, body, load, tol, until, columns, nodes, y, contact):
    """Find the equilibrium and sweep it once more with everything asked for.

    Args:
        t: tip tangent, (3,): a guess unless COLD, the solution on return.
        start: COLD, WARM or WARM_ONLY.
        scratch: (SCRATCH,).
        load: [force, gravity, tip moment, s_c], (10,), base axes, SI.
        tol: error allowed a step [rad]; until: residual allowed at the base [rad];
            both relative to how far the rod turns.
        columns: how many of PARAMETERS get sensitivities: 0, LOAD_COLUMNS or ALL_COLUMNS.
        nodes: (m, 13) for the shape, m may be 0.
        y, contact: states and columns at the base and at s_c, (12 · (3 + columns),).

    Returns:
        status, nodes filled, whether stable, residual at the base [rad].
    """
    path_tol = max(tol, PATH_TOLERANCE)
    judged = _is_judged(load)
    status, size = NOT_CONVERGED, 1.0
    if start != COLD:
        status, _away, size = _newton(t, scratch, body, load, path_tol, 1e-3, judged, MAX_TURN)
    if status != OK and start != WARM_ONLY:
        status, size = _trace(t, scratch, body, load, path_tol, 1e-3, False)
        if status != OK and judged:  # a very soft rod magnifies the errors of the steps themselves
            status, size = _trace(t, scratch, body, load, CAREFUL_TOLERANCE, 1e-3, False)
    if status != OK and start != WARM_ONLY and not judged:
        status, size = _trace(t, scratch, body, load, path_tol, 1e-3, True)
    if status != OK:
        return status, 0, False, math.inf
    n = 12 * (3 + columns)
    k, out = scratch[: 8 * n], scratch[8 * n : 9 * n]
    residual = math.inf
    for _ in range(6):
        status, count, stable, size = sweep(
            t, y, k, out, 12, 3 + columns, body, load, tol, size, nodes, contact
        )
        if status != OK:
            return status, 0, False, math.inf
        residual = math.sqrt(y[0] * y[0] + y[1] * y[1])
        if residual <= max(until * size, _rounding(y)) and y[2] > 0.0:
            return (OK if stable or not judged else UNSTABLE), count, stable, residual
        if _turn(t, 12, y) < 0.0:
            break
    return NOT_CONVERGED, 0, False, residual


@inner
def _square(load):
    """|F|² of a load."""
    return load[0] * load[0] + load[1] * load[1] + load[2] * load[2]


@inner
def _crosses(load, t, sine):
    """Whether the force makes at least that sine with the tangent t."""
    along = load[0] * t[0] + load[1] * t[1] + load[2] * t[2]
    return _square(load) - along * along > sine * sine * _square(load)


@kernel
def moments_along(stations, load, body, tol, scratch, moments, tips):
    """Base moment of one and the same force as it acts at each of `stations`, from the base outwards.

    Each equilibrium starts from its neighbour's, so the path is the one continuous from s_contact = 0,
    where the force bends nothing.

    Args:
        stations: increasing arclengths [m], (j,).
        load: as for `solve`, (10,); its s_c is set here.
        tol: error allowed a step [rad]. Newton stops at ten times as much: closer than the steps' own
            error the residual is no longer smooth, since steps are chosen anew each time.
        scratch: (SCRATCH,).
        moments, tips: base moment [N·m] and tip tangent of each, (j, 3).

    Returns:
        how many stations were reached. The path ends where there is no equilibrium, or where the force has
        bent the rod into its own direction: no contact short of the tip can push along the surface it touches.
    """
    t = scratch[220:223]
    across = True
    for j in range(stations.shape[0]):
        load[9] = stations[j]
        status = NOT_CONVERGED
        if j > 0:
            status, _away, _bend = _newton(t, scratch, body, load, tol, 10.0 * tol, True, 2.0 * MAX_TURN)
        if status != OK:
            status, _bend = _trace(t, scratch, body, load, tol, 10.0 * tol, False)
        if status != OK:
            return j
        if j == 0:  # a force at the clamp bends nothing: this is the free rod
            across = load[0] * load[0] + load[1] * load[1] > ACROSS**2 * _square(load) and _crosses(
                load, t, ACROSS
            )
        elif across and not _crosses(load, scratch[180:183], ALONG):
            return j
        for q in range(3):
            moments[j, q] = scratch[147 + q]
            tips[j, q] = t[q]
    return stations.shape[0]


@kernel
def states_at(s, nodes, count, body, load, scratch, result):
    """States [t, m, p, d] at arclengths s (j,), one step from the node above each; result (j, 12)."""
    k, out, y = scratch[:96], scratch[96:108], scratch[108:120]
    for j in range(s.shape[0]):
        row = 0
        while row + 1 < count and nodes[row + 1, 0] >= s[j]:
            row += 1
        at = nodes[row, 0]
        _copy(12, nodes[row, 1:], y)
        if at > s[j]:
            i = body.knots.shape[0] - 2
            while i > 0 and at <= body.knots[i]:
                i -= 1
            on = 1.0 if at <= load[9] else 0.0
            _step(at, s[j] - at, i, y, out, k, 12, 12, 1, body, load, on, at <= body.material[4])
            _copy(12, out, y)
        _copy(12, y, result[j])


@inner
def _solved_columns(y, columns, target, result):
    """Columns of `target` with the tip's tangent eliminated so that the base's tangent stays; into (12, columns)."""
    a, b, c, d = y[12], y[24], y[13], y[25]
    det = a * d - b * c
    for j in range(columns):
        o = 12 * (3 + j)
        alpha = -(d * y[o] - b * y[o + 1]) / det
        beta = -(a * y[o + 1] - c * y[o]) / det
        for q in range(12):
            result[q, j] = target[o + q] + alpha * target[12 + q] + beta * target[24 + q]


@kernel
def sensitivities(y, contact, columns, body, load, d_base, d_contact, frame):
    """Total derivatives of what the base feels and of where the contact is.

    Args:
        y, contact: as `solve` left them.
        columns: as given to `solve`.
        d_base: (3, columns) of the base moment.
        d_contact: (12, columns) of the contact's [t, x axis, position from the base, y axis].
        frame: (12,) those four themselves.

    The contact moves along the body with s_contact, so that column also holds the rate there.
    """
    work, rate = np.empty((12, columns)), np.empty(12)
    # The section's x axis was started anyhow at the tip; the turn that brings it to e_x at the base.
    norm = math.hypot(y[9], y[10])
    co, si = y[9] / norm, -y[10] / norm
    _solved_columns(y, columns, y, work)
    turn = np.empty(columns)
    p_base = np.empty((3, columns))
    for j in range(columns):
        for q in range(3):
            d_base[q, j] = work[3 + q, j]
            p_base[q, j] = work[6 + q, j]
        turn[j] = -(y[9] * work[10, j] - y[10] * work[9, j]) / (norm * norm)
    _solved_columns(y, columns, contact, work)
    i = body.knots.shape[0] - 2
    while i > 0 and load[9] <= body.knots[i]:
        i -= 1
    _rates(load[9], i, contact, rate, 12, 1, body, load, 1.0, load[9] <= body.material[4])
    if columns > 3:
        for q in range(12):
            work[q, 3] += rate[q]
    t, d = contact[0:3], contact[9:12]
    c = np.array([t[1] * d[2] - t[2] * d[1], t[2] * d[0] - t[0] * d[2], t[0] * d[1] - t[1] * d[0]])
    for q in range(3):
        frame[q] = t[q]
        frame[3 + q] = co * d[q] + si * c[q]
        frame[6 + q] = contact[6 + q] - y[6 + q]
        frame[9 + q] = co * c[q] - si * d[q]
    for j in range(columns):
        dt, dd = work[0:3, j], work[9:12, j]
        for q in range(3):
            r, u = (q + 1) % 3, (q + 2) % 3
            dc = dt[r] * d[u] + t[r] * dd[u] - dt[u] * d[r] - t[u] * dd[r]
            d_contact[q, j] = dt[q]
            d_contact[3 + q, j] = co * dd[q] + si * dc + turn[j] * frame[9 + q]
            d_contact[6 + q, j] = work[6 + q, j] - p_base[q, j]
            d_contact[9 + q, j] = co * dc - si * dd[q] - turn[j] * frame[3 + q]
