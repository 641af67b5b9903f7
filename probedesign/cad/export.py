"""Export a design to its folder of files, with their manifest: all files verified, or none written."""

import math
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import cadquery as cq
import numpy as np

from probedesign.cad.documents import build_documents
from probedesign.cad.exchange import glb_bytes, step_bytes
from probedesign.cad.folder import check_target, digests, write_export
from probedesign.cad.mesh import part_stl, printed_mesh, tessellate
from probedesign.cad.model import CadModel, assembly_of, build_cad
from probedesign.cad.packages import package_files
from probedesign.cad.verify import Findings, verify
from probedesign.core.errors import InputError, quoted
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.design import Design
from probedesign.geometry.mass import MassProperties, combined
from probedesign.mount import root_radii
from probedesign.mount.mount import exported_root_radii, exported_root_std
from probedesign.mount.tolerance_stack import clamp_force, measurements, tolerance_stacks
from probedesign.printing.check import BUILD_VOLUME, check_print, print_scale

SCHEMA = 1


def manifest_of(
    model: CadModel, bill: list[dict[str, Any]], files: dict[str, dict[str, Any]], findings: Findings
) -> dict[str, Any]:
    """Return the manifest of an export."""
    a, mount = model.adapter, model.design.mount
    hold = "clamped" if mount.hold == "bonded" else mount.hold  # the exported ring clamps
    root, root_std = exported_root_radii(model.geometry, hold), exported_root_std(model.geometry, a.pressed_share)
    record = model_record(model, files, findings)
    return {
        "schema": SCHEMA,
        "kind": "export",
        **record,
        "assumptions": [*record["assumptions"], "tolerance_stacks", "clamp"],
        "bill_of_materials": bill,
        "clamp": clamp_force(a, model.plate, model.design.youngs_modulus.value).as_record(),
        "tolerance_stacks": [stack.as_record() for stack in tolerance_stacks(a, model.plate)],
        "measure_before_assembly": [row.as_record() for row in measurements(a, model.plate)],
        "base": {
            "root_rigid_radii": root_radii(model.design, model.geometry),
            "root_rigid_radii_computed": round(root, 3),
            "root_rigid_radii_means": "bending compliance that the base lacks, in base radii; 0.12 is that of a face "
            f"bonded to a rigid part, that of this {hold} soft flange about {root:.2f} ± {root_std:.2g}, "
            "computed for a full round probe, not measured: identify it on the bench",
        },
    }


def model_record(model: CadModel, files: dict[str, dict[str, Any]], findings: Findings) -> dict[str, Any]:
    """Return what the manifests of all exports have in common; `files` are digest and size by name."""
    design, sensor, bodies = model.design, model.design.sensor_model, model.bodies
    rigid = combined(body for name, body in bodies.items() if name != "flexible")
    return {
        "name": design.name,
        "fingerprint": model.geometry.fingerprint,
        "fingerprints": model.fingerprints,
        "made_with": {"cadquery": cq.__version__},
        "design": design.model_dump(mode="json", by_alias=True, exclude_none=True),
        "assumptions": [*design.assumptions, "density of the rigid parts", "density of the steel parts"],
        "files": files,
        "parts": {
            part.name: {"frame": part.frame, "T_sensor_part": _pose(part.T_sensor_part), "density_kg_m3": part.density}
            | _body(part.body)
            for part in model.printed
        },
        "poses": "4x4, in metres; T_a_b maps b's coordinates into a's",
        "T_sensor_base": _pose(model.adapter.T_sensor_base),
        "T_sensor_robotflange": _pose(model.plate.T_sensor_robotflange),
        "T_robotflange_base": _pose(model.T_robotflange_base),
        "robot": {
            "frame": "robotflange: origin at the centre of the robot's face, z out of the robot, x through its "
            "dowel hole; inertia about the centre of mass",
            "base_mm": [round(x / MM, 6) + 0.0 for x in model.T_robotflange_base[:3, 3].tolist()],
            "base_turn_about_z_deg": round(math.degrees(model.base_turn), 6),
            "base_rotation_vector_rad": [0.0, 0.0, model.base_turn],
            "counts": "everything beyond the robot's face: flange adapter, sensor without cable as a homogeneous "
            "cylinder, sensor adapter, clamp ring, probe, all screws, nuts and pins",
            **_body(model.carried),
        },
        "mass": {
            "frame": "sensor; inertia about the centre of mass",
            "counts": "everything beyond the tool face: the probe with its flange, sensor adapter, clamp ring, "
            "and the screws, nuts and dowel pins on the tool side",
            "bodies": {name: _body(body) for name, body in bodies.items()},
            "rigid": _body(rigid),
            "whole": _body(combined([bodies["flexible"], rigid])),
        },
        "sensor": {
            "frame": "sensor; the centre of mass is at half height unless the sensor file states it",
            "product": sensor.product,
            "source": sensor.source,
            "assumed": list(sensor.assumed),
            "mass_kg": sensor.interface.mass,
            "p_com_m": list(sensor.interface.p_com),
            "overload_N": None if sensor.overload is None else list(sensor.overload[:3]),
            "overload_Nm": None if sensor.overload is None else list(sensor.overload[3:]),
        },
        "screws": [use.as_record() for use in model.screws],
        "verification": findings,
        "intersections_m3": model.shared_volumes,
    }


