"""Tables of a prediction: error budget, Monte Carlo beside it, and what a touch costs the object."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from probedesign.prediction.fused import FusedCondition
    from probedesign.prediction.predict import Condition, Prediction
    from probedesign.prediction.table_one import AgreementScore, TableOne
    from probedesign.prediction.workspace import Workspace

    Cell = Condition | FusedCondition

BUDGET_FORCE_N = 0.02
"""At which the budget is shown, or at the force of the grid nearest to it: a delicate touch that is located."""
SHOWN_N = 0.005
"""The same of fused touches, which see more."""
LIMITS = {"gives_way": "gives way", "sensor": "sensor", "slips_off": "slips off", "none": "none"}


def print_all(prediction: "Prediction") -> None:
    """The tables, one after another."""
    single, fused = _worst(prediction.conditions, BUDGET_FORCE_N), _worst(prediction.fused, SHOWN_N)
    places = {c.contact_fraction for c in prediction.conditions}
    for rows, what in ((single, "one reading of"), (fused, f"{prediction.pressing.text}, up to")):
        if rows:
            force = 1e3 * next(iter(rows.values())).force_N
            print(f"\nError budget [mm], RMS of {what} {force:g} mN by cause, worst of the directions")
            print(_budget(rows))
            left = ", ".join(f"{place:g}" for place in sorted(places - set(rows)))
            if left:
                print(f"  Not located at that force, and so not shown: {left}")
        else:
            print(f"\nError budget of {what} its force: none, for no place is located")
    print(
        "  The spreads behind it are assumed unless the design says otherwise: prediction.json, [tolerances]."
    )
    if prediction.monte_carlo:
        print("\nMonte Carlo, all causes together; * where it differs from the budget by more than a tenth")
        print(_monte_carlo(prediction))
    print("\nWhat it takes and what it stands, all causes counted, worst of the directions")
    print(_reach(prediction))
    lightest = min((1e3 * c.force_N for c in prediction.fused), default=0.0)
    if any(f.force_mN_for_2_mm == lightest for f in prediction.fused_reach):
        print(
            f"  Of fused touches {lightest:g} mN is the lightest force looked at: where it stands, less may do."
        )
    print_workspace(prediction.workspace)


def print_workspace(workspace: "Workspace") -> None:
    """Where the contact point can be pushed to."""
    if not workspace.paths:
        return
    print("\nWhere the contact point can be pushed to while the base stands still")
    for side, area in (workspace.area_mm2 or {}).items():
        furthest = max((path for path in workspace.paths if path.direction == side),
                       key=lambda path: path.pressed_mm, default=None)  # fmt: skip
        most = "" if furthest is None else (
            f", furthest {furthest.pressed_mm:.3g} mm, at {furthest.contact_fraction:g} of the length")  # fmt: skip
        print(
            f"  along {side}  sweeps {1e-2 * area:.3g} cm²{most}{' (mirrored)' if furthest is None else ''}"
        )
    if workspace.volume_mm3 is not None:
        print(f"  from all round {1e-3 * workspace.volume_mm3:.3g} cm³")


def _worst(conditions: "Sequence[Cell]", wanted_N: float) -> "dict[float, Cell]":
    """Of each place that is located the direction with the greatest error, at the force of the grid nearest to that."""
    force = min((c.force_N for c in conditions), key=lambda f: abs(f - wanted_N), default=0.0)
    worst: dict[float, Cell] = {}
    for c in conditions:
        if c.force_N == force and c.result == "ok" and c.budget_mm is not None:
            before = worst.get(c.contact_fraction)
            if before is None or (c.predicted_error_mm or 0.0) > (before.predicted_error_mm or 0.0):
                worst[c.contact_fraction] = c
    return worst


def _budget(worst: "dict[float, Cell]") -> str:
    places = sorted(worst)
    lines = ["  s/L               " + "".join(f"{place:>7g}" for place in places)]
    rows: list[tuple[str, Callable[[Cell], float | None]]] = [
        (cause, lambda c, cause=cause: (c.budget_mm or {})[cause])  # type: ignore[misc]
        for cause in next(iter(worst.values())).budget_mm or {}
    ]
    rows += [("all", lambda c: c.predicted_error_mm), ("95 % within", lambda c: c.predicted_error_95_mm)]
    for name, value in rows:
        lines.append(f"  {name:<18}" + "".join(_small(value(worst[place]), 7) for place in places))
    return "\n".join(lines)


def _monte_carlo(prediction: "Prediction") -> str:
    lines = ["  s/L     force  from  touches   budget   Monte Carlo         95 %   located"]
    for row in prediction.monte_carlo:
        shown = "none" if row.error_mm is None else f"{row.error_mm:.3g} ± {row.standard_error_mm:.1g}"
        lines.append(
            f"  {row.contact_fraction:<5g}{1e3 * row.force_N:>5g} mN  {row.direction:<4}{row.touches:>9}"
            f"{_cell(row.first_order_mm, 9)}{shown:>14}{'*' if row.differs else ' '}{_cell(row.error_95_mm, 12)}"
            f"{row.located / row.draws:>9.0%}"
        )
    return "\n".join(lines)


def _reach(prediction: "Prediction") -> str:
    k = prediction.pressing.touches
    lines = [f"  s/L     felt    5 mm    2 mm    1 mm  2 mm, {k:>2} fused   greatest  limit        moved by",
             "            mN      mN      mN      mN              mN         mN                     mm"]  # fmt: skip
    for place in sorted({r.contact_fraction for r in prediction.reach}):
        here = [r for r in prediction.reach if r.contact_fraction == place]
        least = min(here, key=lambda r: r.greatest_force_N or 0.0)
        needed = [
            _most([d for d in prediction.detection if d.contact_fraction == place], "detectable_force_mN"),
            *(_most(here, f"force_mN_for_{mm}_mm") for mm in (5, 2, 1)),
            _most([f for f in prediction.fused_reach if f.contact_fraction == place], "force_mN_for_2_mm"),
        ]
        lines.append(
            f"  {place:<5g}"
            + "".join(_cell(value, width) for value, width in zip(needed, (7, 8, 8, 8, 16), strict=True))
            + _cell(None if least.greatest_force_N is None else 1e3 * least.greatest_force_N, 11)
            + f"  {LIMITS[least.limit]:<11}{_cell(least.deflection_mm, 10)}"
        )
    return "\n".join(lines)


def _most(rows: "Sequence[Any]", name: str) -> float | None:
    """The greatest; none if one has none."""
    values = [getattr(row, name) for row in rows]
    return None if None in values else max(values)


def _cell(value: float | None, width: int) -> str:
    return f"{'none' if value is None else f'{value:.3g}':>{width}}"


def _small(value: float | None, width: int) -> str:
    """To a hundredth of a millimetre; what is less is nothing beside the rest."""
    if value is None:
        return f"{'none':>{width}}"
    return f"{'<0.01' if value < 0.005 else f'{value:.2f}' if value < 100 else f'{value:.3g}':>{width}}"


def print_table_one(table: "TableOne") -> None:
    """The paper's table beside what is predicted."""
    print(
        f"Table I, contact error [mm]: sensor {table.noise_force_mN:.3g} mN and {table.noise_moment_Nmm:.3g} N·mm, "
        f"stereo reference {table.reference_mm:g} mm (assumed), the same for all rows"
    )
    print("  probe    force   s/L    measured   predicted   noise alone   largest cause")
    for row in table.rows:
        print(
            f"  {row.probe:<7}{row.force_N:>7g}{row.contact_fraction:>6g}{row.measured_error_mm:>12g}"
            f"{_cell(row.predicted_error_mm, 12)}{_cell(row.noise_error_mm, 14)}   {row.largest_cause}"
        )
    print(f"\n  {_said(table.score, len(table.rows))}")
    for row in table.rows:
        if not row.within:
            print(f"  misses: {row.probe}, {row.force_N:g} N at {row.contact_fraction:g}: {row.why}")
    print("\nHad the reference or the assumed diameters been others")
    for score in (*table.by_reference, *table.by_diameter):
        print(f"  {score.setting:<24}{_said(score, len(table.rows))}")


def _said(score: "AgreementScore", rows: int) -> str:
    return (
        f"{score.within} of {rows} within a factor of two; rank correlation {score.rank_correlation:.2f} "
        f"over the {score.predicted} predicted"
    )
