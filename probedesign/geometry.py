"""The one geometry that CAD and mechanics both read: a straight round body, radius piecewise linear in s."""

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from probedesign.frames import Array
from probedesign.units import MM

if TYPE_CHECKING:  # the computer that runs `live` loads no design
    from probedesign.design import Design


@dataclass(frozen=True)
class Flange:
    """The disc below s = 0, printed in one piece with the flexible part.

    Attributes:
        diameter: [m].
        thickness: it fills z in [-thickness, 0] of the base frame [m].
    """

    diameter: float
    thickness: float


@dataclass(frozen=True)
class ProbeGeometry:
    """Shape of a probe in the base frame, undeformed.

    The flexible part is a stack of cone frusta between the knots; the flange hangs below z = 0.

    Attributes:
        s: knots along the axis, 0 ... length [m], (K,), increasing.
        radius: at the knots [m], (K,), positive.
        flange: the disc that the adapter holds.
    """

    s: Array
    radius: Array
    flange: Flange

    @property
    def length(self) -> float:
        """Of the flexible part [m]."""
        return float(self.s[-1])

    @property
    def base_radius(self) -> float:
        """At s = 0 [m]."""
        return float(self.radius[0])

    @property
    def tip_radius(self) -> float:
        """At s = length [m]."""
        return float(self.radius[-1])

    def radius_at(self, s: ArrayLike) -> Array:
        """Radius [m] at arclength s [m], any shape."""
        radius: Array = np.interp(np.asarray(s, dtype=float), self.s, self.radius)
        return radius

    @property
    def fingerprint(self) -> str:
        """Twelve hex digits that stand for this geometry: SHA-256 of its dimensions rounded to a nanometre."""
        dimensions = [*self.s, *self.radius, self.flange.diameter, self.flange.thickness]
        text = " ".join(str(round(d * 1e9)) for d in dimensions)
        return hashlib.sha256(text.encode()).hexdigest()[:12]


FLANGE_THICKNESS = 3.0 * MM
"""Thick enough to be gripped in Elastic 50A; twice the 1.5 mm that the resin asks of a feature (assumed)."""
FLANGE_LIP = 3.5 * MM
"""Radial width that the clamp ring presses on (assumed)."""
FLANGE_MIN_D = 17.0 * MM
"""Never narrower than the sensor's body, so that one adapter serves every thin probe."""


def flange_for(base_d: float) -> Flange:
    """The flange of a probe of that base diameter [m]."""
    return Flange(max(base_d + 2 * FLANGE_LIP, FLANGE_MIN_D), FLANGE_THICKNESS)


def build_geometry(design: "Design") -> ProbeGeometry:
    """The geometry that a design describes, in SI."""
    knots = np.array(design.probe.knots_mm, dtype=float) * MM
    radius = knots[:, 1] / 2.0
    return ProbeGeometry(knots[:, 0], radius, flange_for(2.0 * float(radius[0])))
