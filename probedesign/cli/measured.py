"""`probedesign coupon` and `probedesign measured`: parts to measure with calipers, and their diameters in a design."""

import math
from collections.abc import Iterator
from dataclasses import asdict
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Any

from probedesign.cli.console import plural, print_json
from probedesign.cli.options import DesignFile, JsonOutput
from probedesign.core.errors import InputError
from probedesign.core.files import check_overwrite, exports_of

if TYPE_CHECKING:
    from probedesign.identification.measured_print import CouponScale, MeasuredAxis, MeasuredDiameters


def coupon(design: DesignFile, /, *, out: Path | None = None, as_json: JsonOutput = False) -> None:
    """Write a stepped cone and a straight rod in the probe's resin, and sheets for diameters. Needs the extra 'cad'.

    Args:
        out: output folder. Default: exports/NAME/coupon.
    """
    from probedesign import cad
    from probedesign.design import load_design

    drawn = load_design(design)
    manifest = cad.export_coupon(drawn, out or exports_of(design) / drawn.name / "coupon")
    if as_json:
        print_json(manifest)
        return
    print(f"wrote {manifest['folder']}: {', '.join(manifest['files'])}")
    steps = ", ".join(f"{d:g}" for d in manifest["steps_mm"])
    rod_d, rod_length = manifest["rod_mm"]
    print(f"  stepped cone: Ø {steps} mm, {manifest['step_height_mm']:g} mm each")
    print(f"  straight rod: Ø {rod_d:g} mm, {rod_length:g} mm long")
    print(f"  coupon.csv: diameters of these unscaled parts, for: probedesign measured {design} coupon.csv")
    print(f"  calipers.csv: diameters of the probe, for: probedesign measured {design} calipers.csv")


def measured(
    design: DesignFile,
    calipers: Path | None = None,
    /,
    *,
    axis: Path | None = None,
    bow_mm: tuple[float, float] | None = None,
    bow_std_mm: float = 0.2,
    calipers_std_mm: float = 0.02,
    out: Path | None = None,
    force: bool = False,
    as_json: JsonOutput = False,
) -> None:
    """Write what was measured on a print, diameters, axis or bow, into its design, whose error budget shrinks.

    The sheet of a coupon, coupon.csv, gives scales and offset of the next print instead: scale_xy, scale_z and
    offset_xy_mm of [print].

    Args:
        calipers: CSV file with the columns s_mm, diameter_mm, diameter_y_mm and std_mm, or coupon.csv (docs/parts.md);
            `coupon` writes both, empty.
        axis: CSV file with the columns x_mm, y_mm, z_mm and, optionally, std_mm: points of the outline, on the surface
            of the unloaded print, in base axes. The axis that fits them is written as bow_mm, and for a helix or knots
            with a factor on the curvature of the design.
        bow_mm: deviation of the unloaded tip from the axis of the base towards x, the clocking mark, and towards y
            [mm], instead of calipers.
        bow_std_mm: standard deviation of that measurement in each direction [mm]; assumed: a photograph of a thin tip.
        calipers_std_mm: standard deviation of the error that all readings share [mm].
        out: write a changed copy of the design to this file instead.
        force: replace tolerances that were set before, or the file of --out, which is kept as FILE.old.
    """
    from probedesign.design import load_design
    from probedesign.estimation.model import BOW_SHARE
    from probedesign.identification import measured_print
    from probedesign.identification.design_update import write_changes
    from probedesign.mount import build_geometry
    from probedesign.probe import build_probe
    from probedesign.web.home import refresh_home

    if out is not None:
        check_overwrite(out, force)
    start, day = load_design(design), date.today().isoformat()
    if (calipers is not None) + (bow_mm is not None) + (axis is not None) != 1:
        raise InputError("give a table of measured diameters, the points of an outline with --axis, or the bow with "
                         "--bow-mm X Y, one after the other")  # fmt: skip
    document: dict[str, Any]
    if axis is not None:
        again = "bow_mm" in start.probe.measured
        before = BOW_SHARE * start.probe.length_mm if again else build_probe(start).tolerances.bow_mm
        fitted = measured_print.fit_axis(start, measured_print.read_outline(axis), before)
        factor = (fitted.factor, fitted.factor_std) if fitted.factor_std > 0.0 else None
        changes = measured_print.axis_changes(start, fitted.bow_mm, fitted.bow_std_mm, factor, f"measured {day}")
        document = asdict(fitted)
        what, lines = _axis_lines(fitted)
    elif bow_mm is not None:
        changes = measured_print.bow_changes(start, bow_mm, bow_std_mm, f"measured {day}")
        document = {"bow_mm": bow_mm, "bow_std_mm": bow_std_mm}
        what = f"the tip is {bow_mm[0]:g} mm off towards x and {bow_mm[1]:g} mm towards y, ± {bow_std_mm:g} mm"
        lines = [_bow_test(bow_mm, bow_std_mm), "deploy the probe again, with this design; the parts stay"]
    elif calipers is not None and measured_print.is_coupon_sheet(calipers):
        scale = measured_print.fit_scale(*measured_print.read_coupon(calipers, start.resin.name), calipers_std_mm)
        changes, document = measured_print.scale_changes(scale, day), asdict(scale)
        what, lines = _scale_lines(scale)
    elif calipers is not None:
        readings = measured_print.read_calipers(calipers, start)
        fit = measured_print.fit_diameters(start, build_probe(start).tolerances, readings, calipers_std_mm)
        changes, document = measured_print.diameter_changes(fit, start, day), fit.as_dict()
        what = f"{plural(fit.readings, 'reading')}; the former values are kept as comments"
        lines = [*_diameter_lines(fit), "the bow is not seen: diameters, in however many directions, are those of a "
                 "straight probe; measure it with --bow-mm or --axis"]  # fmt: skip
    path, kept = write_changes(design, changes, day, out, force)
    changed = load_design(path)
    refresh_home(build_probe(changed).model, path)
    if "measured_mm" in document:  # another geometry
        document["fingerprint"] = build_geometry(changed).fingerprint
        lines.append(f"the geometry is now {document['fingerprint']}: deploy the probe again, with this design")
    if as_json:
        print_json({**document, "changes": changes, "design_written": path, "design_kept": kept})
        return
    print(f"wrote {path}: {what}")
    for line in lines:
        print(f"  {line}")
    if kept is not None:
        print(f"kept the former {out} as {kept}")


