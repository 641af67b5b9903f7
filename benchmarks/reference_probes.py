"""Probes, mounts and sensors drawn from the priors of an estimate, with their true and their measured wrenches.

A sample is a row z of independent standard normals, one or more for each error source of `Tolerances`; `Perturbations`
assigns the columns of z to the sources. The samples are solved by the reference rod of `tests/reference`. Nothing here
uses `probedesign.estimation` or `probedesign.prediction` except for the definitions of model and tolerances, because
the benchmarks test these packages with it.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from probedesign.core.frames import Array, inverse, wrench_map
from probedesign.core.units import MM
from probedesign.estimation.model import ProbeModel, Tolerances
from probedesign.rod.rod import Rod
from tests.reference.cosserat import Touches, solve
from tests.reference.round_rods import Probes

#: Error sources and the fields of `Tolerances` that state their standard deviations.
SOURCES = {
    "E": ("youngs_modulus",),
    "G": ("shear_modulus",),
    "density": ("density",),
    "diameter": ("diameter_mm", "diameter_share"),
    "diameter scatter": ("diameter_scatter_mm",),
    "length": ("length_mm", "length_share"),
    "bow": ("bow_mm",),
    "root": ("root_radii",),
    "base place": ("base_mm",),
    "base tilt": ("tilt_deg",),
    "clocking": ("clocking_deg",),
    "gravity": ("gravity_deg",),
    "gain": ("gain",),
    "drift": ("drift_steps",),
    "creep": ("creep",),
    "stiffness scatter": ("stiffness_scatter",),
    "robot": ("robot_mm",),
    "object": ("object_compliance",),
    "object walk": ("object_walk_mm",),
}
#: Sources that neither the reading nor the touched point in base axes depends on; a single touch has none of them.
PRESS_SOURCES = ("robot", "object", "object walk")


@dataclass(frozen=True)
class PriorStds:
    """Standard deviations of the error sources."""

    by_name: dict[str, float]  #: standard deviation by field of `Tolerances`, in the unit of the field.

    @classmethod
    def of(cls, model: ProbeModel) -> "PriorStds":
        """Return the standard deviations that the design of a probe states."""
        stated = Tolerances.of(model)
        return cls({name: float(getattr(stated, name)) for names in SOURCES.values() for name in names})

    def only(self, sources: tuple[str, ...]) -> "PriorStds":
        """Return a copy in which all sources but the given ones are zero."""
        kept = {name for source in sources for name in SOURCES[source]}
        return PriorStds({name: value if name in kept else 0.0 for name, value in self.by_name.items()})

    def scaled(self, factor: float) -> "PriorStds":
        """Return a copy with all standard deviations multiplied by a factor."""
        return PriorStds({name: factor * value for name, value in self.by_name.items()})

    def tolerances(self) -> Tolerances:
        """Return the tolerances to give to the estimator."""
        fields: dict[str, Any] = self.by_name
        # The bias of the samples is a random walk with steps of drift_steps from touch to touch.
        return replace(Tolerances.none(), tared=True, walk_steps=self.by_name["drift_steps"], **fields)

    def __getitem__(self, name: str) -> float:
        return self.by_name[name]


def _corners(rod: Rod) -> Array:
    """Return the knots at the ends and corners of the flank: the other ones are those of a curved axis."""
    slope = np.diff(rod.radius) / np.diff(rod.s)
    return np.flatnonzero(np.r_[True, ~np.isclose(slope[1:], slope[:-1], rtol=1e-6, atol=0.0), True])


@dataclass(frozen=True)
class Perturbations:
    """Assignment of the columns of z, independent standard normals, to the error sources."""

    model: ProbeModel  #: model of the probe as designed.
    priors: PriorStds  #: standard deviations that z is multiplied by.
    touches: int = 1  #: number of touches of each sample.
    slots: dict[str, slice] = field(default_factory=dict)  #: columns of z by error source.
    size: int = 0  #: number of columns.

    @classmethod
    def of(cls, model: ProbeModel, priors: PriorStds, touches: int = 1) -> "Perturbations":
        """Assign columns to all sources with a standard deviation above zero."""
        counts = {"E": 1, "G": 1, "density": 1, "diameter": 1, "diameter scatter": len(_corners(model.rod)),
                  "length": 1, "bow": 2, "root": 1, "base place": 3, "base tilt": 2, "clocking": 1, "gravity": 2,
                  "gain": 6, "drift": 6 * touches, "creep": 1, "stiffness scatter": touches}  # fmt: skip
        if touches > 1:
            counts |= {"robot": 3 * touches, "object": 1, "object walk": 3 * (touches - 1)}
        slots, size = {}, 0
        for source, names in SOURCES.items():
            if source in counts and any(priors[name] > 0.0 for name in names):
                slots[source] = slice(size, size + counts[source])
                size += counts[source]
        return cls(model, priors, touches, slots, size)

    @cached_property
    def nominal_free(self) -> Array:
        """The base wrench of the free probe as designed, (6,)."""
        return solve(Probes.of(self.model.rod), self.model.gravity_base, loads=3).wrench[0]

    def draw(self, n: int, rng: np.random.Generator) -> Array:
        """Draw n rows of z, (n, size)."""
        return rng.normal(size=(n, self.size))

    def fix(self, z: Array, source: str, size: Array, rng: np.random.Generator) -> None:
        """Give one source a size in the unit of its standard deviation, (n,), in a random direction of its columns."""
        part = z[:, self.slots[source]]
        direction = rng.normal(size=part.shape)
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        part[:] = (size / self.priors[SOURCES[source][0]])[:, None] * direction

    def affecting_reading(self, k: int) -> list[int]:
        """Return the columns of z that the reading or the touched point of touch k depends on."""
        columns = []
        for source, slot in self.slots.items():
            every = range(slot.start, slot.stop)
            if source == "drift":
                columns += every[: 6 * (k + 1)]
            elif source == "stiffness scatter":
                columns.append(every[k])
            elif source not in PRESS_SOURCES:
                columns += every
        return columns

    def affecting_shape(self, k: int) -> list[int]:
        """Return the columns of `affecting_reading` that the shape of the bent probe depends on."""
        other = {j for name in ("drift", "gain", "base place") if name in self.slots
                 for j in range(self.slots[name].start, self.slots[name].stop)}  # fmt: skip
        return [j for j in self.affecting_reading(k) if j not in other]

    def deviations(self, z: Array, source: str, name: str, count: int) -> Array:
        """Return the deviations of one tolerance, (n, count); zero where the source has no columns."""
        slot = self.slots.get(source)
        return np.zeros((len(z), count)) if slot is None else self.priors[name] * z[:, slot]

    def samples(self, z: Array) -> "ProbeSamples":
        """Return the true probes, mounts and sensors for given perturbations, (n, size)."""
        rod, n, K, k = self.model.rod, len(z), len(self.model.rod.s), self.touches
        p, diameters = self.priors, 2.0 * rod.radius / MM

        def one(source: str, name: str) -> Array:
            return self.deviations(z, source, name, 1)[:, 0]

        common = np.maximum(p["diameter_mm"], p["diameter_share"] * diameters) / diameters
        slot = self.slots.get("diameter")
        scale = np.zeros((n, K)) if slot is None else z[:, slot] * common
        corners = _corners(rod)
        each = self.deviations(z, "diameter scatter", "diameter_scatter_mm", len(corners))
        scatter = np.array([np.interp(rod.s, rod.s[corners], row) for row in each])
        radius = rod.radius * np.exp(scale + scatter / diameters)
        slot = self.slots.get("length")
        length = max(p["length_mm"], p["length_share"] * rod.length / MM) * MM / rod.length
        length_factor = np.ones(n) if slot is None else np.exp(length * z[:, slot][:, 0])
        creep = one("creep", "creep")
        E_factor = np.exp(one("E", "youngs_modulus"))
        if k == 1:
            E_factor = E_factor * np.exp(creep)
        G_factor = np.exp(one("G", "shear_modulus")) * (np.exp(creep) if k == 1 else 1.0)
        missing = radius[:, 0] * (rod.rigid_length / rod.radius[0] + one("root", "root_radii"))
        probes = Probes(
            rod.s[:, None] * length_factor, radius.T, rod.youngs_modulus * E_factor, rod.shear_modulus * G_factor,
            rod.density * np.exp(one("density", "density")), np.full(n, rod.shear_coefficient), missing,
            np.full(n, float(rod.finite_strain)), np.full(n, rod.flatness), self._curvature(z),
        )  # fmt: skip
        # With several touches, the material has not crept at the first and has crept fully at the last.
        creeps = np.zeros((n, k)) if k == 1 else creep[:, None] * np.linspace(0.0, 1.0, k)
        stiffness = np.exp(creeps + self.deviations(z, "stiffness scatter", "stiffness_scatter", k))
        rotation = np.deg2rad(np.hstack([self.deviations(z, "base tilt", "tilt_deg", 2),
                                         self.deviations(z, "clocking", "clocking_deg", 1)]))  # fmt: skip
        R = Rotation.from_rotvec(rotation).as_matrix()
        return ProbeSamples(
            self, probes, stiffness, R, MM * self.deviations(z, "base place", "base_mm", 3), self._gravity(z, R),
            self.deviations(z, "gain", "gain", 6), self._drift(z),
            MM * self.deviations(z, "robot", "robot_mm", 3 * k).reshape(n, k, 3),
            np.abs(one("object", "object_compliance")),
            MM * self.deviations(z, "object walk", "object_walk_mm", 3 * (k - 1)).reshape(n, k - 1, 3),
        )  # fmt: skip

    def _curvature(self, z: Array) -> Array:
        """Return the curvature at rest about the section's axes [1/m], (K, 3, n): the tip is κ L²/2 off x and y."""
        rod = self.model.rod
        towards = self.deviations(z, "bow", "bow_mm", 2) * MM * 2.0 / rod.length**2
        bent = np.zeros((len(rod.s), 3, len(z)))
        bent[:, 0], bent[:, 1] = -towards[:, 1], towards[:, 0]
        return bent if rod.rest_curvature is None else bent + np.asarray(rod.rest_curvature)[:, :, None]

    def _gravity(self, z: Array, R: Array) -> Array:
        """Return gravity in the axes of the true bases [m/s²], (n, 3)."""
        g = np.asarray(self.model.gravity_base, dtype=float)
        across = np.linalg.svd(g[None])[2][1:] if g.any() else np.zeros((2, 3))
        error = np.deg2rad(self.deviations(z, "gravity", "gravity_deg", 2)) @ across * np.linalg.norm(g)
        return np.einsum("nji,nj->ni", R, g + error)

    def _drift(self, z: Array) -> Array:
        """Return the bias since the tare, a random walk over the touches, at the sensor's origin, (n, k, 6)."""
        noise = np.sqrt(np.diag(self.model.noise.cov) * self.model.averaging_samples)
        steps = self.deviations(z, "drift", "drift_steps", 6 * self.touches).reshape(len(z), self.touches, 6)
        return np.cumsum(steps, axis=1) * noise


