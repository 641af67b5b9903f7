"""The drawn parts, checked by points, slabs and overlaps, independently of the drawing code."""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from scipy.integrate import dblquad

pytest.importorskip("cadquery", reason="the parts are drawn with CadQuery: pip install 'probedesign[cad]'")

import cadquery as cq
import trimesh
from OCP.BRepClass3d import BRepClass3d_SolidClassifier
from OCP.gp import gp_Pnt
from OCP.TopAbs import TopAbs_State

from probedesign.cad.documents import assembly_steps
from probedesign.cad.kernel import mass_properties
from probedesign.cad.mesh import MESH_LIMIT, tessellate, volume_omitted
from probedesign.cad.model import FASTENERS, IN_SENSOR_FRAME, CadModel, CadPart, build_cad, build_parts, overlaps
from probedesign.cad.solids import flange_adapter_solid, probe_solid, screw_groups
from probedesign.cad.verify import blocked_tools, checked, mesh_findings, solid_findings, verify
from probedesign.core.errors import CheckFailedError, InputError
from probedesign.core.frames import Array, pose, rotation_z
from probedesign.design import Design, parse_design
from probedesign.design.catalog import SCREWS
from probedesign.design.io import render_design
from probedesign.design.sensor_catalog import SENSORS
from probedesign.design.sensors import ScrewPattern
from probedesign.geometry import flange_for
from probedesign.geometry.mass import combined, flexible_part
from probedesign.mount import Mount, flange_adapter_for, mount_part_masses, sensor_adapter_for
from probedesign.mount.engraving import Engraving
from probedesign.mount.tolerance_stack import tolerance_stacks
from probedesign.printing.check import check_print
from tests.cad.conftest import LARGE, design_of

PROFILE = (
    'shape = "profile"\nlength_mm = 120.0\nbase_d_mm = 12.0\n'
    "profile_mm = [[0, 12], [40, 13], [60, 7], [80, 7], [120, 2]]"
)

HOLLOW = 'section = "hollow"\nbore_ratio = 0.5\n'
ROUNDED = 'tip = "rounded"\n'
ELLIPTIC = 'section = "elliptic"\nflatness = 0.6\n'
NOTHING_CUT = Engraving("", 0.0, (), 0.0)
NEARLY_A_CYLINDER = "length_mm = 400.0\nbase_d_mm = 12.0\ntip_d_mm = 11.98"


def at(azimuth_deg: float, r: float, z: float) -> Array:
    a = np.radians(azimuth_deg)
    return np.array([r * np.cos(a), r * np.sin(a), z])


def filled(shape: Any, p: Array, T_sensor_part: Array = IN_SENSOR_FRAME) -> bool:
    """Whether a part has material at point p of the sensor frame [mm]."""
    local = T_sensor_part[:3, :3].T @ (p - 1e3 * T_sensor_part[:3, 3])
    solid = classifier(shape)
    solid.Perform(gp_Pnt(*local), 1e-6)
    return bool(solid.State() == TopAbs_State.TopAbs_IN)


@lru_cache(maxsize=64)
def classifier(shape: Any) -> Any:
    """Return the kernel's classifier of points, which takes longer to prepare than to ask."""
    return BRepClass3d_SolidClassifier(shape.wrapped)


def assert_verified(model: CadModel) -> None:
    """Solids, mesh of the probe, overlap, access and stacks."""
    assert all(f["ok"] for f in verify(model, {"probe": tessellate(model.parts["probe"].shape)}).values())


# ---- sensor adapter


def test_tool_side_holes(large: CadModel) -> None:
    adapter = large.parts["sensor_adapter"].shape
    for azimuth in (60, 180, 300):
        assert not any(filled(adapter, at(azimuth, 6.25 + side, 1.5)) for side in (-1.15, 0.0, 1.15))
        assert all(filled(adapter, at(azimuth, 6.25 + side, 1.5)) for side in (-1.25, 1.25))  # Ø2.4 clearance
        # Under a Ø3.8 head there is resin up to 3.1 mm and room from there on: the grip of an M2×6.
        assert filled(adapter, at(azimuth, 6.25 - 1.9, 3.0)) and not filled(adapter, at(azimuth, 6.25 - 1.9, 3.2))
    for azimuth in (95, 215, 335):  # the holes of the mounting side
        assert filled(adapter, at(azimuth, 6.25, 1.5))


