"""Technical drawings of the rigid parts: edges from the solids, dimensions from their data.

Each has a section on top, views from above and below under it, a table of its holes, and its fits.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from probedesign.cad.drawing import (
    BOTTOM,
    EDGE,
    STACK,
    WIDTH,
    Sheet,
    SheetView,
    engraving_note,
    number,
    scale_for,
    titled_sheet,
)
from probedesign.cad.model import CadModel, CadPart
from probedesign.cad.projection import ABOVE, BELOW, ViewDirection, cut, seen
from probedesign.core.units import MM
from probedesign.mount.engraving import XY
from probedesign.mount.flange_adapter import CENTRING_PIN_D, TIE_APART, TIE_SLOT
from probedesign.mount.sensor_adapter import PEG_D, RING_VENT_HEIGHT, SLIP, UNDERSIDE_DEG, VENT_WIDTH


@dataclass(frozen=True)
class Holes:
    """Equal holes, tagged in a view and described in the table."""

    points: Sequence[XY]  #: (x, y) of each [m].
    size: float  #: largest diameter [m].
    words: str  #: description of one hole.
    on_circle: bool = True  #: whether they form a hole circle that is drawn and dimensioned.

    @property
    def text(self) -> str:
        """Return the table's text: number, description, position."""
        count = f"{len(self.points)} × " if len(self.points) > 1 else ""
        degrees = (number(float(np.degrees(np.arctan2(y, x))) % 360.0) for x, y in self.points)
        circle = 2 * float(np.hypot(*self.points[0]))
        where = f", on ⌀{_mm(circle)} at {', '.join(f'{d}°' for d in degrees)}" if self.on_circle else ""
        return f"{count}{self.words}{where}"


def sensor_adapter_sheet(model: CadModel, part: CadPart) -> Sheet:
    """Return the drawing of the sensor adapter."""
    a = model.adapter
    bore, room = a.tool.screw.clearance_d, a.tool.screw.counterbore_d
    wider = a.roof_hole_d > a.ring_screw.clearance_d
    above_nut = f", ⌀{_mm(a.roof_hole_d)} above the slot" if wider else ""
    above = [
        Holes(a.p_tool_screws, room, f"⌀{_mm(bore)} through, ⌀{_mm(room)} from z = {_mm(a.tool.grip)} up"),
        Holes(a.p_ring_screws, a.ring_screw.clearance_d,
              f"⌀{_mm(a.ring_screw.clearance_d)} to z = {_mm(a.ring_hole_bottom)}{above_nut}"),
        Holes([(a.peg_x, 0.0)], PEG_D, f"peg ⌀{_mm(PEG_D)} at x = {_mm(a.peg_x)}, top at z = {_mm(a.peg_top)}", False),
    ]  # fmt: skip
    z0, z1 = a.nut_slot_z
    inner = a.ring_circle_d / 2 - a.nut_slot_reach
    size = f"{_mm(a.nut_slot_width)} wide, {_mm(z1 - z0)} high, {_mm(a.body_top - z1)} below the top"
    slot = f"slot {size}, round end about r = {_mm(inner)}"
    second = f"the second a slot {_mm(a.dowel_d)} × {_mm(a.dowel_d + a.dowel_slot)} towards the first"
    fit = " H7" if a.options.milled else ""
    below = [
        Holes(a.p_ring_screws, a.nut_slot_width, slot),
        Holes(a.p_dowels, a.dowel_d, f"⌀{_mm(a.dowel_d)}{fit}, {_mm(a.dowel_depth)} deep, {second}"),
    ]
    # What screws and clamp rely on is dimensioned by itself: the tolerance stack counts it as one length.
    heights = [*_from_datum(a.foot_height, a.cone_top, a.groove_floor, a.peg_top, a.body_top), (a.floor, a.body_top)]
    tops = [a.land_d, a.recess_d, a.body_d]
    notes = [
        "A: z = 0 rests on the sensor's tool face; positions are from A and from the axis",
        f"flat at x = {_mm(a.mark_x)} shows +x; underside at {UNDERSIDE_DEG:g}° to the horizontal",
        f"groove around the land ⌀{_mm(a.land_d)}, with a notch {_mm(VENT_WIDTH)} wide to the flat",
        f"fits: {_pin_fit(a.dowels.diameter, a.options.milled)}; ⌀{_mm(a.recess_d)} takes the probe's "
        f"flange ⌀{_mm(a.flange.diameter)} with {_mm(SLIP)} play",
        *engraving_note(a.on_wall, "the rim"),
    ]
    return _disc(model, part, (0.0, a.body_top), heights, _diameters(tops), _diameters([a.foot_d, a.cone_d]),
                 (above, below), notes)  # fmt: skip


