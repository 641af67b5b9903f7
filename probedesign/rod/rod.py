"""An elastic Cosserat rod, clamped at s = 0, and its static equilibrium."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.rod.equilibrium import Equilibrium, Sensitivity
from probedesign.rod.kernels.equations import (
    ALL_COLUMNS,
    CONTACT_COLUMNS,
    LOAD,
    LOAD_COLUMNS,
    NOT_CONVERGED,
    OK,
    STEP_LIMIT,
    UNSTABLE,
    Body,
)
from probedesign.rod.kernels.newton import COLD, SINGLE_ROD, SOLUTION, WARM, WARM_ONLY, scratch_buffers, solve_cases

Mode = Literal["fast", "reference"]
Columns = Literal["none", "load", "contact", "all"]

#: Error allowed per step [rad], residual allowed at the base [rad]. "fast" keeps the centreline within 1 µm and the
#: base moment within 1e-6 of the reference (tests/rod/test_accuracy.py).
TOLERANCES: dict[str, tuple[float, float]] = {"fast": (5e-7, 2e-8), "reference": (1e-13, 1e-12)}
RESULTS = {OK: "ok", NOT_CONVERGED: "not_converged", UNSTABLE: "unstable", STEP_LIMIT: "not_converged"}
#: Nodes allocated for the shape at first; eight times as many where a rod needs more steps.
_NODES = {"fast": 64, "reference": 512}

ROOT_CENTRE = 0.375  #: Centre of the missing compliance of a bonded root [base radii] (docs/decisions/0006).
#: c₄ and c₅ of a full round neo-Hookean section with ν = 0.49 in finite bending (docs/decisions/0006).
FINITE_BEND, FINITE_STRETCH = 0.369, 0.374


def bow_curvature(length: float) -> Array:
    """Return the constant curvature about x and y by which the tip of a rod deviates by 1 m towards x, +κ about y, and
    towards y, -κ about x: κ = 2/L² [1/m²], (2, 2), a row each.

    Args:
        length: of the rod, L [m].
    """
    return 2.0 / length**2 * np.array([[0.0, 1.0], [-1.0, 0.0]])


@dataclass(frozen=True)
class Rod:
    """A Cosserat rod, z along its axis at rest.

    K_se = diag(k G A, k G A, E A), K_bt = diag(E I_xx, E I_yy, G J): the paper's equation 2 with a shear
    coefficient k, 1 in the paper.
    """

    s: Array  #: knots, 0 ... length [m], (K,).
    radius: Array  #: at the knots, linear between them [m], (K,); half the width along the section's x axis.
    youngs_modulus: float  #: E [Pa].
    shear_modulus: float  #: G [Pa].
    density: float  #: [kg/m³].
    shear_coefficient: float = 1.0  #: k.
    #: missing bending compliance of a bonded root, as a length of rigid rod [m], distributed smoothly over the first
    #: two base radii; negative for a compliant root.
    rigid_length: float = 0.0
    #: whether stretch and shear are excluded (Euler's elastica), for comparison with tables.
    inextensible: bool = False
    #: A, I_xx, I_yy and J over those of a full round section of the same radius.
    factors: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    #: of the unloaded rod at the knots, in section axes, the last one its twist [1/m], (K, 3); linear between; none if
    #: None.
    rest_curvature: Array | None = None
    #: whether sections stiffen and stretch like neo-Hookean ones in large bending; full round sections only.
    finite_strain: bool = False
    #: arclength where the rounding of the tip begins [m]; None for a blunt tip. The normals of a round end all meet the
    #: axis before it, so no frictionless contact acts beyond.
    rounded_from: float | None = None

    def __post_init__(self) -> None:
        for name in ("youngs_modulus", "shear_modulus", "shear_coefficient"):
            _require(bool(0.0 < getattr(self, name) < np.inf), f"{name} = {getattr(self, name)} must be positive")
        _require(bool(0.0 <= self.density < np.inf), f"density = {self.density} must not be negative")
        s, r = np.asarray(self.s, dtype=float), np.asarray(self.radius, dtype=float)
        _require(s.ndim == 1 and s.shape == r.shape and len(s) >= 2, "s and radius need two or more knots each")
        _require(bool(s[0] == 0.0 and (np.diff(s) > 0).all() and np.isfinite(s).all()), "s must increase from 0")
        _require(bool((r > 0).all() and np.isfinite(r).all()), "radius must be positive at every knot")
        _require(
            bool(-r[0] <= self.rigid_length < s[-1]),
            f"rigid_length = {self.rigid_length} must lie between minus the base radius and the rod's length",
        )
        _require(
            self.rounded_from is None or 0.0 < self.rounded_from <= s[-1],
            f"rounded_from = {self.rounded_from} must lie on the rod",
        )
        self._check_section(s)

    def _check_section(self, s: Array) -> None:
        _require(
            len(self.factors) == 4 and all(0.0 < f < np.inf for f in self.factors),
            f"factors = {self.factors} must be four positive numbers",
        )
        _require(
            not self.finite_strain or tuple(self.factors) == (1.0, 1.0, 1.0, 1.0),
            "finite_strain is modelled for full round sections only",
        )
        _require(not (self.finite_strain and self.inextensible), "finite_strain needs a rod that stretches")
        if self.rest_curvature is not None:
            rest = np.asarray(self.rest_curvature, dtype=float)
            _require(
                rest.shape == (len(s), 3) and bool(np.isfinite(rest).all()),
                "rest_curvature must be three finite numbers at every knot",
            )

    @property
    def length(self) -> float:
        """Return the length [m]."""
        return float(self.s[-1])

    @property
    def is_curved(self) -> bool:
        """Return whether the unloaded rod is curved, beyond the bow of a straight print: by more than 0.1 rad.

        A constant curvature of 0.1 rad moves the tip by a twentieth of the length, seven times the assumed bow.
        """
        u = self.rest_curvature
        return u is not None and float(np.abs(u[:, :2]).max()) * self.length > 0.1

    @cached_property
    def sag_origin(self) -> Array:
        """Return the tip from which a sag is measured, in base axes [m], (3,): that of the unloaded rod.

        Of a straight rod with a bow it is the tip of the straight one, so that a measured sag shows the bow.
        """
        return self.solve().p_at(self.length) if self.is_curved else np.array([0.0, 0.0, self.length])

    @property
    def flank_end(self) -> float:
        """Return the largest arclength at which a frictionless contact acts [m]."""
        return self.length if self.rounded_from is None else self.rounded_from

    @property
    def flatness(self) -> float:
        """Return the half-width along y over that along x, 1 if round; √(I_xx/I_yy) of a round section stretched in y,
        full or hollow."""
        return math.sqrt(self.factors[1] / self.factors[2])

    def radius_at(self, s: ArrayLike) -> Array:
        """Return the radius at arclength s [m], of the shape of s."""
        radius: Array = np.interp(np.asarray(s, dtype=float), self.s, self.radius)
        return radius

    def taper_at(self, s: ArrayLike) -> Array:
        """Return tan α = -dr/ds of the frustum at arclength s [m], of the shape of s; of the lower one at a knot."""
        taper: Array = self._tapers[np.searchsorted(self.s[1:-1], np.asarray(s, dtype=float))]
        return taper

    @cached_property
    def _tapers(self) -> Array:
        return np.asarray(-np.diff(self.radius) / np.diff(self.s), dtype=float)

    @property
    def root(self) -> tuple[float, float]:
        """Return depth and reach [m] of the bonded root, f(s) = 1 - depth (1 - s/reach)³; reach -1 without
        one.

        ∫(1 - f) ds = rigid_length, centred at ROOT_CENTRE base radii unless f would fall below 0.1.
        """
        if self.rigid_length == 0.0:
            return 0.0, -1.0
        reach = max(5.0 * ROOT_CENTRE * float(self.radius[0]), 4.0 * self.rigid_length / 0.9)
        return 4.0 * self.rigid_length / reach, reach

    @cached_property
    def body(self) -> Body:
        """Return the rod as arrays for the kernels."""
        s, r = np.ascontiguousarray(self.s, dtype=float), np.ascontiguousarray(self.radius, dtype=float)
        area, xx, yy, torsion = self.factors
        cones = area * np.pi / 3.0 * np.diff(s)
        frusta = cones * (r[:-1] ** 2 + r[:-1] * r[1:] + r[1:] ** 2)
        by_knot = np.zeros((len(s) - 1, len(s)))
        i = np.arange(len(s) - 1)
        by_knot[i, i] = cones * (2.0 * r[:-1] + r[1:]) * r[:-1]
        by_knot[i, i + 1] = cones * (2.0 * r[1:] + r[:-1]) * r[1:]
        stretches = 0.0 if self.inextensible else 1.0 / (np.pi * area)
        rest = np.zeros((len(s), 3)) if self.rest_curvature is None else np.asarray(self.rest_curvature)
        general = xx != yy or bool(rest.any())
        constants = np.array([
            4.0 / (np.pi * self.youngs_modulus * xx), 4.0 / (np.pi * self.youngs_modulus * yy),
            2.0 / (np.pi * self.shear_modulus * torsion),
            stretches / (self.shear_coefficient * self.shear_modulus), stretches / self.youngs_modulus,
            self.density, np.pi / 3.0 * area, float(general), *self.root,
            *((FINITE_BEND, FINITE_STRETCH) if self.finite_strain else (0.0, 0.0)), self.flatness,
        ])  # fmt: skip
        return Body(s, r, _beyond(frusta), _beyond(by_knot), rest.astype(float).ravel(), constants)

    @cached_property
    def stacked(self) -> Body:
        """Return the rod as a batch of one."""
        return Body(*(array[None] for array in self.body))

    @property
    def mass(self) -> float:
        """Return the mass [kg]."""
        return float(self.density * self.body.volume_beyond[0])

    def solve(
        self,
        gravity: ArrayLike = (0.0, 0.0, 0.0),
        force: ArrayLike = (0.0, 0.0, 0.0),
        s_contact: float | None = None,
        *,
        couple: ArrayLike = (0.0, 0.0, 0.0),
        tip_moment: ArrayLike = (0.0, 0.0, 0.0),
        mode: Mode = "fast",
        guess: ArrayLike | None = None,
        guess_only: bool = False,
        columns: Columns = "none",
    ) -> Equilibrium:
        """Solve for the static equilibrium under gravity, a dead point force and dead moments at contact and tip.

        Without a guess the load is increased from zero and the equilibrium is followed, so the solution is on the
        branch connected to the unloaded rod. With a guess, Newton's method starts there first.

        Args:
            gravity: in base axes [m/s²], (3,).
            force: in base axes, on the centreline [N], (3,).
            s_contact: where force and couple act [m]; the tip if None.
            couple: in base axes [N·m], (3,), of a force off the centreline.
            tip_moment: in base axes [N·m], (3,); equilibria under one are not tested for stability.
            mode: "fast" or "reference".
            guess: `tip` of a neighbouring equilibrium, (6,).
            guess_only: return without a solution where the guess fails, instead of starting from no load.
            columns: parameters of the exact sensitivities: "none", "load" (force and s_contact), "contact" (also the
                couple) or "all" (also gravity, E, G, density, and the diameter of all knots and of each).

        Returns:
            The equilibrium; its `result` is "ok", "not_converged" or "unstable", its numbers are finite only with "ok".

        Raises:
            InputError: an argument is not finite or s_contact is off the rod.
        """
        load = self.load(gravity, force, s_contact, couple, tip_moment)
        k, room = self.columns_of(columns), _NODES[mode]
        start = COLD if guess is None else WARM_ONLY if guess_only else WARM
        solved, derivatives = np.empty(1, dtype=SOLUTION), np.empty((1, 15, k + 1))
        if guess is not None:
            solved["tip"] = _tip(guess)
        while True:
            work = scratch_buffers(k, room)
            solve_cases(
                0, 1, self.stacked, SINGLE_ROD, load[None], start, False, *TOLERANCES[mode], work, solved, derivatives
            )
            row = solved[0]
            status, count = int(row["status"]), int(row["count"])
            shape = work.nodes.reshape(room, -1)[:count]
            if status != OK or shape[-1, 0] == 0.0:
                break
            room, start = 8 * room, WARM
        d, sensitivity = derivatives[0], None
        if k and status == OK:
            sensitivity = Sensitivity(d[:3, :k], d[3:, :k], d[3:, k], work.turns, load, self.body)
        return Equilibrium(
            RESULTS[status], float(row["margin"]), float(row["residual"]), load, shape, row["tip"], work.y,
            work.contact, self.body, sensitivity,
        )  # fmt: skip

    def columns_of(self, columns: Columns) -> int:
        """Return the number of parameters of the sensitivities."""
        every = ALL_COLUMNS + len(self.s)
        return {"none": 0, "load": LOAD_COLUMNS, "contact": CONTACT_COLUMNS, "all": every}[columns]

    def load(
        self,
        gravity: ArrayLike,
        force: ArrayLike,
        s_contact: float | None = None,
        couple: ArrayLike = (0.0, 0.0, 0.0),
        tip_moment: ArrayLike = (0.0, 0.0, 0.0),
    ) -> Array:
        """Return [force, gravity, tip moment, couple, s_c] for the kernels, (13,), validated.

        Raises:
            InputError: as `solve`.
        """
        load = np.empty(LOAD)
        try:
            load[:12] = np.array((force, gravity, tip_moment, couple), dtype=float).ravel()
        except (TypeError, ValueError):
            load[0] = math.nan
        if not np.isfinite(load[:12]).all():
            given = {"force": force, "gravity": gravity, "tip_moment": tip_moment, "couple": couple}
            for name, value in given.items():
                finite_vector(name, value)
        try:
            s = self.length if s_contact is None else float(s_contact)
        except (TypeError, ValueError):
            raise InputError(f"s_contact = {s_contact!r} must be a number in metres") from None
        if not 0.0 <= s <= self.length * (1 + 1e-12):  # a fraction of the length may be rounded up
            raise InputError(f"s_contact = {s_contact} must lie in 0 ... {self.length:g} m")
        load[12] = min(s, self.length)
        return load


def finite_vector(name: str, value: ArrayLike) -> Array:
    """Return a vector (3,) of finite numbers; raise InputError, naming the argument, for anything else."""
    try:
        vector = np.array(value, dtype=float)
    except (TypeError, ValueError):
        vector = np.empty(0)
    if vector.shape != (3,) or not np.isfinite(vector).all():  # the text of an array takes as long as a solve
        raise InputError(f"{name} = {value!r} must be three finite numbers")
    return vector


def _beyond(parts: Array) -> Array:
    sums = np.cumsum(parts[::-1], axis=0)[::-1]
    return np.ascontiguousarray(np.concatenate([sums, np.zeros((1, *parts.shape[1:]))]))


def _tip(guess: ArrayLike) -> Array:
    """Return [t, d] of a guess, made a unit tangent and a unit normal of it."""
    tip = np.array(guess, dtype=float)
    if tip.shape != (6,) or not math.isfinite(tip.sum()):
        raise InputError(f"guess = {guess!r} must be a section's [tangent, x axis] (6,)")
    t, d = tip[:3], tip[3:]
    t /= math.sqrt(t @ t) or math.nan
    d -= (d @ t) * t
    norm = math.sqrt(d @ d)
    if not norm > 1e-6:
        raise InputError(f"guess = {guess!r}: the tangent is zero, or the x axis lies along it")
    d /= norm
    return tip


def _require(holds: bool, message: str) -> None:
    if not holds:
        raise InputError(message)


#: Places of Gauss–Legendre quadrature along the rod: the frequency of a uniform cantilever is within 1e-6 of the exact
#: one, those of the paper's cones within 1e-4.
_PLACES = 16


def natural_frequency(rod: Rod, gravity: ArrayLike = (0.0, 0.0, 0.0)) -> float:
    """Return the first natural frequency of small oscillations about the equilibrium under gravity [Hz].

    A force at s' moves the axis at s by the flexibility G(s, s'), (3, 3), the derivative of the equilibrium. The
    eigenvalue problem u(s) = ω² ∫ G(s, s') ρ A(s') u(s') ds' is solved by quadrature. Rotary inertia and damping are
    neglected.

    Args:
        rod: clamped at its base, straight or curved.
        gravity: in base axes [m/s²], (3,).

    Returns:
        The frequency; NaN where the weight buckles the rod.

    Source: L. M. Delves, J. L. Mohamed, Computational Methods for Integral Equations, 1985, 4 (Nyström's method).
    """
    x, weights = np.polynomial.legendre.leggauss(_PLACES)
    s = rod.length * (x + 1.0) / 2.0
    mass = rod.density * rod.factors[0] * np.pi * rod.radius_at(s) ** 2 * weights * rod.length / 2.0
    flexibility = np.empty((_PLACES, 3, _PLACES, 3))
    for j in range(_PLACES):
        rest = rod.solve(gravity, s_contact=float(s[j]), columns="contact")
        if not rest.ok:
            return math.nan
        flexibility[:, :, j] = rest.d_p_at(s)[:, :, :3]
    root = np.repeat(np.sqrt(mass), 3)
    largest = np.linalg.eigvalsh(root[:, None] * flexibility.reshape(3 * _PLACES, -1) * root)[-1]
    return 1.0 / (2.0 * math.pi * math.sqrt(largest))
