"""Whether what was stated beforehand, or stands alone, is borne out by all the rest: the pose of the base, the
dimensions as designed, a weighing, a sag.

These are trusted as they were stated, so a gross error in one would pull the numbers unseen. Each is told from what
the fit makes of it, over how far it may lie off with all else taken into account: with r its misfits over their
standard deviations and V = I - J C Jᵀ what the fit leaves of their unit variance, d² = rᵀ V⁻¹ r is χ².
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from probedesign.frames import Array
from probedesign.identification.parameters import BIAS, FALL, PRINT, SEAT_SHIFT, SEAT_TURN, SHIFT, TURN
from probedesign.identification.robust import DOUBTED
from probedesign.identification.solver import Fit

LEFT = 0.02
"""Share of its variance that a misfit must keep to be judged: of less the other readings say nothing."""
PRIORS = (
    ("the design's shear modulus", slice(1, 2), "shear_modulus_mpa in the design, and its tolerance"),
    ("the design's density", slice(2, 3), "density_kg_m3 in the design, its tolerance, and the weighing"),
    ("the base's rotation", TURN, "rotation_world_deg and std_deg in campaign.toml, or the pose of each test"),
    ("the base's place", SHIFT, "p_world_mm and std_mm in campaign.toml, or the pose of each test"),
    ("the direction of gravity", FALL, "world_m_s2 in campaign.toml, and the tolerance gravity_deg"),
    ("the probe's seat on the sensor", slice(SEAT_TURN.start, SEAT_SHIFT.stop),
     "the frame of wrenches.csv, and the tolerances base_mm, tilt_deg and clocking_deg"),
    ("the sensor's bias", BIAS, "when it was zeroed: before the probe is mounted, or with it hanging free"),
    ("the dimensions as designed", slice(PRINT, None), "what was printed: measure it, or raise the tolerances"),
)  # fmt: skip
"""What is known of the shared vector beforehand, in words, and where to look where that does not hold."""
ALONE = {
    "sags": ("the sag of {}", "tip_sag_mm: its sign, its unit and std_sag_mm"),
    "scales": ("the weighing", "mass_g, std_g and of in campaign.toml"),
    "places": ("where the load acts in {}", "s_contact_mm and std_s_mm"),
}
"""Kinds of readings that are trusted as they were stated."""


@dataclass(frozen=True)
class Stated:
    """Something that was stated, against all the rest.

    Attributes:
        words: what.
        look: where to look.
        chance: of lying so far off.
        deviations: how far off, in standard deviations of one number.
    """

    words: str
    look: str
    chance: float
    deviations: float


def disproved(fit: Fit) -> str:
    """What was stated and all the rest contradicts, with where to look; empty if there is nothing.

    Args:
        fit: the search's end.
    """
    stated = [*_priors(fit), *_alone(fit)]
    worst = min(stated, key=lambda one: one.chance, default=None)
    if worst is None or worst.chance >= DOUBTED / len(stated):
        return ""
    return (
        f"{worst.words}, as stated, lies {worst.deviations:.3g} standard deviations off what all the rest says; look "
        f"at {worst.look}"
    )


def _priors(fit: Fit) -> Iterator[Stated]:
    """Of the shared vector."""
    problem = fit.point.problem
    active = np.flatnonzero(problem.active)
    std = problem.prior[active]
    for words, part, look in PRIORS:
        at = np.flatnonzero(np.isin(active, np.arange(problem.shared.size)[part]) & np.isfinite(std))
        if len(at):
            left = np.eye(len(at)) - fit.cov[np.ix_(at, at)] / np.outer(std[at], std[at])
            yield from _judged(words, look, fit.point.prior_misfit[at], left)


def _alone(fit: Fit) -> Iterator[Stated]:
    """Of readings."""
    problem = fit.point.problem
    shared = int(problem.active.sum())
    at = {bent.trial.name: place for bent, place in zip(fit.point.bents, problem.slices, strict=True)}
    for group in fit.point.groups:
        if group.kind in ALONE:
            words, look = ALONE[group.kind]
            rows = np.zeros((len(group.r), problem.size))
            rows[:, :shared] = group.J[:, problem.active]
            if group.test in at:
                rows[:, at[group.test]] = group.own
            yield from _judged(
                words.format(group.test), look, group.r, np.eye(len(rows)) - rows @ fit.cov @ rows.T
            )


def _judged(words: str, look: str, r: Array, left: Array) -> Iterator[Stated]:
    """As a χ² of those directions that the rest says something of, if there are any."""
    sizes, ways = np.linalg.eigh(0.5 * (left + left.T))
    seen = sizes > LEFT
    if seen.any():
        d = float(np.sum((ways.T @ r)[seen] ** 2 / sizes[seen]))
        yield Stated(words, look, float(chi2.sf(d, int(seen.sum()))), d**0.5)
