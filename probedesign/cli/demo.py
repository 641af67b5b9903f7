"""`probedesign demo`: the whole chain on a built-in example."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from probedesign.cli.console import print_json, print_table

if TYPE_CHECKING:
    from probedesign.demo import Demo


def demo(
    *,
    out: Path | None = None,
    force: bool = False,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> None:
    """Run the whole chain on a built-in example: design, predict, export, deploy, touch, locate.

    Args:
        out: folder for what it makes; by default exports/demo.
        force: replace what stands there, even if it is not what a demo left.
        as_json: print one JSON document.
    """
    from probedesign.demo import run_demo

    made = run_demo(out, _say, force)
    if as_json:
        print_json(made.as_dict())
    else:
        _print(made)


def _say(step: str) -> None:
    if sys.stderr.isatty():
        print(f"{step} ...", file=sys.stderr, flush=True)


def _print(made: "Demo") -> None:
    print("made")
    print_table(made.made)
    for reason in made.skipped:
        print("left out:", reason)
    print(
        f"\nlocated {made.located} of {made.touches} touches; contact error {made.error_mm:.2f} mm RMS, "
        f"the estimates themselves said {made.predicted_mm:.2f} mm"
    )
