"""The drawings of an export: a sheet for each printed part, as SVG and DXF, and all sheets in one PDF."""

from collections.abc import Callable

from probedesign.cad.drawing import Sheet
from probedesign.cad.drawing_files import dxf_bytes, pdf_bytes, svg_bytes
from probedesign.cad.model import CadModel, CadPart
from probedesign.cad.probe_drawing import probe_sheet
from probedesign.cad.rigid_drawings import clamp_ring_sheet, flange_adapter_sheet, sensor_adapter_sheet

SHEETS: dict[str, Callable[[CadModel, CadPart], Sheet]] = {
    "probe": probe_sheet,
    "sensor_adapter": sensor_adapter_sheet,
    "clamp_ring": clamp_ring_sheet,
    "flange_adapter": flange_adapter_sheet,
}
PDF_FILE = "drawings.pdf"


def part_drawings(model: CadModel) -> dict[str, bytes]:
    """Return the files of the drawings by name: an SVG and a DXF of each printed part, and a PDF with all sheets."""
    sheets = {name: draw(model, model.parts[name]) for name, draw in SHEETS.items()}
    files = {f"{name}.svg": svg_bytes(sheet) for name, sheet in sheets.items()}
    files |= {f"{name}.dxf": dxf_bytes(sheet) for name, sheet in sheets.items()}
    title = f"{model.design.name}: drawings of the parts, {model.geometry.fingerprint}"
    return files | {PDF_FILE: pdf_bytes(list(sheets.values()), title)}
