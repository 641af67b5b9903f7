"""The fusion of `fusion.py` as readings come: bounded time and memory, forgetting when the touch is lost.

Readings from nearly one pose are kept as their mean, a node; no more than so many nodes are kept, and the two that lie
closest become one where there is one too many. Each update puts its reading into a node, linearises that node anew,
now and then one of the others in turn, and takes one step of Gauss and Newton over all nodes as they were linearised
last. So the answer is that of the batch over the nodes' means.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from probedesign.errors import InputError
from probedesign.estimator.detector import Detector
from probedesign.estimator.estimator import Estimator
from probedesign.estimator.fused import Fixed, Fused, MomentsAbout
from probedesign.estimator.fusion import (
    OFFSET,
    POINT,
    STIFFNESS,
    Fusion,
    Reading,
    Solution,
    channels_of,
    share_of,
)
from probedesign.estimator.pressed import Pressed, press
from probedesign.estimator.unknowns import Unknowns
from probedesign.frames import Array, is_pose

MOST_NODES = 8
IN_TURN = 4
"""Readings after which one of the older nodes is linearised anew too."""
_APART = 5e-6
"""Poses nearer than this [m], and their rotations [rad] likewise over a tenth of a metre, are one."""
_ANCHOR = 7000
"""Most readings that the free probe's mean counts."""


