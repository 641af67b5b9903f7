"""Triangle meshes of the printed parts and their 3MF packages.

A package holds the parts of one resin with their unit, names and the design's fingerprint; a strict reader checks it.
"""

import tempfile
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cadquery as cq
import lib3mf
import numpy as np
from numpy.typing import NDArray
from OCP.StlAPI import StlAPI_Writer

from probedesign.cad.kernel import meshed
from probedesign.cad.model import CadModel
from probedesign.core.errors import CheckFailedError
from probedesign.core.frames import Array
from probedesign.core.stl import stl_bytes, stl_corners
from probedesign.core.units import MM
from probedesign.design import Design
from probedesign.design.catalog import RIGID_RESIN
from probedesign.printing.check import scale_note

LINEAR_TOLERANCE_MM = 0.01
ANGULAR_TOLERANCE_RAD = 0.05
"""Determines a cone's mesh: 0.05 rad omits 0.04 % of its volume, the default 0.1 four times that."""

MESH_LIMIT = 5e-4
"""Relative. Facets that turn by at most δ = 0.05 rad omit δ²/6 = 4.2e-4 of a round body."""


@dataclass(frozen=True)
class Mesh:
    """A closed triangle mesh in millimetres, in its part's own frame."""

    vertices: NDArray[np.float32]  #: (n, 3), each point once, single precision as an STL file holds them.
    triangles: NDArray[np.int64]  #: corners of each triangle, counter-clockwise from outside, (m, 3).

    @property
    def volume(self) -> float:
        """Return the enclosed volume [m³]: the tetrahedra between the triangles and the origin."""
        a, b, c = (self.vertices.astype(float)[self.triangles[:, i]] for i in range(3))
        return float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0 * MM**3

    @property
    def closed(self) -> bool:
        """Return whether every edge joins two consistently oriented triangles and the normals point outwards."""
        ends = np.concatenate([self.triangles[:, [i, (i + 1) % 3]] for i in range(3)])
        forward, backward = (ends @ [len(self.vertices), 1], ends @ [1, len(self.vertices)])
        once = len(np.unique(forward)) == len(forward)
        return bool(once and np.array_equal(np.sort(forward), np.sort(backward)) and self.volume > 0.0)

    def scaled(self, factors: tuple[float, float, float]) -> "Mesh":
        """Return the mesh scaled along x, y and z about the origin of its frame."""
        return Mesh(self.vertices * np.array(factors, dtype=np.float32), self.triangles)


def tessellate(
    shape: cq.Shape, linear_mm: float = LINEAR_TOLERANCE_MM, angular_rad: float = ANGULAR_TOLERANCE_RAD
) -> Mesh:
    """Return the triangles of a shape, the same on every run.

    Args:
        shape: one or several solids, in millimetres.
        linear_mm: largest distance of a facet from its surface [mm].
        angular_rad: largest angle between adjacent facets [rad].
    """
    return facets_of(meshed(shape, linear_mm, angular_rad))


def facets_of(shape: cq.Shape) -> Mesh:
    """Return the facets that a shape has already, in millimetres."""
    # The kernel writes a file in a tenth of the time in which Python reads the points one by one.
    with tempfile.TemporaryDirectory() as scratch:
        file, writer = Path(scratch) / "mesh.stl", StlAPI_Writer()
        writer.ASCIIMode = False
        if not writer.Write(shape.wrapped, str(file)):
            raise CheckFailedError("the kernel did not mesh a part")
        points = stl_corners(file.read_bytes()).reshape(-1, 3)
    return _welded(points, np.arange(len(points)).reshape(-1, 3))


def _welded(points: NDArray[np.float32], corners: NDArray[np.int64]) -> Mesh:
    """Merge equal corners of adjacent faces, and drop triangles that degenerate by it."""
    points = points + np.float32(0.0)  # makes -0.0 equal to 0.0
    vertices, index = np.unique(points, axis=0, return_inverse=True)
    triangles = index.reshape(-1)[corners]
    a, b, c = triangles.T
    return Mesh(vertices, triangles[(a != b) & (b != c) & (c != a)])


XML_STRING = "xs:string"
BETWEEN_MM = 5.0
"""Distance between parts on the build plate."""


@dataclass(frozen=True)
class ThreemfObject:
    """One object of a 3MF package."""

    name: str  #: of the part.
    part_number: str  #: of the object and of its build item.
    mesh: Mesh  #: in millimetres, in the part's own frame.


