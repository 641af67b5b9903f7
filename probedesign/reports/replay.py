"""Replay of a recording's estimates in three dimensions: the bent probe, the located touch, its force and ellipsoid.

The replay is one HTML element with its data and scripts, for a page that needs no network. It is drawn with gravity
downwards.
"""

import json
import math
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from probedesign.core.frames import Array
from probedesign.core.statistics import rms, sigmas_95
from probedesign.core.units import MM
from probedesign.estimation.estimator import Estimator
from probedesign.live.processing.estimates import COVARIANCE, Row
from probedesign.mapping.contact_map import MAX_RMS_MM, MIN_RMS_MM, rms_colour

#: Of a replay: readings that are shown, evenly chosen, and points of the centreline. A frame takes about half a
#: kilobyte.
MAX_FRAMES, STATIONS = 240, 25
ARROW = 0.25  #: Length of the arrow of the largest force over that of the probe.
AZIMUTH, ELEVATION = math.radians(-25.0), math.radians(18.0)
FLAT = 2.2  #: Width over height of a probe that lies, whose picture may be wider than high.
FOLDER = Path(__file__).parent
ORBIT = FOLDER / "orbit.js"
STYLE = """#replay { width: 100%; height: 84mm; border: 0.4pt solid #bbb; color: #111; touch-action: pan-y;
  cursor: grab; display: block; box-sizing: border-box }
.player { display: flex; gap: 3mm; align-items: center; margin: 1.5mm 0 }
.player button { font: inherit; min-width: 18mm; padding: 0.8mm 3mm } .player input { flex: 1; min-width: 0 }
#replay-text { min-height: 2.8em } @media print { .replay { display: none } }
"""
HINT = (
    "Drag or use the arrow keys to rotate, scroll to zoom, double-click to reset. Arrow: force on the probe, in "
    f"proportion. Dot: located point with its 95 % ellipsoid, by RMS error from blue ({MIN_RMS_MM:g} mm or less) to "
    f"red ({MAX_RMS_MM:g} mm or more)."
)


def replay_element(estimator: Estimator, rows: Sequence[Row], gravities: Sequence[Array], label: str) -> str:
    """Return the replay as HTML; empty without a located reading. A page may have one, with `STYLE` in its style sheet.

    Args:
        estimator: of the recorded probe.
        rows: estimates in order, one per reading, as of `estimate_row`.
        gravities: gravity in base axes at each row [m/s²], (3,).
        label: text alternative.
    """
    located = [row for row in rows if row["result"] == "ok"]
    if not located:
        return ""
    known = any("true_s_contact_mm" in row for row in rows)
    data = json.dumps(_data(estimator, rows, gravities, located), allow_nan=False).replace("<", "\\u003c")
    truth = " Cross: true point of the simulation." if known else ""
    return (
        f'<div class="replay"><canvas id="replay" role="img" tabindex="0" aria-label="{escape(label)}"></canvas>'
        '<div class="player"><button type="button" id="replay-play">Pause</button>'
        f'<input type="range" id="replay-time" min="{rows[0]["time_s"]}" max="{rows[-1]["time_s"]}" step="any" '
        'aria-label="time of the recording in seconds"></div>'
        f'<p id="replay-text"></p><p>{escape(HINT + truth)}</p>'
        f'<script type="application/json" id="replay-data">{data}</script>'
        f"<script>{ORBIT.read_text('utf-8')}{(FOLDER / 'replay.js').read_text('utf-8')}</script></div>"
    )


