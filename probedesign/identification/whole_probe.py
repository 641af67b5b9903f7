"""Measurements that belong to no test, as residuals: the weighing of the probe, and the prior on Poisson's ratio."""

from dataclasses import dataclass

import numpy as np

from probedesign.identification.parameters import PARAMETERS, POISSON, POISSON_STD, ParameterValues
from probedesign.identification.residuals import ResidualBlock


@dataclass(frozen=True)
class MassMeasurement:
    """A weighing of the probe."""

    mass: float  #: measured [kg].
    std: float  #: standard deviation of the mass [kg].
    flange_volume: float  #: of printed material that was weighed with the flexible part, as drawn [m³].

    def block(self, values: ParameterValues) -> ResidualBlock:
        """Return its residual, which depends on the density and on all diameters."""
        rod = values.rod
        total = rod.mass + rod.density * self.flange_volume
        J = np.zeros((1, values.common.size))
        J[0, PARAMETERS["density"].columns] = total
        J[0, PARAMETERS["diameters"].columns] = 2.0 * rod.mass
        J[0, values.common.print_columns] = rod.density * rod.body.volume_by_knot[0] @ values.common.print_modes.T
        residual = np.array([self.mass - total])
        return ResidualBlock("", "scales", 0, residual / self.std, -J / self.std, np.zeros((1, 0)), residual)


@dataclass(frozen=True)
class PoissonPrior:
    """Prior on Poisson's ratio, which ties G to E: E = 2 (1 + ν) G."""

    def block(self, values: ParameterValues) -> ResidualBlock:
        """Return its residual."""
        rod = values.rod
        std = POISSON_STD / (1.0 + POISSON)  # of the logarithm of E/G
        J = np.zeros((1, values.common.size))
        J[0, PARAMETERS["E"].columns], J[0, PARAMETERS["G"].columns] = 1.0, -1.0
        ratio = np.log(rod.youngs_modulus / rod.shear_modulus)
        residual = np.array([np.log(2.0 * (1.0 + POISSON)) - ratio])
        return ResidualBlock("", "poisson", 0, residual / std, -J / std, np.zeros((1, 0)), residual)
