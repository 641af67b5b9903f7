"""Options that say what a probe is to do: the same for sweep, optimize and compare."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

if TYPE_CHECKING:
    from probedesign.search.task import Task

About = Literal["sensor", "base"]


@Parameter(name="*")
@dataclass
class TaskOptions:
    """What the probe is judged by."""

    force_N: Annotated[float, Parameter(name="--force-N")] = 0.005
    """Contact force; of several touches that of the strongest, the others even parts of it."""
    touches: int = 5
    """Of one fixed point, fused as the base presses on; 1 is a single reading, sensor noise alone."""
    forces_too: bool = False
    """Fuse forces and moments; by default moments alone."""
    moments_about: About = "sensor"
    """Which moments count alone: those that the sensor reads, or those about the base's origin."""
    base_repeat_mm: float = 0.05
    """The robot's error from touch to touch, on each axis."""
    bias_walk_steps: float = 0.2
    """Walk of the sensor's bias from touch to touch, in steps of its resolution."""
    places: str = "0.4:0.9:0.1"
    """START:STOP:STEP as fractions of the length: where it is touched."""

    def task(self) -> "Task":
        """The task.

        Raises:
            InputError: a value makes no sense.
        """
        from probedesign.search.grid import numbers_of
        from probedesign.search.task import Task

        moments = None if self.forces_too else self.moments_about
        return Task(self.force_N, self.touches, moments, self.base_repeat_mm, self.bias_walk_steps,
                    tuple(map(float, numbers_of("--places", self.places))))  # fmt: skip
