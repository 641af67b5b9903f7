"""Inspection sheet of each printed part: edges from the solid, and the dimensions that calipers check, from the data.

A rigid part has a section on top, views from above and below under it, a table of its holes, and its accepted ranges;
the probe stands upright, with the underside of its flange beside it.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from probedesign.cad.model import CadModel, CadPart
from probedesign.cad.sheet import (
    ABOVE,
    BELOW,
    BOTTOM,
    CHAIN,
    EDGE,
    FRONT,
    LINE,
    SAME_MM,
    SIDE,
    SMALL,
    STACK,
    TEXT,
    THIN,
    WIDTH,
    View,
    cut,
    note,
    page,
    rows_of,
    scale_for,
    scale_text,
    seen,
)
from probedesign.core.frames import Array
from probedesign.core.svg import Canvas, number
from probedesign.core.units import MM
from probedesign.design.catalog import RIGID_RESIN
from probedesign.geometry.probe_geometry import DEVIATION_MM, filleted, rounding_radius_mm
from probedesign.mount.engraving import DEPTH, HEIGHT, XY, Engraving
from probedesign.mount.flange_adapter import CENTRING_PIN_D, TIE_APART, TIE_SLOT
from probedesign.mount.sensor_adapter import PEG_D, RING_VENT_HEIGHT, SLIP, UNDERSIDE_DEG, VENT_WIDTH
from probedesign.mount.tolerance_stack import measurements

#: Tolerance of a stereolithography print; the manufacturer publishes none for the soft resin.
TOLERANCE = "printed to ±0.5 %, at least ±0.15 mm (assumed)"


#: Between views side by side, and room for the caption of a narrow one [mm of paper].
VIEWS_APART, CAPTION_WIDTH = 22.0, 50.0


def inspection_sheets(model: CadModel) -> dict[str, bytes]:
    """Return the SVG file of each printed part's sheet, by name."""
    sheets = {"probe": probe_sheet, "sensor_adapter": sensor_adapter_sheet, "clamp_ring": clamp_ring_sheet,
              "flange_adapter": flange_adapter_sheet}  # fmt: skip
    return {f"{name}.svg": bytes(draw(model, model.parts[name])) for name, draw in sheets.items()}


def _page(model: CadModel, part: CadPart, scale: float) -> Canvas:
    resin = model.design.resin.name if part.name == "probe" else RIGID_RESIN
    grams = 1e3 * part.body.mass
    frame, date = part.frame.replace("_", " "), model.design.date or ""
    names = [printed.name for printed in model.printed]
    number_of = f"number {model.fingerprints[part.name]} · sheet {names.index(part.name) + 1} of {len(names)}"
    return page(f"{model.design.name}: {part.name.replace('_', ' ')}", [
        f"{number_of} · {resin} · {grams:.3g} g · {part.name}.stl",
        f"scale {scale_text(scale)}, in mm · {frame} frame, angles about +z from +x · date: {date or 'not stated'}",
        f"{TOLERANCE} · owner: {model.design.owner or 'not stated'}",
    ])  # fmt: skip


def _mm(value: float) -> str:
    return number(value / MM)


def _engraved(engraving: Engraving, where: str) -> list[str]:
    size = f"{_mm(HEIGHT)} high, {_mm(DEPTH)} deep"
    return [f"engraved on {where}: {engraving.text}, {size}"] if engraving.text else []


def _accepted(model: CadModel, part: str) -> list[str]:
    return [
        f"{row.what.partition(': ')[2]}: {_mm(row.nominal)}, accept {_mm(row.accept[0])} … {_mm(row.accept[1])}"
        for row in measurements(model.adapter, model.plate)
        if row.what.startswith(f"{part}: ")
    ]


# ---- rigid parts


def _holes(points: Sequence[XY], words: str, on_circle: bool = True) -> str:
    """Return the row of equal holes at (x, y) [m]: number, description of one, and position on their circle."""
    count = f"{len(points)} × " if len(points) > 1 else ""
    degrees = (number(float(np.degrees(np.arctan2(y, x))) % 360.0) for x, y in points)
    circle = 2 * float(np.hypot(*points[0]))
    where = f", on ⌀{_mm(circle)} at {', '.join(f'{d}°' for d in degrees)}" if on_circle else ""
    return f"{count}{words}{where}"


