"""What the cameras of a synthetic campaign see: a box with points that are known, and the probe's markers."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from probedesign.frames import Array
from probedesign.rod.equilibrium import Equilibrium
from probedesign.simulation.ground_truth import State, World
from probedesign.simulation.plan import marker_arclengths
from probedesign.simulation.tube import Dots, Tube
from probedesign.vision.camera import Camera

SIZE_PX = (1600, 1200)
FOCAL_PX = 2200.0
"""A compact camera's picture, halved and more so that examples stay small (assumed); the paper's has 20 megapixels."""
BESIDE = math.radians(35.0)
"""Each camera stands that far to its side: 70° between the sights tell depth about as well as the rest."""
ABOVE = math.radians(20.0)
ROOM = 1.35
"""Width of what a picture shows, over the largest extent of the box."""
CLICK_PX, CONTROL_PX = 0.7, 0.5
"""Standard deviations of clicked markers and control points (assumed: a person, a mouse, a dot of 3 mm)."""
DOT_SHARE, DOT_MOST = 0.45, 3e-3
"""Diameter of a dot over that of the probe there, and at most [m]."""


@dataclass(frozen=True, eq=False)
class Sight:
    """The cameras, the box and the markers.

    Attributes:
        world: what they look at.
    """

    world: World

    @cached_property
    def marker_s(self) -> Array:
        """Arclengths of the markers, as the ruler said them and where they are [m], (k,)."""
        return np.array(marker_arclengths(self.world.model.rod.length))

    @cached_property
    def side(self) -> float:
        """Side of the section that faces the cameras, from the base's x axis about z, in whole degrees [rad]."""
        towards = self.world.T_world_base[:3, :3].T @ np.array([0.0, -1.0, math.tan(ABOVE)])
        return math.radians(round(math.degrees(math.atan2(towards[1], towards[0]))))

    @cached_property
    def _room(self) -> tuple[Array, Array]:
        """Centre and size of the box that the probe moves in, (3,) each [m]."""
        length = self.world.model.rod.length
        axis = self.world.T_world_base[:3, 2]
        centre = self.world.T_world_base[:3, 3] + 0.5 * length * axis
        size = np.maximum(1.1 * length * np.abs(axis), 0.7 * length)
        return np.asarray(np.round(centre, 3)), np.asarray(np.round(size, 3), dtype=float)

    @cached_property
    def control_points(self) -> Array:
        """Twenty points of a box [m]: its corners and the middles of its edges, (20, 3)."""
        centre, size = self._room
        grid = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)], dtype=float)
        on_edges = grid[np.abs(grid).sum(axis=1) >= 2]
        return np.asarray(centre + on_edges * size / 2.0)

    @cached_property
    def cameras(self) -> tuple[Camera, Camera]:
        """Left and right."""
        centre, size = self._room
        far = ROOM * float(size.max()) * FOCAL_PX / SIZE_PX[0] + size.max() / 2.0
        found = []
        for name, angle in (("left", -BESIDE), ("right", BESIDE)):
            way = np.array([math.sin(angle), -math.cos(angle), math.tan(ABOVE)])
            found.append(
                Camera.looking(name, centre + far * way / np.linalg.norm(way), centre, FOCAL_PX, SIZE_PX)
            )
        return found[0], found[1]

    def tube(self, eq: Equilibrium) -> Tube:
        """The bent probe in the world."""
        s = np.linspace(0.0, self.world.rod.length, 400)
        radius = np.interp(s, self.world.rod.s, self.world.rod.radius)
        return Tube(self.world.to_world(eq.p_at(s)), 2.0 * radius)

    def dots(self, eq: Equilibrium) -> Dots:
        """The dots on it."""
        _, outward, radius = self._marked(eq)
        return Dots(self.marker_s, outward, np.minimum(2.0 * DOT_SHARE * radius, DOT_MOST))

    def markers(self, state: State) -> Array:
        """Where they truly are in the world [m], (k, 3)."""
        centre, outward, radius = self._marked(state.equilibrium)
        return np.asarray(centre + radius[:, None] * outward)

    def _marked(self, eq: Equilibrium) -> tuple[Array, Array, Array]:
        """Centres of the marked sections, way to their side, and how far the surface lies there."""
        s = np.minimum(self.marker_s, self.world.rod.length)
        R = eq.R_at(s)
        outward = R[:, :, 0] * math.cos(self.side) + R[:, :, 1] * math.sin(self.side)
        radius = np.interp(s, self.world.rod.s, self.world.rod.radius)
        radius *= self.world.model.cross_section.reach(self.side)
        return self.world.to_world(eq.p_at(s)), outward @ self.world.T_world_true[:3, :3].T, radius