def clamp_ring_sheet(model: CadModel, part: CadPart) -> Sheet:
    """Return the drawing of the clamp ring."""
    a = model.adapter
    top = a.ring_thickness
    hole_d = a.ring_screw.clearance_d
    above = [Holes(a.p_ring_screws, hole_d, f"⌀{_mm(hole_d)} through")]
    notes = [
        "A: z = 0 rests on the sensor adapter's rim and presses the flange of the probe",
        "the wide end of the bore faces the tip",
        f"notch {_mm(a.ring_vent_width)} wide and {_mm(RING_VENT_HEIGHT)} high at +x across the underside",
        *engraving_note(a.on_ring, "the top"),
    ]
    tops, bottoms = _diameters([a.ring_bore_top_d, a.body_d]), _diameters([a.ring_bore_d])
    return _disc(model, part, (0.0, top), _from_datum(top), tops, bottoms, (above, []), notes)


def flange_adapter_sheet(model: CadModel, part: CadPart) -> Sheet:
    """Return the drawing of the flange adapter."""
    p, bolt, screw = model.plate, model.plate.robot.screw, model.plate.mounting.screw
    milled = model.adapter.options.milled
    spigot_d, spigot = p.robot.spigot
    width, length = p.robot.pin_slot
    reach = p.robot.bolt_circle_d / 2
    above = [
        Holes(p.p_bolts, bolt.clearance_d, f"⌀{_mm(bolt.clearance_d)} through"),
        Holes(p.p_mounting_screws, screw.clearance_d, f"⌀{_mm(screw.clearance_d)} through"),
    ]
    slot = f"slot {_mm(width)} × {_mm(length)} through, middle at x = {_mm(reach)}: the robot's dowel pin"
    grip = p.plate_top - p.counterbore_top
    bore = f"counterbore ⌀{_mm(screw.counterbore_d)} from below, {_mm(grip)} of the plate above it"
    below = [Holes(p.p_mounting_screws, screw.counterbore_d, bore)]
    fits = []
    if p.p_centring_pins:
        d, bottom = p.centring_hole
        fit = " H7" if milled else ""
        above.append(Holes(p.p_centring_pins, d, f"⌀{_mm(d)}{fit} down to z = {_mm(bottom)}"))
        fits.append(_pin_fit(CENTRING_PIN_D, milled))
    radial, across = TIE_SLOT
    beside = float(np.hypot(*np.mean(p.p_tie_slots, axis=0)))
    tie = f"slot {_mm(radial)} × {_mm(across)} through, at {_mm(beside)} along {number(p.cable_deg)}°"
    above.append(Holes(p.p_tie_slots, across, f"{tie}, {_mm(TIE_APART)} apart across", False))
    if width:
        below.append(Holes([(reach, 0.0)], 0.0, slot, False))
        fits.append(f"slot {_mm(width)} takes a pin of {_mm(p.robot.pin_d)}")
    bottoms = [(spigot_d, " h9" if milled else ""), (p.plate_d, "")] if spigot else [(p.plate_d, "")]
    if spigot:
        fits.append(f"⌀{_mm(spigot_d)} enters ⌀{_mm(spigot_d + p.robot.spigot_play)} H7")
    (r0, r1), (v0, v1), (z0, z1) = p.cable_pocket
    notes = [
        f"A: z = 0 rests on the robot, {p.robot.source}; the sensor sits on the top face",
        f"pocket for the cable at {number(p.cable_deg)}°: r = {_mm(r0)} to {_mm(r1)}, {_mm(v1 - v0)} wide, "
        f"{_mm(z1 - z0)} deep",
        *([f"fits: {'; '.join(fits)}"] if fits else []),
        *engraving_note(p.on_plate, "the top"),
    ]
    heights = _from_datum(-spigot, p.plate_top) if spigot else _from_datum(p.plate_top)
    return _disc(model, part, (-spigot, p.plate_top), heights, [], bottoms, (above, below), notes)


def _pin_fit(diameter: float, milled: bool) -> str:
    """Return the fit of a dowel pin, which enters the sensor's hole by hand."""
    pin = f"pins ISO 2338 {_mm(diameter)} h8"
    return f"{pin} in {_mm(diameter)} H7" if milled else f"{pin}, by hand (assumed; drill if tight)"


