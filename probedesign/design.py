"""The design file: what `designs/NAME.toml` may say, checked at the door.

A bad file never gets further than `load_design`: unknown keys, wrong types, values out of range and
shapes that do not hold together all become one line that names the key, the value, the remedy and the
line of the file.
"""

import math
import re
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from probedesign.design_problems import Inconsistent, first_problem, one_line, quoted
from probedesign.errors import InputError
from probedesign.materials import Provenance, Quantity, Resin, resin_named
from probedesign.printer import Printer, printer_named
from probedesign.robot_flange import RobotFlange, robot_flange_named
from probedesign.sensor import Calibration, SensorModel, sensor_named
from probedesign.units import MPA

Shape = Literal["cone", "cylinder", "profile"]
NAME_PATTERN = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
MAX_GRAVITY = 30.0
"""More than this in m/s² [m/s²] is a slip of units: nothing but a centrifuge pulls harder."""
MAX_PROFILE_POINTS = 64

MIN_DIAMETER_MM, MAX_DIAMETER_MM = 0.3, 60.0

Length = Annotated[float, Field(ge=5.0, le=400.0)]
Diameter = Annotated[float, Field(ge=MIN_DIAMETER_MM, le=MAX_DIAMETER_MM)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class ProbeTable(_Table):
    """`[probe]`: the flexible part. All lengths in millimetres."""

    shape: Shape = "cone"
    length_mm: Length
    base_d_mm: Diameter
    tip_d_mm: Diameter | None = None
    profile_mm: tuple[tuple[float, float], ...] | None = None
    assumed: tuple[str, ...] = ()

    @field_validator("profile_mm", "assumed", mode="before")
    @classmethod
    def _tuples(cls, value: Any) -> Any:
        return _as_tuple(value)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for name in self.assumed:
            if name not in ("length_mm", "base_d_mm", "tip_d_mm", "profile_mm"):
                raise Inconsistent("assumed", f"'{name}' is not a dimension of [probe]")
        match self.shape:
            case "cone":
                self._check_cone()
            case "cylinder":
                self._check_cylinder()
            case "profile":
                self._check_profile()
        return self

    def _check_cone(self) -> None:
        if self.profile_mm is not None:
            raise Inconsistent("profile_mm", 'is only for shape = "profile"; remove it or change the shape')
        if self.tip_d_mm is None:
            raise Inconsistent("tip_d_mm", "is missing; a cone needs its tip diameter")
        if self.tip_d_mm > self.base_d_mm:
            raise Inconsistent(
                "tip_d_mm",
                f"= {self.tip_d_mm!r} is wider than base_d_mm = {self.base_d_mm!r}; a cone tapers to its tip",
            )

    def _check_cylinder(self) -> None:
        if self.profile_mm is not None:
            raise Inconsistent("profile_mm", 'is only for shape = "profile"; remove it or change the shape')
        if self.tip_d_mm is not None and self.tip_d_mm != self.base_d_mm:
            raise Inconsistent(
                "tip_d_mm",
                f"= {self.tip_d_mm!r} differs from base_d_mm = {self.base_d_mm!r}; "
                "a cylinder has one diameter: leave it out",
            )

    def _check_profile(self) -> None:
        points = self.profile_mm
        if points is None or not 2 <= len(points) <= MAX_PROFILE_POINTS:
            raise Inconsistent("profile_mm", f"needs 2 to {MAX_PROFILE_POINTS} pairs [s, diameter]")
        for i, (s, d) in enumerate(points):
            if not MIN_DIAMETER_MM <= d <= MAX_DIAMETER_MM:
                allowed = f"{MIN_DIAMETER_MM:g} ... {MAX_DIAMETER_MM:g} mm"
                raise Inconsistent("profile_mm", f"pair {i + 1}: diameter {d!r} is outside {allowed}")
            if i and s <= points[i - 1][0]:
                raise Inconsistent(
                    "profile_mm", f"pair {i + 1}: s = {s!r} does not increase after {points[i - 1][0]!r}"
                )
        first, last = points[0], points[-1]
        self._check_equal("s of the first pair", first[0], "0", 0.0)
        self._check_equal("s of the last pair", last[0], "length_mm", self.length_mm)
        self._check_equal("the first diameter", first[1], "base_d_mm", self.base_d_mm)
        if self.tip_d_mm is not None:
            self._check_equal("the last diameter", last[1], "tip_d_mm", self.tip_d_mm)

    def _check_equal(self, what: str, value: float, name: str, wanted: float) -> None:
        if value != wanted:
            raise Inconsistent("profile_mm", f"{what} is {value!r}, it must equal {name} = {wanted!r}")

    @property
    def knots_mm(self) -> tuple[tuple[float, float], ...]:
        """(s, diameter) where the taper may change [mm]."""
        if self.profile_mm is not None:
            return self.profile_mm
        tip = self.base_d_mm if self.tip_d_mm is None else self.tip_d_mm
        return ((0.0, self.base_d_mm), (self.length_mm, tip))


class ProvenanceTable(_Table):
    """`[material.provenance]`: where each number of `[material]` comes from."""

    youngs_modulus_mpa: Provenance = "assumed"
    shear_modulus_mpa: Provenance = "assumed"
    density_kg_m3: Provenance = "assumed"


class MaterialTable(_Table):
    """`[material]`: a resin by name; numbers given here go before the resin's."""

    resin: str = "elastic-50a"
    youngs_modulus_mpa: Annotated[float, Field(ge=0.01, le=1e5)] | None = None
    shear_modulus_mpa: Annotated[float, Field(ge=0.003, le=1e5)] | None = None
    density_kg_m3: Annotated[float, Field(ge=100.0, le=20000.0)] | None = None
    shear_coefficient: Annotated[float, Field(ge=0.1, le=1.2)] = 1.0
    provenance: ProvenanceTable = ProvenanceTable()


class SensorTable(_Table):
    """`[sensor]`: which sensor, which calibration, how many samples make one reading."""

    model: str = "nano17"
    calibration: str = "si-12-0.12"
    averaging_samples: Annotated[int, Field(ge=1, le=70000)] = 36


class MountTable(_Table):
    """`[mount]`: how the probe hangs on the robot."""

    robot_flange: str = "iso-9409-1-50-4-m6"
    gravity_base_m_s2: tuple[float, float, float] = (9.81, 0.0, 0.0)
    root_rigid_radii: Annotated[float, Field(ge=0.0, le=2.0)] = 0.12

    @field_validator("gravity_base_m_s2", mode="before")
    @classmethod
    def _triple(cls, value: Any) -> Any:
        return _as_tuple(value)

    @model_validator(mode="after")
    def _plausible(self) -> Self:
        if math.hypot(*self.gravity_base_m_s2) > MAX_GRAVITY:
            given = f"= {list(self.gravity_base_m_s2)} is longer than {MAX_GRAVITY:g} m/s²"
            raise Inconsistent("gravity_base_m_s2", f"{given}; give it in m/s², e.g. [9.81, 0.0, 0.0]")
        return self


class PrintTable(_Table):
    """`[print]`: on what the parts are printed."""

    printer: str = "form-3"


class Design(_Table):
    """One probe, as its design file says it."""

    schema_version: Literal[1] = Field(alias="schema")
    name: str
    probe: ProbeTable
    material: MaterialTable = MaterialTable()
    sensor: SensorTable = SensorTable()
    mount: MountTable = MountTable()
    print_: PrintTable = Field(default=PrintTable(), alias="print")

    @field_validator("name")
    @classmethod
    def _plain(cls, value: str) -> str:
        check_name(value)
        return value

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
        """The named robot flange."""
        return robot_flange_named(self.mount.robot_flange)

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
        # A flange as soft as the probe may hold less firmly than the bonded face that 0.12 was found for.
        root = ("mount.root_rigid_radii",) if self.mount.root_rigid_radii > 0.0 else ()
        return (*dimensions, *(k for k, q in quantities.items() if q.provenance == "assumed"), *root)


def _as_tuple(value: Any) -> Any:
    """A TOML array, and the arrays in it, as tuples; anything else unchanged, for pydantic to refuse."""
    if not isinstance(value, list):
        return value
    return tuple(tuple(v) if isinstance(v, list) else v for v in value)


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
    try:
        data = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # ValueError: also an integer of thousands of digits
        raise InputError(f"{where}: not valid TOML: {one_line(str(error))}") from None
    return check_design(data, text, where)


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
    try:
        return Design.model_validate(data)
    except ValidationError as error:
        line, problem = first_problem(error, Design, text)
    place = f"{where}:{line}: " if line else f"{where}: "
    raise InputError(f"{place if where else ''}{problem}")
