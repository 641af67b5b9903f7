"""`probedesign new`: from a few numbers to a design file, and what to expect of it."""

from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from probedesign.cli.console import counted, print_json, print_table, working
from probedesign.errors import InputError

FOLDER = Path("designs")
OPTIONS = {
    "probe.length_mm": "--length",
    "probe.base_d_mm": "--base-d",
    "probe.tip_d_mm": "--tip-d",
    "probe.tip": "--tip",
    "probe.section": "--section",
    "probe.bore_ratio": "--bore-ratio",
    "probe.flatness": "--flatness",
    "material.resin": "--resin",
    "sensor.calibration": "--sensor",
    "mount.robot_flange": "--robot-flange",
    "contact.friction": "--friction",
}
"""The option that sets a key, so that an error speaks of what was typed."""


def new(
    name: str | None = None,
    /,
    *,
    length: float,
    base_d: float,
    tip_d: float | None = None,
    tip: Literal["blunt", "rounded"] = "blunt",
    shape: Literal["cone", "cylinder"] = "cone",
    section: Literal["round", "hollow", "elliptic"] = "round",
    bore_ratio: float | None = None,
    flatness: float | None = None,
    resin: str = "elastic-50a",
    sensor: str = "nano17",
    robot_flange: str = "iso-9409-1-50-4-m6",
    friction: float | None = None,
    force: bool = False,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> None:
    """Write designs/NAME.toml from a few numbers; print mass, sag, print fit and the expected error.

    Args:
        name: of the design; by default one that carries the parameters, such as cone-150x12x2.
        length: of the flexible part, base to tip [mm].
        base_d: diameter at the base [mm].
        tip_d: diameter at the tip [mm]; by default a sixth of the base, at least 2 mm.
        tip: rounded ends in a sphere within the same length.
        shape: a cylinder has one diameter.
        section: round is full; hollow needs --bore-ratio, elliptic needs --flatness.
        bore_ratio: of a hollow section, inner over outer diameter, 0.05 ... 0.9.
        flatness: of an elliptic section, diameter along y over that along x, 0.2 ... 1; the others are along x.
        resin: elastic-50a, flexible-80a or silicone-40a.
        sensor: nano17, or a calibration of it such as si-12-0.12.
        robot_flange: bolt pattern of the robot.
        friction: tangential over normal force of a touch, standard deviation of the prior, 0 ... inf; by default the
            resin's.
        force: replace a design file of that name.
        as_json: print one JSON document.
    """
    from probedesign.design_file import draft_design, render_design, write_design

    try:
        design, notes = draft_design(
            name,
            shape=shape,
            length_mm=length,
            base_d_mm=base_d,
            tip_d_mm=tip_d,
            tip=tip,
            section=section,
            bore_ratio=bore_ratio,
            flatness=flatness,
            resin=resin,
            sensor=sensor,
            robot_flange=robot_flange,
            friction=friction,
        )
    except InputError as error:
        raise InputError(_in_options(str(error))) from None
    path = FOLDER / f"{design.name}.toml"
    write_design(render_design(design, notes), path, force)
    with working("predicting what it can do"):
        from probedesign import pipeline

        summary = pipeline.summary(design)
    document = {"file": str(path), "name": design.name, "tip_d_mm": design.probe.blunt_mm[-1][1], **summary}
    if as_json:
        print_json(document)
    else:
        _print(document, tip_note=notes.get("probe.tip_d_mm"))


def _in_options(message: str) -> str:
    """An error about keys as one about the options that set them."""
    for key, option in OPTIONS.items():
        bare = key.rpartition(".")[2]
        message = message.replace(key, option).replace(f" {bare} = ", f" {option} = ")
    return message


def _print(document: dict[str, Any], tip_note: str | None) -> None:
    error = document["expected_error_mm"]
    fits = "fits" if document["fits_upright"] else "does not fit"
    expected = "none" if error is None else f"{error:.2g} mm"
    found = document["print_check"]
    rows = {
        "mass": f"{document['mass_g']:.3g} g",
        "sag": "none: it cannot stand as mounted"
        if document["sag_mm"] is None
        else f"{document['sag_mm']:.3g} mm at the tip, under gravity as mounted",
        "print": f"{fits} upright in a {document['printer']}; {document['thinnest_mm']:.3g} mm at its thinnest",
        "print check": f"{counted(found['errors'], 'error')}, {counted(found['warnings'], 'warning')}; "
        f"probedesign check {document['file']}",
        "expected error": f"{expected}, {document['expected_error_condition']}",
        "assumed": ", ".join(document["assumptions"]) or "nothing",
    }
    if tip_note:
        rows = {"tip": f"{document['tip_d_mm']:g} mm, {tip_note}; --tip-d sets it"} | rows
    print(f"wrote {document['file']}")
    print_table(rows)
    for finding in found["findings"]:
        if finding["severity"] == "error":
            print(f"  error: {finding['message']}")
