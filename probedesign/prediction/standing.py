"""Touches whose point of the surface stands still in the world: how reading and centreline answer to it, and to what
differs between a probe and its model."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from probedesign.estimation.causes import Answers, answers_of, d_slope, free_answers, moved_by
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.frames import Array
from probedesign.rod.contacts import Contacts
from probedesign.rod.rod import Rod

_LOG_E, _LOG_G = 3, 4  # columns of `Answers`


def surface_of(rods: Sequence[Rod], contacts: Contacts) -> Array:
    """Touched points of the surface, base axes [m], (n, 3); of one rod, or of one a touch."""
    distance, push = _distance(rods, contacts), contacts.force / contacts.magnitude[:, None]
    return np.asarray(contacts.batch.p_contact_base - distance[:, None] * push)


@dataclass(frozen=True)
class Standing:
    """n touches of the model's rod.

    Attributes:
        model: the probe.
        gravity: base axes [m/s²], (3,).
        contacts: of it, with all columns.
    """

    model: ProbeModel
    gravity: Array
    contacts: Contacts

    @cached_property
    def by_place(self) -> Array:
        """Of the base wrench by the touched point, (n, 6, 3)."""
        return np.asarray(self.contacts.d_wrench_by_touch @ self._touch_by_point)

    @cached_property
    def centre_by_place(self) -> Array:
        """Of the centreline's point by the touched one, (n, 3, 3)."""
        return np.asarray(self.contacts.d_point_by_touch @ self._touch_by_point)

    @cached_property
    def by_stiffness(self) -> tuple[Array, Array]:
        """Of base wrench and centreline's point by a common factor's logarithm, the touched point held, (n, 6) and
        (n, 3)."""
        wrench, surface, centre = (
            columns[:, :, _LOG_E] + columns[:, :, _LOG_G]
            for columns in (self._answers.wrench, self._surface.point, self._answers.point)
        )
        held = [part - np.einsum("nij,nj->ni", by, surface) for part, by in
                ((wrench, self.by_place), (centre, self.centre_by_place))]  # fmt: skip
        return held[0], held[1]

    def misled(self, tolerances: Tolerances) -> dict[str, tuple[Array, Array]]:
        """Of each cause beside noise, drift and robot, by each of its unit normals: what the reading has more than
        the model has for the same touched point, and how far the centreline's point is told amiss on top of what the
        reading does, (n, 6, j) and (n, 3, j)."""
        free = free_answers(self.model.rod, self.gravity)
        seen, centre, still = (
            moved_by(answers, self.model, self.gravity, tolerances, hung=True)
            for answers in (self._surface, self._answers, free)
        )
        found = {}
        for name, (wrench, surface) in seen.items():
            tared = still[name][0] * tolerances.tared
            found[name] = (
                wrench - tared - self.by_place @ surface,
                self.centre_by_place @ surface - centre[name][1],
            )
        return found

    @cached_property
    def _answers(self) -> Answers:
        return answers_of(self.contacts, self.model.rod, self.gravity)

    @cached_property
    def _surface(self) -> Answers:
        """The same of the touched point of the surface."""
        rod, c = self.model.rod, self.contacts
        distance, push = _distance([rod], c), c.force / c.magnitude[:, None]
        turned = self._answers.force / c.magnitude[:, None, None]
        nearer = push[:, :, None] * _d_distance(rod, c)[:, None, :]
        point = self._answers.point - distance[:, None, None] * turned - nearer
        return replace(self._answers, point=point, p=surface_of([rod], c))

    @cached_property
    def _touch_by_point(self) -> Array:
        """Of (s_contact, angle, magnitude) by the touched point, (n, 3, 3)."""
        c, size = self.contacts, self.contacts.magnitude[:, None]
        push = c.force / size
        d_push = c.d_touch / size[:, :, None]
        d_push[:, :, 2] -= push / size
        d_surface = c.d_point_by_touch - _distance([self.model.rod], c)[:, None, None] * d_push
        d_surface[:, :, 0] += np.sin(c.slope)[:, None] * push
        scale = np.linalg.norm(d_surface, axis=1)
        return np.asarray(np.linalg.inv(d_surface / scale[:, None, :]) / scale[:, :, None])


def _distance(rods: Sequence[Rod], contacts: Contacts) -> Array:
    """From the centreline's point to the touched one [m], (n,)."""
    if len(rods) == 1:
        radius = np.interp(contacts.s, rods[0].s, rods[0].radius)
    else:
        radius = np.array([np.interp(s, rod.s, rod.radius) for s, rod in zip(contacts.s, rods, strict=True)])
    return np.asarray(np.cos(contacts.slope) * radius)


def _d_distance(rod: Rod, contacts: Contacts) -> Array:
    """Of it by the parameters of `Answers`, (n, j)."""
    s, n = contacts.s, np.arange(len(contacts.s))
    i = np.clip(np.searchsorted(rod.s, s) - 1, 0, len(rod.s) - 2)
    share = (s - rod.s[i]) / (rod.s[i + 1] - rod.s[i])
    found = -np.sin(contacts.slope)[:, None] * d_slope(rod, contacts)
    found *= np.interp(s, rod.s, rod.radius)[:, None]
    found[n, 7 + i] += np.cos(contacts.slope) * (1.0 - share) * rod.radius[i]
    found[n, 8 + i] += np.cos(contacts.slope) * share * rod.radius[i + 1]
    return np.asarray(found)
