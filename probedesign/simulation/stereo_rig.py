"""Simulated stereo rig: two cameras, control points and the probe's markers."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from probedesign.core.frames import Array
from probedesign.simulation.ground_truth import GroundTruth, SimulatedTest, marker_arclengths
from probedesign.vision.camera import Camera

SIZE_PX = (1600, 1200)
#: Picture and focal length of a compact camera, reduced to keep examples small (assumed); the paper's has 20
#: megapixels.
FOCAL_PX = 2200.0
#: Of each camera to its side: 70° between the lines of sight give depth about the precision of the other axes.
AZIMUTH = math.radians(35.0)
ELEVATION = math.radians(20.0)
FIELD_OF_VIEW = 1.35  #: Width of the field of view, over the largest extent of the box.
#: Standard deviations of clicked markers and control points (assumed: a person, a mouse, a dot of 3 mm).
CLICK_PX, CONTROL_PX = 0.7, 0.5


@dataclass(frozen=True, eq=False)
class StereoRig:
    """Two cameras, a box of control points and the markers of the probe."""

    truth: GroundTruth  #: what the cameras see.

    @cached_property
    def marker_s(self) -> Array:
        """Arclengths of the markers, stated and true [m], (k,)."""
        return np.array(marker_arclengths(self.truth.model.rod.length))

    @cached_property
    def side(self) -> float:
        """Side of the section towards the cameras, from the base's x axis about z, in whole degrees [rad]."""
        towards = self.truth.T_world_base[:3, :3].T @ np.array([0.0, -1.0, math.tan(ELEVATION)])
        return math.radians(round(math.degrees(math.atan2(towards[1], towards[0]))))

    @cached_property
    def workspace(self) -> tuple[Array, Array]:
        """Centre and size of the box in which the probe moves, (3,) each [m]."""
        length = self.truth.model.rod.length
        axis = self.truth.T_world_base[:3, 2]
        centre = self.truth.T_world_base[:3, 3] + 0.5 * length * axis
        size = np.maximum(1.1 * length * np.abs(axis), 0.7 * length)
        return np.asarray(np.round(centre, 3)), np.asarray(np.round(size, 3), dtype=float)

    @cached_property
    def control_points(self) -> Array:
        """Twenty points of a box [m]: its corners and the midpoints of its edges, (20, 3)."""
        centre, size = self.workspace
        grid = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)], dtype=float)
        on_edges = grid[np.abs(grid).sum(axis=1) >= 2]
        return np.asarray(centre + on_edges * size / 2.0)

    @cached_property
    def cameras(self) -> tuple[Camera, Camera]:
        """Left and right camera."""
        centre, size = self.workspace
        distance = FIELD_OF_VIEW * float(size.max()) * FOCAL_PX / SIZE_PX[0] + size.max() / 2.0
        cameras = []
        for name, angle in (("left", -AZIMUTH), ("right", AZIMUTH)):
            direction = np.array([math.sin(angle), -math.cos(angle), math.tan(ELEVATION)])
            p = centre + distance * direction / np.linalg.norm(direction)
            cameras.append(Camera.looking(name, p, centre, FOCAL_PX, SIZE_PX))
        return cameras[0], cameras[1]

    def markers(self, test: SimulatedTest) -> Array:
        """Return the true positions of the markers in the world [m], (k, 3)."""
        centre, outward, radius = self.sections(test)
        return np.asarray(centre + radius[:, None] * outward)

    def sections(self, test: SimulatedTest) -> tuple[Array, Array, Array]:
        """Return the centres of the marked sections, the direction to their side, and the distance of the surface."""
        s = np.minimum(self.marker_s, self.truth.rod.length)
        eq, bench = test.equilibrium, test.bench
        R = eq.R_at(s)
        outward = R[:, :, 0] * math.cos(self.side) + R[:, :, 1] * math.sin(self.side)
        radius = self.truth.rod.radius_at(s)
        radius *= self.truth.model.cross_section.reach(self.side)
        return bench.to_world(eq.p_at(s)), outward @ bench.T_world_true[:3, :3].T, radius
