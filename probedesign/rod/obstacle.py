"""The rod pressed against a fixed object: where the object is is given, what it does to the rod is found."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from probedesign.errors import InputError
from probedesign.frames import Array
from probedesign.rod.approach import FreeRod, Obstacle
from probedesign.rod.equilibrium import Equilibrium, Sensitivity
from probedesign.rod.pressing import Pressing
from probedesign.rod.rod import Mode, Rod
from probedesign.rod.touch import Touch

_FARTHEST = 1e6  # of the length: beyond, the way's own digits run out


@dataclass(frozen=True)
class Press:
    """What a fixed object does to the rod that has come against it.

    Attributes:
        result: "ok"; "no_contact"; "unstable": on the way the rod gave way, it slips past the object or
            round it, or would if the force did not turn with it; "not_converged": no equilibrium was found,
            also where the clamp itself is hit.
        way_touched: after which length of its way the object first touches [m]; NaN if it never does.
        way_followed: up to which length of its way the contact was followed [m]; NaN if there was none.
            With "no_contact" the object came off the rod there.
        equilibrium: the rod as it is now with "ok", and free of contact with "no_contact".
        touch: the contact in the solver's own units, with "ok".
    """

    result: str
    way_touched: float
    way_followed: float
    equilibrium: Equilibrium
    touch: Touch | None

    @property
    def lost(self) -> bool:
        """Whether there was a contact on the way, from which the object came off."""
        return self.result == "no_contact" and not math.isnan(self.way_touched)

    @property
    def where(self) -> str:
        """What is touched: "flank", "rim" of the blunt tip or its "face"; "" if nothing."""
        return self.touch.piece.where if self.touch else ""

    @property
    def s_contact(self) -> float:
        """Arclength at which the force is put on the centreline [m]: where its line meets the axis; the tip's
        for its rim and face."""
        return self.touch.s_contact if self.touch else math.nan

    @property
    def s_surface(self) -> float:
        """Arclength of the touched section [m]."""
        return self.touch.s_surface if self.touch else math.nan

    @property
    def angle(self) -> float:
        """φ of the push about the tangent, from the section's x axis [rad]: the object lies at φ + π."""
        return self.touch.angle if self.touch else math.nan

    @property
    def magnitude(self) -> float:
        """f [N]."""
        return float(np.linalg.norm(self.force_base))

    @property
    def force_base(self) -> Array:
        """What the object does to the rod [N], (3,)."""
        return self.touch.force if self.touch else np.full(3, np.nan)

    @property
    def couple_base(self) -> Array:
        """Of that force about the centreline at s_contact [N·m], (3,); zero on the flank."""
        return self.touch.couple if self.touch else np.full(3, np.nan)

    @property
    def p_surface_base(self) -> Array:
        """The touched point, which is the object's own [m], (3,)."""
        return self.touch.point if self.touch else np.full(3, np.nan)

    @property
    def sensitivity(self) -> Sensitivity:
        """Of the equilibrium, by force, s_contact and couple."""
        assert self.touch is not None, "asked of a press without an answer"
        return self.touch.sensitivity

    @property
    def d_force(self) -> Array:
        """Of the force by the object's position [N/m], (3, 3)."""
        return self._d_load[0:3]

    @property
    def d_s_contact(self) -> Array:
        """Of s_contact by the object's position, (3,)."""
        column: Array = self._d_load[3]
        return column

    @property
    def d_couple(self) -> Array:
        """Of the couple by the object's position [N], (3, 3)."""
        return self._d_load[4:7]

    @property
    def d_surface(self) -> Array:
        """Of the touched point by the object's position, (3, 3): the identity for a point."""
        return self.touch.d_point if self.touch else np.full((3, 3), np.nan)

    @cached_property
    def d_wrench(self) -> Array:
        """Of the base wrench by the object's position [N/m, N], (6, 3).

        A base that moves by v in its own axes, without turning, moves the object by -v.
        """
        columns = self.sensitivity.d_wrench
        return columns @ self._d_load[: columns.shape[1]]

    @cached_property
    def d_position(self) -> Array:
        """Of the centreline's point at s_contact by the object's position, (3, 3)."""
        columns = self.sensitivity.d_position
        return columns @ self._d_load[: columns.shape[1]]

    @property
    def _d_load(self) -> Array:
        """Of [force, s_contact, couple] by the object's position, (7, 3)."""
        return self.touch.d_load if self.touch else np.full((7, 3), np.nan)


