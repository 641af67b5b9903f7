"""The page of the studio, served by viser: controls, the bent probe in three dimensions, charts and tables.

Handlers of the page only put requests into a queue; one thread works them off, so that no two changes meet. While a
slider moves, only the last value counts. All browser tabs show the same state.
"""

import base64
import io
import queue
import threading
import time
import webbrowser
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout, suppress
from functools import lru_cache, partial
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import viser

from probedesign.core.errors import InputError, MissingDependencyError, report_defect
from probedesign.core.files import exports_of
from probedesign.core.statistics import rms as rms_of
from probedesign.core.units import MM
from probedesign.design import Design, check_design
from probedesign.design.catalog import PROBES
from probedesign.design.edit import tables_of
from probedesign.design.io import load_design, render_design, write_design
from probedesign.probe import build_probe
from probedesign.reports.chart import Chart
from probedesign.studio.controls import DesignControls
from probedesign.studio.figures import (
    HEAD,
    N_CLOUD,
    DesignFigures,
    DrawnTouch,
    budget_figure,
    complete,
    direction_figure,
    drawn_touch,
    error_chart,
    estimate_cloud,
    fused_chart,
    located,
    preview,
    styled,
    summary_table,
)
from probedesign.studio.scene import StudioScene
from probedesign.studio.session import MOUNTINGS, PinnedDesign, Session, StudioTouch, with_knots
from probedesign.web import LOOPBACK
from probedesign.web.guard import PHONE_SCENE, PHONE_WIDTH, LoopbackServer, protect
from probedesign.web.scene import colour_bar

TITLE = "probedesign studio"
REST_SECONDS = 0.35  #: Time without a change after which everything is predicted.
#: Widths of the panels, and of the scene below which the panels share one side [px].
CONTROLS_WIDTH, CHARTS_WIDTH, MIN_SCENE_WIDTH = 340.0, 400.0, 300.0


def _save(design: Design, replace: bool) -> str:
    path = Path("designs") / f"{design.name}.toml"
    write_design(render_design(design), path, replace)
    return _written(f"wrote {path}", design)


def _written(message: str, design: Design) -> str:
    """Refresh the home page of the design, and return the message with its path."""
    from probedesign.web.home import write_home

    page = write_home(exports_of() / design.name, build_probe(design).model, f"designs/{design.name}.toml")
    return message if page is None else f"{message}; open {page}".removeprefix("; ")


def _open(design: Design, replace: bool) -> str:
    message = _written("", design)
    page = exports_of() / design.name / "index.html"
    if message and webbrowser.open(page.resolve().as_uri()):
        return f"opened {page}"
    raise InputError(f"{page} cannot be opened: open it by hand, or another program wrote it")


def _export(design: Design, replace: bool) -> str:
    from probedesign import cad

    try:
        manifest = cad.export_parts(design, exports_of() / design.name)
    except MissingDependencyError as error:
        raise InputError(str(error)) from None
    return _written(f"wrote {manifest['folder']}: {len(manifest['files']) + 1} files", design)


def _deploy(design: Design, replace: bool) -> str:
    from probedesign.frozen_probe import deploy_model

    path = exports_of() / design.name / f"{design.name}.probe.json"
    return _written(f"wrote {deploy_model(build_probe(design).model, path)}", design)


_built = lru_cache(maxsize=8)(build_probe)  # of the shadows
#: Writes files of a design, which may be replaced where the second argument says so, and returns a message.
Action = Callable[[Design, bool], str]
#: Action of each button by its label.
ACTIONS: dict[str, Action] = {"Save the design": _save, "Export the parts": _export, "Deploy the estimator": _deploy,
                              "Open the page of the design": _open}  # fmt: skip


class _RequestWaitsError(Exception):
    """A request ends what is computed while the hand rests."""


