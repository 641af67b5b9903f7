"""A straight round elastic rod, clamped at s = 0: arrays in, equilibria out."""

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

Mode = Literal["fast", "reference"]
Columns = Literal["none", "load", "all"]

TOLERANCES: dict[str, tuple[float, float]] = {"fast": (1e-7, 1e-8), "reference": (1e-13, 1e-12)}
"""Error allowed a step [rad], residual allowed at the base [rad]. Fast keeps the centreline within 1 µm and
the base moment within 1e-6 of the reference (tests/rod/test_accuracy.py)."""
_COLUMNS = {"none": 0, "load": kernels.LOAD_COLUMNS, "all": kernels.ALL_COLUMNS}
_RESULTS = {
    kernels.OK: "ok",
    kernels.NOT_CONVERGED: "not_converged",
    kernels.UNSTABLE: "unstable",
    kernels.STEP_LIMIT: "not_converged",
}
_MAX_NODES = 4096


@dataclass(frozen=True)
class Rod:
    """A Cosserat rod of solid round section, straight and untwisted at rest, z along its axis.

    K_se = diag(k G A, k G A, E A), K_bt = diag(E I, E I, G J): the paper's equation 2 with a shear
    coefficient k, 1 in the paper.

    Attributes:
        s: knots, 0 ... length [m], (K,).
        radius: at the knots, linear between them [m], (K,).
        youngs_modulus: E [Pa].
        shear_modulus: G [Pa].
        density: [kg/m³].
        shear_coefficient: k.
        rigid_length: from s = 0 the rod neither bends nor twists so far [m] (the bonded root).
        inextensible: neither stretches nor shears (Euler's elastica), for comparisons with tables.
        factors: of A, I_xx, I_yy and J, over those of a full round section of that radius; x and y are the
            section's axes, the radius is its half-width along x.
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
            bool(0.0 <= self.rigid_length < s[-1]), f"rigid_length = {self.rigid_length} must lie on the rod"
        )

    @property
    def length(self) -> float:
        """[m]."""
        return float(self.s[-1])

    def taper_at(self, s: float) -> float:
        """tan α = -dr/ds of the frustum that arclength s [m] lies in (the lower one at a knot)."""
        i = int(np.clip(np.searchsorted(self.s, s) - 1, 0, len(self.s) - 2))
        return float((self.radius[i] - self.radius[i + 1]) / (self.s[i + 1] - self.s[i]))

    @cached_property
    def body(self) -> kernels.Body:
        """The same as arrays for the kernels."""
        s, r = np.ascontiguousarray(self.s, dtype=float), np.ascontiguousarray(self.radius, dtype=float)
        frusta = np.pi / 3.0 * np.diff(s) * (r[:-1] ** 2 + r[:-1] * r[1:] + r[1:] ** 2)
        beyond = np.append(np.cumsum(frusta[::-1])[::-1], 0.0)
        material = np.array([self.youngs_modulus, self.shear_modulus, self.shear_coefficient, self.density,
                             self.rigid_length, 0.0 if self.inextensible else 1.0])  # fmt: skip
        return kernels.Body(s, r, beyond, material)

    def solve(
        self,
        gravity: ArrayLike = (0.0, 0.0, 0.0),
        force: ArrayLike = (0.0, 0.0, 0.0),
        s_contact: float | None = None,
        *,
        tip_moment: ArrayLike = (0.0, 0.0, 0.0),
        mode: Mode = "fast",
        guess: ArrayLike | None = None,
        guess_only: bool = False,
        columns: Columns = "none",
    ) -> Equilibrium:
        """Static equilibrium under gravity, a dead point force and a dead moment at the tip.

        Cold, the load grows from nothing and the equilibrium is followed, so the answer is the branch
        connected to the unloaded rod; with a guess, Newton starts there first.

        Args:
            gravity: in base axes [m/s²], (3,).
            force: in base axes, on the centreline [N], (3,).
            s_contact: where the force acts [m]; the tip if None.
            tip_moment: in base axes [N·m], (3,).
            mode: "fast" or "reference".
            guess: tangent at the tip to start from, (3,).
            guess_only: give up where the guess does not lead to an answer, instead of starting cold.
            columns: which exact sensitivities to carry along: "none", "load" (force and s_contact) or "all".

        Returns:
            The equilibrium; its `result` is "ok", "not_converged" or "unstable"; numbers come only with "ok".

        Raises:
            InputError: an argument is not finite or s_contact lies off the rod.
        """
        load = self._load(gravity, force, s_contact, tip_moment)
        tol, until = TOLERANCES[mode]
        k = _COLUMNS[columns]
        start = kernels.COLD if guess is None else kernels.WARM_ONLY if guess_only else kernels.WARM
        t = np.array([0.0, 0.0, 1.0]) if guess is None else _unit(guess)
        y, contact = np.empty(12 * (3 + k)), np.empty(12 * (3 + k))
        nodes = np.empty((_MAX_NODES if mode == "reference" else 512, 13))
        scratch = np.empty(kernels.SCRATCH)
        status, count, stable, residual = kernels.solve(
            t, start, scratch, self.body, load, tol, until, k, nodes, y, contact
        )
        sensitivity = self._sensitivity(y, contact, k, load) if k and status == kernels.OK else None
        result, shape = _RESULTS[status], nodes[:count]
        return Equilibrium(result, stable, residual, load, shape, y, contact, self.body, sensitivity)

    def _load(
        self, gravity: ArrayLike, force: ArrayLike, s_contact: float | None, moment: ArrayLike
    ) -> Array:
        """[force, gravity, tip moment, s_c] for the kernels, checked."""
        load = np.empty(10)
        for start, name, value in ((0, "force", force), (3, "gravity", gravity), (6, "tip_moment", moment)):
            if np.shape(value) != (3,):
                raise InputError(f"{name} = {value!r} must be three finite numbers")
            load[start : start + 3] = value
            if not (
                math.isfinite(load[start])
                and math.isfinite(load[start + 1])
                and math.isfinite(load[start + 2])
            ):
                raise InputError(f"{name} = {value!r} must be three finite numbers")
        try:
            s = self.length if s_contact is None else float(s_contact)
        except (TypeError, ValueError):
            raise InputError(f"s_contact = {s_contact!r} must be a number in metres") from None
        if not 0.0 <= s <= self.length * (1 + 1e-12):  # a fraction of the length may round up
            raise InputError(f"s_contact = {s_contact} must lie in 0 ... {self.length:g} m")
        load[9] = min(s, self.length)
        return load

    def _sensitivity(self, y: Array, contact: Array, columns: int, load: Array) -> Sensitivity:
        d_moment, d_contact, frame = np.empty((3, columns)), np.empty((12, columns)), np.empty(12)
        kernels.sensitivities(y, contact, columns, self.body, load, d_moment, d_contact, frame)
        return Sensitivity(d_moment, d_contact, frame, load, self.body)


def _unit(t: ArrayLike) -> Array:
    vector = np.array(t, dtype=float)
    norm = float(np.linalg.norm(vector))
    if vector.shape != (3,) or not 0.0 < norm < np.inf:
        raise InputError(f"guess = {t!r} must be a direction (3,)")
    return vector / norm


def _require(holds: bool, message: str) -> None:
    if not holds:
        raise InputError(message)
