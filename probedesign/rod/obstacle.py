"""Press the rod against a fixed object without friction: the object's path is given, the contact force is found.

The first contact on the path is found on the free rod (`first_contact`). From there the contact is followed by
Newton's method in steps of the object's path (`ContactContinuation`), over the pieces of the rod's surface (`surface`);
`contact_solver` solves each step.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.rod.contact_solver import MIN_FORCE, ContactSolver, SolvedContact, StepFailure
from probedesign.rod.equilibrium import Equilibrium, Sensitivity
from probedesign.rod.rod import Mode, Rod, finite_vector, require_round_section
from probedesign.rod.surface import (
    UNKNOWNS,
    Edge,
    FirstContactQuery,
    NearestPoint,
    Obstacle,
    Rim,
    SurfacePiece,
    surface_pieces,
)

_MAX_DISTANCE = 1e6  # rod lengths: beyond, rounding of the path exceeds the tolerance


@dataclass(frozen=True)
class ObstacleContact:
    """Contact of the rod with a fixed object."""

    #: "ok"; "no_contact"; "unstable": on the path the rod buckled, it slips past the object or around it, or would if
    #: the force kept its direction; "not_converged": no equilibrium was found, also where the object meets the clamp.
    result: str
    way_touched: float  #: length of the path at the first contact [m]; NaN without one.
    #: length of the path up to which the contact was followed [m]; NaN without one. With "no_contact" the object left
    #: the rod there.
    way_followed: float
    equilibrium: Equilibrium  #: of the rod under the contact with "ok", and of the free rod with "no_contact".
    touch: SolvedContact | None  #: the solved contact, without dimension, with "ok"; else None.

    @property
    def lost(self) -> bool:
        """Return whether there was a contact on the path that the object has left."""
        return self.result == "no_contact" and not math.isnan(self.way_touched)

    @property
    def where(self) -> str:
        """Return what is touched: "flank", "rim" of the blunt tip or its "face"; "" without contact."""
        return self.touch.piece.where if self.touch else ""

    @property
    def s_contact(self) -> float:
        """Return the arclength where the force acts on the centreline [m].

        It is where the force's line of action meets the axis, and the tip for its rim and face.
        """
        return self.touch.s_contact if self.touch else math.nan

    @property
    def s_surface(self) -> float:
        """Return the arclength of the touched section [m]."""
        return self.touch.s_surface if self.touch else math.nan

    @property
    def angle(self) -> float:
        """Return φ of the force about the tangent, from the section's x axis [rad]; the object is at φ + π."""
        return self.touch.angle if self.touch else math.nan

    @property
    def magnitude(self) -> float:
        """Return the magnitude of the force [N]."""
        return float(np.linalg.norm(self.force_base))

    @property
    def force_base(self) -> Array:
        """Return the force of the object on the rod [N], (3,)."""
        return self.touch.force if self.touch else np.full(3, np.nan)

    @property
    def couple_base(self) -> Array:
        """Return the moment of that force about the centreline at s_contact [N·m], (3,); zero on the flank."""
        return self.touch.couple if self.touch else np.full(3, np.nan)

    @property
    def p_surface_base(self) -> Array:
        """Return the touched point, a point of the object [m], (3,)."""
        return self.touch.point if self.touch else np.full(3, np.nan)

    @property
    def sensitivity(self) -> Sensitivity:
        """Return the sensitivity of the equilibrium to force, s_contact and couple."""
        assert self.touch is not None, "a contact whose result is not ok has no sensitivity"
        return self.touch.sensitivity

    @property
    def d_force(self) -> Array:
        """Return the derivative of the force by the object's position [N/m], (3, 3)."""
        return self._d_load[0:3]

    @cached_property
    def d_wrench(self) -> Array:
        """Return the derivative of the base wrench by the object's position [N/m, N], (6, 3).

        A base that moves by v in its own axes, without turning, moves the object by -v.
        """
        columns = self.sensitivity.d_wrench
        return columns @ self._d_load[: columns.shape[1]]

    @cached_property
    def d_position(self) -> Array:
        """Return the derivative of the centreline's point at s_contact by the object's position, (3, 3)."""
        columns = self.sensitivity.d_position
        return columns @ self._d_load[: columns.shape[1]]

    @property
    def _d_load(self) -> Array:
        """Return the derivative of [force, s_contact, couple] by the object's position, (7, 3)."""
        return self.touch.d_load if self.touch else np.full((7, 3), np.nan)


