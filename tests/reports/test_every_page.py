"""Every page in a real browser: contrast, text alternatives, width, print, no network."""

import json
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from probedesign import data_of, identify, validate
from probedesign.campaigns import read_campaign
from probedesign.cli.console import json_bytes
from probedesign.cli.demo import DEMO_STYLE, demo_section
from probedesign.cli.main import run
from probedesign.design import load_design
from probedesign.live.blocks import iter_readings
from probedesign.live.processing.estimates import true_values
from probedesign.live.recordings.csv import write_recording
from probedesign.live.run import RecordingEstimates, estimate_recording
from probedesign.live.sources.sim import SimulatedSource
from probedesign.mapping.contact_map import build_map
from probedesign.planning.candidates import Instruments
from probedesign.planning.plan import make_plan
from probedesign.probe import build_probe
from probedesign.reports.html_page import REPORT_STYLE
from probedesign.reports.identification_page import identification_page
from probedesign.reports.map_page import MapScene, map_page, map_svg
from probedesign.reports.plan_page import plan_page
from probedesign.reports.prediction_page import prediction_page
from probedesign.reports.recording_page import STYLE, recording_page, replay_element, touches_in, verdict
from probedesign.reports.sweep_page import sweep_page
from probedesign.reports.validation_page import validation_page
from probedesign.simulation.campaign_folder import make_campaign
from probedesign.simulation.ground_truth import CampaignPlan
from probedesign.web.home import write_home
from tests.mapping.synthetic_touches import STD_E, touch
from tests.reports.page_checks import browser, check_page, opened
from tests.reports.test_sweep_page import grid

DESIGNS = Path(__file__).parents[2] / "designs"


@cache
def probe():
    return build_probe(load_design(DESIGNS / "large.toml"))


@pytest.fixture(scope="module")
def running():
    with browser() as started:
        yield started


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("pages")


@pytest.fixture(scope="module")
def recorded(folder) -> RecordingEstimates:
    """A touch of 20 mN that moves along the probe and back, with its truth."""
    estimator = probe().estimator()
    readings = list(iter_readings(SimulatedSource(estimator.model, "force_mN=20&seconds=20&rate_hz=5&speed=max")))
    path = folder / "recording.csv"
    write_recording(path, np.array([r.time for r in readings]), np.array([r.wrench_sensor for r in readings]))
    estimates = estimate_recording(estimator, path)
    for row, reading in zip(estimates.rows, readings, strict=True):
        row |= true_values(reading)
    return estimates


@pytest.fixture(scope="module")
def campaign(folder):
    make_campaign(probe().model, folder / "data", CampaignPlan())
    return read_campaign(folder / "data")


def prediction(_request) -> bytes:
    small = build_probe(load_design(DESIGNS / "small.toml"))
    made = small.predict(fractions=(0.2, 0.4, 0.6, 0.8, 1.0), forces_N=(0.005, 0.01, 0.02, 0.1))
    return prediction_page(made, small.estimator())


def comparison(request) -> bytes:
    page = request.getfixturevalue("folder") / "compared.html"
    files = [str(DESIGNS / f"{name}.toml") for name in ("large", "small")]
    assert run(["compare", *files, "--out", str(page), "--at", "0.6", "0.8"]) == 0
    return page.read_bytes()


def sweep(_request) -> bytes:
    records = grid([(a, b) for a in (1.0, 2.0, 3.0, 4.0) for b in (1.0, 2.0, 3.0)])
    return sweep_page(records, ["probe.k0", "probe.k1"], "task")


def recording(request) -> bytes:
    return recording_page(request.getfixturevalue("recorded"))


def identification(request) -> bytes:
    data = data_of(request.getfixturevalue("campaign"), probe().model, 0.0)
    return identification_page(identify(data, ["E", "G"]))


def validation(request) -> bytes:
    return validation_page(validate(probe().estimator(), request.getfixturevalue("campaign")))


def plan(_request) -> bytes:
    return plan_page(make_plan(probe().model, 0.0, 40.0, ["E"], Instruments(), 0), "data/large")


def points(_request) -> bytes:
    return map_page(
        MapScene(build_map([touch(1, (0, 0, 0), 0.2e-3), touch(2, (20e-3, 0, 0), 2e-3)], STD_E)), "Points", []
    )


