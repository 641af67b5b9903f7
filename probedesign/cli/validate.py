"""`probedesign validate`: compare a frozen probe's estimates with a reference."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from probedesign.cli.console import json_bytes, print_columns, print_json, print_note, show_progress, write_files
from probedesign.cli.options import FrozenProbe, JsonOutput
from probedesign.core.files import check_writable, exports_of
from probedesign.core.units import format_value

if TYPE_CHECKING:
    from probedesign.validation.validate import ValidationReport

#: Printed columns of a test, after its force and place.
NUMBERS = ("shape_rms_mm", "shape_rms_percent", "contact_error_mm", "stated_error_mm", "predicted_error_mm")


def validate(
    bundle: FrozenProbe,
    data: Path,
    /,
    *,
    out: Path | None = None,
    exact_model: bool = False,
    include_identified: bool = False,
    as_json: JsonOutput = False,
) -> None:
    """Compare estimates with a reference: shape RMS, contact error and coverage of the stated covariance.

    Writes validation.json, .csv and .html. See docs/measurements.md.

    Args:
        data: the folder of a campaign.
        out: output folder. Default: exports/NAME/validation.
        exact_model: treat probe, mount and bench as exactly known; sensor noise, drift of its bias and the friction
            prior remain. Default: all tolerances of BUNDLE.
        include_identified: judge also tests that the parameters of BUNDLE were identified from. Default: these are
            listed and left out of the verdict and the means.
    """
    from probedesign.campaigns import read_campaign
    from probedesign.frozen_probe import load_estimator
    from probedesign.validation.validate import validate as judge
    from probedesign.web.home import refresh_home

    with show_progress() as on_progress:
        estimator = load_estimator(bundle)
        campaign = read_campaign(data)
        folder = exports_of() / estimator.model.name / "validation" if out is None else out
        check_writable(folder / "validation.json")
        report = judge(
            estimator, campaign, exact_model, include_identified, lambda share: on_progress("estimating", share)
        )
        on_progress("drawing", None)
        files = write_files(folder, _files(report))
        if out is None:
            refresh_home(estimator.model)
    if as_json:
        print_json(report.as_dict())
        return
    _print(report)
    print("wrote", ", ".join(map(str, files)))
    for note in report.notes:
        print_note(note)


def _files(report: "ValidationReport") -> Iterator[tuple[str, bytes]]:
    yield "validation.json", json_bytes(report.as_dict())
    yield "validation.csv", report.csv()
    from probedesign.reports.validation_page import validation_page

    yield "validation.html", validation_page(report)


def _print(report: "ValidationReport") -> None:
    model = report.estimator.model
    print(f"{model.name}  geometry {model.fingerprint}  {report.campaign.folder}\n  {report.coverage.sentence}\n")
    head = ["probe", "test", "dir", "force\nmN", "s/L", "shape RMS\nmm", "\n%", "contact\nmm", "stated\nmm",
            "predicted\nmm", "95 %", "method", "result"]  # fmt: skip
    print_columns(head, [_cells(row) for row in report.rows()])
    print()
    for kind, means in report.summary.items():
        shape, contact = means["shape_rms_mm"], means["contact_error_mm"]
        print(f"  {kind:<8}shape RMS mean {_mm(shape.mean)}, largest {_mm(shape.largest)}; "
              f"contact error mean {_mm(contact.mean)}, RMS {_mm(contact.rms)}")  # fmt: skip
    print()
    for line in report.coverage.words:
        print(f"  {line}")
    print()


def _cells(row: dict[str, Any]) -> list[str]:
    force = None if row["force_N"] is None else 1e3 * row["force_N"]
    numbers = (force, row["contact_fraction"], *(row[name] for name in NUMBERS))
    inside = {None: "", True: "in", False: "out"}[row["within_95"]]
    served = "" if row["held_out"] or row["kind"] == "free" else "  served"
    return [row["probe"], row["test"], row["direction"][:3] or "-",
            *(format_value(number, ".3g", missing="-") for number in numbers),
            inside, row["method"], row["result"] + served]  # fmt: skip


def _mm(value: float | None) -> str:
    return format_value(value, ".3g", "mm", "-")
