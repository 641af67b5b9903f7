"""A cloud as a page that a browser opens from the disk: points to turn by the mouse, and the table of them."""

import json
import math
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from probedesign.mapping.colour import hex_of
from probedesign.mapping.contact_map import WITHIN_95, Cloud, Point
from probedesign.mapping.map_files import PAIRS, line_of, unlocated_lines
from probedesign.reports.html_page import html_document
from probedesign.reports.map_camera import View
from probedesign.reports.map_legend import STROKE_COLOUR, SWATCH, TRUTH_COLOUR, legend
from probedesign.reports.map_picture import NORMAL, svg_of
from probedesign.reports.map_scene import TIMES, Scene
from probedesign.units import MILLINEWTON, MM

SCRIPT = Path(__file__).with_name("map_page.js")
STYLE = """canvas { width: 100%; height: 150mm; border: 0.4pt solid #bbb; touch-action: none; cursor: grab;
  display: block }
#said { color: #333; min-height: 1.4em; margin: 1mm 0 3mm; font-size: 9.5pt }
#times { margin: 0 0 1.5mm } #times label { margin-left: 3mm } #times input { vertical-align: -1px }
.legend { list-style: none; padding: 0; margin: 0 0 5mm; color: #333; font-size: 9.5pt }
.legend svg { vertical-align: -2px; margin-right: 1.5mm }
.still { display: none }
"""
STILL = "canvas, #times, #said, .legend { display: none } .still { display: block }"
"""On paper and without a script: the still picture, which has its own legend."""
HINT = "Drag to turn, wheel to zoom, double click to begin anew; point at a point to read it."
HEAD = ("point", "x [mm]", "y [mm]", "z [mm]", "± [mm]", "of it common [mm]", "force [mN]", "touches")


def page_of(scene: Scene, title: str, about: Sequence[str]) -> bytes:
    """The page.

    Args:
        scene: what is shown.
        title: of the page.
        about: lines under it: what the numbers rest on.
    """
    data = json.dumps(_data(scene), allow_nan=False).replace("<", "\\u003c")
    body = (
        f"{_magnified(scene.times)}\n"
        '<canvas id="cloud" role="img" aria-label="points and their ellipsoids"></canvas>'
        f'<div class="still">{svg_of(scene).decode()}</div>\n<p id="said">{HINT}</p>\n{_legend(bool(scene.truth))}\n'
        f"{_table(scene.cloud)}{_unlocated(scene.cloud)}\n"
        f'<script type="application/json" id="data">{data}</script>\n'
        f"<script>\n{SCRIPT.read_text()}</script>"
    )
    style, head = f"{STYLE}@media print {{ {STILL} }}\n", f"<noscript><style>{STILL}</style></noscript>"
    return html_document(title, list(map(escape, about)), body, style, head)


def _magnified(shown: int) -> str:
    """The choice of how large ellipsoids are drawn."""
    choices = "".join(
        f'<label><input type="radio" name="times" value="{times}"{" checked" if times == shown else ""}>'
        f"×{times}{' (in scale)' if times == 1 else ''}</label>"
        for times in TIMES
    )
    return f'<form id="times">Ellipsoids drawn {choices}</form>'


def _legend(truth: bool) -> str:
    wide, high = SWATCH
    lines = "".join(
        f'<li><svg width="{wide}" height="{high}" aria-hidden="true">{entry.mark}</svg> {escape(entry.words)}</li>'
        for entry in legend("drawn as many times its size as chosen above", truth)
    )
    return f'<ul class="legend">{lines}</ul>'


def _data(scene: Scene) -> dict[str, Any]:
    view = View()
    return {
        "azimuth": view.azimuth, "elevation": view.elevation, "middle": scene.middle_mm.tolist(),
        "radius": scene.radius_mm, "within": math.sqrt(WITHIN_95), "normal": NORMAL, "hint": HINT,
        "truth": [(polygon / MM).tolist() for polygon in scene.truth], "truth_colour": TRUTH_COLOUR,
        "stroke_colour": STROKE_COLOUR,
        "points": [_point(number, point) for number, point in enumerate(scene.cloud.points, 1)],
    }  # fmt: skip


def _point(number: int, point: Point) -> dict[str, Any]:
    cov = point.cov_world / MM**2
    return {
        "p": (point.p_world / MM).tolist(), "cov": [float(cov[i, j]) for _, i, j in PAIRS],
        "colour": hex_of(point.rms / MM), "said": line_of(number, point),
        "normal": None if point.direction is None else point.direction.tolist(),
    }  # fmt: skip


def _table(cloud: Cloud) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in HEAD)
    rows = []
    for number, point in enumerate(cloud.points, 1):
        common = math.sqrt(float(np.trace(point.cov_common))) / MM
        numbers = ", ".join(str(touch.series.number) for touch in point.touches)
        cells = (str(number), *(f"{value:z.2f}" for value in (*point.p_world / MM, point.rms / MM, common)),
                 f"{point.force / MILLINEWTON:.1f}", numbers)  # fmt: skip
        rows.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"


def _unlocated(cloud: Cloud) -> str:
    return "".join(f"<p>{escape(line)}.</p>" for line in unlocated_lines(cloud))
