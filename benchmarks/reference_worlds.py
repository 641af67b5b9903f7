"""Probes, mounts, sensors and touches drawn from the priors, read by the reference rod of `tests/reference`.

A world is a row z of standard normals, one for each error source of `Tolerances`; `Sources` names them. Everything here
is written anew, apart from `probedesign.estimation` and `probedesign.prediction`, which it is meant to judge.
"""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from probedesign.core.frames import Array, inverse, wrench_map
from probedesign.core.units import MM
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from tests.reference.cosserat import Touches, differences, press, solve
from tests.reference.round_rods import Probes

FIELDS = {
    "E": ("youngs_modulus",),
    "G": ("shear_modulus",),
    "density": ("density",),
    "diameter": ("diameter_mm", "diameter_share"),
    "diameter scatter": ("diameter_scatter_mm",),
    "length": ("length_mm", "length_share"),
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
}
"""Error sources and the tolerances that state them."""
NEW = {"root_radii": 0.15, "gain": 0.005, "stiffness_scatter": 0.01}
"""Tolerances that older versions of the package lack, with their defaults; then only the worlds have them."""
SMALL = 0.05
"""Step of the columns, in standard deviations."""


@dataclass(frozen=True)
class Priors:
    """Standard deviations by name, as `Tolerances` has them, and of those it may lack.

    Attributes:
        by_name: value of each tolerance.
    """

    by_name: dict[str, float]

    @classmethod
    def of(cls, model: ProbeModel) -> "Priors":
        """Return the priors that the design of a probe states."""
        stated = Tolerances.of(model)
        names = [name for source in FIELDS.values() for name in source]
        return cls({name: float(getattr(stated, name, NEW.get(name, 0.0))) for name in names})

    def only(self, sources: tuple[str, ...]) -> "Priors":
        """Return the same with these error sources alone."""
        kept = {name for source in sources for name in FIELDS[source]}
        return Priors({name: value if name in kept else 0.0 for name, value in self.by_name.items()})

    def times(self, factor: float) -> "Priors":
        """Return the same with every standard deviation so many times as large."""
        return Priors({name: factor * value for name, value in self.by_name.items()})

    def tolerances(self) -> Tolerances:
        """Return them as the estimator takes them, as far as it knows them."""
        known: dict[str, Any] = {name: value for name, value in self.by_name.items()
                                 if name in Tolerances.__dataclass_fields__}  # fmt: skip
        # The bias of these worlds walks by drift_steps from touch to touch.
        return replace(Tolerances.none(), tared=True, walk_steps=self.by_name["drift_steps"], **known)

    def __getitem__(self, name: str) -> float:
        return self.by_name[name]


