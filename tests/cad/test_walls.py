"""The print check measures walls by formula; here the kernel measures the same walls on the drawn solids."""

from typing import Any

import pytest

pytest.importorskip("cadquery", reason="the parts are drawn with CadQuery: pip install 'probedesign[cad]'")

from probedesign.core.units import MM
from probedesign.design.catalog import M2
from probedesign.printing.check import check_print


def round_faces(shape: Any, diameter: float) -> list[Any]:
    """Cylindrical faces of that diameter [m]."""
    return [
        face
        for face in shape.Faces()
        if face.geomType() == "CYLINDER"
        and abs(2 * face._geomAdaptor().Cylinder().Radius() * MM - diameter) < 1e-9
    ]


def apart(some: list[Any], others: list[Any]) -> float:
    """Least distance between two groups of faces [mm]."""
    assert some and others
    return min(a.distance(b) for a in some for b in others)


def test_walls_of_the_rigid_parts_equal_the_check(large: Any) -> None:
    message = {(f.part, f.what): f.measured for f in check_print(large.design).findings}
    a, plate = large.adapter, large.plate
    adapter, ring, flange = (large.parts[n].shape for n in ("sensor_adapter", "clamp_ring", "flange_adapter"))
    cone = [face for face in ring.Faces() if face.geomType() == "CONE"]
    planes = [face for face in flange.Faces() if face.geomType() == "PLANE"]
    slot = [face for face in planes if abs(face.normalAt().z) < 1e-6]
    drawn = {
        ("sensor_adapter", "between ring screw and recess"): (
            round_faces(adapter, M2.clearance_d), round_faces(adapter, a.recess_d)),
        ("sensor_adapter", "between dowel hole and edge of the foot"): (
            round_faces(adapter, a.dowel_d), round_faces(adapter, a.foot_d)),
        ("clamp_ring", "between screw hole and rim"): (
            round_faces(ring, M2.clearance_d), round_faces(ring, a.body_d)),
        ("clamp_ring", "between screw hole and bore"): (round_faces(ring, M2.clearance_d), cone),
        ("flange_adapter", "between bolt and rim"): (
            round_faces(flange, plate.robot.screw.clearance_d), round_faces(flange, plate.plate_d)),
        ("flange_adapter", "between pin slot and rim"): (slot, round_faces(flange, plate.plate_d)),
        ("flange_adapter", "between sensor screw and edge of the pad"): (
            round_faces(flange, M2.clearance_d), round_faces(flange, plate.pad_d)),
        ("flange_adapter", "between a head's room and edge of the spigot"): (
            round_faces(flange, M2.counterbore_d), round_faces(flange, plate.robot.spigot[0])),
    }  # fmt: skip
    for key, (some, others) in drawn.items():
        assert apart(some, others) == pytest.approx(message[key], abs=1e-6), (
            key
        )  # mm: the kernel's tolerance is 1e-7


def test_the_nut_pocket_is_not_nearer_to_the_rim_than_checked(large: Any) -> None:
    """The check goes by the pocket's corners, however they are turned."""
    a, adapter = large.adapter, large.parts["sensor_adapter"].shape
    message = {f.what: f.measured for f in check_print(large.design).findings if f.part == "sensor_adapter"}
    sides = [f for f in adapter.Faces() if f.geomType() == "PLANE" and abs(f.normalAt().z) < 1e-6]
    pocket = [f for f in sides if f.BoundingBox().zmax < a.nut_pocket_top / MM + 1e-6]
    assert len(pocket) == 4 * 6
    wall = apart(pocket, round_faces(adapter, a.body_d))
    assert message["between nut pocket and rim"] - 1e-6 <= wall
    assert message["between nut pocket and recess"] == pytest.approx((a.floor - a.nut_pocket_top) / MM)


def test_the_web_at_the_clocking_hole_equals_the_check(large: Any) -> None:
    probe = large.parts["probe"].shape
    (found,) = [f for f in check_print(large.design).findings if "its rim" in f.what]
    web = apart(
        round_faces(probe, large.adapter.peg_hole_d), round_faces(probe, large.geometry.flange.diameter)
    )
    assert web == pytest.approx(found.measured, abs=1e-6)  # mm: the kernel's tolerance is 1e-7
