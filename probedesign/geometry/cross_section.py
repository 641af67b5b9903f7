"""Cross sections: full and round, hollow or elliptic, similar to themselves along the whole probe."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from probedesign.core.errors import InputError


class Factors(NamedTuple):
    """Ratios of the properties of a section to those of a full round section of the same width along x."""

    area: float  #: of A.
    xx: float  #: of I_xx = ∫y² dA, the bending about the section's x axis.
    yy: float  #: of I_yy = ∫x² dA.
    torsion: float  #: of J.


@dataclass(frozen=True)
class CrossSection:
    """A section by its proportions; its radius is its half-width along x."""

    bore_ratio: float = 0.0  #: inner over outer diameter; 0 is full.
    flatness: float = 1.0  #: diameter along y over diameter along x; 1 is round.

    def __post_init__(self) -> None:
        if not (0.0 <= self.bore_ratio < 1.0 and 0.0 < self.flatness <= 1.0):
            raise InputError(f"section: {self} is not a section: needs 0 <= bore_ratio < 1 and 0 < flatness <= 1")
        if self.hollow and self.flat:
            raise InputError(f"section: {self} is both hollow and elliptic, which is not supported; choose one")

    @property
    def hollow(self) -> bool:
        """Return whether there is a bore."""
        return self.bore_ratio > 0.0

    @property
    def flat(self) -> bool:
        """Return whether the section is elliptic, so that it bends more easily about x than about y."""
        return self.flatness < 1.0

    @property
    def full_round(self) -> bool:
        """Return whether the section is neither hollow nor elliptic."""
        return not (self.hollow or self.flat)

    def reach(self, side: float) -> float:
        """Return the distance from axis to surface over the half-width along x, at an angle from x to y [rad]."""
        return 1.0 / math.hypot(math.cos(side), math.sin(side) / self.flatness)

    @cached_property
    def factors(self) -> Factors:
        """Return A, I_xx, I_yy and J over π r², π r⁴/4, π r⁴/4 and π r⁴/2.

        With β the bore ratio and φ = b/a the flatness of semi-axes a = r and b: a bore takes β² of A and β⁴ of
        the moments; an ellipse has A = π a b, I_xx = π a b³/4, I_yy = π a³ b/4, J = π a³ b³/(a² + b²).

        Source: Saint-Venant's torsion of the ellipse, any book of elasticity; the tests integrate all four again.
        """
        f = self.flatness
        full, ring = 1.0 - self.bore_ratio**2, 1.0 - self.bore_ratio**4
        return Factors(full * f, ring * f**3, ring * f, ring * 2.0 * f**3 / (1.0 + f**2))


FULL_ROUND = CrossSection()
