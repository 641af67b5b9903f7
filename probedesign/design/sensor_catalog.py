"""Sensor files and the known sensors: TOML files that describe a force/moment sensor, in the units of a data sheet.

The known sensors are the files in `sensor_files/`, so each of them is a template for a user's own. Lengths are in
millimetres and in the sensor frame: origin at the centre of the tool face, +X through a dowel hole, +Z out of the face.
"""

import math
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from probedesign.core.csv_tables import read_text
from probedesign.core.errors import quoted
from probedesign.core.files import MAX_TOML, check_regular, is_plain_name
from probedesign.core.units import GRAM, MM
from probedesign.design.catalog import SCREWS
from probedesign.design.diagnostics import FromArray, Inconsistent, Table, known_keys, parse_toml
from probedesign.design.sensors import (
    DEFAULT_SENSOR,
    CableExit,
    DowelPattern,
    ScrewPattern,
    SensorCalibration,
    SensorInterface,
    SensorModel,
)

FILES = Path(__file__).parent / "sensor_files"  #: Folder of the known sensors.

Positive = Annotated[float, Field(gt=0.0, le=1e5)]
Millimetres = Annotated[float, Field(gt=0.0, le=300.0)]
Degrees = Annotated[float, Field(ge=-360.0, le=360.0)]
Azimuths = Annotated[tuple[Degrees, ...], FromArray]
Three = Annotated[tuple[Positive, Positive, Positive], FromArray]
Text = Annotated[str, Field(min_length=1, max_length=400)]


def _check_holes(key: str, azimuths_deg: tuple[float, ...], fewest: int, most: int, apart_deg: float) -> None:
    """Refuse a circle with too few holes, or with two that overlap.

    Raises:
        Inconsistent: names the key.
    """
    if not fewest <= len(azimuths_deg) <= most:
        allowed = f"{fewest}" if fewest == most else f"{fewest} to {most}"
        raise Inconsistent(key, f"has {len(azimuths_deg)} holes; it needs {allowed}")
    sorted_deg = sorted(a % 360.0 for a in azimuths_deg)
    gaps = np.diff([*sorted_deg, sorted_deg[0] + 360.0])
    if gaps.min() < apart_deg:
        raise Inconsistent(key, f"has holes {gaps.min():.3g}° apart, which overlap; at least {apart_deg:.3g}°")


def _hole_deg(diameter: float, circle_d: float) -> float:
    """Return the angle between two holes on a circle that touch [deg]."""
    return 2.0 * math.degrees(math.asin(min(1.0, diameter / circle_d)))


class ScrewTable(Table):
    """`[interface.tool]`, `[interface.mounting]`: equal threaded holes on a bolt circle in one face, or one hole on
    the axis, with a circle of 0."""

    face_d_mm: Millimetres
    bolt_circle_d_mm: Annotated[float, Field(ge=0.0, le=300.0)]
    azimuths_deg: Azimuths
    screw: Literal["M2", "M3", "M4", "M5", "M6"]
    min_entry_mm: Millimetres
    max_entry_mm: Millimetres

    @model_validator(mode="after")
    def _drilled(self) -> Self:
        d_mm = SCREWS[self.screw].nominal_d / MM
        if self.bolt_circle_d_mm > 0.0:
            _check_holes("azimuths_deg", self.azimuths_deg, 3, 12, _hole_deg(d_mm, self.bolt_circle_d_mm))
        elif (count := len(self.azimuths_deg)) != 1:
            raise Inconsistent("azimuths_deg", f"has {count} holes; bolt_circle_d_mm = 0 has one, on the axis")
        if self.bolt_circle_d_mm + d_mm > self.face_d_mm:
            raise Inconsistent(
                "bolt_circle_d_mm",
                f"= {self.bolt_circle_d_mm:g} leaves the holes outside the face; at most {self.face_d_mm - d_mm:g}",
            )
        if self.min_entry_mm > self.max_entry_mm:
            raise Inconsistent("min_entry_mm", f"= {self.min_entry_mm:g} is above max_entry_mm = {self.max_entry_mm:g}")
        return self

    @property
    def pattern(self) -> ScrewPattern:
        """Return the holes in SI units."""
        return ScrewPattern(
            self.face_d_mm * MM, self.bolt_circle_d_mm * MM, self.azimuths_deg, SCREWS[self.screw],
            min_entry=self.min_entry_mm * MM, max_entry=self.max_entry_mm * MM,
        )  # fmt: skip


class DowelTable(Table):
    """`[interface.dowels]`: one or two dowel holes in the tool face; without the table it has none."""

    diameter_mm: Millimetres
    depth_mm: Millimetres
    circle_d_mm: Millimetres
    azimuths_deg: Azimuths
    pin_length_mm: Millimetres

    @model_validator(mode="after")
    def _drilled(self) -> Self:
        _check_holes("azimuths_deg", self.azimuths_deg, 1, 2, _hole_deg(self.diameter_mm, self.circle_d_mm))
        if self.pin_length_mm <= self.depth_mm:
            raise Inconsistent(
                "pin_length_mm", f"= {self.pin_length_mm:g} ends in its hole, {self.depth_mm:g} mm deep; take longer"
            )
        return self


