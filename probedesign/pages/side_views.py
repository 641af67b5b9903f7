"""The probe from the side and from above: how it bends under touches, and where it can be touched at all."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from probedesign.estimation.estimator import Estimator
from probedesign.frames import Array
from probedesign.pages.chart import COLOURS, DASHES, Axis, Chart, span_of
from probedesign.prediction.touches import DIRECTIONS
from probedesign.prediction.workspace import STEPS, Path, Workspace
from probedesign.rod.contact import solve_frictionless
from probedesign.units import MM

TOUCHES = ((0.4, 0.05), (0.6, 0.03), (0.8, 0.02))
"""Fractions and newtons of the touches whose shapes are drawn."""
_Z = "z, along the undeformed axis [mm]"


def draw_shapes(estimator: Estimator) -> bytes:
    """Free and under a few touches along ±x, seen along y; x downwards, as gravity is in a horizontal mount; an SVG."""
    model = estimator.model
    s = np.linspace(0.0, model.rod.length, 60)
    lines: list[tuple[Array, str, str, str]] = []
    dots: list[tuple[Array, str]] = []
    for (fraction, force), colour, dashes in zip(TOUCHES, COLOURS[1:], DASHES, strict=False):
        for side in ("-x", "+x"):
            contact = solve_frictionless(
                model.rod, model.gravity_base, fraction * model.rod.length, DIRECTIONS[side], force
            )
            if contact.result == "ok":
                name = f"{1e3 * force:g} mN at {fraction:g}" if side == "-x" else ""
                lines.append((contact.equilibrium.p_at(s) / MM, colour, dashes, name))
                dots.append((contact.equilibrium.p_contact_base / MM, colour))
    free = estimator.free()
    if free.ok:
        lines.insert(0, (free.p_at(s) / MM, "#000000", "", "free"))
    chart = _chart(
        np.concatenate([points for points, *_ in lines]) if lines else np.zeros((1, 3)), 0, "x [mm]"
    )
    for points, colour, dashes, name in lines:
        chart.line(points[:, 2].tolist(), points[:, 0].tolist(), colour, dashes, name=name, width=2.4)
    for dot, colour in dots:
        chart.line([float(dot[2])], [float(dot[0])], colour, mark="o")
    return chart.svg()


def draw_workspace(workspace: Workspace, across: int) -> bytes:
    """Where the centreline's contact point can be pushed to from two sides, seen at right angles to them; an SVG.

    Args:
        workspace: of a prediction.
        across: axis that the sides push along: 0 for ±x, seen along y; 1 for ±y, seen along x.
    """
    name = "xy"[across]
    sides = {f"+{name}": COLOURS[1], f"-{name}": COLOURS[2]}
    sheets = {side: _sheet(workspace.paths, side) for side in sides}
    if not len(sheets.get("-y", "-")) and "-y" in (workspace.area_mm2 or {}):
        sheets["-y"] = sheets["+y"] * np.array([1.0, -1.0, 1.0])
    points = np.concatenate([sheet.reshape(-1, 3) for sheet in sheets.values()] + [np.zeros((1, 3))])
    chart = _chart(points, across, f"{name} [mm]")
    for side, colour in sides.items():
        sheet = sheets[side]
        if len(sheet):
            _draw_sheet(chart, sheet, across, colour, f"pushed along {side}")
    free = next((sheet[:, 0] for sheet in sheets.values() if len(sheet)), np.zeros((0, 3)))
    chart.line(
        [0.0, *free[:, 2].tolist()], [0.0, *free[:, across].tolist()], "#000000", name="free", width=2.6
    )
    return chart.svg()


def _draw_sheet(chart: Chart, sheet: Array, across: int, colour: str, name: str) -> None:
    """The swept area with every place's path."""
    flat = np.concatenate([np.zeros((1, STEPS, 3)), sheet])[:, :, [2, across]]
    for low, high in pairwise(flat):
        corners = [*map(tuple, low.tolist()), *map(tuple, high[::-1].tolist())]
        chart.area(corners, colour, 0.16)
    for path in flat[1:]:
        chart.line(path[:, 0].tolist(), path[:, 1].tolist(), colour, width=1.0)
    chart.line(flat[:, -1, 0].tolist(), flat[:, -1, 1].tolist(), colour, mark="o", width=2.0, name=name)


def _sheet(paths: Sequence[Path], side: str) -> Array:
    along = sorted((path for path in paths if path.direction == side), key=lambda path: path.contact_fraction)
    return np.array([path.points for path in along]).reshape(-1, STEPS, 3)


def _chart(points: Array, across: int, label: str) -> Chart:
    x, y = (Axis(words, *span_of(points[:, i].tolist(), False)) for words, i in ((_Z, 2), (label, across)))
    return Chart(x, y, square=True, down=across == 0)
