"""Content of the views: shape, ellipsoid, parts, status lines; unknown values are blank."""

import json
import math
import time
from collections import Counter
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
from rich.console import Console

from probedesign.core.frames import pose
from probedesign.core.statistics import ellipsoid_95
from probedesign.estimation.estimate import RESULTS, Estimate
from probedesign.geometry.tube import SIDES, BentShape, TubeMesh, centreline
from probedesign.live.blocks import Block, WrenchReading, dropout_block
from probedesign.live.processing.chain import ProcessingOptions
from probedesign.live.processing.estimates import EstimateUpdate, estimate_row, readable_line
from probedesign.live.processing.touches import Contact
from probedesign.live.run import estimate_stream
from probedesign.live.sources.sim import SimulatedSource
from probedesign.live.view.page import events_html, status_html
from probedesign.live.view.sinks import TerminalView, scene_setup, table_of
from probedesign.live.view.state import (
    STRIP,
    Event,
    PageSetup,
    Snapshot,
    StatusLine,
    StripCharts,
    ViewState,
    touch_points,
)
from probedesign.web.scene import RECORD, rigid_parts


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
    half_axes, axes = ellipsoid_95(root @ root.T)
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
            "the probe there has fingerprint 0",
        ),
        (lambda folder: (folder / "manifest.json").write_text("[]"), ""),
        (lambda folder: (folder / "clamp_ring.stl").write_bytes(b"solid"), "clamp_ring.stl is not a binary STL"),
        (lambda folder: (folder / "clamp_ring.stl").write_bytes(stl([])), "clamp_ring.stl is not a binary STL"),
        (lambda folder: (folder / "clamp_ring.stl").write_bytes(stl([[[math.inf] * 3] * 3])), "non-finite corner"),
        (lambda folder: (folder / "clamp_ring.stl").write_bytes(stl([[[0.0] * 3] * 3])[:-1]), "not a binary STL"),
    ],
)
def test_parts_of_another_probe_are_not_drawn_and_a_note_is_shown(estimator, folder, spoil, expected):
    spoil(folder)
    parts, note = rigid_parts(estimator.model, folder)
    assert [part.name for part in parts] == ["sensor", "flange", "adapter"]
    assert expected in note and "plain cylinders" in note and "\n" not in note


# words


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


ANSWERS: list[EstimateUpdate] = []  #: Those of a simulated touch, once for all tests.


def kept(estimator, clock: Clock) -> ViewState:
    """The state after a simulated run of eight seconds, on the clock of the run."""
    if not ANSWERS:
        source = SimulatedSource(estimator.model, "speed=max&rate_hz=10&seconds=8")
        ANSWERS.extend(estimate_stream(estimator, source, ProcessingOptions(), print))
    state, start = ViewState(clock=clock), clock.now
    for answer in ANSWERS:
        reading = answer.reading
        clock.now = start + reading.time
        now = np.array([reading.time])
        state.on_samples(Block(now, reading.wrench_sensor[None], reading.gravity_base, now))
        state.on_estimate(answer)
    return state


def of(snapshot: Snapshot) -> dict[str, StatusLine]:
    return {line.name: line for line in snapshot.status}


def answer(estimator, estimate: Estimate, time: float = 0.0, **more) -> EstimateUpdate:
    gravity = estimator.model.gravity_base
    return EstimateUpdate(WrenchReading(time, np.zeros(6), gravity), estimate, wrench_base=np.zeros(6), **more)


def test_a_contact_is_shown_with_its_units(estimator):
    snapshot = kept(estimator, Clock()).snapshot()
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
    ok = kept(estimator, Clock())._update.estimate
    state = ViewState()
    state.on_estimate(answer(estimator, Estimate(result, candidates=ok.candidates, force_base=ok.force_base)))
    snapshot = state.snapshot()
    assert snapshot.marker is None
    assert [of(snapshot)[name].text for name in ("contact", "point", "force")] == ["–"] * 3
    assert of(snapshot)["result"].text == f"{result}: {RESULTS[result]}"
    assert np.isnan(snapshot.strip[:, 7:10]).all()  # s, its standard deviation, the force


def test_a_light_touch_has_an_interval_and_no_place(estimator):
    estimate = Estimate("interval_only", solve_interval=lambda: (0.0612, 0.0949))
    state = ViewState()
    state.on_estimate(update := answer(estimator, estimate))
    snapshot = state.snapshot()
    assert snapshot.marker is None and of(snapshot)["contact"].text == "s between 61 and 95 mm"
    assert "  between 61 and 95 mm  " in readable_line(update) + "  "
    row = estimate_row(update.reading, estimate)
    assert (row["s_interval_95_low_mm"], row["s_interval_95_high_mm"]) == pytest.approx((61.2, 94.9))
    assert math.isnan(float(row["s_contact_mm"]))


