"""Estimate of one contact. Numbers never come without their result code."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Literal

import numpy as np

from probedesign.core import statistics
from probedesign.core.frames import Array
from probedesign.core.notebook import Tabular
from probedesign.core.units import MILLINEWTON, MM
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
    "no_tare",
    "interval_only",
    "in_motion",
    "warming_up",
]
RESULTS: dict[Result, str] = {
    "ok": "one contact was located",
    "no_contact": "the reading is that of the free probe under gravity",
    "too_light": "something touches, but too lightly to be located",
    "ambiguous": "several places explain the reading; see candidates",
    "inconsistent": "no single contact that pushes explains the reading",
    "unobservable": "the force hardly bends the probe, so its place is not observable",
    "out_of_range": "the reading is not finite, beyond the sensor, or needs a contact off the probe",
    "not_converged": "no equilibrium was found",
    "no_tare": "the sensor's zero is not that of the free probe, and no tare was taken",
    "interval_only": "the force is light: the place is known to an interval that is no ellipsoid, and to no point",
    "in_motion": "the base moves, and its motion is not explained within the noise",
    "warming_up": "the sensor's zero drifts faster than it can be followed",
}

#: Where the moments are taken about that count alone: the base's origin, or the sensor's own.
MomentsAbout = Literal["base", "sensor"]


@cache
def _nan(*shape: int) -> Array:
    array = np.full(shape, np.nan)
    array.flags.writeable = False
    return array


@dataclass(frozen=True)
class Candidate:
    """One touch that would explain a reading."""

    s_contact: float  #: arclength of `p_contact_base` [m].
    std_s: float  #: its standard deviation [m].
    p_contact_base: Array  #: point of the centreline where the force's line of action comes nearest [m], (3,).
    p_surface_base: Array  #: the touched point of the surface [m], (3,).
    force_base: Array  #: [N], (3,).
    cov_contact_base: Array  #: covariance of p_contact_base [m²], (3, 3).
    cov_surface_base: Array  #: covariance of p_surface_base [m²], (3, 3).
    force_normal: float  #: component of the force into the surface [N]; NaN where the method does not know the surface.
    force_tangential: float  #: magnitude of the rest, the friction [N].
    chi2: float  #: misfit, a χ² of `dof` degrees of freedom if it is the true touch.
    dof: int  #: degrees of freedom.
    lever: float  #: how much the base moment changes with s, over the force; 1 for a force across a straight probe.
    shape: Callable[[], Equilibrium] = field(repr=False, compare=False)  #: the probe touched there.
    at_end: bool = False  #: whether an end of the probe bounds the place.
    #: of the compiled fit, a record `multistart.FIT`; None for the force–moment method.
    fit: np.void | None = field(default=None, repr=False, compare=False)

    @property
    def touch(self) -> Array | None:
        """Return unknowns, dead loads and tip, from which a neighbouring reading can start; None without a fit."""
        return None if self.fit is None else np.asarray(self.fit["touch"])

    @property
    def growth(self) -> float:
        """Return the least growth of the misfit beside the place, over that of a normal error; inf without a check."""
        return math.inf if self.fit is None else float(self.fit["growth"])

    @property
    def cov_linear_base(self) -> Array:
        """Return the covariance of p_surface_base to first order, without the curvature of the probe [m²], (3, 3)."""
        return _nan(3, 3) if self.fit is None else np.asarray(self.fit["cov_linear_surface"])

    @property
    def cov_linear_contact_base(self) -> Array:
        """Return the covariance of p_contact_base to first order, without the curvature of the probe [m²], (3, 3)."""
        return _nan(3, 3) if self.fit is None else np.asarray(self.fit["cov_linear_centre"])

    @property
    def rms(self) -> float:
        """Return the root of the trace of the touched point's covariance [m]."""
        return statistics.rms(self.cov_surface_base)

    @property
    def friction_ratio(self) -> float:
        """Return the tangential over the normal force; NaN without a normal force."""
        return self.force_tangential / self.force_normal if self.force_normal > 0.0 else math.nan


