"""The probe on scales: what its mass says of density and diameters."""

from dataclasses import dataclass

import numpy as np

from probedesign.identification.guess import Guess
from probedesign.identification.parameters import PRINT
from probedesign.identification.residuals import Group


@dataclass(frozen=True)
class Weighed:
    """A weighing.

    Attributes:
        mass: read [kg].
        std: of it [kg].
        flange_volume: that was on the scales beside the flexible part, as drawn [m³].
    """

    mass: float
    std: float
    flange_volume: float

    def group(self, guess: Guess) -> Group:
        """Its misfit."""
        rod = guess.rod
        soft = rod.mass
        whole = soft + rod.density * self.flange_volume
        J = np.zeros((1, guess.shared.size))
        J[0, 2], J[0, 3] = whole, 2.0 * soft
        J[0, PRINT:] = rod.density * rod.body.volume_by_knot[0] @ guess.shared.print_rows.T
        off = np.array([self.mass - whole])
        return Group("", "scales", 0, off / self.std, -J / self.std, np.zeros((1, 0)), off)