def test_parts_on_another_sensor_agree_with_their_closed_form(large: CadModel) -> None:
    """A wider tool face, larger screws and another dowel circle: solids, screws and pins follow the interface."""
    nano, screw = SENSORS["nano17"].interface, SCREWS["M4"]
    tool = ScrewPattern(30e-3, 20e-3, (60.0, 180.0, 300.0), screw, min_entry=4e-3, max_entry=6e-3)
    dowels = replace(nano.dowels, circle_d=20e-3, diameter=3e-3, pin_length=5e-3)
    interface = replace(nano, body_d=40e-3, tool=tool, mounting=replace(tool, face_d=40e-3), dowels=dowels)
    geometry = replace(large.geometry, flange=flange_for(12e-3, tool.face_d))
    a = sensor_adapter_for(geometry, replace(SENSORS["nano17"], interface=interface))
    assert (tool.length, tool.grip) == (pytest.approx(8e-3), pytest.approx(3.5e-3))  # 8 - 4 - 0.29 - 0.15 mm
    # Heads of 7 mm on a circle of 20 mm reach beyond the land: they lie below the groove around it, 0.9 mm deep.
    assert a.floor == pytest.approx(tool.grip + screw.head_height + 0.2e-3 + 0.9e-3)
    plate = flange_adapter_for(
        replace(SENSORS["nano17"], interface=interface), replace(large.plate.robot, face_d=80e-3, bolt_circle_d=70e-3)
    )
    parts = build_parts(geometry, 1010.0, interface, a, plate, screw_groups(a, plate))
    assert max(overlaps(parts).values()) == 0.0
    bodies = mount_part_masses(geometry, a, 1010.0)
    for name, drawn in {
        "sensor_adapter": [parts["sensor_adapter"]],
        "clamp_ring": [parts["clamp_ring"]],
        "fasteners": [parts[name] for name in FASTENERS],
    }.items():
        whole = combined(mass_properties(part.placed, part.density) for part in drawn)
        assert whole.mass == pytest.approx(bodies[name].mass, rel=1e-9)
        assert whole.p_com == pytest.approx(bodies[name].p_com, abs=1e-9)


@pytest.mark.parametrize(("thread", "azimuths_deg"), [("M2", ()), ("M2", (0.0,)), ("M3", ()), ("M6", (0.0,))])
def test_parts_on_a_sensor_with_fewer_than_two_dowels_agree_with_their_closed_form(
    large: CadModel, azimuths_deg: tuple[float, ...], thread: str
) -> None:
    """No hole and no pin without a dowel; the adapter then turns in the play of its screws, M2 in 2.4 + 0.15 mm.

    Three M2, or another thread on the axis."""
    nano, geometry, screw = SENSORS["nano17"], large.geometry, SCREWS[thread]
    dowels, tool = replace(nano.interface.dowels, azimuths_deg=azimuths_deg), nano.interface.tool
    if thread != "M2":
        tool = ScrewPattern(20e-3, 0.0, (0.0,), screw, min_entry=4e-3, max_entry=6e-3)
        dowels = replace(dowels, circle_d=16e-3)
        geometry = replace(geometry, radius=geometry.radius / 2, flange=flange_for(6e-3, 20e-3))
    interface = replace(nano.interface, body_d=22e-3 if thread != "M2" else 17e-3, tool=tool, dowels=dowels)
    sensor = replace(nano, interface=interface)
    a, plate = sensor_adapter_for(geometry, sensor), flange_adapter_for(sensor, large.plate.robot)
    parts = build_parts(geometry, 1010.0, interface, a, plate, screw_groups(a, plate))
    assert ("dowel_pins" in parts) == bool(azimuths_deg) and max(overlaps(parts).values()) == 0.0
    bodies = mount_part_masses(geometry, a, 1010.0)
    fastened = combined(mass_properties(parts[name].placed, parts[name].density) for name in FASTENERS if name in parts)
    adapter = mass_properties(parts["sensor_adapter"].placed, parts["sensor_adapter"].density)
    for drawn, name in ((adapter, "sensor_adapter"), (fastened, "fasteners")):
        assert drawn.mass == pytest.approx(bodies[name].mass, rel=1e-9)
        assert drawn.p_com == pytest.approx(bodies[name].p_com, abs=1e-9)
    names = {stack.name for stack in tolerance_stacks(a, plate)}
    assert ("dowel_fit" in names) == bool(azimuths_deg) and "dowel_slot" not in names
    if thread == "M2":
        # The farthest screw is on the circle of 12.5 mm: half of it from its middle, all of it from a pin opposite.
        reach = 12.5e-3 if azimuths_deg else 6.25e-3
        assert a.tool_play_deg == pytest.approx(np.degrees(np.arctan(0.275e-3 / reach)))
        return
    # A screw on the axis is 8 mm from a pin; without a pin it holds no turn.
    play = screw.clearance_d + 0.15e-3 - screw.nominal_d
    assert a.tool_play_deg == (pytest.approx(np.degrees(np.arctan(play / 2 / 8e-3))) if azimuths_deg else 90.0)
    # Random points of the lip with resin in it, land below and ring above: M3's head lies within the ring's bore.
    rng, inner, outer = np.random.default_rng(1), a.ring_bore_d / 2, a.land_d / 2
    drawn = list(zip(rng.uniform(0.0, 360.0, 400), 1e3 * np.sqrt(rng.uniform(inner**2, outer**2, 400)), strict=True))
    base = 1e3 * a.T_sensor_base[2, 3]
    heights = {"sensor_adapter": 1e3 * a.floor - 0.05, "probe": base - 1.5, "clamp_ring": base + 0.05}
    pressed = [all(filled(parts[name].shape, at(*point, z), parts[name].T_sensor_part) for name, z in heights.items())
               for point in drawn]  # fmt: skip
    # three standard deviations of a share of 400 draws
    assert a.pressed_share == pytest.approx(np.mean(pressed), abs=3 * np.sqrt(0.25 / 400))
    head = max(screw.counterbore_d / 2, inner)
    assert a.pressed_share < (outer**2 - head**2) / (outer**2 - inner**2) + 0.01
    model = replace(large, geometry=geometry, adapter=a, plate=plate, screws=screw_groups(a, plate), parts=parts)
    steps = " ".join(step.text for step in assembly_steps(model))
    assert ("over the dowels onto" in steps and "dowels, 1 × 2 mm, into" in steps) == bool(azimuths_deg)
    assert ("holds no turn" in steps) == (not azimuths_deg) and f"1 {thread}x" in steps


