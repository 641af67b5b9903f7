"""The page, served by viser: a 3D scene, panels with status text and buttons, strip charts, and their style.

All text from outside is escaped.
"""

import math
import time
from collections.abc import Callable, Iterable
from html import escape

import numpy as np
import viser
import viser.transforms as tf
from viser import uplot

from probedesign.core.frames import Array
from probedesign.core.statistics import ellipsoid_95
from probedesign.core.units import MM
from probedesign.live.processing.estimates import ContactMarker
from probedesign.live.view.state import CHART_SECONDS, SceneSetup, Snapshot, StripCharts
from probedesign.web.guard import LoopbackServer
from probedesign.web.scene import (
    ARROW,
    CONTACT,
    METAL,
    MIN_HALF_AXIS,
    PART_COLOURS,
    PROBE,
    SPREAD,
    STALE_COLOUR,
    UNIT,
    level_rotation,
    quaternion,
)

#: Colours of levels, readable on light and on dark ground.
STYLE = """
:root { --pd-good: #1b7f4b; --pd-fair: #9a5b00; --pd-bad: #b3261e; --pd-plain: #46525e; --pd-dim: #66717c; }
[data-mantine-color-scheme="dark"] { --pd-dim: #9aa5b0; }
.pd { padding: 4px 12px; font-size: 13px; line-height: 1.4; font-variant-numeric: tabular-nums; }
.pd table { width: 100%; border-collapse: collapse; }
.pd td { vertical-align: top; padding: 0; }
.pd td:first-child { color: var(--pd-dim); padding-right: 10px; white-space: nowrap; }
.pd-small { font-size: 12px; }
.pd-banner { color: white; border-radius: 6px; padding: 7px 10px; margin-bottom: 6px; font-size: 14px;
  font-weight: 600; }
.pd-banner.pd-good { background: var(--pd-good); } .pd-banner.pd-fair { background: var(--pd-fair); }
.pd-banner.pd-bad { background: var(--pd-bad); } .pd-banner.pd-plain { background: var(--pd-plain); }
td.pd-good, td.pd-fair, td.pd-bad { font-weight: 600; }
td.pd-good { color: var(--pd-good); } td.pd-fair { color: var(--pd-fair); } td.pd-bad { color: var(--pd-bad); }
[data-mantine-color-scheme="dark"] td.pd-good { color: #4fc78a; }
[data-mantine-color-scheme="dark"] td.pd-fair { color: #f0b050; }
[data-mantine-color-scheme="dark"] td.pd-bad { color: #ff8a80; }
.pd-old td { opacity: 0.45; } .pd-old td.pd-now { opacity: 1; }
.pd-rec { color: #d3302f; font-weight: 700; }
[data-mantine-color-scheme="dark"] .pd-rec { color: #ff6b6b; }
[data-mantine-color-scheme="dark"] .u-title { color: #c8d0d8; }
.u-title { font-size: 12px !important; line-height: 1.5; font-weight: 600; }
#pd-lost { display: none; position: fixed; z-index: 10000; top: 0; left: 0; right: 0; background: #b3261e;
  color: white; font: 600 15px sans-serif; padding: 10px 14px; text-align: center; }
.pd-lost #pd-lost { display: block; }
.pd-lost .pd { filter: grayscale(1); opacity: 0.45; } .pd-lost .pd-banner { background: var(--pd-plain) !important; }
.pd-lost canvas, .pd-lost .uplot { filter: grayscale(1); opacity: 0.45; }
"""

