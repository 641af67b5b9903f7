"""The touch that explains a reading best where the probe itself is known only to its tolerances."""

import math
from dataclasses import replace

from probedesign.estimation.estimate import Candidate
from probedesign.estimation.fit import PLACE
from probedesign.estimation.likelihood import Fitter, unknowns_of
from probedesign.estimation.locate import Scan
from probedesign.estimation.observation import Observation
from probedesign.estimation.weighing import Causes, Weighing

NEAR = 0.05
"""Of the length: how far from the place that they were told for doubts are still taken for the same."""
ROUNDS = 3
"""How often they are told anew at most."""


def locate(
    causes: Causes, seen: Observation, near: Candidate | None = None, scan: Scan | None = None
) -> list[Candidate]:
    """The contacts of greatest likelihood, weighed by the reading's noise and the probe's tolerances together.

    What the tolerances do to a reading depends on where it is touched, so they are weighed as at the place that noise
    and drift alone make likeliest, and once more where that leads elsewhere.

    Args:
        causes: of doubt, under the reading's gravity.
        seen: the reading, with its noise alone.
        near: a neighbouring reading's place, as for `likelihood.locate`.
        scan: likewise.
    """
    rod = causes.model.rod
    fitter = Fitter(rod, _drifted(seen, causes), scan or Scan.of(rod, seen))
    weighing = Weighing(causes, seen)
    place = fitter.likeliest() if near is None else unknowns_of(near)
    found: list[Candidate] = []
    for _ in range(ROUNDS):
        if place is None or not weighing.at(place):
            return found or fitter.locate(near)
        fitter.known_to(weighing.whiten)
        found = fitter.locate(near)
        best = _likeliest(found)
        if best is None or abs(best.s_contact - place[PLACE]) <= NEAR * rod.length:
            break
        place = unknowns_of(best)
    return [_told(weighing, candidate) for candidate in found]


def _drifted(seen: Observation, causes: Causes) -> Observation:
    """With the bias' drift in it, which has the shape of the noise."""
    share = float(causes.drift[0, 0] * seen.whiten[0, 0] ** 2)
    return replace(seen, whiten=seen.whiten / math.sqrt(1.0 + share))


def _likeliest(places: list[Candidate]) -> Candidate | None:
    return min(places, key=lambda candidate: candidate.chi2, default=None)


def _told(weighing: Weighing, place: Candidate) -> Candidate:
    """With the covariance of its point as tolerances make it; its bow as it was."""
    if not weighing.at(unknowns_of(place)):
        return place
    linear = weighing.cov_point
    return replace(place, cov_contact_base=place.cov_contact_base - place.cov_linear_base + linear,
                   cov_linear_base=linear)  # fmt: skip
