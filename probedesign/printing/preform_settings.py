"""Schemas of PreForm's responses, and the choice of material and settings for a job.

Only the fields in use are validated; others are ignored. Materials and settings are found in PreForm's own list.
"""

import difflib
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from probedesign.core.errors import InputError
from probedesign.design.catalog import RESINS, RIGID_PREFORM_LABELS
from probedesign.design.diagnostics import one_line, quoted
from probedesign.printing.check import LAYER

Id = Annotated[str, Field(pattern=r"^\{?[A-Za-z0-9][A-Za-z0-9._-]{0,63}\}?$")]
"""Pattern of an id; it becomes part of an address."""
Text = Annotated[str, Field(max_length=200)]
Extent = tuple[float, float, float]


class Reply(BaseModel):
    """Base of all responses."""

    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)


class VersionReply(Reply):
    """The version of the API."""

    version: Text


class OperationAccepted(Reply):
    """A long operation that continues in the background."""

    operationId: Id | None = None


class OperationStatus(Reply):
    """The progress of a long operation, and its result: that of the call, or its error."""

    status: Literal["IN_PROGRESS", "SUCCEEDED", "FAILED"]
    progress: float = 0.0
    result: dict[str, Any] | None = None


class BuildPoint(Reply):
    """A point in the build volume [mm]."""

    x: float
    y: float
    z: float


class BoundingBox(Reply):
    """The bounding box of a model."""

    min_corner: BuildPoint
    max_corner: BuildPoint

    @property
    def size(self) -> Extent:
        """Return the extent along x, y and z [mm]."""
        a, b = self.min_corner, self.max_corner
        return (b.x - a.x, b.y - a.y, b.z - a.z)


class SceneModel(Reply):
    """A part in a scene; None where PreForm gives no value."""

    id: Id
    bounding_box: BoundingBox | None = None
    in_bounds: bool | None = None
    has_supports: bool | None = None


class MaterialUsage(Reply):
    """The resin that a print needs."""

    volume_ml: float | None = None


class PrintScene(Reply):
    """A print job under preparation."""

    id: Id
    models: tuple[SceneModel, ...] = ()
    layer_count: int | None = None
    material_usage: MaterialUsage = MaterialUsage()


class ModelValidation(Reply):
    """The result of print validation for one model."""

    cups: int = 0
    unsupported_minima: int = 0
    undersupported: bool = False


class PrintValidation(Reply):
    """The result of print validation for all models, by id."""

    per_model_results: dict[str, ModelValidation] = {}


class PrintTimeEstimate(Reply):
    """The estimated print time."""

    total_print_time_s: float


class UploadedJob(Reply):
    """A job in a printer's queue."""

    job_id: Text = ""


class PrintSetting(Reply):
    """One setting of a material; `scene_settings` are the parameters of a scene."""

    label: Text = ""
    scene_settings: dict[str, str | float | None]


class PrintMaterial(Reply):
    """A material with its version."""

    label: Text
    material_settings: tuple[PrintSetting, ...] = ()


class PrinterType(Reply):
    """Printers with common materials and settings."""

    label: Text
    supported_product_names: tuple[str, ...] = ()
    materials: tuple[PrintMaterial, ...] = ()


class MaterialList(Reply):
    """All printers and materials that PreForm supports."""

    printer_types: tuple[PrinterType, ...]


RIGID = "rigid"
"""Name of the material of the rigid parts, beside those of the resins."""


@dataclass(frozen=True)
class PrintSelection:
    """The printer, material and setting of a scene."""

    printer: str  #: printer, material, setting: as PreForm labels them.
    material: str
    setting: str
    scene_settings: dict[str, Any]  #: the parameters that create the scene.


def select_settings(materials: MaterialList, product: str, resin: str, material: str | None = None) -> PrintSelection:
    """Return the settings for a printer and a resin, in layers of 0.1 mm.

    Args:
        materials: PreForm's list.
        product: name of the printer, such as "Form 3".
        resin: of the design, or "rigid".
        material: PreForm's label or code; None for the resin's default.

    Raises:
        InputError: PreForm has no such printer, material or layer, or the resin has no default; names what PreForm has.
    """
    printer = next((p for p in materials.printer_types if product in (p.label, *p.supported_product_names)), None)
    if printer is None:
        known = _has(p.label for p in materials.printer_types)
        raise InputError(f"PreForm knows no {product}; {known}")
    found = _asked(printer, material) if material else _preferred(printer, resin)
    setting = _setting(found, printer.label)
    return PrintSelection(product, found.label, setting.label, setting.scene_settings)


def _asked(printer: PrinterType, name: str) -> PrintMaterial:
    for material in printer.materials:
        codes = {setting.scene_settings.get("material_code") for setting in material.material_settings}
        if name.lower() == material.label.lower() or name in codes:
            return material
    labels = [material.label for material in printer.materials]
    near = difflib.get_close_matches(name, labels, 3, 0.5)
    raise InputError(f"--material {quoted(name)}: PreForm has none for a {printer.label}; {_has(near or labels)}")


def _preferred(printer: PrinterType, resin: str) -> PrintMaterial:
    by_label = {material.label: material for material in printer.materials}
    known = RESINS.get(resin)
    wanted = RIGID_PREFORM_LABELS if resin == RIGID else known.preform_labels if known else ()
    if not wanted:
        raise InputError(
            f"{resin}: its name in PreForm is unknown; --material names one of the {printer.label}; {_has(by_label)}"
        )
    for label in wanted:
        if label in by_label:
            return by_label[label]
    same = sorted(label for label in by_label if _family(label) == _family(wanted[0]))
    if same:
        return by_label[same[-1]]
    raise InputError(
        f"PreForm has no {_family(wanted[0])} for a {printer.label}; --material takes another; {_has(by_label)}"
    )


def _family(label: str) -> str:
    return re.sub(r" V[\d.]+$", "", label)


def _setting(material: PrintMaterial, printer: str) -> PrintSetting:
    """Return the default setting in layers of 0.1 mm, preferring current settings over legacy ones."""
    layers = {s.scene_settings.get("layer_thickness_mm") for s in material.material_settings}
    fitting = [s for s in material.material_settings if s.scene_settings.get("layer_thickness_mm") == LAYER]
    if not fitting:
        raise InputError(
            f"{material.label} on a {printer}: PreForm has no layer of {LAYER:g} mm; {_has(map(str, layers))}"
        )
    return min(fitting, key=lambda s: ("default" not in s.label.lower(), "legacy" in s.label.lower()))


def _has(names: Iterable[str]) -> str:
    return one_line(f"it has: {', '.join(names) or 'none'}")
