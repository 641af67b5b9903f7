"""`probedesign demo`: run the whole chain on a built-in example, from a few dimensions to located contacts."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from probedesign.cli.console import print_json, print_step, print_table, write_files
from probedesign.cli.deploy import write_bundle
from probedesign.cli.options import EXPORTS, JsonOutput
from probedesign.cli.predict import prediction_files
from probedesign.core.errors import InputError, MissingDependencyError
from probedesign.core.units import MM

if TYPE_CHECKING:
    from probedesign.estimation.estimator import Estimator
    from probedesign.probe import Probe
    from probedesign.reports.png import SweepSeries

NAME = "demo"
TOUCH = "force_mN=20&seconds=20&rate_hz=10&speed=max"
"""Simulated contact: 20 mN, swept along the probe and back, with the sensor's noise."""


def demo(
    *,
    out: Path | None = None,
    force: bool = False,
    as_json: JsonOutput = False,
) -> None:
    """Run the whole chain on a built-in example: design, predict, export, deploy, simulate, estimate.

    Args:
        out: output folder. Default: exports/demo.
        force: replace existing files, even those that the demo did not write.
        as_json: print one JSON document.
    """
    result = run_demo(EXPORTS / NAME if out is None else out, force)
    if as_json:
        print_json(result)
        return
    print("wrote")
    print_table(result["made"])
    for reason in result["skipped"]:
        print("skipped:", reason)
    print(
        f"\n{result['located']} of {result['touches']} touches located; contact error {result['error_mm']:.2f} mm RMS, "
        f"predicted {result['predicted_mm']:.2f} mm RMS"
    )


def run_demo(folder: Path, force: bool) -> dict[str, Any]:
    """Design, predict, export (with CadQuery), deploy, simulate a recording and estimate; all in one folder.

    Returns:
        made: each file with its purpose; skipped: reasons for files that could not be written; numbers of located
        contacts and of touches; error_mm: RMS distance between located and true contact points; predicted_mm: the
        same from the estimates' own covariances.

    Raises:
        InputError: the folder has an edited design or other files, and `force` is not set.
    """
    import numpy as np

    from probedesign import pipeline
    from probedesign.design.io import draft_design, render_design, write_design

    made: dict[str, str] = {}
    skipped: list[str] = []
    print_step("designing a 150 mm cone, 12 mm at its base")
    design = folder / f"{NAME}.toml"
    drafted, notes = draft_design(NAME, shape="cone", length_mm=150.0, base_d_mm=12.0)
    text = render_design(drafted, notes)
    if not force:
        _check_folder(folder, design, text)
    write_design(text, design, force=True)
    made[str(design)] = "the design; edit it and run the chain again"
    print_step(
        "predicting sensitivity and contact error (the first run compiles the rod, about half a minute)"
    )
    probe = pipeline.load_probe(design)
    made |= _predict(probe, folder, skipped)
    print_step("building the parts")
    made |= _export(probe, folder, skipped)
    print_step("freezing the estimator and its geometry")
    bundle = write_bundle(probe, folder / f"{NAME}.probe.json")
    made[str(bundle)] = "the frozen probe for estimate and live"
    print_step("simulating a recording and locating its contacts")
    estimator = pipeline.load_estimator(bundle)
    recording, contacts = folder / "recording.csv", folder / "contacts.csv"
    sweep = _simulate(estimator, recording, contacts)
    made[str(recording)] = "a simulated recording: 20 mN, swept along the probe"
    made[str(contacts)] = "the located contacts, one estimate per row"
    made |= _draw(sweep, folder / "contacts.png")
    ok = np.isfinite(sweep.error_mm)
    return {
        "made": made,
        "skipped": skipped,
        "located": int(ok.sum()),
        "touches": int(np.isfinite(sweep.true_s_mm).sum()),
        "error_mm": float(np.sqrt(np.mean(sweep.error_mm[ok] ** 2))),
        "predicted_mm": float(np.sqrt(np.mean(sweep.predicted_mm[ok] ** 2))),
    }


