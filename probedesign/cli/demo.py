"""`probedesign demo`: run the whole chain on a built-in example."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from probedesign.cli.console import print_json, print_step, print_table


def demo(
    *,
    out: Path | None = None,
    force: bool = False,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> None:
    """Run the whole chain on a built-in example: design, predict, export, deploy, simulate, estimate.

    Args:
        out: output folder. Default: exports/demo.
        force: replace existing files, even those that the demo did not write.
        as_json: print one JSON document.
    """
    from probedesign.demo import run_demo

    result = run_demo(out, print_step, force)
    if as_json:
        print_json(result.as_dict())
        return
    print("wrote")
    print_table(result.made)
    for reason in result.skipped:
        print("skipped:", reason)
    print(
        f"\n{result.located} of {result.touches} touches located; contact error {result.error_mm:.2f} mm RMS, "
        f"predicted {result.predicted_mm:.2f} mm RMS"
    )
