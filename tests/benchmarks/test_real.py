"""Test the comparison with measurements of others on files made here: parsers, estimators of drift and payload."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.__main__ import main
from benchmarks.real import columns, numbers, payload, sag_and_frequency, white_and_walk


@pytest.mark.parametrize("given", [[], ["--data", "none/here"]])
def test_without_the_data_it_says_so_in_one_line(given: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["real", *given]) == 0
    assert capsys.readouterr().out.count("\n") == 1


def test_files_are_read_with_and_without_a_header(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("from_tip_mm,width_mm\n0.0,1.5\n127.0,\n", "utf-8")
    (tmp_path / "b.txt").write_text("0.1, 5.0, -4.0\n0.2, 5.1, -4.1\n", "utf-8")
    assert columns(tmp_path / "a.csv") == {"from_tip_mm": ["0.0", "127.0"], "width_mm": ["1.5", ""]}
    np.testing.assert_array_equal(numbers(tmp_path / "b.txt"), [[0.1, 5.0, -4.0], [0.2, 5.1, -4.1]])


def test_a_swinging_beam_has_its_sag_and_frequency() -> None:
    """The spectrum of 1.5 s, interpolated, gives a frequency to a hundredth of its line width of 0.7 Hz."""
    time = np.arange(500) / 100.0
    let_go = np.maximum(time - 0.5, 0.0)
    x = -12.0 * (1.0 - np.exp(-0.8 * let_go) * np.cos(2.0 * np.pi * 5.0 * let_go))
    read = {"time_s": time, **{f"base{k}_x_mm": np.zeros(500) for k in (1, 2, 3)},
            **{f"tip{k}_x_mm": (0.8 + 0.1 * k) * x / 1.1 for k in (1, 2, 3)}}  # fmt: skip
    sag, frequency = sag_and_frequency({name: [str(v) for v in values] for name, values in read.items()})
    assert sag == pytest.approx(12.0, rel=0.02)  # it still swings by e^-3
    assert frequency == pytest.approx(5.0, abs=0.05)


def test_noise_and_random_walk_are_found_apart() -> None:
    """Of 200 channels and 24 differences each, a walk of 0.5 steps/√s stands out of noise of one step at 200 Hz."""
    rng, rate = np.random.default_rng(3), 200.0
    walk = np.cumsum(0.5 / np.sqrt(rate) * rng.normal(size=(5000, 200)), axis=0)
    noise, found = white_and_walk(rng.normal(size=walk.shape) + walk, rate)
    assert noise == pytest.approx(np.ones(200), rel=0.06)  # 1/√10000 each, six of them
    assert np.sqrt((found**2).mean()) == pytest.approx(0.5, rel=0.05)  # 1/√(2·24·200), five of them


def test_a_payload_is_found_from_rest_poses_without_noise() -> None:
    rng = np.random.default_rng(5)
    R, weight, centre = Rotation.random(30, random_state=6).as_matrix(), np.array([0.1, 0.0, -12.0]), [0.0, 0.01, 0.05]
    bias = rng.normal(size=6)
    force = R @ bias[:3] + weight
    moment = R @ bias[3:] + np.cross(R @ centre, weight)
    w, c, *off = payload(R, np.hstack([force, moment]))
    np.testing.assert_allclose(w, weight, atol=1e-9)
    np.testing.assert_allclose(c, centre, atol=1e-9)
    assert max(np.abs(part).max() for part in off) < 1e-9
