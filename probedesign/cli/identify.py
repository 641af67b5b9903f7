"""`probedesign identify`: identify E, G and other parameters from tests of a print."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from probedesign.cli.console import plural, print_json, print_table, show_progress
from probedesign.core.errors import InputError

if TYPE_CHECKING:
    from probedesign.design.io import Change
    from probedesign.identification.result import Identification, Identified


def identify(
    design: Path,
    data: Path,
    /,
    *,
    for_: Annotated[str, Parameter(name="--for")] = "E,G",
    write: bool = False,
    out: Path | None = None,
    force: bool = False,
    folder: Path | None = None,
    page: Annotated[bool, Parameter(negative="--no-page")] = True,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> None:
    """Identify E, G and other parameters from tests of a print by least squares on the full rod model.

    Args:
        design: the design file.
        data: folder of the tests (docs/measurements.md).
        for_: comma-separated parameters: E, G, density, diameters, root, tilt, clocking, offset, gravity.
        write: write the identified values to the design file. Default: print the changes only.
        out: write a changed copy of the design to this file instead.
        force: replace values that were set or identified before, or the file of --out, which is kept as FILE.old.
        folder: folder for identification.json, residuals.csv and identification.html. Default:
            exports/NAME/identification.
        page: write the page with residuals.
        as_json: print one JSON document.
    """
    from probedesign import pipeline

    if write and out is not None:
        raise InputError("--write changes the design file and --out writes another one; choose one of them")
    names = [name for name in (part.strip() for part in for_.split(",")) if name]
    with show_progress("identifying"):
        found, files = pipeline.identify(design, data, names, folder, page)
    if not as_json:
        _print(found)
        print("wrote", ", ".join(map(str, files)))
    changes: tuple[Change, ...] = ()
    path = backup = refused = None
    try:
        changes, path, backup = pipeline.write_identified(found, design, out, write, force)
    except InputError as error:
        if write or out is not None:
            raise
        refused = error
    if as_json:
        print_json(
            {
                **found.as_dict(),
                "files": files,
                "changes": changes,
                "design_written": path,
                "design_kept": backup,
            }
        )
    elif changes:
        _print_changes(changes, path, design)
    if backup is not None and not as_json:
        print(f"kept the former {out} as {backup}")
    if refused is not None:  # raised last, so that all results are printed first
        raise refused


def _print(found: "Identification") -> None:
    head = f"{found.name}  geometry {found.fingerprint}  {plural(found.tests, 'test')} of {found.data}"
    print(f"{head}: {found.result}")
    print_table({one.name: _value(one, found.dimensions) for one in found.found})
    for outlier in found.outliers[:5]:
        print(f"  outlier: {outlier.words}, {outlier.deviations:.1f} standard deviations; down-weighted")
    if len(found.outliers) > 5:
        print(f"  and {len(found.outliers) - 5} more outliers, in residuals.csv")
    for cause, effects in found.causes.items():
        percent = ", ".join(f"{effect.of} {effect.percent:+.2g} %" for effect in effects)
        print(f"  systematic effect (one standard deviation): {cause}: {percent}")
    for one in found.found:
        if any(shift.of == one.name for shift in found.shifts):
            print(
                f"  including systematic effects: {one.name} ± {one.relative_std_total:.2%}, "
                f"95 % interval {one.low_total:.4g} ... {one.high_total:.4g}"
            )
    for note in (*found.caveats, *found.notes):
        print(f"  note: {note}")


def _value(one: "Identified", dimensions: str) -> str:
    """Return a parameter's value and 95 % interval.

    Args:
        one: the parameter.
        dimensions: uncertainty of the print's dimensions; the interval that includes it is added where it is wider.
    """
    value = f"{one.value:.4g} {one.unit or f'({one.words})'}"
    if not one.identified:
        return f"{value} (design value; not observable in these tests)"
    text = f"{value}, 95 % interval {one.low:.4g} ... {one.high:.4g}"
    assert one.std is not None and one.std_of_print is not None
    if one.std_of_print > 1.1 * one.std:
        text += f" with the design's dimensions; {one.low_of_print:.4g} ... {one.high_of_print:.4g} with {dimensions}"
    return text


def _print_changes(changes: "tuple[Change, ...]", path: Path | None, design: Path) -> None:
    preview = f"--write would change {design} (values set or identified before only with --force):"
    print(f"wrote {path}; the former values are kept as comments:" if path else preview)
    for change in changes:
        print(f"  [{change.table}] {change.key} = {change.text}")
    if path is None:
        print(f"{design} was not changed. Write these values with --write, or to a copy with --out")
