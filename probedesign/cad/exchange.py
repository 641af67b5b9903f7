"""STEP and GLB files of parts and assemblies: the same bytes for the same parts.

A part that an assembly has several times is one product with instances.
"""

import re
import tempfile
from importlib.metadata import version
from itertools import count
from pathlib import Path

import cadquery as cq
from OCP.APIHeaderSection import APIHeaderSection_MakeHeader
from OCP.Interface import Interface_Static
from OCP.Message import Message_ProgressRange
from OCP.RWGltf import RWGltf_CafWriter
from OCP.RWMesh import RWMesh_CoordinateSystem, RWMesh_NameFormat
from OCP.STEPCAFControl import STEPCAFControl_Writer
from OCP.STEPControl import STEPControl_StepModelType
from OCP.TCollection import TCollection_AsciiString, TCollection_ExtendedString, TCollection_HAsciiString
from OCP.TColStd import TColStd_IndexedDataMapOfStringString
from OCP.TDataStd import TDataStd_Name
from OCP.TDF import TDF_Label
from OCP.TDocStd import TDocStd_Document
from OCP.XCAFApp import XCAFApp_Application
from OCP.XCAFDoc import XCAFDoc_ColorSurf, XCAFDoc_DocumentTool
from OCP.XSControl import XSControl_WorkSession

from probedesign.cad.kernel import PRODUCT
from probedesign.core.errors import CheckFailedError
from probedesign.core.units import MM

STEP_END = b"END-ISO-10303-21;"
EPOCH = "1970-01-01"  #: Date in the header of a file without one, as ISO 10303-21 requires a time.
#: A part in its assembly, with a number that the kernel counts through all assemblies of a process.
_OCCURRENCE = re.compile(r"(NEXT_ASSEMBLY_USAGE_OCCURRENCE\(')\d+('.*?\);)", re.DOTALL)
_LINE_BREAK = re.compile(r"\s*\n\s*")
_ENTITY = re.compile(r"^#(\d+) = (.*?);$", re.MULTILINE | re.DOTALL)
_REFERENCE = re.compile(r"#(\d+)")
_STYLES = "MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION"


def step_bytes(assembly: cq.Assembly, file: str, about: str, date: str | None) -> bytes:
    """Return the STEP file (AP214) of an assembly, or of a single part.

    Args:
        assembly: of parts without further levels; children with the same shape, colour and product are instances.
        file: its name, for the header.
        about: description for the header.
        date: for the header, such as 2026-01-31; 1970 if None: equal designs have equal files.

    Raises:
        CheckFailedError: the kernel does not write the file to its end.
    """
    document = _document(assembly)
    writer = STEPCAFControl_Writer(XSControl_WorkSession(), False)
    writer.SetColorMode(True)
    writer.SetNameMode(True)
    # Curves in the coordinates of each face are redundant, and more than half of a file.
    Interface_Static.SetIVal_s("write.surfacecurve.mode", 0)
    Interface_Static.SetCVal_s("xstep.cascade.unit", "MM")
    Interface_Static.SetCVal_s("write.step.unit", "MM")
    writer.Transfer(document, STEPControl_StepModelType.STEPControl_AsIs)
    model = writer.ChangeWriter().Model()
    header = APIHeaderSection_MakeHeader(model)
    header.SetDescriptionValue(1, _ascii(about))
    header.SetName(_ascii(file))
    header.SetTimeStamp(_ascii(f"{date or EPOCH}T00:00:00"))
    header.SetAuthorValue(1, _ascii("probedesign"))
    header.SetOrganizationValue(1, _ascii("not stated"))
    header.SetOriginatingSystem(_ascii(f"probedesign {version('probedesign')}"))
    header.SetAuthorisation(_ascii(""))
    header.Apply(model)
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "part.step"
        writer.Write(str(path))
        content = path.read_bytes() if path.is_file() else b""
    if not content.rstrip().endswith(STEP_END):
        raise CheckFailedError(f"{file}: the kernel did not write it to its end")
    return reproducible(content.decode("ascii")).encode("ascii")


