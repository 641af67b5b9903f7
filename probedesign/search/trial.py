"""The figures of one body of a family, with their derivatives as far as they are known exactly."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from probedesign.design import Design
from probedesign.errors import InputError
from probedesign.frames import Array
from probedesign.probe import Probe, build_probe
from probedesign.rod.rod import Rod
from probedesign.search.bearing import borne
from probedesign.search.body import Body
from probedesign.search.task import Task
from probedesign.search.worth import touches
from probedesign.units import MM

STEP = 1e-4
"""Of the finite differences, relative: the bound is smooth to about 1e-8."""
_EXACT = 12  # digits: none is lost that counts
_SMALL = 1e-4  # of a radius, where a difference is of the hanging rod alone
HELD = 1.25
"""Force, over the task's, that a body must bear: the error does not show how near it is to giving way, and a print may
be softer than designed by some times the 3 % that E spreads (assumed)."""
_NO_SLIDE_MM = 1e-3
"""Slide below which an object counts as one that stays where it is."""
_ASKED = 1.1 * HELD  # so that what is told is smooth at the limit itself
HOPELESS = {"error_mm": 1e3, "worst_error_mm": 1e3, "sensor_use": 10.0, "slide_mm": 1e3, "sag_mm": 1e3,
            "reach_mm": 1e-3, "borne": 0.1}  # fmt: skip
"""What stands for figures of a body that gives way: numbers that no search takes for good."""


@dataclass
class Trial:
    """A family of bodies in a task, each looked at once.

    Attributes:
        body: the family.
        task: that it is judged by; its force is scaled by that of a point that carries one.
        with_force: whether the last number of a point is the logarithm of the force over the task's.
    """

    body: Body
    task: Task
    with_force: bool = False
    _seen: dict[bytes, dict[str, float]] = field(default_factory=dict)

    @property
    def looked(self) -> int:
        """Bodies that were computed."""
        return len(self._seen)

    def design(self, x: Array) -> Design:
        """The design of a point, as its file will say it."""
        return self.body.design(x[: self.body.size])

    def task_at(self, x: Array) -> Task:
        """With the point's own force."""
        if not self.with_force:
            return self.task
        factor = math.exp(float(x[-1]))
        return replace(self.task, forces_N=tuple(factor * force for force in self.task.forces_N))

    def figures(self, x: Array) -> dict[str, float]:
        """Of the body as it is, not rounded; `HOPELESS` where it does not stand."""
        key = x.tobytes()
        if key not in self._seen:
            self._seen[key] = self._figures(x)
        return self._seen[key]

    def stands(self, x: Array) -> bool:
        """Whether the body bears the task's force."""
        return self.figures(x)["error_mm"] < HOPELESS["error_mm"]

    def _figures(self, x: Array) -> dict[str, float]:
        length = {"length_mm": self.body.length_mm(x)}
        try:
            probe = self.probe(x)
            model = probe.model
        except InputError:
            return HOPELESS | length | {"mass_g": 1e3}
        found = {**HOPELESS, **length, "mass_g": 1e3 * probe.mass}
        task = self.task_at(x)
        touched = touches(model, task)
        error = task.combined(touched.errors)
        if math.isfinite(error):
            slid = min(max(touched.slide / MM, _NO_SLIDE_MM), HOPELESS["slide_mm"])
            found |= {"error_mm": error / MM, "worst_error_mm": max(touched.errors) / MM, "slide_mm": slid,
                      "sensor_use": touched.sensor_use, "borne": borne(model, task, _ASKED)}  # fmt: skip
        free = probe.rod.solve(model.gravity_base)
        if free.ok:
            tip = free.p_at(probe.length)
            found["sag_mm"] = float(np.linalg.norm(tip - [0.0, 0.0, probe.length])) / MM
            found["reach_mm"] = float(np.linalg.norm(tip)) / MM
        return found

    def probe(self, x: Array) -> Probe:
        """The probe of a point, its dimensions not rounded, so that differences of it are smooth."""
        return build_probe(self.body.design(x[: self.body.size], _EXACT))

    def gradient(self, name: str, x: Array) -> Array:
        """Of a figure. Sag and reach by diameters are exact but for the base's; the rest are finite differences.

        The bound is made of first derivatives of the rod, so its own would need second ones, which the rod lacks.
        """
        if name in ("sag_mm", "reach_mm") and not {"length", "section"} & set(self.body.free):
            found = np.zeros(len(x))
            exact = self._hanging(x)
            if exact is not None:
                found[: self.body.controls] = exact[name]
                return found
        if name in ("mass_g", "length_mm"):
            return differences(lambda y: self.figures(y)[name], x, central=True)
        return differences(lambda y: self.figures(y)[name], x, central=False)

    def _hanging(self, x: Array) -> dict[str, Array] | None:
        """Sag and reach by the control diameters [mm/mm]; None if it does not stand."""
        probe = self.probe(x)
        rod, gravity = probe.rod, probe.model.gravity_base
        eq = rod.solve(gravity, columns="all")
        if eq.sensitivity is None:
            return None
        first = eq.sensitivity.names.index("log_diameter_0")
        by_knot = eq.sensitivity.d_position[:, first : first + len(rod.s)] / (2.0 * rod.radius)
        by_knot[:, 0] = _by_base(
            rod, gravity
        )  # the root's stiffening goes with it, for which the rod has no column
        by_control, tip = by_knot @ self.body.spline, eq.p_at(rod.length)
        hung, reached = tip - [0.0, 0.0, rod.length], tip
        return {
            "sag_mm": hung @ by_control / np.linalg.norm(hung),
            "reach_mm": reached @ by_control / np.linalg.norm(tip),
        }


def differences(f: Callable[[Array], float | Array], x: Array, central: bool) -> Array:
    """Finite differences of a function of n numbers, (n,), or (n, m) of m functions."""
    found, here = list[Array](), 0.0 if central else f(x)
    for i in range(len(x)):
        step = np.zeros(len(x))
        step[i] = STEP * max(abs(float(x[i])), 1.0)
        risen = (f(x + step) - f(x - step)) / 2.0 if central else f(x + step) - here
        found.append(np.asarray(risen / step[i]))
    return np.array(found)


def _by_base(rod: Rod, gravity: Array) -> Array:
    """Of the hanging tip by the base's diameter, the rigid root in proportion, by two solves [m/m], (3,)."""
    ends = list[Array]()
    for factor in (1.0 - _SMALL, 1.0 + _SMALL):
        radius = rod.radius.copy()
        radius[0] *= factor
        other = replace(rod, radius=radius, rigid_length=factor * rod.rigid_length)
        ends.append(other.solve(gravity, mode="reference").p_at(rod.length))
    difference: Array = (ends[1] - ends[0]) / (4.0 * _SMALL * rod.radius[0])
    return difference
