"""A contact map as an HTML page that opens from the disk: points to rotate with the mouse, and their table."""

import json
import math
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from probedesign.core.units import MILLINEWTON, MM
from probedesign.mapping.contact_map import CHI2_95, ContactMap, MapPoint
from probedesign.mapping.map_files import COVARIANCE_ENTRIES, point_line, touch_numbers, unlocated_lines
from probedesign.reports.html_page import html_document
from probedesign.reports.map_picture import (
    MAGNIFICATIONS,
    NORMAL_LENGTH,
    STROKE_COLOUR,
    SYMBOL_SIZE,
    TRUTH_COLOUR,
    MapScene,
    ParallelProjection,
    hex_colour,
    map_svg,
    map_symbols,
)

SCRIPT = Path(__file__).with_suffix(".js")
STYLE = """canvas { width: 100%; height: 150mm; border: 0.4pt solid #bbb; touch-action: none; cursor: grab;
  display: block }
#status { color: #333; min-height: 1.4em; margin: 1mm 0 3mm; font-size: 9.5pt }
#times { margin: 0 0 1.5mm } #times label { margin-left: 3mm } #times input { vertical-align: -1px }
.legend { list-style: none; padding: 0; margin: 0 0 5mm; color: #333; font-size: 9.5pt }
.legend svg { vertical-align: -2px; margin-right: 1.5mm }
.still { display: none }
"""
STILL_STYLE = "canvas, #times, #status, .legend { display: none } .still { display: block }"
"""On paper and without scripts: the still picture, which has its own legend."""
HINT = "Drag to rotate, scroll to zoom, double-click to reset; point at a point to read its values."
HEAD = ("point", "x [mm]", "y [mm]", "z [mm]", "± [mm]", "common part [mm]", "force [mN]", "touches")


def map_page(scene: MapScene, title: str, about: Sequence[str]) -> bytes:
    """Return the page.

    Args:
        scene: what is shown.
        title: title of the page.
        about: lines below it, on the data and assumptions.
    """
    data = json.dumps(_data(scene), allow_nan=False).replace("<", "\\u003c")
    unlocated = "".join(f"<p>{escape(line)}.</p>" for line in unlocated_lines(scene.contact_map))
    body = (
        f"{_magnification_form(scene.magnification)}\n"
        '<canvas id="map" role="img" aria-label="points and their ellipsoids"></canvas>'
        f'<div class="still">{map_svg(scene).decode()}</div>\n<p id="status">{HINT}</p>\n{_legend(bool(scene.truth))}\n'
        f"{_table(scene.contact_map)}{unlocated}\n"
        f'<script type="application/json" id="data">{data}</script>\n'
        f"<script>\n{SCRIPT.read_text()}</script>"
    )
    style = f"{STYLE}@media print {{ {STILL_STYLE} }}\n"
    head = f"<noscript><style>{STILL_STYLE}</style></noscript>"
    return html_document(title, list(map(escape, about)), body, style, head)


def _magnification_form(initial: int) -> str:
    choices = "".join(
        f'<label><input type="radio" name="times" value="{times}"{" checked" if times == initial else ""}>'
        f"×{times}{' (in scale)' if times == 1 else ''}</label>"
        for times in MAGNIFICATIONS
    )
    return f'<form id="times">Magnification of ellipsoids {choices}</form>'


def _legend(truth: bool) -> str:
    width, height = SYMBOL_SIZE
    lines = "".join(
        f'<li><svg width="{width}" height="{height}" aria-hidden="true">{symbol.svg}</svg> '
        f"{escape(symbol.meaning)}</li>"
        for symbol in map_symbols("magnified as chosen above", truth)
    )
    return f'<ul class="legend">{lines}</ul>'


def _data(scene: MapScene) -> dict[str, Any]:
    view = ParallelProjection()
    return {
        "azimuth": view.azimuth, "elevation": view.elevation, "centre": scene.centre_mm.tolist(),
        "radius": scene.radius_mm, "radius_95": math.sqrt(CHI2_95), "normal": NORMAL_LENGTH, "hint": HINT,
        "truth": [(polygon / MM).tolist() for polygon in scene.truth], "truth_colour": TRUTH_COLOUR,
        "stroke_colour": STROKE_COLOUR,
        "points": [_point(number, point) for number, point in enumerate(scene.contact_map.points, 1)],
    }  # fmt: skip


def _point(number: int, point: MapPoint) -> dict[str, Any]:
    cov = point.cov_world / MM**2
    return {
        "p": (point.p_world / MM).tolist(), "cov": [float(cov[i, j]) for _, i, j in COVARIANCE_ENTRIES],
        "colour": hex_colour(point.rms / MM), "text": point_line(number, point),
        "normal": None if point.direction is None else point.direction.tolist(),
    }  # fmt: skip


def _table(contact_map: ContactMap) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in HEAD)
    rows = []
    for number, point in enumerate(contact_map.points, 1):
        common = math.sqrt(float(np.trace(point.cov_common))) / MM
        cells = (str(number), *(f"{value:z.2f}" for value in (*point.p_world / MM, point.rms / MM, common)),
                 f"{point.force / MILLINEWTON:.1f}", touch_numbers(point, ", "))  # fmt: skip
        rows.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"
