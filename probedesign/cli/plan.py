"""`probedesign plan`: the tests that determine the parameters of a print best in the time available."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from probedesign.cli.console import json_bytes, print_json, show_progress
from probedesign.cli.options import DesignFile, JsonOutput
from probedesign.core.errors import InputError

if TYPE_CHECKING:
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
        design: the design file, or its name.
        out: data folder to write, with plan.html. Default: data/NAME.
        minutes: time available [min], preparation included.
        for_: comma-separated parameters, as of identify: E, G, density, diameters, root, tilt, clocking,
            offset, gravity.
        stage_mm: standard deviation of a place that the stage measures, on each axis [mm].
        stage: there is a stage.
        cameras_mm: standard deviation of a marker by cameras or another reference, on each axis [mm]. Default: none.
        weights_g: comma-separated masses that can be hung by a thread [g]; "" for none.
        turn: the base can be held in other orientations with known poses.
        balance_g: standard deviation of a weighing [g]; 0 without a balance.
        calipers_mm: standard deviation of a measured diameter [mm]; 0 without calipers.
        held_out: number of touches that identify leaves out and validate judges by.
        force: replace a plan without measured values.
        as_json: print one JSON document.
    """
    from probedesign import pipeline
    from probedesign.design import load_design
    from probedesign.identification.parameters import check_requested
    from probedesign.planning.folder import CHECKLIST, PAGE, PLAN, check_target, checklist_text, tables, write_folder
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
    folder = Path("data") / start.name if out is None else out
    check_target(folder, force)
    with show_progress("planning"):
        planned = pipeline.plan(start, minutes, names, instruments, held_out)
        contents = [(name, text.encode()) for name, text in tables(planned).items()]
        contents += [(CHECKLIST, checklist_text(planned, str(folder)).encode()),
                     (PAGE, plan_page(planned, str(folder))),
                     (PLAN, json_bytes(planned.as_dict(), ascii_only=False))]  # fmt: skip
        files = write_folder(folder, contents, force)
    if as_json:
        print_json({**planned.as_dict(), "files": files})
        return
    _print(planned)
    print(f"wrote {', '.join(map(str, files))}")


def _instruments(
    stage_mm: float | None, cameras_mm: float | None, weights_g: str, turn: bool, balance_g: float | None,
    calipers_mm: float | None,
) -> "Instruments":  # fmt: skip
    """Return the instruments of the options, in SI; refuse values that no instrument has."""
    from probedesign.core.units import GRAM, MM
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


def _print(plan: "Plan") -> None:
    from probedesign.reports.plan_page import interval_text

    names = [interval.name for interval in plan.expected]
    print(f"{plan.bench.model.name}  {len(plan.tests)} measurements in {plan.tests[-1].minutes:.0f} of "
          f"{plan.minutes:g} min; expected 95 % intervals after each")  # fmt: skip
    print(f"  {'min':>4} {'test':<12}" + "".join(f"{name:>13}" for name in names) + "  what")
    for test in plan.tests:
        candidate = test.candidate
        cells = ["" if candidate.held_out else interval_text(interval) for interval in test.expected]
        print(f"  {test.minutes:>4.0f} {candidate.name:<12}" + "".join(f"{cell:>13}" for cell in cells)
              + f"  {candidate.words}{' For validate.' * candidate.held_out}")  # fmt: skip
    enough = plan.enough
    print(f"  after {enough.candidate.name} ({enough.minutes:.0f} min) every interval is within 10 % of the final one")
    for note in plan.notes:
        print(f"  note: {note}")
