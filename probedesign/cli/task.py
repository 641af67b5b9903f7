"""Options that say what a probe is to do: the same for sweep, optimize and compare."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from probedesign.errors import InputError

if TYPE_CHECKING:
    from probedesign.optimization.task import Task

About = Literal["sensor", "base"]


_LIST: dict[str, Any] = {"negative": (), "consume_multiple": True}


@Parameter(name="*")
@dataclass
class TaskOptions:
    """What the probe is judged by: every place with every force under every gravity is one case."""

    force_N: Annotated[list[float] | None, Parameter(name="--force-N", **_LIST)] = None
    """Normal contact force, one or several; of several touches that of the strongest, the others even parts of it. By
    default 0.005."""
    touches: int = 5
    """Of one fixed point, fused as the base presses on; 1 is a single reading."""
    forces_too: bool = False
    """Fuse forces and moments; by default moments alone."""
    moments_about: About = "sensor"
    """Which moments count alone: those that the sensor reads, or those about the base's origin."""
    base_repeat_mm: float | None = None
    """The robot's error from touch to touch, on each axis; by default robot_mm of the design's tolerances."""
    bias_walk_steps: float | None = None
    """Walk of the sensor's bias from touch to touch, in steps of its resolution; by default walk_steps of the design's
    tolerances."""
    places: str = "0.4:0.9:0.1"
    """START:STOP:STEP as fractions of the length: where it is touched."""
    at: Annotated[list[float] | None, Parameter(**_LIST)] = None
    """Fractions of the length where it is touched, in place of --places."""
    gravity: Annotated[list[str] | None, Parameter(**_LIST)] = None
    """X,Y,Z in base axes [m/s²], one or several, such as 9.81,0,0; by default the design's mount."""
    combine: Literal["mean", "worst"] = "mean"
    """How the cases make one error: RMS, or the worst."""

    def task(self) -> "Task":
        """The task.

        Raises:
            InputError: a value makes no sense.
        """
        from probedesign.optimization.grid import numbers_of
        from probedesign.optimization.task import Task

        moments = None if self.forces_too else self.moments_about
        places = self.at if self.at is not None else numbers_of("--places", self.places)
        return Task(
            tuple(self.force_N or (0.005,)), self.touches, moments, self.base_repeat_mm, self.bias_walk_steps,
            tuple(map(float, places)), tuple(map(_vector, self.gravity or [])), self.combine,
        )  # fmt: skip


def _vector(text: str) -> tuple[float, float, float]:
    """X,Y,Z.

    Raises:
        InputError: it is not three numbers.
    """
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--gravity {text!r}: write X,Y,Z in m/s², such as 9.81,0,0") from None
    return x, y, z
