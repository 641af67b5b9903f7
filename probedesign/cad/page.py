"""The assembly page: one HTML file for the bench, to be read without a network and printed on A4."""

import base64
from collections.abc import Sequence
from html import escape

from probedesign.cad.bill import NUT_FACTOR, RESIN_PRESSURE, Item
from probedesign.cad.drawing import Drawing
from probedesign.cad.steps import Step
from probedesign.cad.svg import Svg
from probedesign.mount.fasteners import M2, SCREWS
from probedesign.units import MM, MPA

STYLE = """
@page { size: A4; margin: 14mm }
body { font: 10.5pt/1.4 Helvetica, Arial, "Liberation Sans", "DejaVu Sans", sans-serif; color: #111;
  max-width: 182mm; margin: 8mm auto; padding: 0 4mm }
h1 { font-size: 18pt; margin: 0 } h2 { font-size: 13pt; margin: 4.5mm 0 1mm; break-after: avoid } p { margin: 1mm 0 }
.about { color: #444; margin: 1mm 0 4mm }
.warning { border: 2.5pt solid #b00020; padding: 3mm 4mm; margin: 4mm 0; break-inside: avoid }
.warning strong { color: #b00020; font-size: 13pt; display: block }
table { border-collapse: collapse; width: 100%; font-size: 9.5pt; break-inside: avoid }
th, td { text-align: left; padding: 0.8mm 2mm; border-bottom: 0.4pt solid #bbb; vertical-align: top }
th { border-bottom: 1pt solid #111 } .n { text-align: right; white-space: nowrap }
.exploded { break-before: page; break-inside: avoid } .exploded svg { display: block; width: auto; height: auto;
  max-width: 100%; max-height: 245mm; margin: 0 auto }
.steps { display: grid; grid-template-columns: 1fr 1fr; gap: 4mm }
.step { border: 0.4pt solid #bbb; padding: 3mm; break-inside: avoid } .step img { display: block; height: 58mm;
  max-width: 100%; object-fit: contain; margin: 0 auto 2mm } .step b { margin-right: 1.5mm }
ul { margin: 1mm 0; padding-left: 5mm } .tools { columns: 2 }
@media print { body { margin: 0; padding: 0; max-width: none } }
"""


def page_of(
    drawing: Drawing, bill: Sequence[Item], steps: Sequence[Step], exploded: Svg, pictures: Sequence[bytes]
) -> bytes:
    """The page.

    Args:
        drawing: of the design.
        bill: of materials.
        steps: in order.
        exploded: the picture of all parts drawn apart, with the bill's numbers.
        pictures: a PNG of each step.
    """
    name = escape(drawing.design.name)
    sections = [
        _head(drawing), _warning(drawing),
        "<h2>Parts</h2>", _parts(bill), _tightening(), _tools(drawing), _frames(drawing),
        f'<div class="exploded"><h2>Where they go</h2>{exploded}</div>',
        '<h2>Steps</h2><div class="steps">', *map(_step, range(1, len(steps) + 1), steps, pictures), "</div>",
    ]  # fmt: skip
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{name}: assembly</title>'
        f'<meta name="viewport" content="width=device-width"><style>{STYLE}</style></head>\n<body>\n'
        + "\n".join(sections)
        + "\n</body></html>\n"
    ).encode()


def _head(drawing: Drawing) -> str:
    design = drawing.design
    sensor = f"ATI {escape(design.sensor.model.capitalize())}, {escape(design.sensor.calibration.upper())}"
    return (
        f"<h1>{escape(design.name)}: assembly</h1>"
        f'<p class="about">geometry {drawing.geometry.fingerprint} · {sensor} · {escape(drawing.plate.robot.source)}'
        " · compare the geometry's number with the manifest and with the probe that <code>live</code> runs</p>"
    )


