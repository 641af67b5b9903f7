"""`probedesign coupon`: write parts to print and measure, with their measuring sheets."""

from pathlib import Path

from probedesign.cli.console import print_json
from probedesign.cli.options import DesignFile, JsonOutput
from probedesign.core.files import exports_of


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
    diameters = ", ".join(f"{d:g}" for d in manifest["steps_mm"])
    (rod_d, rod_length) = manifest["rod_mm"]
    print(f"  stepped cone: Ø {diameters} mm, {manifest['step_height_mm']:g} mm each")
    print(f"  straight rod: Ø {rod_d:g} mm, {rod_length:g} mm long")
    print(f"  coupon.csv: diameters of these unscaled parts, for: probedesign measured {design} coupon.csv")
    print(f"  calipers.csv: diameters of the probe, for: probedesign measured {design} calipers.csv")
