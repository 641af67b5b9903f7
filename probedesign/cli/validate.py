"""`probedesign validate`: what the frozen probe estimates beside what a reference measured."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from probedesign.cli.output import print_json, telling

if TYPE_CHECKING:
    from probedesign.validation.validate import Validation


def validate(
    bundle: Path,
    data: Path,
    /,
    *,
    out: Path | None = None,
    exact_model: bool = False,
    plots: Annotated[bool | None, Parameter(negative="--no-plots")] = None,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> None:
    """Compare estimates with a reference: shape RMS, contact error, and whether stated errors come true.

    Writes validation.json, .csv, .html and .png. See docs/measurements.md.

    Args:
        bundle: the frozen probe, NAME.probe.json.
        data: folder of a campaign.
        out: folder for the files; by default exports/NAME/validation.
        exact_model: take the probe for exactly what BUNDLE says, so that ellipsoids hold the sensor's noise alone;
            else they hold the tolerances of material, print and mount too.
        plots: make the page and the picture; by default the latter where matplotlib is installed.
        as_json: print one JSON document instead of tables.
    """
    from probedesign import pipeline

    with telling() as tell:
        found, files = pipeline.validate(bundle, data, out, exact_model, plots, tell)
    if as_json:
        print_json(found.as_dict())
        return
    _print(found)
    print("wrote", ", ".join(map(str, files)))
    for note in found.notes:
        print(f"note: {note}", file=sys.stderr)


def _print(found: "Validation") -> None:
    print(
        f"{found.estimator.model.name}  geometry {found.estimator.model.fingerprint}  {found.campaign.folder}"
    )
    print("\n  test              force  contact      shape RMS     contact   stated  95 %  result")
    print("                       mN     of L      mm       %          mm       mm")
    for row in found.rows():
        inside = {None: "", True: "in", False: "out"}[row["within_95"]]
        force = None if row["force_N"] is None else 1e3 * row["force_N"]
        print(f"  {row['test'][:16]:<16}{_cell(force, 7)}{_cell(row['contact_fraction'], 9)}"
              f"{_cell(row['shape_rms_mm'], 8)}{_cell(row['shape_rms_percent'], 8)}{_cell(row['contact_error_mm'], 12)}"
              f"{_cell(row['stated_error_mm'], 9)}{inside:>6}  {row['result']}")  # fmt: skip
    print()
    for kind, means in found.summary.items():
        shape, contact = means["shape_rms_mm"], means["contact_error_mm"]
        print(f"  {kind:<8}shape RMS mean {_mm(shape.mean)}, largest {_mm(shape.largest)}; "
              f"contact error mean {_mm(contact.mean)}, RMS {_mm(contact.rms)}")  # fmt: skip
    print()
    for line in found.honesty.words:
        print(f"  {line}")
    print()


def _cell(value: Any, width: int) -> str:
    return f"{'-' if value is None else f'{value:.3g}':>{width}}"


def _mm(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g} mm"
