"""Maximum likelihood: the contact without friction whose base wrench lies nearest to the reading, in its noise.

Every place that the scan of the paper's method finds is a start (`locate.py`); the fit itself is compiled (`fit.py`,
`spread.py`).
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.special import chdtri

from probedesign.estimator import fit, round_end, spread
from probedesign.estimator.estimate import Candidate
from probedesign.estimator.locate import candidates, starts
from probedesign.estimator.observation import Observation
from probedesign.frames import Array
from probedesign.rod import kernels
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.rod import Rod
from probedesign.rod.workspace import workspace

DOF = 3
"""Six channels, three unknowns: arclength, angle around the section, normal force."""
UNLIKELY = 1e-3
"""Chance of a true contact's misfit beyond which it is looked for elsewhere too."""
MOST_CHI2 = float(chdtri(DOF, UNLIKELY))
_SAME = 1e-5
"""Places closer than this, over the length, are one."""


def locate(rod: Rod, seen: Observation, near: Candidate | None = None) -> list[Candidate]:
    """The contacts of greatest likelihood.

    Args:
        rod: of the probe.
        seen: the reading.
        near: a neighbouring reading's place: only from there is then searched, everywhere only if nothing is there.
    """
    fitter = _Fitter(rod, seen)
    if near is not None:
        found = fitter.fit(near.tip, near.force_base, near.s_contact)
        if found is not None and fitter.explains(found):
            return [found]
    scanned = starts(rod, seen.gravity, seen.force, seen.wrench[3:6])
    places = fitter.places((tip, seen.force, s) for s, tip in scanned)
    if not any(fitter.explains(place) for place in places):
        # The scan may be too coarse where the probe gives way.
        exact = candidates(rod, seen.gravity, seen.force, seen.wrench[3:6])
        places += fitter.places((eq.tip, seen.force, eq.s_contact) for eq in exact)
    if rod.rounded_from is not None:
        places += fitter.at_round_end(places)
    return places or fitter.stalled


@dataclass
class _Fitter:
    """Fits contacts to one reading.

    Attributes:
        rod: of the probe.
        seen: the reading.
        stalled: where fits ended that found no least misfit but one that explains nothing.
    """

    rod: Rod
    seen: Observation
    stalled: list[Candidate] = field(default_factory=list)

    def explains(self, place: Candidate) -> bool:
        """Whether a contact there may well have made the reading."""
        return place.chi2 <= MOST_CHI2

    def places(self, guesses: Iterable[tuple[Array, Array, float]]) -> list[Candidate]:
        """What is found from each guess, each place once."""
        found: list[Candidate] = []
        for guess in guesses:
            place = self.fit(*guess)
            if place is not None and not any(self._same(place, other) for other in found):
                found.append(place)
        return found

    def at_round_end(self, places: list[Candidate]) -> list[Candidate]:
        """The touch of a round end, if it explains the reading where no touch of the flank close to it does."""
        end = round_end.touch(self.rod, self.seen)
        if end is None or not self.explains(end):
            return []
        near = (
            abs(p.s_contact - end.s_contact) <= 3.0 * (p.std_s + end.std_s)
            for p in places
            if self.explains(p)
        )
        return [] if any(near) else [end]

    def fit(self, tip: Array, force: Array, s: float) -> Candidate | None:
        """The fit from one guess; None if there is no least misfit near."""
        state, answer, seen = np.empty(fit.STATE), np.empty(spread.ANSWER), self.seen
        state[: fit.PUSH], state[fit.PUSH : fit.PLACE], state[fit.PLACE] = tip, force, s
        status = spread.locate_contact(
            self.rod.body, seen.gravity, seen.weight, seen.wrench, seen.whiten, 0.0, self.rod.flank_end,
            *self._scratch, state, answer,
        )  # fmt: skip
        if status == fit.LOST:
            return None
        place = self._candidate(state, answer)
        if status != fit.STALLED:
            return place
        if not self.explains(place):
            self.stalled.append(place)
        return None

    def _candidate(self, state: Array, answer: Array) -> Candidate:
        rod, gravity = self.rod, self.seen.gravity
        s, force, tip = float(state[fit.PLACE]), state[fit.PUSH : fit.PLACE], state[: fit.PUSH]
        p, size = answer[spread.POINT : spread.POINT + 3], math.sqrt(force @ force)
        reach = float(np.interp(s, rod.s, rod.radius)) / math.hypot(1.0, rod.taper_at(s))

        def shape() -> Equilibrium:
            return rod.solve(gravity, force, s, guess=tip)

        return Candidate(
            s_contact=s,
            std_s=float(answer[spread.STD]),
            p_contact_base=p,
            p_surface_base=p - reach / max(size, 1e-300) * force,
            force_base=force,
            cov_contact_base=answer[spread.COV : spread.COV + 9].reshape(3, 3),
            chi2=float(answer[spread.CHI2]),
            dof=DOF,
            lever=float(answer[spread.LEVER]),
            tip=tip,
            shape=shape,
        )

    def _same(self, a: Candidate, b: Candidate) -> bool:
        return abs(a.s_contact - b.s_contact) < _SAME * self.rod.length + 1e-2 * min(a.std_s, b.std_s)

    @cached_property
    def _scratch(self) -> tuple[Array, ...]:
        """What the kernel works in: load, sweep, nodes, columns, base, contact, turns, derivatives, the rest."""
        room = workspace(kernels.LOAD_COLUMNS, 0)
        return (np.zeros(kernels.LOAD), room.scratch, room.nodes, room.blocks, room.y, room.contact, room.turns,
                np.empty((15, fit.UNKNOWNS + 1)), np.empty(spread.WORK))  # fmt: skip
