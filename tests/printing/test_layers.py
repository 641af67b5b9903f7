"""Layers of bodies whose overhangs, bridges, cups and enclosed volumes are known, and of the exported rigid parts."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from probedesign.core.errors import CheckFailedError
from probedesign.design import parse_design
from probedesign.design.catalog import ROBOT_FLANGES, PrintLimits
from probedesign.design.sensor_catalog import SENSORS
from probedesign.design.sensors import DowelPattern
from probedesign.mount import FlangeAdapter, Mount, SensorAdapter, flange_adapter_for, sensor_adapter_for
from probedesign.mount.flange_adapter import fitting_flanges
from probedesign.mount.sensor_adapter import MAX_OVERHANG
from probedesign.printing.check import MAX_BRIDGE, MAX_CUP_D, ORIENTATIONS, check_print, mount_findings
from tests.printing.raster import LayerReport, examine_layers, grid_of, layers_of_mesh

PIXEL, LAYER = 0.25, 0.1


def examined(interior, height: float = 6.0) -> LayerReport:
    x, y = grid_of(11.0, PIXEL)
    layers = np.stack([interior(x, y, float(z)) for z in np.arange(LAYER / 2, height, LAYER)])
    return examine_layers(layers, 1.0, MAX_BRIDGE, PIXEL, LAYER)


def cone(angle_deg: float):
    """A post of radius 2, above z = 1 a cone that widens at an angle to the horizontal."""
    return lambda x, y, z: np.hypot(x, y) < 2.0 + max(z - 1.0, 0.0) / np.tan(np.radians(angle_deg)) * (z < 2.5)


def test_a_cone_prints_above_19_degrees_and_hangs_below() -> None:
    assert examined(cone(25.0), 2.5).overhang == 0.0
    assert examined(cone(8.0), 1.8).hanging_area > 0.0


@pytest.mark.parametrize("ledge", [0.5, 0.9, 1.5, 3.0])
def test_a_ledge_overhangs_by_its_width(ledge: float) -> None:
    report = examined(lambda x, y, z: np.hypot(x, y) < (2.0 if z < 3.0 else 2.0 + ledge))
    # To a pixel, and what one layer may reach.
    if report.overhang:
        assert report.overhang == pytest.approx(ledge, abs=2 * PIXEL)
        assert report.overhang_z == pytest.approx(3.0, abs=LAYER)
    assert (report.hanging_area > 0.0) == (ledge > 1.0)
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


def test_islands_cups_and_enclosed_volumes_are_measured() -> None:
    """What begins in mid-air is an island; a cup is as wide as its bore until it is vented below."""
    report = examined(lambda x, y, z: (np.hypot(x - 4, y) < 2.0) | ((np.hypot(x + 4, y) < 2.0) & (z > 2.0)))
    assert report.islands == 1

    def cup(vented: bool):
        def inside(x, y, z):
            wall = (np.hypot(x, y) < 7.0) & ((np.hypot(x, y) >= 6.0) | (z < 1.0))
            return wall & ~((abs(y) < 1.0) & (x > 0.0) & (z >= 1.0)) if vented else wall

        return inside

    assert examined(cup(False)).cup_d == pytest.approx(12.0, abs=2 * PIXEL)
    assert examined(cup(True)).cup_d == 0.0
    report = examined(lambda x, y, z: (np.hypot(x, y) < 7.0) & ~((np.hypot(x, y) < 3.0) & (z > 2.0) & (z < 4.0)))
    assert report.trapped == pytest.approx(np.pi * 9.0 * 2.0, rel=0.03)  # pixels of a circle of 24 of them
    assert examined(lambda x, y, z: np.hypot(x, y) < 7.0).trapped == 0.0


def mounts() -> list[Any]:
    """Every known sensor on every flange that leaves it room, and narrow and wide probes with a thick flange.

    Each sensor on its first flange stands for the others, among which are all flanges but the smallest.
    """
    cases: list[Any] = [
        pytest.param(sensor, flange, 12.0, f'ring_screw = "{("M2", "M3")[i % 2]}"',
                     marks=[pytest.mark.slow] if i or sensor == "nano17-e" else [])
        for sensor, model in SENSORS.items() for i, flange in enumerate(fitting_flanges(model))
    ]  # fmt: skip
    small = ("nano17", "iso-9409-1-31.5-4-m5")
    cases += [
        (*small, base, mount)
        for base, mount in ((3.0, "flange_thickness_mm = 5.0"), (25.0, "flange_thickness_mm = 4.0"))
    ]
    return [*cases, (*small, 12.0, 'ring_screw = "M3"\nflange_thickness_mm = 5.0')]


def sliced(name: str, solid: Any) -> tuple[LayerReport, float]:
    """What the layers of a part show as it stands on the platform, and the width of a pixel."""
    from probedesign.cad.mesh import tessellate

    mesh = tessellate(solid, 0.05, 0.3)
    if not ORIENTATIONS[name].upright:
        mesh.apply_transform(np.diag([1.0, -1.0, -1.0, 1.0]))
    mesh.apply_translation([0.0, 0.0, -mesh.bounds[0, 2]])
    pixel = 0.2 * max(1.0, mesh.bounds[1, 0] / 32.0)
    layers = layers_of_mesh(mesh, pixel, LAYER)
    assert layers.sum() * pixel**2 * LAYER == pytest.approx(mesh.volume, rel=0.02)  # of the raster
    # The raster shows a length to half a pixel; the test of the roof above a nut has it exactly.
    return examine_layers(layers, 1e3 * MAX_OVERHANG + pixel / 2, MAX_BRIDGE, pixel, LAYER), pixel


@pytest.mark.parametrize(("sensor", "flange", "base", "mount"), mounts())
def test_rigid_parts_print_in_their_constant_orientation(sensor: str, flange: str, base: float, mount: str) -> None:
    """The exported solids, engraving included, need no supports and enclose no resin."""
    pytest.importorskip("cadquery", reason="the parts are drawn with CadQuery: pip install 'probedesign[cad]'")
    from probedesign.cad.solids import clamp_ring_solid, flange_adapter_solid, sensor_adapter_solid

    design = parse_design(
        f'schema = 1\nname = "x"\n[probe]\nlength_mm = 60.0\nbase_d_mm = {base}\ntip_d_mm = 2.0\n[sensor]\n'
        f'model = "{sensor}"\n[mount]\nrobot_flange = "{flange}"\n{mount}\n'
    )
    whole = Mount.of(design)
    a, plate = whole.sensor_adapter, whole.flange_adapter
    solids = {"flange_adapter": flange_adapter_solid(plate)}
    if (
        flange == fitting_flanges(design.sensor_model)[0] or base != 12.0 or "thick" in mount
    ):  # these do not depend on the flange
        solids |= {"sensor_adapter": sensor_adapter_solid(a), "clamp_ring": clamp_ring_solid(a)}
    for name, solid in solids.items():
        report, pixel = sliced(name, solid)
        assert report.hanging_area == 0.0 and report.islands == 0 and report.trapped == 0.0, (name, report)
        assert report.bridge <= MAX_BRIDGE and not ORIENTATIONS[name].supports
        rooms = {"sensor_adapter": a.tool, "flange_adapter": plate.mounting}
        room = 1e3 * rooms[name].screw.counterbore_d if name in rooms else 0.0  # what the check warns of
        assert report.cup_d <= max(MAX_CUP_D, room + 2 * pixel)
    assert [f.message for f in mount_findings(a, plate, PrintLimits()) if f.rule in ("bridge", "island")
            and f.severity != "ok"] == []  # fmt: skip


def test_the_check_finds_what_an_own_sensor_and_an_own_flange_make_unprintable() -> None:
    """A wide exit of the cable, thick dowel pins and a wide pin of the robot, as the layers of the solids show them."""
    pytest.importorskip("cadquery", reason="the parts are drawn with CadQuery: pip install 'probedesign[cad]'")
    from probedesign.cad.solids import flange_adapter_solid, sensor_adapter_solid

    design = parse_design(
        'schema = 1\nname = "x"\n[probe]\nlength_mm = 60.0\nbase_d_mm = 12.0\ntip_d_mm = 2.0\n'
        '[sensor]\nmodel = "mini40"'
    )
    known = SENSORS["mini40"]
    robot = replace(ROBOT_FLANGES["iso-9409-1-100-6-m8"], pin_slot=(14e-3, 16e-3))

    def adapters(**changed: Any) -> tuple[SensorAdapter, FlangeAdapter]:
        sensor = replace(known, interface=replace(known.interface, **changed))
        return sensor_adapter_for(Mount.of(design).geometry, sensor), flange_adapter_for(sensor, robot)

    def worst(rule: str, part: str) -> float:
        wrong = [
            f
            for f in mount_findings(a, plate, PrintLimits())
            if (f.rule, f.part) == (rule, part) and f.severity != "ok"
        ]
        return max(f.measured for f in wrong)

    dowels = DowelPattern(12e-3, 3e-3, 22e-3, (0.0, 180.0), 10e-3)
    a, plate = adapters(cable=replace(known.interface.cable, width=11e-3, reach=33e-3), dowels=dowels)
    report, pixel = sliced("flange_adapter", flange_adapter_solid(plate))
    assert worst("bridge", "flange_adapter") == pytest.approx(12.2) and report.hanging_area > 0.0  # 0.6 mm beside it
    assert worst("cup", "flange_adapter") == pytest.approx(14.0) == pytest.approx(report.cup_d, abs=2 * pixel)
    report, pixel = sliced("sensor_adapter", sensor_adapter_solid(a))
    assert worst("bridge", "sensor_adapter") == pytest.approx(12.1) and report.hanging_area > 0.0
    assert worst("cup", "sensor_adapter") == pytest.approx(12.1) == pytest.approx(report.cup_d, abs=2 * pixel)
    # A screw at 0° under the clocking peg: the kernel draws a peg without a foot.
    tool = replace(known.interface.tool, bolt_circle_d=36e-3, azimuths_deg=(0.0, 120.0, 240.0))
    a, plate = adapters(tool=tool)
    (peg,) = [f for f in mount_findings(a, plate, PrintLimits()) if f.rule == "island"]
    assert peg.severity == "error" and peg.measured == pytest.approx(0.2 - 1.9 / 2 - 5.9 / 2)
    with pytest.raises(CheckFailedError):
        sensor_adapter_solid(a)


@pytest.mark.parametrize("screw", ["M2", "M3"])
def test_the_roof_above_a_nut_prints_without_supports(screw: str) -> None:
    """By brute force: farthest point of the roof from the slot's sides and from the bridges beside the hole."""
    design = parse_design(
        'schema = 1\nname = "x"\n[probe]\nlength_mm = 60.0\nbase_d_mm = 25.0\ntip_d_mm = 2.0\n'
        f'[mount]\nring_screw = "{screw}"\n'
    )
    a = Mount.of(design).sensor_adapter
    half, h = 1e3 * a.nut_slot_width / 2, 1e3 * a.roof_hole_d / 2
    u, v = np.meshgrid(np.linspace(0.0, h, 400), np.linspace(0.0, half, 400))  # along and across the slot
    roof = np.hypot(u, v) >= h
    farthest = np.minimum(half - v, h - u)[roof].max()
    assert 1e3 * a.roof_overhang == pytest.approx(farthest, abs=0.01)  # the grid's step
    assert farthest <= 1.0
    assert [f for f in check_print(design).findings if f.severity != "ok" and f.part != "probe"] == []
