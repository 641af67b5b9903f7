"""Layers of bodies whose overhangs, bridges, cups and enclosed volumes are known, and of the exported rigid parts."""

import numpy as np
import pytest

from probedesign.design import parse_design
from probedesign.geometry import build_geometry
from probedesign.mount import mount_options, sensor_adapter_for
from probedesign.printing.check import check_print
from probedesign.printing.layers import LayerReport, examine_layers

PIXEL, LAYER = 0.25, 0.1


def examined(interior, height: float = 6.0, datums: tuple[float, ...] = ()) -> LayerReport:
    return examine_layers(interior, (11.0, height), datums, 1.0, 10.0, PIXEL, LAYER)


def cone(angle_deg: float):
    """A post of radius 2, above z = 1 a cone that widens at an angle to the horizontal."""
    return lambda x, y, z: np.hypot(x, y) < 2.0 + max(z - 1.0, 0.0) / np.tan(np.radians(angle_deg)) * (z < 2.5)


def test_a_cone_prints_above_19_degrees_and_hangs_below() -> None:
    assert examined(cone(25.0), 2.5).overhang == 0.0
    assert examined(cone(8.0), 1.8).hanging_area > 0.0


@pytest.mark.parametrize("ledge", [0.5, 0.9, 1.5, 3.0])
def test_a_ledge_overhangs_by_its_width(ledge: float) -> None:
    report = examined(lambda x, y, z: np.hypot(x, y) < (2.0 if z < 3.0 else 2.0 + ledge), datums=(3.0,))
    # To a pixel, and what one layer may reach.
    if report.overhang:
        assert report.overhang == pytest.approx(ledge, abs=2 * PIXEL)
        assert report.overhang_z == pytest.approx(3.0, abs=LAYER)
    assert (report.hanging_area > 0.0) == (ledge > 1.0) == (report.datum_area > 0.0)
    assert report.islands == 0


@pytest.mark.parametrize("width", [2.0, 4.0, 8.0])
def test_a_roof_between_two_walls_is_a_bridge_in_any_direction(width: float) -> None:
    for turn in (0.0, 45.0):
        c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))

        def tunnel(x, y, z, c=c, s=s):
            return (
                (abs(c * x + s * y) < 7.0)
                & (abs(c * y - s * x) < 7.0)
                & ~((abs(c * x + s * y) < width / 2) & (z < 3.0))
            )

        report = examined(tunnel)
        assert report.overhang <= 1.0 and report.islands == 0
        # The part that the walls' own layers carry does not count, 0.54 mm on both sides; a diagonal pixel is 1.4.
        assert width - 1.8 <= report.bridge <= width


def test_a_place_that_begins_in_mid_air_is_an_island() -> None:
    report = examined(lambda x, y, z: (np.hypot(x - 4, y) < 2.0) | ((np.hypot(x + 4, y) < 2.0) & (z > 2.0)))
    assert report.islands == 1


def test_a_cup_is_as_wide_as_its_bore_until_it_is_vented_below() -> None:
    def cup(vented: bool):
        def inside(x, y, z):
            wall = (np.hypot(x, y) < 7.0) & ((np.hypot(x, y) >= 6.0) | (z < 1.0))
            return wall & ~((abs(y) < 1.0) & (x > 0.0) & (z >= 1.0)) if vented else wall

        return inside

    assert examined(cup(False)).cup_d == pytest.approx(12.0, abs=2 * PIXEL)
    assert examined(cup(True)).cup_d == 0.0


def test_an_enclosed_volume_is_measured() -> None:
    report = examined(lambda x, y, z: (np.hypot(x, y) < 7.0) & ~((np.hypot(x, y) < 3.0) & (z > 2.0) & (z < 4.0)))
    assert report.trapped == pytest.approx(np.pi * 9.0 * 2.0, rel=0.03)  # pixels of a circle of 24 of them
    assert examined(lambda x, y, z: np.hypot(x, y) < 7.0).trapped == 0.0


@pytest.mark.parametrize("base", [3.0, 12.0, 25.0])
@pytest.mark.parametrize("mount", ["", 'robot_flange = "iso-9409-1-31.5-4-m5"\nflange_thickness_mm = 5.0'])
def test_rigid_parts_stand_on_the_platform_without_supports_on_their_datums(base: float, mount: str) -> None:
    design = parse_design(
        f'schema = 1\nname = "x"\n[probe]\nlength_mm = 60.0\nbase_d_mm = {base}\ntip_d_mm = 2.0\n[mount]\n{mount}\n'
    )
    check = check_print(design)
    found = [f for f in check.findings if f.rule in ("overhang", "bridge", "datum", "island", "cup", "enclosed_volume")]
    rigid = [f for f in found if f.part != "probe"]
    assert len(rigid) == 3 * 6 + 1 and {f.severity for f in rigid} == {"ok"}
    sides = {part.name: part.side for part in check.oriented}
    assert sides == {"sensor_adapter": "upright", "clamp_ring": "upright", "flange_adapter": "upside down"}
    assert not any(part.needs_supports for part in check.oriented)


@pytest.mark.parametrize("screw", ["M2", "M3"])
def test_the_roof_above_a_nut_prints_without_supports(screw: str) -> None:
    """By brute force: farthest point of the roof from the slot's sides and from the bridges beside the hole."""
    design = parse_design(
        'schema = 1\nname = "x"\n[probe]\nlength_mm = 60.0\nbase_d_mm = 25.0\ntip_d_mm = 2.0\n'
        f'[mount]\nring_screw = "{screw}"\n'
    )
    a = sensor_adapter_for(build_geometry(design), design.sensor_model, options=mount_options(design))
    half, h = 1e3 * a.nut_slot_width / 2, 1e3 * a.roof_hole_d / 2
    u, v = np.meshgrid(np.linspace(0.0, h, 400), np.linspace(0.0, half, 400))  # along and across the slot
    roof = np.hypot(u, v) >= h
    farthest = np.minimum(half - v, h - u)[roof].max()
    assert 1e3 * a.roof_overhang == pytest.approx(farthest, abs=0.01)  # the grid's step
    assert farthest <= 1.0
    check = check_print(design)
    assert [f for f in check.findings if f.severity != "ok" and f.part != "probe"] == []
    assert not any(part.needs_supports for part in check.oriented)
