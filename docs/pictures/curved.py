"""Draw the pictures of docs/curved.md: the idea, and the errors of the large probe and of the whisker.

`docs/conf.py` runs it in every build of the documentation; by hand: `python docs/pictures/curved.py`.
"""

from pathlib import Path

import numpy as np

from probedesign.core.units import MM
from probedesign.design import load_design
from probedesign.geometry import Axis
from probedesign.prediction.fused import SHOWN_N
from probedesign.prediction.predict import FRACTIONS, HEADLINE_FRACTION, errors_over_directions
from probedesign.probe import build_probe
from probedesign.reports.chart import COLOURS, Chart
from probedesign.reports.prediction_charts import direction_chart, error_band_chart

HERE = Path(__file__).parent
PLACES = (0.4, 0.6, 0.8, 1.0)  #: Touches of the idea, fractions of the length.


def idea() -> Chart:
    """Return an arc in its plane with p(s) and the moment of a force out of the plane at four places."""
    axis = Axis.helix(0.15, np.radians(90.0), azimuth=np.radians(-90.0))
    line = axis.frames(np.linspace(0.0, axis.length, 81))[:, :3, 3] / MM
    points = axis.frames(np.array(PLACES) * axis.length)[:, :3, 3] / MM
    moments = 0.4 * np.cross(points, [1.0, 0.0, 0.0])  # of a force along x, out of the plane
    chart = Chart.side_view(np.concatenate([line, moments])[:, [2, 1]], 1)
    chart.line(line[:, 2], line[:, 1], COLOURS[0], name="axis of the probe", width=4.0)
    for k, (p, m, colour) in enumerate(zip(points, moments, COLOURS[1:], strict=False)):
        chart.line([0.0, p[2]], [0.0, p[1]], colour, name="" if k else "p(s)", width=1.4)
        chart.points(p[2], p[1], colour, "o")
        chart.line([0.0, m[2]], [0.0, m[1]], colour, "7 4", name="" if k else "moment M at the base", width=2.2)
        chart.points(m[2], m[1], colour, "d")
        chart.text(p[2] + 17.0, p[1] + 1.0, f"{PLACES[k]:g} L", colour)
    return chart


def draw() -> None:
    """Write the pictures."""
    names = {"straight": "large", "whisker": "whisker"}
    over = {name: errors_over_directions(build_probe(load_design(HERE.parents[1] / f"designs/{file}.toml")).estimator(),
                                         FRACTIONS, (SHOWN_N,)) for name, file in names.items()}  # fmt: skip
    at = FRACTIONS.index(HEADLINE_FRACTION)
    polar = direction_chart({name: rows[at].errors_mm for name, rows in over.items()})
    pictures = {"idea": idea(), "along": error_band_chart(over), "direction": polar}
    for name, chart in pictures.items():
        (HERE / f"curved-{name}.svg").write_bytes(chart.svg() + b"\n")


if __name__ == "__main__":
    draw()
