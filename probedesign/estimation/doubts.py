"""What tolerances make of a reading: how far the probe that is may read and be bent beside the probe that was modelled.

A cause with one standard deviation moves the true reading of a touch by a column of D and the true point by one of Q
(`causes.py`). A reading is then known to Σ = noise + D Dᵀ, and the touch that lies nearest in that covariance answers
it by the gain G = P (Jᵀ Σ⁻¹ J)⁻¹ Jᵀ Σ⁻¹, so that the point is known to

    G noise Gᵀ + (G D - Q) (G D - Q)ᵀ.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from probedesign.estimation.causes import (
    Answers,
    answers_of,
    by_turns,
    free_answers,
    held_answers,
    parameters_of,
    turns_of,
)
from probedesign.estimation.estimate import Candidate
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.frames import Array
from probedesign.rod.contacts import contacts_at
from probedesign.rod.equilibrium import Equilibrium


@dataclass(frozen=True)
class Doubt:
    """Of one touch.

    Attributes:
        wrench: of the reading by each cause, one standard deviation a column, (6, j).
        point: of the touched point [m], (3, j).
        J: of the reading by (s, angle, magnitude), (6, 3).
        P: of the point by the same [m], (3, 3).
    """

    wrench: Array
    point: Array
    J: Array
    P: Array

    def cov_wrench(self, noise: Array) -> Array:
        """Of the reading, (6, 6), from that of its noise."""
        return np.asarray(noise + self.wrench @ self.wrench.T)

    def cov_point(self, noise: Array) -> Array:
        """Of the contact point [m²], (3, 3), to first order, from the covariance of the reading's noise, (6, 6)."""
        whiten = np.linalg.inv(np.linalg.cholesky(self.cov_wrench(noise)))
        white = whiten @ self.J
        scale = np.linalg.norm(white, axis=0)
        gain = (self.P / scale) @ np.linalg.pinv(white / scale) @ whiten
        off = gain @ self.wrench - self.point
        return np.asarray(gain @ noise @ gain.T + off @ off.T)


@dataclass(frozen=True)
class Doubts:
    """Of a probe under one gravity.

    Attributes:
        model: of the probe.
        gravity: base axes [m/s²], (3,).
        tolerances: how well the probe is known.
        still: of the free probe's reading by each cause, which a tare has taken away, (6, j).
    """

    model: ProbeModel
    gravity: Array
    tolerances: Tolerances
    still: Array

    @classmethod
    def of(cls, model: ProbeModel, gravity: Array, tolerances: Tolerances) -> "Doubts":
        """For a probe that can stand."""
        unborn = cls(model, gravity, tolerances, np.zeros(()))
        still = unborn._moved(free_answers(model.rod, gravity))[0][0] * tolerances.tared
        return cls(model, gravity, tolerances, still)

    @cached_property
    def drift(self) -> Array:
        """Covariance of the bias since the tare, at the base, (6, 6)."""
        step = self.tolerances.drift_steps**2 * self.model.averaging_samples
        return step * self.model.noise_base()

    def at(self, places: Sequence[Candidate]) -> list[Doubt | None]:
        """Of touches, one each; None where the probe cannot be held."""
        s = np.array([place.s_contact for place in places])
        force, tip = (np.array([getattr(place, name) for place in places]) for name in ("force_base", "tip"))
        contacts = contacts_at(self.model.rod, self.gravity, s, force, tip)
        if not contacts.ok.any():
            return [None] * len(places)
        known = contacts.rows(contacts.ok)
        wrench, point = self._moved(answers_of(known, self.model.rod, self.gravity))
        told = iter(
            zip(wrench - self.still, point, known.d_wrench_by_touch, known.d_point_by_touch, strict=True)
        )
        return [Doubt(*next(told)) if ok else None for ok in contacts.ok]

    def held(self, eq: Equilibrium) -> tuple[Array, Array]:
        """Of reading and point by each cause, (6, j) and (3, j), under a force that friction holds as it is."""
        load = self.model.rod.solve(self.gravity, eq.load[0:3], eq.s_contact, guess=eq.tip, columns="all")
        wrench, point = self._moved(held_answers(self.model.rod, load, self.gravity))
        return wrench[0] - self.still, point[0]

    @cached_property
    def _steps(self) -> tuple[Array, Array]:
        """One standard deviation of each cause, a row each: of the rod itself, and of how things are turned."""
        own = np.concatenate(list(parameters_of(self.model.rod, self.tolerances).values()))
        turns = np.concatenate(list(turns_of(self.gravity, self.tolerances).values()))
        return own[own.any(axis=1)], turns[turns.any(axis=1)]

    def _moved(self, answers: Answers) -> tuple[Array, Array]:
        """Of reading and point, told in the model's base frame, by every cause, (n, 6, j) and (n, 3, j)."""
        own, turns = self._steps
        by_pose = by_turns(answers, self.model, self.gravity)
        wrench = np.concatenate([answers.wrench[:, :, 3:] @ own.T, by_pose[0] @ turns.T], axis=2)
        return wrench, np.concatenate([answers.point[:, :, 3:] @ own.T, by_pose[1] @ turns.T], axis=2)
