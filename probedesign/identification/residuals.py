"""What one test says against a guess: whitened misfits and their derivatives, in groups that belong together."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from probedesign.frames import Array, skew
from probedesign.identification.guess import ROOT_STEP, Guess
from probedesign.identification.parameters import BIAS, FALL, PRINT, SEAT_SHIFT, SEAT_TURN, SHIFT, TURN
from probedesign.identification.trial import Trial
from probedesign.rod import kernels
from probedesign.rod.equilibrium import Equilibrium, Sensitivity
from probedesign.rod.rod import Rod

LOG_E, LOG_G, LOG_DENSITY, LOG_DIAMETER = (
    kernels.PARAMETERS.index(f"log_{name}") for name in ("E", "G", "density", "diameter")
)
"""Columns of the rod's sensitivities."""
FRICTION = 0.1
"""Standard deviation of the share of a touch's force that acts along the surface. A dry edge on this resin may well
stick (assumed); the sensor tells the force itself, so that little is lost by trusting the surface little."""
_NEAR = 1e-5  # for the turn of a section, over which its tangent is differenced [m]


class Group(NamedTuple):
    """Misfits that one reading makes.

    Attributes:
        test: its name.
        kind: markers, wrenches, touches, places, sags, friction or scales.
        item: which of its kind in the test, as people count; 0 for the only one.
        r: told less expected, over its standard deviations, (k,).
        J: derivatives of `r` by the shared vector, (k, size).
        own: and by the test's own unknowns, (k, own).
        off: told less expected, in SI, (k,).
    """

    test: str
    kind: str
    item: int
    r: Array
    J: Array
    own: Array
    off: Array


class Moving(NamedTuple):
    """Vectors of the bent rod in base axes with their derivatives; further axes before for several.

    Attributes:
        at: (3,), or (6,) of a wrench.
        rod: by all that the rod's columns are by, (., k).
        root: by root_rigid_radii, (.,).
    """

    at: Array
    rod: Array
    root: Array


