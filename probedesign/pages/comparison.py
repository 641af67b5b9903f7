"""Several designs side by side: one table, and the same axes for all."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from probedesign.design import Design
from probedesign.errors import InputError
from probedesign.pages.chart import COLOURS, DASHES, MARKS, Axis, Chart, span_of
from probedesign.prediction.predict import Prediction
from probedesign.prediction.press_schedule import MAX_TOUCHES, PressSchedule
from probedesign.probe import build_probe
from probedesign.reports.html_page import HtmlTable, Section, report_page
from probedesign.search.task import Task
from probedesign.search.worth import FIGURES, Touched, Worth, touches, worth
from probedesign.units import MM

MOST = 6
PLACES = tuple(round(0.2 + 0.05 * k, 2) for k in range(16))
SIDE = "+y"
"""Sideways to the gravity of a horizontal mount, as in the task."""
FORCES_N = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05)


@dataclass(frozen=True)
class Compared:
    """One design of several.

    Attributes:
        design: it.
        worth: its figures in the task.
        along: its touches at `PLACES`.
        by_force: error as the task combines its places, at each of `FORCES_N` [m]; infinite where it gives way.
        prediction: pushed sideways with the task's force: what is felt, borne and, fused, left with all causes.
    """

    design: Design
    worth: Worth
    along: Touched
    by_force: tuple[float, ...]
    prediction: Prediction


def compare(designs: Sequence[Design], task: Task) -> list[Compared]:
    """The same questions to every design.

    Raises:
        InputError: fewer than two, or more than can be told apart.
    """
    if not 2 <= len(designs) <= MOST:
        raise InputError(f"compare takes 2 to {MOST} designs; {len(designs)} given")
    return [_compared(design, task) for design in designs]


def _compared(design: Design, task: Task) -> Compared:
    probe = build_probe(design)
    model, moments = probe.model, task.moments_about
    prediction = probe.predict(
        forces_N=(task.force_N,), directions=(SIDE,),
        tolerances=task.priors(model),
        pressing=PressSchedule(min(max(task.touches, 2), MAX_TOUCHES), moments),
    )  # fmt: skip
    rms = tuple(
        task.combined(touches(model, replace(task, forces_N=(f,)), slipping=False).errors) for f in FORCES_N
    )
    along = replace(task, fractions=PLACES, forces_N=(task.force_N,), gravities=task.gravities[:1])
    return Compared(design, worth(design, task), touches(model, along, slipping=False), rms, prediction)


def table_of(compared: Sequence[Compared]) -> HtmlTable:
    """A row a figure, a column a design."""
    rows = [[name, *(_cell(getattr(one.worth, name)) for one in compared)] for name in FIGURES]
    return HtmlTable(["", *(one.design.name for one in compared)], rows)


def comparison_page(compared: Sequence[Compared], task: Task) -> bytes:
    """The page."""
    touched = task.text.split(", all causes")[0] + ", all causes counted"
    drawn: list[tuple[str, str, bytes]] = [
        ("How well along the probe?", f"{touched}. A line ends where the probe gives way.",
         _lines(compared, _along, _PLACE, _ERROR)),
        ("How well at which force?", "The same, over the task's places, by the strongest force.",
         _lines(compared, _by_force, Axis("contact force [mN]", 0.9, 55.0, log=True), _ERROR)),
        ("What is left with all causes?", f"{compared[0].prediction.pressing.text}, up to {1e3 * task.force_N:g} mN, "
         "all causes of the error counted, pushed sideways.", _lines(compared, _all_causes, _PLACE, _ERROR)),
        ("From which force on is it felt?", "Smallest force told from none every other time, one false alarm an hour.",
         _lines(compared, _felt, _PLACE, "smallest detectable force [mN]")),
        ("How hard can one press?",
         "Until the probe gives way, an object slips off the tip or the sensor's range ends, "
         "pushed sideways.", _lines(compared, _most, _PLACE, "greatest force [mN]")),
        ("What do they look like?", "Diameter along the undeformed axis.",
         _lines(compared, _outline, "s, base to tip [mm]", "diameter [mm]", from_zero=True)),
        ("How do they hang?", "Free of touch, under gravity as mounted, seen along y, x downwards.",
         _draw_sag(compared)),
    ]  # fmt: skip
    names = " · ".join(one.design.name for one in compared)
    assumed = [
        f"{one.design.name} assumes {', '.join(one.design.assumptions) or 'nothing'}" for one in compared
    ]
    sections = [Section(*one) for one in drawn]
    return report_page(f"Compared: {names}", [task.text, *assumed], table_of(compared), sections)


_Line = tuple[Sequence[float], Sequence[float]]
_PLACE = Axis("contact, fraction of the length", 0.0, 1.05, ticks=(0.0, 0.2, 0.4, 0.6, 0.8, 1.0))
_ERROR = "contact error, RMS [mm]"


def _lines(
    compared: Sequence[Compared],
    line: Callable[[Compared], _Line],
    x: Axis | str,
    y: str,
    from_zero: bool = False,
) -> bytes:
    """A line a design; logarithmic upwards unless it is from zero."""
    lines = [line(one) for one in compared]
    low, high = span_of([v for _, values in lines for v in values], not from_zero)
    along = x if isinstance(x, Axis) else Axis(x, *span_of([v for values, _ in lines for v in values], False))
    chart = Chart(along, Axis(y, 0.0 if from_zero else low, high, log=not from_zero))
    for one, (places, values), colour, dashes, mark in zip(
        compared, lines, COLOURS, DASHES, MARKS, strict=False
    ):
        chart.line(places, values, colour, dashes, mark, one.design.name)
    return chart.svg()


def _along(one: Compared) -> _Line:
    return PLACES, _shown(one.along.errors)


def _by_force(one: Compared) -> _Line:
    return [1e3 * force for force in FORCES_N], _shown(one.by_force)


def _all_causes(one: Compared) -> _Line:
    cells = one.prediction.fused
    return [c.contact_fraction for c in cells], [
        _number(c.predicted_error_mm if c.result == "ok" else None) for c in cells
    ]


def _felt(one: Compared) -> _Line:
    rows = one.prediction.detection
    return [row.contact_fraction for row in rows], [_number(row.detectable_force_mN) for row in rows]


def _most(one: Compared) -> _Line:
    rows = one.prediction.reach
    return [row.contact_fraction for row in rows], [1e3 * _number(row.greatest_force_N) for row in rows]


def _outline(one: Compared) -> _Line:
    s, d = np.array(one.design.probe.knots_mm).T
    return s.tolist(), d.tolist()


def _draw_sag(compared: Sequence[Compared]) -> bytes:
    hung = []
    for one in compared:
        probe = build_probe(one.design)
        free = probe.rod.solve(probe.model.gravity_base)
        s = np.linspace(0.0, probe.length, 60)
        hung.append(free.p_at(s) / MM if free.ok else np.full((1, 3), np.nan))
    points = np.concatenate(hung)
    x = Axis("z, along the undeformed axis [mm]", *span_of(points[:, 2].tolist(), False))
    chart = Chart(x, Axis("x [mm]", *span_of(points[:, 0].tolist(), False)), square=True, down=True)
    for one, p, colour, dashes in zip(compared, hung, COLOURS, DASHES, strict=False):
        chart.line(p[:, 2].tolist(), p[:, 0].tolist(), colour, dashes, name=one.design.name)
    return chart.svg()


def _shown(errors: Sequence[float]) -> list[float]:
    return [error / MM if np.isfinite(error) else np.nan for error in errors]


def _number(value: float | None) -> float:
    return np.nan if value is None else value


def _cell(value: float | int | None) -> str:
    return "none" if value is None else f"{value:.4g}"
