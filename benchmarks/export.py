"""Time, memory and files of `probedesign export` for the large probe as a whole process."""

import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from benchmarks.timing import print_table

ROOT = Path(__file__).parents[1]
PICTURE = ROOT / "docs/pictures/exploded.svg"
COMMAND = (sys.executable, "-m", "probedesign.cli.main", "export", "designs/large.toml", "--out")
RUNS = 3
TARGETS = ("≤ 20 s", "", "≤ 1500 MB")


class Run(NamedTuple):
    """Wall time [s], CPU time of all cores [s] and peak memory [MB] of one process."""

    wall_s: float
    cpu_s: float
    peak_MB: float


def measure_export(folder: Path) -> Run:
    """Run and measure one export.

    Raises:
        RuntimeError: the export fails.
    """
    start = time.perf_counter()
    process = subprocess.Popen([*COMMAND, str(folder)], cwd=ROOT, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)  # resource usage of this child only
    if status:
        raise RuntimeError(f"export ended with status {os.waitstatus_to_exitcode(status)}")
    unit = 1.0 if sys.platform == "darwin" else 1024.0  # Linux counts in kibibytes
    return Run(time.perf_counter() - start, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * unit / 1e6)


def report() -> None:
    """Print the tables and copy the exploded view to the documentation."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "large"
        first, *warm = [measure_export(folder) for _ in range(1 + RUNS)]
        shutil.copyfile(folder / "exploded.svg", PICTURE)
        sizes = sorted((path.stat().st_size, path.name) for path in folder.iterdir())
    middle = Run(*(statistics.median(values) for values in zip(*warm, strict=True)))
    rows = [
        [name, f"{a:.3g}", f"{b:.3g}", target]
        for name, a, b, target in zip(
            ("wall time [s]", "CPU time [s]", "peak memory [MB]"), first, middle, TARGETS, strict=True
        )
    ]
    print_table(
        f"probedesign export designs/large.toml: first run, and median of {RUNS} more",
        ["", "first", "warm", "target"],
        rows,
    )
    total = sum(size for size, _ in sizes)
    largest = ", ".join(f"{name} {size / 1e3:.0f}" for size, name in sizes[:-4:-1])
    print(f"  {len(sizes)} files, {total / 1e3:.0f} kB; largest: {largest} kB")
