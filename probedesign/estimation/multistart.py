"""Fit every touch that may explain a reading, from all candidates, with its posterior (compiled).

Each fit starts with the reading weighted by noise and drift alone; what the error sources do to a reading depends on
where it is touched, so the weights are then taken at the place found, and the fit is carried on with them.
"""

import math

import numpy as np

from probedesign.core.statistics import sigmas_95
from probedesign.estimation import candidates
from probedesign.estimation.contact_fit import (
    AT_END,
    FITTED,
    LOST,
    MAX_ITERATIONS,
    STALLED,
    FitMemory,
    Measured,
    bounded_step,
    fit_touch,
    normal_equations,
    residuals,
    step_share,
    sweep_tolerance,
)
from probedesign.estimation.uncertainty_kernel import (
    SourceArrays,
    add_curvature,
    error_columns,
    measurement_covariance,
    posterior,
    whitening,
)
from probedesign.rod.kernels import inner, kernel
from probedesign.rod.kernels.equations import FLATNESS, OK
from probedesign.rod.kernels.linalg import minus, take, times
from probedesign.rod.kernels.surface_contact import (
    ALONG,
    AROUND,
    BY_TOUCH,
    CENTRE,
    CLAMPED,
    DEAD,
    NORMAL,
    OWN,
    PHI,
    POINT,
    ROWS,
    TIP,
    TOUCH,
    UNKNOWNS,
    VALUE,
    S,
    advance,
    linearise,
    offset_along,
    outline_at,
    plan_move,
    radius_and_slope,
    s_contact,
    work_size,
)

#: What `fit_contacts` does: it fits every candidate of the trace, or from the touch of the first row, or it evaluates
#: the bounds of the touch there.
EVERYWHERE, NEAR, BOUNDS = 0, 1, 2
MAX_STARTS = 8  #: Places that one reading is fitted from at most, the likeliest ones.
#: One fit: its outcome (FITTED, ...), the touch, squared misfit, change of the base moment with s over the force,
#: variance of s_contact [m²], covariance of the five unknowns, those of the touched point and of the centreline point
#: [m²], both to first order alone, force [N], touched point and centreline point [m], s_contact [m], the reading's
#: whitening, how many sweeps the fit took under the weights of noise and drift and under all, on a curved probe by how
#: much the misfit grows beside the fit, see `uncertainty_kernel.NODE`, and the bounds of s_contact that `BOUNDS` fills
#: in [m].
FIT = np.dtype([
    ("status", "f8"), ("touch", "f8", TOUCH), ("chi2", "f8"), ("lever", "f8"), ("var_s", "f8"),
    ("cov_touch", "f8", (UNKNOWNS, UNKNOWNS)), ("cov_surface", "f8", (3, 3)), ("cov_centre", "f8", (3, 3)),
    ("cov_linear_surface", "f8", (3, 3)), ("cov_linear_centre", "f8", (3, 3)), ("force", "f8", 3),
    ("surface", "f8", 3), ("centre", "f8", 3), ("s_contact", "f8"), ("whiten", "f8", (6, 6)), ("sweeps", "f8", 2),
    ("growth", "f8"), ("bounds", "f8", 2),
])  # fmt: skip
#: Misfits of the trace beyond which no contact is fitted: standard deviations of the reading's moment and of its
#: force's lever together, and over the moment itself. Friction around the section leaves a couple of its own, μ r F,
#: and the normals of an ellipse miss its centre by up to (1 - f) r, which is added.
LIKELY, SHARE = 8.0, 0.05
#: Of the length: how far before the likeliest place a second fit starts where the first one leads nowhere, as where the
#: trace has run out of the thin tip.
BACK = (0.0, 0.08)
FEW = 10  #: Iterations for a place other than the likeliest: a rival that explains the reading is near its guess.
ROUNDS = 12  #: Most recomputations of the weights: each changes them by a fraction of the change before.
#: Decrease of the misfit by a step under new weights, over one and the misfit, at which they are kept: a thirtieth of a
#: standard deviation, taken to first order.
SETTLED = 1e-3
#: Of the last decrease: one that is left larger shows that the touch and its weights alternate, and the step is halved.
SLOW = 0.5
MAX_FRICTION = 3.0  #: Ratio of friction that the trace allows for where the direction of the force is free.


