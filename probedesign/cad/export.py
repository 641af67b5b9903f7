"""Export a design to its folder of files, with their manifest: all files verified, or none written."""

import hashlib
import json
import os
import re
import shutil
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import cadquery as cq
import numpy as np

from probedesign.cad.assembly_docs import Documents, bill_records, build_documents
from probedesign.cad.kernel import mass_properties
from probedesign.cad.mesh import Mesh, read_back, tessellate, threemf_packages
from probedesign.cad.model import CadModel, CadPart, assembly_of, build_cad, printed_solid
from probedesign.cad.step import step_bytes
from probedesign.cad.verify import MESH_LIMIT, Findings, verify
from probedesign.core.errors import CheckFailedError, InputError
from probedesign.core.files import write_atomically
from probedesign.core.frames import Array
from probedesign.core.parallel import defer_sigint
from probedesign.core.stl import stl_bytes
from probedesign.core.units import MM
from probedesign.design import Design
from probedesign.geometry import build_geometry
from probedesign.geometry.mass import MassProperties, combined
from probedesign.mount import exported_root_radii
from probedesign.mount.root import ROOT_STD
from probedesign.mount.tolerance_stack import measurements, tolerance_stacks
from probedesign.printing.check import check_print, is_compensated, print_scale, scale_note

SCHEMA = 1
MANIFEST = "manifest.json"


def manifest_of(
    model: CadModel, documents: Documents, files: dict[str, dict[str, Any]], findings: Findings
) -> dict[str, Any]:
    """Return the manifest of an export.

    Args:
        model: of the design.
        documents: of the export.
        files: sha256 and size by name.
        findings: of `verify`.
    """
    design, a, robot = model.design, model.adapter, model.plate.robot
    robot_pin = (
        {f"dowel pin of {robot.pin_d / MM:g} mm that the robot's flange takes": 1} if robot.pin_d else {}
    )
    pin = f"dowel pin {a.dowels.diameter / MM:g}x{a.dowels.pin_length / MM:g} mm"
    return {
        "schema": SCHEMA,
        "name": design.name,
        "fingerprint": model.geometry.fingerprint,
        "made_with": {"cadquery": cq.__version__},
        "design": design.model_dump(mode="json", by_alias=True, exclude_none=True),
        "assumptions": [
            *design.assumptions,
            "density of the rigid parts",
            "density of the steel parts",
            "tolerance_stacks",
        ],
        "files": files,
        "parts": {part.name: _part(part) for part in model.printed},
        "poses": "4x4, in metres; T_a_b maps b's coordinates into a's",
        "T_sensor_base": _pose(a.T_sensor_base),
        "T_sensor_robotflange": _pose(model.plate.T_sensor_robotflange),
        "mass": _mass(model),
        "bill_of_materials": bill_records(documents.bill),
        "screws": [use.as_record() for use in model.screws],
        "tolerance_stacks": [stack.as_record() for stack in tolerance_stacks(a, model.plate)],
        "measure_before_assembly": [row.as_record() for row in measurements(a, model.plate)],
        "also_needed": {
            f"{a.ring_screw.thread} nut, ISO 4032": len(a.p_ring_screws),
            pin: len(a.p_dowels) + len(model.plate.p_centring_pins),
            "cable tie, 2.5 mm wide": 1,
            **robot_pin,
        },
        # the fingerprint, then as much of the name as fits
        "engraved": {
            "probe": a.on_flange.text,
            "sensor_adapter": a.on_wall.text,
            "clamp_ring": a.on_ring.text,
            "flange_adapter": model.plate.on_plate.text,
        },
        "assembly_order": documents.steps,
        "base": _base(model),
        "verification": findings,
        "intersections_m3": model.shared_volumes,
    }


def _part(part: CadPart) -> dict[str, Any]:
    return {
        "frame": part.frame,
        "T_sensor_part": _pose(part.T_sensor_part),
        "density_kg_m3": part.density,
        **_body(mass_properties(part.shape, part.density)),
    }


