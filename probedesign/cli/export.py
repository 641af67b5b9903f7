"""`probedesign export`: the parts to print."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from probedesign.cli.output import print_json, working


def export(
    design: Path,
    /,
    *,
    out: Path | None = None,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> None:
    """Make the parts to print: STL, STEP, 3MF and their manifest.

    Args:
        design: the design file.
        out: folder for the parts; by default exports/NAME.
        as_json: print the manifest.
    """
    from probedesign import pipeline

    with working("building the parts"):
        manifest = pipeline.export(design, out)
    print_json(manifest)  # lead completes: a readable summary without --json
