"""Verify the CAD model against the mechanics and for assembly.

Solids and meshes are compared with closed forms; parts must not overlap or enter the sensor's clearance; every screw,
nut and pin must reach its place, and a hexagon key every screw, past the parts mounted before.
"""

from typing import Any

import cadquery as cq
import numpy as np
import trimesh

from probedesign.cad.documents import assembly_steps
from probedesign.cad.kernel import block, cylinder, hexagon, placed, revolved
from probedesign.cad.mesh import MESH_LIMIT, volume_omitted
from probedesign.cad.model import CadModel, volume_inside
from probedesign.cad.solids import ScrewGroup, cable_sector, clearance_volumes
from probedesign.core.errors import CheckFailedError
from probedesign.core.frames import pose
from probedesign.core.units import MM
from probedesign.geometry.mass import combined, flexible_part
from probedesign.mount import SensorAdapter, mount_mass_properties, mount_part_masses
from probedesign.mount.engraving import XY
from probedesign.mount.tolerance_stack import tolerance_stacks

CORRIDOR = 60.0 * MM  #: Length of the corridors of nuts and pins around the adapter, which lies free on the bench.


def blocked_tools(model: CadModel) -> dict[str, float]:
    """Return the obstruction of each group of screws, nuts and pins, and of the ring.

    Returns:
        By name, the volume [m³] of earlier parts in the corridors of the fastener and of its key; zero if it is free.
    """
    parts, screws, adapter = model.parts, model.screws, model.adapter
    tip = float(parts["probe"].placed.BoundingBox().zmax) * MM
    pin, ring_bottom = adapter.dowels, (adapter.ring_top, tip)
    corridors: dict[str, list[cq.Shape]] = {
        **{use.name: _screw_corridors(use) for use in screws},
        "ring_nuts": [_nut_corridor(adapter, p) for p in adapter.p_ring_screws],  # from the rim
        "dowel_pins": [cylinder(pin.diameter, -pin.depth, CORRIDOR, p) for p in adapter.p_dowels],  # from above
        "clamp_ring": [  # from above the tip
            cylinder(adapter.body_d, *ring_bottom).cut(cylinder(adapter.ring_bore_d, *ring_bottom))
        ],
    }
    blocked: dict[str, float] = {}
    present = ["sensor"]
    for step in assembly_steps(model):
        there = list(dict.fromkeys(move.onto for move in step.moves)) if step.on_bench else present
        for name in step.parts:
            if name in corridors and name not in blocked:
                corridor = cq.Compound.makeCompound(corridors[name])
                # a curved probe is threaded through the ring, and bent aside for the keys
                aside = ("clamp_ring", "ring_screws", "robot_bolts") if parts["probe"].ruled is not None else ()
                others = [parts[other] for other in there if other != "probe" or name not in aside]
                blocked[name] = volume_inside(corridor, others)
            if name not in there:  # the adapter comes with its nuts and pins
                there.append(name)
        present += [name for name in step.parts if name not in present]
    return blocked


def _screw_corridors(use: ScrewGroup) -> list[cq.Shape]:
    """Return the corridor of each screw: its shank, and above it the head's width over the length of the key."""
    out = -1.0 if use.up else 1.0  # from point to head
    seat, head, shank = use.seat, use.screw.head_d / 2, use.screw.pitch_d / 2
    point, free = seat - out * use.length, seat + out * (use.screw.head_height + use.screw.key_length)
    corridor = revolved([(0.0, point), (shank, point), (shank, seat), (head, seat), (head, free), (0.0, free)])
    return [placed(corridor, pose(p=[*p, 0.0])) for p in use.points]


def _nut_corridor(a: SensorAdapter, p: XY) -> cq.Shape:
    nut, r = a.options.nut, float(np.hypot(*p))
    z = (a.nut_slot_z[1] - nut.height, a.nut_slot_z[1])
    ahead = block((r, r + CORRIDOR), (-nut.af / 2, nut.af / 2), z)
    turned = ahead.rotate((0, 0, 0), (0, 0, 1), float(np.degrees(np.arctan2(p[1], p[0]))))
    return turned.fuse(hexagon(nut.af, *z, p, 30.0))


Findings = dict[str, dict[str, Any]]

SOLID_LIMIT = 1e-9  #: Relative. The kernel integrates these surfaces to about 1e-14; modelling errors are far larger.
#: Relative, of bodies with a curved axis: rings between those of the splines are too small by 2e-8, and the kernel
#: integrates many of them to about 1e-6.
CURVED_LIMIT = 1e-5
OVERLAP_LIMIT = 0.0  #: Shared volume [m³]: touching faces share none, and no fit is drawn compressed.


