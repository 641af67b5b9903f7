"""The error over place and force, as a map."""

import numpy as np

from probedesign.estimator.estimator import Estimator
from probedesign.estimator.tolerances import Tolerances
from probedesign.frames import Array
from probedesign.prediction.touches import touches_of
from probedesign.report import blank, svg
from probedesign.units import MM

PLACES = np.linspace(0.1, 1.0, 16)
FORCES_N = np.geomspace(1e-3, 0.3, 15)
DIRECTION = "+y"
"""Sideways to the gravity of a horizontal mount: the paper's touches."""
LEVELS_MM = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
CAPTION = (
    "One reading of a touch sideways to gravity, sensor noise alone, E and geometry taken as known. Grey: felt, but "
    "too light to be located. White: not felt. Hatched: the probe gives way, or the sensor's range ends."
)


def draw_heat_map(estimator: Estimator) -> bytes:
    """The map, an SVG.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """
    from matplotlib import colormaps
    from matplotlib.colors import BoundaryNorm, ListedColormap

    errors, results = _computed(estimator)
    figure = blank(6.4, 4.4, (0.75, 0.05, 0.5, 0.15))
    ax = figure.subplots()
    x, y = PLACES, 1e3 * FORCES_N
    for codes, colour, hatch in ((("too_light", "unobservable"), "0.8", ""), (_ENDS, "white", "////")):
        share = np.where(np.isin(results, codes), 1.0, np.nan)
        ax.pcolor(x, y, np.ma.masked_invalid(share), cmap=ListedColormap([colour]), hatch=hatch,
                  edgecolor="0.6" if hatch else "none", lw=0, shading="nearest")  # fmt: skip
    norm = BoundaryNorm(LEVELS_MM, 256, extend="both")
    seen = ax.pcolormesh(
        x, y, np.ma.masked_invalid(errors), norm=norm, cmap=colormaps["viridis"], shading="nearest"
    )
    bar = figure.colorbar(seen, ax=ax, extend="both", label="contact error, RMS [mm]")
    bar.ax.set_yticks(LEVELS_MM, [f"{level:g}" for level in LEVELS_MM])
    ax.set(yscale="log", xlabel="contact, fraction of the length", ylabel="contact force [mN]")
    ax.set_yticks([1, 2, 5, 10, 20, 50, 100, 200], ["1", "2", "5", "10", "20", "50", "100", "200"])
    ax.minorticks_off()
    return svg(figure)


_ENDS = ("gives_way", "out_of_range", "not_converged")


def _computed(estimator: Estimator) -> tuple[Array, np.ndarray[tuple[int, ...], np.dtype[np.str_]]]:
    """Errors [mm], NaN where there is none, and results, (forces, places)."""
    if not estimator.free().ok:  # it cannot even stand
        nothing = np.full((len(FORCES_N), len(PLACES)), np.nan)
        return nothing, np.full(nothing.shape, "gives_way")
    lines = [(float(place), DIRECTION) for place in PLACES]
    touches = touches_of(estimator, Tolerances.of(estimator.model), lines, FORCES_N.tolist())
    results = np.array([touch.results() for touch in touches.values()])
    errors = np.array([touch.rms[0] for touch in touches.values()]) / MM
    return np.where(results == "ok", errors, np.nan), results