def test_dowel_holes_are_blind_and_the_second_is_a_slot_towards_the_first(large: CadModel) -> None:
    adapter = large.parts["sensor_adapter"].shape
    for azimuth in (0, 120):
        # 3 mm of a 6 ± 0.25 mm pin protrude from the sensor: the hole takes the tolerances and what the foot loses.
        assert not filled(adapter, at(azimuth, 6.25, 3.6))
        assert filled(adapter, at(azimuth, 6.25, 3.75))
    assert filled(adapter, at(240, 6.25, 1.0))
    first, second = (at(azimuth, 6.25, 1.0) for azimuth in (0, 120))
    along = (first - second) / np.linalg.norm(first - second)
    across = np.array([-along[1], along[0], 0.0])
    assert not filled(adapter, second + 1.2 * along) and not filled(adapter, second - 1.2 * along)
    assert filled(adapter, second + 1.1 * across)
    assert filled(adapter, first + 1.1 * along) and filled(adapter, first - 1.1 * along)


def test_clocking_is_at_plus_x_only(large: CadModel) -> None:
    probe, adapter = large.parts["probe"], large.parts["sensor_adapter"]
    r = 1e3 * large.adapter.peg_x
    assert 6.0 < r < 9.5  # on the lip
    mid_flange = 1e3 * large.adapter.floor + 1.5
    assert filled(adapter.shape, at(0, r, mid_flange))
    assert not filled(probe.shape, at(0, r, mid_flange), probe.T_sensor_part)
    for azimuth in (90, 180, 270):
        assert not filled(adapter.shape, at(azimuth, r, mid_flange))
        assert filled(probe.shape, at(azimuth, r, mid_flange), probe.T_sensor_part)


@pytest.mark.parametrize("turn_deg", [120.0, 240.0])
def test_dowels_fix_the_turn_of_the_adapter(large: CadModel, turn_deg: float) -> None:
    """The tool side's screws repeat every 120°; turned so, a pin would press on the sensor's face."""
    turn = pose(rotation_z(np.radians(turn_deg)))
    pins, sensor = large.parts["dowel_pins"], large.parts["sensor"]
    turned = replace(pins, T_sensor_part=turn @ pins.T_sensor_part)
    assert overlaps({"sensor": sensor, "dowel_pins": pins}) == {"sensor & dowel_pins": 0.0}
    assert overlaps({"sensor": sensor, "dowel_pins": turned})["sensor & dowel_pins"] > 1e-9


