"""Words as HTML for the page. Whatever comes from outside is escaped."""

import math
from html import escape
from typing import TYPE_CHECKING

from probedesign.live.view.snapshot import Moment, Mood, Place
from probedesign.live.view.state import Counts, Keeper
from probedesign.units import MM

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table


COLOURS: dict[Mood, str] = {"good": "#1b7f4b", "fair": "#a86400", "bad": "#b3261e", "plain": "#46525e"}
TABLE = (
    "width:100%;border-collapse:collapse;font-size:13px;line-height:1.45;font-variant-numeric:tabular-nums"
)
SHOWN = 8
"""Events and touches on the page, the last ones."""


def words_html(moment: Moment) -> str:
    """The result on a ground of its colour, then everything else in two columns."""
    if not moment.words:
        return ""
    first, *rest = moment.words
    rows = "".join(
        f'<tr><td style="color:#75808b;padding-right:10px;vertical-align:top">{escape(said.name)}</td>'
        f'<td style="color:{COLOURS[said.mood] if said.mood != "plain" else "inherit"}">{escape(said.text)}</td></tr>'
        for said in rest
    )
    ground = (
        f"background:{COLOURS[first.mood]};color:white;border-radius:6px;padding:7px 10px;margin-bottom:8px"
    )
    return (
        f'<div style="padding:4px 12px"><div style="{ground};font-size:14px;font-weight:600">{escape(first.text)}</div>'
        f'<table style="{TABLE}">{rows}</table></div>'
    )


def events_html(moment: Moment) -> str:
    """What was told last, the newest on top."""
    lines = "".join(
        f'<tr><td style="color:#75808b;padding-right:8px;vertical-align:top;white-space:nowrap">{_when(time)}</td>'
        f"<td>{escape(line)}</td></tr>"
        for time, line in reversed(moment.events[-SHOWN:])
    )
    return f'<div style="padding:2px 12px"><table style="{TABLE};font-size:12px">{lines}</table></div>'


def touches_html(touches: tuple[Place, ...]) -> str:
    """Earlier touches, the newest on top."""
    if not touches:
        return '<div style="padding:2px 12px;font-size:12px;color:#75808b">none yet; each is kept when it ends</div>'
    rows = "".join(_touch(place) for place in reversed(touches[-SHOWN:]))
    head = (
        "<tr style='color:#75808b'><td>no.</td><td>s ± std [mm]</td><td>x, y, z [mm]</td><td>frame</td></tr>"
    )
    return f'<div style="padding:2px 12px"><table style="{TABLE};font-size:12px">{head}{rows}</table></div>'


def _touch(place: Place) -> str:
    x, y, z = (f"{float(value) / MM:z.1f}" for value in place.p_surface)
    frame = "world" if place.in_world else "base"
    s = f"{place.s / MM:.1f} ± {place.std_s / MM:.1f}"
    return f"<tr><td>{place.number}</td><td>{s}</td><td>{x}, {y}, {z}</td><td>{frame}</td></tr>"


def _when(time: float) -> str:
    return f"{time:.1f} s" if math.isfinite(time) else ""


A_SECOND = 8
STYLES: dict[Mood, str] = {"good": "bold green", "fair": "yellow", "bad": "bold red", "plain": ""}


class Terminal(Keeper):
    """A sink that draws what it is given at the bottom of a terminal until it is closed."""

    def __init__(self, title: str, counts: Counts = dict, console: "Console | None" = None) -> None:
        """Begin to draw.

        Args:
            title: of the table.
            counts: gives what the source counts: lost, dropped.
            console: where; standard output if None.
        """
        from rich.live import Live

        super().__init__(counts)
        self._title = title
        self._live = Live(console=console, get_renderable=self._table, refresh_per_second=A_SECOND)
        self._live.start()

    def close(self) -> None:
        """Leave the last words standing, and the cursor as it was."""
        self._live.stop()

    def _table(self) -> "Table":
        return table_of(self._title, self.moment(shaped=False))


def table_of(title: str, moment: Moment) -> "Table":
    """The words of a moment in two columns, and the touches so far."""
    from rich.table import Table
    from rich.text import Text

    table = Table(title=f"{title}, {moment.since:.1f} s", title_justify="left", show_header=False, box=None)
    for said in moment.words:
        table.add_row(Text(said.name, style="dim"), Text(said.text, style=STYLES[said.mood]))
    for place in moment.touches[-3:]:
        told = f"s {1e3 * place.s:.1f} ± {1e3 * place.std_s:.1f} mm"
        table.add_row(Text(f"touch {place.number}", style="dim"), Text(told))
    return table
