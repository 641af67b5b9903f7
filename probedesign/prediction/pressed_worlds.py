"""Points touched several times in worlds that differ from the model, fused by the real estimator: for Monte Carlo."""

from dataclasses import dataclass, replace

import numpy as np

from probedesign.estimation.estimator import Estimator
from probedesign.estimation.fused import Fused
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.frames import Array, pose
from probedesign.prediction.pressing import Pressing, unknowns_of
from probedesign.prediction.standing import surface_of
from probedesign.prediction.worlds import Worlds
from probedesign.units import MM

_CREEP = 1  # told apart from what else the seed draws


@dataclass(frozen=True)
class Series:
    """Touches of one point in n worlds, free of noise.

    Attributes:
        wrenches: as read, told at the model's base, (n, k, 6).
        places: of the bases as the robot would tell them, the touched point being the world's origin [m], (n, k, 3).
        points: of the centreline, the mean over the touches, in the world [m], (n, 3).
    """

    wrenches: Array
    places: Array
    points: Array


@dataclass(frozen=True)
class PressedWorlds:
    """Worlds whose probes relax while they are pressed.

    Attributes:
        worlds: before that.
        creep: of log stiffness at the last touch, (n,).
        pressing: how the touches are made.
    """

    worlds: Worlds
    creep: Array
    pressing: Pressing

    @classmethod
    def draw(
        cls, model: ProbeModel, tolerances: Tolerances, pressing: Pressing, n: int, seed: int
    ) -> "PressedWorlds":
        """Draw them, the same for the same seed, and the same as those of single touches but for the creep."""
        worlds = Worlds.draw(model, replace(tolerances, creep=0.0), n, seed)
        z = np.random.default_rng([seed, _CREEP]).normal(size=n)
        return cls(worlds, tolerances.creep * z, pressing)

    def touched(self, fraction: float, force_N: float, direction: str) -> Series:
        """One point, pressed on at the same place of every probe; NaN where one gives way."""
        wrenches, places, offsets = list[Array](), list[Array](), list[Array]()
        for share, force in zip(self.pressing.ramp, self.pressing.forces(force_N), strict=True):
            worlds = self._relaxed(share)
            contacts = worlds.contacts(fraction, force, direction)
            told = worlds.told_point(surface_of(worlds.rods.rods, contacts))
            wrenches.append(worlds.told(contacts.batch.wrench_base) + worlds.off)
            places.append(-told)
            offsets.append(worlds.told_point(contacts.batch.p_contact_base) - told)
        return Series(np.stack(wrenches, 1), np.stack(places, 1), np.mean(offsets, axis=0))

    def noise(self, rng: np.random.Generator) -> Array:
        """Of all readings, with the bias as it walks from touch to touch, (n, k, 6)."""
        worlds, n, k = self.worlds, len(self.worlds.rods), self.pressing.touches
        root = np.linalg.cholesky(worlds.model.noise_base())
        step = worlds.tolerances.drift_steps * worlds.model.averaging_samples**0.5
        walked = step * np.cumsum(rng.normal(size=(n, k, 6)), axis=1)
        return np.asarray((rng.normal(size=(n, k, 6)) + walked) @ root.T)

    def robot(self, rng: np.random.Generator) -> Array:
        """How far it tells each base amiss [m], (n, k, 3)."""
        shape = (len(self.worlds.rods), self.pressing.touches, 3)
        return np.asarray(rng.normal(0.0, self.worlds.tolerances.robot_mm * MM, shape))

    def _relaxed(self, share: float) -> Worlds:
        """What the touch adds relaxes; what hangs has done so before the tare."""
        factors = np.exp(share * self.creep).tolist()
        rods = [replace(rod, youngs_modulus=f * rod.youngs_modulus, shear_modulus=f * rod.shear_modulus,
                        density=f * rod.density) for rod, f in zip(self.worlds.rods, factors, strict=True)]  # fmt: skip
        return self.worlds.of_rods(rods)


def fuse(
    estimator: Estimator, tolerances: Tolerances, pressing: Pressing, wrenches: Array, places: Array
) -> Fused:
    """What the estimator makes of one point's readings, told of what is not known.

    Args:
        wrenches: (k, 6); places: of the bases [m], (k, 3).
    """
    return estimator.fuse(
        wrenches, [pose(p=place) for place in places], estimator.model.gravity_base,
        moments_only=pressing.moments_about is not None, moments_about=pressing.moments_about or "base",
        unknowns=unknowns_of(estimator.model, tolerances),
    )  # fmt: skip
