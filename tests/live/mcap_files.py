"""Recordings for tests: blocks of readings, files of them, and bags of other writers."""

from contextlib import closing
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader

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


def bag(path: Path, topics: dict[str, list[tuple[float, list[float]]]], frame: str = "ft", **how) -> Path:
    """A bag as rosbags writes one: by topic, times [s] and wrenches."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    kind = "geometry_msgs/msg/WrenchStamped"
    mode = how.pop("compression", None)
    with_storage = how.pop("storage", "sqlite3")
    plugin = StoragePlugin.MCAP if with_storage == "mcap" else StoragePlugin.SQLITE3
    writer = Writer(path, version=9, storage_plugin=plugin)
    if mode:
        writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    stamped = how.pop("stamped", True)
    with writer:
        for topic, rows in topics.items():
            connection = writer.add_connection(topic, how.get("kind", kind), typestore=store)
            for time, wrench in rows:
                second, rest = divmod(round(time * 1e9), 1_000_000_000) if stamped else (0, 0)
                stamp = types["builtin_interfaces/msg/Time"](second, rest)
                vectors = [types["geometry_msgs/msg/Vector3"](*wrench[i : i + 3]) for i in (0, 3)]
                message = types[kind](
                    types["std_msgs/msg/Header"](stamp, frame), types["geometry_msgs/msg/Wrench"](*vectors)
                )
                writer.write(connection, round(time * 1e9), store.serialize_cdr(message, kind))
    return path
