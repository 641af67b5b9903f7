"""`probedesign identify`: identify E, G and other parameters from tests of a print."""

from collections.abc import Iterator, Sequence
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from probedesign.cli.console import json_bytes, plural, print_json, print_table, show_progress, write_files
from probedesign.cli.options import DesignFile, JsonOutput
from probedesign.core.errors import InputError
from probedesign.core.files import check_overwrite, exports_of

if TYPE_CHECKING:
    from probedesign.design.edit import Change
    from probedesign.identification.result import Identification, Identified

MAX_CAUSES = 4  #: Likely causes of a contradiction that are printed; all are in identification.json.


def identify(
    design: DesignFile,
    data: Path,
    /,
    *,
    for_: Annotated[str, Parameter(name="--for")] = "E,G",
    write: bool = False,
    out: Path | None = None,
    force: bool = False,
    accept: bool = False,
    folder: Path | None = None,
    page: Annotated[bool, Parameter(negative="--no-page")] = True,
    as_json: JsonOutput = False,
) -> None:
    """Identify E, G and other parameters from tests of a print by least squares on the full rod model.

    Args:
        data: folder of the tests (docs/measurements.md).
        for_: comma-separated parameters: E, G, density, root, bow_x, bow_y, curvature, tilt, clocking, offset,
            gravity, diameters. curvature is the factor on that of a helix or of knots; of an arc it is a bow.
        write: write the identified values to the design file. Default: print the changes only.
        out: write a changed copy of the design to this file instead.
        force: replace values that were set or identified before, or the file of --out, which is kept as FILE.old.
        accept: use the numbers of tests that contradict the design or each other, with widened intervals.
        folder: folder for identification.json, residuals.csv and identification.html. Default:
            exports/NAME/identification.
        page: write the page with residuals.
    """
    from probedesign.campaigns import read_campaign
    from probedesign.design import load_design
    from probedesign.identification.identify import data_of
    from probedesign.identification.identify import identify as fit
    from probedesign.identification.parameters import check_requested
    from probedesign.probe import build_probe
    from probedesign.web.home import refresh_home

    if write and out is not None:
        raise InputError("--write changes the design file and --out writes another one; choose one of them")
    if out is not None:
        check_overwrite(out, force)  # before the fit
    names: Sequence[str] = [name for name in (part.strip() for part in for_.split(",")) if name]
    with show_progress("identifying"):
        start = load_design(design)
        names = check_requested(names)
        probe = build_probe(start)
        identified = fit(data_of(read_campaign(data), probe.model, probe.flange_volume), names, accept)
        folder = exports_of(design) / start.name / "identification" if folder is None else folder
        files = write_files(folder, _files(identified, page))
        refresh_home(probe.model, design)
    if not as_json:
        _print(identified)
        print("wrote", ", ".join(map(str, files)))
    changes: tuple[Change, ...] = ()
    path = backup = refused = None
    try:
        changes, path, backup = _write_design(identified, design, out, write, force)
    except InputError as error:
        if write or out is not None:
            raise
        refused = error
    if as_json:
        print_json({**identified.as_dict(), "files": files, "changes": changes, "design_written": path,
                    "design_kept": backup})  # fmt: skip
    elif changes:
        preview = f"--write would change {design} (values set or identified before only with --force):"
        print(f"wrote {path}; the former values are kept as comments:" if path else preview)
        for change in changes:
            print(f"  [{change.table}] {change.key} = {change.text}")
        if path is None:
            print(f"{design} was not changed. Write these values with --write, or to a copy with --out")
    if backup is not None and not as_json:
        print(f"kept the former {out} as {backup}")
    if refused is not None:  # raised last, so that all results are printed first
        raise refused


def _files(fit: "Identification", page: bool) -> Iterator[tuple[str, bytes]]:
    yield "identification.json", json_bytes(fit.as_dict(), ascii_only=False)
    yield "residuals.csv", fit.csv()
    if page:
        from probedesign.reports.identification_page import identification_page

        yield "identification.html", identification_page(fit)


def _write_design(
    fit: "Identification", design_path: Path, out: Path | None, write: bool, force: bool
) -> "tuple[tuple[Change, ...], Path | None, Path | None]":
    """Write identified parameters into a design file, which keeps its comments, its layout and the former values.

    Returns:
        The changes; the file written, if any; the backup of the file `out`, if there was one.
    """
    from probedesign.design import load_design
    from probedesign.design.edit import edit_text
    from probedesign.design.io import design_text
    from probedesign.identification.design_update import design_changes, write_changes

    day = date.today().isoformat()
    changes = design_changes(fit, load_design(design_path), day)
    if not write and out is None:  # checked all the same
        edit_text(design_text(design_path), changes, day, str(design_path))
        return changes, None, None
    return changes, *write_changes(design_path, changes, day, out, force)


def _print(fit: "Identification") -> None:
    head = f"{fit.name}  geometry {fit.fingerprint}  {plural(fit.tests, 'test')} of {fit.data}"
    print(f"{head}: {fit.result}")
    print_table({number.name: _value(number, fit.dimensions) for number in fit.found})
    for outlier in fit.outliers[:5]:
        print(f"  outlier: {outlier.words}; down-weighted")
    if len(fit.outliers) > 5:
        print(f"  and {len(fit.outliers) - 5} more outliers, in residuals.csv")
    for name in dict.fromkeys(shift.of for shift in fit.shifts):
        number = fit.of(name)
        if number is not None:
            shares = ", ".join(f"{shift.cause} {shift.percent:.2g} %" for shift in fit.shifts if shift.of == name)
            print(f"  {name} ± {number.relative_std:.2%} (one standard deviation): {shares}")
    for rank, cause in enumerate(fit.likely_causes[:MAX_CAUSES], 1):
        print(f"  likely cause {rank}: {cause}")
    for note in fit.notes:
        print(f"  note: {note}")


def _value(number: "Identified", dimensions: str) -> str:
    """Return a parameter's value and 95 % interval.

    Args:
        number: the identified parameter.
        dimensions: uncertainty of the print's dimensions; the interval that includes it is added where it is wider.
    """
    value = f"{number.value:.4g} {number.unit or f'({number.words})'}"
    if not number.estimated:
        return f"{value} (design value; {number.state})"
    text = f"{value}, 95 % interval {number.low:.4g} ... {number.high:.4g}"
    assert number.std is not None and number.std_of_print is not None
    if number.std_of_print > 1.1 * number.std:
        of_print = f"{number.value_of_print:.4g} {number.unit}".rstrip()
        text += (
            f" with the design's dimensions; {of_print}, {number.low_of_print:.4g} ... {number.high_of_print:.4g} with "
            f"{dimensions}"
        )
    if number.change:
        text += f"; {number.change} from the design's {number.design:.4g}"
    return text if number.identified else f"{text} ({number.why})"
