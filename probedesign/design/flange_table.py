"""`[mount.flange]` of a design file: a robot flange that is not in the catalog."""

import math
from dataclasses import replace
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from probedesign.core.units import MM
from probedesign.design.catalog import CUSTOM, RobotFlange
from probedesign.design.diagnostics import FromArray, Inconsistent, Table

Millimetres = Annotated[float, Field(gt=0.0, le=300.0)]


class FlangeTable(Table):
    """`[mount.flange]`: azimuths are measured from the dowel; `recess_d_mm` is of the recess that takes the spigot."""

    bolt: Literal["M4", "M5", "M6", "M8"]
    bolt_circle_d_mm: Millimetres
    bolt_azimuths_deg: Annotated[tuple[float, ...], FromArray]
    max_bolt_entry_mm: Millimetres
    bolt_length_mm: Millimetres
    face_d_mm: Millimetres
    pin_slot_mm: Annotated[tuple[Millimetres, Millimetres] | None, FromArray] = None
    spigot_mm: Annotated[tuple[Millimetres, Millimetres] | None, FromArray] = None
    recess_d_mm: Millimetres | None = None

    @model_validator(mode="after")
    def _bolted(self) -> Self:
        if not 2 <= len(self.bolt_azimuths_deg) <= 12:
            raise Inconsistent("bolt_azimuths_deg", "needs 2 to 12 angles from the dowel")
        spigot_d, _ = self.spigot_mm or (math.inf, 0.0)
        if self.recess_d_mm is not None and self.recess_d_mm <= spigot_d:
            raise Inconsistent("recess_d_mm", f"= {self.recess_d_mm:g} needs a spigot_mm that is narrower")
        return self

    @property
    def record(self) -> RobotFlange:
        """Return the flange in SI units; without the robot's recess that of a play of 0.2 mm is assumed."""
        slot, spigot = ((pair[0] * MM, pair[1] * MM) for pair in (self.pin_slot_mm or (0, 0), self.spigot_mm or (0, 0)))
        flange = RobotFlange(
            CUSTOM, self.bolt_circle_d_mm * MM, self.bolt_azimuths_deg, self.bolt, self.max_bolt_entry_mm * MM,
            self.bolt_length_mm * MM, slot, spigot, self.face_d_mm * MM, "design file, mount.flange",
        )  # fmt: skip
        return flange if self.recess_d_mm is None else replace(flange, spigot_play=self.recess_d_mm * MM - spigot[0])
