"""Many readings of one fixed point, from several poses of the base, into one answer.

Pressing on by a known motion of the base measures the compliance at the contact, which tells its place without any
reading of the force. Unknown are the fixed point p, a common factor on the stiffness, and the base's own offset; the
sensor's bias, its walk and the base's scatter from pose to pose go into the covariance V of all readings together:

    w_k = h_k(p) + b_k + ε_k,   b a random walk,   minimise rᵀ V⁻¹ r + priors.

At every pose the arclength, the side and the force that put the probe's fixed point at p are found on the way
(`pressed.py`), so the contact may slide along the probe.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from probedesign.estimator.curves import Curve, curve, meetings
from probedesign.estimator.estimate import Result
from probedesign.estimator.fused import Fixed, Fused, MomentsAbout
from probedesign.estimator.model import ProbeModel
from probedesign.estimator.pressed import Pressed, Push, press, settle
from probedesign.estimator.unknowns import EXACT, Source, Unknowns
from probedesign.frames import Array, pose, wrench_map

UNLIKELY = 1e-3
"""Chance that true touches of one fixed point are called inconsistent."""
RIVAL = 9.0
"""Least misfits this close to the best explain the readings about as well."""
POINT, STIFFNESS, OFFSET = slice(0, 3), 3, slice(4, 7)
"""Of the unknowns: where the fixed point is, the logarithm of the stiffness, the base's offset in its own axes."""
_UNKNOWN = 7
_STARTS = 3
_ANYWHERE = (4, 10, 16, 22)  # stations to start from where no meeting of the curves leads anywhere
_MAX_ITERATIONS = 30
_CLOSE = 1e-3  # of a standard deviation
_NEAR = 1e-9  # [m]
_SOURCES: tuple[Source, ...] = ("stiffness", "bias", "robot")


@dataclass(frozen=True)
class Reading:
    """One pose.

    Attributes:
        wrench: read at the base, free of what hangs below it, (6,).
        cov: of its noise, (6, 6).
        T_world_base: (4, 4).
        gravity: base axes [m/s²], (3,).
        touched: whether there was contact.
    """

    wrench: Array
    cov: Array
    T_world_base: Array
    gravity: Array
    touched: bool

    def to_base(self, p_world: Array) -> Array:
        """A point of the world seen from the base [m], (3,)."""
        seen: Array = self.T_world_base[:3, :3].T @ (p_world - self.T_world_base[:3, 3])
        return seen

    def turned(self, v_base: Array) -> Array:
        """A vector of the base's in the world's axes, (3,)."""
        v_world: Array = self.T_world_base[:3, :3] @ v_base
        return v_world

    def to_world(self, p_base: Array) -> Array:
        """A point of the base's in the world [m], (3,)."""
        there: Array = self.T_world_base[:3, :3] @ p_base + self.T_world_base[:3, 3]
        return there


@dataclass(frozen=True)
class Linear:
    """All readings to first order about one guess.

    Attributes:
        misfit: read less modelled, (n,).
        design: of the model by the unknowns, (n, 7).
        by_place: of the model by where each base is, one block a reading, (k, m, 3).
        noise: (k, m, m).
    """

    misfit: Array
    design: Array
    by_place: Array
    noise: Array

    def repeated(self, other: "Linear") -> "Linear":
        """These readings and others after them."""
        return Linear(*(np.concatenate([getattr(self, name), getattr(other, name)]) for name in
                        ("misfit", "design", "by_place", "noise")))  # fmt: skip


class Normal(NamedTuple):
    """What the normal equations tell of one guess.

    Attributes:
        cov: of the unknowns, (7, 7).
        step: to where the misfit is least, (7,).
        chi2: the misfit at the guess, priors included.
        shifts: how far each base was likely off for itself, in base axes [m], (k, 3).
    """

    cov: Array
    step: Array
    chi2: float
    shifts: Array


@dataclass(frozen=True)
class Solution:
    """Where the iterations ended.

    Attributes:
        x: the unknowns, (7,).
        cov: of them, (7, 7).
        chi2: misfit, priors included.
        pressed: the touches, None where free.
        linear: the readings there.
        iterations: how many.
    """

    x: Array
    cov: Array
    chi2: float
    pressed: tuple[Pressed | None, ...]
    linear: Linear
    iterations: int


