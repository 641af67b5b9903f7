"""The paper's estimator: gravity, detection, force, contact arclength, shape, with covariance and result codes."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtri

from probedesign.errors import InputError
from probedesign.estimator.covariance import propagate
from probedesign.estimator.estimate import Candidate, Estimate, Result
from probedesign.estimator.locate import candidates
from probedesign.estimator.model import ProbeModel
from probedesign.frames import Array
from probedesign.rod.equilibrium import Equilibrium
from probedesign.sensor import Noise

FALSE_ALARM = 1.4e-6
"""Chance that a free reading is called a contact: one an hour at 7000/36 readings a second."""
LEAST_FORCE = 5.0
"""Standard deviations of the force below which no position is given: s follows M/F, and its error is no longer
normal where F is known to less than a fifth (tests/estimator/test_statistics.py)."""
INCONSISTENT = 1e-4
"""Chance that a true single contact is called inconsistent."""
NUMERICAL = 1e-6
"""Error of the fast solve's base moment, relative: no reading is held against it more closely."""
AMBIGUOUS = 9.0
"""Candidates whose misfit χ² lies within 3² of the best explain a reading about as well."""


@dataclass(frozen=True)
class Estimator:
    """Locates one contact from one base wrench.

    The paper's method: equation 4 decides whether there is a contact, equation 5 gives the force, and the
    contact's arclength is where that force makes the measured moment. One contact is assumed; the force may
    have any direction (friction is not assumed away here).

    Attributes:
        model: the probe.
    """

    model: ProbeModel
    _last_free: dict[tuple[float, ...], Equilibrium] = field(default_factory=dict, compare=False, repr=False)

    def with_noise(self, force_N: float, moment_Nm: float) -> "Estimator":
        """The same estimator for readings with these standard deviations of each channel.

        Args:
            force_N: [N], positive.
            moment_Nm: [N·m], positive.

        Raises:
            InputError: a value is not positive and finite.
        """
        for name, value in (("force_N", force_N), ("moment_Nm", moment_Nm)):
            if not 0.0 < value < np.inf:
                raise InputError(f"{name} = {value} must be positive and finite")
        return Estimator(self.model.with_noise(Noise(float(force_N), float(moment_Nm))))

    def estimate(self, wrench_base: ArrayLike, gravity_base: ArrayLike | None = None) -> Estimate:
        """Locate the contact that explains a reading.

        Args:
            wrench_base: what the probe does to its mount, about the base origin [N, N·m], (6,).
            gravity_base: gravity in base axes [m/s²], (3,); the design's mount if None.

        Returns:
            The estimate; anything that goes wrong is its result code, never an exception.

        Raises:
            InputError: an argument has the wrong shape, or gravity is not finite.
        """
        wrench = np.asarray(wrench_base, dtype=float)
        gravity = self.model.gravity_base if gravity_base is None else np.asarray(gravity_base, dtype=float)
        if wrench.shape != (6,):
            raise InputError(f"wrench_base has shape {wrench.shape}; it must be (6,): force and moment")
        if gravity.shape != (3,) or not np.isfinite(gravity).all():
            raise InputError(f"gravity_base = {gravity} must be three finite numbers in m/s²")
        if not np.isfinite(wrench).all() or not self.model.reads(self.model.to_sensor(wrench, gravity)):
            return Estimate("out_of_range")
        free = self.free(gravity)
        if not free.ok:
            return Estimate("not_converged")
        chi2 = self._detection_chi2(wrench, free)
        if not self._exceeds(chi2):
            return Estimate("no_contact", shape=free, detection_chi2=chi2)
        force = wrench[0:3] - self.model.mass * gravity  # equation 5, base axes
        found = candidates(self.model.rod, gravity, force, wrench[3:6])
        return replace(self._decide(found, wrench), detection_chi2=chi2)

    def free(self, gravity_base: ArrayLike | None = None) -> Equilibrium:
        """The untouched probe under gravity [m/s²], (3,); the design's mount if None. The last one is kept."""
        gravity = self.model.gravity_base if gravity_base is None else np.asarray(gravity_base, dtype=float)
        key = tuple(gravity.tolist())
        if key not in self._last_free:
            self._last_free.clear()
            self._last_free[key] = self.model.rod.solve(gravity)
        return self._last_free[key]

    def detects(self, wrench_base: Array, gravity_base: ArrayLike | None = None) -> bool:
        """Whether a reading (6,) is told from the free probe's (equation 4 with the sensor's noise)."""
        free = self.free(gravity_base)
        return free.ok and self._exceeds(self._detection_chi2(wrench_base, free))

    def locates(self, std_s: float, force: Array) -> bool:
        """Whether an estimate with that standard deviation [m] and force [N] (3,) says where.

        It does not if s is known no better than with no reading at all (uniform over the probe, L/√12), or
        if the force is so uncertain that a covariance of first order no longer holds.
        """
        return bool(
            std_s < self.model.rod.length / np.sqrt(12.0)
            and np.linalg.norm(force) > LEAST_FORCE * self.model.noise.force
        )

    @staticmethod
    def _exceeds(chi2: float) -> bool:
        return bool(chi2 >= chdtri(6, FALSE_ALARM))

    def detectable(self, wrench_by_force: Array) -> float:
        """Smallest force [N] that is told from a free probe every other time.

        Args:
            wrench_by_force: change of the base wrench per newton of contact, (6,).
        """
        return float(
            np.sqrt(chdtri(6, FALSE_ALARM) / (wrench_by_force @ self._information @ wrench_by_force))
        )

    @cached_property
    def cov_wrench(self) -> Array:
        """Covariance of a base wrench reading, (6, 6)."""
        return self.model.noise_base()

    @cached_property
    def _information(self) -> Array:
        return np.linalg.inv(self.cov_wrench).astype(float, copy=False)

    def _detection_chi2(self, wrench: Array, free: Equilibrium) -> float:
        d = wrench - free.wrench_base
        return float(d @ self._information @ d)

    def _decide(self, found: list[Equilibrium], wrench: Array) -> Estimate:
        """Turn the candidate equilibria into one answer with its code."""
        if not found:
            return Estimate("not_converged")
        judged = [(self._candidate(eq, wrench), eq) for eq in found]
        judged.sort(key=lambda pair: pair[0].chi2)
        listed = tuple(candidate for candidate, _ in judged)
        best, eq = judged[0]
        result = self._result(listed, eq, wrench)
        force = eq.load[0:3].copy()
        if result != "ok":
            return Estimate(result, force_base=force, candidates=listed)
        assert eq.sensitivity is not None
        cov = propagate(eq.sensitivity, self.cov_wrench)
        return Estimate("ok", best.s_contact, cov.std_s, best.p_contact_base, self._surface(eq), force,
                        cov.cov_p, eq, candidates=listed)  # fmt: skip

    def _candidate(self, eq: Equilibrium, wrench: Array) -> Candidate:
        assert eq.sensitivity is not None
        cov = propagate(eq.sensitivity, self.cov_wrench)
        misfit = eq.wrench_base[3:6] - wrench[3:6]
        rounding = (NUMERICAL * float(np.linalg.norm(wrench[3:6]))) ** 2 * np.eye(3)
        chi2 = float(misfit @ np.linalg.solve(cov.moment_misfit + rounding, misfit))
        return Candidate(eq.s_contact, cov.std_s, eq.p_contact_base, chi2)

    def _result(self, listed: tuple[Candidate, ...], eq: Equilibrium, wrench: Array) -> Result:
        """The code of the best candidate beside its rivals."""
        best = listed[0]
        length = self.model.rod.length
        if best.chi2 > chdtri(2, INCONSISTENT):
            return "out_of_range" if best.s_contact in (0.0, length) else "inconsistent"
        if not self.locates(best.std_s, eq.load[0:3]):
            return "unobservable" if _acts_along_axis(eq) else "too_light"
        rivals = [c for c in listed[1:] if c.chi2 < best.chi2 + AMBIGUOUS]
        if any(abs(c.s_contact - best.s_contact) > 3.0 * (c.std_s + best.std_s) for c in rivals):
            return "ambiguous"
        return "ok"

    def _surface(self, eq: Equilibrium) -> Array:
        """The touched point of the surface, where the force's line leaves the body.

        The outward normal at the touched section leans towards the tip by α, so with r the radius at
        s_contact the touched section lies r cos α sin α further out and has radius r cos² α.
        """
        rod, s = self.model.rod, eq.s_contact
        tan = rod.taper_at(s)
        cos2 = 1.0 / (1.0 + tan * tan)
        radius = float(np.interp(s, rod.s, rod.radius)) * cos2
        there = min(s + radius * tan, rod.length)
        R = eq.R_at(there)
        inward = eq.load[0:3] - R[:, 2] * float(R[:, 2] @ eq.load[0:3])
        norm = float(np.linalg.norm(inward))
        out = -inward / norm if norm > 0.0 else np.zeros(3)
        return eq.p_at(there) + radius * out


def _acts_along_axis(eq: Equilibrium) -> bool:
    """Whether moving the contact changes the moment by less than a tenth of force times way."""
    assert eq.sensitivity is not None
    return bool(np.linalg.norm(eq.sensitivity.d_moment[:, 3]) < 0.1 * np.linalg.norm(eq.load[0:3]))
