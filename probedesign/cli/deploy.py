"""`probedesign deploy`: freeze the estimator of a design with its geometry."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from probedesign.cli.console import print_json, show_progress


def deploy(
    design: Path,
    /,
    *,
    out: Path | None = None,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> None:
    """Freeze the estimator of a design into one file.

    Args:
        design: the design file.
        out: output file. Default: exports/NAME/NAME.probe.json.
        as_json: print one JSON document.
    """
    from probedesign import pipeline

    with show_progress("freezing the probe"):
        path = pipeline.deploy(design, out)
        unapplied = pipeline.unapplied_parameters(design)
    if as_json:
        print_json({"file": path, "identified_apart": unapplied})
        return
    print(f"wrote {path}")
    if unapplied:
        print(
            f"note: the frozen probe has the values of {design}, which differ from the identified ones: {unapplied}. "
            "To write those, run identify with --write or --out"
        )
