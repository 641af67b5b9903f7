"""Where the error of one touch comes from: its covariance by cause, to first order.

The prediction is the information matrix of the residuals that the estimator minimises. With H and X the derivatives of
base wrench and point by the five unknowns of a touch, D and Q the columns of the error sources, a reading is known to
Σ = noise + drift + D Dᵀ and the touch to C = (Hᵀ Σ⁻¹ H + P)⁻¹, P = diag(0, 0, 0, 1/μ², 1/μ²) the prior on friction.
The gain K = C Hᵀ Σ⁻¹ turns each part of the reading's error into one of the point:

    cov = X K (noise + drift) Kᵀ Xᵀ + Σ_j (X K d_j - q_j)(X K d_j - q_j)ᵀ + X C P C Xᵀ,

which is the estimator's own first-order covariance (`uncertainty_kernel.posterior`). The causes are those terms for a
contact without friction, μ = 0; the cause "friction" is what the prior on friction adds to their sum, so all causes add
up to the total. Where a free direction of the force makes the error smaller by a little, which happens as one reading
does not correct the point for the error sources, the others are scaled to the total and friction is none.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from probedesign.estimation.contact_fit import MIN_FRICTION
from probedesign.estimation.error_sources import CAUSES as SOURCES
from probedesign.estimation.error_sources import ErrorSources
from probedesign.estimation.observation import covariance
from probedesign.estimation.surface_contact_kernel import (
    ALONG,
    BY_TOUCH,
    CENTRE,
    POINT,
    UNKNOWNS,
    VALUE,
    S,
)
from probedesign.frames import Array
from probedesign.rod.rod import Rod

CAUSES = (*SOURCES, "friction")
"""Of the error of a single touch, in the order of the tables."""


@dataclass(frozen=True)
class Budget:
    """Errors of n touched points; NaN where there is no touch, infinite where a reading leaves the place open.

    Attributes:
        cov: of the touched point [m²] by cause, (n, causes, 3, 3).
        total: by all causes [m²], (n, 3, 3).
        cov_centre: likewise of the centreline's point, by all causes [m²], (n, 3, 3).
        cov_noise: of the touched point by the sensor's noise and the prior on friction where all else is exactly known
            [m²], (n, 3, 3).
        std_s: of s_contact, by all causes [m], (n,).
    """

    cov: Array
    total: Array
    cov_centre: Array
    cov_noise: Array
    std_s: Array

    @property
    def rms(self) -> Array:
        """Of each cause [m], (n, causes)."""
        return rms_of(self.cov)


def rms_of(cov: Array) -> Array:
    """Root of the trace of covariances (..., 3, 3)."""
    return np.asarray(np.sqrt(np.maximum(np.trace(cov, axis1=-2, axis2=-1), 0.0)))


def budget_of(touch: Array, lin: Array, D: Array, sources: ErrorSources, friction: float) -> Budget:
    """Split the errors of single readings.

    Args:
        touch: unknowns, dead loads and tip of each, (n, TOUCH).
        lin: linearisations of the touches, (n, ROWS, 1 + UNKNOWNS + parameters); NaN where there is none.
        D: their error columns, (n, 12, J).
        sources: whose columns they are.
        friction: prior standard deviation of the friction ratio; inf leaves the direction of the force free.
    """
    n, of = len(lin), np.flatnonzero(np.isfinite(lin[:, 0, VALUE]))
    total, centre, noise = (np.full((n, 3, 3), np.nan) for _ in range(3))
    found = Budget(np.full((n, len(CAUSES), 3, 3), np.nan), total, centre, noise, np.full(n, np.nan))
    if len(of):
        touches = _Linear.of(touch[of], lin[of], D[of], sources)
        for name, value in zip(
            ("cov", "total", "cov_centre", "cov_noise", "std_s"), touches.split(friction), strict=True
        ):
            getattr(found, name)[of] = value
    return found


@dataclass(frozen=True)
class _Linear:
    """Touches that there are, linearised.

    Attributes:
        H, X, X_centre: of wrench, touched point and centreline point by the touch, (n, 6, 5), (n, 3, 5), (n, 3, 5).
        D, Q, Q_centre: likewise of the error sources, (n, 6, J), (n, 3, J), (n, 3, J).
        noise: covariance of a reading by noise, (n, 6, 6); drift: by drift, (6, 6).
        names: of the columns.
        by_s: of s_contact by the touch, (n, 5).
    """

    H: Array
    X: Array
    X_centre: Array
    D: Array
    Q: Array
    Q_centre: Array
    noise: Array
    drift: Array
    names: tuple[str, ...]
    by_s: Array

    @classmethod
    def of(cls, touch: Array, lin: Array, D: Array, sources: ErrorSources) -> "_Linear":
        by = slice(BY_TOUCH, BY_TOUCH + UNKNOWNS)
        by_s = np.array([by_s_of(sources.model.rod, float(s)) for s in touch[:, S]])
        noise = np.array([covariance(sources.model, wrench) for wrench in lin[:, 0:6, VALUE]])
        return cls(
            lin[:, 0:6, by], lin[:, POINT : POINT + 3, by], lin[:, CENTRE : CENTRE + 3, by],
            D[:, 0:6], D[:, 6:9], D[:, 9:12], noise, sources.drift, sources.names, by_s,
        )  # fmt: skip

    def split(self, friction: float) -> tuple[Array, Array, Array, Array, Array]:
        """Covariance by cause, the total, that of the centreline point, that by noise alone, and std of s_contact."""
        whiten = np.linalg.inv(np.linalg.cholesky(self._known(self.noise)))
        known, root, gain = self._solve(whiten, friction)
        total = self._total(self.X, self.Q, root, gain)
        centre = self._total(self.X_centre, self.Q_centre, root, gain)
        std_s = np.linalg.norm(np.einsum("ni,nij->nj", self.by_s, root), axis=1)
        alone = self.X @ self._solve(np.linalg.inv(np.linalg.cholesky(self.noise)), friction)[1]
        noise = alone @ np.swapaxes(alone, 1, 2)
        without = self._solve(whiten, 0.0)[2]
        parts = dict(self._parts(self.X @ without))
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
        own, cross = X @ root, X @ gain @ self.D @ np.swapaxes(Q, 1, 2)
        return np.asarray(
            own @ np.swapaxes(own, 1, 2) + Q @ np.swapaxes(Q, 1, 2) - cross - np.swapaxes(cross, 1, 2)
        )

    def _parts(self, gain: Array) -> list[tuple[str, Array]]:
        """Each cause's covariance of the touched point, by its gain on the reading, (n, 3, 6)."""
        found = [("noise", gain @ self.noise @ np.swapaxes(gain, 1, 2)),
                 ("drift", gain @ self.drift @ np.swapaxes(gain, 1, 2))]  # fmt: skip
        off = gain @ self.D - self.Q
        for name in SOURCES[2:]:
            here = off[:, :, [c for c, of in enumerate(self.names) if of == name]]
            found.append((name, here @ np.swapaxes(here, 1, 2)))
        return found

    def _solve(self, whiten: Array, friction: float) -> tuple[NDArray[np.bool_], Array, Array]:
        """Whether the touch is known at all, a root of its covariance C, (n, 5, 5), and its gain, (n, 5, 6)."""
        n = len(self.H)
        J = np.zeros((n, 6 + 2, UNKNOWNS))
        J[:, :6] = whiten @ self.H
        if math.isfinite(friction):
            J[:, 6, ALONG - 1] = J[:, 7, ALONG] = 1.0 / max(friction, MIN_FRICTION)
        scale = np.linalg.norm(J, axis=1)
        scale = np.where(scale > 0.0, scale, 1.0)
        R = np.linalg.qr(J / scale[:, None, :])[1]
        known = np.asarray(np.abs(np.diagonal(R, axis1=1, axis2=2)).min(axis=1) >= 1e-12)
        R = np.where(known[:, None, None], R, np.eye(UNKNOWNS))
        root = np.linalg.inv(R) / scale[:, :, None]
        gain = root @ np.swapaxes(J[:, :6] @ root, 1, 2) @ whiten
        return known, root, gain


