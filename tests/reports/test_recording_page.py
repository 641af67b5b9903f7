"""`estimate --page`: its files, its summary, and what is refused."""

import json

import numpy as np
import pytest

from probedesign.cli.main import run
from probedesign.design import load_design
from probedesign.estimation.estimate import RESULTS
from probedesign.frozen_probe import freeze
from probedesign.live.blocks import iter_readings
from probedesign.live.recordings.csv import write_recording
from probedesign.live.run import estimate_recording
from probedesign.live.sources.sim import SimulatedSource
from probedesign.probe import build_probe
from probedesign.reports.recording_page import MAX_FRAMES, recording_page, replay_element, verdict
from tests.reports.test_pages import DESIGNS


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A frozen probe, a recording of a touch, and one of the free probe."""
    folder = tmp_path_factory.mktemp("touched")
    model = build_probe(load_design(DESIGNS / "large.toml")).model
    (folder / "large.probe.json").write_text(json.dumps(freeze(model)))
    for name, seconds in (("touch.csv", 12), ("free.csv", 1)):
        readings = list(iter_readings(SimulatedSource(model, f"force_mN=20&seconds={seconds}&rate_hz=5&speed=max")))
        time, wrench = np.array([r.time for r in readings]), np.array([r.wrench_sensor for r in readings])
        write_recording(folder / name, time, wrench)
    return folder


def estimate(folder, *options: str, recording: str = "touch.csv") -> int:
    paths = [str(folder / "large.probe.json"), str(folder / recording)]
    return run(["estimate", *paths, "--average", "1", *options])


def test_a_page_is_written_and_the_touches_are_printed(folder, tmp_path, capsys):
    page, table = tmp_path / "touch.html", tmp_path / "touch.csv"
    assert estimate(folder, "--page", str(page), "--out", str(table)) == 0
    printed = capsys.readouterr().out
    rows = table.read_text().splitlines()[1:]
    located = sum(",ok," in row for row in rows)
    assert f"{located} ok" in printed and "touch 1: " in printed and f"{located} of " in printed
    html = page.read_text(encoding="utf-8")
    assert f"<td>ok</td><td>{located}</td><td>{RESULTS['ok']}</td>" in html
    assert 'id="replay"' in html and html.count("<svg") == 3


def test_the_rows_are_printed_without_a_file(folder, capsys):
    assert estimate(folder) == 0
    assert capsys.readouterr().out.startswith("time_s,result,")


def test_a_free_probe_has_a_page_without_a_replay(folder, tmp_path, capsys):
    page = tmp_path / "free.html"
    assert estimate(folder, "--page", str(page), recording="free.csv") == 0
    html = page.read_text(encoding="utf-8")
    assert "Nothing touched" in html and "<canvas" not in html and "<svg" not in html
    assert "touch 1" not in capsys.readouterr().out


def test_nothing_is_replaced_without_force(folder, tmp_path, capsys):
    page = tmp_path / "page.html"
    page.write_text("mine")
    recording = folder / "touch.csv"
    before = recording.read_bytes()
    for options in (("--page", str(page)), ("--page", str(recording), "--force"),
                    ("--page", str(tmp_path / "a"), "--out", str(tmp_path / "a"))):  # fmt: skip
        assert estimate(folder, *options) == 2
        captured = capsys.readouterr()
        assert captured.out == "" and captured.err.count("\n") == 1
    assert page.read_text() == "mine" and recording.read_bytes() == before
    assert not (tmp_path / "a").exists()
    assert estimate(folder, "--page", str(page), "--force") == 0 and page.read_text().startswith("<!DOCTYPE html>")


@pytest.mark.parametrize("method", ["ml", "force_moment"])
def test_both_methods_have_a_page(folder, method):
    estimator = build_probe(load_design(DESIGNS / "large.toml")).estimator()
    estimates = estimate_recording(estimator, folder / "touch.csv", method=method)
    page = recording_page(estimates).decode()
    assert "NaN" not in page and "nan" not in page and "located" in verdict(estimates)


def test_a_long_recording_is_thinned(folder):
    """A page is not larger for a longer recording than for one of `MAX_FRAMES` readings."""
    estimator = build_probe(load_design(DESIGNS / "large.toml")).estimator()
    estimates = estimate_recording(estimator, folder / "touch.csv")
    rows = [row | {"time_s": row["time_s"] + 12.0 * i} for i in range(100) for row in estimates.rows]
    element = replay_element(estimator, rows, estimates.gravities * 100, "long")
    assert element.count('"t": ') == MAX_FRAMES
