"""`probedesign validate`: compare a frozen probe's estimates with a reference."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from probedesign.cli.console import json_bytes, print_columns, print_json, print_note, show_progress, write_files
from probedesign.cli.options import JsonOutput, frozen_probe
from probedesign.core.errors import InputError
from probedesign.core.files import check_writable, exports_of
from probedesign.core.units import format_value

if TYPE_CHECKING:
    from probedesign.validation.validate import ValidationReport

#: Printed columns of a test, after its force and place.
NUMBERS = ("shape_rms_mm", "shape_rms_percent", "contact_error_mm", "stated_error_mm", "predicted_error_mm")


def validate(
    *bundles_and_data: Path,
    out: Path | None = None,
    exact_model: bool = False,
    include_identified: bool = False,
    as_json: JsonOutput = False,
) -> None:
    """Compare estimates with a reference: shape RMS, contact error and coverage of the stated covariance.

    Writes validation.json, .csv and .html; for several probes also table1.csv. See docs/measurements.md.

    Args:
        bundles_and_data: the frozen probe, NAME.probe.json or its name, and the folder of a campaign; then the same of
            further probes.
        out: output folder; for several probes it has one folder each. Default: exports/NAME/validation.
        exact_model: treat probe, mount and bench as exactly known; sensor noise, drift of its bias and the friction
            prior remain. Default: all tolerances of BUNDLE.
        include_identified: judge also tests that the parameters of BUNDLE were identified from. Default: these are
            listed and left out of the verdict and the means.
    """
    from probedesign.campaigns import read_campaign
    from probedesign.frozen_probe import load_estimator
    from probedesign.validation.validate import MultiProbeReport, ValidationReport, check_names
    from probedesign.validation.validate import validate as judge
    from probedesign.web.home import refresh_home

    pairs = _pairs(bundles_and_data)
    reports, files = list[ValidationReport](), list[Path]()
    with show_progress() as on_progress:
        estimators = [load_estimator(bundle) for bundle, _ in pairs]
        if len(pairs) > 1:
            check_names([estimator.model.name for estimator in estimators])
        for estimator, (_, data) in zip(estimators, pairs, strict=True):
            campaign, name = read_campaign(data), estimator.model.name
            folder = exports_of() / name / "validation" if out is None else out / name if len(pairs) > 1 else out
            check_writable(folder / "validation.json")
            report = judge(
                estimator, campaign, exact_model, include_identified, lambda share: on_progress("estimating", share)
            )
            on_progress("drawing", None)
            files += write_files(folder, _files(report))
            if out is None:
                refresh_home(estimator.model)
            reports.append(report)
        joined = MultiProbeReport(tuple(reports))
        if len(pairs) > 1:
            files += write_files(out or exports_of(), [("table1.csv", joined.csv())])
    if as_json:
        print_json(joined.as_dict() if len(pairs) > 1 else reports[0].as_dict())
        return
    _print(reports)
    print("wrote", ", ".join(map(str, files)))
    for report in reports:
        for note in report.notes:
            print_note(_prefix(report, reports) + note)


def _pairs(paths: tuple[Path, ...]) -> list[tuple[Path, Path]]:
    if not paths or len(paths) % 2:
        raise InputError(f"{len(paths)} paths are given; validate needs pairs of a bundle and its data folder, "
                         "BUNDLE DATA")  # fmt: skip
    return [(frozen_probe(bundle), data) for bundle, data in zip(paths[::2], paths[1::2], strict=True)]


def _files(report: "ValidationReport") -> Iterator[tuple[str, bytes]]:
    yield "validation.json", json_bytes(report.as_dict())
    yield "validation.csv", report.csv()
    from probedesign.reports.validation_page import validation_page

    yield "validation.html", validation_page(report)


def _prefix(report: "ValidationReport", reports: "Sequence[ValidationReport]") -> str:
    return f"{report.estimator.model.name}: " if len(reports) > 1 else ""


def _print(reports: "Sequence[ValidationReport]") -> None:
    for report in reports:
        model = report.estimator.model
        print(f"{model.name}  geometry {model.fingerprint}  {report.campaign.folder}")
        print(f"  {report.coverage.sentence}")
    print()
    head = ["probe", "test", "dir", "force\nmN", "s/L", "shape RMS\nmm", "\n%", "contact\nmm", "stated\nmm",
            "predicted\nmm", "95 %", "method", "result"]  # fmt: skip
    print_columns(head, [_cells(row) for report in reports for row in report.rows()])
    for report in reports:
        prefix = _prefix(report, reports)
        print()
        for kind, means in report.summary.items():
            shape, contact = means["shape_rms_mm"], means["contact_error_mm"]
            print(f"  {prefix}{kind:<8}shape RMS mean {_mm(shape.mean)}, largest {_mm(shape.largest)}; "
                  f"contact error mean {_mm(contact.mean)}, RMS {_mm(contact.rms)}")  # fmt: skip
        print()
        for line in report.coverage.words:
            print(f"  {prefix}{line}")
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
