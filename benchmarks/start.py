"""Wall time of whole commands, each in its own process."""

import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.timing import format_seconds, print_table

ROOT = Path(__file__).parents[1]
RUNS = 5
PROBEDESIGN = (sys.executable, "-m", "probedesign.cli.main")
PYTHON = (sys.executable, "-c")


def wall(command: tuple[str, ...]) -> float:
    """Return the wall time of a command that must succeed [s]."""
    start = time.perf_counter()
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    return time.perf_counter() - start


def report() -> None:
    """Print the wall times."""
    with tempfile.TemporaryDirectory() as out:
        commands = {
            "python -c pass": ((*PYTHON, "pass"), ""),
            "probedesign --help": ((*PROBEDESIGN, "--help"), "≤ 0.5 s"),
            'python -c "import probedesign"': ((*PYTHON, "import probedesign"), "≤ 0.4 s"),
            "probedesign predict designs/large.toml": (
                (*PROBEDESIGN, "predict", "designs/large.toml", "--out", out),
                "≤ 5 s",
            ),
        }
        first = {name: wall(command) for name, (command, _) in commands.items()}
        rounds = [{name: wall(command) for name, (command, _) in commands.items()} for _ in range(RUNS)]
    rows = [
        [name, format_seconds(first[name]), format_seconds(statistics.median(found[name] for found in rounds)), target]
        for name, (_, target) in commands.items()
    ]
    print_table(
        f"Whole processes: first run, and median of {RUNS} more interleaved runs",
        ["command", "first", "warm", "target"],
        rows,
    )
