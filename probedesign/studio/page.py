"""The page of the studio, served by viser: controls, the bent probe in three dimensions, charts and tables.

Handlers of the page only put requests into a queue; one thread works them off, so that no two changes meet. While a
slider moves, only the last value counts. All browser tabs show the same state.
"""

import io
import math
import queue
import threading
import time
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import partial
from html import escape
from typing import Any

import numpy as np
import viser

from probedesign.core.errors import InputError
from probedesign.core.units import MM
from probedesign.design import Design
from probedesign.design.catalog import RESINS
from probedesign.design.sensor_catalog import SENSORS
from probedesign.live.view.access import protect
from probedesign.live.view.page import UNIT, LoopbackServer, level_rotation
from probedesign.prediction.predict import FORCES_N
from probedesign.prediction.table_one import PROBES, paper_design
from probedesign.reports.chart import Chart
from probedesign.studio import actions
from probedesign.studio.figures import (
    DrawnTouch,
    budget_figure,
    complete,
    drawn_touch,
    error_chart,
    fused_chart,
    preview,
    styled,
    summary_table,
)
from probedesign.studio.scene import StudioScene
from probedesign.studio.session import MOUNTINGS, Session, StudioTouch, knots_of, mounting_of, with_knots

TITLE = "probedesign studio"
REST_SECONDS = 0.35
"""Time without a change after which everything is predicted."""


