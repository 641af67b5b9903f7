"""Content of the views: shape, ellipsoid, parts, status lines; unknown values are blank."""

import json
import math
from collections import Counter
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
from rich.console import Console

from probedesign.core.frames import pose
from probedesign.core.stl import RECORD
from probedesign.estimation.estimate import RESULTS, Estimate
from probedesign.live.outputs.drawing import SIDES, BentShape, TubeMesh, centreline, ellipsoid
from probedesign.live.processing.blocks import Block, WrenchReading
from probedesign.live.processing.control import ProcessingOptions
from probedesign.live.processing.estimates import EstimateUpdate
from probedesign.live.run import estimate_stream
from probedesign.live.sources.sim import SimulatedSource
from probedesign.live.view.page import events_html, status_html
from probedesign.live.view.scene import StripCharts, read_stl, rigid_parts
from probedesign.live.view.sinks import TerminalView, table_of
from probedesign.live.view.state import STRIP, Snapshot, StatusLine, ViewState


def bent(estimator):
    """The probe under a force that bends it by more than a radian."""
    eq = estimator.model.rod.solve((9.81, 0.0, 0.0), (0.04, 0.02, 0.0), 0.14)
    assert eq.ok and eq.tip_tangent[2] < math.cos(1.0)
    return eq


def tube_of(estimator) -> TubeMesh:
    rod = estimator.model.rod
    return TubeMesh(rod.s, rod.radius)


# shape


def test_the_drawn_centreline_is_the_solved_one(estimator):
    eq, s = bent(estimator), np.linspace(0.0, estimator.model.rod.length, 200)
    p, x, y = centreline(BentShape(eq.s, eq.p_base, eq.R_base), s)
    # a tenth of a millimetre is a pixel of a page that shows the whole probe
    assert np.abs(p - eq.p_at(s)).max() < 1e-4
    assert np.abs(np.einsum("ij,ij->i", x, y)).max() < 1e-12
    turned = np.einsum("ij,ij->i", x, eq.R_at(s)[:, :, 0])
    assert turned.min() > math.cos(math.radians(2.0))  # of a mark on the skin nobody sees two degrees