def test_what_is_known_is_old_in_silence_and_without_estimates(estimator):
    clock = Clock()
    state = kept(estimator, clock)
    clock.now += 0.45  # not yet five gaps
    assert not state.snapshot().stale
    clock.now += 1.95
    snapshot = state.snapshot()
    assert snapshot.stale and of(snapshot)["result"] == StatusLine("result", "stale: no reading for 2.4 s", "bad")
    state.on_samples(dropout_block(estimator.model.gravity_base, "stale, no record", 0))
    assert of(state.snapshot())["fault"] == StatusLine("fault", "stale, no record", "bad")
    gravity = estimator.model.gravity_base
    for _ in range(100):  # readings without estimates
        clock.now += 0.1
        state.on_samples(Block(np.zeros(1), np.zeros((1, 6)), gravity, np.zeros(1)))
    assert "old" in of(state.snapshot())["result"].text and state.snapshot().stale


def test_loss_tare_and_recording_are_shown(estimator):
    recording = ["to a.mcap, 7 readings", ""]
    state = ViewState(lambda: {"lost": 3, "received": 10}, recording=lambda: tuple(recording))
    for line in ("tare from 100 readings", "mark: here"):
        state.on_event(1.0, line)
    snapshot = state.snapshot()
    words = of(snapshot)
    assert words["result"].text == "no reading yet" and snapshot.marker is None and snapshot.shape is None
    assert words["loss"] == StatusLine("loss", "3 lost of 0 readings", "fair")
    assert words["tare"].text == "from 100 readings"
    assert words["recording"] == StatusLine("recording", "to a.mcap, 7 readings", "good")
    assert state.snapshot().recording == "to a.mcap, 7 readings"
    recording[:] = "", "ended: No space left on device"
    assert of(state.snapshot())["recording"] == StatusLine("recording", recording[1], "bad")


def test_the_end_of_a_run_is_shown_without_a_green_banner(estimator):
    clock = Clock()
    state = kept(estimator, clock)
    fresh = status_html(state.snapshot())
    assert "pd-banner pd-good" in fresh and "pd-old" not in fresh
    state.on_end()
    clock.now += 12.0
    snapshot = state.snapshot()
    assert snapshot.stale and snapshot.age == pytest.approx(12.0)
    assert of(snapshot)["result"].text == "the run has ended: all values are 12.0 s old"
    assert "pd-good" not in status_html(snapshot).partition("</div>")[0]
    assert 'class="pd-old"' in status_html(snapshot)


def test_touches_marks_and_the_bias_are_in_the_curves_over_the_wall_clock(estimator):
    state = ViewState()
    for i, phase in enumerate(("free", "touching", "settled", "released")):
        drift = np.array([0.0, 3e-3, 0, 0, 0, 0])
        state.on_estimate(answer(estimator, Estimate("no_contact"), 1234.5 + i, phase=phase, drift_base=drift))
        if phase == "touching":
            state.on_event(0.0, "mark: here")
    snapshot = state.snapshot()
    columns = dict(zip(STRIP, snapshot.strip.T, strict=True))
    assert columns["touch"].tolist() == [0.0, 1.0, 1.0, 0.0] and columns["mark"].tolist() == [0.0, 0.0, 1.0, 0.0]
    assert columns["bias_y"].tolist() == [3e-3] * 4
    assert snapshot.time == 1237.5  # the table has the source's time
    # a second is ample for the lines above; the intervals are exact up to the rounding of seconds since 1970
    assert columns["time"][0] == pytest.approx(time.time(), abs=1.0)
    assert np.diff(columns["time"]) == pytest.approx([1.0] * 3, abs=1e-6)


def test_a_known_pose_puts_the_contact_into_the_world(estimator):
    found = kept(estimator, Clock())._update
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
        status=(StatusLine("fault", "<script>", "bad"),), events=(Event(math.nan, "mark: <img src=x>"),)
    )
    assert "<script>" not in status_html(snapshot) and "&lt;script&gt;" in status_html(snapshot)
    assert "<img" not in events_html(snapshot)


# charts


