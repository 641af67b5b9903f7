"""Former priors of a fusion; they are part of `Tolerances` now."""

from dataclasses import dataclass, fields

from probedesign.core.errors import InputError
from probedesign.estimation.model import ProbeModel

IDENTIFIED = 0.005
"""What an identification on the bench leaves of the stiffness, relative. Assumed."""
ASSUMED_STIFFNESS = 0.03
"""Standard deviation of E where nothing was measured, relative: prints of one resin differ so. Assumed."""


def stiffness_spread(model: ProbeModel) -> float:
    """Return the standard deviation of E and of G, relative: of the design's material, or by where E comes from."""
    if model.stiffness_spread is not None:
        return model.stiffness_spread
    E = model.material.get("youngs_modulus")
    return IDENTIFIED if E is not None and E.provenance == "identified" else ASSUMED_STIFFNESS


@dataclass(frozen=True)
class Unknowns:
    """Priors of a fusion in which the probe is known but for its stiffness: kept for one release, use `Tolerances`.

    Attributes:
        stiffness: of E and of G, relative.
        base_offset: of the base's place, the same at every pose, on each of the base's axes [m].
        base_repeat: of the base's place at each pose for itself, on each axis [m].
        bias_steps: of the sensor's bias at the first reading, in steps of its resolution.
        bias_walk_steps: of the bias's step from one reading to the next, in the same steps.
        creep: of how far the stiffness has relaxed at the last reading, relative.
    """

    stiffness: float = ASSUMED_STIFFNESS
    base_offset: float = 0.05e-3
    base_repeat: float = 0.01e-3
    bias_steps: float = 0.0
    bias_walk_steps: float = 0.2
    creep: float = 0.0

    def __post_init__(self) -> None:
        """Raises InputError where a value is not a standard deviation."""
        for entry in fields(self):
            value = getattr(self, entry.name)
            if not 0.0 <= value < float("inf"):
                raise InputError(f"{entry.name} = {value} must be a standard deviation: finite, not negative")

    @classmethod
    def of(cls, model: ProbeModel) -> "Unknowns":
        """Return the priors of the design's material."""
        return cls(stiffness=stiffness_spread(model), creep=model.creep_spread)

    @classmethod
    def none(cls) -> "Unknowns":
        """Return priors with which all but the object is known exactly."""
        return cls(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
