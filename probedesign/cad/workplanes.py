"""The parts of a design as CadQuery objects with tagged faces and bolt circles, their assembly, and the export of parts
that were changed in CadQuery."""

import os
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import cadquery as cq
import numpy as np

from probedesign.cad.export import SCHEMA, cad_files, model_record
from probedesign.cad.folder import check_target, digests, write_export
from probedesign.cad.kernel import FLAT_MM, cylinder, location
from probedesign.cad.mesh import part_stl, printed_mesh, tessellate
from probedesign.cad.model import CadModel, CadPart, assembly_of, box_of, build_cad, printed_solid
from probedesign.cad.solids import ScrewGroup
from probedesign.cad.verify import checked, mesh_findings, room_findings
from probedesign.core.errors import CheckFailedError, InputError
from probedesign.core.frames import Array, inverse, pose
from probedesign.core.units import MM
from probedesign.design import Design
from probedesign.geometry import fingerprint_of
from probedesign.geometry.mass import combined
from probedesign.mount import Mount
from probedesign.mount.engraving import XY
from probedesign.mount.mount import payload_fingerprint
from probedesign.printing.check import print_scale

#: Parts that each group of screws clamps, from the head to the thread.
CLAMPED = {"sensor_adapter_screws": ("sensor_adapter",), "ring_screws": ("clamp_ring", "sensor_adapter"),
           "mounting_screws": ("flange_adapter",), "robot_bolts": ("flange_adapter",)}  # fmt: skip
#: Parts that must touch, so that the poses of the manifest hold, and the largest gap between them [mm].
TOUCHING, GAP_MM = (("sensor_adapter", "sensor"), ("flange_adapter", "sensor"), ("sensor_adapter", "probe")), 1e-3
EDGE = 0.05 * MM  #: Distance of the cut below a screw's head from its hole and from the rim of the head.


def probe_solid(design: Design) -> cq.Workplane:
    """Return the probe with its flange as a CadQuery workplane of one solid.

    Args:
        design: the design, for example from `load_design`.

    Returns:
        The solid in millimetres in the base frame. Tagged faces: base_plane, tip, underside; frames: probe_base,
        probe_tip; point: clocking_mark.

    Raises:
        InputError: the mount cannot clamp this probe.
    """
    return _part(design, "probe")


def sensor_adapter(design: Design) -> cq.Workplane:
    """Return the sensor adapter in millimetres in the sensor frame; raises what `probe_solid` raises.

    Tagged faces: tool_face, seat, rim; frames: sensor, probe_base; centres of holes: tool_screws, dowels, ring_screws.
    """
    return _part(design, "sensor_adapter")


def clamp_ring(design: Design) -> cq.Workplane:
    """Return the clamp ring in millimetres in its own frame; raises what `probe_solid` raises.

    Tagged faces: base_plane, top; frame: probe_base; centres of holes: ring_screws.
    """
    return _part(design, "clamp_ring")


def flange_adapter(design: Design) -> cq.Workplane:
    """Return the robot flange's adapter in millimetres in that flange's frame; raises what `probe_solid` raises.

    Tagged faces: robot_face, sensor_face; frames: robotflange, sensor; centres of holes: robot_bolts, mounting_screws,
    centring_pins.
    """
    return _part(design, "flange_adapter")


def _part(design: Design, part: str) -> cq.Workplane:
    design.sensor_model.check_holes_known()
    return _tagged(design, part, printed_solid(design, part))


def assembly(
    design: Design,
    *,
    probe: cq.Workplane | None = None,
    sensor_adapter: cq.Workplane | None = None,
    clamp_ring: cq.Workplane | None = None,
    flange_adapter: cq.Workplane | None = None,
) -> cq.Assembly:
    """Return all parts, screws, pins and the sensor's envelope, named, coloured and placed in the sensor frame.

    Args:
        design: the design.
        probe, sensor_adapter, clamp_ring, flange_adapter: changed parts that replace the design's, each in its own
            frame; None for the design's.

    Returns:
        The assembly in millimetres. Its printed parts carry their tags, such as `probe?tip` in a constraint.

    Raises:
        InputError: the mount cannot clamp this probe, or a part is not one solid.
        CheckFailedError: a changed solid is not valid.
    """
    changed = _given(probe, sensor_adapter, clamp_ring, flange_adapter)
    model = changed_model(design, changed)
    result = assembly_of(model.parts, model.design.name)
    for part in model.printed:
        kept = changed.get(part.name)
        result.objects[part.name].obj = _tagged(model.design, part.name, part.shape) if kept is None else kept
    return result


def _given(*parts: cq.Workplane | None) -> dict[str, cq.Workplane]:
    names = ("probe", "sensor_adapter", "clamp_ring", "flange_adapter")
    return {name: part for name, part in zip(names, parts, strict=True) if part is not None}


