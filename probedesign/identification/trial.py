"""One test as the fit sees it: how the probe was loaded and what was read, in SI and in one frame."""

from dataclasses import dataclass, field

import numpy as np

from probedesign.frames import Array


@dataclass(frozen=True)
class Trial:
    """A state of the probe and what was measured of it; what was not is None or NaN.

    Attributes:
        name: of the test.
        T_world_base: pose of the base as told, (4, 4).
        gravity_world: [m/s²], (3,).
        force_world: a dead load known beforehand [N], (3,); None for a touch whose force is not known.
        s_contact: where the load acts [m].
        std_s: of it [m]; 0: exactly there.
        p_touch_world: the touched place of the surface, or of the centreline under a dead load [m], (3,).
        std_touch: of it on each axis [m].
        wrench_base: mean reading, told at the base [N, N·m], (6,).
        cov_wrench: of it, (6, 6).
        marker_s: arclengths of the markers that were seen [m], (m,).
        p_markers_world: [m], (m, 3).
        cov_markers: (m, 3, 3).
        marker_numbers: from 1 on, (m,).
        marker_side: side of the section that bears them [rad]; None: they are on the axis.
        sag: how far the tip hangs below where it would be without weight [m].
        std_sag: [m].
    """

    name: str
    T_world_base: Array
    gravity_world: Array
    force_world: Array | None
    s_contact: float = np.nan
    std_s: float = 0.0
    p_touch_world: Array | None = None
    std_touch: float = np.nan
    wrench_base: Array | None = None
    cov_wrench: Array | None = None
    marker_s: Array = field(default_factory=lambda: np.empty(0))
    p_markers_world: Array = field(default_factory=lambda: np.empty((0, 3)))
    cov_markers: Array = field(default_factory=lambda: np.empty((0, 3, 3)))
    marker_numbers: tuple[int, ...] = ()
    marker_side: float | None = None
    sag: float = np.nan
    std_sag: float = np.nan

    @property
    def free(self) -> bool:
        """Whether nothing but its weight loads it."""
        return self.force_world is not None and not np.any(self.force_world)

    @property
    def touched(self) -> bool:
        """Whether the force is unknown."""
        return self.force_world is None

    @property
    def own(self) -> int:
        """How many unknowns are its own: the force of a touch, and where a load acts."""
        return 3 * self.touched + self.slides

    @property
    def slides(self) -> bool:
        """Whether the place of the load is not known exactly."""
        return not self.free and not (np.isfinite(self.s_contact) and self.std_s == 0.0)

    @property
    def gravity_base(self) -> Array:
        """As the pose that was told has it [m/s²], (3,)."""
        return np.asarray(self.T_world_base[:3, :3].T @ self.gravity_world)