def press_against_point(
    rod: Rod,
    gravity: ArrayLike,
    point: ArrayLike,
    travel: ArrayLike,
    mode: Mode = "fast",
    judged: bool = True,
) -> Press:
    """Equilibrium of the rod against a sharp point in space that it cannot stick to.

    The point has come along a straight path, which tells from which side it presses: where it ends, far
    past the rod's axis, does not. From the first touch on the contact is followed by Newton's method, over
    the flank, the edges of a profile, the rim of the blunt tip and its face. Without friction a round rod
    stays on a sharp point only until it is pushed aside by about its own radius; then it slips round it,
    to either side if pressed squarely.

    Args:
        rod: the rod; its section must be round.
        gravity: in base axes [m/s²], (3,).
        point: where the object is now, in base axes [m], (3,).
        travel: the way it has come relative to the base; at point - travel it touches nothing [m], (3,).
        mode: "fast" or "reference".
        judged: False follows the contact also where it would not stay by itself and the rod would slip
            round the point: as if something kept it from doing so.

    Returns:
        The press; numbers of the contact come only with result "ok".

    Raises:
        InputError: an argument is not finite or far out, the path starts in the rod, or its section is not
            round.
    """
    return _press(
        rod, gravity, Obstacle(_vector("point", point), _vector("travel", travel), None), mode, judged
    )


def press_against_line(
    rod: Rod,
    gravity: ArrayLike,
    point: ArrayLike,
    direction: ArrayLike,
    travel: ArrayLike,
    mode: Mode = "fast",
    judged: bool = True,
) -> Press:
    """Equilibrium of the rod against a straight edge, infinitely long, that it cannot stick to.

    As `press_against_point`; the rod may slide along the edge, and the force is normal to both.

    Args:
        rod: the rod; its section must be round.
        gravity: in base axes [m/s²], (3,).
        point: of the edge, in base axes [m], (3,).
        direction: of the edge, of any length, (3,).
        travel: the way it has come relative to the base; before it the edge touches nothing [m], (3,).
        mode: "fast" or "reference".
        judged: False follows the contact also where it would not stay by itself.

    Returns:
        The press; numbers of the contact come only with result "ok".

    Raises:
        InputError: an argument is not finite or far out, the direction is zero, the path starts in the rod,
            or its section is not round.
    """
    along = _vector("direction", direction)
    norm = float(np.linalg.norm(along))
    if not norm > 0.0:
        raise InputError(f"direction = {direction!r} must not be zero")
    obstacle = Obstacle(_vector("point", point), _vector("travel", travel), along / norm)
    return _press(rod, gravity, obstacle, mode, judged)


def _press(rod: Rod, gravity: ArrayLike, obstacle: Obstacle, mode: Mode, judged: bool) -> Press:
    """First touch with the free rod, then the contact from there on."""
    if not np.allclose(rod.factors[1:], rod.factors[1], rtol=1e-9):
        raise InputError("only a rod of round section has the surface that is pressed here")
    for name, vector in (("point", obstacle.point), ("travel", obstacle.travel)):
        if not np.abs(vector).max() <= _FARTHEST * rod.length:
            raise InputError(f"{name} = {vector.tolist()} lies a million lengths away")
    free = rod.solve(gravity, mode=mode)
    if not free.ok:
        return Press(free.result, math.nan, math.nan, free, None)
    way = float(np.linalg.norm(obstacle.travel))
    first = FreeRod(rod, free).first_touch(obstacle)
    if first is None:
        return Press("no_contact", math.nan, math.nan, free, None)
    if first[0] == 0.0:
        raise InputError("the path must start clear of the rod: travel further, or in the other direction")
    pressing = Pressing(rod, np.asarray(gravity, dtype=float), obstacle, mode, judged)
    followed = pressing.follow(free, *first)
    touch = followed.touch if followed.result == "ok" else None
    eq = touch.equilibrium if touch else free
    return Press(followed.result, followed.touched * way, followed.reached * way, eq, touch)


def _vector(name: str, value: ArrayLike) -> Array:
    try:
        vector = np.array(value, dtype=float)
    except (TypeError, ValueError):
        vector = np.empty(0)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise InputError(f"{name} = {value!r} must be three finite numbers")
    return vector