def _pose(T: Array) -> list[list[float]]:
    rounded = np.round(T, 12) + 0.0  # to a picometre, which hides round-off such as 0.008199999999999999
    return [[float(x) for x in row] for row in rounded]


def _body(body: MassProperties) -> dict[str, Any]:
    return {
        "volume_m3": body.volume,
        "mass_kg": body.mass,
        "p_com_m": body.p_com.tolist(),
        "inertia_kg_m2": body.inertia.tolist(),
    }


def export_parts(
    design: Design, out: Path | None = None, progress: Callable[[str], None] = lambda step: None
) -> dict[str, Any]:
    """Build a design's parts, verify them, and write the files of one export.

    Args:
        design: the design to export.
        out: output folder; `exports/NAME` if None.
        progress: called with the name of each step.

    Returns:
        The manifest, with the output folder under `folder`.

    Raises:
        InputError: the folder cannot be written, the mount cannot clamp the probe, or the sensor's holes are not known.
        CheckFailedError: a part disagrees with its closed form; nothing is written.
    """
    design.sensor_model.check_holes_known()
    folder = Path(os.path.abspath(out or Path("exports") / design.name))
    check_target(folder)
    check = check_print(design)
    if small := next((f for f in check.errors if f.rule == BUILD_VOLUME.name), None):
        raise InputError(f"print.printer = {quoted(check.printer)} is too small: {small.message}")
    progress("drawing the parts")
    model = build_cad(design)
    progress("meshing")
    meshes = {part.name: tessellate(part.ruled or part.shape) for part in model.printed}
    printed = {name: printed_mesh(design, name, mesh) for name, mesh in meshes.items()}
    packages = package_files(design, check, printed, model.fingerprints)
    progress("checking solids and meshes against the formulae")
    findings = verify(model, meshes)
    progress("rendering pictures and drawings")
    documents, bill = build_documents(model, check.post_processing)
    progress("converting to STEP and GLB")
    stl = {f"{name}.stl": part_stl(design, name, mesh, model.fingerprints[name]) for name, mesh in printed.items()}
    contents = stl | packages | documents | cad_files(model, list(printed))
    manifest = manifest_of(model, bill, digests(contents), findings)
    manifest["print_check"] = check.as_record()
    manifest["print_scale"] = {name: list(print_scale(design, name)) for name in printed}
    manifest["print_offset_xy_mm"] = design.print_.offset_xy_mm  # of the probe, beside its scale
    progress("writing")
    return write_export(folder, contents, manifest)


def cad_files(model: CadModel, parts: Iterable[str]) -> dict[str, bytes]:
    """Return the assembly as STEP and GLB, and the STEP file of each of these parts in its own frame."""
    name, date = model.design.name, model.design.date

    def step(assembly: cq.Assembly, file: str, what: str, part: str = "probe") -> bytes:
        fingerprint = model.fingerprints[part]
        return step_bytes(assembly, file, f"{name}: {what}, geometry {fingerprint}, units mm", date)

    files = {
        "assembly.step": step(assembly_of(model.parts, name), "assembly.step", "assembly in the sensor frame"),
        "assembly.glb": glb_bytes(assembly_of(model.parts, name, displayed=True), "assembly.glb"),
    }
    for part in map(model.parts.__getitem__, parts):
        alone = cq.Assembly(part.shape, name=part.name, color=cq.Color(*part.color))
        where = f"{part.name} in the {part.frame} frame"
        files[f"{part.name}.step"] = step(alone, f"{part.name}.step", where, part.name)
    return files
