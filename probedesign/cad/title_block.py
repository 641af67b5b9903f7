"""The sheet of a part before anything is drawn on it: its frame, and a title block that names it."""

from probedesign.cad.assembly import Part
from probedesign.cad.drawing import Drawing
from probedesign.cad.sheet import EDGE, HEIGHT, TITLE_HEIGHT, Sheet, scale_text
from probedesign.materials import RIGID_RESIN

TOLERANCE = "±0.5 %, at least ±0.15 (assumed)"
"""What a stereolithography print holds; the printer's maker publishes none for the soft resin."""
BOTTOM = HEIGHT - EDGE - TITLE_HEIGHT
"""Where the title block begins on the paper [mm]."""
STACK = 7.5
"""From one dimension line to the next [mm of paper]."""


def titled_sheet(drawing: Drawing, part: Part, scale: float) -> Sheet:
    """An empty sheet for a part at a scale."""
    resin = drawing.design.resin.name if part.name == "probe" else RIGID_RESIN
    return Sheet(f"{drawing.design.name}: {part.name.replace('_', ' ')}", [
        ("geometry", drawing.geometry.fingerprint), ("material", resin), ("file", f"{part.name}.stl"),
        ("scale", scale_text(scale)), ("units", "mm"), ("frame", part.frame.replace("_", " ")),
        ("tolerance", TOLERANCE), ("angles", "about +z from +x, seen from above"),
    ])  # fmt: skip
