"""`campaign.toml`: the probe, the poses, the markers and the cameras of a campaign."""

import json
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, field_validator, model_validator
from scipy.spatial.transform import Rotation

from probedesign.core.csv_tables import read_text
from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.design import check_name
from probedesign.design.diagnostics import Inconsistent, Table, as_tuple, parse_toml
from probedesign.design.schema import MAX_GRAVITY
from probedesign.estimation.model import ProbeModel

FILE = "campaign.toml"
MAX_BYTES = 1_000_000
MAX_MARKERS = 500
#: Default standard deviations of the base pose: assumed, a bracket set with a caliper and a level.
STD_BASE_MM, STD_BASE_DEG = 0.2, 0.2
#: Standard deviation of the length scale of the reference, relative. Assumed: 0.5 mm on a box of 100 mm.
LENGTH_SCALE = 0.005
WEIGHT_STD = 0.005  #: Standard deviation of a known load, relative. Assumed: 5 mg on a weight of a gram.
#: Distance over which a robot's or a stage's repeatability becomes a rotation of the base [m]. Assumed: that of the
#: base from the last axis.
WRIST = 0.1

Coordinate = Annotated[float, Field(ge=-1e5, le=1e5)]
Std = Annotated[float, Field(gt=0.0, le=100.0)]
Point = Annotated[tuple[Coordinate, Coordinate, Coordinate], BeforeValidator(as_tuple)]
Angles = Annotated[tuple[float, float, float], BeforeValidator(as_tuple)]
Arclength = Annotated[float, Field(ge=0.0, le=400.0)]


class BaseTable(Table):
    """`[base]`: pose of the base frame in the world."""

    p_world_mm: Point = (0.0, 0.0, 0.0)
    rotation_world_deg: Angles = (0.0, 0.0, 0.0)
    std_mm: Annotated[float, Field(ge=0.0, le=100.0)] = STD_BASE_MM
    std_deg: Annotated[float, Field(ge=0.0, le=30.0)] = STD_BASE_DEG


class GravityTable(Table):
    """`[gravity]`: its vector in the world."""

    world_m_s2: Angles

    @model_validator(mode="after")
    def _plausible(self) -> Self:
        if not 0.0 < sum(g * g for g in self.world_m_s2) <= MAX_GRAVITY**2:
            given = f"= {list(self.world_m_s2)} is not a gravity of up to {MAX_GRAVITY:g} m/s²"
            raise Inconsistent("gravity.world_m_s2", f"{given}; with z up it is [0.0, 0.0, -9.81]")
        return self


class MarkersTable(Table):
    """`[markers]`: their arclengths and side."""

    s_mm: Annotated[tuple[Arclength, ...], BeforeValidator(as_tuple)]
    side_deg: Annotated[float, Field(ge=-360.0, le=360.0)] | None = None
    std_mm: Std | None = None

    @model_validator(mode="after")
    def _increasing(self) -> Self:
        if not 1 <= len(self.s_mm) <= MAX_MARKERS:
            raise Inconsistent("markers.s_mm", f"needs 1 to {MAX_MARKERS} arclengths")
        for i, (a, b) in enumerate(zip(self.s_mm, self.s_mm[1:], strict=False), 2):
            if b <= a:
                text = f"item {i}: {b:g} does not increase after {a:g}; marker 1 is the one nearest to the base"
                raise Inconsistent("markers.s_mm", text)
        return self