class StudioPage:
    """Serves the studio of a session until it is stopped.

    Attributes:
        session: the state.
        figures: what is shown of the current design.
    """

    def __init__(self, session: Session, port: int) -> None:
        """Start the server for this machine; the next free port is used."""
        self.session = session
        self._requests: queue.Queue[Callable[[], None]] = queue.Queue()
        self._request = self._requests.put
        self._latest: dict[str, Any] = {}
        self._lock = threading.Lock()
        self._probe = build_probe(session.design)
        self.figures = preview(self._probe, self._forces)
        self._drawn: DrawnTouch | None = None
        self._pending = {"prediction"}  # of prediction and cloud: what follows when the hand rests
        self._kept: tuple[str, bool] | None = None  # message of an action, shown until the next change
        self._stopped = threading.Event()
        self._window = protect(TITLE, head=HEAD, on_link=lambda text: self._request(lambda: self._open_link(text)))
        with redirect_stdout(io.StringIO()):  # viser prints a banner
            self._server = LoopbackServer(LOOPBACK[0], port, TITLE, verbose=False)
        self._controls()
        self._scene = StudioScene(self._server.scene, self.move)
        self._show()
        self._scene.set_camera(self._server.initial_camera)
        self._server.on_client_connect(self._lay_out)
        self._thread = threading.Thread(target=self._work, name="studio", daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{LOOPBACK[0]}:{self._server.get_port()}"

    @property
    def _forces(self) -> tuple[float, ...]:
        return tuple(1e-3 * force for force in self.session.forces_mN)

    def wait(self) -> None:
        """Return when the page is stopped; a signal interrupts it."""
        while not self._stopped.is_set():  # a signal within Event.wait can leave the lock that set() needs
            time.sleep(0.2)

    def stop(self) -> None:
        """Stop the server and the thread."""
        self._stopped.set()
        self._requests.put(lambda: None)
        self._thread.join(timeout=5.0)
        with redirect_stdout(io.StringIO()):
            self._server.stop()

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
        touch = {key.removeprefix("touch."): values.pop(key) for key in list(values) if key.startswith("touch.")}
        if touch:
            self.session.touch = StudioTouch(**{**vars(self.session.touch), **touch})
        if "forces" in values:
            self.session.forces_mN = values.pop("forces")
        before = self.session.design
        knots = {int(key.removeprefix("knot.")): values.pop(key) for key in list(values) if key.startswith("knot.")}
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
                request = self._requests.get(timeout=REST_SECONDS if self._pending else None)
            except queue.Empty:
                request = self._rest
            try:
                request()
            except InputError as error:  # the page has a box where a command has an option
                self._keep(str(error).replace("--force", "the box 'replace existing files'"), bad=True)
            except Exception as error:  # without this thread the page would show old numbers and say nothing
                self._keep(f"That failed: {report_defect(error)}", bad=True)
            else:
                continue
            if request == self._rest:  # it would fail again
                self._pending.clear()

    def _rest(self) -> None:
        """Predict everything once the hand rests; the next request ends it."""
        with suppress(_RequestWaitsError):
            if "prediction" in self._pending:
                self.figures = complete(self.session.design, self._yield)
                self._pending.remove("prediction")
                self._scene.end_change()
                self._show(shape=False)
            if "cloud" in self._pending:
                self._show_cloud()
                self._pending.remove("cloud")

    def _yield(self, _step: str, _share: float | None) -> None:
        if not self._requests.empty():
            raise _RequestWaitsError

    def _refresh(self, moved: bool = True) -> None:
        """Compute and show what follows from a change; `moved`: the design or the forces may have changed.

        All is computed before a browser draws: both share the processor where there is no GPU.
        """
        if moved:
            self._kept = None
            self._probe = build_probe(self.session.design)
            self.figures = preview(self._probe, self._forces)
            self._pending.add("prediction")
        if self._touch["cloud"].value:
            self._pending.add("cloud")
        self._show()

    # Controls

    def _controls(self) -> None:
        gui = self._server.gui
        self._theme(dark=False)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(CONTROLS_WIDTH)
        self._status = gui.add_html("")
        self._design_controls = DesignControls(gui, self.session, self.move)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Probe"):
            preset: Any = gui.add_dropdown("preset", ("-", *PROBES), initial_value="-")

            def load_preset(_: Any) -> None:
                if (name := preset.value) in PROBES:
                    preset.value = "-"  # so that the same one can be chosen later
                    self._request(lambda: self._load(load_design(name)))

            preset.on_update(load_preset)
            steps = gui.add_button_group("changes", ("undo", "redo"))
            steps.on_click(lambda _: self._request(lambda: self._step(steps.value)))
            for label, key, modifier, change in (
                ("Undo", "Z", "cmd/ctrl", lambda: self._step("undo")),
                ("Redo", "Z", "cmd/ctrl+shift", lambda: self._step("redo")),
                ("Exchange with the pinned design", "space", None, self._toggle),
                ("Fit the view", "F", None, self._fit),
            ):
                command: Any = gui.add_command(label, hotkey=key, modifier=modifier)  # type: ignore[arg-type]  # literals
                command.on_trigger(lambda _, change=change: self._request(change))
            self._design_controls.add_probe()
        with tabs.add_tab("Bench"):
            self._design_controls.add_bench()
        with tabs.add_tab("Touch"):
            self._design_controls.add_touch()
            gui.add_markdown("Drag the red point along the probe, or the end of its arrow: its direction is that of "
                             "the force, and it grows with the logarithm of the force.")  # fmt: skip
            cloud: Any = gui.add_checkbox(f"{N_CLOUD} estimates of it, on as many prints", False)
            cloud.on_update(lambda _: self._request(lambda: self._refresh(moved=False)))
            self._touch: dict[str, Any] = {"cloud": cloud, "text": gui.add_html(""), "scatter": gui.add_html("")}
        with tabs.add_tab("Save"):
            pin = gui.add_button("Pin this design", icon=viser.Icon.PINNED)
            pin.on_click(lambda _: self._request(lambda: self._pin(self.session.pin)))
            unpin = gui.add_button("Remove the last pin")
            unpin.on_click(lambda _: self._request(lambda: self._pin(self.session.unpin_last)))
            name: Any = gui.add_text("name", self.session.design.name)
            replace: Any = gui.add_checkbox("replace existing files", False)
            for label, action in ACTIONS.items():
                gui.add_button(label).on_click(partial(self._press, action))
            links = gui.add_html("")
            name.on_update(lambda _: self._request(lambda: self._refresh(moved=False)))
            self._save = {"name": name, "replace": replace, "links": links}
            dark = gui.add_checkbox("dark page", False)
            dark.on_update(lambda _: self._theme(dark.value))
        self._stacked, self._panel = False, gui.add_panel()
        charts = self._panel
        with charts.add_tab("Error"):
            self._charts = {"error": gui.add_html(""), "summary": gui.add_html("")}
        with charts.add_tab("Budget"):
            self._charts["budget"] = gui.add_html("")
        with charts.add_tab("Direction"):
            self._charts["direction"] = gui.add_html("")
        with charts.add_tab("Fused"):
            self._charts["fused"] = gui.add_html("")
        charts.dock_left()
        charts.set_width(CHARTS_WIDTH)

    def _theme(self, dark: bool) -> None:
        self._server.gui.configure_theme(
            show_logo=False, show_share_button=False, control_width="large", brand_color=(38, 84, 124), dark_mode=dark
        )

    def _lay_out(self, client: viser.ClientHandle) -> None:
        """Fit the camera of a browser; on a narrow screen, put the charts below the controls.

        All tabs share the arrangement: the last one that was opened decides.
        """
        # Not the size that viser reports: depending on the moment, the panels are already subtracted from it.
        width, height = self._window.size
        scene = width
        if width > PHONE_WIDTH:
            scene -= CONTROLS_WIDTH + CHARTS_WIDTH
            narrow = scene < MIN_SCENE_WIDTH
            if narrow:
                scene += CHARTS_WIDTH
            if narrow is not self._stacked:
                self._stacked = narrow
                # One column takes the width of either panel, whichever message the browser applies last.
                if narrow:
                    self._panel.dock_below(self._server.gui.main_panel)
                else:
                    self._panel.dock_left()
                self._panel.set_width(CONTROLS_WIDTH if narrow else CHARTS_WIDTH)
                self._server.gui.main_panel.set_width(CONTROLS_WIDTH)
        else:
            height *= PHONE_SCENE
        # A browser that moves panels takes the initial camera.
        for camera in (self._server.initial_camera, client.camera):
            self._scene.set_camera(camera, scene / max(height, 1.0))

    # Reactions

    def _load(self, design: Design) -> None:
        self.session.replace_design(design)
        self._save["name"].value = design.name
        self._refresh()

    def _step(self, name: str) -> None:
        if self.session.undo() if name == "undo" else self.session.redo():
            self._refresh()

    def _toggle(self) -> None:
        if self.session.toggle():
            self._refresh()
        elif not self.session.pinned:
            self._say("Space exchanges the design with a pinned one: pin one on the tab Save.")

    def _open_link(self, text: str) -> None:
        self.session.open_link(text)
        self._load(self.session.design)

    def _fit(self, turned: bool = True) -> None:
        """Place the cameras so that the whole probe is seen: beside it if `turned`, else from where each looks."""
        for client in self._server.get_clients().values():
            camera = client.camera
            direction = np.asarray(camera.position) - np.asarray(camera.look_at)
            self._scene.set_camera(camera, camera.aspect, None if turned else direction)
        self._scene.set_camera(self._server.initial_camera)

    def _pin(self, change: Callable[[], object]) -> None:
        change()
        self._refresh(moved=False)

    def _press(self, action: Action, _: Any) -> None:
        def act() -> None:
            design = self.session.design.model_copy(update={"name": self._save["name"].value.strip()})
            self._say("working ...")
            self._keep(
                action(check_design(tables_of(design)), self._save["replace"].value)
            )  # its name may be no file name

        self._request(act)

    # Show

    def _show(self, shape: bool = True) -> None:
        """Show everything in one update: what a browser draws in a frame is of one state."""
        session = self.session
        pinned = [(pin, complete(pin.design)) for pin in session.pinned]
        others = [_built(pin.design) for pin in session.pinned if pin.design != session.design]
        former = _built(session.former) if session.former and "prediction" in self._pending else None
        self._drawn = drawn_touch(self._probe, session.touch)
        estimate = located(self._probe, self._drawn) if self._drawn else None
        if estimate is None:
            touch = '<div class="bad">The probe buckles under this touch.</div>'
        elif estimate.ok:
            s, std, rms = (x / MM for x in (estimate.s_contact, estimate.std_s, rms_of(estimate.cov_surface_base)))
            touch = f"<table><tr><td>located</td><td>s = {s:.1f} ± {std:.1f} mm</td></tr>"
            touch += f"<tr><td>error</td><td>{rms:.2g} mm RMS, all error sources</td></tr></table>"
        else:
            touch = f'<div class="bad">The reading is not located: {escape(estimate.result)}.</div>'
        with self._lock:
            waiting = set(self._latest)
        with self._server.atomic():
            self._design_controls.show(waiting)
            self._show_text(pinned)
            self._touch["text"].content = styled(touch)
            if shape:
                self._scene.show_shape(self._probe, self._drawn, session.touch, others, former)
                self._touch["scatter"].content = styled("<p class=note>…</p>" if self._touch["cloud"].value else "")
            self._scene.show_errors(self.figures, estimate, session.touch)
            if not shape and self._scene.is_out_of_frame:
                self._fit(self._scene.has_turned)
        self._server.flush()

    def _show_cloud(self) -> None:
        points = np.zeros((0, 3))
        if self._touch["cloud"].value and self._drawn is not None:
            points = estimate_cloud(self._probe, self._drawn, self.session.touch, self._yield)
            rms = np.sqrt(np.mean(np.sum((points - self._drawn.p_surface) ** 2, axis=1))) / MM if len(points) else 0.0
            self._touch["scatter"].content = styled(
                f"<p class=note>{len(points)} of {N_CLOUD} located, {rms:.2g} mm RMS</p>"
            )
        with self._server.atomic():
            self._scene.show_cloud(points)
        self._server.flush()

    def _say(self, text: str, bad: bool = False) -> None:
        self._status.content = styled(
            f"<div class=status><div class={'bad' if bad else 'note'}>{escape(text)}</div></div>"
        )

    def _keep(self, text: str, bad: bool = False) -> None:
        self._kept = text, bad
        self._say(text, bad)

    def _show_text(self, pinned: Sequence[tuple[PinnedDesign, DesignFigures]]) -> None:
        session, figures = self.session, self.figures
        if self._kept is not None:
            self._say(*self._kept)
        elif session.refused:
            self._say(f"Not applied: {session.refused}", bad=True)
        elif figures.buckles:
            self._say("The probe buckles under its own weight as mounted.", bad=True)
        else:
            self._say(figures.prediction.verdict)
        lines = "".join(f"<li>{escape(text)}</li>" for text in figures.findings)
        check = f"<ul>{lines}</ul>" if lines else "<p class=note>Print check: no errors, no warnings.</p>"
        check = check if figures.complete else ""
        charts: dict[str, Chart | None] = {
            "error": error_chart(figures, pinned, self._forces), "budget": budget_figure(figures),
            "direction": direction_figure(figures, pinned, self._forces),
        }  # fmt: skip
        if figures.complete:
            charts["fused"] = fused_chart(figures, pinned)
        empty = {"direction": "Only a curved probe has another error in each direction: choose an axis."}
        for name, chart in charts.items():
            text = empty.get(name, "nothing is located") if chart is None else chart.svg().decode()
            self._charts[name].content = styled(text)
        dotted = (
            "<p class=note>Grey: not located. Solid: all error sources. Dotted: an exact probe. Dashed: pinned.</p>"
        )
        bar = colour_bar(f"error of {session.touch.force_mN:g} mN there")
        self._charts["summary"].content = styled(bar + dotted + summary_table(figures, pinned) + check)
        name = self._save["name"].value.strip()
        file = render_design(session.design.model_copy(update={"name": name})).encode()
        self._save["links"].content = styled(
            f'<a class=button download="{escape(name)}.toml" href="data:application/toml;base64,'
            f'{base64.b64encode(file).decode()}">Download {escape(name)}.toml</a>'
            f'<a class=button href="?state={session.link}" onclick="event.preventDefault();'
            "navigator.clipboard.writeText(this.href);this.textContent='Copied'\">Copy a link to this state</a>"
        )
