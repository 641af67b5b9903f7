"""Touches of a rod's surface, grown from nothing in steps of the force: what a press from the free probe reaches."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from probedesign.estimation import surface_contact_kernel as kernel
from probedesign.estimation.error_sources import FINE, NOTHING
from probedesign.estimation.surface_contact_kernel import (
    ALONG,
    AROUND,
    BY_TOUCH,
    NORMAL,
    PHI,
    POINT,
    ROWS,
    TIP,
    TOUCH,
    TURN,
    UNKNOWNS,
    S,
)
from probedesign.frames import Array
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.rod import Rod

_MIN_STEP = 1e-3
"""Step of the force, over the force reached, below which a press is not divided any more: the probe gives way."""
_MAX_TURN = 0.3
"""Predicted turn of the tip in one step [rad]."""
_MAX_MISS = 0.15
"""Turn of the tip [rad] between what a step predicts and what it finds: a larger one has left the branch."""


@dataclass(frozen=True)
class SurfaceRod:
    """A rod under a gravity, whose surface is touched.

    Attributes:
        rod: the rod.
        gravity: base axes [m/s²], (3,).
        mass: of the flexible part [kg].
        free: the free rod under it.
    """

    rod: Rod
    gravity: Array
    mass: float
    free: Equilibrium

    def settled(self, touch: Array) -> Array | None:
        """Make the dead loads and the tip of a touch consistent, in place; its linearisation by the touch,
        (ROWS, 1 + UNKNOWNS), or None where the rod does not hold it."""
        lin = np.empty((ROWS, 1 + UNKNOWNS))
        work = np.empty(kernel.work_size(0))
        held = kernel.linearise_touch(self.rod.body, self.gravity, self.mass, FINE, touch, 0, work, lin)
        return lin if held else None

    def press(self, s: float, phi: float, ratios: tuple[float, float] = (0.0, 0.0)) -> "Press":
        """A press that has not begun, at a place of the surface.

        Args:
            s: arclength [m]; beyond the flank no touch acts, and it is taken at the flank's end.
            phi: angle around the section [rad].
            ratios: of friction, around and along.
        """
        touch = np.zeros(TOUCH)
        touch[S], touch[PHI], touch[NORMAL] = min(s, self.rod.flank_end), phi, NOTHING
        touch[AROUND], touch[ALONG] = ratios
        touch[TIP:] = self.free.tip
        return Press(self, touch, self.settled(touch) if self.free.ok else None)


class Press:
    """A press at one place of the surface, grown as far as it was asked for."""

    def __init__(self, on: SurfaceRod, touch: Array, lin: Array | None) -> None:
        """Args:
        on: the rod.
        touch: where it begins, settled, (TOUCH,); lin: its linearisation, None where there is none.
        """
        self.on, self.touch, self.lin = on, touch, lin

    @property
    def alive(self) -> bool:
        """Whether the rod has held it so far."""
        return self.lin is not None

    def to(self, force: float, ratios: tuple[float, float] | None = None) -> Array | None:
        """The touch (TOUCH,) under a greater normal force [N], or None where the rod gives way before it.

        Args:
            force: at least that of the last call.
            ratios: of friction at that force, reached evenly with it; those before if None.
        """
        target = self.touch[:UNKNOWNS].copy()
        target[NORMAL] = force
        if ratios is not None:
            target[AROUND], target[ALONG] = ratios
        while self.lin is not None:
            goal = target - self.touch[:UNKNOWNS]
            turn = self.lin[TURN : TURN + 3, BY_TOUCH : BY_TOUCH + UNKNOWNS] @ goal
            share = first = min(1.0, _MAX_TURN / max(float(np.linalg.norm(turn)), 1e-300))
            smallest = _MIN_STEP * max(first, self.force / max(abs(goal[NORMAL]), 1e-300))
            while not self._take(share * goal):
                share *= 0.3
                if share < min(smallest, 0.3 * first):
                    self.lin = None
                    return None
            if share == 1.0:
                return self.touch.copy()
        return None

    def _take(self, step: Array) -> bool:
        """Go a step, if the rod holds the touch there on the same branch."""
        assert self.lin is not None
        ahead = self.touch.copy()
        kernel.move_touch(ahead, self.lin, step)
        told = ahead[TIP:].copy()
        lin = self.on.settled(ahead)
        if lin is None or np.linalg.norm(ahead[TIP:] - told) > _MAX_MISS:
            return False
        self.touch, self.lin = ahead, lin
        return True

    def shift(self, by_s: float, by_phi: float) -> bool:
        """Move the touch over the surface [m, rad] under the same force; whether the rod holds it there."""
        step = np.zeros(UNKNOWNS)
        step[S], step[PHI] = by_s, by_phi
        return self.lin is not None and self._take(step)

    @property
    def force(self) -> float:
        """Normal force that it has reached [N]."""
        return float(self.touch[NORMAL])


def slide(on: SurfaceRod, s: float, phi: float, forces: Sequence[float]) -> float:
    """How far an object slides over the rod, towards the tip or back, as the base presses on along a straight line.

    The base moves against the free rod's outward normal at the place, the object is fixed and has no friction, which
    would shorten the way. To stick instead, a straight press of a slender probe needs several times the normal force
    along it, because the surface turns with the section; so it slides, by little.

    Args:
        on: the rod.
        s: arclength of the first touch [m]; phi: angle around the section [rad].
        forces: ascending normal forces [N].

    Returns:
        Largest arclength from the first touch to a later one [m], at most; infinite where the object comes off the end
        of the flank, or where the rod gives way.
    """
    press, most = on.press(s, phi), 0.0
    if press.lin is None:
        return math.inf
    begin = float(press.touch[S])
    start = press.lin[POINT : POINT + 3, 0].copy()
    push = press.lin[0:3, BY_TOUCH + NORMAL]
    across = np.linalg.svd(push[None])[2][1:]
    for force in forces:
        if press.to(force) is None:
            return math.inf
        for _ in range(_TRIES):
            assert press.lin is not None
            off = across @ (press.lin[POINT : POINT + 3, 0] - start)
            if np.linalg.norm(off) <= _ASIDE * on.rod.length:
                break
            change = np.linalg.solve(across @ press.lin[POINT : POINT + 3, BY_TOUCH : BY_TOUCH + 2], -off)
            change *= min(1.0, _MAX_SLIDE * on.rod.length / max(abs(float(change[0])), 1e-300))
            ahead = float(press.touch[S] + change[0])
            if not 0.0 <= ahead <= on.rod.flank_end or not press.shift(float(change[0]), float(change[1])):
                return math.inf
        else:
            return math.inf
        most = max(most, abs(float(press.touch[S]) - begin))
    return most


_TRIES = 12
_ASIDE = 1e-6
"""Distance from the straight line, over the length, that counts as none."""
_MAX_SLIDE = 0.05
"""Of one step, over the length."""
