"""Check a user's arrays and fuse them."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from probedesign.core.errors import InputError
from probedesign.core.frames import Array, is_pose
from probedesign.estimation.fused import FusedEstimate, MomentsAbout
from probedesign.estimation.fusion import Fusion, Reading, channels_of
from probedesign.estimation.model import ProbeModel, covariance
from probedesign.estimation.tolerances import Tolerances


def fuse(
    model: ProbeModel,
    wrenches_base: ArrayLike,
    Ts_world_base: ArrayLike,
    gravity_world: ArrayLike,
    touched: ArrayLike | None,
    priors: Tolerances,
    moments: MomentsAbout | None,
) -> FusedEstimate:
    """The point that the probe touches from several poses; see `Estimator.fuse`.

    Args:
        model: the probe.
        moments: which moments count alone; None: forces and moments.
        The others as there.

    Raises:
        InputError: an argument has the wrong shape, or there are no such moments.
    """
    if moments not in (None, "base", "sensor"):
        raise InputError(f"moments_about = {moments!r} is not known; known: base, sensor")
    wrenches, poses, gravity, contact = _checked(wrenches_base, Ts_world_base, gravity_world, touched)
    needed = wrenches[:, 3:] if moments == "base" else wrenches
    if not (np.isfinite(needed).all() and np.isfinite(gravity).all() and all(is_pose(T) for T in poses)):
        return FusedEstimate("out_of_range")
    readings = tuple(
        Reading(w, covariance(model, w), T, g, bool(c))
        for w, T, g, c in zip(
            np.nan_to_num(wrenches), poses, gravity @ poses[:, :3, :3], contact, strict=True
        )
    )
    if not all(_can_be_read(model, reading, moments) for reading in readings):
        return FusedEstimate("out_of_range")
    if not all(model.rod.solve(reading.gravity).ok for reading in readings):
        return FusedEstimate("not_converged")
    return Fusion(model, readings, priors, channels_of(model, moments), gravity).solve()


def _can_be_read(model: ProbeModel, reading: Reading, moments: MomentsAbout | None) -> bool:
    """Whether no channel that counts is beyond the sensor."""
    read = model.to_sensor(reading.wrench, reading.gravity)
    of = slice(0, 6) if moments is None else slice(3, 6)
    return bool((np.abs(read[of]) <= model.saturation_limit[of]).all())


def _checked(
    wrenches_base: ArrayLike, Ts_world_base: ArrayLike, gravity_world: ArrayLike, touched: ArrayLike | None
) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """The arguments as arrays.

    Raises:
        InputError: a shape is wrong.
    """
    wrenches, poses = np.asarray(wrenches_base, dtype=float), np.asarray(Ts_world_base, dtype=float)
    gravity, k = np.asarray(gravity_world, dtype=float), len(wrenches) if wrenches.ndim else 0
    contact = np.ones(k, dtype=bool) if touched is None else np.asarray(touched, dtype=bool)
    shapes = {"wrenches_base": (wrenches, (k, 6)), "Ts_world_base": (poses, (k, 4, 4)),
              "gravity_world": (gravity, (3,)), "touched": (contact, (k,))}  # fmt: skip
    for name, (array, shape) in shapes.items():
        if array.shape != shape or k == 0:
            raise InputError(f"{name} has shape {array.shape}; it must be {shape}, one or more readings k")
    return wrenches, poses, gravity, contact
