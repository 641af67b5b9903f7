"""Data of a campaign: the tests of one probe, in SI."""

import hashlib
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from probedesign.core.csv_tables import Frame
from probedesign.core.frames import Array
from probedesign.estimation.model import ProbeModel

Use = Literal["", "identify", "validate"]  #: Command that a test is for; empty for both.
TESTS, WRENCHES, MARKERS = "tests.csv", "wrenches.csv", "markers.csv"
#: Unit vectors in base axes.
PUSH_DIRECTIONS = {"+x": (1.0, 0.0, 0.0), "-x": (-1.0, 0.0, 0.0), "+y": (0.0, 1.0, 0.0), "-y": (0.0, -1.0, 0.0)}


@dataclass(frozen=True, eq=False)
class Markers:
    """Positions of the markers of one test."""

    numbers: NDArray[np.intp]  #: indices of the campaign's markers, from 0, increasing, (m,).
    p_world: Array  #: [m], (m, 3).
    cov_world: Array  #: of each [m²], (m, 3, 3).
    file: str  #: name of the table they are from.

    def __len__(self) -> int:
        return len(self.numbers)


@dataclass(frozen=True, eq=False)
class Test:
    """One state of the probe, hanging free or touched, and what was measured of it."""

    name: str  #: of the test.
    T_world_base: Array  #: pose of the base, (4, 4).
    gravity_world: Array  #: [m/s²], (3,).
    #: known force of the object on the probe [N], (3,); zero for a free probe; None if not known.
    force_world: Array | None
    s_contact: float  #: known arclength of the contact force on the axis [m]; NaN if not known.
    std_s: float  #: standard deviation of s_contact [m].
    p_contact_world: Array | None  #: touched point of the surface by the reference [m], (3,); None if not measured.
    std_contact: float  #: standard deviation of p_contact_world on each axis [m].
    direction: str  #: of the push, as +y; empty if not given.
    tip_sag: float  #: displacement of the tip along gravity from its undeformed place [m]; NaN if not measured.
    std_sag: float  #: standard deviation of tip_sag [m].
    #: readings of the sensor without bias [N, N·m], (n, 6), n may be 0.
    wrenches: Array = field(default_factory=lambda: np.zeros((0, 6)))
    frame: Frame = "base"  #: of the wrenches: "sensor" (with the weight of what hangs between) or "base".
    markers: Markers | None = None  #: None if none were measured.
    use: Use = ""  #: command that the test is for; empty for both.
    time: float = np.nan  #: mean of its readings [s]; NaN if not given, or if time begins anew in each test.

    @property
    def free(self) -> bool:
        """Whether nothing is known to touch the probe."""
        return self.force_world is not None and not self.force_world.any()

    @cached_property
    def gravity_base(self) -> Array:
        """Gravity in base axes [m/s²], (3,)."""
        return np.asarray(self.T_world_base[:3, :3].T @ self.gravity_world)

    @property
    def force_base(self) -> Array | None:
        """Known force on the probe in base axes [N], (3,); None if not known."""
        force = self.force_world
        return None if force is None else np.asarray(self.T_world_base[:3, :3].T @ force)

    @cached_property
    def digest(self) -> str:
        """Fingerprint of the measured values, 8 hexadecimal digits, by which a frozen probe knows the tests that its
        parameters were identified from.

        That of the readings, where there are any, else of place and markers, to six digits: another name, other
        columns or the number format of a spreadsheet do not change it.
        """
        if len(self.wrenches):
            values = self.wrenches
        else:
            contact = np.full(3, np.nan) if self.p_contact_world is None else self.p_contact_world
            seen = np.zeros(0) if self.markers is None else self.markers.p_world.ravel()
            values = np.concatenate([[self.s_contact, self.tip_sag], contact, seen])
        # the factor keeps the seventh digit of short decimals from being a tie, which units would round either way
        text = ",".join(f"{value * (1.0 + 1e-9) + 0.0:.6g}" for value in values.ravel())
        return hashlib.sha256(text.encode()).hexdigest()[:8]

    @cached_property
    def mean_wrench(self) -> Array:
        """Mean of the readings in their own frame [N, N·m], (6,); NaN without readings."""
        return self.wrenches.mean(axis=0) if len(self.wrenches) else np.full(6, np.nan)

    def wrenches_base(self, model: ProbeModel) -> Array:
        """Return the readings about the base, without the weight between base and sensor [N, N·m], (n, 6)."""
        return self.wrenches if self.frame == "base" else model.to_base(self.wrenches, self.gravity_base)

    def mean_wrench_base(self, model: ProbeModel) -> Array:
        """Return the mean reading about the base, without the weight between base and sensor [N, N·m], (6,)."""
        mean = self.mean_wrench
        return mean if self.frame == "base" else model.to_base(mean, self.gravity_base)

    def mean_wrench_sensor(self, model: ProbeModel) -> Array:
        """Return the mean reading as the sensor measures it [N, N·m], (6,)."""
        mean = self.mean_wrench
        return mean if self.frame == "sensor" else model.to_sensor(mean, self.gravity_base)


@dataclass(frozen=True)
class Weighing:
    """Mass of the probe on a balance."""

    mass: float  #: [kg].
    std: float  #: standard deviation of the mass [kg].
    #: "flexible", the soft part cut off at its base, or "probe", with its printed flange.
    of: Literal["flexible", "probe"]


@dataclass(frozen=True, eq=False)
class Campaign:
    """Tests of one probe."""

    name: str  #: of the probe's design.
    fingerprint: str | None  #: of its geometry; None if the campaign does not state it.
    T_world_base: Array  #: pose of the base in tests without a pose of their own, (4, 4).
    std_base: float  #: standard deviation of its position, on each axis [m].
    std_tilt: float  #: of its rotation, about each axis [rad].
    gravity_world: Array  #: [m/s²], (3,).
    marker_s: Array  #: arclength of each marker, increasing [m], (k,).
    #: side of the section with the markers, from the base's x axis about z [rad]; None for markers on the axis.
    marker_side: float | None
    tests: tuple[Test, ...]  #: in the order of their table.
    weighing: Weighing | None  #: None if it was not weighed.
    folder: Path  #: it was read from.
    notes: tuple[str, ...] = ()  #: lines for the user.
