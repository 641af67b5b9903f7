"""The chain from a design file to its results: one function for each arrow.

    designs/NAME.toml → design → geometry → section, mass ─→ rod ─→ estimator ─→ prediction ─→ report
                            ├→ print check                                            └→ frozen probe → live
                            └→ cad (solids, adapters) → exports/NAME/ + manifest → PreForm

`probe.build_probe` is the middle of it: one `ProbeGeometry` feeds the rod and CadQuery. `estimate`, `live` and
`explore` read the frozen probe only; they are in `probedesign.live` and `probedesign.exploring`. Each function imports
what its own arrow needs, so that an export loads no estimator.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from probedesign.core.errors import InputError
from probedesign.core.files import backup, check_writable, write_atomically
from probedesign.core.units import MM
from probedesign.design import Design, load_design

if TYPE_CHECKING:
    from probedesign.design.io import Change
    from probedesign.identification.result import Identification
    from probedesign.optimization.grid import GridAxis
    from probedesign.optimization.optimum import OptimizationProblem, OptimizeResult
    from probedesign.optimization.sweep import SweepResult
    from probedesign.optimization.task import Task
    from probedesign.prediction.fused import PressSchedule
    from probedesign.prediction.predict import Prediction
    from probedesign.prediction.table_one import TableOne
    from probedesign.printing.check import PrintCheck
    from probedesign.printing.preform_job import PreparedJob, PrintOrder
    from probedesign.probe import Probe
    from probedesign.reports.comparison_page import ComparedDesign
    from probedesign.simulation.campaign_folder import SimulatedCampaign
    from probedesign.simulation.ground_truth import CampaignPlan
    from probedesign.validation.validate import MultiProbeReport, ValidationReport

EXPORTS = Path("exports")
SUMMARY_TOUCH = (0.8, 0.010, "+y")
"""Fraction of the length, force [N] and direction of the touch that `new` reports: light, and near the tip."""
Progress = Callable[[str, float | None], None]
"""Called with the step at work and the completed fraction, which is None where it is unknown."""


def _ignore(step: str, fraction: float | None = None) -> None:
    """Report no progress."""


def probe_of(design_path: Path) -> "Probe":
    """Return the probe of a design file."""
    from probedesign.probe import build_probe

    return build_probe(load_design(design_path))


def summary(design: Design) -> dict[str, Any]:
    """Return the main figures of a design.

    Returns:
        mass_g, sag_mm, thinnest_mm, fits_upright, printer, print_check, expected_error_mm,
        expected_error_condition, assumptions.
    """
    from probedesign.prediction.predict import predict_touch, tip_sag_mm
    from probedesign.printing.check import check_print
    from probedesign.probe import build_probe

    probe = build_probe(design)
    estimator = probe.estimator()
    fraction, force_N, direction = SUMMARY_TOUCH
    touch = predict_touch(estimator, fraction, force_N, direction)
    found = check_print(design)
    return {
        "mass_g": 1e3 * probe.mass,
        "sag_mm": tip_sag_mm(estimator),
        "thinnest_mm": probe.geometry.thinnest / MM,
        "fits_upright": found.fits,
        "printer": found.printer,
        "print_check": found.as_record(),
        "expected_error_mm": touch.predicted_error_mm if touch.result == "ok" else None,
        "expected_error_condition": f"RMS, {1e3 * force_N:g} mN at {fraction:g} of the length, one reading "
        f"of {design.sensor.averaging_samples} samples ({touch.result})",
        "assumptions": list(design.assumptions),
    }


def check(design_path: Path) -> "PrintCheck":
    """Check a design against the rules of the printer and of both resins, without CAD."""
    from probedesign.printing.check import check_print

    return check_print(load_design(design_path))


def export(
    design_path: Path, out: Path | None = None, progress: Callable[[str], None] = _ignore
) -> dict[str, Any]:
    """Write solids, adapters and meshes with their manifest to exports/NAME/; return the manifest. Needs CadQuery."""
    from probedesign.cad import export_parts

    return export_parts(load_design(design_path), out, progress)


def prepare_print(
    design_path: Path,
    preform: str,
    order: "PrintOrder",
    timeout_s: float,
    on_progress: Progress,
) -> "PreparedJob":
    """Prepare the exported parts in PreForm: a form file, and the queue of a printer if one is named."""
    from probedesign.printing.preform_client import PreForm, connection_to
    from probedesign.printing.preform_job import check_form_file, load_job, path_mapping, prepare_job

    design = load_design(design_path)
    connection = connection_to(preform)
    job = load_job(design, order.folder or EXPORTS / design.name, order.parts)
    places = path_mapping(job.folder, order.server_folder, connection.local, connection.url)
    if order.form_file is not None:
        order = replace(order, form_file=check_form_file(order.form_file, places, order.force))
    return prepare_job(PreForm(connection, timeout_s, on_progress=on_progress), job, places, order)


def predict(
    design_path: Path,
    out: Path | None = None,
    plots: bool | None = None,
    draws: int | None = None,
    seed: int = 0,
    on_progress: Progress = _ignore,
    pressing: "PressSchedule | None" = None,
) -> tuple["Prediction", list[Path]]:
    """Predict sensitivity and contact error of a design and write the report.

    Args:
        design_path: the design file.
        out: folder for prediction.json, its tables as CSV, prediction.html and prediction.png; exports/NAME if None.
        plots: write page and picture; None writes the picture where matplotlib is installed.
        draws: Monte Carlo samples of each condition; no Monte Carlo if None.
        seed: seed of the samples.
        on_progress: progress callback.
        pressing: schedule of the touches that are fused; the default one if None.

    Returns:
        The prediction and the files written.
    """
    from probedesign.prediction.predict import along_csv, conditions_csv

    probe = probe_of(design_path)
    folder = EXPORTS / probe.design.name if out is None else out
    on_progress("predicting", None)
    prediction = probe.predict(pressing=pressing)
    if draws is not None:
        from probedesign.prediction.fused import shown
        from probedesign.prediction.monte_carlo import MonteCarloPlan, run_monte_carlo

        plan = MonteCarloPlan(probe.model, probe.tolerances, draws, seed, prediction.pressing)
        sampled = run_monte_carlo(plan, prediction, folder, lambda share: on_progress("Monte Carlo", share),
                         fused=shown(prediction.fused))  # fmt: skip
        prediction = replace(prediction, monte_carlo=sampled)
    files = [folder / "prediction.json"]
    write_atomically(files[0], (json.dumps(prediction.as_dict(), indent=1) + "\n").encode())
    for name, table in (("prediction.csv", conditions_csv), ("prediction-along.csv", along_csv)):
        files.append(folder / name)
        write_atomically(files[-1], table(prediction))
    if plots is False:
        return prediction, files
    from probedesign.reports.prediction_page import prediction_page

    estimator = probe.estimator()
    files.append(folder / "prediction.html")
    write_atomically(files[-1], prediction_page(prediction, estimator))
    if plots or find_spec("matplotlib") is not None:
        from probedesign.reports.png import draw_prediction

        files.append(folder / "prediction.png")
        write_atomically(files[-1], draw_prediction(prediction, estimator))
    return prediction, files


def predict_table_one() -> "TableOne":
    """Predict Table I of the paper for its probes."""
    from probedesign.prediction.table_one import PROBES, paper_design, table_one
    from probedesign.probe import build_probe

    probes = {name: build_probe(paper_design(name)) for name in PROBES}
    return table_one({name: (probe.model, probe.tolerances) for name, probe in probes.items()})


def compare(
    design_paths: list[Path], task: "Task", out: Path | None, page: bool
) -> tuple["list[ComparedDesign]", Path | None]:
    """Compute the figures of several designs for one task, and write a page with the same axes for all."""
    from probedesign.reports.comparison_page import compare as side_by_side
    from probedesign.reports.comparison_page import comparison_page
    from probedesign.reports.html_page import check_page_target

    if page and out is not None:
        check_page_target(out)
    compared = side_by_side([load_design(path) for path in design_paths], task)
    if not page:
        return compared, None
    file = out or EXPORTS / f"compare-{'-'.join(one.design.name for one in compared)}.html"
    write_atomically(file, comparison_page(compared, task))
    return compared, file


def sweep(
    design_path: Path,
    axes: "list[GridAxis]",
    task: "Task",
    out: Path | None,
    scheduler: str | None,
    workers: int,
    on_progress: Progress,
) -> "SweepResult":
    """Compute a grid of designs and write sweep.csv and sweep.parquet. Needs dask and pyarrow."""
    from probedesign.optimization.sweep import sweep as run

    design = load_design(design_path)
    return run(design, axes, task, out or EXPORTS / design.name / "sweep", scheduler, workers, on_progress)


def optimize(
    search: "OptimizationProblem",
    out: Path | None,
    force: bool,
    draws: int,
    trials: int,
    seed: int,
    on_progress: Progress,
) -> "OptimizeResult":
    """Find the best body for a task; write its design file, checked by Monte Carlo, and a Pareto front."""
    from probedesign.design.io import write_design
    from probedesign.optimization.confirm import confirm
    from probedesign.optimization.optimum import OptimizeResult, design_text, optimum
    from probedesign.optimization.pareto import check_installed, pareto_front

    path = out or Path("designs") / f"{search.start.name}-best.toml"
    if path.exists() and not force:
        raise InputError(f"{path}: exists already; --force replaces it, or name another with --out")
    check_writable(path)  # before the search, which takes a minute
    if trials:
        check_installed()
    best = optimum(search, path.stem, on_progress)
    write_design(design_text(search, best), path, force)  # first: the steps below may be interrupted or fail
    files, confirmed = [path], None
    try:
        if draws:
            start_gives_way = best.before.error_mm is None
            confirmed = (None if start_gives_way else confirm(search.start, best.task, draws, seed, on_progress),
                         confirm(best.design, best.task, draws, seed, on_progress))  # fmt: skip
        shown = pareto_front(search, trials, seed, on_progress, best) if trials else None
    except InputError as error:
        raise InputError(f"{path} is written, but {error}") from None
    if shown is not None:
        files.append(path.with_name(f"{path.stem}-front.csv"))
        write_atomically(files[1], shown.csv())
    if find_spec("matplotlib") is not None:
        from probedesign.reports.comparison_page import compare as side_by_side
        from probedesign.reports.comparison_page import comparison_page

        files.append(path.with_name(f"{path.stem}-compared.html"))
        compared = side_by_side([search.start, best.design], best.task)
        write_atomically(files[-1], comparison_page(compared, best.task))
    return OptimizeResult(search, best, confirmed, shown, tuple(files))


def identify(
    design_path: Path, data: Path, names: Sequence[str], folder: Path | None, page: bool
) -> tuple["Identification", list[Path]]:
    """Estimate the parameters of a probe from a campaign; write identification.json, residuals.csv and a page.

    Args:
        design_path: the design file.
        data: folder of the campaign.
        names: parameters to estimate.
        folder: of the files; exports/NAME/identification if None.
        page: write identification.html.
    """
    from probedesign.campaigns import read_campaign
    from probedesign.identification.identify import data_of
    from probedesign.identification.identify import identify as run
    from probedesign.identification.parameters import check_requested
    from probedesign.mount import mount_part_masses, sensor_adapter_for
    from probedesign.probe import build_probe

    design = load_design(design_path)
    names = check_requested(names)
    probe = build_probe(design)
    adapter = sensor_adapter_for(probe.geometry, design.sensor_model, design.name)
    flange = mount_part_masses(probe.geometry, adapter, design.density.value)["flange"]
    found = run(data_of(read_campaign(data), probe.model, flange.volume), names)
    place = EXPORTS / design.name / "identification" if folder is None else folder
    files = [place / "identification.json", place / "residuals.csv"]
    write_atomically(files[0], (json.dumps(found.as_dict(), indent=1, ensure_ascii=False) + "\n").encode())
    write_atomically(files[1], found.csv())
    if page:
        from probedesign.reports.identification_page import identification_page

        files.append(place / "identification.html")
        write_atomically(files[2], identification_page(found))
    return found, files


def write_identified(
    found: "Identification", design_path: Path, out: Path | None, write: bool, force: bool
) -> "tuple[tuple[Change, ...], Path | None, Path | None]":
    """Write identified parameters into a design file, which keeps its comments, its layout and the former values.

    Args:
        found: the identified parameters.
        design_path: the design file.
        out: another file to write instead.
        write: write the file; otherwise the changes are computed only.
        force: replace values that were set or identified before, or the file `out`, of which a backup is made.

    Returns:
        The changes; the file written, if any; the backup of the file `out`, if there was one.
    """
    from datetime import date

    from probedesign.design.io import edit_text, write_design
    from probedesign.identification.design_update import check_overwritable, design_changes

    design, text = load_design(design_path), design_path.read_bytes().decode("utf-8-sig")
    day = date.today().isoformat()
    changes = design_changes(found, design, day)
    result = edit_text(text, changes, day, str(design_path))
    if not write and out is None:
        return changes, None, None
    if out is None:
        check_overwritable(design, text, changes, str(design_path), force)
        write_design(result, design_path, force=True)
        return changes, design_path, None
    kept = backup(out) if force else None
    write_design(result, out, force=force)
    return changes, out, kept


def campaign(
    design_path: Path, out: Path, plan: "CampaignPlan", force: bool, on_progress: Progress
) -> "SimulatedCampaign":
    """Simulate the measurements of a laboratory on a randomly perturbed print of a design; write a data folder."""
    from probedesign.simulation.campaign_folder import make_campaign

    return make_campaign(probe_of(design_path).model, out, plan, force, on_progress)


def validate(
    bundle: Path,
    data: Path,
    out: Path | None,
    exact_model: bool,
    plots: bool | None,
    on_progress: Progress,
) -> tuple["ValidationReport", list[Path]]:
    """Compare the estimates of a frozen probe with the stereo reference; write table, page and picture.

    Args:
        bundle: the frozen probe.
        data: folder of a campaign.
        out: folder for validation.json, .csv, .html and .png; exports/NAME/validation if None.
        exact_model: take the model of the frozen probe as exactly known.
        plots: write page and picture; None writes the picture where matplotlib is installed.
        on_progress: progress callback.

    Returns:
        The report and the files written.
    """
    from probedesign.campaigns import read_campaign
    from probedesign.frozen_probe import load_estimator
    from probedesign.validation.validate import validate as compare_all

    estimator, campaign = load_estimator(bundle), read_campaign(data)
    folder = EXPORTS / estimator.model.name / "validation" if out is None else out
    check_writable(folder / "validation.json")
    found = compare_all(estimator, campaign, exact_model, lambda share: on_progress("estimating", share))
    on_progress("drawing", None)
    written = {
        "validation.json": (json.dumps(found.as_dict(), indent=1) + "\n").encode(),
        "validation.csv": found.csv(),
    }
    if plots is not False:
        from probedesign.reports.validation_page import validation_page

        written["validation.html"] = validation_page(found)
        if plots or find_spec("matplotlib") is not None:
            from probedesign.reports.png import draw_validation

            written["validation.png"] = draw_validation(found)
    for name, content in written.items():
        write_atomically(folder / name, content)
    return found, [folder / name for name in written]


def validate_all(
    pairs: Sequence[tuple[Path, Path]],
    out: Path | None,
    exact_model: bool,
    plots: bool | None,
    on_progress: Progress,
) -> tuple["MultiProbeReport", list[Path]]:
    """Validate several frozen probes and write one table of all, as Table I of the paper, beside the files of each.

    Args:
        pairs: frozen probe and campaign folder of each probe.
        out: folder of table1.csv and of one folder for each probe; if None the table is written into exports and
            the files of each probe as by `validate`.
        exact_model: as in `validate`.
        plots: as in `validate`.
        on_progress: progress callback.
    """
    from probedesign.frozen_probe import load_estimator
    from probedesign.validation.validate import MultiProbeReport, check_names

    names = [load_estimator(bundle).model.name for bundle, _ in pairs]
    check_names(names)
    found, files = [], []
    for name, (bundle, data) in zip(names, pairs, strict=True):
        one, written = validate(
            bundle, data, None if out is None else out / name, exact_model, plots, on_progress
        )
        found.append(one)
        files += written
    joined = MultiProbeReport(tuple(found))
    files.append((EXPORTS if out is None else out) / "table1.csv")
    write_atomically(files[-1], joined.csv())
    return joined, files


def deploy(design_path: Path, out: Path | None = None) -> Path:
    """Write the frozen probe of a design, unless the parts exported beside it have another geometry.

    Returns:
        The file written: exports/NAME/NAME.probe.json unless `out` is given.
    """
    from probedesign.frozen_probe import check_manifest, check_replaceable, write_frozen

    probe = probe_of(design_path)
    path = EXPORTS / probe.design.name / f"{probe.design.name}.probe.json" if out is None else out
    check_replaceable(path)
    manifest = path.parent / "manifest.json"
    if manifest.exists():
        check_manifest(probe.geometry.fingerprint, manifest)
    write_frozen(probe.model, path)
    return path


def unapplied_parameters(design_path: Path) -> str:
    """Return a sentence on the identified parameters that the design does not have; empty if it has all."""
    from probedesign.identification.design_update import design_diff

    probe = probe_of(design_path)
    file = EXPORTS / probe.design.name / "identification/identification.json"
    return design_diff(probe.design, probe.geometry.fingerprint, file)
