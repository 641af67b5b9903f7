"""How several touches of one point are made and fused: the base presses on, in even parts of the greatest force."""

from dataclasses import dataclass

from probedesign.errors import InputError
from probedesign.estimation.fused import MomentsAbout

MAX_TOUCHES = 20


@dataclass(frozen=True)
class PressSchedule:
    """One way to press; prediction, search and Monte Carlo share it.

    Attributes:
        touches: of one fixed point of the world, the base turned as in its mount.
        moments_about: which moments count alone; None: forces too.
    """

    touches: int = 5
    moments_about: MomentsAbout | None = "sensor"

    def __post_init__(self) -> None:
        """Raises InputError where there is nothing to fuse."""
        if not 2 <= self.touches <= MAX_TOUCHES:
            raise InputError(
                f"touches = {self.touches} must lie in 2 ... {MAX_TOUCHES}, fused into one answer"
            )

    def forces(self, greatest_N: float) -> tuple[float, ...]:
        """Normal force of each touch in the order of time, the last the greatest [N]."""
        return (*(greatest_N * k / self.touches for k in range(1, self.touches)), greatest_N)

    @property
    def text(self) -> str:
        """For people."""
        counted = (
            f"moments about the {self.moments_about} alone" if self.moments_about else "forces and moments"
        )
        return f"{self.touches} touches fused as the base presses on, {counted}"
