"""What a fusion does not know beside where the object is, and how well it knows it beforehand."""

from dataclasses import dataclass, fields, replace
from typing import Literal

import numpy as np

from probedesign.errors import InputError
from probedesign.estimation.model import ProbeModel
from probedesign.frames import Array

EXACT = 1e-12
"""A prior that is none, relative and in metres."""
IDENTIFIED = 0.005
"""What an identification on the bench leaves of the stiffness, relative. Assumed."""
Source = Literal["stiffness", "bias", "robot"]


@dataclass(frozen=True)
class Unknowns:
    """Prior standard deviations. All of them are assumed: say what your bench and robot have.

    Attributes:
        stiffness: of a common factor on E and G, relative. 0.03: prints of one resin differ by so much (assumed);
            0.005 is what an identification on the bench leaves.
        base_offset: of the base's place, the same at every pose, on each of the base's axes [m].
        base_repeat: of the base's place at each pose for itself, on each axis [m].
        bias_steps: of the sensor's bias at the first reading, on each channel, in steps of its resolution: what the
            tare left.
        bias_walk_steps: how far the bias walks from one reading to the next, in the same steps.
        creep: of the factor by which the stiffness has relaxed at the last reading, relative; it grows evenly over
            the readings, from none at the first. 0 leaves creep out.
    """

    stiffness: float = 0.03
    base_offset: float = 0.05e-3
    base_repeat: float = 0.01e-3
    bias_steps: float = 0.0
    bias_walk_steps: float = 0.2
    creep: float = 0.0

    def __post_init__(self) -> None:
        """Raises InputError where a standard deviation is none."""
        for entry in fields(self):
            value = getattr(self, entry.name)
            if not 0.0 <= value < float("inf"):
                raise InputError(f"{entry.name} = {value} must be a standard deviation: finite, not negative")

    @classmethod
    def of(cls, model: ProbeModel) -> "Unknowns":
        """As the design's material has it; E that was identified on the bench is known six times as well."""
        stiffness = model.stiffness_spread
        if stiffness is None:
            E = model.material.get("youngs_modulus")
            stiffness = IDENTIFIED if E is not None and E.provenance == "identified" else cls.stiffness
        return cls(stiffness=stiffness, creep=model.creep_spread)

    @classmethod
    def none(cls) -> "Unknowns":
        """Everything but the object is known exactly."""
        return cls(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    @property
    def prior(self) -> Array:
        """Standard deviations of log stiffness and of the base's offset [m], (4,); never quite none."""
        offset = max(self.base_offset, EXACT)
        return np.array([max(self.stiffness, EXACT), offset, offset, offset])

    def without(self, source: Source) -> "Unknowns":
        """The same with one source of error gone."""
        if source == "stiffness":
            return replace(self, stiffness=0.0, creep=0.0)
        if source == "bias":
            return replace(self, bias_steps=0.0, bias_walk_steps=0.0)
        return replace(self, base_offset=0.0, base_repeat=0.0)
