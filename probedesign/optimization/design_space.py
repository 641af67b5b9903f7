"""Design space of the optimiser: designs as vectors of a few numbers, their metrics, gradients and buckling margin."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from scipy.interpolate import make_interp_spline

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.design import Design, check_design
from probedesign.design.catalog import PrintLimits
from probedesign.design.edit import as_new_print, tables_of
from probedesign.design.schema import AXIS_KEYS, MAX_DIAMETER_MM, MIN_DIAMETER_MM
from probedesign.estimation.model import ProbeModel
from probedesign.geometry.axis import MIN_RADIUS_RATIO, Axis
from probedesign.mount import flange_of, max_ring_passage_d
from probedesign.optimization.objective import Task, detectable_mN, predict_task, tip_offset
from probedesign.prediction.predict import tip_sag
from probedesign.printing import check
from probedesign.probe import Probe, build_probe
from probedesign.rod.contact import solve_frictionless
from probedesign.rod.rod import natural_frequency

FreeParameter = Literal["cone", "taper", "length", "section", "axis"]
CONTROLS = 5  #: Number of control diameters of a free taper, evenly spaced along the probe.
FRUSTA = 11  #: Number of frusta of a free taper: none of the usual contact positions lies on a knot between two.
LENGTH_MM, RATIO = (20.0, 400.0), (0.2, 0.9)
#: Units of the coordinates, chosen so that all of them are between one and fifty.
_UNIT = {"length": 10.0, "section": 0.1}
#: Bounds and units of the variables of an axis: total bend [deg], turns, azimuth [deg].
AXIS = {"axis_bend_deg": (5.0, 270.0, 10.0), "axis_turns": (-1.5, 1.5, 0.1), "axis_azimuth_deg": (-360.0, 360.0, 10.0)}
#: Margin of a rule's limit where a ratio varies: it is rounded like the diameters and must not violate the rule.
_ROUNDING_MARGIN = 2e-3
DIGITS = 3  #: Decimals of a millimetre in a design file; no printer resolves the thousandth.


@dataclass(frozen=True)
class DesignSpace:
    """Designs that differ from a start in their flexible part alone.

    A point x: control diameters [mm], evenly from base to tip; then, if they are free, the length [cm], ten times the
    section's ratio and the axis as a helix, in the units of `AXIS`. A free taper is the cubic spline through its
    control diameters, linear in them.
    """

    start: Design  #: the design that the others differ from.
    controls: int  #: number of control diameters; 2 is a cone, 0 leaves the diameters unchanged.
    free: tuple[FreeParameter, ...]  #: what varies.

    @classmethod
    def of(cls, start: Design, free: tuple[FreeParameter, ...]) -> "DesignSpace":
        """Return the design space about a design.

        Raises:
            InputError: the section has nothing to vary, or both a cone and a taper are requested.
        """
        if "cone" in free and "taper" in free:
            raise InputError("--over cone and --over taper contradict: a cone is one of the tapers; name one of them")
        if "section" in free and start.probe.section == "round":
            raise InputError("--over section: a round section has nothing to vary; start from a hollow or elliptic one")
        if "taper" in free and start.probe.tip == "rounded":
            raise InputError('--over taper: requires a blunt tip; start from tip = "blunt"')
        return cls(start, CONTROLS if "taper" in free else 2 if "cone" in free else 0, free)

    @property
    def size(self) -> int:
        """Return the dimension of x."""
        return self._axis + len(AXIS) * ("axis" in self.free)

    @property
    def _axis(self) -> int:
        return self.controls + ("length" in self.free) + ("section" in self.free)

    @property
    def ratio_key(self) -> str:
        """Return the key of the section's ratio in the design file."""
        return "bore_ratio" if self.start.probe.section == "hollow" else "flatness"

    @cached_property
    def spline(self) -> Array:
        """Return the matrix from control diameters to diameters at the knots, (knots, controls)."""
        at = np.linspace(0.0, 1.0, self.controls)
        to = at if self.controls == 2 else np.linspace(0.0, 1.0, FRUSTA + 1)
        return np.asarray(make_interp_spline(at, np.eye(self.controls), k=min(3, self.controls - 1))(to))

    def x_of(self, design: Design) -> Array:
        """Return the nearest point to a design: its diameters at the controls."""
        knots = np.array(design.probe.blunt_mm)
        at = np.linspace(0.0, knots[-1, 0], self.controls)
        x = list(np.interp(at, knots[:, 0], knots[:, 1]))
        if "length" in self.free:
            x.append(design.probe.length_mm / _UNIT["length"])
        if "section" in self.free:
            x.append(getattr(design.probe, self.ratio_key) / _UNIT["section"])
        if "axis" in self.free:
            x += [(getattr(design.probe, key) or 0.0) / unit for key, (_, _, unit) in AXIS.items()]
        return np.array(x)

    def with_axis(self, x: Array, keys: dict[str, float]) -> Array:
        """Return a point with another axis, given by its keys."""
        return np.concatenate(
            [x[: self._axis], [keys[key] / unit for key, (_, _, unit) in AXIS.items()], x[self.size :]]
        )

    def axis_keys(self, x: Array, digits: int) -> dict[str, Any]:
        """Return the keys of the axis of a point."""
        values = x[self._axis : self._axis + len(AXIS)]
        keys = {key: round(float(v * AXIS[key][2]), digits) for key, v in zip(AXIS, values, strict=True)}
        if not keys["axis_turns"]:
            del keys["axis_turns"]
        return {"axis": "helix" if "axis_turns" in keys else "arc"} | keys

    def length_mm(self, x: Array) -> float:
        """Return the length of a point [mm]."""
        if "length" in self.free:
            return float(x[self.controls] * _UNIT["length"])
        return self.start.probe.length_mm

    def ratio(self, x: Array) -> float | None:
        """Return the section's ratio, None where it is round."""
        if "section" in self.free:
            return float(x[self._axis - 1] * _UNIT["section"])
        return getattr(self.start.probe, self.ratio_key, None)

    def knots_mm(self, x: Array) -> tuple[Array, Array]:
        """Return arclengths and diameters [mm], (knots,) each."""
        if not self.controls:
            s, d = np.array(self.start.probe.blunt_mm).T
            return s * (self.length_mm(x) / s[-1]), d
        d = self.spline @ x[: self.controls]
        return np.linspace(0.0, self.length_mm(x), len(d)), d

    @property
    def limits(self) -> PrintLimits:
        """Return the limits of the printer."""
        return self.start.printer.limits

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Return the lower and upper bound of each coordinate."""
        intervals = [(max(MIN_DIAMETER_MM, 0.8 * self.limits.soft_feature_mm), MAX_DIAMETER_MM)] * self.controls
        longest = check.longest_mm(self.start, flange_of(self.start, self.start.probe.base_d_mm * MM).thickness)
        length = (LENGTH_MM[0], min(LENGTH_MM[1], math.floor(longest)))  # a longer one is an error of the print check
        for name, (low, high) in {"length": length, "section": RATIO}.items():
            if name in self.free:
                intervals.append((low / _UNIT[name], high / _UNIT[name]))
        if "axis" in self.free:
            intervals += [(low / unit, high / unit) for low, high, unit in AXIS.values()]
        return intervals

    def printable(self, x: Array, *, without_warnings: bool = False) -> dict[str, Array]:
        """Return the margins of the print rules; 0 is the limit below which they report an error, or a
        warning if designs are wanted `without_warnings`.

        The limits of wall and bore are those for soft resin, below which `check` warns: a search that may choose them
        ends at the limit, and the figures of rigid resin are not expected to print. The margins are at most quadratic
        in x, so their central differences are exact.
        """
        s, d = self.knots_mm(x)
        ratio, hollow = self.ratio(x), self.start.probe.section == "hollow"
        thin = d * (ratio if ratio is not None and not hollow else 1.0)
        angle = check.MIN_SOFT_OVERHANG if without_warnings else self.limits.overhang_deg
        steepest = math.tan(math.radians(angle))
        slenderness = check.GOOD_SLENDERNESS if without_warnings else check.MIN_SLENDERNESS
        bore = max(check.SOFT_FACTOR * self.limits.hole_mm, self.limits.drain_mm if without_warnings else 0.0)
        rules = {
            "print rule smallest_feature": thin / self.limits.soft_feature_mm - 1.0,
            "print rule slenderness": (thin[:-1] - slenderness * (s[-1] - s[:-1])) / self.limits.soft_feature_mm,
            "print rule overhang": (np.diff(s) - steepest * np.diff(d) / 2.0) / s[-1],
        }
        if hollow and ratio is not None:
            wall = check.SOFT_FACTOR * self.limits.supported_wall_mm
            rules["print rule wall"] = (1.0 - ratio) * d / 2.0 / wall - 1.0
            rules["print rule hole"] = ratio * d / bore - 1.0
        if self.controls > 2:
            flange = flange_of(self.start, d[0] * MM)
            rules["room for the clamp ring"] = (max_ring_passage_d(flange) / MM - d) / self.limits.soft_feature_mm
        if self.controls == 2:
            rules["a cone that tapers"] = (d[:-1] - d[1:]) / self.limits.soft_feature_mm
        if "axis" in self.free:
            rules |= self._axis_margins(x, s, d)
        spare = _ROUNDING_MARGIN if "section" in self.free else 0.0
        return {name: room - spare for name, room in rules.items()}

    def _axis_margins(self, x: Array, s: Array, d: Array) -> dict[str, Array]:
        """Return the margins of `Axis.conflict`, with the curvature and the height over the mount along the axis."""
        keys = self.axis_keys(x, _EXACT)
        bend, azimuth = math.radians(keys["axis_bend_deg"]), math.radians(keys["axis_azimuth_deg"])
        axis = Axis.helix(s[-1] * MM, bend, keys.get("axis_turns", 0.0), azimuth)
        at = np.linspace(0.0, axis.length, _AXIS_POINTS)
        T, r = axis.frames(at), np.interp(at, s * MM, d * MM / 2.0)
        low = T[:, 2, 3] - r * np.sqrt(np.maximum(1.0 - T[:, 2, 2] ** 2, 0.0))
        return {
            "radius of curvature": 1.0 - MIN_RADIUS_RATIO * np.linalg.norm(axis.curvature_at(at), axis=1) * r,
            "axis above the mount": low[1:] / axis.length,
        }

    def tables(self, x: Array, digits: int) -> dict[str, Any]:
        """Return the tables of the design file of a point, dimensions rounded to the given decimals of a millimetre."""
        s, d = self.knots_mm(x)
        s, d = np.round(s, digits).tolist(), (np.round(d, digits) if self.controls else d).tolist()
        data = tables_of(self.start)
        probe: dict[str, Any] = data["probe"]
        profile = [list(pair) for pair in zip(s, d, strict=True)]
        for key in ("profile_mm", "tip_d_mm", "assumed") if self.controls else ():
            probe.pop(key, None)
        if not self.controls:
            probe |= {"length_mm": s[-1]} | ({"profile_mm": profile} if "profile_mm" in probe else {})
        else:
            probe |= {"length_mm": s[-1], "base_d_mm": d[0], "tip_d_mm": d[-1], "shape": "cone"}
        if self.controls > 2:
            probe |= {"shape": "profile", "profile_mm": profile}
        if "section" in self.free:
            probe[self.ratio_key] = round(float(self.ratio(x) or 0.0), 4)
        if "axis" in self.free:
            probe = {key: value for key, value in probe.items() if key not in AXIS_KEYS}
            data["probe"] = probe | self.axis_keys(x, digits)
        return as_new_print(data)

    def design(self, x: Array, digits: int = DIGITS) -> Design:
        """Return the design of a point.

        Raises:
            InputError: the design is invalid.
        """
        return check_design(self.tables(x, digits))


# Buckling

_WEAK_N = 1e-6
_SQUARE = 2.0  #: Power of the force by which the stiffness falls at first: the sign of the force does not matter.
#: Smallest relative loss of stiffness that is resolved: far from buckling the critical load needs no precision.
_NONE_LOST = 1e-3
_SHORT = 0.97  #: Fraction of the extrapolated critical load at which the stiffness is evaluated next.
_BACK = 0.7  #: Fraction of the step that is kept where the evaluation is beyond the critical load.
_MAX_EVALUATIONS = 4


def critical_load_factor(model: ProbeModel, task: Task, limit: float) -> float:
    """Return the critical load over the task's force, at the position where it is smallest.

    It is smooth in the design and exact near `limit` or below; beyond, only a lower bound. The stiffness against a dead
    force falls to zero at the critical load, as 1 - (F / F_critical)^p: two forces determine p.

    Args:
        model: of a probe that is stable under the task's force.
        task: positions and forces.
        limit: largest factor of interest.
    """
    return min(
        _load_factor_at(under, fraction * under.rod.length, angle, task.force_N, limit)
        for under in task.models(model)
        for fraction in task.fractions
        for angle in task.angles(under.gravity_base)
    )


def _load_factor_at(model: ProbeModel, s: float, angle: float, force: float, limit: float) -> float:
    free = _compliance(model, s, angle, _WEAK_N)
    here, lost, power = 1.0, _lost_stiffness(free, _compliance(model, s, angle, force)), _SQUARE
    for _ in range(_MAX_EVALUATIONS):
        estimate = here * float(lost ** (-1.0 / power))
        ahead = min(_SHORT * estimate, limit)
        if ahead <= here:
            break
        there = _compliance(model, s, angle, ahead * force)
        if not math.isfinite(there):
            limit = here + _BACK * (ahead - here)
            continue
        more = _lost_stiffness(free, there)
        power = max(math.log(more / lost) / math.log(ahead / here), 1.0) if more > lost else _SQUARE
        here, lost = ahead, more
    return here * float(lost ** (-1.0 / power))


def _lost_stiffness(free: float, pushed: float) -> float:
    return min(max(1.0 - free / pushed, _NONE_LOST), 1.0)


def _compliance(model: ProbeModel, s: float, angle: float, force: float) -> float:
    """Return the displacement of the contact by an additional dead force [m/N]; infinite where the probe buckles."""
    pushed = solve_frictionless(model.rod, model.gravity_base, s, angle, force)
    if pushed.result != "ok" or pushed.equilibrium.sensitivity is None:
        return math.inf
    return float(np.linalg.norm(pushed.equilibrium.sensitivity.d_position[:, :3]))


STEP = 1e-4  #: Relative step of the finite differences; the error prediction is smooth to about 1e-8.
_AXIS_POINTS = 25  #: Points of the axis at which its margins are evaluated.
_EXACT = 12  # decimals: dimensions are not rounded noticeably
#: Critical load, over the task's force, that a design must have: the error does not show how near buckling is, and a
#: print may be softer than designed by two standard deviations of E, 10 % each (assumed).
SAFETY_FACTOR = 1.25
_MOST_DISTINCT = 1e3  #: Distinction of a probe whose places are not confused.
_NO_SLIDE_MM = 1e-3  #: Slide below which an object counts as stationary.
_MAX_LOAD = 1.1 * SAFETY_FACTOR  # beyond the safety factor, so that the constraint is smooth at its limit
SOUGHT = "sought_mm"  #: Metric that a search minimises: the error of the task, of the worst case smooth.
#: Metrics of a design that buckles: values that no optimiser accepts.
INFEASIBLE = {SOUGHT: 1e3, "error_mm": 1e3, "worst_error_mm": 1e3, "sensor_use": 10.0, "slide_mm": 1e3,
            "sag_mm": 1e3, "reach_mm": 1e-3, "critical_load": 0.1, "distinction": 0.01, "buckling_margin": 0.1,
            "natural_frequency_Hz": 1e-3, "detectable_mN": 1e6, "thinnest_mm": 1e-3, "tip_offset_mm": 1e3}  # fmt: skip


@dataclass
class DesignEvaluator:
    """A design space with a task; each point is evaluated once."""

    space: DesignSpace  #: the design space.
    task: Task  #: by which designs are judged; its force is scaled by that of a point that has one.
    with_force: bool = False  #: whether the last coordinate of a point is the logarithm of the force over the task's.
    #: names of the metrics that are limited; what costs extra is computed for these alone.
    limited: frozenset[str] = frozenset()
    max_load: float = _MAX_LOAD  #: largest factor of the critical load over the task's force that is of interest.
    _cache: dict[bytes, dict[str, float]] = field(default_factory=dict)

    @property
    def n_evaluations(self) -> int:
        """Return the number of designs that were computed."""
        return len(self._cache)

    def task_at(self, x: Array) -> Task:
        """Return the task with the point's own force."""
        if not self.with_force:
            return self.task
        factor = math.exp(float(x[-1]))
        return replace(self.task, forces_N=tuple(factor * force for force in self.task.forces_N))

    def metrics(self, x: Array) -> dict[str, float]:
        """Return the metrics of a point, dimensions not rounded; `INFEASIBLE` where the design buckles."""
        key = x.tobytes()
        if key not in self._cache:
            self._cache[key] = self._evaluate(x)
        return self._cache[key]

    def is_stable(self, x: Array) -> bool:
        """Return whether the design is stable under the task's force."""
        return self.metrics(x)["error_mm"] < INFEASIBLE["error_mm"]

    def _evaluate(self, x: Array) -> dict[str, float]:
        metrics = {**INFEASIBLE, "length_mm": self.space.length_mm(x), "mass_g": 1e3}
        try:
            probe = self.probe(x)
            model = probe.model
        except InputError:
            return metrics
        metrics |= {"mass_g": 1e3 * probe.mass, "thinnest_mm": probe.geometry.thinnest / MM,
                    "tip_offset_mm": max(tip_offset(probe) / MM, 1e-3)}  # fmt: skip
        task = self.task_at(x)
        touched = predict_task(model, task)
        error = task.combined(touched.errors)
        if math.isfinite(error):
            slid = min(max(touched.slide / MM, _NO_SLIDE_MM), INFEASIBLE["slide_mm"])
            metrics |= {SOUGHT: task.sought(touched.errors) / MM, "error_mm": error / MM,
                      "worst_error_mm": max(touched.errors) / MM, "slide_mm": slid,
                      "sensor_use": touched.sensor_use, "distinction": min(touched.distinction, _MOST_DISTINCT),
                      "critical_load": critical_load_factor(model, task, self.max_load)}  # fmt: skip
            metrics["buckling_margin"] = metrics["critical_load"]
        if "natural_frequency_Hz" in self.limited:
            frequency = natural_frequency(model.rod, model.gravity_base)
            metrics["natural_frequency_Hz"] = frequency if math.isfinite(frequency) else 1e-3
        if "detectable_mN" in self.limited:
            metrics["detectable_mN"] = detectable_mN(model, task) or INFEASIBLE["detectable_mN"]
        free = probe.rod.solve(model.gravity_base)
        if free.ok:
            tip = free.p_at(probe.length)
            metrics["sag_mm"] = tip_sag(free, probe.rod, model.gravity_base) / MM
            metrics["reach_mm"] = float(np.linalg.norm(tip)) / MM
        return metrics

    def probe(self, x: Array) -> Probe:
        """Return the probe of a point, dimensions not rounded, so that its differences are smooth."""
        return build_probe(self.space.design(x[: self.space.size], _EXACT))

    def gradient(self, name: str, x: Array) -> Array:
        """Return the gradient of a metric by finite differences; those of all metrics need the same designs.

        The error consists of first derivatives of the rod, so its exact gradient would need second ones, which the rod
        lacks.
        """
        return finite_differences(lambda y: self.metrics(y)[name], x, central=name in ("mass_g", "length_mm"))


def finite_differences(f: Callable[[Array], float | Array], x: Array, central: bool) -> Array:
    """Return finite differences of a function of n numbers, (n,), or (n, m) of m functions."""
    columns, here = list[Array](), 0.0 if central else f(x)
    for i in range(len(x)):
        step = np.zeros(len(x))
        step[i] = STEP * max(abs(float(x[i])), 1.0)
        risen = (f(x + step) - f(x - step)) / 2.0 if central else f(x + step) - here
        columns.append(np.asarray(risen / step[i]))
    return np.array(columns)
