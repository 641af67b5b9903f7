"""Recordings as CSV are read back to the last bit, errors are refused; and recordings of ATI's demonstration."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from probedesign.core.errors import InputError
from probedesign.live.recordings.csv import CSV_HEADER, Recording, read_recording, write_recording
from tests.live.mcap_files import read as read_blocks

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
    assert (recording.gaps, recording.missing_samples, recording.dropped_lines) == (0, 0, 0)
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
    assert recording.dropped_lines == 1
    assert "line 4 is incomplete at the end: dropped" in recording.notes


def test_a_last_line_without_newline_is_accepted(path):
    recording = read(path, f"{CSV_HEADER}\n{rows(0.0, 0.01)}".rstrip("\n"))
    assert (len(recording.time), recording.dropped_lines) == (2, 0)
    assert "line 3 does not end in a newline" in recording.notes[0]


def test_gaps_are_counted(path):
    """At 100 Hz: one sample missing after 0.02 s, three after 0.05 s; 14 ms of jitter is no gap."""
    recording = read(path, f"{CSV_HEADER}\n{rows(0.0, 0.01, 0.02, 0.04, 0.05, 0.09, 0.1, 0.114, 0.12)}")
    assert (recording.gaps, recording.missing_samples) == (2, 4)
    assert recording.notes == ("4 samples are missing in 2 gaps",)


def test_a_coarse_clock_has_no_gaps(path):
    """Several samples to a millisecond tick: most steps are zero, and the rate is undefined."""
    recording = read(path, f"{CSV_HEADER}\n{rows(0.0, 0.0, 0.0, 0.0, 0.001, 0.001, 0.001)}")
    assert recording.gaps == 0


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
        (f"{CSV_HEADER}\n{rows(0.0)}0.01,,2,3,4,5,6\n", ":3: Fx_N = ''"),
        (f"{CSV_HEADER}\n{rows(0.0)}0.01,1_0,2,3,4,5,6\n", ":3: Fx_N = '1_0'"),
        (f"{CSV_HEADER}\n{rows(0.0)}0.01,1,2\n{rows(0.02)}", ":3: the row has 3 values where the header names 7"),
        (f"{CSV_HEADER}\n{rows(0.0)}0.01,{ROW},9\n{rows(0.02)}", ":3: the row has 8 values where the header names 7"),
        (f"{CSV_HEADER}\n0;1;2;3;4;5;6\n", ":2: the row has 1 values"),
        (f"{CSV_HEADER}\n{rows(0.0)}{CSV_HEADER}\n{rows(0.0)}", ":3: time_s = 'time_s'"),
        (f"{CSV_HEADER}\n# a\n{rows(0.0, 0.02, 0.01)}", ":5: time decreases, from 0.02 s to 0.01 s"),
        (f"{CSV_HEADER}\n{rows(0.0)}0.01,1,2,-1000001,4,5,6\n", ":3: Fz_N = -1e+06 exceeds"),
        (f"{CSV_HEADER}\n0.01,1,2,3,51,5,6\n", "Mx_Nm = 51 exceeds the range of any sensor"),
        (f"{CSV_HEADER}\n{rows(1700000000000.0)}", "time_s = 1.7e+12 exceeds"),
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
    assert recording.dropped_lines == 0


def test_what_cannot_be_written_is_refused(path):
    with pytest.raises(InputError, match="cannot be written"):
        write_recording(path.parent, [0.0], [[0.0] * 6])
    with pytest.raises(ValueError):
        write_recording(path, [0.0, 1.0], [[0.0] * 6])


HEAD = """Start Time: 6/3/10 3:32 PM
RDT Sample Rate: 1000
"PLEASE NOTE: The sample rate is read from the Net F/T when the program starts."
Force Units: N
Counts per Unit Force: 1000000.0
Torque Units: N-mm
Counts per Unit Torque: 1000000.0
Status (hex), RDT Sequence, F/T Sequence, Fx, Fy, Fz, Tx, Ty, Tz, Time
"""
UNITS = ("0.15", "-0.25", "0.5", "1.5", "-2.5", "3.5")
COUNTS = ("150000", "-250000", "500000", "1500000", "-2500000", "3500000")
SI = [0.15, -0.25, 0.5, 1.5e-3, -2.5e-3, 3.5e-3]
ROUNDED = 1e-15  #: Relative: a product and a quotient.


def row(rdt: int, sequence: int, values=UNITS, status: str = "0x0") -> str:
    fields = (status, str(rdt), str(sequence), *values, "Jun 3, 2010 3:32:10 PM")
    return ",".join(f'"{field}"' for field in fields) + "\n"


@pytest.fixture
def read_demo(estimator, tmp_path):
    def read_demo(text: str):
        path = tmp_path / "demo.csv"
        path.write_text(text)
        recorded, blocks = read_blocks(path, estimator.model)
        return recorded, [r for block in blocks for r in block.readings()]

    return read_demo


@pytest.mark.parametrize("values", [UNITS, COUNTS])
def test_units_or_counts_in_si_by_the_sensors_clock(read_demo, values):
    """1000 of the sensor's 7000 samples a second; the count wraps in between."""
    _, readings = read_demo(HEAD + "".join(row(i + 1, (2**32 - 7 + 7 * i) % 2**32, values) for i in range(3)))
    assert [r.time for r in readings] == pytest.approx([0.0, 1e-3, 2e-3], rel=ROUNDED)
    assert all(r.wrench_sensor == pytest.approx(SI, rel=ROUNDED) for r in readings)


def test_faults_are_omitted_and_gaps_reported(read_demo):
    rows = [row(1, 0), row(2, 7), row(3, 14, status="0x80020000"), row(4, 21, status="0x80010000"), row(5, 28)]
    recorded, readings = read_demo(HEAD + "".join(rows))
    assert len(readings) == 4  # a latched monitor condition is healthy
    assert recorded.notes == ("1 samples with a fault are omitted", "1 samples are missing in 1 gaps")


def test_half_a_line_at_the_end_of_a_demo_is_dropped(read_demo):
    recorded, readings = read_demo(HEAD + row(1, 0) + row(2, 7)[:40])
    assert len(readings) == 1 and recorded.missing() == ("line 10 is incomplete at the end: dropped",)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (HEAD, "no samples"),
        (HEAD.replace("N-mm", "furlongs") + row(1, 0), "Torque Units = 'furlongs' is not a known unit"),
        (HEAD.replace("Force: 1000000.0", "Force: 0") + row(1, 0), "Counts per Unit Force '0' must be a positive"),
        (HEAD.replace("Status", "State") + row(1, 0), "without its header"),
        (HEAD + row(1, 7) + row(2, 0), ":10: F/T Sequence decreases"),
        (HEAD + row(1, 0, ("x",) * 6) + row(2, 7), ":9: .* is not a row of 10 fields"),
        (HEAD + row(1, 0, ("nan",) * 6), "no box sends"),
        (HEAD + row(1, 2**40), "no box sends"),
        (HEAD + row(1, 0, ("5000.5",) * 6), "Fx = 5000.5 N at 0 s exceeds the range"),
    ],
)
def test_what_is_wrong_is_one_line(read_demo, text, problem):
    with pytest.raises(InputError, match=problem) as error:
        read_demo(text)
    assert str(error.value).isprintable()
