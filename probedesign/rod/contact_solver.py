"""Solve one contact of a rod and an object by Newton's method with exact derivatives."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from probedesign.core.frames import Array
from probedesign.rod.contact import Numbers
from probedesign.rod.equilibrium import Equilibrium, Sensitivity
from probedesign.rod.rod import Mode, Rod
from probedesign.rod.surface import UNKNOWNS, Obstacle, SurfacePiece, SurfaceState

MIN_FORCE = 1e-6
"""Without dimension; below it, the residual of forces is absolute."""
_CLOSE = {"fast": 1e-8, "reference": 1e-12}
"""Residual allowed: rod lengths and relative force; above the rounding of each mode."""
_MAX_ITERATIONS = 12  # Newton's method converges in a few; else the step is shortened
_MAX_UNKNOWN = 1e6  # without dimension: Newton's method has diverged
_IMAGINARY = 1e-30  # complex step of the derivatives: so small that no digit is lost
_REAL = 1e-6  # relative imaginary part of a double eigenvalue by rounding


class StepFailure(NamedTuple):
    """Reason why a step found no contact that continues the last one."""

    #: "not_converged" or "unstable", of the rod or the contact; "pulls": the object would have to pull; "slips": the
    #: contact is unstable; "far": it does not continue the last one; "edge": it leaves its piece of the surface and has
    #: no equilibrium on the next.
    reason: str
    ahead: int = 0  #: for "edge", 1 towards the tip, -1 towards the base.


@dataclass(frozen=True)
class SolvedContact:
    """A solved contact of the rod with an object."""

    index: int  #: index, piece: of the surface.
    piece: SurfacePiece
    part: float  #: fraction of the object's path.
    x: Array  #: unknowns, without dimension, (8,).
    obstacle: Obstacle  #: the object.
    equilibrium: Equilibrium  #: of the rod under the contact.
    state: SurfaceState  #: of the surface's equations.
    rates: Array  #: derivatives of the unknowns by the object's position, without dimension, (8, 3).
    stays: bool  #: whether the contact is stable.
    units: tuple[float, float]  #: length [m] and force [N] that scale the numbers without dimension.

    @property
    def sensitivity(self) -> Sensitivity:
        """Return the sensitivity of the equilibrium."""
        assert self.equilibrium.sensitivity is not None, "every solved contact has it"
        return self.equilibrium.sensitivity

    @property
    def presses(self) -> bool:
        """Return whether the force is not zero, as it is at the first contact."""
        return bool(self.x[0:3].any())

    @property
    def force(self) -> Array:
        """Return the force of the object on the rod [N], (3,)."""
        return np.asarray(self.x[0:3] * self.units[1])

    @property
    def couple(self) -> Array:
        """Return the couple about the centreline [N·m], (3,)."""
        return np.asarray(self.x[3:6] * self.units[0] * self.units[1])

    @property
    def s_contact(self) -> float:
        """Return the arclength where the force acts on the centreline [m]."""
        return on_rod(self.piece, float(self.x[6])) * self.units[0]

    @property
    def s_surface(self) -> float:
        """Return the arclength of the touched section [m]."""
        return self.piece.surface(float(self.x[6])) * self.units[0]

    @property
    def point(self) -> Array:
        """Return the touched point [m], (3,)."""
        point = self.obstacle.at(self.part)
        if self.obstacle.direction is None:
            return point
        return point + float(self.x[7]) * self.units[0] * self.obstacle.direction

    @property
    def angle(self) -> float:
        """Return φ of the force about the tangent [rad]."""
        w = self.state.w[:, 0]
        return math.atan2(-float(w @ self.state.y[:, 0]), -float(w @ self.state.x[:, 0]))

    @property
    def normal(self) -> Array:
        """Return the outward unit normal of the surface, (3,); at the rim the direction opposite to the force."""
        if self.piece.where == "rim" and self.presses:
            return -self.x[0:3] / float(np.linalg.norm(self.x[0:3]))
        w: Array = self.state.t[:, 0] if self.piece.where == "face" else self.state.w[:, 0]
        return np.asarray(w / max(float(np.linalg.norm(w)), 1e-300))

    @property
    def d_point(self) -> Array:
        """Return the derivative of the touched point by the object's position, (3, 3)."""
        if self.obstacle.direction is None:
            return np.eye(3)
        return np.eye(3) + np.outer(self.obstacle.direction, self.rates[7])

    @cached_property
    def d_load(self) -> Array:
        """Return the derivative of [force, s_contact, couple] by the object's position [N/m, 1, N], (7, 3)."""
        length, force = self.units
        station = _rate(self.piece, self.x[6]) * self.rates[6]
        return np.vstack([self.rates[0:3] * force / length, station, self.rates[3:6] * force])

    @property
    def d_along(self) -> Array:
        """Return the derivative of the unknowns along the path, per rod length, (8,)."""
        way: Array = self.rates @ self.obstacle.travel / np.linalg.norm(self.obstacle.travel)
        return way


