"""Likely causes of a contradiction: what would have to be different for the tests to agree.

Each cause is a model of its own that is fitted to the same tests: a mistake in the data folder is undone, a prior is
thirty times as wide, or a kind of reading scatters more. They are ranked by Laplace's approximation of their evidence,

    -ln p(data | model) ≈ loss + Σ ln s + Σ ln σ + ½ ln det N,

with the robust loss, the noise scales s of all readings, the standard deviations σ of the priors, and the information N
of all unknowns. The last three terms make a model pay for its freedom: a wide prior or a large scatter fits anything.
Source: D. J. C. MacKay, Information Theory, Inference, and Learning Algorithms, 2003, chapter 28.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, pairwise

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from probedesign.core.frames import Array
from probedesign.identification.fit_checks import DIMENSIONS, LABELS, PriorTest
from probedesign.identification.parameters import CHANNELS, PARAMETERS
from probedesign.identification.residuals import MeasuredTest
from probedesign.identification.robust_loss import READING_KINDS, ROBUST_KINDS, median_scales, weights
from probedesign.identification.solver import (
    Fit,
    LeastSquaresProblem,
    Linearization,
    linearize,
    minimise,
    reread,
)
from probedesign.identification.starting_values import START_FACTORS, points_at, spread

MAX_REFINED = 5
"""Mistakes, and priors, that are fitted; of other mistakes only the start of the search is compared."""
MAX_FIT_ITERATIONS = 8
MAX_LOADED, MAX_FREE, MAX_FACTORS = 6, 2, 3
"""Tests under load, free tests, and factors on E that models are compared with."""
SOFT_CHANCE = 0.01
"""Chance up to which a cause is listed."""
WRONG_PRIOR = 30.0
"""Factor on the standard deviation of a prior whose value is wrong: 6 mm or 6 degrees of a base known to 0.2
(assumed)."""
MAX_LOSS = 2.0
"""Loss over its median for normal noise up to which a mistake explains tests that have no equilibrium otherwise: noise
three times as large as stated (assumed)."""

Change = Callable[[MeasuredTest], MeasuredTest]


@dataclass(frozen=True)
class LikelyCause:
    """A likely cause of a contradiction.

    Attributes:
        name: sign, unit, mount, camera, marker, probe, friction, stiffness, or the prior's name.
        words: what is likely wrong, and what to check.
        evidence: the number that speaks for it.
        gain: logarithm of its odds against the tests and priors as stated.
    """

    name: str
    words: str
    evidence: str
    gain: float

    def __str__(self) -> str:
        return f"{self.words} ({self.evidence})"


def likely_causes(fit: Fit, priors: Sequence[PriorTest]) -> tuple[LikelyCause, ...]:
    """Return what may explain a contradiction, the likeliest first.

    Args:
        fit: of the contradictory tests.
        priors: tests of the priors against the rest of the data.
    """
    some = [test.measured.name for test in fit.point.tests if test.measured in _some(fit.point.problem.tests)]
    solved = [test for test in fit.point.tests if test.measured.name in some]
    problem = replace(fit.point.problem, tests=tuple(test.measured for test in solved))
    point = linearize(problem, fit.point.values, [test.nuisance for test in solved])
    if not point.ok:
        return ()
    stated = _refined(problem, point)
    causes = [*_mistakes(problem, stated), *_wrong_priors(stated, priors), *_scatter(stated, fit)]
    return tuple(sorted(causes, key=lambda one: -one.gain))


def explaining_mistakes(problem: LeastSquaresProblem) -> tuple[LikelyCause, ...]:
    """Return mistakes without which the rod has an equilibrium in tests that have none as they are, the likeliest
    first."""
    some = replace(problem, tests=_some(problem.tests))
    return tuple(sorted(_mistakes(some, None), key=lambda one: -one.gain))


def _some(tests: Sequence[MeasuredTest]) -> tuple[MeasuredTest, ...]:
    """Return tests that are spread over the campaign, most of them loaded: a mistake of the whole folder is in all."""
    loaded, free = [one for one in tests if not one.free], [one for one in tests if one.free]
    chosen = {one.name for one in (*spread(loaded, MAX_LOADED), *spread(free, MAX_FREE))}
    return tuple(one for one in tests if one.name in chosen)


def _cost(point: Linearization, scales: dict[str, float] | None = None) -> float:
    """Return minus the logarithm of the evidence, up to a constant of all models."""
    scales = scales or {}
    std = point.problem.prior[point.problem.active]
    noise = sum(
        len(one.r) * np.log(scales.get(one.kind, 1.0)) for one in point.blocks if one.kind in ROBUST_KINDS
    )
    volume = point.normal_equations(weights(point.blocks, scales)).log_volume
    return float(point.loss(scales) + noise + np.log(std[np.isfinite(std)]).sum() + volume)


def _refined(problem: LeastSquaresProblem, point: Linearization) -> Linearization:
    """Return the fit with the stated noise, after a search that gross errors disturb less."""
    point = minimise(problem, point, None, MAX_FIT_ITERATIONS)[0]
    return minimise(problem, point, {}, MAX_FIT_ITERATIONS)[0]


def _wrong_priors(stated: Linearization, priors: Sequence[PriorTest]) -> Iterator[LikelyCause]:
    """Yield priors and single readings whose value is wrong."""
    for one in [one for one in priors if one.chance < SOFT_CHANCE][:MAX_REFINED]:
        gain = one.gain
        if one.columns:
            prior = stated.problem.prior.copy()
            prior[list(one.columns)] *= WRONG_PRIOR
            problem = replace(stated.problem, prior=prior)
            start = Linearization(problem, stated.values, stated.tests, stated.blocks)
            gain = _cost(stated) - _cost(minimise(problem, start, {}, MAX_FIT_ITERATIONS)[0])
        name = "probe" if one.label == DIMENSIONS else one.label
        words = f"{one.label}: check {one.source}"
        if gain > 0.0:
            yield LikelyCause(name, words, f"{one.deviation:.3g} standard deviations from the rest", gain)


def _scatter(stated: Linearization, fit: Fit) -> Iterator[LikelyCause]:
    """Yield stiffness and friction that scatter more than stated; and that all kinds do, as with another probe."""
    for scale in fit.noise:
        words = {
            "stiffness": "creep or rests between tests: the stiffness differs from test to test",
            "friction": "friction: larger than friction in [contact]",
        }.get(scale.kind)
        if scale.measured and words:
            scales = {scale.kind: scale.scale}
            point = minimise(stated.problem, stated, scales, MAX_FIT_ITERATIONS)[0]
            gain = _cost(stated) - _cost(point, scales)
            if gain > 0.0:
                yield LikelyCause(scale.kind, words, f"{scale.scale:.2g} times as large as stated", gain)
    point = minimise(stated.problem, stated, None, MAX_FIT_ITERATIONS)[0]
    scales = median_scales(point.blocks)
    worst = max(READING_KINDS, key=lambda kind: scales.get(kind, 0.0))
    yield LikelyCause("probe", "another probe than the design's, or a mistake that is not listed here: check probe and "
                      "fingerprint in campaign.toml, and the diameters of the print",
                      f"{LABELS[worst]} scatter {scales.get(worst, 1.0):.2g} times as much as stated",
                      _cost(stated) - _cost(point, scales))  # fmt: skip


def _mistakes(problem: LeastSquaresProblem, stated: Linearization | None) -> Iterator[LikelyCause]:
    """Yield mistakes in the data that the tests speak for; without a fit of the tests as stated, those that explain
    all readings."""
    prior = problem.prior.copy()
    prior[PARAMETERS["root"].columns] = 0.0  # its derivatives are half of the time
    rough = replace(problem, prior=prior)
    starts = _starts(rough)
    tried = []
    for name, words, change in _hypotheses(problem.tests):
        tests = tuple(change(test) for test in problem.tests)
        if all(_same_load(a, b) for a, b in zip(tests, problem.tests, strict=True)):
            others = [reread(one, tests) for one in starts]
        else:
            others = _starts(replace(rough, tests=tests))
        if others:
            start = min(others, key=lambda one: one.loss({}))
            tried.append((start.loss({}), name, words, start))
    tried.sort(key=lambda one: one[0])
    margin = 0.5 * chi2.isf(SOFT_CHANCE / max(len(tried), 1), 1)
    for _, name, words, start in tried[:MAX_REFINED]:
        whole = replace(problem, tests=start.problem.tests)
        point = linearize(whole, start.values, [test.nuisance for test in start.tests], start)
        if not point.ok:
            continue
        point = _refined(whole, point)
        loss, n = point.loss({}), len(whole.tests)
        if stated is None:
            expected = 0.5 * sum(chi2.median(len(block.r)) for block in point.blocks)
            if loss < MAX_LOSS * expected:
                yield LikelyCause(name, words, f"χ² of {n} tests is {2.0 * loss:.4g}, and else they have no "
                                  "equilibrium", -_cost(point))  # fmt: skip
        elif (gain := _cost(stated) - _cost(point)) > margin:
            evidence = f"χ² of {n} tests falls from {2.0 * stated.loss({}):.4g} to {2.0 * loss:.4g}"
            yield LikelyCause(name, words, evidence, gain)


def _starts(problem: LeastSquaresProblem) -> list[Linearization]:
    """Return the starts of a search with each factor on E for which the rod has an equilibrium."""
    return [point for _, point in points_at(problem, START_FACTORS[:MAX_FACTORS])]


def _same_load(a: MeasuredTest, b: MeasuredTest) -> bool:
    """Return whether two tests differ in what the reference measured alone, so that the rod is in the same state."""
    return (
        a.wrench_base is b.wrench_base and a.force_world is b.force_world and a.T_world_base is b.T_world_base
    )


def _hypotheses(tests: Sequence[MeasuredTest]) -> Iterator[tuple[str, str, Change]]:
    """Yield mistakes by name, in words, and as the change of a test that undoes them."""
    if any(test.wrench_base is not None for test in tests):
        for which, size in _signs().items():
            words = f"sign: {which} with the opposite sign; check the columns of wrenches.csv"
            yield "sign", words, partial(_scaled, factors=size)
        for which, size in _units().items():
            yield "unit", f"unit: {which}; check the columns of wrenches.csv", partial(_scaled, factors=size)
        for degrees in (90.0, 180.0, 270.0):
            words = f"mount: wrenches rotated by {degrees:g} degrees about z; check frame and clocking of the sensor"
            yield "mount", words, partial(_rotated_wrench, degrees=degrees)
    for degrees in (90.0, 180.0, 270.0):
        words = f"mount: base rotated by {degrees:g} degrees about its axis; check rotation_world_deg"
        yield "mount", words, partial(_rotated_base, degrees=degrees)
    yield "mount", "mount: inverse rotation of the base; check rotation_world_deg", _inverse_base
    if any(np.any(test.force_world) for test in tests if test.force_world is not None):
        yield (
            "sign",
            "sign: known forces with the opposite sign; check tests.csv",
            partial(_known, factor=-1.0),
        )
        yield "unit", "unit: known forces in mN; check tests.csv", partial(_known, factor=1e-3)
    if not any(len(test.marker_s) or test.p_touch_world is not None for test in tests):
        return
    for factor, which in ((1e3, "small"), (1e-3, "large")):
        words = f"unit: places of the reference a thousand times too {which}; check the columns in mm"
        yield "unit", words, partial(_resized, factor=factor)
    for axis in range(3):
        words = f"camera: {'xyz'[axis]} mirrored; check which camera is which, and the control points"
        yield "camera", words, partial(_placed, matrix=np.diag(np.where(np.arange(3) == axis, -1.0, 1.0)))
    for i, j in combinations(range(3), 2):
        words = f"camera: {'xyz'[i]} and {'xyz'[j]} exchanged; check the control points"
        yield "camera", words, partial(_placed, matrix=np.eye(3)[_swapped(3, i, j)])
    numbers = sorted({number for test in tests for number in test.marker_numbers})
    for i, j in pairwise(numbers):
        yield (
            "marker",
            f"marker: {i} and {j} exchanged; check their numbers",
            partial(_renamed, names={i: j, j: i}),
        )
    if len(numbers) > 2:
        backwards = dict(zip(numbers, numbers[::-1], strict=True))
        yield (
            "marker",
            "marker: numbered from the tip; check their numbers",
            partial(_renamed, names=backwards),
        )
        for shift, which in ((1, "low"), (-1, "high")):
            yield (
                "marker",
                f"marker: all numbers too {which} by 1; check s_mm",
                partial(_shifted, shift=shift),
            )


def _signs() -> dict[str, Array]:
    both = np.repeat([-1.0, 1.0], 3)
    signs = {"all wrenches": -np.ones(6), "forces": both, "moments": -both}
    return signs | {name: 1.0 - 2.0 * np.eye(6)[i] for i, name in enumerate(CHANNELS)}


def _units() -> dict[str, Array]:
    units = {}
    for which, one in (("forces", np.repeat([1.0, 0.0], 3)), ("moments", np.repeat([0.0, 1.0], 3))):
        units[f"{which} a thousand times too large"] = 10.0 ** (-3.0 * one)
        units[f"{which} a thousand times too small"] = 10.0 ** (3.0 * one)
    units["moments ten times too small"] = np.repeat([1.0, 10.0], 3)
    units["moments ten times too large"] = np.repeat([1.0, 0.1], 3)
    return units


def _scaled(test: MeasuredTest, factors: Array) -> MeasuredTest:
    if test.wrench_base is None:
        return test
    return replace(test, wrench_base=factors * test.wrench_base)


def _rotated_wrench(test: MeasuredTest, degrees: float) -> MeasuredTest:
    if test.wrench_base is None:
        return test
    R = Rotation.from_rotvec([0.0, 0.0, np.radians(degrees)])
    return replace(test, wrench_base=R.apply(test.wrench_base.reshape(2, 3)).ravel())


def _rotated_base(test: MeasuredTest, degrees: float) -> MeasuredTest:
    T = test.T_world_base.copy()
    T[:3, :3] = T[:3, :3] @ Rotation.from_rotvec([0.0, 0.0, np.radians(degrees)]).as_matrix()
    return replace(test, T_world_base=T)


def _inverse_base(test: MeasuredTest) -> MeasuredTest:
    T = test.T_world_base.copy()
    T[:3, :3] = T[:3, :3].T
    return replace(test, T_world_base=T)


def _known(test: MeasuredTest, factor: float) -> MeasuredTest:
    return test if test.force_world is None else replace(test, force_world=factor * test.force_world)


def _placed(test: MeasuredTest, matrix: Array) -> MeasuredTest:
    """Return the test with its places mapped about the base."""
    origin = test.T_world_base[:3, 3]
    touch = test.p_touch_world
    return replace(
        test,
        p_markers_world=origin + (test.p_markers_world - origin) @ matrix.T,
        p_touch_world=None if touch is None else origin + matrix @ (touch - origin),
    )


def _resized(test: MeasuredTest, factor: float) -> MeasuredTest:
    touch = test.p_touch_world
    return replace(
        test,
        p_markers_world=factor * test.p_markers_world,
        p_touch_world=None if touch is None else factor * touch,
    )


def _swapped(n: int, i: int, j: int) -> list[int]:
    order = list(range(n))
    order[i], order[j] = j, i
    return order


def _renamed(test: MeasuredTest, names: dict[int, int]) -> MeasuredTest:
    """Return the test with markers that are measured under other numbers."""
    where = {number: i for i, number in enumerate(test.marker_numbers)}
    order = [where.get(names.get(number, number), i) for i, number in enumerate(test.marker_numbers)]
    return replace(test, p_markers_world=test.p_markers_world[order], cov_markers=test.cov_markers[order])


def _shifted(test: MeasuredTest, shift: int) -> MeasuredTest:
    """Return the test with the arclength of each marker that of its neighbour; that of the last one is extrapolated."""
    s = test.marker_s
    if len(s) < 2:
        return test
    end = 2.0 * s[-1] - s[-2] if shift > 0 else max(2.0 * s[0] - s[1], 0.0)
    return replace(test, marker_s=np.append(s[1:], end) if shift > 0 else np.append(end, s[:-1]))
