"""`probedesign coupon` and `probedesign measured`: parts to measure with calipers, and their diameters in a design."""

import math
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING

from probedesign.cli.console import plural, print_json
from probedesign.cli.options import DesignFile, JsonOutput
from probedesign.core.errors import InputError
from probedesign.core.files import check_overwrite, exports_of

if TYPE_CHECKING:
    from probedesign.design.edit import Change
    from probedesign.identification.measured_diameters import CouponScale


def coupon(design: DesignFile, /, *, out: Path | None = None, as_json: JsonOutput = False) -> None:
    """Write a stepped cone and a straight rod in the probe's resin, and sheets for diameters. Needs the extra 'cad'.

    Args:
        design: the design file, or its name.
        out: output folder. Default: exports/NAME/coupon.
        as_json: print the manifest instead of a summary.
    """
    from probedesign import pipeline
    from probedesign.design import load_design

    drawn = load_design(design)
    manifest = pipeline.export_coupon(drawn, out or exports_of(design) / drawn.name / "coupon")
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
    bow_mm: tuple[float, float] | None = None,
    bow_std_mm: float = 0.2,
    calipers_std_mm: float = 0.02,
    out: Path | None = None,
    force: bool = False,
    as_json: JsonOutput = False,
) -> None:
    """Write what was measured on a print, diameters or the bow, into its design, whose error budget shrinks.

    The sheet of a coupon, coupon.csv, gives the scale of the next print instead: scale_xy of [print].

    Args:
        design: the design file, or its name.
        calipers: CSV file with the columns s_mm, diameter_mm and std_mm, or coupon.csv (docs/parts.md); `coupon` writes
            both, empty.
        bow_mm: deviation of the unloaded tip from the axis of the base towards x, the clocking mark, and towards y
            [mm], instead of calipers.
        bow_std_mm: standard deviation of that measurement in each direction [mm]; assumed: a photograph of a thin tip.
        calipers_std_mm: standard deviation of the error that all readings share [mm].
        out: write a changed copy of the design to this file instead.
        force: replace tolerances that were set before, or the file of --out, which is kept as FILE.old.
        as_json: print one JSON document.
    """
    from probedesign import pipeline
    from probedesign.design import load_design
    from probedesign.identification.design_update import write_changes
    from probedesign.identification.measured_diameters import (
        bow_changes,
        diameter_changes,
        fit_scale,
        is_coupon_sheet,
        read_calipers,
        read_coupon,
    )
    from probedesign.mount import build_geometry

    if out is not None:
        check_overwrite(out, force)
    start, day = load_design(design), date.today().isoformat()
    if (calipers is None) == (bow_mm is None):
        raise InputError("give a table of measured diameters, or the bow with --bow-mm X Y, one after the other")
    if bow_mm is not None:
        _write_bow(design, bow_changes(start, bow_mm, bow_std_mm, day), out, force, as_json)
        return
    assert calipers is not None
    if is_coupon_sheet(calipers):
        scale = fit_scale(*read_coupon(calipers, start.resin.name), calipers_std_mm)
        _write_scale(design, scale, out, force, as_json)
        return
    diameters = pipeline.measure(start, read_calipers(calipers, start), calipers_std_mm)
    changes = diameter_changes(diameters, start, day)
    path, kept = write_changes(design, changes, day, out, force)
    fingerprint = build_geometry(load_design(path)).fingerprint
    if as_json:
        print_json({**diameters.as_dict(), "fingerprint": fingerprint, "changes": changes,
                    "design_written": path, "design_kept": kept})  # fmt: skip
        return
    print(f"wrote {path}: {plural(diameters.readings, 'reading')}; the former values are kept as comments")
    for s, drawn, mean, std in zip(diameters.s, diameters.drawn, diameters.measured, diameters.std, strict=True):
        print(f"  s = {s:g} mm: {mean:.3f} ± {std:.3f} mm (drawn: {drawn:g} mm; one standard deviation)")
    (common, scatter), (together, each) = diameters.before, diameters.after
    print(f"  tolerance of all diameters together: {together:.3f} mm (before: {common:.3f} mm); "
          f"of each for itself: {each:.3f} mm (before: {scatter:.3f} mm)")  # fmt: skip
    if math.hypot(together, each) > math.hypot(common, scatter):
        print("  note: where nothing was measured the tolerance is wider than before, because a print may be larger or "
              "smaller as a whole by 1 % (assumed); measure near base and tip")  # fmt: skip
    if diameters.scale > 1.0:
        print(
            f"  note: the readings scatter by {diameters.scale:.1f} times their standard deviation, which was widened"
        )
    if diameters.prior_scale > 1.0:
        worst = max(diameters.measured - diameters.drawn, key=abs)
        print(
            f"  note: the diameters are up to {worst:+.3f} mm off, more than the tolerance of the print explains; it "
            f"was widened {diameters.prior_scale:.1f} times. Check the calipers, or print a coupon for scale_xy"
        )
    print(f"  the geometry is now {fingerprint}: deploy the probe again, with this design")
    if kept is not None:
        print(f"kept the former {out} as {kept}")


def _write_bow(design: Path, changes: "tuple[Change, ...]", out: Path | None, force: bool, as_json: bool) -> None:
    """Write the measured bow of a print."""
    from probedesign.design import load_design
    from probedesign.identification.design_update import write_changes

    path, kept = write_changes(design, changes, date.today().isoformat(), out, force)
    written = load_design(path)
    bow, std = written.probe.bow_mm, written.tolerances.bow_mm
    if as_json:
        print_json({"bow_mm": bow, "bow_std_mm": std, "changes": changes, "design_written": path, "design_kept": kept})
        return
    x, y = bow or (0.0, 0.0)
    print(f"wrote {path}: the tip is {x:g} mm off towards x and {y:g} mm towards y, ± {std:g} mm")
    print("  deploy the probe again, with this design; the parts and their fingerprint stay")
    if kept is not None:
        print(f"kept the former {out} as {kept}")


def _write_scale(design: Path, scale: "CouponScale", out: Path | None, force: bool, as_json: bool) -> None:
    """Write the scale of the next print, fitted to the sheet of a coupon."""
    from probedesign.identification.design_update import write_changes
    from probedesign.identification.measured_diameters import scale_changes

    day = date.today().isoformat()
    changes = scale_changes(scale, day)
    path, kept = write_changes(design, changes, day, out, force)
    if as_json:
        print_json({**scale.as_dict(), "changes": changes, "design_written": path, "design_kept": kept})
        return
    print(
        f"wrote {path}: scale_xy = {scale.scale_xy:.4f} ± {scale.std:.2g} of [print], from "
        f"{plural(scale.rows, 'place')} on the coupon"
    )
    print(f"  the diameters deviate from one scale by up to {scale.left_mm:.3f} mm")
    if scale.has_offset:
        print(
            f"  note: all diameters are {scale.offset_mm:+.3f} ± {scale.offset_std_mm:.2g} mm off, whatever their "
            "size, which a scale does not remove; measure the probe itself"
        )
    print("  export again: only the files to print change, and the tolerance of the diameters stays")
    if kept is not None:
        print(f"kept the former {out} as {kept}")
