"""One touch solved and linearised, compiled; `pressed.py` says what the numbers mean."""

import math
from pathlib import Path

from probedesign.estimation.fit import radius_at, slope_at
from probedesign.rod.kernels.body import FORCE, GRAVITY, OK, S_CONTACT
from probedesign.rod.kernels.compiled import drop_stale, inner, kernel, merged
from probedesign.rod.kernels.linear import linear_equilibrium
from probedesign.rod.kernels.newton import turn_tip
from probedesign.rod.kernels.vectors import take

drop_stale(Path(__file__).parent)

COLUMNS = 12
"""By force, s_contact, couple, gravity, log E and log G."""
_S, _E, _G = 3, 10, 11
TOLERANCE = 5e-7
"""Error of a sweep's step [rad], that of the rod's fast mode."""
CLAMPED = 1e-5
"""Misfit of the base [rad] up to which its linear answer is exact: an error of its square."""
MOST_TURN, SWEEPS = 0.5, 12
MOMENT, D_MOMENT, POINT, D_POINT, SURFACE, D_SURFACE, D_FORCE, TOWARDS = 0, 3, 15, 18, 30, 33, 45, 57
"""Where in an answer stand the base moment (3), what it is by θ (3, 4), the contact's point (3), (3, 4), the touched
point (3), (3, 4), the force by θ (3, 4), and what makes the force normal (3)."""
ANSWER = 60


@inner
def _leaning(columns, j, cos, sin, co, si, r):
    """Component r of the push as the section's axes are in column j."""
    return cos * (co * columns[6 + r, j] + si * columns[12 + r, j]) - sin * columns[3 + r, j]


@inner
def inverted(A, V):
    """Inverse of (3, 3), both flat."""
    c00, c01, c02 = A[4] * A[8] - A[5] * A[7], A[5] * A[6] - A[3] * A[8], A[3] * A[7] - A[4] * A[6]
    det = A[0] * c00 + A[1] * c01 + A[2] * c02
    V[0], V[3], V[6] = c00 / det, c01 / det, c02 / det
    V[1], V[4], V[7] = (
        (A[2] * A[7] - A[1] * A[8]) / det,
        (A[0] * A[8] - A[2] * A[6]) / det,
        (A[1] * A[6] - A[0] * A[7]) / det,
    )
    V[2], V[5], V[8] = (
        (A[1] * A[5] - A[2] * A[4]) / det,
        (A[2] * A[3] - A[0] * A[5]) / det,
        (A[0] * A[4] - A[1] * A[3]) / det,
    )


@merged
def _settled(body, tip, load, sweep_work, nodes, blocks, y, contact, turns, derivatives, change):
    """Sweep from the guessed tip until the base stands in its clamp; whether it does and stably."""
    size = 1.0
    for _ in range(SWEEPS):
        status, lack, margin, size = linear_equilibrium(
            tip, load, body, TOLERANCE, max(size, 1e-6), sweep_work, nodes, blocks, y, contact, turns, derivatives,
            change,
        )  # fmt: skip
        turn = math.sqrt(change[0] ** 2 + change[1] ** 2 + change[2] ** 2)
        if status != OK or not math.isfinite(lack) or not turn < 10.0 * MOST_TURN:
            return False
        share = min(1.0, MOST_TURN / max(turn, 1e-300))
        turn_tip(tip, 0, (share * change[0], share * change[1], share * change[2]))
        if share == 1.0 and lack <= CLAMPED:
            return margin > 0.0
    return False


