"""Content of the views: shape, ellipsoid, parts, status lines; unknown values are blank."""

import json
import math
from collections import Counter
from dataclasses import replace
from io import StringIO
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from probedesign.core.frames import pose
from probedesign.core.statistics import ellipsoid_95
from probedesign.estimation.estimate import RESULTS, Estimate
from probedesign.geometry.tube import SIDES, BentShape, TubeMesh, centreline
from probedesign.live.blocks import Block, WrenchReading
from probedesign.live.processing.chain import ProcessingOptions
from probedesign.live.processing.estimates import ContactMarker, EstimateUpdate, estimate_row, readable_line
from probedesign.live.run import estimate_stream
from probedesign.live.sources.sim import SimulatedSource
from probedesign.live.view.page import events_html, status_html
from probedesign.live.view.sinks import TerminalView, scene_setup, table_of
from probedesign.live.view.state import MAX_EVENTS, STRIP, Event, Snapshot, StatusLine, StripCharts, ViewState
from probedesign.web.scene import RECORD, read_stl, rigid_parts


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
        (lambda folder: (folder / "manifest.json").write_text('{"fingerprint": "0"}'), "they belong to probe 0"),
        (lambda folder: (folder / "manifest.json").write_text("[]"), ""),
        (lambda folder: (folder / "clamp_ring.stl").write_bytes(b"solid"), "clamp_ring.stl is not a binary STL"),
        (lambda folder: (folder / "clamp_ring.stl").write_bytes(stl([])), "clamp_ring.stl is not a binary STL"),
        (lambda folder: (folder / "clamp_ring.stl").write_bytes(stl([[[math.inf] * 3] * 3])), "non-finite corner"),
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
    for answer in estimate_stream(estimator, SimulatedSource(estimator.model, query), ProcessingOptions(), print):
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
    return EstimateUpdate(WrenchReading(time, np.zeros(6), gravity), estimate, wrench_base=np.zeros(6), **more)


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


def test_a_light_touch_has_an_interval_and_no_place(estimator):
    estimate = Estimate("interval_only", solve_interval=lambda: (0.0612, 0.0949))
    state = ViewState()
    state.on_estimate(update := answer(estimator, estimate))
    snapshot = state.snapshot()
    assert snapshot.marker is None and of(snapshot)["contact"].text == "s between 61 and 95 mm"
    assert "  between 61 and 95 mm  " in readable_line(0.0, update.reading, estimate) + "  "
    row = estimate_row(update.reading, estimate)
    assert (row["s_interval_95_low_mm"], row["s_interval_95_high_mm"]) == pytest.approx((61.2, 94.9))
    assert math.isnan(float(row["s_contact_mm"]))


def test_silence_is_stale_and_what_is_known_is_old(estimator):
    clock = Clock()
    state = kept(estimator, "speed=max&rate_hz=10&seconds=8", clock)
    clock.now += 0.45  # not yet five gaps
    assert not state.snapshot().stale
    clock.now += 1.95
    snapshot = state.snapshot()
    assert snapshot.stale and of(snapshot)["result"] == StatusLine("result", "stale: no reading for 2.4 s", "bad")


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
    recording = ["to a.mcap, 7 readings", ""]
    state = ViewState(lambda: {"lost": 3, "received": 10}, recording=lambda: tuple(recording))
    for line in ("tare from 100 readings", "mark: here"):
        state.on_event(1.0, line)
    words = of(state.snapshot())
    assert words["loss"] == StatusLine("loss", "3 lost of 0 readings", "fair")
    assert words["tare"].text == "from 100 readings"
    assert words["recording"] == StatusLine("recording", "to a.mcap, 7 readings", "good")
    assert state.snapshot().recording == "to a.mcap, 7 readings"
    assert "● recording to a.mcap" in status_html(state.snapshot())
    recording[:] = "", "ended: No space left on device"
    assert of(state.snapshot())["recording"] == StatusLine("recording", recording[1], "bad")
    assert "●" not in status_html(state.snapshot())


def test_tares_and_marks_stay_visible_among_many_other_events():
    state = ViewState()
    state.on_event(1.0, "tare from 100 readings")
    state.on_event(2.0, "mark: third card")
    for i in range(300):
        state.on_event(3.0 + i, f"touch {i}, {i}.02 ... {i}.90 s: single reading: s {i}.5 mm")
        state.on_event(3.5 + i, f"192.168.1.1: {i} records lost on the way")
    events = state.snapshot().events
    assert [event.line[:4] for event in events[:2]] == ["tare", "mark"]
    assert len(events) == 2 + MAX_EVENTS and events[-2].line.startswith("touch 299,")
    assert "touch 299, 299.02" in events_html(state.snapshot())


def test_the_end_of_a_run_is_shown_without_a_green_banner(estimator):
    clock = Clock()
    state = kept(estimator, "speed=max&rate_hz=10&seconds=8", clock)
    fresh = status_html(state.snapshot())
    assert "pd-banner pd-good" in fresh and "pd-old" not in fresh
    state.on_end()
    clock.now += 12.0
    snapshot = state.snapshot()
    assert snapshot.stale and snapshot.age == pytest.approx(12.0)
    assert of(snapshot)["result"].text == "the run has ended: all values are 12.0 s old"
    assert "pd-good" not in status_html(snapshot).partition("</div>")[0]
    assert 'class="pd-old"' in status_html(snapshot)


