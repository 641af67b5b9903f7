"""`python -m benchmarks [NAME ...]`: all parts or some, as `PARTS` names them."""

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
}


def main(names: list[str]) -> int:
    """Run the parts named, all if none; the exit status."""
    unknown = [name for name in names if name not in PARTS]
    if unknown:
        print(f"benchmarks: error: no part '{unknown[0]}'; there are {', '.join(PARTS)}", file=sys.stderr)
        return 2
    print_machine()
    for name in names or PARTS:
        PARTS[name]()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
