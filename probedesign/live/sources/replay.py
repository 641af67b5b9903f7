"""A recording of any kind as blocks of readings: our MCAP, anybody's ROS 2 bag, CSV."""

import json
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, get_args
from urllib.parse import parse_qsl, urlencode

import numpy as np

from probedesign.errors import InputError
from probedesign.estimation.model import ProbeModel
from probedesign.frames import Array
from probedesign.live.processing.blocks import Block, Reading, blocks_of, paced
from probedesign.live.recordings.csv import Recording, read_recording
from probedesign.live.recordings.schemas import BLOCK, OURS, RAW, read_text, read_wrenches
from probedesign.live.sources.netft.ati_demo import is_ati_demo, read_ati_demo
from probedesign.live.sources.parameters import MOST, SPEED, TICK, Parameter, parse_parameters
from probedesign.live.sources.rosbag import Attached, Bag, Published, find_wrenches, is_bag, open_bag
from probedesign.tables.columns import CEILING
from probedesign.tables.text_table import Frame, plain, shown
from probedesign.units import MM

MomentUnit = Literal["Nm", "Nmm"]
BLOCK_SIZE = 256
"""Readings to a block, where the recording names none."""
CHANNELS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
LIMITS = np.repeat([CEILING["force"], CEILING["moment"]], 3)


@dataclass(frozen=True)
class Choice:
    """What of a bag is read, and how.

    Attributes:
        topic: of its wrenches; may be empty if there is only one, or the recording is ours.
        frame: of a topic that is not ours.
        moment_unit: that the publisher used, whatever the standard says.
        other_probe: read our recordings that were made with another probe, too.
    """

    topic: str = ""
    frame: Frame | None = None
    moment_unit: MomentUnit = "Nm"
    other_probe: bool = False


@dataclass(frozen=True)
class Recorded:
    """A recording, open for reading.

    Attributes:
        path: of it.
        what: it is, in a few words.
        frame: that its wrenches are told in.
        notes: what a user should know before it is read.
        blocks: its readings, in the sensor frame.
        lacking: what is missing in it, as far as it was read.
        source: that it was read from, by its own words; empty where it does not say.
    """

    path: Path
    what: str
    frame: Frame
    notes: tuple[str, ...]
    blocks: Callable[[], Iterator[Block]]
    lacking: Callable[[], tuple[str, ...]] = field(default=lambda: ())
    source: str = ""


def open_recording(path: Path, model: ProbeModel, choice: Choice | None = None) -> Recorded:
    """The recording at a path.

    Args:
        path: CSV, MCAP, `.db3`, or the folder of a bag.
        model: the probe it was recorded with; its gravity counts where the recording holds none.
        choice: of what is read in a bag.

    Raises:
        InputError: it is no recording, or not of this probe.
        MissingDependencyError: what reads it is not installed.
    """
    choice = choice or Choice()
    if not is_bag(path):
        return _open_table(path, model, choice)
    bag = open_bag(path)
    if isinstance(bag, Attached) and OURS in bag.metadata and not choice.topic:
        return _open_native(bag, model, choice)
    return _open_foreign(bag, model, choice)


def _open_table(path: Path, model: ProbeModel, choice: Choice) -> Recorded:
    if choice.topic:
        raise InputError(f"{path}: has no topic {choice.topic!r}: it is no ROS 2 bag")
    recording = read_ati_demo(path) if is_ati_demo(path) else read_recording(path)
    hurt = recording.notes if recording.gaps or recording.dropped_lines else ()
    return Recorded(path, f"{len(recording.time)} readings", recording.frame, recording.notes,
                    lambda: _table_blocks(recording, model), lambda: hurt)  # fmt: skip


def _table_blocks(recording: Recording, model: ProbeModel) -> Iterator[Block]:
    """The samples of a table; a block has one gravity."""
    n = len(recording.time)
    gravity = recording.gravity_base
    told = np.zeros((n, 3)) if gravity is None else gravity
    turns = np.flatnonzero((np.diff(told, axis=0) != 0).any(axis=1)) + 1
    cuts = np.unique(np.concatenate([turns, np.arange(0, n, BLOCK_SIZE), [n]])).tolist()
    for start, end in pairwise(cuts):
        here = model.gravity_base if gravity is None else gravity[start]
        wrench = recording.wrench[start:end]
        if recording.frame == "base":  # one by one: a product of many rows rounds otherwise
            wrench = np.array([model.to_sensor(row, here) for row in wrench])
        yield Block(recording.time[start:end], wrench, here, np.full(end - start, np.nan))


def _open_native(bag: Attached, model: ProbeModel, choice: Choice) -> Recorded:

    notes = _check_probe(bag, model, choice)
    blocks = OwnBlocks(bag)

    def lacking() -> tuple[str, ...]:
        told = []
        if blocks.left_out:
            told.append(f"{blocks.left_out} readings were left out by the recorder, whose disk was too slow")
        if bag.damage:
            told.append(f"not whole: {bag.damage}")
        return tuple(told)

    about = bag.metadata[OURS]
    source = plain(about.get("source", ""))
    what = f"recorded {plain(about.get('started', ''))} from {source}"
    return Recorded(bag.path, what, "sensor", notes, lambda: _checked(bag.path, blocks), lacking, source)


