"""`probedesign predict`: predict sensitivity and contact error of a design."""

from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from probedesign.cli.console import json_bytes, print_columns, print_json, print_table, show_progress, write_files
from probedesign.cli.options import DesignFile, JsonOutput, Origin
from probedesign.core.errors import MissingDependencyError
from probedesign.core.files import check_folder, exports_of
from probedesign.core.units import format_value

if TYPE_CHECKING:
    from probedesign.prediction.fused import PredictedTouch
    from probedesign.prediction.predict import Prediction
    from probedesign.prediction.workspace import Workspace
    from probedesign.probe import Probe

#: Contact force of the printed error budget of fused touches, which are located at lower forces.
FUSED_BUDGET_FORCE_N = 0.005
#: Printed name of what limits the contact force.
LIMITS = {"gives_way": "buckling", "sensor": "sensor", "slips_off": "slips off", "none": "none"}
#: Printed instead of an error, by result code; any other code is "/".
MARKS = {"too_light": "-", "unobservable": "-", "interval_only": "-", "no_contact": ".", "out_of_range": "^"}


def predict(
    design: DesignFile,
    /,
    *,
    out: Path | None = None,
    monte_carlo: int | None = None,
    seed: int = 0,
    touches: int = 5,
    moments_about: Origin | None = None,
    plots: Annotated[bool | None, Parameter(negative="--no-plots")] = None,
    verbose: bool = False,
    as_json: JsonOutput = False,
) -> None:
    """Predict sensitivity and contact error of a design; write prediction.json, .csv, .html and .png.

    Args:
        out: output folder. Default: exports/NAME.
        monte_carlo: check the error budget by this number of simulated estimates per condition. An interrupted run is
            resumed by the same command.
        seed: seed of the Monte Carlo simulation.
        touches: number of touches of one point that are fused while the base presses on.
        moments_about: fuse the moments about this origin only. Default: forces and moments.
        plots: write page and picture. Default: the page, and the picture if matplotlib is installed.
        verbose: print all tables: sensitivity, error budgets, force limits and workspace too.
    """
    from probedesign import pipeline
    from probedesign.mount import root_contradiction
    from probedesign.prediction.fused import PressSchedule
    from probedesign.web.home import write_home

    schedule = PressSchedule(touches, moments_about)
    with show_progress() as on_progress:
        probe = pipeline.load_probe(design)
        folder = exports_of(design) / probe.design.name if out is None else out
        check_folder(folder)
        on_progress("predicting", None)
        prediction = pipeline.predict(probe, schedule)
        if monte_carlo is not None:
            prediction = pipeline.sample_prediction(probe, prediction, monte_carlo, seed, folder, on_progress)
        files = write_files(folder, prediction_files(probe, prediction, plots))
        write_home(folder, probe.model, str(design))
    root = root_contradiction(probe.design)
    if as_json:
        print_json({**prediction.as_dict(), "root_warning": root or None})
        return
    _print_properties(prediction)
    if root:
        print(f"warning: {root}")
    print_tables(prediction, verbose)
    if not verbose:
        print("--verbose prints sensitivity, error budgets, force limits and workspace too")
    print("wrote", ", ".join(map(str, files)))
    if plots is None and not any(file.suffix == ".png" for file in files):
        print("no picture was written:", MissingDependencyError.of_extra("a plot", "matplotlib", "plots"))


def prediction_files(
    probe: "Probe", prediction: "Prediction", plots: bool | None = None
) -> Iterator[tuple[str, bytes]]:
    """Yield names and contents of the files of a prediction; for `plots` see `predict`."""
    from probedesign.prediction.predict import along_csv, conditions_csv

    yield "prediction.json", json_bytes(prediction.as_dict())
    yield "prediction.csv", conditions_csv(prediction)
    yield "prediction-along.csv", along_csv(prediction)
    if plots is False:
        return
    from probedesign.reports.prediction_page import prediction_page

    estimator = probe.estimator()
    yield "prediction.html", prediction_page(prediction, estimator)
    if plots or find_spec("matplotlib") is not None:
        from probedesign.reports.png import draw_prediction

        yield "prediction.png", draw_prediction(prediction, estimator)


