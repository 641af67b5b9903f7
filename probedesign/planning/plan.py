"""Choice of the tests that determine the requested parameters best in the time available.

The information of a test on the parameters, its own unknowns marginalised, is that of `identify`: the whitened
Jacobian of its residuals at the designed probe. Tests are chosen one after the other by the gain in D-optimality,
½ log det of the marginal information on the requested parameters, per minute; then chosen tests are exchanged for
others as long as that increases it. Source: V. Fedorov, Theory of Optimal Experiments, 1972.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import WALK_SECONDS
from probedesign.identification.fit_checks import conditional_estimate, unobservable_direction
from probedesign.identification.identify import TEST_SECONDS, data_of
from probedesign.identification.parameters import OWNER, PARAMETERS, ParameterValues, columns_of
from probedesign.identification.residuals import MassMeasurement, ResidualBlock, poisson_block
from probedesign.identification.solver import (
    Fit,
    LeastSquaresProblem,
    Linearization,
    linearize,
    solvable_tests,
    start_nuisance,
)
from probedesign.planning.candidates import TOUCH_PLACES, Bench, CandidateTest, Instruments, SetUp

DEFAULT = ("E", "G", "root", "diameters")  #: Parameters that a plan is for unless others are requested.
PREPARATION = 20.0  #: Time to mount the probe, to let sensor and resin settle and to zero [min] (assumed).
HELD_OUT = 4  #: Touches that a plan holds out for `validate`, if the bench can touch and the time allows it.
#: Gain of ½ log det below which a further test is not proposed: it narrows no interval by more than 1 %.
MIN_GAIN = 0.01
MAX_EXCHANGES = 10
ENOUGH = 1.1  #: Ratio of a standard deviation to the final one from which on further tests are not necessary.
#: Tests on the sensor between two free hangs at most: with 4 minutes each the bias has walked for half an hour
#: (assumed).
HANG_EVERY = 8
LEVEL = 0.95
#: Measurements away from the sensor come first. The others keep one set-up after the other.
ORDER: tuple[SetUp, ...] = ("weighing", "calipers", "hang", "weight", "turned", "touch")


@dataclass(frozen=True)
class ExpectedInterval:
    """Interval of a parameter that `identify` will state, expected before the tests."""

    name: str  #: of the parameter or its component.
    unit: str  #: of the values; empty for plain factors.
    #: standard deviation with the design's dimensions [unit], relative for a logarithm; None if the tests do not
    #: determine the parameter.
    std: float | None
    low: float | None  #: low, high: ends of the 95 % interval about the design's value [unit]; None as well.
    high: float | None
    std_of_print: float | None  #: standard deviation with the dimensions as uncertain as they are after the tests.
    relative: bool  #: whether both standard deviations are relative.


@dataclass(frozen=True, eq=False)
class PlannedTest:
    """A test of a plan."""

    candidate: CandidateTest  #: what to do.
    minutes: float  #: since the start when it is done [min].
    expected: tuple[ExpectedInterval, ...]  #: intervals after it; the same as before for a test that is held out.


@dataclass(frozen=True, eq=False)
class Plan:
    """A plan of a campaign."""

    bench: Bench  #: the probe and its instruments.
    names: tuple[str, ...]  #: requested parameters.
    minutes: float  #: time available [min].
    tests: tuple[PlannedTest, ...]  #: in the order to be made.
    unobservable: tuple[str, ...]  #: why a requested parameter is not determined, one line each.

    @property
    def expected(self) -> tuple[ExpectedInterval, ...]:
        """Intervals after all tests."""
        return self.tests[-1].expected

    @property
    def enough(self) -> PlannedTest:
        """The first test after which every standard deviation is at most a tenth above its final value."""
        final = [interval.std for interval in self.expected]
        for test in self.tests:
            now = [interval.std for interval in test.expected]
            if all(b is None or (a is not None and a <= ENOUGH * b) for a, b in zip(now, final, strict=True)):
                return test
        return self.tests[-1]

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user, each one line."""
        notes = list(self.unobservable)
        if self.identified != self.names:
            notes.append("The calipers determine the diameters: write them into the design with `probedesign "
                         f"measured`, and identify --for {','.join(self.identified)}.")  # fmt: skip
        if assumed := ", ".join(self.bench.model.assumptions):
            notes.append(f"assumed of the design: {assumed}")
        return tuple(notes)

    @property
    def identified(self) -> tuple[str, ...]:
        """Parameters that `identify` estimates from the tests: all but the diameters, where calipers measure them."""
        calipers = any(candidate.set_up == "calipers" for candidate in self.candidates)
        return tuple(name for name in self.names if not (name == "diameters" and calipers)) or self.names

    @property
    def candidates(self) -> tuple[CandidateTest, ...]:
        """What is to be done, in order."""
        return tuple(test.candidate for test in self.tests)

    def as_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {
            "schema": 1,
            "probe": self.bench.model.name,
            "fingerprint": self.bench.model.fingerprint,
            "for": list(self.names),
            "minutes": self.minutes,
            "minutes_planned": self.tests[-1].minutes,
            "enough_after": self.enough.candidate.name,
            "tests": [
                {"name": test.candidate.name, "set_up": test.candidate.set_up, "what": test.candidate.words,
                 "use": "validate" if test.candidate.held_out else "identify",
                 "minutes": test.candidate.minutes, "minutes_since_start": test.minutes,
                 "expected": [vars(interval) for interval in test.expected]}
                for test in self.tests
            ],
            "unobservable": list(self.unobservable),
        }  # fmt: skip


