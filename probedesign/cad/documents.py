"""Assembly of the parts: its order, exploded views, the bill of materials and the assembly page of an export."""

import base64
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from html import escape
from typing import Any

import numpy as np

from probedesign.cad.inspection import inspection_sheets
from probedesign.cad.model import CadModel
from probedesign.cad.render import PALE, RenderBody, fit_view, png_bytes, render_bodies, render_body
from probedesign.cad.solids import ScrewGroup
from probedesign.core import csv_tables
from probedesign.core.svg import Anchor, Canvas
from probedesign.core.units import MM, MPA
from probedesign.design.catalog import RIGID_RESIN
from probedesign.geometry.mass import combined
from probedesign.mount import SensorAdapter
from probedesign.mount.flange_adapter import CENTRING_PIN_LENGTH
from probedesign.mount.tolerance_stack import (
    CALIPERS,
    NUT_FACTOR,
    RESIN_PRESSURE,
    clamp_force,
    hand_torque,
    measurements,
    ring_torque,
    tolerance_stacks,
)
from probedesign.reports.html_page import html_document

# ---- order

UP, DOWN = 1, -1


@dataclass(frozen=True)
class Move:
    """Parts that are mounted onto another part."""

    parts: tuple[str, ...]  #: names.
    onto: str  #: the part that they are moved away from.
    side: int  #: UP or DOWN along the sensor's z.


@dataclass(frozen=True)
class AssemblyStep:
    """One step of the assembly."""

    text: str  #: the instruction.
    moves: tuple[Move, ...]  #: of this step's parts, each onto a part that is present or moved before it.
    on_bench: bool = False  #: whether it is done on the bench, so that earlier parts are not shown.
    measure: tuple[str, ...] = ()  #: how the names of the measurements begin that decide it.

    @property
    def parts(self) -> tuple[str, ...]:
        """Return the names of all parts that are mounted."""
        return tuple(name for move in self.moves for name in move.parts)