def test_x_of_the_base_is_x_of_the_sensor_through_the_dowel(large: CadModel) -> None:
    """From the sensor's dowel hole at 0° by the pin and the peg to the hole in the flange, all at +X of the sensor."""
    T = large.adapter.T_sensor_base
    assert T[:3, 0] == pytest.approx([1.0, 0.0, 0.0], abs=1e-15)
    sensor, pins, adapter = (large.parts[n].placed for n in ("sensor", "dowel_pins", "sensor_adapter"))
    pin_at_x = next(pin for pin in pins.Solids() if filled(pin, at(0, 6.25, 1.0)))
    assert filled(pin_at_x, at(0, 6.25, -2.9)) and not filled(sensor, at(0, 6.25, -2.9))  # in the sensor's hole
    assert not filled(adapter, at(0, 6.25, 2.9))  # and in the adapter's
    r = 1e3 * large.adapter.peg_x
    mark = np.linalg.solve(T, np.append(1e-3 * at(0, r, 6.7), 1.0))[:3]
    assert mark[:2] == pytest.approx([large.adapter.peg_x, 0.0], abs=1e-15)  # +x of the base
    assert not filled(large.parts["probe"].shape, 1e3 * mark, pose())


@pytest.mark.parametrize("turn_deg", [1.5, 90.0, 180.0, 270.0])
def test_the_peg_fixes_the_turn_of_the_probe(large: CadModel, turn_deg: float) -> None:
    """By its clearance of 0.05 mm at 7.75 mm it may turn by 0.4°, no more."""
    probe, adapter = large.parts["probe"], large.parts["sensor_adapter"]
    for degrees, free in ((0.3, True), (turn_deg, False)):
        turned = replace(probe, T_sensor_part=probe.T_sensor_part @ pose(rotation_z(np.radians(degrees))))
        (shared,) = overlaps({"probe": turned, "sensor_adapter": adapter}).values()
        assert (shared == 0.0) == free


def test_nuts_slide_in_from_the_side_and_lie_on_the_floor_of_their_slots(large: CadModel) -> None:
    adapter, a = large.parts["sensor_adapter"].shape, large.adapter
    middle, r = 500.0 * sum(a.nut_slot_z), 500.0 * a.ring_circle_d
    for azimuth in (45, 135, 225, 315):
        assert not any(filled(adapter, at(azimuth, r + out, middle)) for out in (0.0, 1.5, 2.6))
        assert filled(adapter, at(azimuth, r + 1.5, 1e3 * a.nut_slot_z[0] - 0.1))  # gravity keeps them
        assert filled(adapter, at(azimuth, r - 3.0, middle))


def test_pins_centre_the_sensor_on_the_plate_and_a_tie_takes_the_cable(large: CadModel) -> None:
    pins = large.parts["centring_pins"].placed.Solids()
    azimuths = sorted(np.degrees(np.arctan2(p.Center().y, p.Center().x)) % 360.0 for p in pins)
    assert np.diff([*azimuths, azimuths[0] + 360.0]).max() < 180.0  # on all sides of the body
    for pin in pins:
        play = np.hypot(pin.Center().x, pin.Center().y) - 1.0 - 8.5
        assert play == pytest.approx(0.15, abs=1e-6)  # 0 at the worst corner of the tolerances; kernel: 1e-7 mm
    assert large.shared_volumes["flange_adapter & centring_pins"] == 0.0
    plate = large.parts["flange_adapter"]
    x, y = (1e3 * v for v in large.plate.p_tie_slots[0])
    assert not any(plate.shape.isInside(cq.Vector(x, y, z)) for z in (0.1, 3.0, 6.4))


# ---- flange adapter


def test_mounting_triad_is_turned_from_the_tool_triad(large: CadModel) -> None:
    plate = large.parts["flange_adapter"]
    just_below_the_sensor = -14.5 - 1.0
    for azimuth in (95, 215, 335):
        assert not filled(plate.shape, at(azimuth, 6.25, just_below_the_sensor), plate.T_sensor_part)
        # The heads rest 3.1 mm below the mounting face.
        assert filled(plate.shape, at(azimuth, 6.25 + 1.8, -14.5 - 3.0), plate.T_sensor_part)
        assert not filled(plate.shape, at(azimuth, 6.25 + 1.8, -14.5 - 3.2), plate.T_sensor_part)
    for azimuth in (60, 180, 300):
        assert filled(plate.shape, at(azimuth, 6.25, just_below_the_sensor), plate.T_sensor_part)


