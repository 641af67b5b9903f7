"""Several designs side by side: one table, and the same axes for all."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from probedesign.design import Design
from probedesign.errors import InputError
from probedesign.pages.page import Section, TextTable, page_of
from probedesign.probe import build_probe
from probedesign.report import blank, svg
from probedesign.search.task import Task
from probedesign.search.worth import FIGURES, Touched, Worth, touches, worth
from probedesign.units import MM

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST = 6
COLOURS = ("#000000", "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00")
"""Okabe and Ito's, for colour-blind readers; markers and dashes tell them apart in grey."""
MARKS = ("o-", "s--", "^-.", "D:", "v-", "x--")
PLACES = tuple(round(0.2 + 0.05 * k, 2) for k in range(16))
FORCES_N = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05)


@dataclass(frozen=True)
class Compared:
    """One design of several.

    Attributes:
        design: it.
        worth: its figures in the task.
        along: its touches at `PLACES`.
        by_force: RMS over the task's places at each of `FORCES_N` [m]; infinite where it gives way.
    """

    design: Design
    worth: Worth
    along: Touched
    by_force: tuple[float, ...]


def compare(designs: Sequence[Design], task: Task) -> list[Compared]:
    """The same questions to every design.

    Raises:
        InputError: fewer than two, or more than can be told apart.
    """
    if not 2 <= len(designs) <= MOST:
        raise InputError(f"compare takes 2 to {MOST} designs; {len(designs)} given")
    return [_compared(design, task) for design in designs]


def _compared(design: Design, task: Task) -> Compared:
    model = build_probe(design).model
    rms = tuple(touches(model, replace(task, force_N=force)).rms for force in FORCES_N)
    return Compared(design, worth(design, task), touches(model, replace(task, fractions=PLACES)), rms)


def table_of(compared: Sequence[Compared]) -> TextTable:
    """A row a figure, a column a design."""
    rows = [[name, *(_cell(getattr(one.worth, name)) for one in compared)] for name in FIGURES]
    return TextTable(["", *(one.design.name for one in compared)], rows)


def comparison_page(compared: Sequence[Compared], task: Task) -> bytes:
    """The page.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """
    touched = task.text.split(", RMS over")[0]
    drawn: list[tuple[str, str, Callable[[Axes, Sequence[Compared]], None]]] = [
        ("How well along the probe?", f"{touched}. A line ends where the probe gives way.", _draw_along),
        (
            "How well at which force?",
            "The same, RMS over the task's places, by the strongest force.",
            _draw_force,
        ),
        ("What do they look like?", "Diameter along the undeformed axis.", _draw_outline),
        ("How do they hang?", "Free of touch, under gravity as mounted, seen along y.", _draw_sag),
    ]
    sections = [Section(heading, caption, _figure(compared, draw)) for heading, caption, draw in drawn]
    names = " · ".join(one.design.name for one in compared)
    assumed = [
        f"{one.design.name} assumes {', '.join(one.design.assumptions) or 'nothing'}" for one in compared
    ]
    return page_of(f"Compared: {names}", [task.text, *assumed], table_of(compared), sections)


def _figure(compared: Sequence[Compared], draw: "Callable[[Axes, Sequence[Compared]], None]") -> bytes:
    figure = blank(6.4, 4.4)
    ax = figure.subplots()
    draw(ax, compared)
    ax.grid(True, alpha=0.25)
    ax.legend(fontsize=9)
    return svg(figure)


def _draw_along(ax: "Axes", compared: Sequence[Compared]) -> None:
    for one, colour, mark in zip(compared, COLOURS, MARKS, strict=False):
        ax.plot(PLACES, _shown(one.along.errors), mark, color=colour, ms=4, label=one.design.name)
    ax.set(yscale="log", xlabel="contact, fraction of the length", ylabel="contact error, RMS [mm]")
    _plain(ax, both=False)


def _draw_force(ax: "Axes", compared: Sequence[Compared]) -> None:
    for one, colour, mark in zip(compared, COLOURS, MARKS, strict=False):
        ax.plot(
            1e3 * np.array(FORCES_N), _shown(one.by_force), mark, color=colour, ms=4, label=one.design.name
        )
    ax.set(xscale="log", yscale="log", xlabel="contact force [mN]", ylabel="contact error, RMS [mm]")
    _plain(ax, both=True)


def _draw_outline(ax: "Axes", compared: Sequence[Compared]) -> None:
    for one, colour, mark in zip(compared, COLOURS, MARKS, strict=False):
        s, d = np.array(one.design.probe.knots_mm).T
        ax.plot(s, d, mark, color=colour, ms=4, label=one.design.name)
    ax.set(xlabel="s, base to tip [mm]", ylabel="diameter [mm]", ylim=(0.0, None))


def _draw_sag(ax: "Axes", compared: Sequence[Compared]) -> None:
    for one, colour, mark in zip(compared, COLOURS, MARKS, strict=False):
        probe = build_probe(one.design)
        free = probe.rod.solve(probe.model.gravity_base)
        if free.ok:
            p = free.p_at(np.linspace(0.0, probe.length, 60)) / MM
            ax.plot(p[:, 2], p[:, 0], mark[1:], color=colour, label=one.design.name)
    ax.set(xlabel="z, along the undeformed axis [mm]", ylabel="x [mm]")
    ax.set_aspect("equal", adjustable="datalim")
    ax.invert_yaxis()  # gravity of a horizontal mount points along +x: down


def _shown(errors: Sequence[float]) -> list[float]:
    return [error / MM if np.isfinite(error) else np.nan for error in errors]


def _plain(ax: "Axes", both: bool) -> None:
    """0.1, 1, 10 instead of powers."""
    from matplotlib.ticker import FuncFormatter, LogLocator

    for axis in (ax.yaxis, ax.xaxis) if both else (ax.yaxis,):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(FuncFormatter(lambda *_: ""))


def _cell(value: float | int | None) -> str:
    return "none" if value is None else f"{value:.4g}"
