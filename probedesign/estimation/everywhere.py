"""Every contact that may explain a reading, compiled: fitted from one guess, or from all that the trace finds."""

import math
from pathlib import Path

from probedesign.estimation import trace
from probedesign.estimation.fit import AT_END, LOST, MAX_ITERATIONS, STATE, UNKNOWNS
from probedesign.estimation.fit import FITTED as FIT
from probedesign.estimation.spread import ANSWER, locate_contact
from probedesign.estimation.spread import WORK as SPREAD_WORK
from probedesign.rod.kernels.body import LOAD
from probedesign.rod.kernels.compiled import drop_stale, inner, kernel, merged
from probedesign.rod.kernels.steps import BLOCK, COLUMN, WIDE
from probedesign.rod.kernels.steps import STATE as RODS_STATE
from probedesign.rod.kernels.steps import WORK as STEP_WORK
from probedesign.rod.kernels.vectors import minus, take

drop_stale(Path(__file__).parent)

MOST = 8
"""Places that one reading is fitted from at most, the likeliest ones."""
FITTED, FOUND, TOLD = 0, 1, 1 + STATE
FROM = TOLD + ANSWER
"""Where in a row stand what became of its fit, the unknowns found (STATE), the answer (ANSWER), and the arclength of
the place of the trace that it was fitted from [m]."""
ROW = FROM + 1
LIKELY, SHARE = 8.0, 0.05
"""Misfits of the trace beyond which no contact is fitted: standard deviations of the reading's moment and of its
force's lever together, and over the moment itself. Of 3600 touches of random probes, up to where they give way, no
place that explains a reading lay beyond."""
BACK = (0.0, 0.08)
"""Of the length: how far before the likeliest place a second fit starts where the first one leads nowhere, as where
the trace has run out of the thin tip."""
FEW = 10
"""Iterations that a place other than the likeliest is worth: a rival that explains the reading is near its guess."""
_CHUNKS = 2
_CONTACT = RODS_STATE + WIDE * COLUMN * _CHUNKS
_SWEEP = LOAD + STEP_WORK + _CHUNKS * BLOCK + RODS_STATE + _CONTACT
WORK = _SWEEP + 3 * UNKNOWNS + 15 * (UNKNOWNS + 1) + SPREAD_WORK
"""Numbers that one fit works in."""


def room_for(knots: int) -> int:
    """Numbers that `fit_contacts` works in, of a rod with so many knots."""
    return WORK + trace.ROOM + knots + 1


@merged
def _fit(body, end, gravity, weight, wrench, whiten, most, rough, work, row):
    """Fit from the guess in a row, and fill it."""
    a = LOAD
    b = a + STEP_WORK
    c = b + _CHUNKS * BLOCK
    d = c + RODS_STATE
    e = d + _CONTACT
    f = e + 3 * UNKNOWNS
    g = f + 15 * (UNKNOWNS + 1)
    for q in range(a):
        work[q] = 0.0
    row[FITTED] = locate_contact(
        body, gravity, weight, wrench, whiten, 0.0, end, most, work[:a], work[a:b], work[g:g], work[b:c],
        work[c:d], work[d:e], work[e:f].reshape((3, UNKNOWNS)), work[f:g].reshape((15, UNKNOWNS + 1)),
        work[g : g + SPREAD_WORK], row[FOUND:TOLD], rough, row[TOLD:FROM],
    )  # fmt: skip


@kernel
def fit_contacts(body, end, gravity, weight, wrench, whiten, near, known, rough, work, rows):
    """Fit contacts from a guess alone, or wherever the trace says that one may lie, the likeliest place first.

    Args:
        body: of the rod; end: the furthest arclength at which a touch acts [m].
        gravity: [m/s²], (3,); weight: of the flexible part [N], (3,).
        wrench: read at the base, (6,).
        whiten: lower triangular, with whitenᵀ whiten the inverse covariance of the wrench, (6, 6).
        near: whether the guess stands where the first row's unknowns do; nothing is traced then.
        known: rows traced before for the same wrench with a narrower whitening and this scratch, (n, ROW); none at
            first. Beside the likeliest place only theirs are then fitted again, from where they are: of 1300 touches
            of probes drawn by their tolerances, no place that only these made likely explained the reading.
        rough: whether covariances are not asked for beyond the first order.
        work: scratch, (room_for(knots),).
        rows: filled, (m, ROW).

    Returns:
        How many rows.
    """
    room, reached, places, fitted = work[WORK:], 0, 1, 0
    force, g = minus(take(wrench, 0), take(weight, 0)), take(gravity, 0)
    if not near:
        reached = _traced(body, end, g, force, wrench, known.shape[0] > 0, work, room)
        places = _places(end, wrench, whiten, room, reached, rows)
    for k in range(places):
        s, likely = rows[k, FOUND], rows[k, TOLD] > 0.0
        begun = near or _recalled(known, s, rows[fitted])
        if k > 0 and not (begun or (likely and known.shape[0] == 0)):
            continue
        for back in BACK:
            row, start, status = rows[fitted], max(s - back * end, 0.0), LOST
            if begun or trace.guess(body, end, g, force, work, room, start, reached, row[FOUND:TOLD]):
                most = MAX_ITERATIONS if k == 0 else FEW
                _fit(body, end, gravity, weight, wrench, whiten, most, rough, work, row)
                status = int(row[FITTED])
            row[FROM], begun = s, False
            if near or k > 0 or status in (FIT, AT_END):
                break
        fitted += status != LOST
    return fitted


@inner
def _traced(body, end, gravity, force, wrench, before, work, room):
    """How far the trace reaches that stands in its room, drawn now if not before."""
    drawn = room.shape[0] - 1
    if not before:
        room[drawn] = trace.trace(body, end, gravity, force, take(wrench, 3), work, room)
    return int(room[drawn])


@inner
def _recalled(known, s, row):
    """Whether a row is known that was fitted from the trace's place at s; where it ended is then the guess."""
    for n in range(known.shape[0]):
        if known[n, FROM] == s:
            for q in range(FOUND, TOLD):
                row[q] = known[n, q]
            return True
    return False


@inner
def _places(end, wrench, whiten, room, reached, rows):
    """Where the trace says that a contact may lie: score, arclength, and whether it is likely, into rows, best first;
    returns how many."""
    moment, places = math.sqrt(wrench[3] ** 2 + wrench[4] ** 2 + wrench[5] ** 2), 0
    for j in range(reached):
        if trace.is_least(room, j, reached):
            off, s = trace.least(end, room, j, reached)
            score = off / math.sqrt(1.0 / whiten[3, 3] ** 2 + (s / whiten[0, 0]) ** 2)
            likely = score < LIKELY or off < SHARE * moment
            places = _ranked(rows, places, s, score, likely)
    return places


@inner
def _ranked(rows, places, s, score, likely):
    """Put a place where its score belongs among the rows, least first; how many there are then."""
    at = places
    while at > 0 and rows[at - 1, FITTED] > score:
        at -= 1
    if at >= rows.shape[0]:
        return places
    for k in range(min(places, rows.shape[0] - 1), at, -1):
        for q in (FITTED, FOUND, TOLD):
            rows[k, q] = rows[k - 1, q]
    rows[at, FITTED], rows[at, FOUND], rows[at, TOLD] = score, s, 1.0 if likely else 0.0
    return min(places + 1, rows.shape[0])
