"""Located touches of known position and uncertainty, without a sensor."""

from types import SimpleNamespace

import numpy as np

from probedesign.mapping.touch_point import ConditionalPoint, LocatedTouch

STD_E, STD_BASE = 0.01, 0.05e-3
NAMES = ("E", "base place", "base place", "base place")
#: A point shifts along the probe by half its lever arm times the error of stiffness.
BY_STIFFNESS = np.array([0.0, 0.05, 0.0])


def conditional_point(p, std, lever=1.0):
    """Return a point at p [m] with independent errors `std` on each axis and no information on the common errors."""
    B = np.column_stack([STD_E * lever * BY_STIFFNESS, -STD_BASE * np.eye(3)])
    return ConditionalPoint(np.asarray(p, dtype=float), B, std**2 * np.eye(3), np.zeros((4, 4)), np.zeros(4), NAMES)


def touch(number, p, std, lever=1.0):
    segment = SimpleNamespace(number=number, start=float(number))
    return LocatedTouch(
        segment, "ok", conditional_point(p, std, lever), 0.004, np.array([1.0, 0, 0]), np.array([0.1]), std
    )