def test_every_old_value_is_faded_and_what_is_current_is_not(estimator):
    clock = Clock()
    state = kept(estimator, "speed=max&rate_hz=10&seconds=8", clock)
    clock.now += 60.0
    html = status_html(state.snapshot())
    assert 'class="pd-old"' in html and "pd-banner pd-bad" in html and "stale: no reading for 60.0 s" in html
    for name in ("contact", "point", "force", "forces", "moments", "phase"):
        assert f'<td class="pd-name">{name}</td>' in html
    for name in ("rate", "loss", "tare", "recording"):
        assert f'<td class="pd-name pd-now">{name}</td>' in html


def test_time_is_that_of_the_source(estimator):
    """The same clock as in JSON, CSV and events."""
    update = answer(estimator, Estimate("no_contact"), 1234.5)
    state = ViewState()
    state.on_estimate(update)
    snapshot = state.snapshot()
    assert snapshot.time == 1234.5 and snapshot.strip[0, 0] == 1234.5
    assert readable_line(update.reading.time, update.reading, update.estimate).split()[0] == "1234.50"


def test_each_touch_is_stored_once_with_its_best_contact(estimator):
    """Two touches of a run without phases: of each the place of the least standard deviation."""
    query = "speed=max&rate_hz=10&seconds=23&period_s=10"
    snapshot = kept(estimator, query, Clock()).snapshot()
    assert [place.number for place in snapshot.touches] == [1, 2]
    answers = list(estimate_stream(estimator, SimulatedSource(estimator.model, query), ProcessingOptions(), print))
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
        status=(StatusLine("fault", "<script>", "bad"),),
        events=(Event(math.nan, "mark: <img src=x>"),),
        recording="<b>",
    )
    assert "<script>" not in status_html(snapshot) and "&lt;script&gt;" in status_html(snapshot)
    assert "<img" not in events_html(snapshot) and "<b>" not in status_html(snapshot)


# charts


def test_charts_are_thinned_keep_the_last_seconds_and_leave_gaps():
    charts = StripCharts()
    rows = np.zeros((40_000, len(STRIP)))
    rows[:, 0] = np.arange(40_000) / 1000.0
    rows[::2, 7] = np.nan
    assert charts.add(rows)
    time, s, low, high = charts.lines()["place"]
    assert np.isnan([s, low, high]).any() and np.isfinite([s, low, high]).any()
    assert 400 <= len(time) <= 450 and time[-1] == 0.0 and time[0] >= -15.0
    assert charts.lines(age=5.0)["push"][0][-1] == -5.0  # old data move out of the chart
    assert np.isnan(charts.lines(age=16.0)["push"][0]).all()
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


def test_the_label_of_a_contact_extends_toward_the_middle_of_the_view(estimator, tmp_path):
    """A panel or the edge of the screen covers what extends outward."""
    pytest.importorskip("viser")
    from probedesign.live.view.page import ViewerPage

    page = ViewerPage(scene_setup(estimator, tmp_path, "127.0.0.1", 8123, lambda line: None), lambda name, text: None)
    free = estimator.free()
    g, anchors = estimator.model.gravity_base, []
    side = np.cross(g, (0.0, 0.0, 1.0))
    try:
        for part in (0.1, 0.5, 0.95):
            s = part * estimator.model.rod.length
            marker = ContactMarker(
                free.p_at(s), 1e-6 * np.eye(3), 0.02 * side / np.linalg.norm(side), s, 1e-3, False, 0.0, 1
            )
            page.show(Snapshot(result="ok", marker=marker, gravity_base=g))
            anchors.append(page._label.anchor)
            # numbers of earlier touches are hidden below the label only
            inward = {"bottom-left": 1.0, "bottom-center": 0.0, "bottom-right": -1.0}[page._label.anchor]
            here, right = np.asarray(page._label.position), np.cross(-page._direction, (0.0, 0.0, 1.0))
            step = 2.0 * right / np.linalg.norm(right)  # a tenth of a metre, two thirds of the probe
            assert page._is_covered(here + 0.5 * inward * step)
            assert not page._is_covered(here - inward * step + (0.0, 0.0, -2.0))
    finally:
        page.stop()
    # The first view has the root on one side and the tip on the other.
    assert anchors == ["bottom-left", "bottom-center", "bottom-right"]


@pytest.mark.parametrize(("width", "height"), [(1100, 650), (1280, 720), (1920, 1080), (390, 844)])
def test_the_whole_probe_is_framed_between_the_panels(estimator, tmp_path, width, height):
    """The size is that of the window, which the panels of a large screen then make narrower."""
    pytest.importorskip("viser")
    from viser.transforms import SO3

    from probedesign.live.view import page as view_page

    page = view_page.ViewerPage(
        scene_setup(estimator, tmp_path, "127.0.0.1", 8123, lambda line: None), lambda name, text: None
    )
    camera = SimpleNamespace(image_width=width, image_height=height, aspect=width / height)
    try:
        page._frame(SimpleNamespace(camera=camera))
        vertices = np.asarray(page._probe.vertices) @ SO3(np.asarray(page._base.wxyz)).as_matrix().T
    finally:
        page.stop()
    forward = np.asarray(camera.look_at) - camera.position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    off = vertices - camera.position
    panels = view_page.STATUS_WIDTH + view_page.CHARTS_WIDTH if width > view_page.SMALL_WIDTH else 0.0
    half = np.tan(0.5 * view_page.FIELD_OF_VIEW)
    assert (np.abs(off @ right) < half * (width - panels) / height * (off @ forward)).all()
    up = np.cross(right, forward)
    lowest = 0.0 if width <= view_page.SMALL_WIDTH else -half  # a sheet covers the lower half of a telephone
    assert (off @ up > lowest * (off @ forward)).all() and (off @ up < half * (off @ forward)).all()