def press_against_point(
    rod: Rod, gravity: ArrayLike, point: ArrayLike, travel: ArrayLike, mode: Mode = "fast", judged: bool = True
) -> ObstacleContact:
    """Solve for the equilibrium of the rod against a sharp point, without friction.

    The point moves along a straight path, which determines the side from which it presses. From the first contact on,
    Newton's method follows it over the flank, the edges of a profile, the rim of the blunt tip and its face. Without
    friction a round rod remains on a sharp point only until it is displaced by about its own radius; then it slips
    around the point, to either side if pressed centrally.

    Args:
        rod: the rod; its section must be round.
        gravity: in base axes [m/s²], (3,).
        point: where the object is now, in base axes [m], (3,).
        travel: displacement of the object relative to the base up to now; at point - travel it is clear of the rod
            [m], (3,).
        mode: "fast" or "reference".
        judged: False follows the contact also where it is unstable and the rod would slip around the point.

    Returns:
        The contact; its numbers are finite only with result "ok".

    Raises:
        InputError: an argument is not finite or far out, the path starts in the rod, or its section is not
            round.
    """
    obstacle = Obstacle(finite_vector("point", point), finite_vector("travel", travel), None)
    return _press(rod, gravity, obstacle, mode, judged)


def press_against_line(
    rod: Rod,
    gravity: ArrayLike,
    point: ArrayLike,
    direction: ArrayLike,
    travel: ArrayLike,
    mode: Mode = "fast",
    judged: bool = True,
) -> ObstacleContact:
    """Solve for the equilibrium of the rod against a straight, infinitely long edge, without friction.

    See `press_against_point`. The rod may slide along the edge, and the force is normal to both.

    Args:
        rod: the rod; its section must be round.
        gravity: in base axes [m/s²], (3,).
        point: of the edge, in base axes [m], (3,).
        direction: of the edge, of any length, (3,).
        travel: displacement of the edge relative to the base up to now; before it the edge is clear of the rod
            [m], (3,).
        mode: "fast" or "reference".
        judged: False follows the contact also where it is unstable.

    Returns:
        The contact; its numbers are finite only with result "ok".

    Raises:
        InputError: an argument is not finite or far out, the direction is zero, the path starts in the rod,
            or its section is not round.
    """
    along = finite_vector("direction", direction)
    norm = float(np.linalg.norm(along))
    if not norm > 0.0:
        raise InputError(f"direction = {direction!r} must not be zero")
    obstacle = Obstacle(finite_vector("point", point), finite_vector("travel", travel), along / norm)
    return _press(rod, gravity, obstacle, mode, judged)


def _press(rod: Rod, gravity: ArrayLike, obstacle: Obstacle, mode: Mode, judged: bool) -> ObstacleContact:
    """Find the first contact with the free rod and follow it to the end of the path."""
    require_round_section(rod)
    for name, vector in (("point", obstacle.point), ("travel", obstacle.travel)):
        if not np.abs(vector).max() <= _MAX_DISTANCE * rod.length:
            raise InputError(f"{name} = {vector.tolist()} is more than a million lengths away")
    free = rod.solve(gravity, mode=mode)
    if not free.ok:
        return ObstacleContact(free.result, math.nan, math.nan, free, None)
    way = float(np.linalg.norm(obstacle.travel))
    first = FirstContactQuery(rod, free).first_contact(obstacle)
    if first is None:
        return ObstacleContact("no_contact", math.nan, math.nan, free, None)
    if first[0] == 0.0:
        raise InputError("the path must start clear of the rod; use a longer travel or the opposite direction")
    continuation = ContactContinuation(rod, np.asarray(gravity, dtype=float), obstacle, mode, judged)
    followed = continuation.follow(free, *first)
    touch = followed.touch if followed.result == "ok" else None
    eq = touch.equilibrium if touch else free
    return ObstacleContact(followed.result, followed.touched * way, followed.reached * way, eq, touch)


