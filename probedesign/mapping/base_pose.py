"""Uncertainty of the base pose, the limit of the accuracy of a point in the world."""

from dataclasses import dataclass, fields, replace

import numpy as np

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances

MAX_STD_MM, MAX_STD_DEG = 10.0, 10.0
"""Largest standard deviations accepted: beyond them errors are no longer linear in a rotation, and touches of one point
no longer lie near each other. Assumed; the `[tolerances]` of a design allow as many degrees."""


@dataclass(frozen=True)
class BasePoseUncertainty:
    """Standard deviations of the reported base pose, in the units of the command line.

    Attributes:
        base_offset_mm: of the position, constant for all poses, on each axis.
        base_repeat_mm: of the position at each pose, on each axis.
        tilt_deg: of the rotation about the base's x and y axes, constant for all poses.
        clocking_deg: of the rotation about its z axis, likewise.
    """

    base_offset_mm: float = Tolerances.base_mm
    base_repeat_mm: float = Tolerances.robot_mm
    tilt_deg: float = Tolerances.tilt_deg
    clocking_deg: float = Tolerances.clocking_deg

    def __post_init__(self) -> None:
        """Raise InputError where a standard deviation is out of range."""
        for entry in fields(self):
            value = getattr(self, entry.name)
            largest = MAX_STD_MM if entry.name.endswith("_mm") else MAX_STD_DEG
            if not 0.0 <= value <= largest:
                option = entry.name.replace("_", "-")
                raise InputError(
                    f"--{option} {value:g} is a standard deviation; it must lie in 0 ... {largest:g}"
                )

    @classmethod
    def from_model(cls, model: ProbeModel) -> "BasePoseUncertainty":
        """Return the uncertainty that the tolerances of a probe state."""
        tolerances = Tolerances.of(model)
        return cls(tolerances.base_mm, tolerances.robot_mm, tolerances.tilt_deg, tolerances.clocking_deg)

    def apply_to(self, tolerances: Tolerances) -> Tolerances:
        """Return tolerances of probe, sensor and mount with this uncertainty of the base pose."""
        return replace(
            tolerances,
            base_mm=self.base_offset_mm,
            robot_mm=self.base_repeat_mm,
            tilt_deg=self.tilt_deg,
            clocking_deg=self.clocking_deg,
        )

    @property
    def rotation_std(self) -> Array:
        """Standard deviations of the rotation about the base axes [rad], (3,)."""
        return np.radians([self.tilt_deg, self.tilt_deg, self.clocking_deg])

    @property
    def summary(self) -> str:
        """The standard deviations in one line."""
        return (
            f"base pose uncertainty: {self.base_offset_mm:g} mm common, {self.base_repeat_mm:g} mm per pose, "
            f"tilt {self.tilt_deg:g}°, clocking {self.clocking_deg:g}°"
        )

    @property
    def notice(self) -> str:
        """The same line with the options that change it."""
        return (
            f"{self.summary}; change it with --base-offset-mm, --base-repeat-mm, --tilt-deg, --clocking-deg"
        )
