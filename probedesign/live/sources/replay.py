"""Recordings of any kind as blocks of readings, and the source `replay:FILE` that plays them.

Our own MCAP recordings reproduce the readings of the original source, their times to the nanosecond.
Other ROS 2 bags and CSV are read too.
"""

import csv
import json
import re
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import islice, pairwise
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from probedesign.core.csv_tables import Frame
from probedesign.core.csv_tables import read_text as read_table
from probedesign.core.errors import InputError, one_line, quoted
from probedesign.core.files import check_regular
from probedesign.core.frames import Array
from probedesign.core.units import FORCE_UNITS, MM, TORQUE_UNITS, unit_of
from probedesign.estimation.model import ProbeModel
from probedesign.frozen_probe import freeze
from probedesign.live import Log
from probedesign.live.blocks import Block, WrenchReading
from probedesign.live.recordings.csv import Recording, check_wrenches, gaps_in, read_recording
from probedesign.live.recordings.schemas import (
    BLOCK,
    METADATA_NAME,
    RAW,
    WRENCH,
    Message,
    read_text,
    read_wrenches,
    ros_name,
)
from probedesign.live.sources import rosbag
from probedesign.live.sources.netft_rdt import SAMPLES_PER_SECOND, WRAP, fault_of
from probedesign.live.sources.rosbag import BLOCK_SIZE, Bag
from probedesign.live.sources.source import SPEED, SourceParameter, parse_parameters, played

MomentUnit = Literal["Nm", "Nmm"]


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
        recording = read_ati_demo(path) if is_ati_demo(path) else read_recording(path)
        damage = recording.notes if recording.gaps or recording.dropped_lines else ()
        return OpenRecording(path, f"{len(recording.time)} readings", recording.frame, recording.notes,
                        lambda: _table_blocks(recording, model), lambda: damage)  # fmt: skip
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
    n = len(recording.time)
    gravity = recording.gravity_base
    notes = np.zeros((n, 3)) if gravity is None else gravity
    turns = np.flatnonzero((np.diff(notes, axis=0) != 0).any(axis=1)) + 1
    faults = recording.faults or ("",) * n
    turns = np.concatenate([turns, [i for i in range(1, n) if faults[i] != faults[i - 1]]]).astype(int)
    cuts = np.unique(np.concatenate([turns, np.arange(0, n, BLOCK_SIZE), [n]])).tolist()
    for start, end in pairwise(cuts):
        here = model.gravity_base if gravity is None else gravity[start]
        wrench = recording.wrench[start:end]
        if recording.frame == "base":  # one by one: the product of many rows rounds differently
            wrench = np.array([model.to_sensor(row, here) for row in wrench])
        yield Block(recording.time[start:end], wrench, here, np.full(end - start, np.nan), faults[start])


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
    metadata = bag.metadata[METADATA_NAME]
    dropped = [0]

    def missing() -> tuple[str, ...]:
        lines = []
        if dropped[0]:
            why = "lie in damaged parts" if bag.damage else "were dropped by the recorder: the disk was too slow"
            lines.append(f"{dropped[0]} readings {why}")
        if bag.damage:
            lines.append(f"incomplete: {bag.damage}")
        return tuple(lines)

    source = one_line(metadata.get("source", ""))
    description = f"recorded {one_line(metadata.get('started', ''))} from {source}"
    return OpenRecording(
        bag.path,
        description,
        "sensor",
        notes,
        lambda: _checked(bag.path, _native_blocks(bag, raw, states, dropped)),
        missing,
        source,
    )


def _open_foreign(bag: Bag, model: ProbeModel, options: RecordingOptions) -> OpenRecording:
    channel = rosbag.select_channel(bag, {WRENCH}, options.topic)
    topic = f"topic {one_line(channel.topic)}"
    first = list(islice(bag.messages({channel.topic}), BLOCK_SIZE))
    if not first:
        raise InputError(f"{bag.path}: {topic} has no messages" + (bag.damage and f"; {bag.damage}"))
    read = [rosbag.read_wrench_message(bag, message) for message in first]
    stamp, frame_id, _ = read[0]
    frame: Frame = options.frame or ("base" if frame_id in ("base", f"{ros_name(model.name)}/base") else "sensor")
    notes = [f"{topic}, frame {quoted(frame_id)}, interpreted as the {frame} frame"]
    if stamp == 0:
        notes.append("its headers have no time stamp: the time of recording is used")
    typical = np.median(np.abs([values[3:] for _, _, values in read]), axis=0)
    limit = model.wrench_range[3:]
    if options.moment_unit == "Nm" and (typical > limit).any() and (typical * MM <= limit).all():
        notes.append(
            f"moments of {typical.max():.3g} N·m are beyond the sensor's {limit.max():.3g} N·m; "
            "if they are in N·mm, use moment_unit=Nmm"
        )
    factors = np.array([1.0] * 3 + [MM if options.moment_unit == "Nmm" else 1.0] * 3)
    unread = np.full(BLOCK_SIZE, np.nan)

    def blocks() -> Iterator[Block]:
        messages = bag.messages({channel.topic})
        while batch := list(islice(messages, BLOCK_SIZE)):
            read = [rosbag.read_wrench_message(bag, message) for message in batch]
            stamps = [at if stamp else message.logged
                      for message, (at, _, _) in zip(batch, read, strict=True)]  # fmt: skip
            wrench = np.array([values for _, _, values in read]) * factors
            if frame == "base":
                wrench = model.to_sensor(wrench, model.gravity_base)
            yield Block(np.array(stamps, dtype=float) / 1e9, wrench, model.gravity_base, unread[: len(batch)])

    return OpenRecording(bag.path, topic, frame, tuple(notes),
                    lambda: _checked(bag.path, blocks()),
                    lambda: (f"incomplete: {bag.damage}",) if bag.damage else ())  # fmt: skip


