"""The page of a recording's estimates: its touches, a replay in three dimensions, place, force and error over time."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from probedesign.core.frames import Array, rotation_under_gravity
from probedesign.core.statistics import rms, sigmas_95
from probedesign.core.units import MILLINEWTON, MM
from probedesign.design.catalog import assumed_text
from probedesign.estimation.estimate import RESULTS
from probedesign.estimation.estimator import Estimator
from probedesign.live.processing.estimates import COVARIANCE, Row
from probedesign.live.run import RecordingEstimates
from probedesign.mapping.contact_map import MAX_RMS_MM, MIN_RMS_MM, rms_colour
from probedesign.reports.chart import COLOURS, Chart, ChartAxis
from probedesign.reports.html_page import HtmlTable, ReportFigure, report_page

FREE = ("no_contact", "no_tare")  #: Results of a reading that no touch contains.
#: Results that neither begin nor end a touch: it is not known whether anything touches.
UNKNOWN = ("out_of_range", "not_converged")
#: Readings that are drawn as lines, and with a marker each; touches in the table of the page.
MAX_POINTS, MAX_MARKED, MAX_TOUCHES = 1500, 400, 60


@dataclass(frozen=True)
class RecordedTouch:
    """Consecutive readings with a contact."""

    start_s: float  #: start_s, end_s: time of its first and last reading.
    end_s: float
    readings: int  #: readings, located: number of its readings, and of those with the result "ok".
    located: int
    s_mm: tuple[float, float]  #: smallest and largest arclength of the located contacts; NaN if there is none.
    force_mN: float  #: largest force of the located contacts.
    rms_mm: float  #: median of their stated RMS errors.

    @property
    def words(self) -> str:
        """Return the touch as one line."""
        time = f"{self.start_s:.2f} ... {self.end_s:.2f} s: {self.located} of {self.readings} readings located"
        if not self.located:
            return time
        low, high = self.s_mm
        where = f"s = {low:.1f} mm" if high - low < 0.1 else f"s = {low:.1f} ... {high:.1f} mm"
        return f"{time}, {where}, up to {self.force_mN:.3g} mN, RMS error {self.rms_mm:.2g} mm in the median"


def touches_in(rows: Sequence[Row]) -> list[RecordedTouch]:
    """Return the touches of a recording: runs of estimates between those of the free probe."""
    runs: list[list[Row]] = [[]]
    for row in rows:
        if row["result"] in FREE:
            runs.append([])
        elif runs[-1] or row["result"] not in UNKNOWN:
            runs[-1].append(row)
    touches = []
    for run in filter(None, runs):
        while run[-1]["result"] in UNKNOWN:
            run.pop()
        located = [row for row in run if row["result"] == "ok"]
        s, force, median = (math.nan, math.nan), math.nan, math.nan
        if located:
            at = _column(located, "s_contact_mm")
            s, force = (float(at.min()), float(at.max())), float(_force(located).max())
            median = float(np.median(_rms(located)))
        times = float(run[0]["time_s"]), float(run[-1]["time_s"])
        touches.append(RecordedTouch(*times, len(run), len(located), s, force, median))
    return touches


def _column(rows: Sequence[Row], name: str) -> Array:
    return np.array([float(row[name]) for row in rows])


def _force(rows: Sequence[Row]) -> Array:
    force = [_column(rows, f"force_base_{axis}_N") for axis in "xyz"]
    return np.asarray(np.linalg.norm(force, axis=0) / MILLINEWTON)


def _rms(rows: Sequence[Row]) -> Array:
    variances = [_column(rows, f"cov_surface_base_{axis}{axis}_mm2") for axis in "xyz"]
    return np.asarray(np.sqrt(np.sum(variances, axis=0)))


def verdict(estimates: RecordingEstimates) -> str:
    """Return the result of a recording in one sentence."""
    rows, touches = estimates.rows, touches_in(estimates.rows)
    if not touches:
        return f"Nothing touched the probe in {len(rows)} estimates."
    located = [row for row in rows if row["result"] == "ok"]
    inside, number = sum(touch.readings for touch in touches), len(touches)
    text = f"{number} touch{'' if number == 1 else 'es'}: {len(located)} of {inside} readings located"
    if not located:
        return f"{text}."
    median = float(np.median(_rms(located)))
    return f"{text}, with a stated RMS error of {median:.2g} mm in the median."


def recording_page(estimates: RecordingEstimates) -> bytes:
    """Return the page of the estimates of a recording."""
    model, rows = estimates.estimator.model, estimates.rows
    about = [
        f"{estimates.recording.path}: {estimates.readings} readings, {estimates.samples} averaged to one estimate",
        f"probe {model.name}, geometry {model.fingerprint}",
        f"assumed of the probe until measured: {assumed_text(model.assumptions)}",
        *estimates.notes,
    ]
    replay = replay_element(estimates.estimator, rows, estimates.gravities, "The located touches, replayed")
    first = f'<section class="replay"><h2>The touches, replayed</h2>{replay}</section>\n' if replay else ""
    touches = touches_in(rows)
    counted = [[name, f"{estimates.counts[name]}", meaning]
               for name, meaning in RESULTS.items() if name in estimates.counts]  # fmt: skip
    by_result = HtmlTable(["result", "estimates", "meaning"], counted, worded=True)
    listed = [
        [f"{number}", f"{touch.start_s:.2f}", f"{touch.end_s:.2f}", f"{touch.readings}", f"{touch.located}",
         *((f"{touch.s_mm[0]:.1f} ... {touch.s_mm[1]:.1f}", f"{touch.force_mN:.3g}", f"{touch.rms_mm:.2g}")
           if touch.located else ("—", "—", "—"))]
        for number, touch in enumerate(touches[:MAX_TOUCHES], 1)
    ]  # fmt: skip
    left = len(touches) - MAX_TOUCHES
    more = f" {left} further touches are not listed." if left > 0 else ""
    note = f"A touch is a run of estimates with a contact. RMS error: stated, in the median of its readings.{more}"
    head = ["touch", "start [s]", "end [s]", "readings", "located", "s [mm]", "force up to [mN]", "RMS error [mm]"]
    after = [("Touches", HtmlTable(head, listed, note)), ("Estimates by result", by_result)]
    title = f"{estimates.recording.path.name}: located touches"
    return report_page(
        title, about, None, _figures(rows), opened=after, verdict=verdict(estimates), first=first, style=STYLE
    )


def _figures(rows: Sequence[Row]) -> list[ReportFigure]:
    if not any(row["result"] == "ok" for row in rows):
        return []
    step = -(-len(rows) // MAX_POINTS)
    shown = rows[::step]
    thinned = f" One of {step} readings is drawn." if step > 1 else ""
    gaps = " The lines end where no contact was located."
    s, std = (np.array([float(row[name]) for row in shown]) for name in ("s_contact_mm", "std_s_mm"))
    arclength = _over_time(shown, "arclength of the contact [mm]", [*(s - std), *(s + std)])
    finite = np.concatenate([[False], np.isfinite(s), [False]])
    for low, high in np.flatnonzero(np.diff(finite)).reshape(-1, 2).tolist():  # runs of located contacts
        time = _column(shown[low:high], "time_s")
        band = [*zip(time, (s + std)[low:high], strict=True), *zip(time[::-1], (s - std)[low:high][::-1], strict=True)]
        arclength.area([(float(a), float(b)) for a, b in band], COLOURS[1], 0.25)
    _draw(arclength, shown, s, COLOURS[1], "estimated, ± one standard deviation")
    if "true_s_contact_mm" in shown[0]:
        arclength.line(_column(shown, "time_s"), _column(shown, "true_s_contact_mm"), COLOURS[0], "5 3", name="true")
    force = _over_time(shown, "force [mN]", [*_force(shown), 0.0])
    _draw(force, shown, _force(shown), COLOURS[2])
    error = _over_time(shown, "RMS error [mm]", [*_rms(shown), 0.0])
    _draw(error, shown, _rms(shown), COLOURS[3])
    return [
        ReportFigure("Place of the contact", f"A pointer on a dot shows its values.{gaps}{thinned}", arclength.svg()),
        ReportFigure("Force on the probe", f"Magnitude of the located force.{gaps}{thinned}", force.svg()),
        ReportFigure("Stated error", f"RMS distance between true and located point.{gaps}{thinned}", error.svg()),
    ]


def _over_time(rows: Sequence[Row], label: str, values: Sequence[float]) -> Chart:
    time = _column(rows, "time_s")
    x = ChartAxis("time [s]", float(time[0]), max(float(time[-1]), float(time[0]) + 1e-3))
    return Chart(x, ChartAxis.spanning(label, values))


def _draw(chart: Chart, rows: Sequence[Row], values: Array, colour: str, name: str = "") -> None:
    chart.line(_column(rows, "time_s"), values, colour, mark="o" if len(rows) <= MAX_MARKED else "", name=name)


# the replay: one element with its data and scripts, drawn with gravity downwards

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
    gravity = gravities[chosen[0]]
    # with gravity downwards; without gravity the probe lies
    view = rotation_under_gravity(gravity if np.any(gravity) else np.array([1.0, 0.0, 0.0]))
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


def _vector(row: Row, name: str) -> Array:
    return np.array([float(row.get(name.format(axis), math.nan)) for axis in "xyz"])


def _rounded(metres: Array) -> Any:
    return np.round(metres / MM, 2).tolist()
