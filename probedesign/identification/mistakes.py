"""Eight checks for the cause of a contradiction: unit, sign, frame, exchanged readings, marker numbers, a bent print,
planes of bending that differ, another probe.

Each check undoes one mistake in a few tests of the campaign and fits them again with the stated noise. It is a likely
cause where χ² falls by more than chance explains. It explains the contradiction where the residuals are within
`MAX_LOSS` of normal noise and were not before. Where no mistake explains it, another probe is the first cause.
Mistakes of columns are undone in the frame of wrenches.csv.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from probedesign.core.csv_tables import Frame
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.identification.parameters import CHANNELS, COMPONENTS, OWNER, PRINT, CommonParameters
from probedesign.identification.residuals import MeasuredTest, ResidualBlock
from probedesign.identification.robust_loss import REJECTION_CHANCE, outliers
from probedesign.identification.solver import (
    Fit,
    LeastSquaresProblem,
    Linearization,
    linearize,
    minimise,
    spread,
    start_nuisance,
    start_points,
)

#: Mistakes that are fitted, the best by their start, factors on E that it is chosen from, and rounds of a fit.
MAX_REFINED, MAX_FACTORS, MAX_FIT_ROUNDS = 4, 3, 8
#: Tests under load, free ones, and outlying ones that the checks are made with.
MAX_LOADED, MAX_FREE, MAX_SEEDS = 6, 2, 4
#: Loss over its median for normal noise up to which tests agree: noise three times as large as stated (assumed).
MAX_LOSS = 2.0
OTHER_PRINT = 30.0  #: Factor on the tolerances of the dimensions for another probe (assumed).

DEFECT = 30.0  #: Factor on the tolerances of creep and bow for a defect of the print (assumed).

Change = Callable[[MeasuredTest], MeasuredTest]


class Mistake(NamedTuple):
    """A mistake in the data folder."""

    name: str  #: unit, sign, frame, exchange or marker.
    words: str  #: what is likely wrong, and what to check.
    change: Change  #: undoes it in a test.
    price: float = 0.0  #: logarithm of the number of mistakes of this kind among which it was selected.


class Exchange(NamedTuple):
    """Two tests that agree better with the fit after an exchange of their readings."""

    pair: tuple[str, str]  #: their names.
    before: float  #: loss of both as stated.
    after: float  #: loss of both after the exchange.


@dataclass(frozen=True)
class LikelyCause:
    """A likely cause of a contradiction."""

    name: str  #: that of the mistake, planes, bow, or probe.
    words: str  #: what is likely wrong, and what to check.
    evidence: str  #: the number that speaks for it.
    explains: bool  #: whether the tests agree with it, and do not without.
    #: what it changes of each number: relative for a modulus, a density and diameters, in m or rad for a pose.
    moves: dict[str, float] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.words} ({self.evidence})"


def likely_causes(fit: Fit) -> tuple[LikelyCause, ...]:
    """Return what may explain a contradiction, the likeliest first."""
    problem = fit.point.problem
    seeds = list(dict.fromkeys(block.test for block, _ in outliers(fit.point.blocks, fit.scales)))
    few = 2 * len(seeds) <= len(problem.tests)  # two exchanged tests do not make most others outlying
    exchange = _best_exchange(fit.point, seeds[:MAX_SEEDS]) if few else None
    pair = None if exchange is None else exchange.pair
    names = {*_some(problem.tests), *seeds[:MAX_SEEDS], *(pair or ())}
    some = replace(problem, tests=tuple(test for test in problem.tests if test.name in names))
    # as the fit solved them: from no initial guess, tests far off the design may have no solution
    solved = tuple(test for test in fit.point.tests if test.measured.name in names)
    blocks = tuple(block for block in fit.point.blocks if block.test in names or not block.test)
    stated = minimise(Linearization(some, fit.point.values, solved, blocks), {})[0]
    causes = [*_fitted(some, stated, pair), *print_defects(stated)]
    if any(cause.explains for cause in causes) or _agrees(stated):
        return tuple(causes)
    return _other_probe(stated), *causes


def explaining_mistakes(problem: LeastSquaresProblem) -> tuple[LikelyCause, ...]:
    """Return mistakes without which the rod has an equilibrium in tests that have none as they are."""
    names = _some(problem.tests)
    return tuple(_fitted(replace(problem, tests=tuple(test for test in problem.tests if test.name in names)), None))


def exchange_hint(fit: Fit, outlying: Sequence[tuple[ResidualBlock, float]]) -> tuple[str, ...]:
    """Return a note if an exchange of the readings of two tests, one of them outlying, explains outliers."""
    of = {test.name: test for test in fit.point.problem.tests}
    names = [name for name in dict.fromkeys(block.test for block, _ in outlying) if name in of]
    exchange = _best_exchange(fit.point, [name for name in names if not of[name].free][:MAX_SEEDS])
    price = np.log(len(of) * (len(of) - 1) / 2) - np.log(REJECTION_CHANCE)
    if exchange is None or exchange.before - exchange.after < price:
        return ()
    return (f"{' and '.join(exchange.pair)}: their readings may be exchanged: χ² of both falls from "
            f"{2.0 * exchange.before:.4g} to {2.0 * exchange.after:.4g} that way; check "
            "wrenches.csv, or their places in tests.csv",)  # fmt: skip


# fits of changed tests


def _some(tests: Sequence[MeasuredTest]) -> set[str]:
    loaded, free = [test for test in tests if not test.free], [test for test in tests if test.free]
    return {test.name for test in (*spread(loaded, MAX_LOADED), *spread(free, MAX_FREE))}


def _fitted(
    problem: LeastSquaresProblem, stated: Linearization | None, pair: tuple[str, str] | None = None
) -> list[LikelyCause]:
    """Return the mistakes that the tests speak for, the likeliest first; without a fit of the tests as stated, those
    that explain all readings."""
    starts = []
    for mistake in _mistakes(problem, pair):
        changed = replace(problem, tests=tuple(map(mistake.change, problem.tests)))
        points = [point for _, point in start_points(changed, MAX_FACTORS)]
        if points:
            starts.append((mistake, min(points, key=lambda point: point.loss({}))))
    starts.sort(key=lambda pair: pair[1].loss({}))
    margin = 0.5 * chi2.isf(0.01 / max(len(starts), 1), 1)
    causes = []
    for mistake, start in starts[:MAX_REFINED]:
        point = minimise(minimise(start, None, MAX_FIT_ROUNDS)[0], {}, MAX_FIT_ROUNDS)[0]
        loss, explains = point.loss({}), _agrees(point) and (stated is None or not _agrees(stated))
        before = "they have no equilibrium otherwise" if stated is None else f"falls from {2.0 * stated.loss({}):.4g}"
        if explains if stated is None else stated.loss({}) - loss > margin + mistake.price:
            evidence = f"χ² of {len(problem.tests)} tests {before} to {2.0 * loss:.4g}"
            if stated is None:
                evidence = f"χ² of {len(problem.tests)} tests is {2.0 * loss:.4g}, and {before}"
            cause = LikelyCause(mistake.name, mistake.words, evidence, explains, _moves(point, stated))
            causes.append((loss + mistake.price, cause))
    return [cause for _, cause in sorted(causes, key=lambda pair: pair[0])]


def print_defects(stated: Linearization) -> list[LikelyCause]:
    """Return defects of the print that the tests speak for, the likeliest first: bent, or stiffer in one plane.

    The stiffness of each test by the plane that it bends in, exp(-c cos 2φ) with φ the direction of the force, takes
    the place of the creep, and each prior is `DEFECT` times as wide.
    """
    problem, loss = stated.problem, stated.loss({})
    forces = [test.eq.load[:2] for test in stated.tests]
    planes = tuple(replace(test.measured, creep_ramp=float((f[0] ** 2 - f[1] ** 2) / max(f @ f, 1e-12)))
                   for test, f in zip(stated.tests, forces, strict=True))  # fmt: skip
    causes = []
    for name, tests in (("creep", planes), ("bow", problem.tests)):
        columns = [c for c, owner in enumerate(OWNER) if owner.name.startswith(name) and problem.active[c]]
        if not columns:
            continue
        prior = problem.prior.copy()
        prior[columns] *= DEFECT
        changed = replace(problem, tests=tests, prior=prior)
        nuisance = [test.nuisance for test in stated.tests]
        start = linearize(changed, stated.values, nuisance, stated)
        point = minimise(start, {}, MAX_FIT_ROUNDS)[0] if start.ok else stated
        if loss - point.loss({}) < 0.5 * chi2.isf(REJECTION_CHANCE, len(columns)):
            continue
        x = point.values.x[columns]
        words = (f"planes: bending along x is {np.exp(-2.0 * x[0]):.3g} times as stiff as along y, so planes of "
                 "bending differ; measure the diameters across both axes")  # fmt: skip
        if name == "bow":
            words = (f"bow: a bent print, whose tip deviates by {np.hypot(*x) / MM:.2g} mm; look along it, and write "
                     "the bow into the design with measured --bow-mm")  # fmt: skip
        evidence = f"χ² of {len(tests)} tests falls from {2.0 * loss:.4g} to {2.0 * point.loss({}):.4g}"
        explains = _agrees(point) and not _agrees(stated)
        cause = LikelyCause(words.split(":")[0], words, evidence, explains, _moves(point, stated))
        causes.append((point.loss({}), cause))
    return [cause for _, cause in sorted(causes, key=lambda pair: pair[0])]


def _other_probe(stated: Linearization) -> LikelyCause:
    problem, common = stated.problem, stated.problem.common
    prior = problem.prior.copy()
    prior[common.print_columns] *= OTHER_PRINT
    point = minimise(replace(stated, problem=replace(problem, prior=prior)), {})[0]
    radius = point.values.rod.radius / common.model.rod.radius
    evidence = (f"χ² of {len(problem.tests)} tests is {2.0 * stated.loss({}):.4g}, and {2.0 * point.loss({}):.4g} with "
                f"free diameters, {radius.min():.2f} to {radius.max():.2f} times the design's")  # fmt: skip
    words = ("probe: another probe than the design's, or a mistake that is not listed here; check probe and "
             "fingerprint in campaign.toml, and the diameters of the print")  # fmt: skip
    return LikelyCause("probe", words, evidence, _agrees(point), _moves(point, stated))


def _agrees(point: Linearization) -> bool:
    return bool(point.loss({}) < MAX_LOSS * 0.5 * sum(chi2.median(len(block.r)) for block in point.blocks))


def _moves(point: Linearization, stated: Linearization | None) -> dict[str, float]:
    if stated is None:
        return {}
    change = point.values.x - stated.values.x
    return {COMPONENTS[c]: float(change[c]) for c in range(PRINT)
            if OWNER[c].max_std is not None and stated.problem.active[c]}  # fmt: skip


def _best_exchange(point: Linearization, seeds: Sequence[str]) -> Exchange | None:
    """Return the two tests, one of them outlying, whose loss falls most by an exchange of their readings."""
    common, of = point.problem.common, {test.name: test for test in point.problem.tests}
    read = [name for name, test in of.items() if test.wrench_base is not None]
    stated = {name: _loss_of_test(point, of[name]) for name in read} if seeds else {}
    exchanges = []
    for a, b in dict.fromkeys((min(a, b), max(a, b)) for a in seeds if a in read for b in read if a != b):
        change, before = _exchange(common, of, (a, b)).change, stated[a] + stated[b]
        after = _loss_of_test(point, change(of[a]))
        after += _loss_of_test(point, change(of[b])) if after < before else 0.0
        if after < before:
            exchanges.append(Exchange((a, b), before, after))
    return max(exchanges, key=lambda exchange: exchange.before - exchange.after, default=None)


def _loss_of_test(point: Linearization, test: MeasuredTest) -> float:
    """Return the loss of one test by its own unknowns at a fit's common parameters; infinite without equilibrium."""
    fixed = replace(point.problem, tests=(test,), mass=None, prior=np.zeros(point.problem.common.size))
    start = Linearization(fixed, point.values, (), ()).at(start_nuisance((test,), point.values.rod)[0])
    return minimise(start, {})[0].loss({}) if start.ok else np.inf


