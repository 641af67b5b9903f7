"""One touch of a rod and an object, solved by Newton's method with exact derivatives."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from probedesign.frames import Array
from probedesign.rod.approach import Obstacle
from probedesign.rod.equilibrium import Equilibrium, Sensitivity
from probedesign.rod.rod import Mode, Rod
from probedesign.rod.surface import UNKNOWNS, Numbers, Piece, State

LEAST_FORCE = 1e-6
"""Without dimension; below it, forces are held to an absolute misfit."""
_CLOSE = {"fast": 1e-8, "reference": 1e-12}  # misfit: of the length, of the force; fast rods jitter by less
_MAX_ITERATIONS = 12
_ABSURD = 1e6  # of an unknown without dimension
_IMAGINARY = 1e-30
_REAL = 1e-6  # imaginary part that rounding may leave of a double mode, relative


class Failure(NamedTuple):
    """Why there is no touch near the last one.

    Attributes:
        reason: "not_converged" or "unstable", the rod or the touch; "pulls": the object would have to hold
            the rod; "slips": it would not stay; "far": it is not the last one's continuation; "edge": it
            leaves its piece of the surface and finds no hold on the next.
        ahead: for "edge", towards the tip 1, towards the base -1.
    """

    reason: str
    ahead: int = 0


@dataclass(frozen=True)
class Touch:
    """One touch, solved.

    Attributes:
        index, piece: of the surface.
        part: of the object's way.
        x: unknowns, without dimension, (8,).
        obstacle: the object.
        equilibrium: the rod under it.
        state: of the surface's equations.
        rates: of the unknowns by the object's position, without dimension, (8, 3).
        stays: whether the touch stays by itself.
        units: length [m] and force [N] of what has no dimension.
    """

    index: int
    piece: Piece
    part: float
    x: Array
    obstacle: Obstacle
    equilibrium: Equilibrium
    state: State
    rates: Array
    stays: bool
    units: tuple[float, float]

    @property
    def sensitivity(self) -> Sensitivity:
        """Of the equilibrium."""
        assert self.equilibrium.sensitivity is not None, "every solved touch has it"
        return self.equilibrium.sensitivity

    @property
    def presses(self) -> bool:
        """Whether there is a force at all: at first there is none."""
        return bool(self.x[0:3].any())

    @property
    def force(self) -> Array:
        """[N], (3,)."""
        return np.asarray(self.x[0:3] * self.units[1])

    @property
    def couple(self) -> Array:
        """[N·m], (3,)."""
        return np.asarray(self.x[3:6] * self.units[0] * self.units[1])

    @property
    def s_contact(self) -> float:
        """[m]."""
        return on_rod(self.piece, float(self.x[6])) * self.units[0]

    @property
    def s_surface(self) -> float:
        """[m]."""
        return self.piece.surface(float(self.x[6])) * self.units[0]

    @property
    def point(self) -> Array:
        """Where the object touches [m], (3,)."""
        point = self.obstacle.at(self.part)
        if self.obstacle.direction is None:
            return point
        return point + float(self.x[7]) * self.units[0] * self.obstacle.direction

    @property
    def angle(self) -> float:
        """Of the push about the tangent [rad]."""
        w = self.state.w[:, 0]
        return math.atan2(-float(w @ self.state.y[:, 0]), -float(w @ self.state.x[:, 0]))

    @property
    def normal(self) -> Array:
        """Outward normal, (3,), unit: of the surface, at the rim against the force."""
        if self.piece.where == "rim" and self.presses:
            return -self.x[0:3] / float(np.linalg.norm(self.x[0:3]))
        w: Array = self.state.t[:, 0] if self.piece.where == "face" else self.state.w[:, 0]
        return np.asarray(w / max(float(np.linalg.norm(w)), 1e-300))

    @property
    def d_point(self) -> Array:
        """Of the touched point by the object's position, (3, 3)."""
        if self.obstacle.direction is None:
            return np.eye(3)
        return np.eye(3) + np.outer(self.obstacle.direction, self.rates[7])

    @cached_property
    def d_load(self) -> Array:
        """Of [force, s_contact, couple] by the object's position [N/m, 1, N], (7, 3)."""
        length, force = self.units
        station = _rate(self.piece, self.x[6]) * self.rates[6]
        return np.vstack([self.rates[0:3] * force / length, station, self.rates[3:6] * force])

    @property
    def d_along(self) -> Array:
        """Of the unknowns along the object's way, for one rod's length of it, (8,)."""
        way: Array = self.rates @ self.obstacle.travel / np.linalg.norm(self.obstacle.travel)
        return way


