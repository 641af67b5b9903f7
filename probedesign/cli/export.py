"""`probedesign check`, `export`, `deploy` and `twin`: print rules, parts, frozen probe, files for simulators."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from probedesign.cli.console import plural, print_json, print_step, print_table, show_progress, write_files
from probedesign.cli.options import DesignFile, JsonOutput
from probedesign.core.errors import InputError
from probedesign.core.files import check_folder, exports_of

#: What a file of an export is used for, by its suffix.
FILE_USES = {".3mf": "print", ".stl": "print", ".step": "CAD", ".html": "view", ".glb": "view", ".svg": "view",
             ".csv": "record", ".json": "record"}  # fmt: skip


def check(design: DesignFile, /, *, as_json: JsonOutput = False) -> int:
    """Check a design against the rules of its printer and its resins, before any CAD.

    Exit status 1 if a rule finds an error; warnings do not change it. The rules, their sources and their confidence:
    docs/printing.md.
    """
    from probedesign.design import load_design
    from probedesign.frozen_probe import check_manifest
    from probedesign.mount import Mount, root_contradiction
    from probedesign.printing.check import check_print

    checked = load_design(design)
    report, root = check_print(checked), root_contradiction(checked)
    manifest, stale = exports_of(design) / checked.name / "manifest.json", ""
    if manifest.exists() and not report.errors:
        try:
            check_manifest(Mount.of(checked).fingerprints, manifest)
        except InputError as error:
            stale = str(error)
    if as_json:
        passed = [finding.as_record() for finding in report.passed]
        record = {"name": report.name, "fingerprint": report.fingerprint, **report.as_record(), "passed": passed}
        print_json(record | {"root_warning": root or None, "stale_export": stale or None})
    else:
        print(f"{report.name}  geometry {report.fingerprint}  {report.resin} on a {report.printer}")
        for finding in (*report.errors, *report.warnings):
            print(f"  {finding.severity:<7}  {finding.message}")
            print(f"           {finding.rule}, {finding.confidence} confidence: {finding.source}")
        print(
            f"{plural(len(report.errors), 'error')}, {plural(len(report.warnings), 'warning')}; "
            f"{len(report.passed)} of {len(report.findings)} checks passed"
        )
        print("\nadvice for printing")
        for advice in report.advice:
            print(f"  {advice}")
        print("\nafter printing the probe")
        print_table(dict(report.post_processing))
        for warning in filter(None, (root, stale)):
            print(f"\nwarning: {warning}")
    return 1 if report.errors else 0


def export(
    design: DesignFile,
    /,
    *,
    out: Path | None = None,
    only: Literal["probe", "sensor_adapter", "clamp_ring", "flange_adapter"] | None = None,
    as_json: JsonOutput = False,
) -> None:
    """Write the parts to print: STL, 3MF, STEP, GLB, inspection sheets and their manifest. Needs the extra 'cad'.

    Args:
        out: output folder. Default: exports/NAME.
        only: write the STL file of this part only.
    """
    from probedesign import cad
    from probedesign.design import load_design
    from probedesign.probe import build_probe

    drawn = load_design(design)
    folder = out or exports_of(design) / drawn.name
    if only is not None:
        with _uncollected():
            written = cad.export_part(drawn, only, folder)
        if as_json:
            print_json(written)
        else:
            print(f"wrote {written['file']}: {1e6 * written['volume_m3']:.3g} cm³, geometry {written['fingerprint']}")
        return
    from probedesign.web.home import write_home  # an export of one part loads no model of the probe

    with _uncollected():
        manifest = cad.export_parts(drawn, folder, print_step)
    write_home(folder, build_probe(drawn).model, str(design))
    if as_json:
        print_json(manifest)
    else:
        _print(manifest)


@contextmanager
def _uncollected() -> Iterator[None]:
    """Pause the garbage collector, which would visit the objects of CadQuery and VTK for a second and find nothing."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