def _print_properties(prediction: "Prediction") -> None:
    from probedesign.design.catalog import assumed_text

    sag = (
        "none: no stable equilibrium under gravity as mounted, so the figures below do not apply"
        if prediction.tip_sag_mm is None
        else f"{prediction.tip_sag_mm:.3g} mm at the tip, under gravity as mounted"
    )
    print(f"{prediction.name}  geometry {prediction.fingerprint}")
    print(prediction.verdict)
    fused = prediction.fused_headline
    error, gain = fused.predicted_error_mm, prediction.bench_gain
    print_table(
        {
            "fused": f"{'not located' if error is None else f'{error:.2g} mm RMS'}; {fused.label}",
            **({} if gain is None else {"bench": gain.text}),
            "mass": f"{prediction.mass_g:.3g} g, flexible part",
            "sag": sag,
            "noise": f"{prediction.noise_force_mN:.3g} mN and {prediction.noise_moment_Nmm:.3g} N·mm "
            "per channel of one reading, standard deviation",
            "friction": "any direction of the force"
            if prediction.friction is None
            else f"{prediction.friction:g}, standard deviation of tangential over normal force",
            "assumed until measured": assumed_text(prediction.assumptions),
        }
    )


def print_tables(prediction: "Prediction", verbose: bool = True) -> None:
    """Print errors and Monte Carlo of a prediction; verbose: sensitivity, error budgets, forces and workspace too."""
    print("\nContact error of one reading [mm], RMS, worst direction, all error sources")
    _print_errors(prediction, "predicted_error_mm")
    print("  - : detected, not located   . : not detected   ^ : beyond the sensor's range   / : the probe buckles")
    if over := [row for row in prediction.over_directions if row.force_N in (0.002, 0.005, 0.01, 0.02)]:
        print("\nOver all directions of the force: RMS (median; worst) [mm]")
        by_fraction: dict[float, list[str]] = {}
        for at in over:
            numbers = (at.rms_error_mm, at.median_error_mm, at.worst_error_mm)
            rms, median, largest = (format_value(value, ".2g") for value in numbers)
            by_fraction.setdefault(at.contact_fraction, []).append(f"{rms} ({median}; {largest})")
        forces = dict.fromkeys(f"{1e3 * at.force_N:g} mN" for at in over)
        print_columns(["s/L", *forces], [[f"{fraction:g}", *cells] for fraction, cells in by_fraction.items()])
    rows = []
    for row in prediction.monte_carlo:
        error = "none" if row.error_mm is None else f"{row.error_mm:.3g} ± {row.standard_error_mm:.1g}"
        rows.append([f"{row.contact_fraction:g}", f"{1e3 * row.force_N:g} mN", row.direction, f"{row.touches}",
                     _cell(row.first_order_mm), error + ("*" if row.differs else " "), _cell(row.error_95_mm),
                     f"{row.located / row.draws:.0%}"])  # fmt: skip
    if rows:
        print("\nMonte Carlo, all error sources; * differs from the error budget by more than 10 %")
        print_columns(["s/L", "force", "from", "touches", "budget", "Monte Carlo ", "95 %", "located"], rows)
    if not verbose:
        return
    from probedesign.prediction.predict import HEADLINE_FORCE_N

    print("\nContact error of one reading [mm], sensor noise and friction prior only; the probe equals its model")
    _print_errors(prediction, "noise_error_mm")
    _print_sensitivity(prediction)
    _print_budget(prediction, prediction.conditions, HEADLINE_FORCE_N, "one reading at")
    _print_budget(prediction, prediction.fused, FUSED_BUDGET_FORCE_N, f"{prediction.pressing.text}, up to")
    print("  Tolerances are assumed unless the design states them: prediction.json, [tolerances].")
    _print_thresholds(prediction)
    _print_workspace(prediction.workspace)


def _print_errors(prediction: "Prediction", error: str) -> None:
    forces, rows = sorted({c.force_N for c in prediction.conditions}), []
    for fraction in sorted({c.contact_fraction for c in prediction.conditions}):
        cells = []
        for force in forces:
            here = [c for c in prediction.conditions if (c.contact_fraction, c.force_N) == (fraction, force)]
            failed = next((c.result for c in here if c.result != "ok"), None)
            worst = max((getattr(c, error) or 0.0 for c in here), default=0.0)
            cells.append(MARKS.get(failed, "/") if failed else f"{worst:.3g}")
        rows.append([f"{fraction:g}", *cells])
    print_columns(["s/L", *(f"{1e3 * force:g} mN" for force in forces)], rows)


