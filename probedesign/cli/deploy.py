"""`probedesign deploy`: freeze the estimator with its matching geometry."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from probedesign.cli.output import print_json, working


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
    print_json({"file": path}) if as_json else print(f"wrote {path}")