@dataclass(frozen=True)
class Sources:
    """The standard normals of a world and what each is of.

    Attributes:
        model: of the probe as designed.
        priors: which it is drawn from.
        touches: how many touches a world has.
        slots: columns of z by error source.
        size: of z.
    """

    model: ProbeModel
    priors: Priors
    touches: int = 1
    slots: dict[str, slice] = field(default_factory=dict)
    size: int = 0

    @classmethod
    def of(cls, model: ProbeModel, priors: Priors, touches: int = 1) -> "Sources":
        """Number the normals of all sources that are not zero."""
        counts = {"E": 1, "G": 1, "density": 1, "diameter": 1, "diameter scatter": len(model.rod.s), "length": 1,
                  "root": 1, "base place": 3, "base tilt": 2, "clocking": 1, "gravity": 2, "gain": 6,
                  "drift": 6 * touches, "creep": 1, "stiffness scatter": touches,
                  "robot": 3 * touches if touches > 1 else 0}  # fmt: skip
        slots, size = {}, 0
        for source, names in FIELDS.items():
            if counts[source] and any(priors[name] > 0.0 for name in names):
                slots[source] = slice(size, size + counts[source])
                size += counts[source]
        return cls(model, priors, touches, slots, size)

    def draw(self, n: int, rng: np.random.Generator) -> Array:
        """Draw n worlds, (n, size)."""
        return rng.normal(size=(n, self.size))

    def seen(self, k: int) -> list[int]:
        """Return the normals that reading k or its point depends on."""
        found = []
        for source, slot in self.slots.items():
            every = range(slot.start, slot.stop)
            if source == "drift":
                found += every[: 6 * (k + 1)]
            elif source == "stiffness scatter":
                found.append(every[k])
            elif source != "robot":
                found += every
        return found

    def bending(self, k: int) -> list[int]:
        """Return those of them that change how the probe is bent."""
        other = {j for name in ("drift", "gain", "base place") if name in self.slots
                 for j in range(self.slots[name].start, self.slots[name].stop)}  # fmt: skip
        return [j for j in self.seen(k) if j not in other]

    def value(self, z: Array, source: str, name: str, count: int) -> Array:
        """Return the deviations of one tolerance, (n, count); zero where the source is absent."""
        slot = self.slots.get(source)
        return np.zeros((len(z), count)) if slot is None else self.priors[name] * z[:, slot]

    def worlds(self, z: Array) -> "Worlds":
        """Return what is true in the worlds z, (n, size)."""
        rod, n, K, k = self.model.rod, len(z), len(self.model.rod.s), self.touches
        p, diameters = self.priors, 2.0 * rod.radius / MM

        def one(source: str, name: str) -> Array:
            return self.value(z, source, name, 1)[:, 0]

        common = np.maximum(p["diameter_mm"], p["diameter_share"] * diameters) / diameters
        slot = self.slots.get("diameter")
        scale = np.zeros((n, K)) if slot is None else z[:, slot] * common
        radius = rod.radius * np.exp(
            scale + self.value(z, "diameter scatter", "diameter_scatter_mm", K) / diameters
        )
        slot = self.slots.get("length")
        length = max(p["length_mm"], p["length_share"] * rod.length / MM) * MM / rod.length
        longer = np.ones(n) if slot is None else np.exp(length * z[:, slot][:, 0])
        relaxed = one("creep", "creep")
        before = np.exp(one("E", "youngs_modulus"))
        if k == 1:
            before = before * np.exp(relaxed)
        sheared = np.exp(one("G", "shear_modulus")) * (np.exp(relaxed) if k == 1 else 1.0)
        missing = radius[:, 0] * (rod.rigid_length / rod.radius[0] + one("root", "root_radii"))
        probes = Probes(
            rod.s[:, None] * longer, radius.T, rod.youngs_modulus * before, rod.shear_modulus * sheared,
            rod.density * np.exp(one("density", "density")), np.full(n, rod.shear_coefficient), missing,
            np.full(n, float(rod.finite_strain)),
        )  # fmt: skip
        # Of several touches, none has relaxed at the first and all of it at the last.
        creeps = np.zeros((n, k)) if k == 1 else relaxed[:, None] * np.linspace(0.0, 1.0, k)
        stiffness = np.exp(creeps + self.value(z, "stiffness scatter", "stiffness_scatter", k))
        turn = np.deg2rad(np.hstack([self.value(z, "base tilt", "tilt_deg", 2),
                                     self.value(z, "clocking", "clocking_deg", 1)]))  # fmt: skip
        R = Rotation.from_rotvec(turn).as_matrix()
        return Worlds(
            self, probes, stiffness, R, MM * self.value(z, "base place", "base_mm", 3), self._gravity(z, R),
            self.value(z, "gain", "gain", 6), self._drift(z),
            MM * self.value(z, "robot", "robot_mm", 3 * k).reshape(n, k, 3),
        )  # fmt: skip

    def _gravity(self, z: Array, R: Array) -> Array:
        """Gravity as the true bases see it, (n, 3)."""
        g = np.asarray(self.model.gravity_base, dtype=float)
        across = np.linalg.svd(g[None])[2][1:] if g.any() else np.zeros((2, 3))
        off = np.deg2rad(self.value(z, "gravity", "gravity_deg", 2)) @ across * np.linalg.norm(g)
        return np.einsum("nji,nj->ni", R, g + off)

    def _drift(self, z: Array) -> Array:
        """Bias since the tare at the sensor's origin, walking from touch to touch, (n, k, 6)."""
        noise = np.sqrt(np.diag(self.model.noise.cov) * self.model.averaging_samples)
        steps = self.value(z, "drift", "drift_steps", 6 * self.touches).reshape(len(z), self.touches, 6)
        return np.cumsum(steps, axis=1) * noise


