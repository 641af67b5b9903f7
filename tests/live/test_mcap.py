"""A recording in MCAP: exact, readable by others, and as good as it can be after whatever happens to it."""

import json
import re
import struct
import tomllib
import tracemalloc
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from probedesign.core.errors import InputError, MissingDependencyError
from probedesign.estimation.estimate import Estimate
from probedesign.live.blocks import Block, WrenchReading, dropout_block
from probedesign.live.outputs.recording import RecordingSink
from probedesign.live.poses.base_poses import pose_from_matrix
from probedesign.live.processing.estimates import COLUMNS, EstimateUpdate
from probedesign.live.recordings import schemas
from probedesign.live.recordings.mcap_read import recover
from probedesign.live.recordings.mcap_write import McapRecorder
from probedesign.live.run import estimate_recording
from probedesign.live.sources.replay import RecordingOptions, ReplaySource
from tests.live.mcap_files import GRAVITY, block, messages_of, read, same, write
from tests.live.peers import until

MAGIC = b"\x89MCAP0\r\n"
BLOCKS = [block(0, 3), block(3, 36), block(39, 1, fault="saturated"), block(40, 20, stretch=1)]
few = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module")
def whole(model, tmp_path_factory) -> Path:
    return write(tmp_path_factory.mktemp("mcap") / "whole.mcap", model, BLOCKS)


# What is written is what was read


def test_blocks_come_back_to_the_last_bit_and_silence_too(whole, model, tmp_path):
    recorded, blocks = read(whole, model)
    assert len(blocks) == len(BLOCKS) and all(map(same, blocks, BLOCKS))
    assert (recorded.notes, recorded.missing(), recorded.frame) == ((), (), "sensor")
    written = [block(0, 2), dropout_block(GRAVITY, "stale", 0), block(2, 2)]
    assert all(map(same, read(write(tmp_path / "quiet.mcap", model, written), model)[1], written))


times = st.floats(-4e9, 4e9)


@few
@given(
    start=times,
    later=st.lists(st.floats(0.0, 1.7e9), max_size=3),
    last=st.floats(0.0, 6e9),
    values=st.lists(st.floats(-50.0, 50.0), min_size=30, max_size=30),
    gravity=st.lists(st.floats(-9.81, 9.81), min_size=3, max_size=3),
)
def test_any_readings_come_back_to_the_nanosecond(model, tmp_path, start, later, last, values, gravity):
    """All times that a recording promises, beyond the range of a ROS header, too: up to 1.7e9 s before the end of its
    first block and 6e9 s after it. A double of 10^7 s and more is coarser than a nanosecond."""
    first = np.minimum(np.sort([start, *(start + np.array(later))]), 4e9)
    end = min(first[-1] + last, 4e9)
    path = tmp_path / "any.mcap"
    path.unlink(missing_ok=True)
    wrench, unread = np.array(values).reshape(5, 6), np.full(5, np.nan)
    written = [
        Block(time, wrench[:n], np.array(gravity), unread[:n])
        for time, n in ((first, len(first)), (np.array([end]), 1))
    ]
    (restored,) = read(write(path, model, written, chunk=9), model)[1]
    time = np.append(first, end)
    assert (np.abs(restored.time - time) <= 0.5e-9 + 2.0 * np.spacing(np.abs(time))).all()
    assert restored.wrench_sensor.tobytes() == np.concatenate([each.wrench_sensor for each in written]).tobytes()
    assert restored.gravity_base.tobytes() == np.array(gravity).tobytes()


@pytest.mark.parametrize("time", [-4.1e9, 4.1e9, 1e12, -3e9])
def test_a_time_that_a_recording_cannot_hold_ends_it_with_a_line(model, tmp_path, time):
    """The last one is before 1970 by the wall clock."""
    path, log_lines = tmp_path / "long.mcap", []
    with closing(RecordingSink(path, [model], log_lines.append)) as sink:
        sink.start()
        sink.on_samples(block(0, 5))
        until(lambda: sink.state()[0].endswith("5 readings"))
        sink.on_samples(replace(block(5, 1), time=np.array([time])))
    assert "recording ended: time" in log_lines[0] and "record to NAME.csv" in log_lines[0]
    assert log_lines[1].startswith(f"recorded 5 readings to {path}; it ended early: time {time:.6g} s is outside")
    recorded, blocks = read(path, model)
    assert [same(each, block(0, 5)) for each in blocks] == [True] and not recorded.missing()


# Others read it


