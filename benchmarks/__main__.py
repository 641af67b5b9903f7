"""`python -m benchmarks [rod|peak|start|estimation|detection|prediction|optimisation|export|live ...]`: all or some."""

import sys
from importlib import import_module

from benchmarks.timing import print_machine

PARTS = ("rod", "peak", "start", "estimation", "detection", "prediction", "optimisation", "export", "live")
"""Modules, each imported when its turn comes: worker processes import this one again."""


def main(names: list[str]) -> int:
    """Run the parts named, all if none; the exit status."""
    unknown = [name for name in names if name not in PARTS]
    if unknown:
        print(f"benchmarks: error: no part '{unknown[0]}'; there are {', '.join(PARTS)}", file=sys.stderr)
        return 2
    print_machine()
    for name in names or PARTS:
        import_module(f"benchmarks.{name}").report()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
