"""`python -m benchmarks [PART ...]`: all parts or some; for an unknown name it lists the parts."""

import argparse
import sys
from importlib import import_module

from benchmarks.timing import print_machine

PARTS = ("rod", "peak", "start", "install", "estimation", "detection", "prints", "identify", "pictured", "validation",
         "planning", "prediction", "optimisation", "sweep", "export", "live", "recording", "view",
         "studio", "day", "explore", "clamp", "coverage")  # fmt: skip
"""Modules, each imported when its turn comes: worker processes import this one again."""


def main(arguments: list[str]) -> int:
    """Run the parts named, all if none; the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks")
    parser.add_argument("parts", nargs="*", help=f"of {', '.join(PARTS)}; all if none is named")
    parser.add_argument("--minutes", type=float, help="how long live streams, default a third of a minute")
    parser.add_argument("--hours", type=float, help="day: how long it is, default 8")
    parser.add_argument("--view", action="store_true", help="live with the page of live --view")
    parser.add_argument("--foxglove", action="store_true", help="live with the server of live --foxglove")
    parser.add_argument("--draws", type=int, help="coverage: single touches a row")
    parser.add_argument("--only", help="coverage: only rows with this in their name")
    parser.add_argument("--bounds", action="store_true", help="coverage: the bounds of one touch instead")
    parser.add_argument("--workers", type=int, help="coverage: processes, default 2")
    parser.add_argument("--json", action="store_true", help="coverage: one JSON document")
    args = parser.parse_args(arguments)
    unknown = [name for name in args.parts if name not in PARTS]
    if unknown:
        parser.error(f"no part '{unknown[0]}'; there are {', '.join(PARTS)}")
    if not args.json:
        print_machine()
    for name in args.parts or PARTS:
        given: dict[str, object] = {}
        if name == "live":
            given = {"minutes": args.minutes, "view": args.view or None, "foxglove": args.foxglove or None}
        elif name == "day":
            given = {"hours": args.hours}
        elif name == "coverage":
            given = {"draws": args.draws, "only": args.only, "bounds_only": args.bounds or None,
                     "as_json": args.json or None, "workers": args.workers}  # fmt: skip
        options = {option: value for option, value in given.items() if value is not None}
        import_module(f"benchmarks.{name}").report(**options)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
