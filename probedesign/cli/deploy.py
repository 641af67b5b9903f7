"""`probedesign deploy`: freeze the estimator of a design with its geometry."""

from pathlib import Path

from probedesign.cli.console import print_json, show_progress
from probedesign.cli.options import DesignFile, JsonOutput
from probedesign.core.files import exports_of


def deploy(design: DesignFile, /, *, out: Path | None = None, as_json: JsonOutput = False) -> None:
    """Freeze the estimator of a design into one file.

    Args:
        design: the design file, or its name.
        out: output file, or a folder for NAME.probe.json. Default: exports/NAME.
        as_json: print one JSON document.
    """
    from probedesign import pipeline
    from probedesign.frozen_probe import deploy_model
    from probedesign.identification.design_update import design_diff

    with show_progress("freezing the probe"):
        probe = pipeline.load_probe(design)
        exports = exports_of(design) / probe.design.name
        path = deploy_model(probe.model, out or exports)
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