# the mistakes


def _mistakes(problem: LeastSquaresProblem, pair: tuple[str, str] | None) -> Iterator[Mistake]:
    """Yield mistakes that the tests may contain."""
    common, tests = problem.common, problem.tests
    if any(test.wrench_base is not None for test in tests):
        both = np.repeat([-1.0, 1.0], 3)
        signs = {"all wrenches": -np.ones(6), "forces": both, "moments": -both}
        signs |= {name: 1.0 - 2.0 * np.eye(6)[i] for i, name in enumerate(CHANNELS)}
        for which, factors in signs.items():
            words = f"sign: {which} with the opposite sign; check the columns of wrenches.csv"
            yield Mistake("sign", words, partial(_scaled, common, factors))
        for which, columns in (("forces", both < 0.0), ("moments", both > 0.0)):
            for factor, size in ((1e-3, "large"), (1e3, "small")):
                words = f"unit: {which} a thousand times too {size}; check the columns of wrenches.csv"
                yield Mistake("unit", words, partial(_scaled, common, np.where(columns, factor, 1.0)))
        actual: Frame = "base" if common.frame == "sensor" else "sensor"
        words = f"frame: wrenches.csv states '# frame: {common.frame}', but its values are those of '# frame: {actual}'"
        yield Mistake("frame", words, partial(_in_frame, replace(common, frame=actual), common))
        if pair is not None:
            yield _exchange(common, {test.name: test for test in tests}, pair)
    if any(np.any(test.force_world) for test in tests if test.force_world is not None):
        for name, what, factor in (("sign", "with the opposite sign", -1.0), ("unit", "in mN", 1e-3)):
            yield Mistake(name, f"{name}: known forces {what}; check tests.csv", partial(_known, factor))
    if any(len(test.marker_s) or test.p_touch_world is not None for test in tests):
        for factor, size in ((1e3, "small"), (1e-3, "large")):
            words = f"unit: places of the reference a thousand times too {size}; check the columns in mm"
            yield Mistake("unit", words, partial(_resized, factor))
    if any(len(test.marker_s) > 2 for test in tests):
        for shift, size in ((1, "low"), (-1, "high")):
            yield Mistake("marker", f"marker: all numbers too {size} by 1; check s_mm", partial(_shifted, shift))


