"""Runs the processing chain on a source, estimates contacts from a recording, and compiles all kernels beforehand."""

import gc
import itertools
import math
import threading
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array, pose
from probedesign.estimation.detector import Detector
from probedesign.estimation.estimate import RESULTS
from probedesign.estimation.estimator import Estimator, Method
from probedesign.estimation.tracker import Tracker
from probedesign.live import Log
from probedesign.live.blocks import Block, WrenchReading, limit_duration
from probedesign.live.outputs.sinks import Sink
from probedesign.live.poses.base_poses import BasePoses
from probedesign.live.processing.averaging import Averager
from probedesign.live.processing.chain import Chain, ProcessingOptions
from probedesign.live.processing.commands import CommandQueue
from probedesign.live.processing.estimates import COLUMNS, EstimateUpdate, Row, csv_line, estimate_row
from probedesign.live.processing.screen import SampleScreen
from probedesign.live.processing.tare import Tare, TareWindow, Zero, describe_tare, is_free, tare_of
from probedesign.live.sources.source import Source
from probedesign.rod.contact import safe_force, solve_frictionless

if TYPE_CHECKING:  # a run does not read recordings
    from probedesign.live.sources.replay import OpenRecording, RecordingOptions


def estimate_stream(
    estimator: Estimator,
    source: Source,
    options: ProcessingOptions,
    log: Log,
    sink: Sink | None = None,
    commands: CommandQueue | None = None,
    poses: BasePoses | None = None,
) -> Generator[EstimateUpdate, None, None]:
    """Yield estimates as readings arrive; source and poses are closed at the end in any case.

    The sink receives every raw reading, before averaging and tare, and every estimate. Without poses the base is fixed
    as the frozen probe or the source states.

    Raises:
        InputError: the tare window cannot be used, or the source fails.
    """
    chain = Chain(estimator, options, poses, log)
    try:
        with closing(iter(source)) as stream:
            blocks: Iterator[Block] = stream if options.seconds is None else limit_duration(stream, options.seconds)
            for update in itertools.islice(
                _updates(chain, blocks, log, sink, commands, getattr(source, "expect", None)), options.count
            ):
                if sink is not None:
                    sink.on_estimate(update)
                yield update
    finally:
        chain.scheduler.finish()
        if poses is not None:
            poses.close()


def _updates(
    chain: Chain,
    blocks: Iterator[Block],
    log: Log,
    sink: Sink | None,
    commands: CommandQueue | None,
    expect: Callable[[int], None] | None,
) -> Iterator[EstimateUpdate]:
    """Yield estimates block by block, execute commands in between, and state how many readings are expected next."""
    commands = commands or CommandQueue()
    commands.register("tare", lambda command: chain.take_tare(command.text == "force"))
    commands.register("mark", lambda command: f"mark: {command.text}")
    for block in blocks:
        if sink is not None:
            sink.on_samples(block)
        for update in chain.process(block):
            yield update
            if commands.execute(log):
                return
        if commands.execute(log):
            return
        if expect is not None:
            averager = chain.averager
            expect(averager.samples - averager.n_pending if averager.samples else 1)
    yield from chain.finish()


def merged(
    streams: Sequence[Generator[EstimateUpdate, None, None]], stop: Callable[[], None]
) -> Generator[tuple[int, EstimateUpdate], None, None]:
    """Yield the estimates of several probes as they become available, with the number of the probe.

    Each of several is processed in a thread of its own, so that no sensor waits for another. `stop` asks all of them to
    end, which happens if one fails, whose exception is raised here, or the caller ends.
    """
    if len(streams) == 1:
        with closing(streams[0]) as stream:
            yield from ((0, update) for update in stream)
        return
    arrived: SimpleQueue[tuple[int, EstimateUpdate | Exception | None]] = SimpleQueue()

    def work(number: int, stream: Generator[EstimateUpdate, None, None]) -> None:
        try:
            for update in stream:
                arrived.put((number, update))
            arrived.put((number, None))
        except Exception as error:  # raised where the estimates are taken
            arrived.put((number, error))

    threads = [threading.Thread(target=work, args=pair, daemon=True) for pair in enumerate(streams)]
    for thread in threads:
        thread.start()
    running = len(threads)
    try:
        while running:
            number, item = arrived.get()
            if isinstance(item, Exception):
                raise item
            if item is None:
                running -= 1
            else:
                yield number, item
    finally:
        stop()
        for thread in threads:
            thread.join(JOIN_TIMEOUT)