def _data(
    estimator: Estimator, rows: Sequence[Row], gravities: Sequence[Array], located: Sequence[Row]
) -> dict[str, Any]:
    rod = estimator.model.rod
    chosen = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), MAX_FRAMES)).round().astype(int))
    view = upright(gravities[chosen[0]])
    largest = max(float(np.linalg.norm(_vector(row, "force_base_{}_N"))) for row in located)
    arrow = ARROW * rod.length / MM / largest
    frames = [_frame(estimator, rows[i], gravities[i], view, arrow) for i in chosen]
    bodies = np.array([p for frame in frames if (p := frame["p"]) is not None]).reshape(-1, 3)
    points = np.concatenate([bodies, [frame["contact"]["p"] for frame in frames if "contact" in frame]])
    low, high = points.min(axis=0), points.max(axis=0)
    centre = 0.5 * (low + high)
    lies = high[2] - low[2] < np.hypot(*(high - low)[:2])
    s = np.linspace(0.0, rod.length, STATIONS)
    return {
        "azimuth": AZIMUTH, "elevation": ELEVATION, "centre": centre.tolist(), "flat": FLAT if lies else 1.0,
        "radius": float(np.linalg.norm(points - centre, axis=1).max()), "radius_95": sigmas_95(3),
        "radius_mm": _rounded(rod.radius_at(s)), "axes": dict(zip("xyz", view.T.tolist(), strict=True)),
        "note": "ellipsoids in scale", "frames": frames,
    }  # fmt: skip


def _frame(estimator: Estimator, row: Row, gravity: Array, view: Array, arrow: float) -> dict[str, Any]:
    """Return what is drawn of one reading, in the axes of the view [mm]; the force in lengths of its arrow."""
    rod, ok = estimator.model.rod, row["result"] == "ok"
    time = float(row["time_s"])
    shape = estimator.free(gravity)
    frame: dict[str, Any] = {"t": time, "text": f"{time:.2f} s: {row['result']}"}
    if ok:
        force = _vector(row, "force_base_{}_N")
        shape = rod.solve(gravity, force, float(row["s_contact_mm"]) * MM)
        p = _vector(row, "p_surface_base_{}_mm")
        cov = np.zeros((3, 3))
        for pair, i, j in COVARIANCE:
            cov[i, j] = cov[j, i] = float(row[f"cov_surface_base_{pair}_mm2"])
        error = rms(cov)
        turned = view @ cov @ view.T
        frame["contact"] = {
            "p": _rounded(view @ p * MM), "cov": [round(float(turned[i, j]), 4) for _, i, j in COVARIANCE],
            "force": _rounded(view @ force * arrow * MM), "colour": "#{:02x}{:02x}{:02x}".format(*rms_colour(error)),
        }  # fmt: skip
        size = 1e3 * float(np.linalg.norm(force))
        s, std = float(row["s_contact_mm"]), float(row["std_s_mm"])
        frame["text"] += f", {size:.3g} mN at s = {s:.1f} ± {std:.2g} mm; RMS error {error:.2g} mm"
    if not ok and row["result"] != "no_contact":  # touched somewhere: grey, in its shape without a touch
        frame["free"] = True
        frame["text"] += "; drawn without the touch"
    frame["p"] = _rounded(shape.p_at(np.linspace(0.0, rod.length, STATIONS)) @ view.T) if shape.ok else None
    true = _vector(row, "true_p_surface_base_{}_mm")
    if np.isfinite(true).all():
        frame["true"] = _rounded(view @ true * MM)
    return frame


def upright(gravity: Array) -> Array:
    """Return the rotation from base axes to axes of a view with gravity along -z, (3, 3); the probe points along x.

    A probe that points up or down keeps its x axis to the right; without gravity the probe lies.
    """
    size = float(np.linalg.norm(gravity))
    up = -np.asarray(gravity, dtype=float) / size if size > 0.0 else np.array([-1.0, 0.0, 0.0])
    along = np.array([0.0, 0.0, 1.0]) - up[2] * up
    if np.linalg.norm(along) < 1e-3:
        along = np.array([1.0, 0.0, 0.0]) - up[0] * up
    along /= np.linalg.norm(along)
    return np.stack([along, np.cross(up, along), up])


def _vector(row: Row, name: str) -> Array:
    return np.array([float(row.get(name.format(axis), math.nan)) for axis in "xyz"])


def _rounded(metres: Array) -> Any:
    return np.round(metres / MM, 2).tolist()
