"""`probedesign deploy`: freeze the estimator of a design with its geometry."""

from pathlib import Path
from typing import TYPE_CHECKING

from probedesign.cli.console import print_json, show_progress
from probedesign.cli.options import DesignFile, JsonOutput
from probedesign.core.files import exports_of

if TYPE_CHECKING:
    from probedesign.probe import Probe


def deploy(design: DesignFile, /, *, out: Path | None = None, as_json: JsonOutput = False) -> None:
    """Freeze the estimator of a design into one file.

    Args:
        design: the design file, or its name.
        out: output file, or a folder for NAME.probe.json. Default: exports/NAME.
        as_json: print one JSON document.
    """
    from probedesign import pipeline
    from probedesign.identification.design_update import design_diff

    with show_progress("freezing the probe"):
        probe = pipeline.load_probe(design)
        exports = exports_of(design) / probe.design.name
        path = write_bundle(probe, out or exports)
        identified = exports / "identification/identification.json"
        unapplied = design_diff(probe.design, probe.geometry.fingerprint, identified)
    if as_json:
        print_json({"file": path, "identified_apart": unapplied})
        return
    print(f"wrote {path}")
    if unapplied:
        print(
            f"note: the frozen probe has the values of {design}, which differ from the identified ones: {unapplied}. "
            "To write those, run identify with --write or --out"
        )


def write_bundle(probe: "Probe", path: Path) -> Path:
    """Write the frozen probe and return its file, which may replace a frozen probe only.

    Args:
        probe: to freeze.
        path: a file, or a folder: one that exists, or a name that does not end in .json.

    Raises:
        InputError: another file has that name, or the parts exported beside it have another geometry.
    """
    from probedesign.frozen_probe import check_manifest, check_replaceable, write_frozen

    if path.is_dir() or (path.suffix != ".json" and not path.exists()):
        path /= f"{probe.design.name}.probe.json"
    check_replaceable(path)
    manifest = path.parent / "manifest.json"
    if manifest.exists():
        check_manifest(probe.geometry.fingerprint, manifest)
    write_frozen(probe.model, path)
    return path