@dataclass
class Node:
    """The mean of readings from nearly one pose.

    Attributes:
        wrench: (6,); T: of the base, (4, 4); gravity: in base axes (3,); count: of readings; touched: whether.
        pressed: as it was linearised last, None if not yet or free.
        shift: how far the base was likely off there for itself [m], (3,).
    """

    wrench: Array
    T: Array
    gravity: Array
    count: int
    touched: bool
    pressed: Pressed | None = None
    shift: Array = field(default_factory=lambda: np.zeros(3))

    def take(self, wrench: Array, most: float = math.inf) -> None:
        """One more reading."""
        self.count = int(min(self.count + 1, most))
        self.wrench = self.wrench + (wrench - self.wrench) / self.count

    def join(self, other: "Node") -> "Node":
        """Both as one; the pose is that of the one with more readings, moved to the mean."""
        total = self.count + other.count
        share, more = other.count / total, self if self.count >= other.count else other
        T = more.T.copy()
        T[:3, 3] = (1.0 - share) * self.T[:3, 3] + share * other.T[:3, 3]
        wrench = (1.0 - share) * self.wrench + share * other.wrench
        return Node(wrench, T, more.gravity, total, True, more.pressed)

    def apart(self, T: Array) -> float:
        """How far a pose is from this one [m]; a radian of turn counts as a tenth of a metre."""
        moved, turned = T[:3, 3] - self.T[:3, 3], T[:3, :3] - self.T[:3, :3]
        return math.sqrt(float(moved @ moved)) + 0.1 * math.sqrt(0.5 * float((turned * turned).sum()))


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
        self._gravity = np.asarray(self.gravity_world, dtype=float)
        if self._gravity.shape != (3,) or not np.isfinite(self._gravity).all():
            raise InputError(f"gravity_world = {self.gravity_world} must be three finite numbers in m/s²")
        if self.nodes < 2:
            raise InputError(f"nodes = {self.nodes} must be 2 or more")
        model = self.estimator.model
        self._unknowns = self.unknowns or Unknowns.of(model)
        self._detector = Detector(model, self.rate)
        self._channels = channels_of(model, self.moments_about if self.moments_only else None)
        self._cov = model.noise_base() * model.averaging_samples
        self._time = -math.inf
        self._free: Node | None = None
        self._forget()

    def _forget(self) -> None:
        self._nodes: list[Node] = []
        self._x: Array | None = None
        self._fixed: Fixed = "surface"
        self._turn = 0
        self._said = Fused("unobservable")

    def update(self, wrench_base: ArrayLike, T_world_base: ArrayLike, time: float) -> Fused:
        """Take in one reading.

        Args:
            wrench_base: one sample at the base [N, N·m], (6,).
            T_world_base: pose of the base as it was read, (4, 4).
            time: of the sensor's clock [s].

        Returns:
            What is known of the touched point: "ok" with its covariance, "no_contact", or why there is no number. A
            reading that cannot be ("out_of_range": not finite, beyond the sensor, no pose, time running backward)
            changes nothing.
        """
        wrench, T = np.asarray(wrench_base, dtype=float), np.asarray(T_world_base, dtype=float)
        if wrench.shape != (6,) or not (
            np.isfinite(wrench).all() and is_pose(T) and self._time < time < math.inf
        ):
            return Fused("out_of_range")
        gravity = T[:3, :3].T @ self._gravity
        if not self.estimator.model.reads(self.estimator.model.to_sensor(wrench, gravity)):
            return Fused("out_of_range")
        free = self.estimator.free(gravity)
        if not free.ok:
            return Fused("not_converged")
        self._time = float(time)
        said = self._detector.update(wrench - free.wrench_base)
        if said != "contact":
            self._release(wrench, T, gravity, lost=said == "lost")
            return Fused("no_contact")
        node = self._place(wrench, T, gravity)
        return self._solve(node)

    @property
    def kept(self) -> int:
        """How many nodes of the present touch are kept."""
        return len(self._nodes)

    def _release(self, wrench: Array, T: Array, gravity: Array, lost: bool) -> None:
        """A free reading: it ties the bias down."""
        if lost or self._nodes:
            self._forget()
        if self._free is None or self._free.apart(T) > _APART:
            self._free = Node(wrench, T, gravity, 1, False)
        else:
            self._free.take(wrench, _ANCHOR)

    def _place(self, wrench: Array, T: Array, gravity: Array) -> Node:
        """The node that a reading belongs to, with it."""
        if self._nodes and self._nodes[-1].apart(T) <= _APART:
            self._nodes[-1].take(wrench)
            return self._nodes[-1]
        pressed = self._nodes[-1].pressed if self._nodes else None
        self._nodes.append(Node(wrench, T, gravity, 1, True, pressed))
        if len(self._nodes) > self.nodes:
            gaps = [b.apart(a.T) for a, b in zip(self._nodes, self._nodes[1:], strict=False)]
            i = int(np.argmin(gaps))
            self._nodes[i : i + 2] = [self._nodes[i].join(self._nodes[i + 1])]
        return self._nodes[-1]

    def _fusion(self) -> Fusion:
        anchor = [self._free] if self._free is not None and self._unknowns.bias_steps > 0.0 else []
        readings = tuple(
            Reading(node.wrench, self._cov / node.count, node.T, node.gravity, node.touched)
            for node in [*anchor, *self._nodes]
        )
        return Fusion(self.estimator.model, readings, self._unknowns, self._channels)

    def _solve(self, node: Node) -> Fused:
        """The answer over all nodes: a whole batch at first, then one step from the last one."""
        fusion = self._fusion()
        if self._x is None:
            return self._begin(fusion)
        anchors = len(fusion.readings) - len(self._nodes)
        self._turn += 1
        older = self._nodes[self._turn // IN_TURN % len(self._nodes)]
        for one in (node, older) if self._turn % IN_TURN == 0 and older is not node else (node,):
            if not self._linearise(one):
                self._x, self._said = None, Fused("not_converged")
                return self._said
        pressed = (*[None] * anchors, *[one.pressed for one in self._nodes])
        linear = fusion.linear(pressed, self._x)
        normal = fusion.normal(linear, self._x)
        for one, shift in zip(self._nodes, normal.shifts[anchors:], strict=True):
            one.shift = shift
        x = self._x + share_of(normal.step, 0.1 * self.estimator.model.rod.length) * normal.step
        if not np.isfinite(x).all():
            self._x, self._said = None, Fused("not_converged")
            return self._said
        solution = Solution(x, normal.cov, normal.chi2, pressed, linear, 1)
        told = fusion.answer([solution], self._fixed, brief=True)
        # What fits no more may have run away, so a batch looks again; what no batch can fit stays so.
        self._x = None if told.result == "inconsistent" else x
        self._said = told
        return told

    def _begin(self, fusion: Fusion) -> Fused:
        """Start from a whole batch, but not at every reading; between, what was said last holds, never "ok"."""
        last = self._nodes[-1]
        if last.count & (last.count - 1) and last.count % 256:  # at 1, 2, 4, 8 ... readings of a pose
            return self._said
        solved = fusion.solved()
        if isinstance(solved, Fused):
            self._said = solved
            return solved
        found, self._fixed = solved
        self._said = told = fusion.answer(found, self._fixed, brief=True)
        if told.ok:
            self._x = found[0].x
            anchors = len(fusion.readings) - len(self._nodes)
            for one, pressed in zip(self._nodes, found[0].pressed[anchors:], strict=True):
                one.pressed = pressed
        return told

    def _linearise(self, node: Node) -> bool:
        """About where the unknowns put the fixed point; whether there is an equilibrium."""
        assert self._x is not None
        assert node.pressed is not None
        rod = self.estimator.model.rod
        point = node.T[:3, :3].T @ (self._x[POINT] - node.T[:3, 3]) - self._x[OFFSET] + node.shift
        push = node.pressed.moved(point, float(self._x[STIFFNESS]), 0.1 * rod.length)
        found = press(rod, node.gravity, push, self._fixed, float(self._x[STIFFNESS]))
        if found is not None:
            node.pressed = found
        return found is not None
