"""Opening of sources, errors in their specification, and the rate of readings and estimates."""

from pathlib import Path

import numpy as np
import pytest

from probedesign.core.errors import InputError
from probedesign.live.blocks import Block, WrenchReading, dropout_block, group_readings, limit_duration, paced
from probedesign.live.processing.chain import ProcessingOptions
from probedesign.live.run import estimate_stream
from probedesign.live.sources.source import SOURCES, open_source
from tests.live.peers import averaged


@pytest.mark.parametrize(
    ("spec", "expected"),
    [
        ("dac://Dev1/ai0:5", "is unknown; available are netft://HOST, daq://DEVICE/ai0:5?cal=FILE, replay:FILE"),
        ("serial:COM1", "'serial:COM1' is unknown; available are netft://HOST, daq:"),
        ("sim", "'sim' is unknown"),
        ("", "'' is unknown"),
        ("sim:20", "sim: takes parameters only"),
        ("sim:?force_N=1", "did you mean force_mN? known: force_mN, angle_deg"),
        ("sim:?force_mN=nan", "force_mN = 'nan' must be a number in 0.001 ... 100000"),
        ("sim:?force_mN=much", "force_mN = 'much' must be a number"),
        ("sim:?force_mN=", "force_mN = '' must be a number"),
        ("sim:?force_mN=-1", "force_mN = '-1' must be a number"),
        ("sim:?seconds=inf", "seconds = 'inf' must be a number"),
        ("sim:?seed=1.5", "seed = '1.5' must be a whole number"),
        ("sim:?seed=1&seed=2", "seed is given twice"),
        ("sim:?fast", "name=value&name=value"),
        ("sim:?speed=quick", "or max"),
        ("replay:", "a file is required"),
        ("replay:none.csv", "none.csv: no such recording"),
        ("netft:", "write netft://HOST"),
        ("netft://", "write netft://HOST"),
        ("netft://host:0", "write netft://HOST"),
        ("netft://host:99999", "write netft://HOST"),
        ("netft://host/path", "write netft://HOST"),
        ("netft://127.0.0.1?htp=80", "did you mean http?"),
        ("netft://127.0.0.1?sensor=other", "sensor = 'other' must be netbox or axia"),
        ("netft://no.such.host.invalid", "is the box on"),
        ("netft://127.0.0.1?http=1", "Connection refused"),
        ("udp:9000", "write udp://:PORT"),
        ("udp://", "write udp://:PORT"),
        ("udp://127.0.0.1:70000", "write udp://:PORT"),
        ("udp://127.0.0.1:9/x", "write udp://:PORT"),
        ("udp://192.0.2.1:9000", "an address of this machine"),
        ("udp://:0?frame=tool", "frame = 'tool' must be"),
        ("udp://:0?wait_s=0", "wait_s = '0' must be"),
        ("udp://:0?waits=1", "did you mean wait_s?"),
        ("replay:none.csv?seed=1", "replay: has no parameter 'seed'; did you mean speed? known: speed"),
    ],
)
def test_what_is_no_source(estimator, spec, expected):
    with pytest.raises(InputError) as error:
        open_source(spec, estimator.model)
    assert expected in str(error.value)
    assert str(error.value).isprintable()


def test_every_source_is_documented():
    text = (Path(__file__).parents[2] / "docs/live.md").read_text(encoding="utf-8").replace('"', "")
    assert [scheme for scheme in SOURCES if f"--source {scheme}:" not in text] == []


def stream(*times: float, most: int = 1) -> list[Block]:
    return list(group_readings((WrenchReading(time, np.zeros(6), np.zeros(3)) for time in times), most))


def slept(times: list[float], speed: float, most: int = 1) -> list[float]:
    """How long a stream waits before each of its blocks, by a clock that only moves while it waits."""
    now, waits = [100.0], []

    def sleep(seconds: float) -> None:
        waits.append(seconds)
        now[0] += seconds

    list(paced(stream(*times, most=most), speed, clock=lambda: now[0], sleep=sleep))
    return waits