def _check_probe(bag: Attached, model: ProbeModel, choice: Choice) -> tuple[str, ...]:
    """What is to say of the probe that the recording was made with.

    Raises:
        InputError: it is another, and that was not asked for.
    """
    probe = bag.probe or {}
    name, fingerprint = str(probe.get("name"))[:80], str(probe.get("fingerprint"))[:80]
    if fingerprint != model.fingerprint:
        told = f"recorded with probe {shown(name)}, fingerprint {shown(fingerprint)}, not {model.fingerprint}"
        if not choice.other_probe:
            raise InputError(
                f"{bag.path}: {told}; take its own frozen probe, or read it anyhow with other_probe"
            )
        return (told,)
    from probedesign.deployment import freeze

    if probe.get("checksum") == freeze(model)["checksum"]:
        return ()
    return ("recorded with another freezing of this probe (material, sensor, program): estimates may differ",)


def _open_foreign(bag: Bag, model: ProbeModel, choice: Choice) -> Recorded:
    published = find_wrenches(bag, choice.topic)
    named: Frame = "base" if published.frame_id == "base" else "sensor"
    frame = choice.frame or named
    notes = [
        f"topic {plain(published.channel.topic)}, frame {shown(published.frame_id)}, taken for the {frame}'s"
    ]
    if published.unstamped:
        notes.append("its headers hold no time: the time of recording counts")
    notes += _check_unit(published, model, choice)
    factors = np.array([1.0] * 3 + [MM if choice.moment_unit == "Nmm" else 1.0] * 3)
    unread = np.full(BLOCK_SIZE, np.nan)

    def blocks() -> Iterator[Block]:
        for time, published_wrench in published.wrenches():
            wrench = published_wrench * factors
            if frame == "base":
                wrench = model.to_sensor(wrench, model.gravity_base)
            yield Block(time, wrench, model.gravity_base, unread[: len(time)])

    return Recorded(bag.path, f"topic {plain(published.channel.topic)}", frame, tuple(notes),
                    lambda: _checked(bag.path, blocks()),
                    lambda: (f"not whole: {bag.damage}",) if bag.damage else ())  # fmt: skip


def _check_unit(published: Published, model: ProbeModel, choice: Choice) -> list[str]:
    """A warning where moments look like N·mm: beyond the sensor's range as N·m, within it as N·mm."""
    _, wrench = next(published.wrenches())
    typical = np.median(np.abs(wrench[:, 3:]), axis=0)
    limit = model.wrench_range[3:]
    if choice.moment_unit == "Nm" and (typical > limit).any() and (typical * MM <= limit).all():
        return [f"moments of {typical.max():.3g} N·m are beyond the sensor's {limit.max():.3g} N·m; if they are N·mm, "
                "as some publish them, say moment_unit=Nmm"]  # fmt: skip
    return []


def _checked(path: Path, blocks: Iterable[Block]) -> Iterator[Block]:
    """The blocks, refused where they hold what no sensor reads or time that runs backward."""
    last = -np.inf
    for block in blocks:
        times: Array = np.concatenate([[last], block.time])
        back = np.flatnonzero(np.diff(times) < 0)
        if len(back):
            i = int(back[0])
            raise InputError(f"{path}: time runs backward, from {times[i]:.9g} s to {times[i + 1]:.9g} s")
        if not block.fault:
            _check_block(path, block)
        last = float(times[-1])
        yield block


def _check_block(path: Path, block: Block) -> None:
    bad = ~(np.abs(block.wrench_sensor) <= LIMITS)
    if bad.any():
        i, j = np.argwhere(bad)[0]
        value = f"{CHANNELS[j]} = {block.wrench_sensor[i, j]:g} {'N' if j < 3 else 'N·m'}"
        raise InputError(
            f"{path}: {value} at {block.time[i]:.9g} s is no reading; raw counts or a wrong unit?"
        )


MAX_BLOCK = 1_000_000
"""No source gives more readings at once: it is two minutes of the fastest."""