def _check_folder(folder: Path, design: Path, text: str) -> None:
    """Refuse a folder that has other files than those of the demo."""
    if (
        folder.is_dir()
        and any(folder.iterdir())
        and not (design.is_file() and design.read_text("utf-8") == text)
    ):
        raise InputError(
            f"{folder} has files that the demo did not write. --force replaces them; --out names another folder"
        )


def _predict(probe: "Probe", folder: Path, skipped: list[str]) -> dict[str, str]:
    """Predict, and return the files; a picture that cannot be drawn is added to `skipped`."""
    from probedesign import pipeline

    files = write_files(folder, prediction_files(probe, pipeline.predict(probe)))
    if not any(file.suffix == ".png" for file in files):
        skipped.append(str(MissingDependencyError.of_extra("a plot", "matplotlib", "plots")))
    return {str(file): "predicted sensitivity and contact error" for file in files}


def _export(probe: "Probe", folder: Path, skipped: list[str]) -> dict[str, str]:
    """Export the parts, and return the files; without CadQuery the reason is added to `skipped`."""
    from probedesign import pipeline

    try:
        manifest = pipeline.export(probe.design, folder, lambda step: None)
    except MissingDependencyError as error:
        skipped.append(str(error))
        return {}
    purposes = {
        ".stl": "to print",
        ".3mf": "to print",
        ".step": "assembly of all parts",
        ".html": "assembly instructions",
        ".svg": "dimensioned drawing",
        ".png": "preview",
        ".csv": "parts to print and to buy",
        ".json": "manifest with the results of all checks",
    }
    files = {name: purposes[Path(name).suffix] for name in [*manifest["files"], "manifest.json"]}
    files |= {name: "exploded view" for name in files if name.startswith("exploded")}
    return {str(folder / name): purpose for name, purpose in files.items()}


def _draw(sweep: "SweepSeries", path: Path) -> dict[str, str]:
    """Draw true and estimated contacts, and return the file; none without matplotlib."""
    from probedesign.reports.png import draw_sweep

    try:
        write_files(path.parent, [(path.name, draw_sweep(sweep))])
    except MissingDependencyError:  # reported with the prediction's picture
        return {}
    return {str(path): "true and estimated contacts"}


def _simulate(estimator: "Estimator", recording: Path, contacts: Path) -> "SweepSeries":
    """Simulate and record readings, locate their contacts and return estimates and truth."""
    import numpy as np

    from probedesign.live.processing.blocks import iter_readings
    from probedesign.live.recordings.csv import write_recording
    from probedesign.live.run import estimate_recording
    from probedesign.live.sources.sim import SimulatedSource
    from probedesign.reports.png import SweepSeries

    readings = list(iter_readings(SimulatedSource(estimator.model, TOUCH)))
    time = np.array([r.time for r in readings])
    write_recording(recording, time, np.array([r.wrench_sensor for r in readings]))
    estimates = estimate_recording(estimator, recording)
    write_files(contacts.parent, [(contacts.name, estimates.csv().encode())])
    truth = np.array([np.append(r.truth.s_contact, r.truth.p_surface_base) for r in readings if r.truth]) / MM
    columns = ["s_contact_mm", "std_s_mm", *(f"p_surface_base_{a}_mm" for a in "xyz")]
    found = np.array([[row[c] for c in columns] for row in estimates.rows], dtype=float)
    variance = np.array(
        [[row[f"cov_surface_base_{a}{a}_mm2"] for a in "xyz"] for row in estimates.rows], dtype=float
    )
    return SweepSeries(
        time_s=time,
        true_s_mm=truth[:, 0],
        s_mm=found[:, 0],
        std_s_mm=found[:, 1],
        error_mm=np.linalg.norm(found[:, 2:5] - truth[:, 1:4], axis=1),
        predicted_mm=np.sqrt(variance.sum(axis=1)),
    )