def _pose(T: Array) -> list[list[float]]:
    rounded = np.round(T, 12) + 0.0  # to a picometre, which hides round-off such as 0.008199999999999999
    return [[float(x) for x in row] for row in rounded]


def _mass(model: CadModel) -> dict[str, Any]:
    bodies = model.bodies
    rigid = combined(body for name, body in bodies.items() if name != "flexible")
    return {
        "frame": "sensor; inertia about the centre of mass",
        "counts": "everything beyond the tool face: the probe with its flange, sensor adapter, clamp ring, "
        "and the screws, nuts and dowel pins on the tool side",
        "bodies": {name: _body(body) for name, body in bodies.items()},
        "rigid": _body(rigid),
        "whole": _body(combined([bodies["flexible"], rigid])),
    }


def _body(body: MassProperties) -> dict[str, Any]:
    return {
        "volume_m3": body.volume,
        "mass_kg": body.mass,
        "p_com_m": body.p_com.tolist(),
        "inertia_kg_m2": body.inertia.tolist(),
    }


def _base(model: CadModel) -> dict[str, Any]:
    flange, a = model.geometry.flange, model.adapter
    return {
        "held_by": f"soft flange Ø{flange.diameter / MM:g} x {flange.thickness / MM:g} mm in one piece with "
        f"the probe; the clamp ring presses its lip from Ø{a.ring_bore_d / MM:g} mm outwards by "
        f"{a.squeeze / MM:.3g} mm",
        "root_rigid_radii": model.design.mount.root_rigid_radii,
        "root_rigid_radii_computed": round(exported_root_radii(model.geometry, model.design.mount.hold), 3),
        "root_rigid_radii_means": "bending compliance that the base lacks, in base radii; 0.12 is that of a face "
        f"bonded to a rigid part, that of this {model.design.mount.hold} soft flange about "
        f"{exported_root_radii(model.geometry, model.design.mount.hold):.2f} ± {ROOT_STD:g}, "
        "computed for a full round probe, not measured: identify it on the bench",
        "drawn": "with the lip not yet pressed: screwed down, the ring and its screws lie lower by as much",
    }


def export_parts(design: Design, out: Path | None, progress: Callable[[str], None]) -> dict[str, Any]:
    """Build, verify and write an export; see `probedesign.cad.export_parts`."""
    folder = Path(os.path.abspath(out or Path("exports") / design.name))
    check_target(folder)
    progress("drawing the parts")
    model = build_cad(design)
    progress("meshing")
    meshes = {part.name: tessellate(part.shape) for part in model.printed}
    packages = threemf_packages(model, meshes)
    progress("checking solids, slices and meshes against the formulae")
    findings = verify(model, meshes, packages)
    progress("rendering pictures and drawings")
    documents = build_documents(model, meshes)
    if is_compensated(design):  # verified as drawn, printed scaled
        meshes = {name: mesh.scaled(print_scale(design, name)) for name, mesh in meshes.items()}
        packages = threemf_packages(model, meshes)
        for content in packages.values():
            read_back(content)
    progress("writing")
    stl = {
        f"{name}.stl": _stl(design, name, mesh, model.geometry.fingerprint) for name, mesh in meshes.items()
    }
    step = step_bytes(assembly_of(model.parts, design.name))
    with staged(folder) as staging:
        contents = stl | packages | documents.files | {"assembly.step": step}
        for name, content in contents.items():
            (staging / name).write_bytes(content)
        files = {
            name: {"sha256": hashlib.sha256(content).hexdigest(), "size_bytes": len(content)}
            for name, content in sorted(contents.items())
        }
        manifest = manifest_of(model, documents, files, findings)
        manifest["print_check"] = check_print(design).as_record()
        manifest["print_scale"] = {name: list(print_scale(design, name)) for name in meshes}
        (staging / MANIFEST).write_text(_as_json(manifest), "utf-8")
    return {**manifest, "folder": str(folder)}


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
    content = _stl(design, part, scaled, build_geometry(design).fingerprint)
    path = folder / f"{part}.stl"
    listed = _digests(folder).get(path.name)
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


