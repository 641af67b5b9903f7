"""Maximum likelihood: the contact without friction whose base wrench lies nearest to the reading, in its noise.

Every place that the scan of the paper's method finds is a start (`locate.py`); the fit itself is compiled (`fit.py`).
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.special import chdtri

from probedesign.estimator import fit
from probedesign.estimator.estimate import Candidate
from probedesign.estimator.locate import candidates, starts
from probedesign.estimator.observation import Observation
from probedesign.frames import Array
from probedesign.rod import kernels
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.rod import Rod
from probedesign.rod.workspace import workspace

DOF = 3
"""Six channels, three unknowns: arclength, angle around the section, normal force."""
UNLIKELY = 1e-3
"""Chance of a true contact's misfit beyond which it is looked for elsewhere too."""
NUMERICAL = 0.08e-6
"""Error that a fast rod leaves at a contact of the envelope in a thousand touches at most [m]: none is known better."""
ASIDE = math.sqrt(3.0)
_SAME = 1e-5
"""Places closer than this, over the length, are one."""


def locate(rod: Rod, seen: Observation, near: Candidate | None = None) -> list[Candidate]:
    """The contacts of greatest likelihood.

    Args:
        rod: of the probe.
        seen: the reading.
        near: a neighbouring reading's place: only from there is then searched, everywhere only if nothing is there.
    """
    fitter = _Fitter(rod, seen)
    if near is not None:
        found = fitter.fit(near.tip, near.force_base, near.s_contact)
        if found is not None and fitter.explains(found):
            return [found]
    scanned = starts(rod, seen.gravity, seen.force, seen.wrench[3:6])
    places = fitter.places((tip, seen.force, s) for s, tip in scanned)
    if not any(
        fitter.explains(place) for place in places
    ):  # the scan may be too coarse where the probe gives way
        exact = candidates(rod, seen.gravity, seen.force, seen.wrench[3:6])
        places += fitter.places((eq.tip, seen.force, eq.s_contact) for eq in exact)
    return places or fitter.stalled