def unweighted_budget_of(lin: Array, D: Array, sources: ErrorSources, friction: float) -> Array:
    """Covariance of the centreline's point [m²] by cause, (n, causes, 3, 3), of a method that takes the probe as exact
    and the direction of the force as free, and weighs its readings by the sensor's noise alone.

    Args:
        lin, D, sources: as in `budget_of`, of touches that there are.
        friction: standard deviation of the true friction ratio.
    """
    touches = _Linear.of(np.zeros((len(lin), UNKNOWNS)), lin, D, sources)
    touches = replace(touches, X=touches.X_centre, Q=touches.Q_centre)
    whiten = np.linalg.inv(np.linalg.cholesky(touches.noise))
    gain = touches.X @ touches._solve(whiten, math.inf)[2]
    parts = dict(touches._parts(gain))
    rubbed = min(friction, 1.0) * (gain @ touches.H - touches.X)[:, :, ALONG - 1 :]
    cov = [*(parts[name] for name in SOURCES), rubbed @ np.swapaxes(rubbed, 1, 2)]
    return np.stack(cov, axis=1)


def by_s_of(rod: Rod, s: float) -> Array:
    """Derivative of s_contact by the touch for a force normal to the surface, (UNKNOWNS,).

    s_contact = s + r tan(β - α) with β the force's lean towards the tip: ∂/∂s = 1 + tan² α, ∂/∂a_2 = r / cos² α.
    """
    tan = rod.taper_at(s)
    found = np.zeros(UNKNOWNS)
    found[S] = 1.0 + tan * tan
    found[ALONG] = float(rod.radius_at(s)) * (1.0 + tan * tan)
    return found
