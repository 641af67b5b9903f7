"""3MF packages: meshes with their unit, their names and the design's fingerprint, read back as a slicer would."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import lib3mf
import numpy as np
from numpy.typing import NDArray

from probedesign.cad.mesh import Mesh
from probedesign.errors import CheckFailedError
from probedesign.frames import Array

XML_STRING = "xs:string"
BETWEEN_MM = 5.0
"""Parts stand that far apart on the build plate."""


@dataclass(frozen=True)
class Piece:
    """One object of a package.

    Attributes:
        name: of the part.
        part_number: of the object and of its place on the build plate.
        mesh: in millimetres, in the part's own frame.
    """

    name: str
    part_number: str
    mesh: Mesh


def threemf_bytes(pieces: Sequence[Piece], metadata: dict[str, str]) -> bytes:
    """Pieces in a row on the build plate, each with its vertices in its own frame.

    Args:
        pieces: of one resin.
        metadata: names of the 3MF core specification (`Title`, `Designer`, `Description`, ...).
    """
    wrapper = lib3mf.get_wrapper()
    model = wrapper.CreateModel()
    model.SetUnit(lib3mf.ModelUnit.MilliMeter)
    group = model.GetMetaDataGroup()
    for key, value in metadata.items():
        group.AddMetaData("", key, value, XML_STRING, True)
    for piece, place in zip(pieces, places_of(pieces), strict=True):
        body = model.AddMeshObject()
        body.SetName(piece.name)
        body.SetPartNumber(piece.part_number)
        body.SetGeometry(
            _structs(lib3mf.Position, piece.mesh.vertices.astype("<f4")),
            _structs(lib3mf.Triangle, piece.mesh.triangles.astype("<u4")),
        )
        model.AddBuildItem(body, wrapper.GetTranslationTransform(*place)).SetPartNumber(piece.part_number)
    return bytes(model.QueryWriter("3mf").WriteToBuffer())


def places_of(pieces: Sequence[Piece]) -> list[list[float]]:
    """Where each piece's origin goes [mm]: on the plate, side by side, all coordinates positive as 3MF asks."""
    places, x = [], 0.0
    for piece in pieces:
        low, high = piece.mesh.vertices.min(axis=0), piece.mesh.vertices.max(axis=0)
        places.append([x - float(low[0]), -float(low[1]), -float(low[2])])
        x += float(high[0] - low[0]) + BETWEEN_MM
    return places


def read_back(content: bytes) -> tuple[list[tuple[Piece, Array]], int]:
    """What a strict reader finds in a 3MF package.

    Returns:
        Each piece with the place of its origin on the build plate [mm], (3,), and how many warnings there were.

    Raises:
        CheckFailedError: it is refused, or is not in millimetres.
    """
    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    try:
        reader.ReadFromBuffer(content)
    except lib3mf.ELib3MFException as error:
        raise CheckFailedError(f"3MF: a strict reader refuses it: {error}") from None
    if model.GetUnit() != lib3mf.ModelUnit.MilliMeter:
        raise CheckFailedError(f"3MF: unit {model.GetUnit()}, not millimetres")
    items, found = model.GetBuildItems(), []
    while items.MoveNext():
        item = items.GetCurrent()
        body = model.GetMeshObjectByID(item.GetObjectResource().GetResourceID())
        vertices = _rows(lib3mf.Position, body.GetVertices(), "<f4")
        triangles = _rows(lib3mf.Triangle, body.GetTriangleIndices(), "<u4").astype(np.int64)
        piece = Piece(body.GetName(), item.GetPartNumber(), Mesh(vertices, triangles))
        found.append((piece, np.array(list(item.GetObjectTransform().Fields[3]))))
    return found, reader.GetWarningCount()


def _structs(kind: Any, rows: NDArray[Any]) -> Any:
    """Rows of three numbers as an array of lib3mf's structures, which hold three."""
    return (kind * len(rows)).from_buffer_copy(rows.tobytes())


def _rows(kind: Any, structs: Any, dtype: str) -> NDArray[Any]:
    """And back."""
    return np.frombuffer((kind * len(structs))(*structs), dtype=dtype).reshape(-1, 3)