def demo(request) -> bytes:
    folder, estimates = request.getfixturevalue("folder"), request.getfixturevalue("recorded")
    scene = MapScene(build_map([touch(1, (0, 0, 0), 0.2e-3)], STD_E))
    (folder / "points.svg").write_bytes(map_svg(scene))
    replay = replay_element(estimates.estimator, estimates.rows, estimates.gravities, "a touch")
    picture, long = '<img src="points.svg" alt="points">', Path(20 * "long/")
    extra = demo_section(folder, "estimate", "Located.", replay) + demo_section(long, "whisker", "Not made.")
    extra += demo_section(folder, "explore", "Found.", picture, [("points.svg", "points")])
    style = REPORT_STYLE + DEMO_STYLE + STYLE
    (folder / "prediction.json").write_bytes(json_bytes(probe().predict().as_dict()))
    page = write_home(folder, probe().model, extra=f'<div class="figures">{extra}</div>', style=style)
    assert page is not None
    return page.read_bytes()


PAGES: tuple[Callable[[pytest.FixtureRequest], bytes], ...] = (
    prediction, comparison, sweep, recording, identification, validation, plan, points, demo,
)  # fmt: skip


@pytest.mark.parametrize("make", PAGES, ids=lambda make: make.__name__)
def test_a_page_is_legible_fits_and_prints(make, running, folder, request):
    """Contrast of 4.5 in light and dark, nothing cut at 360 px and on A4, no request, no console message."""
    file = folder / f"{make.__name__}.html"
    file.write_bytes(make(request))
    number, cut = check_page(running, file)
    assert not cut and 1 <= number <= 6


def test_the_replay_plays_pauses_and_turns(running, folder, recorded):
    file = folder / "replay.html"
    file.write_bytes(recording_page(recorded))
    with opened(running, file, 1000, "light") as page:  # reduced motion: it does not start

        def picture() -> str:
            return str(page.evaluate("document.getElementById('replay').toDataURL()"))

        button, text = page.locator("#replay-play"), page.locator("#replay-text")
        assert button.inner_text() == "Play"
        row = next(row for row in recorded.rows if row["result"] == "ok")
        page.evaluate(
            "t => { const place = document.getElementById('replay-time'); place.value = t;"
            "place.dispatchEvent(new Event('input')); }", row["time_s"] + 1e-6,
        )  # fmt: skip
        assert text.inner_text().startswith(f"{row['time_s']:.2f} s: ok")
        assert f"s = {row['s_contact_mm']:.1f}" in text.inner_text()
        still = picture()
        page.locator("#replay").press("ArrowLeft")
        turned = picture()
        assert turned != still
        button.click()
        page.wait_for_function(
            "shown => document.getElementById('replay-text').textContent !== shown", arg=text.inner_text()
        )
        assert button.inner_text() == "Pause" and picture() != turned


def test_the_replay_shows_the_shapes_and_points_of_the_estimates(recorded):
    """Each shape is the equilibrium under the row's force, gravity points down, and the truth is near the estimate."""
    page = recording_page(recorded).decode()
    data = json.loads(re.search(r'id="replay-data">(.*?)</script>', page).group(1))
    assert len(data["frames"]) == len(recorded.rows) and data["axes"]["x"] == pytest.approx([0, 0, -1])
    view = np.array([data["axes"][axis] for axis in "xyz"]).T
    assert np.linalg.det(view) == pytest.approx(1.0)
    for frame, row in zip(data["frames"], recorded.rows, strict=True):
        assert ("contact" in frame) == (row["result"] == "ok")
        assert frame["p"] is not None and ("free" in frame) == (row["result"] not in ("ok", "no_contact"))
        if row["result"] != "ok":
            continue
        p = np.array([row[f"p_surface_base_{axis}_mm"] for axis in "xyz"])
        assert frame["contact"]["p"] == pytest.approx((view @ p).tolist(), abs=0.006)  # printed to 0.01 mm
        away = np.linalg.norm(np.array(frame["p"]) - frame["contact"]["p"], axis=1).min()
        assert away < 10.0  # within the radius and half the distance of two points of the centreline, 3 mm


def test_touches_are_runs_of_readings_with_a_contact(recorded):
    (only,) = touches_in(recorded.rows)
    located = [row for row in recorded.rows if row["result"] == "ok"]
    assert only.located == len(located) <= only.readings < len(recorded.rows)
    assert only.s_mm == (min(r["s_contact_mm"] for r in located), max(r["s_contact_mm"] for r in located))
    assert 18.0 < only.force_mN < 23.0  # 20 mN with noise of 0.5 mN
    assert "1 touch" in verdict(recorded)


def test_unusable_readings_neither_begin_nor_end_a_touch(recorded):
    free = next(row for row in recorded.rows if row["result"] == "no_contact")
    ok = next(row for row in recorded.rows if row["result"] == "ok")
    bad = free | {"result": "out_of_range"}
    assert [t.readings for t in touches_in([bad, free, bad, ok, bad, ok, bad, free, ok, free])] == [3, 1]
    assert touches_in([bad, bad, free]) == [] and touches_in([]) == []
