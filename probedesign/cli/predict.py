"""`probedesign predict`: what a design will sense, before it is printed."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from probedesign.cli import prediction_tables as tables
from probedesign.cli.console import print_json, print_table, telling, working
from probedesign.errors import InputError

if TYPE_CHECKING:
    from probedesign.prediction.predict import Prediction


def predict(
    design: Path | None = None,
    /,
    *,
    out: Path | None = None,
    monte_carlo: int | None = None,
    seed: int = 0,
    touches: int = 5,
    forces_too: bool = False,
    table1: bool = False,
    plots: Annotated[bool | None, Parameter(negative="--no-plots")] = None,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> None:
    """Predict sensitivity and contact error of a design; write prediction.json, .csv, .html and .png.

    Args:
        design: the design file; none with --table1.
        out: folder for them; by default exports/NAME.
        monte_carlo: check the error budget by so many simulated estimates of each condition; goes on where an
            interrupted run of the same stopped.
        seed: of what Monte Carlo draws.
        table1: predict the paper's Table I for its own three probes, beside what was measured.
        touches: how many touches of one point are fused, as the base presses on.
        forces_too: fuse forces and moments; by default the moments alone that the sensor reads.
        plots: make the page, which reads without a network, and the picture; by default the latter where matplotlib
            is installed.
        as_json: print one JSON document instead of tables.
    """
    from probedesign import pipeline
    from probedesign.prediction.press_schedule import PressSchedule

    if (design is None) is not table1:
        raise InputError(
            "predict needs a design file, or --table1 and none: probedesign predict designs/NAME.toml"
        )
    if design is None:
        if (out, monte_carlo, seed, touches, forces_too, plots) != (None, None, 0, 5, False, None):
            raise InputError("--table1 takes --json alone: it writes no files and fuses nothing")
        with working("predicting the paper's table"):
            table = pipeline.predict_table_one()
        if as_json:
            print_json(table.as_dict())
        else:
            tables.print_table_one(table)
        return
    pressing = PressSchedule(touches, None if forces_too else "sensor")
    with telling() as tell:
        prediction, files = pipeline.predict(design, out, plots, monte_carlo, seed, tell, pressing)
    if as_json:
        print_json(prediction.as_dict())
    else:
        _print(prediction)
        print("wrote", ", ".join(map(str, files)))
        if plots is None and not any(file.suffix == ".png" for file in files):
            print("no picture: matplotlib is not installed (pip install 'probedesign[plots]')")


def _print(prediction: "Prediction") -> None:
    sag = (
        "none: the probe cannot stand as mounted, so nothing below holds"
        if prediction.tip_sag_mm is None
        else f"{prediction.tip_sag_mm:.3g} mm at the tip, under gravity as mounted"
    )
    print(f"{prediction.name}  geometry {prediction.fingerprint}")
    print_table(
        {
            "mass": f"{prediction.mass_g:.3g} g, flexible part",
            "sag": sag,
            "noise": f"{prediction.noise_force_mN:.3g} mN and {prediction.noise_moment_Nmm:.3g} N·mm "
            "a reading and channel",
            "friction": "direction of the force free"
            if prediction.friction is None
            else f"{prediction.friction:g}, tangential over normal force, standard deviation",
            "assumed": ", ".join(prediction.assumptions) or "nothing",
        }
    )
    print("\nContact error [mm], RMS of one reading, worst of the directions; all causes counted")
    print(_error_table(prediction, "predicted_error_mm"))
    print("\nThe same by the sensor's noise alone, of a probe that is exactly its model")
    print(_error_table(prediction, "noise_error_mm"))
    print("\n- : felt but not located   . : not felt   ^ : beyond the sensor   / : the probe gives way")
    print("\nAt the lightest force, worst of the directions")
    print(_sensitivity_table(prediction))
    tables.print_all(prediction)


_MARKS = {"too_light": "-", "unobservable": "-", "no_contact": ".", "out_of_range": "^"}


def _error_table(prediction: "Prediction", error: str) -> str:
    forces = sorted({c.force_N for c in prediction.conditions})
    lines = ["  s/L  " + "".join(f"{1e3 * f:>7g} mN" for f in forces)]
    for fraction in sorted({c.contact_fraction for c in prediction.conditions}):
        cells = []
        for force in forces:
            here = [c for c in prediction.conditions if (c.contact_fraction, c.force_N) == (fraction, force)]
            bad = next((c.result for c in here if c.result != "ok"), None)
            worst = max((getattr(c, error) or 0.0 for c in here), default=0.0)
            cells.append(_MARKS.get(bad, "/") if bad else f"{worst:.3g}")
        lines.append(f"  {fraction:<5g}" + "".join(f"{cell:>10}" for cell in cells))
    return "\n".join(lines)


def _sensitivity_table(prediction: "Prediction") -> str:
    lightest = min(c.force_N for c in prediction.conditions)
    lines = ["  s/L    detectable    moment/force    moment/press    force/press",
             "                 mN          N·mm/N         N·mm/mm          mN/mm"]  # fmt: skip
    for fraction in sorted({c.contact_fraction for c in prediction.conditions}):
        here = [c for c in prediction.conditions if (c.contact_fraction, c.force_N) == (fraction, lightest)]
        felt = [d.detectable_force_mN for d in prediction.detection if d.contact_fraction == fraction]
        cells = (
            max((f for f in felt if f is not None), default=None),
            min((c.moment_per_N_Nmm for c in here if c.moment_per_N_Nmm is not None), default=None),
            min((c.moment_per_mm_Nmm for c in here if c.moment_per_mm_Nmm is not None), default=None),
            min((1e3 * c.force_per_mm_N for c in here if c.force_per_mm_N is not None), default=None),
        )
        shown = ["none" if cell is None else f"{cell:.3g}" for cell in cells]
        lines.append(f"  {fraction:<5g}{shown[0]:>12}{shown[1]:>16}{shown[2]:>16}{shown[3]:>15}")
    return "\n".join(lines)