@dataclass(frozen=True)
class ProbeSamples:
    """n true probes with their mounts and sensors, for k touches each."""

    perturbations: Perturbations  #: that they were computed from.
    probes: Probes  #: rods as printed and mounted.
    stiffness: Array  #: factor on E and G at each touch, (n, k).
    #: R, shift: rotation and displacement of the true bases in the model's base frame, (n, 3, 3) and [m], (n, 3).
    R: Array
    shift: Array
    gravity: Array  #: in the axes of the true bases [m/s²], (n, 3).
    gain: Array  #: relative gain error of each channel, (n, 6).
    drift: Array  #: bias at the sensor's origin [N, N·m], (n, k, 6).
    robot: Array  #: position error of the base at each touch [m], (n, k, 3).
    compliance: Array  #: of the touched object [m/N], (n,).
    walk: Array  #: steps of the object between the touches [m], (n, k - 1, 3).

    def at_touch(self, k: int) -> Probes:
        """Return the rods with their stiffness at touch k."""
        factor = self.stiffness[:, k]
        return replace(self.probes, E=self.probes.E * factor, G=self.probes.G * factor)

    @cached_property
    def free_touches(self) -> Touches:
        """The true probes without contact, as touches of zero force."""
        return solve(self.probes, self.gravity, loads=3)

    def free_wrench(self) -> Array:
        """Return the base wrench of the true probes without contact in the axes of the true bases, (n, 6)."""
        return self.free_touches.wrench

    def in_nominal_frame(self, wrench: Array) -> Array:
        """Transform wrenches from the true bases to the model's base frame, (n, 6)."""
        force, moment = (np.einsum("nij,nj->ni", self.R, part) for part in (wrench[:, :3], wrench[:, 3:]))
        return np.hstack([force, moment + np.cross(self.shift, force)])

    def point_in_nominal_frame(self, point: Array) -> Array:
        """Transform points from the true bases to the model's base frame [m], (n, 3)."""
        return np.einsum("nij,nj->ni", self.R, point) + self.shift

    def reading(self, touched: Array, free: Array, k: int, nominal_free: Array) -> Array:
        """Return the reading of touch k without noise, about the model's base, (n, 6).

        The tare sets the reading of the free probe to the wrench of the model; the gain errors of the channels act on
        the change since then.

        Args:
            touched, free: wrenches with and without contact in the axes of the true bases, (n, 6).
            k: index of the touch.
            nominal_free: wrench of the model's free probe, (6,).
        """
        T = self.perturbations.model.T_sensor_base
        to_sensor, to_base = wrench_map(T), wrench_map(inverse(T))
        added = (self.in_nominal_frame(touched) - self.in_nominal_frame(free)) @ to_sensor.T
        return nominal_free + ((1.0 + self.gain) * added + self.drift[:, k]) @ to_base.T
