"""The record that lies beside the exported files: what they are, how they go together, what was checked."""

from typing import Any

import cadquery as cq
import numpy as np

from probedesign.cad.assembly import Part
from probedesign.cad.bill import as_records
from probedesign.cad.documents import Documents
from probedesign.cad.drawing import Drawing
from probedesign.cad.kernel import mass_of
from probedesign.cad.verify import Findings
from probedesign.frames import Array
from probedesign.mass import MassProperties, combined
from probedesign.mount.sensor_adapter import SQUEEZE, exported_root_radii
from probedesign.units import MM

SCHEMA = 1


def manifest_of(
    drawing: Drawing, documents: Documents, files: dict[str, dict[str, Any]], findings: Findings
) -> dict[str, Any]:
    """The manifest of an export.

    Args:
        drawing: of the design.
        documents: made of it.
        files: by name, each with its sha256 and size.
        findings: of `verify`.
    """
    design = drawing.design
    return {
        "schema": SCHEMA,
        "name": design.name,
        "fingerprint": drawing.geometry.fingerprint,
        "made_with": {"cadquery": cq.__version__},
        "design": design.model_dump(mode="json", by_alias=True, exclude_none=True),
        "assumptions": [*design.assumptions, "density of the rigid parts", "density of the steel parts"],
        "files": files,
        "parts": {part.name: _part(part) for part in drawing.printed},
        "poses": "4x4, in metres; T_a_b maps b's coordinates into a's",
        "T_sensor_base": _pose(drawing.adapter.T_sensor_base),
        "T_sensor_robotflange": _pose(drawing.plate.T_sensor_robotflange),
        "mass": _mass(drawing),
        "bill_of_materials": as_records(documents.bill),
        "screws": [use.as_record() for use in drawing.screws],
        "also_needed": _also_needed(drawing),
        "engraved": _engraved(drawing),
        "assembly_order": documents.steps,
        "base": _base(drawing),
        "verification": findings,
        "intersections_m3": drawing.shared_volumes,
    }


def _also_needed(drawing: Drawing) -> dict[str, int]:
    """What is neither printed nor a screw."""
    pin_d = drawing.plate.robot.pin_d / MM
    robots = {f"dowel pin of {pin_d:g} mm that the robot's flange takes": 1} if pin_d > 0.0 else {}
    return {"M2 nut, ISO 4032": 4, "dowel pin 2x6 mm": len(drawing.adapter.p_dowels), **robots}


def _part(part: Part) -> dict[str, Any]:
    return {
        "frame": part.frame,
        "T_sensor_part": _pose(part.T_sensor_part),
        "density_kg_m3": part.density,
        **_body(mass_of(part.shape, part.density)),
    }


def _pose(T: Array) -> list[list[float]]:
    rounded = np.round(T, 12) + 0.0  # to a picometre: spares the reader sums like 0.008199999999999999
    return [[float(x) for x in row] for row in rounded]


def _mass(drawing: Drawing) -> dict[str, Any]:
    bodies = drawing.bodies
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


def _engraved(drawing: Drawing) -> dict[str, str]:
    """What is cut into each printed part: the fingerprint, then as much of the name as there was room for."""
    a = drawing.adapter
    return {
        "probe": a.on_flange.text,
        "sensor_adapter": a.on_wall.text,
        "clamp_ring": a.on_ring.text,
        "flange_adapter": drawing.plate.on_plate.text,
    }


def _base(drawing: Drawing) -> dict[str, Any]:
    flange, a = drawing.geometry.flange, drawing.adapter
    return {
        "held_by": f"soft flange Ø{flange.diameter / MM:g} x {flange.thickness / MM:g} mm in one piece with "
        f"the probe; the clamp ring presses its lip from Ø{a.ring_bore_d / MM:g} mm outwards by "
        f"{SQUEEZE / MM:g} mm",
        "root_rigid_radii": drawing.design.mount.root_rigid_radii,
        "root_rigid_radii_means": "bending compliance that the base lacks, in base radii; 0.12 is that of a face "
        f"bonded to a rigid part, this soft flange yields by about {exported_root_radii(drawing.geometry):.2f}, "
        "computed for a full round probe, not measured: identify it on the bench",
        "drawn": "with the lip not yet pressed: screwed down, the ring and its screws lie lower by as much",
    }
