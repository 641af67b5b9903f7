"""`python -m benchmarks [NAME ...]`: all parts or some, as `PARTS` names them."""

import argparse
import sys

from benchmarks import (
    detection,
    estimation,
    export,
    live,
    optimisation,
    peak,
    prediction,
    recording,
    rod,
    start,
    view,
)
from benchmarks.timing import print_machine

PARTS = {
    "rod": rod.report,
    "peak": peak.report,
    "start": start.report,
    "estimation": estimation.report,
    "detection": detection.report,
    "prediction": prediction.report,
    "optimisation": optimisation.report,
    "export": export.report,
    "live": live.report,
    "recording": recording.report,
    "view": view.report,
}


def main(arguments: list[str]) -> int:
    """Run the parts named, all if none; the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks")
    parser.add_argument("parts", nargs="*", help=f"of {', '.join(PARTS)}; all if none is named")
    parser.add_argument("--minutes", type=float, default=live.MINUTES, help="how long live streams")
    parser.add_argument("--view", action="store_true", help="live with its page open")
    said = parser.parse_args(arguments)
    unknown = [name for name in said.parts if name not in PARTS]
    if unknown:
        parser.error(f"no part '{unknown[0]}'; there are {', '.join(PARTS)}")
    print_machine()
    for name in said.parts or PARTS:
        live.report(said.minutes, said.view) if name == "live" else PARTS[name]()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