def assembly_steps(model: CadModel) -> list[AssemblyStep]:
    """Return the steps of the assembly: on the bench, upright, and bolted to the robot last.

    Where the sensor adapter covers the bolts of the robot, the plate is bolted to it before the adapter is mounted.
    """
    a, robot, pins = model.adapter, model.plate.robot, len(model.plate.p_centring_pins)
    curved = not model.geometry.axis.is_straight
    centred = f"press the {pins} centring pins into the flange adapter as deep as they go, set the sensor between them "
    plate = Move(("flange_adapter",), "centring_pins" if pins else "sensor", DOWN)
    base = (Move(("centring_pins",), "sensor", DOWN), plate) if pins else (plate,)
    glue = (
        "spread a thin film of flexible cyanoacrylate on the land only, none in groove and notch or on screw heads, "
        if model.design.mount.hold == "glued"
        else ""
    )
    along = (
        "thread the clamp ring over the tip and along the bend down to the flange; where the soft body lies over a "
        "screw, hold it aside with a finger"
        if curved
        else "slip the clamp ring over the tip"
    )
    aside = "; where the soft body lies over a bolt, hold it aside with a finger" if curved else ""
    of = {
        use.name: f"{len(use.points)} {use.screw.thread}x{use.length / MM:g}, at most {torque_of(use, a):g} N·m"
        for use in model.screws
    }
    robot_pin = f", its own {robot.pin_d / MM:g} mm dowel pin in the slot" if robot.pin_d > 0.0 else ""
    bolted = AssemblyStep(
        f"bolt the flange adapter to the robot: {of['robot_bolts']}, from above{robot_pin}; tie the cable to the plate "
        f"through the two slots, with a slack loop before the tie{aside}",
        (Move(("robot_bolts",), "flange_adapter", UP),))  # fmt: skip
    by_eye, centred_by_eye = f"(the play leaves ±{a.tool_play_deg:.1f}°), ", "" if a.p_dowels else "centre it, "
    if a.tool_play_deg == 90.0:
        by_eye = "(one screw on the axis holds no turn: hold the adapter while you tighten, then measure the angle), "
    turned = "" if len(a.p_dowels) > 1 else f"turn the flat on its rim to the sensor's +X {by_eye}{centred_by_eye}"
    covered = a.body_d > robot.bolt_circle_d - robot.screw.head_d
    return [
        AssemblyStep(f"{centred if pins else 'set the sensor on the flange adapter '}with its cable over the pocket, "
             "and screw the flange adapter to the sensor's mounting side from below: "
             f"{of['mounting_screws']}, never longer",
             (*base, Move(("mounting_screws",), "flange_adapter", DOWN)), measure=("flange adapter:",)),
        *([bolted] if covered else []),
        *([AssemblyStep(f"stand the sensor upright{'' if covered else ' on the bench'}, and push "
             f"the dowels, {len(a.p_dowels)} × {a.dowels.diameter / MM:g} mm, into its tool face to the bottom",
             (Move(("dowel_pins",), "sensor", UP),))] if a.p_dowels else []),
        AssemblyStep(f"stand the sensor adapter upright and slide {a.ring_screw.thread} nuts into its four slots from "
             "the side; they lie on the slots' floors, and fall out where the adapter is turned over",
             (Move(("ring_nuts",), "sensor_adapter", DOWN),), on_bench=True,
             measure=("sensor adapter: depth",)),
        AssemblyStep("lower the sensor adapter with its nuts "
             f"{'over the dowels ' if a.p_dowels else ''}onto the tool face, {turned}and "
             f"screw it down from above through its recess: {of['sensor_adapter_screws']}, never longer",
             (Move(("sensor_adapter", "ring_nuts"), "dowel_pins" if a.p_dowels else "sensor", UP),
              Move(("sensor_adapter_screws",), "sensor_adapter", UP)),
             measure=("sensor adapter: each", "sensor adapter: thickness")),
        AssemblyStep(f"{glue}lay the flange into the recess, its hole over the peg: peg "
             "and the flat on the rim are at +X, and the probe's number is in the window opposite",
             (Move(("probe",), "sensor_adapter", UP),), measure=("probe:", "flange minus recess")),
        AssemblyStep(f"{along}, with an even gap around the probe, and screw it down crosswise in two rounds with "
             f"{of['ring_screws']}, until it sits on the wall all around",
             (Move(("clamp_ring",), "probe", UP), Move(("ring_screws",), "clamp_ring", UP))),
        *([] if covered else [bolted]),
    ]  # fmt: skip


def torque_of(use: ScrewGroup, a: SensorAdapter) -> float:
    """Return the greatest torque of a screw [N·m]."""
    return ring_torque(a) if use.name == "ring_screws" else hand_torque(use.screw)


# ---- bill of materials

STEEL = "stainless steel A2"


@dataclass(frozen=True)
class BillItem:
    """One line of the bill of materials; fields that do not apply are empty."""

    number: int  #: in the order of assembly, as in the exploded view.
    name: str  #: as in the files.
    quantity: int  #: how many.
    what: str  #: description with the standard.
    length_mm: float | None = None  #: of a screw under its head, or of a pin.
    material: str = ""  #: resin, steel or none.
    mass_g: float | None = None  #: of one.
    file: str = ""  #: mesh to print.
    tighten_Nm: float | None = None  #: maximum torque that the resin under the head allows.

    @property
    def title(self) -> str:
        """Return the name for readers."""
        return self.name.replace("_", " ")


