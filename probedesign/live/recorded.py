"""A recording of any kind as blocks of readings: our MCAP, anybody's ROS 2 bag, CSV."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np

from probedesign.core.csv_tables import CEILING, Frame, plain, shown
from probedesign.errors import InputError
from probedesign.estimation.model import ProbeModel
from probedesign.frames import Array
from probedesign.live.ati_demo import is_ati_demo, read_ati_demo
from probedesign.live.bag import Attached, Bag, is_bag, open_bag
from probedesign.live.bag_wrenches import Published, find_wrenches
from probedesign.live.block import Block
from probedesign.live.mcap.topics import OURS
from probedesign.live.recording import Recording, read_recording
from probedesign.units import MM

MomentUnit = Literal["Nm", "Nmm"]
AT_ONCE = 256
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
        return _table(path, model, choice)
    bag = open_bag(path)
    if isinstance(bag, Attached) and OURS in bag.metadata and not choice.topic:
        return _own(bag, model, choice)
    return _foreign(bag, model, choice)


def _table(path: Path, model: ProbeModel, choice: Choice) -> Recorded:
    if choice.topic:
        raise InputError(f"{path}: has no topic {choice.topic!r}: it is no ROS 2 bag")
    recording = read_ati_demo(path) if is_ati_demo(path) else read_recording(path)
    hurt = recording.notes if recording.gaps or recording.dropped_lines else ()
    return Recorded(path, f"{len(recording.time)} readings", recording.frame, recording.notes,
                    lambda: _rows(recording, model), lambda: hurt)  # fmt: skip


def _rows(recording: Recording, model: ProbeModel) -> Iterator[Block]:
    """The samples of a table; a block has one gravity."""
    n = len(recording.time)
    gravity = recording.gravity_base
    told = np.zeros((n, 3)) if gravity is None else gravity
    turns = np.flatnonzero((np.diff(told, axis=0) != 0).any(axis=1)) + 1
    cuts = np.unique(np.concatenate([turns, np.arange(0, n, AT_ONCE), [n]])).tolist()
    for start, end in pairwise(cuts):
        here = model.gravity_base if gravity is None else gravity[start]
        wrench = recording.wrench[start:end]
        if recording.frame == "base":  # one by one: a product of many rows rounds otherwise
            wrench = np.array([model.to_sensor(row, here) for row in wrench])
        yield Block(recording.time[start:end], wrench, here, np.full(end - start, np.nan))


def _own(bag: Attached, model: ProbeModel, choice: Choice) -> Recorded:
    from probedesign.live.own_blocks import OwnBlocks

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


def _foreign(bag: Bag, model: ProbeModel, choice: Choice) -> Recorded:
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
    unread = np.full(AT_ONCE, np.nan)

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
            _check_values(path, block)
        last = float(times[-1])
        yield block


def _check_values(path: Path, block: Block) -> None:
    bad = ~(np.abs(block.wrench_sensor) <= LIMITS)
    if bad.any():
        i, j = np.argwhere(bad)[0]
        value = f"{CHANNELS[j]} = {block.wrench_sensor[i, j]:g} {'N' if j < 3 else 'N·m'}"
        raise InputError(
            f"{path}: {value} at {block.time[i]:.9g} s is no reading; raw counts or a wrong unit?"
        )