# information


@dataclass(frozen=True, eq=False)
class Information:
    """Information of all candidates on the parameters."""

    bench: Bench  #: probe and instruments.
    candidates: tuple[CandidateTest, ...]  #: all of them.
    flange_volume: float  #: of printed material that is weighed with the flexible part [m³].
    #: whether the candidates have their times: the bias then walks from one to the next, as in `identify`.
    scheduled: bool = False

    @cached_property
    def whole(self) -> Linearization:
        """The tests that `identify` can solve at the designed probe, linearised by every parameter."""
        model = self.bench.model
        data = data_of(self.bench.campaign(list(self.candidates)), model, self.flange_volume)
        common, tests = data.common, data.tests
        if not self.scheduled:
            # The order is chosen last: until then the bias walks in each test by itself, between two tests.
            common = replace(common, walk_seconds=())
            walked = common.tolerances.walk_steps**2 * TEST_SECONDS / WALK_SECONDS
            drift = walked * model.averaging_samples * model.noise_base()
            tests = tuple(
                replace(test, epoch=0, cov_wrench=None if test.cov_wrench is None else test.cov_wrench + drift)
                for test in tests
            )
        every = LeastSquaresProblem(common, tests, None, np.ones(common.size))
        solvable = tuple(solvable_tests(every, free_E=False)[0])
        values = ParameterValues(common, np.zeros(common.size))
        return linearize(replace(every, tests=solvable), values, start_nuisance(solvable, model.rod), every=True)

    @cached_property
    def blocks(self) -> dict[str, tuple[ResidualBlock, ...]]:
        """Residuals of each candidate by its name."""
        blocks: dict[str, list[ResidualBlock]] = {candidate.name: [] for candidate in self.candidates}
        for block in self.whole.blocks:
            blocks[block.test].append(block)
        balance = self.bench.instruments.balance
        if "weighing" in blocks and balance is not None:
            mass = MassMeasurement(0.0, balance, self.flange_volume).block(self.whole.values)
            blocks["weighing"] = [mass._replace(r=0.0 * mass.r, residual=0.0 * mass.residual)]
        std, rod, step = self.bench.instruments.calipers, self.bench.model.rod, 1e-5
        if "calipers" in blocks and std is not None:
            # Diameters measured at the marks; derivatives by differences, as they are linear in their logarithms.
            s, common = np.array([0.02, *TOUCH_PLACES]) * rod.length, self.whole.problem.common
            J = np.zeros((len(s), common.size))
            for column in (*columns_of(["diameters"]), *range(common.size)[common.print_columns]):
                x = np.zeros(common.size)
                x[column] = step
                J[:, column] = -2.0 * (ParameterValues(common, x).rod.radius_at(s) - rod.radius_at(s)) / (step * std)
            blocks["calipers"] = [ResidualBlock("", "calipers", 0, np.zeros(len(s)), J, np.zeros(len(s)))]
        return {name: tuple(of_candidate) for name, of_candidate in blocks.items()}

    def matrix(self, name: str, active: NDArray[np.intp]) -> Array:
        """Return the information of one candidate on the active parameters, its own unknowns marginalised."""
        every = np.concatenate([block.J for block in self.blocks[name]])
        J, of_test = every[:, active], every[:, self.whole.problem.common.size :]
        if of_test.shape[1]:
            scaled = of_test / np.maximum(np.linalg.norm(of_test, axis=0), 1e-300)
            J = J - scaled @ np.linalg.lstsq(scaled, J, rcond=None)[0]
        return np.asarray(J.T @ J)

    def expected(
        self, chosen: Sequence[CandidateTest], names: Sequence[str]
    ) -> tuple[tuple[ExpectedInterval, ...], tuple[str, ...]]:
        """Return the intervals that `identify` would state of these tests, and why parameters are not determined."""
        requested, why = tuple(names), list[str]()
        common = self.whole.problem.common
        inside = {candidate.name for candidate in chosen}
        solved = tuple(test for test in self.whole.tests if test.measured.name in inside)
        blocks = tuple(block for candidate in chosen for block in self.blocks[candidate.name])
        while requested:
            problem = LeastSquaresProblem(common, tuple(test.measured for test in solved), None,
                                          common.prior_without(requested))  # fmt: skip
            prior = (poisson_block(self.whole.values),) if problem.with_poisson else ()
            point = Linearization(problem, self.whole.values, solved, blocks + prior)
            lost = unobservable_direction(point, np.ones(len(point.blocks)), requested)
            if lost is None:
                return self._intervals(point, names, requested), tuple(why)
            why.append(lost.description)
            requested = tuple(name for name in requested if name != lost.name)
        return tuple(_unknown(name) for name in _components(names)), tuple(why)

    def _intervals(
        self, point: Linearization, names: Sequence[str], determined: Sequence[str]
    ) -> tuple[ExpectedInterval, ...]:
        fit = Fit("ok", point, {})  # as designed, with every reading at full weight
        active = np.flatnonzero(point.problem.active)
        intervals, quantile = [], float(norm.ppf(0.5 + LEVEL / 2.0))
        for label, column in zip(_components(names), columns_of(names), strict=True):
            owner = OWNER[column]
            if owner.name not in determined:
                intervals.append(_unknown(label))
                continue
            i = int(np.searchsorted(active, column))
            (_, std, _), of_print = conditional_estimate(fit, column), math.sqrt(fit.cov[i, i])
            model, unit = self.bench.model, 1.0 if owner.logarithm else owner.scale
            low, high = (owner.reported(model, sign * quantile * std) for sign in (-1.0, 1.0))
            intervals.append(
                ExpectedInterval(label, owner.unit, unit * std, low, high, unit * of_print, owner.logarithm)
            )
        return tuple(intervals)