def _print(manifest: dict[str, Any]) -> None:
    from probedesign.design.catalog import assumed_text

    whole, checks, stacks = manifest["mass"]["whole"], manifest["verification"], manifest["tolerance_stacks"]
    files: dict[str, list[str]] = {use: [] for use in FILE_USES.values()}
    for name in (*manifest["files"], "manifest.json"):
        files[FILE_USES[Path(name).suffix]].append(name)
    print(f"wrote {manifest['folder']}: {len(manifest['files']) + 1} files; assembly instructions: assembly.html")
    print_table(
        {
            **{use: ", ".join(names) for use, names in files.items() if names},
            "geometry": manifest["fingerprint"],
            "mass": f"{1e3 * whole['mass_kg']:.3g} g on the sensor",
            "base": f"{1e3 * manifest['T_sensor_base'][2][3]:.2f} mm above the tool face",
            "checks": f"{sum(c['ok'] for c in checks.values())} of {len(checks)} passed (solids and meshes "
            "against the formulae)",
            "assumed": assumed_text(manifest["assumptions"]),
        }
    )
    for part, scale in manifest["print_scale"].items():
        if scale != [1.0, 1.0, 1.0]:
            print(
                f"  {part}: STL and 3MF are scaled by {scale[0]:g} in x and y and by {scale[2]:g} in z; "
                "the other files are not"
            )
    for finding in manifest["print_check"]["findings"]:
        print(f"  print check, {finding['severity']}: {finding['message']}")
    for part, way in manifest["print_check"]["orientation"].items():
        stands = "on supports" if way["supports"] else "without supports"
        print(f"  print the {part.replace('_', ' ')} {way['side']} on {way['rests_on']}, {stands}")
    within = sum(stack["ok"] for stack in stacks)
    print(f"  tolerances: {within} of {len(stacks)} stacks are within their limits in the worst case")
    print("\nscrews (longer ones damage the sensor)")
    for screw in manifest["screws"]:
        low, high = screw["entry_allowed_mm"]
        entry = f"depth {screw['entry_mm']:g} mm (allowed: {low:g} ... {high:g} mm)"
        print(f"  {screw['count']} x {screw['screw']:<16} into {screw['into']}: {entry}")
    print("nuts, pins and all other parts: bill_of_materials.csv")


def deploy(design: DesignFile, /, *, out: Path | None = None, as_json: JsonOutput = False) -> None:
    """Freeze the estimator of a design into one file.

    Args:
        out: output file, or a folder for NAME.probe.json. Default: exports/NAME.
    """
    from probedesign.design import load_design
    from probedesign.frozen_probe import deploy_model
    from probedesign.identification.design_update import design_diff
    from probedesign.probe import build_probe
    from probedesign.web.home import refresh_home

    with show_progress("freezing the probe"):
        probe = build_probe(load_design(design))
        exports = exports_of(design) / probe.design.name
        path = deploy_model(probe.model, out or exports)
        identified = exports / "identification/identification.json"
        unapplied = design_diff(probe.design, probe.geometry.fingerprint, identified)
    if out is None:
        refresh_home(probe.model, design)
    if as_json:
        print_json({"file": path, "identified_apart": unapplied})
        return
    print(f"wrote {path}")
    if unapplied:
        print(
            f"note: the frozen probe has the values of {design}, which differ from the identified ones: {unapplied}. "
            "To write those, run identify with --write or --out"
        )


def twin(
    design: DesignFile,
    /,
    *,
    formats: Annotated[str, Parameter(name="--format")] = "mjcf,sdf,urdf",
    out: Path | None = None,
    links: int | None = None,
    as_json: JsonOutput = False,
) -> None:
    """Write a probe for simulators: an elastic chain as MJCF (MuJoCo) and USD, a rigid body as SDF and URDF.

    Args:
        formats: out of mjcf, sdf, urdf and usd, separated by commas. usd needs usd-core.
        out: output folder. Default: exports/NAME/twin.
        links: number of links of the chain, even. Default: 10, or 14 of a curved probe.
    """
    from probedesign.design import load_design
    from probedesign.probe import build_probe
    from probedesign.simulation.twin import FORMATS, twin_files
    from probedesign.web.home import refresh_home

    chosen = formats.split(",")
    for name in chosen:
        if name not in FORMATS:
            raise InputError(f"--format {formats}: {name!r} is not a format; choose out of {', '.join(FORMATS)}")
    with show_progress("writing the twin"):
        probe = build_probe(load_design(design))
        folder = exports_of(design) / probe.design.name / "twin" if out is None else out
        check_folder(folder)
        files = write_files(folder, twin_files(probe.model, chosen, links).items())
        if out is None:
            refresh_home(probe.model, design)
    if as_json:
        print_json({"files": files})
        return
    print("wrote", ", ".join(map(str, files)))