def _exchange(common: CommonParameters, of: dict[str, MeasuredTest], pair: tuple[str, str]) -> Mistake:
    other = {pair[0]: of[pair[1]], pair[1]: of[pair[0]]}

    def change(test: MeasuredTest) -> MeasuredTest:
        if test.name not in other:
            return test
        swapped = _with_columns(common, test, _columns(common, other[test.name]))
        return replace(swapped, cov_wrench=other[test.name].cov_wrench)

    words = f"exchange: the readings of {pair[0]} and {pair[1]}; check wrenches.csv, or their places in tests.csv"
    return Mistake("exchange", words, change, float(np.log(len(of) * (len(of) - 1) / 2)))


def _columns(common: CommonParameters, test: MeasuredTest) -> Array:
    """Return the wrench of a test in the frame of wrenches.csv [N, N·m], (6,)."""
    assert test.wrench_base is not None
    sensor = common.frame == "sensor"
    return common.model.to_sensor(test.wrench_base, test.gravity_base) if sensor else test.wrench_base


def _with_columns(common: CommonParameters, test: MeasuredTest, values: Array) -> MeasuredTest:
    wrench = values if common.frame == "base" else common.model.to_base(values, test.gravity_base)
    return replace(test, wrench_base=wrench)


def _scaled(common: CommonParameters, factors: Array, test: MeasuredTest) -> MeasuredTest:
    return test if test.wrench_base is None else _with_columns(common, test, factors * _columns(common, test))


def _in_frame(actual: CommonParameters, stated: CommonParameters, test: MeasuredTest) -> MeasuredTest:
    return test if test.wrench_base is None else _with_columns(actual, test, _columns(stated, test))


def _known(factor: float, test: MeasuredTest) -> MeasuredTest:
    return test if test.force_world is None else replace(test, force_world=factor * test.force_world)


def _resized(factor: float, test: MeasuredTest) -> MeasuredTest:
    touch = None if test.p_touch_world is None else factor * test.p_touch_world
    return replace(test, p_markers_world=factor * test.p_markers_world, p_touch_world=touch)


def _shifted(shift: int, test: MeasuredTest) -> MeasuredTest:
    s = test.marker_s
    if len(s) < 2:
        return test
    end = 2.0 * s[-1] - s[-2] if shift > 0 else max(2.0 * s[0] - s[1], 0.0)
    return replace(test, marker_s=np.append(s[1:], end) if shift > 0 else np.append(end, s[:-1]))
