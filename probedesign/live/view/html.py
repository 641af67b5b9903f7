"""Words as HTML for the page. Whatever comes from outside is escaped."""

import math
from html import escape

from probedesign.live.view.moment import Moment, Mood, Place
from probedesign.units import MM

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