class CamerasTable(Table):
    """`[cameras]`: their names, as in the names of photographs, and how they are calibrated.

    By files of other programs (`calibration`), by `control_points.csv`, or both.
    """

    names: Annotated[tuple[str, ...], BeforeValidator(as_tuple)]
    distortion: Literal[0, 1, 2, 4, 5] | None = None
    calibration: Annotated[tuple[str, ...], BeforeValidator(as_tuple)] = ()
    length_unit: Literal["mm", "cm", "m"] | None = None
    reprojection_px: Annotated[float, Field(gt=0.0, le=20.0)] | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for name in self.calibration:
            if not name or Path(name).is_absolute() or ".." in Path(name).parts:
                text = f"{name[:40]!r} is not the name of a file in the data folder; copy it there"
                raise Inconsistent("cameras.calibration", text)
        for key in ("length_unit", "reprojection_px"):
            if getattr(self, key) is not None and not self.calibration:
                raise Inconsistent(f"cameras.{key}", "applies to calibration files, but cameras.calibration names none")
        if self.distortion is not None and self.calibration:
            text = "is that of the calibration files; remove the key"
            raise Inconsistent("cameras.distortion", text)
        if len(self.names) < 2 or len(set(self.names)) < len(self.names):
            raise Inconsistent("cameras.names", f"= {list(self.names)} must be two or more different names")
        for name in self.names:
            if not name.replace("_", "a").replace("-", "a").isalnum() or not name.isascii():
                text = f"{name[:40]!r} is not a valid name; use letters, digits, - and _"
                raise Inconsistent("cameras.names", text)
        return self


class WeighingTable(Table):
    """`[weighing]`: mass of the probe or of its flexible part."""

    mass_g: Annotated[float, Field(gt=0.0, le=10000.0)]
    std_g: Annotated[float, Field(gt=0.0, le=1000.0)]
    of: Literal["flexible", "probe"]


class Manifest(Table):
    """Contents of `campaign.toml`."""

    schema_version: Literal[1] = Field(alias="schema")
    probe: str
    fingerprint: str | None = None
    base: BaseTable = BaseTable()
    gravity: GravityTable
    markers: MarkersTable | None = None
    cameras: CamerasTable | None = None
    weighing: WeighingTable | None = None
    source: dict[str, Any] = Field(default_factory=dict)  # free text

    @field_validator("probe")
    @classmethod
    def _valid_name(cls, value: str) -> str:
        check_name(value)
        return value


def manifest_lines(
    about: str, model: ProbeModel, T_world_base: Array, std_base: tuple[float, float], gravity_world: Array
) -> list[str]:
    """Return the lines of a `campaign.toml` with the probe, the pose of its base and gravity.

    Args:
        about: first line, a comment.
        model: of the probe.
        T_world_base: (4, 4).
        std_base: standard deviations of its position [m] and of its rotation [rad], each about an axis.
        gravity_world: [m/s²], (3,).
    """
    rotation_deg = np.degrees(Rotation.from_matrix(T_world_base[:3, :3]).as_rotvec())
    return [
        f"# {about}",
        "schema = 1",
        f"probe = {json.dumps(model.name)}",
        f"fingerprint = {json.dumps(model.fingerprint)}   # of the geometry, in manifest.json and on the part",
        "",
        "[base]                      # pose of the base in the frame of the stage or of the cameras",
        f"p_world_mm = {number_list(T_world_base[:3, 3] / MM)}",
        f"rotation_world_deg = {number_list(rotation_deg)}",
        f"std_mm = {std_base[0] / MM:g}                # how well it is known",
        f"std_deg = {np.degrees(std_base[1]):g}",
        "",
        "[gravity]",
        f"world_m_s2 = {number_list(gravity_world)}",
    ]


def number_list(values: Array) -> str:
    """Return numbers as a list of TOML, to six decimals."""
    return "[" + ", ".join(repr(round(float(value), 6) + 0.0) for value in values) + "]"


def read_manifest(folder: Path) -> Manifest:
    """Read and check `campaign.toml` of a data folder.

    Raises:
        InputError: it is missing or invalid; one line.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such data folder; `probedesign campaign` makes an example")
    path = folder / FILE
    if not path.is_file():
        raise InputError(f"{folder}: has no {FILE}, so it is not a data folder; see docs/measurements.md")
    return parse_toml(read_text(path, "campaign file", MAX_BYTES, "TOML"), Manifest, str(path))
