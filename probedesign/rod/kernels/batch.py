"""Cases one after another in one call, no Python in between, the interpreter's lock released."""

from probedesign.rod.kernels.body import OK, Body
from probedesign.rod.kernels.compiled import kernel
from probedesign.rod.kernels.outputs import sensitivities
from probedesign.rod.kernels.solve import WARM, solve

STATUS, MARGIN, RESIDUAL, COUNT, TIP, MOMENT, CONTACT, FOUND = 0, 1, 2, 3, 4, 10, 13, 19
"""Where in a row of answers stand the status, the margin of stability, the residual, the nodes filled, the tip's
section (6), the base moment (3) and the contact's [t, position from the base] (6); and how long a row is."""


@kernel
def solve_cases(
    first, last, bodies, which, loads, start, chained, tol, until, scratch, nodes, blocks, y, contact, turns, found,
    derivatives,
):  # fmt: skip
    """Equilibria of the cases first ... last - 1.

    Args:
        bodies: Body of stacked arrays, one row a rod; which: the rod of each case, (n,).
        loads: (n, LOAD).
        start: COLD, WARM or WARM_ONLY; from a guess: the tip that stands in the case's row of `found`.
        chained: whether each case starts from the one before it, until one has no answer. If not, the answers do
            not depend on their order.
        tol, until: see `solve`.
        scratch: (SCRATCH,); nodes, blocks, y, contact: see `solve`; those of the last case on return.
        turns: scratch, (3, k).
        found: answers, (n, FOUND).
        derivatives: of the base moment (3) and the contact's [t, x axis, position, y axis] (12), by k parameters,
            and in the last column those twelve themselves, (n, 15, k + 1); filled if k > 0.

    Returns:
        How many cases were done.
    """
    for case in range(first, last):
        b = which[case]
        body = Body(
            bodies.knots[b],
            bodies.radii[b],
            bodies.volume_beyond[b],
            bodies.volume_by_knot[b],
            bodies.rest[b],
            bodies.constants[b],
        )
        row = found[case]
        tip = row[TIP : TIP + 6]
        from_where = start
        if chained and case > first:
            from_where = WARM
            for q in range(6):
                tip[q] = found[case - 1, TIP + q]
        status, count, margin, residual = solve(
            tip, from_where, scratch, body, loads[case], tol, until, nodes, blocks, y, contact
        )
        row[STATUS], row[MARGIN], row[RESIDUAL], row[COUNT] = status, margin, residual, count
        if chained and status != OK:
            return case + 1 - first
        for q in range(3):
            row[MOMENT + q] = y[3 + q]
            row[CONTACT + q] = contact[q]
            row[CONTACT + 3 + q] = contact[6 + q] - y[6 + q]
        if turns.shape[1] > 0 and status == OK:
            sensitivities(y, blocks, contact, body, loads[case], turns, derivatives[case])
    return last - first
