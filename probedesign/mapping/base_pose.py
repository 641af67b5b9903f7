"""How well it is known where the base is: what a point of the world can be no better than."""

from dataclasses import dataclass, fields, replace

import numpy as np

from probedesign.errors import InputError
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.frames import Array

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

    base_offset_mm: float = Tolerances.base_mm
    base_repeat_mm: float = Tolerances.robot_mm
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
        """Return what the probe's tolerances state of place, scatter and turn."""
        known = Tolerances.of(model)
        return cls(known.base_mm, known.robot_mm, known.tilt_deg, known.clocking_deg)

    def priors(self, known: Tolerances) -> Tolerances:
        """Return the same tolerances with the pose of the base as stated here.

        Args:
            known: of probe, sensor and mount.
        """
        return replace(
            known,
            base_mm=self.base_offset_mm,
            robot_mm=self.base_repeat_mm,
            tilt_deg=self.tilt_deg,
            clocking_deg=self.clocking_deg,
        )

    @property
    def turn(self) -> Array:
        """Standard deviations of the turn about the base's axes [rad], (3,)."""
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
