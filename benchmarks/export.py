"""Time, memory and files of `probedesign export` as a whole process, straight and curved, and of a single STL."""

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
COMMAND = (sys.executable, "-m", "probedesign.cli.main", "export")
RUNS = 3
#: What is measured: design and options, and the targets of wall time, CPU time and memory on an idle machine.
CASES = (
    (("designs/whisker.toml",), ("≤ 15 s", "", "≤ 900 MB")),
    (("designs/large.toml", "--only", "probe"), ("≤ 4 s", "", "")),
    (("designs/large.toml",), ("≤ 15 s", "", "≤ 900 MB")),
)


class Run(NamedTuple):
    """Wall time [s], CPU time of all cores [s] and peak memory [MB] of one process."""

    wall_s: float
    cpu_s: float
    peak_MB: float


def measure_export(folder: Path, *options: str) -> Run:
    """Run and measure one export.

    Raises:
        RuntimeError: the export fails.
    """
    start = time.perf_counter()
    process = subprocess.Popen([*COMMAND, *options, "--out", str(folder)], cwd=ROOT, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)  # resource usage of this child only
    if status:
        raise RuntimeError(f"export ended with status {os.waitstatus_to_exitcode(status)}")
    unit = 1.0 if sys.platform == "darwin" else 1024.0  # Linux counts in kibibytes
    return Run(time.perf_counter() - start, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * unit / 1e6)


def report() -> None:
    """Print the tables and copy the exploded view to the documentation."""
    with tempfile.TemporaryDirectory() as scratch:
        for options, targets in CASES:
            folder = Path(scratch) / "-".join(Path(option).stem for option in options)
            first, *warm = [measure_export(folder, *options) for _ in range(1 + RUNS)]
            middle = Run(*(statistics.median(values) for values in zip(*warm, strict=True)))
            names = ("wall time [s]", "CPU time [s]", "peak memory [MB]")
            print_table(
                f"probedesign export {' '.join(options)}: first run, and median of {RUNS} more",
                ["", "first", "warm", "target"],
                [
                    [name, f"{a:.3g}", f"{b:.3g}", target]
                    for name, a, b, target in zip(names, first, middle, targets, strict=True)
                ],
            )
        shutil.copyfile(folder / "exploded.svg", PICTURE)
        sizes = sorted((path.stat().st_size, path.name) for path in folder.iterdir())
    total = sum(size for size, _ in sizes)
    largest = ", ".join(f"{name} {size / 1e3:.0f}" for size, name in sizes[:-4:-1])
    print(f"  {len(sizes)} files, {total / 1e3:.0f} kB; largest: {largest} kB")
