"""3MF packages of the printed parts: one for each resin and platform, with the parts as the print check lays them out.

A package states its unit, the names of its parts and the design's fingerprint; a strict reader checks it.
"""

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import lib3mf
import numpy as np
import trimesh
from numpy.typing import NDArray

from probedesign.core.errors import CheckFailedError
from probedesign.core.frames import Array, pose
from probedesign.design import Design
from probedesign.design.catalog import RIGID_RESIN
from probedesign.printing.check import ORIENTATIONS, PrintCheck, scale_note

XML_STRING = "xs:string"


@dataclass(frozen=True)
class PackedPart:
    """One part of a package."""

    name: str  #: of the part.
    part_number: str  #: of the object and of its build item.
    mesh: trimesh.Trimesh  #: in millimetres, in the part's own frame.
    T_platform_part: Array  #: pose on the platform, whose corner is the origin, (4, 4) in millimetres.

    @property
    def bounds(self) -> Array:
        """Return the corners of the bounding box on the platform [mm], (2, 3)."""
        return np.asarray(self.mesh.copy().apply_transform(self.T_platform_part).bounds)


def packed_parts(
    design: Design, check: PrintCheck, meshes: Mapping[str, trimesh.Trimesh], fingerprints: Mapping[str, str]
) -> dict[str, list[PackedPart]]:
    """Return the parts of each package by file name, with the orientation and position of the print check."""
    packages: dict[str, list[PackedPart]] = {}
    for platform in check.platforms:
        stem, number = ("probe" if "probe" in platform else "adapters"), 1
        while (file := f"{stem}{'' if number == 1 else f'_{number}'}.3mf") in packages:
            number += 1
        packages[file] = [
            PackedPart(name, f"{design.name}-{fingerprints[name]}-{name}", mesh, _pose(mesh, name, axis))
            for name, axis in platform.items()
            for mesh in (meshes[name],)
        ]
    return packages


def _pose(mesh: trimesh.Trimesh, name: str, axis: tuple[float, float]) -> Array:
    """Return the pose of a part that stands on the platform with its axis at a point [mm]."""
    low, high = mesh.bounds[:, 2]
    upright = ORIENTATIONS[name].upright
    return pose(None if upright else np.diag([1.0, -1.0, -1.0]), [*axis, -low if upright else high])


def package_files(design: Design, packages: Mapping[str, Sequence[PackedPart]]) -> dict[str, bytes]:
    """Return the content of each package by file name."""
    return {file: _package(design, parts) for file, parts in packages.items()}


def _package(design: Design, parts: Sequence[PackedPart]) -> bytes:
    first, names = parts[0], ", ".join(part.name.replace("_", " ") for part in parts)
    numbers = ", ".join(part.part_number for part in parts)
    resin = design.resin.name if first.name == "probe" else RIGID_RESIN
    wrapper = lib3mf.get_wrapper()
    model = wrapper.CreateModel()
    model.SetUnit(lib3mf.ModelUnit.MilliMeter)
    group = model.GetMetaDataGroup()
    for key, value in {
        "Title": f"{design.name}: {names}",
        "Designer": "probedesign",
        "Description": f"{numbers}{scale_note(design, first.name)}, {resin}",
    }.items():
        group.AddMetaData("", key, value, XML_STRING, True)
    for part in parts:
        body = model.AddMeshObject()
        body.SetName(part.name)
        body.SetPartNumber(part.part_number)
        body.SetGeometry(
            _structs(lib3mf.Position, part.mesh.vertices.astype("<f4")),
            _structs(lib3mf.Triangle, part.mesh.faces.astype("<u4")),
        )
        body.SetUUID(_uuid(f"object {part.part_number}"))
        T = part.T_platform_part[:3].T  # rows of x, y, z and the origin, as 3MF multiplies from the right
        transform = lib3mf.Transform()
        for row, values in zip(transform.Fields, T, strict=True):
            row[:] = [float(value) for value in values]
        item = model.AddBuildItem(body, transform)
        item.SetPartNumber(part.part_number)
        item.SetUUID(_uuid(f"item {part.part_number}"))
    model.SetBuildUUID(_uuid(" ".join(part.part_number for part in parts)))
    return bytes(model.QueryWriter("3mf").WriteToBuffer())


def _uuid(name: str) -> str:
    return str(uuid.uuid5(uuid.NAMESPACE_OID, name))


def read_back(content: bytes) -> tuple[list[PackedPart], int]:
    """Read a 3MF package with a strict reader.

    Returns:
        Its parts, and the number of warnings.

    Raises:
        CheckFailedError: the package is rejected, or is not in millimetres.
    """
    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    try:
        reader.ReadFromBuffer(content)
    except lib3mf.ELib3MFException as error:
        raise CheckFailedError(f"3MF: a strict reader rejects it: {error}") from None
    if model.GetUnit() != lib3mf.ModelUnit.MilliMeter:
        raise CheckFailedError(f"3MF: unit {model.GetUnit()}, not millimetres")
    items, parts = model.GetBuildItems(), []
    while items.MoveNext():
        item = items.GetCurrent()
        body = model.GetMeshObjectByID(item.GetObjectResource().GetResourceID())
        vertices = _rows(lib3mf.Position, body.GetVertices(), "<f4")
        triangles = _rows(lib3mf.Triangle, body.GetTriangleIndices(), "<u4")
        fields = np.array([list(row) for row in item.GetObjectTransform().Fields])
        mesh = trimesh.Trimesh(vertices, triangles, process=False)
        parts.append(PackedPart(body.GetName(), item.GetPartNumber(), mesh, pose(fields[:3].T, fields[3])))
    return parts, reader.GetWarningCount()


def _structs(kind: Any, rows: NDArray[Any]) -> Any:
    return (kind * len(rows)).from_buffer_copy(rows.tobytes())


def _rows(kind: Any, structs: Any, dtype: str) -> NDArray[Any]:
    return np.frombuffer((kind * len(structs))(*structs), dtype=dtype).reshape(-1, 3)
