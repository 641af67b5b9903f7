"""A rounded tip as the knots that mechanics and CAD both read: frusta about a sphere."""

import math

Knot = tuple[float, float]

DEVIATION_MM = 0.025
"""How far the frusta may stand off the sphere [mm]: one pixel of a Form 3 in XY, which prints no finer; its layers
of Elastic 50A are 0.1 mm."""
_MOST_FACETS = 64


def rounding_height_mm(before: Knot, tip: Knot) -> float:
    """How much of the length the rounding takes [mm]: r cos α, with r the tip's radius and α the taper's half-angle.

    Args:
        before, tip: the last two (s, diameter) of the blunt body [mm].
    """
    return tip[1] / 2.0 * math.cos(_half_angle(before, tip))


def rounded(knots: tuple[Knot, ...]) -> tuple[Knot, ...]:
    """The knots (s, diameter) [mm] of the same body with a round end; its length stays.

    The sphere touches the last frustum all around and the end plane: R = r cos α/(1 - sin α). The frusta are those
    of a regular polygon about it: every facet touches the sphere, the first is the flank itself, the last the flat
    end; no corner stands off by more than `DEVIATION_MM`.

    Args:
        knots: of the blunt body; its last frustum is at least `rounding_height_mm` long.
    """
    before, (length, d) = knots[-2], knots[-1]
    alpha = _half_angle(before, knots[-1])
    R = d / 2.0 * math.cos(alpha) / (1.0 - math.sin(alpha))
    turn = math.pi / 2.0 - alpha  # of the normal, from the flank's to the end's
    widest = 2.0 * math.acos(1.0 / (1.0 + DEVIATION_MM / R))
    count = min(max(math.ceil(turn / widest), 2), _MOST_FACETS)
    step = turn / count
    corner = R / math.cos(step / 2.0)
    angles = [(k + 0.5) * step for k in reversed(range(1, count))]
    round_end = [(length - R + corner * math.cos(a), 2.0 * corner * math.sin(a)) for a in angles]
    return (*knots[:-1], *round_end, (length, 2.0 * R * math.tan(step / 2.0)))


def _half_angle(before: Knot, tip: Knot) -> float:
    """α of the last frustum [rad]; negative where it widens."""
    return math.atan((before[1] - tip[1]) / 2.0 / (tip[0] - before[0]))
