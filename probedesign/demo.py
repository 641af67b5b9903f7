"""Run the whole chain on a built-in example, from a few dimensions to located contacts."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from probedesign import pipeline
from probedesign.core.errors import InputError, MissingDependencyError
from probedesign.core.files import write_atomically
from probedesign.core.units import MM
from probedesign.design.io import draft_design, render_design, write_design
from probedesign.estimation.estimator import Estimator
from probedesign.frozen_probe import load_estimator
from probedesign.live.processing.blocks import iter_readings
from probedesign.live.recordings.csv import write_recording
from probedesign.live.run import estimate_recording
from probedesign.live.sources.sim import SimulatedSource
from probedesign.reports.png import SweepSeries, draw_sweep

FOLDER = pipeline.EXPORTS / "demo"
NAME = "demo"
TOUCH = "force_mN=20&seconds=20&rate_hz=10&speed=max"
"""Simulated contact: 20 mN, swept along the probe and back, with the sensor's noise."""


@dataclass(frozen=True)
class DemoResult:
    """Files of the demo, and the error of its estimates.

    Attributes:
        made: each file with its purpose, in the order of the chain.
        skipped: reasons for files that could not be written.
        located: number of located contacts.
        touches: number of readings with a contact.
        error_mm: RMS distance between located and true contact points [mm].
        predicted_mm: the same from the estimates' own covariances [mm].
    """

    made: dict[str, str]
    skipped: tuple[str, ...]
    located: int
    touches: int
    error_mm: float
    predicted_mm: float

    def as_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return dict(vars(self))


def run_demo(
    out: Path | None = None, on_step: Callable[[str], None] = lambda _: None, force: bool = False
) -> DemoResult:
    """Design, predict, export (with CadQuery), deploy, simulate a recording and estimate; all in one folder.

    Args:
        out: the folder; exports/demo if None.
        on_step: called with the name of each step.
        force: replace existing files, even those that the demo did not write.

    Returns:
        The files, and the contact error.

    Raises:
        InputError: the folder has an edited design or other files.
    """
    folder = FOLDER if out is None else out
    made: dict[str, str] = {}
    skipped: list[str] = []
    on_step("designing a 150 mm cone, 12 mm at its base")
    design = folder / f"{NAME}.toml"
    drafted, notes = draft_design(NAME, shape="cone", length_mm=150.0, base_d_mm=12.0)
    text = render_design(drafted, notes)
    if not force:
        _check_folder(folder, design, text)
    write_design(text, design, force=True)
    made[str(design)] = "the design; edit it and run the chain again"
    on_step("predicting sensitivity and contact error (the first run compiles the rod, about half a minute)")
    made |= _predict(design, folder, skipped)
    on_step("building the parts")
    made |= _export(design, folder, skipped)
    on_step("freezing the estimator and its geometry")
    bundle = pipeline.deploy(design, folder / f"{NAME}.probe.json")
    made[str(bundle)] = "the frozen probe for estimate and live"
    on_step("simulating a recording and locating its contacts")
    estimator = load_estimator(bundle)
    recording, contacts = folder / "recording.csv", folder / "contacts.csv"
    sweep = _simulate(estimator, recording, contacts)
    made[str(recording)] = "a simulated recording: 20 mN, swept along the probe"
    made[str(contacts)] = "the located contacts, one estimate per row"
    made |= _draw(sweep, folder / "contacts.png")
    error, ok = sweep.error_mm, np.isfinite(sweep.error_mm)
    predicted = float(np.sqrt(np.mean(sweep.predicted_mm[ok] ** 2)))
    rms = float(np.sqrt(np.mean(error[ok] ** 2)))
    touches = int(np.isfinite(sweep.true_s_mm).sum())
    return DemoResult(made, tuple(skipped), int(ok.sum()), touches, rms, predicted)


def _check_folder(folder: Path, design: Path, text: str) -> None:
    """Check that a folder is new, empty, or has the design that the demo writes.

    Raises:
        InputError: it has other files.
    """
    if (
        folder.is_dir()
        and any(folder.iterdir())
        and not (design.is_file() and design.read_text("utf-8") == text)
    ):
        raise InputError(
            f"{folder} has files that the demo did not write. --force replaces them; --out names another folder"
        )


def _predict(design: Path, folder: Path, skipped: list[str]) -> dict[str, str]:
    """Predict, and return the files; a picture that cannot be drawn is added to `skipped`."""
    _, files = pipeline.predict(design, folder)
    if not any(file.suffix == ".png" for file in files):
        skipped.append(str(MissingDependencyError.of_extra("a plot", "matplotlib", "plots")))
    return {str(file): "predicted sensitivity and contact error" for file in files}


def _export(design: Path, folder: Path, skipped: list[str]) -> dict[str, str]:
    """Export the parts, and return the files; without CadQuery the reason is added to `skipped`."""
    try:
        manifest = pipeline.export(design, folder)
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
    return {str(folder / name): purposes[Path(name).suffix] for name in [*manifest["files"], "manifest.json"]}


def _draw(sweep: SweepSeries, path: Path) -> dict[str, str]:
    """Draw true and estimated contacts, and return the file; none without matplotlib."""
    try:
        write_atomically(path, draw_sweep(sweep))
    except MissingDependencyError:  # reported with the prediction's picture
        return {}
    return {str(path): "true and estimated contacts"}


def _simulate(estimator: Estimator, recording: Path, contacts: Path) -> SweepSeries:
    """Simulate and record readings, locate their contacts and return estimates and truth."""
    readings = list(iter_readings(SimulatedSource(estimator.model, TOUCH)))
    time = np.array([r.time for r in readings])
    write_recording(recording, time, np.array([r.wrench_sensor for r in readings]))
    estimates = estimate_recording(estimator, recording)
    write_atomically(contacts, estimates.csv().encode())
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