def bill_of_materials(model: CadModel, steps: Iterable[AssemblyStep]) -> list[BillItem]:
    """Return the bill of materials: the sensor first, then every part in the order of assembly."""
    screws = {use.name: use for use in model.screws}
    pins = {"centring_pins": CENTRING_PIN_LENGTH, "dowel_pins": model.adapter.dowels.pin_length}
    bill = []
    for number, name in enumerate(dict.fromkeys(["sensor", *(name for step in steps for name in step.parts)]), 1):
        part, use = model.parts[name], screws.get(name)
        length = pins.get(name) if use is None else use.length
        what, material, file = part.standard, STEEL, ""
        if part.printed:
            resin = model.design.resin.name if name == "probe" else RIGID_RESIN
            what, material, file = "printed", resin, f"{name}.stl"
        elif not part.standard:
            what, material = _sensor_text(model), ""
        bill.append(BillItem(
            number, name, len(part.places), what, None if length is None else round(length / MM, 3), material,
            float(f"{1e3 * part.body.mass:.3g}") if part.density else None, file,
            None if use is None else torque_of(use, model.adapter),
        ))  # fmt: skip
    return bill


def _sensor_text(model: CadModel) -> str:
    return f"{model.design.sensor_model.product}, {model.design.calibration.name.upper()}"


# ---- exploded views

GAP = 8.0  #: Distance between exploded parts [mm].
EXPLODED_SIZE, STEP_SIZE = (560, 1300), (360, 320)
ABOVE = 25.0  #: Length of the probe that a step's picture shows above all other parts [mm].
LABEL_WIDTH, LINE = 285.0, 19.0  #: Width of the label column, and line spacing of a label [px].

Bodies = Mapping[str, RenderBody]


def exploded_bodies(bodies: Bodies, moves: Iterable[Move], seat: float) -> dict[str, RenderBody]:
    """Return the bodies with each move's parts translated away from their assembled position.

    Args:
        bodies: all in their places.
        moves: each onto a body that is fixed or moved before.
        seat: z up to which the probe counts [mm]: the ring is drawn around the probe, not beyond its tip.
    """
    lifts = dict.fromkeys(bodies, 0.0)
    ends: dict[tuple[str, int], float] = {}  # of what was moved away from a side of a part before
    for move in moves:
        low, high = min(bodies[name].span[0] for name in move.parts), max(bodies[name].span[1] for name in move.parts)
        bottom, top = bodies[move.onto].span
        top, up = seat if move.onto == "probe" else top, move.side == UP
        start = ends.get((move.onto, move.side), lifts[move.onto] + (top if up else bottom))
        away = start + GAP - low if up else start - GAP - high
        ends[move.onto, move.side] = away + (high if up else low)
        for name in move.parts:  # a part that was moved onto another one before goes with it
            lifts[name] += away
    return {name: body.translated(lifts[name]) for name, body in bodies.items()}


def step_pictures(bodies: Bodies, steps: Sequence[AssemblyStep], seat: float) -> list[bytes]:
    """Return a PNG of each step: its parts on their way, and the parts mounted before in a paler colour."""
    pictures, there = [], ["sensor"]
    for step in steps:
        onto = [move.onto for move in step.moves if move.onto not in step.parts]
        before = [name for name in (onto if step.on_bench else there) if name not in step.parts]
        shown = {name: replace(bodies[name], opacity=PALE) for name in dict.fromkeys(before)}
        shown |= {name: bodies[name] for name in step.parts}
        exploded = exploded_bodies(shown, step.moves, seat)
        drawn = list(exploded.values())
        below = max(body.span[1] for name, body in exploded.items() if name != "probe") + ABOVE
        pictures.append(png_bytes(render_bodies(drawn, fit_view(drawn, STEP_SIZE, below))[0]))
        if not step.on_bench:
            there += [name for name in step.parts if name not in there]
    return pictures


