"""Where the error of one touch comes from: its covariance, cause by cause, to first order.

The estimator finds the touch θ = (s, angle, magnitude) whose modelled reading lies nearest, weighed by W: the inverse
covariance of the sensor's noise and of what all causes do to the reading, as `Estimator.with_tolerances` weighs it,
or of the noise alone. A cause that moves the true reading by δh and the true point by δp moves the answer by G δh
with G = P (Jᵀ W J)⁻¹ Jᵀ W, J and P the derivatives of reading and point by θ: the error is that less δp. It is the
distance between the contact point told in the sensor's axes by the model's mount and the true one there, so that a
base that sits elsewhere counts too.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from probedesign.estimation.causes import CAUSES, answers_of, free_answers, moved_by
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.frames import Array
from probedesign.rod.contacts import Contacts


@dataclass(frozen=True)
class ByCause:
    """Errors of n points by what causes them.

    Attributes:
        cov: of each point [m²] by cause, (n, causes, 3, 3).
    """

    cov: Array

    @property
    def total(self) -> Array:
        """Covariance by all causes [m²], (n, 3, 3)."""
        return np.asarray(self.cov.sum(axis=1))

    @property
    def rms(self) -> Array:
        """Of each cause [m], (n, causes)."""
        return np.asarray(np.sqrt(np.trace(self.cov, axis1=2, axis2=3)))


@dataclass(frozen=True)
class Budget(ByCause):
    """Errors of n touches; NaN where there is no touch, infinite where a reading leaves the place open.

    Attributes:
        cov: of the contact point [m²] by cause, (n, causes, 3, 3), as `CAUSES` names them.
        cov_noise: of the contact point by the sensor's noise where nothing else differs and the estimator knows it,
            (n, 3, 3).
        cov_touch: of (s_contact, angle, magnitude), likewise, (n, 3, 3).
    """

    cov_noise: Array
    cov_touch: Array


def budget_of(
    contacts: Contacts, model: ProbeModel, gravity: Array, tolerances: Tolerances, *, weighed: bool = True
) -> Budget:
    """Split the errors of single readings.

    Args:
        contacts: touches of the model's rod, with all columns.
        model: the probe.
        gravity: they are under, base axes [m/s²], (3,).
        tolerances: how well things are known.
        weighed: whether the estimator weighs readings by the tolerances, or takes the probe as exact.

    Returns:
        The budget of each touch.
    """
    n, of = len(contacts.s), np.flatnonzero(contacts.ok)
    budget = Budget(np.full((n, len(CAUSES), 3, 3), np.nan), *np.full((2, n, 3, 3), np.nan))
    if len(of):
        found = _split(contacts.rows(contacts.ok), model, gravity, tolerances, weighed)
        budget.cov[of], budget.cov_noise[of], budget.cov_touch[of] = found
    return budget


def _split(
    contacts: Contacts, model: ProbeModel, gravity: Array, tolerances: Tolerances, weighed: bool
) -> tuple[Array, Array, Array]:
    """Of touches that there are: covariance by cause, that by the noise alone, and that of the touch."""
    J, P, noise = contacts.d_wrench_by_touch, contacts.d_point_by_touch, model.noise_base()
    answers, free = answers_of(contacts, model.rod, gravity), free_answers(model.rod, gravity)
    still = moved_by(free, model, gravity, tolerances)
    moved = {
        name: (wrench - still[name][0] * tolerances.tared, point)
        for name, (wrench, point) in moved_by(answers, model, gravity, tolerances).items()
    }
    step = tolerances.drift_steps**2 * model.averaging_samples * noise
    known, root = _root(model.whiten @ J)
    cov_touch = root @ np.swapaxes(root, 1, 2)
    cov_noise = P @ cov_touch @ np.swapaxes(P, 1, 2)
    whiten = _whiten(noise + step, [wrench for wrench, _ in moved.values()]) if weighed else model.whiten
    gain = _gain(J, P, whiten)
    covs = {"noise": gain @ noise @ np.swapaxes(gain, 1, 2), "drift": gain @ step @ np.swapaxes(gain, 1, 2)}
    for name, (wrench, point) in moved.items():
        off = gain @ wrench - point
        covs[name] = off @ np.swapaxes(off, 1, 2)
    cov = np.stack([covs[name] for name in CAUSES], axis=1)
    for found in (cov, cov_noise, cov_touch):
        found[~known] = np.inf
    return cov, cov_noise, cov_touch


def _whiten(noise: Array, moved: list[Array]) -> Array:
    """Of readings that noise, (6, 6), and causes, (n, 6, j) each, make vague together, (n, 6, 6)."""
    columns = np.concatenate(moved, axis=2)
    return np.asarray(np.linalg.inv(np.linalg.cholesky(noise + columns @ np.swapaxes(columns, 1, 2))))


def _gain(J: Array, P: Array, whiten: Array) -> Array:
    """How the point answers the reading, (n, 3, 6)."""
    white = whiten @ J
    root = _root(white)[1]
    return np.asarray(P @ root @ np.swapaxes(white @ root, 1, 2) @ whiten)


def _root(white: Array) -> tuple[NDArray[np.bool_], Array]:
    """Whether (Jᵀ W J)⁻¹ is known, and a root of it by the triangle of J's whitened, scaled columns, (n, 3, 3)."""
    scale = np.linalg.norm(white, axis=1)
    scale = np.where(scale > 0.0, scale, 1.0)
    R = np.linalg.qr(white / scale[:, None, :])[1]
    known = np.asarray(np.abs(np.diagonal(R, axis1=1, axis2=2)).min(axis=1) >= 1e-12)
    R = np.where(known[:, None, None], R, np.eye(3))
    return known, np.linalg.inv(R) / scale[:, :, None]
