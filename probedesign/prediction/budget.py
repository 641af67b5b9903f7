"""Where the error of one touch comes from: its covariance, cause by cause, to first order.

The estimator finds the touch θ = (s, angle, magnitude) whose modelled reading lies nearest in the sensor's noise. A
cause that moves the true reading by δh and the true point by δp moves the answer by P (Jᵀ W J)⁻¹ Jᵀ W δh, J and P the
derivatives of reading and point by θ: the error is that less δp. It is the distance between the contact point told in
the sensor's axes by the model's mount and the true one there, so that a base that sits elsewhere counts too.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from probedesign.estimator.causes import CAUSES, answers_of, free_answers, moved_by
from probedesign.estimator.model import ProbeModel
from probedesign.estimator.tolerances import Tolerances
from probedesign.frames import Array
from probedesign.rod.contacts import Contacts


@dataclass(frozen=True)
class Budget:
    """Errors of n touches; NaN where there is no touch, infinite where a reading leaves the place open.

    Attributes:
        cov: of the contact point [m²] by cause, (n, causes, 3, 3), as `CAUSES` names them.
        cov_touch: of (s_contact, angle, magnitude) by the sensor's noise alone, (n, 3, 3).
    """

    cov: Array
    cov_touch: Array

    @property
    def total(self) -> Array:
        """Covariance of the contact point by all causes [m²], (n, 3, 3)."""
        return np.asarray(self.cov.sum(axis=1))

    @property
    def rms(self) -> Array:
        """Of each cause [m], (n, causes)."""
        return np.asarray(np.sqrt(np.trace(self.cov, axis1=2, axis2=3)))


def budget_of(contacts: Contacts, model: ProbeModel, gravity: Array, tolerances: Tolerances) -> Budget:
    """Split the errors of single readings.

    Args:
        contacts: touches of the model's rod, with all columns.
        model: the probe.
        gravity: they are under, base axes [m/s²], (3,).
        tolerances: how well things are known.

    Returns:
        The budget of each touch.
    """
    n, of = len(contacts.s), np.flatnonzero(contacts.ok)
    cov, cov_touch = np.full((n, len(CAUSES), 3, 3), np.nan), np.full((n, 3, 3), np.nan)
    if len(of):
        cov[of], cov_touch[of] = _split(contacts.rows(contacts.ok), model, gravity, tolerances)
    return Budget(cov, cov_touch)


def _split(
    contacts: Contacts, model: ProbeModel, gravity: Array, tolerances: Tolerances
) -> tuple[Array, Array]:
    """Of touches that there are: covariance by cause, and that of the touch."""
    J, P = contacts.d_wrench_by_touch, contacts.d_point_by_touch
    root, known = _root(model.whiten @ J)
    gain = P @ root @ np.swapaxes(model.whiten @ J @ root, 1, 2) @ model.whiten
    answers, free = answers_of(contacts, model.rod, gravity), free_answers(model.rod, gravity)
    moved, still = (moved_by(a, model, gravity, tolerances) for a in (answers, free))
    noise = model.noise_base()
    step = tolerances.drift_steps**2 * model.averaging_samples * noise
    covs = {"noise": gain @ noise @ np.swapaxes(gain, 1, 2), "drift": gain @ step @ np.swapaxes(gain, 1, 2)}
    for name, (wrench, point) in moved.items():
        off = gain @ (wrench - still[name][0] * tolerances.tared) - point
        covs[name] = off @ np.swapaxes(off, 1, 2)
    cov = np.stack([covs[name] for name in CAUSES], axis=1)
    cov_touch = root @ np.swapaxes(root, 1, 2)
    cov[~known], cov_touch[~known] = np.inf, np.inf
    return cov, cov_touch


def _root(white: Array) -> tuple[Array, NDArray[np.bool_]]:
    """A root of (Jᵀ W J)⁻¹ by the triangle of J's whitened, scaled columns, (n, 3, 3), and whether it is known."""
    scale = np.linalg.norm(white, axis=1)
    scale = np.where(scale > 0.0, scale, 1.0)
    R = np.linalg.qr(white / scale[:, None, :])[1]
    known = np.asarray(np.abs(np.diagonal(R, axis1=1, axis2=2)).min(axis=1) >= 1e-12)
    R = np.where(known[:, None, None], R, np.eye(3))
    return np.linalg.inv(R) / scale[:, :, None], known
