"""Many frictionless contacts at once, with exact derivatives by everything that the rod is made of."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from probedesign.frames import Array
from probedesign.rod.batch import Batch, Rods, solve_batch
from probedesign.rod.rod import Columns, Rod

_MAX_ITERATIONS = 12
_CLOSE = 1e-4
"""Relative misfit of force and normal from which Newton's next step is the last: it squares it."""
_EXACT = 1e-6
"""Relative misfit that is left alone: the fast rod's own error."""
_FAR = 2.0
"""Steps of the magnitude, over the one before, beyond which a curve through the last two is not trusted."""
_LEAST_STEP = 1e-3  # of the magnitude
TIP_AT_REST = (0.0, 0.0, 1.0, 1.0, 0.0, 0.0)
Indices = NDArray[np.int64]


class Start(NamedTuple):
    """Contacts that others set out from.

    Attributes:
        magnitude: [N], (n,).
        force: base axes [N], (n, 3).
        tip: of the equilibria, (n, 6).
        by_magnitude: of the force, (n, 3).
    """

    magnitude: Array
    force: Array
    tip: Array
    by_magnitude: Array

    def rows(self, of: Indices) -> "Start":
        """Some of them."""
        return Start(*(part[of] for part in self))

    def ahead(self, magnitude: Array) -> Array:
        """The force at other magnitudes, to first order [N], (n, 3)."""
        return self.force + (magnitude - self.magnitude)[:, None] * self.by_magnitude

    def bent(self, before: "Start", magnitude: float) -> "Start":
        """The same with the slope that leads to where the cubic through both will be at another magnitude."""
        past, h = (
            (a - b)[:, None] for a, b in ((self.magnitude, before.magnitude), (magnitude, self.magnitude))
        )
        mean = (self.force - before.force) / past
        second = (2.0 * before.by_magnitude + 4.0 * self.by_magnitude - 6.0 * mean) / past
        third = 6.0 * (before.by_magnitude + self.by_magnitude - 2.0 * mean) / past**2
        slope = self.by_magnitude + h * (second / 2.0 + h * third / 6.0)
        return self._replace(by_magnitude=np.where(h <= _FAR * past, slope, self.by_magnitude))


@dataclass(frozen=True)
class Contacts:
    """Contacts without friction, one a row; rows of numbers are NaN unless `result` is "ok".

    Attributes:
        result: of each, (n,).
        s, angle, magnitude: of each touch [m], [rad], [N], (n,).
        slope: half-angle of the frustum there [rad], (n,).
        force: base axes [N], (n, 3).
        tip: of each equilibrium, (n, 6).
        held: the greatest push up to the one asked for that the rod holds [N], (n,).
        batch: the equilibria, with whatever columns were asked for.
    """

    result: NDArray[np.str_]
    s: Array
    angle: Array
    magnitude: Array
    slope: Array
    force: Array
    tip: Array
    held: Array
    batch: Batch

    @property
    def ok(self) -> NDArray[np.bool_]:
        """Which have an answer, (n,)."""
        return np.asarray(self.result == "ok")

    def rows(self, of: NDArray[np.bool_]) -> "Contacts":
        """Some of them."""
        parts = {entry.name: getattr(self, entry.name)[of] for entry in fields(self) if entry.name != "batch"}
        return Contacts(**parts, batch=self.batch.rows(of))

    @cached_property
    def _by_frame(self) -> Array:
        """The push in the section's axes x, y and tangent, (n, 3)."""
        return _weights(self.slope, self.angle)

    @cached_property
    def _d_normal(self) -> Array:
        """Of the push by every column under a dead force [N], (n, 3, k)."""
        return self.magnitude[:, None, None] * self.pushed(self.batch.d_contact)

    def pushed(self, d_contact: Array) -> Array:
        """Of the unit push by what moves the section's frame, (n, 12, k) to (n, 3, k)."""
        return _pushed(self._by_frame, d_contact)

    def d_force(self, dead: Array, slope: Array | None = None) -> Array:
        """Of the force, which turns with the section, by parameters [N], (n, 3, j).

        Args:
            dead: of the push by them under a dead force, (n, 3, j).
            slope: of the half-angle by them, (n, j).
        """
        if slope is not None:
            lean = np.stack([-np.sin(self.slope) * np.cos(self.angle), -np.sin(self.slope) * np.sin(self.angle),
                             -np.cos(self.slope)], axis=-1)  # fmt: skip
            by_slope = self.magnitude[:, None] * np.einsum("nij,nj->ni", self.axes, lean)
            dead = dead + by_slope[:, :, None] * slope[:, None, :]
        return np.asarray(np.linalg.solve(np.eye(3) - self._d_normal[:, :, 0:3], dead), dtype=float)

    @cached_property
    def axes(self) -> Array:
        """Of the sections, columns x, y, tangent, (n, 3, 3)."""
        return _axes(self.batch.frame)

    @cached_property
    def d_touch(self) -> Array:
        """Of the force by (s_contact, angle, magnitude), (n, 3, 3)."""
        x, y = self.axes[:, :, 0], self.axes[:, :, 1]
        turned = np.cos(self.slope)[:, None] * (
            np.cos(self.angle)[:, None] * y - np.sin(self.angle)[:, None] * x
        )
        push = np.einsum("nij,nj->ni", self.axes, self._by_frame)
        dead = np.stack([self._d_normal[:, :, 3], self.magnitude[:, None] * turned, push], axis=-1)
        return self.d_force(dead)

    @cached_property
    def d_wrench_by_touch(self) -> Array:
        """Of the base wrench by (s_contact, angle, magnitude), (n, 6, 3)."""
        moment = self.batch.d_moment[:, :, 0:3] @ self.d_touch
        moment[:, :, 0] += self.batch.d_moment[:, :, 3]
        return np.concatenate([self.d_touch, moment], axis=1)

    @cached_property
    def d_point_by_touch(self) -> Array:
        """Of the contact's point by the same, (n, 3, 3)."""
        d = self.batch.d_contact[:, 6:9]
        point: Array = d[:, :, 0:3] @ self.d_touch
        point[:, :, 0] += d[:, :, 3]
        return point