JOIN_TIMEOUT = 5.0  #: Maximum wait for the end of a probe's source [s].


def count_results(results: Iterable[str]) -> dict[str, int]:
    """Return the number of estimates with each result, in the order of `RESULTS`, without zeros."""
    counted = Counter(results)
    return {result: counted[result] for result in RESULTS if counted[result]}


def describe_counts(counts: dict[str, int]) -> str:
    """Return the counts as one line."""
    text = ", ".join(f"{count} {result}" for result, count in counts.items())
    return f"{sum(counts.values())} estimates" + (f": {text}" if text else "")


#: Time after which the user is informed [s]: kernels that take longer are compiled, not loaded from the cache.
NOTICE_DELAY = 6.0
WARM_UP_RATE = 7000.0
#: More touches than the tracker has keyframes, so that it merges some; more samples than it linearizes in turn.
WARM_UP_TOUCHES, WARM_UP_SAMPLES = 12, 8


def warm_up(estimator: Estimator, log: Log, *, fusing: bool = False) -> None:
    """Compute one estimate so that every kernel is compiled, and report it if that takes long.

    With `fusing`, detector and tracker are included.
    """
    kernels = "rod, estimator, detector and tracker" if fusing else "rod and estimator"
    text = f"compiling {kernels}; this takes about a minute once, reading starts afterwards"
    notice = threading.Timer(NOTICE_DELAY, log, [text])
    notice.daemon = True
    notice.start()
    try:
        model, touches = estimator.model, _warm_up_touches(estimator)
        for wrench, _ in touches[-1:]:
            estimate = estimator.estimate(wrench)
            _ = estimate.s_interval_95, estimator.estimate(wrench, near=estimate).shape
        if fusing:
            free, still = estimator.free(model.gravity_base).wrench_base, pose(np.eye(3), np.zeros(3))
            samples = np.zeros((WARM_UP_SAMPLES, 6))
            Detector(model, WARM_UP_RATE).run(samples)
            SampleScreen(model, 1, WARM_UP_RATE).screened(np.arange(float(WARM_UP_SAMPLES)), samples)
            tracker = Tracker(estimator, gravity_world=model.gravity_base, rate=WARM_UP_RATE)
            steps = [(free, still), *(touch for touch in touches for _ in range(WARM_UP_SAMPLES))]
            for i, (wrench, T) in enumerate(steps):
                tracker.update(wrench, T, i / WARM_UP_RATE)
            wrenches, poses = zip(*touches[:2], strict=True)
            estimator.fuse(wrenches, poses, model.gravity_base)  # the tracker restarts with this
    finally:
        notice.cancel()
    gc.collect()
    gc.freeze()  # exclude existing objects: a collection that visits them takes 0.1 s


def _warm_up_touches(estimator: Estimator) -> list[tuple[Array, Array]]:
    model = estimator.model
    s, touches = 0.7 * model.rod.length, []
    for force in safe_force(model.rod) * np.linspace(0.5, 1.0, WARM_UP_TOUCHES):
        touch = solve_frictionless(model.rod, model.gravity_base, s, 0.5, float(force))
        if touch.result == "ok":
            eq = touch.equilibrium
            _ = eq.R_at(s)  # a simulated source uses this kernel
            touches.append((eq.wrench_base, pose(np.eye(3), -eq.p_contact_base)))
    return touches


Progress = Callable[[list[WrenchReading]], Iterable[WrenchReading]]


