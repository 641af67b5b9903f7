"""Many readings of one fixed point, from several poses of the base, into one answer.

Pressing on by a known motion of the base measures the compliance at the contact, which tells its place without any
reading of the force. `equations.py` says what is minimised, `answer.py` what is told of it. At every pose the
arclength, the side and the force that put the probe's fixed point at p are found on the way (`pressed.py`), so the
contact may slide along the probe.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from probedesign.estimation.answer import RIVAL, Solution, told
from probedesign.estimation.curves import Curve, curve, meetings
from probedesign.estimation.equations import POINT, STIFFNESS, UNKNOWNS, Equations, Normal, Reading, target
from probedesign.estimation.fused import Fixed, Fused
from probedesign.estimation.likelihood import locate
from probedesign.estimation.observation import Observation
from probedesign.estimation.pressed import Pressed, Push, press
from probedesign.estimation.unknowns import EXACT
from probedesign.frames import Array

_STARTS = 3
_ANYWHERE = (4, 10, 16, 22)  # stations to start from where no meeting of the curves leads anywhere
_MAX_ITERATIONS = 30
_CLOSE = 1e-3  # of a standard deviation


@dataclass(frozen=True)
class Fusion:
    """A point sought that explains readings.

    Attributes:
        equations: of the readings.
    """

    equations: Equations

    def solve(self) -> Fused:
        """The answer; see `Estimator.fuse`."""
        solved = self.solved()
        return solved if isinstance(solved, Fused) else told(self.equations, *solved)

    def solved(self) -> tuple[list[Solution], Fixed, list[Solution]] | Fused:
        """Every place that explains the readings, best first, which point stands still, and what were if the other one
        did; or why there is none."""
        if not self._enough():
            return Fused("unobservable")
        starts, centre = self._starts(), list[Solution]()
        for pushes in starts:
            centre = centre or _distinct(self._run(push, "contact") for push in pushes)
        # Where the centreline's point cannot stand still, near the tip, or somewhere else, the touched one may.
        again = [_pushes(found) for found in centre] + [*starts[0], *starts[2]]
        again += [] if centre else starts[1]
        surface = _distinct(self._run(push, "surface") for push in again)
        return self._choose(centre, surface) if centre or surface else Fused("not_converged")

    def _starts(self) -> list[list[tuple[Push | None, ...]]]:
        """Guesses, the likelier first: where the curves meet, anywhere along them, and what each reading tells."""
        curves = self._curves()
        met = [self._pushes(curves, place) for place in meetings(curves)[:_STARTS]]
        return [met, [self._pushes(curves, (j,) * len(curves)) for j in _ANYWHERE], [self._singly()]]

    def _enough(self) -> bool:
        """Whether the poses can tell a point at all: moments alone need two that differ."""
        touched = any(reading.touched for reading in self.equations.readings)
        return touched and not (self.equations.moments_only and self.equations.one_pose)

    def _curves(self) -> list[Curve]:
        """What each touch's moment leaves open; the point lies where they meet."""
        return [
            curve(self.equations.model.rod, reading.gravity, reading.wrench[3:6], reading.T_world_base)
            for reading in self.equations.readings
            if reading.touched
        ]

    def _pushes(self, curves: list[Curve], stations: tuple[int, ...]) -> tuple[Push | None, ...]:
        """The pushes at a station of each curve, None for readings without contact."""
        pushes = iter([of.pushes[j] for of, j in zip(curves, stations, strict=True)])
        return tuple(next(pushes) if reading.touched else None for reading in self.equations.readings)

    def _singly(self) -> tuple[Push | None, ...]:
        """The push that each reading tells by itself, its force's reading trusted, None where it tells none."""
        return tuple(self._alone(reading) if reading.touched else None for reading in self.equations.readings)

    def _alone(self, reading: Reading) -> Push | None:
        rod, whiten = self.equations.model.rod, np.linalg.inv(np.linalg.cholesky(reading.cov))
        weight = rod.mass * reading.gravity
        places = locate(rod, Observation(reading.wrench, whiten, reading.gravity, weight, math.inf))
        if not places:
            return None
        eq = min(places, key=lambda place: place.chi2).shape()
        return Push.under(rod, eq) if eq.ok else None

    def _choose(
        self, centre: list[Solution], surface: list[Solution]
    ) -> tuple[list[Solution], Fixed, list[Solution]]:
        """The touched point stands still, unless the readings speak for the centreline's."""
        if surface and (not centre or surface[0].chi2 <= centre[0].chi2 + RIVAL):
            return surface, "surface", centre
        return centre, "contact", surface

    def _run(self, pushes: tuple[Push | None, ...], fixed: Fixed) -> Solution | None:
        """Gauss and Newton from one guess; None if a touch has no push to start from."""
        if any(
            push is None and reading.touched
            for push, reading in zip(pushes, self.equations.readings, strict=True)
        ):
            return None
        x, most = np.zeros(UNKNOWNS), 0.1 * self.equations.model.rod.length
        pressed = self._press(pushes, 0.0, fixed)
        if pressed is None:
            return None
        there = [
            r.to_world(p.p_fixed)
            for r, p in zip(self.equations.readings, pressed, strict=True)
            if p is not None
        ]
        x[POINT] = np.mean(there, axis=0)
        calm, before = 1.0, math.inf
        for iteration in range(_MAX_ITERATIONS):
            linear = self.equations.linear(pressed, x)
            normal = self.equations.normal(linear, x)
            if not np.isfinite(normal.step).all():
                return None
            if self._ended(pressed, x, normal):
                return Solution(x, normal.cov, normal.chi2, pressed, linear, iteration)
            # Where the model fits badly whole steps go to and fro about the least misfit.
            calm, before = (0.5 * calm if normal.chi2 > before else calm), normal.chi2
            x_new = x + calm * share_of(normal.step, most) * normal.step
            moved = self._moved(pressed, x_new, normal.shifts, most)
            pressed_new = self._press(moved, float(x_new[STIFFNESS]), fixed)
            if pressed_new is None:
                most *= 0.25
                if most < 1e-4 * self.equations.model.rod.length:
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
            for r, p, shift in zip(self.equations.readings, pressed, normal.shifts, strict=True)
            if p is not None
        )

    def _moved(
        self, pressed: tuple[Pressed | None, ...], x: Array, shifts: Array, most: float
    ) -> tuple[Push | None, ...]:
        """The pushes that put each fixed point where the unknowns say."""
        return tuple(
            None if p is None else p.moved(target(r, x, shift), float(x[STIFFNESS]), most)
            for r, p, shift in zip(self.equations.readings, pressed, shifts, strict=True)
        )

    def _press(
        self, pushes: tuple[Push | None, ...], log_stiffness: float, fixed: Fixed
    ) -> tuple[Pressed | None, ...] | None:
        """Every touch solved and linearised; None if one of them has no equilibrium."""
        rod = self.equations.model.rod
        pressed = tuple(
            None if push is None else press(rod, reading.gravity, push, fixed, log_stiffness)
            for reading, push in zip(self.equations.readings, pushes, strict=True)
        )
        lost = any(p is None and push is not None for p, push in zip(pressed, pushes, strict=True))
        return None if lost else pressed


def _pushes(found: Solution) -> tuple[Push | None, ...]:
    return tuple(None if p is None else p.push for p in found.pressed)


def share_of(step: Array, most: float) -> float:
    """The share of a step that moves the point no further than that [m], nor the stiffness by more than a fifth."""
    far = float(np.linalg.norm(step[POINT]))
    return min(1.0, most / max(far, 1e-300), 0.2 / max(abs(float(step[STIFFNESS])), 1e-300))


def _distinct(found: Iterable[Solution | None]) -> list[Solution]:
    """Best first, each place once."""
    listed = sorted((solution for solution in found if solution is not None), key=lambda s: s.chi2)
    kept: list[Solution] = []
    for solution in listed:
        if all(np.linalg.norm(solution.x[POINT] - other.x[POINT]) > 1e-5 for other in kept):
            kept.append(solution)
    return kept
