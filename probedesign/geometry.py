"""The one geometry that CAD and mechanics both read: a straight body, radius piecewise linear in s."""

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from probedesign.cross_section import FULL_ROUND, CrossSection
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

    The flexible part is a stack of frusta between the knots; the flange hangs below z = 0. A bore runs
    through both.

    Attributes:
        s: knots along the axis, 0 ... length [m], (K,), increasing.
        radius: at the knots [m], (K,), positive; of a flattened probe along x.
        flange: the disc that the adapter holds.
        cross_section: full and round, hollow or flattened.
        rounded_from: where the rounding of the tip begins [m], a knot; None for a blunt tip. It says nothing that
            the knots do not, so the fingerprint leaves it out.
    """

    s: Array
    radius: Array
    flange: Flange
    cross_section: CrossSection = FULL_ROUND
    rounded_from: float | None = None

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

    @property
    def flank_end(self) -> float:
        """Where the flank ends [m]: the length, or where a rounded tip begins."""
        return self.length if self.rounded_from is None else self.rounded_from

    @property
    def bore_radius(self) -> float:
        """Of the hole through the flange, and of a hollow probe at s = 0 [m]; 0 without a bore."""
        return self.cross_section.bore_ratio * self.base_radius

    @property
    def thinnest(self) -> float:
        """The least thickness that must print: a wall of a hollow probe, else a diameter of the flank [m]."""
        section, radius = self.cross_section, float(self.radius[self.s <= self.flank_end].min())
        return (1.0 - section.bore_ratio) * radius if section.hollow else 2.0 * section.flatness * radius

    def radius_at(self, s: ArrayLike) -> Array:
        """Radius [m] at arclength s [m], any shape."""
        radius: Array = np.interp(np.asarray(s, dtype=float), self.s, self.radius)
        return radius

    @property
    def fingerprint(self) -> str:
        """Twelve hex digits that stand for this geometry: SHA-256 of its dimensions rounded to a nanometre.

        The proportions of the section count where it is not full and round, rounded to 1e-9.
        """
        dimensions = [*self.s, *self.radius, self.flange.diameter, self.flange.thickness]
        section = self.cross_section
        dimensions += [] if section.full_round else [section.bore_ratio, section.flatness]
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
    return ProbeGeometry(
        knots[:, 0],
        radius,
        flange_for(2.0 * float(radius[0])),
        design.probe.cross_section,
        None if design.probe.tip == "blunt" else design.probe.flank_end_mm * MM,
    )
