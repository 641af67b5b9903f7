"""The 3MF file: a mesh with its unit, its name and the design's fingerprint, read back as a slicer would."""

from typing import Any

import lib3mf
import numpy as np

from probedesign.cad.mesh import Mesh
from probedesign.errors import CheckFailedError

XML_STRING = "xs:string"


def threemf_bytes(mesh: Mesh, name: str, part_number: str, metadata: dict[str, str]) -> bytes:
    """One object as a 3MF package.

    Args:
        mesh: in millimetres.
        name: of the object.
        part_number: of the object and of its place on the build plate.
        metadata: names of the 3MF core specification (`Title`, `Designer`, `Description`, ...).
    """
    wrapper = lib3mf.get_wrapper()
    model = wrapper.CreateModel()
    model.SetUnit(lib3mf.ModelUnit.MilliMeter)
    group = model.GetMetaDataGroup()
    for key, value in metadata.items():
        group.AddMetaData("", key, value, XML_STRING, True)
    body = model.AddMeshObject()
    body.SetName(name)
    body.SetPartNumber(part_number)
    body.SetGeometry(_positions(mesh), _triangles(mesh))
    model.AddBuildItem(body, wrapper.GetIdentityTransform()).SetPartNumber(part_number)
    return bytes(model.QueryWriter("3mf").WriteToBuffer())


def read_back(content: bytes) -> tuple[Mesh, str, int]:
    """What a strict reader finds in a 3MF package.

    Returns:
        The mesh of its only object, that object's name, and how many warnings the reader had.

    Raises:
        CheckFailedError: it is refused, is not in millimetres, or does not hold exactly one object.
    """
    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    try:
        reader.ReadFromBuffer(content)
    except lib3mf.ELib3MFException as error:
        raise CheckFailedError(f"probe.3mf: a strict reader refuses it: {error}") from None
    objects = model.GetMeshObjects()
    if objects.Count() != 1 or model.GetUnit() != lib3mf.ModelUnit.MilliMeter:
        raise CheckFailedError(f"probe.3mf: holds {objects.Count()} objects, unit {model.GetUnit()}")
    objects.MoveNext()
    body = objects.GetCurrentMeshObject()
    vertices = np.array([tuple(p.Coordinates) for p in body.GetVertices()], dtype=np.float32)
    triangles = np.array([tuple(t.Indices) for t in body.GetTriangleIndices()], dtype=np.int64)
    return Mesh(vertices, triangles), body.GetName(), reader.GetWarningCount()


def _positions(mesh: Mesh) -> list[Any]:
    positions = []
    for point in mesh.vertices.tolist():
        position = lib3mf.Position()
        position.Coordinates[:] = point
        positions.append(position)
    return positions


def _triangles(mesh: Mesh) -> list[Any]:
    triangles = []
    for corners in mesh.triangles.tolist():
        triangle = lib3mf.Triangle()
        triangle.Indices[:] = corners
        triangles.append(triangle)
    return triangles