def solve_contacts(
    rods: Rod | Sequence[Rod] | Rods,
    gravity: ArrayLike,
    s_contact: ArrayLike,
    angle: ArrayLike,
    magnitude: ArrayLike,
    *,
    start: Start | None = None,
    columns: Columns = "load",
    threads: int | None = None,
) -> Contacts:
    """Equilibria of n objects that push without friction, each as `solve_frictionless` has it.

    Args:
        rods: one for all, or one a case with equally many knots.
        gravity: base axes [m/s²], (3,) or (n, 3).
        s_contact, angle, magnitude: of each push [m], [rad], [N], (n,).
        start: neighbouring contacts to set out from.
        columns: of the sensitivities that the contacts bring along; derivatives need "load" at least.
        threads: all cores if None.

    Returns:
        The contacts; "unstable" is a push that the rod cannot hold, however gently it grows.
    """
    several = Rods.of(rods)
    s, angle, magnitude = (np.array(v, dtype=float) for v in (s_contact, angle, magnitude))
    which = np.arange(len(s)) if len(several) > 1 else np.zeros(len(s), dtype=np.int64)
    s = np.minimum(s, several.flank_end[which])
    pushes = _Pushes(several, which, np.broadcast_to(np.asarray(gravity, dtype=float), (len(s), 3)), s, angle,
                     _slopes(several, which, s), threads)  # fmt: skip
    return pushes.grown(magnitude, start, columns)


def contacts_at(rod: Rod, gravity: Array, s: Array, force: Array, tip: Array) -> Contacts:
    """Contacts that have been found already, with all columns.

    Args:
        rod: the rod.
        gravity: base axes [m/s²], (3,).
        s: of each contact [m], (n,).
        force: base axes [N], (n, 3).
        tip: of each equilibrium, (n, 6).
    """
    batch = solve_batch(rod, gravity, force, s, columns="all", guess=tip, guess_only=True, threads=1)
    x, y = (np.einsum("ni,ni->n", batch.frame[:, of], force) for of in (slice(3, 6), slice(9, 12)))
    magnitude = np.linalg.norm(force, axis=1)
    slope = _slopes(Rods.of(rod), np.zeros(len(s), dtype=np.int64), np.minimum(s, rod.flank_end))
    return Contacts(batch.result, s, np.arctan2(y, x), magnitude, slope, force, batch.tip, magnitude, batch)


