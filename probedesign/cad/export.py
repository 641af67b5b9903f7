"""From a design to its folder of files: all of them checked, or none."""

import hashlib
import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from probedesign.cad.assembly import assembly_of
from probedesign.cad.documents import documents_of
from probedesign.cad.drawing import Drawing, draw
from probedesign.cad.manifest import manifest_of
from probedesign.cad.mesh import Mesh, mesh_of, stl_bytes
from probedesign.cad.packages import packages_of
from probedesign.cad.staging import MANIFEST, check_target, staged
from probedesign.cad.threemf import read_back
from probedesign.cad.verify import verify
from probedesign.design import Design
from probedesign.errors import CheckFailedError
from probedesign.printing.check import check_print, is_compensated, print_scale, scale_note

STEP_END = b"END-ISO-10303-21;"


def export_parts(design: Design, out: Path | None, progress: Callable[[str], None]) -> dict[str, Any]:
    """Draw, check and write; see `probedesign.cad.export_parts`."""
    folder = Path(os.path.abspath(out or Path("exports") / design.name))
    check_target(folder)
    progress("drawing the parts")
    drawing = draw(design)
    progress("meshing")
    meshes = {part.name: mesh_of(part.shape) for part in drawing.printed}
    packages = packages_of(drawing, meshes)
    progress("checking solids, slices and meshes against the formulae")
    findings = verify(drawing, meshes, packages)
    progress("taking pictures, drawing sheets")
    documents = documents_of(drawing, meshes)
    if is_compensated(design):  # what is checked is what was drawn; what is printed is that, stretched
        meshes = {name: mesh.scaled(print_scale(design, name)) for name, mesh in meshes.items()}
        packages = packages_of(drawing, meshes)
        for content in packages.values():
            read_back(content)
    progress("writing")
    with staged(folder) as staging:
        for name, content in (_stl_files(drawing, meshes) | packages | documents.files).items():
            (staging / name).write_bytes(content)
        _write_step(drawing, staging / "assembly.step")
        manifest = manifest_of(drawing, documents, _digests(staging), findings)
        manifest["print_check"] = check_print(design).as_record()
        manifest["print_scale"] = {name: list(print_scale(design, name)) for name in meshes}
        (staging / MANIFEST).write_text(_as_json(manifest), "utf-8")
    return {**manifest, "folder": str(folder)}


def _stl_files(drawing: Drawing, meshes: dict[str, Mesh]) -> dict[str, bytes]:
    # An STL header must not begin with "solid": readers take such a file for text.
    title, design = f"probedesign {drawing.geometry.fingerprint}", drawing.design
    return {
        f"{name}.stl": stl_bytes(mesh, f"{title}{scale_note(design, name)} {design.name} {name}")
        for name, mesh in meshes.items()
    }


def _write_step(drawing: Drawing, path: Path) -> None:
    assembly_of(drawing.parts, drawing.design.name).export(str(path), "STEP")
    if not path.is_file() or not path.read_bytes().rstrip().endswith(STEP_END):
        raise CheckFailedError(f"{path.name}: the kernel did not write it to its end")


def _digests(folder: Path) -> dict[str, dict[str, Any]]:
    contents = {path.name: path.read_bytes() for path in sorted(folder.iterdir())}
    return {n: {"sha256": hashlib.sha256(c).hexdigest(), "size_bytes": len(c)} for n, c in contents.items()}


def _as_json(manifest: dict[str, Any]) -> str:
    """JSON that a person can read: each row of numbers on one line."""
    text = json.dumps(manifest, indent=2, ensure_ascii=False, allow_nan=False)
    row = re.compile(r"\[\n\s+([^\[\]{}\"]*?)\n\s+\]")
    return row.sub(lambda m: "[" + re.sub(r",\n\s+", ", ", m[1]) + "]", text) + "\n"