def exploded_svg(
    bodies: Bodies, steps: Iterable[AssemblyStep], bill: Sequence[BillItem], title: str, seat: float
) -> Canvas:
    """Return the exploded view of all parts with their numbers, names and descriptions; for `seat` see
    `exploded_bodies`."""
    exploded = list(exploded_bodies(bodies, (move for step in steps for move in step.moves), seat).values())
    view = fit_view(exploded, EXPLODED_SIZE)
    pixels, owners = render_bodies(exploded, view)
    width, height = view.size
    svg = Canvas(width + 2 * LABEL_WIDTH, height, unit="px", title=title)
    svg.add("rect", width=svg.width, height=height, fill="#fff")  # of the file; a dark page removes it
    picture = base64.b64encode(png_bytes(pixels)).decode()
    svg.add("image", x=LABEL_WIDTH, y=0.0, width=width, height=height, href=f"data:image/png;base64,{picture}")
    shown = {name: np.nonzero(owners == i) for i, name in enumerate(bodies)}  # rows and columns of its pixels

    def anchor_of(name: str, side: int) -> tuple[float, float]:
        rows, columns = shown[name]
        if len(rows) == 0:
            return width / 2, height / 2
        edge = np.quantile(columns, 0.06 if side == 0 else 0.94)
        i = int(np.argmin(np.abs(columns - edge) + 0.5 * np.abs(rows - np.median(rows))))
        return float(columns[i]), float(rows[i])

    items = {item.name: item for item in bill}
    order = sorted(shown, key=lambda name: float(np.unique(shown[name][0]).mean()) if len(shown[name][0]) else 0.0)
    for side in (0, 1):  # alternating left and right, from the top
        anchors = [anchor_of(name, side) for name in order[side::2]]
        heights = _spread([y for _, y in anchors], 3.2 * LINE, height)
        for name, anchor, y in zip(order[side::2], anchors, heights, strict=True):
            _label(svg, items[name], anchor, y, side, width)
    return svg


def _spread(wanted: Sequence[float], spacing: float, height: float) -> list[float]:
    """Return heights near the wanted ones, at least `spacing` apart, inside the picture."""
    order, lowest = np.argsort(wanted, kind="stable"), spacing * (np.arange(len(wanted)) + 0.5)
    highest = height - lowest[::-1]
    placed = lowest + np.maximum.accumulate(np.maximum(np.array(wanted)[order] - lowest, 0.0))
    placed = highest + np.minimum.accumulate(np.minimum(placed - highest, 0.0)[::-1])[::-1]
    return [float(y) for y in placed[np.argsort(order)]]


def _label(svg: Canvas, item: BillItem, anchor: tuple[float, float], y: float, side: int, width: float) -> None:
    inner = LABEL_WIDTH - 8.0 if side == 0 else LABEL_WIDTH + width + 8.0
    outward = -1.0 if side == 0 else 1.0
    svg.polylines([[(LABEL_WIDTH + anchor[0], anchor[1]), (inner, y)]], 1.2, "#444")
    svg.circle((LABEL_WIDTH + anchor[0], anchor[1]), 3.2, fill="#444")
    svg.circle((inner + 15 * outward, y), 14.0, fill="#fff", colour="#222", width=1.4)
    svg.text((inner + 15 * outward, y + 5.5), str(item.number), 15.0, bold=True)
    what = f"{item.quantity} × {item.what}" if item.quantity > 1 else item.what
    what = f"{item.what}, {item.material}" if item.file else what
    x = inner + 36 * outward
    anchored: Anchor = "end" if side == 0 else "start"
    svg.text((x, y - 2.0), item.title, 15.5, anchor=anchored, bold=True)
    svg.text((x, y - 2.0 + LINE), what, 13.0, anchor=anchored)


# ---- page

