"""Test closed forms and screws of the mount."""

import numpy as np
import pytest

from probedesign.core.errors import InputError
from probedesign.core.frames import is_pose, rotation_z
from probedesign.design import Design
from probedesign.design.sensor_catalog import SENSORS
from probedesign.mount import Mount, SensorAdapter, build_geometry, exported_root_radii, sensor_adapter_for
from probedesign.probe import build_probe
from tests.cad.conftest import design_of as make_design


def adapter_of(design: Design) -> SensorAdapter:
    return sensor_adapter_for(build_geometry(design), design.sensor_model)


def test_base_sits_straight_above_the_tool_face_and_screws_into_the_sensor_keep_its_limits() -> None:
    T = adapter_of(make_design()).T_sensor_base
    assert is_pose(T) and np.array_equal(T[:3, :3], np.eye(3))
    # 3.1 mm of grip, a 2.0 mm head sunk by 0.2 mm, a 3.0 mm flange; sums of decimals, hence a picometre.
    assert T[:3, 3] == pytest.approx([0.0, 0.0, 8.3e-3], abs=1e-12)
    for holes in (SENSORS["nano17"].interface.tool, SENSORS["nano17"].interface.mounting):
        assert holes.min_entry < holes.length - holes.grip < holes.max_entry
        # 6.0 - 2.5 - 0.24 (screw) - 0.15 (print) = 3.11 mm, to 0.1 mm; sums of decimals, hence a picometre.
        assert (holes.length, holes.grip) == (6e-3, pytest.approx(3.1e-3, abs=1e-12))


def test_the_base_on_the_robot_is_the_sum_of_plate_sensor_and_adapter_turned_by_the_cable() -> None:
    design = make_design()
    T, mount = build_probe(design).model.T_robotflange_base, Mount.of(design)
    assert T is not None and is_pose(T)
    height = design.sensor_model.interface.height
    assert T[2, 3] == pytest.approx(mount.flange_adapter.plate_top + height + mount.sensor_adapter.T_sensor_base[2, 3])
    assert T[:2, 3] == pytest.approx([0.0, 0.0], abs=1e-15)
    x = T[:3, 0]  # the clocking mark, in the robot flange's axes
    assert np.degrees(np.arctan2(x[1], x[0])) == pytest.approx(-60.0)
    # The cable leaves midway between the first two bolts,.
    cable = T[:3, :3] @ rotation_z(np.radians(design.sensor_model.interface.cable.azimuth_deg))[:, 0]
    first, second = design.robot_flange.bolt_azimuths_deg[:2]
    assert np.degrees(np.arctan2(cable[1], cable[0])) % 360.0 == pytest.approx((first + second) / 2.0)


@pytest.mark.parametrize("base_d", [0.5, 3.0, 12.0, 25.0, 60.0])
def test_adapter_fits_together(base_d: float) -> None:
    a = adapter_of(make_design(f"length_mm = 150.0\nbase_d_mm = {base_d}\ntip_d_mm = 0.4"))
    assert a.foot_height < a.cone_top < a.nut_slot_z[0] < a.nut_slot_z[1] < a.body_top < a.ring_top
    assert a.cone_top < a.floor < a.peg_top < a.body_top
    assert a.flange.diameter < a.recess_d < a.body_d
    assert base_d * 1e-3 < a.ring_bore_d < a.ring_bore_top_d < a.flange.diameter
    inner_end = np.hypot(*a.p_ring_screws[0]) - a.nut_slot_reach - a.nut_slot_width / 2
    assert inner_end > a.recess_d / 2 > a.foot_d / 2  # nuts lie beside recess and sensor


@pytest.mark.parametrize(("base_d", "computed"), [(4.0, -0.319), (8.0, -0.239), (12.0, -0.177), (20.0, -0.099)])
def test_the_exported_flange_yields_as_computed(base_d: float, computed: float) -> None:
    """Finite elements of docs/decisions/0006: lip bonded, plate without friction under the middle."""
    geometry = build_geometry(make_design(f"length_mm = 150.0\nbase_d_mm = {base_d}\ntip_d_mm = 2.0"))
    assert exported_root_radii(geometry) == pytest.approx(computed, abs=3e-3)  # what the fit leaves


@pytest.mark.parametrize("base_d", [12.0, 18.5, 25.0])
def test_the_widest_probe_that_the_message_allows_is_clamped_and_a_wider_one_is_refused(base_d: float) -> None:
    """Between its ring and the land 1.5 mm of the lip remain."""
    bulge = f"[[0.0, {base_d}], [75.0, {base_d + 2.0}], [150.0, 2.0]]"
    a = adapter_of(make_design(f'shape = "profile"\nlength_mm = 150.0\nbase_d_mm = {base_d}\nprofile_mm = {bulge}'))
    assert (a.land_d - a.ring_bore_d) / 2 == pytest.approx(1.5e-3)
    assert a.land_d <= a.flange.diameter - 1e-3 + 1e-9
    bulge = 'shape = "profile"\nlength_mm = 150.0\nbase_d_mm = 12.0\nprofile_mm = [[0, 12], [75, 16], [150, 2]]'
    with pytest.raises(InputError, match=r"profile_mm: 16 mm .* at most 14\.2 mm") as error:
        adapter_of(make_design(bulge))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("base_d", np.arange(3.0, 25.01, 0.5))
def test_the_ring_presses_the_lip_all_around_and_clears_the_probe(base_d: float) -> None:
    a = adapter_of(make_design(f"length_mm = 150.0\nbase_d_mm = {base_d}\ntip_d_mm = 1.2"))
    assert a.ring_bore_d / 2 - base_d / 2 * 1e-3 == pytest.approx(0.5e-3)
    # The clamped width is 2 mm, but where the heads of the sensor's screws move the land's edge.
    assert 1.5e-3 - 1e-9 <= (a.land_d - a.ring_bore_d) / 2 <= 2.5e-3
    assert a.land_d <= a.flange.diameter - 2 * 0.4e-3  # the resin that it displaces has room
    assert a.peg_x - a.peg_hole_d / 2 > base_d / 2 * 1e-3 + 0.6e-3  # the mark keeps off the flexible part
