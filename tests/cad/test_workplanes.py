"""The parts as CadQuery objects: tags, poses and colours of the assembly, and the export of changed parts."""

import hashlib
import json
import math
import runpy
import sys
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cadquery", reason="the parts are drawn with CadQuery: pip install 'probedesign[cad]'")

import cadquery as cq

from probedesign.cad import assembly, clamp_ring, export_changed, flange_adapter, probe_solid, sensor_adapter
from probedesign.cad.model import CadModel
from probedesign.cad.workplanes import with_measured_screws
from probedesign.core.errors import CheckFailedError, InputError
from probedesign.design import check_design
from probedesign.design.io import render_design, write_design
from probedesign.mount.engraving import XY
from tests.cad.conftest import design_of, without_engraving

EXAMPLE = Path(__file__).parents[2] / "examples/changed_adapter.py"
LARGE = design_of()
FLANGE = LARGE.robot_flange


@pytest.fixture(scope="module")
def parts() -> dict[str, cq.Workplane]:
    return {build.__name__: build(LARGE) for build in (probe_solid, sensor_adapter, clamp_ring, flange_adapter)}


def test_parts_for_assumed_holes_are_refused(tmp_path: Path) -> None:
    """As `export` refuses them."""
    tables = LARGE.model_dump(by_alias=True, exclude_none=True, mode="json")
    assumed = check_design({**tables, "sensor": {"model": "rft40"}})
    with pytest.raises(InputError):
        assumed.sensor_model.check_holes_known()
    for build in (
        lambda: flange_adapter(assumed),
        lambda: assembly(assumed),
        lambda: export_changed(assumed, tmp_path / "out", flange_adapter=cq.Workplane().box(1, 1, 1)),
    ):
        with pytest.raises(InputError):
            build()
    assert not (tmp_path / "out").exists()


def test_tags_of_the_probe_are_base_plane_and_tip(parts: dict[str, cq.Workplane]) -> None:
    part = parts["probe_solid"]
    base, tip = part.faces(tag="base_plane").val(), part.faces(tag="tip").val()
    assert abs(base.Center().z) < 1e-9 and abs(tip.Center().z - 150.0) < 1e-9  # [mm], round-off
    assert tip.Area() == pytest.approx(math.pi, rel=1e-9)  # Ø2 mm
    assert part.solids().size() == 1


def test_bolt_circle_of_the_robot_lies_on_its_holes(parts: dict[str, cq.Workplane]) -> None:
    part = parts["flange_adapter"]
    centres = [v.toTuple() for v in part.vertices(tag="robot_bolts").vals()]
    radii = [2e-3 * math.hypot(x, y) for x, y, _ in centres]
    assert np.allclose(radii, FLANGE.bolt_circle_d)
    wider = part.faces(tag="sensor_face").workplane(origin=(0, 0, 0)).vertices(tag="robot_bolts").hole(8.0)
    thickness = centres[0][2]
    clearance = FLANGE.screw.clearance_d * 1e3
    ring = math.pi / 4 * (8.0**2 - clearance**2) * thickness
    # drilled concentrically, each of the four holes loses exactly a ring; the engraving and the pocket are elsewhere
    assert part.val().Volume() - wider.findSolid().Volume() == pytest.approx(4 * ring, rel=1e-6)


def test_assembly_has_names_colours_tags_and_poses(large: Any) -> None:
    whole = assembly(LARGE)
    assert {"probe", "sensor_adapter", "clamp_ring", "flange_adapter", "sensor"} <= set(whole.objects)
    assert whole.objects["probe"].color.toTuple()[:3] == pytest.approx(large.parts["probe"].color, abs=1e-6)
    probe = whole.objects["probe"]
    tip = probe.obj.faces(tag="tip").val().moved(probe.loc).Center()
    assert tip.z == pytest.approx(150.0 + 1e3 * large.adapter.T_sensor_base[2, 3])
    # a tag that a constraint of CadQuery names
    whole.constrain("probe?base_plane", "clamp_ring?base_plane", "Plane", param=0)


