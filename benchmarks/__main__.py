"""Run benchmarks: `python -m benchmarks [PART ...]`."""

import argparse
import sys
from importlib import import_module

from benchmarks.timing import print_machine

#: Benchmarks by module. Each is imported when it runs, because worker processes import this module again.
PARTS = ("rod", "start", "install", "estimation", "curved", "identify", "pictured",
         "planning", "table1", "optimisation", "export", "live", "view", "studio",
         "pictures", "day", "motion", "explore", "shapes", "coverage", "twin", "real")  # fmt: skip


def main(arguments: list[str]) -> int:
    """Run the named parts, or all if none is named, and return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks")
    parser.add_argument("parts", nargs="*", help=f"benchmarks to run, out of {', '.join(PARTS)}; default all")
    parser.add_argument("--minutes", type=float, help="live: duration of the stream, default 1/3")
    parser.add_argument("--hours", type=float, help="day: length of the simulated day, default 8")
    parser.add_argument("--view", action="store_true", help="live: with the page of live --view")
    parser.add_argument("--foxglove", action="store_true", help="live: with the server of live --foxglove")
    parser.add_argument("--draws", type=int, help="coverage: touches in each row; shapes: objects of each kind")
    parser.add_argument("--scenes", type=int, help="shapes: card houses and known objects, default 10")
    parser.add_argument(
        "--only", help="coverage: rows with this in the name; motion: payload, drift, moves, touches; explore: probes"
    )
    parser.add_argument("--bounds", action="store_true", help="coverage: print the bounds of one touch instead")
    parser.add_argument("--workers", type=int, help="coverage: number of processes, default 2")
    parser.add_argument("--data", help="real: folder with measurements by others")
    args = parser.parse_args(arguments)
    unknown = [name for name in args.parts if name not in PARTS]
    if unknown:
        parser.error(f"there is no benchmark '{unknown[0]}'; choose from {', '.join(PARTS)}")
    if args.parts != ["real"]:  # where no time counts
        print_machine()
    for name in args.parts or PARTS:
        given: dict[str, object] = {}
        if name == "live":
            given = {"minutes": args.minutes, "view": args.view or None, "foxglove": args.foxglove or None}
        elif name == "real":
            given = {"data": args.data}
        elif name in ("motion", "explore"):
            given = {"only": args.only}
        elif name == "shapes":
            given = {"draws": args.draws, "scenes": args.scenes}
        elif name == "day":
            given = {"hours": args.hours}
        elif name == "coverage":
            given = {"draws": args.draws, "only": args.only, "bounds_only": args.bounds or None,
                     "workers": args.workers}  # fmt: skip
        options = {option: value for option, value in given.items() if value is not None}
        import_module(f"benchmarks.{name}").report(**options)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