def test_the_tools_of_mcap_read_it(whole, model):
    with whole.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        counts = summary.statistics.channel_message_counts
        by_name = {c.topic: (counts.get(i, 0), c, summary.schemas[c.schema_id]) for i, c in summary.channels.items()}
        assert (by_name[schemas.RAW.name][0], by_name[schemas.BLOCK.name][0]) == (60, 4)
        assert reader.get_header().profile == "ros2"
        assert {s.encoding for _, _, s in by_name.values()} == {"ros2msg"}
        (probe,) = reader.iter_attachments()
        known = {record.name: record.metadata for record in reader.iter_metadata()}
    frozen, ours = json.loads(probe.data), known["probedesign"]
    assert frozen["fingerprint"] == ours["fingerprint"] == model.fingerprint
    assert ours["unit_of_moment"] == "N m"
    assert "rosbag2" in known and "serialized_metadata" not in known["rosbag2"]


def test_rosbags_reads_it(model, tmp_path):
    p, cov, pose = np.array([0.001, 0.002, 0.09]), np.diag([1e-6, 2e-6, 3e-6]), np.eye(4)
    pose[:3, :3], pose[:3, 3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]], [0.1, 0.2, 0.3]
    estimate = Estimate("ok", 0.09, 0.001, 2.0 * p, p, np.array([0.01, 0.0, 0.0]), 4.0 * cov, cov)
    file = McapRecorder(tmp_path / "decoded.mcap", model)
    file.on_samples(BLOCKS[0])
    file.on_estimate(
        EstimateUpdate(
            WrenchReading(1.0 / 3.0, np.zeros(6), GRAVITY), estimate, T_world_base=pose, wrench_base=np.arange(6.0)
        )
    )
    file.on_pose(pose_from_matrix(0.25, pose))
    file.on_event(0.5, "mark: here")
    file.close()
    found = messages_of(tmp_path / "decoded.mcap")
    contact, base = found[schemas.CONTACT.name], found[schemas.BASE.name]
    assert (contact.header.frame_id, base.header.frame_id) == ("base", "world")
    assert [contact.pose.pose.position.x, contact.pose.pose.position.z] == [0.001, 0.09]
    assert np.array_equal(contact.pose.covariance.reshape(6, 6)[:3, :3], cov)
    turn = base.pose.orientation  # a quarter about z
    assert [turn.z, turn.w] == pytest.approx([0.5**0.5] * 2, abs=1e-15)
    assert found[schemas.WITHOUT_BIAS.name].wrench.torque.z == 5.0
    content = json.loads(found[schemas.ESTIMATE.name].data)
    assert content["time_s"] == 1.0 / 3.0 and content["result"] == "ok" and content["T_world_base"] == pose.tolist()
    assert set(COLUMNS) <= set(content)
    assert json.loads(found[schemas.EVENT.name].data) == {"time_s": 0.5, "event": "mark: here"}


# Whose it is


def test_another_probe_is_refused_unless_allowed_and_another_version_is_noted(whole, model):
    other = replace(model, fingerprint="0123456789ab")
    with pytest.raises(InputError, match=r"fingerprint .*not 0123456789ab; use its own frozen probe"):
        read(whole, other)
    recorded, blocks = read(whole, other, RecordingOptions(other_probe=True))
    assert len(blocks) == 4 and "not 0123456789ab" in recorded.notes[0]
    assert ReplaySource(other, whole, "other_probe=1").notes == recorded.notes
    assert "another frozen version" in read(whole, replace(model, averaging_samples=7))[0].notes[0]


# Cut off


def test_a_file_that_was_never_closed_is_refused_accepted_with_a_note_or_recovered(estimator, tmp_path):
    model, log_lines = estimator.model, []
    cut = write(tmp_path / "cut.mcap", model, BLOCKS, closed=False)
    recorded, blocks = read(cut, model)
    assert all(map(same, blocks, BLOCKS)) and len(blocks) == 4
    assert recorded.missing() == ("incomplete: it was cut off",)
    with pytest.raises(InputError, match="cut off; use --mend"):
        estimate_recording(estimator, cut)
    estimates = estimate_recording(estimator, cut, allow_incomplete=True)
    assert len(estimates.rows) == 60 and "incomplete: it was cut off" in estimates.notes
    list(ReplaySource(model, cut, "speed=max", log_lines.append))
    assert log_lines == [f"{cut}: incomplete: it was cut off"]
    assert recover(cut, tmp_path / "whole.mcap").messages == 65  # with the static transform
    recorded, blocks = read(tmp_path / "whole.mcap", model)
    assert all(map(same, blocks, BLOCKS)) and recorded.missing() == ()
    with AnyReader([tmp_path / "whole.mcap"]) as reader:
        assert sum(1 for _ in reader.messages()) == 65


