"""What is drawn of an estimate: the bent centreline, and the contact with its force."""

from dataclasses import dataclass

import numpy as np

from probedesign.core.frames import Array
from probedesign.geometry.tube import BentShape
from probedesign.live.processing.estimates import EstimateUpdate


@dataclass(frozen=True)
class ContactMarker:
    """A located contact."""

    p_surface: Array  #: touched point [m], (3,).
    cov: Array  #: its covariance [m²], (3, 3).
    force: Array  #: force of the object on the probe [N], (3,).
    s: float  #: s, std_s: arclength and its standard deviation [m].
    std_s: float
    in_world: bool  #: whether all this is in the world frame; otherwise in the base frame.
    time: float  #: time by the source's clock [s].
    number: int  #: number of the touch, from 1.
    friction_ratio: float = float("nan")  #: tangential over normal force; NaN if unknown.


def contact_marker(update: EstimateUpdate, number: int) -> ContactMarker | None:
    """Return the contact, fused if available, otherwise of this reading; None if the estimate is not ok."""
    estimate, fused, T = update.estimate, update.fused, update.T_world_base
    if not estimate.ok:
        return None
    contact = (estimate.force_base, estimate.s_contact, estimate.std_s)
    when = (update.reading.time, number, estimate.friction_ratio)
    if not np.isfinite(T).all():
        return ContactMarker(estimate.p_surface_base, estimate.cov_surface_base, *contact, False, *when)
    R, origin = T[:3, :3], T[:3, 3]
    contact = (R @ estimate.force_base, estimate.s_contact, estimate.std_s)
    if fused is not None and fused.ok:
        return ContactMarker(fused.p_surface_world, fused.cov_surface_world, *contact, True, *when)
    surface = R @ estimate.p_surface_base + origin
    return ContactMarker(surface, R @ estimate.cov_surface_base @ R.T, *contact, True, *when)


def bent_shape(update: EstimateUpdate) -> BentShape | None:
    """Return the estimated shape of the probe; None if it is unknown."""
    eq = update.estimate.shape
    return BentShape(eq.s, eq.p_base, eq.R_base) if eq is not None and eq.ok else None