@dataclass(frozen=True)
class _Linear:
    """A piece's equations at a guess and their derivatives.

    Attributes:
        piece: of the surface.
        direction: of the line, if it is one.
        inputs: what the equations depend on: [8 unknowns, 12 of the frame, 3 of the point].
        answer: of the frame by the unknowns, (12, 8).
    """

    piece: Piece
    direction: Array | None
    inputs: Array
    answer: Array

    @property
    def misfit(self) -> Array:
        """Of the equations, (8,)."""
        return self._derived[0]

    @cached_property
    def by_unknowns(self) -> Array:
        """(8, 8)."""
        d = self._derived[1]
        return d[:, :8] + d[:, 8:20] @ self.answer

    @property
    def by_point(self) -> Array:
        """(8, 3)."""
        return self._derived[1][:, 20:23]

    @property
    def state(self) -> State:
        """At the guess."""
        return State.of(self.inputs[:, None], self.direction, self.piece.beyond)

    def stays(self) -> bool:
        """Whether the energy has a minimum here.

        Under a force that is held the rod is stable, or it would not have been found. What is left out there
        is how the force turns as the rod moves on the object, in proportion to the force. Let that grow from
        nothing to what it is: the Jacobian passes through a singular one for each way in which the rod gives.
        """
        held = self._held
        modes = np.linalg.eigvals(solved(held, held - self.by_unknowns))
        real = np.abs(modes.imag) <= _REAL * np.abs(modes)
        return not bool((modes.real[real] > 1.0).any())

    @property
    def _held(self) -> Array:
        """`by_unknowns` as though the force did not turn with the surface, (8, 8)."""
        inputs = self.inputs.copy()
        inputs[0:3] = 0.0
        d = self._derivatives(inputs)[1]
        d[:, 6] = self._derived[1][:, 6]  # at an edge the place stands for how the force leans,
        if self.piece.where == "face":  # and along a flush line the way is where the force acts
            d[:, 7] = self._derived[1][:, 7]
        return d[:, :8] + d[:, 8:20] @ self.answer

    @cached_property
    def _derived(self) -> tuple[Array, Array]:
        return self._derivatives(self.inputs)

    def _derivatives(self, inputs: Array) -> tuple[Array, Array]:
        """Equations (8,) and what they are by each input (8, 23), by complex steps."""
        steps: Numbers = inputs[:, None] + 1j * _IMAGINARY * np.eye(len(inputs))
        state = State.of(steps, self.direction, self.piece.beyond)
        found = self.piece.equations(state, self.direction)
        return found[:, 0].real, found.imag / _IMAGINARY


