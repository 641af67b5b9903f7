"""Figures of the documentation with benchmark results."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.error_statistics import CHI2_95
from probedesign.core.frames import Array

PICTURES = Path(__file__).parents[1] / "docs/pictures"
BLUE, ORANGE, GREY = "#1f5fa8", "#d9730d", "#777777"


def draw_table_one(rows: Sequence[tuple[str, float, float, float, float, float]]) -> None:
    """Draw RMS errors for the conditions of Table I.

    Args:
        rows: probe, force [N], place over the length, bound, error of ml and of the paper's method [m].
    """
    ordered = sorted(rows, key=lambda row: row[3])
    figure, ax = _figure(7.6, 5.6)
    y = np.arange(len(ordered))
    bound, ml, paper = (1e3 * np.array([row[i] for row in ordered]) for i in (3, 4, 5))
    for at, low, high in zip(y, bound, np.maximum(ml, paper), strict=True):
        ax.plot([low, high], [at, at], color="#cccccc", lw=1.0, zorder=1)
    ax.plot(bound, y, "|", color=GREY, ms=11, mew=2, label="bound")
    ax.plot(paper, y, "s", color=ORANGE, ms=5, label="paper's method")
    ax.plot(ml, y, "o", color=BLUE, ms=5, label="maximum likelihood")
    ax.set_yticks(y, [f"{name} {force * 1e3:g} mN at {place:.2g} L" for name, force, place, *_ in ordered], fontsize=8)
    ax.set(xscale="log", xlabel="RMS error of one touch, sensor noise alone [mm]")
    ax.grid(True, axis="x", which="major", color="#dddddd", lw=0.6)
    ax.legend(frameon=False, loc="lower right")
    figure.savefig(PICTURES / "table1.png", dpi=150)


def draw_fusion(drawn: dict[tuple[str, float], tuple[list[float], list[float]]]) -> None:
    """Draw errors and bounds of fused touches.

    Args:
        drawn: errors and bounds [mm] at 0.5 ... 0.9 L, by the error sources and the largest force [N].
    """
    kinds = list(dict.fromkeys(kind for kind, _ in drawn))
    figure, axes = _figure(9.6, 3.4, len(kinds))
    for ax, kind in zip(axes, kinds, strict=True):
        for key, color in zip([key for key in drawn if key[0] == kind], ("#9cc3e8", BLUE, "#0c2f57"), strict=False):
            errors, bounds = drawn[key]
            places = np.linspace(0.5, 0.9, 5)[: len(errors)]
            ax.plot(places, bounds, "-", color=color, lw=1.5)
            ax.plot(places, errors, "o", color=color, ms=5, label=f"to {key[1] * 1e3:g} mN")
        ax.set(xlabel="contact over length", ylim=(0.0, None))
        ax.set_title(kind, fontsize=9)
        ax.grid(True, color="#dddddd", lw=0.6)
    axes[0].set_ylabel("RMS error, five touches,\nmoments alone [mm]")
    axes[0].plot([], [], "-", color=GREY, label="bound")
    axes[0].legend(frameon=False, fontsize=8)
    figure.savefig(PICTURES / "fusion.png", dpi=150)


def draw_card_house(cards: Sequence[Array], located: Array, targets: Array) -> None:
    """Draw a card house with its touched and its located points from the front and from above.

    Args:
        cards: corners of each card [mm], (4, 3).
        located: position and covariance xx, xy, xz, yy, yz, zz of the located points [mm, mm²], (k, 9).
        targets: points that were to be touched [mm], (n, 3).
    """
    figure, axes = _figure(10.4, 5.6, 2)
    for ax, (i, j), names in zip(axes, ((0, 2), (0, 1)), (("x", "z"), ("x", "y")), strict=True):
        for card in cards:
            ax.fill(*card[:, [i, j]].T, facecolor="#c9b98a22", edgecolor="#a08c5a", lw=1.0)
        ax.plot(*targets[:, [i, j]].T, "+", color="#111111", ms=6, mew=0.8, label="touched", zorder=3)
        for row in located:
            cov = np.array([[row[3], row[4], row[5]], [row[4], row[6], row[7]], [row[5], row[7], row[8]]])
            values, vectors = np.linalg.eigh(cov[np.ix_([i, j], [i, j])])
            angle = np.linspace(0.0, 2.0 * np.pi, 60)
            ellipse = row[[i, j], None] + vectors @ (
                np.sqrt(CHI2_95 * values)[:, None] * np.array([np.cos(angle), np.sin(angle)])
            )
            ax.fill(*ellipse, facecolor="#1f5fa833", edgecolor=BLUE, lw=1.0)
        ax.plot(*located[:, [i, j]].T, ".", color=BLUE, ms=4, label="located, with 95 % ellipsoid")
        ax.set(xlabel=f"{names[0]} [mm]", ylabel=f"{names[1]} [mm]")
        ax.set_aspect("equal")
        ax.grid(True, color="#eeeeee", lw=0.6)
    axes[0].set_title("from the front", fontsize=10)
    axes[1].set_title("from above: the front edges, enlarged across them", fontsize=10)
    axes[1].set_ylim(-4.0, 4.0)
    axes[1].set_aspect("auto")
    axes[0].legend(frameon=False, fontsize=8, loc="upper left")
    figure.savefig(PICTURES / "card-house.png", dpi=130)


def draw_bamboo(s: Array, masses: Array, mean: Array, spread: Array, model: Array, fitted: Sequence[bool]) -> None:
    """Draw measured and predicted deflections of a tapered rod.

    Args:
        s: places from the clamp [mm], (n,).
        masses: at the tip [g], (k,).
        mean, spread, model: deflections, their scatter, and those of the model [mm], (k, n).
        fitted: which masses the model was fitted to, (k,).
    """
    figure, ax = _figure(7.6, 3.8)
    for k, mass in enumerate(masses):
        color = GREY if fitted[k] else ORANGE
        ax.plot(s, model[k], "-", color=color, lw=1.2)
        ax.errorbar(s, mean[k], spread[k], fmt="o", color=BLUE, ms=4, capsize=2)
        ax.annotate(f" {mass:g} g", (s.max(), mean[k, int(np.argmax(s))]), fontsize=8, va="center")
    ax.plot([], [], "o", color=BLUE, label="measured by others, four times")
    ax.plot([], [], "-", color=GREY, label="rod, E and density fitted to these")
    ax.plot([], [], "-", color=ORANGE, label="rod, predicted")
    ax.set(xlabel="along the rod from the clamp [mm]", ylabel="deflection [mm]", xlim=(None, 1.06 * s.max()))
    ax.grid(True, color="#dddddd", lw=0.6)
    ax.legend(frameon=False, fontsize=8, loc="lower left")
    figure.savefig(PICTURES / "real-rod.png", dpi=130)


def draw_allan(curves: dict[str, tuple[Array, Array]], walk: float) -> None:
    """Draw the Allan deviation of sensors without load.

    Args:
        curves: window lengths [s] and deviations [steps] by sensor.
        walk: assumed random walk [steps/√s].
    """
    figure, ax = _figure(7.6, 3.8)
    for (name, (tau, deviation)), color in zip(curves.items(), (ORANGE, BLUE, "#0c2f57"), strict=False):
        ax.loglog(tau, deviation, "o-", color=color, ms=3, lw=1.2, label=name)
    tau = np.array([5e-3, 2.0])
    ax.loglog(tau, walk * np.sqrt(tau / 3.0), "--", color=GREY, label=f"walk of {walk:g} steps/√s, as assumed")
    ax.loglog(tau, 1.0 / np.sqrt(tau / tau[0]), ":", color=GREY, label="noise of one step a sample, as assumed")
    ax.set(xlabel="window τ [s]", ylabel="Allan deviation of the\nchannel that drifts most [steps]")
    ax.grid(True, which="major", color="#dddddd", lw=0.6)
    ax.legend(frameon=False, fontsize=8)
    figure.savefig(PICTURES / "real-drift.png", dpi=130)


def _figure(width: float, height: float, panels: int = 1) -> tuple[Any, Any]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, panels, squeeze=False)[0]
    return figure, axes[0] if panels == 1 else axes