def glb_bytes(assembly: cq.Assembly, file: str) -> bytes:
    """Return an assembly of shapes with facets as a binary glTF file, in metres with y up as glTF requires:
    x, z and −y of the assembly.

    Raises:
        CheckFailedError: the kernel does not write the file.
    """
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "assembly.glb"
        writer = RWGltf_CafWriter(TCollection_AsciiString(str(path)), True)
        frame = writer.ChangeCoordinateSystemConverter()
        frame.SetInputLengthUnit(MM)
        frame.SetOutputLengthUnit(1.0)
        frame.SetInputCoordinateSystem(RWMesh_CoordinateSystem.RWMesh_CoordinateSystem_Zup)
        writer.SetMergeFaces(True)
        writer.SetNodeNameFormat(RWMesh_NameFormat.RWMesh_NameFormat_InstanceOrProduct)
        writer.SetMeshNameFormat(RWMesh_NameFormat.RWMesh_NameFormat_Product)
        writer.Perform(_document(assembly), TColStd_IndexedDataMapOfStringString(), Message_ProgressRange())
        content = path.read_bytes() if path.is_file() else b""
    if content[:4] != b"glTF":
        raise CheckFailedError(f"{file}: the kernel did not write it")
    return content


def _document(assembly: cq.Assembly) -> TDocStd_Document:
    """Return the kernel's document of an assembly.

    CadQuery's own has no products whose name differs from that of an instance, and one compound around each part.
    """
    document = TDocStd_Document(TCollection_ExtendedString("BinXCAF"))
    XCAFApp_Application.GetApplication_s().InitDocument(document)
    tool = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    colours = XCAFDoc_DocumentTool.ColorTool_s(document.Main())
    tool.SetAutoNaming_s(False)
    products: dict[tuple[cq.Shape, cq.Color | None, str], TDF_Label] = {}

    def product(part: cq.Assembly) -> TDF_Label:
        key = (part.obj, part.color, str(part.metadata.get(PRODUCT, part.name)))
        if key not in products:
            products[key] = tool.AddShape(part.obj.wrapped, False)
            _name(products[key], key[2])
            if part.color is not None:
                colours.SetColor(products[key], part.color.wrapped, XCAFDoc_ColorSurf)
        return products[key]

    if not assembly.children:
        product(assembly)
        return document
    root = tool.NewShape()
    _name(root, assembly.name)
    for part in assembly.children:
        _name(tool.AddComponent(root, product(part), part.loc.wrapped), part.name)
    tool.UpdateAssemblies()
    return document


def _name(label: TDF_Label, name: str) -> None:
    TDataStd_Name.Set_s(label, TCollection_ExtendedString(name))


def _ascii(text: str) -> TCollection_HAsciiString:
    return TCollection_HAsciiString(text)


def reproducible(text: str) -> str:
    """Return a STEP file with its parts counted from 1, and its styles in the order of the shapes.

    The kernel writes the styles last, in the order of the addresses of the shapes in memory.
    """
    numbers = count(1)
    # the number's digits decide where the kernel breaks the line
    text = _OCCURRENCE.sub(lambda m: m[1] + str(next(numbers)) + _LINE_BREAK.sub("", m[2]), text)
    first = re.search(rf"^#(\d+) = {_STYLES}", text, re.MULTILINE)
    if first is None:
        return text
    start, end, number = first.start(), text.rindex("ENDSEC;"), int(first[1])
    entities = {int(m[1]): " ".join(m[2].split()) for m in _ENTITY.finditer(text[start:end])}

    def referenced(entity: int) -> list[int]:
        return [int(r) for r in _REFERENCE.findall(entities[entity])]

    def styled_shape(root: int) -> list[int]:
        return [r for r in referenced(root) if r not in entities]

    order: dict[int, int] = {}
    stack = sorted((e for e in entities if entities[e].startswith(_STYLES)), key=styled_shape, reverse=True)
    while stack:  # depth first from each style's root
        entity = stack.pop()
        if entity not in order:
            order[entity] = number + len(order)
            stack += [r for r in reversed(referenced(entity)) if r in entities]
    if len(order) != len(entities):
        raise CheckFailedError("STEP: the styles have a form that is not known")

    def renumbered(entity: int) -> str:
        return _REFERENCE.sub(lambda m: f"#{order.get(int(m[1]), int(m[1]))}", entities[entity])

    lines = "".join(f"#{order[entity]} = {renumbered(entity)};\n" for entity in order)
    return text[:start] + lines + text[end:]
