"""Recordings of any kind as blocks of readings, and the source `replay:FILE` that plays them.

Our own MCAP recordings reproduce the readings of the original source, their times to the nanosecond.
Other ROS 2 bags and CSV are read too.
"""

import json
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import islice, pairwise
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from probedesign.core.csv_tables import CEILING, WRENCH, Frame
from probedesign.core.errors import InputError, one_line, quoted
from probedesign.core.files import check_regular
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.estimation.model import ProbeModel
from probedesign.frozen_probe import freeze
from probedesign.live import Log
from probedesign.live.blocks import Block, WrenchReading
from probedesign.live.recordings import schemas
from probedesign.live.recordings.csv import Recording, read_recording
from probedesign.live.recordings.schemas import BLOCK, METADATA_NAME, RAW, Message, decode, read_wrenches, ros_name
from probedesign.live.sources import rosbag
from probedesign.live.sources.rosbag import Bag
from probedesign.live.sources.source import SPEED, SourceParameter, parse_parameters, played

MomentUnit = Literal["Nm", "Nmm"]
BLOCK_SIZE = 256  #: Readings per block: few enough for a short delay, enough for efficiency.


@dataclass(frozen=True)
class RecordingOptions:
    """What to read of a bag, and how."""

    topic: str = ""  #: topic of the wrenches; may be empty if there is only one, or for our own recordings.
    frame: Frame | None = None  #: frame of a topic of another publisher.
    moment_unit: MomentUnit = "Nm"  #: moment unit that the publisher used, regardless of the standard.
    other_probe: bool = False  #: accept our own recordings of another probe.


@dataclass(frozen=True)
class OpenRecording:
    """A recording, open for reading."""

    path: Path  #: path of the recording.
    description: str  #: its content in a few words.
    frame: Frame  #: frame of its wrenches.
    notes: tuple[str, ...]  #: notes for the user before it is read.
    blocks: Callable[[], Iterator[Block]]  #: returns its readings, in the sensor frame.
    #: returns what is missing in it, as far as it was read.
    missing: Callable[[], tuple[str, ...]] = field(default=lambda: ())
    source: str = ""  #: source that was recorded, as stated in the recording; may be empty.


def open_recording(path: Path, model: ProbeModel, options: RecordingOptions | None = None) -> OpenRecording:
    """Open the recording at a path: CSV, MCAP, `.db3`, or the folder of a bag.

    Args:
        path: path of the file or folder.
        model: recorded probe; its gravity is used if the recording has none.
        options: what to read of a bag.

    Raises:
        InputError: the path is not a recording, or not of this probe.
        MissingDependencyError: the package that reads it is not installed.
    """
    options = options or RecordingOptions()
    check_readable(path)
    if not rosbag.is_bag(path):
        if options.topic:
            raise InputError(f"{path}: has no topic {options.topic!r}: it is not a ROS 2 bag")
        recording = read_recording(path)
        notes, description = recording.notes + recording.damage, f"{len(recording.time)} readings"
        return OpenRecording(path, description, recording.frame, notes,
                             lambda: _table_blocks(recording, model), lambda: recording.damage)  # fmt: skip
    bag = rosbag.open_bag(path)
    if METADATA_NAME in bag.metadata and not options.topic:
        return _open_native(bag, model, options)
    return _open_foreign(bag, model, options)


def check_readable(path: Path) -> None:
    """Refuse a missing recording, and one that is or contains a device, a pipe or a socket, before any other work.

    Raises:
        InputError: the path is one of these.
    """
    if not path.exists():
        raise InputError(f"{path}: no such recording")
    if path.is_dir() and not rosbag.is_bag(path):
        raise InputError(f"{path}: is a folder without metadata.yaml, so no ROS 2 bag; name a recording in it")
    for each in (path, *(path.iterdir() if path.is_dir() else ())):
        check_regular(each)


def _table_blocks(recording: Recording, model: ProbeModel) -> Iterator[Block]:
    """Yield the samples of a table; a block has one gravity vector and one fault or none."""
    n, gravity = len(recording.time), recording.gravity_base
    faults = np.array(recording.faults or ("",) * n)
    turns = faults[1:] != faults[:-1]
    if gravity is not None:
        turns |= (gravity[1:] != gravity[:-1]).any(axis=1)
    cuts = np.unique([*range(0, n, BLOCK_SIZE), *np.flatnonzero(turns) + 1, n]).tolist()
    for start, end in pairwise(cuts):
        here = model.gravity_base if gravity is None else gravity[start]
        wrench = recording.wrench[start:end]
        if recording.frame == "base":  # one by one: the product of many rows rounds differently
            wrench = np.array([model.to_sensor(row, here) for row in wrench])
        yield Block(recording.time[start:end], wrench, here, np.full(end - start, np.nan), str(faults[start]))


