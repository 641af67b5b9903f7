"""What PreForm answers, checked at the door: only what is used, everything else is passed over."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

Id = Annotated[str, Field(pattern=r"^\{?[A-Za-z0-9][A-Za-z0-9._-]{0,63}\}?$")]
"""It becomes part of an address."""
Words = Annotated[str, Field(max_length=200)]
Corner = tuple[float, float, float]


class Reply(BaseModel):
    """Any answer of PreForm's."""

    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)


class Version(Reply):
    """Of the API."""

    version: Words


class Accepted(Reply):
    """A long operation that goes on by itself."""

    operationId: Id | None = None


class Operation(Reply):
    """How far it is, and its result: that of the call, or its error."""

    status: Literal["IN_PROGRESS", "SUCCEEDED", "FAILED"]
    progress: float = 0.0
    result: dict[str, Any] | None = None


class Point(Reply):
    """In the build volume [mm]."""

    x: float
    y: float
    z: float


class Box(Reply):
    """Around a model."""

    min_corner: Point
    max_corner: Point

    @property
    def size(self) -> Corner:
        """Along x, y and z [mm]."""
        a, b = self.min_corner, self.max_corner
        return (b.x - a.x, b.y - a.y, b.z - a.z)


class Model(Reply):
    """A part in a scene; None where PreForm does not say."""

    id: Id
    bounding_box: Box | None = None
    in_bounds: bool | None = None
    has_supports: bool | None = None


class Usage(Reply):
    """Resin."""

    volume_ml: float | None = None


class Scene(Reply):
    """A job in the making."""

    id: Id
    models: tuple[Model, ...] = ()
    layer_count: int | None = None
    material_usage: Usage = Usage()


class Checked(Reply):
    """What print validation says of a model."""

    cups: int = 0
    unsupported_minima: int = 0
    undersupported: bool = False


class Validation(Reply):
    """Of all models, by id."""

    per_model_results: dict[str, Checked] = {}


class Estimate(Reply):
    """Of the time to print."""

    total_print_time_s: float


class Uploaded(Reply):
    """A job that a printer has."""

    job_id: Words = ""


class Setting(Reply):
    """One way to print a material; `scene_settings` makes a scene of it."""

    label: Words = ""
    scene_settings: dict[str, str | float | None]


class Material(Reply):
    """A resin with its version."""

    label: Words
    material_settings: tuple[Setting, ...] = ()


class PrinterType(Reply):
    """Printers that print alike."""

    label: Words
    supported_product_names: tuple[str, ...] = ()
    materials: tuple[Material, ...] = ()


class Materials(Reply):
    """All that PreForm can print on anything."""

    printer_types: tuple[PrinterType, ...]