@dataclass(frozen=True)
class Bent:
    """A test solved with a guess.

    Attributes:
        trial: the test.
        guess: of what is shared.
        own: the test's own unknowns: force of a touch in base axes [N], place of the load [m].
        eq: the equilibrium, with all columns.
        rooted: with a root a little less and a little more; empty where its derivative is not wanted.
        gravity_base: as guessed [m/s²], (3,).
        d_gravity: of gravity in base axes by its own turns, (3, 2).
    """

    trial: Trial
    guess: Guess
    own: Array
    eq: Equilibrium
    rooted: tuple[Equilibrium, ...]
    gravity_base: Array
    d_gravity: Array

    @property
    def ok(self) -> bool:
        """Whether the rod holds."""
        return self.eq.ok and all(eq.ok for eq in self.rooted)

    @property
    def sensitivity(self) -> Sensitivity:
        """Of the equilibrium."""
        assert self.eq.sensitivity is not None
        return self.eq.sensitivity

    @property
    def force(self) -> Array:
        """On the rod in base axes [N], (3,)."""
        return self.eq.load[0:3]

    @property
    def T_world_base(self) -> Array:
        """As guessed, (4, 4)."""
        return np.asarray(self.trial.T_world_base @ self.guess.T_mount_base)

    def groups(self) -> Iterator[Group]:
        """All misfits of the test."""
        if self.trial.wrench_base is not None:
            yield self._wrench()
        yield from self._markers()
        if self.trial.p_touch_world is not None and not self.trial.free:
            yield self._touch()
        if self.trial.slides and np.isfinite(self.trial.s_contact):
            yield self._place()
        if self.trial.touched:
            yield self._friction()
        if np.isfinite(self.trial.sag):
            yield self._sag()

    def by_shared(self, moving: Moving) -> Array:
        """Derivatives of a vector, in base axes, by the shared vector; the turn of base axes themselves left out."""
        J = np.zeros((*moving.at.shape, self.guess.shared.size))
        J[..., 0:4] = moving.rod[..., [LOG_E, LOG_G, LOG_DENSITY, LOG_DIAMETER]]
        J[..., 4] = moving.root
        turned = moving.rod[..., 7:10] @ skew(self.gravity_base)
        if not self.trial.touched:
            turned = turned + moving.rod[..., 0:3] @ skew(self.force)
        J[..., TURN] = turned @ self.guess.T_mount_base[:3, :3].T
        J[..., SEAT_TURN] = turned @ self.guess.T_seat[:3, :3].T
        J[..., FALL] = moving.rod[..., 7:10] @ self.d_gravity
        J[..., PRINT:] = moving.rod[..., kernels.ALL_COLUMNS :] @ self.guess.shared.print_rows.T
        return J

    def by_own(self, moving: Moving) -> Array:
        """Likewise by the test's own unknowns."""
        touched, slides = self.trial.touched, self.trial.slides
        return np.concatenate([moving.rod[..., 0 : 3 * touched], moving.rod[..., 3 : 3 + slides]], axis=-1)

    def in_world(self, moving: Moving) -> tuple[Array, Array, Array]:
        """Points of the rod in the world with its derivatives by the shared vector and by the test's own."""
        guess, T, told = self.guess, self.T_world_base, self.trial.T_world_base[:3, :3]
        R, mount, seat = T[:3, :3], told @ guess.T_mount[:3, :3], guess.T_seat
        seated = moving.at @ seat[:3, :3].T
        J = R @ self.by_shared(moving)
        J[..., TURN] -= told @ _skews((seated + seat[:3, 3]) @ guess.T_mount[:3, :3].T)
        J[..., SEAT_TURN] -= mount @ _skews(seated)
        J[..., SHIFT], J[..., SEAT_SHIFT] = told, mount
        return moving.at @ R.T + T[:3, 3], J, R @ self.by_own(moving)

    def _wrench(self) -> Group:
        seat, d = self.guess.to_seat, self.sensitivity
        root = self._by_root(lambda eq: eq.wrench_base)
        moving = Moving(self.eq.wrench_base, d.d_wrench, root)
        told = seat @ moving.at
        J, own = seat @ self.by_shared(moving), seat @ self.by_own(moving)
        f, arm = skew(told[:3]), skew(self.guess.T_seat[:3, 3])
        J[:3, SEAT_TURN] -= f
        J[3:, SEAT_TURN] -= skew(told[3:] - arm @ told[:3]) + arm @ f
        J[3:, SEAT_SHIFT] -= f
        J[:, BIAS] = np.eye(6)
        assert self.trial.wrench_base is not None and self.trial.cov_wrench is not None
        off = self.trial.wrench_base - told - self.guess.bias
        return self._group("wrenches", 0, off, J, own, self.trial.cov_wrench)

    def _markers(self) -> Iterator[Group]:
        trial = self.trial
        if not len(trial.marker_s):
            return
        p, d = self.eq.p_at(trial.marker_s), self.eq.d_p_at(trial.marker_s)
        root = self._by_root(lambda eq: eq.p_at(trial.marker_s))
        if trial.marker_side is not None:
            offset, turned = self._on_surface(trial.marker_s, trial.marker_side)
            p, d = p + offset, d + turned
        expected, J, own = self.in_world(Moving(p, d, root))
        off = trial.p_markers_world - expected
        for i, number in enumerate(trial.marker_numbers):
            yield self._group("markers", number, off[i], J[i], own[i], trial.cov_markers[i])

    def _on_surface(self, s: Array, side: float) -> tuple[Array, Array]:
        """From the axis to the surface on one side (m, 3), and its derivatives, (m, 3, k).

        The section turns with its tangent; a change of its twist, which round rods have none of, is left out.
        """
        rod, R, section = self.guess.rod, self.eq.R_at(s), self.guess.shared.model.cross_section
        offset = (
            section.reach(side)
            * np.interp(s, rod.s, rod.radius)[:, None]
            * (np.cos(side) * R[:, :, 0] + np.sin(side) * R[:, :, 1])
        )
        low, high = np.maximum(s - _NEAR, 0.0), np.minimum(s + _NEAR, rod.length)
        across = (low <= self.eq.s_contact) & (self.eq.s_contact < high)  # the shear jumps there
        low = np.where(across, self.eq.s_contact - 2.0 * _NEAR, low)
        high = np.where(across, self.eq.s_contact - _NEAR, high)
        d_tangent = (self.eq.d_p_at(high) - self.eq.d_p_at(low)) / (high - low)[:, None, None]
        turn = np.cross(R[:, :, 2][:, :, None], d_tangent, axis=1)
        return offset, np.cross(turn, offset[:, :, None], axis=1)

    def _touch(self) -> Group:
        trial = self.trial
        root = self._by_root(lambda eq: eq.p_contact_base)
        moving = Moving(self.eq.p_contact_base, self.sensitivity.d_position, root)
        if trial.touched:
            out, columns = self._outward()
            moving = Moving(moving.at + out, moving.rod + columns, root)
        expected, J, own = self.in_world(moving)
        assert trial.p_touch_world is not None
        cov = trial.std_touch**2 * np.eye(3)
        return self._group("touches", 0, trial.p_touch_world - expected, J, own, cov)

    def _outward(self) -> tuple[Array, Array]:
        """From the axis to the touched surface against the force [m], (3,), and by what the rod's columns are by."""
        rod, s, size = self.guess.rod, self.eq.s_contact, float(np.linalg.norm(self.force)) or 1.0
        u, slope, radius = self.force / size, rod.taper_at(s), float(np.interp(s, rod.s, rod.radius))
        reach = radius / np.hypot(1.0, slope)
        columns = np.zeros((3, kernels.ALL_COLUMNS + len(rod.s)))
        columns[:, 0:3] = -reach / size * (np.eye(3) - np.outer(u, u))
        columns[:, 3] = slope / radius * reach * u
        columns[:, LOG_DIAMETER] = -reach * u
        knots = np.array([np.interp(s, rod.s, one) for one in np.diag(rod.radius)]) / radius
        columns[:, kernels.ALL_COLUMNS :] = -reach * np.outer(u, knots)
        return -reach * u, columns

    def _place(self) -> Group:
        own = np.zeros((1, self.trial.own))
        own[0, -1] = 1.0
        off = np.array([self.trial.s_contact - self.own[-1]])
        cov = np.array([[self.trial.std_s**2]])
        return self._group("places", 0, off, np.zeros((1, self.guess.shared.size)), own, cov)

    def _friction(self) -> Group:
        """No force along the surface: F · t = -|F| sin α, t the tangent there."""
        d, size = self.sensitivity, float(np.linalg.norm(self.force)) or 1.0
        t, dt = d.frame[0:3], d.d_contact[0:3]
        slope = self.guess.rod.taper_at(self.eq.s_contact)
        lean = slope / np.hypot(1.0, slope)
        share = (self.force @ t) / size + lean
        by_force = (t - (self.force @ t) / size**2 * self.force) / size
        root = self._by_root(lambda eq: eq.R_at(eq.s_contact)[:, 2])
        moving = Moving(np.zeros(1), (self.force @ dt / size)[None], np.array([self.force @ root / size]))
        own = self.by_own(moving)
        own[0, 0:3] += by_force
        cov = np.array([[FRICTION**2]])
        return self._group("friction", 0, np.array([-share]), self.by_shared(moving), own, cov)

    def _sag(self) -> Group:
        """How far along gravity the tip hangs below where the straight probe on the same base has it."""
        trial, length, size = self.trial, self.guess.rod.length, float(np.linalg.norm(self.gravity_base))
        s, down = np.array([length]), self.gravity_base / size
        root = self._by_root(lambda eq: eq.p_at(s))[0]
        moving = Moving(self.eq.p_at(s)[0] - [0.0, 0.0, length], self.eq.d_p_at(s)[0], root)
        falls = Moving(self.gravity_base, np.zeros_like(moving.rod), np.zeros(3))
        falls.rod[:, 7:10] = np.eye(3)
        J = down @ self.by_shared(moving) + moving.at @ self.by_shared(falls) / size
        own, off = (down @ self.by_own(moving))[None], np.array([trial.sag - moving.at @ down])
        return self._group("sags", 0, off, J[None], own, np.array([[trial.std_sag**2]]))

    def _by_root(self, value: Callable[[Equilibrium], Array]) -> Array:
        """Derivative of what an equilibrium tells by root_rigid_radii; zero where it is not wanted."""
        if not self.rooted:
            return np.zeros_like(value(self.eq))
        less, more = map(value, self.rooted)
        return np.asarray((more - less) / (2.0 * ROOT_STEP))

    def _group(self, kind: str, item: int, off: Array, J: Array, own: Array, cov: Array) -> Group:
        """Whitened: misfits are told less expected, so derivatives change their sign."""
        whiten = np.linalg.inv(np.linalg.cholesky(cov))
        return Group(self.trial.name, kind, item, whiten @ off, -whiten @ J, -whiten @ own, off)


