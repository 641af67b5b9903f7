"""The low-pass filter: its cut-off, its delay and its step are as it says."""

import numpy as np
import pytest

from probedesign.core.errors import InputError
from probedesign.live.processing.chain import LowPass

RATE = 7000.0


@pytest.mark.parametrize("cutoff", [5.0, 20.0, 500.0])
def test_a_ramp_comes_out_later_by_the_stated_delay(cutoff):
    """Of first order exactly: what is left of the start dies away, and sums of thousands round at 1e-12."""
    low_pass = LowPass(cutoff, RATE)
    time = np.arange(int(6.0 / cutoff * RATE)) / RATE
    out = low_pass.filter(time[:, None])[-1, 0]
    assert out == pytest.approx(time[-1] - low_pass.delay, abs=1e-9)
    assert low_pass.delay < 0.205 / cutoff  # 2/(2π f) √(√2 - 1), a filter's of continuous time


@pytest.mark.parametrize("cutoff", [5.0, 20.0, 500.0])
def test_the_power_of_a_wave_at_the_cut_off_is_halved(cutoff):
    """Over whole waves after the start; a tenth of a percent for the samples that do not fall on their ends."""
    low_pass = LowPass(cutoff, RATE)
    wave = np.sin(2.0 * np.pi * cutoff * np.arange(int(12.0 / cutoff * RATE)) / RATE)
    out = low_pass.filter(wave[:, None])[:, 0]
    part = slice(int(4.0 / cutoff * RATE), None)
    assert np.mean(out[part] ** 2) / np.mean(wave[part] ** 2) == pytest.approx(0.5, rel=1e-3)


def test_a_step_never_overshoots_and_it_begins_at_rest():
    low_pass = LowPass(20.0, RATE)
    assert low_pass.filter(np.full((50, 6), 3.0)) == pytest.approx(3.0, rel=1e-14)  # rounding
    rise = low_pass.filter(np.full((2000, 6), 4.0))
    assert (np.diff(rise, axis=0) >= -1e-14).all() and rise.max() <= 4.0 + 1e-13
    assert rise[-1] == pytest.approx(4.0, abs=1e-9)  # ten time constants and more


def test_pieces_make_the_whole():
    samples = np.random.default_rng(1).standard_normal((360, 6))
    whole, pieces = LowPass(20.0, RATE), LowPass(20.0, RATE)
    cut = np.concatenate([pieces.filter(samples[i : i + 36]) for i in range(0, 360, 36)])
    assert np.array_equal(whole.filter(samples), cut)


@pytest.mark.parametrize("cutoff", [0.0, -1.0, 3500.0, float("nan")])
def test_an_invalid_cut_off_is_refused(cutoff):
    with pytest.raises(InputError, match="--filter-hz"):
        LowPass(cutoff, RATE)
