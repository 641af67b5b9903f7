"""What was measured of one probe, in SI."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from probedesign.core.csv_tables import Frame
from probedesign.frames import Array

Weighed = Literal["flexible", "probe"]


@dataclass(frozen=True, eq=False)
class Markers:
    """Where the markers of one test were seen.

    Attributes:
        numbers: which of the campaign's markers, from 0, rising, (m,).
        p_world: [m], (m, 3).
        cov_world: of each [m²], (m, 3, 3).
        file: name of the table that told them.
    """

    numbers: NDArray[np.intp]
    p_world: Array
    cov_world: Array
    file: str

    def __len__(self) -> int:
        return len(self.numbers)


@dataclass(frozen=True, eq=False)
class Test:
    """One state of the probe, hanging free or touched, and what was measured of it.

    Attributes:
        name: of the test.
        T_world_base: pose of the base, (4, 4).
        force_world: known force of the object on the probe [N], (3,); zero for a free probe; None if not known.
        s_contact: where the contact force is known to meet the axis [m]; NaN if it is not.
        std_s: standard deviation of that [m].
        p_contact_world: the touched point of the surface by the reference [m], (3,); None if it saw none.
        std_contact: of that, on each axis [m].
        direction: of the push, as people call it: +y; empty if not said.
        tip_sag: how far the tip hangs below its unbent place, along gravity [m]; NaN if not measured.
        std_sag: of that [m].
        wrenches: readings of the sensor, its bias removed, [N, N·m], (n, 6), n may be 0.
        frame: they are told in: "sensor" (with the weight of what hangs between) or "base".
        markers: None if none were seen.
    """

    name: str
    T_world_base: Array
    force_world: Array | None
    s_contact: float
    std_s: float
    p_contact_world: Array | None
    std_contact: float
    direction: str
    tip_sag: float
    std_sag: float
    wrenches: Array = field(default_factory=lambda: np.zeros((0, 6)))
    frame: Frame = "base"
    markers: Markers | None = None

    @property
    def free(self) -> bool:
        """Whether nothing is known to touch the probe."""
        return self.force_world is not None and not self.force_world.any()


@dataclass(frozen=True)
class Weighing:
    """The probe on scales.

    Attributes:
        mass: [kg].
        std: of that [kg].
        of: "flexible", the soft part cut off at its base, or "probe", with its printed flange.
    """

    mass: float
    std: float
    of: Weighed


@dataclass(frozen=True, eq=False)
class Campaign:
    """The tests of one probe.

    Attributes:
        name: of the probe's design.
        fingerprint: of its geometry; None where the campaign does not say.
        T_world_base: pose of the base where a test has none of its own, (4, 4).
        std_base: of its place, on each axis [m].
        std_tilt: of its rotation, about each axis [rad].
        gravity_world: [m/s²], (3,).
        marker_s: arclength of each marker, rising [m], (k,).
        marker_side: side of the section that bears the markers, from the base's x axis about z [rad]; None for
            markers on the axis.
        tests: in the order of their table.
        weighing: None if it was not weighed.
        folder: it was read from.
        notes: what a user should know, each one line.
    """

    name: str
    fingerprint: str | None
    T_world_base: Array
    std_base: float
    std_tilt: float
    gravity_world: Array
    marker_s: Array
    marker_side: float | None
    tests: tuple[Test, ...]
    weighing: Weighing | None
    folder: Path
    notes: tuple[str, ...] = ()
