"""How well it is known where the base is: what a point of the world can be no better than."""

from dataclasses import dataclass, fields, replace

import numpy as np

from probedesign.errors import InputError
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.estimation.unknowns import Unknowns
from probedesign.frames import Array
from probedesign.units import MM

FARTHEST_MM, FARTHEST_DEG = 10.0, 10.0
"""A base less well known than this is refused: a turn's errors are no longer in proportion to it, and touches of one
point no longer lie near to each other. Assumed; the design's `[tolerances]` allow as many degrees."""


@dataclass(frozen=True)
class Base:
    """Standard deviations of the base's pose as it is told, in the units that options are in.

    Attributes:
        base_offset_mm: of its place, the same at every pose, on each axis.
        base_repeat_mm: of its place at each pose for itself, on each axis.
        tilt_deg: of its turn about its x and its y axis, the same at every pose.
        clocking_deg: of its turn about its z axis, likewise.
    """

    base_offset_mm: float = Unknowns.base_offset / MM
    base_repeat_mm: float = Unknowns.base_repeat / MM
    tilt_deg: float = Tolerances.tilt_deg
    clocking_deg: float = Tolerances.clocking_deg

    def __post_init__(self) -> None:
        """Raises InputError where a standard deviation is none, or too great to be meant."""
        for entry in fields(self):
            value = getattr(self, entry.name)
            most = FARTHEST_MM if entry.name.endswith("_mm") else FARTHEST_DEG
            if not 0.0 <= value <= most:
                option = entry.name.replace("_", "-")
                raise InputError(f"--{option} {value:g} is a standard deviation: say 0 ... {most:g}")

    @classmethod
    def of(cls, model: ProbeModel) -> "Base":
        """Place and turn as the probe's tolerances have them; the scatter of a robot's poses is assumed."""
        known = Tolerances.of(model)
        return cls(known.base_mm, cls.base_repeat_mm, known.tilt_deg, known.clocking_deg)

    def unknowns(self, model: ProbeModel) -> Unknowns:
        """All that a fusion does not know: of the probe as the bundle has it, of the base as here."""
        return replace(
            Unknowns.of(model), base_offset=self.base_offset_mm * MM, base_repeat=self.base_repeat_mm * MM
        )

    @property
    def turn(self) -> Array:
        """About the base's axes [rad], (3,)."""
        return np.radians([self.tilt_deg, self.tilt_deg, self.clocking_deg])

    @property
    def short(self) -> str:
        """For people."""
        return (
            f"the base is taken as known to {self.base_offset_mm:g} mm in common and {self.base_repeat_mm:g} mm from "
            f"pose to pose, tilt {self.tilt_deg:g}°, clocking {self.clocking_deg:g}°"
        )

    @property
    def line(self) -> str:
        """The same, and what says otherwise."""
        return f"{self.short}; --base-offset-mm, --base-repeat-mm, --tilt-deg, --clocking-deg say otherwise"
