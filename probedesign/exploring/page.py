"""A cloud as a page that a browser opens from the disk: points to turn by the mouse, and the table of them."""

import json
import math
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from probedesign.exploring.camera import View
from probedesign.exploring.cloud import WITHIN_95, Cloud, Point
from probedesign.exploring.colour import colour_of
from probedesign.exploring.picture import FEWEST_MM, NORMAL, svg_of
from probedesign.exploring.table import PAIRS, line_of, unlocated_lines
from probedesign.frames import Array
from probedesign.units import MILLINEWTON, MM

SCRIPT = Path(__file__).with_name("turning.js")
STYLE = """
body { font: 10.5pt/1.4 Helvetica, Arial, "Liberation Sans", sans-serif; color: #111; max-width: 260mm;
  margin: 8mm auto; padding: 0 4mm }
h1 { font-size: 18pt; margin: 0 } .about { color: #444; margin: 1mm 0 3mm }
canvas { width: 100%; height: 150mm; border: 0.4pt solid #bbb; touch-action: none; cursor: grab; display: block }
#said { color: #333; min-height: 1.4em; margin: 1mm 0 5mm; font-size: 9.5pt }
table { border-collapse: collapse; font-size: 9.5pt }
th, td { text-align: right; padding: 0.8mm 3mm; border-bottom: 0.4pt solid #bbb; white-space: nowrap }
thead th { border-bottom: 1pt solid #111 }
@media print { canvas { display: none } }
"""
HEAD = ("point", "x [mm]", "y [mm]", "z [mm]", "± [mm]", "of it common [mm]", "force [mN]", "touches")


def page_of(cloud: Cloud, title: str, about: Sequence[str], outlines: Sequence[Array] = ()) -> bytes:
    """The page.

    Args:
        cloud: what was found.
        title: of the page.
        about: lines under it: what the numbers rest on.
        outlines: polygons that are known of the object [m], (k, 3) each.
    """
    lines = "<br>".join(map(escape, about))
    data = json.dumps(_data(cloud, outlines), allow_nan=False).replace("<", "\\u003c")
    still = svg_of(cloud, outlines).decode()
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        f'<meta name="viewport" content="width=device-width"><style>{STYLE}</style></head>\n<body><h1>{escape(title)}'
        f'</h1>\n<p class="about">{lines}</p>\n<canvas id="cloud" role="img" aria-label="points and their ellipsoids">'
        f'</canvas><noscript>{still}</noscript>\n<p id="said">Drag to turn, wheel to zoom, double click to begin anew.'
        f"</p>\n{_table(cloud)}{_unlocated(cloud)}\n"
        f'<script type="application/json" id="data">{data}</script>\n'
        f"<script>\n{SCRIPT.read_text()}</script></body></html>\n"
    ).encode()


def _data(cloud: Cloud, outlines: Sequence[Array]) -> dict[str, Any]:
    view = View()
    points = np.array([point.p_world for point in cloud.points]).reshape(-1, 3)
    everything = (
        np.concatenate([points, *outlines]) / MM if len(points) or len(outlines) else np.zeros((1, 3))
    )
    middle = 0.5 * (everything.min(axis=0) + everything.max(axis=0))
    radius = max(float(np.linalg.norm(everything - middle, axis=1).max()), 0.5 * FEWEST_MM)
    return {
        "azimuth": view.azimuth, "elevation": view.elevation, "middle": middle.tolist(), "radius": radius,
        "within": math.sqrt(WITHIN_95), "normal": NORMAL, "outlines": [(polygon / MM).tolist() for polygon in outlines],
        "points": [_point(number, point) for number, point in enumerate(cloud.points, 1)],
    }  # fmt: skip


def _point(number: int, point: Point) -> dict[str, Any]:
    cov = point.cov_world / MM**2
    return {
        "p": (point.p_world / MM).tolist(), "cov": [float(cov[i, j]) for _, i, j in PAIRS],
        "colour": "#{:02x}{:02x}{:02x}".format(*colour_of(point.rms / MM)), "said": line_of(number, point),
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
