"""What a probe is asked to do: how hard, where and how often it touches, and what of a reading counts."""

from dataclasses import dataclass

from probedesign.errors import InputError
from probedesign.estimation.fused import MomentsAbout

FRACTIONS = (0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
"""Of the length, where the error is averaged over: the part that touches, less the tip itself."""
BASE_REPEAT_MM = 0.05
"""The robot's error from touch to touch on each axis. Assumed: a small arm's repeatability."""


@dataclass(frozen=True)
class Task:
    """One way to use a probe.

    Attributes:
        force_N: the contact force; of several touches that of the strongest, the others even parts of it.
        touches: of one fixed point as the base presses on; 1 is a single reading.
        moments_about: with several touches, which moments count alone; None: forces too.
        base_repeat_mm: of several touches, how far the base is off at each for itself, on each axis.
        bias_walk_steps: of several touches, how far the bias walks from one to the next, in steps of resolution.
        fractions: of the length, where.
    """

    force_N: float = 0.005
    touches: int = 5
    moments_about: MomentsAbout | None = "sensor"
    base_repeat_mm: float = BASE_REPEAT_MM
    bias_walk_steps: float = 0.2
    fractions: tuple[float, ...] = FRACTIONS

    def __post_init__(self) -> None:
        """Raises InputError where a value makes no sense."""
        if not 0.0 < self.force_N <= 100.0:
            raise InputError(f"force = {self.force_N:g} N must lie in (0, 100]")
        if not 1 <= self.touches <= 100:
            raise InputError(f"touches = {self.touches} must lie in 1 ... 100")
        for name, value in (("base repeat", self.base_repeat_mm), ("bias walk", self.bias_walk_steps)):
            if not 0.0 <= value <= 100.0:
                raise InputError(f"{name} = {value:g} must lie in 0 ... 100")
        if not self.fractions or not all(0.0 < f <= 1.0 for f in self.fractions):
            raise InputError(f"fractions {list(self.fractions)} must lie in (0, 1]")

    @property
    def text(self) -> str:
        """In one line, for people."""
        where = f"RMS over {self.fractions[0]:g}-{self.fractions[-1]:g} of the length"
        if self.touches == 1:
            return f"one reading at {1e3 * self.force_N:g} mN, sensor noise alone, {where}"
        counts = (
            f"moments about the {self.moments_about} alone" if self.moments_about else "forces and moments"
        )
        return (
            f"{self.touches} touches up to {1e3 * self.force_N:g} mN fused, {counts}, base repeats to "
            f"{self.base_repeat_mm:g} mm, bias walks {self.bias_walk_steps:g} steps, {where}"
        )