@dataclass(frozen=True)
class Toucher:
    """Finds a rod's touches with an object.

    Attributes:
        rod: the rod.
        gravity: in base axes [m/s²], (3,).
        obstacle: the object.
        pieces: of the rod's surface.
        mode: "fast" or "reference".
    """

    rod: Rod
    gravity: Array
    obstacle: Obstacle
    pieces: list[Piece]
    mode: Mode

    def begun(self, free: Equilibrium, index: int, part: float, x: Array) -> Touch:
        """A touch that does not press yet: the free rod, the object at its surface, unknowns `x` (8,)."""
        piece = self.pieces[index]
        s = self.rod.length * on_rod(piece, x[6])
        R = free.R_at(s)
        frame = np.concatenate([R[:, 2], R[:, 0], free.p_at(s) / self.rod.length, R[:, 1]])
        linear = self._linear(piece, frame, np.zeros((12, UNKNOWNS)), part, x)
        still = np.zeros((UNKNOWNS, 3))
        return Touch(index, piece, part, x, self.obstacle, free, linear.state, still, True, self._units)

    def solve(self, index: int, part: float, x: Array, guess: Array) -> Touch | Failure:
        """The touch on one piece.

        Args:
            index: of the piece.
            part: of the object's way.
            x: unknowns to start from, (8,).
            guess: `tip` of a neighbouring equilibrium, (6,).

        Returns:
            The touch, which may lie beyond the ends of its piece, or why there is none.
        """
        piece, off = self.pieces[index], 0
        for _ in range(_MAX_ITERATIONS):
            eq = self._solved(piece, x, guess)
            if not eq.ok:
                return Failure(eq.result)
            linear = self._linearised(piece, x, eq, part)
            if self._fits(linear.misfit, x):
                rates = -solved(linear.by_unknowns, linear.by_point)
                stays = linear.stays()
                return Touch(
                    index, piece, part, x, self.obstacle, eq, linear.state, rates, stays, self._units
                )
            x, guess, before = x - solved(linear.by_unknowns, linear.misfit), eq.tip, off
            if not np.abs(x).max() < _ABSURD:
                break
            off = int(np.sign(_station(piece, x[6]) - on_rod(piece, x[6])))
            if off and off == before:  # a second time off the rod's end
                return Failure("edge", off)
        return Failure("not_converged")

    def _solved(self, piece: Piece, x: Array, guess: Array) -> Equilibrium:
        """The rod under the force and couple of the unknowns."""
        length, unit = self._units
        force, s = unit * x[0:3], length * on_rod(piece, x[6])
        if piece.at_tip:
            return self.rod.solve(
                self.gravity, force, s, couple=unit * length * x[3:6], mode=self.mode,
                guess=guess, guess_only=True, columns="contact",
            )  # fmt: skip
        return self.rod.solve(
            self.gravity, force, s, mode=self.mode, guess=guess, guess_only=True, columns="load"
        )

    def _linearised(self, piece: Piece, x: Array, eq: Equilibrium, part: float) -> _Linear:
        """The piece's equations with the rod's answer to the load."""
        assert eq.sensitivity is not None
        length, force = self._units
        lengths = np.repeat([1.0, 1.0, 1.0 / length, 1.0], 3)
        loads = np.array([force] * 3 + [length] + [force * length] * 3)
        d = eq.sensitivity.d_contact
        columns = lengths[:, None] * d * loads[: d.shape[1]]
        answer = np.zeros((12, UNKNOWNS))
        answer[:, 0:3], answer[:, 6] = columns[:, 0:3], columns[:, 3] * _rate(piece, x[6])
        if d.shape[1] == 7:
            answer[:, 3:6] = columns[:, 4:7]
        return self._linear(piece, lengths * eq.sensitivity.frame, answer, part, x)

    def _linear(self, piece: Piece, frame: Array, answer: Array, part: float, x: Array) -> _Linear:
        inputs = np.concatenate([x, frame, self.obstacle.at(part) / self.rod.length])
        return _Linear(piece, self.obstacle.direction, inputs, answer)

    def _fits(self, misfit: Array, x: Array) -> bool:
        """Whether lengths and forces are met."""
        close = _CLOSE[self.mode]
        of_force = close * max(float(np.linalg.norm(x[0:3])), LEAST_FORCE)
        allowed = np.array([close] * 2 + [of_force] * 5 + [close])
        return bool((np.abs(misfit) <= allowed).all())

    @cached_property
    def _units(self) -> tuple[float, float]:
        """The length, and the force that turns a bar as thick as the base by about 1 rad."""
        stiffness = self.rod.youngs_modulus * math.pi / 4.0 * float(self.rod.radius[0]) ** 4
        return self.rod.length, stiffness / self.rod.length**2


def on_rod(piece: Piece, place: float) -> float:
    """Where the force is put at a place, without dimension, held to the rod."""
    return min(max(_station(piece, place), 0.0), 1.0)


def solved(matrix: Array, right: Array) -> Array:
    """Of linear equations; the shortest answer where they leave something open."""
    try:
        answer = np.linalg.solve(matrix, right)
    except np.linalg.LinAlgError:
        answer = np.linalg.lstsq(matrix, right, rcond=1e-10)[0]
    return np.asarray(answer, dtype=float)


def _station(piece: Piece, place: float) -> float:
    return float(piece.station(np.array([place]))[0])


def _rate(piece: Piece, place: float) -> float:
    """Of the station by the place."""
    step: Numbers = np.array([place + 1j * _IMAGINARY])
    return float(piece.station(step).imag[0] / _IMAGINARY)