@dataclass(frozen=True)
class _Linear:
    """Equations of a piece, linearised at a guess."""

    piece: SurfacePiece  #: of the surface.
    direction: Array | None  #: of the line; None for a point.
    inputs: Array  #: of the equations: [8 unknowns, 12 of the frame, 3 of the point].
    frame_by_unknowns: Array  #: derivative of the frame by the unknowns, (12, 8).

    @property
    def misfit(self) -> Array:
        """Return the residual of the equations, (8,)."""
        return self._derived[0]

    @cached_property
    def by_unknowns(self) -> Array:
        """Return the Jacobian by the unknowns, (8, 8)."""
        d = self._derived[1]
        return d[:, :8] + d[:, 8:20] @ self.frame_by_unknowns

    @property
    def by_point(self) -> Array:
        """Return the derivative by the object's position, (8, 3)."""
        return self._derived[1][:, 20:23]

    @property
    def state(self) -> SurfaceState:
        """Return the surface state at the guess."""
        return SurfaceState.of(self.inputs[:, None], self.direction, self.piece.beyond)

    def stays(self) -> bool:
        """Return whether the energy has a minimum here.

        Under a dead force the rod is stable, else it would not have been found. The additional terms, by which the
        force turns as the rod moves on the object, are proportional to the force. As they grow from zero to their
        value, the Jacobian becomes singular once for each unstable mode.
        """
        dead = self._by_unknowns_dead_load
        modes = np.linalg.eigvals(solved(dead, dead - self.by_unknowns))
        real = np.abs(modes.imag) <= _REAL * np.abs(modes)
        return not bool((modes.real[real] > 1.0).any())

    @property
    def _by_unknowns_dead_load(self) -> Array:
        """Return `by_unknowns` for a force that does not turn with the surface, (8, 8)."""
        inputs = self.inputs.copy()
        inputs[0:3] = 0.0
        d = self._derivatives(inputs)[1]
        d[:, 6] = self._derived[1][:, 6]  # at an edge the place is the direction of the force,
        if self.piece.where == "face":  # along a flush line the way is where the force acts
            d[:, 7] = self._derived[1][:, 7]
        return d[:, :8] + d[:, 8:20] @ self.frame_by_unknowns

    @cached_property
    def _derived(self) -> tuple[Array, Array]:
        return self._derivatives(self.inputs)

    def _derivatives(self, inputs: Array) -> tuple[Array, Array]:
        """Return the equations (8,) and their derivatives by each input (8, 23), by complex steps."""
        steps: Numbers = inputs[:, None] + 1j * _IMAGINARY * np.eye(len(inputs))
        state = SurfaceState.of(steps, self.direction, self.piece.beyond)
        found = self.piece.equations(state, self.direction)
        return found[:, 0].real, found.imag / _IMAGINARY