def sensor_adapter_sheet(model: CadModel, part: CadPart) -> Canvas:
    """Return the sheet of the sensor adapter."""
    a = model.adapter
    bore, room, screw_d = a.tool.screw.clearance_d, a.tool.screw.counterbore_d, a.ring_screw.clearance_d
    above_nut = f", ⌀{_mm(a.roof_hole_d)} above the slot" if a.roof_hole_d > screw_d else ""
    ring = a.tool.bolt_circle_d > 0.0
    head = f"⌀{_mm(bore)} through, ⌀{_mm(room)} from z = {_mm(a.tool.grip)} up"
    above = [
        _holes(a.p_tool_screws, f"{head}{'' if ring else ', on the axis'}", ring),
        _holes(a.p_ring_screws, f"⌀{_mm(screw_d)} to z = {_mm(a.ring_hole_bottom)}{above_nut}"),
        f"peg ⌀{_mm(PEG_D)} at x = {_mm(a.peg_x)}, top at z = {_mm(a.peg_top)}",
    ]
    z0, z1 = a.nut_slot_z
    slot = (
        f"slot {_mm(a.nut_slot_width)} wide, {_mm(z1 - z0)} high, {_mm(a.body_top - z1)} below the top, round end "
        f"about r = {_mm(a.ring_circle_d / 2 - a.nut_slot_reach)}"
    )
    slotted = f", the second a slot {_mm(a.dowel_d)} × {_mm(a.dowel_d + a.dowel_slot)} towards the first"
    below = [_holes(a.p_ring_screws, slot)]
    if a.p_dowels:
        blind = f"⌀{_mm(a.dowel_d)}, {_mm(a.dowel_depth)} deep"
        below.append(_holes(a.p_dowels, f"{blind}{slotted if len(a.p_dowels) > 1 else ''}"))
    heights = [*_from_face(a.foot_height, a.cone_top, a.groove_floor, a.peg_top, a.body_top), (a.floor, a.body_top)]
    notes = [
        f"z = 0 rests on the sensor's tool face; the flat at x = {_mm(a.mark_x)} shows +x",
        f"underside at {UNDERSIDE_DEG:g}°; groove around the land ⌀{_mm(a.land_d)}, notch {_mm(VENT_WIDTH)} wide to "
        f"the flat, window {_mm(2 * a.window_half)} wide to the rim at -x, both down to the groove",
        *([f"pins {_mm(a.dowels.diameter)} h8 enter by hand (assumed; drill if tight)"] if a.p_dowels else []),
        f"⌀{_mm(a.recess_d)} takes the flange ⌀{_mm(a.flange.diameter)} with {_mm(SLIP)} play",
        *_engraved(a.on_wall, "the rim"),
    ]
    return _disc(model, part, (0.0, a.body_top), heights, ([a.land_d, a.recess_d, a.body_d], [a.foot_d, a.cone_d]),
                 (above, below), notes)  # fmt: skip


def clamp_ring_sheet(model: CadModel, part: CadPart) -> Canvas:
    """Return the sheet of the clamp ring."""
    a = model.adapter
    notes = [
        "z = 0 rests on the sensor adapter's rim and presses the flange of the probe",
        "the wide end of the bore faces the tip",
        f"notch {_mm(a.ring_vent_width)} wide and {_mm(RING_VENT_HEIGHT)} high at +x across the underside",
        *_engraved(a.on_ring, "the top"),
    ]
    return _disc(model, part, (0.0, a.ring_thickness), _from_face(a.ring_thickness),
                 ([a.ring_bore_top_d, a.body_d], [a.ring_bore_d]),
                 ([_holes(a.p_ring_screws, f"⌀{_mm(a.ring_screw.clearance_d)} through")], []), notes)  # fmt: skip


