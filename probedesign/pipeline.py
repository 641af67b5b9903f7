"""The whole chain, one function an arrow. Read this page first.

    designs/NAME.toml → design → geometry → section, mass ─→ rod ─→ estimator ─→ prediction ─→ report
                            ├→ print check                                            └→ frozen probe → live
                            └→ cad (solids, adapters) → exports/NAME/ + manifest → PreForm

`probe.build_probe` is the middle of it: one `ProbeGeometry` feeds the rod here and CadQuery there. The
frozen probe at the end is all that `estimate` and `live` ever read.
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
from probedesign.design.io import write_design
from probedesign.frozen_probe import check_manifest, check_replaceable, write_frozen
from probedesign.prediction.fused import PressSchedule
from probedesign.prediction.predict import (
    PRESSING,
    Prediction,
    along_csv,
    conditions_csv,
    predict_touch,
    tip_sag_mm,
)
from probedesign.printing.check import PrintCheck, check_print
from probedesign.printing.preform.client import PreForm, connection_to
from probedesign.printing.preform.job import (
    PreparedJob,
    PrintOrder,
    check_form_file,
    load_job,
    path_mapping,
    prepare_job,
)
from probedesign.probe import Probe, build_probe

if TYPE_CHECKING:
    from probedesign.design.edit import Change
    from probedesign.identification.result import Identification
    from probedesign.optimization.grid import GridAxis
    from probedesign.optimization.optimum import OptimizationProblem, OptimizeResult
    from probedesign.optimization.sweep import SweepResult
    from probedesign.optimization.task import Task
    from probedesign.prediction.table_one import TableOne
    from probedesign.reports.comparison_page import ComparedDesign
    from probedesign.simulation.campaign_folder import SimulatedCampaign
    from probedesign.simulation.ground_truth import CampaignPlan
    from probedesign.validation.validate import MultiProbeReport, ValidationReport

EXPORTS = Path("exports")
SUMMARY_TOUCH = (0.8, 0.010, "+y")
"""Fraction, newtons and direction of the touch that `new` speaks of: delicate, and near the tip."""


def _quiet(_: str) -> None:
    """Say nothing."""


def _silent(_: str, __: float | None) -> None:
    """Tell nothing."""


def probe_of(design_path: Path) -> Probe:
    """Design file → design → geometry, mass, rod."""
    return build_probe(load_design(design_path))


def summary(design: Design) -> dict[str, Any]:
    """What to expect of a design, in a few numbers.

    Returns:
        mass_g, sag_mm, thinnest_mm, fits_upright, printer, print_check, expected_error_mm,
        expected_error_condition, assumptions.
    """
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


def check(design_path: Path) -> PrintCheck:
    """Design → will it print? The rules of the printer and of both resins; no CAD."""
    return check_print(load_design(design_path))


def export(
    design_path: Path, out: Path | None = None, progress: Callable[[str], None] = _quiet
) -> dict[str, Any]:
    """Design → solids, adapters, meshes → exports/NAME/ with their manifest. Needs CadQuery."""
    from probedesign.cad import export_parts

    return export_parts(load_design(design_path), out, progress)


def prepare_print(
    design_path: Path,
    preform: str,
    order: PrintOrder,
    timeout_s: float,
    tell: Callable[[str, float | None], None],
) -> PreparedJob:
    """Exported parts → PreForm → form file, and the queue of a printer if one is named."""
    design = load_design(design_path)
    connection = connection_to(preform)
    job = load_job(design, order.folder or EXPORTS / design.name, order.parts)
    places = path_mapping(job.folder, order.server_folder, connection.local, connection.url)
    if order.form_file is not None:
        order = replace(order, form_file=check_form_file(order.form_file, places, order.force))
    return prepare_job(PreForm(connection, timeout_s, on_progress=tell), job, places, order)


def predict(
    design_path: Path,
    out: Path | None = None,
    plots: bool | None = None,
    draws: int | None = None,
    seed: int = 0,
    tell: Callable[[str, float | None], None] = _silent,
    pressing: PressSchedule = PRESSING,
) -> tuple[Prediction, list[Path]]:
    """Design → rod → estimator → prediction → report.

    Args:
        design_path: the design file.
        out: folder for prediction.json, its tables as CSV, prediction.html and prediction.png; exports/NAME if None.
        plots: make page and picture; None makes the picture where matplotlib is installed.
        draws: Monte Carlo's estimates of each condition; none is run if None.
        seed: of what it draws.
        tell: told the step at work and the share done, if known.
        pressing: how the touches are made that are fused.

    Returns:
        The prediction and the files written.
    """
    probe = probe_of(design_path)
    folder = EXPORTS / probe.design.name if out is None else out
    tell("predicting", None)
    prediction = probe.predict(pressing=pressing)
    if draws is not None:
        from probedesign.prediction.fused import shown
        from probedesign.prediction.monte_carlo import MonteCarloPlan, run_monte_carlo

        plan = MonteCarloPlan(probe.model, probe.tolerances, draws, seed, prediction.pressing)
        sampled = run_monte_carlo(plan, prediction, folder, lambda share: tell("Monte Carlo", share),
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
    """The paper's probes → its Table I, predicted."""
    from probedesign.prediction.table_one import PROBES, paper_design, table_one

    probes = {name: build_probe(paper_design(name)) for name in PROBES}
    return table_one({name: (probe.model, probe.tolerances) for name, probe in probes.items()})


