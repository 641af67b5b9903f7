"""One answer of an estimator. Numbers never come without their result code."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from probedesign.frames import Array
from probedesign.rod.equilibrium import Equilibrium

Result = Literal[
    "ok",
    "no_contact",
    "too_light",
    "ambiguous",
    "inconsistent",
    "unobservable",
    "out_of_range",
    "not_converged",
]
RESULTS: dict[Result, str] = {
    "ok": "one contact was located",
    "no_contact": "the reading is that of the free probe under gravity",
    "too_light": "something touches, but the reading does not tell where",
    "ambiguous": "several places explain the reading; see candidates",
    "inconsistent": "no single contact without friction explains the reading",
    "unobservable": "the force does not bend the probe, so its place leaves no trace",
    "out_of_range": "the reading is not finite, beyond the sensor, or asks for a contact off the probe",
    "not_converged": "no equilibrium was found",
}


def _nan(*shape: int) -> Array:
    return np.full(shape, np.nan)


@dataclass(frozen=True)
class Candidate:
    """One place that would explain a reading.

    Attributes:
        s_contact: [m].
        std_s: its standard deviation [m].
        p_contact_base: point of the centreline [m], (3,).
        p_surface_base: the touched point of the surface [m], (3,).
        force_base: [N], (3,).
        cov_contact_base: of p_contact_base [m²], (3, 3).
        chi2: how badly it explains the reading: a χ² of `dof` degrees of freedom if it is the true place.
        dof: 3 of "ml", 2 of "paper".
        lever: how much the base moment changes with s, over the force; 1 for a force across a straight probe.
        tip: the tip's section, for a neighbouring reading to start from, (6,).
        shape: the probe touched there.
        cov_linear_base: what cov_contact_base is to first order, without the curve of the probe [m²], (3, 3).
    """

    s_contact: float
    std_s: float
    p_contact_base: Array
    p_surface_base: Array
    force_base: Array
    cov_contact_base: Array
    chi2: float
    dof: int
    lever: float
    tip: Array = field(repr=False)
    shape: Callable[[], Equilibrium] = field(repr=False, compare=False)
    cov_linear_base: Array = field(default_factory=lambda: _nan(3, 3), repr=False)


@dataclass(frozen=True)
class Estimate:
    """Where a probe is touched. With any result but "ok" the position is NaN.

    Attributes:
        result: one of `RESULTS`.
        s_contact: arclength of the contact [m].
        std_s: its standard deviation [m].
        p_contact_base: point of the centreline where the equivalent force acts [m], (3,).
        p_surface_base: the touched point of the surface [m], (3,).
        force_base: what the object does to the probe [N], (3,).
        cov_contact_base: covariance of p_contact_base [m²], (3, 3).
        detection_chi2: how far the reading is from the free probe's, six degrees of freedom.
        candidates: every place that was considered, best first.
        solve_shape: for `shape`.
    """

    result: Result
    s_contact: float = float("nan")
    std_s: float = float("nan")
    p_contact_base: Array = field(default_factory=lambda: _nan(3))
    p_surface_base: Array = field(default_factory=lambda: _nan(3))
    force_base: Array = field(default_factory=lambda: _nan(3))
    cov_contact_base: Array = field(default_factory=lambda: _nan(3, 3))
    detection_chi2: float = float("nan")
    candidates: tuple[Candidate, ...] = ()
    solve_shape: Callable[[], Equilibrium] | None = field(default=None, repr=False, compare=False)

    @property
    def ok(self) -> bool:
        """Whether a contact was located."""
        return self.result == "ok"

    @cached_property
    def shape(self) -> Equilibrium | None:
        """The reconstructed probe, solved when it is first asked for; None if there is none."""
        return self.solve_shape() if self.solve_shape is not None else None
