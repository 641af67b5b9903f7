"""What is to be best, and what has to be kept meanwhile."""

import re
from dataclasses import dataclass
from typing import Literal

from probedesign.errors import InputError
from probedesign.naming import unknown

Goal = Literal["error-at-force", "force-for-error"]
KEPT = (
    "error_mm",
    "worst_error_mm",
    "sag_mm",
    "reach_mm",
    "sensor_use",
    "slide_mm",
    "mass_g",
    "length_mm",
)
"""Figures that may be limited."""
_LIMIT = re.compile(r"\s*([A-Za-z_]+)\s*(<=|>=)\s*(\S+)\s*")


@dataclass(frozen=True)
class Limit:
    """A figure that must stay on one side of a value.

    Attributes:
        figure: one of `KEPT`.
        at_most: or else at least.
        value: in the unit that the figure's name ends with.
    """

    figure: str
    at_most: bool
    value: float

    @property
    def text(self) -> str:
        """As it was written."""
        return f"{self.figure} {'<=' if self.at_most else '>='} {self.value:g}"

    def room(self, figure: float) -> float:
        """How far the limit is kept, over its value; negative where it is not."""
        off = self.value - figure if self.at_most else figure - self.value
        return off / abs(self.value)


def parse_limit(text: str) -> Limit:
    """`sag_mm<=60` or `reach_mm>=100`.

    Raises:
        InputError: it is no limit, or of no such figure.
    """
    match = _LIMIT.fullmatch(text)
    if match is None:
        raise InputError(
            f"--subject-to {text!r}: write FIGURE<=NUMBER or FIGURE>=NUMBER, such as 'sag_mm<=60'"
        )
    figure, sign, number = match.groups()
    if figure not in KEPT:
        raise unknown("--subject-to", figure, KEPT)
    try:
        value = float(number)
    except ValueError:
        value = float("nan")
    if not 0.0 < value < 1e9:
        raise InputError(f"--subject-to {text!r}: {number} must be a positive number")
    return Limit(figure, sign == "<=", value)


def check_limits(limits: list[Limit]) -> None:
    """Refuse limits that contradict each other by themselves.

    Raises:
        InputError: a figure would have to be above and below.
    """
    for low in limits:
        for high in limits:
            if low.figure == high.figure and not low.at_most and high.at_most and low.value > high.value:
                raise InputError(f"--subject-to {low.text} and {high.text} contradict; drop one of them")
