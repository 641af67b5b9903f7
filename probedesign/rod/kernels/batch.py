"""Cases group by group in one call, no Python in between, the interpreter's lock released."""

from probedesign.rod.kernels.body import OK
from probedesign.rod.kernels.compiled import inlined, kernel
from probedesign.rod.kernels.lane_sweep import SEEN, body_of
from probedesign.rod.kernels.lane_sweep import TIP as MIND_TIP
from probedesign.rod.kernels.newton import STABLE, STATUS
from probedesign.rod.kernels.outputs import sensitivities
from probedesign.rod.kernels.search import RESIDUAL, WARM
from probedesign.rod.kernels.solve import BASE, CASE, POLISHING, SEEKING, parts, report, through
from probedesign.rod.kernels.steps import STATE

ROW_STATUS, MARGIN, ROW_RESIDUAL, COUNT, TIP, MOMENT, CONTACT, FOUND = 0, 1, 2, 3, 4, 10, 13, 19
"""Where in a row of answers stand the status, the margin of stability, the residual, the nodes filled, the tip's
section (6), the base moment (3) and the contact's [t, position from the base] (6); and how long a row is."""
NEAR_ENOUGH = 200.0
"""Times the tolerance: Newton's matrix, taken NEAR the answer, makes a thousandth of a misfit."""


@inlined
def _write(row, mind, o, y, contact, status, margin, residual, count):
    """An answer by its place in the row."""
    row[ROW_STATUS], row[MARGIN], row[ROW_RESIDUAL], row[COUNT] = status, margin, residual, count
    for q in range(6):
        row[TIP + q] = mind[o + MIND_TIP + q]
    for q in range(3):
        row[MOMENT + q] = y[3 + q]
        row[CONTACT + q] = contact[q]
        row[CONTACT + 3 + q] = contact[6 + q] - y[6 + q]


@kernel
def solve_cases(
    first, last, bodies, which, loads, directed, start, chained, tol, until, scratch, nodes, blocks, y, contact, turns,
    found, derivatives,
):  # fmt: skip
    """Equilibria of the cases first ... last - 1.

    Args:
        bodies: Body of stacked arrays, one row a rod; which: the rod of each case, (n,).
        loads: (n, LOAD).
        directed: None if all rods are round and straight, else 0.
        start: COLD, WARM or WARM_ONLY; from a guess: the tip that stands in the case's row of `found`.
        chained: whether each case starts from the one before it, until one has no answer. If not, the answers do
            not depend on their order.
        tol: error allowed a step [rad]; until: residual allowed at the base [rad]; both relative to how far the rod
            turns.
        scratch: (FIXED + group · CASE,). As many cases are sought before any of them is polished, since polishing
            needs no columns, which a lane beside would.
        nodes, blocks, y, contact: see `report`; those of the last case on return. With neither nodes nor blocks
            there is no last sweep, no section axes, and `y` and `contact` stay as they are.
        turns: scratch, (3, k).
        found: answers, (n, FOUND).
        derivatives: of the base moment (3) and the contact's [t, x axis, position, y axis] (12), by k parameters,
            and in the last column those twelve themselves, (n, 15, k + 1); filled if k > 0.

    Returns:
        How many cases were done.
    """
    lanes, seats, work, minds = parts(scratch)
    reports = nodes.shape[0] > 0 or blocks.shape[0] > 0
    near_enough = NEAR_ENOUGH * tol if reports else 0.0
    case = first
    while case < last:
        count = 1 if chained else min(last - case, minds.shape[0] // CASE)
        from_where = WARM if chained and case > first else start
        for k in range(count):
            guess = case - 1 if chained and case > first else case + k
            for q in range(6):
                minds[k * CASE + MIND_TIP + q] = found[guess, TIP + q]
        group, of = loads[case : case + count], which[case : case + count]
        for stage in (SEEKING, POLISHING):
            through(
                stage,
                count,
                lanes,
                seats,
                minds,
                bodies,
                of,
                group,
                directed,
                from_where,
                tol,
                until,
                near_enough,
            )
        for k in range(count):
            o, row, filled = k * CASE, found[case + k], 0
            body, load = body_of(bodies, of[k]), group[k]
            status, margin, residual = minds[o + STATUS], minds[o + STABLE], minds[o + RESIDUAL]
            if reports and status == OK:
                code, filled, margin, residual = report(
                    minds, o, work, body, load, tol, until, nodes, blocks, y, contact
                )
                status = float(code)
                _write(row, minds, o, y, contact, status, margin, residual, filled)
            else:
                base, seen = minds[o + BASE : o + BASE + STATE], minds[o + SEEN : o + SEEN + STATE]
                _write(row, minds, o, base, seen, status, margin, residual, filled)
            if chained and status != OK:
                return case + k + 1 - first
            if turns.shape[1] > 0 and status == OK:
                sensitivities(y, blocks, contact, body, load, turns, derivatives[case + k])
        case += count
    return last - first