@dataclass
class _Fitter:
    """Fits contacts to one reading.

    Attributes:
        rod: of the probe.
        seen: the reading.
        stalled: where fits ended that found no least misfit but one that explains nothing.
    """

    rod: Rod
    seen: Observation
    stalled: list[Candidate] = field(default_factory=list)
    _turns: Array = field(default_factory=lambda: np.empty((3, fit.UNKNOWNS)))

    def explains(self, place: Candidate) -> bool:
        """Whether a contact there may well have made the reading."""
        return bool(place.chi2 <= chdtri(place.dof, UNLIKELY))

    def places(self, guesses: Iterable[tuple[Array, Array, float]]) -> list[Candidate]:
        """What is found from each guess, each place once."""
        found: list[Candidate] = []
        for guess in guesses:
            place = self.fit(*guess)
            if place is not None and not any(self._same(place, other) for other in found):
                found.append(place)
        return found

    def fit(self, tip: Array, force: Array, s: float) -> Candidate | None:
        """The fit from one guess; None if there is no least misfit near."""
        state = np.concatenate([tip, force, [s]])
        derivatives, seen, scratch = np.empty((15, fit.UNKNOWNS + 1)), self.seen, self._scratch
        status, chi2, _iterations = fit.fit_contact(
            self.rod.body, seen.gravity, seen.weight, seen.wrench, self._whiten, 0.0, self.rod.length,
            *scratch[:-1], derivatives, scratch[-1], state,
        )  # fmt: skip
        if status == fit.LOST:
            return None
        self._turns = scratch[-2].copy()
        place = self._candidate(state, derivatives, chi2)
        if status != fit.STALLED:
            return place
        if not self.explains(place):
            self.stalled.append(place)
        return None

    def _candidate(self, state: Array, derivatives: Array, chi2: float) -> Candidate:
        rod, seen = self.rod, self.seen
        s, force = float(state[fit.PLACE]), state[fit.PUSH : fit.PLACE]
        tan = rod.taper_at(s)
        cov = covariance(derivatives, force, tan / math.hypot(1.0, tan), self._whiten)
        p, by_load, size = derivatives[9:12, -1], derivatives[9:12, :-1], float(np.linalg.norm(force))
        reach = float(np.interp(s, rod.s, rod.radius)) / math.hypot(1.0, tan)
        tip = state[: fit.PUSH].copy()

        def shape() -> Equilibrium:
            return rod.solve(seen.gravity, force, s, guess=tip)

        return Candidate(
            s_contact=s,
            std_s=math.sqrt(cov[3, 3]),
            p_contact_base=p,
            p_surface_base=p - reach / max(size, 1e-300) * force,
            force_base=force,
            cov_contact_base=self._curved(state, cov, p, by_load),
            chi2=chi2,
            dof=DOF,
            lever=float(np.linalg.norm(derivatives[0:3, 3])) / max(size, 1e-300),
            tip=tip,
            shape=shape,
        )

    def _curved(self, state: Array, cov: Array, p: Array, by_load: Array) -> Array:
        """Covariance of the contact point, (3, 3), to third order in how far s may be off.

        The places that explain a reading lie on a curve far narrower than it is bowed and twisted,
        p + a δ + b δ² + c δ³ for a standard normal δ, with the mean square aaᵀ + 3 (acᵀ + caᵀ) + 3 bbᵀ + 15 ccᵀ
        about p. It is looked at √3 standard deviations to either side, Gauss and Hermite's places. And s is known less well where the force would
        be less: where it goes as one over a force known to a share σ, its variance is 1 + 6 σ² greater than at the
        estimate, and the mean fourth power, on which bows depend, about 1 + 30 σ².
        """
        linear: Array = by_load @ cov @ by_load.T + NUMERICAL**2 * np.eye(3)
        std = math.sqrt(cov[3, 3])
        if not std < self.rod.length / 4.0:  # nothing is told of such a place anyhow
            return linear
        way, shares, points, variances = cov[:, 3] / std, [], [], []
        for share in (-ASIDE, ASIDE):
            found = self._displaced(state, share, way)
            if found is not None:
                shares.append(share)
                points.append(found[0])
                variances.append(found[1])
        if len(shares) < 2:  # close to the tip there is one side only
            bow = (points[0] - p) / shares[0] ** 2 - by_load @ way / shares[0] if shares else np.zeros(3)
            return linear + 3.0 * np.outer(bow, bow)
        wider = 2.0 / 3.0 + float(np.mean(variances)) / 3.0 / cov[3, 3]
        along, bow = by_load @ way, (points[0] + points[1] - 2.0 * p) / 6.0
        twist = ((points[1] - points[0]) / (2.0 * ASIDE) - along) / 3.0
        turned = along + 3.0 * twist
        widened: Array = linear + wider * np.outer(turned, turned) - np.outer(along, along)
        widened += wider**5 * (3.0 * np.outer(bow, bow) + 6.0 * np.outer(twist, twist))
        return widened

    def _displaced(self, state: Array, share: float, way: Array) -> tuple[Array, float] | None:
        """The contact's point and the variance of s as force and arclength go so far aside; None off the probe."""
        if not 0.0 < state[fit.PLACE] + share * way[3] <= self.rod.length:
            return None
        derivatives, there = np.empty((15, fit.UNKNOWNS + 1)), np.empty(fit.STATE)
        found = fit.displaced(
            self.rod.body, self.seen.gravity, self._whiten, self.seen.wrench, *self._scratch[:-2], self._turns,
            derivatives, np.empty(fit.WORK), state, share * way, there,
        )  # fmt: skip
        if not found:
            return None
        force, tan = there[fit.PUSH : fit.PLACE], self.rod.taper_at(float(there[fit.PLACE]))
        sine = tan / math.hypot(1.0, tan)
        wrench = np.concatenate([force + self.seen.weight, derivatives[0:3, -1]])
        refit = refitted(derivatives, force, sine, self._whiten, wrench - self.seen.wrench)
        cov = covariance(derivatives, force, sine, self._whiten)
        return derivatives[9:12, -1] + derivatives[9:12, :3] @ refit, float(cov[3, 3])

    def _same(self, a: Candidate, b: Candidate) -> bool:
        return abs(a.s_contact - b.s_contact) < _SAME * self.rod.length + 1e-2 * min(a.std_s, b.std_s)

    @cached_property
    def _whiten(self) -> Array:
        return self.seen.whiten

    @cached_property
    def _scratch(self) -> tuple[Array, ...]:
        """What the kernels work in: load, sweep, nodes, columns, base, contact, turns, fit."""
        room = workspace(kernels.LOAD_COLUMNS, 0)
        return (np.zeros(kernels.LOAD), room.scratch, room.nodes, room.blocks, room.y, room.contact, room.turns,
                np.empty(fit.WORK))  # fmt: skip


