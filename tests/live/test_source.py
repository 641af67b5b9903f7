"""Which sources there are, what is refused, and how fast they run."""

import numpy as np
import pytest

from probedesign.errors import InputError
from probedesign.live.reading import Reading, paced, thinned, until
from probedesign.live.source import open_source


@pytest.mark.parametrize(
    ("spec", "told"),
    [
        ("daq://Dev1/ai0:5?cal=FT1.cal", "source daq: is not in this version; there are netft://HOST"),
        ("serial:COM1", "'serial:COM1' is not known; there are netft://HOST, replay:FILE and sim:"),
        ("sim", "'sim' is not known"),
        ("", "'' is not known"),
        ("sim:20", "sim: takes parameters only"),
        ("sim:?force_N=1", "did you mean force_mN? known: force_mN, angle_deg"),
        ("sim:?force_mN=nan", "force_mN = 'nan' must be a number in 0.001 ... 100000"),
        ("sim:?force_mN=much", "force_mN = 'much' must be a number"),
        ("sim:?force_mN=", "force_mN = '' must be a number"),
        ("sim:?force_mN=-1", "force_mN = '-1' must be a number"),
        ("sim:?seconds=inf", "seconds = 'inf' must be a number"),
        ("sim:?seed=1.5", "seed = '1.5' must be a whole number"),
        ("sim:?seed=1&seed=2", "seed is said twice"),
        ("sim:?fast", "name=value&name=value"),
        ("sim:?speed=quick", "or max"),
        ("replay:", "names no file"),
        ("replay:none.csv", "none.csv: no such recording"),
        ("replay:none.csv?seed=1", "replay: has no parameter 'seed'; did you mean speed? known: speed"),
    ],
)
def test_what_is_no_source(estimator, spec, told):
    with pytest.raises(InputError) as error:
        open_source(spec, estimator.model)
    assert told in str(error.value)
    assert str(error.value).isprintable()


def stream(*times: float) -> list[Reading]:
    return [Reading(time, np.zeros(6), np.zeros(3)) for time in times]


def slept(times: list[float], speed: float) -> list[float]:
    """How long a stream waits before each of its readings, by a clock that only moves while it waits."""
    now, waits = [100.0], []

    def sleep(seconds: float) -> None:
        waits.append(seconds)
        now[0] += seconds

    list(paced(stream(*times), speed, clock=lambda: now[0], sleep=sleep))
    return waits


def test_readings_come_at_their_own_time():
    """Exact up to the rounding of a clock near 100 s, 1.4e-14 s."""
    assert slept([5.0, 5.5, 7.0], 1.0) == pytest.approx([0.5, 1.5], abs=1e-13)
    assert slept([5.0, 5.5, 7.0], 2.0) == pytest.approx([0.25, 0.75], abs=1e-13)
    assert slept([5.0, 5.5, 7.0], float("inf")) == []


def test_at_most_so_many_a_second():
    times = [i / 16 for i in range(16)]  # exact in binary
    assert [r.time for r in thinned(stream(*times), 4.0)] == [0.0, 0.25, 0.5, 0.75]
    assert len(list(thinned(stream(*times), 1000.0))) == 16


def test_a_source_of_the_very_rate_loses_none():
    """i/20 and i times 1/20 differ in the last bit."""
    assert len(list(thinned(stream(*(i / 20 for i in range(200))), 20.0))) == 200


def test_a_pause_is_not_made_up_for():
    assert [r.time for r in thinned(stream(0.0, 10.0, 10.25, 10.5, 11.0), 1.0)] == [0.0, 10.0, 11.0]


def test_until_counts_from_the_first_reading():
    assert [r.time for r in until(stream(7.0, 7.5, 8.0, 9.0), 1.0)] == [7.0, 7.5]
