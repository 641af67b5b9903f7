"""What a covariance looks like."""

import numpy as np

from probedesign.frames import Array

RADIUS_95 = 2.7955
"""Standard deviations within which a point of three dimensions lies 95 times in 100: √ of that quantile of χ² of three
degrees of freedom."""


def ellipsoid(cov: Array) -> tuple[Array, Array]:
    """Half-axes of the 95 % ellipsoid [m], (3,), and their directions as the columns of a rotation, (3, 3)."""
    variances, axes = np.linalg.eigh(cov)
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] = -axes[:, 0]
    half_axes: Array = RADIUS_95 * np.sqrt(np.maximum(variances, 0.0))
    return half_axes, axes
