"""What ATI's own program writes, as its source says: quoted fields, the sensor's sequence, units in the head."""

import pytest

from probedesign.core.errors import InputError
from tests.live.mcap_files import read

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
ROUNDED = 1e-15
"""Relative: a product and a quotient."""


def row(rdt: int, sequence: int, values=UNITS, status: str = "0x0") -> str:
    fields = (status, str(rdt), str(sequence), *values, "Jun 3, 2010 3:32:10 PM")
    return ",".join(f'"{field}"' for field in fields) + "\n"


@pytest.fixture
def told(estimator, tmp_path):
    def told(text: str):
        path = tmp_path / "demo.csv"
        path.write_text(text)
        recorded, blocks = read(path, estimator.model)
        return recorded, [r for block in blocks for r in block.readings()]

    return told


@pytest.mark.parametrize("values", [UNITS, COUNTS])
def test_units_or_counts_in_si_by_the_sensors_clock(told, values):
    """1000 of the sensor's 7000 samples a second; the count wraps in between."""
    _, readings = told(HEAD + "".join(row(i + 1, (2**32 - 7 + 7 * i) % 2**32, values) for i in range(3)))
    assert [r.time for r in readings] == pytest.approx([0.0, 1e-3, 2e-3], rel=ROUNDED)
    assert all(r.wrench_sensor == pytest.approx(SI, rel=ROUNDED) for r in readings)


def test_faults_are_omitted_and_gaps_reported(told):
    rows = [
        row(1, 0),
        row(2, 7),
        row(3, 14, status="0x80020000"),
        row(4, 21, status="0x80010000"),
        row(5, 28),
    ]
    recorded, readings = told(HEAD + "".join(rows))
    assert len(readings) == 4  # a latched monitor condition is healthy
    assert recorded.notes == ("1 samples with a fault are omitted", "1 samples are missing in 1 gaps")


def test_half_a_line_at_the_end_is_dropped(told):
    recorded, readings = told(HEAD + row(1, 0) + row(2, 7)[:40])
    assert len(readings) == 1 and recorded.missing() == ("line 10 is incomplete at the end: dropped",)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (HEAD, "no samples"),
        (HEAD.replace("N-mm", "furlongs") + row(1, 0), "Torque Units 'furlongs' is unknown"),
        (
            HEAD.replace("Force: 1000000.0", "Force: 0") + row(1, 0),
            "Counts per Unit Force '0' must be a positive",
        ),
        (HEAD.replace("Status", "State") + row(1, 0), "has no header"),
        (HEAD + row(1, 7) + row(2, 0), ":10: F/T Sequence decreases"),
        (HEAD + row(1, 0, ("x",) * 6) + row(2, 7), ":9: .* is not a row of 10 fields"),
        (HEAD + row(1, 0, ("nan",) * 6), "no box sends"),
        (HEAD + row(1, 2**40), "no box sends"),
        (HEAD + row(1, 0, ("5000.5",) * 6), "Fx = 5000.5 N at 0 s exceeds the range"),
    ],
)
def test_what_is_wrong_is_one_line(told, text, problem):
    with pytest.raises(InputError, match=problem) as error:
        told(text)
    assert str(error.value).isprintable()