def test_charts_are_thinned_keep_the_last_seconds_every_mark_and_gaps():
    charts = StripCharts()
    rows = np.zeros((80_000, len(STRIP)))
    rows[:, 0] = 1.76e9 + np.arange(80_000) / 1000.0
    rows[::2, 7] = np.nan
    rows[70_001, -1] = 1.0
    assert charts.add(rows)
    columns = charts.columns()
    assert np.isnan(columns["s"]).any() and np.isfinite(columns["s"]).any()
    assert 400 <= len(columns["time"]) <= 450 and columns["mark"].sum() == 1.0
    assert columns["time"][-1] - columns["time"][0] <= 30.0 and columns["time"][-1] == pytest.approx(
        rows[-1, 0], abs=0.1
    )
    assert not charts.add(rows[:0])
    assert charts.add(np.zeros((1, len(STRIP))))  # another run's clock
    assert len(charts.columns()["time"]) == 1


@pytest.fixture
def page(estimator, tmp_path):
    pytest.importorskip("viser")
    from probedesign.live.view.page import ViewerPage

    scene = scene_setup(estimator, tmp_path, lambda line: None, (0.05, 1.0))
    page = ViewerPage(PageSetup("127.0.0.1", 8123, (scene, scene)), lambda name, text: None)
    page.show_first = lambda snapshot: page.show([snapshot, Snapshot()])
    yield page
    page.stop()


def test_old_curves_move_out_and_limits_are_lines(estimator, page):
    rows = np.zeros((31, len(STRIP)))
    rows[:, 0] = 1.76e9 + np.arange(31)
    page.show_first(Snapshot(strip=rows))
    page.show_first(Snapshot(result="ok", stale=True, age=5.0))
    plot = page._panel._charts[0][2]._plot  # force at the base
    assert plot.scales["x"]["range"] == (rows[-1, 0] + 5.0 - 30.0, rows[-1, 0] + 5.0)
    limit = 1e3 * estimator.model.wrench_range[:3].min()
    assert [plot.data[4][0], plot.data[5][0]] == [limit, -limit] and plot.scales["y"]["range"][1] < limit
    rows[:, 9] = 0.02  # a contact of 20 mN, of the guard's 50 mN
    page.show_first(Snapshot(strip=rows + 40.0 * (np.arange(len(STRIP)) == 0)))
    contact = page._panel._charts[0][1]._plot
    assert contact.data[2][0] == 50.0 and contact.scales["y"]["range"][1] > 50.0


def test_scene_and_charts_are_of_one_instant_and_stay_while_paused(estimator, page):
    update = kept(estimator, Clock())._update
    states = []
    for x in (0.1, 0.2):
        state = ViewState()
        state.on_estimate(answer(estimator, update.estimate, T_world_base=pose(p=(x, 0.0, 0.0))))
        states.append(state.snapshot())
    page.show_first(states[0])
    bent_vertices = page._scenes[0]._probe.vertices.copy()  # viser writes into its own array
    page._panel._toggle()
    page.show_first(states[1])
    assert page._scenes[0]._base.position[0] == pytest.approx(20.0 * 0.1) and np.array_equal(
        page._scenes[0]._probe.vertices, bent_vertices
    )
    page._panel._toggle()
    page.show_first(states[1])
    assert page._scenes[0]._base.position[0] == pytest.approx(20.0 * 0.2)  # 20 units of the scene are a metre
    # No shape of an earlier instant is drawn at a pose of this one: the free probe, in grey.
    page.show_first(replace(states[0], result="inconsistent", shape=None, marker=None))
    assert not np.allclose(page._scenes[0]._probe.vertices, bent_vertices)
    assert page._scenes[1]._base.position[2] > 1.0  # the other probe, of unknown pose, stands aside
    assert tuple(page._scenes[0]._probe.color) == (150, 150, 150) and not page._scenes[0]._contact.visible
    # Of three touches the second was not located, and the third goes on.
    touches = (
        Contact(1, 0.0, 1.0, estimate=update.estimate),
        Contact(2, 2.0, 3.0),
        Contact(3, 4.0, estimate=update.estimate),
    )
    page.show_first(Snapshot(result="no_contact", touches=touch_points(touches)))
    assert [label.text for mark, label in page._scenes[0]._marks if mark.visible] == ["1"]


# terminal


def test_the_terminal_shows_the_status_and_is_left_as_it_was(estimator):
    snapshot = kept(estimator, Clock()).snapshot(shaped=False)
    console = Console(file=StringIO(), force_terminal=True, width=120, height=40)
    console.print(table_of("large", snapshot))
    terminal = TerminalView({"": ViewState()}, ["large"], console=console)
    terminal.on_estimate(answer(estimator, Estimate("no_contact")))
    terminal.on_event(0.0, "tare from [bold]100[/bold] readings")
    terminal.close()
    drawn = console.file.getvalue()
    assert all(line.text in drawn for line in snapshot.status)
    assert "no_contact" in drawn and "from [bold]100[/bold] readings" in drawn
    assert drawn.index("\x1b[?25l") < drawn.rindex("\x1b[?25h")  # the cursor is back
