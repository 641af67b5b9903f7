"""Strip charts: the last seconds of wrench and estimate, thinned to what a page can draw."""

from collections.abc import Callable, Iterable

import numpy as np
import viser
from viser import uplot

from probedesign.frames import Array
from probedesign.live.view.scene import Charts
from probedesign.units import MM

AXIS_COLOURS = ("#d1495b", "#2e8b57", "#2a6fbb")
"""Of x, y and z."""
INTERVAL_COLOURS = ("#c81e28", "#e9a3a8", "#e9a3a8")
"""Of an estimate and the two ends of what it may be."""
AXIS: uplot.Axis = {
    "stroke": "#55606b",
    "grid": {"stroke": "#e7eaed", "width": 1},
    "ticks": {"show": False},
    "font": "11px sans-serif",
}
HEIGHT = 150


class Panel:
    """Words, charts and buttons."""

    def __init__(
        self, server: viser.ViserServer, ask: Callable[[str, str], None], note: str, length: float
    ) -> None:
        """Lay them out.

        Args:
            server: of the page.
            ask: takes what a person asks: a wish and its text.
            note: on what is drawn.
            length: of the probe [m].
        """
        self._length_mm = length / MM
        gui = server.gui
        gui.main_panel.dock_right()
        gui.main_panel.set_width(400.0)
        self._texts = [gui.add_html("")]
        self._buttons(gui, ask)
        for title in ("What was told", "Touches so far"):
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

    def _buttons(self, gui: viser.GuiApi, ask: Callable[[str, str], None]) -> None:
        tare = gui.add_button("Tare: nothing touches the probe now", icon=viser.Icon.SCALE)
        tare.on_click(lambda _: ask("tare", ""))
        text = gui.add_text("Note", "")
        mark = gui.add_button("Mark this moment", icon=viser.Icon.FLAG)
        mark.on_click(lambda _: ask("mark", text.value))
        start = gui.add_button("Start recording", icon=viser.Icon.PLAYER_RECORD, color="red")
        start.on_click(lambda _: ask("start recording", ""))
        stop = gui.add_button("Stop recording", icon=viser.Icon.PLAYER_STOP, color="gray")
        stop.on_click(lambda _: ask("stop recording", ""))

    def say(self, *texts: str) -> None:
        """The words, what was told and the touches, where they have changed."""
        for shown, text in zip(self._texts, texts, strict=True):
            if shown.content != text:
                shown.content = text

    def draw(self, charts: Charts) -> None:
        """The charts as they are now."""
        low, high = charts.window()
        for name, data in charts.lines().items():
            chart = self._charts[name]
            chart.data = tuple(np.ascontiguousarray(line, dtype=np.float64) for line in data)
            y = (0.0, 1.05 * self._length_mm) if name == "place" else _range(data[1:])
            chart.scales = {"x": {"time": False, "range": (low, high)}, "y": {"range": y}}


def _range(lines: Iterable[Array]) -> tuple[float, float]:
    """What the lines reach, and some air; NaN, which uPlot does not pass over, is left out."""
    values = np.concatenate(list(lines))
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 0.0)
    air = max(0.1 * (high - low), 0.5)
    return low - air, high + air


def _chart(gui: viser.GuiApi, title: str, names: tuple[str, ...], dots: bool = False) -> viser.GuiUplotHandle:
    """Empty lines over time; dots where there may be nothing between, which a line would bridge."""
    nothing = np.array([np.nan])
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
        data=(nothing,) * (1 + len(names)),
        series=tuple(series),
        title=title,
        scales={"x": {"time": False, "range": (0.0, 15.0)}, "y": {"auto": True}},
        axes=({**AXIS}, {**AXIS, "size": 46}),
        legend={"show": False},
        height=HEIGHT,
    )