def _from_datum(*heights: float) -> list[tuple[float, float]]:
    return [(min(0.0, h), max(0.0, h)) for h in heights]


def _diameters(values: Sequence[float]) -> list[tuple[float, str]]:
    return [(value, "") for value in values]


def _disc(
    model: CadModel, part: CadPart, z: tuple[float, float], heights: Sequence[tuple[float, float]],
    tops: Sequence[tuple[float, str]], bottoms: Sequence[tuple[float, str]],
    holes: tuple[list[Holes], list[Holes]], notes: list[str],
) -> Sheet:  # fmt: skip
    """Return the sheet of a flat part; all in [m]: its lowest and highest z, and what is dimensioned: pairs of heights,
    and diameters with their fits."""
    box = part.shape.BoundingBox()
    rim, low, high = max(box.xmax, -box.xmin, box.ymax), z[0] / MM, z[1] / MM
    scale = scale_for((2 * rim, high - low), (66.0, 60.0))
    sheet = titled_sheet(model, part, scale)
    top = EDGE + 14.0 + STACK * len(tops)
    section = SheetView(sheet, (WIDTH / 2, top + scale * high), scale)
    edges, faces = cut(part.shape)
    section.section(faces)
    section.outline(edges)
    section.axis((0.0, low), (0.0, high))
    for i, (below, above) in enumerate(sorted(heights, key=lambda ends: ends[1] - ends[0]), 1):
        section.dimension_v(below / MM, above / MM, rim, STACK * i, _mm(above - below))
    for diameters, v, side in ((tops, high, 1.0), (bottoms, low, -1.0)):
        for i, (d, fit) in enumerate(sorted(diameters), 1):
            section.dimension_u(-d / 2 / MM, d / 2 / MM, v, side * STACK * i, f"⌀{_mm(d)}{fit}")
    section.datum((-rim, 0.0), "A", 8.0)
    section.caption("C–C, the plane y = 0", low, STACK * len(bottoms) + 9.0)
    if holes[1]:
        section.viewing_arrow((rim + 3.0 / scale, low), "B")
    middle = section.at((0.0, low))[1] + STACK * len(bottoms) + 9.0 + 20.0 + scale * rim
    _plans(sheet, part, holes, (rim, scale, middle))
    text = [f"{label}: {hole.text}" for label, hole in _numbered([*holes[0], *holes[1]])]
    sheet.note((EDGE + 6.0, BOTTOM - 5.0 * (len(text) + len(notes))), [*text, *notes])
    return sheet


def _plans(
    sheet: Sheet, part: CadPart, holes: tuple[list[Holes], list[Holes]], where: tuple[float, float, float]
) -> None:
    """Draw the views from above and, if it has holes to show, from below, at one height of the paper."""
    rim, scale, y = where
    labelled = _numbered([*holes[0], *holes[1]])
    views: list[tuple[str, ViewDirection, list[tuple[str, Holes]]]] = [("from above", ABOVE, labelled[: len(holes[0])])]
    if holes[1]:
        views.append(("B (from below)", BELOW, labelled[len(holes[0]) :]))
    for i, (name, side, tagged) in enumerate(views):
        view = SheetView(
            sheet, (WIDTH * (2 * i + 1) / (2 * len(views)) + (5.0 - 10.0 * i) * (len(views) - 1), y), scale
        )
        view.outline(seen(part.shape, side))
        view.cross(rim)
        if side is ABOVE:
            view.cutting_plane(rim, 0.0, "C")
        flip = -1.0 if side is BELOW else 1.0
        taken: list[complex] = []
        for label, hole in tagged:
            points = [(x / MM, flip * v / MM) for x, v in hole.points]
            if hole.on_circle:
                view.bolt_circle(2 * float(np.hypot(*points[0])))
            view.centres(points, 0.6 * hole.size / MM)
            chosen = _free(points, taken)
            taken.append(complex(*chosen))
            view.tag(chosen, rim, label)
        view.caption(f"{name}, +x to the right", -rim, 18.0)


def _free(points: Sequence[XY], taken: Sequence[complex]) -> XY:
    """Return the point whose direction from the centre is farthest from those taken, so that tags do not overlap."""

    def room(p: XY) -> float:
        return min((abs(float(np.angle(complex(*p) / other))) for other in taken), default=np.pi)

    return max(points, key=lambda p: round(room(p), 6))


def _numbered(holes: Iterable[Holes]) -> list[tuple[str, Holes]]:
    return [(str(i), hole) for i, hole in enumerate(holes, 1)]


def _mm(value: float) -> str:
    return number(value / MM)