LOST_SECONDS = 3  #: Age from which the values of a page are lost [s]; the server renews them every second.
#: Marks all values as old when the server has not renewed them for a while.
SCRIPT = """
(function () {
  var beat = null, since = Date.now(), bar = null;
  setInterval(function () {
    var status = document.querySelector('[data-beat]'), now = Date.now();
    if (status && status.dataset.beat !== beat) { beat = status.dataset.beat; since = now; }
    var age = Math.round((now - since) / 1000), lost = beat !== null && age >= LOST_SECONDS;
    if (!bar && document.body) {
      bar = document.createElement('div'); bar.id = 'pd-lost'; bar.setAttribute('role', 'alert');
      document.body.appendChild(bar);
    }
    document.documentElement.classList.toggle('pd-lost', lost);
    if (lost) bar.textContent = 'Connection to the run lost: all values are ' + age + ' s old';
  }, 500);
})();
""".replace("LOST_SECONDS", str(LOST_SECONDS))

MAX_SHOWN = 8  #: Maximum number of events and touches on the page: the last ones.
#: Status lines that describe the run itself: they are current even if the values are old.
CURRENT = ("rate", "loss", "fault", "tare", "recording")


def status_html(snapshot: Snapshot, beat: int = 0) -> str:
    """Return the result on a coloured background and the other lines in two columns; old values are faded.

    `beat` changes while the page is alive: the browser marks everything as old if it does not.
    """
    if not snapshot.status:
        return ""
    first, *rest = snapshot.status
    rows = ""
    for line in rest:
        now = " pd-now" if line.name in CURRENT else ""
        rows += f'<tr><td class="pd-name{now}">{escape(line.name)}</td>'
        rows += f'<td class="pd-{line.level}{now}">{escape(line.text)}</td></tr>'
    old = ' class="pd-old"' if snapshot.stale else ""
    recording = f'<div class="pd-rec">● recording {escape(snapshot.recording)}</div>' if snapshot.recording else ""
    return (
        f'<div class="pd" data-beat="{beat}"><div class="pd-banner pd-{first.level}">{escape(first.text)}</div>'
        f"{recording}<table{old}>{rows}</table></div>"
    )


def events_html(snapshot: Snapshot) -> str:
    """Return the last events, newest first."""
    times = [f"{event.time:.1f} s" if math.isfinite(event.time) else "" for event in snapshot.events]
    rows = [f"<tr><td>{t}</td><td>{escape(e.line)}</td></tr>" for t, e in zip(times, snapshot.events, strict=True)]
    return f'<div class="pd pd-small"><table>{"".join(reversed(rows))}</table></div>'


def touches_html(touches: tuple[ContactMarker, ...]) -> str:
    """Return the earlier touches, newest first."""
    if not touches:
        return '<div class="pd pd-small">none yet; added when a touch ends</div>'
    rows = "<tr><td>no.</td><td>s ± std [mm]</td><td>x, y, z [mm]</td><td>frame</td></tr>"
    for marker in reversed(touches[-MAX_SHOWN:]):
        x, y, z = (f"{float(value) / MM:z.1f}" for value in marker.p_surface)
        rows += f"<tr><td>{marker.number}</td><td>{marker.s / MM:.1f} ± {marker.std_s / MM:.1f}</td>"
        rows += f"<td>{x}, {y}, {z}</td><td>{'world' if marker.in_world else 'base'}</td></tr>"
    return f'<div class="pd pd-small"><table>{rows}</table></div>'


#: Colours of x, y and z.
AXIS_COLOURS = ("#d1495b", "#2e8b57", "#2a6fbb")
#: Colours of an estimate and of the ends of its interval.
INTERVAL_COLOURS = ("#c81e28", "#e9a3a8", "#e9a3a8")
#: An axis whose colours are readable on light and on dark ground.
AXIS: uplot.Axis = {"stroke": "#808b96", "grid": {"stroke": "rgba(128,139,150,0.22)", "width": 1},
                    "ticks": {"show": False}, "font": "11px sans-serif", "size": 24}  # fmt: skip
HEIGHT = 142
STATUS_WIDTH, CHARTS_WIDTH = 350.0, 300.0  #: Widths of the panels [px]: of 1100, 450 are left for the scene.


WINDOW = (-CHART_SECONDS, 0.0)  #: Range of the charts [s], before now.


