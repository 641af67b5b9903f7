"""`probedesign deploy`: freeze the estimator with its matching geometry."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from probedesign.cli.console import print_json, working


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
        out: the file to write; by default exports/NAME/NAME.probe.json.
        as_json: print one JSON document.
    """
    from probedesign import pipeline

    with working("freezing the probe"):
        path = pipeline.deploy(design, out)
        apart = pipeline.identified_apart(design)
    if as_json:
        print_json({"file": path, "identified_apart": apart})
        return
    print(f"wrote {path}")
    if apart:
        print(
            f"note: frozen as {design} has it; identified were {apart}: identify writes that with --write or --out"
        )
