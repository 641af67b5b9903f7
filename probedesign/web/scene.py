"""What the scenes of `live --view` and of the studio share: scale, colours and rotations."""

import numpy as np
import viser.transforms as tf

from probedesign.core.frames import Array

UNIT = 20.0  #: Scene units per metre: viser's lights, camera and shadows suit objects of a few units.
MIN_HALF_AXIS = 0.9e-3  #: Minimum half-axis of the drawn ellipsoid [m], so that it is visible.
ARROW = 0.03  #: Length of the force arrow [m]; its label states the force.
PROBE, CONTACT, SPREAD, STALE_COLOUR = (236, 148, 66), (150, 10, 30), (232, 72, 66), (150, 150, 150)
METAL = (132, 142, 154)
PART_COLOURS = {"sensor": (60, 64, 72), "flange": PROBE, "clamp_ring": (112, 122, 136),
                "flange_adapter": (150, 158, 168)}  # fmt: skip


def level_rotation(gravity_base: Array) -> Array:
    """Return the rotation of the base that points gravity down, the nearest to upright, (3, 3)."""
    g = np.asarray(gravity_base, dtype=float)
    if not np.linalg.norm(g) > 0.0:
        return np.eye(3)
    up = -g / np.linalg.norm(g)  # world z in base axes
    side = np.array([1.0, 0.0, 0.0]) if abs(up[0]) < 0.9 else np.array([0.0, 0.0, 1.0])
    x = side - (side @ up) * up
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(up, x), up])


def quaternion(R: Array) -> Array:
    """Return the quaternion w, x, y, z of a rotation, as viser reads it."""
    return np.asarray(tf.SO3.from_matrix(R).wxyz, dtype=float)