@dataclass(frozen=True)
class Estimate(Tabular):
    """Where a probe is touched. With any result but "ok" the position is NaN."""

    result: Result  #: one of `RESULTS`.
    #: arclength of the centreline point at which the force acts without a couple about it [m].
    s_contact: float = float("nan")
    std_s: float = float("nan")  #: its standard deviation [m].
    p_contact_base: Array = field(default_factory=lambda: _nan(3))  #: that point of the centreline [m], (3,).
    p_surface_base: Array = field(default_factory=lambda: _nan(3))  #: the touched point of the surface [m], (3,).
    force_base: Array = field(default_factory=lambda: _nan(3))  #: what the object does to the probe [N], (3,).
    cov_contact_base: Array = field(default_factory=lambda: _nan(3, 3))  #: covariance of p_contact_base [m²], (3, 3).
    cov_surface_base: Array = field(default_factory=lambda: _nan(3, 3))  #: covariance of p_surface_base [m²], (3, 3).
    force_normal: float = float("nan")  #: component of the force into the surface [N].
    force_tangential: float = float("nan")  #: magnitude of the friction [N].
    friction_ratio: float = float("nan")  #: tangential over normal force.
    detection_chi2: float = float("nan")  #: how far the reading is from the free probe's, six degrees of freedom.
    candidates: tuple[Candidate, ...] = ()  #: every touch that was considered, best first.
    solve_shape: Callable[[], Equilibrium] | None = field(default=None, repr=False, compare=False)  #: for `shape`.

    #: for `s_interval_95`.
    solve_interval: Callable[[], tuple[float, float]] | None = field(default=None, repr=False, compare=False)

    @cached_property
    def s_interval_95(self) -> tuple[float, float]:
        """Return the arclengths s_contact [m] between which the contact lies with a probability of 95 %; NaN with any
        result but "ok" and "interval_only".

        Computed by the profile of the misfit, which is valid where the posterior is not normal: near the tip and for
        light touches; on first access if the result is "ok".
        """
        return self.solve_interval() if self.solve_interval is not None else (math.nan, math.nan)

    @property
    def ok(self) -> bool:
        """Return whether the point was located."""
        return self.result == "ok"

    def __str__(self) -> str:
        """Return the result with its numbers in one line."""
        if self.ok:
            x, y, z = self.p_surface_base / MM
            rms = statistics.rms(self.cov_surface_base) / MM
            return (f"ok: s = {self.s_contact / MM:.1f} ± {self.std_s / MM:.2g} mm, point ({x:.1f}, {y:.1f}, {z:.1f}) "
                    f"mm ± {rms:.2g} mm RMS, force {np.linalg.norm(self.force_base) / MILLINEWTON:.3g} mN")  # fmt: skip
        if self.result == "interval_only":
            low, high = (s / MM for s in self.s_interval_95)
            return f"interval_only: s = {low:.1f} ... {high:.1f} mm with a probability of 95 %"
        return f"{self.result}: {RESULTS[self.result]}"

    @cached_property
    def shape(self) -> Equilibrium | None:
        """Return the reconstructed probe, solved on first access; None if there is none."""
        return self.solve_shape() if self.solve_shape is not None else None


@dataclass(frozen=True)
class FusedEstimate(Tabular):
    """One fixed point touched from several poses. With any result but "ok" the position is NaN."""

    result: Result  #: one of `estimate.RESULTS`.
    #: the touched point of the object at rest, before it yielded [m], (3,).
    p_surface_world: Array = field(default_factory=lambda: _nan(3))
    #: its covariance with every error source counted [m²], (3, 3).
    cov_surface_world: Array = field(default_factory=lambda: _nan(3, 3))
    #: where that point is at the last touch [m], (3,), with its covariance [m²], (3, 3).
    p_surface_now_world: Array = field(default_factory=lambda: _nan(3))
    cov_surface_now_world: Array = field(default_factory=lambda: _nan(3, 3))
    #: point of the centreline where the force's line of action comes nearest at the last touch [m], (3,).
    p_contact_world: Array = field(default_factory=lambda: _nan(3))
    cov_contact_world: Array = field(default_factory=lambda: _nan(3, 3))  #: its covariance [m²], (3, 3).
    object_compliance: float = float("nan")  #: yielding of the object along the force, -c F: posterior mean of c [m/N].
    #: interval that contains c with a probability of 95 %, from 0 unless a rigid object is rejected [m/N], (2,).
    object_compliance_interval_95: Array = field(default_factory=lambda: _nan(2))
    #: arclength of that point at each pose, NaN where free [m], (k,).
    s_contact: Array = field(default_factory=lambda: _nan(0))
    force_base: Array = field(default_factory=lambda: _nan(0, 3))  #: at each pose [N], (k, 3).
    #: force_normal, force_tangential: at each pose [N], NaN where free, (k,).
    force_normal: Array = field(default_factory=lambda: _nan(0))
    force_tangential: Array = field(default_factory=lambda: _nan(0))
    stiffness: float = float("nan")  #: stiffness, std_stiffness: factor on E, and its standard deviation.
    std_stiffness: float = float("nan")
    chi2: float = float("nan")  #: chi2, dof: misfit of all readings and priors, and its degrees of freedom.
    dof: int = 0
    rms: float = float("nan")  #: root of the trace of cov_surface_world [m].
    iterations: int = 0  #: of Gauss-Newton.
    #: touched point of every solution that explains the readings about as well, best first [m], (j, 3).
    candidates_world: Array = field(default_factory=lambda: _nan(0, 3))

    @property
    def ok(self) -> bool:
        """Return whether the point was located."""
        return self.result == "ok"

    def __str__(self) -> str:
        """Return the result with its numbers in one line."""
        if not self.ok:
            return f"{self.result}: {RESULTS[self.result]}"
        x, y, z = self.p_surface_world / MM
        low, high = self.object_compliance_interval_95
        return (f"ok: point at rest ({x:.1f}, {y:.1f}, {z:.1f}) mm ± {self.rms / MM:.2g} mm RMS in the world, object "
                f"yields by {low:.2g} ... {high:.2g} m/N")  # fmt: skip

    @property
    def friction_ratio(self) -> Array:
        """Return the tangential over the normal force at each pose, (k,)."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(self.force_tangential / self.force_normal)
