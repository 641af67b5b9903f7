"""Touches of one fixed point with rising force, free of noise: what a fusion will read, and how well it then knows."""

import math
from dataclasses import dataclass, replace

import numpy as np

from probedesign.estimation.equations import UNKNOWNS, Equations, Reading, channels_of
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.pressed import Pressed, Push, press
from probedesign.estimation.unknowns import Unknowns
from probedesign.frames import Array, pose
from probedesign.rod.contact import solve_frictionless
from probedesign.search.task import Task
from probedesign.units import MM

SIDE = math.pi / 2
"""Angle of the push [rad]: sideways to the gravity of a horizontal mount, as in the paper's experiments."""
_NORMAL = 1e-9  # of the force
_TRIES = 8


@dataclass(frozen=True)
class PressSeries:
    """Touches of the world's origin, the base turned as in its mount.

    Attributes:
        model: of the probe.
        touches: solved and to first order, in the order of time.
    """

    model: ProbeModel
    touches: tuple[Pressed, ...]

    @property
    def wrenches(self) -> Array:
        """At the base, without noise, (k, 6)."""
        return np.array([touch.wrench for touch in self.touches])

    @property
    def Ts_world_base(self) -> Array:
        """(k, 4, 4)."""
        return np.array([pose(p=-touch.p_surface) for touch in self.touches])

    def equations(self, unknowns: Unknowns, task: Task) -> Equations:
        """As `Estimator.fuse` would write them down."""
        cov, gravity = self.model.noise_base(), self.model.gravity_base
        readings = tuple(Reading(touch.wrench, cov, T, gravity, True)
                         for touch, T in zip(self.touches, self.Ts_world_base, strict=True))  # fmt: skip
        return Equations(self.model, readings, unknowns, channels_of(self.model, task.moments_about))

    def rms(self, unknowns: Unknowns, task: Task) -> float:
        """Of the fixed point [m] by the bound, as `Estimator.fuse` states it."""
        equations = self.equations(unknowns, task)
        return equations.rms(equations.linear(self.touches, np.zeros(UNKNOWNS)), unknowns)


def unknowns_of(model: ProbeModel, task: Task) -> Unknowns:
    """What is not known while touches are fused: the stiffness as the design has it, the rest as the task says."""
    return replace(
        Unknowns.of(model), base_repeat=task.base_repeat_mm * MM, bias_walk_steps=task.bias_walk_steps
    )


def press_series(model: ProbeModel, fraction: float, task: Task, angle: float = SIDE) -> PressSeries | None:
    """The touches at one place of the probe; None if it gives way.

    The strongest is sought from nothing, so that it is the branch that a press reaches; the others follow it down, or
    are sought so too where the probe is so near to giving way that they cannot.

    Args:
        model: of the probe.
        fraction: of the length, where.
        task: how hard and how often.
        angle: of the push about the tangent [rad].
    """
    s, found = fraction * model.rod.length, list[Pressed]()
    for k in range(task.touches, 0, -1):
        force = task.force_N * k / task.touches
        pressed = _at(model, found[-1].push, force) if found else None
        pressed = pressed or _from_nothing(model, s, angle, force)
        if pressed is None:
            return None
        found.append(pressed)
    return PressSeries(model, tuple(found[::-1]))


def _from_nothing(model: ProbeModel, s: float, angle: float, force: float) -> Pressed | None:
    """The touch there, the push grown from nothing."""
    contact = solve_frictionless(model.rod, model.gravity_base, s, angle, force)
    if contact.result != "ok":
        return None
    eq = contact.equilibrium
    return _at(model, Push(eq.s_contact, angle, force, contact.force_base, eq.tip), force)


def _at(model: ProbeModel, near: Push, force: float) -> Pressed | None:
    """The touch there with another force, from a neighbouring one: the force is turned until it is normal."""
    push = replace(near, magnitude=force, force=near.force * force / near.magnitude)
    for _ in range(_TRIES):
        pressed = press(model.rod, model.gravity_base, push, "surface")
        if pressed is None:
            return None
        if np.linalg.norm(pressed.towards_normal) <= _NORMAL * force:
            return replace(pressed, push=replace(push, tip=pressed.tip))
        push = replace(push, force=push.force + pressed.towards_normal, tip=pressed.tip)
    return None
