"""The fusion of `fusion.py` as readings come: bounded time and memory, forgetting when the touch is lost.

Readings from nearly one pose are kept as their mean, a node; no more than so many nodes are kept, and the two that lie
closest become one where there is one too many. Each update puts its reading into a node, linearises that node anew,
now and then one of the others in turn, and takes one step of Gauss and Newton over all nodes as they were linearised
last. So the answer is that of the batch over the nodes' means. The arithmetic is compiled (`node_kernel.py`,
`normal_kernel.py`).
"""

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from probedesign.errors import InputError
from probedesign.estimation import node_kernel as node
from probedesign.estimation import normal_kernel as normal
from probedesign.estimation.answer import most_chi2, told, widened
from probedesign.estimation.bow import Bow, bow_of
from probedesign.estimation.detector import Detector, Touching
from probedesign.estimation.equations import POINT, Equations, Reading, channels_of
from probedesign.estimation.estimate import Result
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.fused import Fixed, Fused, MomentsAbout
from probedesign.estimation.fusion import Fusion
from probedesign.estimation.pressed import Push
from probedesign.estimation.unknowns import Unknowns
from probedesign.frames import Array

MOST_NODES = 8
IN_TURN = 4
"""Readings after which one of the older nodes is linearised anew too."""
LONGEST_WAIT = 256
"""Readings from one start to the next, which come after 1, 2, 4 ... of them: a start may take a tenth of a second, and
a touch that fits no single point must not hold up the readings."""
SETTLING = 8
"""Steps of Gauss and Newton at the first readings, from the place that one reading by itself tells."""
_APART = 5e-6
"""Poses nearer than this [m], and their rotations [rad] likewise over a tenth of a metre, are one."""
_MIXED = 1e-4
"""Poses further apart than this, measured likewise, are not mixed into one node: their readings differ too much."""
_HELD, _HELD_SECONDS = 256.0, 0.15
"""Free readings that are held back before they count, the fewer: the last ones may be touches that were not told yet;
the contact test takes a seventh of a second at most."""
_ANCHOR_SECONDS = 1.0
"""How long free readings count in the free probe's mean [s]: before, the bias was another."""
_LARGE = 1e9


