"""A simulated box, and a reader of it in a thread of its own, so that a test may disturb the box meanwhile.

Ports are chosen by the system. Waiting ends with what is waited for; the deadlines only keep a broken test short.
"""

import threading
import time

import numpy as np

from probedesign.core.errors import InputError
from probedesign.live.processing.averaging import Averager
from probedesign.live.sources.source import open_source
from probedesign.simulation.netft_box import NATIVE, SimulatedNetFT, SimulatedTransducer

LOAD = np.array([0.05, -0.02, 0.1, 2e-3, 1e-3, -5e-4])


def box(estimator, settings=NATIVE, load=LOAD, **options) -> SimulatedNetFT:
    def constant(when):
        return np.tile(load, (len(when), 1))

    return SimulatedNetFT(SimulatedTransducer(estimator.model, constant, seed=1, drift=0.0), settings, **options)


def until(happened, describe=lambda: "", seconds=10.0):
    deadline = time.monotonic() + seconds
    while not happened():
        assert time.monotonic() < deadline, describe()
        time.sleep(0.01)


class Reader:
    """Reads a source.

    Attributes:
        lines: the messages of the source.
        readings: one by one.
        blocks: as they came, those of silence with them.
        story: (time by the host's clock, block or line), in the order in which they came.
        error: what ended it.
    """

    def __init__(self, peer, estimator, query: str = ""):
        self.lines, self.readings, self.blocks, self.story, self.error = [], [], [], [], None
        self.source = open_source(peer.source + query, estimator.model, self._told)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._read, daemon=True)

    def _told(self, line):
        self.lines.append(line)
        self.story.append((time.monotonic(), line))

    def _read(self):
        stream = iter(self.source)
        try:
            for block in stream:
                self.blocks.append(block)
                self.story.append((time.monotonic(), block))
                self.readings.extend(block.readings())
                if self._ended.is_set():
                    break
        except InputError as error:
            self.error = error
        finally:
            stream.close()

    def wait(self, happened):
        until(happened, lambda: (self.lines, len(self.readings), self.error))

    def more(self, count=200):
        have = len(self.readings)
        self.wait(lambda: len(self.readings) >= have + count)

    def has_logged(self, words):
        self.wait(lambda: any(words in line for line in self.lines))

    def __enter__(self):
        self._thread.start()
        self.more()
        return self

    def __exit__(self, *_):
        self._ended.set()
        self._thread.join(10.0)


def taken(peer, estimator, count: int):
    """The first readings of a box, and the source that gave them."""
    source = open_source(peer.source, estimator.model)
    stream, readings = iter(source), []
    for block in stream:
        readings.extend(block.readings())
        if len(readings) >= count:
            break
    stream.close()
    return readings[:count], source


def mean_of(readings):
    return np.mean([r.wrench_sensor for r in readings], axis=0)


def close(estimator, count):
    """Six standard deviations of the mean of so many raw samples."""
    model = estimator.model
    return 6.0 * np.sqrt(np.diag(model.noise.cov) * model.averaging_samples / count)


def averaged(blocks, samples):
    batches = Averager(samples, None, print)
    return [batch.reading for block in blocks for batch in batches.add(block)]
