"""One reading of a wrench sensor."""

from dataclasses import dataclass

import numpy as np

from probedesign.frames import Array


@dataclass(frozen=True)
class Truth:
    """What a simulation knows of the contact; NaN while nothing touches.

    Attributes:
        s_contact: arclength of the contact [m].
        p_contact_base: its point of the centreline [m], (3,).
        force_base: what the object does to the probe [N], (3,).
        p_surface_base: the touched point of the surface [m], (3,).
    """

    s_contact: float
    p_contact_base: Array
    force_base: Array
    p_surface_base: Array


FREE = Truth(float("nan"), np.full(3, np.nan), np.full(3, np.nan), np.full(3, np.nan))
"""Nothing touches."""


@dataclass(frozen=True)
class Reading:
    """What the sensor reads at one moment.

    Attributes:
        time: by the source's own clock [s].
        wrench_sensor: in the sensor frame, its bias included [N, N·m], (6,).
        gravity_base: vector of gravity in base axes [m/s²], (3,).
        truth: where the contact really is, if the source knows.
        fault: what is wrong with it, in words; such a reading counts as out of range.
        stretch: counts what the source read without an interruption; nothing is averaged from one to the next.
        received: when it reached this program, by `time.monotonic` [s]; NaN if nothing is received.
    """

    time: float
    wrench_sensor: Array
    gravity_base: Array
    truth: Truth | None = None
    fault: str = ""
    stretch: int = 0
    received: float = float("nan")