def test_readings_come_at_their_own_time():
    """Exact up to the rounding of a clock near 100 s, 1.4e-14 s."""
    assert slept([5.0, 5.5, 7.0], 1.0) == pytest.approx([0.5, 1.5], abs=1e-13)
    assert slept([5.0, 5.5, 7.0], 2.0) == pytest.approx([0.25, 0.75], abs=1e-13)
    assert slept([5.0, 5.5, 7.0], float("inf")) == []
    assert slept([5.0, 5.5, 7.0, 9.0], 1.0, most=2) == pytest.approx([0.5, 3.5], abs=1e-13)  # with its last reading


def readings(blocks) -> list[WrenchReading]:
    return [reading for block in blocks for reading in block.readings()]


class Known:
    title, notes = "", ()

    def __init__(self, blocks: list[Block]) -> None:
        self.blocks = blocks

    def __iter__(self):
        yield from self.blocks


def answered(estimator, times: list[float], rate: float) -> list[float]:
    answers = estimate_stream(estimator, Known(stream(*times)), ProcessingOptions(rate=rate), lambda line: None)
    return [answer.reading.time for answer in answers]


def test_at_most_so_many_estimates_a_second(estimator):
    """A pause is not made up for, and a source at exactly this rate loses none: i/20 and i times 1/20 differ."""
    times = [i / 16 for i in range(16)]  # exact in binary
    assert answered(estimator, times, 4.0) == [0.0, 0.25, 0.5, 0.75]
    assert answered(estimator, times, 1000.0) == times
    assert len(answered(estimator, [i / 20 for i in range(200)], 20.0)) == 200
    assert answered(estimator, [0.0, 10.0, 10.25, 10.5, 11.0], 1.0) == [0.0, 10.0, 11.0]


@pytest.mark.parametrize("most", [1, 2, 3, 9])
def test_until_counts_from_the_first_reading(most):
    inside = readings(limit_duration(stream(7.0, 7.5, 8.0, 9.0, most=most), 1.0))
    assert [r.time for r in inside] == [7.0, 7.5]


def noisy(count: int, fault_at: int, break_at: int, turn_at: int) -> list[WrenchReading]:
    """Readings of two stretches, one with a fault, under a gravity that turns."""
    random = np.random.default_rng(7)
    gravities = (np.array([9.81, 0.0, 0.0]), np.array([0.0, 9.81, 0.1]))
    return [
        WrenchReading(
            0.1 * i + random.uniform(0.0, 0.01),
            random.standard_normal(6),
            gravities[i >= turn_at],
            None,
            "saturated" if i == fault_at else "",
            int(i >= break_at),
            50.0 + i,
        )
        for i in range(count)
    ]


@pytest.mark.parametrize("samples", [1, 2, 7])
@pytest.mark.parametrize("most", [2, 5, 7, 16, 1000])
def test_how_readings_are_cut_into_blocks_changes_nothing(samples, most):
    """To the bit: the same means, whose last readings, faults and stretches are the same."""
    given = noisy(100, fault_at=20, break_at=45, turn_at=70)

    def expected(most):
        means = averaged(limit_duration(group_readings(given, most), 9.0), samples)
        return [(r.time, *r.wrench_sensor, *r.gravity_base, r.fault, r.stretch, r.received) for r in means]

    assert expected(most) == expected(1)
    assert sum(row[-3] == "saturated" for row in expected(1)) == 1
    assert expected(1)[-1][0] < given[0].time + 9.0


def test_a_mean_spans_no_interruption():
    given = noisy(20, fault_at=-1, break_at=9, turn_at=99)
    means = list(averaged(group_readings(given, 4), 5))
    assert [m.stretch for m in means] == [0, 1, 1]
    assert np.array_equal(means[1].wrench_sensor, np.mean([r.wrench_sensor for r in given[9:14]], axis=0))


def test_blocks_are_no_longer_than_their_span():
    times = [0.0, 0.5, 1.0, 1.25, 5.0, 5.75]
    blocks = group_readings((WrenchReading(t, np.zeros(6), np.zeros(3)) for t in times), 100, max_span=1.0)
    assert [block.time.tolist() for block in blocks] == [[0.0, 0.5], [1.0, 1.25], [5.0, 5.75]]


def test_silence_is_no_reading():
    quiet = dropout_block(np.zeros(3), "stale", 0)
    blocks = [*stream(1.0, 2.0), quiet, *stream(3.0, 4.0)]
    assert [m.time for m in averaged(limit_duration(blocks, 10.0), 4)] == [2.5]
    assert list(averaged([quiet], 1)) == []
