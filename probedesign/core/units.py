"""Factors to SI units, and values as text: `value_mm * MM` is in metres, `value_m / MM` in millimetres."""

MM = 1e-3
"""One millimetre [m]."""
MPA = 1e6
"""One megapascal [Pa]."""
MILLINEWTON = 1e-3
"""One millinewton [N]."""
N_MM = 1e-3
"""One newton millimetre [N·m]."""
GRAM = 1e-3
"""One gram [kg]."""


def format_value(value: float | str | None, spec: str = ".4g", unit: str = "", missing: str = "none") -> str:
    """Return a value of a table as text: a number with its unit, a text as it is, `missing` for None."""
    if value is None:
        return missing
    return value if isinstance(value, str) else f"{value:{spec}}{unit and ' '}{unit}"