def follow_contacts(
    rod: Rod, gravity: ArrayLike, s_contact: Array, angle: Array, magnitudes: Sequence[float]
) -> list[Contacts]:
    """The same touches pressed ever harder, each force starting from the one before it.

    A touch that the rod cannot hold is not tried at a greater force: its branch has ended.

    Args:
        rod: the rod.
        gravity: base axes [m/s²], (3,).
        s_contact, angle: of each touch [m], [rad], (n,).
        magnitudes: ascending [N], (m,).

    Returns:
        Contacts of all touches for each force, with all columns.
    """
    steps: list[Contacts] = []
    alive, last, before = np.arange(len(s_contact)), None, None
    for magnitude in magnitudes:
        start = last if last is None or before is None else last.bent(before, magnitude)
        size = np.full(len(alive), magnitude)
        here = solve_contacts(rod, gravity, s_contact[alive], angle[alive], size, start=start, columns="all")
        steps.append(_spread(here, alive, steps[-1], magnitude) if steps else here)
        ok, held = np.flatnonzero(here.ok), here.rows(here.ok)
        alive, before = alive[ok], None if last is None else last.rows(ok)
        last = Start(held.magnitude, held.force, held.tip, held.d_touch[:, :, 2])
    return steps


def _spread(here: Contacts, alive: Indices, before: Contacts, magnitude: float) -> Contacts:
    """Contacts of those still alive among all; the others keep why they ended."""
    n = len(before.result)
    result = before.result.astype("<U16")
    result[alive] = here.result

    def full(v: Array) -> Array:
        out = np.full((n, *v.shape[1:]), np.nan)
        out[alive] = v
        return out

    held = before.held.copy()
    held[alive] = here.held
    batch = here.batch.among(alive, result)
    return Contacts(result, before.s, before.angle, np.full(n, magnitude), before.slope, full(here.force),
                    full(here.tip), held, batch)  # fmt: skip


