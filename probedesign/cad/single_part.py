"""STL file of one printed part, without the rest of an export."""

import hashlib
import os
from pathlib import Path
from typing import Any

from probedesign.cad.folder import check_target, listed_digests
from probedesign.cad.kernel import mass_properties
from probedesign.cad.mesh import MESH_LIMIT, part_stl, tessellate
from probedesign.cad.model import printed_solid
from probedesign.core.errors import CheckFailedError, InputError
from probedesign.core.files import write_atomically
from probedesign.design import Design
from probedesign.geometry import build_geometry
from probedesign.printing.check import print_scale


def export_part(design: Design, part: str, out: Path | None) -> dict[str, Any]:
    """Build, check and write the mesh of one printed part; see `probedesign.cad.export_part`."""
    folder = Path(os.path.abspath(out or Path("exports") / design.name))
    check_target(folder)
    shape = printed_solid(design, part)
    mesh, solid = tessellate(shape), mass_properties(shape, 1.0)
    missing = abs(mesh.volume / solid.volume - 1.0)
    if not mesh.closed or missing > MESH_LIMIT:
        raise CheckFailedError(f"{part}: the mesh is not closed, or omits {missing:.2g} of the volume")
    scaled = mesh.scaled(print_scale(design, part))
    content = part_stl(design, part, scaled, build_geometry(design).fingerprint)
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
        "fingerprint": build_geometry(design).fingerprint,
        "volume_m3": solid.volume,
        "mesh_volume_missing": missing,
        "size_bytes": len(content),
        "print_scale": list(print_scale(design, part)),
    }