def _components(names: Sequence[str]) -> list[str]:
    return [label for name in names for label in PARAMETERS[name].labels]


def _unknown(label: str) -> ExpectedInterval:
    owner = next(parameter for parameter in PARAMETERS.values() if label in parameter.labels)
    return ExpectedInterval(label, owner.unit, None, None, None, None, owner.logarithm)


# choice


def make_plan(
    model: ProbeModel,
    flange_volume: float,
    minutes: float,
    names: Sequence[str] = DEFAULT,
    instruments: Instruments | None = None,
    held_out: int = HELD_OUT,
) -> Plan:
    """Choose the tests of a campaign.

    Args:
        model: of the probe as designed.
        flange_volume: of printed material that is weighed with the flexible part [m³].
        minutes: time available, preparation included [min].
        names: requested parameters, of `identification.parameters.REQUESTABLE`.
        instruments: of the bench; the default ones if None.
        held_out: number of touches for `validate`.

    Raises:
        InputError: the time is too short for a plan, or the probe does not hang stably in its mount.
    """
    bench = Bench(model, instruments or Instruments())
    candidates = bench.candidates()
    hang = candidates[0]
    fixed = [hang.named("hang-1"), hang.named("hang-2")]  # before and after; others are between
    candidates = [*fixed, *candidates[1:]]
    if len(candidates) == len(fixed):
        raise InputError("no test is possible besides the free hang; name a stage, cameras, weights, a balance or "
                         "calipers, or leave out --no-turn")  # fmt: skip
    information = Information(bench, tuple(candidates), flange_volume)
    candidates = [candidate for candidate in candidates if information.blocks[candidate.name]]
    for_validation = _spread([candidate for candidate in candidates if candidate.set_up == "touch"], held_out)
    reserved = PREPARATION + sum(candidate.minutes for candidate in (*fixed, *for_validation))
    shortest = reserved + min((candidate.minutes for candidate in candidates[2:]), default=0.0)
    if minutes < shortest:
        raise InputError(f"--minutes {minutes:g} is too short: {PREPARATION:g} min of preparation, two free hangs and "
                         f"{len(for_validation)} touches for validate need {shortest:g} min with one further test; "
                         "give more time, or fewer touches with --held-out")  # fmt: skip
    free = [candidate for candidate in candidates[2:] if candidate not in for_validation]
    choice = _Choice(information, names, fixed)
    validation = [replace(touch, held_out=True) for touch in sorted(for_validation, key=lambda touch: touch.mark)]
    hangs_between, hangs_needed = -1, 0
    while hangs_needed > hangs_between:  # more hangs leave time for fewer tests, which need no more hangs
        hangs_between = hangs_needed
        chosen = choice.best(free, minutes - reserved - hangs_between * hang.minutes)
        # one set-up after the other, the most informative test of each first
        in_order = [candidate for set_up in ORDER for candidate in chosen if candidate.set_up == set_up]
        apart = [candidate for candidate in in_order if candidate.test is None]
        mounted = [candidate for candidate in in_order if candidate.test is not None] + validation
        hangs_needed = max(len(mounted) - 1, 0) // HANG_EVERY
    ordered = [*apart, hang]  # and one after the tests and between them, evenly
    for start, end in pairwise(round(len(mounted) * k / (hangs_needed + 1)) for k in range(hangs_needed + 2)):
        ordered += [*mounted[start:end], hang]
    return _scheduled(information, ordered, tuple(names), minutes)


