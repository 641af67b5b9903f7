"""Pictures of a prediction, made to be read at half size and in print."""

import io
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from probedesign.errors import MissingDependencyError
from probedesign.estimation.estimator import Estimator
from probedesign.frames import Array
from probedesign.prediction.predict import DIRECTIONS, Condition, Prediction
from probedesign.rod.contact import solve_frictionless
from probedesign.units import MM

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STYLES = ("-", "--", ":", "-.")
SHAPE_TOUCHES = ((0.4, 0.05), (0.6, 0.03), (0.8, 0.02))
"""Fractions and newtons of the touches whose shapes are drawn; pushed along -x and +x."""


def draw_prediction(prediction: Prediction, estimator: Estimator) -> bytes:
    """Four panels: error along the probe, detection, sensitivity, bent shapes; a PNG.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """
    figure = blank(12, 8.6, (0.7, 0.1, 0.5, 0.75))
    axes: Any = figure.subplots(2, 2, gridspec_kw={"wspace": 0.135, "hspace": 0.22})
    _draw_error(axes[0, 0], prediction)
    _draw_detection(axes[0, 1], prediction)
    _draw_sensitivity(axes[1, 0], prediction)
    _draw_shapes(axes[1, 1], estimator)
    for ax in axes.flat:
        ax.set_title(ax.get_title(), y=1.0)  # where it stands anyhow: else it is sought anew
    figure.suptitle(_title(prediction), fontsize=12, x=0.01, y=0.992, ha="left", va="top")
    return png(figure)


@dataclass(frozen=True)
class Sweep:
    """Estimates of a moving contact beside the truth, each (n,); NaN where nothing touches or is located.

    Attributes:
        time_s: of each reading.
        true_s_mm, s_mm: arclength of the contact, true and estimated.
        std_s_mm: standard deviation that the estimate states.
        error_mm: distance between true and estimated contact point.
        predicted_mm: RMS distance that the estimate's covariance states.
    """

    time_s: Array
    true_s_mm: Array
    s_mm: Array
    std_s_mm: Array
    error_mm: Array
    predicted_mm: Array


def draw_sweep(sweep: Sweep) -> bytes:
    """A moving contact: where it was, where it was located, and how far off; a PNG.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """
    figure = blank(9, 6)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    t = sweep.time_s
    low, high = sweep.s_mm - 2 * sweep.std_s_mm, sweep.s_mm + 2 * sweep.std_s_mm
    upper.fill_between(
        t, low, high, color=_colour(0.6), alpha=0.3, lw=0, label="± 2 standard deviations, as stated"
    )
    upper.plot(t, sweep.true_s_mm, color="black", lw=1.5, label="true")
    upper.plot(t, sweep.s_mm, ".", color=_colour(0.3), ms=5, label="located")
    upper.set(ylabel="contact s [mm]", title="A simulated touch sweeps along the probe")
    upper.legend(fontsize=8, loc="lower center")
    lower.plot(t, sweep.error_mm, ".", color=_colour(0.3), ms=5, label="distance from the truth")
    lower.plot(t, sweep.predicted_mm, color=_colour(0.6), label="RMS that the estimate states")
    lower.set(xlabel="time [s]", ylabel="error [mm]")
    lower.legend(fontsize=8)
    for ax in (upper, lower):
        ax.grid(True, alpha=0.25)
    return png(figure)


