"""The page, served by viser: a 3D scene, a panel with status and buttons, strip charts, and their style.

It is a small instrument: what a history needs (scrolling back, zoom, cursors, export) is left to Foxglove, see
docs/decisions/0020-the-page-is-an-instrument.md. All text from outside is escaped.

It runs in a process of its own, so that drawing and browsers never delay the estimator. Its standard input receives a
pickled `PageSetup`, then one list of snapshots after another; its standard output returns lines of JSON: the URL of the
page, commands of the user, or an error. It ends with its input.
"""

import json
import logging
import math
import os
import pickle
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from html import escape
from threading import Lock

import numpy as np
import viser
from viser import uplot

from probedesign.core.frames import Array
from probedesign.core.statistics import ellipsoid_95
from probedesign.core.units import MILLINEWTON, MM, N_MM
from probedesign.live.processing.payload import Guide
from probedesign.live.view.state import CHART_SECONDS, CLOUD, MAX_TOUCHES, PageSetup, SceneSetup, Snapshot, StripCharts
from probedesign.web.guard import LoopbackServer, protect
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
    Stage,
    arrow,
    level_rotation,
    quaternion,
)

#: Colours of levels, readable on light and on dark ground.
STYLE = """
:root { --pd-good: #1b7f4b; --pd-fair: #9a5b00; --pd-bad: #b3261e; --pd-plain: #46525e; --pd-dim: #66717c;
  --pd-guide-done: #1b7f4b; --pd-guide-now: #c26a00; }
[data-mantine-color-scheme="dark"] { --pd-dim: #9aa5b0; --pd-guide-done: #4fc78a; --pd-guide-now: #f0b050; }
.pd { padding: 8px 16px; font-size: 15px; line-height: 1.5; }
.pd table { width: 100%; border-collapse: collapse; }
.pd td { vertical-align: top; padding: 0; }
.pd td { overflow-wrap: anywhere; }
.pd td:first-child { color: var(--pd-dim); padding-right: 8px; white-space: nowrap; }
.pd-small { font-size: 14px; }
.pd-banner { color: white; border-radius: 8px; padding: 8px; margin-bottom: 8px; font-size: 16px; font-weight: 600; }
.pd-banner.pd-good { background: var(--pd-good); } .pd-banner.pd-fair { background: var(--pd-fair); }
.pd-banner.pd-bad { background: var(--pd-bad); } .pd-banner.pd-plain { background: var(--pd-plain); }
td.pd-good, td.pd-fair, td.pd-bad { font-weight: 600; }
td.pd-good { color: var(--pd-good); } td.pd-fair { color: var(--pd-fair); } td.pd-bad { color: var(--pd-bad); }
[data-mantine-color-scheme="dark"] td.pd-good { color: #4fc78a; }
[data-mantine-color-scheme="dark"] td.pd-fair { color: #f0b050; }
[data-mantine-color-scheme="dark"] td.pd-bad { color: #ff8a80; }
.pd-old td { opacity: 0.45; }
[data-mantine-color-scheme="dark"] .u-title { color: #c8d0d8; }
.u-title { font-size: 14px !important; line-height: 1.5; font-weight: 600; }
#pd-lost { display: none; position: fixed; z-index: 10000; top: 0; left: 0; right: 0; background: #b3261e;
  color: white; font: 600 16px system-ui, sans-serif; padding: 8px 16px; text-align: center; }
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


def status_html(snapshot: Snapshot, beat: int = 0, title: str = "") -> str:
    """Return the result on a coloured background and the other lines in two columns; old values are faded.

    `beat` changes while the page is alive: the browser marks everything as old if it does not. `title` names the probe
    where there are several.
    """
    if not snapshot.status:
        return ""
    first, *rest = snapshot.status
    rows = [f'<tr><td>{escape(n)}</td><td class="pd-{level}">{escape(text)}</td></tr>' for n, text, level in rest]
    return (
        f'<div class="pd" data-beat="{beat}">{escape(title)}'
        f'<div class="pd-banner pd-{first.level}">{escape(first.text)}</div>'
        f'<table class="{"pd-old" if snapshot.stale else ""}">{"".join(rows)}</table>'
        f"{guide_html(snapshot.guide) if snapshot.guide else ''}</div>"
    )


def events_html(snapshot: Snapshot) -> str:
    """Return the last events, newest first."""
    times = [f"{event.time:.1f} s" if math.isfinite(event.time) else "" for event in snapshot.events]
    rows = [f"<tr><td>{t}</td><td>{escape(e.line)}</td></tr>" for t, e in zip(times, snapshot.events, strict=True)]
    return f'<div class="pd pd-small"><table>{"".join(reversed(rows))}</table></div>'


def guide_html(guide: Guide) -> str:
    """Return which side of the base pointed up: both halves of the sphere in an equal-area projection.

    A ring is an orientation along an axis: dashed while it is missing, thick where it is the next.
    """

    def circle(up: Array, radius: float, style: str) -> str:
        """Return a circle in each half that the direction is in, or on the rim of."""
        size = math.sqrt(1.0 - abs(up[2])) / (math.hypot(up[0], up[1]) or 1.0)
        x, y = 64.0 * size * up[0], -64.0 * size * up[1]
        halves = [c for c, side in ((104, up[2]), (304, -up[2])) if side > -0.1]
        return "".join(f'<circle cx="{c + x:.0f}" cy="{104 + y:.0f}" r="{radius}" {style}/>' for c in halves)

    drawn = []
    for up in (*np.eye(3), *-np.eye(3)):
        done = (guide.measured @ up).max(initial=-1.0) > 0.87  # within 30°
        following = guide.following is not None and np.array_equal(up, guide.following)
        colour = "var(--pd-guide-done)" if done else "var(--pd-guide-now)" if following else "currentColor"
        style = f'fill="none" stroke="{colour}" stroke-width="{4 if following else 1.5}"'
        drawn.append(circle(up, 13, style + ("" if done or following else ' stroke-dasharray="3 3"')))
    drawn += [circle(up, 6, 'fill="none" stroke="var(--pd-bad)" stroke-width="2"') for up in guide.refused]
    drawn += [circle(up, 6, 'fill="var(--pd-guide-done)"') for up in guide.measured]
    drawn += (
        [] if guide.now is None else [circle(guide.now, 8, 'fill="none" stroke="var(--pd-guide-now)" stroke-width="3"')]
    )
    halves = "".join(
        f'<circle cx="{c}" cy="104" r="64" fill="none" stroke="currentColor" opacity="0.4"/>'
        f'<text x="{c}" y="218" text-anchor="middle">tip {tip}</text>'
        + "".join(f'<text x="{c + x}" y="{y}" text-anchor="middle">{text}</text>'
                  for x, y, text in ((90, 109, "x"), (-92, 109, "−x"), (0, 22, "y"), (0, 196, "−y")))
        for c, tip in ((104, "up"), (304, "down"))
    )  # fmt: skip
    return (
        '<svg viewBox="0 0 408 226" style="width:100%;max-width:420px" role="img" aria-label="orientations measured">'
        f'<g font-size="15" fill="currentColor">{halves}</g>{"".join(drawn)}</svg>'
        '<div class="pd-small">Side of the base that points up: <b style="color:var(--pd-guide-done)">●</b> measured, '
        '<b style="color:var(--pd-guide-now)">○</b> now and next, <b style="color:var(--pd-bad)">○</b> not used</div>'
    )


#: Colours of x, y and z, of a quantity with its 95 % interval, of limits, and of touches and marks.
AXIS_COLOURS = ("#d1495b", "#2e8b57", "#2a6fbb")
INTERVAL_COLOURS = ("#c81e28", "#e9a3a8", "#e9a3a8")
LIMIT_COLOUR, TOUCH_COLOUR, MARK_COLOUR = "#b3261e", "#e08a2e", "#8e44ad"
#: An axis whose colours are readable on light and on dark ground.
AXIS: uplot.Axis = {"stroke": "#808b96", "grid": {"stroke": "rgba(128,139,150,0.22)", "width": 1},
                    "ticks": {"show": False}, "font": "12px system-ui, sans-serif"}  # fmt: skip
HEIGHT = 142
NEAR_LIMIT = 3.0  #: A limit is visible up to this multiple of the largest value.
STATUS_WIDTH, CHARTS_WIDTH = 370.0, 310.0  #: Widths of the panels [px]: of 1280, 600 are left for the scene.


class StripChart:
    """A strip chart over wall-clock time, with limits as dashed lines, touches below and marks above the curves."""

    def __init__(
        self,
        gui: viser.GuiApi,
        title: str,
        columns: tuple[str, ...],
        unit: float,
        limits: tuple[float, ...] = (),
        dots: bool = False,
    ) -> None:
        """Create an empty chart of columns of `STRIP` in a unit; "low" and "high" are the 95 % interval of s.

        Dashed `limits` are visible as curves come near. With `dots`, missing values are not drawn across.
        """
        self._columns, self._unit, self._limits = columns, unit, limits
        series = [uplot.Series(label="time")]
        for name, colour in zip(columns, INTERVAL_COLOURS if dots else AXIS_COLOURS, strict=False):
            points: uplot.Series_Points = {"show": dots, "size": 3.0, "fill": colour, "stroke": colour}
            series.append(uplot.Series(label=name, stroke=colour, width=0.0 if dots else 1.6, points=points))
        for _ in limits:
            series.append(uplot.Series(label="limit", stroke=LIMIT_COLOUR, width=1.0, dash=(6, 4)))
        for name, colour, size in (("touch", TOUCH_COLOUR, 4.0), ("mark", MARK_COLOUR, 9.0)):
            points = {"show": True, "size": size, "fill": colour, "stroke": colour}
            series.append(uplot.Series(label=name, stroke=colour, width=0.0, points=points))
        self._plot = gui.add_uplot(
            data=(np.array([np.nan]),) * len(series), series=tuple(series), title=title,
            scales={"x": {"time": True}, "y": {"auto": True}}, padding=(0, 10, 0, 0),
            axes=({**AXIS, "size": 38}, {**AXIS, "size": 40}), legend={"show": False}, height=HEIGHT,
        )  # fmt: skip

    def draw(self, columns: dict[str, Array], age: float) -> None:
        """Draw the columns of `StripCharts`, the last of which has an age [s]: old curves move out of the chart."""
        curves = [columns[name] / self._unit for name in self._columns]
        known = np.concatenate([*curves, np.zeros(1)])
        near = NEAR_LIMIT * float(np.nanmax(np.abs(known)))
        known = np.append(known, [level / self._unit for level in self._limits if abs(level / self._unit) < near])
        low, high = float(np.nanmin(known)), float(np.nanmax(known))
        margin = max(0.12 * (high - low), 0.5)
        low, high, end = low - margin, high + margin, float(columns["time"][-1]) + age
        limits = [np.full(len(columns["time"]), limit / self._unit) for limit in self._limits]
        flags = [
            np.where(columns[name] > 0.0, level, np.nan)
            for name, level in (("touch", low + 0.25 * margin), ("mark", high - 0.4 * margin))
        ]
        self._plot.data = (columns["time"], *curves, *limits, *flags)
        shown = (end - CHART_SECONDS, end) if math.isfinite(end) else (0.0, 1.0)
        self._plot.scales = {"x": {"time": True, "range": shown}, "y": {"range": (low, high)}}


class Panel:
    """Status text, charts and buttons."""

    def __init__(self, server: viser.ViserServer, send_command: Callable[[str, str], None], setup: PageSetup) -> None:
        self.paused, gui, scenes, runs = False, server.gui, setup.scenes, not setup.guided
        gui.main_panel.dock_right()
        gui.main_panel.set_width(STATUS_WIDTH)
        self._texts, self._charts = [gui.add_html("") for _ in scenes], list[list[StripChart]]()
        self._finish = gui.add_button("Finish: fit and write the result", icon=viser.Icon.CHECK, visible=setup.guided)
        self._finish.on_click(lambda _: send_command("stop", ""))
        self._pause = gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE, visible=runs)
        self._pause.on_click(lambda _: self._toggle())
        tare = gui.add_button("Tare: the probe is free", icon=viser.Icon.SCALE, visible=runs)
        tare.on_click(lambda _: send_command("tare", ""))
        text = gui.add_text("Note", "", visible=runs)
        mark = gui.add_button("Mark this time", icon=viser.Icon.FLAG, visible=runs)
        mark.on_click(lambda _: send_command("mark", text.value))
        self._start = gui.add_button("Start recording", icon=viser.Icon.PLAYER_RECORD, color=(192, 36, 36),
                                     visible=runs)  # fmt: skip
        self._start.on_click(lambda _: send_command("start recording", ""))
        self._stop = gui.add_button("Stop recording", icon=viser.Icon.PLAYER_STOP, color="gray", disabled=True,
                                    visible=runs)  # fmt: skip
        self._stop.on_click(lambda _: send_command("stop recording", ""))
        self.cloud = gui.add_checkbox(f"Last {CLOUD} estimates", False, visible=runs)
        with gui.add_folder("Events"):
            self._texts.append(gui.add_html(""))
        for scene in scenes:
            if scene.note:
                gui.add_markdown(scene.note)
        if setup.guided:
            return
        strips = gui.add_panel()
        for scene in scenes:
            title = f"Last {CHART_SECONDS:g} s" if len(scenes) == 1 else scene.title.partition(" ")[0]
            with strips.add_tab(title):
                force, moment, contact = scene.limits
                self._charts.append([
                    StripChart(gui, "s of the contact, 95 % [mm]", ("s", "low", "high"), MM, dots=True),
                    StripChart(gui, "force of the contact [mN]", ("force",), MILLINEWTON, (contact,), dots=True),
                    StripChart(gui, "base force [mN]: x red, y green, z blue", ("Fx", "Fy", "Fz"), MILLINEWTON,
                          (force, -force)),
                    StripChart(gui, "base moment [N·mm]: x, y, z", ("Mx", "My", "Mz"), N_MM, (moment, -moment)),
                    StripChart(gui, "drift of the bias [mN]: x, y, z", ("bias_x", "bias_y", "bias_z"), MILLINEWTON),
                ])  # fmt: skip
        strips.dock_left()
        strips.set_width(CHARTS_WIDTH)

    def _toggle(self) -> None:
        self.paused = not self.paused
        self._pause.label = f"Continue: paused at {time.strftime('%H:%M:%S')}" if self.paused else "Pause"

    def show(self, snapshot: Snapshot, *texts: str) -> None:
        """Update status and events, and enable the button that applies, where they have changed."""
        recording, guide = bool(snapshot.recording), snapshot.guide
        if guide is not None and self._finish.disabled == (can := guide.enough and not snapshot.result):
            self._finish.disabled = not can
        if recording != self._start.disabled:
            self._start.disabled, self._stop.disabled = recording, not recording
        for shown, text in zip(self._texts, texts, strict=True):
            if shown.content != text:
                shown.content = text

    def draw(self, number: int, charts: StripCharts, age: float) -> None:
        """Draw the charts of a probe, whose last row has an age [s]."""
        if not self._charts:
            return
        columns = charts.columns()
        half = 1.96 * columns["std_s"]
        columns |= {"low": columns["s"] - half, "high": columns["s"] + half}
        for chart in self._charts[number]:
            chart.draw(columns, age)


FIELD_OF_VIEW = math.radians(40.0)
DISTANCE = 2.8  #: Distance of the camera, in lengths of the probe: all of it is between the panels.
GUIDED_DISTANCE = 4.0  #: The same where the probe turns to anywhere.
AXES = 0.04  #: Length of the axes of the base [m].
ASIDE = 0.1  #: Distance between probes whose poses are unknown [m].
AGEING = 0.5  #: Interval in which the charts of old data are drawn again [s].


class ProbeScene:
    """What is drawn of one probe; all of it is of one estimate."""

    def __init__(
        self, scene: viser.SceneApi, stage: Stage, setup: SceneSetup, number: int, aside: Array, guided: bool
    ) -> None:
        """Create all objects, invisible if their content is unknown; `aside` is where a base of unknown pose is [m].

        The axes of the base are shown if a calibration is `guided`.
        """
        self._setup, self._aside, self._T, root = setup, aside, np.eye(4), f"/{number}"
        self._stage, self._number = stage, number
        self._tube = replace(setup.tube, rings=16, sides=12)  # of the shadow
        self._hull = np.concatenate([part.vertices for part in setup.parts])
        self._base = scene.add_frame(f"{root}/base", show_axes=guided, axes_length=UNIT * AXES, axes_radius=UNIT * 7e-4)
        self._axes = [
            scene.add_label(f"{root}/base/axis/{name}", name, position=UNIT * 1.1 * AXES * axis, visible=guided)
            for name, axis in zip("xyz", np.eye(3), strict=True)
        ]
        self._base.wxyz, self._base.position = quaternion(level_rotation(setup.gravity_base)), UNIT * aside
        for part in setup.parts:
            colour, name = PART_COLOURS.get(part.name, METAL), f"{root}/base/{part.name}"
            scene.add_mesh_simple(name, UNIT * part.vertices, part.faces, color=colour, cast_shadow=False)
        free = UNIT * setup.tube.vertices(setup.free)
        self._probe = scene.add_mesh_simple(
            f"{root}/base/probe", free, setup.tube.faces, color=PROBE, opacity=0.42, side="double", cast_shadow=False
        )
        self._contact = scene.add_icosphere(f"{root}/contact", UNIT * 1.5e-3, CONTACT, visible=False, cast_shadow=False)
        # Opaque: a translucent object inside another is drawn or not, depending on the camera.
        self._spread = scene.add_icosphere(f"{root}/spread", 1.0, SPREAD, visible=False, cast_shadow=False)
        self._force = arrow(scene, f"{root}/force", CONTACT, visible=False)
        self._spread_label = scene.add_label(f"{root}/spread_label", "95 % region", anchor="top-left", visible=False)
        self._cloud = scene.add_point_cloud(
            f"{root}/cloud", np.zeros((1, 3)), CONTACT, point_size=UNIT * 7e-4, point_shape="circle", visible=False
        )
        self._label = scene.add_label(f"{root}/contact_label", "", anchor="bottom-center", visible=False)
        size = UNIT * 1.5e-3
        self._marks = [
            (
                scene.add_icosphere(f"{root}/touch/{i}", size, STALE_COLOUR, visible=False, cast_shadow=False),
                scene.add_label(f"{root}/touch/{i}/number", "", font_screen_scale=0.8, visible=False),
            )
            for i in range(MAX_TOUCHES)
        ]

    def show(self, snapshot: Snapshot, cloud: bool) -> None:
        """Show a snapshot, with its cloud of the last estimates if it is asked for."""
        self._show_probe(snapshot)
        self._show_contact(snapshot)
        for (mark, label), (number, p, in_world) in zip(self._marks, snapshot.touches, strict=False):
            mark.visible = label.visible = True
            mark.position, label.text = UNIT * (p if in_world else self._T[:3, :3] @ p + self._T[:3, 3]), f"{number}"
        if (guide := snapshot.guide) is not None:
            for name, axis, label in zip("xyz", np.eye(3), self._axes, strict=True):
                way = 0.0 if guide.following is None else axis @ guide.following
                label.text = f"{name}: turn it {'up' if way > 0.0 else 'down'}" if way else name
        self._cloud.visible = cloud and len(snapshot.cloud) > 0
        if self._cloud.visible:
            R, origin = (np.eye(3), np.zeros(3)) if snapshot.has_pose else (self._T[:3, :3], self._T[:3, 3])
            self._cloud.points = (UNIT * (snapshot.cloud @ R.T + origin)).astype(np.float16)

    def _show_probe(self, snapshot: Snapshot) -> None:
        """Show the estimated shape; where it is unknown the free probe in grey."""
        T = np.eye(4)  # of the base in the scene: in the world, or upright by gravity if it is unknown
        if snapshot.has_pose:
            T = snapshot.T_world_base
        else:
            T[:3, :3], T[:3, 3] = level_rotation(snapshot.gravity_base), self._aside
        self._T = T
        self._base.wxyz, self._base.position = quaternion(T[:3, :3]), UNIT * T[:3, 3]
        shape = snapshot.shape or self._setup.free
        self._probe.vertices = (UNIT * self._setup.tube.vertices(shape)).astype(np.float32)
        for name, points, faces in (
            ("probe", self._tube.vertices(shape), self._tube.faces),
            ("mount", self._hull, None),
        ):
            self._stage.shade(f"{self._number}/{name}", points @ T[:3, :3].T + T[:3, 3], faces)
        current = (snapshot.shape is not None and not snapshot.stale) or not snapshot.result
        self._probe.color = PROBE if current else STALE_COLOUR

    def _show_contact(self, snapshot: Snapshot) -> None:
        """Show the contact, its 95 % ellipsoid and its force; grey and labelled old if it is not current."""
        marker = snapshot.marker
        shown = marker is not None
        self._contact.visible = self._label.visible = shown
        self._spread.visible = self._spread_label.visible = self._force.visible = shown and not snapshot.stale
        if marker is None:
            return
        R, origin = (np.eye(3), np.zeros(3)) if marker.in_world else (self._T[:3, :3], self._T[:3, 3])
        surface = R @ marker.p_surface + origin
        half_axes, axes = ellipsoid_95(R @ marker.cov @ R.T)
        self._contact.position = self._spread.position = UNIT * surface
        self._spread.scale = tuple(UNIT * np.maximum(half_axes, MIN_HALF_AXIS))
        self._spread.wxyz = quaternion(axes)
        self._spread_label.position = UNIT * (surface - half_axes[-1] * axes[:, -1])
        force = R @ marker.force
        strength = float(np.linalg.norm(force))
        tail = surface - ARROW * force / strength
        self._force.points = (UNIT * np.array([[tail, surface]])).astype(np.float32)
        self._contact.color = STALE_COLOUR if snapshot.stale else CONTACT
        self._label.position = UNIT * tail
        position = f"s {1e3 * marker.s:.1f} ± {1e3 * marker.std_s:.1f} mm"
        fresh = f"{position}, {1e3 * strength:.1f} mN"
        self._label.text = f"{snapshot.age:.0f} s old: {position}" if snapshot.stale else fresh


class ViewerPage:
    """Shows the snapshots of a run, one for each probe, in every connected browser."""

    def __init__(self, setup: PageSetup, send_command: Callable[[str, str], None]) -> None:
        """Start the server and show the free probes; `send_command` receives a command and its text."""
        self._setup, self._charts = setup, [StripCharts() for _ in setup.scenes]
        self._drawn_ages = [0.0] * len(setup.scenes)
        self._server = server = LoopbackServer(setup.host, setup.port, setup.title, verbose=False)
        server.gui.configure_theme(
            show_logo=False, show_share_button=False, control_width="large", brand_color=(38, 84, 124)
        )
        self._stage = Stage(server.scene)
        aside = self._set_camera()
        self._scenes = [ProbeScene(server.scene, self._stage, each, i, i * aside, setup.guided)
                        for i, each in enumerate(setup.scenes)]  # fmt: skip
        self._panel = Panel(server, send_command, setup)

    @property
    def url(self) -> str:
        """Address of the page."""
        host = f"[{self._setup.host}]" if ":" in self._setup.host else self._setup.host
        return f"http://{host}:{self._server.get_port()}"

    def stop(self) -> None:
        """Stop the server."""
        self._server.stop()

    def show(self, snapshots: Sequence[Snapshot]) -> None:
        """Show the snapshots in one update; while the page is paused, scene and charts stay, and the status goes on."""
        beat, several = int(time.monotonic()), len(snapshots) > 1
        with self._server.atomic():
            titles = [scene.title if several else "" for scene in self._setup.scenes]
            status = [status_html(s, beat, title) for s, title in zip(snapshots, titles, strict=True)]
            self._panel.show(snapshots[0], *status, events_html(snapshots[0]))
            for i, snapshot in enumerate(snapshots):
                redraw = self._charts[i].add(snapshot.strip)
                if self._panel.paused:
                    continue
                self._scenes[i].show(snapshot, self._panel.cloud.value)
                age = snapshot.age if snapshot.stale and math.isfinite(snapshot.age) else 0.0
                if redraw or abs(age - self._drawn_ages[i]) > AGEING:
                    self._panel.draw(i, self._charts[i], age)
                    self._drawn_ages[i] = age
        self._server.flush()

    def _set_camera(self) -> Array:
        """Place the camera beside and slightly above the free probes, with a floor below.

        Returns:
            Step [m], (3,), from one probe of unknown pose to the next, across the direction of view.
        """
        setup, n = self._setup.scenes[0], len(self._setup.scenes)
        free, length = setup.free, float(setup.tube.s[-1])
        T = level_rotation(setup.gravity_base)
        p = free.p_base @ T.T
        body = np.concatenate([p, *(part.vertices @ T.T for part in setup.parts)])
        if self._setup.guided:  # it turns about its base to anywhere
            body = length * np.array([[-0.7, -0.5, -1.0], [0.7, 0.5, 1.0]])
        low = body.min(axis=0) - (0.0, 0.02, 0.02)
        front = np.array([0.5 * (low[0] + body[:, 0].max()), low[1], 0.0])
        self._stage.put(low[2], front, low + np.array([0.0, 0.0, 0.025]), bool(np.any(setup.gravity_base)))
        along = T[:, 2]
        middle = UNIT * (0.5 * (p[0] + p[-1]) - 0.02 * along)
        side = np.cross(along, (0.0, 0.0, 1.0))
        side = side / np.linalg.norm(side) if np.linalg.norm(side) > 0.2 else np.array([0.0, -1.0, 0.0])
        direction = 2.3 * side + np.array([0.0, 0.0, 0.8]) + 0.5 * along
        aside = ASIDE * np.cross(side, along)
        middle += 0.5 * (n - 1) * UNIT * aside
        camera = self._server.initial_camera
        camera.fov = FIELD_OF_VIEW
        distance = DISTANCE + 0.5 * (n - 1)
        if self._setup.guided:
            middle, distance = np.zeros(3), GUIDED_DISTANCE
        camera.look_at = middle
        camera.position = middle + UNIT * length * distance * direction / np.linalg.norm(direction)
        return aside


def main() -> None:
    """Show snapshots until the input ends."""
    back = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # viser prints a banner
    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    lock = Lock()

    def send(**message: str) -> None:
        with lock:
            back.write(json.dumps(message) + "\n")
            back.flush()

    try:
        setup = pickle.load(sys.stdin.buffer)
        protect(setup.title, setup.token, f"<style>{STYLE}</style><script>{SCRIPT}</script>")
        page = ViewerPage(setup, lambda name, text: send(command=name, text=text))
        send(url=page.url)
        while True:
            page.show(pickle.load(sys.stdin.buffer))
    except (EOFError, BrokenPipeError):
        pass  # the run has ended
    except Exception as error:
        send(error=f"{error} ({type(error).__name__})")
    os._exit(0)  # do not wait for threads of an open browser


if __name__ == "__main__":
    main()
