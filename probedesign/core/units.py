"""Factors between the units people write and SI. `value_mm * MM` is metres; `value_m / MM` is millimetres."""

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
