"""The whole chain from a design file to a map of touched points: one function with one result for each step.

    designs/NAME.toml ─ load_probe ─→ Probe ─┬─ export ──────→ parts, adapters, drawings and their manifest
                                             ├─ check ───────→ PrintCheck
                                             ├─ predict ─────→ Prediction
                                             ├─ optimize ────→ Optimum
                     calipers ───────────────├─ measure ─────→ MeasuredDiameters
                                             ├─ plan ────────→ Plan
                     measurements ───────────┼─ identify ────→ Identification
                                             └─ freeze ──────→ frozen probe ─ load_estimator ─→ Estimator
    Estimator ─┬─ validate (measurements) ──→ ValidationReport
               ├─ estimate (recording) ─────→ RecordingEstimates
               ├─ live (source) ────────────→ EstimateUpdate, EstimateUpdate, ...
               └─ `mapping.explore.Exploration` (source, poses) ──→ LocatedTouch, LocatedTouch, ..., their map

One `ProbeGeometry` feeds CAD, rod and estimator. The functions compute; reading options and writing files belongs to
the commands in `probedesign.cli`, except for `export`, whose solids and meshes exist as files only. Each function
imports what its own step needs, so that an export loads no estimator and an estimate loads no CAD.
"""

from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from probedesign.campaigns import Campaign
    from probedesign.core.parallel import OnProgress
    from probedesign.design import Design
    from probedesign.estimation.estimator import Estimator, Method
    from probedesign.identification.measured_print import Calipers, MeasuredAxis, MeasuredDiameters
    from probedesign.identification.result import Identification
    from probedesign.live import Log
    from probedesign.live.outputs.sinks import Sink
    from probedesign.live.poses.base_poses import BasePoses
    from probedesign.live.processing.chain import ProcessingOptions
    from probedesign.live.processing.commands import CommandQueue
    from probedesign.live.processing.estimates import EstimateUpdate
    from probedesign.live.processing.tare import TareWindow, Zero
    from probedesign.live.run import Progress, RecordingEstimates
    from probedesign.live.sources.replay import RecordingOptions
    from probedesign.live.sources.source import Source
    from probedesign.optimization.constraints import OptimizationProblem
    from probedesign.optimization.optimum import MonteCarloCheck, Optimum
    from probedesign.planning.candidates import Instruments
    from probedesign.planning.plan import Plan
    from probedesign.prediction.fused import PressSchedule
    from probedesign.prediction.predict import Prediction
    from probedesign.printing.check import PrintCheck
    from probedesign.probe import Probe
    from probedesign.validation.validate import ValidationReport


def load_probe(design_path: Path) -> "Probe":
    """Return the probe of a design file."""
    from probedesign.design import load_design
    from probedesign.probe import build_probe

    return build_probe(load_design(design_path))


def export(design: "Design", folder: Path | None, on_step: Callable[[str], None]) -> dict[str, Any]:
    """Write solids, adapters, meshes and drawings, and return their manifest. Needs CadQuery."""
    from probedesign import cad

    design.sensor_model.check_holes_known()
    return cad.export_parts(design, folder, on_step)


def export_part(design: "Design", part: str, folder: Path | None) -> dict[str, Any]:
    """Write the STL file of one printed part, and return its properties. Needs CadQuery."""
    from probedesign import cad

    design.sensor_model.check_holes_known()
    return cad.export_part(design, part, folder)


def export_coupon(design: "Design", folder: Path | None) -> dict[str, Any]:
    """Write a stepped cone and a rod to be printed and measured, and return their manifest. Needs CadQuery."""
    from probedesign import cad

    return cad.export_coupon(design, folder)


def measure(design: "Design", calipers: "Calipers", calipers_std_mm: float) -> "MeasuredDiameters":
    """Estimate the diameters of a print from readings of calipers, with its tolerances as prior."""
    from probedesign.identification.measured_print import fit_diameters
    from probedesign.probe import build_probe

    return fit_diameters(design, build_probe(design).tolerances, calipers, calipers_std_mm)


def measure_axis(design: "Design", points: Path) -> "MeasuredAxis":
    """Fit the axis of a print to points of its outline."""
    from probedesign.estimation.model import BOW_SHARE
    from probedesign.identification.measured_print import fit_axis, read_outline
    from probedesign.probe import build_probe

    again = "bow_mm" in design.probe.measured
    before = BOW_SHARE * design.probe.length_mm if again else build_probe(design).tolerances.bow_mm
    return fit_axis(design, read_outline(points), before)


def check(design: "Design") -> "PrintCheck":
    """Check a design against the rules of its printer and of both resins, without CAD."""
    from probedesign.printing.check import check_print

    return check_print(design)


def predict(probe: "Probe", pressing: "PressSchedule | None" = None) -> "Prediction":
    """Predict sensitivity and contact error, with the default schedule of fused touches if `pressing` is None."""
    return probe.predict(pressing=pressing)


def sample_prediction(
    probe: "Probe", prediction: "Prediction", draws: int, seed: int, checkpoint: Path | None, on_progress: "OnProgress"
) -> "Prediction":
    """Return a prediction with a Monte Carlo check of each of its conditions.

    An interrupted run resumes from the folder `checkpoint`; None keeps no checkpoint.
    """
    from probedesign.prediction.fused import SHOWN_N, worst
    from probedesign.prediction.monte_carlo import MonteCarloPlan, run_monte_carlo

    plan = MonteCarloPlan(probe.model, probe.tolerances, draws, seed, prediction.pressing)
    results = run_monte_carlo(
        plan, prediction, checkpoint, lambda share: on_progress("Monte Carlo", share),
        fused=worst(prediction.fused, SHOWN_N),
    )  # fmt: skip
    return replace(prediction, monte_carlo=results)


