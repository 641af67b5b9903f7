"""How several touches of one point are made and fused: the base presses on, in even parts of the greatest force."""

from dataclasses import dataclass, replace

from probedesign.errors import InputError
from probedesign.estimation.fused import MomentsAbout
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.estimation.unknowns import Unknowns
from probedesign.units import MM

MOST_TOUCHES = 20


@dataclass(frozen=True)
class Pressing:
    """One way to touch.

    Attributes:
        touches: of one fixed point of the surface, the base turned as in its mount.
        moments_about: which moments count alone; None: forces too.
    """

    touches: int = 5
    moments_about: MomentsAbout | None = "sensor"

    def __post_init__(self) -> None:
        """Raises InputError where there is nothing to fuse."""
        if not 2 <= self.touches <= MOST_TOUCHES:
            raise InputError(
                f"touches = {self.touches} must lie in 2 ... {MOST_TOUCHES}, fused into one answer"
            )

    def forces(self, greatest_N: float) -> tuple[float, ...]:
        """Of each touch in the order of time, the last the greatest [N]."""
        return (*(greatest_N * k / self.touches for k in range(1, self.touches)), greatest_N)

    @property
    def ramp(self) -> tuple[float, ...]:
        """How far the creep has come at each touch, of what it is at the last: none at the first, as fusion has it."""
        return tuple(k / (self.touches - 1) for k in range(self.touches))

    @property
    def text(self) -> str:
        """For people."""
        counted = (
            f"moments about the {self.moments_about} alone" if self.moments_about else "forces and moments"
        )
        return f"{self.touches} touches fused as the base presses on, {counted}"


def unknowns_of(model: ProbeModel, tolerances: Tolerances) -> Unknowns:
    """What the estimator is told that it does not know: as the tolerances say, creep only where the design does."""
    return replace(
        Unknowns.of(model), stiffness=tolerances.youngs_modulus, base_offset=tolerances.base_mm * MM,
        base_repeat=tolerances.robot_mm * MM, bias_steps=0.0, bias_walk_steps=tolerances.drift_steps,
    )  # fmt: skip
