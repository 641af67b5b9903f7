"""The print check measures walls by formula; here the kernel measures the same walls on the drawn solids."""

from typing import Any

import numpy as np
import pytest

pytest.importorskip("cadquery", reason="the parts are drawn with CadQuery: pip install 'probedesign[cad]'")

from OCP.BRepAdaptor import BRepAdaptor_Surface

from probedesign.core.units import MM
from probedesign.design.catalog import M2
from probedesign.printing.check import check_print


def round_faces(shape: Any, diameter: float) -> list[Any]:
    """Cylindrical faces of that diameter [m]."""
    cylinders = [face for face in shape.Faces() if face.geomType() == "CYLINDER"]
    radii = [BRepAdaptor_Surface(face.wrapped).Cylinder().Radius() for face in cylinders]
    return [face for face, r in zip(cylinders, radii, strict=True) if abs(2 * r * MM - diameter) < 1e-9]


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
            round_faces(adapter, a.dowel_d)[:1], round_faces(adapter, a.foot_d)),
        ("clamp_ring", "between screw hole and rim"): (
            round_faces(ring, M2.clearance_d), round_faces(ring, a.body_d)),
        ("clamp_ring", "between screw hole and bore"): (round_faces(ring, M2.clearance_d), cone),
        ("flange_adapter", "between bolt and rim"): (
            round_faces(flange, plate.robot.screw.clearance_d), round_faces(flange, plate.plate_d)),
        ("flange_adapter", "between pin slot and rim"): (slot, round_faces(flange, plate.plate_d)),
        ("flange_adapter", "between a head's room and edge of the spigot"): (
            round_faces(flange, M2.counterbore_d), round_faces(flange, plate.robot.spigot[0])),
    }  # fmt: skip
    for key, (some, others) in drawn.items():
        assert apart(some, others) == pytest.approx(message[key], abs=1e-6), key  # mm: the kernel's tolerance is 1e-7


def test_walls_around_a_nut_slot_equal_the_check(large: Any) -> None:
    a, adapter = large.adapter, large.parts["sensor_adapter"].shape
    message = {f.what: f.measured for f in check_print(large.design).findings if f.part == "sensor_adapter"}
    ends = [f for f in round_faces(adapter, a.nut_slot_width) if f.Center().z > a.nut_slot_z[0] / MM]
    assert len(ends) == 4
    wall = apart(ends, round_faces(adapter, a.recess_d))
    assert wall == pytest.approx(message["between nut slot and recess"], abs=1e-6)  # mm: the kernel's tolerance
    holes = [f for f in round_faces(adapter, M2.clearance_d) if f.BoundingBox().zmin < a.nut_slot_z[0] / MM]
    cone = [face for face in adapter.Faces() if face.geomType() == "CONE"]
    below = [f for f in holes if f.BoundingBox().zmin > 1.0]
    # The check measures the wall upright, the kernel along the cone's normal.
    upright = message["below a ring screw's hole"]
    assert apart(below, cone) == pytest.approx(upright * np.cos(np.radians(22.0)), rel=1e-6)


def test_the_web_at_the_clocking_hole_equals_the_check(large: Any) -> None:
    probe = large.parts["probe"].shape
    (found,) = [f for f in check_print(large.design).findings if "its rim" in f.what]
    web = apart(round_faces(probe, large.adapter.peg_hole_d), round_faces(probe, large.geometry.flange.diameter))
    assert web == pytest.approx(found.measured, abs=1e-6)  # mm: the kernel's tolerance is 1e-7
