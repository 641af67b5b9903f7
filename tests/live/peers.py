"""A simulated box with faults, and a reader of it in a thread of its own, so that a test may disturb the box meanwhile.

Ports are chosen by the system. Waiting ends with what is waited for; the deadlines only keep a broken test short.
"""

import threading
import time
from dataclasses import replace

import numpy as np

from probedesign.core.errors import InputError
from probedesign.live.processing.averaging import Averager
from probedesign.live.sources.source import open_source
from probedesign.simulation.netft_box import NATIVE, SimulatedNetFT, SimulatedTransducer

LOAD = np.array([0.05, -0.02, 0.1, 2e-3, 1e-3, -5e-4])


class FaultyBox(SimulatedNetFT):
    """A box whose network loses, exchanges, doubles and cuts packets, and which stalls and restarts.

    Attributes:
        load: wrench at the sensor, which a test may change.
        disorder: probability of each fault of a packet.
        status: bits that each status word has.
    """

    def __init__(self, model, settings, load, **options):
        self.load, self.disorder, self.status = np.array(load), 0.0, 0
        transducer = SimulatedTransducer(model, lambda when: np.tile(self.load, (len(when), 1)), seed=1, drift=0.0)
        super().__init__(transducer, settings, **options)
        self._luck, self._delayed = np.random.default_rng(1), []
        self._off_until = self._stalled_until = 0.0

    def restart(self, seconds):
        """Its counter begins anew, and its client is forgotten."""
        with self._lock:
            self.client, self._next = None, 0
            self._off_until = self._zero = time.monotonic() + seconds

    def stall(self, seconds):
        """The same sample is sent again and again."""
        with self._lock:
            self._stalled_until, self._frozen = time.monotonic() + seconds, self._next - 1

    def drop_client(self):
        """Another client takes the stream."""
        with self._lock:
            self.client = None

    def configure(self, **changes):
        self.configuration = replace(self.configuration, **changes)

    def _page(self):
        time.sleep(max(0.0, self._off_until - time.monotonic()))
        return super()._page()

    def _receive(self):
        if time.monotonic() < self._off_until:
            self._udp.recv(100)
        else:
            super()._receive()

    def _records(self, samples):
        stalled = time.monotonic() < self._stalled_until
        records = super()._records(np.full(len(samples), self._frozen) if stalled else samples)
        records["status"] |= self.status
        return records

    def _send(self, packets):
        sent = []
        for packet in packets if self.disorder else ():
            loss, delay, double, garbage, short = (self._luck.random(5) < self.disorder).tolist()
            if delay and not self._delayed:
                self._delayed.append(packet)
            elif not loss:
                packet = packet[:20] if short else packet
                sent += [bytes(17)] * garbage + [packet] * (1 + double) + self._delayed
                self._delayed = []
        super()._send(sent if self.disorder else packets)


def box(estimator, settings=NATIVE, load=LOAD, **options) -> FaultyBox:
    return FaultyBox(estimator.model, settings, load, **options)


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