@pytest.mark.parametrize(
    ("flange", "reach", "spigot_r"), [("iso-9409-1-50-4-m6", 25.0, 15.65), ("iso-9409-1-31.5-4-m5", 15.75, 9.9)]
)
def test_robot_side(flange: str, reach: float, spigot_r: float) -> None:
    plate = flange_adapter_solid(Mount.of(design_of(robot_flange=flange)).flange_adapter)
    for azimuth in (45, 135, 225, 315):  # from the dowel, through and through
        assert not any(filled(plate, at(azimuth, reach, z)) for z in (0.1, 3.0, 6.4))
    assert not filled(plate, at(0, reach, 0.1))  # the pin's slot
    assert filled(plate, at(180, reach, 0.1))  # and only one of them
    assert filled(plate, at(20, spigot_r - 0.1, -3.9)) and not filled(plate, at(20, spigot_r + 0.1, -0.1))


OWN_FLANGE = """robot_flange = "own"
[mount.flange]
bolt = "M4"
bolt_circle_d_mm = 36.0
bolt_azimuths_deg = [60.0, 180.0, 300.0]
max_bolt_entry_mm = 6.0
bolt_length_mm = 12.0
face_d_mm = 45.0
spigot_mm = [20.0, 2.0]
pin_slot_mm = [4.2, 7.0]
"""


def with_flange(text: str) -> Design:
    probe = "length_mm = 30.0\nbase_d_mm = 6.0\ntip_d_mm = 2.0"
    return parse_design(f'schema = 1\nname = "g"\n[probe]\n{probe}\n[mount]\n{text}')


def test_a_flange_of_the_users_own() -> None:
    design = with_flange(OWN_FLANGE)
    assert parse_design(render_design(design)) == design
    model = build_cad(design)
    plate = model.parts["flange_adapter"].shape
    for azimuth in (60, 180, 300):
        assert not any(filled(plate, at(azimuth, 18.0, z)) for z in (0.1, 3.0, 6.4))
    assert not filled(plate, at(0, 18.0, 0.1)) and filled(plate, at(30, 18.0, 0.1))
    assert filled(plate, at(20, 9.8, -1.9)) and not filled(plate, at(20, 10.2, -0.1))
    assert max(model.shared_volumes.values()) == 0.0
    assert set(ways(model).values()) == {0.0}


@pytest.mark.parametrize(
    ("given", "wrong", "text"),
    [
        ("36.0", "20.0", r"bolt_circle_d_mm = 20 .* at least 25 mm"),
        ("entry_mm = 6.0", "entry_mm = 3.0", r"max_bolt_entry_mm = 3 .* at least 3\.9 mm"),
        ("length_mm = 12.0", "length_mm = 11.0", r"bolt_length_mm = 11 .* M4 these will do: 10, 12"),
        ("[60.0, 180.0", "[60.0, 120.0", r"bolt_azimuths_deg .* at least 73° apart"),
        ("180.0, 300.0]", "180.0, 300.0, 305.0]", r"bolt_azimuths_deg = .*300, 305 .* heads 1\.57 mm .* at least 7 mm"),
        ("[60.0, 180.0, 300.0]", "[10.0, 180.0]", r"bolt_azimuths_deg .* mm from the pin's slot, at least 5\.35 mm"),
        ("face_d_mm = 45.0", "face_d_mm = 35.0", r"face_d_mm = 35 .* at least 40 mm"),
        ("[20.0, 2.0]", "[12.0, 2.0]", r"spigot_mm = 12 .* at least 17\.7 mm, or none"),
    ],
)
def test_a_flange_without_room_is_one_line(given: str, wrong: str, text: str) -> None:
    with pytest.raises(InputError, match=r"^mount\.flange\." + text) as error:
        _ = Mount.of(with_flange(OWN_FLANGE.replace(given, wrong, 1))).flange_adapter
    assert "\n" not in str(error.value)


def test_cable_leaves_midway_between_two_bolts(large: CadModel) -> None:
    plate = large.parts["flange_adapter"]
    for azimuth in (150 - 45, 150 + 45):
        assert not filled(plate.shape, at(azimuth, 25.0, -21.0 + 0.1), plate.T_sensor_part)
    everything = [part for part in large.parts.values() if part.name != "sensor"]
    for azimuth in np.linspace(125, 175, 11):
        for r in (8.6, 12.0, 20.0, 30.0):
            p = at(azimuth, r, -14.5 + 4.0)
            assert not any(filled(s, p) for part in everything for s in part.placed.Solids())


# ---- screws


