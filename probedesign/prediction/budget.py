"""Error budget of one touch: its covariance by error source, to first order, and the 95 % radius of a covariance.

The prediction is the information matrix of the residuals that the estimator minimises. With H and X the derivatives of
base wrench and point by the five unknowns of a touch, D and Q the columns of the error sources, a reading has the
covariance Σ = noise + drift + D Dᵀ and the touch C = (Hᵀ Σ⁻¹ H + P)⁻¹, P = diag(0, 0, 0, 1/μ², 1/μ²) the prior on
friction. The gain K = C Hᵀ Σ⁻¹ maps each part of the reading's error to one of the point:

    cov = X K (noise + drift) Kᵀ Xᵀ + Σ_j (X K d_j - q_j)(X K d_j - q_j)ᵀ + X C P C Xᵀ,

which is the estimator's own first-order covariance (`uncertainty_kernel.posterior`). The budget lists those terms for a
contact without friction, μ = 0; the source "friction" is what the prior on friction adds to their sum, so that all
sources add up to the total. Where a free direction of the force reduces the error slightly, which happens because one
reading does not correct the point for the error sources, the others are scaled to the total and friction is zero.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, erf

from probedesign.core.frames import Array
from probedesign.core.statistics import rms_each, whiten
from probedesign.estimation.contact_fit import MIN_FRICTION
from probedesign.estimation.error_sources import CAUSES as SOURCES
from probedesign.estimation.error_sources import ErrorSources
from probedesign.estimation.model import covariance
from probedesign.rod.contact import outline
from probedesign.rod.kernels.surface_contact import ALONG, AROUND, BY_TOUCH, CENTRE, PHI, POINT, UNKNOWNS, VALUE, S

CAUSES = (*SOURCES, "friction")  #: Error sources of a single touch, in the order of the tables.


@dataclass(frozen=True)
class ErrorBudget:
    """Error budgets of n touches: NaN without a touch, infinite where a reading does not determine the position."""

    cov: Array  #: of the touched point [m²] by error source, (n, causes, 3, 3).
    total: Array  #: of the touched point by all error sources [m²], (n, 3, 3).
    cov_centre: Array  #: of the centreline point by all error sources [m²], (n, 3, 3).
    cov_noise: Array  #: of the touched point by sensor noise and the prior on friction alone [m²], (n, 3, 3).
    std_s: Array  #: standard deviation of s_contact by all error sources [m], (n,).

    @property
    def rms(self) -> Array:
        """Return the RMS error by source [m], (n, causes)."""
        return rms_each(self.cov)


def error_budget(touch: Array, lin: Array, D: Array, sources: ErrorSources, friction: float) -> ErrorBudget:
    """Split the errors of single readings by source.

    Args:
        touch: unknowns, dead loads and tip of each, (n, TOUCH).
        lin: linearisations, (n, ROWS, 1 + UNKNOWNS + parameters); NaN where there is no touch.
        D: error columns, (n, 12, J).
        sources: whose columns they are.
        friction: prior standard deviation of the friction ratio; inf leaves the direction of the force free.
    """
    n, of = len(lin), np.flatnonzero(np.isfinite(lin[:, 0, VALUE]))
    total, centre, noise = (np.full((n, 3, 3), np.nan) for _ in range(3))
    budget = ErrorBudget(np.full((n, len(CAUSES), 3, 3), np.nan), total, centre, noise, np.full(n, np.nan))
    if len(of):
        parts = LinearizedTouches.of(touch[of], lin[of], D[of], sources).split(friction)
        for into, part in zip((budget.cov, total, centre, noise, budget.std_s), parts, strict=True):
            into[of] = part
    return budget


@dataclass(frozen=True)
class LinearizedTouches:
    """Linearised touches, all of them valid."""

    #: H, X, X_centre: of wrench, touched point and centreline point by the touch, (n, 6, 5), (n, 3, 5), (n, 3, 5).
    H: Array
    X: Array
    X_centre: Array
    D: Array  #: D, Q, Q_centre: of the same by the error sources, (n, 6, J), (n, 3, J), (n, 3, J).
    Q: Array
    Q_centre: Array
    noise: Array  #: covariance of a reading by noise, (n, 6, 6).
    drift: Array  #: covariance by drift, (6, 6).
    names: tuple[str, ...]  #: of the columns.
    by_s: Array  #: derivative of s_contact by the touch, (n, 5).

    @classmethod
    def of(cls, touch: Array, lin: Array, D: Array, sources: ErrorSources) -> "LinearizedTouches":
        """Return the linearisations of touches; the arguments are those of `error_budget`."""
        by = slice(BY_TOUCH, BY_TOUCH + UNKNOWNS)
        # At forces normal to the surface, `rod.kernels.surface_contact.offset_along` has these derivatives; of a round
        # section ∂/∂s = 1 + tan² α and ∂/∂a_2 = r / cos² α alone.
        rod, s = sources.model.rod, touch[:, S]
        reach, aside = outline(rod.flatness, np.cos(touch[:, PHI]), np.sin(touch[:, PHI]))
        radius, tan = rod.radius_at(s), reach * rod.taper_at(s)
        by_s = np.zeros((len(s), UNKNOWNS))
        by_s[:, S] = 1.0 + tan**2
        by_s[:, PHI] = -2.0 * radius * aside * tan
        by_s[:, AROUND] = radius * aside * tan * np.sqrt(by_s[:, S])
        by_s[:, ALONG] = radius * reach * by_s[:, S]
        noise = np.array([covariance(sources.model, wrench) for wrench in lin[:, 0:6, VALUE]])
        return cls(
            lin[:, 0:6, by], lin[:, POINT : POINT + 3, by], lin[:, CENTRE : CENTRE + 3, by],
            D[:, 0:6], D[:, 6:9], D[:, 9:12], noise, sources.drift, sources.names, by_s,
        )  # fmt: skip

    def split(self, friction: float) -> tuple[Array, Array, Array, Array, Array]:
        """Return the covariance by source, total, of the centreline point and by noise alone, and std of s_contact."""
        W = whiten(self._known(self.noise))
        known, root, gain = self.solve(W, friction)
        total = self._total(self.X, self.Q, root, gain)
        centre = self._total(self.X_centre, self.Q_centre, root, gain)
        std_s = np.linalg.norm(np.einsum("ni,nij->nj", self.by_s, root), axis=1)
        noise_root = self.X @ self.solve(whiten(self.noise), friction)[1]
        noise = noise_root @ np.swapaxes(noise_root, 1, 2)
        without = self.solve(W, 0.0)[2]
        parts = dict(self.parts(self.X @ without))
        cov = np.stack([parts[name] for name in SOURCES], axis=1)
        whole = np.trace(cov.sum(axis=1), axis1=1, axis2=2)
        cov = cov * np.minimum(np.trace(total, axis1=1, axis2=2) / whole, 1.0)[:, None, None, None]
        cov = np.concatenate([cov, (total - cov.sum(axis=1))[:, None]], axis=1)
        for of in (cov, total, centre, noise, std_s):
            of[~known] = np.inf
        return cov, total, centre, noise, std_s

    def _known(self, noise: Array) -> Array:
        return np.asarray(noise + self.drift + self.D @ np.swapaxes(self.D, 1, 2))

    def _total(self, X: Array, Q: Array, root: Array, gain: Array) -> Array:
        by_reading, cross = X @ root, X @ gain @ self.D @ np.swapaxes(Q, 1, 2)
        return np.asarray(
            by_reading @ np.swapaxes(by_reading, 1, 2) + Q @ np.swapaxes(Q, 1, 2) - cross - np.swapaxes(cross, 1, 2)
        )

    def parts(self, gain: Array) -> list[tuple[str, Array]]:
        """Return each source with its covariance of the touched point, given its gain on the reading, (n, 3, 6)."""
        parts = [("noise", gain @ self.noise @ np.swapaxes(gain, 1, 2)),
                 ("drift", gain @ self.drift @ np.swapaxes(gain, 1, 2))]  # fmt: skip
        error = gain @ self.D - self.Q
        for name in SOURCES[2:]:
            here = error[:, :, [c for c, of in enumerate(self.names) if of == name]]
            parts.append((name, here @ np.swapaxes(here, 1, 2)))
        return parts

    def solve(self, W: Array, friction: float) -> tuple[NDArray[np.bool_], Array, Array]:
        """Return whether the touch is observable, a root of its covariance C, (n, 5, 5), and its gain, (n, 5, 6)."""
        n = len(self.H)
        J = np.zeros((n, 6 + 2, UNKNOWNS))
        J[:, :6] = W @ self.H
        if math.isfinite(friction):
            J[:, 6, ALONG - 1] = J[:, 7, ALONG] = 1.0 / max(friction, MIN_FRICTION)
        scale = np.linalg.norm(J, axis=1)
        scale = np.where(scale > 0.0, scale, 1.0)
        R = np.linalg.qr(J / scale[:, None, :])[1]
        known = np.asarray(np.abs(np.diagonal(R, axis1=1, axis2=2)).min(axis=1) >= 1e-12)
        R = np.where(known[:, None, None], R, np.eye(UNKNOWNS))
        root = np.linalg.inv(R) / scale[:, :, None]
        gain = root @ np.swapaxes(J[:, :6] @ root, 1, 2) @ W
        return known, root, gain


SHARE = 0.95  #: Of the errors that lie within a radius.
_NODES = 16
_AT_ONCE = 512  # covariances: what fits into a cache
_HALLEY = 3  # steps, each of which trebles the digits
# u is at angle arccos c from the longest axis. Nodes squeezed towards c = 0 keep needle-like ellipsoids exact.
_X, _W = np.polynomial.legendre.leggauss(_NODES)
_PHI = (np.arange(_NODES // 2) + 0.5) * (np.pi / _NODES)
_C2 = np.repeat(((_X + 1.0) / 2.0) ** 6, len(_PHI))
_COS2 = np.tile(np.cos(_PHI) ** 2, _NODES)
_WEIGHT = np.repeat(1.5 * ((_X + 1.0) / 2.0) ** 2 * _W, len(_PHI)) / len(_PHI)


def radius_95(cov: Array) -> float:
    """Return `radii_95` of one covariance (3, 3)."""
    return float(radii_95(np.asarray(cov, dtype=float)[None])[0])


def radii_95(cov: Array) -> Array:
    """Return the radii r with P(|e| ≤ r) = 95 % for normal errors e with zero mean.

    With e of length ρ sqrt(uᵀ cov u), ρ² is chi-square of three degrees of freedom, independent of the direction u,
    which is uniform on the sphere. P is the mean over u of the chi-square distribution at r²/(uᵀ cov u), by
    Gauss-Legendre and trapezoidal quadrature on one octant. Halley's method solves for r, starting between a line, a
    disc and a ball.

    Args:
        cov: [m²], (n, 3, 3), each positive semidefinite.

    Returns:
        Radii [m], (n,); NaN or infinite where a covariance is.
    """
    finite = np.asarray(np.isfinite(cov).all(axis=(1, 2)))
    radii = np.where(np.isnan(cov).any(axis=(1, 2)), np.nan, np.inf)
    eigenvalues = np.clip(np.linalg.eigvalsh(np.where(finite[:, None, None], cov, 0.0)), 0.0, None)
    radii[finite] = 0.0
    for first in range(0, len(cov), _AT_ONCE):
        part = np.arange(first, min(first + _AT_ONCE, len(cov)))
        part = part[eigenvalues[part, 2] > 0.0]
        radii[part] = np.sqrt(eigenvalues[part, 2]) * _of_largest(eigenvalues[part])
    return np.asarray(radii)


def _of_largest(eigenvalues: Array) -> Array:
    """Return radii relative to the longest axis, (n,), for ascending eigenvalues (n, 3)."""
    low, middle = (eigenvalues[:, i, None] / eigenvalues[:, 2, None] for i in (0, 1))
    across = low * _COS2 + middle * (1.0 - _COS2)
    inverse = 1.0 / np.sqrt(np.maximum(_C2 + (1.0 - _C2) * across, 1e-300))
    line, disc, ball = (math.sqrt(float(chdtri(dof, 1.0 - SHARE))) for dof in (1, 2, 3))
    r = (line**2 + (disc**2 - line**2) * middle + (ball**2 - disc**2) * low)[:, 0] ** 0.5
    for _ in range(_HALLEY):
        x = r[:, None] * inverse
        square = x * x
        bell = math.sqrt(2.0 / math.pi) * x * np.exp(-0.5 * square)
        slopes = bell * inverse
        excess = (erf(x * math.sqrt(0.5)) - bell) @ _WEIGHT - SHARE
        slope = (slopes * x) @ _WEIGHT
        bend = (slopes * inverse * (2.0 - square)) @ _WEIGHT
        r = r - 2.0 * excess * slope / (2.0 * slope * slope - excess * bend)
    return r