def _checked(path: Path, blocks: Iterable[Block]) -> Iterator[Block]:
    """Yield the blocks; refuse values beyond the range of any sensor and decreasing time."""
    last = -np.inf
    for block in blocks:
        times: Array = np.concatenate([[last], block.time])
        back = np.flatnonzero(np.diff(times) < 0)
        if len(back):
            i = int(back[0])
            raise InputError(f"{path}: time decreases, from {times[i]:.9g} s to {times[i + 1]:.9g} s")
        if not block.fault:
            check_wrenches(path, block.time, block.wrench_sensor)
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
            first, block = _native_block(raw, rosbag.clock_offset(bag, raw_topic), read_text(message.data))
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


FIRST_WORDS = "Start Time"
ATI_HEADER = ("status(hex)", "rdtsequence", "f/tsequence", "fx", "fy", "fz", "tx", "ty", "tz", "time")


def is_ati_demo(path: Path) -> bool:
    """Return whether a file begins like a recording of ATI's Java demo, version 1.1.1."""
    try:
        with path.open("rb") as file:
            return file.read(len(FIRST_WORDS) + 4).lstrip(b'\xef\xbb\xbf"').startswith(FIRST_WORDS.encode())
    except (OSError, ValueError):
        return False


def read_ati_demo(path: Path) -> Recording:
    """Read a recording of ATI's demonstration program: seven lines, a header, and rows of quoted fields.

    A row contains counts or units. The time is the sensor's, from the first sample.

    Raises:
        InputError: the file cannot be read or is invalid; the message names the line.
    """
    lines = read_table(path, "recording").splitlines()
    factors, start = _head(path, lines)
    rows = [(number, fields) for number, fields in enumerate(csv.reader(lines[start:]), start + 1) if fields]
    notes = []
    if rows and len(rows[-1][1]) < len(ATI_HEADER):
        notes.append(f"line {rows[-1][0]} is incomplete at the end: dropped")
        rows.pop()
    dropped = len(notes)
    values = np.array([_numbers(path, number, fields) for number, fields in rows]).reshape(-1, 8)
    if not len(values):
        raise InputError(f"{path}: no samples, only a header")
    time = _time(path, values[:, 1], [number for number, _ in rows])
    counts = bool((values[:, 2:] == np.rint(values[:, 2:])).all())  # counts are integers, newtons are not
    wrench = values[:, 2:] * factors[0] / (factors[1] if counts else 1.0)
    good = np.array([not fault_of(int(status)) for status in values[:, 0]])
    if not good.all():
        notes.append(f"{int((~good).sum())} samples with a fault are omitted")
    gaps, missing = gaps_in(time[good])
    if gaps:
        notes.append(f"{missing} samples are missing in {gaps} gaps")
    check_wrenches(path, time[good], wrench[good])
    return Recording(time[good], wrench[good], "sensor", None, gaps, missing, dropped, tuple(notes))


def _head(path: Path, lines: list[str]) -> tuple[tuple[Array, Array], int]:
    """Return units in SI and counts per unit, (6,) each, and the number of lines before the first row."""
    head: dict[str, str] = {}
    for number, line in enumerate(lines[:20], 1):
        if re.sub(r"[\s\"]", "", line).lower().split(",") == list(ATI_HEADER):
            force, torque = (
                unit_of(f"{path}: {what} Units", head.get(f"{what} Units", ""), units)
                for what, units in (("Force", FORCE_UNITS), ("Torque", TORQUE_UNITS))
            )
            counts = [_counts(path, head, f"Counts per Unit {what}") for what in ("Force", "Torque")]
            return (np.repeat([force, torque], 3), np.repeat(counts, 3)), number
        name, _, value = line.strip().strip('"').partition(":")
        head[name.strip()] = value.strip()
    raise InputError(f"{path}: like a recording of ATI's demo, but without its header: Status (hex), ..., Time")


def _counts(path: Path, head: dict[str, str], name: str) -> float:
    try:
        counts = float(head[name])
    except (KeyError, ValueError):
        counts = 0.0
    if not 0.0 < counts < np.inf:
        raise InputError(f"{path}: {name} {quoted(head.get(name, ''))} must be a positive number")
    return counts


def _numbers(path: Path, number: int, fields: list[str]) -> list[float]:
    """Return status, sequence number of the sensor and six channels."""
    try:
        if len(fields) != len(ATI_HEADER):
            raise ValueError
        numbers = [int(fields[0].strip(), 16), int(fields[2]), *map(float, fields[3:9])]
    except ValueError:
        text = quoted(",".join(fields))
        raise InputError(f"{path}:{number}: {text} is not a row of {len(ATI_HEADER)} fields of ATI's demo") from None
    if not np.isfinite(numbers).all() or not 0 <= min(numbers[:2]) <= max(numbers[:2]) < WRAP:
        raise InputError(f"{path}:{number}: {quoted(','.join(fields))} contains a number that no box sends")
    return numbers


def _time(path: Path, sequence: Array, numbers: list[int]) -> Array:
    """Return the time by the sensor's own counter, across its 32-bit overflow [s], (n,)."""
    ticks = np.diff(sequence) % WRAP
    back = np.flatnonzero(ticks > WRAP / 2)
    if len(back):
        number = numbers[int(back[0]) + 1]
        raise InputError(f"{path}:{number}: F/T Sequence decreases; sort the rows or split the recording")
    return np.concatenate([[0.0], np.cumsum(ticks)]) / SAMPLES_PER_SECOND


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
