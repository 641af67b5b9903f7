"""The page of one prediction."""

from collections.abc import Sequence

from probedesign.estimator.estimator import Estimator
from probedesign.pages.heat_map import CAPTION, draw_heat_map
from probedesign.pages.page import Section, TextTable, page_of
from probedesign.prediction.predict import Prediction
from probedesign.report import draw_panels

_PANELS = {
    "error": ("How well is a touch located?", "A line a force; the band spans the directions. A line ends where the "
              "probe gives way or the touch is too light to be located."),
    "shapes": ("How does it bend?", "Seen along y, gravity downwards if mounted horizontally; dots are the touches."),
    "detection": ("What is felt at all?", "Smallest force told from none every other time, one false alarm an hour."),
    "sensitivity": ("How hard does it press?", "At the lightest force, pushed along the last of "
                    "the directions: what a millimetre more of press changes."),
}  # fmt: skip


def prediction_page(prediction: Prediction, estimator: Estimator, more: Sequence[Section] = ()) -> bytes:
    """The page.

    Args:
        prediction: of a probe.
        estimator: of the same.
        more: further sections, such as an error budget; they stand after the heat map.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """
    panels = draw_panels(prediction, estimator)
    sections = [
        Section("Where and how hard?", CAPTION, draw_heat_map(estimator)),
        *more,
        *(Section(*text, panels[name]) for name, text in _PANELS.items()),
    ]
    sag = (
        "it cannot stand" if prediction.tip_sag_mm is None else f"its tip sags {prediction.tip_sag_mm:.3g} mm"
    )
    about = [
        f"{prediction.mass_g:.3g} g, flexible part; {sag}, as mounted",
        f"geometry {prediction.fingerprint}; noise {prediction.noise_force_mN:.3g} mN and "
        f"{prediction.noise_moment_Nmm:.3g} N·mm a reading and channel",
        f"assumed: {', '.join(prediction.assumptions) or 'nothing'}",
    ]
    return page_of(f"{prediction.name}: what it will feel", about, _table(prediction), sections)


def _table(prediction: Prediction) -> TextTable:
    """Error by place and force, worst of the directions."""
    forces = sorted({c.force_N for c in prediction.conditions})
    lines = []
    for fraction in sorted({c.contact_fraction for c in prediction.conditions}):
        cells = [f"{fraction:g} L"]
        for force in forces:
            here = [c for c in prediction.conditions if (c.contact_fraction, c.force_N) == (fraction, force)]
            bad = next((c.result for c in here if c.result != "ok"), None)
            worst = max(c.predicted_error_mm or 0.0 for c in here)
            cells.append(bad.replace("_", " ") if bad else f"{worst:.3g} mm")
        lines.append(cells)
    return TextTable(["RMS error", *(f"{1e3 * force:g} mN" for force in forces)], lines)
