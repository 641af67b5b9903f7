"""The messages of a recording are those of ROS 2: rosbags is the independent reader."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from probedesign.live.recordings import schemas
from probedesign.live.recordings.schemas import TEXT, WRENCH

STORE = get_typestore(Stores.ROS2_HUMBLE)
finite = st.floats(allow_nan=False)
stamps = st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1)
frames = st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=12)


@given(stamps, frames, st.lists(finite, min_size=6, max_size=6))
def test_a_wrench_is_read_by_others_and_by_us(stamp, frame, values):
    data = schemas.stamped(frame, [stamp], [values]).tobytes()
    theirs = STORE.deserialize_cdr(data, WRENCH)
    assert theirs.header.stamp.sec * 10**9 + theirs.header.stamp.nanosec == stamp
    force, torque = theirs.wrench.force, theirs.wrench.torque
    assert [force.x, force.y, force.z, torque.x, torque.y, torque.z] == values
    assert theirs.header.frame_id == frame
    assert schemas.read_wrenches([data] * 2).tolist() == [values] * 2


@pytest.mark.parametrize("other", ["longer", "big-endian", "cut", "frame"])
def test_what_another_writer_writes_is_no_block_of_wrenches(other):
    data = schemas.stamped("sensor", [1], [[0.0] * 6]).tobytes()
    changed = {"longer": data + b"\0", "big-endian": b"\0\0" + data[2:], "cut": data[:20],
               "frame": data[:12] + b"\xff" * 4 + data[16:]}[other]  # fmt: skip
    for messages in ([changed], [data, changed]):
        with pytest.raises(ValueError, match="not those of one writer"):
            schemas.read_wrenches(messages)


@given(st.lists(st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"])), min_size=1))
def test_texts_are_read_by_others(lines):
    """Of one length, so that they can be laid out together: filled up with spaces, which JSON does not mind."""
    length = max(len(line.encode()) for line in lines)
    for line, data in zip(lines, schemas.texts(lines), strict=True):
        decoded = STORE.deserialize_cdr(data.tobytes(), TEXT).data
        assert decoded == line + (length - len(line.encode())) * " "


def test_a_stamp_that_does_not_fit_is_the_nearest_that_does():
    """ROS counts seconds in 32 bits; the exact time is in the block."""
    stamp = schemas.decode(schemas.stamped("f", [9 * 10**18], [[0.0] * 6]).tobytes(), WRENCH).header.stamp
    assert (stamp.sec, stamp.nanosec) == (2**31 - 1, 10**9 - 1)
    assert schemas.nanoseconds(np.array([np.inf, -np.inf, np.nan])).tolist() == [9 * 10**18, -9 * 10**18, 0]


@given(st.binary(max_size=80))
def test_any_bytes_are_a_message_or_a_value_error(junk):
    for name in (WRENCH, TEXT):
        try:
            schemas.decode(junk, name)
        except ValueError as error:
            assert str(error).isprintable()