class CableTable(Table):
    """`[interface.cable]`: the cable's exit, and the sector that is kept free for the cable."""

    azimuth_deg: Degrees
    half_width_deg: Annotated[float, Field(gt=0.0, le=90.0)] = 25.0
    free_height_mm: Millimetres
    width_mm: Millimetres
    reach_mm: Millimetres
    heights_mm: Annotated[tuple[Annotated[float, Field(ge=0.0, le=300.0)], Millimetres], FromArray]

    @model_validator(mode="after")
    def _upright(self) -> Self:
        low, high = self.heights_mm
        if low >= high:
            raise Inconsistent("heights_mm", f"= [{low:g}, {high:g}]: the lower face comes first")
        return self


class InterfaceTable(Table):
    """`[interface]`: body, holes, cable and mass."""

    body_d_mm: Millimetres
    height_mm: Millimetres
    mass_g: Annotated[float, Field(gt=0.0, le=10000.0)]
    p_com_mm: Annotated[tuple[float, float, float] | None, FromArray] = None
    tool: ScrewTable
    mounting: ScrewTable
    dowels: DowelTable | None = None
    cable: CableTable

    @model_validator(mode="after")
    def _whole(self) -> Self:
        for key, face in (("tool", self.tool), ("mounting", self.mounting)):
            if face.face_d_mm > self.body_d_mm:
                raise Inconsistent(
                    f"interface.{key}.face_d_mm", f"= {face.face_d_mm:g} is wider than body_d_mm = {self.body_d_mm:g}"
                )
        if self.mounting.bolt_circle_d_mm == 0.0:
            raise Inconsistent(
                "interface.mounting.bolt_circle_d_mm", "= 0: only the tool side may have one centre thread"
            )
        if self.tool.max_entry_mm + self.mounting.max_entry_mm > self.height_mm:
            raise Inconsistent("height_mm", f"= {self.height_mm:g} is less than the depths of the screws together")
        if self.cable.heights_mm[1] > self.height_mm:
            raise Inconsistent("interface.cable.heights_mm", f"end above the tool face, height_mm = {self.height_mm:g}")
        screw_d, dowels = SCREWS[self.tool.screw].nominal_d / MM, self.dowels
        if dowels is None:
            return self
        if dowels.circle_d_mm + dowels.diameter_mm > self.tool.face_d_mm:
            raise Inconsistent("dowels.circle_d_mm", f"= {dowels.circle_d_mm:g} leaves the holes outside the face")
        bolts = _points(self.tool.bolt_circle_d_mm, self.tool.azimuths_deg)
        pins = _points(dowels.circle_d_mm, dowels.azimuths_deg)
        apart = float(np.abs(bolts[:, None] - pins[None]).min())
        if apart < (needed := (screw_d + dowels.diameter_mm) / 2.0):
            raise Inconsistent(
                "interface.dowels.azimuths_deg", f"has a hole {apart:.3g} mm from a screw's, at least {needed:g} mm"
            )
        return self

    @property
    def interface(self) -> SensorInterface:
        """Return the interface in SI units; without a centre of mass that of a uniform body is assumed."""
        d, c = self.dowels, self.cable
        x, y, z = self.p_com_mm or (0.0, 0.0, -self.height_mm / 2.0)
        return SensorInterface(
            body_d=self.body_d_mm * MM,
            height=self.height_mm * MM,
            tool=self.tool.pattern,
            mounting=self.mounting.pattern,
            dowels=DowelPattern(0.0, 0.0, 0.0, (), 0.0) if d is None else DowelPattern(
                d.diameter_mm * MM, d.depth_mm * MM, d.circle_d_mm * MM, d.azimuths_deg, d.pin_length_mm * MM
            ),
            cable=CableExit(
                c.azimuth_deg, c.half_width_deg, c.free_height_mm * MM, c.width_mm * MM, c.reach_mm * MM,
                (c.heights_mm[0] * MM, c.heights_mm[1] * MM),
            ),
            mass=self.mass_g * GRAM,
            p_com=(x * MM, y * MM, z * MM),
        )  # fmt: skip


def _points(circle_d_mm: float, azimuths_deg: tuple[float, ...]) -> np.ndarray:
    """Return points on a circle as complex numbers [mm]."""
    return np.asarray(circle_d_mm / 2.0 * np.exp(1j * np.radians(azimuths_deg)))