@dataclass(frozen=True)
class Worlds:
    """n worlds of k touches each.

    Attributes:
        sources: they were drawn by.
        probes: as printed and glued.
        stiffness: factor on E and G at each touch, (n, k).
        R, shift: turn and place of the true bases in the model's base frame, (n, 3, 3) and [m], (n, 3).
        gravity: as the true bases see it [m/s²], (n, 3).
        gain: relative error of each channel, (n, 6).
        drift: bias at the sensor's origin [N, N·m], (n, k, 6).
        robot: of the base's place at each touch [m], (n, k, 3).
    """

    sources: Sources
    probes: Probes
    stiffness: Array
    R: Array
    shift: Array
    gravity: Array
    gain: Array
    drift: Array
    robot: Array

    def at_touch(self, k: int) -> Probes:
        """Return the probes with the stiffness they have at touch k."""
        factor = self.stiffness[:, k]
        return replace(self.probes, E=self.probes.E * factor, G=self.probes.G * factor)

    @cached_property
    def free_touches(self) -> Touches:
        """The true free probes."""
        return solve(self.probes, self.gravity, loads=3)

    def free(self) -> Array:
        """Return the base wrench of the true free probes in the true bases, (n, 6)."""
        return self.free_touches.wrench

    def in_nominal_frame(self, wrench: Array) -> Array:
        """Return wrenches of the true bases in the model's base frame, (n, 6)."""
        force, moment = (np.einsum("nij,nj->ni", self.R, part) for part in (wrench[:, :3], wrench[:, 3:]))
        return np.hstack([force, moment + np.cross(self.shift, force)])

    def point_in_nominal_frame(self, point: Array) -> Array:
        """Return points of the true bases in the model's base frame [m], (n, 3)."""
        return np.einsum("nij,nj->ni", self.R, point) + self.shift

    def reading(self, touched: Array, free: Array, k: int, nominal_free: Array) -> Array:
        """Return what the program reads of touch k without noise, about the model's base, (n, 6).

        The tare makes the free probe read what the model has; what is added since is read by each channel's gain.

        Args:
            touched, free: wrenches of the true bases, (n, 6).
            k: which touch.
            nominal_free: of the model's free probe, (6,).
        """
        T = self.sources.model.T_sensor_base
        there, back = wrench_map(T), wrench_map(inverse(T))
        added = (self.in_nominal_frame(touched) - self.in_nominal_frame(free)) @ there.T
        return nominal_free + ((1.0 + self.gain) * added + self.drift[:, k]) @ back.T


def nominal_free(model: ProbeModel) -> Array:
    """Return the free probe's wrench as designed, (6,)."""
    return solve(Probes.of(model.rod), model.gravity_base, loads=3).wrench[0]


# Touches, their columns and bounds


@dataclass(frozen=True)
class Readings:
    """Touches of n worlds, one each.

    Attributes:
        touches: solved by the reference rod, in the true bases.
        wrench: read without noise, about the model's base, (n, 6).
        point: touched point of the surface in the model's base frame [m], (n, 3).
        J, P: derivatives of reading and point by (s, φ, normal, circumferential, along), (n, 6, 5), (n, 3, 5).
        D, Q: by each standard normal of the world, (n, 6, j), (n, 3, j).
    """

    touches: Touches
    wrench: Array
    point: Array
    J: Array
    P: Array
    D: Array
    Q: Array


