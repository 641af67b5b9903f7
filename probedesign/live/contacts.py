"""Contacts so far: one for each touch."""

import math
from dataclasses import dataclass, replace

from probedesign.estimation.estimate import Estimate
from probedesign.estimation.fused import FusedEstimate
from probedesign.live.phases import Phase

MOST = 1000
"""Contacts that are kept; of a longer run the last."""


@dataclass(frozen=True)
class Contact:
    """One touch.

    Attributes:
        number: from 1.
        start: when it was told [s].
        end: when it was lost [s]; NaN while it lasts.
        settled: whether readings and base stood still in it.
        fused: the point that its readings tell, as answered last while it was settled, or last at all if it never was.
        estimate: the last located one of a single reading, of settled ones if there are any.
    """

    number: int
    start: float
    end: float = math.nan
    settled: bool = False
    fused: FusedEstimate | None = None
    estimate: Estimate | None = None

    @property
    def lasts(self) -> bool:
        """Whether it still touches."""
        return math.isnan(self.end)

    @property
    def line(self) -> str:
        """It in one line."""
        told = f"touch {self.number}, {self.start:.2f} ... {self.end:.2f} s"
        if not self.settled:
            told += ", never settled"
        if self.fused is not None and self.fused.ok:
            x, y, z = (1e3 * float(value) for value in self.fused.p_surface_world)
            return f"{told}: ({x:z.2f}, {y:z.2f}, {z:z.2f}) mm in the world, ± {1e3 * self.fused.rms:.2f} mm"
        if self.fused is not None:
            told += f": as one point of the world {self.fused.result}"
        if self.estimate is not None:
            s, std = 1e3 * self.estimate.s_contact, 1e3 * self.estimate.std_s
            return f"{told}{'; ' if self.fused is not None else ': '}one reading alone says s {s:.1f} ± {std:.1f} mm"
        return f"{told}: not located"


class Contacts:
    """Keeps the list while phases and answers come.

    Attributes:
        so_far: every touch, the present one included.
    """

    def __init__(self) -> None:
        self.so_far: tuple[Contact, ...] = ()
        self._count = 0

    @property
    def present(self) -> Contact | None:
        """The touch that lasts."""
        return self.so_far[-1] if self.so_far and self.so_far[-1].lasts else None

    def follow(self, time: float, phase: Phase, fused: FusedEstimate | None) -> Contact | None:
        """Take in the phase at a time [s] and what is fused by then; the touch that has just ended, if one has."""
        present = self.present
        if phase not in ("touching", "settled"):
            return None if present is None else self._keep(replace(present, end=time))
        if present is None:
            self._count += 1
            present = Contact(self._count, time)
            self.so_far = (*self.so_far[1 - MOST :], present)
        if phase == "settled" or not present.settled:
            present = replace(present, fused=fused or present.fused)
        self._keep(replace(present, settled=present.settled or phase == "settled"))
        return None

    def locate(self, estimate: Estimate, phase: Phase) -> None:
        """Take in the estimate of one reading of the present touch."""
        present = self.present
        if present is None or not estimate.ok:
            return
        if phase == "settled" or not present.settled:
            self._keep(replace(present, estimate=estimate))

    def _keep(self, contact: Contact) -> Contact:
        self.so_far = (*self.so_far[:-1], contact)
        return contact
