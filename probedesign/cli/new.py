"""`probedesign new`: write a design file from a few dimensions, and predict its performance."""

from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from probedesign.cli.console import plural, print_json, print_table, show_progress
from probedesign.core.errors import InputError

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
"""Option that sets a key of the design, so that errors name the option that the user typed."""


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
    """Write designs/NAME.toml from a few dimensions; print mass, sag, print fit and the expected error.

    Args:
        name: name of the design. Default: composed of the dimensions, such as cone-150x12x2.
        length: length of the flexible part from base to tip [mm].
        base_d: diameter at the base [mm].
        tip_d: diameter at the tip [mm]. Default: a sixth of the base diameter, at least 2 mm.
        tip: blunt, or rounded: a sphere within the same length.
        shape: cone, or cylinder with one diameter.
        section: round (solid), hollow (needs --bore-ratio) or elliptic (needs --flatness).
        bore_ratio: inner over outer diameter of a hollow section, 0.05 ... 0.9.
        flatness: diameter along y over diameter along x of an elliptic section, 0.2 ... 1. --base-d and --tip-d are
            along x.
        resin: a known resin, such as elastic-50a; an unknown name lists all.
        sensor: a known sensor, such as nano17, or one of its calibrations, such as si-12-0.12.
        robot_flange: bolt pattern of the robot.
        friction: standard deviation of the prior of tangential over normal contact force, 0 ... inf. Default: the
            resin's.
        force: replace an existing design file.
        as_json: print one JSON document.
    """
    from probedesign.design.io import draft_design, render_design, write_design

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
    with show_progress("predicting its performance"):
        from probedesign import pipeline

        summary = pipeline.summary(design)
    document = {"file": str(path), "name": design.name, "tip_d_mm": design.probe.blunt_mm[-1][1], **summary}
    if as_json:
        print_json(document)
    else:
        _print(document, tip_note=notes.get("probe.tip_d_mm"))


def _in_options(message: str) -> str:
    """Replace the keys in an error message by the options that set them."""
    for key, option in OPTIONS.items():
        bare = key.rpartition(".")[2]
        message = message.replace(key, option).replace(f" {bare} = ", f" {option} = ")
    return message


def _print(document: dict[str, Any], tip_note: str | None) -> None:
    error = document["expected_error_mm"]
    fits = "fits" if document["fits_upright"] else "does not fit"
    expected = "none" if error is None else f"{error:.2g} mm"
    findings = document["print_check"]
    rows = {
        "mass": f"{document['mass_g']:.3g} g",
        "sag": "none: no stable equilibrium under gravity as mounted"
        if document["sag_mm"] is None
        else f"{document['sag_mm']:.3g} mm at the tip, under gravity as mounted",
        "print": f"{fits} upright in a {document['printer']}; {document['thinnest_mm']:.3g} mm smallest diameter",
        "print check": f"{plural(findings['errors'], 'error')}, {plural(findings['warnings'], 'warning')}; "
        f"details: probedesign check {document['file']}",
        "expected error": f"{expected}, {document['expected_error_condition']}",
        "assumed": ", ".join(document["assumptions"]) or "nothing",
    }
    if tip_note:
        rows = {"tip": f"{document['tip_d_mm']:g} mm, {tip_note}; set it with --tip-d"} | rows
    print(f"wrote {document['file']}")
    print_table(rows)
    for finding in findings["findings"]:
        if finding["severity"] == "error":
            print(f"  error: {finding['message']}")
