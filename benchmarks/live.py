"""Live over loopback: a simulated box sends 7000 records a second to `netft://`, estimator and recording on.

`PROBEDESIGN_LIVE_SECONDS=600` runs ten minutes. Box and reader are two processes on one machine, as nobody
runs them, so what is lost in the kernel's buffer is lost to both.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

import numpy as np

from benchmarks.timing import print_table
from probedesign.deployment import load_estimator, write_frozen
from probedesign.design import load_design
from probedesign.live.netft.source import NetFT
from probedesign.live.recordings import Recordings
from probedesign.live.run import Plan, estimate_stream, warm_up
from probedesign.live.source import open_source
from probedesign.live.tare import Window
from probedesign.probe import build_probe

SECONDS = float(os.environ.get("PROBEDESIGN_LIVE_SECONDS", "20"))
AVERAGE = 36
DESIGN = Path(__file__).parents[1] / "designs" / "large.toml"


def report() -> None:
    """Print losses, latency and their growth."""
    with tempfile.TemporaryDirectory() as folder:
        bundle = Path(folder) / "large.probe.json"
        write_frozen(build_probe(load_design(DESIGN)).model, bundle)
        with _box(bundle) as box:
            try:
                _measure(bundle, _source(box), Path(folder) / "record.mcap")
            finally:
                box.terminate()


def _measure(bundle: Path, spec: str, recording: Path) -> None:
    estimator = load_estimator(bundle)
    warm_up(estimator, print)
    source = open_source(spec, estimator.model, print)
    assert isinstance(source, NetFT)
    late, memory, plan = [], [], Plan(Window(0.0, 3.0), AVERAGE, seconds=SECONDS)
    start, used = time.monotonic(), time.process_time()
    with closing(Recordings(recording, estimator.model, print)) as recordings:
        recordings.start()
        for answer in estimate_stream(estimator, source, plan, print, recordings):
            late.append(time.monotonic() - answer.reading.received)
            memory.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    wall, used = time.monotonic() - start, time.process_time() - used
    counts, late_ms = source.counts, 1e3 * np.array(late)
    half = len(late) // 2
    lost = f"{counts['lost']} ({counts['lost'] / max(counts['received'], 1):.3%})"
    halves = f"{np.median(late_ms[:half]):.2f}, {np.median(late_ms[half:]):.2f}"
    rows = [
        ["records", str(counts["received"]), ""],
        ["estimates a second", f"{len(late) / wall:.0f}", ""],
        ["dropped by our queue", str(counts["dropped"]), "0"],
        ["lost before it, in the kernel", lost, "< 1 %"],
        ["latency, median [ms]", f"{np.median(late_ms):.2f}", "≤ 2"],
        ["latency, 99.9 % [ms]", f"{np.percentile(late_ms, 99.9):.1f}", "≤ 20"],
        ["latency, median of each half [ms]", halves, "does not grow"],
        ["memory grew in the second half [MB]", f"{(memory[-1] - memory[half]) / 1024:.1f}", "flat"],
        ["processor, of one core", f"{used / wall:.0%}", ""],
    ]
    title = f"live over loopback: {SECONDS:g} s of 7000 records/s, {AVERAGE} to an estimate, recorded"
    print_table(title, ["", "measured", "target"], rows)


def _box(bundle: Path) -> "subprocess.Popen[str]":
    """A box in a process of its own, as `probedesign simulate` makes it."""
    command = [sys.executable, "-m", "probedesign.cli.main", "simulate", str(bundle)]
    return subprocess.Popen([*command, "--port", "0", "--http-port", "0"], stdout=subprocess.PIPE, text=True)


def _source(box: "subprocess.Popen[str]") -> str:
    assert box.stdout is not None
    for line in box.stdout:
        if "netft://" in line:
            return line.split('"')[1]
    raise RuntimeError("the box did not start")