def changed_model(design: Design, changed: Mapping[str, cq.Workplane]) -> CadModel:
    """Return the CAD model of a design with some printed parts replaced.

    Raises:
        InputError: a part is not one solid.
        CheckFailedError: the solid is not valid.
    """
    solids: dict[str, cq.Solid] = {}
    for name, part in changed.items():
        pieces = part.findSolid().Solids() if isinstance(part, cq.Workplane) else []
        if len(pieces) != 1:
            raise InputError(f"{name}: has {len(pieces)} solids; give a CadQuery Workplane with one solid")
        if not pieces[0].isValid() or pieces[0].Volume() <= 0.0:
            raise CheckFailedError(f"{name}: the changed solid is not valid; check its last operation")
        solids[name] = pieces[0]
    design.sensor_model.check_holes_known()
    model = build_cad(design)
    parts: dict[str, CadPart] = {
        name: replace(part, shape=solids[name], ruled=None) if name in solids else part
        for name, part in model.parts.items()
    }
    return replace(model, parts=parts)


def with_measured_screws(model: CadModel, changed: Iterable[str]) -> CadModel:
    """Return a model whose screws have the seats and the grips of its changed parts.

    Raises:
        CheckFailedError: a head meets no seat, a screw enters too little or too deep, or parts do not touch.
    """
    for a, b in (pair for pair in TOUCHING if not set(pair).isdisjoint(changed)):
        if (gap := model.parts[a].placed.distance(model.parts[b].placed)) > GAP_MM:
            raise CheckFailedError(f"{model.design.name}: {a} and {b} are {gap:.2g} mm apart; they must touch")
    screws, parts = [], dict(model.parts)
    for group in model.screws:
        if not set(CLAMPED[group.name]).isdisjoint(changed):
            group = _measured(group, model.parts)
            parts[group.name] = replace(parts[group.name], places=group.poses)
        screws.append(group)
    return replace(model, screws=screws, parts=parts)


def _measured(group: ScrewGroup, parts: Mapping[str, CadPart]) -> ScrewGroup:
    """Return a group of screws with its smallest grip and that screw's seat, from cuts of the parts below each head.

    A part is cut by a tube between the screw's hole and the rim of its head, up to the thread. Its piece nearest to the
    head counts: a gap within a part makes the grip smaller and the entry larger than they are.
    """
    up, measured_groups = -1.0 if group.up else 1.0, []  # towards the head
    thread = group.seat - up * group.grip if len(CLAMPED[group.name]) == 1 else -up  # a nut moves with its part
    low, high = min(thread, up), max(thread, up)
    for p in group.points:
        tube = cylinder(group.screw.head_d - 2 * EDGE, low, high, p)
        tube = tube.cut(cylinder(group.screw.clearance_d + 2 * EDGE, low, high, p))
        ends = []
        for name in CLAMPED[group.name]:
            pieces = [box_of(piece)[:, 2] * MM for piece in parts[name].placed.intersect(tube).Solids()]
            if not pieces:
                raise CheckFailedError(f"{group.name}: a head of {group.standard} meets no seat in the {name}")
            ends.append(max(pieces, key=lambda z: float((up * z).max())))
        grip = sum(float(z[1] - z[0]) for z in ends)
        measured_groups.append(replace(group, grip=grip, seat=float(up * (up * ends[0]).max())))
    for measured in measured_groups:
        measured.check()
    return min(measured_groups, key=lambda measured: measured.grip)