def test_tagged_frames_mate_the_parts_where_the_manifest_puts_them(
    large: CadModel, parts: dict[str, cq.Workplane]
) -> None:
    """Faces do not: a peg, a cable slot or an engraving moves the centre of a face off the axis."""
    parts = {name.removesuffix("_solid"): part for name, part in parts.items()}
    mates = (("sensor_adapter", "probe", "probe_base"), ("sensor_adapter", "clamp_ring", "probe_base"),
             ("sensor_adapter", "flange_adapter", "sensor"))  # fmt: skip
    solved = cq.Assembly()
    for name, part in parts.items():
        solved.add(part, name=name)
    for fixed, moving, frame in mates:
        solved.constrain(f"{fixed}?{frame}", f"{moving}?{frame}", "Plane", param=0)
        solved.constrain(f"{fixed}?{frame}_x", f"{moving}?{frame}_x", "Axis", param=0)
    solved.constrain("sensor_adapter", "Fixed").solve()

    def frame_of(part: str, frame: str) -> cq.Location:
        return parts[part].workplaneFromTagged(frame).plane.location

    def matrix(at: cq.Location) -> Any:
        row = at.wrapped.Transformation()
        return [[row.Value(i, k) * (1e-3 if k == 4 else 1.0) for k in range(1, 5)] for i in range(1, 4)]

    for fixed, moving, frame in mates:
        wanted = large.parts[moving].T_sensor_part[:3]
        np.testing.assert_allclose(matrix(solved.objects[moving].loc), wanted, atol=1e-9)  # [m]
        computed = frame_of(fixed, frame) * frame_of(moving, frame).inverse
        np.testing.assert_allclose(matrix(computed), wanted, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "face", "tag"),
    [("sensor_adapter", "seat", "tool_screws"), ("sensor_adapter", "tool_face", "dowels"),
     ("clamp_ring", "top", "ring_screws"), ("flange_adapter", "sensor_face", "mounting_screws")],
)  # fmt: skip
def test_blind_holes_are_drilled_at_the_tagged_centres_from_their_face(
    parts: dict[str, cq.Workplane], name: str, face: str, tag: str
) -> None:
    part, depth, d = parts[name], 1.0, 8.0
    drilled = part.faces(tag=face).workplane(origin=(0, 0, 0)).vertices(tag=tag).hole(d, depth)
    into = -part.faces(tag=face).val().normalAt().z
    tools = [
        cq.Solid.makeCylinder(d / 2, depth, v.Center(), cq.Vector(0, 0, into)) for v in part.vertices(tag=tag).vals()
    ]
    wanted = part.val().Volume() - part.val().cut(*tools).Volume()
    assert part.val().Volume() - drilled.findSolid().Volume() == pytest.approx(wanted, rel=1e-6) and wanted > 1.0


def test_changed_part_is_exported_with_its_manifest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, out = tmp_path / "large.toml", tmp_path / "changed"
    write_design(render_design(LARGE), path)
    monkeypatch.setattr(sys, "argv", [str(EXAMPLE), str(path), str(out)])
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    manifest = json.loads((out / "manifest.json").read_text("utf-8"))
    assert {"flange_adapter.stl", "flange_adapter.step", "assembly.step", "assembly.glb"} == set(manifest["files"])
    for name, record in manifest["files"].items():
        assert hashlib.sha256((out / name).read_bytes()).hexdigest() == record["sha256"]
    mass = manifest["changed"]["flange_adapter"]
    density = manifest["parts"]["flange_adapter"]["density_kg_m3"]
    hole = math.pi / 4 * 2.5**2 * 4.0 * 1e-9
    assert mass["mass_as_designed_kg"] - mass["mass_kg"] == pytest.approx(density * hole, rel=1e-6)
    read = cq.importers.importStep(str(out / "flange_adapter.step"))
    assert read.val().Volume() * 1e-9 == pytest.approx(manifest["parts"]["flange_adapter"]["volume_m3"], rel=1e-6)


@pytest.fixture(scope="module")
def plain(large: CadModel) -> CadModel:
    return without_engraving(large)


def with_part(large: CadModel, name: str, change: Callable[[cq.Workplane], cq.Workplane]) -> CadModel:
    part = large.parts[name]
    changed = replace(part, shape=change(cq.Workplane(obj=part.shape)).findSolid().Solids()[0])
    return with_measured_screws(replace(large, parts=large.parts | {name: changed}), [name])


