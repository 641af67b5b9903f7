"""Maximum likelihood: the contact without friction whose base wrench lies nearest to the reading, in its noise.

Where it may lie one integration tells (`trace.py`); where that leads to no place at all, the scan of the paper's method
does (`locate.py`). A reading for which the trace leads to places that do not explain it is not searched further: of
2000 such readings of touches with a bias the scan explained one, of 61,000 estimates without one another (counted
once, by hand, on the paper's probes), and it costs some thirty times as much. The fit itself is compiled (`fit.py`,
`spread.py`, `everywhere.py`).
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.special import chdtri

from probedesign.estimation import everywhere, fit, round_end, spread
from probedesign.estimation.estimate import Candidate
from probedesign.estimation.locate import Scan
from probedesign.estimation.observation import Observation
from probedesign.frames import Array
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.rod import Rod

DOF = 3
"""Six channels, three unknowns: arclength, angle around the section, normal force."""
UNLIKELY = 1e-3
"""Chance of a true contact's misfit beyond which it is looked for elsewhere too."""
MOST_CHI2 = float(chdtri(DOF, UNLIKELY))
_SAME = 1e-5
"""Places closer than this, over the length, are one."""
_ALIKE = 0.05
"""Likewise over a standard deviation; a fit ends within a hundredth or so."""
_UNKNOWNS = slice(everywhere.FOUND, everywhere.TOLD)
_NONE = np.empty((0, everywhere.ROW))


def locate(
    rod: Rod, seen: Observation, near: Candidate | None = None, scan: Scan | None = None
) -> list[Candidate]:
    """The contacts of greatest likelihood.

    Args:
        rod: of the probe.
        seen: the reading.
        near: a neighbouring reading's place: only from there is then searched, everywhere only if nothing is there.
        scan: of the reading, if there is one already.
    """
    return Fitter(rod, seen, scan or Scan.of(rod, seen)).locate(near)