@dataclass(frozen=True)
class _Pushes:
    """Pushes at given places from given sides."""

    rods: Rods
    which: Indices
    gravity: Array
    s: Array
    angle: Array
    slope: Array
    threads: int | None

    def grown(self, magnitude: Array, start: Start | None, columns: Columns) -> Contacts:
        """At once where Newton goes there, else the push grows from where it starts."""
        every, first, misfit = np.arange(len(self.s)), None, np.full(len(self.s), np.inf)
        force = magnitude[:, None] * self._weights if start is None else start.ahead(magnitude)
        tip = np.tile(TIP_AT_REST, (len(every), 1)) if start is None else start.tip.copy()
        if start is not None and columns != "none":  # neighbours may know the force to the last digit
            first = self._solve(every, force, tip, columns)
            force, misfit = self._improved(every, first, magnitude, force)
            tip[first.ok] = first.tip[first.ok]
        result = np.where(misfit <= _CLOSE * magnitude, "ok", "not_converged").astype("<U16")
        far = np.flatnonzero(result != "ok")
        guess = None if start is None else tip[far]
        force[far], tip[far], result[far] = self._newton(far, magnitude[far], force[far], guess)
        lost, held = np.flatnonzero(result != "ok"), magnitude.copy()
        if len(lost):
            begun = self._unloaded(lost) if start is None else start.rows(lost)
            force[lost], tip[lost], result[lost], held[lost] = self._step_by_step(
                lost, magnitude[lost], begun
            )
        batch = self._told(np.flatnonzero(misfit > _EXACT * magnitude), force, tip, result, columns, first)
        force = np.where((result == "ok")[:, None], force, np.nan)
        return Contacts(result, self.s, self.angle, magnitude, self.slope, force, batch.tip, held, batch)

    @cached_property
    def _weights(self) -> Array:
        return _weights(self.slope, self.angle)

    def _unloaded(self, of: Indices) -> Start:
        """No push at all, on the free rod."""
        free = self._solve(of, np.zeros((len(of), 3)), None, "load")
        push = np.einsum("nij,nj->ni", _axes(free.frame), self._weights[of])
        tip = np.where(free.ok[:, None], free.tip, TIP_AT_REST)
        return Start(np.zeros(len(of)), np.zeros((len(of), 3)), tip, np.nan_to_num(push))

    def _told(self, of: Indices, force: Array, tip: Array, result: NDArray[np.str_], columns: Columns,
              first: Batch | None) -> Batch:  # fmt: skip
        """All with the columns asked for, of which some are to be solved; the forces of those without an answer count
        as none."""
        good = result == "ok"
        here = self._solve(of, np.where(good[:, None], force, 0.0)[of], tip[of], columns)
        batch = here if first is None else first.changed(of, here)
        result[good] = batch.result[good]
        return batch.without(result != "ok")

    def _solve(self, of: Indices, force: Array, tip: Array | None, columns: Columns) -> Batch:
        return solve_batch(self.rods, self.gravity[of], force, self.s[of], which=self.which[of], columns=columns,
                           guess=tip, guess_only=tip is not None, threads=self.threads)  # fmt: skip

    def _newton(
        self, of: Indices, magnitude: Array, force: Array, tip: Array | None
    ) -> tuple[Array, Array, NDArray[np.str_]]:
        """Newton on the forces of some pushes from guesses; force, tip and result of each."""
        force, result = force.copy(), np.full(len(of), "not_converged", dtype="<U16")
        tips = np.tile(TIP_AT_REST, (len(of), 1))
        busy = np.arange(len(of))
        for _ in range(_MAX_ITERATIONS):
            if not len(busy):
                break
            batch = self._solve(of[busy], force[busy], tip, "load")
            force[busy], misfit = self._improved(of[busy], batch, magnitude[busy], force[busy])
            ok, done = batch.ok, misfit <= _CLOSE * magnitude[busy]
            tips[busy[ok]], result[busy[~ok]] = batch.tip[ok], batch.result[~ok]
            result[busy[done]] = "ok"
            # Newton may leave the sphere on which the force must lie.
            going = ok & ~done & (np.linalg.norm(force[busy], axis=1) <= 3.0 * magnitude[busy])
            busy, tip = busy[going], batch.tip[going]
        return force, tips, result

    def _improved(self, of: Indices, batch: Batch, magnitude: Array, force: Array) -> tuple[Array, Array]:
        """Forces after a step of Newton from their equilibria, and how far they were off [N]; those without an
        equilibrium stay, infinitely far off."""
        w, ok = self._weights[of], batch.ok
        off = force - magnitude[:, None] * np.einsum("nij,nj->ni", _axes(batch.frame), w)
        jacobian = np.eye(3) - magnitude[:, None, None] * _pushed(w, batch.d_contact[:, :, 0:3])
        better = force.copy()
        better[ok] -= np.linalg.solve(jacobian[ok], off[ok][:, :, None])[:, :, 0]
        return better, np.where(ok, np.linalg.norm(off, axis=1), np.inf)

    def _step_by_step(
        self, of: Indices, magnitude: Array, start: Start
    ) -> tuple[Array, Array, NDArray[np.str_], Array]:
        """Pushes that grow in steps that Newton can take; "unstable" where no step is short enough. Also told is how
        far each came."""
        reached, force, tip, by = (part.copy() for part in start)
        step, result = (magnitude - reached) / 4.0, np.full(len(of), "ok", dtype="<U16")
        busy = np.arange(len(of))
        while len(busy):
            goal = np.minimum(reached[busy] + step[busy], magnitude[busy])
            ahead = force[busy] + (goal - reached[busy])[:, None] * by[busy]
            found, tips, codes = self._newton(of[busy], goal, ahead, tip[busy])
            ok = codes == "ok"
            held, lost = busy[ok], busy[~ok]
            by[held] = (found[ok] - force[held]) / np.maximum(goal[ok] - reached[held], 1e-300)[:, None]
            force[held], tip[held], reached[held] = found[ok], tips[ok], goal[ok]
            step[held] *= 2.0
            result[lost[step[lost] < _LEAST_STEP * magnitude[lost]]] = "unstable"
            step[lost] /= 4.0
            busy = busy[(reached[busy] < magnitude[busy]) & (result[busy] == "ok")]
        return force, tip, result, reached


def _axes(frame: Array) -> Array:
    """[t, x, p, y], (n, 12), as columns x, y, tangent, (n, 3, 3)."""
    return np.stack([frame[:, 3:6], frame[:, 9:12], frame[:, 0:3]], axis=-1)


def _weights(slope: Array, angle: Array) -> Array:
    """Unit push in the section's axes, (n, 3)."""
    return np.stack([np.cos(slope) * np.cos(angle), np.cos(slope) * np.sin(angle), -np.sin(slope)], axis=-1)


def _pushed(weights: Array, d_contact: Array) -> Array:
    """Of the unit push by the columns that move the section's axes, (n, 3, k)."""
    x, y, z = (weights[:, i, None, None] for i in range(3))
    return np.asarray(x * d_contact[:, 3:6] + y * d_contact[:, 9:12] + z * d_contact[:, 0:3])


def _slopes(rods: Rods, which: Indices, s: Array) -> Array:
    """Half-angle of the frustum of each place [rad], (n,)."""
    knots, radii = rods.bodies.knots, rods.bodies.radii
    i = np.clip((knots[which] < s[:, None]).sum(axis=1) - 1, 0, knots.shape[1] - 2)
    thinner = radii[which, i] - radii[which, i + 1]
    return np.asarray(np.arctan(thinner / (knots[which, i + 1] - knots[which, i])))
