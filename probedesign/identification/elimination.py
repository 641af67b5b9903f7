"""Normal equations of a campaign: the own unknowns of each test are eliminated by QR, the common ones solved for.

The rows of one test depend on the common unknowns (A) and on its own (B). With B = Q₁ R, [Q₁ Q₂] orthogonal, Q₂ᵀA are
the rows that are left for the common unknowns, and δν = -R⁻¹ Q₁ᵀ (r + A δx). Time grows with the number of tests, not
with its cube, as that of one dense system does.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from probedesign.core.frames import Array


@dataclass(frozen=True)
class TestRows:
    """Weighted rows of one test, or of the readings that belong to none."""

    __test__ = False  # no test of pytest

    A: Array  #: derivatives by the common unknowns, (k, n).
    B: Array  #: by its own unknowns, (k, m).
    r: Array  #: residuals, (k,).

    def eliminated(self, damping: float) -> "EliminatedRows":
        """Return the rows with the own unknowns eliminated, each damped by a fraction of its information; those without
        any keep their values."""
        k, m = self.B.shape
        B, A, r = self.B, self.A, self.r
        if m:
            size = np.linalg.norm(B, axis=0)
            B = np.concatenate([B, np.diag(np.where(size > 0.0, np.sqrt(damping) * size, 1.0))])
            A = np.concatenate([A, np.zeros((m, A.shape[1]))])
            r = np.concatenate([r, np.zeros(m)])
        Q, R = np.linalg.qr(B, mode="complete") if m else (np.eye(k), np.zeros((k, 0)))
        rotated, turned = Q.T @ A, Q.T @ r
        return EliminatedRows(Q[:k], R[:m], rotated, turned, m)


@dataclass(frozen=True)
class EliminatedRows:
    """Rows of one test after an orthogonal transformation; the first m determine its own unknowns."""

    Q: Array  #: orthogonal, of the test's own rows, (k, k + m).
    R: Array  #: upper triangular, (m, m).
    A: Array  #: transformed derivatives by the common unknowns, (k + m, n).
    r: Array  #: transformed residuals, (k + m,).
    m: int  #: number of own unknowns.

    def own_step(self, step: Array) -> Array:
        """Return the step of the test's own unknowns after one of the common unknowns."""
        if self.m == 0:
            return np.zeros(0)
        right = -(self.r[: self.m] + self.A[: self.m] @ step)
        return np.asarray(solve_triangular(self.R, right))


@dataclass(frozen=True)
class NormalEquations:
    """Normal equations of the common unknowns."""

    tests: Sequence[EliminatedRows]  #: eliminated rows, of readings that belong to no test last.
    prior: Array  #: information of the priors on each common unknown, (n,).
    gradient_of_prior: Array  #: their part of the gradient, (n,).
    damping: float  #: fraction of its information that each unknown is damped by.

    @cached_property
    def information(self) -> Array:
        """Information on the common unknowns, all own ones marginalised, (n, n)."""
        N = np.diag(self.prior)
        for test in self.tests:
            left = test.A[test.m :]
            N += left.T @ left
        return N

    @cached_property
    def gradient(self) -> Array:
        """Gradient of half the χ² by the common unknowns, (n,)."""
        g = self.gradient_of_prior.copy()
        for test in self.tests:
            g += test.A[test.m :].T @ test.r[test.m :]
        return g

    @cached_property
    def units(self) -> Array:
        """Inverse roots of the diagonal of the information: units in which the unknowns are comparable, (n,)."""
        size = np.sqrt(np.diag(self.information))
        return np.where(size > 0.0, 1.0 / np.where(size > 0.0, size, 1.0), 1.0)

    def _scaled(self, damping: float) -> Array:
        scaled = self.information * np.outer(self.units, self.units)
        # at least the rounding of a sum of squares, so that what nothing determines stays where it is
        return np.asarray(scaled + max(damping, 1e-13) * np.eye(len(scaled)))

    @cached_property
    def steps(self) -> tuple[Array, list[Array], float]:
        """The damped step of the common unknowns, those of each test's own, and the decrease of half the χ² that the
        linear model expects of it."""
        g = self.units * self.gradient
        step = -cho_solve(cho_factor(self._scaled(self.damping)), g)
        gain = -0.5 * float(g @ step) + 0.5 * sum(float(t.r[: t.m] @ t.r[: t.m]) for t in self.tests)
        step = self.units * step
        return step, [test.own_step(step) for test in self.tests], gain

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the common unknowns, (n, n)."""
        n = len(self.units)
        inverse = cho_solve(cho_factor(self._scaled(0.0)), np.eye(n))
        return np.asarray(inverse * np.outer(self.units, self.units))

    @cached_property
    def log_volume(self) -> float:
        """Half the logarithm of the determinant of the information on all unknowns."""
        common = 0.5 * np.linalg.slogdet(self._scaled(0.0))[1] - np.log(self.units).sum()
        own = sum(float(np.log(np.maximum(np.abs(np.diag(test.R)), 1e-12)).sum()) for test in self.tests)
        return float(common + own)

    def hat(self, i: int) -> Array:
        """Return what the fit absorbs of the residuals of one test, their hat matrix, (k, k)."""
        test = self.tests[i]
        Q1, Q2 = test.Q[:, : test.m], test.Q[:, test.m :]
        left = test.A[test.m :]
        return np.asarray(Q1 @ Q1.T + Q2 @ (left @ self.covariance @ left.T) @ Q2.T)

    def marginal(self, columns: Sequence[int]) -> Array:
        """Return the information on some common unknowns, all others marginalised."""
        N = self._scaled(0.0)
        others = np.setdiff1d(np.arange(len(N)), columns)
        at = np.asarray(columns)
        if len(others):
            across = N[np.ix_(others, at)]
            left = N[np.ix_(at, at)] - across.T @ cho_solve(cho_factor(N[np.ix_(others, others)]), across)
        else:
            left = N
        size = 1.0 / self.units[at]
        return np.asarray(left * np.outer(size, size))
