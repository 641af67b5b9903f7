"""The geometry that CAD and mechanics share: a body about an axis, whose radius is piecewise linear, and its flange."""

import hashlib
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.geometry.axis import Axis
from probedesign.geometry.cross_section import FULL_ROUND, CrossSection


@dataclass(frozen=True)
class Flange:
    """The disc below s = 0, printed in one piece with the flexible part."""

    diameter: float  #: [m].
    thickness: float  #: of the disc, which fills z in [-thickness, 0] of the base frame [m].


@dataclass(frozen=True)
class ProbeGeometry:
    """Shape of a probe in the base frame, undeformed.

    The flexible part is a stack of frusta between the knots, along its axis; the flange hangs below z = 0. A bore runs
    through both.
    """

    s: Array  #: knots along the axis, 0 ... length [m], (K,), increasing.
    radius: Array  #: at the knots [m], (K,), positive; of a flattened probe along x.
    flange: Flange  #: the disc that is clamped in the adapter.
    cross_section: CrossSection = FULL_ROUND  #: full and round, hollow or flattened.
    #: where the rounding of the tip begins [m], a knot; None for a blunt tip. It follows from the knots, so the
    #: fingerprint does not include it.
    rounded_from: float | None = None
    curved: Axis | None = None  #: the axis of a curved probe; None for a straight one.

    @property
    def axis(self) -> Axis:
        """Return the axis."""
        return Axis.helix(self.length, 0.0) if self.curved is None else self.curved

    @property
    def length(self) -> float:
        """Return the length of the flexible part [m]."""
        return float(self.s[-1])

    @property
    def base_radius(self) -> float:
        """Return the radius at s = 0 [m]."""
        return float(self.radius[0])

    @property
    def tip_radius(self) -> float:
        """Return the radius at s = length [m]."""
        return float(self.radius[-1])

    @property
    def flank_end(self) -> float:
        """Return the arclength at which the flank ends [m]: the length, or the begin of a rounded tip."""
        return self.length if self.rounded_from is None else self.rounded_from

    @property
    def bore_radius(self) -> float:
        """Return the radius of the bore through the flange and at s = 0 [m]; 0 without a bore."""
        return self.cross_section.bore_ratio * self.base_radius

    @property
    def thinnest(self) -> float:
        """Return the smallest printed thickness: the wall of a hollow probe, else the diameter of the flank [m]."""
        section, radius = self.cross_section, float(self.radius[self.s <= self.flank_end].min())
        return (1.0 - section.bore_ratio) * radius if section.hollow else 2.0 * section.flatness * radius

    def radius_at(self, s: ArrayLike) -> Array:
        """Return the radius [m] at arclength s [m], an array of any shape."""
        radius: Array = np.interp(np.asarray(s, dtype=float), self.s, self.radius)
        return radius

    def area_at(self, s: ArrayLike) -> Array:
        """Return A(s) [m²] at arclength s [m]; π r² of a full round section."""
        return self.cross_section.factors.area * np.pi * self.radius_at(s) ** 2

    def second_moment_xx_at(self, s: ArrayLike) -> Array:
        """Return I_xx(s) = ∫y² dA [m⁴] at arclength s [m]: bending about x; π r⁴/4 of a full round section."""
        return self.cross_section.factors.xx * np.pi / 4.0 * self.radius_at(s) ** 4

    def second_moment_yy_at(self, s: ArrayLike) -> Array:
        """Return I_yy(s) = ∫x² dA [m⁴] at arclength s [m]: bending about y; π r⁴/4 of a full round section."""
        return self.cross_section.factors.yy * np.pi / 4.0 * self.radius_at(s) ** 4

    @property
    def fingerprint(self) -> str:
        """Return twelve hex digits that identify the geometry: SHA-256 of its dimensions, rounded to a nanometre.

        The proportions of a section that is not full and round are included, rounded to 1e-9, and the axis of a curved
        probe.
        """
        s = self.s if self.curved is None else np.unique(np.concatenate([self.s, self.curved.s]))
        dimensions = [*s, *self.radius_at(s), self.flange.diameter, self.flange.thickness]
        section = self.cross_section
        dimensions += [] if section.full_round else [section.bore_ratio, section.flatness]
        dimensions += [] if self.curved is None else [*self.curved.s, *self.curved.curvature.ravel()]
        return fingerprint_of(dimensions)


def fingerprint_of(dimensions: Iterable[float]) -> str:
    """Return twelve hex digits that identify dimensions [m]: SHA-256 of them, rounded to a nanometre."""
    text = " ".join(str(round(d * 1e9)) for d in dimensions)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