@dataclass(frozen=True)
class ContactSolver:
    """Finds the contacts of a rod with an object."""

    rod: Rod  #: the rod.
    gravity: Array  #: in base axes [m/s²], (3,).
    obstacle: Obstacle  #: the object.
    pieces: list[SurfacePiece]  #: of the rod's surface.
    mode: Mode  #: "fast" or "reference".

    def begun(self, free: Equilibrium, index: int, part: float, x: Array) -> SolvedContact:
        """Return the contact without force of the free rod, with unknowns `x` (8,)."""
        piece = self.pieces[index]
        s = self.rod.length * on_rod(piece, x[6])
        R = free.R_at(s)
        frame = np.concatenate([R[:, 2], R[:, 0], free.p_at(s) / self.rod.length, R[:, 1]])
        linear = self._linear(piece, frame, np.zeros((12, UNKNOWNS)), part, x)
        still = np.zeros((UNKNOWNS, 3))
        return SolvedContact(index, piece, part, x, self.obstacle, free, linear.state, still, True, self._units)

    def solve(self, index: int, part: float, x: Array, guess: Array) -> SolvedContact | StepFailure:
        """Solve for the contact on one piece.

        Args:
            index: of the piece.
            part: fraction of the object's path.
            x: unknowns to start from, (8,).
            guess: `tip` of a neighbouring equilibrium, (6,).

        Returns:
            The contact, which may lie beyond the ends of its piece, or why there is none.
        """
        piece, off = self.pieces[index], 0
        for _ in range(_MAX_ITERATIONS):
            eq = self._solved(piece, x, guess)
            if not eq.ok:
                return StepFailure(eq.result)
            linear = self._linearised(piece, x, eq, part)
            if self._fits(linear.misfit, x):
                rates = -solved(linear.by_unknowns, linear.by_point)
                stays = linear.stays()
                return SolvedContact(index, piece, part, x, self.obstacle, eq, linear.state, rates, stays, self._units)
            x, guess, before = x - solved(linear.by_unknowns, linear.misfit), eq.tip, off
            if not np.abs(x).max() < _MAX_UNKNOWN:
                break
            off = int(np.sign(_station(piece, x[6]) - on_rod(piece, x[6])))
            if off and off == before:  # the second iterate off the same end of the rod
                return StepFailure("edge", off)
        return StepFailure("not_converged")

    def _solved(self, piece: SurfacePiece, x: Array, guess: Array) -> Equilibrium:
        """Solve the rod under the force and couple of the unknowns."""
        length, unit = self._units
        force, s = unit * x[0:3], length * on_rod(piece, x[6])
        if piece.at_tip:
            return self.rod.solve(
                self.gravity, force, s, couple=unit * length * x[3:6], mode=self.mode,
                guess=guess, guess_only=True, columns="contact",
            )  # fmt: skip
        return self.rod.solve(self.gravity, force, s, mode=self.mode, guess=guess, guess_only=True, columns="load")

    def _linearised(self, piece: SurfacePiece, x: Array, eq: Equilibrium, part: float) -> _Linear:
        """Linearise the piece's equations with the rod's sensitivity to the load."""
        assert eq.sensitivity is not None
        length, force = self._units
        lengths = np.repeat([1.0, 1.0, 1.0 / length, 1.0], 3)
        loads = np.array([force] * 3 + [length] + [force * length] * 3)
        d = eq.sensitivity.d_contact
        columns = lengths[:, None] * d * loads[: d.shape[1]]
        frame_by_unknowns = np.zeros((12, UNKNOWNS))
        frame_by_unknowns[:, 0:3], frame_by_unknowns[:, 6] = (columns[:, 0:3], columns[:, 3] * _rate(piece, x[6]))
        if d.shape[1] == 7:
            frame_by_unknowns[:, 3:6] = columns[:, 4:7]
        return self._linear(piece, lengths * eq.sensitivity.frame, frame_by_unknowns, part, x)

    def _linear(self, piece: SurfacePiece, frame: Array, frame_by_unknowns: Array, part: float, x: Array) -> _Linear:
        inputs = np.concatenate([x, frame, self.obstacle.at(part) / self.rod.length])
        return _Linear(piece, self.obstacle.direction, inputs, frame_by_unknowns)

    def _fits(self, misfit: Array, x: Array) -> bool:
        """Return whether the residuals of lengths and forces are within tolerance."""
        close = _CLOSE[self.mode]
        of_force = close * max(float(np.linalg.norm(x[0:3])), MIN_FORCE)
        allowed = np.array([close] * 2 + [of_force] * 5 + [close])
        return bool((np.abs(misfit) <= allowed).all())

    @cached_property
    def _units(self) -> tuple[float, float]:
        """Return the length [m] and the force [N] that bends a bar of the base's diameter by about 1 rad."""
        stiffness = self.rod.youngs_modulus * math.pi / 4.0 * float(self.rod.radius[0]) ** 4
        return self.rod.length, stiffness / self.rod.length**2


def on_rod(piece: SurfacePiece, place: float) -> float:
    """Return the arclength where the force acts, in rod lengths, clipped to the rod."""
    return min(max(_station(piece, place), 0.0), 1.0)


def solved(matrix: Array, right: Array) -> Array:
    """Solve linear equations; return the solution of least norm where they are singular."""
    try:
        solution = np.linalg.solve(matrix, right)
    except np.linalg.LinAlgError:
        solution = np.linalg.lstsq(matrix, right, rcond=1e-10)[0]
    return np.asarray(solution, dtype=float)


def _station(piece: SurfacePiece, place: float) -> float:
    return float(piece.station(np.array([place]))[0])


def _rate(piece: SurfacePiece, place: float) -> float:
    """Return the derivative of the station by the place."""
    step: Numbers = np.array([place + 1j * _IMAGINARY])
    return float(piece.station(step).imag[0] / _IMAGINARY)