def _open_native(bag: Bag, model: ProbeModel, options: RecordingOptions) -> OpenRecording:
    probe = min(  # two prints of one design differ in name only
        bag.probes, key=lambda p: (p.get("fingerprint") != model.fingerprint, p.get("name") != model.name), default={}
    )
    name, fingerprint = str(probe.get("name"))[:80], str(probe.get("fingerprint"))[:80]
    of = name if len(bag.probes) > 1 else ""
    raw, states = (replace(topic, probe=of).path for topic in (RAW, BLOCK))
    notes: tuple[str, ...] = (
        (f"readings of {quoted(of)}, one of {len(bag.probes)} probes of the recording",) if of else ()
    )
    if fingerprint != model.fingerprint:
        notes = (f"recorded with probe {quoted(name)}, fingerprint {quoted(fingerprint)}, not {model.fingerprint}",)
        if not options.other_probe:
            raise InputError(f"{bag.path}: {notes[0]}; use its own frozen probe, or allow it with other_probe")
    elif probe.get("checksum") != freeze(model)["checksum"]:
        notes += ("recorded with another frozen version of this probe (material, sensor): estimates may differ",)
    dropped = [0]

    def missing() -> tuple[str, ...]:
        why = "lie in damaged parts" if bag.damage else "were dropped by the recorder: the disk was too slow"
        lost = (f"{dropped[0]} readings {why}",) if dropped[0] else ()
        return (*lost, f"incomplete: {bag.damage}") if bag.damage else lost

    metadata = bag.metadata[METADATA_NAME]
    source = one_line(metadata.get("source", ""))
    description = f"recorded {one_line(metadata.get('started', ''))} from {source}"
    return OpenRecording(bag.path, description, "sensor", notes,
                         lambda: _checked(bag.path, _native_blocks(bag, raw, states, dropped)),
                         missing, source)  # fmt: skip


def _open_foreign(bag: Bag, model: ProbeModel, options: RecordingOptions) -> OpenRecording:
    channel = rosbag.select_channel(bag, {schemas.WRENCH}, options.topic)
    topic = f"topic {one_line(channel.topic)}"
    first = [_read_wrench(bag, message) for message in islice(bag.messages({channel.topic}), BLOCK_SIZE)]
    if not first:
        raise InputError(f"{bag.path}: {topic} has no messages" + (bag.damage and f"; {bag.damage}"))
    stamp, frame_id, _ = first[0]
    frame: Frame = options.frame or ("base" if frame_id in ("base", f"{ros_name(model.name)}/base") else "sensor")
    notes = [f"{topic}, frame {quoted(frame_id)}, interpreted as the {frame} frame"]
    if stamp == 0:
        notes.append("its headers have no time stamp: the time of recording is used")
    typical = np.median(np.abs([values[3:] for _, _, values in first]), axis=0)
    limit = model.wrench_range[3:]
    if options.moment_unit == "Nm" and (typical > limit).any() and (typical * MM <= limit).all():
        notes.append(
            f"moments of {typical.max():.3g} N·m are beyond the sensor's {limit.max():.3g} N·m; "
            "if they are in N·mm, use moment_unit=Nmm"
        )
    factors = np.repeat([1.0, MM if options.moment_unit == "Nmm" else 1.0], 3)

    def blocks() -> Iterator[Block]:
        messages = bag.messages({channel.topic})
        while batch := list(islice(messages, BLOCK_SIZE)):
            read = [_read_wrench(bag, message) for message in batch]
            stamps = [at if stamp else message.logged
                      for message, (at, _, _) in zip(batch, read, strict=True)]  # fmt: skip
            wrench = np.array([values for _, _, values in read]) * factors
            if frame == "base":
                wrench = model.to_sensor(wrench, model.gravity_base)
            yield Block(np.array(stamps, dtype=float) / 1e9, wrench, model.gravity_base, np.full(len(read), np.nan))

    return OpenRecording(bag.path, topic, frame, tuple(notes),
                         lambda: _checked(bag.path, blocks()),
                         lambda: (f"incomplete: {bag.damage}",) if bag.damage else ())  # fmt: skip


def _read_wrench(bag: Bag, message: Message) -> tuple[int, str, list[float]]:
    """Return time stamp [ns], frame and wrench of a message."""
    try:
        decoded = decode(message.data, schemas.WRENCH)
    except ValueError as error:
        at = f"{message.logged / 1e9:.9g} s"
        raise InputError(f"{bag.path}: a message of {quoted(message.topic)} logged at {at}: {error}") from None
    wrench = [getattr(vector, axis) for vector in (decoded.wrench.force, decoded.wrench.torque) for axis in "xyz"]
    return rosbag.header_stamp(decoded.header), decoded.header.frame_id, wrench


def _checked(path: Path, blocks: Iterable[Block]) -> Iterator[Block]:
    """Yield the blocks; refuse values beyond the range of any sensor and decreasing time."""
    last, ceiling = -np.inf, np.repeat([CEILING["force"], CEILING["moment"]], 3)
    for block in blocks:
        times: Array = np.concatenate([[last], block.time])
        for i in np.flatnonzero(np.diff(times) < 0)[:1]:
            raise InputError(f"{path}: time decreases, from {times[i]:.9g} s to {times[i + 1]:.9g} s")
        beyond = ~(np.abs(block.wrench_sensor) <= ceiling)
        for i, j in np.argwhere(beyond)[:1] if not block.fault else ():
            value = f"{WRENCH[j].capitalize()} = {block.wrench_sensor[i, j]:g} {'N' if j < 3 else 'N·m'}"
            at = f"at {block.time[i]:.9g} s"
            raise InputError(f"{path}: {value} {at} exceeds the range of any sensor; raw counts or a wrong unit?")
        last = float(times[-1])
        yield block


