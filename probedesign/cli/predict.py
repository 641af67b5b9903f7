"""`probedesign predict`: predict sensitivity and contact error of a design."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from probedesign.cli.console import json_bytes, print_columns, print_json, print_table, show_progress, write_files
from probedesign.cli.options import DesignFile, JsonOutput
from probedesign.core.files import check_folder, exports_of
from probedesign.core.units import format_value

if TYPE_CHECKING:
    from probedesign.prediction.predict import Prediction
    from probedesign.probe import Probe

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
    as_json: JsonOutput = False,
) -> None:
    """Predict sensitivity and contact error of a design; write prediction.json, .csv and .html.

    Args:
        out: output folder. Default: exports/NAME.
        monte_carlo: check the error budget by this number of simulated estimates per condition.
        seed: seed of the Monte Carlo simulation.
        touches: number of touches of one point that are fused while the base presses on.
    """
    from probedesign.design import load_design
    from probedesign.mount import root_contradiction
    from probedesign.prediction.fused import SHOWN_N, PressSchedule, worst
    from probedesign.probe import build_probe
    from probedesign.web.home import write_home

    schedule = PressSchedule(touches)
    with show_progress() as on_progress:
        probe = build_probe(load_design(design))
        folder = exports_of(design) / probe.design.name if out is None else out
        check_folder(folder)
        on_progress("predicting", None)
        prediction = probe.predict(pressing=schedule)
        if monte_carlo is not None:
            from probedesign.prediction.monte_carlo import MonteCarloPlan, run_monte_carlo

            plan = MonteCarloPlan(probe.model, probe.tolerances, monte_carlo, seed, schedule)
            rows = run_monte_carlo(plan, prediction, lambda share: on_progress("Monte Carlo", share),
                                   fused=worst(prediction.fused, SHOWN_N))  # fmt: skip
            prediction = replace(prediction, monte_carlo=rows)
        files = write_files(folder, prediction_files(probe, prediction))
        write_home(folder, probe.model, str(design))
    root = root_contradiction(probe.design)
    if as_json:
        print_json({**prediction.as_dict(), "root_warning": root or None})
        return
    _print_properties(prediction)
    if root:
        print(f"warning: {root}")
    print_tables(prediction)
    print("wrote", ", ".join(map(str, files)))


def prediction_files(probe: "Probe", prediction: "Prediction") -> Iterator[tuple[str, bytes]]:
    """Yield names and contents of the files of a prediction."""
    from probedesign.prediction.predict import along_csv, conditions_csv
    from probedesign.reports.prediction_page import prediction_page

    yield "prediction.json", json_bytes(prediction.as_dict())
    yield "prediction.csv", conditions_csv(prediction)
    yield "prediction-along.csv", along_csv(prediction)
    yield "prediction.html", prediction_page(prediction, probe.estimator())


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


def print_tables(prediction: "Prediction") -> None:
    """Print the errors of single readings and those by Monte Carlo simulation."""
    print("\nContact error of one reading [mm], RMS, worst direction, all error sources")
    forces, rows = sorted({c.force_N for c in prediction.conditions}), list[list[str]]()
    for fraction in sorted({c.contact_fraction for c in prediction.conditions}):
        cells = []
        for force in forces:
            here = [c for c in prediction.conditions if (c.contact_fraction, c.force_N) == (fraction, force)]
            failed = next((c.result for c in here if c.result != "ok"), None)
            worst = max((c.predicted_error_mm or 0.0 for c in here), default=0.0)
            cells.append(MARKS.get(failed, "/") if failed else f"{worst:.3g}")
        rows.append([f"{fraction:g}", *cells])
    print_columns(["s/L", *(f"{1e3 * force:g} mN" for force in forces)], rows)
    print("  - : detected, not located   . : not detected   ^ : beyond the sensor's range   / : the probe buckles")
    if over := [row for row in prediction.over_directions if row.force_N in (0.002, 0.005, 0.01, 0.02)]:
        print("\nOver all directions of the force: RMS (median; worst) [mm]")
        by_fraction: dict[float, list[str]] = {}
        for at in over:
            numbers = (at.rms_error_mm, at.median_error_mm, at.worst_error_mm)
            rms, median, largest = (format_value(value, ".2g") for value in numbers)
            by_fraction.setdefault(at.contact_fraction, []).append(f"{rms} ({median}; {largest})")
        heads = dict.fromkeys(f"{1e3 * at.force_N:g} mN" for at in over)
        print_columns(["s/L", *heads], [[f"{fraction:g}", *cells] for fraction, cells in by_fraction.items()])
    rows = []
    for row in prediction.monte_carlo:
        error = "none" if row.error_mm is None else f"{row.error_mm:.3g} ± {row.standard_error_mm:.1g}"
        rows.append([f"{row.contact_fraction:g}", f"{1e3 * row.force_N:g} mN", row.direction, f"{row.touches}",
                     _cell(row.first_order_mm), error + ("*" if row.differs else " "), _cell(row.error_95_mm),
                     f"{row.located / row.draws:.0%}"])  # fmt: skip
    if rows:
        print("\nMonte Carlo, all error sources; * differs from the error budget by more than 10 %")
        print_columns(["s/L", "force", "from", "touches", "budget", "Monte Carlo ", "95 %", "located"], rows)


def _cell(value: float | None) -> str:
    return format_value(value, ".3g")
