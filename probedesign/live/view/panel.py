"""The panels beside the scene: status text and buttons on the right, strip charts on the left."""

from collections.abc import Callable, Iterable

import numpy as np
import viser
from viser import uplot

from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.live.view.scene import StripCharts

AXIS_COLOURS = ("#d1495b", "#2e8b57", "#2a6fbb")
"""Colours of x, y and z."""
INTERVAL_COLOURS = ("#c81e28", "#e9a3a8", "#e9a3a8")
"""Colours of an estimate and of the ends of its interval."""
AXIS: uplot.Axis = {
    "stroke": "#55606b",
    "grid": {"stroke": "#e7eaed", "width": 1},
    "ticks": {"show": False},
    "font": "11px sans-serif",
}
HEIGHT = 150


class Panel:
    """Status text, charts and buttons."""

    def __init__(
        self, server: viser.ViserServer, send_command: Callable[[str, str], None], note: str, length: float
    ) -> None:
        """Create the panels.

        Args:
            server: server of the page.
            send_command: receives a command and its text.
            note: note on what is drawn.
            length: length of the probe [m].
        """
        self._length_mm = length / MM
        gui = server.gui
        gui.main_panel.dock_right()
        gui.main_panel.set_width(400.0)
        self._texts = [gui.add_html("")]
        self._buttons(gui, send_command)
        for title in ("Events", "Touches so far"):
            with gui.add_folder(title):
                self._texts.append(gui.add_html(""))
        if note:
            gui.add_markdown(note)
        strips = gui.add_panel()
        with strips.add_tab("Last 15 s"):
            self._charts = {
                "place": _chart(gui, "s of the contact and its 95 % [mm]", ("s", "from", "to"), dots=True),
                "push": _chart(gui, "force of the contact [mN]", ("F",), dots=True),
                "forces": _chart(gui, "force at the base [mN]: x red, y green, z blue", ("Fx", "Fy", "Fz")),
                "moments": _chart(
                    gui, "moment at the base [N·mm]: x red, y green, z blue", ("Mx", "My", "Mz")
                ),
            }
        strips.dock_left()
        strips.set_width(360.0)

    def _buttons(self, gui: viser.GuiApi, send_command: Callable[[str, str], None]) -> None:
        tare = gui.add_button("Tare: nothing touches the probe now", icon=viser.Icon.SCALE)
        tare.on_click(lambda _: send_command("tare", ""))
        text = gui.add_text("Note", "")
        mark = gui.add_button("Mark this moment", icon=viser.Icon.FLAG)
        mark.on_click(lambda _: send_command("mark", text.value))
        start = gui.add_button("Start recording", icon=viser.Icon.PLAYER_RECORD, color="red")
        start.on_click(lambda _: send_command("start recording", ""))
        stop = gui.add_button("Stop recording", icon=viser.Icon.PLAYER_STOP, color="gray")
        stop.on_click(lambda _: send_command("stop recording", ""))

    def show_text(self, *texts: str) -> None:
        """Update status, events and touches where they have changed."""
        for shown, text in zip(self._texts, texts, strict=True):
            if shown.content != text:
                shown.content = text

    def draw(self, charts: StripCharts) -> None:
        """Draw the charts."""
        low, high = charts.window()
        for name, data in charts.lines().items():
            chart = self._charts[name]
            chart.data = tuple(np.ascontiguousarray(line, dtype=np.float64) for line in data)
            y = (0.0, 1.05 * self._length_mm) if name == "place" else _range(data[1:])
            chart.scales = {"x": {"time": False, "range": (low, high)}, "y": {"range": y}}


def _range(lines: Iterable[Array]) -> tuple[float, float]:
    """Return the range of the lines with a margin; NaN, which uPlot does not ignore, is removed."""
    values = np.concatenate(list(lines))
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 0.0)
    air = max(0.1 * (high - low), 0.5)
    return low - air, high + air


def _chart(gui: viser.GuiApi, title: str, names: tuple[str, ...], dots: bool = False) -> viser.GuiUplotHandle:
    """Create an empty chart over time; dots instead of lines if values may be missing in between."""
    empty = np.array([np.nan])
    series = [uplot.Series(label="t [s]")]
    for i, (name, colour) in enumerate(zip(names, INTERVAL_COLOURS if dots else AXIS_COLOURS, strict=False)):
        drawn: uplot.Series_Points = {
            "show": dots,
            "size": 2.5 if i else 3.5,
            "fill": colour,
            "stroke": colour,
        }
        series.append(uplot.Series(label=name, stroke=colour, width=0.0 if dots else 1.6, points=drawn))
    return gui.add_uplot(
        data=(empty,) * (1 + len(names)),
        series=tuple(series),
        title=title,
        scales={"x": {"time": False, "range": (0.0, 15.0)}, "y": {"auto": True}},
        axes=({**AXIS}, {**AXIS, "size": 46}),
        legend={"show": False},
        height=HEIGHT,
    )
