"""`probedesign plan`, `campaign` and `markers`: tests worth measuring, simulated ones, and markers in photographs."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from probedesign.cli.console import json_bytes, plural, print_columns, print_json, print_table, show_progress
from probedesign.cli.options import DesignFile, JsonOutput
from probedesign.core.errors import InputError
from probedesign.core.units import GRAM, MM, MPA

if TYPE_CHECKING:
    from probedesign.campaigns.photographs import PhotographedTest
    from probedesign.planning.candidates import Instruments
    from probedesign.planning.plan import Plan


def plan(
    design: DesignFile,
    out: Path | None = None,
    /,
    *,
    minutes: float = 120.0,
    for_: Annotated[str, Parameter(name="--for")] = "E,G,root,diameters",
    stage_mm: float | None = 0.05,
    stage: Annotated[bool, Parameter(negative="--no-stage")] = True,
    cameras_mm: float | None = None,
    weights_g: str = "0.5,1,2,5",
    turn: Annotated[bool, Parameter(negative="--no-turn")] = True,
    balance_g: float | None = 0.01,
    calipers_mm: float | None = 0.05,
    held_out: int = 4,
    force: bool = False,
    as_json: JsonOutput = False,
) -> None:
    """Plan a campaign: tests, expected intervals after each, a sheet to print and an empty data folder.

    Args:
        out: data folder to write, with plan.html. Default: data/NAME.
        minutes: time available [min], preparation included.
        for_: comma-separated parameters, as of identify: E, G, density, diameters, root, bow_x, bow_y,
            curvature, tilt, clocking, offset, gravity.
        stage_mm: standard deviation of a place that the stage measures, on each axis [mm].
        stage: there is a stage.
        cameras_mm: standard deviation of a marker by cameras or another reference, on each axis [mm]. Default: none.
        weights_g: comma-separated masses that can be hung by a thread [g]; "" for none.
        turn: the base can be held in other orientations with known poses.
        balance_g: standard deviation of a weighing [g]; 0 without a balance.
        calipers_mm: standard deviation of a measured diameter [mm]; 0 without calipers.
        held_out: number of touches that identify leaves out and validate judges by.
        force: replace a plan without measured values.
    """
    from probedesign.design import load_design
    from probedesign.identification.parameters import check_requested
    from probedesign.planning.plan import (
        CHECKLIST,
        PAGE,
        PLAN,
        check_target,
        checklist_text,
        make_plan,
        tables,
        write_folder,
    )
    from probedesign.probe import build_probe
    from probedesign.reports.plan_page import plan_page

    if stage_mm == 0.0:
        raise InputError(
            "--stage-mm 0: a stage measures a place with a standard deviation above 0; --no-stage plans without a stage"
        )
    names = check_requested([name for name in (part.strip() for part in for_.split(",")) if name])
    if not 0.0 < minutes <= 10_000.0:
        raise InputError(f"--minutes {minutes:g} must lie in 1 ... 10000")
    if not 0 <= held_out <= 40:
        raise InputError(f"--held-out {held_out} must lie in 0 ... 40")
    instruments = _instruments(stage_mm if stage else None, cameras_mm, weights_g, turn, balance_g, calipers_mm)
    start = load_design(design)
    if "model" not in start.sensor.model_fields_set:
        raise InputError(f"{start.name}: [sensor] names no model; a plan needs the noise and the load limits of the "
                         'sensor on the bench, such as model = "nano17"')  # fmt: skip
    folder = Path("data") / start.name if out is None else out
    check_target(folder, force)
    with show_progress("planning"):
        probe = build_probe(start)
        planned = make_plan(probe.model, probe.flange_volume, minutes, names, instruments, held_out)
        contents = [(name, text.encode()) for name, text in tables(planned).items()]
        contents += [(CHECKLIST, checklist_text(planned, str(folder)).encode()),
                     (PAGE, plan_page(planned, str(folder))),
                     (PLAN, json_bytes(planned.as_dict(), ascii_only=False))]  # fmt: skip
        files = write_folder(folder, contents, force)
    if as_json:
        print_json({**planned.as_dict(), "files": files})
        return
    _print_plan(planned)
    print(f"wrote {', '.join(map(str, files))}")


def _instruments(
    stage_mm: float | None, cameras_mm: float | None, weights_g: str, turn: bool, balance_g: float | None,
    calipers_mm: float | None,
) -> "Instruments":  # fmt: skip
    """Return the instruments of the options, in SI; refuse values that no instrument has."""
    from probedesign.planning.candidates import Instruments

    def si(option: str, value: float | None, unit: float, high: float) -> float | None:
        """Return a standard deviation [SI]; None for 0, which means that there is no such instrument."""
        if value is None or value == 0.0:
            return None
        if not 1e-4 <= value <= high:
            raise InputError(f"--{option} {value:g} must lie in 0.0001 ... {high:g}, or be 0 without the instrument")
        return value * unit

    weights = []
    for text in filter(None, (part.strip() for part in weights_g.split(","))):
        try:
            mass = float(text)
        except ValueError:
            mass = math.nan
        if not 0.001 <= mass <= 1000.0:
            raise InputError(f"--weights-g {text[:20]!r} must be a mass of 0.001 ... 1000 g, such as 0.5,1,2")
        weights.append(mass * GRAM)
    return Instruments(si("stage-mm", stage_mm, MM, 5.0), si("cameras-mm", cameras_mm, MM, 20.0), tuple(weights), turn,
                       si("balance-g", balance_g, GRAM, 10.0), si("calipers-mm", calipers_mm, MM, 2.0))  # fmt: skip


def _print_plan(plan: "Plan") -> None:
    from probedesign.reports.plan_page import interval_text

    names = [interval.name for interval in plan.expected]
    print(f"{plan.bench.model.name}  {len(plan.tests)} measurements in {plan.tests[-1].minutes:.0f} of "
          f"{plan.minutes:g} min; expected 95 % intervals after each")  # fmt: skip
    rows = [
        [f"{test.minutes:.0f}", test.candidate.name,
         *("" if test.candidate.held_out else interval_text(interval) for interval in test.expected),
         f"{test.candidate.words}{' For validate.' * test.candidate.held_out}"]
        for test in plan.tests
    ]  # fmt: skip
    print_columns(["min", "test", *names, "what"], rows)
    enough = plan.enough
    print(f"  after {enough.candidate.name} ({enough.minutes:.0f} min) every interval is within 10 % of the final one")
    for note in plan.notes:
        print(f"  note: {note}")


def campaign(
    design: DesignFile,
    out: Path,
    /,
    *,
    seed: int = 0,
    stage: bool = False,
    youngs_modulus_mpa: float | None = None,
    shear_modulus_mpa: float | None = None,
    marker_noise_mm: float | None = None,
    readings: int = 5,
    exact: bool = False,
    friction: float | None = None,
    hold_out: Annotated[bool, Parameter(negative="--no-hold-out")] = True,
    flaws: Annotated[bool, Parameter(negative="--no-flaws")] = True,
    force: bool = False,
    as_json: JsonOutput = False,
) -> None:
    """Simulate a measurement campaign of a print: tests, wrenches, markers and two calibrated cameras.

    The simulated print differs from the design by errors drawn from the design's tolerances. OUT/truth.json holds the
    true values; no command reads it. See docs/measurements.md.

    Args:
        out: output folder.
        seed: seed of all drawn values.
        stage: touches at positions known to 0.05 mm, without cameras.
        youngs_modulus_mpa: Young's modulus of the true print [MPa]. Default: drawn around the design's.
        shear_modulus_mpa: shear modulus of the true print [MPa]. Default: drawn around the design's.
        marker_noise_mm: standard deviation of the markers on each axis [mm], from a reference other than cameras.
        readings: number of sensor readings per test.
        exact: the print and its mount are exactly as designed; only the readings are noisy.
        friction: median friction coefficient of the touching objects. The tangential force has any direction within
            the friction cone. 0 is without friction. Default: [contact] friction of the design.
        hold_out: every second touch is for validate, and identify leaves it out (use in tests.csv).
        flaws: the bench has the flaws of the design's tolerances: friction, gain and drift of the sensor, root, creep
            and scatter of the stiffness.
        force: replace an existing simulated campaign.
    """
    from probedesign.design import load_design
    from probedesign.probe import build_probe
    from probedesign.simulation.campaign_folder import make_campaign
    from probedesign.simulation.ground_truth import CampaignPlan

    def si(value: float | None, unit: float) -> float | None:
        return None if value is None else value * unit

    plan = CampaignPlan("stage" if stage else "cameras", seed, si(youngs_modulus_mpa, MPA), si(shear_modulus_mpa, MPA),
                si(marker_noise_mm, MM), readings, exact, friction, hold_out=hold_out, flaws=flaws)  # fmt: skip
    made = make_campaign(build_probe(load_design(design)).model, out, plan, force)
    if as_json:
        print_json({"folder": made.folder, "files": made.files, "tests": made.tests})
    else:
        print(f"wrote {made.folder}: {plural(made.tests, 'test')}, {plural(len(made.files), 'file')}; "
              "true values in truth.json")  # fmt: skip


def markers(
    data: Path,
    /,
    *,
    base_side: Literal["left", "right", "top", "bottom"] | None = None,
    dots: Literal["dark", "light", "either"] = "either",
    overlays: Annotated[bool, Parameter(negative="--no-overlays")] = True,
    skip: bool = False,
    force: bool = False,
    as_json: JsonOutput = False,
) -> None:
    """Detect the markers of a probe in the photographs of a campaign, and write DATA/pixels.csv.

    The photographs are DATA/images/TEST-CAMERA.png or .jpg. Copies in DATA/overlays show what was detected, for visual
    inspection. See docs/stereo.md.

    Args:
        data: the folder of the campaign.
        base_side: side of the photographs where the base is. Default: determined from the calibrated cameras.
        dots: markers are darker or lighter than the probe.
        overlays: write the copies for visual inspection.
        skip: leave out tests whose photographs are rejected, with a note.
        force: replace an existing pixels.csv.
    """
    from probedesign import vision

    vision.require_opencv()
    from probedesign.campaigns.photographs import find_all, write_pixels
    from probedesign.campaigns.reading import PIXELS
    from probedesign.core.files import check_overwrite

    check_overwrite(data / PIXELS, force)  # its pixels may have been clicked by hand
    folder = data / "overlays" if overlays else None
    with show_progress() as on_progress:
        tests, notes = find_all(data, base_side, {"dark": True, "light": False}.get(dots), skip, on_progress)
        if folder is not None:
            from probedesign.vision.markers import overlay, read_grey, write_png

            for test in tests:
                for photograph, markers in zip(test.photographs, test.found, strict=bool(test.found)):
                    write_png(folder / f"{photograph.path.stem}.png", overlay(read_grey(photograph.path), markers))
    path = write_pixels(data, tests, force)
    if as_json:
        records = [
            {
                "test": test.test,
                "photographs": [photograph.path for photograph in test.photographs],
                "markers": len(test.found[0].pixels) if test.found else 0,
                "largest_std_px": max((float(markers.std_px.max()) for markers in test.found), default=None),
                "residual_px": test.residual_px,
                "problem": test.problem or None,
            }
            for test in tests
        ]
        print_json({"file": path, "overlays": folder, "notes": notes, "tests": records})
        return
    for note in notes:
        print(note)
    print_table({test.test: _line(test) for test in tests})
    used = sum(len(test.found) for test in tests)
    inspect = f"inspect the overlays in {folder}" if folder else "no overlays were written"
    print(f"wrote {path}: {plural(used, 'photograph')}; {inspect}")


def _line(test: "PhotographedTest") -> str:
    if test.problem:
        return f"left out: {test.problem}"
    count, shade = len(test.found[0].pixels), "dark" if test.found[0].dark else "light"
    max_std = max(float(markers.std_px.max()) for markers in test.found)
    reprojection = "" if math.isnan(test.residual_px) else f", reprojection residual {test.residual_px:.2f} px"
    return (
        f"{plural(count, f'{shade} marker')} in {plural(len(test.found), 'photograph')}, "
        f"largest standard deviation {max_std:.2f} px{reprojection}"
    )