def flange_adapter_sheet(model: CadModel, part: CadPart) -> Canvas:
    """Return the sheet of the flange adapter."""
    p, bolt, screw = model.plate, model.plate.robot.screw, model.plate.mounting.screw
    spigot_d, spigot = p.robot.spigot
    width, length = p.robot.pin_slot
    grip = p.plate_top - p.counterbore_top
    above = [
        _holes(p.p_bolts, f"⌀{_mm(bolt.clearance_d)} through"),
        _holes(p.p_mounting_screws, f"⌀{_mm(screw.clearance_d)} through"),
    ]
    bore = f"counterbore ⌀{_mm(screw.counterbore_d)}, {_mm(grip)} of the plate above it"
    below = [_holes(p.p_mounting_screws, bore)]
    fits = []
    if p.p_centring_pins:
        d, bottom = p.centring_hole
        above.append(_holes(p.p_centring_pins, f"⌀{_mm(d)} down to z = {_mm(bottom)}"))
        fits.append(f"pins {_mm(CENTRING_PIN_D)} h8 enter by hand (assumed; drill if tight)")
    radial, across = TIE_SLOT
    beside = float(np.hypot(*np.mean(p.p_tie_slots, axis=0)))
    tie = f"slot {_mm(radial)} × {_mm(across)} through, at {_mm(beside)} along {number(p.cable_deg)}°"
    above.append(_holes(p.p_tie_slots, f"{tie}, {_mm(TIE_APART)} apart across", False))
    if width:
        middle = f"middle at x = {_mm(p.robot.bolt_circle_d / 2)}: pin of {_mm(p.robot.pin_d)}"
        below.append(f"slot {_mm(width)} × {_mm(length)} through, {middle}")
    if spigot:
        fits.append(f"⌀{_mm(spigot_d)} enters ⌀{_mm(spigot_d + p.robot.spigot_play)} H7")
    (r0, r1), (v0, v1), (z0, z1) = p.cable_pocket
    notes = [
        f"z = 0 rests on the robot, {p.robot.source}; the sensor sits on the top face",
        f"pocket for the cable at {number(p.cable_deg)}°: r = {_mm(r0)} to {_mm(r1)}, {_mm(v1 - v0)} wide, "
        f"{_mm(z1 - z0)} deep",
        *(["; ".join(fits)] if fits else []),
        *_engraved(p.on_plate, "the top"),
    ]
    heights = _from_face(-spigot, p.plate_top) if spigot else _from_face(p.plate_top)
    return _disc(model, part, (-spigot, p.plate_top), heights, ([], [spigot_d, p.plate_d] if spigot else [p.plate_d]),
                 (above, below), notes)  # fmt: skip


def _from_face(*heights: float) -> list[tuple[float, float]]:
    return [(min(0.0, h), max(0.0, h)) for h in heights]


def _disc(
    model: CadModel, part: CadPart, z: tuple[float, float], heights: Sequence[tuple[float, float]],
    diameters: tuple[list[float], list[float]], holes: tuple[list[str], list[str]], notes: list[str],
) -> Canvas:  # fmt: skip
    """Return the sheet of a flat part; all in [m]: its lowest and highest z, the pairs of heights and the diameters
    that are dimensioned above and below its section, and the rows of the holes that are seen from above and below."""
    box = part.shape.BoundingBox()
    rim, low, high = max(box.xmax, -box.xmin, box.ymax), z[0] / MM, z[1] / MM
    scale = scale_for((2 * rim, high - low), (66.0, 60.0))
    sheet = _page(model, part, scale)
    section = View(sheet, (WIDTH / 2, EDGE + 14.0 + STACK * len(diameters[0]) + scale * high), scale)
    edges, faces = cut(part.shape)
    section.section(faces)
    section.outline(edges)
    section.axis(low, high)
    for i, (below, above) in enumerate(sorted(heights, key=lambda ends: ends[1] - ends[0]), 1):
        section.dimension_v(
            below / MM, above / MM, rim, STACK * i, _mm(above - below), below=below == z[0] < above < z[1]
        )
    for values, v, side in ((diameters[0], high, 1.0), (diameters[1], low, -1.0)):
        for i, d in enumerate(sorted(values), 1):
            section.dimension_u(-d / 2 / MM, d / 2 / MM, v, side * STACK * i, f"⌀{_mm(d)}")
    drop = STACK * len(diameters[1]) + 9.0
    section.caption("section in the plane y = 0, +x to the right", low, drop)
    middle = section.at((0.0, low))[1] + drop + 10.0 + scale * rim
    views = [("from above", ABOVE, holes[0]), *([("from below", BELOW, holes[1])] if holes[1] else [])]
    for i, (name, direction, _) in enumerate(views):
        view = View(sheet, (WIDTH * (2 * i + 1) / (2 * len(views)), middle), scale)
        view.outline(seen(part.shape, direction))
        view.cross(rim)
        view.caption(f"{name}, +x to the right", -rim, 8.0)
    lines = [*(f"{name}: {row}" for name, _, table in views for row in table), *notes,
             *_accepted(model, part.name.replace("_", " "))]  # fmt: skip
    rows = rows_of(lines, WIDTH - 2 * EDGE - 6.0)
    note(sheet, (EDGE + 6.0, BOTTOM - LINE * TEXT * len(rows)), rows)
    return sheet