def _print_sensitivity(prediction: "Prediction") -> None:
    print("\nSensitivity at the lightest force, worst direction")
    lightest, rows = min(c.force_N for c in prediction.conditions), []
    for fraction in sorted({c.contact_fraction for c in prediction.conditions}):
        here = [c for c in prediction.conditions if (c.contact_fraction, c.force_N) == (fraction, lightest)]
        detectable = [d.detectable_force_mN for d in prediction.detection if d.contact_fraction == fraction]
        values = (
            max((f for f in detectable if f is not None), default=None),
            min((c.moment_per_N_Nmm for c in here if c.moment_per_N_Nmm is not None), default=None),
            min((c.moment_per_mm_Nmm for c in here if c.moment_per_mm_Nmm is not None), default=None),
            min((1e3 * c.force_per_mm_N for c in here if c.force_per_mm_N is not None), default=None),
        )
        rows.append([f"{fraction:g}", *map(_cell, values)])
    head = ["s/L", "detectable\nmN", "moment/force\nN·mm/N", "moment/depth\nN·mm/mm", "force/depth\nmN/mm"]
    print_columns(head, rows)


def _print_budget(prediction: "Prediction", conditions: "Sequence[PredictedTouch]", force_N: float, kind: str) -> None:
    """Print the error budget of the worst direction at each located place, for the force nearest to `force_N` [N]."""
    from probedesign.prediction.fused import worst

    force = min((c.force_N for c in conditions), key=lambda f: abs(f - force_N), default=0.0)
    located = worst([c for c in conditions if c.force_N == force and c.result == "ok"], force)
    if not located:
        print(f"\nError budget of {kind} this force: none, no place is located")
        return
    print(f"\nError budget [mm], RMS of {kind} {1e3 * force:g} mN by error source, worst direction")
    rows: dict[str, list[float | None]] = {
        cause: [(c.budget_mm or {})[cause] for c in located] for cause in located[0].budget_mm or {}
    }
    rows["all"] = [c.predicted_error_mm for c in located]
    rows["95 % radius"] = [c.predicted_error_95_mm for c in located]

    def cell(value: float | None) -> str:
        """Return the value [mm] to 0.01 mm; smaller parts of an error budget are negligible."""
        if value is None or value >= 100:
            return _cell(value)
        return "<0.01" if value < 0.005 else f"{value:.2f}"

    fractions = [c.contact_fraction for c in located]
    print_columns(["s/L", *(f"{fraction:g}" for fraction in fractions)],
                  [[name, *map(cell, values)] for name, values in rows.items()])  # fmt: skip
    missing = ", ".join(f"{c:g}" for c in sorted({c.contact_fraction for c in prediction.conditions} - set(fractions)))
    if missing:
        print(f"  Not located at this force: {missing}")


def _print_thresholds(prediction: "Prediction") -> None:
    from probedesign.reports.prediction_page import threshold_rows

    print("\nForce limits and thresholds, full error budget, worst direction")
    rows = [[f"{fraction:g}", *map(_cell, forces), LIMITS[weakest.limit], _cell(weakest.deflection_mm)]
            for fraction, forces, weakest in threshold_rows(prediction)]  # fmt: skip
    fused = f"2 mm, {prediction.pressing.touches} fused\nmN"
    print_columns(["s/L", "detect\nmN", "5 mm\nmN", "2 mm\nmN", "1 mm\nmN", fused, "largest\nmN", "limit",
                   "deflection\nmm"], rows)  # fmt: skip
    lightest = min((1e3 * c.force_N for c in prediction.fused), default=0.0)
    if any(f.force_mN_for_2_mm == lightest for f in prediction.fused_reach):
        print(f"  Fused touches: {lightest:g} mN is the lightest force evaluated; the true threshold may be lower.")


def _print_workspace(workspace: "Workspace") -> None:
    if not workspace.paths:
        return
    print("\nWorkspace of the contact point for a fixed base")
    for side, area in (workspace.area_mm2 or {}).items():
        furthest = max((path for path in workspace.paths if path.direction == side),
                       key=lambda path: path.pressed_mm, default=None)  # fmt: skip
        extent = " (mirrored)" if furthest is None else (
            f", up to {furthest.pressed_mm:.3g} mm at {furthest.contact_fraction:g} of the length")  # fmt: skip
        print(f"  along {side}  area {1e-2 * area:.3g} cm²{extent}")
    if workspace.volume_mm3 is not None:
        print(f"  volume {1e-3 * workspace.volume_mm3:.3g} cm³")


def _cell(value: float | None) -> str:
    return format_value(value, ".3g")
