"""An elastic rod, clamped at s = 0: arrays in, equilibria out."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from probedesign.errors import InputError
from probedesign.frames import Array
from probedesign.rod import kernels
from probedesign.rod.equilibrium import Equilibrium, Sensitivity
from probedesign.rod.kernels.solve import SINGLE_ROD, scratch_buffers

Mode = Literal["fast", "reference"]
Columns = Literal["none", "load", "contact", "all"]

TOLERANCES: dict[str, tuple[float, float]] = {"fast": (5e-7, 2e-8), "reference": (1e-13, 1e-12)}
"""Error allowed a step [rad], residual allowed at the base [rad]. Fast keeps the centreline within 1 µm and
the base moment within 1e-6 of the reference (tests/rod/test_accuracy.py)."""
RESULTS = {
    kernels.OK: "ok",
    kernels.NOT_CONVERGED: "not_converged",
    kernels.UNSTABLE: "unstable",
    kernels.STEP_LIMIT: "not_converged",
}
_NODES = {"fast": 64, "reference": 512}
"""Room for the shape at first; more where a rod needs more steps."""

ROOT_CENTRE = 0.375
"""Where the compliance that a bonded root lacks is centred, in base radii (docs/decisions/0006)."""
FINITE_BEND, FINITE_STRETCH = 0.369, 0.374
"""c₄ and c₅ of a full round neo-Hookean section with ν = 0.49 in finite bending (docs/decisions/0006)."""


@dataclass(frozen=True)
class Rod:
    """A Cosserat rod, z along its axis at rest.

    K_se = diag(k G A, k G A, E A), K_bt = diag(E I_xx, E I_yy, G J): the paper's equation 2 with a shear
    coefficient k, 1 in the paper.

    Attributes:
        s: knots, 0 ... length [m], (K,).
        radius: at the knots, linear between them [m], (K,); half the width along the section's x axis.
        youngs_modulus: E [Pa].
        shear_modulus: G [Pa].
        density: [kg/m³].
        shear_coefficient: k.
        rigid_length: bending compliance that a bonded root lacks, as a length of rigid rod [m]; negative where
            the root yields. Spread smoothly over the first two base radii.
        inextensible: neither stretches nor shears (Euler's elastica), for comparisons with tables.
        factors: of A, I_xx, I_yy and J, over those of a full round section of that radius.
        rest_curvature: of the unloaded rod at the knots, in section axes, the last one its twist [1/m], (K, 3);
            linear between; none if None.
        finite_strain: whether sections stiffen and stretch as neo-Hookean ones do in large bending; only of a
            full round rod.
        rounded_from: where the rounding of the tip begins [m]; None for a blunt tip. The normals of a round end
            all meet the axis before it, so no touch acts further out.
    """

    s: Array
    radius: Array
    youngs_modulus: float
    shear_modulus: float
    density: float
    shear_coefficient: float = 1.0
    rigid_length: float = 0.0
    inextensible: bool = False
    factors: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    rest_curvature: Array | None = None
    finite_strain: bool = False
    rounded_from: float | None = None

    def __post_init__(self) -> None:
        for name in ("youngs_modulus", "shear_modulus", "shear_coefficient"):
            _require(
                bool(0.0 < getattr(self, name) < np.inf), f"{name} = {getattr(self, name)} must be positive"
            )
        _require(bool(0.0 <= self.density < np.inf), f"density = {self.density} must not be negative")
        s, r = np.asarray(self.s, dtype=float), np.asarray(self.radius, dtype=float)
        _require(
            s.ndim == 1 and s.shape == r.shape and len(s) >= 2, "s and radius need two or more knots each"
        )
        _require(
            bool(s[0] == 0.0 and (np.diff(s) > 0).all() and np.isfinite(s).all()), "s must increase from 0"
        )
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
            "finite_strain is known of full round sections only",
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
        """[m]."""
        return float(self.s[-1])

    @property
    def flank_end(self) -> float:
        """The furthest arclength at which a touch without friction acts [m]."""
        return self.length if self.rounded_from is None else self.rounded_from

    def taper_at(self, s: float) -> float:
        """tan α = -dr/ds of the frustum that arclength s [m] lies in (the lower one at a knot)."""
        i = int(np.clip(np.searchsorted(self.s, s) - 1, 0, len(self.s) - 2))
        return float((self.radius[i] - self.radius[i + 1]) / (self.s[i + 1] - self.s[i]))

    @property
    def root(self) -> tuple[float, float]:
        """Depth and reach [m] of the bonded root, f(s) = 1 - depth (1 - s/reach)³; reach -1 where there is none.

        ∫(1 - f) ds = rigid_length, centred at ROOT_CENTRE base radii unless so much is missing that f would
        fall below a tenth.
        """
        if self.rigid_length == 0.0:
            return 0.0, -1.0
        reach = max(5.0 * ROOT_CENTRE * float(self.radius[0]), 4.0 * self.rigid_length / 0.9)
        return 4.0 * self.rigid_length / reach, reach

    @cached_property
    def body(self) -> kernels.Body:
        """The same as arrays for the kernels."""
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
            *((FINITE_BEND, FINITE_STRETCH) if self.finite_strain else (0.0, 0.0)),
        ])  # fmt: skip
        return kernels.Body(s, r, _beyond(frusta), _beyond(by_knot), rest.astype(float).ravel(), constants)

    @cached_property
    def stacked(self) -> kernels.Body:
        """The same as one row of many."""
        return kernels.Body(*(array[None] for array in self.body))

    @cached_property
    def directed(self) -> int | None:
        """How the kernels are told whether bending knows direction: None if it does not."""
        return 0 if self.body.constants[kernels.GENERAL] else None

    @property
    def mass(self) -> float:
        """[kg]."""
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
        """Static equilibrium under gravity, a dead point force and dead moments at the contact and at the tip.

        Cold, the load grows from nothing and the equilibrium is followed, so the answer is the branch
        connected to the unloaded rod; with a guess, Newton starts there first.

        Args:
            gravity: in base axes [m/s²], (3,).
            force: in base axes, on the centreline [N], (3,).
            s_contact: where force and couple act [m]; the tip if None.
            couple: in base axes [N·m], (3,): that of a force beside the centreline.
            tip_moment: in base axes [N·m], (3,); no equilibrium under one is judged for stability.
            mode: "fast" or "reference".
            guess: `tip` of a neighbouring equilibrium, (6,), or its tangent alone, (3,).
            guess_only: give up where the guess does not lead to an answer, instead of starting cold.
            columns: which exact sensitivities to carry along: "none", "load" (force and s_contact), "contact"
                (with the couple) or "all" (with gravity, E, G, density, every and each knot's diameter).

        Returns:
            The equilibrium; its `result` is "ok", "not_converged" or "unstable"; numbers come only with "ok".

        Raises:
            InputError: an argument is not finite or s_contact lies off the rod.
        """
        load = self.load(gravity, force, s_contact, couple, tip_moment)
        k, room = self.columns_of(columns), _NODES[mode]
        start = kernels.COLD if guess is None else kernels.WARM_ONLY if guess_only else kernels.WARM
        found, derivatives = np.empty((1, kernels.ROW_LENGTH)), np.empty((1, 15, k + 1))
        row = found[0]
        if guess is not None:
            row[kernels.ROW_TIP : kernels.ROW_TIP + 6] = _tip(guess)
        while True:
            work = scratch_buffers(k, room)
            kernels.solve_cases(
                0,
                1,
                self.stacked,
                SINGLE_ROD,
                load[None],
                self.directed,
                start,
                False,
                *TOLERANCES[mode],
                *work,
                found,
                derivatives,
            )
            status, count = int(row[kernels.ROW_STATUS]), int(row[kernels.ROW_COUNT])
            shape = work.nodes.reshape(room, -1)[:count]
            if status != kernels.OK or shape[-1, 0] == 0.0:
                break
            room, start = 8 * room, kernels.WARM
        d, tip = derivatives[0], row[kernels.ROW_TIP : kernels.ROW_TIP + 6]
        sensitivity = None
        if k and status == kernels.OK:
            sensitivity = Sensitivity(d[:3, :k], d[3:, :k], d[3:, k], work.turns, load, self.body)
        margin, residual = float(row[kernels.ROW_MARGIN]), float(row[kernels.ROW_RESIDUAL])
        return Equilibrium(
            RESULTS[status], margin, residual, load, shape, tip, work.y, work.contact, self.body, sensitivity
        )

    def columns_of(self, columns: Columns) -> int:
        """How many parameters the sensitivities are by."""
        every = kernels.ALL_COLUMNS + len(self.s)
        return {"none": 0, "load": kernels.LOAD_COLUMNS, "contact": kernels.CONTACT_COLUMNS, "all": every}[
            columns
        ]

    def load(
        self,
        gravity: ArrayLike,
        force: ArrayLike,
        s_contact: float | None = None,
        couple: ArrayLike = (0.0, 0.0, 0.0),
        tip_moment: ArrayLike = (0.0, 0.0, 0.0),
    ) -> Array:
        """[force, gravity, tip moment, couple, s_c] for the kernels, checked.

        Raises:
            InputError: as `solve`.
        """
        load = np.empty(kernels.LOAD)
        try:
            load[:12] = np.array((force, gravity, tip_moment, couple), dtype=float).ravel()
        except (TypeError, ValueError):
            load[0] = math.nan
        if not np.isfinite(load[:12]).all():
            _refuse_vector(force=force, gravity=gravity, tip_moment=tip_moment, couple=couple)
        try:
            s = self.length if s_contact is None else float(s_contact)
        except (TypeError, ValueError):
            raise InputError(f"s_contact = {s_contact!r} must be a number in metres") from None
        if not 0.0 <= s <= self.length * (1 + 1e-12):  # a fraction of the length may round up
            raise InputError(f"s_contact = {s_contact} must lie in 0 ... {self.length:g} m")
        load[12] = min(s, self.length)
        return load


def _refuse_vector(**vectors: ArrayLike) -> None:
    """Name the one that is not three finite numbers."""
    for name, value in vectors.items():
        good = np.shape(value) == (3,) and bool(np.isfinite(np.asarray(value, dtype=float)).all())
        _require(good, f"{name} = {value!r} must be three finite numbers")


def _beyond(parts: Array) -> Array:
    """Sums of the rows from each on, and zero after the last."""
    sums = np.cumsum(parts[::-1], axis=0)[::-1]
    return np.ascontiguousarray(np.concatenate([sums, np.zeros((1, *parts.shape[1:]))]))


def _tip(guess: ArrayLike) -> Array:
    """[t, d] of a guess: a section, or a tangent, whose section is turned from the base's the shortest way."""
    given = np.array(guess, dtype=float)
    t = given[:3] if given.shape in ((3,), (6,)) else np.zeros(3)
    norm = math.sqrt(t @ t)
    if not 0.0 < norm < math.inf or not math.isfinite(given.sum()):
        raise InputError(f"guess = {guess!r} must be a direction (3,) or a section's [tangent, x axis] (6,)")
    t = t / norm
    d = given[3:] if len(given) == 6 else _carried_x(t)
    d = d - (d @ t) * t
    norm = math.sqrt(d @ d)
    if norm < 1e-6:
        raise InputError(f"guess = {guess!r}: the x axis lies along the tangent")
    found = np.empty(6)
    found[:3], found[3:] = t, d / norm
    return found


def _carried_x(t: Array) -> Array:
    """The x axis carried along from z to t."""
    if t[2] < -0.999:
        return np.array([-1.0, 0.0, 0.0])
    carried: Array = np.array([1.0, 0.0, 0.0]) - t[0] / (1.0 + t[2]) * (t + np.array([0.0, 0.0, 1.0]))
    return carried


def _require(holds: bool, message: str) -> None:
    if not holds:
        raise InputError(message)
