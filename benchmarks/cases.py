"""What is solved: the paper's large probe under loads of the paper, and cases drawn at random."""

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
TABLE_I = ((0.25, 0.133), (0.103, 0.4), (0.032, 0.533), (0.006, 0.8))
"""Force [N] and place over L of four of the paper's tests on the large probe."""

LENGTH, BASE, TAPER, MODULUS = (0.03, 0.2), (0.002, 0.02), (0.1, 1.0), (3e5, 1e7)
"""Length and base diameter [m], tip over base, Young's modulus [Pa] of random probes, least and most."""
DENSITY, SHEAR = 1100.0, 1.0 / 2.98
"""[kg/m³]; G over E."""
CONTACT, AT_TIP = 0.02, 0.3
"""Nearest contact over L; share of contacts at the very tip."""
STRONGEST = 1.5
"""F s²/(E I(0) r(s)/r(0)), up to which forces are drawn: tips turn by up to some 120°."""


class Load(NamedTuple):
    """One case: sideways to gravity, so that the probe bends in three dimensions."""

    force: Array
    s: float


class Cases(NamedTuple):
    """Many of them, as `solve_batch` takes them: rods, the rod of each case, gravity, force, s_contact."""

    rods: Sequence[Rod]
    which: np.ndarray[tuple[int], np.dtype[np.int64]]
    gravity: Array
    force: Array
    s_contact: Array

    @property
    def loads(self) -> Array:
        """As the kernels take them, (n, LOAD)."""
        loads = np.zeros((len(self.which), LOAD))
        loads[:, 0:3], loads[:, 3:6], loads[:, 12] = self.force, self.gravity, self.s_contact
        return loads


def bare_large() -> Rod:
    """The paper's rod: clamped at s = 0 without a rigid root, so that all methods solve the same equations."""
    rod = build_probe(load_design(LARGE)).rod
    return Rod(rod.s, rod.radius, rod.youngs_modulus, rod.shear_modulus, rod.density, rod.shear_coefficient)


def paper_loads(rod: Rod) -> list[Load]:
    """The cases that all methods are compared on."""
    return [Load(np.array([0.0, force, 0.0]), fraction * rod.length) for force, fraction in TABLE_I]


def random_cases(n: int, seed: int = 1) -> Cases:
    """n cases of the working envelope, each with a cone of its own."""
    rng = np.random.default_rng(seed)
    length, radius = rng.uniform(*LENGTH, n), rng.uniform(*BASE, n) / 2.0
    taper, E = rng.uniform(*TAPER, n), np.exp(rng.uniform(*np.log(MODULUS), n))
    rods = [
        Rod(np.array([0.0, L]), np.array([r, k * r]), e, e * SHEAR, DENSITY)
        for L, r, k, e in zip(length, radius, taper, E, strict=True)
    ]
    return _loaded(rods, np.arange(n), rng)


def random_loads(rod: Rod, n: int, seed: int = 2) -> Cases:
    """n loads of one rod."""
    return _loaded([rod], np.zeros(n, dtype=np.int64), np.random.default_rng(seed))


def _loaded(rods: Sequence[Rod], which: Array, rng: np.random.Generator) -> Cases:
    """The rods with gravity, force and contact drawn at random."""
    n = len(which)
    length, r0, r1, E = (
        np.array(values)[which]
        for values in zip(
            *((rod.length, rod.radius[0], rod.radius[-1], rod.youngs_modulus) for rod in rods), strict=True
        )
    )
    s = np.where(rng.uniform(size=n) < AT_TIP, 1.0, rng.uniform(CONTACT, 1.0, n)) * length
    stiffness = E * np.pi / 4.0 * r0**3 * (r0 + (r1 - r0) * s / length)
    force = rng.uniform(0.0, STRONGEST, n) * stiffness / s**2
    return Cases(rods, which, 9.81 * _directions(n, rng), force[:, None] * _directions(n, rng), s)


def _directions(n: int, rng: np.random.Generator) -> Array:
    v = rng.normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1)[:, None]