def _tagged(design: Design, part: str, solid: cq.Shape) -> cq.Workplane:
    """Return a part's workplane with its tags: faces by their height, frames, centres of holes at the face from which
    each is drilled."""
    mount = Mount.of(design)
    geometry, a, plate = mount.geometry, mount.sensor_adapter, mount.flange_adapter
    faces: dict[str, float]
    circles: dict[str, tuple[Iterable[XY], float]]
    frames = {"probe_base": np.eye(4)}  # by the names of the manifest's and the simulators' frames
    match part:
        case "probe":
            faces = {"base_plane": 0.0, "underside": -geometry.flange.thickness}
            circles = {"clocking_mark": ([(a.peg_x, 0.0)], 0.0)}
            frames["probe_tip"] = geometry.axis.frames([geometry.length])[0]
        case "sensor_adapter":
            faces = {"tool_face": 0.0, "seat": a.floor, "rim": a.body_top}
            circles = {"tool_screws": (a.p_tool_screws, a.tool.grip), "dowels": (a.p_dowels, 0.0),
                       "ring_screws": (a.p_ring_screws, a.body_top)}  # fmt: skip
            frames = {"sensor": np.eye(4), "probe_base": a.T_sensor_base}
        case "clamp_ring":
            faces = {"base_plane": 0.0, "top": a.ring_thickness}
            circles = {"ring_screws": (a.p_ring_screws, a.ring_thickness)}
        case _:
            faces = {"robot_face": 0.0, "sensor_face": plate.plate_top}
            circles = {"robot_bolts": (plate.p_bolts, plate.plate_top),
                       "mounting_screws": (plate.p_mounting_screws, plate.plate_top),
                       "centring_pins": (plate.p_centring_pins, plate.plate_top)}  # fmt: skip
            frames = {"robotflange": np.eye(4), "sensor": inverse(plate.T_sensor_robotflange)}
    work = cq.Workplane(obj=solid)

    def tag_plane(name: str, T: Array) -> None:
        """Tag the largest face in the plane through the origin and across z of a pose in the part's frame."""
        turned = ((face.moved(location(T).inverse), face) for face in solid.Faces() if face.geomType() == "PLANE")
        there = [face for local, face in turned
                 if abs(local.normalAt().z) > 1.0 - FLAT_MM and abs(local.Center().z) < FLAT_MM]  # fmt: skip
        work.newObject([max(there, key=lambda face: face.Area())]).tag(name)

    for name, z in faces.items():
        tag_plane(name, pose(p=[0.0, 0.0, z]))
    if part == "probe":
        tag_plane("tip", frames["probe_tip"])
    for name, T in frames.items():
        at = location(T)
        for tag, axis in ((name, T[:3, 2]), (f"{name}_x", T[:3, 0])):  # two faces hold all six freedoms of a mate
            disc = cq.Face.makeFromWires(cq.Wire.makeCircle(1.0, cq.Vector(*T[:3, 3] / MM), cq.Vector(*axis)))
            tagged = work.newObject([disc])
            tagged.plane = cq.Plane(at)
            tagged.tag(tag)
    for name, (points, z) in circles.items():
        work.newObject([cq.Vertex.makeVertex(x / MM, y / MM, z / MM) for x, y in points]).tag(name)
    return work


def export_changed(
    design: Design,
    out: Path,
    *,
    probe: cq.Workplane | None = None,
    sensor_adapter: cq.Workplane | None = None,
    clamp_ring: cq.Workplane | None = None,
    flange_adapter: cq.Workplane | None = None,
) -> dict[str, Any]:
    """Check changed parts in the assembly, and write their STL and STEP, the assembly's STEP and GLB and a manifest.

    Checked are what needs no formula of the original part: valid solids, closed meshes, no overlap of parts, the
    clearance to the sensor and its cable, the entry of every screw, measured in the changed parts, and that adapters
    touch sensor and probe. Tolerance stacks and printability of a changed part are neither checked nor in the
    manifest.

    Args:
        design: the design.
        out: output folder.
        probe, sensor_adapter, clamp_ring, flange_adapter: changed parts, as for `assembly`.

    Returns:
        The manifest, with the output folder under `folder`; `changed` has the mass of each part beside that of the
        design, which `deploy` uses.

    Raises:
        InputError: as `assembly`, or no part is given, or the folder cannot be written.
        CheckFailedError: a check fails; nothing is written.
    """
    changed = _given(probe, sensor_adapter, clamp_ring, flange_adapter)
    if not changed:
        raise InputError("no part is given; name the changed ones, such as sensor_adapter=PART")
    folder = Path(os.path.abspath(out))
    check_target(folder, "changed parts")
    model = with_measured_screws(changed_model(design, changed), changed)
    fingerprints = dict(model.fingerprints)
    for name in changed:  # of volume and centre of mass, which stand for dimensions that nobody lists
        body = model.parts[name].body
        fingerprints[name] = fingerprint_of([np.cbrt(body.volume), *body.p_com])
    if not {"sensor_adapter", "clamp_ring"}.isdisjoint(changed):
        rigid = combined(body for name, body in model.bodies.items() if name != "flexible")
        fingerprints["payload"] = payload_fingerprint(rigid)
    model = replace(model, fingerprints=fingerprints)
    meshes = {name: tessellate(model.parts[name].shape) for name in changed}
    findings = checked(design.name, {**mesh_findings(model, meshes), **room_findings(model)})
    contents = cad_files(model, changed)
    for name, mesh in meshes.items():
        as_printed = printed_mesh(design, name, mesh)
        contents[f"{name}.stl"] = part_stl(design, name, as_printed, fingerprints[name])

    drawn = build_cad(design).parts
    manifest = {
        "schema": SCHEMA,
        "kind": "changed parts",
        **model_record(model, digests(contents), findings),
        "changed": {
            name: {"mass_kg": model.parts[name].body.mass, "mass_as_designed_kg": drawn[name].body.mass}
            for name in changed
        },
        "print_scale": {name: list(print_scale(design, name)) for name in changed},
    }
    return write_export(folder, contents, manifest)