class OwnBlocks:
    """What a recorder wrote, again as blocks.

    Attributes:
        left_out: readings that the recorder left out, as far as it was read.
    """

    def __init__(self, bag: Bag) -> None:
        """Blocks of a bag that holds `RAW` and `BLOCK`."""
        self._bag = bag
        self.left_out = 0

    def __iter__(self) -> Iterator[Block]:
        """The blocks in order.

        Raises:
            InputError: the file is none of ours, whatever it says.
        """
        raw: list[bytes | memoryview] = []
        self.left_out = 0
        seen, skips = 0, 0
        for message in self._bag.messages({RAW.name, BLOCK.name}):
            if message.topic == RAW.name:
                raw.append(message.data)
                if len(raw) > MAX_BLOCK:
                    raise InputError(f"{self._bag.path}: {len(raw)} readings without a {BLOCK.name}")
                continue
            try:
                first, block = _native_block(raw, read_text(message.data))
            except (ValueError, KeyError, TypeError, RecursionError, OverflowError) as error:
                raise InputError(f"{self._bag.path}: a {BLOCK.name} after {seen} readings: {error}") from None
            if first != seen + self.left_out:  # nothing is averaged over what was left out
                self.left_out, skips = first - seen, skips + 1
            seen, raw = seen + len(block), []
            yield block if not skips else _new_segment(block, skips)


def _native_block(raw: list[bytes | memoryview], text: str) -> tuple[int, Block]:
    """How many readings came before it, and the block.

    Raises:
        ValueError, KeyError, TypeError: it is not as it should be.
    """
    known = json.loads(text)
    time = _finite_array(known["time_s"])
    gravity = _finite_array(known["gravity_base_m_s2"])
    first, stretch, fault = known["first"], known["stretch"], known["fault"]
    if type(first) is not int or type(stretch) is not int or type(fault) is not str or gravity.shape != (3,):
        raise ValueError("it is not as its schema says")
    if len(time) != len(raw):
        raise ValueError(f"it tells of {len(time)} readings, {len(raw)} wrenches stand before it")
    wrench = read_wrenches(raw)
    return first, Block(time, wrench, gravity, np.full(len(time), np.nan), plain(fault, 200), stretch)


def _finite_array(values: Any) -> Array:
    array = np.array(values, dtype=float)
    if array.ndim != 1 or not np.isfinite(array).all():
        raise ValueError("its numbers are not finite numbers")
    return array


def _new_segment(block: Block, skips: int) -> Block:
    """The block, in a stretch of its own after what was left out; 2³² keeps clear of the source's stretches."""
    return Block(block.time, block.wrench_sensor, block.gravity_base, block.received, block.fault,
                 block.stretch + (skips << 32))  # fmt: skip


PARAMETERS = {"speed": SPEED, "other_probe": Parameter(0, 0, 1, whole=True)}
TEXT_PARAMETERS = {"topic": (), "frame": get_args(Frame), "moment_unit": get_args(MomentUnit)}
"""Parameters that are no numbers, with what there is to choose from; nothing if anything goes."""


class Replay:
    """A recording at its own speed or another.

    Attributes:
        title: one line that says what it is.
        notes: what a user should know of the file.
        recorded_from: what the recording was read from, by its own words; empty where it does not say.
    """

    def __init__(
        self,
        model: ProbeModel,
        path: Path,
        query: str = "",
        say: Callable[[str], None] = lambda line: None,
    ) -> None:
        """Open the file.

        Args:
            model: the probe it was recorded with.
            path: the recording.
            query: parameters, as `PARAMETERS` and `WORDS` have them.
            say: takes what is found to be missing at the end.

        Raises:
            InputError: a parameter is wrong, the file is no recording, or it is another probe's.
            MissingDependencyError: what reads it is not installed.
        """
        if not path.name:
            raise InputError("replay: names no file; write replay:FILE")
        words, rest = _text_parameters(query)
        numbers = parse_parameters("replay:", rest, PARAMETERS)
        self._speed, self._say = numbers["speed"], say
        choice = Choice(other_probe=numbers["other_probe"] == 1, **words)  # type: ignore[arg-type]  # checked
        self._recorded = open_recording(path, model, choice)
        self.title = f"replay of {path}, {self._recorded.what}"
        self.notes, self.recorded_from = self._recorded.notes, self._recorded.source

    def __iter__(self) -> Generator[Block, None, None]:
        return paced(blocks_of(self._readings(), MOST, TICK * self._speed), self._speed)

    def _readings(self) -> Iterator[Reading]:
        for block in self._recorded.blocks():
            yield from block.readings()
        for line in self._recorded.lacking():
            if line not in self.notes:
                self._say(f"{self._recorded.path}: {line}")


def _text_parameters(query: str) -> tuple[dict[str, str], str]:
    """The parameters that are no numbers, and the query without them.

    Raises:
        InputError: one is said twice, or is none of what there is.
    """
    try:
        pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
    except ValueError:
        return {}, query  # told by who parses the rest
    words = [(name, value) for name, value in pairs if name in TEXT_PARAMETERS]
    for i, (name, value) in enumerate(words):
        if name in dict(words[:i]):
            raise InputError(f"replay: {name} is said twice; keep one")
        if TEXT_PARAMETERS[name] and value not in TEXT_PARAMETERS[name]:
            raise InputError(f"replay: {name} = {value!r} must be {' or '.join(TEXT_PARAMETERS[name])}")
    return dict(words), urlencode([pair for pair in pairs if pair[0] not in TEXT_PARAMETERS])