def channels_of(model: ProbeModel, moments: MomentsAbout | None) -> Array:
    """What of a wrench at the base counts.

    Args:
        model: the probe.
        moments: None: all six channels. "base": the moments about the base's origin alone. "sensor": the moments that
            the sensor reads, which hold no noise of the forces; but they are got back from all six numbers.

    Returns:
        (6, 6) or (3, 6).
    """
    if moments is None:
        return np.eye(6)
    return np.eye(6)[3:] if moments == "base" else wrench_map(model.T_sensor_base)[3:]


@dataclass(frozen=True)
class Fusion:
    """Readings to be fused.

    Attributes:
        model: the probe.
        readings: in the order of time.
        unknowns: what is not known.
        channels: what of a wrench at the base counts, (m, 6): see `channels_of`.
    """

    model: ProbeModel
    readings: tuple[Reading, ...]
    unknowns: Unknowns
    channels: Array

    def solve(self) -> Fused:
        """The answer; see `Estimator.fuse`."""
        solved = self.solved()
        return solved if isinstance(solved, Fused) else self.answer(*solved)

    def solved(self) -> tuple[list[Solution], Fixed] | Fused:
        """Every place that explains the readings, best first, and which point stands still; or why there is none."""
        if not self._enough():
            return Fused("unobservable")
        curves = self._curves()
        centre: list[Solution] = []
        for places in (meetings(curves)[:_STARTS], [(j,) * len(curves) for j in _ANYWHERE]):
            centre = centre or _distinct(
                self._run(self._pushes(curves, place), "contact") for place in places
            )
        if not centre:
            return Fused("not_converged")
        surface = _distinct(self._run(_pushes(found), "surface") for found in centre)
        return self._choose(centre, surface)

    def _enough(self) -> bool:
        """Whether the poses can tell a point at all: moments alone need two that differ."""
        touched = [reading.T_world_base for reading in self.readings if reading.touched]
        if not touched:
            return False
        differ = any(not np.allclose(touched[0], T, atol=_NEAR) for T in touched[1:])
        return differ or not self._moments_only

    def _curves(self) -> list[Curve]:
        """What each touch's moment leaves open; the point lies where they meet."""
        return [
            curve(self.model.rod, reading.gravity, reading.wrench[3:6], reading.T_world_base)
            for reading in self.readings
            if reading.touched
        ]

    def _pushes(self, curves: list[Curve], stations: tuple[int, ...]) -> tuple[Push | None, ...]:
        """The pushes at a station of each curve, None for readings without contact."""
        pushes = iter([of.pushes[j] for of, j in zip(curves, stations, strict=True)])
        return tuple(next(pushes) if reading.touched else None for reading in self.readings)

    def _choose(self, centre: list[Solution], surface: list[Solution]) -> tuple[list[Solution], Fixed]:
        """The touched point stands still, unless the readings speak for the centreline's."""
        if surface and surface[0].chi2 <= centre[0].chi2 + RIVAL:
            return surface, "surface"
        return centre, "contact"

    def _run(self, pushes: tuple[Push | None, ...], fixed: Fixed) -> Solution | None:
        """Gauss and Newton from one guess; None if a touch has no push to start from."""
        if any(push is None and reading.touched for push, reading in zip(pushes, self.readings, strict=True)):
            return None
        x, most = np.zeros(_UNKNOWN), 0.1 * self.model.rod.length
        pressed = self._press(pushes, 0.0, fixed)
        if pressed is None:
            return None
        there = [r.to_world(p.p_fixed) for r, p in zip(self.readings, pressed, strict=True) if p is not None]
        x[POINT] = np.mean(there, axis=0)
        for iteration in range(_MAX_ITERATIONS):
            linear = self.linear(pressed, x)
            normal = self.normal(linear, x)
            if not np.isfinite(normal.step).all():
                return None
            if self._ended(pressed, x, normal):
                return Solution(x, normal.cov, normal.chi2, pressed, linear, iteration)
            x_new = x + share_of(normal.step, most) * normal.step
            moved = self._moved(pressed, x_new, normal.shifts, most)
            pressed_new = self._press(moved, float(x_new[STIFFNESS]), fixed)
            if pressed_new is None:
                most *= 0.25
                if most < 1e-4 * self.model.rod.length:
                    return None
                continue
            x, pressed = x_new, pressed_new
        return None

    def _ended(self, pressed: tuple[Pressed | None, ...], x: Array, normal: Normal) -> bool:
        """Whether the next step is nothing beside what is not known, and every touch is where it belongs."""
        if (np.abs(normal.step) > _CLOSE * np.sqrt(np.diag(normal.cov)) + EXACT).any():
            return False
        near = 1e-6 + _CLOSE * math.sqrt(float(np.trace(normal.cov[POINT, POINT])))
        return all(
            np.linalg.norm(p.towards_normal) <= _CLOSE * abs(p.push.magnitude) + 1e-9
            and np.linalg.norm(target(r, x, shift) - p.p_fixed) <= near
            for r, p, shift in zip(self.readings, pressed, normal.shifts, strict=True)
            if p is not None
        )

    def _moved(
        self, pressed: tuple[Pressed | None, ...], x: Array, shifts: Array, most: float
    ) -> tuple[Push | None, ...]:
        """The pushes that put each fixed point where the unknowns say."""
        return tuple(
            None if p is None else p.moved(target(r, x, shift), float(x[STIFFNESS]), most)
            for r, p, shift in zip(self.readings, pressed, shifts, strict=True)
        )

    def _press(
        self, pushes: tuple[Push | None, ...], log_stiffness: float, fixed: Fixed
    ) -> tuple[Pressed | None, ...] | None:
        """Every touch solved and linearised; None if one of them has no equilibrium."""
        rod = self.model.rod
        pressed = tuple(
            None if push is None else press(rod, reading.gravity, push, fixed, log_stiffness)
            for reading, push in zip(self.readings, pushes, strict=True)
        )
        lost = any(p is None and push is not None for p, push in zip(pressed, pushes, strict=True))
        return None if lost else pressed

    @property
    def _moments_only(self) -> bool:
        return len(self.channels) == 3

    @cached_property
    def _free_wrenches(self) -> dict[int, tuple[Array, Array]]:
        """Of the readings without contact: the wrench and its derivative by log stiffness."""
        found = {}
        for k, reading in enumerate(self.readings):
            if not reading.touched:
                eq = self.model.rod.solve(reading.gravity, columns="all")
                assert eq.sensitivity is not None, "the free probe stands"
                d = eq.sensitivity.d_wrench
                names = eq.sensitivity.names
                found[k] = (eq.wrench_base, d[:, names.index("log_E")] + d[:, names.index("log_G")])
        return found

    def linear(self, pressed: tuple[Pressed | None, ...], x: Array) -> Linear:
        """All readings to first order, each touch's fixed point put where the unknowns say."""
        k = len(self.readings)
        modelled, by_place, design = np.empty((k, 6)), np.zeros((k, 6, 3)), np.empty((k, 6, _UNKNOWN))
        made_at, stiffness_at = np.zeros((k, 3)), np.zeros(k)
        for i, p in enumerate(pressed):
            if p is None:
                modelled[i], design[i, :, STIFFNESS] = self._free_wrenches[i]
            else:
                modelled[i], design[i, :, STIFFNESS] = p.wrench, p.by_stiffness
                by_place[i], made_at[i], stiffness_at[i] = p.stiffness, p.p_fixed, p.log_stiffness
        R, origins = self._poses[:, :3, :3], self._poses[:, :3, 3]
        points = ((x[POINT] - origins)[:, None] @ R)[:, 0] - x[OFFSET]
        modelled += (by_place @ (points - made_at)[:, :, None])[:, :, 0]
        modelled += design[:, :, STIFFNESS] * (x[STIFFNESS] - stiffness_at)[:, None]
        design[:, :, POINT] = by_place @ R.transpose(0, 2, 1)
        design[:, :, OFFSET] = -by_place
        of = self.channels
        misfit = (np.array([reading.wrench for reading in self.readings]) - modelled) @ of.T
        return Linear(misfit.ravel(), (of @ design).reshape(-1, _UNKNOWN), of @ by_place, self._noise)

    @cached_property
    def _poses(self) -> Array:
        return np.array([reading.T_world_base for reading in self.readings])

    @cached_property
    def _noise(self) -> Array:
        """Of the channels that count, (k, m, m)."""
        noise: Array = self.channels @ np.array([reading.cov for reading in self.readings]) @ self.channels.T
        return noise

    def covariance(self, linear: Linear, unknowns: Unknowns) -> Array:
        """V: noise, bias and its walk, and the base's scatter, of all readings together, (n, n)."""
        k, m, _ = linear.noise.shape
        step = self.channels @ self.model.noise_base() @ self.channels.T * self.model.averaging_samples
        walked = np.minimum.outer(np.arange(1, k + 1), np.arange(1, k + 1)).astype(float)
        bias = unknowns.bias_steps**2 + unknowns.bias_walk_steps**2 * walked
        V = np.asarray(np.kron(bias, step), dtype=float)
        creep = unknowns.creep
        i = np.arange(k)
        scatter = unknowns.base_repeat**2 * linear.by_place @ linear.by_place.transpose(0, 2, 1)
        V.reshape(k, m, k, m)[i, :, i] += linear.noise + scatter
        if creep:
            grown = linear.design[:, STIFFNESS] * np.repeat(np.arange(k) / max(k - 1, 1), m)
            V += creep**2 * np.outer(grown, grown)
        return V

    def normal(self, linear: Linear, x: Array) -> Normal:
        """The normal equations of the readings as they are linearised, at the unknowns x."""
        prior = self.unknowns.prior
        V = self.covariance(linear, self.unknowns)
        weighted = np.linalg.solve(V, np.column_stack([linear.design, linear.misfit]))
        cov = _inverted(linear.design.T @ weighted[:, :-1], prior)
        lack = linear.design.T @ weighted[:, -1]
        lack[STIFFNESS:] -= x[STIFFNESS:] / prior**2
        chi2 = float(linear.misfit @ weighted[:, -1] + ((x[STIFFNESS:] / prior) ** 2).sum())
        step = cov @ lack
        left = (weighted[:, -1] - weighted[:, :-1] @ step).reshape(len(linear.by_place), -1)
        shifts = self.unknowns.base_repeat**2 * np.einsum("kmi,km->ki", linear.by_place, left)
        return Normal(cov, step, chi2, shifts)

    def rms(self, linear: Linear, unknowns: Unknowns) -> float:
        """Of the fixed point [m], by the bound."""
        information = linear.design.T @ np.linalg.solve(self.covariance(linear, unknowns), linear.design)
        return math.sqrt(max(float(np.trace(_inverted(information, unknowns.prior)[POINT, POINT])), 0.0))

    @cached_property
    def _most(self) -> float:
        return float(chdtri(self._dof, UNLIKELY))

    @property
    def _dof(self) -> int:
        return max(len(self.readings) * len(self.channels) - 3, 1)

    def answer(self, found: list[Solution], fixed: Fixed, brief: bool = False) -> Fused:
        """The best solution with its code; brief: without what it would be if something were otherwise."""
        best = found[0]
        result = self._result(found)
        touched = [(r, p) for r, p in zip(self.readings, best.pressed, strict=True) if p is not None]
        told = Fused(
            result,
            fixed=fixed,
            stiffness=math.exp(best.x[STIFFNESS]),
            std_stiffness=math.exp(best.x[STIFFNESS]) * math.sqrt(best.cov[STIFFNESS, STIFFNESS]),
            chi2=best.chi2,
            dof=self._dof,
            rms=math.sqrt(float(np.trace(best.cov[POINT, POINT]))),
            rms_without={}
            if brief
            else {source: self.rms(best.linear, self.unknowns.without(source)) for source in _SOURCES},
            iterations=best.iterations,
        )
        if result != "ok":
            return told
        by_unknowns = _contact_by_unknowns(
            np.array([r.T_world_base[:3, :3] for r, _ in touched]), [p for _, p in touched]
        )
        return replace(
            told,
            p_contact_world=best.x[POINT] + _mean(r.turned(p.p_contact - p.p_fixed) for r, p in touched),
            p_surface_world=best.x[POINT] + _mean(r.turned(p.p_surface - p.p_fixed) for r, p in touched),
            cov_contact_world=by_unknowns @ best.cov @ by_unknowns.T,
            cov_fixed_world=best.cov[POINT, POINT],
            s_contact=np.array([np.nan if p is None else p.push.s for p in best.pressed]),
            force_base=np.array([np.zeros(3) if p is None else p.push.force for p in best.pressed]),
            rms_with={} if brief else self._gains(best),
        )

    def _result(self, found: list[Solution]) -> Result:
        best = found[0]
        if best.chi2 > self._most or any(p is not None and p.push.magnitude < 0.0 for p in best.pressed):
            return "inconsistent"
        rms = math.sqrt(float(np.trace(best.cov[POINT, POINT])))
        if not rms < self.model.rod.length / math.sqrt(12.0):
            return "unobservable" if self._moments_only else "too_light"
        apart = [np.linalg.norm(other.x[POINT] - best.x[POINT]) for other in found[1:]
                 if other.chi2 < best.chi2 + RIVAL]  # fmt: skip
        return "ambiguous" if any(distance > 3.0 * rms for distance in apart) else "ok"

    def _gains(self, best: Solution) -> dict[str, float]:
        """What more readings or a better stiffness would bring."""
        halved = replace(self.unknowns, stiffness=0.5 * self.unknowns.stiffness)
        gains = {"stiffness": self.rms(best.linear, halved)}
        touched = [(r, p) for r, p in zip(self.readings, best.pressed, strict=True) if p is not None]
        last, p = touched[-1]
        more = replace(self, readings=(last,)).linear((p,), best.x)
        gains["one more touch"] = self.rms(best.linear.repeated(more), self.unknowns)
        if len(touched) > 1:
            way = last.T_world_base[:3, 3] - touched[-2][0].T_world_base[:3, 3]
            on = replace(last, T_world_base=pose(last.T_world_base[:3, :3], last.T_world_base[:3, 3] + way))
            point, log_stiffness = target(on, best.x, np.zeros(3)), float(best.x[STIFFNESS])
            further = settle(self.model.rod, on.gravity, p.push, p.fixed, point, 1e-6, log_stiffness)
            if further is not None:
                pressed_on = replace(self, readings=(on,)).linear((further,), best.x)
                gains["further press"] = self.rms(best.linear.repeated(pressed_on), self.unknowns)
        return gains


