"""Test closed forms and screws of the mount."""

from collections.abc import Callable

import numpy as np
import pytest

from probedesign.core.errors import InputError
from probedesign.core.frames import is_pose, rotation_z
from probedesign.design import Design
from probedesign.design.sensor_catalog import SENSORS
from probedesign.mount import (
    Mount,
    SensorAdapter,
    build_geometry,
    exported_root_radii,
    mount_mass_properties,
    mount_part_masses,
    sensor_adapter_for,
)
from probedesign.mount.mass import cylinder, hexagon, segment, strip, subtract
from probedesign.probe import build_probe
from tests.cad.conftest import design_of as make_design


def adapter_of(design: Design) -> SensorAdapter:
    return sensor_adapter_for(build_geometry(design), design.sensor_model)


def moments(width_at: Callable[[np.ndarray], np.ndarray], x0: float, x1: float) -> tuple[float, float, float, float]:
    """Integrate area, mean x, ∫x² about the mean and ∫y² of a shape with height `width_at(x)` by strips."""
    edges = np.linspace(x0, x1, 200_001)
    x, dx = (edges[1:] + edges[:-1]) / 2, edges[1] - edges[0]
    w = width_at(x)
    area = float(np.sum(w) * dx)
    mean = float(np.sum(w * x) * dx) / area
    return area, mean, float(np.sum(w * (x - mean) ** 2) * dx), float(np.sum(w**3) * dx) / 12.0


def test_segment_is_the_integral_over_its_strips() -> None:
    r, x, h = 15.0, 14.2, 2.0
    area, mean, Iy, Ix = moments(lambda x: 2 * np.sqrt(r * r - x * x), x, r)
    body = segment(r, x, 1.0, 1.0 + h, density=1.0)
    # 200 000 strips of a square-root edge: the midpoint rule is good to about 1e-8.
    assert body.volume == pytest.approx(area * h, rel=1e-7)
    assert body.p_com == pytest.approx([mean, 0.0, 2.0], rel=1e-7)
    slab = body.mass * h * h / 12
    assert np.diag(body.inertia) == pytest.approx([Ix * h + slab, Iy * h + slab, (Ix + Iy) * h], rel=1e-6)


def test_a_strip_to_the_rim_is_the_integral_over_its_strips() -> None:
    r, x0, half = 15.0, 12.0, 2.1
    area, _, Ix, _ = moments(lambda y: np.sqrt(r * r - y * y) - x0, -half, half)
    body = strip(r, x0, half, 0.0, 2.0, density=1.0)
    # The midpoint rule over 200 000 smooth strips is good to about 1e-11.
    assert body.volume == pytest.approx(2.0 * area, rel=1e-9)
    assert body.inertia[0, 0] == pytest.approx(2.0 * Ix + body.mass * 4.0 / 12.0, rel=1e-9)
    disc, rest = cylinder(2 * r, 0.0, 2.0, 1.0), strip(r, 0.0, r, 0.0, 2.0, 1.0)
    assert rest.volume == pytest.approx(disc.volume / 2, rel=1e-4)  # square-root ends: Gauss is good to 1e-5


def test_hexagon_is_the_integral_over_its_strips() -> None:
    af, h = 4.2, 3.5
    corner = af / np.sqrt(3.0)
    area, _, Iy, Ix = moments(lambda x: np.minimum(af, 2 * np.sqrt(3.0) * (corner - abs(x))), -corner, corner)
    body = hexagon(af, 0.0, h, 1.0, (3.0, -1.0))
    # Straight edges: the midpoint rule is good to the square of the strip's width, 1e-9.
    assert body.volume == pytest.approx(area * h, rel=1e-8)
    assert body.inertia[2, 2] == pytest.approx((Ix + Iy) * h, rel=1e-8)
    assert body.p_com == pytest.approx([3.0, -1.0, h / 2])


def test_a_tube_is_a_rod_without_its_bore() -> None:
    tube = subtract(cylinder(10.0, 0.0, 4.0, 2.0), [cylinder(6.0, 0.0, 4.0, 2.0)])
    m = 2.0 * np.pi / 4 * (100 - 36) * 4
    assert tube.mass == pytest.approx(m)  # sums of a few terms: pytest's 1e-6 is ample
    assert tube.inertia[2, 2] == pytest.approx(m * (5.0**2 + 3.0**2) / 2)
    assert tube.inertia[0, 0] == pytest.approx(m * (3 * (25 + 9) + 16) / 12)


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


def test_the_mount_mass_is_the_sum_of_its_parts() -> None:
    geometry = build_geometry(make_design())
    adapter = sensor_adapter_for(geometry, SENSORS["nano17"])
    whole = mount_mass_properties(geometry, adapter, 1010.0)
    parts = mount_part_masses(geometry, adapter, 1010.0)
    gravity = np.array([3.0, -5.0, 8.0])
    assert whole.wrench(gravity) == pytest.approx(sum(p.wrench(gravity) for p in parts.values()))
    assert 5e-3 < whole.mass < 15e-3  # ten grams, beside a sensor that weighs nine
    # Pins, peg and window are not symmetric; the window removes 0.2 g of 10 g at 12 mm from the axis.
    assert abs(whole.p_com[:2]).max() < 0.4e-3


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
