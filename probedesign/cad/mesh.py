"""Triangle meshes of printed parts in millimetres, each in its own frame, and their STL files."""

import hashlib
import os
import tempfile
from pathlib import Path
from typing import Any

import cadquery as cq
import numpy as np
import trimesh
from OCP.StlAPI import StlAPI_Writer
from scipy.spatial import cKDTree

from probedesign.cad.folder import check_target, listed_digests
from probedesign.cad.kernel import mass_properties, meshed
from probedesign.cad.model import printed_solid
from probedesign.core.errors import CheckFailedError, InputError
from probedesign.core.files import write_atomically
from probedesign.core.units import MM
from probedesign.design import Design
from probedesign.mount import Mount, build_geometry
from probedesign.printing.check import print_scale, scale_note

LINEAR_TOLERANCE_MM = 0.01
#: Determines a cone's mesh: 0.05 rad omits 0.04 % of its volume, the default 0.1 four times that.
ANGULAR_TOLERANCE_RAD = 0.05

MESH_LIMIT = 5e-4  #: Relative. Facets that turn by at most δ = 0.05 rad omit δ²/6 = 4.2e-4 of a round body.


def tessellate(
    shape: cq.Shape, linear_mm: float = LINEAR_TOLERANCE_MM, angular_rad: float = ANGULAR_TOLERANCE_RAD
) -> trimesh.Trimesh:
    """Return the mesh of a shape, the same on every run.

    Args:
        shape: one or several solids, in millimetres.
        linear_mm: largest distance of a facet from its surface [mm].
        angular_rad: largest angle between adjacent facets [rad].
    """
    return facets_of(meshed(shape, linear_mm, angular_rad))


def facets_of(shape: cq.Shape) -> trimesh.Trimesh:
    """Return the facets that a shape has already, with equal corners of adjacent faces merged."""
    # The kernel writes a file in a tenth of the time in which Python reads the points one by one.
    with tempfile.TemporaryDirectory() as scratch:
        file, writer = Path(scratch) / "mesh.stl", StlAPI_Writer()
        writer.ASCIIMode = False
        if not writer.Write(shape.wrapped, str(file)):
            raise CheckFailedError("the kernel did not mesh a part")
        mesh = trimesh.load_mesh(file, process=False)
    mesh.merge_vertices()
    a, b, c = mesh.faces.T
    mesh.update_faces((a != b) & (b != c) & (c != a))
    return mesh


def printed_mesh(design: Design, part: str, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return the mesh of a printed part that shrinks and widens to the drawn one.

    Every point of the flexible part's surface first goes by half the offset of `[print]` towards the axis, or away from
    it on the wall of a bore, in its section. The part is then scaled along x, y and z about the origin of its frame.
    """
    points = np.array(mesh.vertices)
    if part == "probe" and design.print_.offset_xy_mm:
        geometry = build_geometry(design)
        s = np.linspace(0.0, geometry.length, 4001)
        T = geometry.axis.frames(s)
        _, nearest = cKDTree(T[:, :3, 3] / MM).query(points)
        T, radius = T[nearest], geometry.radius_at(s[nearest]) / MM
        aside = points - T[:, :3, 3] / MM
        aside -= np.einsum("ij,ij->i", aside, T[:, :3, 2])[:, None] * T[:, :3, 2]
        r = np.linalg.norm(aside, axis=1)
        outer = r > 0.5 * (geometry.cross_section.bore_ratio + geometry.cross_section.flatness) * radius
        body = (points[:, 2] > -LINEAR_TOLERANCE_MM) & (r > 0.0) & (r < radius + 2.0 * LINEAR_TOLERANCE_MM)
        towards = np.where(outer, -0.5, 0.5) * design.print_.offset_xy_mm
        points[body] += (towards / np.where(r > 0.0, r, 1.0))[body, None] * aside[body]
    return trimesh.Trimesh(points * np.array(print_scale(design, part)), mesh.faces, process=False)


def volume_omitted(mesh: trimesh.Trimesh, volume: float) -> float:
    """Return by how much the volume of a mesh differs from that of its solid [m³], relative to it."""
    return float(abs(mesh.volume * MM**3 / volume - 1.0))


def checked_mesh(name: str, shape: cq.Shape, volume: float | None = None) -> trimesh.Trimesh:
    """Return the mesh of a solid.

    Args:
        name: of the part.
        shape: whose facets are those of the mesh.
        volume: of the part [m³], where `shape` is drawn for its facets and lacks some of it.

    Raises:
        CheckFailedError: it is not closed, or omits more than `MESH_LIMIT` of the volume.
    """
    mesh = tessellate(shape)
    omitted = volume_omitted(mesh, mass_properties(shape, 1.0).volume if volume is None else volume)
    if not mesh.is_volume or omitted > MESH_LIMIT:
        raise CheckFailedError(f"{name}: the mesh is not closed, or omits {omitted:.2g} of the volume")
    return mesh


def stl_bytes(mesh: trimesh.Trimesh, title: str) -> bytes:
    """Return a binary STL file in single precision.

    Args:
        mesh: in millimetres.
        title: of the header; must not begin with "solid", which marks a text file.
    """
    header = f"{title}, mm".encode("ascii", "replace")[:80].ljust(80)
    return header + trimesh.exchange.stl.export_stl(mesh)[80:]


def part_stl(design: Design, part: str, mesh: trimesh.Trimesh, fingerprint: str) -> bytes:
    """Return the STL file of a part, scaled already; its header states design and fingerprint."""
    return stl_bytes(mesh, f"probedesign {fingerprint}{scale_note(design, part)} {design.name} {part}")


def export_part(design: Design, part: str, out: Path | None = None) -> dict[str, Any]:
    """Write the STL file of one printed part only: probe, sensor_adapter, clamp_ring or flange_adapter.

    Returns the file, its volume and its scale; raises what `export_parts` raises, and an InputError where the file
    belongs to an export of another design.
    """
    design.sensor_model.check_holes_known()
    folder = Path(os.path.abspath(out or Path("exports") / design.name))
    check_target(folder)
    shape = printed_solid(design, part)
    twice = part == "probe" and not design.probe.designed_axis.is_straight
    drawn = printed_solid(design, part, ruled=True) if twice else shape
    volume, scale = mass_properties(shape, 1.0).volume, print_scale(design, part)
    mesh = checked_mesh(part, drawn, volume)
    fingerprint = Mount.of(design).fingerprints[part]
    content = part_stl(design, part, printed_mesh(design, part, mesh), fingerprint)
    path = folder / f"{part}.stl"
    listed = listed_digests(folder).get(path.name)
    if listed is not None and listed != hashlib.sha256(content).hexdigest():
        raise InputError(
            f"{path}: belongs to an export of another design or version; export the whole design, or give --out"
        )
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(path, content, replace=True)
    return {
        "file": str(path),
        "part": part,
        "fingerprint": fingerprint,
        "volume_m3": volume,
        "mesh_volume_missing": volume_omitted(mesh, volume),
        "size_bytes": len(content),
        "print_scale": list(scale),
    }