def test_every_screw_enters_within_its_limits_and_a_longer_one_is_refused(large: CadModel) -> None:
    entries = {use.name: use.entry for use in large.screws}
    assert entries["sensor_adapter_screws"] == pytest.approx(2.9e-3)
    assert entries["mounting_screws"] == pytest.approx(2.9e-3)
    assert entries["robot_bolts"] <= 6e-3
    # Measured on the solids too: no point of a screw lies deeper in the sensor than 3.5 mm.
    tool = large.parts["sensor_adapter_screws"].placed.BoundingBox()
    mounting = large.parts["mounting_screws"].placed.BoundingBox()
    assert -3.5 < tool.zmin < -2.5
    assert 2.5 < mounting.zmax + 14.5 < 3.5
    use = next(u for u in large.screws if u.name == "sensor_adapter_screws")
    with pytest.raises(CheckFailedError, match=r"M2×8 would enter .* 4\.90 mm; allowed 2\.5 to 3\.5 mm"):
        replace(use, length=8e-3).check()
    with pytest.raises(CheckFailedError, match="not a stock length"):
        replace(use, length=6.3e-3).check()


# ---- the way in


def ways(model: CadModel, **moved: CadPart) -> dict[str, float]:
    return blocked_tools(replace(model, parts={**model.parts, **moved}))


def test_all_assembly_corridors_are_free_and_a_covered_screw_is_detected(large: CadModel) -> None:
    free = ways(large)
    assert set(free) == {use.name for use in large.screws} | {"ring_nuts", "dowel_pins", "clamp_ring"}
    assert set(free.values()) == {0.0}
    # The ring a screw's width aside; a plate above everything.
    ring, plate = large.parts["clamp_ring"], large.parts["flange_adapter"]
    aside = replace(ring, T_sensor_part=pose(p=[2e-3, 0.0, 0.0]) @ ring.T_sensor_part)
    assert ways(large, clamp_ring=aside)["ring_screws"] > 0.0
    over = replace(plate, T_sensor_part=pose(p=[0.0, 0.0, 50e-3]) @ plate.T_sensor_part)
    assert ways(large, flange_adapter=over)["sensor_adapter_screws"] > 0.0


# ---- the whole


@pytest.mark.parametrize(("base_d", "tip"), [(3.0, "rounded"), (25.0, "blunt")])
def test_parts_of_narrow_and_wide_probes_agree_with_the_formulae_and_go_together(base_d: float, tip: str) -> None:
    model = build_cad(design_of(f'length_mm = 60.0\nbase_d_mm = {base_d}\ntip_d_mm = 2.0\ntip = "{tip}"'))
    assert_verified(model)
    # The limit is 1e-9; the kernel is far better, so growth of these numbers indicates a change. It integrates along
    # the hyperbolas of the ring's notch in its conical bore, and so the ring and the sum of all parts, to 4e-11 only;
    # the closed form is converged there to 1e-15 (32 to 200 Gauss points).
    for name, finding in solid_findings(model).items():
        assert finding["measured"] < (1e-10 if name.startswith(("clamp_ring", "hanging")) else 1e-12), name


