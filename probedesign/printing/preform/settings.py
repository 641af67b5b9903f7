"""Which of PreForm's materials and settings a job takes: found in its own list, never guessed."""

import difflib
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from probedesign.design_problems import one_line, quoted
from probedesign.errors import InputError
from probedesign.printing.limits import LAYER
from probedesign.printing.preform.replies import Material, Materials, PrinterType, Setting

PREFERRED = {
    "elastic-50a": ("Elastic 50A V1", "Elastic 50A V2"),
    "flexible-80a": ("Flexible 80A V1",),
    "silicone-40a": ("Silicone 40A V1",),
    "rigid": ("Grey V4", "Grey V5"),
}
"""By resin, as PreForm labels them: first the one that the design's numbers were taken from."""


@dataclass(frozen=True)
class Chosen:
    """What a scene is made for.

    Attributes:
        printer, material, setting: as PreForm labels them.
        scene_settings: that make a scene of them.
    """

    printer: str
    material: str
    setting: str
    scene_settings: dict[str, Any]


def choose(materials: Materials, product: str, resin: str, material: str | None = None) -> Chosen:
    """The settings for a printer and a resin, in layers of 0.1 mm.

    Args:
        materials: PreForm's list.
        product: name of the printer, such as "Form 3".
        resin: of the design, or "rigid".
        material: as PreForm labels it, or its code; None for the resin's own.

    Raises:
        InputError: PreForm has no such printer, material or layer; it names those it has.
    """
    printer = _printer(materials, product)
    found = _asked(printer, material) if material else _preferred(printer, resin)
    setting = _setting(found, printer.label)
    return Chosen(product, found.label, setting.label, setting.scene_settings)


def _printer(materials: Materials, product: str) -> PrinterType:
    for printer in materials.printer_types:
        if product in printer.supported_product_names or product == printer.label:
            return printer
    raise InputError(f"PreForm knows no {product}; {_has(p.label for p in materials.printer_types)}")


def _asked(printer: PrinterType, name: str) -> Material:
    for material in printer.materials:
        codes = {setting.scene_settings.get("material_code") for setting in material.material_settings}
        if name.lower() == material.label.lower() or name in codes:
            return material
    labels = [material.label for material in printer.materials]
    near = difflib.get_close_matches(name, labels, 3, 0.5)
    raise InputError(
        f"--material {quoted(name)}: PreForm has none for a {printer.label}; {_has(near or labels)}"
    )


def _preferred(printer: PrinterType, resin: str) -> Material:
    wanted = PREFERRED[resin]
    by_label = {material.label: material for material in printer.materials}
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


def _setting(material: Material, printer: str) -> Setting:
    """The default in layers of 0.1 mm, not a legacy one."""
    layers = {s.scene_settings.get("layer_thickness_mm") for s in material.material_settings}
    fitting = [s for s in material.material_settings if s.scene_settings.get("layer_thickness_mm") == LAYER]
    if not fitting:
        raise InputError(
            f"{material.label} on a {printer}: PreForm has no layer of {LAYER:g} mm; {_has(map(str, layers))}"
        )
    return min(fitting, key=lambda s: ("default" not in s.label.lower(), "legacy" in s.label.lower()))


def _has(names: Iterable[str]) -> str:
    return one_line(f"it has: {', '.join(names) or 'none'}")
