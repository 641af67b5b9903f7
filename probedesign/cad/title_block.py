"""Title block of a part's drawing: revision, material, mass, scale, date and tolerance."""

import datetime
import os

from probedesign.cad.drawing import Sheet, number, scale_text
from probedesign.cad.kernel import mass_properties
from probedesign.cad.model import CadModel, CadPart
from probedesign.core.errors import InputError
from probedesign.core.units import MM
from probedesign.design import Design
from probedesign.design.catalog import ALUMINIUM, MILLED_TOLERANCE, RIGID_RESIN
from probedesign.mount.engraving import DEPTH, HEIGHT, Engraving

TOLERANCE = "±0.5 %, at least ±0.15 (assumed)"
"""Tolerance of a stereolithography print; the manufacturer publishes none for the soft resin."""
MILLED = f"±{number(MILLED_TOLERANCE / MM)}, all lengths"
DATE_VARIABLE = "SOURCE_DATE_EPOCH"
"""Environment variable with the time of the sources in seconds since 1970 (reproducible-builds.org)."""


def titled_sheet(model: CadModel, part: CadPart, scale: float) -> Sheet:
    """Return an empty sheet for a part at a scale."""
    design, milled = model.design, part.name != "probe" and model.adapter.options.milled
    resin = design.resin.name if part.name == "probe" else ALUMINIUM if milled else RIGID_RESIN
    grams = 1e3 * mass_properties(part.shape, part.density).mass
    sheet = Sheet(f"{design.name}: {part.name.replace('_', ' ')}", scale)
    sheet.frame([
        ("revision", model.geometry.fingerprint), ("material", resin), ("mass", f"{grams:.3g} g"),
        ("file", f"{part.name}.stl"),
        ("scale", scale_text(scale)), ("units", "mm"), ("frame", part.frame.replace("_", " ")),
        ("date", drawing_date(design)),
        ("tolerance", MILLED if milled else TOLERANCE), ("angles", "about +z from +x"),
        ("edges", "broken, at most 0.2" if milled else "as printed"),
        ("projection", "first angle, ISO 5456-2"),
    ])  # fmt: skip
    return sheet


def drawing_date(design: Design) -> str:
    """Return the date of a drawing: that of the design, or of SOURCE_DATE_EPOCH; empty without either, because equal
    designs have equal files.

    Raises:
        InputError: SOURCE_DATE_EPOCH is not a number of seconds.
    """
    if design.date is not None:
        return design.date
    value = os.environ.get(DATE_VARIABLE)
    if value is None:
        return ""
    try:
        return datetime.datetime.fromtimestamp(int(value), datetime.UTC).date().isoformat()
    except (ValueError, OverflowError, OSError):
        raise InputError(
            f"{DATE_VARIABLE} = {value!r} is not a number of seconds since 1970; unset it"
        ) from None


def engraving_note(engraving: Engraving, where: str) -> list[str]:
    """Return the note on an engraving, or none if nothing is engraved."""
    if not engraving.text:
        return []
    return [f"engraved on {where}: {engraving.text}, {number(HEIGHT / MM)} high, {number(DEPTH / MM)} deep"]