def compare(
    design_paths: list[Path], task: "Task", out: Path | None, page: bool
) -> tuple["list[ComparedDesign]", Path | None]:
    """Designs → their figures for one task → a page with the same axes for all."""
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
    tell: Callable[[str, float | None], None],
) -> "SweepResult":
    """Design → many designs → their figures → sweep.csv, sweep.parquet. Needs dask and pyarrow."""
    from probedesign.optimization.sweep import sweep as run

    design = load_design(design_path)
    return run(design, axes, task, out or EXPORTS / design.name / "sweep", scheduler, workers, tell)


def optimize(
    search: "OptimizationProblem",
    out: Path | None,
    force: bool,
    draws: int,
    trials: int,
    seed: int,
    tell: Callable[[str, float | None], None],
) -> "OptimizeResult":
    """Design, task, limits → the best body → a design file, confirmed by drawn touches, with a Pareto front."""
    from probedesign.optimization.confirm import confirm
    from probedesign.optimization.optimum import OptimizeResult, design_text, optimum
    from probedesign.optimization.pareto import check_installed, pareto_front

    path = out or Path("designs") / f"{search.start.name}-best.toml"
    if path.exists() and not force:
        raise InputError(f"{path}: exists already; --force replaces it, or name another with --out")
    check_writable(path)  # here and below: a search takes a minute, so what cannot end does not begin
    if trials:
        check_installed()
    best = optimum(search, path.stem, tell)
    write_design(design_text(search, best), path, force)  # before what may be interrupted or find nothing
    files, confirmed = [path], None
    try:
        if draws:
            start_gives_way = best.before.error_mm is None
            confirmed = (None if start_gives_way else confirm(search.start, best.task, draws, seed, tell),
                         confirm(best.design, best.task, draws, seed, tell))  # fmt: skip
        shown = pareto_front(search, trials, seed, tell, best) if trials else None
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
    """Design, campaign → E, G and their kin → identification.json, residuals.csv, identification.html.

    Args:
        design_path: the design file.
        data: folder of the campaign.
        names: what is asked for.
        folder: for the files; exports/NAME/identification if None.
        page: make the page.
    """
    from probedesign.campaigns import read_campaign
    from probedesign.identification.identify import data_of
    from probedesign.identification.identify import identify as run
    from probedesign.identification.parameters import check_requested
    from probedesign.mount import mount_part_masses, sensor_adapter_for

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
    """Identified numbers → the design file, whose comments, layout and old values stay.

    Args:
        found: the numbers.
        design_path: the design file.
        out: another file to write instead.
        write: whether to write at all; else it is only looked what would change.
        force: replace what was set or identified before, or the file `out`, which is kept beside.

    Returns:
        The changes; the file that has them, if any; and where the file `out` that stood there is kept, if one did.
    """
    from datetime import date

    from probedesign.design.edit import edited
    from probedesign.identification.design_update import check_overwritable, design_changes

    design, text = load_design(design_path), design_path.read_bytes().decode("utf-8-sig")
    day = date.today().isoformat()
    changes = design_changes(found, design, day)
    result = edited(text, changes, day, str(design_path))
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
    design_path: Path, out: Path, plan: "CampaignPlan", force: bool, tell: Callable[[str, float | None], None]
) -> "SimulatedCampaign":
    """Design → a print of it, drawn → what a laboratory would measure of that → a data folder."""
    from probedesign.simulation.campaign_folder import make_campaign

    return make_campaign(probe_of(design_path).model, out, plan, force, tell)


def validate(
    bundle: Path,
    data: Path,
    out: Path | None,
    exact_model: bool,
    plots: bool | None,
    tell: Callable[[str, float | None], None],
) -> tuple["ValidationReport", list[Path]]:
    """Frozen probe, data folder → estimates beside the reference → table, page, picture.

    Args:
        bundle: the frozen probe.
        data: folder of a campaign.
        out: folder for validation.json, .csv, .html and .png; exports/NAME/validation if None.
        exact_model: take the probe for exactly what its file says.
        plots: make page and picture; None makes the picture where matplotlib is installed.
        tell: told the step at work and the share done.

    Returns:
        What was found and the files written.
    """
    from probedesign.campaigns import read_campaign
    from probedesign.frozen_probe import load_estimator
    from probedesign.validation.validate import validate as compare_all

    estimator, campaign = load_estimator(bundle), read_campaign(data)
    folder = EXPORTS / estimator.model.name / "validation" if out is None else out
    check_writable(folder / "validation.json")
    found = compare_all(estimator, campaign, exact_model, lambda share: tell("estimating", share))
    tell("drawing", None)
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
    tell: Callable[[str, float | None], None],
) -> tuple["MultiProbeReport", list[Path]]:
    """Frozen probes, each with its data folder → one table of all, as the paper's Table I, beside the files of each.

    Args:
        pairs: frozen probe and folder of a campaign, one a probe.
        out: folder for table1.csv and for a folder a probe; if None the table is written into exports, and each
            probe's files as `validate` does.
        exact_model: as for `validate`.
        plots: likewise.
        tell: likewise.
    """
    from probedesign.frozen_probe import load_estimator
    from probedesign.validation.validate import MultiProbeReport, check_names

    names = [load_estimator(bundle).model.name for bundle, _ in pairs]
    check_names(names)
    found, files = [], []
    for name, (bundle, data) in zip(names, pairs, strict=True):
        one, written = validate(bundle, data, None if out is None else out / name, exact_model, plots, tell)
        found.append(one)
        files += written
    joined = MultiProbeReport(tuple(found))
    files.append((EXPORTS if out is None else out) / "table1.csv")
    write_atomically(files[-1], joined.csv())
    return joined, files


def deploy(design_path: Path, out: Path | None = None) -> Path:
    """Design → frozen probe. Refused where the parts exported beside it are of another geometry.

    Returns:
        The file written: exports/NAME/NAME.probe.json unless `out` says otherwise.
    """
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