@few
@given(st.data())
def test_cut_anywhere_what_is_left_is_a_beginning(whole, model, tmp_path, data):
    content = whole.read_bytes()
    at = data.draw(st.integers(0, len(content) - 1))
    path, out = tmp_path / "cut.mcap", tmp_path / "saved.mcap"
    path.write_bytes(content[:at])
    blocks = intact_or_one_line(path, model)
    assert all(map(same, blocks, BLOCKS))
    if blocks:
        recover(path, out, force=True)
        assert all(map(same, read(out, model)[1], blocks))


@few
@given(st.data())
def test_any_change_gives_intact_blocks_or_one_line(whole, model, tmp_path, data):
    content = bytearray(whole.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(content)))
        content[start : start + data.draw(st.integers(0, 12))] = data.draw(st.binary(max_size=9) | st.just(b"\xff" * 8))
    path = tmp_path / "changed.mcap"
    path.write_bytes(content)
    intact_or_one_line(path, model)
    try:
        recover(path, tmp_path / "saved.mcap", force=True)
    except InputError as error:
        assert str(error).isprintable()


def intact_or_one_line(path: Path, model) -> list[Block]:
    """The blocks read, each one of those written; none if it was refused with one line."""
    try:
        _, blocks = read(path, model, RecordingOptions(other_probe=True))
    except InputError as error:
        assert str(error).isprintable() and str(path) in str(error)
        return []
    written = [(each.time.tobytes(), each.wrench_sensor.tobytes(), each.fault) for each in BLOCKS]
    numbers = [written.index((b.time.tobytes(), b.wrench_sensor.tobytes(), b.fault)) for b in blocks]
    assert numbers == sorted(set(numbers))
    return blocks


def chunk_offsets(path: Path) -> list[int]:
    with path.open("rb") as file:
        return [index.chunk_start_offset for index in make_reader(file).get_summary().chunk_indexes]


@pytest.mark.parametrize("where", ["content", "length", "opcode"])
@pytest.mark.parametrize("bad", [0, 1, 2])
def test_reading_and_recovery_continue_after_a_bad_chunk(whole, model, tmp_path, where, bad):
    """A flipped byte in the compressed data, a record that claims 2 GB, and a record of no kind."""
    content, start = bytearray(whole.read_bytes()), chunk_offsets(whole)[bad]
    if where == "content":
        content[start + 80] ^= 0xFF
    elif where == "length":
        content[start + 1 : start + 9] = (2**31).to_bytes(8, "little")
    else:
        content[start] = 0
    path = tmp_path / "bad.mcap"
    path.write_bytes(content)
    recorded, blocks = read(path, model)
    kept = [each for i, each in enumerate(BLOCKS) if i != bad]
    assert [b.time.tobytes() for b in blocks] == [b.time.tobytes() for b in kept]
    lost, incomplete = recorded.missing()
    assert lost.startswith(f"{len(BLOCKS[bad])} readings lie in damaged parts") and incomplete
    # averages do not span what is missing
    assert all(b.stretch >= 1 << 32 for b in blocks[bad:]) and all(b.stretch < 1 << 32 for b in blocks[:bad])
    recover(path, tmp_path / "saved.mcap")
    recorded, saved = read(tmp_path / "saved.mcap", model)
    assert all(map(same, saved, blocks)) and len(saved) == 3 and len(recorded.missing()) == 1


# Files of nobody's


def record(opcode: int, content: bytes, length: int | None = None) -> bytes:
    return struct.pack("<BQ", opcode, len(content) if length is None else length) + content


def chunk(data: bytes, compression: bytes, size: int, claimed: int | None = None) -> bytes:
    head = struct.pack("<QQQII", 0, 0, size, 0, len(compression)) + compression
    return record(6, head + struct.pack("<Q", len(data) if claimed is None else claimed) + data)


