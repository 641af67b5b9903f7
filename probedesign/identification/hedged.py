"""What must be said beside a number that the tests told, but barely."""

from collections.abc import Sequence
from dataclasses import replace

from probedesign.identification.parameters import ASKABLE
from probedesign.identification.result import Identified
from probedesign.rod.rod import Rod
from probedesign.units import MPA

BARELY = 0.5
"""Of `Askable.told`, the standard deviation that tells nothing: from here on, with what the fit does not count, a
number is told barely. Assumed."""


def hedged(numbers: Sequence[Identified], rod: Rod) -> tuple[Identified, ...]:
    """The numbers with their doubts.

    Args:
        numbers: all that was asked for, counted in all.
        rod: of the probe as designed.
    """
    E = next((one.value for one in numbers if one.name == "E"), rod.youngs_modulus / MPA)
    designed = rod.youngs_modulus / rod.shear_modulus
    return tuple(
        replace(one, doubt="; ".join(filter(None, (_barely(one), _not_apart(one, E, designed)))))
        if one.identified
        else one
        for one in numbers
    )


def _barely(one: Identified) -> str:
    """Whether it is a factor's logarithm, and told nearly too badly to be told at all."""
    asked = ASKABLE.get(one.name)
    if asked is None or not asked.logarithm or one.share_in_all < BARELY * asked.told:
        return ""
    return (
        f"barely told: its standard deviation in all is {one.share_in_all:.0%}, and {asked.told:.0%} by the fit alone "
        "would leave it at the design's"
    )


def _not_apart(one: Identified, E: float, designed: float) -> str:
    """Which ratios to E the 95 % interval of G leaves open: that of what keeps its volume, and the design's."""
    if one.name != "G" or one.low_in_all is None or one.high_in_all is None:
        return ""
    ratios = {"E/3": 3.0, f"the design's E/{designed:.3g}": designed}
    left = [name for name, ratio in ratios.items() if one.low_in_all <= E / ratio <= one.high_in_all]
    return f"not told apart from {' and '.join(left)}" if left else ""
