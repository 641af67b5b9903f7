"""The bill of materials: what to print and what to buy, how many, how long, how tight."""

import csv
import io
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from probedesign.cad.assembly import Part
from probedesign.cad.drawing import Drawing
from probedesign.cad.kernel import mass_of
from probedesign.cad.screws import ScrewUse
from probedesign.cad.steps import EXPLOSION
from probedesign.materials import RIGID_RESIN
from probedesign.mount.fasteners import M2, M2_CLEARANCE_D
from probedesign.mount.sensor_adapter import DOWEL_PIN_LENGTH
from probedesign.robot_flange import RobotFlange
from probedesign.units import MM, MPA

STEEL = "stainless steel A2"
NUT_FACTOR = 0.2
"""Torque over preload and diameter, dry steel. Source: Shigley, Mechanical Engineering Design, table 8-15."""
RESIN_PRESSURE = 20.0 * MPA
"""Under a screw's head, for good: a third of a rigid resin's strength of about 60 MPa, since it creeps (assumed)."""


@dataclass(frozen=True)
class Item:
    """One line of the bill; empty where it does not apply.

    Attributes:
        number: counts in the order of assembly; the exploded picture shows it.
        name: as in the files.
        quantity: how many.
        what: in words, with the standard.
        length_mm: of a screw under its head, or of a pin.
        material: resin, steel or none.
        mass_g: of one.
        file: to print it from.
        tighten_Nm: the most that the resin under its head takes.
    """

    number: int
    name: str
    quantity: int
    what: str
    length_mm: float | None = None
    material: str = ""
    mass_g: float | None = None
    file: str = ""
    tighten_Nm: float | None = None

    @property
    def title(self) -> str:
        """The name as one writes it."""
        return self.name.replace("_", " ")


def bill_of(drawing: Drawing) -> list[Item]:
    """Every part of the assembly, the sensor first, then in the order of assembly."""
    order = ["sensor", *(name for move in EXPLOSION for name in move.parts)]
    uses = {use.name: use for use in drawing.screws}
    return [_item(number, drawing, drawing.parts[name], uses) for number, name in enumerate(order, 1)]


def _item(number: int, drawing: Drawing, part: Part, uses: Mapping[str, ScrewUse]) -> Item:
    count = len(part.shape.Solids())
    grams = _digits(1e3 * mass_of(part.shape, part.density).mass / count) if part.density else None
    if part.printed:
        resin = drawing.design.resin.name if part.name == "probe" else RIGID_RESIN
        return Item(number, part.name, count, "printed", None, resin, grams, f"{part.name}.stl")
    if part.name in uses:
        use = uses[part.name]
        torque = hand_torque(use, drawing.plate.robot)
        what, length = f"ISO 4762 {use.screw.thread}x{use.length / MM:g}", round(use.length / MM, 3)
        return Item(number, part.name, count, what, length, STEEL, grams, "", torque)
    if part.name == "ring_nuts":
        return Item(number, part.name, count, "ISO 4032 M2", None, STEEL, grams)
    if part.name == "dowel_pins":
        d, length = drawing.design.sensor_model.dowel_d / MM, DOWEL_PIN_LENGTH / MM
        # h8 slips into the sensor's hole; m6 would have to be driven into it.
        return Item(number, part.name, count, f"ISO 2338 {d:g} h8x{length:g}", length, STEEL, grams)
    sensor = drawing.design.sensor
    return Item(number, part.name, count, f"ATI {sensor.model.capitalize()}, {sensor.calibration.upper()}")


def hand_torque(use: ScrewUse, robot: RobotFlange) -> float:
    """The torque [N·m] that presses a head on its seat with `RESIN_PRESSURE`, rounded down to one digit."""
    d = float(use.screw.thread[1:]) * MM
    hole = M2_CLEARANCE_D if use.screw is M2 else robot.bolt_clearance_d
    preload = RESIN_PRESSURE * np.pi / 4 * (use.screw.head_d**2 - hole**2)
    torque = NUT_FACTOR * preload * d
    digit = 10.0 ** np.floor(np.log10(torque))
    return float(f"{np.floor(torque / digit) * digit:.1g}")


def as_records(bill: list[Item]) -> list[dict[str, Any]]:
    """For the manifest."""
    return [{k: v for k, v in asdict(item).items() if v not in (None, "")} for item in bill]


def csv_bytes(bill: list[Item]) -> bytes:
    """As a table that spreadsheets open."""
    table = io.StringIO(newline="")
    writer = csv.DictWriter(table, list(asdict(bill[0])), lineterminator="\r\n")
    writer.writeheader()
    writer.writerows(asdict(item) for item in bill)
    return table.getvalue().encode("utf-8")


def _digits(value: float) -> float:
    return float(f"{value:.3g}")