class Panel:
    """Status text, charts and buttons."""

    def __init__(
        self, server: viser.ViserServer, send_command: Callable[[str, str], None], note: str, length: float
    ) -> None:
        """Create the panels; `note` is on what is drawn, `length` that of the probe [m]."""
        self._length_mm = length / MM
        gui = server.gui
        gui.main_panel.dock_right()
        gui.main_panel.set_width(STATUS_WIDTH)
        self._texts = [gui.add_html("")]
        tare = gui.add_button("Tare: the probe is free", icon=viser.Icon.SCALE)
        tare.on_click(lambda _: send_command("tare", ""))
        text = gui.add_text("Note", "")
        mark = gui.add_button("Mark this time", icon=viser.Icon.FLAG)
        mark.on_click(lambda _: send_command("mark", text.value))
        self._start = gui.add_button("Start recording", icon=viser.Icon.PLAYER_RECORD, color="red")
        self._start.on_click(lambda _: send_command("start recording", ""))
        self._stop = gui.add_button("Stop recording", icon=viser.Icon.PLAYER_STOP, color="gray")
        self._stop.on_click(lambda _: send_command("stop recording", ""))
        self._stop.disabled = True
        for title in ("Events", "Touches so far"):
            with gui.add_folder(title):
                self._texts.append(gui.add_html(""))
        if note:
            gui.add_markdown(note)
        strips = gui.add_panel()
        with strips.add_tab("Last 15 s, 0 is now"):
            self._charts = {
                "place": _chart(gui, "s of the contact, 95 % [mm]", ("s", "from", "to"), dots=True),
                "push": _chart(gui, "force of the contact [mN]", ("F",), dots=True),
                "forces": _chart(gui, "base force [mN]: x red, y green, z blue", ("Fx", "Fy", "Fz")),
                "moments": _chart(gui, "base moment [N·mm]: x, y, z", ("Mx", "My", "Mz")),
            }
        strips.dock_left()
        strips.set_width(CHARTS_WIDTH)

    def show(self, recording: bool, *texts: str) -> None:
        """Update status, events and touches, and enable the button that applies, where they have changed."""
        if recording != self._start.disabled:
            self._start.disabled, self._stop.disabled = recording, not recording
        for shown, text in zip(self._texts, texts, strict=True):
            if shown.content != text:
                shown.content = text

    def draw(self, charts: StripCharts, age: float) -> None:
        """Draw the charts, whose last row has an age [s]."""
        for name, data in charts.lines(age).items():
            chart = self._charts[name]
            chart.data = tuple(np.ascontiguousarray(line, dtype=np.float64) for line in data)
            y = (0.0, 1.05 * self._length_mm) if name == "place" else _range(data[1:])
            chart.scales = {"x": {"time": False, "range": WINDOW}, "y": {"range": y}}


def _range(lines: Iterable[Array]) -> tuple[float, float]:
    values = np.concatenate(list(lines))
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 0.0)
    margin = max(0.1 * (high - low), 0.5)
    return low - margin, high + margin


def _chart(gui: viser.GuiApi, title: str, names: tuple[str, ...], dots: bool = False) -> viser.GuiUplotHandle:
    """Create an empty chart over time; dots instead of lines if values may be missing in between."""
    empty = np.array([np.nan])
    series = [uplot.Series(label="t [s]")]
    for i, (name, colour) in enumerate(zip(names, INTERVAL_COLOURS if dots else AXIS_COLOURS, strict=False)):
        size = 2.5 if i else 3.5
        drawn: uplot.Series_Points = {"show": dots, "size": size, "fill": colour, "stroke": colour}
        series.append(uplot.Series(label=name, stroke=colour, width=0.0 if dots else 1.6, points=drawn))
    return gui.add_uplot(
        data=(empty,) * (1 + len(names)),
        series=tuple(series),
        title=title,
        scales={"x": {"time": False, "range": WINDOW}, "y": {"auto": True}},
        padding=(0, 10, 0, 0),
        axes=({**AXIS}, {**AXIS, "size": 40}),
        legend={"show": False},
        height=HEIGHT,
    )


