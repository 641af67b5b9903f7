"""`probedesign export`: the parts to print."""

import sys
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from probedesign.cli.console import print_json, print_table

USES = {".3mf": "print", ".stl": "print", ".step": "CAD", ".html": "look", ".svg": "look", ".png": "look",
        ".csv": "record", ".json": "record"}  # fmt: skip
"""What a file is for, by its ending."""


def export(
    design: Path,
    /,
    *,
    out: Path | None = None,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> None:
    """Make the parts to print: STL, STEP, 3MF and their manifest. Needs the extra 'cad'.

    Args:
        design: the design file.
        out: folder for the parts; by default exports/NAME.
        as_json: print the manifest instead of a summary.
    """
    from probedesign import pipeline

    manifest = pipeline.export(design, out, _progress)
    if as_json:
        print_json(manifest)
    else:
        _print(manifest)


def _progress(step: str) -> None:
    if sys.stderr.isatty():
        print(f"{step} ...", file=sys.stderr)


def _by_use(files: list[str]) -> dict[str, list[str]]:
    """What was written, by what it is for."""
    uses: dict[str, list[str]] = {use: [] for use in dict.fromkeys(USES.values())}
    for name in files:
        uses[USES.get(Path(name).suffix, "look")].append(name)
    return {use: names for use, names in uses.items() if names}


def _print(manifest: dict[str, Any]) -> None:
    whole, checks = manifest["mass"]["whole"], manifest["verification"]
    print(f"wrote {manifest['folder']}: {len(manifest['files']) + 1} files; for the bench: assembly.html")
    print_table(
        {
            **{
                what: ", ".join(names)
                for what, names in _by_use([*manifest["files"], "manifest.json"]).items()
            },
            "geometry": manifest["fingerprint"],
            "mass": f"{1e3 * whole['mass_kg']:.3g} g hang on the sensor",
            "base": f"{1e3 * manifest['T_sensor_base'][2][3]:.2f} mm above the tool face; "
            f"{manifest['base']['held_by']}",
            "checked": f"{sum(c['ok'] for c in checks.values())} of {len(checks)} checks of solids, slices and "
            "meshes against the formulae hold",
            "assumed": ", ".join(manifest["assumptions"]),
        }
    )
    for part, scale in manifest["print_scale"].items():
        if scale != [1.0, 1.0, 1.0]:
            print(
                f"  {part}: STL and 3MF are scaled by {scale[0]:g} in x and y, {scale[2]:g} in z; all else is not"
            )
    for finding in manifest["print_check"]["findings"]:
        print(f"  print check, {finding['severity']}: {finding['message']}")
    print("\nscrews (longer ones destroy the sensor)")
    for screw in manifest["screws"]:
        low, high = screw["entry_allowed_mm"]
        entry = f"enters {screw['entry_mm']:g} mm of {low:g} ... {high:g}"
        print(f"  {screw['count']} x {screw['screw']:<16} into {screw['into']}: {entry}")
    print("also needed:", ", ".join(f"{count} x {what}" for what, count in manifest["also_needed"].items()))
    print("\nin this order")
    for number, step in enumerate(manifest["assembly_order"], 1):
        print(f"  {number}. {step}")
