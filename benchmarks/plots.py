"""What a solution costs, drawn against how much of it there is."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from probedesign.core.frames import Array

PICTURE = Path(__file__).parents[1] / "docs/pictures/cost.png"
BLUE, GREY = "#1f5fa8", "#999999"


class Cost(NamedTuple):
    """One series.

    Attributes:
        amount: of cases or steps, increasing, (k,).
        seconds: that they took, (k,).
    """

    amount: Array
    seconds: Array


def draw_cost(panels: Mapping[str, Mapping[str, Cost]], path: Path = PICTURE) -> None:
    """Write a picture of one panel for each of `panels`: by what its x axis is called, series by their names.

    Both axes are logarithmic; a grey line of slope 1 through each series' last point shows cost in proportion.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.6 * len(panels), 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = np.atleast_1d(figure.subplots(1, len(panels), squeeze=False)[0])
    for ax, (amount_of, series) in zip(axes, panels.items(), strict=True):
        for mark, (name, cost) in zip("osv^D", series.items(), strict=False):
            along = cost.seconds[-1] / cost.amount[-1] * cost.amount
            ax.plot(cost.amount, along, color=GREY, lw=1.0, zorder=1)
            ax.plot(cost.amount, cost.seconds, mark, color=BLUE, ms=5, label=name)
        ax.plot([], [], color=GREY, lw=1.0, label="in proportion")
        ax.set(xscale="log", yscale="log", xlabel=amount_of, ylabel="seconds")
        ax.grid(True, which="major", color="#dddddd", lw=0.6)
        ax.legend(frameon=False)
    figure.savefig(path, dpi=150)


def slope(cost: Cost) -> float:
    """Of the straight line through a series on logarithmic axes: 1 where the cost is in proportion."""
    return float(np.polyfit(np.log(cost.amount), np.log(cost.seconds), 1)[0])