def _stl(design: Design, part: str, mesh: Mesh, fingerprint: str) -> bytes:
    # An STL header must not begin with "solid", which marks a text file.
    title = f"probedesign {fingerprint}{scale_note(design, part)} {design.name} {part}"
    return stl_bytes(mesh.vertices[mesh.triangles], title)


def _digests(folder: Path) -> dict[str, str]:
    """Return the digests of the files that the folder's manifest lists; none if it cannot be read."""
    try:
        files = json.loads((folder / MANIFEST).read_text("utf-8"))["files"]
        return {str(name): str(record["sha256"]) for name, record in files.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def _as_json(manifest: dict[str, Any]) -> str:
    """Return readable JSON: each row of numbers on one line."""
    text = json.dumps(manifest, indent=2, ensure_ascii=False, allow_nan=False)
    row = re.compile(r"\[\n\s+([^\[\]{}\"]*?)\n\s+\]")
    return row.sub(lambda m: "[" + re.sub(r",\n\s+", ", ", m[1]) + "]", text) + "\n"


def check_target(folder: Path) -> None:
    """Check, before any work, that a folder can be written or created."""
    nearest = next(path for path in (folder, *folder.parents) if path.exists())
    if not nearest.is_dir():
        inside = "" if nearest == folder else f"{folder}: "
        raise InputError(f"{inside}{nearest} is a file; name a folder to export into")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise InputError(f"{folder}: cannot be written: no permission in {nearest}")


@contextmanager
def staged(folder: Path) -> Iterator[Path]:
    """Yield a temporary sibling of `folder`; its files move there on success and are deleted otherwise.

    What killed processes left behind is removed first.
    """
    staging = folder.parent / f".{folder.name}.{uuid.uuid4().hex[:8]}.partial"
    try:
        staging.mkdir(parents=True)
        with _claimed(staging):
            _remove_abandoned(folder)
            yield staging
            with defer_sigint():
                _put_in_place(staging, folder)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror or error}") from None
    finally:
        shutil.rmtree(staging, ignore_errors=True)


@contextmanager
def _claimed(staging: Path) -> Iterator[None]:
    """Lock a folder; the system releases the lock with the process, however it ends.

    Raises:
        BlockingIOError: another process holds it.
    """
    try:
        import fcntl
    except ImportError:  # Windows: no locks, so no folder counts as abandoned
        yield
        return
    handle = os.open(staging, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(handle)


def _remove_abandoned(folder: Path) -> None:
    """Remove staging folders that no process has locked; those of running exports stay."""
    if os.name == "nt":
        return
    for left in folder.parent.glob(f".{folder.name}.????????.partial"):
        with suppress(OSError), _claimed(left):
            shutil.rmtree(left, ignore_errors=True)


def _put_in_place(staging: Path, folder: Path) -> None:
    """Move the files into place. Files of the folder's last export that this one lacks are removed; all others stay.

    The old manifest is removed first and the new one moved last, so a folder with a manifest is a complete export.
    """
    if not folder.exists():
        staging.rename(folder)
        return
    outdated = _made_before(folder) - {path.name for path in staging.iterdir()}
    (folder / MANIFEST).unlink(missing_ok=True)
    for name in outdated:
        (folder / name).unlink(missing_ok=True)
    for path in sorted(staging.iterdir(), key=lambda path: path.name == MANIFEST):
        path.replace(folder / path.name)


def _made_before(folder: Path) -> set[str]:
    """Return the names of existing files that the folder's manifest lists; none if it cannot be read."""
    listed = _digests(folder)
    return {path.name for path in folder.iterdir() if path.name in listed and path.is_file()}
