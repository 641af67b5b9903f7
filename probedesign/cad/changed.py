"""Export of parts that were changed in CadQuery: their files and a manifest, after the checks that need no formula."""

import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cadquery as cq

from probedesign.cad.export import SCHEMA, cad_files, manifest_json, model_record
from probedesign.cad.folder import MANIFEST, check_target, staged
from probedesign.cad.kernel import mass_properties
from probedesign.cad.mesh import part_stl, scaled, tessellate
from probedesign.cad.model import CadPart, printed_solid
from probedesign.cad.verify import checked, mesh_findings, room_findings
from probedesign.cad.workplanes import changed_model
from probedesign.core.errors import InputError
from probedesign.design import Design
from probedesign.printing.check import print_scale


def export_changed(design: Design, changed: Mapping[str, cq.Workplane], out: Path) -> dict[str, Any]:
    """Check, mesh and write changed parts; see `probedesign.cad.export_changed`."""
    if not changed:
        raise InputError("no part is given; name the changed ones, such as sensor_adapter=PART")
    folder = Path(os.path.abspath(out))
    check_target(folder, "changed parts")
    model = changed_model(design, changed)
    meshes = {name: tessellate(model.parts[name].shape) for name in changed}
    findings = checked(design.name, {**mesh_findings(model, meshes), **room_findings(model)})
    contents = cad_files(model, changed)
    for name, mesh in meshes.items():
        as_printed = scaled(mesh, print_scale(design, name))
        contents[f"{name}.stl"] = part_stl(design, name, as_printed, model.geometry.fingerprint)
    files = {
        name: {"sha256": hashlib.sha256(content).hexdigest(), "size_bytes": len(content)}
        for name, content in sorted(contents.items())
    }
    manifest = {
        "schema": SCHEMA,
        "kind": "changed parts",
        **model_record(model, files, findings),
        "changed": {name: _masses(design, model.parts[name]) for name in changed},
        "print_scale": {name: list(print_scale(design, name)) for name in changed},
    }
    with staged(folder) as staging:
        for name, content in contents.items():
            (staging / name).write_bytes(content)
        (staging / MANIFEST).write_text(manifest_json(manifest), "utf-8")
    return {**manifest, "folder": str(folder)}


def _masses(design: Design, part: CadPart) -> dict[str, float]:
    """Return the mass of a changed part beside that of the design's."""
    drawn = printed_solid(design, part.name)
    return {
        "mass_kg": mass_properties(part.shape, part.density).mass,
        "mass_as_designed_kg": mass_properties(drawn, part.density).mass,
    }
