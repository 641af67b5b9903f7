"""Factors to SI units, and values as text: `value_mm * MM` is in metres, `value_m / MM` in millimetres."""

import math
import re

from probedesign.core.errors import InputError

MM = 1e-3  #: One millimetre [m].
MPA = 1e6  #: One megapascal [Pa].
MILLINEWTON = 1e-3  #: One millinewton [N].
N_MM = 1e-3  #: One newton millimetre [N·m].
GRAM = 1e-3  #: One gram [kg].
POUND_FORCE = 4.4482216152605  # exact, from the pound and standard gravity
KILOGRAM_FORCE = 9.80665  # exact
INCH, FOOT = 0.0254, 0.3048  # exact

FORCE_UNITS = {
    "n": 1.0, "kn": 1e3, "lbf": POUND_FORCE, "klbf": 1e3 * POUND_FORCE, "kgf": KILOGRAM_FORCE, "kg": KILOGRAM_FORCE,
}  # fmt: skip
TORQUE_UNITS = {
    "nm": 1.0, "nmm": 1e-3, "knm": 1e3, "lbfin": POUND_FORCE * INCH, "lbfft": POUND_FORCE * FOOT,
    "kgfcm": KILOGRAM_FORCE * 0.01, "kgcm": KILOGRAM_FORCE * 0.01,
}  # fmt: skip
LENGTH_UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": INCH, "ft": FOOT}
#: Units in SI, by the letters of their names: boxes write N-mm, N·mm and Nmm.
ANGLE_UNITS = {"degrees": math.pi / 180.0, "deg": math.pi / 180.0, "radians": 1.0, "rad": 1.0}


def format_value(value: float | str | None, spec: str = ".4g", unit: str = "", missing: str = "none") -> str:
    """Return a value of a table as text: a number with its unit, a text as it is, `missing` for None."""
    if value is None:
        return missing
    return value if isinstance(value, str) else f"{value:{spec}}{unit and ' '}{unit}"


def unit_of(tag: str, text: str, units: dict[str, float]) -> float:
    """Return one of `units` in SI; `tag` is what names it, for messages.

    Raises:
        InputError: the unit is unknown.
    """
    letters = re.sub(r"[^a-z]", "", text.lower())
    if letters not in units:
        raise InputError(f"{tag} = {text[:40]!r} is not a known unit; known: {', '.join(units)}")
    return units[letters]
