"""The design file: what `designs/NAME.toml` may say, checked at the door.

A bad file never gets further than `load_design`: unknown keys, wrong types, values out of range and
shapes that do not hold together all become one line that names the key, the value, the remedy and the
line of the file.
"""

import math
import re
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from probedesign.design_problems import Inconsistent, check_toml, one_line, parse_toml, quoted
from probedesign.design_tables import (
    ContactTable,
    MaterialTable,
    MountTable,
    PrintTable,
    ProbeTable,
    SensorTable,
    Table,
    TolerancesTable,
)
from probedesign.errors import InputError
from probedesign.materials import Quantity, Resin, resin_named
from probedesign.printer import Printer, printer_named
from probedesign.robot_flange import RobotFlange, own_flange, robot_flange_named
from probedesign.sensor import Calibration, SensorModel, sensor_named
from probedesign.units import MM, MPA

NAME_PATTERN = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")


class Design(Table):
    """One probe, as its design file says it."""

    schema_version: Literal[1] = Field(alias="schema")
    name: str
    probe: ProbeTable
    material: MaterialTable = MaterialTable()
    sensor: SensorTable = SensorTable()
    mount: MountTable = MountTable()
    contact: ContactTable = ContactTable()
    print_: PrintTable = Field(default=PrintTable(), alias="print")
    tolerances: TolerancesTable = TolerancesTable()

    @field_validator("name")
    @classmethod
    def _plain(cls, value: str) -> str:
        check_name(value)
        return value

    @model_validator(mode="after")
    def _root_fits(self) -> Self:
        """The rigid root must end on the probe."""
        rigid = self.mount.root_rigid_radii * self.probe.base_d_mm / 2.0
        if rigid >= self.probe.length_mm:
            most = 2.0 * self.probe.length_mm / self.probe.base_d_mm
            raise Inconsistent(
                "mount.root_rigid_radii",
                f"= {self.mount.root_rigid_radii:g} makes {rigid:g} mm rigid, the whole probe; stay below {most:g}",
            )
        return self

    @model_validator(mode="after")
    def _known(self) -> Self:
        try:
            _ = self.resin, self.calibration, self.robot_flange, self.printer
        except InputError as error:
            key, _, rest = str(error).partition(": ")
            raise Inconsistent(key, rest) from None
        return self

    @property
    def resin(self) -> Resin:
        """The named resin."""
        return resin_named(self.material.resin)

    @property
    def sensor_model(self) -> SensorModel:
        """The named sensor."""
        return sensor_named(self.sensor.model)

    @property
    def calibration(self) -> Calibration:
        """The named calibration of that sensor."""
        return self.sensor_model.calibration(self.sensor.calibration)

    @property
    def robot_flange(self) -> RobotFlange:
        """The named robot flange, or that of `[mount.flange]`."""
        own = self.mount.flange
        if own is None:
            return robot_flange_named(self.mount.robot_flange)
        slot, spigot = (
            None if pair is None else (pair[0] * MM, pair[1] * MM)
            for pair in (own.pin_slot_mm, own.spigot_mm)
        )
        return own_flange(
            own.bolt, own.bolt_circle_d_mm * MM, own.bolt_azimuths_deg, own.max_bolt_entry_mm * MM,
            own.bolt_length_mm * MM, own.face_d_mm * MM, slot, spigot,
        )  # fmt: skip

    @property
    def printer(self) -> Printer:
        """The named printer."""
        return printer_named(self.print_.printer)

    @property
    def youngs_modulus(self) -> Quantity:
        """E [Pa] with its provenance."""
        return self._quantity("youngs_modulus_mpa", MPA, self.resin.youngs_modulus)

    @property
    def shear_modulus(self) -> Quantity:
        """G [Pa] with its provenance."""
        return self._quantity("shear_modulus_mpa", MPA, self.resin.shear_modulus)

    @property
    def density(self) -> Quantity:
        """Density [kg/m³] with its provenance."""
        return self._quantity("density_kg_m3", 1.0, self.resin.density)

    @property
    def friction(self) -> Quantity:
        """Friction of a touch, tangential over normal force [-], with its provenance."""
        given = self.contact.friction
        if given is None:
            return self.resin.friction
        return Quantity(given, self.contact.provenance.friction, "design file, contact.friction")

    def _quantity(self, key: str, unit: float, default: Quantity) -> Quantity:
        given = getattr(self.material, key)
        if given is None:
            return default
        return Quantity(given * unit, getattr(self.material.provenance, key), f"design file, material.{key}")

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What of this design is assumed, each as `table.key`, for every report that shows numbers."""
        dimensions = [f"probe.{key}" for key in self.probe.assumed]
        quantities = {
            "material.youngs_modulus_mpa": self.youngs_modulus,
            "material.shear_modulus_mpa": self.shear_modulus,
            "material.density_kg_m3": self.density,
        }
        # 0.12 is a face bonded to something rigid; the exported flange is computed to yield (mount/sensor_adapter.py).
        root = ("mount.root_rigid_radii",) if self.mount.root_rigid_radii != 0.0 else ()
        # An infinite friction leaves the direction of the force free: no number is assumed.
        friction, free = self.friction, math.isinf(self.friction.value)
        contact = ("contact.friction",) if friction.provenance == "assumed" and not free else ()
        return (
            *dimensions,
            *(k for k, q in quantities.items() if q.provenance == "assumed"),
            *root,
            *contact,
        )


def check_name(name: str) -> None:
    """Refuse a design name that is not a plain file name.

    Raises:
        InputError: the name has a path, a space or odd characters in it.
    """
    if not NAME_PATTERN.fullmatch(name) or name.endswith((".", ".toml")):
        allowed = "letters, digits, '-', '_' and '.', at most 64, no path, no extension"
        raise InputError(f"name: {quoted(name)} is not a plain name; use {allowed}")


def load_design(path: str | Path) -> Design:
    """Read and check a design file.

    Args:
        path: the TOML file.

    Returns:
        The design.

    Raises:
        InputError: the file cannot be read, is not TOML, or says something wrong; one line.
    """
    path = Path(path)
    try:
        text = path.read_bytes().decode("utf-8-sig")  # Windows editors put a byte order mark first
    except FileNotFoundError:
        raise InputError(f"{path}: no such design file; make one with: probedesign new") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not a text file in UTF-8") from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        raise InputError(one_line(f"{path}: cannot be read: {getattr(error, 'strerror', error)}")) from None
    return parse_design(text, str(path))


def parse_design(text: str, where: str = "design") -> Design:
    """Check the text of a design file; `where` names it in errors.

    Raises:
        InputError: one line naming the key, the value, the remedy and the line.
    """
    return parse_toml(text, Design, where)


def check_design(data: dict[str, Any], text: str = "", where: str = "") -> Design:
    """Check what a design file says, or would say.

    Args:
        data: its tables, with the keys and units of the file.
        text: the file's text, to name the line of a wrong value; empty if there is no file.
        where: names the file in errors; empty if there is none.

    Returns:
        The design.

    Raises:
        InputError: one line naming the key, the value and the remedy.
    """
    return check_toml(data, Design, text, where)
