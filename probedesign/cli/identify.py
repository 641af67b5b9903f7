"""`probedesign identify`: E, G and their kin from tests of a print."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from probedesign.cli.console import counted, print_json, print_table, working
from probedesign.errors import InputError

if TYPE_CHECKING:
    from probedesign.design_edit import Change
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
    """Find E, G and their kin from tests of a print: least squares on the full rod.

    Args:
        design: the design file.
        data: folder of the tests (docs/measurements.md).
        for_: what to find, with commas between: E, G, density, diameters, root, tilt, clocking, offset, gravity.
        write: put what was found into the design file; without it, the lines are only shown.
        out: write a changed copy of the design to this file instead.
        force: replace numbers that were set or identified before, or the file of --out, which is kept as FILE.old.
        folder: for identification.json, residuals.csv and identification.html; by default exports/NAME/identification.
        page: make the page with residuals.
        as_json: print one JSON document.
    """
    from probedesign import pipeline

    if write and out is not None:
        raise InputError("--write changes the design itself and --out writes another file; choose one")
    names = [name for name in (part.strip() for part in for_.split(",")) if name]
    with working("identifying"):
        found, files = pipeline.identify(design, data, names, folder, page)
    if not as_json:
        _print(found)
        print("wrote", ", ".join(map(str, files)))
    changes: tuple[Change, ...] = ()
    path = kept = refused = None
    try:
        changes, path, kept = pipeline.write_identified(found, design, out, write, force)
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
                "design_kept": kept,
            }
        )
    elif changes:
        _print_changes(changes, path, design)
    if kept is not None and not as_json:
        print(f"kept {out} as it was: {kept}")
    if refused is not None:  # last, when all that was found is told
        raise refused


def _print(found: "Identification") -> None:
    head = f"{found.name}  geometry {found.fingerprint}  {counted(found.tests, 'test')} of {found.data}"
    print(f"{head}: {found.result}")
    print_table({one.name: _told(one, found.dimensions) for one in found.found})
    for outlier in found.outliers[:5]:
        print(
            f"  outlier: {outlier.words}, {outlier.deviations:.1f} standard deviations off; it hardly counts"
        )
    if len(found.outliers) > 5:
        print(f"  and {len(found.outliers) - 5} more outliers, in residuals.csv")
    for cause, of in found.causes.items():
        print(f"  not counted: {cause}: {', '.join(f'{one.of} {one.percent:+.2g} %' for one in of)}")
    for one in found.found:
        if any(shift.of == one.name for shift in found.shifts):
            within = f"95 % within {one.low_total:.4g} ... {one.high_total:.4g}"
            print(
                f"  with each of these as one standard deviation: {one.name} to {one.relative_std_total:.2%}, {within}"
            )
    for note in (*found.caveats, *found.notes):
        print(f"  note: {note}")


def _told(one: "Identified", dimensions: str) -> str:
    if not one.identified:
        return f"{_with_unit(one)}, the design's: not told by these tests"
    text = f"{_with_unit(one)}, 95 % within {one.low:.4g} ... {one.high:.4g}"
    assert one.std is not None and one.std_of_print is not None
    if one.std_of_print > 1.1 * one.std:
        of_print = f"{one.low_of_print:.4g} ... {one.high_of_print:.4g} with {dimensions}"
        text += f" with the design's dimensions; {of_print}"
    return text


def _with_unit(one: "Identified") -> str:
    return f"{one.value:.4g} {one.unit or f'({one.words})'}"


def _print_changes(changes: "tuple[Change, ...]", path: Path | None, design: Path) -> None:
    would = f"--write would change {design} (what was set or identified before, only with --force):"
    print(f"wrote {path}; its old values stay as comments:" if path else would)
    for change in changes:
        print(f"  [{change.table}] {change.key} = {change.text}")
    if path is None:
        print(f"nothing is written: deploy would freeze {design} as it is; take --write, or --out for a copy")