# ---- probe


NOTE_SPACING = 7.0  #: Minimum distance between two notes [mm of paper].
SIDE_X, SIDE_ROOM = 163.0, 42.0  #: Middle of the views beside the probe, and the width of each [mm of paper].


def probe_sheet(model: CadModel, part: CadPart) -> Canvas:
    """Return the sheet of the probe."""
    g = model.geometry
    if g.curved is not None:
        return _curved_probe_sheet(model, part)
    length, rim, thick = g.length / MM, g.flange.diameter / MM, g.flange.thickness / MM
    scale = scale_for((rim, length + thick), (70.0, BOTTOM - EDGE - 54.0))
    sheet = _page(model, part, scale)
    front = View(sheet, (88.0, (EDGE + BOTTOM) / 2 - 4.0 + scale * (length - thick) / 2), scale)
    edges, faces = cut(part.shape) if g.cross_section.hollow else (seen(part.shape, FRONT), [])
    probe = model.design.probe
    fillet = 0.0 if probe.base_fillet_mm is None else filleted(probe.blunt_mm, probe.base_fillet_mm)[1]
    rounded = [(0.0, fillet), (g.flank_end / MM, length)]  # approximated by facets, whose edges are not drawn

    def facet(line: Array) -> bool:
        low, high = float(line[:, 1].min()), float(line[:, 1].max())
        return high - low < SAME_MM and any(a + SAME_MM < low < b - SAME_MM for a, b in rounded)

    front.section(faces)
    front.outline([line for line in edges if not facet(line)])
    front.axis(-thick, length)
    front.dimension_v(0.0, length, rim / 2, 2 * STACK, number(length), top_u=g.tip_radius / MM)
    front.dimension_v(-thick, 0.0, rim / 2, STACK, number(thick))
    front.dimension_u(-rim / 2, rim / 2, -thick, -STACK, f"⌀{number(rim)}")
    for s, r, words in _stations(model, NOTE_SPACING / scale):
        front.leader((-r, s), (-10.0 - scale * (rim / 2 - r), 5.0), words)
    side = "section in the plane y = 0" if g.cross_section.hollow else "from the front"
    front.caption(f"{side}, +x to the right", -thick, 20.0)
    _underside(model, part, sheet)
    return sheet


def _curved_probe_sheet(model: CadModel, part: CadPart) -> Canvas:
    """Return the sheet of a curved probe: outlines from two sides to lay a print or a photograph on, and points of its
    axis."""
    g, box = model.geometry, part.shape.BoundingBox()
    spans = ((box.xmin, box.xmax), (box.ymin, box.ymax))
    room = WIDTH - 2 * EDGE - 2 * VIEWS_APART
    scale = scale_for((sum(high - low for low, high in spans), box.zmax - box.zmin), (room, BOTTOM - EDGE - 100.0))
    sheet, left = _page(model, part, scale), EDGE + VIEWS_APART
    zero, foot = EDGE + 10.0 + scale * box.zmax, EDGE + 10.0 + scale * (box.zmax - box.zmin)
    line = g.axis.frames(np.linspace(0.0, g.length, 65))[:, :3, 3] / MM
    for k, words in enumerate(("from the front, +x to the right", "from +x, +y to the right")):
        low, high = spans[k]
        view = View(sheet, (left - scale * low, zero), scale)
        view.outline(seen(part.shape, (FRONT, SIDE)[k]))
        sheet.polylines([[view.at((float(p[k]), float(p[2]))) for p in line]], THIN, dashes=CHAIN)
        sheet.text((left + scale * (high - low) / 2, foot + 8.0), f"{words}, {scale_text(scale)}", TEXT, bold=True)
        left += max(scale * (high - low), CAPTION_WIDTH) + VIEWS_APART
    s = np.linspace(0.0, g.length, 9)
    points = np.column_stack([s / MM, g.axis.frames(s)[:, :3, 3] / MM, 2.0 * g.radius_at(s) / MM])
    full = "" if scale == 1.0 else f"; printed at {100.0 / scale:g} % they are of the size of the part"
    lines = [
        f"outlines are drawn {scale_text(scale)}{full}",
        "axis, at rest and without weight: s; x, y, z in the base frame; diameter",
        *(f"s = {row[0]:.1f}:  {row[1]:.2f}, {row[2]:.2f}, {row[3]:.2f};  ⌀{row[4]:.2f}" for row in points),
        f"flange ⌀{_mm(g.flange.diameter)}, {_mm(g.flange.thickness)} thick",
        f"hole ⌀{_mm(model.adapter.peg_hole_d)} through the flange at x = {_mm(model.adapter.peg_x)}: it marks +x",
        *_engraved(model.adapter.on_flange, "the flange's rim at -x"), *_accepted(model, "probe"),
    ]  # fmt: skip
    note(sheet, (EDGE + 10.0, foot + 20.0), rows_of(lines, WIDTH - 2 * EDGE - 20.0, SMALL), SMALL)
    return sheet