@pytest.mark.parametrize(
    "probe", [PROFILE, HOLLOW + PROFILE, HOLLOW + NEARLY_A_CYLINDER, ROUNDED + ELLIPTIC + PROFILE],
    ids=["profile", "hollow profile", "hollow, nearly a cylinder", "elliptic profile, rounded"],
)  # fmt: skip
def test_every_section_has_the_mass_of_the_formulae_as_a_whole_and_in_slabs(probe: str) -> None:
    """To the kernel, "nearly a cylinder" is neither cone nor cylinder."""
    mount = Mount.of(design_of(probe))
    g, a = mount.geometry, mount.sensor_adapter
    solid = probe_solid(g, a)
    flange = mount_part_masses(g, a, 1010.0)["flange"].moved(np.linalg.inv(a.T_sensor_base))
    wanted, body = combined([flexible_part(g, 1010.0), flange]), mass_properties(solid, 1010.0)
    # The limit of an export is 1e-9; the kernel is far better, so growth of these numbers indicates a change.
    assert body.volume == pytest.approx(wanted.volume, rel=1e-12)
    assert body.p_com == pytest.approx(wanted.p_com, abs=1e-12 * g.length)
    assert body.inertia == pytest.approx(wanted.inertia, abs=1e-12 * wanted.inertia.max())
    mesh = tessellate(solid)
    assert mesh.is_volume and volume_omitted(mesh, body.volume) <= MESH_LIMIT
    for s in (0.123, 0.456, 0.789):
        ends = np.array([s, s + 0.0025, s + 0.005]) * g.length
        height = ends[2] - ends[0]
        slab = cq.Solid.makeBox(60.0, 60.0, 1e3 * height, cq.Vector(-30.0, -30.0, 1e3 * ends[0]))
        drawn = mass_properties(solid.intersect(slab), 1.0).volume
        # Simpson's rule is exact for areas that grow with the square; the kernel fits a curve to cuts of some faces.
        assert drawn == pytest.approx(height * g.area_at(ends) @ [1, 4, 1] / 6.0, rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("flange", ["iso-9409-1-50-4-m6", "iso-9409-1-31.5-4-m5"])
@pytest.mark.parametrize("base_d", [0.5, 3, 6, 9, 12, 18, 25, 40, 60])
@pytest.mark.parametrize("length", [5.0, 400.0])
def test_wider_grid(base_d: float, length: float, flange: str) -> None:
    probe = f"length_mm = {length}\nbase_d_mm = {float(base_d)}\ntip_d_mm = 0.3"
    model = build_cad(design_of(probe, flange))
    assert_verified(model)


def random_design(seed: int) -> str:
    """A design file with every choice of probe, sensor and mount drawn at random, within what soft resin can print."""
    rng = np.random.default_rng(seed)
    section = rng.choice(["round", "hollow", "elliptic"])
    length = round(float(rng.uniform(30.0, 165.0)), 1)  # what a Form 3 holds
    tip_d = round(float(rng.uniform(2.0, 6.0)) + (3.0 if section == "hollow" else 0.0), 1)
    base_d = round(max(tip_d, 0.06 * length) + float(rng.uniform(0.0, 10.0)), 1)
    probe = [f"length_mm = {length}", f"base_d_mm = {base_d}", f"tip_d_mm = {tip_d}", f'section = "{section}"']
    if section == "hollow":
        probe.append(f"bore_ratio = {rng.uniform(0.2, 0.5):.2f}")
    else:
        probe.append(f'tip = "{rng.choice(["blunt", "rounded"])}"')
    if section == "elliptic":
        probe.append(f"flatness = {rng.uniform(0.8, 1.0):.2f}")
    elif rng.random() < 0.5:
        probe.append(f"base_fillet_mm = {rng.uniform(0.3, 1.5):.1f}")
    if rng.random() < 0.3:
        middle = round((base_d + tip_d) / 2 + float(rng.uniform(-0.5, 0.5)), 1)
        profile = f"[[0.0, {base_d}], [{length / 2:.1f}, {middle}], [{length}, {tip_d}]]"
        probe += ['shape = "profile"', f"profile_mm = {profile}"]
    mount = [
        f'robot_flange = "{rng.choice(["iso-9409-1-50-4-m6", "iso-9409-1-31.5-4-m5"])}"',
        f'ring_screw = "{rng.choice(["M2", "M3"])}"',
        f'hold = "{rng.choice(["clamped", "glued"])}"',
        f"flange_thickness_mm = {rng.uniform(3.0, 5.0):.1f}",
        f"flange_lip_mm = {rng.uniform(3.5, 5.0):.1f}",
    ]
    sensor = rng.choice(["nano17", "nano17-e"])
    return "\n".join(
        [f'schema = 1\nname = "random-{seed}"\n[probe]', *probe, f'[sensor]\nmodel = "{sensor}"\n[mount]', *mount]
    )


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(24))
def test_random_designs(seed: int) -> None:
    """Closed, exact, free of interference, printable, and clamping at every corner of the tolerance stacks."""
    check_all(parse_design(random_design(seed)))


FIXED = {
    "large": LARGE,
    "medium": "length_mm = 100.0\nbase_d_mm = 8.0\ntip_d_mm = 2.0",
    "small": "length_mm = 50.0\nbase_d_mm = 5.0\ntip_d_mm = 1.5",
    "cylinder": "length_mm = 80.0\nbase_d_mm = 6.0\ntip_d_mm = 6.0",
    "profile": PROFILE,
    "hollow": HOLLOW + "length_mm = 150.0\nbase_d_mm = 12.0\ntip_d_mm = 6.0",
    "elliptic": ELLIPTIC + "length_mm = 150.0\nbase_d_mm = 12.0\ntip_d_mm = 4.0",
    "rounded": ROUNDED + "base_fillet_mm = 1.0\n" + LARGE,
}


@pytest.mark.slow
@pytest.mark.parametrize("probe", FIXED.values(), ids=FIXED)
def test_fixed_designs(probe: str) -> None:
    check_all(design_of(probe))


