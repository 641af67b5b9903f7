"""Likely causes of a contradiction: what would have to be different for the tests to agree.

Each hypothesis is a mistake in the data folder that is undone, or a prior that is dropped. The evidence for it is the
gain of the log-likelihood: of a fit to the changed data, or half the squared deviation of the prior. The likeliest
cause comes first.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, pairwise

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from probedesign.core.frames import Array
from probedesign.identification.fit_checks import LABELS, PriorTest
from probedesign.identification.parameters import CHANNELS
from probedesign.identification.residuals import MeasuredTest
from probedesign.identification.solver import Fit, LeastSquaresProblem, Linearization, minimise
from probedesign.identification.starting_values import START_FACTORS, points_at

MAX_REFINED = 5
"""Hypotheses that are fitted; of the others only the start of the search is compared."""
MAX_FIT_ITERATIONS = 8
MAX_TESTS, MAX_FACTORS = 6, 3
"""Tests and factors on E that hypotheses are compared with."""
SOFT_CHANCE = 0.01
"""Chance of a deviation of a prior up to which it is listed as a likely cause."""
MIN_EXPLAINED = 0.5
"""Fraction of the misfit that a mistake must explain, else another probe is suspected (assumed)."""

Change = Callable[[MeasuredTest], MeasuredTest]


@dataclass(frozen=True)
class LikelyCause:
    """A likely cause of a contradiction.

    Attributes:
        name: sign, unit, mount, camera, marker, probe, friction, stiffness, noise, or the prior's name.
        words: what is likely wrong, and what to check.
        evidence: the number that speaks for it.
        gain: of the log-likelihood.
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
    causes = [*_soft(fit, priors), *_mistakes(fit)]
    return tuple(sorted(causes, key=lambda one: -one.gain))


def _soft(fit: Fit, priors: Sequence[PriorTest]) -> Iterator[LikelyCause]:
    """Yield priors that deviate, and kinds of readings that scatter more than stated."""
    for one in priors:
        if one.chance < SOFT_CHANCE:
            yield LikelyCause(one.label, f"{one.label}: check {one.source}",
                              f"{one.deviation:.3g} standard deviations from the rest", one.gain)  # fmt: skip
    for scale in fit.noise:
        if scale.measured:
            name = {"stiffness": "stiffness", "friction": "friction"}.get(scale.kind, "noise")
            gain = scale.freedom * (0.5 * (scale.scale**2 - 1.0) - np.log(scale.scale))
            words = {
                "stiffness": "creep or rests between tests: the stiffness differs from test to test",
                "friction": "friction: larger than friction in [contact]",
            }.get(scale.kind, f"noise of {LABELS[scale.kind]}")
            # noise fits anything: it comes after a cause that explains the same
            yield LikelyCause(name, words, f"{scale.scale:.2g} times as large as stated", 0.1 * float(gain))


def _mistakes(fit: Fit) -> Iterator[LikelyCause]:
    """Yield mistakes in the data that explain a part of the misfit."""
    problem = _some_tests(fit.point.problem)
    starts = _starts(problem)
    if not starts:
        return
    misfit = _fitted_loss(problem, min(starts, key=lambda start: start.loss({})))
    expected = 0.5 * sum(chi2.median(len(block.r)) for block in starts[0].blocks)
    tried = []
    for name, words, change in _hypotheses(problem.tests):
        other = replace(problem, tests=tuple(change(test) for test in problem.tests))
        others = _starts(other)
        if others:
            start = min(others, key=lambda one: one.loss({}))
            tried.append((start.loss({}), name, words, other, start))
    tried.sort(key=lambda one: one[0])
    best = 0.0
    for _, name, words, other, start in tried[:MAX_REFINED]:
        loss = _fitted_loss(other, start)
        if loss < misfit - 0.5 * chi2.isf(SOFT_CHANCE / len(tried), 1):
            best = max(best, (misfit - loss) / max(misfit - expected, 1e-9))
            evidence = f"χ² of {len(problem.tests)} tests falls from {2.0 * misfit:.4g} to {2.0 * loss:.4g}"
            yield LikelyCause(name, words, evidence, misfit - loss)
    if best < MIN_EXPLAINED:
        yield LikelyCause("probe", "another probe than the design's: check probe and fingerprint in campaign.toml, and "
                          "the diameters of the print",
                          f"no mistake in the tables explains half of χ² {2.0 * misfit:.4g}",
                          misfit - expected)  # fmt: skip


def _some_tests(problem: LeastSquaresProblem) -> LeastSquaresProblem:
    """Return the problem with tests that are spread over the campaign: a mistake of the whole folder is in all."""
    n = len(problem.tests)
    at = np.unique(np.linspace(0, n - 1, min(n, MAX_TESTS)).round().astype(int))
    return replace(problem, tests=tuple(problem.tests[i] for i in at))


def _starts(problem: LeastSquaresProblem) -> list[Linearization]:
    """Return the starts of a search with each factor on E for which the rod has an equilibrium."""
    return [point for _, point in points_at(problem, START_FACTORS[:MAX_FACTORS])]


def _fitted_loss(problem: LeastSquaresProblem, start: Linearization) -> float:
    """Return the loss with the stated noise after a few steps of the search."""
    return minimise(problem, start, None, MAX_FIT_ITERATIONS)[0].loss({})


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
    """Return the test with the arclength of each marker that of its neighbour; the last one is left out."""
    n = len(test.marker_s)
    if n < 2:
        return test
    keep = slice(0, n - 1) if shift > 0 else slice(1, n)
    s = test.marker_s[1:] if shift > 0 else test.marker_s[:-1]
    return replace(test, marker_s=s, p_markers_world=test.p_markers_world[keep], cov_markers=test.cov_markers[keep],
                   marker_numbers=test.marker_numbers[keep])  # fmt: skip
