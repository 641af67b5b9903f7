"""Mean of a window of readings with its tests: within range, free probe, sensor at zero (compiled)."""

import math
from pathlib import Path

from probedesign.rod.kernels.compiled import drop_stale, kernel

drop_stale(Path(__file__).parent)

WRENCH, WEIGHT, CHI2, SIZE, SENSOR, WHITEN, SEEN = 0, 6, 9, 10, 11, 12, 48
"""Offsets of the mean wrench (6), the flexible part's weight (3), the misfit of the free probe, the size of the moment,
the misfit of a sensor that reads zero, and the mean's whitening (6, 6); and the size of all."""


@kernel
def observe(
    window, gravity, free, mass, sensor_from_base, hanging, most, whiten, force_noise, moment_noise, seen
):
    """Evaluate a window of readings.

    Args:
        window: base wrenches, (n, 6).
        gravity: base axes [m/s²], (3,).
        free: the free probe's wrench, (6,).
        mass: of the flexible part [kg].
        sensor_from_base: carries wrenches, (6, 6); hanging: what hangs on the sensor, by gravity, (6, 3).
        most: the sensor's range, (6,).
        whiten: of one reading, lower triangular, (6, 6).
        force_noise, moment_noise: standard deviations of one reading's channels [N], [N·m].
        seen: filled, (SEEN,).

    Returns:
        Whether the sensor can have read them all: finite, and within its range.
    """
    n = window.shape[0]
    for i in range(6):
        seen[WRENCH + i] = 0.0
    for k in range(n):
        for i in range(6):
            read = 0.0
            for j in range(6):
                read += sensor_from_base[i, j] * window[k, j]
            for j in range(3):
                read += hanging[i, j] * gravity[j]
            if not abs(read) <= most[i] or not math.isfinite(window[k, i]):
                return False
            seen[WRENCH + i] += window[k, i] / n
    for q in range(3):
        seen[WEIGHT + q] = mass * gravity[q]
    root, chi2, sensor_chi2 = math.sqrt(n), 0.0, 0.0
    for i in range(6):
        read = 0.0
        for j in range(6):
            read += sensor_from_base[i, j] * seen[WRENCH + j]
        for j in range(3):
            read += hanging[i, j] * gravity[j]
        sensor_chi2 += n * (read / (force_noise if i < 3 else moment_noise)) ** 2
        off = 0.0
        for j in range(6):
            seen[WHITEN + 6 * i + j] = root * whiten[i, j]
            off += root * whiten[i, j] * (seen[WRENCH + j] - free[j])
        chi2 += off * off
    seen[CHI2], seen[SENSOR] = chi2, sensor_chi2
    seen[SIZE] = math.sqrt(seen[WRENCH + 3] ** 2 + seen[WRENCH + 4] ** 2 + seen[WRENCH + 5] ** 2)
    return True
