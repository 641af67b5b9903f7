"""3MF packages of the printed parts: one for each resin and platform, with the parts as the print check lays them out.

A package states its unit, the names of its parts and the design's fingerprint.
"""

import uuid
from collections.abc import Mapping
from typing import Any

import lib3mf
import trimesh
from numpy.typing import NDArray

from probedesign.design import Design
from probedesign.design.catalog import RIGID_RESIN
from probedesign.mount.engraving import XY
from probedesign.printing.check import ORIENTATIONS, PrintCheck, scale_note


def package_files(
    design: Design, check: PrintCheck, meshes: Mapping[str, trimesh.Trimesh], fingerprints: Mapping[str, str]
) -> dict[str, bytes]:
    """Return the content of each package by file name, with the orientation and position of the print check.

    Args:
        design: of the parts.
        check: that lays them out.
        meshes: as printed, each in its own frame [mm], by part.
        fingerprints: by part.
    """
    packages: dict[str, bytes] = {}
    for platform in check.platforms:
        stem, number = ("probe" if "probe" in platform else "adapters"), 1
        while (file := f"{stem}{'' if number == 1 else f'_{number}'}.3mf") in packages:
            number += 1
        part_numbers = {name: f"{design.name}-{fingerprints[name]}-{name}" for name in platform}
        packages[file] = _package(design, platform, meshes, part_numbers)
    return packages


def _package(
    design: Design, platform: Mapping[str, XY], meshes: Mapping[str, trimesh.Trimesh], part_numbers: Mapping[str, str]
) -> bytes:
    names, resin = list(platform), design.resin.name if "probe" in platform else RIGID_RESIN
    model = lib3mf.get_wrapper().CreateModel()
    model.SetUnit(lib3mf.ModelUnit.MilliMeter)
    group = model.GetMetaDataGroup()
    for key, value in {
        "Title": f"{design.name}: {', '.join(names).replace('_', ' ')}",
        "Designer": "probedesign",
        "Description": f"{', '.join(part_numbers.values())}{scale_note(design, names[0])}, {resin}",
    }.items():
        group.AddMetaData("", key, value, "xs:string", True)
    for name, (x, y) in platform.items():
        mesh, part_number = meshes[name], part_numbers[name]
        body = model.AddMeshObject()
        body.SetName(name)
        body.SetPartNumber(part_number)
        body.SetGeometry(_structs(lib3mf.Position, mesh.vertices.astype("<f4")),
                         _structs(lib3mf.Triangle, mesh.faces.astype("<u4")))  # fmt: skip
        body.SetUUID(_uuid(f"object {part_number}"))
        (low, high), side = mesh.bounds[:, 2].tolist(), 1.0 if ORIENTATIONS[name].upright else -1.0
        transform = lib3mf.Transform()
        rows = ((1.0, 0.0, 0.0), (0.0, side, 0.0), (0.0, 0.0, side), (x, y, -low if side > 0.0 else high))
        for fields, values in zip(transform.Fields, rows, strict=True):  # 3MF multiplies from the right
            fields[:] = values
        item = model.AddBuildItem(body, transform)
        item.SetPartNumber(part_number)
        item.SetUUID(_uuid(f"item {part_number}"))
    model.SetBuildUUID(_uuid(" ".join(part_numbers.values())))
    return bytes(model.QueryWriter("3mf").WriteToBuffer())


def _uuid(name: str) -> str:
    return str(uuid.uuid5(uuid.NAMESPACE_OID, name))


def _structs(kind: Any, rows: NDArray[Any]) -> Any:
    return (kind * len(rows)).from_buffer_copy(rows.tobytes())