class StudioPage:
    """Serves the studio of a session until it is stopped.

    Attributes:
        session: the state.
        figures: what is shown of the current design.
    """

    def __init__(self, session: Session, host: str, port: int) -> None:
        """Start the server at an address; the next free port is used."""
        self.session = session
        self._requests: queue.Queue[Callable[[], None]] = queue.Queue()
        self._latest: dict[str, Any] = {}
        self._lock, self._setting = threading.Lock(), False
        self.figures = preview(session.design, self._forces)
        self._drawn: DrawnTouch | None = None
        self._complete = False
        self._stopped = threading.Event()
        protect(TITLE, token="")
        with redirect_stdout(io.StringIO()):  # viser prints a banner
            self._server = LoopbackServer(host, port, TITLE, verbose=False)
        self._host = host
        self._controls()
        self._scene = StudioScene(self._server.scene, self.move)
        self._show()
        self._set_camera()
        self._thread = threading.Thread(target=self._work, name="studio", daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """Address of the page."""
        host = f"[{self._host}]" if ":" in self._host else self._host
        return f"http://{host}:{self._server.get_port()}"

    @property
    def _forces(self) -> tuple[float, ...]:
        return tuple(1e-3 * force for force in self.session.forces_mN)

    def wait(self) -> None:
        """Return when the page is stopped; a signal interrupts it."""
        while not self._stopped.wait(0.5):
            pass

    def stop(self) -> None:
        """Stop the server and the thread."""
        self._stopped.set()
        self._requests.put(lambda: None)
        self._thread.join(timeout=5.0)
        with redirect_stdout(io.StringIO()):
            self._server.stop()

    # Requests

    def _request(self, change: Callable[[], None]) -> None:
        """Put a request that is carried out in order."""
        self._requests.put(change)

    def move(self, key: str, value: Any) -> None:
        """Request a change, as a control of the page does; of several that wait, only the last of each key counts.

        Args:
            key: of the design file; `touch.fraction`, `touch.angle_deg` or `touch.force_mN`; `knot.INDEX` of a
                profile; `mounting`; `forces`.
            value: its new value.
        """
        with self._lock:
            first = not self._latest
            self._latest[key] = value
        if first:
            self._requests.put(self._apply_latest)

    def settle(self) -> None:
        """Wait until all requests so far are carried out."""
        done = threading.Event()
        self._requests.put(done.set)
        done.wait()

    def _apply_latest(self) -> None:
        with self._lock:
            values, self._latest = self._latest, {}
        touch = {
            key.removeprefix("touch."): values.pop(key) for key in list(values) if key.startswith("touch.")
        }
        if touch:
            self.session.touch = StudioTouch(**{**vars(self.session.touch), **touch})
        if "forces" in values:
            self.session.forces_mN = values.pop("forces")
        before = self.session.design
        knots = {
            int(key.removeprefix("knot.")): values.pop(key) for key in list(values) if key.startswith("knot.")
        }
        if knots:
            values |= with_knots(self.session.design, knots)
        if (mounting := values.pop("mounting", None)) in MOUNTINGS:
            values["mount.gravity_base_m_s2"] = list(MOUNTINGS[mounting])
        if values:
            self.session.change(values, time.monotonic())
        self._refresh(moved=self.session.design != before or not touch)

    def _work(self) -> None:
        """Carry out requests; predict everything when there were none for a while."""
        while not self._stopped.is_set():
            try:
                busy = self._improvement is not None and self._improvement.running
                request = self._requests.get(timeout=None if self._complete and not busy else REST_SECONDS)
            except queue.Empty:
                self._rest()
                continue
            try:
                request()
            except InputError as error:  # the page has a box where a command has an option
                self._say(str(error).replace("--force", "the box 'replace existing files'"), bad=True)

    def _rest(self) -> None:
        """Predict everything once the hand rests, and draw the path of a search."""
        self._show_improvement()
        if not self._complete:
            self._complete = True
            self.figures = complete(self.session.design)
            self._show()

    def _refresh(self, moved: bool = True) -> None:
        """Compute and show what follows from a change; `moved`: the design or the forces may have changed."""
        if moved:
            self.figures = preview(self.session.design, self._forces)
            self._complete = False
        self._show()

    # Controls

    def _controls(self) -> None:
        gui = self._server.gui
        gui.configure_theme(
            show_logo=False, show_share_button=False, control_width="large", brand_color=(38, 84, 124)
        )
        gui.main_panel.dock_right()
        gui.main_panel.set_width(310.0)
        self._status = gui.add_html("")
        self._handles: dict[str, Any] = {}
        tabs = gui.add_tab_group()
        with tabs.add_tab("Probe"):
            self._probe_controls(gui)
        with tabs.add_tab("Bench"):
            self._bench_controls(gui)
        with tabs.add_tab("Touch"):
            self._touch_controls(gui)
        with tabs.add_tab("Improve"):
            self._improve_controls(gui)
        with tabs.add_tab("Save"):
            self._save_controls(gui)
        charts = gui.add_panel()
        with charts.add_tab("Error"):
            self._charts = {"error": gui.add_html(""), "summary": gui.add_html("")}
        with charts.add_tab("Budget"):
            self._charts["budget"] = gui.add_html("")
        with charts.add_tab("Fused"):
            self._charts["fused"] = gui.add_html("")
        charts.dock_left()
        charts.set_width(360.0)

    def _bind(self, key: str, handle: Any, value: Callable[[Any], Any] = lambda value: value) -> None:
        """Connect a control to a key of the design or of the touch."""
        self._handles[key] = handle

        def changed(_: Any) -> None:
            if not self._setting:
                self.move(key, value(handle.value))

        handle.on_update(changed)

    def _slider(
        self, gui: viser.GuiApi, key: str, label: str, low: float, high: float, step: float, value: float
    ) -> None:
        low, high = min(low, value), max(high, value)
        self._bind(key, gui.add_slider(label, low, high, step, value))

    def _probe_controls(self, gui: viser.GuiApi) -> None:
        design = self.session.design
        preset = gui.add_dropdown("preset", ("-", *PROBES), initial_value="-")
        preset.on_update(lambda _: self._preset(preset))
        steps = gui.add_button_group("changes", ("undo", "redo"))
        steps.on_click(lambda _: self._request(lambda: self._step(steps.value)))
        probe = design.probe
        self._bind(
            "probe.shape",
            gui.add_dropdown("shape", ("cone", "cylinder", "profile"), initial_value=probe.shape),
        )
        self._slider(gui, "probe.length_mm", "length [mm]", 20.0, 250.0, 1.0, probe.length_mm)
        self._slider(gui, "probe.base_d_mm", "base diameter [mm]", 2.0, 20.0, 0.1, probe.base_d_mm)
        self._slider(
            gui, "probe.tip_d_mm", "tip diameter [mm]", 1.0, 12.0, 0.1, probe.tip_d_mm or probe.base_d_mm
        )
        self._knots = gui.add_folder("profile: diameters between [mm]", visible=False)
        self._knot_sliders: list[Any] = []
        self._bind(
            "probe.section",
            gui.add_dropdown("section", ("round", "hollow", "elliptic"), initial_value=probe.section),
        )
        self._slider(
            gui, "probe.bore_ratio", "bore over outer diameter", 0.1, 0.9, 0.01, probe.bore_ratio or 0.5
        )
        self._slider(gui, "probe.flatness", "flatness, y over x", 0.2, 1.0, 0.01, probe.flatness or 0.7)
        self._bind("probe.tip", gui.add_dropdown("tip", ("blunt", "rounded"), initial_value=probe.tip))
        self._bind(
            "material.resin", gui.add_dropdown("resin", tuple(RESINS), initial_value=design.material.resin)
        )
        self._slider(gui, "material.youngs_modulus_mpa", "E [MPa]", 0.2, 10.0, 0.01,
                     design.youngs_modulus.value / 1e6)  # fmt: skip

    def _bench_controls(self, gui: viser.GuiApi) -> None:
        design = self.session.design
        known = (design.sensor_model, *SENSORS.values())
        calibrations = tuple(dict.fromkeys(c.name for sensor in known for c in sensor.calibrations))
        self._bind(
            "sensor.calibration",
            gui.add_dropdown("calibration", calibrations, initial_value=design.calibration.name),
        )
        self._bind(
            "sensor.averaging_samples",
            gui.add_slider("samples in one reading", 1, 1000, 1, design.sensor.averaging_samples),
        )
        mounted = gui.add_dropdown("probe points", (*MOUNTINGS, "other"),
                                   initial_value=mounting_of(design.mount.gravity_base_m_s2))  # fmt: skip
        self._bind("mounting", mounted)
        vector = gui.add_vector3("gravity in base axes [m/s²]", design.mount.gravity_base_m_s2, step=0.01)
        self._bind("mount.gravity_base_m_s2", vector, list)
        self._slider(gui, "mount.root_rigid_radii", "root, rigid base radii", -0.5, 0.5, 0.01,
                     design.mount.root_rigid_radii)  # fmt: skip
        self._slider(gui, "contact.friction", "friction", 0.0, 1.5, 0.05, min(design.friction.value, 1.5))
        shown = [gui.add_checkbox(f"{1e3 * f:g} mN", 1e3 * f in self.session.forces_mN) for f in FORCES_N]
        for box in shown:
            box.on_update(lambda _: self._choose_forces(shown))

    def _touch_controls(self, gui: viser.GuiApi) -> None:
        touch = self.session.touch
        self._slider(gui, "touch.fraction", "place, fraction of the length", 0.05, 1.0, 0.01, touch.fraction)
        self._slider(gui, "touch.angle_deg", "direction [deg]", -180.0, 180.0, 1.0, touch.angle_deg)
        self._slider(gui, "touch.force_mN", "force [mN]", 0.5, 200.0, 0.5, touch.force_mN)
        gui.add_markdown("Drag the red point along the probe, or the end of its arrow: its direction is that of the "
                         "force, and it grows with the logarithm of the force.")  # fmt: skip
        self._touch_text = gui.add_html("")

    def _improve_controls(self, gui: viser.GuiApi) -> None:
        self._goal = gui.add_slider("force of the task [mN]", 1.0, 50.0, 0.5, 5.0)
        self._touches = gui.add_slider("fused touches of the task", 1, 8, 1, 5)
        self._free = gui.add_dropdown("what may change", tuple(actions.FREE))
        self._sag = gui.add_slider("largest tip sag [mm]", 1.0, 120.0, 1.0, 60.0)
        start = gui.add_button("Improve from here", color="green")
        start.on_click(lambda _: self._improve())
        self._path = gui.add_html("")
        self._accept = gui.add_button("Accept the result", visible=False, color="green")
        self._accept.on_click(lambda _: self._request(self._take))
        self._drop = gui.add_button("Drop the result", visible=False)
        self._drop.on_click(lambda _: self._request(self._discard))
        self._improvement: actions.Improvement | None = None

    def _save_controls(self, gui: viser.GuiApi) -> None:
        pin = gui.add_button("Pin this design", icon=viser.Icon.PINNED)
        pin.on_click(lambda _: self._request(self._pin))
        unpin = gui.add_button("Remove the last pin")
        unpin.on_click(lambda _: self._request(self._unpin))
        self._name: Any = gui.add_text("name", self.session.design.name)
        self._replace = gui.add_checkbox("replace existing files", False)
        for label, action in actions.ACTIONS.items():
            gui.add_button(label).on_click(partial(self._press, action))
        self._command: Any = gui.add_text("command that restores this state", "", multiline=True)

    # Reactions

    def _preset(self, preset: Any) -> None:
        """Load a preset; its field is empty again, so that the same one can be chosen later."""
        if (name := preset.value) in PROBES:
            preset.value = "-"
            self._request(lambda: self._load(paper_design(name)))

    def _load(self, design: Design) -> None:
        self.session.replace_design(design)
        self._name.value = design.name
        self._refresh()

    def _step(self, name: str) -> None:
        if self.session.undo() if name == "undo" else self.session.redo():
            self._refresh()

    def _choose_forces(self, boxes: list[Any]) -> None:
        if not self._setting:
            chosen = tuple(1e3 * f for f, box in zip(FORCES_N, boxes, strict=True) if box.value)
            self.move("forces", chosen or (10.0,))

    def _pin(self) -> None:
        self.session.pin()
        self._show_text()

    def _unpin(self) -> None:
        if self.session.pinned:
            self.session.unpin(self.session.pinned[-1].label)
        self._show_text()

    def _press(self, action: actions.Action, _: Any) -> None:
        self._request(partial(self._act, action))

    def _act(self, action: actions.Action) -> None:
        design = self.session.design.model_copy(update={"name": self._name.value.strip()})
        self._say("working ...")
        self._say(action(actions.checked(design), self._replace.value))

    def _improve(self) -> None:
        """Start a search in a thread of its own; its path is drawn as it goes."""
        if self._improvement is not None and self._improvement.running:
            return
        self._improvement = actions.Improvement(
            self.session.design, actions.FREE[self._free.value], 1e-3 * self._goal.value, int(self._touches.value),
            self._sag.value, lambda: self._request(self._show_improvement),
        )  # fmt: skip

    def _show_improvement(self) -> None:
        found = self._improvement
        if found is None:
            return
        chart = found.chart()
        text = f'<div class="note">{escape(found.text)}</div>'
        self._path.content = styled(text + ("" if chart is None else chart.svg().decode()))
        self._accept.visible = self._drop.visible = found.design is not None

    def _take(self) -> None:
        if self._improvement is not None and self._improvement.design is not None:
            design, self._improvement = self._improvement.design, None
            self._path.content, self._accept.visible, self._drop.visible = "", False, False
            self._load(design)

    def _discard(self) -> None:
        self._improvement = None
        self._path.content, self._accept.visible, self._drop.visible = "", False, False

    # Show

    def _show(self) -> None:
        """Show the whole state in one update."""
        self._drawn = None if self.figures.buckles else drawn_touch(self.figures.probe, self.session.touch)
        with self._server.atomic():
            self._show_controls()
            self._scene.show(self.figures, self._drawn, self.session.touch)
            self._show_text()
        self._server.flush()

    def _show_controls(self) -> None:
        """Set the controls to the state; what a design does not use is hidden."""
        design, probe = self.session.design, self.session.design.probe
        values = {
            "probe.shape": probe.shape, "probe.length_mm": probe.length_mm, "probe.base_d_mm": probe.base_d_mm,
            "probe.tip_d_mm": probe.tip_d_mm, "probe.section": probe.section, "probe.bore_ratio": probe.bore_ratio,
            "probe.flatness": probe.flatness, "probe.tip": probe.tip, "material.resin": design.material.resin,
            "material.youngs_modulus_mpa": design.youngs_modulus.value / 1e6,
            "sensor.calibration": design.calibration.name,
            "sensor.averaging_samples": design.sensor.averaging_samples,
            "mounting": mounting_of(design.mount.gravity_base_m_s2),
            "mount.gravity_base_m_s2": tuple(design.mount.gravity_base_m_s2),
            "mount.root_rigid_radii": design.mount.root_rigid_radii,
            "contact.friction": min(design.friction.value, 1.5),
            **{f"touch.{key}": value for key, value in vars(self.session.touch).items()},
        }  # fmt: skip
        self._setting = True
        try:
            with self._lock:
                waiting = set(self._latest)
            for key, value in values.items():
                handle = self._handles[key]
                handle.visible = value is not None  # hidden where the design does not use it
                if (
                    value is not None
                    and key not in waiting
                    and not self.session.refused
                    and handle.value != value
                ):
                    handle.value = value
            self._show_knots()
        finally:
            self._setting = False

    def _show_knots(self) -> None:
        """Show a slider for each interior diameter of a profile."""
        knots = knots_of(self.session.design)
        self._knots.visible = bool(knots)
        if len(knots) != len(self._knot_sliders):
            for handle in self._knot_sliders:
                handle.remove()
            self._knot_sliders = []
            with self._knots:
                for index, s, d in knots:
                    slider = self._server.gui.add_slider(f"at {s / MM:.0f} mm", 1.0, 20.0, 0.1, d / MM)
                    self._bind(f"knot.{index}", slider)
                    self._knot_sliders.append(slider)
        for slider, (_, _, d) in zip(self._knot_sliders, knots, strict=True):
            if slider.value != d / MM:
                slider.value = d / MM

    def _say(self, text: str, bad: bool = False) -> None:
        self._status.content = styled(f'<div class="{"bad" if bad else "note"}">{escape(text)}</div>')

    def _show_text(self) -> None:
        """Update texts, tables and charts."""
        session, figures = self.session, self.figures
        if session.refused:
            self._say(f"Not applied: {session.refused}", bad=True)
        elif figures.buckles:
            self._say("The probe buckles under its own weight as mounted.", bad=True)
        else:
            self._say(figures.prediction.verdict)
        pinned = [(pin, complete(pin.design)) for pin in session.pinned]
        lines = "".join(f"<li>{escape(text)}</li>" for text in figures.findings)
        check = f"<ul>{lines}</ul>" if lines else "<p class=note>Print check: no errors, no warnings.</p>"
        charts: dict[str, Chart | None] = {
            "error": error_chart(figures, pinned, self._forces), "budget": budget_figure(figures),
        }  # fmt: skip
        if figures.complete:
            charts["fused"] = fused_chart(figures, pinned)
        for name, chart in charts.items():
            self._charts[name].content = styled(
                "nothing is located" if chart is None else chart.svg().decode()
            )
        dotted = "<p class=note>Solid: all error sources. Dotted: an exact probe. Dashed: pinned designs.</p>"
        self._charts["summary"].content = styled(dotted + summary_table(figures, pinned) + check)
        self._touch_text.content = styled(self._touch_html())
        self._command.value = session.command_line

    def _touch_html(self) -> str:
        drawn = self._drawn
        if drawn is None:
            return '<div class="bad">The probe buckles under this touch.</div>'
        estimate = drawn.estimate
        if not estimate.ok:
            return f'<div class="bad">The reading is not located: {escape(estimate.result)}.</div>'
        rms = math.sqrt(float(np.trace(estimate.cov_surface_base))) / MM
        return (
            f"<table><tr><td>located</td><td>s = {estimate.s_contact / MM:.1f} ± {estimate.std_s / MM:.1f} mm</td></tr>"
            f"<tr><td>error</td><td>{rms:.2g} mm RMS, all error sources</td></tr></table>"
        )

    def _set_camera(self) -> None:
        """Place the camera beside and slightly above the probe."""
        T, length = level_rotation(self.figures.probe.model.gravity_base), self.figures.probe.length
        along = T[:, 2]
        side = np.cross(along, (0.0, 0.0, 1.0))
        side = side / np.linalg.norm(side) if np.linalg.norm(side) > 0.2 else np.array([0.0, -1.0, 0.0])
        middle = UNIT * 0.45 * length * along
        camera = self._server.initial_camera
        camera.fov = math.radians(40.0)
        camera.look_at = middle
        camera.position = middle + UNIT * length * (2.2 * side + np.array([0.0, 0.0, 0.7]) + 0.4 * along)
