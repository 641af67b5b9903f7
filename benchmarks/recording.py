"""Processor time and size of a recorded second of a Net F/T box, 7000 readings, in MCAP and CSV."""

import os
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.timing import print_table
from probedesign.design import load_design
from probedesign.estimation.model import ProbeModel
from probedesign.live.blocks import Block
from probedesign.live.outputs.recording import FLUSH_PERIOD, RecordingFile, open_recording_file
from probedesign.live.sources.replay import open_recording
from probedesign.probe import build_probe

RATE = 7000
SECONDS = int(os.environ.get("PROBEDESIGN_RECORDING_SECONDS", "10"))
BLOCK_SIZES = (1, 7, 35)  #: Readings in each block; a source that empties its queue returns several at once.
DESIGN = Path(__file__).parents[1] / "designs" / "large.toml"


def report() -> None:
    """Print the processor time and the size of a recorded second."""
    model = build_probe(load_design(DESIGN)).model
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for kind in ("mcap", "csv"):
            for count in BLOCK_SIZES:
                path, blocks = Path(folder) / f"{count}.{kind}", _blocks(model, count)
                written = _cpu_time(partial(_write, open_recording_file(path, [model], False, {}), blocks)) / SECONDS
                read = _cpu_time(partial(_read, path, model)) / SECONDS / RATE
                size = path.stat().st_size / SECONDS / 1e6
                rows.append([f"{kind}, {count} per block", f"{written:.1%}", f"{size:.2f}", f"{1e6 * read:.1f}"])
    head = ["", "share of a core", "MB", "reading back [µs/reading]"]
    print_table(f"Recording one second of {RATE} readings, mean of {SECONDS}", head, rows)


def _blocks(model: ProbeModel, count: int) -> list[Block]:
    """Return blocks of noise, which compresses worst."""
    noise = np.random.default_rng(1)
    std = model.noise.std
    times = np.arange(RATE * SECONDS).reshape(-1, count) / RATE
    return [Block(time, std * noise.standard_normal((count, 6)), model.gravity_base, time) for time in times]


def _write(file: RecordingFile, blocks: list[Block]) -> None:
    """Write blocks with the flush period of the writer thread."""
    interval = int(FLUSH_PERIOD * RATE) // len(blocks[0])
    for i, block in enumerate(blocks):
        file.on_samples(block)
        if i % interval == 0:
            file.flush()
    file.close()


def _read(path: Path, model: ProbeModel) -> None:
    for _ in open_recording(path, model).blocks():
        pass


def _cpu_time(call: Callable[[], None]) -> float:
    """Return the processor time of a call [s]."""
    before = time.process_time()
    call()
    return time.process_time() - before