def read(
    worlds: Worlds, z: Array, touches: Touches, free: Array, k: int = 0, columns: bool = True
) -> Readings:
    """Return the readings of solved touches, with their columns unless these are left out."""
    sources, n = worlds.sources, len(z)
    bare = nominal_free(sources.model)
    wrench = worlds.reading(touches.wrench, free, k, bare)
    point = worlds.point_in_nominal_frame(touches.p_surface)
    if not columns:
        none = np.zeros((n, 0, 0))
        return Readings(touches, wrench, point, none, none, none, none)
    probes, force = worlds.at_touch(k), touches.surface_force
    size = np.linalg.norm(np.nan_to_num(force, nan=1.0), axis=1)
    steps = [1e-4 * worlds.probes.length, np.full(n, 1e-4), *(1e-3 * size,) * 3]
    variants = [(probes, worlds.gravity, touches.s + steps[0], touches.phi, force),
                (probes, worlds.gravity, touches.s, touches.phi + steps[1], force)]  # fmt: skip
    variants += [(probes, worlds.gravity, touches.s, touches.phi, force + steps[2 + i][:, None] * e)
                 for i, e in enumerate(np.eye(3))]  # fmt: skip
    dw, dp = differences(probes, worlds.gravity, touches, variants)
    over = np.stack(steps, axis=1)[:, None, :]
    J = np.stack(
        [worlds.reading(touches.wrench + dw[:, :, i], free, k, bare) - wrench for i in range(5)], axis=2
    )
    P = np.stack(
        [worlds.point_in_nominal_frame(touches.p_surface + dp[:, :, i]) - point for i in range(5)], axis=2
    )
    D, Q = _world_columns(worlds, z, touches, free, k, wrench, point, bare)
    return Readings(touches, wrench, point, J / over, P / over, D, Q)


def _world_columns(worlds: Worlds, z: Array, touches: Touches, free: Array, k: int, wrench: Array, point: Array,
                   bare: Array) -> tuple[Array, Array]:  # fmt: skip
    """Columns by the world's normals: touch and tare both change."""
    sources, n = worlds.sources, len(z)
    D, Q = np.zeros((n, 6, sources.size)), np.zeros((n, 3, sources.size))
    if not sources.size:
        return D, Q
    force, none, zero = touches.surface_force, np.zeros(n), np.zeros((n, 3))
    bending = sources.bending(k)
    worlds_moved = {j: sources.worlds(z + SMALL * np.eye(sources.size)[j]) for j in sources.seen(k)}
    rods = [worlds_moved[j] for j in bending]
    dw, dp = differences(worlds.at_touch(k), worlds.gravity, touches, [
        (w.at_touch(k), w.gravity, touches.s * w.probes.length / worlds.probes.length, touches.phi, force) for w in rods
    ])  # fmt: skip
    df, _ = differences(worlds.probes, worlds.gravity, worlds.free_touches,
                        [(w.probes, w.gravity, none, none, zero) for w in rods])  # fmt: skip
    for j, w in worlds_moved.items():
        i = bending.index(j) if j in bending else -1
        by_touch, by_free, by_point = (dw[:, :, i], df[:, :, i], dp[:, :, i]) if i >= 0 else (0.0, 0.0, 0.0)
        D[:, :, j] = w.reading(touches.wrench + by_touch, free + by_free, k, bare) - wrench
        Q[:, :, j] = w.point_in_nominal_frame(touches.p_surface + by_point) - point
    return D / SMALL, Q / SMALL


def bound(readings: Readings, noise: Array, friction: float = math.inf, sources: bool = True) -> Array:
    """Return the Cramér-Rao bound of the touched point, its covariance [m²], (n, 3, 3).

    Unknown are (s, φ, F) and the world's normals, which have their priors; with a friction prior the tangential
    components too. With `friction` 0 they are known.

    Args:
        readings: of the touches.
        noise: covariance of a reading about the base, (6, 6).
        friction: standard deviation of tangential over normal force.
        sources: whether the world's normals are unknown.
    """
    count = 3 if friction == 0.0 else 5
    J, P = readings.J[:, :, :count], readings.P[:, :, :count]
    if sources:
        J, P = np.concatenate([J, readings.D], axis=2), np.concatenate([P, readings.Q], axis=2)
    information = np.einsum("nai,ab,nbj->nij", J, np.linalg.inv(noise), J)
    diagonal = np.zeros(information.shape[:2])
    diagonal[:, count:] = 1.0
    if count == 5 and math.isfinite(friction):
        diagonal[:, 3:5] = 1.0 / (friction * readings.touches.surface_force[:, :1]) ** 2
    information[:, np.arange(J.shape[2]), np.arange(J.shape[2])] += diagonal
    return projected(information, P)


