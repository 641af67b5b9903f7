"""`probedesign predict`: what a design will sense, before it is printed."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from probedesign.cli.output import print_json, working


def predict(
    design: Path,
    /,
    *,
    out: Path | None = None,
    plots: bool = False,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> None:
    """Predict sensitivity and contact error of a design.

    Args:
        design: the design file.
        out: folder for tables and plots; by default exports/NAME.
        plots: draw them too.
        as_json: print one JSON document.
    """
    from probedesign import pipeline

    with working("predicting"):
        prediction = pipeline.predict(design, out, plots)
    print_json(prediction)  # lead completes: a table without --json