def _stations(model: CadModel, apart: float) -> Iterable[tuple[float, float, str]]:
    """Yield height and half-width [mm] with its text: both ends and the middle of the flank, which calipers measure,
    knots at least `apart` [mm] from others, and the radii of a rounded tip and of a fillet."""
    probe, g, section = model.design.probe, model.geometry, model.geometry.cross_section
    length, end = g.length / MM, g.flank_end / MM
    knots = [(s, d / 2) for s, d in probe.blunt_mm[:-1]] + [(end, float(g.radius_at(g.flank_end)) / MM)]
    wanted = [knots[0], knots[-1], (length / 2, float(g.radius_at(g.length / 2)) / MM), *knots[1:-1]]
    placed: list[float] = []
    tip = [length] if g.rounded_from is not None else []
    for s, r in wanted:
        if all(abs(s - other) >= apart for other in (*placed, *(t for t in tip if s != end))):
            placed.append(s)
            if section.flatness != 1.0:
                width = f"{number(2 * r)} × {number(2 * r * section.flatness)}"
            else:
                bore = f" / bore {number(2 * r * section.bore_ratio)}" if section.hollow else ""
                width = f"⌀{number(2 * r)}{bore}"
            words = f"{width} at s = {number(s)}"
            if s == 0.0 and probe.base_fillet_mm is not None:
                words = f"{words}\nfillet R{number(probe.base_fillet_mm)}"
            if s == end and tip:
                radius = rounding_radius_mm(*probe.blunt_mm[-2:])
                words = f"{words}\nround tip R{number(radius)}, facets within {DEVIATION_MM:g}"
            yield s, r, words


def _underside(model: CadModel, part: CadPart, sheet: Canvas) -> None:
    a, rim = model.adapter, model.geometry.flange.diameter / MM
    scale = scale_for((rim, rim), (SIDE_ROOM, SIDE_ROOM))
    view = View(sheet, (SIDE_X, (EDGE + BOTTOM) / 2 + 10.0), scale)
    view.outline(seen(part.shape, BELOW))
    view.cross(rim / 2)
    view.dimension_u(0.0, a.peg_x / MM, rim / 2, STACK, _mm(a.peg_x))
    view.caption(f"from below, {scale_text(scale)}", -rim / 2, 14.0)
    x, y = view.at((-rim / 2, -rim / 2))
    left = min(x, SIDE_X - SIDE_ROOM / 2)
    lines = [
        f"hole ⌀{_mm(a.peg_hole_d)} through the flange:",
        "it marks +x of the base frame",
        "s = 0 is the flange's top",
        *(part for text in (*_engraved(a.on_flange, "the flange's rim at -x"), *_accepted(model, "probe"))
          for part in text.replace(": ", ":\n").splitlines()),
    ]  # fmt: skip
    rows = rows_of(lines, WIDTH - EDGE - left, SMALL)
    note(sheet, (left, y + 22.0), rows, SMALL)
    probe = model.design.probe
    if probe.shape == "profile":  # leaders show what calipers measure, the table every knot
        flat = probe.cross_section.flatness
        knots = "; ".join(f"{number(s)}:\u00a0{number(d)}{f' × {number(flat * d)}' if flat != 1.0 else ''}"
                          for s, d in probe.blunt_mm)  # fmt: skip
        top, end = EDGE + 8.0, y - scale * rim - 16.0
        size = SMALL
        while len(table := rows_of([f"every knot, s: ⌀ {knots}"], WIDTH - EDGE - left, size)) * LINE * size > end - top:
            size *= 0.95
        note(sheet, (left, top), table, size)
