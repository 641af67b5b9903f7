"""`probedesign estimate`: a recording in, one estimate a row out."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from probedesign.cli.output import print_json, working


def estimate(
    bundle: Path,
    recording: Path,
    /,
    *,
    out: Path | None = None,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> None:
    """Locate the contacts of a recording, one estimate a row.

    Args:
        bundle: the frozen probe, NAME.probe.json.
        recording: CSV with named units; see docs/recording-format.md.
        out: the CSV to write.
        as_json: print one JSON document.
    """
    from probedesign import pipeline

    with working("estimating"):
        estimates = pipeline.estimate(bundle, recording, out)
    print_json(estimates)  # lead completes