def blank(width: float, height: float, margins: tuple[float, float, float, float] | None = None) -> "Figure":
    """An empty figure, drawn without a screen.

    Args:
        width, height: [inch].
        margins: left, right, bottom and top of its axes [inch]; found from what is drawn if None, which takes as long
            as drawing it twice more.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ModuleNotFoundError:
        raise MissingDependencyError(
            "plots need matplotlib: pip install 'probedesign[plots]', or give --no-plots"
        ) from None
    figure = Figure(figsize=(width, height), layout="constrained" if margins is None else None)
    FigureCanvasAgg(figure)
    if margins is not None:
        left, right, bottom, top = margins
        figure.subplots_adjust(left / width, bottom / height, 1.0 - right / width, 1.0 - top / height)
    return figure


def png(figure: "Figure") -> bytes:
    """The figure as a file."""
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=110, metadata={"Software": None})
    return picture.getvalue()


def _title(prediction: Prediction) -> str:
    assumed = ", ".join(a.rpartition(".")[2] for a in prediction.assumptions) or "nothing"
    noise = f"σ {prediction.noise_force_mN:.2g} mN, {prediction.noise_moment_Nmm:.2g} N·mm a reading"
    return f"{prediction.name}  ·  geometry {prediction.fingerprint}  ·  {noise}\nassumed: {assumed}"


def _draw_error(ax: "Axes", prediction: Prediction) -> None:
    """Predicted error against place, a line a force; the band spans the directions."""
    forces = sorted({c.force_N for c in prediction.conditions})
    for i, force in enumerate(forces):
        rows = _by_fraction([c for c in prediction.conditions if c.force_N == force and c.result == "ok"])
        if not rows:
            continue
        x = list(rows)
        errors = [
            [c.predicted_error_mm for c in row if c.predicted_error_mm is not None] for row in rows.values()
        ]
        colour = _colour(i / max(len(forces) - 1, 1))
        ax.fill_between(x, [min(e) for e in errors], [max(e) for e in errors], color=colour, alpha=0.25, lw=0)
        ax.plot(x, [max(e) for e in errors], "o-", ms=3.5, color=colour, label=f"{1e3 * force:g} mN")
    ax.set(yscale="log", xlabel="contact, fraction of the length", ylabel="predicted contact error, RMS [mm]",
           title="Where is the touch? Error of one reading (ends: probe gives way)", xlim=(0, 1.02))  # fmt: skip
    _plain_numbers(ax)
    _legend(ax, title="force", ncols=2)


def _draw_detection(ax: "Axes", prediction: Prediction) -> None:
    """Smallest force told from no contact."""
    for i, direction in enumerate(_directions(prediction)):
        rows = [
            d for d in prediction.detection if d.direction == direction and d.detectable_force_mN is not None
        ]
        ax.plot([d.contact_fraction for d in rows], [d.detectable_force_mN or np.nan for d in rows], STYLES[i % 4],
                marker="o", ms=3.5, color=_colour(i / 3), label=f"pushed along {direction}")  # fmt: skip
    ax.set(yscale="log", xlabel="contact, fraction of the length", ylabel="smallest detectable force [mN]",
           title="What is felt at all? One false alarm an hour", xlim=(0, 1.02))  # fmt: skip
    _plain_numbers(ax)
    _legend(ax)


def _draw_sensitivity(ax: "Axes", prediction: Prediction) -> None:
    """Base moment and force for a millimetre of press, at the lightest force of the grid."""
    lightest = min(c.force_N for c in prediction.conditions)
    direction = _directions(prediction)[-1]
    rows = [c for c in prediction.conditions if c.force_N == lightest and c.direction == direction]
    rows = [c for c in rows if c.moment_per_mm_Nmm is not None and c.force_per_mm_N is not None]
    x = [c.contact_fraction for c in rows]
    ax.plot(
        x,
        [c.moment_per_mm_Nmm or np.nan for c in rows],
        "o-",
        ms=3.5,
        color=_colour(0.0),
        label="base moment [N·mm/mm]",
    )
    ax.plot(
        x,
        [1e3 * (c.force_per_mm_N or np.nan) for c in rows],
        "s--",
        ms=3.5,
        color=_colour(0.6),
        label="contact force [mN/mm]",
    )
    ax.set(yscale="log", xlabel="contact, fraction of the length", ylabel="per millimetre of press",
           title=f"How hard does a millimetre press? (along {direction})", xlim=(0, 1.02))  # fmt: skip
    _plain_numbers(ax)
    _legend(ax)


def _draw_shapes(ax: "Axes", estimator: Estimator) -> None:
    """The probe under gravity and under a few touches, seen along y."""
    model, free = estimator.model, estimator.free()
    s = np.linspace(0.0, model.rod.length, 120)
    if free.ok:
        p = free.p_at(s) / MM
        ax.plot(p[:, 2], p[:, 0], color="black", lw=2, label="free, gravity as mounted")
    for i, (fraction, force) in enumerate(SHAPE_TOUCHES):
        for direction in ("-x", "+x"):
            contact = solve_frictionless(
                model.rod, model.gravity_base, fraction * model.rod.length, DIRECTIONS[direction], force
            )
            if contact.result != "ok":
                continue
            p, touched = contact.equilibrium.p_at(s) / MM, contact.equilibrium.p_contact_base / MM
            label = f"{1e3 * force:g} mN at {fraction:g}" if direction == "-x" else None
            ax.plot(p[:, 2], p[:, 0], STYLES[i], color=_colour(i / 3), label=label)
            ax.plot(touched[2], touched[0], "o", color=_colour(i / 3), ms=5)
    ax.set(
        xlabel="z, along the undeformed axis [mm]",
        ylabel="x [mm]",
        title="How does it bend? Touches along ±x",
    )
    ax.set_aspect("equal", adjustable="datalim")
    ax.invert_yaxis()  # gravity of the horizontal mount points along +x: down
    ax.grid(True, alpha=0.25)
    _legend(ax)


def _legend(ax: "Axes", **how: Any) -> None:
    """A legend, if there is anything to name: a probe that cannot stand leaves panels empty."""
    if ax.get_legend_handles_labels()[0]:
        ax.legend(fontsize=8, **how)


def _plain_numbers(ax: "Axes") -> None:
    """Grid, and 0.1, 1, 10 instead of powers, on a logarithmic axis."""
    from matplotlib.ticker import FuncFormatter, LogLocator

    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.yaxis.set_minor_formatter(FuncFormatter(lambda *_: ""))
    ax.grid(True, which="major", alpha=0.25)


def _directions(prediction: Prediction) -> list[str]:
    return list(dict.fromkeys(c.direction for c in prediction.conditions))


def _by_fraction(conditions: list[Condition]) -> dict[float, list[Condition]]:
    rows: dict[float, list[Condition]] = {}
    for c in conditions:
        rows.setdefault(c.contact_fraction, []).append(c)
    return rows


def _colour(share: float) -> Any:
    """From a scale that colour-blind readers and grey prints keep in order."""
    from matplotlib import colormaps

    return colormaps["viridis"](0.05 + 0.8 * min(share, 1.0))
