"""What live says of one moment."""

from dataclasses import dataclass, field

import numpy as np

from probedesign.estimation.estimate import Estimate
from probedesign.estimation.fused import FusedEstimate
from probedesign.frames import Array
from probedesign.live.contacts import Contact
from probedesign.live.phases import Phase
from probedesign.live.reading import Reading


def _unknown_pose() -> Array:
    return np.full((4, 4), np.nan)


@dataclass(frozen=True)
class Answer:
    """One estimate and what belongs to it.

    Attributes:
        reading: what was estimated from, averaged, its bias included.
        estimate: from this reading alone, in the base frame.
        phase: of the touch, as in the paper's figure 8: free, moving, touching, settled or released; empty where
            nobody watches.
        fused: the touched point from all readings of this touch; None where nothing is fused.
        T_world_base: pose of the base, (4, 4); NaN if it is not known.
        wrench_base: what was estimated from, without bias, at the base [N, N·m], (6,); NaN where there is a fault.
        made: when it was there, by `time.monotonic` [s].
        stale: what is too old or missing to be used: "pose", or nothing.
        contacts: every touch so far, the present one included.
    """

    reading: Reading
    estimate: Estimate
    phase: Phase = ""
    fused: FusedEstimate | None = None
    T_world_base: Array = field(default_factory=_unknown_pose)
    wrench_base: Array = field(default_factory=lambda: np.full(6, np.nan))
    made: float = float("nan")
    stale: str = ""
    contacts: tuple[Contact, ...] = ()