STYLE = """body { max-width: 182mm }
h2 { font-size: 13pt; margin: 4.5mm 0 1mm; break-after: avoid } p { margin: 1mm 0 }
.warning { border: 2.5pt solid var(--alarm); padding: 3mm 4mm; margin: 4mm 0; break-inside: avoid }
.warning strong { color: var(--alarm); font-size: 13pt; display: block }
table { width: 100% } td label { white-space: nowrap }
th, td { text-align: left; padding: 0.8mm 2mm; vertical-align: top; white-space: normal }
.n { text-align: right } .n, td label { white-space: nowrap }
.step label { display: block; margin: 1mm 0 0 5mm; text-indent: -5mm } .step label b { margin: 0 }
.exploded { break-inside: avoid } .exploded svg { display: block;
  width: auto; height: auto; max-width: 100%; max-height: 195mm; margin: 0 auto }
.steps { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(75mm, 100%), 1fr)); gap: 4mm }
.step { border: 0.4pt solid var(--rule); padding: 3mm; break-inside: avoid }
.step img { display: block; height: 55mm; max-width: 100%; object-fit: contain; margin: 0 auto 2mm }
.step b { margin-right: 1.5mm }
ul { margin: 1mm 0; padding-left: 5mm } .tools { columns: 2 75mm } li { break-inside: avoid }
@media screen and (prefers-color-scheme: dark) {
  .exploded rect { display: none } .exploded :is(text, path, circle) { filter: invert(1) hue-rotate(180deg) }
  .exploded image, .step img { filter: brightness(1.35) }
}
@media print { body { font-size: 9.5pt } table { font-size: 8.5pt } .step { padding: 2mm } .step img { height: 40mm } }
"""


def assembly_page(
    model: CadModel,
    bill: Sequence[BillItem],
    steps: Sequence[AssemblyStep],
    exploded: Canvas,
    pictures: Sequence[bytes],
    post_processing: Mapping[str, str],
) -> bytes:
    """Return the assembly page: one HTML file that needs no network and prints on A4.

    Args:
        model, bill, steps, exploded, pictures: of the assembly.
        post_processing: what to do with the print of the probe before, by step.
    """
    keys = dict.fromkeys((use.screw for use in model.screws), "") | {
        model.adapter.ring_screw: " with a long arm, to reach past the probe"
    }
    pin_d = model.plate.robot.pin_d
    tools = [
        *(f"hexagon key {screw.socket_af / MM:g} mm ({screw.thread}){note}" for screw, note in keys.items()),
        "calipers with a depth rod, for the dimensions in the steps and the probe's diameters",
        "tweezers, for nuts and pins", "cable tie, 2.5 mm wide",
        *([f"dowel pin of {pin_d / MM:g} mm, for the hole in the robot's flange"] if pin_d else []),
    ]  # fmt: skip
    rows = measurements(model.adapter, model.plate)
    after = "".join(
        f"<tr><td><label><input type=checkbox> {escape(step)}</label></td><td>{escape(text)}</td></tr>"
        for step, text in post_processing.items()
    )
    sections = [
        f'<div class="exploded">{exploded}</div>', _warning(model),
        f"<h2>After printing the probe, in {escape(model.design.resin.product)}</h2><table>{after}</table>",
        f"<h2>Tools and small parts</h2><ul class=tools>{''.join(f'<li>{escape(tool)}</li>' for tool in tools)}</ul>",
        "<h2>Steps</h2><p>Measure before you screw, in millimetres. The ranges leave room for the tolerance of the "
        f"screws, for heads that settle, and for the calipers: {CALIPERS / MM:g} mm for a reading, on the side that "
        "destroys the sensor and on both sides of the lip's compression. Do not sand the foot of the sensor adapter or "
        'the faces of the flange adapter.</p><div class="steps">',
    ]  # fmt: skip
    for number, (step, picture) in enumerate(zip(steps, pictures, strict=True), 1):
        source, text = base64.b64encode(picture).decode(), escape(step.text[0].upper() + step.text[1:])
        image = f'<img alt="step {number}" src="data:image/png;base64,{source}">'
        ticks = [
            f"{escape(row.what)}: <b>{row.accept[0] / MM:.2f} … {row.accept[1] / MM:.2f}</b> (drawn "
            f"{row.nominal / MM:.2f}; {escape(row.otherwise)})"
            for row in rows
            if row.what.startswith(step.measure or "-")
        ]
        boxes = "".join(f"<label><input type=checkbox> {tick}</label>" for tick in (*ticks, f"step {number} done"))
        sections.append(f'<div class="step">{image}<b>{number}</b>{text}.{boxes}</div>')
    sections += ["</div><h2>Parts</h2>", _parts(bill), _tightening(model), _frames(model)]
    about = (
        f"geometry {model.geometry.fingerprint} · {escape(_sensor_text(model))} · {escape(model.plate.robot.source)}"
        " · compare the geometry's number with the manifest and with the probe that <code>live</code> runs"
    )
    return html_document(f"{model.design.name}: assembly", [about], "\n".join(sections) + "\n", STYLE)


