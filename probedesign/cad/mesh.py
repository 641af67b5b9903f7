"""Triangles of a solid and the STL file that holds them."""

from dataclasses import dataclass

import cadquery as cq
import numpy as np
import trimesh
from numpy.typing import NDArray
from OCP.BRepMesh import BRepMesh_IncrementalMesh
from OCP.IMeshTools import IMeshTools_Parameters

from probedesign.units import MM

LINEAR_TOLERANCE_MM = 0.01
ANGULAR_TOLERANCE_RAD = 0.05
"""Decides a cone's mesh: 0.05 rad leaves out 0.04 % of its volume, the default 0.1 four times that."""
STL_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


@dataclass(frozen=True)
class Mesh:
    """A closed triangle mesh in millimetres, in its part's own frame.

    Attributes:
        vertices: (n, 3), each point once, single precision as an STL file holds them.
        triangles: corners of each triangle, counter-clockwise from outside, (m, 3).
    """

    vertices: NDArray[np.float32]
    triangles: NDArray[np.int64]

    @property
    def volume(self) -> float:
        """Enclosed volume [m³]."""
        return float(self._as_trimesh().volume) * MM**3

    @property
    def closed(self) -> bool:
        """Whether every edge joins two triangles that turn the same way, with the outside outside."""
        mesh = self._as_trimesh()
        return bool(mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0.0)

    def scaled(self, factors: tuple[float, float, float]) -> "Mesh":
        """The mesh stretched along x, y and z about the origin of its frame."""
        return Mesh(self.vertices * np.array(factors, dtype=np.float32), self.triangles)

    def _as_trimesh(self) -> trimesh.Trimesh:
        return trimesh.Trimesh(self.vertices.astype(float), self.triangles, process=False)


def mesh_of(shape: cq.Shape) -> Mesh:
    """Triangles of a solid, the same ones on every run."""
    fresh = shape.copy()  # a copy carries no coarser mesh from earlier use
    wanted = IMeshTools_Parameters()
    wanted.Deflection, wanted.Angle = LINEAR_TOLERANCE_MM, ANGULAR_TOLERANCE_RAD
    # Between rulings a facet is as good as its edge; looking inside takes a minute on a flattened probe.
    wanted.ControlSurfaceDeflection = False
    BRepMesh_IncrementalMesh(fresh.wrapped, wanted)
    points, corners = fresh.tessellate(LINEAR_TOLERANCE_MM, ANGULAR_TOLERANCE_RAD)
    return _welded(np.array([p.toTuple() for p in points], dtype=np.float32), np.array(corners))


def _welded(points: NDArray[np.float32], corners: NDArray[np.int64]) -> Mesh:
    """Faces come with corners of their own: make equal points one, drop triangles that lose a corner so."""
    points = points + np.float32(0.0)  # -0.0 and 0.0 are one point
    vertices, index = np.unique(points, axis=0, return_inverse=True)
    triangles = index.reshape(-1)[corners]
    a, b, c = triangles.T
    return Mesh(vertices, triangles[(a != b) & (b != c) & (c != a)])


def stl_bytes(mesh: Mesh, title: str) -> bytes:
    """The mesh as a binary STL file; millimetres, as slicers take it."""
    corners = mesh.vertices[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    records = np.zeros(len(corners), dtype=STL_RECORD)
    records["corners"] = corners
    records["normal"] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    header = f"{title}, mm".encode("ascii", "replace")[:80].ljust(80)
    return header + np.uint32(len(records)).tobytes() + records.tobytes()