def check_all(design: Design) -> None:
    model = build_cad(design)
    assert_verified(model)
    for stack in tolerance_stacks(model.adapter, model.plate):
        assert stack.ok, stack.name
    # Errors include supports on a face with a dimension.
    assert [f.message for f in check_print(design).findings if f.severity == "error"] == []


def drawn_probe(probe: str) -> Any:
    mount = Mount.of(design_of(probe))
    return probe_solid(mount.geometry, mount.sensor_adapter)


def test_a_bore_is_open_from_tip_to_underside() -> None:
    probe = drawn_probe(HOLLOW + "length_mm = 150.0\nbase_d_mm = 12.0\ntip_d_mm = 2.0")
    for z in (-2.99, -0.1, 0.1, 75.0, 149.99):
        outer = 6.0 if z < 0.0 else 6.0 - z / 30.0  # below s = 0 the bore keeps its width
        for azimuth in (20.0, 110.0, 200.0, 290.0):
            assert not filled(probe, at(azimuth, 0.49 * outer, z))
            assert filled(probe, at(azimuth, 0.51 * outer, z))


def test_a_flattened_probe_is_wide_along_the_clocking_mark_and_a_turned_one_is_detected(large: CadModel) -> None:
    mount = Mount.of(design_of(ELLIPTIC + LARGE))
    probe = probe_solid(mount.geometry, mount.sensor_adapter)
    for z in (0.1, 75.0, 149.9):
        a = 6.0 - z / 30.0
        for azimuth, half in ((0.0, a), (90.0, 0.6 * a), (180.0, a), (270.0, 0.6 * a)):
            assert filled(probe, at(azimuth, 0.99 * half, z))
            assert not filled(probe, at(azimuth, 1.01 * half, z))
    assert all(filled(probe, at(azimuth, 9.4, -1.5)) for azimuth in (0.0, 45.0, 90.0))  # a round flange
    for degrees, wrong in ((0.0, []), (90.0, ["flexible_inertia"])):
        part = replace(large.parts["probe"], shape=probe.rotate((0, 0, 0), (0, 0, 1), degrees))
        model = replace(
            large, geometry=mount.geometry, adapter=mount.sensor_adapter, parts={**large.parts, "probe": part}
        )
        found = [name for name, f in solid_findings(model).items() if not f["ok"]]
        assert [name for name in found if name.startswith("flexible")] == wrong


def test_verify_detects_an_error_of_a_micrometre_and_an_open_mesh(large: CadModel) -> None:
    other = replace(large.geometry, radius=large.geometry.radius + 1e-6)
    with pytest.raises(CheckFailedError, match="flexible_volume") as error:
        checked("large", solid_findings(replace(large, geometry=other)))
    assert "clamp_ring" not in str(error.value)
    ring = tessellate(large.parts["clamp_ring"].shape)
    assert all(finding["ok"] for finding in mesh_findings(large, {"clamp_ring": ring}).values())
    with pytest.raises(CheckFailedError, match="clamp_ring_mesh_closed"):
        checked("large", mesh_findings(large, {"clamp_ring": trimesh.Trimesh(ring.vertices, ring.faces[1:])}))


def test_overlap_is_detected(large: CadModel) -> None:
    """The ring pressed 0.2 mm into the lip shares with it an annulus of that height."""
    ring, plain = large.parts["clamp_ring"], replace(large.adapter, on_flange=NOTHING_CUT)
    probe = replace(large.parts["probe"], shape=probe_solid(large.geometry, plain))
    pressed = replace(ring, T_sensor_part=ring.T_sensor_part @ pose(p=[0.0, 0.0, -0.2e-3]))
    (shared,) = overlaps({"probe": probe, "clamp_ring": pressed}).values()
    a = large.adapter
    inner = np.pi / 3 * 0.2e-3 * sum(x * y for x, y in [(6.5e-3, 6.5e-3), (6.5e-3, 6.7e-3), (6.7e-3, 6.7e-3)])
    # The notch below the ring takes what lies at +x, the hole of the peg in the lip included.
    half, outer = a.ring_vent_width / 2, a.flange.diameter / 2
    assert a.peg_hole_d / 2 <= half and a.peg_x + a.peg_hole_d / 2 < outer
    notch, _ = dblquad(lambda z, y: np.sqrt(outer**2 - y * y) - np.sqrt((6.5e-3 + z) ** 2 - y * y), -half, half,
                       0.0, 0.2e-3, epsabs=1e-22, epsrel=1e-12)  # fmt: skip
    expected = np.pi / 4 * a.flange.diameter**2 * 0.2e-3 - inner - notch
    assert shared == pytest.approx(expected, rel=1e-9)  # exact surfaces
