"""What the marks of page and picture mean, in words."""

from dataclasses import dataclass

from probedesign.mapping.colour import SURE, VAGUE, hex_of

TRUTH_COLOUR, STROKE_COLOUR = "#a08c5a", "#999"
SWATCH = (34, 14)
"""Width and height of a mark beside its words, in units of SVG."""


@dataclass(frozen=True)
class Entry:
    """A mark and what it means.

    Attributes:
        mark: SVG within `SWATCH`.
        words: plain text.
    """

    mark: str
    words: str


def legend(ellipsoids: str, truth: bool) -> tuple[Entry, ...]:
    """All marks.

    Args:
        ellipsoids: how large they are drawn, in words.
        truth: whether the simulated truth is shown.
    """
    sure = hex_of(SURE)
    entries = (
        Entry(f'<circle cx="17" cy="7" r="2" fill="{sure}"/>', "a point of the surface, with its number"),
        Entry(
            f'<ellipse cx="17" cy="7" rx="12" ry="5" fill="{sure}" fill-opacity="0.25" stroke="{sure}"/>',
            f"its 95 % ellipsoid, {ellipsoids}",
        ),
        Entry(
            _scale(), f"colour: known to {SURE:g} mm or better (blue) ... {VAGUE:g} mm or worse (red), RMS"
        ),
        Entry(
            f'<path d="M6 7H28" stroke="{STROKE_COLOUR}"/>',
            "which way the object faces, by the force on the probe; the length says nothing",
        ),
    )
    outline = f'<path d="M5 12L12 3H30L23 12Z" fill="none" stroke="{TRUTH_COLOUR}" stroke-width="0.8"/>'
    edge = f'<path d="M5 12L12 3" stroke="{TRUTH_COLOUR}" stroke-width="2"/>'
    told = Entry(
        outline + edge, "the simulated truth, not measured: what was touched, its touched edges thick"
    )
    return (*entries, told) if truth else entries


def _scale() -> str:
    """The colours side by side, from sure to vague."""
    steps = 8
    width = (SWATCH[0] - 4) / steps
    shades = [SURE * (VAGUE / SURE) ** (i / (steps - 1)) for i in range(steps)]
    return "".join(
        f'<rect x="{2 + i * width:.2f}" y="4" width="{width:.2f}" height="6" fill="{hex_of(shade)}"/>'
        for i, shade in enumerate(shades)
    )