@kernel
def press_at(
    body, gravity, s, angle, magnitude, force, around_by_force, load, sweep_work, nodes, blocks, y, contact, turns,
    derivatives, work, tip, answer,
):  # fmt: skip
    """Solve and linearise one touch.

    Args:
        s, angle, magnitude: of the push; force: its guess [N], (3,).
        around_by_force: whether θ's second is the tangential force instead of the angle.
        tip: the tip's section, a guess and then the answer, (6,).
        answer: see the indices above, (ANSWER,).
        work: (27,).
        The others as in `linear_equilibrium`, for twelve columns.

    Returns:
        Whether there is an equilibrium.
    """
    loosened, A, change = work[0:9], work[9:18], work[18:21]
    for q in range(3):
        load[FORCE + q], load[GRAVITY + q] = force[q], gravity[q]
    load[S_CONTACT] = s
    if not _settled(body, tip, load, sweep_work, nodes, blocks, y, contact, turns, derivatives, change):
        return False
    k, sin = COLUMNS, slope_at(body, s)
    cos, co, si = math.sqrt(1.0 - sin * sin), math.cos(angle), math.sin(angle)
    x_axis, y_axis = take(derivatives[6:9, k], 0), take(derivatives[12:15, k], 0)
    for r in range(3):
        for j in range(3):
            A[3 * r + j] = (1.0 if r == j else 0.0) - magnitude * _leaning(
                derivatives, j, cos, sin, co, si, r
            )
    inverted(A, loosened)
    for r in range(3):
        towards = 0.0
        total = (0.0, 0.0, 0.0, 0.0)
        for j in range(3):
            n = _leaning(derivatives, k, cos, sin, co, si, j)
            turned = cos * (co * y_axis[j] - si * x_axis[j])
            by_s = magnitude * _leaning(derivatives, _S, cos, sin, co, si, j)
            by_E = _leaning(derivatives, _E, cos, sin, co, si, j) + _leaning(
                derivatives, _G, cos, sin, co, si, j
            )
            around = turned if around_by_force else magnitude * turned
            loose = loosened[3 * r + j]
            towards += loose * (magnitude * n - force[j])
            total = (
                total[0] + loose * by_s, total[1] + loose * around, total[2] + loose * n,
                total[3] + loose * magnitude * by_E,
            )  # fmt: skip
        answer[TOWARDS + r] = towards
        for c in range(4):
            answer[D_FORCE + 4 * r + c] = total[c]
    radius = cos * radius_at(body, s)
    for r in range(3):
        n = _leaning(derivatives, k, cos, sin, co, si, r)
        moment, point = derivatives[r, k], derivatives[9 + r, k]
        for j in range(3):
            moment += derivatives[r, j] * answer[TOWARDS + j]
            point += derivatives[9 + r, j] * answer[TOWARDS + j]
            n += _leaning(derivatives, j, cos, sin, co, si, r) * answer[TOWARDS + j]
        answer[MOMENT + r], answer[POINT + r], answer[SURFACE + r] = moment, point, point - radius * n
        for c in range(4):
            d_moment = d_point = d_n = 0.0
            for j in range(3):
                by = answer[D_FORCE + 4 * j + c]
                d_moment += derivatives[r, j] * by
                d_point += derivatives[9 + r, j] * by
                d_n += _leaning(derivatives, j, cos, sin, co, si, r) * by
            if c == 0:
                d_moment += derivatives[r, _S]
                d_point += derivatives[9 + r, _S]
                d_n += _leaning(derivatives, _S, cos, sin, co, si, r)
            elif c == 1:
                turned = cos * (co * y_axis[r] - si * x_axis[r])
                d_n += turned if not around_by_force else turned / magnitude if magnitude != 0.0 else 0.0
            elif c == 3:
                d_moment += derivatives[r, _E] + derivatives[r, _G]
                d_point += derivatives[9 + r, _E] + derivatives[9 + r, _G]
                d_n += _leaning(derivatives, _E, cos, sin, co, si, r) + _leaning(
                    derivatives, _G, cos, sin, co, si, r
                )
            answer[D_MOMENT + 4 * r + c], answer[D_POINT + 4 * r + c] = d_moment, d_point
            answer[D_SURFACE + 4 * r + c] = d_point - radius * d_n + (sin * n if c == 0 else 0.0)
    return True
