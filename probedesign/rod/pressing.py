"""A touch without friction, followed as the object it is with moves on."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from probedesign.frames import Array
from probedesign.rod.approach import Nearest, Obstacle
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.rod import Mode, Rod
from probedesign.rod.surface import UNKNOWNS, Edge, Piece, Rim, pieces_of
from probedesign.rod.touch import LEAST_FORCE, Failure, Touch, Toucher

_MAX_TRIES = 300
_LEAST_STEP = 1e-7  # of the rod's length
_FIRST_STEP = 0.02  # likewise
_MAX_TURN = 0.2  # of the tip and of the normal in one step [rad]: keeps the branch
_MAX_SLIDE = 0.02  # of the place beside its prediction, of the length
_NEARBY = 2e-5  # of the length: so well is it known where the touch begins
_RUNS_AWAY = 10.0  # how much faster than the object the touch slides where it comes to a fold


class Followed(NamedTuple):
    """Where following a touch has led.

    Attributes:
        result: "ok", "no_contact", "unstable" or "not_converged".
        touched, reached: part of the object's way at which the touch began and up to which it was followed.
        touch: the last one.
    """

    result: str
    touched: float
    reached: float
    touch: Touch


@dataclass(frozen=True)
class Pressing:
    """A rod and the object that presses it.

    Attributes:
        rod: the rod.
        gravity: in base axes [m/s²], (3,).
        obstacle: the object.
        mode: "fast" or "reference".
        judged: whether a touch must stay by itself.
    """

    rod: Rod
    gravity: Array
    obstacle: Obstacle
    mode: Mode
    judged: bool

    def follow(self, free: Equilibrium, part: float, near: Nearest) -> Followed:
        """The touch from its beginning on the free rod to the end of the object's way."""
        for index in self._candidates(near):
            followed = self._followed(self._begun(free, index, part, near))
            if followed.touch.presses:
                break
        return followed

    def _followed(self, touch: Touch) -> Followed:
        """The touch from one that does not press yet."""
        scale = self.rod.length / float(np.linalg.norm(self.obstacle.travel))
        begun, step = touch.part, _FIRST_STEP * scale
        for _ in range(_MAX_TRIES):
            if touch.part >= 1.0:
                return Followed("ok", begun, 1.0, touch)
            goal = min(1.0, touch.part + step)
            found = self._next(touch, goal)
            if isinstance(found, Failure) and step < _LEAST_STEP * scale:
                jumped = self._over_edge(touch, goal, found)
                if isinstance(jumped, Failure):
                    return Followed(self._ending(touch, found), begun, touch.part, touch)
                found = jumped
            if isinstance(found, Failure):
                step = 0.3 * (goal - touch.part)
            else:
                step, touch = 2.0 * (goal - touch.part), found
        return Followed("not_converged", begun, touch.part, touch)

    def _candidates(self, near: Nearest) -> list[int]:
        """Pieces that the touch may begin on, the likeliest first.

        A straight path meets faces and flanks with a point, corners with a line.
        """
        reach = [
            (p.surface(p.entry(True)) - _NEARBY, p.surface(p.entry(False)) + _NEARBY) for p in self._pieces
        ]
        s = max(near.s / self.rod.length, reach[0][0])  # what lies below is the clamp's
        close = [i for i, (low, high) in enumerate(reach) if low <= s <= high]
        face = len(self._pieces) - 1
        if near.on_end:
            close = [face - 1, face]
        elif face in close:
            close.remove(face)
        on_corner = self.obstacle.direction is not None and not near.flush
        return sorted(close, key=lambda i: isinstance(self._pieces[i], Edge | Rim) != on_corner)

    def _begun(self, free: Equilibrium, index: int, part: float, near: Nearest) -> Touch:
        """The touch that does not press yet."""
        x = np.zeros(UNKNOWNS)
        if near.flush and self._pieces[index].where == "face":
            x[0:3] = -LEAST_FORCE * free.tip_tangent  # it takes a force to tell where along the line it acts
        x[6] = self._place_at(self._pieces[index], near.s / self.rod.length)
        x[7] = near.way / self.rod.length
        return self._toucher.begun(free, index, part, x)

    def _place_at(self, piece: Piece, s: float) -> float:
        """Where on a piece the surface is at s, straight between its ends."""
        low, high = piece.entry(True), piece.entry(False)
        first, last = piece.surface(low), piece.surface(high)
        return low + (high - low) * min(max((s - first) / max(last - first, 1e-300), 0.0), 1.0)

    def _next(self, last: Touch, part: float) -> Touch | Failure:
        """The touch a step further, on the same piece or on one beside it."""
        index, x, left = last.index, self._predicted(last, part), list[int]()
        while True:
            found = self._toucher.solve(index, part, x, last.equilibrium.tip)
            ahead = _leaving(found)
            if not ahead:
                return found if isinstance(found, Failure) else self._checked(last, found)
            left.append(index)
            index += ahead
            if index in left or not 0 <= index < len(self._pieces):
                return Failure("edge", ahead if len(left) == 1 else left[1] - left[0])
            x = self._moved(last, index, ahead > 0)

    def _checked(self, last: Touch, found: Touch) -> Touch | Failure:
        """The touch, if it goes on from the last one."""
        if not found.piece.pushes(found.state):
            return Failure("pulls")
        if self.judged and not found.stays:
            return Failure("slips")
        turn = _distance(found.equilibrium.tip_tangent, last.equilibrium.tip_tangent)
        if last.presses or last.piece.where != "rim":  # there, only a force shows where its normal is
            turn = max(turn, _distance(found.normal, last.normal))
        slide = 0.0
        if found.index == last.index and last.presses and not isinstance(found.piece, Edge):
            slide = abs(float(found.x[6] - self._predicted(last, found.part)[6]))
        return found if turn <= _MAX_TURN and slide <= _MAX_SLIDE else Failure("far")

    def _predicted(self, last: Touch, part: float) -> Array:
        """Unknowns on from the last ones along the object's way, (8,)."""
        return last.x + (part - last.part) / self.rod.length * (last.rates @ self.obstacle.travel)

    def _moved(self, last: Touch, index: int, from_before: bool) -> Array:
        """The last unknowns, told for another piece, (8,)."""
        x, piece = last.x.copy(), self._pieces[index]
        x[6] = piece.entry(from_before)
        if not piece.at_tip:
            x[3:6] = 0.0
        elif not last.piece.at_tip:
            arm = last.point - last.equilibrium.p_at(self.rod.length)
            x[3:6] = np.cross(arm / self.rod.length, x[0:3])
        return x

    def _over_edge(self, last: Touch, part: float, failure: Failure) -> Touch | Failure:
        """Over a ridge on which no normal holds the object, to the flank behind it."""
        index = last.index + 2 * failure.ahead
        if failure.reason != "edge" or not 0 <= index < len(self._pieces) - 2:
            return failure
        x = self._moved(last, index, failure.ahead > 0)
        found = self._toucher.solve(index, part, x, last.equilibrium.tip)
        if isinstance(found, Failure) or _leaving(found):
            return failure
        return self._checked(last, found)

    def _ending(self, last: Touch, failure: Failure) -> str:
        """Result where the touch goes no further.

        What is regular goes on, so a touch that cannot be carried on by the least step has come to a fold.
        If it was running away towards the tip there, the object slips off.
        """
        outermost = len(self._pieces) - 3  # of the flanks
        if failure.reason == "pulls":
            return "no_contact"
        if not last.presses or (failure.ahead < 0 and last.index == 0):
            return "not_converged"
        if failure.reason == "edge":
            off = last.index > outermost or (last.index == outermost and failure.ahead > 0)
        else:
            off = failure.reason in ("not_converged", "far") and float(last.d_along[6]) > _RUNS_AWAY
        return "no_contact" if off else "unstable"

    @cached_property
    def _pieces(self) -> list[Piece]:
        return pieces_of(self.rod)

    @cached_property
    def _toucher(self) -> Toucher:
        return Toucher(self.rod, self.gravity, self.obstacle, self._pieces, self.mode)


def _leaving(found: Touch | Failure) -> int:
    """To which side the touch leaves its piece: 1 towards the tip, -1 towards the base, 0 if it does not."""
    if isinstance(found, Failure):
        return found.ahead
    excess = found.piece.excess(found.state)
    return 0 if excess == 0.0 else (1 if excess > 0.0 else -1)


def _distance(a: Array, b: Array) -> float:
    return float(np.linalg.norm(a - b))
