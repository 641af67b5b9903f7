"""Choice of the tests that determine the requested parameters best in the time available, and their data folder.

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
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from probedesign.campaigns.campaign import MARKERS, TESTS, WRENCHES
from probedesign.campaigns.manifest import manifest_lines, number_list
from probedesign.campaigns.reading import IMAGES, MARKERS_SCHEMA, PIXELS, TESTS_SCHEMA, WRENCHES_SCHEMA
from probedesign.core import csv_tables
from probedesign.core.errors import InputError
from probedesign.core.files import check_replaceable, check_writable, replaced_folder
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.estimation.model import WALK_SECONDS, ProbeModel
from probedesign.identification.fit_checks import conditional_estimate, unobservable_direction
from probedesign.identification.identify import TEST_SECONDS, data_of
from probedesign.identification.parameters import COMPONENTS, OWNER, PARAMETERS, ParameterValues, columns_of
from probedesign.identification.residuals import MassMeasurement, ResidualBlock, poisson_block
from probedesign.identification.solver import (
    Fit,
    LeastSquaresProblem,
    Linearization,
    linearize,
    solvable_tests,
    start_nuisance,
)
from probedesign.planning.candidates import READINGS, STD_MARK, TOUCH_PLACES, Bench, CandidateTest, Instruments, SetUp
from probedesign.simulation.ground_truth import marker_arclengths

DEFAULT = ("E", "G", "root", "diameters")  #: Parameters that a plan is for unless others are requested.
PREPARATION = 20.0  #: Time to mount the probe, to let sensor and resin settle and to zero [min] (assumed).
HELD_OUT = 4  #: Touches that a plan holds out for `validate`, if the bench can touch and the time allows it.
#: Gain of ½ log det below which a further test is not proposed: it narrows no interval by more than 1 %.
MIN_GAIN = 0.01
ENOUGH = 1.1  #: Ratio of a standard deviation to the final one from which on further tests are not necessary.
#: Tests on the sensor between two free hangs at most: with 4 minutes each the bias has walked for half an hour
#: (assumed).
HANG_EVERY = 8
MAX_EXCHANGES = 10
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
        return tuple(map(_unknown, columns_of(names))), tuple(why)

    def _intervals(
        self, point: Linearization, names: Sequence[str], determined: Sequence[str]
    ) -> tuple[ExpectedInterval, ...]:
        fit = Fit("ok", point, {})  # as designed, with every reading at full weight
        active = np.flatnonzero(point.problem.active)
        intervals, quantile = [], float(norm.ppf(0.5 + LEVEL / 2.0))
        for column in columns_of(names):
            owner = OWNER[column]
            if owner.name not in determined:
                intervals.append(_unknown(column))
                continue
            i = int(np.searchsorted(active, column))
            (_, std, _), of_print = conditional_estimate(fit, column), math.sqrt(fit.cov[i, i])
            model, unit = self.bench.model, 1.0 if owner.logarithm else owner.scale
            low, high = (owner.reported(model, sign * quantile * std) for sign in (-1.0, 1.0))
            intervals.append(ExpectedInterval(COMPONENTS[column], owner.unit, unit * std, low, high, unit * of_print,
                                              owner.logarithm))  # fmt: skip
        return tuple(intervals)


def _unknown(column: int) -> ExpectedInterval:
    owner = OWNER[column]
    return ExpectedInterval(COMPONENTS[column], owner.unit, None, None, None, None, owner.logarithm)


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
    intervals = tuple(map(_unknown, columns_of(names)))
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
        scale = self.scale[self.active]
        return {candidate.name: scale[:, None] * self.information.matrix(candidate.name, self.active) * scale
                for candidate in self.information.candidates if self.information.blocks[candidate.name]}  # fmt: skip

    def value(self, matrices: Array) -> Array:
        others = np.flatnonzero(~np.isin(self.active, columns_of(self.names)))
        whole = np.linalg.slogdet(matrices)[1]
        return np.asarray(0.5 * (whole - np.linalg.slogdet(matrices[..., others[:, None], others])[1]))

    def _values(self, total: Array, pool: list[CandidateTest]) -> Array:
        return np.asarray(self.value(total + np.stack([self.matrices[other.name] for other in pool])))

    def best(self, candidates: list[CandidateTest], minutes: float) -> list[CandidateTest]:
        """Return tests that fit into the time: each the best after those before it, then exchanged for better ones."""
        total = np.eye(len(self.active)) + sum(self.matrices[candidate.name] for candidate in self.fixed)
        chosen: list[CandidateTest] = []
        while pool := [other for other in candidates if other not in chosen and other.minutes <= minutes]:
            gains = self._values(total, pool) - self.value(total)
            k = int(np.argmax(np.where(gains >= MIN_GAIN, gains / [other.minutes for other in pool], -np.inf)))
            if gains[k] < MIN_GAIN:
                break
            chosen.append(pool[k])
            total, minutes = total + self.matrices[pool[k].name], minutes - pool[k].minutes
        for _ in range(MAX_EXCHANGES if chosen else 0):
            exchanges = []
            for i, test in enumerate(chosen):
                left = minutes + test.minutes
                pool = [other for other in candidates if other not in chosen and other.minutes <= left]
                if pool:
                    values = self._values(total - self.matrices[test.name], pool)
                    exchanges.append((float(values.max()), i, pool[int(np.argmax(values))]))
            largest, i, other = max(exchanges, key=lambda exchange: exchange[0], default=(-np.inf, 0, chosen[0]))
            if largest - self.value(total) < MIN_GAIN:
                break
            total = total - self.matrices[chosen[i].name] + self.matrices[other.name]
            minutes += chosen[i].minutes - other.minutes
            chosen[i] = other
        return chosen


# the data folder: tables with the planned tests, which a laboratory fills, and a checklist for the bench

PLAN, PAGE, CHECKLIST = "plan.json", "plan.html", "README.md"
WRENCH_HEADER = f"# frame: sensor\n{WRENCHES_SCHEMA.like}\n"


def tables(plan: Plan) -> dict[str, str]:
    """Return the tables of the data folder by name, with a row for each planned test."""
    rows = [_row(candidate) for candidate in plan.candidates if candidate.test is not None]
    model, bench = plan.bench.model, plan.bench
    lines = manifest_lines(
        "Planned by `probedesign plan`. Correct what differs on your bench; README.md says how.",
        model, bench.T_world_base(model.gravity_base), bench.instruments.std_base, bench.gravity_world,
    )  # fmt: skip
    if bench.instruments.cameras is not None:
        s = np.array(marker_arclengths(model.rod.length)) / MM
        lines += ["", "[markers]                   # marker 1 is the nearest to the base", f"s_mm = {number_list(s)}",
                  "# side_deg = -110.0         # where the dots are on the surface; absent: on the axis",
                  f"std_mm = {bench.instruments.cameras / MM:g}"]  # fmt: skip
    if any(candidate.set_up == "weighing" for candidate in plan.candidates) and bench.instruments.balance is not None:
        lines += ["", "# [weighing]                # after weighing, remove the # of these lines",
                  "# mass_g =", f"# std_g = {1e3 * bench.instruments.balance:g}",
                  '# of = "probe"              # with its printed flange; "flexible": the soft part alone']  # fmt: skip
    manifest = "\n".join([*lines, "", "[source]", 'by = ""', ""])
    columns = [*TESTS_SCHEMA.like.split(","), "note"]
    return {"campaign.toml": manifest, TESTS: csv_tables.write(columns, rows).decode(), WRENCHES: WRENCH_HEADER}


def _row(candidate: CandidateTest) -> dict[str, str]:
    """Return the row of a planned test: what is set beforehand; what is measured stays empty."""
    test = candidate.test
    assert test is not None
    row = {"test": test.name, "direction": test.direction, "use": test.use, "note": candidate.words}
    if test.force_world is not None:
        row |= {f"force_{axis}_world_N": f"{value + 0.0:.6g}"
                for axis, value in zip("xyz", test.force_world, strict=True)}  # fmt: skip
    if np.isfinite(test.s_contact):
        row |= {"s_contact_mm": f"{test.s_contact / MM:.2f}", "std_s_mm": f"{test.std_s / MM:.2g}"}
    if test.force_world is None:
        row["std_contact_mm"] = f"{test.std_contact / MM:g}"
    if candidate.set_up == "turned":
        T = test.T_world_base
        turn = np.degrees(Rotation.from_matrix(T[:3, :3]).as_rotvec())
        for i, axis in enumerate("xyz"):
            row[f"base_{axis}_world_mm"] = f"{T[i, 3] / MM + 0.0:.4f}"
            row[f"base_r{axis}_world_deg"] = f"{turn[i] + 0.0:.4f}"
    return row


# the bench


def checklist(plan: Plan, folder: str) -> list[tuple[str, list[str]]]:
    """Return the steps at the bench: headings with their lines; `folder` is named by the commands at the end."""
    kinds = {candidate.set_up for candidate in plan.candidates}
    model = plan.bench.model
    marks = sorted({candidate.mark for candidate in plan.candidates if np.isfinite(candidate.mark)})
    before = [f"Check that the part bears the fingerprint {model.fingerprint}."]
    if marks:
        before.append(f"Draw marks around the probe at s = {', '.join(f'{s / MM:g}' for s in marks)} mm from the base, "
                      f"each to {STD_MARK / MM:g} mm, measured along the straight probe.")  # fmt: skip
    if "weighing" in kinds:
        before.append("Weigh the printed probe with its flange, and write [weighing] in campaign.toml.")
    if "calipers" in kinds:
        std = plan.bench.instruments.calipers or 0.0
        before.append("Measure the diameter at the base and at each mark twice, at a right angle, and write the "
                      "readings into calipers.csv with the columns s_mm, diameter_mm and std_mm. Then `probedesign "
                      f"measured DESIGN calipers.csv --calipers-std-mm {std / MM:g} --out MEASURED.toml`, which is "
                      "used below, and remove fingerprint from campaign.toml: the measured geometry has another "
                      "one.")  # fmt: skip
    mount = [
        "Zero the sensor before the probe is mounted. Switch it on half an hour before.",
        "Measure the pose of the base in the frame of the stage or cameras, and write [base] in campaign.toml. "
        "std_mm and std_deg are one standard deviation of this measurement; an error of 0.2° moves the tip of this "
        f"probe by {np.radians(0.2) * model.rod.length / MM:.1f} mm.",
        "The base's z axis points from the base to the tip, its x axis to the clocking mark of the flange.",
    ]
    each = [
        f"Wait until the reading is still (1 minute after a change), then take {READINGS} readings, each the mean of "
        f"{model.averaging_samples} samples, with their time_s, and append them to wrenches.csv.",
        "Write the reading as the sensor shows it and keep the line `# frame: sensor`. A wrench is what the probe does "
        "to its mount: with a probe that hangs free, the force has the direction of gravity.",
    ]
    if "weight" in kinds:
        each.append("Weight: write the mass on the balance times 9.81 m/s² with a minus sign into force_z_world_N. "
                    "The thread lies on the mark, and s_contact_mm is the mark.")  # fmt: skip
    if "touch" in kinds:
        each.append("Touch: push with an edge at the mark, read the place of the touched point on the surface from the "
                    "stage, and write contact_x/y/z_world_mm. The direction is where the object moves. s_contact_mm "
                    "is where the force's line meets the axis: nearer to the base than the mark by r·tan α, with "
                    "r the radius and α the half angle of the cone. It is written already.")  # fmt: skip
    if "turned" in kinds:
        each.append("Turned base: write the measured pose into the six base columns of the test.")
    if plan.bench.instruments.cameras is not None:
        each.append(f"Markers: write their places into {MARKERS} with the columns {MARKERS_SCHEMA.like}; or photograph "
                    "them with calibrated cameras (docs/stereo.md).")  # fmt: skip
    held_out = [candidate.name for candidate in plan.candidates if candidate.held_out]
    if held_out:
        each.append(f"{', '.join(held_out)}: measure them like the others. identify leaves them out, and validate "
                    "judges the probe by them.")  # fmt: skip
    each.append("A test that failed or was not made: leave its row without readings; identify then ignores it.")
    names, design = ",".join(plan.identified), "MEASURED.toml" if "calipers" in kinds else "DESIGN"
    after = [
        f"probedesign identify {design} {folder} --for {names} --out IDENTIFIED.toml",
        "probedesign deploy IDENTIFIED.toml --out PROBE.probe.json",
        f"probedesign validate PROBE.probe.json {folder}",
    ]
    return [("Before mounting", before), ("Mounting", mount), ("Each test, in the order of tests.csv", each),
            ("Afterwards", after)]  # fmt: skip


def checklist_text(plan: Plan, folder: str) -> str:
    """Return the checklist as Markdown."""
    summary = f"{len(plan.tests)} measurements in {plan.tests[-1].minutes:.0f} minutes; {PAGE} shows each set-up."
    lines = [f"# Campaign of {plan.bench.model.name}", "", summary]
    for heading, steps in checklist(plan, folder):
        lines += ["", f"## {heading}", "", *(f"- [ ] {step}" for step in steps)]
    return "\n".join([*lines, ""])


# writing


def check_target(folder: Path, force: bool) -> None:
    """Refuse a folder that exists; with `force` replace a plan without measured values, and nothing else.

    Raises:
        InputError: the folder must not be replaced, or cannot be written.
    """
    check_writable(folder)
    check_replaceable(folder, PLAN, "plan", force)
    for name, empty in ((WRENCHES, WRENCH_HEADER), (MARKERS, ""), (PIXELS, ""), (IMAGES, "")):
        path = folder / name
        if path.exists() and (path.is_dir() or path.read_bytes().split() != empty.encode().split()):
            raise InputError(f"{folder}: {name} has measured values, which are not replaced; name another folder")


def write_folder(folder: Path, contents: Sequence[tuple[str, bytes]], force: bool) -> list[Path]:
    """Write the data folder, atomically, and return its files.

    Raises:
        InputError: as `check_target`.
    """
    check_target(folder, force)
    with replaced_folder(folder) as draft:
        for name, content in contents:
            (draft / name).write_bytes(content)
    return [folder / name for name, _ in contents]
