"""Observations for estimation: one wrench reading at the base or the mean of a window, with its covariance."""

import math
from dataclasses import dataclass

import numpy as np

from probedesign.core.frames import Array
from probedesign.estimation.model import ProbeModel
from probedesign.rod.kernels.compiled import kernel

NUMERICAL = 1e-6
"""Relative error of the fast solver's base moment, the lower bound of a reading's standard deviation."""
NEGLIGIBLE = 1e-2
"""Fraction of the moment's standard deviation below which this error is neglected."""


WRENCH, WEIGHT, CHI2, SIZE, SENSOR, WHITEN, OBSERVATION_SIZE = 0, 6, 9, 10, 11, 12, 48
"""Offsets of the mean wrench (6), the flexible part's weight (3), the misfit of the free probe, the size of the moment,
the misfit of a sensor that reads zero, and the mean's whitening (6, 6); and the size of all."""


@kernel
def observe(window, gravity, free, mass, sensor_from_base, payload, limit, whiten, std, row):
    """Evaluate a window of readings.

    Args:
        window: base wrenches, (n, 6).
        gravity: base axes [m/s²], (3,).
        free: the free probe's wrench, (6,).
        mass: of the flexible part [kg].
        sensor_from_base: map of wrenches, (6, 6); payload: its wrench on the sensor, by gravity, (6, 3).
        limit: saturation limit of each channel, (6,).
        whiten: of one reading, lower triangular, (6, 6).
        std: standard deviation of each channel of one reading [N, N·m], (6,).
        row: filled, (OBSERVATION_SIZE,).

    Returns:
        Whether all of them are finite and below the saturation limit.
    """
    n = window.shape[0]
    for i in range(6):
        row[WRENCH + i] = 0.0
    for k in range(n):
        for i in range(6):
            reading = 0.0
            for j in range(6):
                reading += sensor_from_base[i, j] * window[k, j]
            for j in range(3):
                reading += payload[i, j] * gravity[j]
            if not abs(reading) <= limit[i] or not math.isfinite(window[k, i]):
                return False
            row[WRENCH + i] += window[k, i] / n
    for q in range(3):
        row[WEIGHT + q] = mass * gravity[q]
    root, chi2, sensor_chi2 = math.sqrt(n), 0.0, 0.0
    for i in range(6):
        reading = 0.0
        for j in range(6):
            reading += sensor_from_base[i, j] * row[WRENCH + j]
        for j in range(3):
            reading += payload[i, j] * gravity[j]
        sensor_chi2 += n * (reading / std[i]) ** 2
        off = 0.0
        for j in range(6):
            row[WHITEN + 6 * i + j] = root * whiten[i, j]
            off += root * whiten[i, j] * (row[WRENCH + j] - free[j])
        chi2 += off * off
    row[CHI2], row[SENSOR] = chi2, sensor_chi2
    row[SIZE] = math.sqrt(row[WRENCH + 3] ** 2 + row[WRENCH + 4] ** 2 + row[WRENCH + 5] ** 2)
    return True


def covariance(model: ProbeModel, wrench: Array, readings: int = 1) -> Array:
    """Return the covariance of the mean of so many independent readings near a wrench (6,), with the solver's own
    error, (6, 6)."""
    cov = model._noise_base / readings
    moment = wrench[3:]
    numerical = NUMERICAL**2 * float(moment @ moment)
    if numerical > (NEGLIGIBLE * model.noise.moment) ** 2 / readings:
        cov[[3, 4, 5], [3, 4, 5]] += numerical
    return cov


@dataclass(frozen=True)
class Observation:
    """A base wrench with its covariance.

    Attributes:
        wrench: [N, N·m], (6,).
        whiten: lower triangular, with whitenᵀ whiten the inverse of its covariance, (6, 6).
        gravity: base axes [m/s²], (3,).
        weight: of the flexible part [N], (3,).
        chi2: how far it is from the free probe's, six degrees of freedom.
        sensor_chi2: how far the sensor's own reading is from zero, six degrees of freedom.
    """

    wrench: Array
    whiten: Array
    gravity: Array
    weight: Array
    chi2: float
    sensor_chi2: float = math.inf

    @classmethod
    def of(cls, model: ProbeModel, window: Array, gravity: Array, free: Array) -> "Observation | None":
        """Return the mean of independent readings, each with the model's noise; None if one is out of range.

        Args:
            model: the probe.
            window: base wrenches, (n, 6).
            gravity: base axes [m/s²], (3,).
            free: the free probe's wrench under it, (6,).
        """
        row = np.empty(OBSERVATION_SIZE)
        if not observe(
            window,
            gravity,
            free,
            model.mass,
            *model.observation_map,
            model.noise.std,
            row,
        ):
            return None
        whiten, readings = row[WHITEN:].reshape(6, 6), len(window)
        numerical, chi2 = NUMERICAL * float(row[SIZE]), float(row[CHI2])
        if numerical > NEGLIGIBLE * model.noise.moment / math.sqrt(readings):
            whiten = np.linalg.inv(np.linalg.cholesky(covariance(model, row[:WEIGHT], readings)))
        return cls(row[:WEIGHT], whiten, gravity, row[WEIGHT:CHI2], chi2, float(row[SENSOR]))

    @property
    def cov(self) -> Array:
        """Return the covariance of the wrench, (6, 6)."""
        coloured = np.linalg.inv(self.whiten)
        return np.asarray(coloured @ coloured.T, dtype=float)

    @property
    def force(self) -> Array:
        """Return the force of the contact by the paper's equation 5 [N], (3,)."""
        return self.wrench[0:3] - self.weight
