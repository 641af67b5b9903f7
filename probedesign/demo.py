"""The whole chain on a built-in example: from a few numbers to a located contact."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from probedesign import pipeline
from probedesign.deployment import load_estimator
from probedesign.design_file import draft_design, render_design, write_design
from probedesign.errors import InputError, MissingDependencyError
from probedesign.estimation.estimator import Estimator
from probedesign.files import write_atomically
from probedesign.live.offline import estimate_recording
from probedesign.live.processing.blocks import iter_readings
from probedesign.live.recordings.csv import write_recording
from probedesign.live.sources.sim import SimulatedSource
from probedesign.reports.png import SweepSeries, draw_sweep
from probedesign.units import MM

FOLDER = pipeline.EXPORTS / "demo"
NAME = "demo"
TOUCH = "force_mN=20&seconds=20&rate_hz=10&speed=max"
"""What is simulated: 20 mN swept along the probe and back, with the sensor's noise."""


@dataclass(frozen=True)
class Demo:
    """What the demo made.

    Attributes:
        made: each file with what it is for, in the order of the chain.
        skipped: what could not be made, and why.
        located: how many readings gave a contact.
        touches: how many had one.
        error_mm: RMS distance of the located from the truly touched points.
        predicted_mm: what the estimates themselves said it would be.
    """

    made: dict[str, str]
    skipped: tuple[str, ...]
    located: int
    touches: int
    error_mm: float
    predicted_mm: float

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return dict(vars(self))


def run_demo(
    out: Path | None = None, say: Callable[[str], None] = lambda _: None, force: bool = False
) -> Demo:
    """Design, predict, export (with CadQuery), deploy, simulate a recording, estimate; all into one folder.

    Args:
        out: the folder; exports/demo if None.
        say: told each step in a few words.
        force: replace what stands there, even if it is not what a demo left.

    Raises:
        InputError: the folder holds an edited design or somebody else's files.
    """
    folder = FOLDER if out is None else out
    made: dict[str, str] = {}
    skipped: list[str] = []
    say("designing a 150 mm cone, 12 mm at its base")
    design = folder / f"{NAME}.toml"
    drafted, notes = draft_design(NAME, shape="cone", length_mm=150.0, base_d_mm=12.0)
    text = render_design(drafted, notes)
    if not force:
        _check_own(folder, design, text)
    write_design(text, design, force=True)
    made[str(design)] = "the design: edit it and run the chain again"
    say("predicting what it will feel (the first run compiles the rod, half a minute or so)")
    made |= _predicted(design, folder, skipped)
    say("building the parts")
    made |= _exported(design, folder, skipped)
    say("freezing the estimator with this geometry")
    bundle = pipeline.deploy(design, folder / f"{NAME}.probe.json")
    made[str(bundle)] = "the frozen probe: all that estimate and live need"
    say("touching it in simulation and locating the touches")
    estimator = load_estimator(bundle)
    recording, contacts = folder / "recording.csv", folder / "contacts.csv"
    sweep = _touched(estimator, recording, contacts)
    made[str(recording)] = "a simulated recording: 20 mN swept along the probe"
    made[str(contacts)] = "where estimate located each touch"
    made |= _pictured(sweep, folder / "contacts.png")
    error, ok = sweep.error_mm, np.isfinite(sweep.error_mm)
    said = float(np.sqrt(np.mean(sweep.predicted_mm[ok] ** 2)))
    rms = float(np.sqrt(np.mean(error[ok] ** 2)))
    return Demo(made, tuple(skipped), int(ok.sum()), int(np.isfinite(sweep.true_s_mm).sum()), rms, said)


def _check_own(folder: Path, design: Path, text: str) -> None:
    """A folder is the demo's own if it is new, empty, or holds the demo's design as the demo writes it."""
    if (
        folder.is_dir()
        and any(folder.iterdir())
        and not (design.is_file() and design.read_text("utf-8") == text)
    ):
        raise InputError(
            f"{folder}: holds files that the demo did not leave like that; --force replaces them, --out goes elsewhere"
        )


def _predicted(design: Path, folder: Path, skipped: list[str]) -> dict[str, str]:
    _, files = pipeline.predict(design, folder)
    if len(files) == 1:
        skipped.append("pictures need matplotlib: pip install 'probedesign[plots]'")
    return {str(file): "what it will feel, how well it will locate" for file in files}


def _exported(design: Path, folder: Path, skipped: list[str]) -> dict[str, str]:
    try:
        manifest = pipeline.export(design, folder)
    except MissingDependencyError as error:
        skipped.append(str(error))
        return {}
    what = {
        ".stl": "to print",
        ".3mf": "to print",
        ".step": "all parts in place",
        ".html": "how it goes together: open it first",
        ".svg": "dimensioned drawing",
        ".png": "preview",
        ".csv": "what to print and to buy",
        ".json": "what was made and checked",
    }
    return {str(folder / name): what[Path(name).suffix] for name in [*manifest["files"], "manifest.json"]}


def _pictured(sweep: SweepSeries, path: Path) -> dict[str, str]:
    try:
        write_atomically(path, draw_sweep(sweep))
    except MissingDependencyError:  # told already where the prediction was drawn
        return {}
    return {str(path): "truth and estimate, side by side"}


def _touched(estimator: Estimator, recording: Path, contacts: Path) -> SweepSeries:
    """Simulate, record, estimate, and set the estimates beside the truth."""
    readings = list(iter_readings(SimulatedSource(estimator.model, TOUCH)))
    time = np.array([r.time for r in readings])
    write_recording(recording, time, np.array([r.wrench_sensor for r in readings]))
    estimates = estimate_recording(estimator, recording)
    write_atomically(contacts, estimates.csv().encode())
    truth = np.array([np.append(r.truth.s_contact, r.truth.p_surface_base) for r in readings if r.truth]) / MM
    columns = ["s_contact_mm", "std_s_mm", *(f"p_surface_base_{a}_mm" for a in "xyz")]
    found = np.array([[row[c] for c in columns] for row in estimates.rows], dtype=float)
    spread = np.array(
        [[row[f"cov_surface_base_{a}{a}_mm2"] for a in "xyz"] for row in estimates.rows], dtype=float
    )
    return SweepSeries(
        time_s=time,
        true_s_mm=truth[:, 0],
        s_mm=found[:, 0],
        std_s_mm=found[:, 1],
        error_mm=np.linalg.norm(found[:, 2:5] - truth[:, 1:4], axis=1),
        predicted_mm=np.sqrt(spread.sum(axis=1)),
    )