def threemf_bytes(objects: Sequence[ThreemfObject], metadata: dict[str, str]) -> bytes:
    """Return a 3MF package with objects in a row on the build plate, each with its vertices in its own frame.

    Args:
        objects: the objects, of one resin.
        metadata: names of the 3MF core specification (`Title`, `Designer`, `Description`, ...).
    """
    wrapper = lib3mf.get_wrapper()
    model = wrapper.CreateModel()
    model.SetUnit(lib3mf.ModelUnit.MilliMeter)
    group = model.GetMetaDataGroup()
    for key, value in metadata.items():
        group.AddMetaData("", key, value, XML_STRING, True)
    for piece, place in zip(objects, platform_positions(objects), strict=True):
        body = model.AddMeshObject()
        body.SetName(piece.name)
        body.SetPartNumber(piece.part_number)
        body.SetGeometry(
            _structs(lib3mf.Position, piece.mesh.vertices.astype("<f4")),
            _structs(lib3mf.Triangle, piece.mesh.triangles.astype("<u4")),
        )
        body.SetUUID(_uuid(f"object {piece.part_number}"))
        item = model.AddBuildItem(body, wrapper.GetTranslationTransform(*place))
        item.SetPartNumber(piece.part_number)
        item.SetUUID(_uuid(f"item {piece.part_number}"))
    model.SetBuildUUID(_uuid(" ".join(piece.part_number for piece in objects)))
    return bytes(model.QueryWriter("3mf").WriteToBuffer())


def _uuid(name: str) -> str:
    """Return a UUID that depends on a name alone; the library would draw it."""
    return str(uuid.uuid5(uuid.NAMESPACE_OID, name))


def platform_positions(objects: Sequence[ThreemfObject]) -> list[list[float]]:
    """Return each object's origin on the plate [mm]: side by side, all coordinates positive as 3MF requires."""
    places, x = [], 0.0
    for piece in objects:
        low, high = piece.mesh.vertices.min(axis=0), piece.mesh.vertices.max(axis=0)
        places.append([x - float(low[0]), -float(low[1]), -float(low[2])])
        x += float(high[0] - low[0]) + BETWEEN_MM
    return places


def read_back(content: bytes) -> tuple[list[tuple[ThreemfObject, Array]], int]:
    """Read a 3MF package with a strict reader.

    Returns:
        Each object with the position of its origin on the build plate [mm], (3,), and the number of warnings.

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
    items, found = model.GetBuildItems(), []
    while items.MoveNext():
        item = items.GetCurrent()
        body = model.GetMeshObjectByID(item.GetObjectResource().GetResourceID())
        vertices = _rows(lib3mf.Position, body.GetVertices(), "<f4")
        triangles = _rows(lib3mf.Triangle, body.GetTriangleIndices(), "<u4").astype(np.int64)
        piece = ThreemfObject(body.GetName(), item.GetPartNumber(), Mesh(vertices, triangles))
        found.append((piece, np.array(list(item.GetObjectTransform().Fields[3]))))
    return found, reader.GetWarningCount()


def _structs(kind: Any, rows: NDArray[Any]) -> Any:
    """Return rows of three numbers as an array of lib3mf's structures of three."""
    return (kind * len(rows)).from_buffer_copy(rows.tobytes())


def _rows(kind: Any, structs: Any, dtype: str) -> NDArray[Any]:
    """Return an array of lib3mf's structures as rows of three numbers."""
    return np.frombuffer((kind * len(structs))(*structs), dtype=dtype).reshape(-1, 3)


def package_objects(model: CadModel, meshes: Mapping[str, Mesh]) -> dict[str, list[ThreemfObject]]:
    """Return the objects of each package by file name."""
    number = f"{model.design.name}-{model.geometry.fingerprint}"
    objects = [ThreemfObject(name, f"{number}-{name}", mesh) for name, mesh in meshes.items()]
    return {
        "probe.3mf": [piece for piece in objects if piece.name == "probe"],
        "adapters.3mf": [piece for piece in objects if piece.name != "probe"],
    }


def threemf_packages(model: CadModel, meshes: Mapping[str, Mesh]) -> dict[str, bytes]:
    """Return the content of each package by file name."""
    design = model.design
    resins = {"probe.3mf": design.resin.name, "adapters.3mf": RIGID_RESIN}
    titles = {"probe.3mf": "flexible probe", "adapters.3mf": "adapters and clamp ring"}
    return {
        file: threemf_bytes(
            objects,
            {
                "Title": f"{design.name}: {titles[file]}",
                "Designer": "probedesign",
                "Description": f"geometry {model.geometry.fingerprint}{scale_note(design, objects[0].name)}, "
                f"{resins[file]}",
            },
        )
        for file, objects in package_objects(model, meshes).items()
    }


def part_stl(design: Design, part: str, mesh: Mesh, fingerprint: str) -> bytes:
    """Return the STL file of a part, scaled already; its header states design and fingerprint."""
    # An STL header must not begin with "solid", which marks a text file.
    title = f"probedesign {fingerprint}{scale_note(design, part)} {design.name} {part}"
    return stl_bytes(mesh.vertices[mesh.triangles], title)