def projected(information: Array, P: Array) -> Array:
    """Return P I⁻¹ Pᵀ of information matrices, (n, a, a); infinite where P needs what they have nothing of."""
    good = np.isfinite(information).all(axis=(1, 2)) & np.isfinite(P).all(axis=(1, 2))
    safe = np.where(good[:, None, None], information, np.eye(information.shape[1]))
    scale = np.sqrt(np.maximum(np.diagonal(safe, axis1=1, axis2=2), 1e-300))
    values, vectors = np.linalg.eigh(safe / (scale[:, :, None] * scale[:, None, :]))
    gain = (np.where(good[:, None, None], P, 0.0) / scale[:, None, :]) @ vectors
    known = values > 1e-12
    cov = np.einsum("nai,ni,nbi->nab", gain, known / np.where(known, values, 1.0), gain)
    missing = np.where(known[:, None, :], 0.0, gain)
    cov[
        (np.abs(missing) > 1e-3 * np.abs(gain).max(axis=(1, 2), initial=0.0)[:, None, None]).any(axis=(1, 2))
    ] = np.inf
    cov[~good] = np.nan
    return cov


def rms(cov: Array) -> Array:
    """Return the root of the trace [m], (n,)."""
    return np.sqrt(np.trace(cov, axis1=1, axis2=2))


# Several touches of one point


HOLDS = 1.0
"""Largest friction ratio that a sticking touch bears; beyond it the press is not counted. Assumed."""


@dataclass(frozen=True)
class Presses:
    """k touches of the world's origin in each of n worlds, as the base presses on without turning.

    Attributes:
        ok: all touches found, (n,).
        readings: one a touch; without columns unless asked for.
        places: of the base as the robot reports it [m], (n, k, 3).
        sources: of the worlds.
    """

    ok: Array
    readings: tuple[Readings, ...]
    places: Array
    sources: Sources

    @property
    def wrenches(self) -> Array:
        """Read without noise, about the model's base, (n, k, 6)."""
        return np.stack([one.wrench for one in self.readings], axis=1)