def _warning(model: CadModel) -> str:
    deepest = min(model.adapter.tool.max_entry, model.plate.mounting.max_entry) / MM
    into_sensor = [use for use in model.screws if use.name in ("sensor_adapter_screws", "mounting_screws")]
    stacks = {stack.name: stack.worst for stack in tolerance_stacks(model.adapter, model.plate)}
    rows = "".join(
        f"<li>{len(use.points)} × ISO 4762 {use.screw.thread}×{use.length / MM:g} into the {use.into}: enters "
        f"{use.entry / MM:.2g} mm, {' to '.join(f'{x / MM:.2f}' for x in stacks[f'{use.name}_entry'])} mm with all "
        f"tolerances, {use.entry_limits[0] / MM:g} to {use.entry_limits[1] / MM:g} mm allowed</li>"
        for use in into_sensor
    )
    return (
        f'<div class="warning"><strong>A screw that enters the sensor by more than {deepest:g} mm destroys it.</strong>'
        f"<ul>{rows}</ul>Measure every screw under its head before it goes in. Never a longer one, and never one "
        "without the printed part under its head.</div>"
    )


def _parts(bill: Sequence[BillItem]) -> str:
    head = (
        "<thead><tr><th class=n>no.</th><th>part</th><th class=n>pieces</th><th>what</th><th>of</th>"
        "<th class=n>g each</th><th class=n>at most N·m</th></tr></thead>"
    )
    rows = []
    for item in bill:
        what = f"print {item.file}" if item.file else item.what
        mass, torque = ("" if value is None else f"{value:g}" for value in (item.mass_g, item.tighten_Nm))
        rows.append(
            f"<tr><td class=n>{item.number}</td><td>{escape(item.title)}</td><td class=n>{item.quantity}</td>"
            f"<td>{escape(what)}</td><td>{escape(item.material)}</td>"
            f"<td class=n>{mass}</td><td class=n>{torque}</td></tr>"
        )
    return f'<div class="wide" tabindex="0"><table>{head}<tbody>{"".join(rows)}</tbody></table></div>'


def _tightening(model: CadModel) -> str:
    clamp = clamp_force(model.adapter, model.plate, model.design.youngs_modulus.value)
    low, high = clamp.range
    lip = (
        f"The ring needs {clamp.nominal:.0f} N to reach the wall, {low:.0f} to {high:.0f} N with all tolerances; its "
        f"{clamp.screws} screws give {clamp.preload:.0f} N."
    )
    warning = "" if high <= clamp.preload else (
        f'<div class="warning"><strong>The ring may not close.</strong>{lip} Print the probe with a smaller '
        "flange_lip_mm or a larger flange_thickness_mm, or take M3 screws; do not tighten further.</div>"
    )  # fmt: skip
    return (
        "<h2>How tight</h2><p>By hand: the short arm of the key between two fingers, until the head sits; then no "
        f"further. Computed, not tested: at the torque of the table the head presses the resin with "
        f"{RESIN_PRESSURE / MPA:g} MPa, a third of its strength, since resin creeps (assumed), with a nut factor of "
        f"{NUT_FACTOR:g} (dry steel, Shigley). {'' if warning else lip} Tighten crosswise in two rounds, and once more "
        f"after a day. No thread lock near the resin: some crack it (assumed).</p>{warning}"
    )