@dataclass
class Tracker:
    """Locates one fixed point of the world while the probe touches it, reading by reading.

    Attributes:
        estimator: of the probe.
        unknowns: what is not known; as the design's material has it if None.
        gravity_world: [m/s²], (3,).
        moments_only, moments_about: as in `Estimator.fuse`.
        rate: of readings [Hz], each one sample of the sensor, not averaged.
        nodes: kept at most.
    """

    estimator: Estimator
    unknowns: Unknowns | None = None
    gravity_world: ArrayLike = (0.0, 0.0, -9.81)
    moments_only: bool = False
    moments_about: MomentsAbout = "sensor"
    rate: float = 7000.0
    nodes: int = MOST_NODES

    def __post_init__(self) -> None:
        """Raises InputError where an argument makes no sense."""
        self._gravity_world = np.asarray(self.gravity_world, dtype=float)
        if self._gravity_world.shape != (3,) or not np.isfinite(self._gravity_world).all():
            raise InputError(f"gravity_world = {self.gravity_world} must be three finite numbers in m/s²")
        if self.nodes < 2:
            raise InputError(f"nodes = {self.nodes} must be 2 or more")
        model = self.estimator.model
        self._unknowns = self.unknowns or Unknowns.of(model)
        self._detector = Detector(model, self.rate)
        self._channels = channels_of(model, self.moments_about if self.moments_only else None)
        self._time = -math.inf
        # What free readings are beyond the free probe first, then the nodes of the touch, and room for one too many.
        self._rows = np.zeros((self.nodes + 2, node.NODE))
        self._held = np.zeros((2, 7))  # sum and number of the readings held back, the younger first
        self._gravity, self._result = np.empty(3), np.empty(normal.RESULT)
        self._forget()

    @cached_property
    def _work(self) -> Array:
        return np.empty(max(node.WORK, normal.work_for(self.nodes + 1, len(self._channels))))

    @cached_property
    def _doubts(self) -> tuple[Array, Array, Array, float, float, float, float]:
        """What `normal_step` needs to know of noise and unknowns."""
        model, unknowns = self.estimator.model, self._unknowns
        sample = self._channels @ model.noise_base() @ self._channels.T * model.averaging_samples
        return (np.ascontiguousarray(self._channels), np.ascontiguousarray(sample), unknowns.prior,
                unknowns.base_repeat, unknowns.bias_steps, unknowns.bias_walk_steps, unknowns.creep)  # fmt: skip

    def _forget(self) -> None:
        self._kept = 0
        self._x: Array | None = None
        self._fixed: Fixed = "surface"
        self._turn, self._bowed_at = 0, 0.0
        self._idle, self._wait = 0, 1
        self._bow_found: Bow | None = None
        self._said = Fused("unobservable")

    def update(
        self, wrench_base: ArrayLike, T_world_base: ArrayLike, time: float, touching: Touching | None = None
    ) -> Fused:
        """Take in one reading.

        Args:
            wrench_base: one sample at the base [N, N·m], (6,).
            T_world_base: pose of the base as it was read, (4, 4).
            time: of the sensor's clock [s].
            touching: what another test says of the reading, as `Detector` would; the tracker's own test if None.

        Returns:
            What is known of the touched point: "ok" with its covariance, "no_contact", or why there is no number. A
            reading that cannot be ("out_of_range": not finite, beyond the sensor, no pose, time running backward)
            changes nothing.
        """
        wrench, T = (
            np.ascontiguousarray(wrench_base, dtype=float),
            np.ascontiguousarray(T_world_base, dtype=float),
        )
        if wrench.shape != (6,) or T.shape != (4, 4) or not self._time < time < math.inf:
            return Fused("out_of_range")
        reach, hanging, most, _ = self.estimator.model.sight
        if not node.admit(wrench, T, self._gravity_world, reach, hanging, most, self._gravity):
            return Fused("out_of_range")
        free = self.estimator.free(self._gravity)
        if not free.ok:
            return Fused("not_converged")
        self._time = float(time)
        said = touching or self._detector.update(wrench - free.wrench_base)
        if said != "contact":
            self._release(wrench - free.wrench_base, lost=said == "lost")
            return Fused("no_contact")
        i = self._place(wrench, T)
        return self._solve(i) if self._x is not None else self._begin()

    @property
    def kept(self) -> int:
        """How many nodes of the present touch are kept."""
        return self._kept

    @property
    def _touched(self) -> Array:
        """The nodes of the touch."""
        return self._rows[1 : 1 + self._kept]

    @property
    def _counting(self) -> Array:
        """All that counts: the free probe's mean too where the bias is not known."""
        anchored = self._unknowns.bias_steps > 0.0 and self._rows[0, node.COUNT] > 0.0
        return self._rows[0 if anchored else 1 : 1 + self._kept]

    def _release(self, beyond: Array, lost: bool) -> None:
        """A free reading, less what the free probe makes there: it ties the bias down, wherever the base is."""
        if lost or self._kept:
            self._forget()
        self._held[0, :6] += beyond
        self._held[0, 6] += 1.0
        if self._held[0, 6] < min(_HELD, _HELD_SECONDS * self.rate):
            return
        anchor, (old, count) = self._rows[0], (self._held[1, :6], self._held[1, 6])
        if count:
            total = min(anchor[node.COUNT] + count, max(_ANCHOR_SECONDS * self.rate, count))
            anchor[node.WRENCH : node.ROTATION] += (old - count * anchor[node.WRENCH : node.ROTATION]) / total
            anchor[node.COUNT] = total
        self._held[1], self._held[0] = self._held[0], 0.0

    def _set(self, row: Array, wrench: Array, T: Array) -> None:
        """A node of one reading."""
        row[:] = 0.0
        row[node.WRENCH : node.ROTATION] = wrench
        row[node.ROTATION : node.ORIGIN], row[node.ORIGIN : node.GRAVITY] = T[:3, :3].ravel(), T[:3, 3]
        row[node.GRAVITY : node.COUNT] = self._gravity
        row[node.COUNT], row[node.TOUCHED] = 1.0, 1.0

    def _place(self, wrench: Array, T: Array) -> int:
        """Put a reading into the node that it belongs to; which of the touch's nodes that is."""
        self._held[:] = 0.0
        last = self._rows[self._kept]
        if self._kept and node.apart(last, T) <= _APART:
            node.take_in(last, wrench, _LARGE)
            return self._kept - 1
        self._kept += 1
        new = self._rows[self._kept]
        self._set(new, wrench, T)
        if self._kept > 1:
            new[node.PLACE :] = last[node.PLACE :]
        if self._kept > self.nodes:
            self._join()
        return self._kept - 1

    def _join(self) -> None:
        """Make one of the two neighbours that lie closest, or drop the lighter where they lie too far apart."""
        rows = self._touched
        gaps = [node.apart(after, _pose(before)) for before, after in pairwise(rows)]
        i = int(np.argmin(gaps))
        a, b = rows[i], rows[i + 1]
        kept = (a if a[node.COUNT] >= b[node.COUNT] and i + 2 < len(rows) else b).copy()
        if gaps[i] <= _MIXED:
            total = a[node.COUNT] + b[node.COUNT]
            for part in (slice(node.WRENCH, node.ROTATION), slice(node.ORIGIN, node.GRAVITY)):
                kept[part] = (a[node.COUNT] * a[part] + b[node.COUNT] * b[part]) / total
            kept[node.COUNT] = total
        rows[i] = kept
        rows[i + 1 : -1] = rows[i + 2 :].copy()
        self._kept -= 1

    def _solve(self, i: int) -> Fused:
        """The answer after a reading came into node i: linearised there, and one step over all nodes."""
        assert self._x is not None
        self._turn += 1
        older = self._turn // IN_TURN % self._kept
        for k in (i, older) if self._turn % IN_TURN == 0 and older != i else (i,):
            if not self._linearise(k, move=True):
                return self._lost()
        return self._say(self._step())

    def _say(self, answer: Fused) -> Fused:
        """What fits no more may have run away, so it begins again; what cannot fit stays so."""
        if answer.result in ("inconsistent", "not_converged"):
            self._x = None
        self._said = answer
        return answer

    def _lost(self) -> Fused:
        return self._say(Fused("not_converged"))

    def _linearise(self, k: int, move: bool) -> bool:
        """A node of the touch, its push first moved to where the unknowns put it or not; whether it stands."""
        rod, model = self.estimator.model.rod, self.estimator.model
        return bool(node.linearise(rod.body, rod.flank_end, model.mass, self._x, move, self._fixed == "contact",
                                   self._touched[k], self._work))  # fmt: skip

    def _step(self) -> Fused:
        """One step over all nodes as they are linearised, and what is known then."""
        assert self._x is not None
        rows, result = self._counting, self._result
        most = 0.1 * self.estimator.model.rod.length
        if not normal.normal_step(rows, self._x, most, *self._doubts, self._work, result):
            return Fused("not_converged")
        return self._told(rows, self._x.copy(), result.copy())

    def _told(self, rows: Array, x: Array, result: Array) -> Fused:
        """The answer in words."""
        cov, chi2 = result[normal.COV : normal.CHI2].reshape(7, 7), float(result[normal.CHI2])
        dof, rms = max(len(rows) * len(self._channels) - 3, 1), math.sqrt(cov[0, 0] + cov[1, 1] + cov[2, 2])
        stiffness, std = math.exp(x[node.STIFFNESS]), math.sqrt(cov[node.STIFFNESS, node.STIFFNESS])
        code = self._code(chi2, dof, rms, bool(result[normal.PULLS]))
        if code != "ok":
            return Fused(code, fixed=self._fixed, stiffness=stiffness, std_stiffness=stiffness * std, chi2=chi2,
                         dof=dof, rms=rms, iterations=1)  # fmt: skip
        free = rows[:, node.TOUCHED] == 0.0
        answer = Fused(
            "ok",
            p_contact_world=x[POINT] + result[normal.AT_CONTACT : normal.AT_SURFACE],
            p_surface_world=x[POINT] + result[normal.AT_SURFACE : normal.COV_CONTACT],
            cov_contact_world=result[normal.COV_CONTACT : normal.PULLS].reshape(3, 3),
            cov_fixed_world=cov[POINT, POINT],
            fixed=self._fixed,
            s_contact=np.where(free, np.nan, rows[:, node.PLACE]),
            force_base=rows[:, node.FORCE : node.TIP].copy(),
            stiffness=stiffness,
            std_stiffness=stiffness * std,
            chi2=chi2,
            dof=dof,
            rms=rms,
            iterations=1,
        )
        if self._kept > 1 or self.moments_only:
            return answer
        bow = self._bow()
        return answer if bow is None else widened(answer, bow, _pose(self._touched[0])[:3, :3])

    def _bow(self) -> Bow | None:
        """Of the first pose, looked at anew each time it has twice the readings."""
        row = self._touched[0]
        if row[node.COUNT] >= 2.0 * self._bowed_at or self._bowed_at == 0.0:
            model, self._bowed_at = self.estimator.model, float(row[node.COUNT])
            cov = model.noise_base() * model.averaging_samples / self._bowed_at
            wrench, gravity = row[node.WRENCH : node.ROTATION].copy(), row[node.GRAVITY : node.COUNT].copy()
            self._bow_found = bow_of(model.rod, wrench, cov, gravity)
        return self._bow_found

    def _code(self, chi2: float, dof: int, rms: float, pulls: bool) -> Result:
        if chi2 > most_chi2(dof) or pulls:
            return "inconsistent"
        if not rms < self.estimator.model.rod.length / math.sqrt(12.0):
            return "unobservable" if self.moments_only else "too_light"
        return "ok"

    def _begin(self) -> Fused:
        """Start, but not at every reading; between, what was said last holds, never "ok"."""
        if self.moments_only and self._kept < 2:
            self._said = Fused("unobservable")
            return self._said
        self._idle += 1
        if self._idle < self._wait:
            return self._said
        self._idle, self._wait = 0, min(2 * self._wait, LONGEST_WAIT)
        self._model_anchor()
        # Moments alone may have rivals that one reading does not show; of one pose, a batch knows no more.
        answer = Fused("not_converged") if self.moments_only else self._from_one()
        if answer.result not in ("ok", "too_light") and self._kept > 1:
            answer = self._from_batch()
        return self._say(answer)

    def _model_anchor(self) -> None:
        """How what free readings are beyond the free probe goes with its stiffness."""
        anchor, gravity = self._rows[0], self._touched[-1, node.GRAVITY : node.COUNT].copy()
        anchor[node.GRAVITY : node.COUNT] = gravity
        anchor[node.ROTATION : node.GRAVITY] = self._touched[-1, node.ROTATION : node.GRAVITY]
        eq = self.estimator.model.rod.solve(gravity, columns="all")
        if eq.sensitivity is not None:
            by, names = eq.sensitivity.d_wrench, eq.sensitivity.names
            anchor[node.BY_STIFFNESS : node.FIXED] = by[:, names.index("log_E")] + by[:, names.index("log_G")]

    def _from_one(self) -> Fused:
        """Start from the place that the last node's reading tells by itself."""
        last, rod = self._touched[-1], self.estimator.model.rod
        found = self.estimator.estimate(last[node.WRENCH : node.ROTATION], last[node.GRAVITY : node.COUNT])
        if found.result == "ambiguous":
            return Fused("ambiguous")
        if not found.candidates or not (eq := found.candidates[0].shape()).ok:
            return Fused("not_converged")
        push, self._fixed = Push.under(rod, eq), "surface"
        self._x = x = np.zeros(node.UNKNOWNS)
        for row in self._touched:
            _push(row, push)
        if not self._linearise(self._kept - 1, move=False):
            return self._lost()
        x[POINT] = last[node.ORIGIN : node.GRAVITY] + _pose(last)[:3, :3] @ last[node.FIXED : node.CONTACT]
        for row in self._touched[:-1]:
            row[node.PLACE :] = last[node.PLACE :]
        for _ in range(SETTLING):
            if not all(self._linearise(k, move=True) for k in range(self._kept)):
                return self._lost()
            answer = self._step()
        return answer

    def _free_wrench(self, row: Array) -> Array:
        """What the free probe makes where a row is the free readings' mean, which is kept without it; else nothing."""
        if row[node.TOUCHED]:
            return np.zeros(6)
        return self.estimator.free(row[node.GRAVITY : node.COUNT].copy()).wrench_base

    def _from_batch(self) -> Fused:
        """Start from the whole batch."""
        self._x, model, rows = None, self.estimator.model, self._counting
        cov = model.noise_base() * model.averaging_samples
        readings = tuple(
            Reading(row[: node.ROTATION] + self._free_wrench(row), cov / row[node.COUNT], _pose(row),
                    row[node.GRAVITY : node.COUNT].copy(), bool(row[node.TOUCHED]))
            for row in rows
        )  # fmt: skip
        equations = Equations(model, readings, self._unknowns, self._channels)
        solved = Fusion(equations).solved()
        if isinstance(solved, Fused):
            return solved
        found, self._fixed, others = solved
        answer = told(equations, found, self._fixed, others, brief=True)
        if answer.ok:
            self._x = found[0].x
            for k, pressed in enumerate(found[0].pressed[len(rows) - self._kept :]):
                assert pressed is not None
                _push(self._touched[k], pressed.push)
                if not self._linearise(k, move=False):
                    return self._lost()
        return answer


def _pose(row: Array) -> Array:
    """Of a node's base, (4, 4)."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = row[node.ROTATION : node.ORIGIN].reshape(3, 3), row[node.ORIGIN : node.GRAVITY]
    return T


def _push(row: Array, push: Push) -> None:
    """Let a node's push be this one."""
    row[node.PLACE], row[node.ANGLE], row[node.MAGNITUDE] = push.s, push.angle, push.magnitude
    row[node.FORCE : node.TIP], row[node.TIP : node.LOG_STIFFNESS] = push.force, push.tip