class NoiseTable(Table):
    """`[noise]`: of one sample, in the order Fx, Fy, Fz [N], Mx, My, Mz [N·m]: `std` or `cov`."""

    std: Annotated[tuple[Positive, ...] | None, FromArray] = None
    cov: Annotated[tuple[tuple[float, ...], ...] | None, FromArray] = None

    @model_validator(mode="after")
    def _definite(self) -> Self:
        if (self.std is None) == (self.cov is None):
            raise Inconsistent("std", "or noise.cov is needed, one of the two")
        if self.std is not None and len(self.std) != 6:
            raise Inconsistent("std", f"has {len(self.std)} numbers; it needs six")
        if self.cov is None:
            return self
        if len(self.cov) != 6 or any(len(row) != 6 for row in self.cov):
            raise Inconsistent("cov", "needs six rows of six numbers")
        cov = np.array(self.cov)
        std = np.sqrt(np.abs(np.diag(cov)))
        if not np.allclose(cov, cov.T, rtol=1e-9, atol=0.0):
            raise Inconsistent("cov", "is not symmetric")
        # Scaled to a correlation, since N² and (N·m)² differ by many powers of ten.
        if not (np.diag(cov) > 0.0).all() or np.linalg.eigvalsh(cov / np.outer(std, std))[0] < 1e-9:
            raise Inconsistent("cov", "is not positive definite; check its variances and correlations")
        return self

    @property
    def sample_cov(self) -> tuple[tuple[float, ...], ...]:
        """Return the covariance of one sample [N, N·m], six rows, exactly symmetric."""
        cov = np.diag(np.square(self.std)) if self.std is not None else np.array(self.cov)
        return tuple(tuple(row) for row in ((cov + cov.T) / 2.0).tolist())


def _plain_name(value: str) -> str:
    if not is_plain_name(value):
        raise Inconsistent("name", f"= {quoted(value)} is not a plain name; use letters, digits, '-', '_' and '.'")
    return value


PlainName = Annotated[str, AfterValidator(_plain_name)]


class CalibrationTable(Table):
    """`[[calibrations]]`: ranges and resolution of one calibration; without resolution that of the noise is taken."""

    name: PlainName
    range_N: Three
    range_Nm: Three
    resolution_N: Three | None = None
    resolution_Nm: Three | None = None


class SensorRecord(Table):
    """A sensor file."""

    name: PlainName
    product: Text
    source: Text
    assumed: Annotated[tuple[str, ...], FromArray] = ()
    overload_N: Three | None = None
    overload_Nm: Three | None = None
    interface: InterfaceTable
    noise: NoiseTable | None = None
    calibrations: Annotated[tuple[CalibrationTable, ...], FromArray]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        known = known_keys(type(self))
        for key in self.assumed:
            if key not in known:
                raise Inconsistent("assumed", f"{quoted(key)} is not a key of a sensor file")
        if not self.calibrations:
            raise Inconsistent("calibrations", "is empty; it needs at least one")
        names = [c.name for c in self.calibrations]
        if len(set(names)) < len(names):
            raise Inconsistent("calibrations", "has two of one name")
        for c in self.calibrations:
            given = c.resolution_N is not None, c.resolution_Nm is not None
            if not all(given) and (any(given) or self.noise is None):
                raise Inconsistent(
                    "noise", f"is missing; calibration {c.name!r} has no complete resolution from which it could follow"
                )
        if (self.overload_N is None) != (self.overload_Nm is None):
            raise Inconsistent("overload_N", "and overload_Nm belong together; give both or none")
        return self

    @cached_property
    def sensor(self) -> SensorModel:
        """Return the sensor in SI units."""
        overload = None if self.overload_N is None else (*self.overload_N, *(self.overload_Nm or ()))
        return SensorModel(
            name=self.name,
            product=self.product,
            interface=self.interface.interface,
            calibrations=tuple(self._calibration(c) for c in self.calibrations),
            source=self.source,
            assumed=self.assumed,
            overload=overload,
        )

    def _calibration(self, table: CalibrationTable) -> SensorCalibration:
        cov = None if self.noise is None else self.noise.sample_cov
        if table.resolution_N is not None and table.resolution_Nm is not None:
            resolution: tuple[float, ...] = (*table.resolution_N, *table.resolution_Nm)
        else:
            resolution = tuple(np.sqrt(np.diag(np.array(cov))).tolist())
        return SensorCalibration(table.name, (*table.range_N, *table.range_Nm), resolution, cov)


def load_sensor(path: Path) -> SensorRecord:
    """Read and check a sensor file.

    Raises:
        InputError: the file cannot be read, is not TOML, or has a wrong value; one line.
    """
    check_regular(path)
    return parse_toml(read_text(path, "sensor file", MAX_TOML, kind="TOML"), SensorRecord, str(path))


#: Known sensors by name, the default first.
SENSORS: dict[str, SensorModel] = {
    sensor.name: sensor
    for sensor in sorted((load_sensor(path).sensor for path in sorted(FILES.glob("*.toml"))),
                         key=lambda sensor: sensor.name != DEFAULT_SENSOR)
}  # fmt: skip