def _pushes(found: Solution) -> tuple[Push | None, ...]:
    return tuple(None if p is None else p.push for p in found.pressed)


def target(reading: Reading, x: Array, shift: Array) -> Array:
    """Where the fixed point is seen from the base, that being off by `shift` for itself [m], (3,)."""
    return reading.to_base(x[POINT]) - x[OFFSET] + shift


def share_of(step: Array, most: float) -> float:
    """The share of a step that moves the point no further than that [m], nor the stiffness by more than a fifth."""
    far = float(np.linalg.norm(step[POINT]))
    return min(1.0, most / max(far, 1e-300), 0.2 / max(abs(float(step[STIFFNESS])), 1e-300))


def _contact_by_unknowns(R: Array, pressed: list[Pressed]) -> Array:
    """Of the centreline's mean point in the world by the unknowns, (3, 7); R: the bases' turns, (k, 3, 3)."""
    by_point = R @ np.array([p.contact_by_fixed[0] for p in pressed])
    by_stiffness = np.array([p.contact_by_fixed[1] for p in pressed])
    found = np.empty((3, _UNKNOWN))
    found[:, POINT] = (by_point @ R.transpose(0, 2, 1)).mean(axis=0)
    found[:, STIFFNESS] = (R @ by_stiffness[:, :, None])[:, :, 0].mean(axis=0)
    found[:, OFFSET] = (R - by_point).mean(axis=0)
    return found


def _mean(points: Iterable[Array]) -> Array:
    mean: Array = np.mean(list(points), axis=0)
    return mean


def _distinct(found: Iterable[Solution | None]) -> list[Solution]:
    """Best first, each place once."""
    listed = sorted((solution for solution in found if solution is not None), key=lambda s: s.chi2)
    kept: list[Solution] = []
    for solution in listed:
        if all(np.linalg.norm(solution.x[POINT] - other.x[POINT]) > 1e-5 for other in kept):
            kept.append(solution)
    return kept


def _inverted(information: Array, prior: Array) -> Array:
    """Covariance of the unknowns from the readings' information and the priors; huge where neither tells."""
    total = information.copy()
    total[range(STIFFNESS, _UNKNOWN), range(STIFFNESS, _UNKNOWN)] += 1.0 / prior**2
    scale = np.sqrt(np.diag(total))
    scale = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(total / np.outer(scale, scale))
    values = np.maximum(values, 1e-13)
    scaled: Array = (vectors / values) @ vectors.T / np.outer(scale, scale)
    return scaled