HEADER = record(1, struct.pack("<I4sI", 4, b"ros2", 0))
BOMB = zstandard.compress(bytes(300_000_000))
HOSTILE = {
    "nothing": b"",
    "magic alone": MAGIC,
    "a record of 2^63 bytes": MAGIC + record(1, b"", 2**63),
    "a long record": MAGIC + HEADER + record(5, b"", 200_000_000),
    "a chunk that claims more than it is": MAGIC + HEADER + chunk(b"abc", b"", 3, 2**62),
    "a chunk that claims to unpack to much": MAGIC + HEADER + chunk(b"", b"zstd", 2**60),
    "a bomb": MAGIC + HEADER + chunk(BOMB, b"zstd", 100),
    "zeros": MAGIC + HEADER + chunk(zstandard.compress(bytes(250_000_000)), b"zstd", 250_000_000),
    "zeros in records": MAGIC + HEADER + chunk(bytes(9_000_000), b"", 9_000_000),
    "a bomb in lz4": MAGIC + HEADER + chunk(b"\x04\x22\x4d\x18\x60\x40\x82", b"lz4", 10),
    "another compression": MAGIC + HEADER + chunk(b"", b"xz", 0),
    "a message of no channel": MAGIC + HEADER + record(5, bytes(22)),
    "a schema of 4 GB": MAGIC + HEADER + record(3, struct.pack("<HI", 1, 2**32 - 1)),
}


@pytest.mark.parametrize("what", HOSTILE)
def test_a_hostile_file_is_one_line_and_little_memory(model, tmp_path, what):
    """16 MB: a compression bomb contains 300 MB, and a false length two gigabytes and more."""
    path = tmp_path / "hostile.mcap"
    path.write_bytes(HOSTILE[what])
    tracemalloc.start()
    for attempt in (lambda: read(path, model), lambda: recover(path, tmp_path / "out.mcap")):
        with pytest.raises(InputError) as error:
            attempt()
        assert str(error.value).isprintable() and str(path) in str(error.value)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 16e6 + len(HOSTILE[what])
    assert not list(tmp_path.glob(".out*")) and not (tmp_path / "out.mcap").exists()


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ({"readings": 2}, "describes 2 readings, but 1 wrenches"),
        ({"readings": None}, "block after 0 readings"),
        ({"gravity_base_m_s2": ["nan"] * 3}, "not finite"),
        ({"gravity_base_m_s2": [9.81]}, "does not match its schema"),
        ({"stretch": 1.5}, "does not match its schema"),
        ({"fault": None}, "does not match its schema"),
        ("[" * 100_000, "block after 0 readings"),
        ("{}", "block after 0 readings"),
    ],
)
def test_an_inconsistent_block_is_refused(model, tmp_path, content, problem):
    file = McapRecorder(tmp_path / "lie.mcap", model)
    honest = {"first": 0, "readings": 1, "gravity_base_m_s2": [9.81, 0.0, 0.0], "stretch": 0, "fault": ""}
    text = content if isinstance(content, str) else json.dumps(honest | content)
    now = np.array([0])
    file.add(schemas.RAW, now, schemas.stamped("sensor", now, [[0.0] * 6]))
    file.add(schemas.BLOCK, now, schemas.texts([text]))
    file.close()
    with pytest.raises(InputError, match=problem):
        read(tmp_path / "lie.mcap", model)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"time": np.array([1.0, 0.5])}, "time decreases, from 1 s to 0.5 s"),
        ({"wrench_sensor": np.full((2, 6), np.nan)}, "Fx = nan N at 0 s exceeds the range"),
        ({"wrench_sensor": np.full((2, 6), 900.0)}, "Mx = 900 N·m at 0 s exceeds the range"),
    ],
)
def test_values_out_of_range_are_refused_unless_marked_as_faults(model, tmp_path, change, problem):
    path = write(tmp_path / "odd.mcap", model, [replace(block(0, 2, rate=1.0), **change)])
    with pytest.raises(InputError, match=problem):
        read(path, model)
    if "time" not in change:
        faulty = replace(block(0, 2), fault="saturated", **change)
        assert same(read(write(tmp_path / "faulty.mcap", model, [faulty]), model)[1][0], faulty)


def test_without_the_package_one_line_names_what_to_install(whole, model, tmp_path, monkeypatch):
    monkeypatch.setattr("probedesign.core.errors.find_spec", lambda name: None)
    for attempt in (lambda: read(whole, model), lambda: McapRecorder(tmp_path / "new.mcap", model)):
        with pytest.raises(MissingDependencyError, match=r"pip install 'probedesign\[live\]'"):
            attempt()
    assert not (tmp_path / "new.mcap").exists()


def test_the_live_extra_declares_every_package_of_the_recordings():
    root = Path(__file__).parents[2]
    extras = tomllib.loads((root / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    declared = {re.split(r"[^\w-]", requirement)[0] for requirement in extras["live"]}
    sources = [path.read_text() for path in (root / "probedesign/live/recordings").glob("*.py")]
    imported = {m for text in sources for m in re.findall(r"^\s*(?:import|from) (mcap|zstandard|lz4)\b", text, re.M)}
    assert imported == {"mcap", "zstandard", "lz4"} and imported <= declared