def fit_memory(knots: int, causes: int) -> FitMemory:
    """Return what `fit_contacts` works in, by knots of the rod and columns of error sources."""
    parameters = OWN + knots
    return FitMemory(
        np.empty(max(work_size(0), work_size(parameters))), np.empty((ROWS, 1 + UNKNOWNS + parameters)),
        np.empty((12, causes)), np.empty((3, 6 + causes)), np.empty((ROWS, 1 + UNKNOWNS)),
        np.empty(candidates.ROOM + knots),
    )  # fmt: skip


@inner
def _fill_row(measured, lin, touch, share, step, by_s, row):
    """Fill the row of a fit with force, points and s_contact after a last step, taken to first order.

    Args:
        lin: before the step; touch: after a share of it.
        by_s: filled: derivatives of s_contact by the touch, (5,).
    """
    for q in range(3):
        F, x, p = lin[q, VALUE], lin[POINT + q, VALUE], lin[CENTRE + q, VALUE]
        for u in range(UNKNOWNS):
            F += lin[q, BY_TOUCH + u] * share * step[u]
            x += lin[POINT + q, BY_TOUCH + u] * share * step[u]
            p += lin[CENTRE + q, BY_TOUCH + u] * share * step[u]
        row.force[q], row.surface[q], row.centre[q] = F - measured.mass * measured.gravity[q], x, p
    radius, slope = radius_and_slope(measured.body, touch[S])
    at = outline_at(measured.body, slope, touch[PHI])
    shift, by_phi, by_1, by_2, per_r, _by_slope = offset_along(radius, at, touch)
    row.s_contact = touch[S] + shift
    by_s[S], by_s[PHI], by_s[NORMAL] = 1.0 - slope * per_r, by_phi, 0.0
    by_s[AROUND], by_s[ALONG] = by_1, by_2


@inner
def _settle(measured, noise, sources, touch, memory, work, row):
    """Carry a fit on under the weights of its own place, and fill its row with its posterior.

    Args:
        measured: what the touch is fitted to; noise: covariance of the reading by noise and drift, (6, 6).
        sources: `SourceArrays`.
        touch: the guess and then the fit, (TOUCH,).
        memory: scratch, `FitMemory`; work: scratch, FIT_SCRATCH.
        row: filled, FIT.

    Returns:
        What became of the fit: FITTED, AT_END, STALLED or LOST.
    """
    parameters, body, lin = sources.rod.shape[1] + 3, measured.body, memory.lin
    J, r, H, b, step = work.J, work.r, work.H[:, :], work.b[:], work.step[:]
    move, before, white, row.growth = work.move[:], work.before[:], row.whiten[:, :], math.inf
    cov, factor = work.cov[:, :], work.factor[:, :]
    if not whitening(noise, factor, white):
        return LOST
    tol, size, rounds, small = sweep_tolerance(measured.wrench, white), 1.0, 0, False
    chi2, gain, share, bounded, last_gain = 0.0, 0.0, 1.0, 0, math.inf
    while not small and rounds < ROUNDS:
        rounds += 1
        code, lack, margin, size = linearise(
            body, measured.gravity, measured.mass, tol, max(size, 1e-6), touch, parameters, memory.sweep, lin
        )
        if code != OK or not lack < math.inf or not margin > 0.0:
            return LOST
        error_columns(body, measured.gravity, lin, sources, memory.D)
        measurement_covariance(noise, memory.D, cov)
        if not whitening(cov, factor, white):
            return LOST
        chi2 = residuals(lin, touch, measured.wrench, white, measured.friction, J, r)
        normal_equations(J, r, H, b)
        bounded = bounded_step(H, b, work.scale[:], 0.0, measured.end, touch, step, work.full[:, :])
        if bounded < 0 or not math.isfinite(chi2):
            return LOST
        gain = 0.0
        for u in range(UNKNOWNS):
            gain += b[u] * step[u]
        plan_move(lin, step, move)
        share = step_share(step, touch, move, body.knots[-1])
        small = share == 1.0 and lack <= CLAMPED and gain <= SETTLED * (1.0 + chi2)
        if gain > SLOW * last_gain and not small:
            share *= 0.5
        last_gain = gain
        for q in range(TOUCH):
            before[q] = touch[q]
        advance(touch, before, share, step, move)
    row.sweeps[1] = rounds
    _fill_row(measured, lin, touch, share, step, work.by_s, row)
    row.chi2 = chi2 - gain if small and not bounded else chi2
    if not posterior(lin, touch, J, white, memory.D, work.by_s, work, memory.gain, row):
        return LOST
    if not small:
        return STALLED
    # Linearised at `before`; the last step is a thirtieth of a standard deviation.
    if not bounded or candidates.is_curved(body):
        add_curvature(measured, white, tol, before, lin, J, memory, work, row)
    return AT_END if bounded else FITTED


