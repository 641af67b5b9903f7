"""Least squares over a whole campaign: Levenberg and Marquardt's steps on all unknowns at once."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from probedesign.frames import Array
from probedesign.identification.guess import Guess
from probedesign.identification.parameters import PARTS, ROOT, Shared
from probedesign.identification.residuals import Bent, Group, bend
from probedesign.identification.robust import Noise, loss, median_scales, noise_of, weights
from probedesign.identification.trial import Trial
from probedesign.identification.weighed import Weighed

MAX_STEPS = 60
LEAST_DAMPING, MOST_DAMPING = 1e-9, 1e8
LEAST_GAIN = 1e-3
"""Of the loss, half a χ², that ends a search: within a twentieth of a standard deviation of the least. The rod's own
digits, a micrometre and a millionth of the moment, make the loss uncertain by about as much."""
FARTHEST = 3.0
"""Logarithm of a factor on the design's value: no probe is twenty times stiffer than designed."""
ROUNDS = 4
"""How often the scatter of a kind is told anew from the misfits."""


@dataclass(frozen=True)
class Problem:
    """What is fitted.

    Attributes:
        shared: what the tests share.
        trials: the tests.
        weighed: the probe on scales; None if it was not.
        prior: standard deviations of the shared vector: infinite for what is asked for, 0 for what is held.
    """

    shared: Shared
    trials: tuple[Trial, ...]
    weighed: Weighed | None
    prior: Array

    @cached_property
    def active(self) -> Array:
        """Which of the shared vector move, (size,) of bool."""
        return np.asarray(self.prior > 0.0)

    @property
    def size(self) -> int:
        """Of all unknowns that move."""
        return int(self.active.sum()) + sum(trial.own for trial in self.trials)

    @property
    def slices(self) -> list[slice]:
        """Where each test's own unknowns stand behind the shared ones."""
        ends = np.cumsum([int(self.active.sum())] + [trial.own for trial in self.trials])
        return [slice(int(a), int(b)) for a, b in itertools.pairwise(ends)]


@dataclass(frozen=True)
class Point:
    """The campaign solved with one guess.

    Attributes:
        problem: what is fitted.
        guess: of what is shared.
        bents: the tests, solved.
        groups: all misfits.
    """

    problem: Problem
    guess: Guess
    bents: tuple[Bent, ...]
    groups: tuple[Group, ...]

    @property
    def ok(self) -> bool:
        """Whether the rod holds in every test."""
        return all(bent.ok for bent in self.bents)

    @cached_property
    def prior_misfit(self) -> Array:
        """Of the shared vector about its prior, (active,)."""
        std = self.problem.prior[self.problem.active]
        return np.where(np.isinf(std), 0.0, self.guess.x[self.problem.active] / std)

    def loss(self, scales: dict[str, float]) -> float:
        """What is made small."""
        return loss(self.groups, scales) + 0.5 * float(self.prior_misfit @ self.prior_misfit)

    def system(self, weight: Array) -> tuple[Array, Array]:
        """All misfits as rows (n, size), weighted, priors first, and their values (n,)."""
        active, size = self.problem.active, self.problem.size
        shared = int(active.sum())
        std = self.problem.prior[active]
        rows, values = [np.zeros((shared, size))], [self.prior_misfit]
        rows[0][:, :shared] = np.diag(np.where(np.isinf(std), 0.0, 1.0 / std))
        at = {bent.trial.name: place for bent, place in zip(self.bents, self.problem.slices, strict=True)}
        for group, w in zip(self.groups, weight, strict=True):
            block = np.zeros((len(group.r), size))
            block[:, :shared] = group.J[:, active]
            if group.test in at:
                block[:, at[group.test]] = group.own
            rows.append(np.sqrt(w) * block)
            values.append(np.sqrt(w) * group.r)
        return np.concatenate(rows), np.concatenate(values)

    def columns_of(self, places: Sequence[int], weight: Array) -> Array:
        """The same rows by shared unknowns that are held, (n, len(places))."""
        top = np.zeros((int(self.problem.active.sum()), len(places)))
        rows = [np.sqrt(w) * group.J[:, places] for group, w in zip(self.groups, weight, strict=True)]
        return np.concatenate([top, *rows])


def solve_at(problem: Problem, guess: Guess, owns: Sequence[Array], last: Point | None = None,
             root: bool = False) -> Point:  # fmt: skip
    """Solve every test with a guess; the scales too."""
    wanted = root or bool(problem.active[PARTS.index(ROOT)])
    bents = []
    for i, (trial, own) in enumerate(zip(problem.trials, owns, strict=True)):
        tip = last.bents[i].eq.tip if last is not None else None
        bents.append(bend(trial, guess, own, tip, wanted))
        if not bents[-1].ok:
            return Point(problem, guess, tuple(bents), ())
    groups = [group for bent in bents for group in bent.groups()]
    if problem.weighed is not None:
        groups.append(problem.weighed.group(guess))
    return Point(problem, guess, tuple(bents), tuple(groups))