def _bow_test(bow_mm: tuple[float, float], std_mm: float) -> str:
    """Return the chi-square test of a straight print, with two degrees of freedom: the chance is exp(-χ²/2)."""
    chance = math.exp(-((math.hypot(*bow_mm) / std_mm) ** 2) / 2.0) if std_mm > 0.0 else 0.0
    stated = f"a straight print would show as much with a chance of {100 * chance:.2g} %"
    return f"the print is bent: {stated}" if chance < 0.05 else f"the print may be straight: {stated}"


def _axis_lines(fitted: "MeasuredAxis") -> tuple[str, list[str]]:
    x, y = fitted.bow_mm
    what = (f"{plural(fitted.points, 'point')}; the axis deviates by a constant curvature that moves the tip by "
            f"{x:.2f} mm towards X and {y:.2f} mm towards Y, ± {fitted.bow_std_mm:.2g} mm")  # fmt: skip
    lines = [f"tolerance of the bow: {fitted.bow_std_mm:.2g} mm (before: {fitted.before_mm:.2g} mm)",
             _bow_test(fitted.bow_mm, fitted.bow_std_mm),
             f"the points are {fitted.rms_mm:.2g} mm from the fitted surface (RMS)"]  # fmt: skip
    if fitted.scale > 1.0:
        lines.append(f"note: they scatter by {fitted.scale:.1f} times their standard deviation, which was widened")
    if fitted.factor_std > 0.0:
        lines.append(f"the curvature is {fitted.factor:.4f} ± {fitted.factor_std:.2g} times that of the design, whose "
                     "axis and fingerprint change with it")  # fmt: skip
    return what, [*lines, "deploy the probe again, with this design"]


def _diameter_lines(fit: "MeasuredDiameters") -> Iterator[str]:
    for s, drawn, mean, std in zip(fit.s, fit.drawn, fit.measured, fit.std, strict=True):
        yield f"s = {s:g} mm: {mean:.3f} ± {std:.3f} mm (drawn: {drawn:g} mm; one standard deviation)"
    (common, scatter), (together, each) = fit.before, fit.after
    yield (f"tolerance of all diameters together: {together:.3f} mm (before: {common:.3f} mm); of each for itself: "
           f"{each:.3f} mm (before: {scatter:.3f} mm)")  # fmt: skip
    yield from (f"left out: {reading}; measure it again" for reading in fit.dropped)
    if math.hypot(together, each) > math.hypot(common, scatter):
        yield ("note: where nothing was measured the tolerance is wider than before, because a print may be larger or "
               "smaller as a whole by 1 % (assumed); measure near base and tip")  # fmt: skip
    if fit.scale > 1.0:
        yield f"note: the readings scatter by {fit.scale:.1f} times their standard deviation, which was widened"
    if fit.prior_scale > 1.0:
        worst = max(fit.measured - fit.drawn, key=abs)
        yield (f"note: the diameters are up to {worst:+.3f} mm off, more than the tolerance of the print explains; "
               f"it was widened {fit.prior_scale:.1f} times. Check the calipers, or print a coupon for "
               "scale_xy")  # fmt: skip


def _scale_lines(scale: "CouponScale") -> tuple[str, list[str]]:
    what = (f"scale_xy = {scale.scale_xy:.4f} ± {scale.std:.2g} of [print], from {plural(scale.rows, 'place')} on the "
            "coupon")  # fmt: skip
    lines = [f"offset_xy_mm = {scale.offset_mm:.3f} ± {scale.offset_std_mm:.2g}: by how much all diameters are wider, "
             "whatever their size; 0 where it is within two standard deviations",
             f"the diameters deviate from both by up to {scale.left_mm:.3f} mm"]  # fmt: skip
    if scale.scale_z is not None:
        lines.append(f"scale_z = {scale.scale_z:.4f} ± {scale.std_z:.2g}")
    return what, [*lines, "export again: only the files to print change, and the tolerance of the diameters stays"]
