"""Checks and means of readings as they come (compiled)."""

import math

from probedesign.rod.kernels import kernel
from probedesign.rod.kernels.linalg import cross, dot


@kernel
def admit(wrench, T, gravity_world, sensor_from_base, payload, limit, gravity):
    """Whether such a reading can be: finite, within the sensor's range, at a pose that is one.

    Args:
        wrench: at the base, (6,); T: of the base in the world, (4, 4).
        gravity_world: [m/s²], (3,).
        sensor_from_base, payload, limit: as in `observe`.
        gravity: in base axes, filled, (3,).
    """
    for i in range(3):
        gravity[i] = 0.0
        for j in range(3):
            square = -1.0 if i == j else 0.0
            for q in range(3):
                square += T[i, q] * T[j, q]
            if not abs(square) <= 1e-6 or not math.isfinite(T[i, 3]) or not abs(T[3, i]) <= 1e-6:
                return False
            gravity[i] += T[j, i] * gravity_world[j]
    x, y = (T[0, 0], T[1, 0], T[2, 0]), (T[0, 1], T[1, 1], T[2, 1])
    if not dot(cross(x, y), (T[0, 2], T[1, 2], T[2, 2])) > 0.0 or not abs(T[3, 3] - 1.0) <= 1e-6:
        return False
    for i in range(6):
        read = 0.0
        for j in range(6):
            read += sensor_from_base[i, j] * wrench[j]
        for j in range(3):
            read += payload[i, j] * gravity[j]
        if not abs(read) <= limit[i] or not math.isfinite(wrench[i]):
            return False
    return True


@kernel
def apart(a, b):
    """Distance of two poses [m]; a radian of turn counts as a tenth of a metre."""
    moved = turned = 0.0
    for i in range(3):
        moved += (a[i, 3] - b[i, 3]) ** 2
        for j in range(3):
            turned += (a[i, j] - b[i, j]) ** 2
    return math.sqrt(moved) + 0.1 * math.sqrt(0.5 * turned)