def presses(worlds: Worlds, z: Array, fraction: float, phi: Array, ratios: Array, newtons: float,
            slide: Array, aside: Array | None = None, columns: bool = False) -> Presses:  # fmt: skip
    """Press probes on against a fixed point, about evenly from a fifth of a normal force up to all of it.

    A touch that slides has the given friction ratios, and the object drags its place along the probe in the mean
    direction of the tangential force; the base moves as that needs. If it sticks, the material point stays, the base
    moves a little aside of that, and the force is what that needs.

    Args:
        worlds: n of them, for k touches.
        z: their normals.
        fraction: of the length, where the first touch is.
        phi: angle about the section there [rad], (n,).
        ratios: tangential over normal force, (n, 2); if it sticks, at the first touch; (k, n, 2) where they differ.
        newtons: largest normal force [N].
        slide: way along the surface from the first to the last touch [m], (n,); of no account if it sticks.
        aside: None for a touch that slides; else it sticks, and the base moves sideways by this share of its way,
            (n,); beyond a tenth the probe is drawn out and no friction holds it.
        columns: whether the readings carry columns, for `fused_bound`.
    """
    n, k = len(z), worlds.sources.touches
    s, free = fraction * worlds.probes.length, worlds.free()
    each = np.broadcast_to(ratios, (k, n, 2))
    push = np.concatenate([np.ones((k, n, 1)), each], axis=2).reshape(k * n, 3)
    mean = each.mean(axis=0)
    way = slide[:, None] * mean / np.maximum(np.linalg.norm(mean, axis=1), 1e-9)[:, None]
    if aside is not None:
        way = np.zeros((n, 2))

    def every(value: Array) -> Array:
        return np.concatenate([value] * k)

    rods, g = Probes.joined([worlds.at_touch(i) for i in range(k)]), every(worlds.gravity)
    shares, passed = (np.repeat(row, n) for row in (np.arange(1, k + 1) / k, np.arange(k) / (k - 1)))
    around = every(phi) + passed * every(way[:, 0] / worlds.probes.radius_at(s))
    found = solve(rods, g, every(s) + passed * every(way[:, 1]), around, newtons * shares[:, None] * push,
                  axes="surface", loads=3)  # fmt: skip
    if aside is not None:
        way_long = np.linalg.norm(found.p_surface[-n:] - found.p_surface[:n], axis=1)
        sideways = every((aside * way_long)[:, None] * found.frame[:n, :, 1])
        goal = np.nan_to_num(found.p_surface + passed[:, None] * sideways)
        found = press(rods, g, goal, found, sticks=True, moves=2)
        tangential = np.linalg.norm(found.surface_force[:, 1:], axis=1)
        found = replace(found, ok=found.ok & (tangential <= HOLDS * found.surface_force[:, 0]))
    solved = [found.take(np.arange(i * n, (i + 1) * n)) for i in range(k)]
    readings = tuple(read(worlds, z, touch, free, i, columns) for i, touch in enumerate(solved))
    places = np.stack([-one.point - worlds.robot[:, i] for i, one in enumerate(readings)], axis=1)
    return Presses(np.all([touch.ok for touch in solved], axis=0), readings, places, worlds.sources)


TIE = 1e-6
"""Standard deviation with which every touched point is held to be the same one [m]."""


def fused_bound(pressed: Presses, noise: Array, friction: float, moments_only: bool) -> Array:
    """Return the Cramér-Rao bound of the touched fixed point, its covariance [m²], (n, 3, 3).

    Unknown are the point, (s, φ, F) at each touch and the world's normals.

    Args:
        pressed: the touches.
        noise: covariance of a reading about the base, (6, 6).
        friction: standard deviation of tangential over normal force; 0: none, inf: the direction is free.
        moments_only: whether the moments about the base count alone.
    """
    k, sources = len(pressed.readings), pressed.sources
    n, count = len(pressed.ok), 3 if friction == 0.0 else 5
    channels = slice(3, 6) if moments_only else slice(0, 6)
    weight = np.linalg.inv(noise[channels, channels])
    size = 3 + count * k + sources.size
    world = slice(3 + count * k, size)
    information = np.zeros((n, size, size))
    for i, one in enumerate(pressed.readings):
        own = slice(3 + count * i, 3 + count * (i + 1))
        H = np.zeros((n, weight.shape[0], size))
        H[:, :, own], H[:, :, world] = one.J[:, channels, :count], one.D[:, channels]
        C = np.zeros((n, 3, size))
        C[:, :, :3], C[:, :, own], C[:, :, world] = -np.eye(3), one.P[:, :, :count], one.Q
        if "robot" in sources.slots:
            start = 3 + count * k + sources.slots["robot"].start + 3 * i
            C[:, :, start : start + 3] += MM * sources.priors["robot_mm"] * np.eye(3)
        information += np.einsum("nai,ab,nbj->nij", H, weight, H) + np.einsum("nai,naj->nij", C, C) / TIE**2
        if count == 5 and math.isfinite(friction):
            at = np.arange(own.stop - 2, own.stop)
            information[:, at, at] += 1.0 / (friction * one.touches.surface_force[:, :1]) ** 2
    at = np.arange(world.start, size)
    information[:, at, at] += 1.0
    return projected(information, np.tile(np.eye(3, size), (n, 1, 1)))
