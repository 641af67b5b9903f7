"""Recordings for tests: blocks of readings, files of them, and bags of other writers."""

from contextlib import closing
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from probedesign.live.blocks import Block
from probedesign.live.recordings.mcap_write import McapRecorder
from probedesign.live.sources.replay import OpenRecording, RecordingOptions, open_recording

GRAVITY = np.array([9.81, 0.0, 0.0])
#: A recording keeps times to the nearest nanosecond; the rest is the rounding of the double of a time below a minute.
TIME_ROUNDING = 0.5e-9 + 2.0 * np.spacing(60.0)


def block(start: int, count: int, *, rate: float = 7000.0, fault: str = "", stretch: int = 0) -> Block:
    """Readings of pure noise, the same for the same arguments, at whole nanoseconds, which a recording keeps."""
    time = np.rint(1e9 * np.arange(start, start + count) / rate) / 1e9
    wrench = np.random.default_rng(start).normal(0.0, 1e-3, (count, 6))
    return Block(time, wrench, GRAVITY, np.full(count, np.nan), fault, stretch)


def messages_of(path: Path) -> dict:
    """The last message of each topic, as rosbags reads it by the definitions in the file."""
    with AnyReader([path]) as reader:
        return {c.topic: reader.deserialize(data, c.msgtype) for c, _, data in reader.messages()}


def write_estimate(path: Path, model, update) -> dict:
    """The messages of a recording of one estimate."""
    with closing(McapRecorder(path, model)) as file:
        file.on_estimate(update)
    return messages_of(path)


def write(path: Path, model, blocks: list[Block], chunk: int = 1, closed: bool = True) -> Path:
    file = McapRecorder(path, model)
    for i, each in enumerate(blocks, 1):
        file.on_samples(each)
        if i % chunk == 0:
            file.flush()
    if closed:
        file.close()
    return path


def read(path: Path, model, choice: RecordingOptions | None = None) -> tuple[OpenRecording, list[Block]]:
    recorded = open_recording(path, model, choice)
    return recorded, list(recorded.blocks())


def same(a: Block, b: Block) -> bool:
    arrays = ((a.time, b.time), (a.wrench_sensor, b.wrench_sensor), (a.gravity_base, b.gravity_base))
    return (a.fault, a.stretch) == (b.fault, b.stretch) and all(x.tobytes() == y.tobytes() for x, y in arrays)


def joined(blocks: list[Block]) -> list[bytes]:
    return [b"".join(getattr(each, name).tobytes() for each in blocks) for name in ("time", "wrench_sensor")]


STORE = get_typestore(Stores.ROS2_HUMBLE)
ROS = {name.rpartition("/")[2]: kind for name, kind in STORE.types.items()}


def header(time: float, frame: str):
    """A header with a time stamp [s], zero without one."""
    return ROS["Header"](ROS["Time"](*divmod(round(time * 1e9), 1_000_000_000)), frame)


def write_bag(path: Path, kinds: dict[str, str], rows: list, storage: str = "sqlite3", compression: str = "") -> Path:
    """A bag as rosbags writes one, of topics by type and rows of topic, time [s] and message."""
    writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
    if compression:
        writer.set_compression(CompressionMode[compression], CompressionFormat.ZSTD)
    with writer:
        topics = {name: writer.add_connection(name, kind, typestore=STORE) for name, kind in kinds.items()}
        for name, time, message in rows:
            writer.write(topics[name], round(time * 1e9), STORE.serialize_cdr(message, kinds[name]))
    return path


def bag(
    path: Path,
    topics: dict[str, list[tuple[float, list[float]]]],
    frame: str = "ft",
    kind: str = "geometry_msgs/msg/WrenchStamped",
    stamped: bool = True,
    **how,
) -> Path:
    """A bag of wrenches: by topic, times [s] and wrenches."""
    rows = [
        (topic, time, ROS["WrenchStamped"](header(time * stamped, frame), ROS["Wrench"](*vectors)))
        for topic, stated in topics.items()
        for time, wrench in stated
        for vectors in [[ROS["Vector3"](*wrench[i : i + 3]) for i in (0, 3)]]
    ]
    return write_bag(path, dict.fromkeys(topics, kind), rows, **how)