@dataclass(frozen=True)
class Fit:
    """The end of a search.

    Attributes:
        result: "ok" or "not_converged".
        point: where it ended.
        scales: of each kind's scatter, over what is stated.
        noise: how they were told.
        steps: how many were taken.
    """

    result: str
    point: Point
    scales: dict[str, float]
    noise: tuple[Noise, ...]
    steps: int

    @cached_property
    def weight(self) -> Array:
        """Of each group."""
        return weights(self.point.groups, self.scales)

    @cached_property
    def root_of_information(self) -> tuple[Array, Array]:
        """Triangle R with Rᵀ R the information on all unknowns, over units, and the units (size,)."""
        rows, _ = self.point.system(self.weight)
        units = units_of(rows)
        return np.asarray(np.linalg.qr(rows * units, mode="r")), units

    @cached_property
    def cov(self) -> Array:
        """Of all unknowns that move, shared ones first."""
        R, units = self.root_of_information
        inverse = np.linalg.pinv(R)
        return np.asarray(units[:, None] * (inverse @ inverse.T) * units)


def units_of(rows: Array) -> Array:
    """Lengths of the columns, to be told alike; 1 where nothing answers."""
    size = np.linalg.norm(rows, axis=0)
    return np.where(size > 0.0, 1.0 / np.where(size > 0.0, size, 1.0), 1.0)


def fit(problem: Problem, start: Point) -> Fit:
    """Search from a point where every test holds.

    The scatter follows the median until nothing moves; then it is told by the misfits that the unknowns leave, and the
    search goes on from there.
    """
    point, steps, done = _descend(problem, start, None)
    scales: dict[str, float] = {}
    noise: list[Noise] = []
    for _ in range(ROUNDS):
        weight = weights(point.groups, scales)
        noise = noise_of(point.groups, weight, _leverage(point, weight), scales)
        told = {one.kind: one.scale for one in noise}
        settled = bool(scales) and all(abs(told[k] / scales[k] - 1.0) < 0.02 for k in told)
        scales = told
        point, more, done = _descend(problem, point, scales)
        steps += more
        if settled:
            break
    return Fit("ok" if done else "not_converged", point, scales, tuple(noise), steps)


def _leverage(point: Point, weight: Array) -> Array:
    """How many of each group's misfits the unknowns take up, (n,)."""
    rows, _ = point.system(weight)
    q = np.linalg.qr(rows * units_of(rows))[0]
    each = np.sum(q * q, axis=1)
    ends = np.cumsum([int(point.problem.active.sum())] + [len(group.r) for group in point.groups])
    return np.array([each[a:b].sum() for a, b in itertools.pairwise(ends)])


def _descend(problem: Problem, point: Point, scales: dict[str, float] | None) -> tuple[Point, int, bool]:
    """Steps until no more is to be gained; scales by the median of each step if none are given."""
    damping = LEAST_DAMPING
    for steps in range(MAX_STEPS):
        used = median_scales(point.groups) if scales is None else scales
        rows, values = point.system(weights(point.groups, used))
        units = units_of(rows)
        q, R = np.linalg.qr(rows * units)
        inner = q.T @ values
        if _gain(R, inner, _step(R, inner, LEAST_DAMPING)) < LEAST_GAIN:
            return point, steps, True
        moved, least = None, point.loss(used)
        while moved is None and damping < MOST_DAMPING:
            moved = _moved(problem, point, units * _step(R, inner, damping))
            if moved is not None and moved.loss(used) > least:
                moved = None
            damping = 10.0 * max(damping, 1e-5) if moved is None else max(damping / 10.0, LEAST_DAMPING)
        if moved is None:
            return point, steps, False
        point = moved
    return point, MAX_STEPS, False


def _step(R: Array, inner: Array, damping: float) -> Array:
    """Of unknowns in units in which each by itself makes misfits of 1; R the triangle of their rows."""
    size = len(R)
    damped = np.concatenate([R, np.sqrt(damping) * np.eye(size)])
    return np.asarray(np.linalg.lstsq(damped, -np.concatenate([inner, np.zeros(size)]))[0])


def _gain(R: Array, inner: Array, step: Array) -> float:
    """By which half the sum of squares would fall, were it as the rows have it."""
    after = inner + R @ step
    return 0.5 * float(inner @ inner - after @ after)


def _moved(problem: Problem, point: Point, step: Array) -> Point | None:
    """The campaign after a step of all unknowns; None where that leaves all reason or the rod does not hold."""
    x = point.guess.x.copy()
    x[problem.active] += step[: int(problem.active.sum())]
    if np.abs(x[:4]).max() > FARTHEST:
        return None
    owns = []
    for bent, at in zip(point.bents, problem.slices, strict=True):
        own = bent.own + step[at]
        if bent.trial.slides:
            own[-1] = np.clip(own[-1], 0.0, problem.shared.model.rod.flank_end)
        owns.append(own)
    moved = solve_at(problem, Guess(problem.shared, x), owns, point)
    return moved if moved.ok else None
