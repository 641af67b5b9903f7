"""What of a design may change, as a few numbers: diameters of a cone or of a free taper, length, section."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from scipy.interpolate import make_interp_spline

from probedesign.design import Design, check_design
from probedesign.design_tables import MAX_DIAMETER_MM, MIN_DIAMETER_MM
from probedesign.errors import InputError
from probedesign.frames import Array
from probedesign.geometry import flange_for
from probedesign.mount import max_ring_passage_d
from probedesign.printing import rules as limits
from probedesign.search.grid import tables_of
from probedesign.units import MM

Free = Literal["cone", "taper", "length", "section"]
CONTROLS = 5
"""Diameters that a free taper is drawn through, evenly along the probe."""
PIECES = 11
"""Frusta that a free taper is made of: none of the usual places of touch lies on a knot between two."""
LENGTH_MM, RATIO = (20.0, 400.0), (0.2, 0.9)
_UNIT = {"length": 10.0, "section": 0.1}
"""Of the numbers, so that all of them are between one and fifty."""
_ROUNDED = 2e-3
"""Of a rule's limit, kept free where a ratio varies: rounded like the diameters, it must not break the rule."""
DIGITS = 3
"""Of a millimetre, in a design file: no printer knows the thousandth."""


@dataclass(frozen=True)
class Body:
    """The family of designs that differ from one in its body alone.

    A point x of the family: control diameters [mm], evenly from base to tip; then, if they are free, the length [cm]
    and ten times the section's ratio. A free taper is the cubic spline through its diameters: linear in them.

    Attributes:
        start: the design that it is about.
        controls: how many diameters; 2 is a cone, 0 where they stay as they are.
        free: what varies.
    """

    start: Design
    controls: int
    free: tuple[Free, ...]

    @classmethod
    def of(cls, start: Design, free: tuple[Free, ...]) -> "Body":
        """The family of a design.

        Raises:
            InputError: the section has nothing to vary, or a cone and a taper are asked for at once.
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
        """Of x."""
        return self.controls + ("length" in self.free) + ("section" in self.free)

    @property
    def ratio_key(self) -> str:
        """Of the section."""
        return "bore_ratio" if self.start.probe.section == "hollow" else "flatness"

    @cached_property
    def spline(self) -> Array:
        """From control diameters to those at the knots, (knots, controls)."""
        at = np.linspace(0.0, 1.0, self.controls)
        to = at if self.controls == 2 else np.linspace(0.0, 1.0, PIECES + 1)
        drawn: Array = make_interp_spline(at, np.eye(self.controls), k=min(3, self.controls - 1))(to)
        return drawn

    def x_of(self, design: Design) -> Array:
        """The nearest point of the family: the design's diameters where the controls are."""
        knots = np.array(design.probe.blunt_mm)
        at = np.linspace(0.0, knots[-1, 0], self.controls)
        x = list(np.interp(at, knots[:, 0], knots[:, 1]))
        if "length" in self.free:
            x.append(design.probe.length_mm / _UNIT["length"])
        if "section" in self.free:
            x.append(getattr(design.probe, self.ratio_key) / _UNIT["section"])
        return np.array(x)

    def length_mm(self, x: Array) -> float:
        """[mm]."""
        return (
            float(x[self.controls] * _UNIT["length"]) if "length" in self.free else self.start.probe.length_mm
        )

    def ratio(self, x: Array) -> float | None:
        """Of the section, None where it is round."""
        if "section" in self.free:
            return float(x[-1] * _UNIT["section"])
        return getattr(self.start.probe, self.ratio_key, None)

    def knots_mm(self, x: Array) -> tuple[Array, Array]:
        """Arclengths and diameters [mm], (knots,) each."""
        if not self.controls:
            s, d = np.array(self.start.probe.blunt_mm).T
            return s * (self.length_mm(x) / s[-1]), d
        d = self.spline @ x[: self.controls]
        return np.linspace(0.0, self.length_mm(x), len(d)), d

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Least and most of each number."""
        found = [(max(MIN_DIAMETER_MM, 0.8 * limits.MIN_THICKNESS), MAX_DIAMETER_MM)] * self.controls
        for name, (low, high) in {"length": LENGTH_MM, "section": RATIO}.items():
            if name in self.free:
                found.append((low / _UNIT[name], high / _UNIT[name]))
        return found

    def printable(self, x: Array) -> dict[str, Array]:
        """How far the rules of printing are kept, 0 at the limit below which they call an error.

        At most quadratic in x, so their central differences are exact.
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
            rules["room for the clamp ring"] = (_widest_mm(d[0]) - d) / limits.MIN_THICKNESS
        if self.controls == 2:
            rules["a cone that tapers"] = (d[:-1] - d[1:]) / limits.MIN_THICKNESS
        spare = _ROUNDED if "section" in self.free else 0.0
        return {name: room - spare for name, room in rules.items()}

    def tables(self, x: Array, digits: int) -> dict[str, Any]:
        """The tables of its design file, dimensions rounded to so many digits of a millimetre."""
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
        return data

    def design(self, x: Array, digits: int = DIGITS) -> Design:
        """The design there.

        Raises:
            InputError: no design may be so.
        """
        return check_design(self.tables(x, digits))


def _widest_mm(base_d_mm: float) -> float:
    """Over which the clamp ring comes that holds the flange of such a base [mm]."""
    return max_ring_passage_d(flange_for(base_d_mm * MM)) / MM
