"""The touch that explains a reading best where the probe itself is known only to its tolerances."""

from dataclasses import replace

from probedesign.estimator import likelihood
from probedesign.estimator.doubts import Doubts
from probedesign.estimator.estimate import Candidate
from probedesign.estimator.observation import Observation
from probedesign.frames import Array

NEAR = 0.05
"""Of the length: how far from the place that they were told for doubts are still taken for the same."""
ROUNDS = 3
"""How often they are told anew at most."""


def locate(doubts: Doubts, seen: Observation, near: Candidate | None = None) -> list[Candidate]:
    """The contacts of greatest likelihood, weighed by the reading's noise and the probe's tolerances together.

    What the tolerances do to a reading depends on where it is touched, so they are weighed as at the place that the
    noise alone makes likeliest, and once more where that leads elsewhere.

    Args:
        doubts: of the probe under the reading's gravity.
        seen: the reading, with its noise alone.
        near: a neighbouring reading's place, as for `likelihood.locate`.
    """
    rod, noise = doubts.model.rod, seen.cov + doubts.drift
    place = near or likelihood.rough(rod, seen)
    found: list[Candidate] = []
    for _ in range(ROUNDS):
        doubt = doubts.at([place])[0] if place is not None else None
        if place is None or doubt is None:
            return found or likelihood.locate(rod, seen, near)
        found = likelihood.locate(rod, seen.known_to(doubt.cov_wrench(noise)), near)
        best = min(found, key=lambda candidate: candidate.chi2, default=None)
        if best is None or abs(best.s_contact - place.s_contact) <= NEAR * rod.length:
            break
        place = best
    return _told(doubts, found, noise)


def _told(doubts: Doubts, found: list[Candidate], noise: Array) -> list[Candidate]:
    """With the covariance of each point as tolerances make it; its bow as it was."""
    of = doubts.at(found) if found else []
    return [
        candidate
        if doubt is None
        else replace(
            candidate,
            cov_contact_base=candidate.cov_contact_base - candidate.cov_linear_base + linear,
            cov_linear_base=linear,
        )
        for candidate, doubt in zip(found, of, strict=True)
        for linear in [candidate.cov_linear_base if doubt is None else doubt.cov_point(noise)]
    ]
