"""Loads of the paper's large probe, and random rods and loads."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from probedesign.core.frames import Array
from probedesign.design import load_design
from probedesign.probe import build_probe
from probedesign.rod.kernels.equations import LOAD
from probedesign.rod.rod import Rod

LARGE = Path(__file__).parents[1] / "designs/large.toml"
GRAVITY = np.array([9.81, 0.0, 0.0])
#: Force [N] and place over the length of four of the paper's tests of the large probe.
TABLE_I = ((0.25, 0.133), (0.103, 0.4), (0.032, 0.533), (0.006, 0.8))

#: Ranges of length [m], base diameter [m], tip over base diameter and Young's modulus [Pa] of random probes.
LENGTH, BASE, TAPER, MODULUS = (0.03, 0.2), (0.002, 0.02), (0.1, 1.0), (3e5, 1e7)
DENSITY, SHEAR = 1100.0, 1.0 / 2.98  #: Density [kg/m³] and G/E of random probes.
CONTACT, AT_TIP = 0.02, 0.3  #: Smallest contact place over the length, and share of contacts at the tip.
MAX_BEND = 1.5  #: Largest F s²/(E I(0) r(s)/r(0)) of random loads; it rotates the tip by about 120°.


class Load(NamedTuple):
    """Force in base axes [N] and its arclength [m]; the force is across gravity, so that the probe bends in 3-D."""

    force: Array
    s: float


class Cases(NamedTuple):
    """Arguments of `solve_batch`: rods, index of the rod, gravity, force and s_contact of each case."""

    rods: Sequence[Rod]
    which: np.ndarray[tuple[int], np.dtype[np.int64]]
    gravity: Array
    force: Array
    s_contact: Array

    @property
    def loads(self) -> Array:
        """Loads in the layout of the kernels, (n, LOAD)."""
        loads = np.zeros((len(self.which), LOAD))
        loads[:, 0:3], loads[:, 3:6], loads[:, 12] = self.force, self.gravity, self.s_contact
        return loads


def bare_large() -> Rod:
    """Return the large probe clamped at s = 0 without a rigid root, so that all solvers solve the same equations."""
    rod = build_probe(load_design(LARGE)).rod
    return Rod(rod.s, rod.radius, rod.youngs_modulus, rod.shear_modulus, rod.density, rod.shear_coefficient)


def paper_loads(rod: Rod) -> list[Load]:
    """Return the loads for the comparison of the solvers."""
    return [Load(np.array([0.0, force, 0.0]), fraction * rod.length) for force, fraction in TABLE_I]


def random_cases(n: int, seed: int = 1) -> Cases:
    """Return n random cases, each with its own cone."""
    rng = np.random.default_rng(seed)
    length, radius = rng.uniform(*LENGTH, n), rng.uniform(*BASE, n) / 2.0
    taper, E = rng.uniform(*TAPER, n), np.exp(rng.uniform(*np.log(MODULUS), n))
    rods = [
        Rod(np.array([0.0, L]), np.array([r, k * r]), e, e * SHEAR, DENSITY)
        for L, r, k, e in zip(length, radius, taper, E, strict=True)
    ]
    return _loaded(rods, np.arange(n), rng)


def random_loads(rod: Rod, n: int, seed: int = 2) -> Cases:
    """Return n random loads of one rod."""
    return _loaded([rod], np.zeros(n, dtype=np.int64), np.random.default_rng(seed))


def _loaded(rods: Sequence[Rod], which: Array, rng: np.random.Generator) -> Cases:
    """Draw gravity, force and contact for rods."""
    n = len(which)
    length, r0, r1, E = (
        np.array(values)[which]
        for values in zip(
            *((rod.length, rod.radius[0], rod.radius[-1], rod.youngs_modulus) for rod in rods), strict=True
        )
    )
    s = np.where(rng.uniform(size=n) < AT_TIP, 1.0, rng.uniform(CONTACT, 1.0, n)) * length
    stiffness = E * np.pi / 4.0 * r0**3 * (r0 + (r1 - r0) * s / length)
    force = rng.uniform(0.0, MAX_BEND, n) * stiffness / s**2
    return Cases(rods, which, 9.81 * random_directions(n, rng), force[:, None] * random_directions(n, rng), s)


def random_directions(n: int, rng: np.random.Generator) -> Array:
    """Draw n unit vectors, (n, 3)."""
    v = rng.normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1)[:, None]