def cut(points: Iterable[XY], d: float, z0: float, z1: float) -> Callable[[cq.Workplane], cq.Workplane]:
    """Return the change that removes a cylinder about each point; diameter and heights in millimetres."""

    def change(work: cq.Workplane) -> cq.Workplane:
        for x, y in points:
            work = work.cut(cq.Workplane(obj=cq.Solid.makeCylinder(d / 2, z1 - z0, cq.Vector(1e3 * x, 1e3 * y, z0))))
        return work

    return change


def test_screws_are_measured_in_changed_parts(plain: CadModel) -> None:
    """An unchanged part has the screws of the design; deeper counterbores let them enter by as much more."""
    for group, wanted in zip(with_part(plain, "sensor_adapter", lambda work: work).screws, plain.screws, strict=True):
        assert group.grip == pytest.approx(wanted.grip, abs=1e-9) and group.seat == pytest.approx(wanted.seat, abs=1e-9)
    a, plate = plain.adapter, plain.plate
    grip, top = 1e3 * a.tool.grip, 1e3 * plate.counterbore_top
    deeper = with_part(plain, "sensor_adapter", cut(a.p_tool_screws[:1], 4.4, grip - 0.3, grip + 1.0))
    group = {group.name: group for group in deeper.screws}["sensor_adapter_screws"]
    assert group.as_record()["entry_mm"] == pytest.approx(3.2)  # of 2.9
    drawn = deeper.parts["sensor_adapter_screws"].places[0][2, 3]
    assert drawn == pytest.approx(a.tool.grip - 3e-4, abs=1e-9)
    lower = with_part(plain, "flange_adapter", cut(plate.p_mounting_screws, 4.4, top - 1.0, top + 0.2))
    assert lower.screws[2].entry == pytest.approx(plain.screws[2].entry + 2e-4)


def test_screws_that_would_destroy_the_sensor_or_hold_nothing_are_refused(plain: CadModel) -> None:
    a, plate = plain.adapter, plain.plate
    grip, top = 1e3 * a.tool.grip, 1e3 * plate.counterbore_top
    bolts, roof = plate.p_bolts, 1e3 * plate.plate_top
    ring = 1e3 * a.ring_thickness
    wrong: list[tuple[str, Callable[[cq.Workplane], cq.Workplane], str]] = [
        # The counterbore is 1.2 mm deeper: an M2x6 enters by 4.1 mm where the sensor bears 3.5 mm.
        ("sensor_adapter", cut(a.p_tool_screws[1:2], 4.4, grip - 1.2, grip + 1.0), "tool side by 4.10 mm; allowed"),
        ("sensor_adapter", cut(a.p_tool_screws, 4.4, -1.0, grip + 1.0), "sensor_adapter_screws: a head of .* no seat"),
        ("sensor_adapter", cut([(0.0, 0.0)], 60.0, -1.0, 0.8), "are 0.8 mm apart; they must touch"),
        ("flange_adapter", cut(plate.p_mounting_screws, 4.4, top - 1.0, top + 1.2), "sensor mounting side by 4.10 mm"),
        ("flange_adapter", cut(bolts[:1], 12.0, roof - 2.0, roof + 1.0), "robot flange by 7.30 mm"),
        ("clamp_ring", cut(a.p_ring_screws, 5.0, ring - 1.2, ring + 1.0), "nuts in the sensor adapter by"),
    ]
    for name, change, message in wrong:
        with pytest.raises(CheckFailedError, match=message):
            with_part(plain, name, change)


def test_part_that_touches_the_sensor_is_refused(tmp_path: Path, parts: dict[str, cq.Workplane]) -> None:
    part = parts["sensor_adapter"]
    grown = part.union(
        cq.Workplane(origin=(0, 0, 0.5)).circle(12.0).circle(6.0).extrude(-5.0)
    )  # a skirt around the sensor's body
    with pytest.raises(CheckFailedError, match="below_tool_face"):
        export_changed(LARGE, tmp_path / "out", sensor_adapter=grown)
    assert not (tmp_path / "out").exists()


def test_what_is_no_changed_part_is_refused(tmp_path: Path) -> None:
    two = cq.Workplane().box(1, 1, 1).add(cq.Solid.makeBox(1, 1, 1, cq.Vector(5, 0, 0))).combine()
    with pytest.raises(InputError, match="2 solids"):
        assembly(LARGE, clamp_ring=two)
    with pytest.raises(InputError, match="no part"):
        export_changed(LARGE, tmp_path)
