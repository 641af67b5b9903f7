"""Design space: diameters of a cone or a free taper, length and section ratio as a vector of a few numbers."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from scipy.interpolate import make_interp_spline

from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.design import Design, check_design
from probedesign.design.schema import MAX_DIAMETER_MM, MIN_DIAMETER_MM
from probedesign.geometry import flange_for
from probedesign.mount import max_ring_passage_d
from probedesign.optimization.grid import design_dict
from probedesign.printing import check as limits

FreeParameter = Literal["cone", "taper", "length", "section"]
CONTROLS = 5
"""Number of control diameters of a free taper, evenly spaced along the probe."""
FRUSTA = 11
"""Number of frusta of a free taper: none of the usual contact positions lies on a knot between two."""
LENGTH_MM, RATIO = (20.0, 400.0), (0.2, 0.9)
_UNIT = {"length": 10.0, "section": 0.1}
"""Units of the coordinates, chosen so that all of them are between one and fifty."""
_ROUNDING_MARGIN = 2e-3
"""Margin of a rule's limit where a ratio varies: it is rounded like the diameters and must not violate the rule."""
DIGITS = 3
"""Decimals of a millimetre in a design file; no printer resolves the thousandth."""


@dataclass(frozen=True)
class DesignSpace:
    """Designs that differ from a start in their flexible part alone.

    A point x: control diameters [mm], evenly from base to tip; then, if they are free, the length [cm] and ten times
        the
    section's ratio. A free taper is the cubic spline through its control diameters, linear in them.

    Attributes:
        start: the design that the others differ from.
        controls: number of control diameters; 2 is a cone, 0 leaves the diameters unchanged.
        free: what varies.
    """

    start: Design
    controls: int
    free: tuple[FreeParameter, ...]

    @classmethod
    def of(cls, start: Design, free: tuple[FreeParameter, ...]) -> "DesignSpace":
        """Return the design space about a design.

        Raises:
            InputError: the section has nothing to vary, or both a cone and a taper are requested.
        """
        if "cone" in free and "taper" in free:
            raise InputError(
                "--over cone and --over taper contradict: a cone is one of the tapers; name one of them"
            )
        if "section" in free and start.probe.section == "round":
            raise InputError(
                "--over section: a round section has nothing to vary; start from a hollow or elliptic one"
            )
        if "taper" in free and start.probe.tip == "rounded":
            raise InputError('--over taper: is of blunt tips; start from tip = "blunt"')
        return cls(start, CONTROLS if "taper" in free else 2 if "cone" in free else 0, free)

    @property
    def size(self) -> int:
        """Dimension of x."""
        return self.controls + ("length" in self.free) + ("section" in self.free)

    @property
    def ratio_key(self) -> str:
        """Key of the section's ratio in the design file."""
        return "bore_ratio" if self.start.probe.section == "hollow" else "flatness"

    @cached_property
    def spline(self) -> Array:
        """Matrix from control diameters to diameters at the knots, (knots, controls)."""
        at = np.linspace(0.0, 1.0, self.controls)
        to = at if self.controls == 2 else np.linspace(0.0, 1.0, FRUSTA + 1)
        drawn: Array = make_interp_spline(at, np.eye(self.controls), k=min(3, self.controls - 1))(to)
        return drawn

    def x_of(self, design: Design) -> Array:
        """Return the nearest point to a design: its diameters at the controls."""
        knots = np.array(design.probe.blunt_mm)
        at = np.linspace(0.0, knots[-1, 0], self.controls)
        x = list(np.interp(at, knots[:, 0], knots[:, 1]))
        if "length" in self.free:
            x.append(design.probe.length_mm / _UNIT["length"])
        if "section" in self.free:
            x.append(getattr(design.probe, self.ratio_key) / _UNIT["section"])
        return np.array(x)

    def length_mm(self, x: Array) -> float:
        """Return the length of a point [mm]."""
        return (
            float(x[self.controls] * _UNIT["length"]) if "length" in self.free else self.start.probe.length_mm
        )

    def ratio(self, x: Array) -> float | None:
        """Return the section's ratio, None where it is round."""
        if "section" in self.free:
            return float(x[-1] * _UNIT["section"])
        return getattr(self.start.probe, self.ratio_key, None)

    def knots_mm(self, x: Array) -> tuple[Array, Array]:
        """Return arclengths and diameters [mm], (knots,) each."""
        if not self.controls:
            s, d = np.array(self.start.probe.blunt_mm).T
            return s * (self.length_mm(x) / s[-1]), d
        d = self.spline @ x[: self.controls]
        return np.linspace(0.0, self.length_mm(x), len(d)), d

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Lower and upper bound of each coordinate."""
        found = [(max(MIN_DIAMETER_MM, 0.8 * limits.MIN_THICKNESS), MAX_DIAMETER_MM)] * self.controls
        for name, (low, high) in {"length": LENGTH_MM, "section": RATIO}.items():
            if name in self.free:
                found.append((low / _UNIT[name], high / _UNIT[name]))
        return found

    def printable(self, x: Array) -> dict[str, Array]:
        """Return the margins of the print rules; 0 is the limit below which they report an error.

        The margins are at most quadratic in x, so their central differences are exact.
        """
        s, d = self.knots_mm(x)
        ratio, hollow = self.ratio(x), self.start.probe.section == "hollow"
        thin = d * (ratio if ratio is not None and not hollow else 1.0)
        steepest = math.tan(math.radians(limits.MIN_OVERHANG))
        rules = {
            "print rule smallest_feature": thin / limits.MIN_THICKNESS - 1.0,
            "print rule slenderness": (thin[:-1] - limits.MIN_SLENDERNESS * (s[-1] - s[:-1]))
            / limits.MIN_THICKNESS,
            "print rule overhang": (np.diff(s) - steepest * np.diff(d) / 2.0) / s[-1],
        }
        if hollow and ratio is not None:
            rules["print rule wall"] = (1.0 - ratio) * d / 2.0 / limits.SUPPORTED_WALL - 1.0
            rules["print rule hole"] = ratio * d / limits.MIN_HOLE_D - 1.0
        if self.controls > 2:
            flange = flange_for(d[0] * MM, self.start.sensor_model.interface.tool.face_d)
            rules["room for the clamp ring"] = (max_ring_passage_d(flange) / MM - d) / limits.MIN_THICKNESS
        if self.controls == 2:
            rules["a cone that tapers"] = (d[:-1] - d[1:]) / limits.MIN_THICKNESS
        spare = _ROUNDING_MARGIN if "section" in self.free else 0.0
        return {name: room - spare for name, room in rules.items()}

    def tables(self, x: Array, digits: int) -> dict[str, Any]:
        """Return the tables of the design file of a point, dimensions rounded to the given decimals of a millimetre."""
        s, d = self.knots_mm(x)
        s, d = np.round(s, digits).tolist(), (np.round(d, digits) if self.controls else d).tolist()
        data = design_dict(self.start)
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
        return data

    def design(self, x: Array, digits: int = DIGITS) -> Design:
        """Return the design of a point.

        Raises:
            InputError: the design is invalid.
        """
        return check_design(self.tables(x, digits))
