"""Everything about a drawn design that is for the eye: pictures, drawings, the bill and the assembly page."""

from collections.abc import Mapping
from dataclasses import dataclass

from probedesign.cad.bill import Item, bill_of, csv_bytes
from probedesign.cad.drawing import Drawing
from probedesign.cad.explosion import Label, exploded_svg, step_pictures
from probedesign.cad.mesh import Mesh
from probedesign.cad.page import page_of
from probedesign.cad.part_sheets import sheets_of
from probedesign.cad.picture import body_of, preview
from probedesign.cad.steps import steps_of
from probedesign.units import MM

PART_SIZE, ASSEMBLY_SIZE = (640, 640), (800, 1000)


@dataclass(frozen=True)
class Documents:
    """What was made.

    Attributes:
        files: by name.
        bill: of materials.
        steps: what to do, in order.
    """

    files: dict[str, bytes]
    bill: list[Item]
    steps: list[str]


def documents_of(drawing: Drawing, meshes: Mapping[str, Mesh]) -> Documents:
    """All documents of an export.

    Args:
        drawing: of the design.
        meshes: of the printed parts, by name.
    """
    bodies = {name: body_of(part, meshes.get(name)) for name, part in drawing.parts.items()}
    bill, steps = bill_of(drawing), steps_of(drawing.screws, drawing.plate.robot.pin_d)
    labels = {item.name: Label(item.number, (item.title, _told(item))) for item in bill}
    seat = float(drawing.adapter.T_sensor_base[2, 3]) / MM
    exploded = exploded_svg(bodies, labels, f"{drawing.design.name}: all parts drawn apart", seat)
    files = {f"{part.name}.png": preview([bodies[part.name]], PART_SIZE) for part in drawing.printed}
    files |= {f"{name}.svg": sheet for name, sheet in sheets_of(drawing).items()}
    files["assembly.png"] = preview(list(bodies.values()), ASSEMBLY_SIZE)
    files["exploded.svg"] = bytes(exploded)
    files["bill_of_materials.csv"] = csv_bytes(bill)
    files["assembly.html"] = page_of(drawing, bill, steps, exploded, step_pictures(bodies, steps, seat))
    return Documents(files, bill, [step.text for step in steps])


def _told(item: Item) -> str:
    """What a part is, under its name in the exploded picture."""
    if item.file:
        return f"{item.what}, {item.material}"
    return f"{item.quantity} × {item.what}" if item.quantity > 1 else item.what
