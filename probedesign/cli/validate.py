"""`probedesign validate`: what the frozen probe estimates beside what a reference measured."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from probedesign.cli.console import print_json, telling
from probedesign.errors import InputError

if TYPE_CHECKING:
    from probedesign.validation.validate import ValidationReport


def validate(
    *bundles_and_data: Path,
    out: Path | None = None,
    exact_model: bool = False,
    plots: Annotated[bool | None, Parameter(negative="--no-plots")] = None,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> None:
    """Compare estimates with a reference: shape RMS, contact error, and whether stated errors come true.

    Writes validation.json, .csv, .html and .png; of several probes table1.csv too. See docs/measurements.md.

    Args:
        bundles_and_data: the frozen probe, NAME.probe.json, and the folder of a campaign; then those of further probes.
        out: folder for the files, of several probes one folder each in it; by default exports/NAME/validation.
        exact_model: take probe, mount and bench for exactly what BUNDLE says; the sensor's noise, the drift of its bias
            and the prior on friction remain. Otherwise all tolerances of BUNDLE count.
        plots: make the page and the picture; by default the latter where matplotlib is installed.
        as_json: print one JSON document instead of tables.
    """
    from probedesign import pipeline

    pairs = _pairs(bundles_and_data)
    validations: tuple[ValidationReport, ...]
    with telling() as tell:
        if len(pairs) == 1:
            found, files = pipeline.validate(*pairs[0], out, exact_model, plots, tell)
            validations, document = (found,), found.as_dict
        else:
            joined, files = pipeline.validate_all(pairs, out, exact_model, plots, tell)
            validations, document = joined.validations, joined.as_dict
    if as_json:
        print_json(document())
        return
    _print(validations)
    print("wrote", ", ".join(map(str, files)))
    for one in validations:
        for note in one.notes:
            print(
                f"note: {f'{one.estimator.model.name}: ' if len(validations) > 1 else ''}{note}",
                file=sys.stderr,
            )


def _pairs(paths: tuple[Path, ...]) -> list[tuple[Path, Path]]:
    if not paths or len(paths) % 2:
        raise InputError(f"{len(paths)} paths are given; validate takes a bundle and its data folder, "
                         "BUNDLE DATA, or several such pairs")  # fmt: skip
    return list(zip(paths[::2], paths[1::2], strict=True))


def _print(validations: "tuple[ValidationReport, ...]") -> None:
    for one in validations:
        print(
            f"{one.estimator.model.name}  geometry {one.estimator.model.fingerprint}  {one.campaign.folder}"
        )
    print(
        "\n  probe     test          force contact way    shape RMS    contact  stated predicted 95 %  "
        "method       result"
    )
    print("                             mN    of L         mm     %       mm      mm      mm")
    for one in validations:
        for row in one.rows():
            print(_line(row))
    for one in validations:
        _summarise(one, f"{one.estimator.model.name}: " if len(validations) > 1 else "")
    print()


def _line(row: dict[str, Any]) -> str:
    inside = {None: "", True: "in", False: "out"}[row["within_95"]]
    force = None if row["force_N"] is None else 1e3 * row["force_N"]
    return (f"  {row['probe'][:9]:<10}{row['test'][:12]:<12}{_cell(force, 7)}{_cell(row['contact_fraction'], 8)} "
            f"{row['direction'][:3] or '-':<4}{_cell(row['shape_rms_mm'], 7)}{_cell(row['shape_rms_percent'], 7)}"
            f"{_cell(row['contact_error_mm'], 8)}{_cell(row['stated_error_mm'], 8)}"
            f"{_cell(row['predicted_error_mm'], 8)}{inside:>6}   {row['method']:<13}{row['result']}")  # fmt: skip


def _summarise(found: "ValidationReport", name: str) -> None:
    print()
    for kind, means in found.summary.items():
        shape, contact = means["shape_rms_mm"], means["contact_error_mm"]
        print(f"  {name}{kind:<8}shape RMS mean {_mm(shape.mean)}, largest {_mm(shape.largest)}; "
              f"contact error mean {_mm(contact.mean)}, RMS {_mm(contact.rms)}")  # fmt: skip
    print()
    for line in found.coverage.words:
        print(f"  {name}{line}")


def _cell(value: Any, width: int) -> str:
    return f"{'-' if value is None else f'{value:.3g}':>{width}}"


def _mm(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g} mm"