#: Thickness of the flange [m]: twice the 1.5 mm that Elastic 50A requires of a feature, to be clamped (assumed).
FLANGE_THICKNESS = 3.0 * MM
FLANGE_LIP = 3.5 * MM  #: Radial width under the clamp ring [m] (assumed).


def flange_for(base_d: float, min_d: float, thickness: float = FLANGE_THICKNESS, lip: float = FLANGE_LIP) -> Flange:
    """Return the flange of a probe of that base diameter [m].

    Args:
        base_d: of the probe.
        min_d: of the flange: the sensor's tool face, so that one adapter serves all thin probes and the flange covers
            the screws into the sensor.
        thickness, lip: of the flange, and its radial width under the clamp ring.
    """
    return Flange(max(base_d + 2 * lip, min_d), thickness)


Knot = tuple[float, float]


#: Largest deviation of the frusta from the sphere of a rounded tip [mm]: one pixel of a Form 3 in XY, the finest that
#: it prints; its layers of Elastic 50A are 0.1 mm.
DEVIATION_MM = 0.025


_MAX_FACETS = 64


def rounding_height_mm(before: Knot, tip: Knot) -> float:
    """Return the length of the rounding [mm]: r cos α, with r the tip's radius and α the taper's half-angle.

    Args:
        before, tip: the last two (s, diameter) of the blunt body [mm].
    """
    return tip[1] / 2.0 * math.cos(_half_angle(before, tip))


def rounding_radius_mm(before: Knot, tip: Knot) -> float:
    """Return the radius of the rounding's sphere [mm], which touches the last frustum and the end plane.

    R = r cos α/(1 - sin α), with r the tip's radius and α the taper's half-angle; arguments of `rounding_height_mm`.
    """
    alpha = _half_angle(before, tip)
    return tip[1] / 2.0 * math.cos(alpha) / (1.0 - math.sin(alpha))


def rounded(knots: tuple[Knot, ...]) -> tuple[Knot, ...]:
    """Return the knots (s, diameter) [mm] of a body with a round end of the same length.

    The sphere touches the last frustum all around and the end plane. The frusta are those
    of a regular polygon about it: every facet touches the sphere, the first is the flank itself, the last the flat
    end; no corner deviates by more than `DEVIATION_MM`.

    Args:
        knots: of the blunt body; its last frustum is at least `rounding_height_mm` long.
    """
    before, length = knots[-2], knots[-1][0]
    alpha = _half_angle(before, knots[-1])
    R = rounding_radius_mm(before, knots[-1])
    turn = math.pi / 2.0 - alpha  # of the normal, from the flank's to the end's
    widest = 2.0 * math.acos(1.0 / (1.0 + DEVIATION_MM / R))
    count = min(max(math.ceil(turn / widest), 2), _MAX_FACETS)
    step = turn / count
    corner = R / math.cos(step / 2.0)
    angles = [(k + 0.5) * step for k in reversed(range(1, count))]
    round_end = [(length - R + corner * math.cos(a), 2.0 * corner * math.sin(a)) for a in angles]
    return (*knots[:-1], *round_end, (length, 2.0 * R * math.tan(step / 2.0)))


def filleted(knots: tuple[Knot, ...], radius: float) -> tuple[tuple[Knot, ...], float]:
    """Return the knots (s, diameter) [mm] of a fillet between the flange's top, s = 0, and the flank above it.

    The circle of that radius touches the plane s = 0 and the flank outside of the body. Its corners lie on the circle,
    the first at s = 0; between them the frusta deviate by at most `DEVIATION_MM`, outwards.

    Args:
        knots: of the blunt body; its first frustum reaches beyond the fillet.
        radius: of the fillet [mm].

    Returns:
        The knots up to the end of the fillet, and its height [mm].
    """
    alpha = _half_angle(*knots[:2])
    base = knots[0][1] / 2.0
    # The centre lies at height `radius`, at that distance from the flank r = base - s tan α.
    centre = base - radius * math.tan(alpha) + radius / math.cos(alpha)
    end = math.pi / 2.0 - alpha  # of the turn from straight down to the flank's normal
    count = max(math.ceil(end / (2.0 * math.acos(max(1.0 - DEVIATION_MM / radius, 0.0)))), 2)
    turns = [end * k / count for k in range(count + 1)]
    points = [(radius * (1.0 - math.cos(t)), 2.0 * (centre - radius * math.sin(t))) for t in turns]
    return tuple(points), points[-1][0]


def _half_angle(before: Knot, tip: Knot) -> float:
    """Return the half-angle α of the last frustum [rad]; negative where it widens."""
    return math.atan((before[1] - tip[1]) / 2.0 / (tip[0] - before[0]))
