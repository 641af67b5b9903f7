"""`probedesign new`: write a design file from a few dimensions, and predict its performance."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from probedesign.cli.console import plural, print_json, print_table, show_progress
from probedesign.cli.options import JsonOutput
from probedesign.core.errors import InputError
from probedesign.core.units import MM

if TYPE_CHECKING:
    from probedesign.design import Design

FOLDER = Path("designs")
DEFAULT_FLANGE = "iso-9409-1-50-4-m6"
#: Fraction of the length, force [N] and direction of the touch that is reported: light, and near the tip.
SUMMARY_TOUCH = (0.8, 0.010, "+y")
#: Option that sets a key of the design, so that errors name the option that the user typed.
OPTIONS = {
    "probe.length_mm": "--length", "probe.base_d_mm": "--base-d", "probe.tip_d_mm": "--tip-d", "probe.tip": "--tip",
    "probe.section": "--section", "probe.bore_ratio": "--bore-ratio", "probe.flatness": "--flatness",
    "probe.axis_bend_deg": "--bend-deg", "probe.axis_turns": "--turns", "probe.axis_azimuth_deg": "--azimuth-deg",
    "material.resin": "--resin", "sensor.calibration": "--sensor", "mount.robot_flange": "--robot-flange",
    "contact.friction": "--friction", "print.printer": "--printer",
}  # fmt: skip


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
    axis: Literal["straight", "arc", "helix"] = "straight",
    bend_deg: float | None = None,
    turns: float | None = None,
    azimuth_deg: float | None = None,
    resin: str = "elastic-50a",
    sensor: str = "nano17",
    robot_flange: str | None = None,
    friction: float | None = None,
    hold: Literal["clamped", "glued", "bonded"] = "clamped",
    points: Literal["down", "up", "sideways"] = "sideways",
    printer: str = "form-3",
    force: bool = False,
    as_json: JsonOutput = False,
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
        axis: straight, arc (needs --bend-deg) or helix (--turns as well): a curved probe locates light touches better.
        bend_deg: total bending angle, curvature times length [deg].
        turns: of the plane of bending from base to tip, either sign.
        azimuth_deg: of the plane of bending at the base, from x towards y [deg]. Default: 0.
        resin: a known resin, such as elastic-50a; an unknown name lists all.
        sensor: a known sensor, such as nano17, or one of its calibrations, such as si-12-0.12.
        robot_flange: bolt pattern of the robot. Default: iso-9409-1-50-4-m6, or the smallest known one that leaves room
            for the sensor.
        friction: standard deviation of the prior of tangential over normal contact force, 0 ... inf. Default: the
            resin's.
        hold: how the adapter holds the flange: clamped by the ring, its underside glued as well, or the probe bonded to
            a rigid part at s = 0. It determines how much the root yields, which finite elements give for the exported
            parts.
        points: where the probe points as mounted: it sets gravity in base axes, which [mount] states for any other
            orientation.
        printer: a known printer, such as form-3; an unknown name lists all.
        force: replace an existing design file.
    """
    from probedesign.design.io import known_sensor, notes_of, render_design, write_design
    from probedesign.design.io import new as new_design
    from probedesign.mount.flange_adapter import fitting_flanges
    from probedesign.mount.mount import build_geometry, root_radii
    from probedesign.probe import build_probe
    from probedesign.web.home import refresh_home

    try:
        fitting = fitting_flanges(known_sensor(sensor))
        design = new_design(
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
            robot_flange=robot_flange or next(iter(fitting), DEFAULT_FLANGE),
            friction=friction,
            hold=hold,
            points=points,
            printer=printer,
            axis=axis,
            axis_bend_deg=bend_deg,
            axis_turns=turns,
            axis_azimuth_deg=azimuth_deg,
        )
        notes, hints = notes_of(design), []
        if tip_d is not None:
            notes.pop("probe.tip_d_mm", None)
        if robot_flange is None and design.mount.robot_flange != DEFAULT_FLANGE:
            notes["mount.robot_flange"] = "the smallest known one with room for the sensor; set your robot's"
            hints.append(f"took {design.mount.robot_flange}: {DEFAULT_FLANGE} has no room for this sensor")
        if tables := ", ".join(design.sensor_model.assumed_shape):
            hints.append(
                f"before export, measure {tables}: enter them in [sensor.own.interface] of the file and remove them "
                "from sensor.own.assumed"
            )
        root = root_radii(design, build_geometry(design))
        notes["mount.hold"] = f"root {root:g} base radii, computed; root_rigid_radii states a measured one"
    except InputError as error:
        message = str(error)
        for key, option in OPTIONS.items():
            message = message.replace(key, option).replace(f" {key.rpartition('.')[2]} = ", f" {option} = ")
        raise InputError(message) from None
    path = FOLDER / f"{design.name}.toml"
    with show_progress("predicting its performance"):
        figures = summary(design)  # first: a design that fits no mount is not written
    write_design(render_design(design, notes), path, force)
    page = refresh_home(build_probe(design).model, path)
    document = {"file": str(path), "name": design.name, "tip_d_mm": design.probe.blunt_mm[-1][1], **figures}
    if as_json:
        print_json(document)
    else:
        _print(document, tip_note=notes.get("probe.tip_d_mm"))
        if page is not None:
            print(f"  open {page}: the probe in 3-D, and its next steps")
        for hint in hints:
            print(f"  {hint}")


