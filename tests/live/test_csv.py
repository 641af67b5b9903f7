"""Recordings as CSV are read back to the last bit, and errors are refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from probedesign.core.errors import InputError
from probedesign.live.recordings.csv import CSV_HEADER, Recording, read_recording, write_recording

ROW = "0.5,-0.25,0.125,0.001,0.002,-0.003"
EXACT = 1e-15  #: Relative: one conversion of units.


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tmp_path_factory.mktemp("recordings") / "r.csv"


def read(path, text: str | bytes) -> Recording:
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_recording(path)


def problem(path, text: str | bytes) -> str:
    with pytest.raises(InputError) as error:
        read(path, text)
    message = str(error.value)
    assert message.isprintable() and str(path) in message
    return message


def rows(*times: float) -> str:
    return "".join(f"{t},{ROW}\n" for t in times)


# What is right


def test_an_ordinary_recording(path):
    recording = read(path, f"{CSV_HEADER}\n{rows(0.0, 0.01, 0.02)}")
    assert recording.time.tolist() == [0.0, 0.01, 0.02]
    assert recording.wrench.tolist() == [[0.5, -0.25, 0.125, 0.001, 0.002, -0.003]] * 3
    assert (recording.frame, recording.gravity_base, recording.notes) == ("sensor", None, ())
    assert recording.damage == ()
    assert read(path, f"{CSV_HEADER}\n{rows(3.0)}").wrench.shape == (1, 6)


@pytest.mark.parametrize(
    ("header", "factors"),
    [
        ("t_ms,FX_mN,fy_mn,Fz_N,Tx_Nmm,Ty_mNm,TZ_NM", [1e-3, 1e-3, 1e-3, 1.0, 1e-3, 1e-3, 1.0]),
        ("Timestamp_us,Fx_N,Fy_N,Fz_N,Mx_Nm,My_Nm,Mz_Nm", [1e-6, 1, 1, 1, 1, 1, 1]),
        ("Time (s),Fx [N],Fy(N),Fz_n,Tx (N·mm),Ty [N-mm],Tz (N m)", [1, 1, 1, 1, 1e-3, 1e-3, 1.0]),
        ("t [µs],Fx_N,Fy_N,Fz_N,Mx_Nm,My_Nm,Mz_Nm", [1e-6, 1, 1, 1, 1, 1, 1]),
        ('"time_ns", Fx_N ,Fy_N,Fz_N,Mx_Nm,My_Nm,Mz_Nm', [1e-9, 1, 1, 1, 1, 1, 1]),
    ],
)
def test_units_and_aliases(path, header, factors):
    recording = read(path, f"{header}\n1,2,3,4,5,6,7\n")
    problem_text = np.concatenate([recording.time, recording.wrench[0]])
    assert problem_text == pytest.approx(np.arange(1, 8) * factors, rel=EXACT)


def test_columns_in_any_order_beside_others(path):
    recording = read(path, "status,Mz_Nm,My_Nm,Mx_Nm,Fz_N,Fy_N,Fx_N,time_s\n0x0,6,5,4,3,2,1,0\n0xF,6,5,4,3,2,1,1\n")
    assert recording.wrench.tolist() == [[1, 2, 3, 4, 5, 6]] * 2
    assert any("'status'" in note for note in recording.notes)


def test_comments_blank_lines_and_line_ends(path):
    text = f"\ufeff# made by hand\r\n# Frame: BASE\r\n\r\n{CSV_HEADER}\r\n{rows(0.0)}\r\n# pause\r\n{rows(1.0)}"
    recording = read(path, text)
    assert (recording.frame, len(recording.time)) == ("base", 2)


def test_gravity_columns_are_read(path):
    recording = read(path, f"{CSV_HEADER},gx_m_s2,gy_m_s2,gz_m_s2\n0,{ROW},9.81,0,-1\n")
    assert recording.gravity_base.tolist() == [[9.81, 0.0, -1.0]]


def test_seconds_since_1970_keep_their_microseconds(path):
    """Doubles near 1.7e9 are 2.4e-7 s apart."""
    recording = read(path, f"{CSV_HEADER}\n{rows(1700000000.000001, 1700000000.000101)}")
    assert np.diff(recording.time)[0] == pytest.approx(1e-4, abs=2.4e-7)


# Repairs and their notes


@pytest.mark.parametrize("half", ["0.0", "0.02,0.5,-0.2", "0.02,0.5,-0.25,0.125,0.001,0.002,-", "x"])
def test_half_a_line_at_the_end_is_dropped(path, half):
    recording = read(path, f"{CSV_HEADER}\n{rows(0.0, 0.01)}{half}")
    assert len(recording.time) == 2
    assert recording.damage == ("line 4 is incomplete at the end: dropped",)


def test_a_last_line_without_newline_is_accepted(path):
    recording = read(path, f"{CSV_HEADER}\n{rows(0.0, 0.01)}".rstrip("\n"))
    assert (len(recording.time), recording.damage) == (2, ())
    assert "line 3 does not end in a newline" in recording.notes[0]


def test_gaps_are_counted(path):
    """At 100 Hz: one sample missing after 0.02 s, three after 0.05 s; 14 ms of jitter is no gap."""
    recording = read(path, f"{CSV_HEADER}\n{rows(0.0, 0.01, 0.02, 0.04, 0.05, 0.09, 0.1, 0.114, 0.12)}")
    assert recording.damage == ("4 samples are missing in 2 gaps",)


def test_a_coarse_clock_has_no_gaps(path):
    """Several samples to a millisecond tick: most steps are zero, and the rate is undefined."""
    recording = read(path, f"{CSV_HEADER}\n{rows(0.0, 0.0, 0.0, 0.0, 0.001, 0.001, 0.001)}")
    assert recording.damage == ()


# What is wrong


@pytest.mark.parametrize(
    ("text", "problem_text"),
    [
        ("", "is empty"),
        ("# frame: base\n\n", "is empty"),
        (f"{CSV_HEADER}\n", "no samples"),
        (f"{CSV_HEADER}\n0.0,1", "no samples"),
        (CSV_HEADER, "no samples"),
        (rows(0.0), ":1: numbers without a header"),
        ("time_s,Fx_N,Fy_N,Fz_N\n0,1,2,3\n", ":1: columns are missing: Mx_Nm, My_Nm, Mz_Nm"),
        ("a,b\n1,2\n", "columns are missing: time_s, Fx_N"),
        (f"{CSV_HEADER},Tx_Nmm\n0,{ROW},1\n", "columns 'Mx_Nm' and 'Tx_Nmm' are the same"),
        (f"{CSV_HEADER},gx_m_s2\n0,{ROW},1\n", "columns are missing: gy_m_s2, gz_m_s2"),
        (CSV_HEADER.replace("Fx_N", "Fx") + f"\n{rows(0.0)}", "names no unit; end its name in one of _N, _mN"),
        (CSV_HEADER.replace("Fx_N", "Fx (lbf)") + f"\n{rows(0.0)}", "column 'Fx (lbf)': unit 'lbf' is not known"),
        (CSV_HEADER.replace("time_s", "time") + f"\n{rows(0.0)}", "column 'time': names no unit"),
        (CSV_HEADER.replace("Fx_N", "Fx_lbf") + f"\n{rows(0.0)}", "unit 'lbf' is not known"),
        (CSV_HEADER.replace("Mx_Nm", "Mx_N") + f"\n{rows(0.0)}", "unit 'N' is not known; end its name in"),
        (f"# frame: world\n{CSV_HEADER}\n{rows(0.0)}", ":1: frame 'world' is not known"),
        (f"# frame: base\n# frame: sensor\n{CSV_HEADER}\n{rows(0.0)}", "names two frames"),
        (f"{CSV_HEADER}\n{rows(0.0)}0.01,1,2,x,4,5,6\n", ":3: Fz_N = 'x' is not a finite number"),
        (f"{CSV_HEADER}\n{rows(0.0)}0.01,1,nan,3,4,5,6\n", ":3: Fy_N = 'nan'"),
        (f"{CSV_HEADER}\n{rows(0.0)}0.01,1,2,3,4,5,nan", ":3: Mz_Nm = 'nan'"),
        (f"{CSV_HEADER}\n{rows(0.0)}inf,1,2,3,4,5,6\n", ":3: time_s = 'inf'"),
        (f"{CSV_HEADER}\n{rows(0.0)}0.01,1e999,2,3,4,5,6\n", ":3: Fx_N = '1e999'"),
        (f"{CSV_HEADER}\n{rows(0.0)}0.01,,2,3,4,5,6\n", ":3: Fx_N is empty"),
        (f"{CSV_HEADER}\n{rows(0.0)}0.01,1_0,2,3,4,5,6\n", ":3: Fx_N = '1_0'"),
        (f"{CSV_HEADER}\n{rows(0.0)}0.01,1,2\n{rows(0.02)}", ":3: the row has 3 values where the header names 7"),
        (f"{CSV_HEADER}\n{rows(0.0)}0.01,{ROW},9\n{rows(0.02)}", ":3: the row has 8 values where the header names 7"),
        (f"{CSV_HEADER}\n0;1;2;3;4;5;6\n", ":2: the row has 1 values"),
        (f"{CSV_HEADER}\n{rows(0.0)}{CSV_HEADER}\n{rows(0.0)}", ":3: time_s = 'time_s'"),
        (f"{CSV_HEADER}\n# a\n{rows(0.0, 0.02, 0.01)}", ":5: time decreases, from 0.02 s to 0.01 s"),
        (f"{CSV_HEADER}\n{rows(0.0)}0.01,1,2,-1000001,4,5,6\n", ":3: Fz_N = -1e+06 is implausibly large"),
        (f"{CSV_HEADER}\n0.01,1,2,3,51,5,6\n", "Mx_Nm = 51 is implausibly large"),
        (f"{CSV_HEADER}\n{rows(1700000000000.0)}", "time_s = 1.7e+12 is implausibly large"),
    ],
)
def test_what_is_no_recording(path, text, problem_text):
    assert problem_text in problem(path, text)


def test_invalid_messages_are_reported(path):
    assert "UTF-8" in problem(path, b"\x89PNG\r\n\x1a\n\xff\xfe")
    assert "binary" in problem(path, b"time_s\0Fx_N")
    with pytest.raises(InputError, match="no such recording"):
        read_recording(path.with_name("none.csv"))
    with pytest.raises(InputError, match="cannot be read"):
        read_recording(path.parent)


@given(st.binary(max_size=200))
def test_any_bytes(path, junk):
    assert_recording_or_one_line(path, junk)


@given(st.data())
def test_any_mutation_of_a_recording(path, data):
    text = f"# frame: base\n{CSV_HEADER}\n{rows(0.0, 0.01, 0.02)}".encode()
    tokens = st.sampled_from([b",", b"\n", b"\r", b"nan", b"1e400", b"-", b"#", b'"', b" ", b"_", b"\x0b", b"\xc2\x85"])
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.integers(0, len(text)))
        end = start + data.draw(st.integers(0, 12))
        text = text[:start] + data.draw(tokens | st.binary(max_size=4)) + text[end:]
    assert_recording_or_one_line(path, text)


def assert_recording_or_one_line(path, content: bytes) -> None:
    try:
        recording = read(path, content)
    except InputError as error:
        assert str(error).isprintable()
        return
    assert recording.wrench.shape == (len(recording.time), 6)
    assert np.isfinite(recording.wrench).all() and (np.diff(recording.time) >= 0).all()


# Writing

numbers = st.floats(-50.0, 50.0)


@given(
    times=st.lists(st.floats(-1e10, 1e10), min_size=1, max_size=6).map(sorted),
    samples=st.lists(st.lists(numbers, min_size=6, max_size=6), min_size=6, max_size=6),
    frame=st.sampled_from(["sensor", "base"]),
    gravity=st.none() | st.lists(st.floats(-9.81, 9.81), min_size=3, max_size=3),
)
def test_what_is_written_reads_back_to_the_last_bit(path, times, samples, frame, gravity):
    wrench = np.array(samples)[: len(times)]
    gravities = None if gravity is None else np.tile(gravity, (len(times), 1))
    write_recording(path, times, wrench, frame, gravities)
    recording = read_recording(path)
    assert recording.time.tolist() == times
    assert np.array_equal(recording.wrench, wrench)
    assert recording.frame == frame
    assert gravities is None if recording.gravity_base is None else np.array_equal(recording.gravity_base, gravities)
    assert not any("incomplete" in line for line in recording.damage)


def test_what_cannot_be_written_is_refused(path):
    with pytest.raises(InputError, match="cannot be written"):
        write_recording(path.parent, [0.0], [[0.0] * 6])
    with pytest.raises(ValueError):
        write_recording(path, [0.0, 1.0], [[0.0] * 6])
