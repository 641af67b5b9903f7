"""Speed-up of the command `sweep` with two workers, including their start and end."""

import os
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from benchmarks.timing import format_seconds, print_table

DESIGN = Path(__file__).parents[1] / "designs/large.toml"
VARY = ("probe.base_d_mm=8:15.8:0.2", "probe.tip_d_mm=1.6:4:0.1")  #: 40 times 25 designs, none of which buckles.
DESIGNS = 1000
WORKERS = (1, 2)
_POLL_PERIOD = 0.5


def report() -> None:
    """Print wall time, CPU time and speed-up."""
    runs = {workers: _run(workers) for workers in WORKERS}
    first = runs[WORKERS[0]][0]
    rows = [[worker_count(workers), format_seconds(wall), format_seconds(cpu), f"{first / wall:.2f} x"]
            for workers, (wall, cpu) in runs.items()]  # fmt: skip
    print_table(f"Sweep of {DESIGNS} designs, whole command, on {len(os.sched_getaffinity(0))} cores; "
                "CPU time is the sum over all processes; target for two workers 1.8 x",
                ["", "wall", "CPU", "speed-up"], rows)  # fmt: skip


def worker_count(workers: int) -> str:
    """Return the number of workers with its unit."""
    return f"{workers} worker{'' if workers == 1 else 's'}"


def _run(workers: int) -> tuple[float, float]:
    """Return wall and CPU time [s]."""
    with tempfile.TemporaryDirectory() as out:
        vary = [part for axis in VARY for part in ("--vary", axis)]
        command = [sys.executable, "-m", "probedesign.cli.main", "sweep", str(DESIGN), *vary,
                   "--workers", str(workers), "--out", out]  # fmt: skip
        wall = time.perf_counter()
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as run:
            cpu = _cpu_time(run)
            printed = run.stdout.read() if run.stdout else ""
        wall = time.perf_counter() - wall
    assert f"{DESIGNS} designs, {DESIGNS} computed" in printed, printed
    return wall, cpu


def _cpu_time(run: "subprocess.Popen[str]") -> float:
    """Return the CPU time of a process and its descendants [s], sampled while it runs.

    The operating system adds the time of a descendant only if its parent waits for it, which not all do.
    """
    import psutil  # comes with dask.distributed

    first, used = psutil.Process(run.pid), dict[int, float]()
    while run.poll() is None:
        with suppress(psutil.Error):
            for process in (first, *first.children(recursive=True)):
                with suppress(psutil.Error):
                    spent = process.cpu_times()
                    used[process.pid] = spent.user + spent.system
        time.sleep(_POLL_PERIOD)
    return sum(used.values())