def verify(model: CadModel, meshes: dict[str, trimesh.Trimesh]) -> Findings:
    """Check a CAD model and its meshes as drawn.

    Returns:
        Each finding by name, with `measured`, `limit`, `ok` and `what`.

    Raises:
        CheckFailedError: names every finding that is not ok.
    """
    findings = {**solid_findings(model), **mesh_findings(model, meshes), **room_findings(model)}
    for stack in tolerance_stacks(model.adapter, model.plate):
        what = f"m outside the limits at the worst corner: {stack.what}"
        findings[f"{stack.name}_worst_case"] = _finding(stack.outside, 0.0, what)
    what = "m³ of earlier parts in the corridors of the fastener and its key"
    findings |= {
        f"reach_{name}": _finding(volume, OVERLAP_LIMIT, what) for name, volume in blocked_tools(model).items()
    }
    return checked(model.design.name, findings)


def checked(name: str, findings: Findings) -> Findings:
    """Return the findings of a model of that name.

    Raises:
        CheckFailedError: names every finding that is not ok.
    """
    failed = [f"{n} = {f['measured']:.3g} (limit {f['limit']:.3g})" for n, f in findings.items() if not f["ok"]]
    if failed:
        raise CheckFailedError(f"{name}: the CAD model fails verification: {'; '.join(failed)}")
    return findings


def solid_findings(model: CadModel) -> Findings:
    """Return how far volume, centre and inertia of the solids are from their closed forms."""
    geometry, adapter = model.geometry, model.adapter
    density = model.design.density.value
    drawn = dict(model.bodies)
    drawn["hanging"] = combined(body for name, body in drawn.items() if name != "flexible")
    formula = mount_part_masses(geometry, adapter, density)
    formula["hanging"] = mount_mass_properties(geometry, adapter, density)
    formula["flexible"] = flexible_part(geometry, density).moved(adapter.T_sensor_base)
    findings: Findings = {}
    for name, body in drawn.items():
        wanted = formula[name]
        extent = float(np.sqrt(np.trace(wanted.inertia) / wanted.mass))
        volume = abs(body.volume / wanted.volume - 1.0)
        limit = SOLID_LIMIT if geometry.axis.is_straight or name != "flexible" else CURVED_LIMIT
        centre = np.abs(body.p_com - wanted.p_com).max() / extent
        inertia = np.abs(body.inertia - wanted.inertia).max() / np.abs(wanted.inertia).max()
        findings |= {
            f"{name}_volume": _finding(volume, limit, "relative"),
            f"{name}_centre": _finding(centre, limit, "relative to the body's extent"),
            f"{name}_inertia": _finding(inertia, limit, "relative, about the centre of mass"),
        }
    return findings


def mesh_findings(model: CadModel, meshes: dict[str, trimesh.Trimesh]) -> Findings:
    """Return whether meshes are closed, and what they omit of their solids."""
    findings: Findings = {}
    for name, mesh in meshes.items():
        omitted = volume_omitted(mesh, model.parts[name].body.volume)
        what = "watertight, consistent winding, outward normals (0 is yes)"
        findings[f"{name}_mesh_closed"] = _finding(float(not mesh.is_volume), 0.0, what)
        findings[f"{name}_mesh_volume"] = _finding(omitted, MESH_LIMIT, "relative, to the solid")
    return findings


def room_findings(model: CadModel) -> Findings:
    """Return what parts share with each other, with the sensor's clearance and with its cable's sector."""
    mount = [part for part in model.parts.values() if part.name != "sensor"]
    sensor = model.design.sensor_model.interface
    in_sector = volume_inside(cable_sector(sensor), mount)
    in_air = sum(volume_inside(air, mount) for air in clearance_volumes(sensor))
    wide = ("probe", "sensor_adapter", "clamp_ring", "ring_screws", "ring_nuts")
    lowest = min(model.parts[name].placed.BoundingBox().zmin for name in wide) * MM
    return {
        "overlap": _finding(max(model.shared_volumes.values()), OVERLAP_LIMIT, "m³, worst pair of parts"),
        "cable_sector": _finding(in_sector, OVERLAP_LIMIT, "m³ of mount parts in the cable's sector"),
        "air": _finding(in_air, OVERLAP_LIMIT, "m³ of mount parts within 0.5 mm of the sensor's body and cable"),
        # A nanometre: the kernel pads bounding boxes by its tolerance of 1e-10 m.
        "below_tool_face": _finding(max(0.0, -lowest), 1e-9, "m that wide parts reach below the tool face"),
    }


def _finding(measured: float, limit: float, what: str) -> dict[str, Any]:
    return {"measured": float(measured), "limit": limit, "ok": bool(measured <= limit), "what": what}
