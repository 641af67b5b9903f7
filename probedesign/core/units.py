"""Factors to SI units: `value_mm * MM` is in metres, `value_m / MM` in millimetres."""

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