def summary(design: "Design") -> dict[str, Any]:
    """Return the main figures of a design: mass, sag, print check and expected contact error."""
    from probedesign.prediction.predict import errors_over_directions, predict_touch, tip_sag_mm
    from probedesign.printing.check import check_print
    from probedesign.probe import build_probe

    probe = build_probe(design)
    estimator = probe.estimator()
    fraction, force_N, direction = SUMMARY_TOUCH
    if probe.rod.is_curved:
        over = errors_over_directions(estimator, (fraction,), (force_N,))[0]
        error, span = over.rms_error_mm, ""
        if error is not None:
            span = f" over all directions, median {over.median_error_mm:.2g} mm, worst {over.worst_error_mm:.2g} mm"
        condition = f"RMS{span}, {1e3 * force_N:g} mN at {fraction:g} of the length, one reading"
    else:
        touch = predict_touch(estimator, fraction, force_N, direction)
        error = touch.predicted_error_mm if touch.result == "ok" else None
        condition = (
            f"RMS, {1e3 * force_N:g} mN at {fraction:g} of the length, one reading "
            f"of {design.sensor.averaging_samples} samples ({touch.result})"
        )
    check = check_print(design)
    return {
        "mass_g": 1e3 * probe.mass,
        "sag_mm": tip_sag_mm(estimator),
        **(
            {"tip_mm": ((probe.axis.frames([probe.length])[0, :3, 3] / MM).round(3) + 0.0).tolist()}
            if probe.rod.is_curved
            else {}
        ),
        "thinnest_mm": probe.geometry.thinnest / MM,
        "fits_upright": check.fits,
        "printer": check.printer,
        "print_check": check.as_record(),
        "expected_error_mm": error,
        "expected_error_condition": condition,
        "assumptions": list(design.assumptions),
    }


def _print(document: dict[str, Any], tip_note: str | None) -> None:
    from probedesign.design.catalog import assumed_text

    error = document["expected_error_mm"]
    fits = "fits" if document["fits_upright"] else "does not fit"
    condition = document["expected_error_condition"]
    expected = (
        f"{error:.2g} mm, {condition}"
        if error is not None
        else f"none, the touch is not located: {condition.removeprefix('RMS, ')}"
    )
    findings = document["print_check"]
    rows = {
        "mass": f"{document['mass_g']:.3g} g",
        "sag": "none: no stable equilibrium under gravity as mounted"
        if document["sag_mm"] is None
        else f"{document['sag_mm']:.3g} mm at the tip, under gravity as mounted",
        **(
            {"tip at": ", ".join(f"{x:.3g}" for x in tip) + " mm in base axes, unloaded"}
            if (tip := document.get("tip_mm"))
            else {}
        ),
        "print": f"{fits} upright in a {document['printer']}; {document['thinnest_mm']:.3g} mm smallest diameter",
        "print check": f"{plural(findings['errors'], 'error')}, {plural(findings['warnings'], 'warning')}; "
        f"details: probedesign check {document['file']}",
        "expected error": expected,
        "assumed until measured": assumed_text(document["assumptions"]),
    }
    if tip_note:
        rows = {"tip": f"{document['tip_d_mm']:g} mm, {tip_note}; set it with --tip-d"} | rows
    print(f"wrote {document['file']}")
    print_table(rows)
    for finding in findings["findings"]:
        if finding["severity"] == "error":
            print(f"  error: {finding['message']}")
