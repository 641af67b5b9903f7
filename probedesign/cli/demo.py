"""`probedesign demo`: the whole chain on a built-in example."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from probedesign.cli.output import print_json


def demo(
    *,
    out: Path | None = None,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> None:
    """Run the whole chain on a built-in example.

    Args:
        out: folder for what it makes; by default exports/demo.
        as_json: print one JSON document.
    """
    from probedesign import pipeline

    print_json(pipeline.demo(out))  # lead completes