def _scheduled(
    information: Information, ordered: Sequence[CandidateTest], names: tuple[str, ...], minutes: float
) -> Plan:
    """Return the plan of tests in their order, with their times and the intervals after each."""
    counts, clock, timed = dict.fromkeys(ORDER, 0), PREPARATION, list[tuple[CandidateTest, float]]()
    for candidate in ordered:
        clock += candidate.minutes
        counts[candidate.set_up] += 1
        if candidate.test is not None:
            count, set_up = counts[candidate.set_up], candidate.set_up
            name = f"{set_up}-{count:d}" if set_up == "hang" else f"{set_up}-{count:02d}"
            candidate = candidate.named(name, candidate.held_out, 60.0 * clock)
        timed.append((candidate, clock))
    scheduled = tuple(candidate for candidate, _ in timed)
    last = Information(information.bench, scheduled, information.flange_volume, scheduled=True)
    done, why = list[CandidateTest](), tuple[str, ...]()
    intervals: tuple[ExpectedInterval, ...] = tuple(_unknown(label) for label in _components(names))
    tests = []
    for candidate, clock in timed:
        if not candidate.held_out:
            done.append(candidate)
            intervals, why = last.expected(done, names)
        tests.append(PlannedTest(candidate, clock, intervals))
    return Plan(information.bench, names, minutes, tuple(tests), why)


