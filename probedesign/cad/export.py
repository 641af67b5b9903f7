"""From a design to its folder of files: all of them checked, or none."""

import hashlib
import json
import os
import re
import shutil
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from probedesign.cad.assembly import assembly_of
from probedesign.cad.drawing import Drawing, draw
from probedesign.cad.manifest import manifest_of
from probedesign.cad.mesh import Mesh, mesh_of, stl_bytes
from probedesign.cad.threemf import read_back, threemf_bytes
from probedesign.cad.verify import verify
from probedesign.design import Design
from probedesign.errors import CheckFailedError, InputError
from probedesign.printing.check import check_print
from probedesign.printing.compensation import compensated, scale_note, scale_of

MANIFEST = "manifest.json"
STEP_END = b"END-ISO-10303-21;"


def export_parts(design: Design, out: Path | None, progress: Callable[[str], None]) -> dict[str, Any]:
    """Draw, check and write; see `probedesign.cad.export_parts`."""
    folder = Path(os.path.abspath(out or Path("exports") / design.name))
    _check_target(folder)
    progress("drawing the parts")
    drawing = draw(design)
    progress("meshing")
    meshes = {part.name: mesh_of(part.shape) for part in drawing.printed}
    contents = _mesh_files(drawing, meshes)
    progress("checking solids, slices and meshes against the formulae")
    findings = verify(drawing, meshes, contents["probe.3mf"])
    if compensated(design):  # what is checked is what was drawn; what is printed is that, stretched
        contents = _mesh_files(drawing, {n: mesh.scaled(scale_of(design, n)) for n, mesh in meshes.items()})
        read_back(contents["probe.3mf"])
    progress("writing")
    with _staged(folder) as staging:
        for name, content in contents.items():
            (staging / name).write_bytes(content)
        _write_step(drawing, staging / "assembly.step")
        manifest = manifest_of(drawing, _digests(staging), findings)
        manifest["print_check"] = check_print(design).as_record()
        manifest["print_scale"] = {name: list(scale_of(design, name)) for name in meshes}
        (staging / MANIFEST).write_text(_as_json(manifest), "utf-8")
    return {**manifest, "folder": str(folder)}


def _mesh_files(drawing: Drawing, meshes: dict[str, Mesh]) -> dict[str, bytes]:
    design, fingerprint = drawing.design, drawing.geometry.fingerprint
    # An STL header must not begin with "solid": readers take such a file for text.
    files = {
        f"{name}.stl": stl_bytes(
            mesh, f"probedesign {fingerprint}{scale_note(design, name)} {design.name} {name}"
        )
        for name, mesh in meshes.items()
    }
    metadata = {
        "Title": f"{design.name}: flexible probe",
        "Designer": "probedesign",
        "Description": f"geometry {fingerprint}{scale_note(design, 'probe')}, resin {design.resin.name}",
    }
    files["probe.3mf"] = threemf_bytes(meshes["probe"], "probe", f"{design.name}-{fingerprint}", metadata)
    return files


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


def _check_target(folder: Path) -> None:
    """Refuse, before any work, a folder that can neither be written nor be made."""
    nearest = next(path for path in (folder, *folder.parents) if path.exists())
    if not nearest.is_dir():
        raise InputError(f"{folder}: {nearest} is a file; name a folder to export into")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise InputError(f"{folder}: cannot be written: no permission in {nearest}")


@contextmanager
def _staged(folder: Path) -> Iterator[Path]:
    """A temporary sibling of `folder`: its files move there if the block ends well, and vanish otherwise."""
    staging = folder.parent / f".{folder.name}.{uuid.uuid4().hex[:8]}.partial"
    try:
        staging.mkdir(parents=True)
        yield staging
        _put_in_place(staging, folder)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror or error}") from None
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _put_in_place(staging: Path, folder: Path) -> None:
    """Move the files; whatever else lies in the folder stays.

    The old manifest goes first and the new one comes last: a folder with a manifest is a whole export.
    """
    if not folder.exists():
        staging.rename(folder)
        return
    (folder / MANIFEST).unlink(missing_ok=True)
    for path in sorted(staging.iterdir(), key=lambda path: path.name == MANIFEST):
        path.replace(folder / path.name)
