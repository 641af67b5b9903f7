"""Rules of the flexible part and its flange."""

import math

import numpy as np

from probedesign.frames import Array
from probedesign.geometry import ProbeGeometry
from probedesign.mount import SensorAdapter
from probedesign.printing import limits
from probedesign.printing.rule import Finding
from probedesign.units import MM

PART = "probe"


def probe_findings(geometry: ProbeGeometry) -> list[Finding]:
    """What the rules say of the body above the flange, as drawn."""
    s, d = geometry.s / MM, 2.0 * geometry.radius / MM
    thin = geometry.cross_section.flatness * d
    flank = s <= geometry.flank_end / MM  # a round end is no wire
    findings = [
        _tip(s[flank], thin[flank]),
        _slenderness(s, thin),
        _overhang(s, d, geometry.cross_section.bore_ratio),
    ]
    if geometry.cross_section.hollow:
        findings += _bore(s, d, geometry.cross_section.bore_ratio)
    return findings


def flange_findings(adapter: SensorAdapter) -> list[Finding]:
    """What the rules say of the flange with the hole of the clocking mark."""
    flange, hole = adapter.flange, adapter.peg_hole_d
    web = (flange.diameter / 2 - adapter.peg_x - hole / 2) / MM
    held, free = limits.HELD_WALL, limits.FREE_WALL
    return [
        limits.SOFT_WALL.at_least(
            PART, "flange thickness", flange.thickness / MM, limits.SOFT * free, free, "make it thicker"
        ),
        limits.SOFT_WALL.at_least(
            PART, "flange between the clocking hole and its rim", web, limits.SOFT * held, held,
            "look at it after washing: it may tear or close up",
        ),
        limits.SOFT_HOLE.at_least(
            PART, "clocking hole in the flange", hole / MM, limits.SOFT * limits.HOLE, limits.HOLE,
            "open it with a drill by hand",
        ),
    ]  # fmt: skip


def _tip(s: Array, thin: Array) -> Finding:
    i = int(np.argmin(thin))
    return limits.SMALLEST_FEATURE.at_least(
        PART, f"thickness at s = {s[i]:g} mm, the least", float(thin[i]), limits.TIP,
        remedy=f"make it {limits.TIP:g} mm there",
    )  # fmt: skip


def _slenderness(s: Array, thin: Array) -> Finding:
    """Each piece beyond a knot is a wire that stands on it; between knots the ratio has no least value."""
    height = s[-1] - s[:-1]
    ratio = thin[:-1] / height
    i = int(np.argmin(ratio))
    wanted = math.ceil(10 * limits.SLENDER * height[i]) / 10
    return limits.SLENDERNESS.at_least(
        PART, f"diameter at s = {s[i]:g} mm over the {height[i]:g} mm that stand on it", float(ratio[i]),
        limits.SLENDER, limits.TOO_SLENDER,
        remedy=f"{wanted:g} mm there, or {thin[i] / limits.SLENDER:.3g} mm of length on it, keep the rule",
    )  # fmt: skip


def _overhang(s: Array, d: Array, bore_ratio: float) -> Finding:
    """The flattest surface that looks down: outside where it swells, inside a bore where it narrows."""
    rise, out = np.diff(s), np.diff(d) / 2.0
    lean = np.maximum(out, -bore_ratio * out)
    angle = np.degrees(np.arctan2(rise, lean.clip(0.0)))
    i = int(np.argmin(angle))
    least = 2.0 * rise[i] / (1.0 if out[i] >= 0.0 else bore_ratio or 1.0)  # 45 degrees
    return limits.NO_OVERHANG.at_least(
        PART, f"surface from s = {s[i]:g} to {s[i + 1]:g} mm that looks down, above the horizontal by",
        float(angle[i]), limits.SOFT_OVERHANG, limits.OVERHANG,
        remedy=f"supports would have to stand on it: change the diameter by at most {least:.3g} mm there",
    )  # fmt: skip


def _bore(s: Array, d: Array, bore_ratio: float) -> list[Finding]:
    i = int(np.argmin(d))
    wall, bore = (1.0 - bore_ratio) * d[i] / 2.0, bore_ratio * d[i]
    at = f"at s = {s[i]:g} mm"
    held = limits.HELD_WALL
    return [
        limits.SOFT_WALL.at_least(
            PART, f"wall {at}", float(wall), limits.SOFT * held, held, "take a smaller bore_ratio or a wider tip"
        ),
        limits.SOFT_HOLE.at_least(
            PART, f"bore {at}", float(bore), limits.SOFT * limits.HOLE, limits.HOLE,
            "take a larger bore_ratio or a wider tip",
        ),
        limits.TRAPPED_VOLUME.at_least(
            PART, f"bore {at}, through which resin drains,", float(bore), limits.DRAIN, 0.0,
            "flush it with a syringe before curing",
        ),
    ]  # fmt: skip