PROFILE_STEPS = 20  #: Most fits for one end of a profile interval; two to five are usual.
PROFILE_CLOSE = 0.02  #: Difference from the limit, in standard deviations, at which an end is found.
LEAST_PLACE = 1e-3  #: Arclength over length below which an end of the interval is the base's.
LIMIT = sigmas_95(1)  #: Square root of the growth of the misfit, in standard deviations, at the ends of an interval.


@inner
def _copy(touch, to):
    for q in range(TOUCH):
        to[q] = touch[q]


@inner
def _profile_bounds(measured, memory, work, row):
    """Fill in the bounds of a fit: the s_contact [m] where the misfit, least over touches of one section, has grown to
    the limit; 0 and the end of the probe where it does not grow so far.

    The square root of the growth is about linear in 1/s, because s is a moment over an uncertain force. Its secant is
    followed, and bisected where that does not close in.
    """
    moved, kept, end = work.at[:], work.kept[:], measured.end
    lowest, std_s = LEAST_PLACE * end, math.sqrt(max(row.var_s, 0.0))
    first = 1.0 / max(row.touch[S], lowest)
    for side in range(2):
        _copy(row.touch[:], moved)
        _copy(moved, kept)
        last = 1.0 / lowest if side == 0 else 1.0 / end
        inside, grown, outside, beyond = first, 0.0, math.nan, math.inf
        x = first + (1.0 if side == 0 else -1.0) * LIMIT * std_s * first * first
        for step in range(PROFILE_STEPS):
            if math.isnan(outside):
                x = min(x, last) if side == 0 else max(x, last)
            s = 1.0 / x
            if moved[S] > lowest:  # the moment stays
                moved[NORMAL] *= moved[S] / s
                for q in range(DEAD, TIP):
                    moved[q] *= moved[S] / s
            moved[S] = s
            status, chi2, _n = fit_touch(
                measured, row.whiten[:, :], s, s, MAX_ITERATIONS, moved, memory.sweep, memory.lin_touch, work
            )
            growth = math.sqrt(max(chi2 - row.chi2, 0.0))
            if status in (FITTED, AT_END) and growth > LIMIT + PROFILE_CLOSE:
                outside, beyond = x, growth
            elif status in (FITTED, AT_END) or growth <= LIMIT:
                inside, grown = x, growth
                _copy(moved, kept)
                if growth >= LIMIT - PROFILE_CLOSE or x == last:
                    break
            else:  # too far for one fit: from nearer by
                _copy(kept, moved)
                x = 0.5 * (inside + x)
                continue
            _copy(kept, moved)
            if math.isnan(outside):
                x = first + (inside - first) * min(LIMIT / max(grown, 1e-3), 3.0) if inside != first else last
            elif step % 3 != 2:
                x = inside + (outside - inside) * (LIMIT - grown) / (beyond - grown)
            else:
                x = 0.5 * (inside + outside)
        row.bounds[side] = 0.0 if side == 0 and inside == last else s_contact(measured.body, kept)