MAX_MARKS = 24  #: Maximum number of earlier touches that are drawn.
LABEL_GAP = 0.012  #: Minimum distance between two numbered touches [m].
FIELD_OF_VIEW = math.radians(40.0)
#: Distance of the camera at least, and width of the scene that is shown at least, in lengths of the probe.
DISTANCE, SHOWN_WIDTH = 2.5, 1.6
#: Distance beside the middle of the view [lengths of the probe] from which a label extends toward the middle, and so is
#: not behind a panel or beyond the edge of a small screen.
LABEL_SIDE = 0.2
#: Size of the label of the contact at most, on a small screen [lengths of the probe]; numbers below it are hidden.
LABEL_WIDTH, LABEL_HEIGHT = 0.7, 0.08
SMALL_WIDTH = 576  #: Width [px] up to which viser covers the lower part of the scene with its panel.
AGEING = 0.5  #: Interval in which the charts of old data are drawn again [s].


class ViewerPage:
    """Shows one snapshot after another in every connected browser."""

    def __init__(self, setup: SceneSetup, send_command: Callable[[str, str], None]) -> None:
        """Start the server and show the free probe; `send_command` receives a command and its text."""
        self._setup, self._charts = setup, StripCharts()
        self._drawn_age = 0.0
        self._server = server = LoopbackServer(setup.host, setup.port, setup.title, verbose=False)
        server.gui.configure_theme(
            show_logo=False, show_share_button=False, control_width="large", brand_color=(38, 84, 124)
        )
        self._scene()
        self._panel = Panel(server, send_command, setup.note, float(setup.tube.s[-1]))
        self._set_camera()
        server.on_client_connect(self._frame)

    @property
    def url(self) -> str:
        """Address of the page."""
        host = f"[{self._setup.host}]" if ":" in self._setup.host else self._setup.host
        return f"http://{host}:{self._server.get_port()}"

    def stop(self) -> None:
        """Stop the server."""
        self._server.stop()

    def show(self, snapshot: Snapshot) -> None:
        """Show a snapshot in one update."""
        with self._server.atomic():
            self._show_probe(snapshot)
            self._show_contact(snapshot)
            self._show_touches(snapshot.touches)
            status, touches = status_html(snapshot, int(time.monotonic())), touches_html(snapshot.touches)
            self._panel.show(bool(snapshot.recording), status, events_html(snapshot), touches)
            age = snapshot.age if snapshot.stale and math.isfinite(snapshot.age) else 0.0
            if self._charts.add(snapshot.strip) or abs(age - self._drawn_age) > AGEING:
                self._panel.draw(self._charts, age)
                self._drawn_age = age
        self._server.flush()

    def _scene(self) -> None:
        """Create all objects, invisible if their content is unknown."""
        scene, setup = self._server.scene, self._setup
        scene.set_up_direction("+z")
        # Reflections of an environment and shadows take nine tenths of a frame's time in a browser without a GPU.
        scene.configure_environment_map(None)
        scene.configure_default_lights(True, cast_shadow=False)
        scene.add_light_hemisphere("/sky", ground_color=(150, 150, 150), intensity=2.5)
        self._base = scene.add_frame("/base", show_axes=False)
        for part in setup.parts:
            colour, name = PART_COLOURS.get(part.name, METAL), f"/base/{part.name}"
            scene.add_mesh_simple(
                name, UNIT * part.vertices, part.faces, color=colour, flat_shading=True, cast_shadow=False
            )
        free = UNIT * setup.tube.vertices(setup.free)
        self._probe = scene.add_mesh_simple(
            "/base/probe", free, setup.tube.faces, color=PROBE, opacity=0.42, side="double", cast_shadow=False
        )
        self._contact = scene.add_icosphere("/contact", UNIT * 1.5e-3, CONTACT, visible=False, cast_shadow=False)
        # Opaque: a translucent object inside another is drawn or not, depending on the camera.
        self._spread = scene.add_icosphere("/spread", 1.0, SPREAD, visible=False, cast_shadow=False)
        self._force = scene.add_arrows(
            "/force", np.zeros((1, 2, 3)), CONTACT, shaft_radius=UNIT * 0.6e-3, head_radius=UNIT * 1.6e-3,
            head_length=UNIT * 4e-3, visible=False,
        )  # fmt: skip
        self._label = scene.add_label("/contact_label", "", anchor="bottom-center", visible=False)
        size = UNIT * 1.5e-3
        self._marks = [
            (
                scene.add_icosphere(f"/touch/{i}", size, STALE_COLOUR, visible=False, cast_shadow=False),
                scene.add_label(f"/touch/{i}/number", "", font_screen_scale=0.8, visible=False),
            )
            for i in range(MAX_MARKS)
        ]

    def _set_camera(self) -> None:
        """Place the camera beside and slightly above the free probe, with a floor below."""
        free, length = self._setup.free, float(self._setup.tube.s[-1])
        T = level_rotation(self._setup.gravity_base)
        self._base.wxyz = quaternion(T)
        p = free.p_base @ T.T
        low = float(min(p[:, 2].min(), -0.04)) - 0.25 * length
        self._server.scene.add_grid(
            "/floor", UNIT * 0.6, UNIT * 0.6, cell_size=UNIT * 0.01, section_size=UNIT * 0.05,
            cell_color=(150, 156, 162), section_color=(124, 132, 140), plane_opacity=0.0, shadow_opacity=0.0,
            position=(0.0, 0.0, UNIT * low),
        )  # fmt: skip
        along = T[:, 2]
        self._middle = UNIT * (0.5 * (p[0] + p[-1]) - 0.02 * along)
        side = np.cross(along, (0.0, 0.0, 1.0))
        side = side / np.linalg.norm(side) if np.linalg.norm(side) > 0.2 else np.array([0.0, -1.0, 0.0])
        self._direction = 2.3 * side + np.array([0.0, 0.0, 0.8]) + 0.5 * along
        self._direction /= np.linalg.norm(self._direction)
        camera = self._server.initial_camera
        camera.fov = FIELD_OF_VIEW
        camera.look_at = self._middle
        camera.position = self._middle + UNIT * length * DISTANCE * self._direction

    def _frame(self, client: viser.ClientHandle) -> None:
        """Move the camera of a browser so far away that the whole probe fits between the panels.

        On a small screen, whose lower part the panel covers, the probe is in the upper part.
        """
        small = client.camera.image_width <= SMALL_WIDTH
        panels = 0.0 if small else STATUS_WIDTH + CHARTS_WIDTH  # they open later
        aspect = max(client.camera.image_width - panels, 1.0) / max(client.camera.image_height, 1)
        tangent, length = math.tan(0.5 * FIELD_OF_VIEW), float(self._setup.tube.s[-1])
        distance = UNIT * length * max(DISTANCE, 0.5 * SHOWN_WIDTH / (tangent * max(aspect, 0.1)))
        shift = np.array([0.0, 0.0, 0.5 * tangent * distance]) if small else np.zeros(3)
        client.camera.position = self._middle - shift + distance * self._direction
        client.camera.look_at = self._middle - shift  # last: the position moves it too

    def _show_probe(self, snapshot: Snapshot) -> None:
        """Show the estimated shape; grey and unchanged if it is unknown."""
        T = np.eye(4)  # of the base in the scene: in the world, or upright by gravity if it is unknown
        if np.isfinite(snapshot.T_world_base).all():
            T = snapshot.T_world_base
        else:
            T[:3, :3] = level_rotation(snapshot.gravity_base)
        self._base.wxyz, self._base.position = quaternion(T[:3, :3]), UNIT * T[:3, 3]
        if snapshot.shape is not None:
            self._probe.vertices = (UNIT * self._setup.tube.vertices(snapshot.shape)).astype(np.float32)
        current = (snapshot.shape is not None and not snapshot.stale) or not snapshot.result
        self._probe.color = PROBE if current else STALE_COLOUR

    def _scene_transform(self, marker: ContactMarker) -> tuple[Array, Array]:
        if marker.in_world:
            return np.eye(3), np.zeros(3)
        T = self._base
        return np.asarray(tf.SO3(np.asarray(T.wxyz)).as_matrix(), dtype=float), np.asarray(T.position) / UNIT

    def _show_contact(self, snapshot: Snapshot) -> None:
        """Show the contact, its 95 % ellipsoid and its force; grey and labelled old if it is not current."""
        marker = snapshot.marker
        shown = marker is not None
        self._contact.visible = self._label.visible = shown
        self._spread.visible = self._force.visible = shown and not snapshot.stale
        if marker is None:
            return
        R, origin = self._scene_transform(marker)
        surface = R @ marker.p_surface + origin
        half_axes, axes = ellipsoid_95(R @ marker.cov @ R.T)
        self._contact.position = self._spread.position = UNIT * surface
        self._spread.scale = tuple(UNIT * np.maximum(half_axes, MIN_HALF_AXIS))
        self._spread.wxyz = quaternion(axes)
        force = R @ marker.force
        strength = float(np.linalg.norm(force))
        tail = surface - ARROW * force / strength
        self._force.points = (UNIT * np.array([[tail, surface]])).astype(np.float32)
        self._contact.color = STALE_COLOUR if snapshot.stale else CONTACT
        self._label.position = UNIT * tail
        beside, _ = self._in_view(UNIT * tail)
        self._label.anchor = (
            "bottom-center" if abs(beside) < LABEL_SIDE else "bottom-right" if beside > 0.0 else "bottom-left"
        )
        position = f"s {1e3 * marker.s:.1f} ± {1e3 * marker.std_s:.1f} mm"
        fresh = f"{position}, {1e3 * strength:.1f} mN"
        self._label.text = f"{snapshot.age:.0f} s old: {position}" if snapshot.stale else fresh

    def _in_view(self, position: Array) -> tuple[float, float]:
        right = np.cross(-self._direction, (0.0, 0.0, 1.0))
        right /= np.linalg.norm(right)
        away = (position - self._middle) / (UNIT * float(self._setup.tube.s[-1]))
        return float(away @ right), float(away @ np.cross(self._direction, right))

    def _is_covered(self, position: Array) -> bool:
        if not self._label.visible:
            return False
        (x, y), (x0, y0) = self._in_view(position), self._in_view(np.asarray(self._label.position))
        left = {"bottom-left": 0.0, "bottom-center": -0.5 * LABEL_WIDTH}.get(self._label.anchor, -LABEL_WIDTH)
        return 0.0 < x - x0 - left < LABEL_WIDTH and -0.5 * LABEL_HEIGHT < y - y0 < 1.5 * LABEL_HEIGHT

    def _show_touches(self, touches: tuple[ContactMarker, ...]) -> None:
        """Show earlier contacts in grey, with the numbers of those that no later one covers."""
        shown = touches[-MAX_MARKS:]
        points = [R @ marker.p_surface + origin for marker in shown for R, origin in [self._scene_transform(marker)]]
        for i, ((mark, number), marker) in enumerate(zip(self._marks, shown, strict=False)):
            mark.visible, mark.position = True, UNIT * points[i]
            apart = all(np.linalg.norm(later - points[i]) > LABEL_GAP for later in points[i + 1 :])
            number.visible = apart and not self._is_covered(UNIT * points[i])
            number.text = f"{marker.number}"
