"""Options that say where the base is, and how well that is known."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

from cyclopts import Parameter

if TYPE_CHECKING:
    from probedesign.estimation.model import ProbeModel
    from probedesign.live.poses.base_poses import BasePoses
    from probedesign.mapping.base_pose import BasePoseUncertainty


@Parameter(name="*")
@dataclass
class BaseOptions:
    """Where the base is."""

    pose: str = "fixed"
    """FILE.csv or .jsonl, a ROS 2 bag or udp://:PORT, as for `live`."""
    pose_latency_ms: float = 0.0
    """By which a pose arrives later than a reading of the same moment."""
    gravity_world: str | None = None
    """In the world's axes [m/s²], as 0,0,-9.81, which it is unless said."""
    base_offset_mm: float | None = None
    """Standard deviation of the base's place, the same at every pose; unless said, base_mm of the design's
    tolerances, else 0.05 (assumed)."""
    base_repeat_mm: float | None = None
    """The robot's error from pose to pose, on each axis; 0.01 unless said (assumed)."""
    tilt_deg: float | None = None
    """Of the base about its x and y axis, the same at every pose; unless said, the design's, else 0.2 (assumed)."""
    clocking_deg: float | None = None
    """Of the base about its z axis; unless said, the design's, else 0.5 (assumed)."""

    def base(self, model: "ProbeModel") -> "BasePoseUncertainty":
        """How well the base's pose is known.

        Raises:
            InputError: a value makes no sense.
        """
        from probedesign.mapping.base_pose import BasePoseUncertainty

        said = {entry.name: getattr(self, entry.name) for entry in fields(BasePoseUncertainty)}
        return replace(
            BasePoseUncertainty.from_model(model),
            **{name: value for name, value in said.items() if value is not None},
        )

    def poses(self, say: Callable[[str], None]) -> "BasePoses | None":
        """The poses; None if there are to be none.

        Raises:
            InputError: they cannot be had.
        """
        from probedesign.live.poses.open_poses import open_poses

        return open_poses(self.pose, self.pose_latency_ms, self.gravity_world, say)