_MAX_TRIES = 300  # steps and refused steps of one path
_MIN_STEP = 1e-7  # rod lengths: a contact that fails there has reached a fold
_FIRST_STEP = 0.02  # rod lengths
_MAX_TURN = 0.2  # rotation of the tip and of the normal in one step [rad]: stays on the branch
_MAX_SLIDE = 0.02  # of the contact from its prediction, rod lengths
_NEARBY = 2e-5  # rod lengths: accuracy of the first contact
_MAX_SLIDE_RATE = 10.0  # velocity of the contact over that of the object, above which it runs into a fold


class ContinuationResult(NamedTuple):
    """Result of following a contact along the object's path."""

    result: str  #: "ok", "no_contact", "unstable" or "not_converged".
    touched: float  #: touched, reached: fraction of the path at the first contact and up to which it was followed.
    reached: float
    touch: SolvedContact  #: the last contact.


@dataclass(frozen=True)
class ContactContinuation:
    """Follows the contact of a rod with an object along the object's path."""

    rod: Rod  #: the rod.
    gravity: Array  #: in base axes [m/s²], (3,).
    obstacle: Obstacle  #: the object.
    mode: Mode  #: "fast" or "reference".
    judged: bool  #: whether an unstable contact ends the path.

    def follow(self, free: Equilibrium, part: float, near: NearestPoint) -> ContinuationResult:
        """Follow the contact from its beginning on the free rod to the end of the path."""
        for index in self._candidates(near):
            followed = self._followed(self._begun(free, index, part, near))
            if followed.touch.presses:
                break
        return followed

    def _followed(self, touch: SolvedContact) -> ContinuationResult:
        """Follow a contact that carries no force yet."""
        scale = self.rod.length / float(np.linalg.norm(self.obstacle.travel))
        begun, step = touch.part, _FIRST_STEP * scale
        for _ in range(_MAX_TRIES):
            if touch.part >= 1.0:
                return ContinuationResult("ok", begun, 1.0, touch)
            goal = min(1.0, touch.part + step)
            found = self._next(touch, goal)
            if isinstance(found, StepFailure) and step < _MIN_STEP * scale:
                jumped = self._over_edge(touch, goal, found)
                if isinstance(jumped, StepFailure):
                    return ContinuationResult(self._ending(touch, found), begun, touch.part, touch)
                found = jumped
            if isinstance(found, StepFailure):
                step = 0.3 * (goal - touch.part)
            else:
                step, touch = 2.0 * (goal - touch.part), found
        return ContinuationResult("not_converged", begun, touch.part, touch)

    def _candidates(self, near: NearestPoint) -> list[int]:
        """Return the indices of pieces on which the contact may begin, the most likely first.

        On a straight path points meet faces and flanks first, lines meet edges first.
        """
        reach = [(p.surface(p.entry(True)) - _NEARBY, p.surface(p.entry(False)) + _NEARBY) for p in self._pieces]
        s = max(near.s / self.rod.length, reach[0][0])  # the clamp covers what is below
        close = [i for i, (low, high) in enumerate(reach) if low <= s <= high]
        face = len(self._pieces) - 1
        if near.on_end:
            close = [face - 1, face]
        elif face in close:
            close.remove(face)
        on_corner = self.obstacle.direction is not None and not near.flush
        return sorted(close, key=lambda i: isinstance(self._pieces[i], Edge | Rim) != on_corner)

    def _begun(self, free: Equilibrium, index: int, part: float, near: NearestPoint) -> SolvedContact:
        """Return the contact without force at the start."""
        x = np.zeros(UNKNOWNS)
        if near.flush and self._pieces[index].where == "face":
            x[0:3] = -MIN_FORCE * free.tip_tangent  # without a force its place along the line is undetermined
        x[6] = self._place_at(self._pieces[index], near.s / self.rod.length)
        x[7] = near.way / self.rod.length
        return self._solver.begun(free, index, part, x)

    def _place_at(self, piece: SurfacePiece, s: float) -> float:
        """Return the coordinate on a piece of the surface at s, interpolated linearly between its ends."""
        low, high = piece.entry(True), piece.entry(False)
        first, last = piece.surface(low), piece.surface(high)
        return low + (high - low) * min(max((s - first) / max(last - first, 1e-300), 0.0), 1.0)

    def _next(self, last: SolvedContact, part: float) -> SolvedContact | StepFailure:
        """Solve one step, on the same piece or on an adjacent one."""
        index, x, left = last.index, self._predicted(last, part), list[int]()
        while True:
            found = self._solver.solve(index, part, x, last.equilibrium.tip)
            ahead = _leaving(found)
            if not ahead:
                return found if isinstance(found, StepFailure) else self._checked(last, found)
            left.append(index)
            index += ahead
            if index in left or not 0 <= index < len(self._pieces):
                return StepFailure("edge", ahead if len(left) == 1 else left[1] - left[0])
            x = self._moved(last, index, ahead > 0)

    def _checked(self, last: SolvedContact, found: SolvedContact) -> SolvedContact | StepFailure:
        """Return the contact if it continues the last one, else why not."""
        if not found.piece.pushes(found.state):
            return StepFailure("pulls")
        if self.judged and not found.stays:
            return StepFailure("slips")
        turn = _distance(found.equilibrium.tip_tangent, last.equilibrium.tip_tangent)
        if last.presses or last.piece.where != "rim":  # at the rim the normal is that of the force
            turn = max(turn, _distance(found.normal, last.normal))
        slide = 0.0
        if found.index == last.index and last.presses and not isinstance(found.piece, Edge):
            slide = abs(float(found.x[6] - self._predicted(last, found.part)[6]))
        return found if turn <= _MAX_TURN and slide <= _MAX_SLIDE else StepFailure("far")

    def _predicted(self, last: SolvedContact, part: float) -> Array:
        """Extrapolate the unknowns along the path, (8,)."""
        return last.x + (part - last.part) / self.rod.length * (last.rates @ self.obstacle.travel)

    def _moved(self, last: SolvedContact, index: int, from_before: bool) -> Array:
        """Return the last unknowns in the coordinates of another piece, (8,)."""
        x, piece = last.x.copy(), self._pieces[index]
        x[6] = piece.entry(from_before)
        if not piece.at_tip:
            x[3:6] = 0.0
        elif not last.piece.at_tip:
            arm = last.point - last.equilibrium.p_at(self.rod.length)
            x[3:6] = np.cross(arm / self.rod.length, x[0:3])
        return x

    def _over_edge(self, last: SolvedContact, part: float, failure: StepFailure) -> SolvedContact | StepFailure:
        """Solve the step across an edge that has no equilibrium, on the flank beyond it."""
        index = last.index + 2 * failure.ahead
        if failure.reason != "edge" or not 0 <= index < len(self._pieces) - 2:
            return failure
        x = self._moved(last, index, failure.ahead > 0)
        found = self._solver.solve(index, part, x, last.equilibrium.tip)
        if isinstance(found, StepFailure) or _leaving(found):
            return failure
        return self._checked(last, found)

    def _ending(self, last: SolvedContact, failure: StepFailure) -> str:
        """Return the result code where the contact ends.

        A regular contact continues, so one that fails at the smallest step has reached a fold. If it slides fast
        towards the tip there, the object slips off.
        """
        outermost = len(self._pieces) - 3  # of the flanks
        if failure.reason == "pulls":
            return "no_contact"
        if not last.presses or (failure.ahead < 0 and last.index == 0):
            return "not_converged"
        if failure.reason == "edge":
            off = last.index > outermost or (last.index == outermost and failure.ahead > 0)
        else:
            off = failure.reason in ("not_converged", "far") and float(last.d_along[6]) > _MAX_SLIDE_RATE
        return "no_contact" if off else "unstable"

    @cached_property
    def _pieces(self) -> list[SurfacePiece]:
        return surface_pieces(self.rod)

    @cached_property
    def _solver(self) -> ContactSolver:
        return ContactSolver(self.rod, self.gravity, self.obstacle, self._pieces, self.mode)


def _leaving(found: SolvedContact | StepFailure) -> int:
    """Return the side on which the contact leaves its piece: 1 the tip's, -1 the base's, 0 if it does not."""
    if isinstance(found, StepFailure):
        return found.ahead
    excess = found.piece.excess(found.state)
    return 0 if excess == 0.0 else (1 if excess > 0.0 else -1)


def _distance(a: Array, b: Array) -> float:
    return float(np.linalg.norm(a - b))