@kernel
def fit_contacts(
    body, end, gravity, mass, wrench, noise, friction, rod, base, root, gain, payload_by_gravity, sensor_from_base,
    base_from_sensor, reference, tared, task, memory, scratch, rows,
):  # fmt: skip
    """Fit touches from one guess or from every candidate of the trace, the likeliest first, or evaluate bounds of one.

    Args:
        body: of the rod; end: the furthest arclength at which a touch acts [m].
        gravity: [m/s²], (3,); mass: of the flexible part [kg].
        wrench: read at the base, (6,).
        noise: its covariance by noise and drift, (6, 6).
        friction: prior standard deviation of the friction ratio; inf: the direction is free.
        rod, ... tared: the error sources, see `SourceArrays`; as arguments of their own they reach the kernel faster.
        task: EVERYWHERE, NEAR or BOUNDS.
        memory: scratch, `FitMemory`; scratch: FIT_SCRATCH, (1,).
        rows: filled, FIT, (MAX_STARTS,).

    Returns:
        How many rows.
    """
    measured = Measured(body, end, gravity, mass, wrench, friction)
    sources = SourceArrays(
        rod, base, root, gain, payload_by_gravity, sensor_from_base, base_from_sensor, reference, tared
    )
    room, fit_work = memory.room, scratch[0]
    if task == BOUNDS:
        _profile_bounds(measured, memory, fit_work, rows[0])
        return 1
    if task == NEAR:
        row = rows[0]
        row.sweeps[0] = 0
        row.status = _settle(measured, noise, sources, row.touch[:], memory, fit_work, row)
        return int(row.status != LOST)
    narrow = fit_work.noise_whiten[:, :]
    if not whitening(noise, fit_work.factor[:, :], narrow):
        return 0
    g, fitted = take(gravity, 0), 0
    force = minus(take(wrench, 0), times(mass, g))
    arm = min(friction, MAX_FRICTION) + abs(1.0 - body.constants[FLATNESS])
    std_force, std_moment = 1.0 / narrow[0, 0], 1.0 / narrow[3, 3]
    reached = candidates.trace(body, end, g, force, take(wrench, 3), std_force, std_moment, arm, memory.sweep, room)
    places = _places(measured, narrow, force, arm, room, reached, rows)
    for k in range(places):
        s, likely = rows[k].s_contact, rows[k].chi2 > 0.0
        if k > 0 and not likely:
            continue
        status, row, sweeps = LOST, rows[fitted], 0
        touch, limit = row.touch[:], MAX_ITERATIONS if k == 0 else FEW
        for back in BACK:
            start = max(s - back * end, 0.0)
            if candidates.guess(body, end, g, force, std_force, std_moment, memory.sweep, room, start, reached, touch):
                status, _chi2, sweeps = fit_touch(
                    measured, narrow, 0.0, end, limit, touch, memory.sweep, memory.lin_touch, fit_work
                )
            if status != LOST:
                status = _settle(measured, noise, sources, touch, memory, fit_work, row)
            row.status, row.sweeps[0] = status, sweeps
            if k > 0 or status in (FITTED, AT_END):
                break
        fitted += status != LOST
    return fitted


@inner
def _places(measured, whiten, force, arm, room, reached, rows):
    wrench = measured.wrench
    moment, places = math.sqrt(wrench[3] ** 2 + wrench[4] ** 2 + wrench[5] ** 2), 0
    size = math.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
    for j in range(reached):
        if candidates.is_least(room, j, reached):
            off, s = candidates.least(measured.end, room, j, reached)
            couple = arm * size * radius_and_slope(measured.body, s)[0]
            score = off / math.sqrt(1.0 / whiten[3, 3] ** 2 + (s / whiten[0, 0]) ** 2 + couple * couple)
            likely = score < LIKELY or off < SHARE * moment
            if room[candidates.CURVED] != 0.0:  # in standard deviations
                score, likely = off, off < LIKELY
            places = _ranked(rows, places, s, score, likely)
    return places


@inner
def _ranked(rows, places, s, score, likely):
    """Insert a place among the rows by its score, least first; return how many there are then."""
    at = places
    while at > 0 and rows[at - 1].status > score:
        at -= 1
    if at >= rows.shape[0]:
        return places
    for k in range(min(places, rows.shape[0] - 1), at, -1):
        row, last = rows[k], rows[k - 1]
        row.status, row.s_contact, row.chi2 = last.status, last.s_contact, last.chi2
    row = rows[at]
    row.status, row.s_contact, row.chi2 = score, s, 1.0 if likely else 0.0
    return min(places + 1, rows.shape[0])


@kernel
def placed(body, end, s, force, t, x_axis, touch):
    """Run `candidates.place_touch` for callers in Python."""
    candidates.place_touch(body, end, s, take(force, 0), take(t, 0), take(x_axis, 0), 0.0, 1.0, touch)


@kernel
def contact_arclengths(body, touches, s):
    """Fill in the arclengths of the centreline's points where the lines of action of forces come nearest [m], (k,)."""
    for k in range(touches.shape[0]):
        s[k] = s_contact(body, touches[k])