def _skews(a: Array) -> Array:
    """`skew` of each, (..., 3, 3)."""
    return np.asarray(np.swapaxes(np.cross(a[..., None, :], np.eye(3)), -1, -2))


def bend(trial: Trial, guess: Guess, own: Array, tip: Array | None = None, root: bool = False) -> Bent:
    """Solve one test with a guess.

    Args:
        trial: the test.
        guess: of what is shared.
        own: of its own unknowns, (trial.own,).
        tip: of a neighbouring equilibrium, to start from.
        root: whether derivatives by the root are wanted.
    """
    R = (trial.T_world_base @ guess.T_mount_base)[:3, :3]
    gravity, d_gravity = guess.gravity(trial.gravity_world)
    gravity_base = R.T @ gravity
    force = own[:3] if trial.force_world is None else R.T @ trial.force_world
    s = own[-1] if trial.slides else (None if trial.free else trial.s_contact)

    def solved(rod: Rod) -> Equilibrium:
        return rod.solve(gravity_base, force, s, guess=tip, columns="all")

    rooted = tuple(solved(guess.rooted(step)) for step in (-ROOT_STEP, ROOT_STEP)) if root else ()
    return Bent(trial, guess, own, solved(guess.rod), rooted, gravity_base, R.T @ d_gravity)
