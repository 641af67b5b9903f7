"""Identification from end to end: one campaign and one probe in, numbers with their intervals out."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

from probedesign.campaign import Campaign
from probedesign.campaign.reading import check_probe
from probedesign.errors import InputError
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.identification import report
from probedesign.identification.beforehand import disproved
from probedesign.identification.consistency import contradiction, hardly_counted
from probedesign.identification.hedged import hedged
from probedesign.identification.observability import Untold, untold
from probedesign.identification.parameters import DEFAULT, Shared, asked_for, parts_of
from probedesign.identification.reading import trials_of, weighed_of
from probedesign.identification.result import Identification
from probedesign.identification.robust import outliers, weights
from probedesign.identification.solver import Fit, Problem, fit
from probedesign.identification.start import first_point, standing
from probedesign.identification.trial import Trial
from probedesign.identification.weighed import Weighed

APART = 3.0
"""So many times more or less than designed, E is doubted: published values of one resin, 1.6 to 3.2 MPa, differ by
two, and a factor on all forces passes for a factor on E."""
PATIENT = 3.0
"""Where the search begins a direction may be so many times worse told than at its end: the guess is rough there."""


@dataclass(frozen=True)
class Data:
    """What is known of one probe's tests.

    Attributes:
        shared: what they share.
        trials: the tests.
        weighed: the probe on scales.
        where: names the data in messages.
        notes: what was noticed on the way.
    """

    shared: Shared
    trials: tuple[Trial, ...]
    weighed: Weighed | None
    where: str
    notes: tuple[str, ...] = ()


def data_of(campaign: Campaign, model: ProbeModel, flange_volume: float) -> Data:
    """A campaign as the fit sees it.

    Args:
        campaign: that was read.
        model: of the probe as designed.
        flange_volume: of the printed flange below the base [m³].

    Raises:
        InputError: it is of another probe.
    """
    check_probe(campaign, model)
    shared = Shared(model, Tolerances.of(model), campaign.std_base, campaign.std_tilt)
    trials, unused = trials_of(campaign, shared)
    return Data(shared, tuple(trials), weighed_of(campaign, flange_volume), str(campaign.folder),
                (*campaign.notes, *unused))  # fmt: skip


def identify(data: Data, names: Sequence[str] = DEFAULT) -> Identification:
    """Least squares on the full rod.

    Args:
        data: from `data_of`.
        names: what is asked for, of `unknowns.ASKABLE`.

    Returns:
        The numbers; what the tests do not tell is left at the design's value and says so.

    Raises:
        InputError: an unknown name, too few tests, or tests that tell nothing of what is asked for.
    """
    begun = time.perf_counter()
    names = asked_for(names)
    data, notes = _bearable(data, names)
    _check_enough(data, names)
    found, asked, given_up = _search(data, names)
    quantile = report.quantile_of(found)
    numbers, correlation, correlated = report.found_of(found, asked, given_up, names, quantile)
    shifts = report.shifts_of(found, asked)
    numbers = hedged(report.counted_in_all(numbers, shifts, quantile), data.shared.model.rod)
    off = outliers(found.point.groups, found.scales)
    problem, groups = found.point.problem, found.point.groups
    whole = Identification(
        found.result, data.shared.model.name, data.shared.model.fingerprint, data.where, len(data.trials),
        sum(len(group.r) for group in groups), problem.size, numbers, correlation, correlated,
        found.noise, quantile, report.outliers_of(off), shifts,
        (*notes, *(one.words for one in given_up), *hardly_counted(groups, off), *_remarks(found)),
        report.residuals_of(found), time.perf_counter() - begun,
    )  # fmt: skip
    why = contradiction(groups, off, found.noise) or disproved(found)
    return whole.contradicted(why) if why else whole


def _search(data: Data, names: Sequence[str]) -> tuple[Fit, tuple[str, ...], list[Untold]]:
    """The fit of all that the tests tell of `names`, and what they do not tell."""
    asked, given_up = tuple(names), list[Untold]()
    while asked:
        problem = Problem(data.shared, data.trials, data.weighed, data.shared.prior_of(asked))
        start = first_point(problem, "E" in asked)
        assert start is not None  # `_bearable` saw to it, test by test
        lost = untold(start, weights(start.groups, {}), asked, PATIENT)
        if lost is None:
            found = fit(problem, start)
            lost = untold(found.point, found.weight, asked)
            if lost is None:
                return found, asked, given_up
        given_up.append(lost)
        asked = tuple(name for name in asked if name != lost.name)
    raise InputError(
        f"{data.where}: too few tests, or too weak ones: {'; '.join(one.words for one in given_up)}"
    )


def _bearable(data: Data, names: Sequence[str]) -> tuple[Data, tuple[str, ...]]:
    """Without the tests that the rod never bears, with a line for each."""
    if not data.trials:
        raise InputError(f"{data.where}: no test can be used{_first(data.notes)}")
    problem = Problem(data.shared, data.trials, data.weighed, data.shared.prior_of(names))
    free = "E" in names
    if first_point(problem, free) is not None:
        return data, data.notes
    kept, lost = standing(problem, free)
    lines = tuple(f"{one.name}: not used: the probe gives way under it" for one in lost)
    if not kept or first_point(replace(problem, trials=tuple(kept)), free) is None:
        raise InputError(
            f"{data.where}: the probe gives way in its tests, whatever E; is it the right design, and are forces "
            "in their column's unit?"
        )
    return replace(data, trials=tuple(kept)), (*data.notes, *lines)


def _first(notes: Sequence[str]) -> str:
    return f": {notes[0]}" if notes else ""


def _check_enough(data: Data, names: Sequence[str]) -> None:
    """Refuse what counting alone shows to be too little."""
    told = sum(
        6 * (one.wrench_base is not None) + 3 * len(one.marker_s) + 3 * (one.p_touch_world is not None)
        + bool(one.sag == one.sag) + (one.slides and one.s_contact == one.s_contact) + one.touched
        for one in data.trials
    ) + (data.weighed is not None)  # fmt: skip
    wanted = len(parts_of(names)) + sum(one.own for one in data.trials)
    if told < wanted:
        raise InputError(
            f"{data.where}: too few tests for {', '.join(names)}: {told} numbers are measured for {wanted} unknowns"
        )


def _remarks(found: Fit) -> list[str]:
    """What a user should know of a fit."""
    factor = math.exp(found.point.guess.x[0])
    doubted = not 1.0 / APART < factor < APART
    doubts = [
        f"E is {factor:.3g} times the design's: are forces and moments in their columns' units?"
    ] * doubted
    return doubts + [
        f"{one.kind} scatter {one.scale:.2g} times as much as stated; the intervals count that"
        for one in found.noise
        if one.measured
    ]