@dataclass
class Fitter:
    """Fits contacts to one reading.

    Attributes:
        rod: of the probe.
        seen: the reading.
        scan: of it.
        stalled: where fits ended that found no least misfit but one that explains nothing.
    """

    rod: Rod
    seen: Observation
    scan: Scan
    stalled: list[Candidate] = field(default_factory=list)

    def __post_init__(self) -> None:
        """The memory that the kernels work in."""
        self._work = np.empty(everywhere.room_for(len(self.rod.body.knots)))
        self._rows = _NONE
        self._scanned: list[Candidate] = []

    @property
    def _reading(self) -> tuple[Any, ...]:
        """What every fit is told."""
        seen = self.seen
        return self.rod.body, self.rod.flank_end, seen.gravity, seen.weight, seen.wrench, seen.whiten

    def known_to(self, whiten: Array) -> None:
        """From now on the reading is known otherwise: see `Observation.whiten`, (6, 6)."""
        self.seen, self.stalled = replace(self.seen, whiten=whiten), []

    def likeliest(self) -> Array | None:
        """The unknowns of the likeliest of the places that one integration tells or else the scan, (STATE,); None if
        neither tells any. One that explains nothing as the reading is known may do as it is known to tolerances."""
        rows = [row for row in self._everywhere(rough=True) if row[everywhere.FITTED] <= fit.STALLED]
        if rows:
            found: Array = min(rows, key=_misfit)[_UNKNOWNS]
            return found
        places = self._from_scan()
        if places:
            return unknowns_of(min(places, key=lambda place: place.chi2))
        least = self.scan.likeliest
        return None if least is None else np.concatenate([least[1], self.scan.force, (least[0],)])

    def locate(self, near: Candidate | None = None) -> list[Candidate]:
        """As the function of that name."""
        if near is not None:
            found = self.fit(near.tip, near.force_base, near.s_contact)
            if found is not None and self.explains(found):
                return [found]
        places = self.traced() or self.scanned()
        if self.rod.rounded_from is not None:
            places += self.at_round_end(places)
        return places or self.stalled

    def explains(self, place: Candidate) -> bool:
        """Whether a contact there may well have made the reading."""
        return place.chi2 <= MOST_CHI2

    def traced(self) -> list[Candidate]:
        """What is found from wherever the trace says."""
        return self._distinct(self._place(row) for row in self._everywhere(rough=False))

    def scanned(self) -> list[Candidate]:
        """What is found from wherever the scan along the probe says."""
        places = self._from_scan()
        if not any(self.explains(place) for place in places):
            # The scan may be too coarse where the probe gives way.
            exact = self.scan.candidates
            places += self.places((eq.tip, self.scan.force, eq.s_contact) for eq in exact)
        return places

    def _from_scan(self) -> list[Candidate]:
        """Fits from wherever the scan says or, where it was asked before, from what was fitted there."""
        before = [(place.tip, place.force_base, place.s_contact) for place in self._scanned]
        starts = ((tip, self.scan.force, s) for s, tip in self.scan.starts)
        self._scanned = self.places(before or starts)
        return list(self._scanned)

    def _everywhere(self, rough: bool) -> Array:
        """Fits from wherever the trace says or, where it was asked before, from what was fitted there, (n, ROW)."""
        rows = np.empty((everywhere.MOST, everywhere.ROW))
        count = everywhere.fit_contacts(*self._reading, False, self._rows, rough, self._work, rows)
        self._rows = rows[:count]
        return self._rows

    def places(self, guesses: Iterable[tuple[Array, Array, float]]) -> list[Candidate]:
        """What is found from each guess, each place once."""
        return self._distinct(self.fit(*guess) for guess in guesses)

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
        rows = np.empty((1, everywhere.ROW))
        state = rows[0, _UNKNOWNS]
        state[: fit.PUSH], state[fit.PUSH : fit.PLACE], state[fit.PLACE] = tip, force, s
        everywhere.fit_contacts(*self._reading, True, _NONE, False, self._work, rows)
        return self._place(rows[0])

    def _place(self, row: Array) -> Candidate | None:
        """What a fit has found, if it is a least misfit."""
        if row[everywhere.FITTED] == fit.LOST:
            return None
        place = self._candidate(row[_UNKNOWNS], row[everywhere.TOLD : everywhere.FROM])
        if row[everywhere.FITTED] != fit.STALLED:
            return place
        if not self.explains(place):
            self.stalled.append(place)
        return None

    def _candidate(self, state: Array, answer: Array) -> Candidate:
        rod, gravity = self.rod, self.seen.gravity
        s, force, tip = float(state[fit.PLACE]), state[fit.PUSH : fit.PLACE], state[: fit.PUSH]
        chi2, std, lever = answer[: spread.POINT].tolist()

        def shape() -> Equilibrium:
            return rod.solve(gravity, force, s, guess=tip)

        return Candidate(
            s_contact=s,
            std_s=std,
            p_contact_base=answer[spread.POINT : spread.COV],
            p_surface_base=answer[spread.SURFACE : spread.LINEAR],
            force_base=force,
            cov_contact_base=answer[spread.COV : spread.SURFACE].reshape(3, 3),
            cov_linear_base=answer[spread.LINEAR :].reshape(3, 3),
            chi2=chi2,
            dof=DOF,
            lever=lever,
            tip=tip,
            shape=shape,
        )

    def _distinct(self, places: Iterable[Candidate | None]) -> list[Candidate]:
        """Each place once."""
        found: list[Candidate] = []
        for place in places:
            if place is not None and not any(self._same(place, other) for other in found):
                found.append(place)
        return found

    def _same(self, a: Candidate, b: Candidate) -> bool:
        return abs(a.s_contact - b.s_contact) < _SAME * self.rod.length + _ALIKE * min(a.std_s, b.std_s)


def unknowns_of(place: Candidate) -> Array:
    """As the fit has them, (STATE,)."""
    return np.concatenate([place.tip, place.force_base, (place.s_contact,)])


def _misfit(row: Array) -> float:
    return float(row[everywhere.TOLD + spread.CHI2])
