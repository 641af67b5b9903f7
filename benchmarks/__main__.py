"""`python -m benchmarks [PART ...]`: all parts or some; an unknown name is told which there are."""

import argparse
import sys
from importlib import import_module

from benchmarks.timing import print_machine

PARTS = ("rod", "peak", "start", "estimation", "detection", "prints", "identify", "pictured", "validation",
         "prediction", "optimisation", "sweep", "export", "live", "recording", "view",
         "explore")  # fmt: skip
"""Modules, each imported when its turn comes: worker processes import this one again."""


def main(arguments: list[str]) -> int:
    """Run the parts named, all if none; the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks")
    parser.add_argument("parts", nargs="*", help=f"of {', '.join(PARTS)}; all if none is named")
    parser.add_argument(
        "--minutes", type=float, help="how long live streams, a third of a minute if not said"
    )
    parser.add_argument("--view", action="store_true", help="live with the page of live --view")
    said = parser.parse_args(arguments)
    unknown = [name for name in said.parts if name not in PARTS]
    if unknown:
        parser.error(f"no part '{unknown[0]}'; there are {', '.join(PARTS)}")
    print_machine()
    for name in said.parts or PARTS:
        asked = {"minutes": said.minutes, "view": said.view or None} if name == "live" else {}
        options = {option: value for option, value in asked.items() if value is not None}
        import_module(f"benchmarks.{name}").report(**options)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
