"""Touches of known place and force, solved by the rod of the estimator, and presses of one fixed point."""

from typing import NamedTuple

import numpy as np

from probedesign.core.frames import Array, pose
from probedesign.estimation.error_sources import ErrorSources
from probedesign.estimation.model import ProbeModel, Tolerances
from probedesign.rod.kernels.surface_contact import CENTRE, DEAD, POINT, TIP, TOUCH, VALUE

EXACT = Tolerances.none()


class TrueTouch(NamedTuple):
    """A converged touch with its first-order model."""

    touch: Array  #: unknowns, dead loads and tip, (TOUCH,).
    lin: Array  #: linearisation, (ROWS, 1 + 5 + 7 + K).
    D: Array  #: change of wrench, touched and centreline point by one standard deviation of each error source, (12, J).

    @property
    def wrench(self) -> Array:
        """Base wrench [N, N·m], (6,)."""
        return self.lin[:6, VALUE].copy()

    @property
    def p_surface(self) -> Array:
        """Touched point [m], (3,)."""
        return self.lin[POINT : POINT + 3, VALUE].copy()

    @property
    def p_contact(self) -> Array:
        """Point of the centreline nearest to the line of action [m], (3,)."""
        return self.lin[CENTRE : CENTRE + 3, VALUE].copy()

    @property
    def force(self) -> Array:
        """On the probe [N], (3,)."""
        return self.touch[DEAD : DEAD + 3].copy()


def sources_of(model: ProbeModel, gravity: Array, tolerances: Tolerances = EXACT) -> ErrorSources:
    """Return the error sources after a tare under the same gravity."""
    return ErrorSources.of(model, tolerances, gravity, model.rod.solve(gravity))


def settle(sources: ErrorSources, y: Array, steps: int = 4) -> TrueTouch | None:
    """Solve a touch with y = (s, φ, f_n, a_1, a_2) in load steps; return None without an equilibrium."""
    touch = np.zeros(TOUCH)
    touch[:5] = y
    touch[TIP:] = sources.model.rod.solve(sources.gravity).tip
    for share in np.linspace(0.0, 1.0, steps + 1)[1:]:
        if touch[2] != 0.0:
            touch[DEAD:TIP] *= share * y[2] / touch[2]
        touch[2] = share * y[2]
        lin, D = sources.columns_at(touch)
        if not np.isfinite(lin[:12]).all():
            return None
    return TrueTouch(touch, lin, D)


def presses(
    sources: ErrorSources,
    s: float,
    phi: float,
    forces: Array,
    ratios: tuple[float, float] = (0.0, 0.0),
    slide: float = 0.0,
) -> tuple[list[TrueTouch], Array]:
    """Return touches of the origin by a base without rotation, and the poses of the base, (k, 4, 4).

    Args:
        slide: how far the contact moves along the probe from one touch to the next [m].
    """
    touches = []
    for k, force in enumerate(forces):
        touch = settle(sources, np.array([s + k * slide, phi, force, *ratios]))
        assert touch is not None
        touches.append(touch)
    return touches, np.array([pose(np.eye(3), -touch.p_surface) for touch in touches])


def wrenches_of(touches: list[TrueTouch]) -> Array:
    """Return the base wrenches, (k, 6)."""
    return np.array([touch.wrench for touch in touches])