def test_the_skin_is_closed_turned_outward_and_holds_the_probes_volume(estimator):
    eq, tube = bent(estimator), tube_of(estimator)
    vertices = tube.vertices(BentShape(eq.s, eq.p_base, eq.R_base))
    a, b, c = (vertices[tube.faces[:, i]] for i in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0
    # a polygon of n corners lacks 1 - sin(2π/n) n/2π of its circle, 0.5 % here; chords of a bent axis far less
    rounded = math.sin(2.0 * math.pi / SIDES) * SIDES / (2.0 * math.pi)
    assert volume == pytest.approx(rounded * estimator.model.rod.body.volume_beyond[0], rel=2e-3)
    corners = np.unique(np.round(vertices, 9), axis=0, return_inverse=True)[1].reshape(-1)
    edges = Counter(
        frozenset(edge)
        for face in corners[tube.faces]
        for edge in zip(face, np.roll(face, 1), strict=True)
        if len(set(edge)) == 2
    )
    assert set(edges.values()) == {2}


def test_a_flattened_section_is_drawn_flat(estimator):
    free, rod = estimator.free((0.0, 0.0, 9.81)), estimator.model.rod
    ring = TubeMesh(rod.s, rod.radius, 0.5).vertices(BentShape(free.s, free.p_base, free.R_base))[:SIDES]
    assert np.ptp(ring[:, 0]) == pytest.approx(2.0 * rod.radius[0])
    assert np.ptp(ring[:, 1]) == pytest.approx(rod.radius[0])


def test_the_ellipsoid_holds_95_of_100():
    rng = np.random.default_rng(1)
    root = rng.standard_normal((3, 3))
    half_axes, axes = ellipsoid(root @ root.T)
    assert np.allclose(axes @ axes.T, np.eye(3)) and np.linalg.det(axes) == pytest.approx(1.0)
    inside = np.linalg.norm((rng.standard_normal((20_000, 3)) @ root.T @ axes) / half_axes, axis=1) < 1.0
    assert inside.mean() == pytest.approx(0.95, abs=5.0 * math.sqrt(0.95 * 0.05 / 20_000))


# parts


def stl(corners) -> bytes:
    facets = np.zeros(len(corners), RECORD)
    facets["corners"] = np.reshape(corners, (-1, 3, 3))
    return b"made by a test".ljust(80) + len(corners).to_bytes(4, "little") + facets.tobytes()


@pytest.fixture
def folder(tmp_path, estimator):
    """Parts beside a frozen probe, each one triangle, the plate 22 mm below the sensor's face."""
    for name in ("sensor_adapter", "clamp_ring", "flange_adapter"):
        (tmp_path / f"{name}.stl").write_bytes(stl([[[0, 0, 0], [10, 0, 0], [0, 10, 0]]]))
    below = pose(p=(0.0, 0.0, -0.022))
    parts = {name: {"T_sensor_part": np.eye(4).tolist()} for name in ("sensor_adapter", "clamp_ring")}
    parts["flange_adapter"] = {"T_sensor_part": below.tolist()}
    manifest = {"fingerprint": estimator.model.fingerprint, "parts": parts}
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    return tmp_path


def test_exported_parts_are_placed_by_the_manifest(estimator, folder):
    parts, note = rigid_parts(estimator.model, folder)
    found = {part.name: part.vertices for part in parts}
    face = -estimator.model.T_sensor_base[2, 3]  # of the sensor, in base axes
    assert note == ""
    assert set(found) == {"sensor", "flange", "sensor_adapter", "clamp_ring", "flange_adapter"}
    assert np.allclose(found["flange_adapter"][:, 2], face - 0.022)
    assert np.ptp(found["flange_adapter"][:, 0]) == pytest.approx(0.01)  # millimetres in the file
    assert found["sensor"][:, 2].max() == pytest.approx(face)
    assert np.ptp(found["sensor"], axis=0) == pytest.approx([0.017, 0.017, 0.0145], rel=1e-3)


@pytest.mark.parametrize(
    ("spoil", "expected"),
    [
        (lambda folder: (folder / "manifest.json").unlink(), "there is no manifest.json"),
        (
            lambda folder: (folder / "manifest.json").write_text('{"fingerprint": "0"}'),
            "they belong to probe 0",
        ),
        (lambda folder: (folder / "manifest.json").write_text("[]"), ""),
        (
            lambda folder: (folder / "clamp_ring.stl").write_bytes(b"solid"),
            "clamp_ring.stl is not a binary STL",
        ),
        (
            lambda folder: (folder / "clamp_ring.stl").write_bytes(stl([])),
            "clamp_ring.stl is not a binary STL",
        ),
        (
            lambda folder: (folder / "clamp_ring.stl").write_bytes(stl([[[math.inf] * 3] * 3])),
            "non-finite corner",
        ),
    ],
)
def test_parts_of_another_probe_are_not_drawn_and_a_note_is_shown(estimator, folder, spoil, expected):
    spoil(folder)
    parts, note = rigid_parts(estimator.model, folder)
    assert [part.name for part in parts] == ["sensor", "flange", "adapter"]
    assert expected in note and "plain cylinders" in note and "\n" not in note


def test_a_truncated_stl_is_refused(folder):
    path = folder / "clamp_ring.stl"
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(ValueError, match="not a binary STL"):
        read_stl(path)


# words


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


def kept(estimator, query: str, clock: Clock) -> ViewState:
    """The state after a simulated run, on the clock of the run."""
    state, start = ViewState(clock=clock), clock.now
    for answer in estimate_stream(
        estimator, SimulatedSource(estimator.model, query), ProcessingOptions(), print
    ):
        reading = answer.reading
        clock.now = start + reading.time
        one = np.array([reading.time])
        state.on_samples(Block(one, reading.wrench_sensor[None], reading.gravity_base, one))
        state.on_estimate(answer)
    return state


def of(snapshot: Snapshot) -> dict[str, StatusLine]:
    return {line.name: line for line in snapshot.status}


def answer(estimator, estimate: Estimate, time: float = 0.0, **more) -> EstimateUpdate:
    gravity = estimator.model.gravity_base
    return EstimateUpdate(
        WrenchReading(time, np.zeros(6), gravity), estimate, wrench_base=np.zeros(6), **more
    )


def test_the_status_before_the_first_reading():
    snapshot = ViewState().snapshot()
    assert of(snapshot)["result"].text == "no reading yet"
    assert snapshot.marker is None and snapshot.shape is None


def test_a_contact_is_shown_with_its_units(estimator):
    snapshot = kept(estimator, "speed=max&rate_hz=10&seconds=8", Clock()).snapshot()
    words = of(snapshot)
    assert words["result"] == StatusLine("result", f"ok: {RESULTS['ok']}", "good")
    assert words["contact"].text == f"s {1e3 * snapshot.marker.s:.1f} ± {1e3 * snapshot.marker.std_s:.1f} mm"
    assert " mN, tangential over normal " in words["force"].text and words["moments"].text.endswith(" N·mm")
    assert "10 readings/s, 10 estimates/s" in words["rate"].text
    assert snapshot.shape is not None and not snapshot.stale
    assert snapshot.strip.shape == (80, len(STRIP))


@pytest.mark.parametrize("result", [result for result in RESULTS if result != "ok"])
def test_a_result_other_than_ok_has_no_place(estimator, result):
    """Not even if it carries candidates or a point fused from earlier readings."""
    ok = kept(estimator, "speed=max&rate_hz=10&seconds=8", Clock())._update.estimate
    state = ViewState()
    state.on_estimate(answer(estimator, Estimate(result, candidates=ok.candidates, force_base=ok.force_base)))
    snapshot = state.snapshot()
    assert snapshot.marker is None
    assert [of(snapshot)[name].text for name in ("contact", "point", "force")] == ["–"] * 3
    assert of(snapshot)["result"].text == f"{result}: {RESULTS[result]}"
    assert np.isnan(snapshot.strip[:, 7:]).all()


def test_silence_is_stale_and_what_is_known_is_old(estimator):
    clock = Clock()
    state = kept(estimator, "speed=max&rate_hz=10&seconds=8", clock)
    clock.now += 0.45  # not yet five gaps
    assert not state.snapshot().stale
    clock.now += 1.95
    snapshot = state.snapshot()
    assert snapshot.stale and of(snapshot)["result"] == StatusLine(
        "result", "stale: no reading for 2.4 s", "bad"
    )


def test_a_silent_source_is_shown_with_its_fault(estimator):
    state = ViewState()
    state.on_estimate(answer(estimator, Estimate("no_contact")))
    none = np.empty(0)
    state.on_samples(Block(none, np.empty((0, 6)), estimator.model.gravity_base, none, "stale, no record"))
    assert of(state.snapshot())["fault"] == StatusLine("fault", "stale, no record", "bad")


def test_readings_without_estimates_make_what_is_known_old(estimator):
    clock = Clock()
    state = kept(estimator, "speed=max&rate_hz=10&seconds=8", clock)
    gravity = estimator.model.gravity_base
    for _ in range(100):
        clock.now += 0.1
        state.on_samples(Block(np.zeros(1), np.zeros((1, 6)), gravity, np.zeros(1)))
    assert "old" in of(state.snapshot())["result"].text and state.snapshot().stale


def test_loss_tare_and_recording_are_shown(estimator):
    state = ViewState(lambda: {"lost": 3, "received": 10})
    for line in ("tare from 100 readings", "recording to a.mcap", "mark: here"):
        state.on_event(1.0, line)
    words = of(state.snapshot())
    assert words["loss"] == StatusLine("loss", "3 lost of 0 readings", "fair")
    assert words["tare"].text == "from 100 readings" and words["recording"].text == "to a.mcap"
    state.on_event(2.0, "recorded 7 readings to a.mcap")
    assert of(state.snapshot())["recording"].text == "recorded 7 readings to a.mcap"
    assert state.snapshot().events[-2:] == ((1.0, "mark: here"), (2.0, "recorded 7 readings to a.mcap"))


def test_each_touch_is_stored_once_with_its_best_contact(estimator):
    """Two touches of a run without phases: of each the place of the least standard deviation."""
    query = "speed=max&rate_hz=10&seconds=23&period_s=10"
    snapshot = kept(estimator, query, Clock()).snapshot()
    assert [place.number for place in snapshot.touches] == [1, 2]
    answers = list(
        estimate_stream(estimator, SimulatedSource(estimator.model, query), ProcessingOptions(), print)
    )
    for place, start in zip(snapshot.touches, (0.0, 10.0), strict=True):
        here = [a.estimate for a in answers if start <= a.reading.time < start + 10.0 and a.estimate.ok]
        assert place.std_s == min(estimate.std_s for estimate in here)


def test_a_settled_contact_is_preferred_to_more_precise_moving_ones(estimator):
    found = kept(estimator, "speed=max&rate_hz=10&seconds=8", Clock())._update.estimate
    surer, state = replace(found, s_contact=0.1, std_s=0.1 * found.std_s), ViewState()
    for estimate, phase in ((found, "settled"), (surer, "touching"), (Estimate("no_contact"), "released")):
        state.on_estimate(answer(estimator, estimate, phase=phase))
    (place,) = state.snapshot().touches
    assert (place.s, place.std_s) == (found.s_contact, found.std_s)


def test_a_known_pose_puts_the_contact_into_the_world(estimator):
    found = kept(estimator, "speed=max&rate_hz=10&seconds=8", Clock())._update
    T, state = pose(p=(1.0, 2.0, 3.0)), ViewState()
    T[:3, :3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    state.on_estimate(answer(estimator, found.estimate, T_world_base=T))
    place = state.snapshot().marker
    assert place.in_world
    assert place.p_surface == pytest.approx(T[:3, :3] @ found.estimate.p_surface_base + T[:3, 3])
    assert np.trace(place.cov) == pytest.approx(np.trace(found.estimate.cov_surface_base))
    assert "world" in of(state.snapshot())["point"].text


def test_what_comes_from_outside_is_escaped():
    snapshot = Snapshot(
        status=(StatusLine("fault", "<script>", "bad"),), events=((math.nan, "mark: <img src=x>"),)
    )
    assert "<script>" not in status_html(snapshot) and "&lt;script&gt;" in status_html(snapshot)
    assert "<img" not in events_html(snapshot)


# charts


def test_charts_are_thinned_keep_the_last_seconds_and_leave_gaps():
    charts = StripCharts()
    rows = np.zeros((40_000, len(STRIP)))
    rows[:, 0] = np.arange(40_000) / 1000.0
    rows[::2, 7] = np.nan
    assert charts.add(rows)
    time, s, low, high = charts.lines()["place"]
    assert np.isnan([s, low, high]).any() and np.isfinite([s, low, high]).any()
    assert 400 <= len(time) <= 450 and charts.window() == pytest.approx((time[-1] - 15.0, time[-1]))
    assert not charts.add(rows[:0])
    assert charts.add(np.zeros((1, len(STRIP))))  # another run's clock
    assert len(charts.lines()["push"][0]) == 1


# terminal


def test_terminal_and_page_show_the_same_status(estimator):
    snapshot = kept(estimator, "speed=max&rate_hz=10&seconds=8", Clock()).snapshot(shaped=False)
    console = Console(file=StringIO(), width=120)
    console.print(table_of("large", snapshot))
    drawn = console.file.getvalue()
    assert all(line.text in drawn for line in snapshot.status)


def test_the_terminal_is_left_as_it_was(estimator):
    console = Console(file=StringIO(), force_terminal=True, width=100, height=40)
    terminal = TerminalView("large", console=console)
    terminal.on_estimate(answer(estimator, Estimate("no_contact")))
    terminal.on_event(0.0, "tare from [bold]100[/bold] readings")
    terminal.close()
    drawn = console.file.getvalue()
    assert "no_contact" in drawn and "from [bold]100[/bold] readings" in drawn
    assert drawn.index("\x1b[?25l") < drawn.rindex("\x1b[?25h")  # the cursor is back