def _spread(touches: list[CandidateTest], count: int) -> list[CandidateTest]:
    """Return touches at places along the probe, each in another direction and by another displacement."""
    if not touches or count <= 0:
        return []
    marks = sorted({touch.mark for touch in touches})
    directions = list(dict.fromkeys(touch.test.direction for touch in touches if touch.test is not None))
    spread: list[CandidateTest] = []
    for k in range(count):
        middle = round((k + 0.5) / count * len(marks) - 0.5)  # of the k-th part of the probe
        mark, direction = marks[middle], directions[k % len(directions)]
        here = [touch for touch in touches if touch.mark == mark and touch not in spread]
        towards = [touch for touch in here if touch.test is not None and touch.test.direction == direction]
        pool = sorted(towards or here, key=lambda touch: touch.displacement)
        if pool:
            spread.append(pool[k % len(pool)])
    return spread


@dataclass(frozen=True, eq=False)
class _Choice:
    """Search for the tests with the largest determinant."""

    information: Information  #: of all candidates.
    names: Sequence[str]  #: requested parameters.
    fixed: list[CandidateTest]  #: tests that are made in any case.

    @cached_property
    def scale(self) -> Array:
        """Standard deviations of the parameter vector before the tests: for those without a prior their limit of use.

        G has none where E is requested: Poisson's ratio determines it with E.
        """
        common = self.information.whole.problem.common
        std = common.prior_without(self.names)
        for name in dict.fromkeys((*self.names, "G")) if np.isinf(std).any() else self.names:
            limit = PARAMETERS[name].max_std
            assert limit is not None
            std[PARAMETERS[name].columns] = limit
        return np.asarray(std)

    @cached_property
    def active(self) -> NDArray[np.intp]:
        return np.asarray(np.flatnonzero(self.scale > 0.0))

    @cached_property
    def matrices(self) -> dict[str, Array]:
        """Information of each candidate in units of the prior."""
        scale = self.scale[self.active]
        return {candidate.name: scale[:, None] * self.information.matrix(candidate.name, self.active) * scale
                for candidate in self.information.candidates if self.information.blocks[candidate.name]}  # fmt: skip

    def value(self, matrices: Array) -> Array:
        others = np.flatnonzero(~np.isin(self.active, columns_of(self.names)))
        whole = np.linalg.slogdet(matrices)[1]
        return np.asarray(0.5 * (whole - np.linalg.slogdet(matrices[..., others[:, None], others])[1]))

    def best(self, candidates: list[CandidateTest], minutes: float) -> list[CandidateTest]:
        """Return tests within the time, the most informative per minute first."""
        total = np.eye(len(self.active)) + sum(self.matrices[candidate.name] for candidate in self.fixed)
        chosen: list[CandidateTest] = []
        left = minutes
        while pool := [other for other in candidates if other not in chosen and other.minutes <= left]:
            gains = self._values(total, pool) - self.value(total)
            k = int(np.argmax(np.where(gains >= MIN_GAIN, gains / [other.minutes for other in pool], -np.inf)))
            if gains[k] < MIN_GAIN:
                break
            chosen.append(pool[k])
            total, left = total + self.matrices[pool[k].name], left - pool[k].minutes
        return self._exchanged(chosen, candidates, total, left)

    def _values(self, total: Array, pool: list[CandidateTest]) -> Array:
        return self.value(total + np.stack([self.matrices[candidate.name] for candidate in pool]))

    def _exchanged(
        self, chosen: list[CandidateTest], candidates: list[CandidateTest], total: Array, left: float
    ) -> list[CandidateTest]:
        """Return the tests after the exchanges that increase the determinant."""
        for _ in range(MAX_EXCHANGES):
            best, gain = None, MIN_GAIN
            for i, test in enumerate(chosen):
                free = left + test.minutes
                pool = [other for other in candidates if other not in chosen and other.minutes <= free]
                if pool:
                    gains = self._values(total - self.matrices[test.name], pool) - self.value(total)
                    if gains.max() > gain:
                        best, gain = (i, pool[int(np.argmax(gains))]), float(gains.max())
            if best is None:
                break
            i, other = best
            total = total - self.matrices[chosen[i].name] + self.matrices[other.name]
            left += chosen[i].minutes - other.minutes
            chosen[i] = other
        return chosen