MAX_READINGS = 1 << 40  #: More readings than any recording has: five years of the fastest source.
MAX_BLOCK = 1_000_000  #: Maximum number of readings in a block: 2 minutes of the fastest source.


def _native_blocks(bag: Bag, raw_topic: str, block_topic: str, dropped: list[int]) -> Iterator[Block]:
    """Yield the blocks of our own recording; the number of readings that the recorder dropped is put into `dropped`."""
    raw, n_read, n_gaps, dropped[:] = list[Message](), 0, 0, [0]
    for message in bag.messages({raw_topic, block_topic}):
        if message.topic == raw_topic:
            raw.append(message)
            if len(raw) > MAX_BLOCK:
                raise InputError(f"{bag.path}: {len(raw)} readings without a {block_topic}")
            continue
        try:
            first, block = _native_block(
                raw, rosbag.clock_offset(bag, raw_topic), decode(message.data, BLOCK.type).data
            )
        except (ValueError, KeyError, TypeError, RecursionError, OverflowError) as error:
            if bag.damage:  # the rest of this block lies in the damaged part
                raw = []
                continue
            raise InputError(f"{bag.path}: a {block_topic} after {n_read} readings: {error}") from None
        if not n_read + dropped[0] <= first < MAX_READINGS:
            raise InputError(f"{bag.path}: a {block_topic} counts {quoted(first)} readings before it")
        if first != n_read + dropped[0]:  # averages must not span dropped readings
            dropped[0], n_gaps = first - n_read, n_gaps + 1
        n_read, raw = n_read + len(block), []
        # A new stretch after dropped readings; 2³² keeps it clear of the source's stretches.
        yield replace(block, stretch=block.stretch + (n_gaps << 32)) if n_gaps else block


def _native_block(raw: list[Message], clock_offset: int, text: str) -> tuple[int, Block]:
    """Return the number of readings before the block, and the block, whose times are those of its messages."""
    content = json.loads(text)
    gravity = np.array(content["gravity_base_m_s2"], dtype=float)
    if not np.isfinite(gravity).all():
        raise ValueError("its numbers are not finite")
    first, stretch, fault = content["first"], content["stretch"], content["fault"]
    if type(first) is not int or type(stretch) is not int or type(fault) is not str or gravity.shape != (3,):
        raise ValueError("it does not match its schema")
    if content["readings"] != len(raw):
        raise ValueError(f"it describes {content['readings']!r:.20} readings, but {len(raw)} wrenches precede it")
    time = np.array([(message.logged - clock_offset) / 1e9 for message in raw])
    wrench = read_wrenches([message.data for message in raw]).copy()
    return first, Block(time, wrench, gravity, np.full(len(time), np.nan), one_line(fault, 200), stretch)


PARAMETERS = {"speed": SPEED, "other_probe": SourceParameter(0, 0, 1, integer=True)}
#: Text parameters with their values; empty if any value is allowed.
TEXT_PARAMETERS: dict[str, tuple[str, ...]] = {
    "topic": (), "frame": get_args(Frame), "moment_unit": get_args(MomentUnit),
}  # fmt: skip


class ReplaySource:
    """Plays a recording at its own speed or another; see `Source`.

    Attributes:
        recorded_from: source that was recorded, as stated in the recording; may be empty.
    """

    def __init__(self, model: ProbeModel, path: str | Path, query: str = "", log: Log = lambda line: None) -> None:
        """Open the file.

        Args:
            model: recorded probe.
            path: path of the recording.
            query: the parameters of `PARAMETERS` and `TEXT_PARAMETERS`.
            log: callback that reports missing data at the end.

        Raises:
            InputError: a parameter is invalid, the file is not a recording, or it is of another probe.
            MissingDependencyError: the package that reads it is not installed.
        """
        if not str(path):
            raise InputError("replay: a file is required; write replay:FILE")
        path = Path(path)
        numbers, texts = parse_parameters("replay:", query, PARAMETERS, TEXT_PARAMETERS)
        given = {name: text for name, text in texts.items() if text}
        self._speed, self._log = numbers["speed"], log
        options = RecordingOptions(other_probe=numbers["other_probe"] == 1, **given)  # type: ignore[arg-type]  # checked
        self._recording = open_recording(path, model, options)
        self.title = f"replay of {path}, {self._recording.description}"
        self.notes, self.recorded_from = self._recording.notes, self._recording.source

    def __iter__(self) -> Generator[Block, None, None]:
        return played(self._readings(), self._speed)

    def _readings(self) -> Iterator[WrenchReading]:
        for block in self._recording.blocks():
            yield from block.readings()
        for line in self._recording.missing():
            if line not in self.notes:
                self._log(f"{self._recording.path}: {line}")