def optimize(search: "OptimizationProblem", name: str, on_progress: "OnProgress") -> "Optimum":
    """Find the best shape for a task; `name` is that of the new design."""
    from probedesign.optimization.optimum import optimum

    return optimum(search, name, on_progress)


def confirm(
    search: "OptimizationProblem", best: "Optimum", draws: int, seed: int, on_progress: "OnProgress"
) -> "tuple[MonteCarloCheck | None, MonteCarloCheck]":
    """Check start and optimum by Monte Carlo simulation; None for a start that buckles."""
    from probedesign.optimization.optimum import confirm as run

    start_buckles = best.before.error_mm is None
    before = None if start_buckles else run(search.start, best.task, draws, seed, on_progress)
    return before, run(best.design, best.task, draws, seed, on_progress)


def identify(design: "Design", campaign: "Campaign", names: Sequence[str], accept: bool = False) -> "Identification":
    """Estimate the named parameters of a printed probe from the measurements of a campaign.

    `accept` reports numbers with widened intervals where the tests contradict each other.
    """
    from probedesign.identification.identify import data_of
    from probedesign.identification.identify import identify as run
    from probedesign.probe import build_probe

    probe = build_probe(design)
    identified = run(data_of(campaign, probe.model, _flange_volume(probe)), names, accept)
    used = {residual.test for residual in identified.residuals}
    return replace(identified, served=tuple(test.digest for test in campaign.tests if test.name in used))


def plan(design: "Design", minutes: float, names: Sequence[str], instruments: "Instruments", held_out: int) -> "Plan":
    """Choose the tests of a campaign that determine the named parameters best in the time available [min].

    Raises:
        InputError: the design names no sensor, or no plan is possible.
    """
    from probedesign.core.errors import InputError
    from probedesign.planning.plan import make_plan
    from probedesign.probe import build_probe

    if "model" not in design.sensor.model_fields_set:
        raise InputError(
            f"{design.name}: [sensor] names no model; a plan needs the noise and the load limits of the "
            'sensor on the bench, such as model = "nano17"'
        )
    probe = build_probe(design)
    return make_plan(probe.model, _flange_volume(probe), minutes, names, instruments, held_out)


def _flange_volume(probe: "Probe") -> float:
    """Return the volume of the printed flange, which is weighed with the flexible part [m³]."""
    from probedesign.mount import Mount, mount_part_masses

    design = probe.design
    return mount_part_masses(probe.geometry, Mount.of(design).sensor_adapter, design.density.value)["flange"].volume


def freeze(probe: "Probe") -> dict[str, Any]:
    """Return all that an estimator needs of a probe as plain data: the frozen probe."""
    from probedesign import frozen_probe

    return frozen_probe.freeze(probe.model)


def load_estimator(
    bundle: Path, manifest: Path | None = None, exact_model: bool = False, friction: float | None = None
) -> "Estimator":
    """Return the estimator of a frozen probe.

    Args:
        bundle: NAME.probe.json.
        manifest: manifest.json of the printed parts, whose geometry is compared with the bundle's.
        exact_model: treat probe, mount and bench as exactly known. The drift of the sensor's bias still counts: a
            reading that the drift alone explains must not be located.
        friction: standard deviation of the friction prior; None keeps the bundle's.

    Raises:
        InputError: the file is unreadable, or the friction is NaN or below 0.
    """
    from probedesign import frozen_probe
    from probedesign.estimation.model import Tolerances

    estimator = frozen_probe.load_estimator(bundle, manifest)
    if exact_model:
        estimator = estimator.with_tolerances(Tolerances.exact_probe(estimator.model))
    return estimator if friction is None else estimator.with_friction(friction)


def validate(
    estimator: "Estimator",
    campaign: "Campaign",
    exact_model: bool,
    on_progress: "OnProgress",
    include_identified: bool = False,
) -> "ValidationReport":
    """Compare the estimates of a frozen probe with the reference of a campaign of its print."""
    from probedesign.validation.validate import validate as run

    return run(estimator, campaign, exact_model, include_identified, lambda share: on_progress("estimating", share))


def estimate(
    estimator: "Estimator",
    recording: Path,
    window: "TareWindow | None",
    average: int | None,
    *,
    method: "Method",
    options: "RecordingOptions",
    mend: bool = False,
    progress: "Progress" = iter,
    zero: "Zero" = "checked",
) -> "RecordingEstimates":
    """Locate the contacts of a recording; for the arguments see `estimate_recording`."""
    from probedesign.live.run import estimate_recording

    return estimate_recording(
        estimator, recording, window, average, progress=progress, allow_incomplete=mend, options=options,
        method=method, zero=zero,
    )  # fmt: skip


def live(
    estimator: "Estimator",
    source: "Source",
    options: "ProcessingOptions",
    log: "Log",
    sink: "Sink | None" = None,
    commands: "CommandQueue | None" = None,
    poses: "BasePoses | None" = None,
) -> "Generator[EstimateUpdate, None, None]":
    """Yield the located contacts of a live source as its readings arrive; for the arguments see `estimate_stream`."""
    from probedesign.live.run import estimate_stream

    return estimate_stream(estimator, source, options, log, sink, commands, poses)
