"""The page of a recording's estimates: its touches, a replay in three dimensions, place, force and error over time."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from probedesign.core.frames import Array
from probedesign.core.units import MILLINEWTON
from probedesign.estimation.estimate import RESULTS
from probedesign.live.processing.estimates import Row
from probedesign.live.run import RecordingEstimates
from probedesign.reports.chart import COLOURS, Chart, ChartAxis
from probedesign.reports.html_page import HtmlTable, ReportFigure, report_page
from probedesign.reports.replay import STYLE, replay_element

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
        place = f"s = {low:.1f} mm" if high - low < 0.1 else f"s = {low:.1f} ... {high:.1f} mm"
        return f"{time}, {place}, up to {self.force_mN:.3g} mN, RMS error {self.rms_mm:.2g} mm in the median"


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
        s, force, rms = (math.nan, math.nan), math.nan, math.nan
        if located:
            at = _column(located, "s_contact_mm")
            s, force = (float(at.min()), float(at.max())), float(_force(located).max())
            rms = float(np.median(_rms(located)))
        times = float(run[0]["time_s"]), float(run[-1]["time_s"])
        touches.append(RecordedTouch(*times, len(run), len(located), s, force, rms))
    return touches


def _column(rows: Sequence[Row], name: str) -> Array:
    return np.array([float(row[name]) for row in rows])


def _force(rows: Sequence[Row]) -> Array:
    """Return the magnitudes of the forces [mN]."""
    force = [_column(rows, f"force_base_{axis}_N") for axis in "xyz"]
    return np.asarray(np.linalg.norm(force, axis=0) / MILLINEWTON)


def _rms(rows: Sequence[Row]) -> Array:
    """Return the stated RMS errors of the touched points [mm]."""
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
    rms = float(np.median(_rms(located)))
    return f"{text}, with a stated RMS error of {rms:.2g} mm in the median."


def recording_page(estimates: RecordingEstimates) -> bytes:
    """Return the page of the estimates of a recording."""
    model, rows = estimates.estimator.model, estimates.rows
    about = [
        f"{estimates.recording.path}: {estimates.readings} readings, {estimates.samples} averaged to one estimate",
        f"probe {model.name}, geometry {model.fingerprint}",
        f"assumptions of the probe: {', '.join(model.assumptions) or 'nothing'}",
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
    place = _over_time(shown, "arclength of the contact [mm]", [*(s - std), *(s + std)])
    finite = np.concatenate([[False], np.isfinite(s), [False]])
    for low, high in np.flatnonzero(np.diff(finite)).reshape(-1, 2).tolist():  # runs of located contacts
        time = _column(shown[low:high], "time_s")
        band = [*zip(time, (s + std)[low:high], strict=True), *zip(time[::-1], (s - std)[low:high][::-1], strict=True)]
        place.area([(float(a), float(b)) for a, b in band], COLOURS[1], 0.25)
    _draw(place, shown, s, COLOURS[1], "estimated, ± one standard deviation")
    if "true_s_contact_mm" in shown[0]:
        place.line(_column(shown, "time_s"), _column(shown, "true_s_contact_mm"), COLOURS[0], "5 3", name="true")
    force = _over_time(shown, "force [mN]", [*_force(shown), 0.0])
    _draw(force, shown, _force(shown), COLOURS[2])
    error = _over_time(shown, "RMS error [mm]", [*_rms(shown), 0.0])
    _draw(error, shown, _rms(shown), COLOURS[3])
    return [
        ReportFigure("Place of the contact", f"A pointer on a dot shows its values.{gaps}{thinned}", place.svg()),
        ReportFigure("Force on the probe", f"Magnitude of the located force.{gaps}{thinned}", force.svg()),
        ReportFigure("Stated error", f"RMS distance between true and located point.{gaps}{thinned}", error.svg()),
    ]


def _over_time(rows: Sequence[Row], label: str, values: Sequence[float]) -> Chart:
    time = _column(rows, "time_s")
    x = ChartAxis("time [s]", float(time[0]), max(float(time[-1]), float(time[0]) + 1e-3))
    return Chart(x, ChartAxis.spanning(label, values))


def _draw(chart: Chart, rows: Sequence[Row], values: Array, colour: str, name: str = "") -> None:
    chart.line(_column(rows, "time_s"), values, colour, mark="o" if len(rows) <= MAX_MARKED else "", name=name)