def normality_gradient(derivatives: Array, force: Array, sine: float) -> Array:
    """Of F · t + |F| sin α by force and arclength, (4,)."""
    size = float(np.linalg.norm(force))
    gradient: Array = force @ derivatives[3:6, :4]
    gradient[:3] += derivatives[3:6, -1] + (sine / size * force if size > 0.0 else 0.0)
    return gradient


def covariance(derivatives: Array, force: Array, sine: float, whiten: Array) -> Array:
    """Cramér and Rao's bound of force and arclength of a contact without friction.

    With N the directions that keep the force normal, cov = N (Nᵀ Hᵀ Σ⁻¹ H N)⁻¹ Nᵀ.

    Args:
        derivatives: of [moment, tangent, x axis, position, y axis] by force and arclength, and themselves, (15, 5).
        force: [N], (3,).
        sine: sin α at the contact.
        whiten: whitenᵀ whiten = Σ⁻¹, (6, 6).

    Returns:
        (4, 4) of (force, s); infinite where the reading leaves something open.
    """
    H = np.vstack([np.eye(3, 4), derivatives[0:3, :4]])
    gradient = normality_gradient(derivatives, force, sine)
    out = int(np.argmax(np.abs(gradient[:3])))
    rest = [j for j in range(4) if j != out]
    N = np.zeros((4, 3))
    N[rest, range(3)] = 1.0
    N[out] = -gradient[rest] / gradient[out]
    A = whiten @ H @ N
    scale = np.linalg.norm(A, axis=0)
    if not (scale > 0.0).all():
        return np.full((4, 4), np.inf)
    _, R = np.linalg.qr(A / scale)
    if np.abs(np.diag(R)).min() < 1e-12:
        return np.full((4, 4), np.inf)
    root = N / scale @ np.linalg.inv(R)
    cov: Array = root @ root.T
    return cov


def refitted(derivatives: Array, force: Array, sine: float, whiten: Array, misfit: Array) -> Array:
    """The change of a force, kept where it is and normal, that brings the wrench nearest to the reading [N], (3,).

    Args:
        derivatives, force, sine, whiten: as in `covariance`.
        misfit: of the wrench, (6,).
    """
    H = whiten @ np.vstack([np.eye(3), derivatives[0:3, :3]])
    gradient = normality_gradient(derivatives, force, sine)[:3]
    off = float(force @ derivatives[3:6, -1]) + sine * float(np.linalg.norm(force))
    out = int(np.argmax(np.abs(gradient)))
    rest = [j for j in range(3) if j != out]
    N, change = np.zeros((3, 2)), np.zeros(3)
    N[rest, range(2)] = 1.0
    N[out] = -gradient[rest] / gradient[out]
    change[out] = -off / gradient[out]
    kept = np.linalg.lstsq(H @ N, -(whiten @ misfit + H @ change), rcond=None)[0]
    changed: Array = change + N @ kept
    return changed