def _warning(drawing: Drawing) -> str:
    tool, mounting = drawing.design.sensor_model.tool, drawing.design.sensor_model.mounting
    deepest = min(tool.max_entry, mounting.max_entry) / MM
    into_sensor = [use for use in drawing.screws if use.name in ("sensor_adapter_screws", "mounting_screws")]
    rows = "".join(
        f"<li>{len(use.points)} × ISO 4762 {use.screw.thread}×{use.length / MM:g} into the {use.into}: enters "
        f"{use.entry / MM:g} mm, {use.entry_limits[0] / MM:g} to {use.entry_limits[1] / MM:g} mm allowed</li>"
        for use in into_sensor
    )
    return (
        f'<div class="warning"><strong>A screw that enters the sensor by more than {deepest:g} mm destroys it.</strong>'
        f"<ul>{rows}</ul>Measure every screw under its head before it goes in. Never a longer one, and never one "
        "without the printed part under its head.</div>"
    )


def _parts(bill: Sequence[Item]) -> str:
    head = (
        "<tr><th></th><th>part</th><th class=n>pieces</th><th>what</th><th>of</th><th class=n>g each</th>"
        "<th class=n>at most N·m</th></tr>"
    )
    rows = [
        f"<tr><td class=n>{item.number}</td><td>{escape(item.title)}</td><td class=n>{item.quantity}</td>"
        f"<td>{escape(f'print {item.file}' if item.file else item.what)}</td><td>{escape(item.material)}</td>"
        f"<td class=n>{_blank(item.mass_g)}</td><td class=n>{_blank(item.tighten_Nm)}</td></tr>"
        for item in bill
    ]
    return f"<table>{head}{''.join(rows)}</table>"


def _blank(value: float | None) -> str:
    return "" if value is None else f"{value:g}"


def _tools(drawing: Drawing) -> str:
    bolt = SCREWS[drawing.plate.robot.bolt]
    tools = [
        f"hexagon key {M2.socket_af / MM:g} mm (M2) with a long arm, to reach past the probe",
        f"hexagon key {bolt.socket_af / MM:g} mm ({bolt.thread})",
        "calipers, for the screws' lengths and the probe's diameters",
        "tweezers, for nuts and pins",
    ]
    return f"<h2>Tools</h2><ul class=tools>{''.join(f'<li>{escape(tool)}</li>' for tool in tools)}</ul>"


def _step(number: int, step: Step, picture: bytes) -> str:
    text = escape(step.text[0].upper() + step.text[1:])
    image = base64.b64encode(picture).decode()
    return (
        f'<div class="step"><img alt="step {number}" src="data:image/png;base64,{image}">'
        f"<b>{number}</b>{text}.</div>"
    )


def _tightening() -> str:
    return (
        "<h2>How tight</h2><p>By hand: the short arm of the key between two fingers, until the head sits; then no "
        f"further. Computed, not tested: at the torque of the table the head presses the resin with "
        f"{RESIN_PRESSURE / MPA:g} MPa, a third of its strength, since resin creeps (assumed), with a nut factor of "
        f"{NUT_FACTOR:g} (dry steel, Shigley). Tighten crosswise in two rounds, and once more after a day. No thread "
        "lock near the resin: some crack it (assumed).</p>"
    )


def _frames(drawing: Drawing) -> str:
    height = drawing.adapter.T_sensor_base[2, 3] / MM
    mass = sum(body.mass for body in drawing.bodies.values())
    return (
        "<h2>Where the probe's base is</h2>"
        "<p>The base of the flexible part (s = 0, the origin of the base frame) lies on the sensor's axis, "
        f"<b>{height:.2f} mm above the tool face</b>. Its axes are the sensor's: z out of the tool face towards the "
        "tip, x through the dowel hole at 0°, shown by the clocking mark of the flange and by the flat on the "
        f"adapter's rim. {1e3 * mass:.3g} g hang on the sensor, the probe included. The manifest and the frozen probe "
        "hold the numbers.</p>"
    )