def _frames(model: CadModel) -> str:
    height = model.adapter.T_sensor_base[2, 3] / MM
    carried, load = combined(model.bodies.values()), model.carried
    turn = math.degrees(model.base_turn)
    matrix = "\n".join("  ".join(f"{x + 0.0:10.6g}" for x in row) for row in model.T_robotflange_base.round(9))
    sensor = model.design.sensor_model
    if sensor.overload is None:
        overload = "Its overload is not known"
    else:
        force, moment = (" / ".join(f"{x:g}" for x in part) for part in (sensor.overload[:3], sensor.overload[3:]))
        overload = f"On one axis at a time it survives {force} N and {moment} N·m"
    return (
        "<h2>Where the probe's base is</h2>"
        "<p>The base of the flexible part (s = 0, the origin of the base frame) lies on the sensor's axis, "
        f"<b>{height:.2f} mm above the tool face</b>. Its axes are the sensor's: z out of the tool face towards the "
        "tip, x through the dowel hole at 0°, shown by the clocking mark of the flange and by the flat on the "
        f"adapter's rim. {1e3 * carried.mass:.3g} g are mounted on the sensor, the probe included, with their centre "
        f"of mass {carried.p_com[2] / MM:.1f} mm above the tool face; the sensor itself weighs "
        f"{1e3 * sensor.interface.mass:.3g} g. {overload}. The manifest and the frozen probe contain the numbers. "
        f"On the robot, from the centre of its face with z out of it and x through its dowel hole, the base lies at "
        f"0, 0, <b>{model.T_robotflange_base[2, 3] / MM:.2f} mm</b>, turned by <b>{turn:.1f}°</b> about z "
        f"(rotation vector 0, 0, {model.base_turn:.4f} rad). In a controller's axes, in which the dowel hole is at φ "
        f"from x towards y, the turn is φ {'-' if turn < 0.0 else '+'} {abs(turn):.1f}°; in the tool frame of "
        f"Universal Robots φ is 90° for a dowel hole opposite the tool connector. The robot carries "
        f"{1e3 * load.mass:.3g} g, the sensor "
        f"included, with their centre of mass at {', '.join(f'{x / MM:.1f}' for x in load.p_com)} mm and, about "
        f"it, moments of inertia of {', '.join(f'{x:.2g}' for x in np.diag(load.inertia))} kg·m². "
        "For CAD there is one STEP file of each printed part in its own frame and <code>assembly.step</code> in the "
        "sensor's, in millimetres; <code>assembly.glb</code> is for viewers, in metres with y up.</p>"
        f'<p>T_robotflange_base, in metres:</p><div class="wide" tabindex="0"><pre>{matrix}</pre></div>'
    )


def build_documents(
    model: CadModel, post_processing: Mapping[str, str]
) -> tuple[dict[str, bytes], list[dict[str, Any]]]:
    """Return the documents of an export by name, and the bill of materials for the manifest.

    Args:
        model: of the assembly.
        post_processing: what to do with the print of the probe, by step.
    """
    bodies = {name: render_body(part) for name, part in model.parts.items()}
    steps = assembly_steps(model)
    bill, seat = bill_of_materials(model, steps), float(model.adapter.T_sensor_base[2, 3]) / MM
    exploded = exploded_svg(bodies, steps, bill, f"{model.design.name}: exploded view", seat)
    files = inspection_sheets(model)
    files["exploded.svg"] = bytes(exploded)
    files["bill_of_materials.csv"] = csv_tables.write(list(asdict(bill[0])), map(asdict, bill))
    pictures = step_pictures(bodies, steps, seat)
    files["assembly.html"] = assembly_page(model, bill, steps, exploded, pictures, post_processing)
    return files, [{key: value for key, value in asdict(item).items() if value not in (None, "")} for item in bill]