@dataclass(frozen=True)
class RecordingEstimates:
    """Estimates of a recording."""

    estimator: Estimator  #: estimator used.
    recording: "OpenRecording"  #: the recording.
    readings: int  #: number of readings in it.
    missing_samples: int  #: number of samples missing in its gaps.
    samples: int  #: number of readings averaged to one.
    tare: Tare | None  #: bias subtracted from every reading, if a tare was requested.
    rows: list[Row]  #: one row per reading or mean.
    gravities: list[Array]  #: gravity in base axes at each row [m/s²], (3,).
    notes: tuple[str, ...]  #: notes for the user, one line each.
    method: Method = "ml"  #: method by which the readings were located.

    @property
    def counts(self) -> dict[str, int]:
        """Number of rows with each result."""
        return count_results(str(row["result"]) for row in self.rows)

    def csv(self) -> str:
        """Return the rows as CSV with a header."""
        return ",".join(COLUMNS) + "\n" + "".join(map(csv_line, self.rows))

    def document(self) -> dict[str, Any]:
        """Return everything as one JSON document."""
        model, tare = self.estimator.model, self.tare
        return {
            "probe": model.name,
            "fingerprint": model.fingerprint,
            "assumptions": model.assumptions,
            "recording": self.recording.path,
            "frame": self.recording.frame,
            "readings": self.readings,
            "missing_samples": self.missing_samples,
            "average": self.samples,
            "noise_force_N": model.noise.force,
            "noise_moment_Nm": model.noise.moment,
            "method": self.method,
            "friction": str(model.friction) if math.isinf(model.friction) else model.friction,
            "tolerances": asdict(self.estimator.priors),
            "tare": tare
            and {
                "start_s": tare.window.start,
                "end_s": tare.window.end,
                "readings": tare.readings,
                "bias_force_N": tare.bias_sensor[:3],
                "bias_moment_Nm": tare.bias_sensor[3:],
            },
            "notes": self.notes,
            "counts": self.counts,
            "estimates": self.rows,
        }


def estimate_recording(
    estimator: Estimator,
    path: Path,
    window: TareWindow | None = None,
    samples: int | None = 1,
    *,
    progress: Progress = iter,
    allow_incomplete: bool = False,
    options: "RecordingOptions | None" = None,
    method: Method = "ml",
    zero: Zero = "checked",
) -> RecordingEstimates:
    """Locate the contacts of a recording, by the chain of a live run with the tare known from the beginning.

    Args:
        estimator: estimator of the recorded probe.
        path: path of the recording.
        window: window of the tare, in which the probe is free; None: see `zero`.
        samples: number of readings averaged to one; None: as the noise of the first readings and their rate require.
        progress: receives the readings and passes them on one by one.
        allow_incomplete: accept an incomplete recording: dropped lines of CSV, a truncated file.
        options: what to read of a bag.
        method: see `Estimator.estimate`.
        zero: used without a tare window; "checked": "no_tare" throughout if no reading agrees with the free probe.

    Raises:
        InputError: the recording or the tare window cannot be used.
    """
    if samples is not None and samples < 1:
        raise InputError(f"--average {samples} must be positive")
    from probedesign.live.recordings.csv import gaps_in
    from probedesign.live.sources.replay import open_recording

    recording = open_recording(path, estimator.model, options)
    blocks = list(recording.blocks())
    if (missing := recording.missing()) and not allow_incomplete:
        raise InputError(f"{path}: {'; '.join(missing)}; use --mend to continue without the missing data")
    time = np.concatenate([np.empty(0), *(block.time for block in blocks)])
    lines: list[str] = []
    averager = Averager(samples, estimator.model, lines.append)
    batches = [batch for block in blocks for batch in averager.add(block)] + list(averager.finish())
    readings, samples = [batch.reading for batch in batches], averager.samples
    if not readings:
        raise InputError(f"{path}: {len(time)} readings are fewer than --average {samples}")
    tare = None if window is None and zero != "auto" else tare_of(readings, window, estimator)
    free = zero == "trusted" or any(is_free(reading, estimator) for reading in readings)
    trusted: Zero = "trusted" if free else "checked"
    processing = ProcessingOptions(samples=samples, method=method, zero=trusted, touches=False)
    chain = Chain(estimator, processing, None, lines.append, tare)
    updates = itertools.chain((u for block in blocks for u in chain.process(block)), chain.finish())
    rows = [
        estimate_row(update.reading, update.estimate) for _, update in zip(progress(readings), updates, strict=True)
    ]
    gaps, lost = gaps_in(time)
    gap = (f"{lost} samples are missing in {gaps} gaps",) if gaps else ()
    notes = [*dict.fromkeys((*recording.notes, *missing, *gap, *lines))]
    if samples > 1:
        unused = len(time) % samples
        end = f"; {unused} readings at the end are not used" if unused else ""
        notes.append(f"each estimate uses the mean of {samples} readings{end}")
    if tare is not None:
        notes.append(describe_tare(tare))
    gravities = [reading.gravity_base for reading in readings]
    return RecordingEstimates(
        estimator, recording, len(time), lost, samples, tare, rows, gravities, tuple(notes), method
    )
