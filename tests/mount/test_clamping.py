"""Test the force that compresses the flange's lip, and that the ring's screws can give it."""

import math

import numpy as np
import pytest

from probedesign.design import Design, parse_design
from probedesign.design.sensor_catalog import SENSORS
from probedesign.mount import Mount, mount_options
from probedesign.mount.flange_adapter import fitting_flanges
from probedesign.mount.lip import MAX_BENDING_SHARE, MIN_LIP, MIN_RELIEF, pad_force, plate_bending
from probedesign.mount.sensor_adapter import WALL
from probedesign.mount.tolerance_stack import MODEL_RANGE, NUT_FACTOR, ClampForce, clamp_force, hand_torque
from probedesign.printing.check import check_print

E = 2.32e6


def design_of(sensor: str = "nano17", base_d: float = 12.0, mount: str = "", resin: str = "") -> Design:
    model = SENSORS[sensor]
    return parse_design(
        f'schema = 1\nname = "x"\n[probe]\nlength_mm = 100.0\nbase_d_mm = {base_d}\ntip_d_mm = 2.0\n{resin}\n[sensor]\n'
        f'model = "{sensor}"\ncalibration = "{model.calibrations[0].name}"\n[mount]\n'
        f'robot_flange = "{fitting_flanges(model)[0]}"\n{mount}\n'
    )


def clamp_of(design: Design) -> ClampForce:
    mount = Mount.of(design)
    a, plate = mount.sensor_adapter, mount.flange_adapter
    return clamp_force(a, plate, design.youngs_modulus.value)


def test_the_force_of_a_pad_is_that_of_gent_and_lindley() -> None:
    """Of a thin ring little is added beside it: the apparent modulus of a long strip of the same shape factor."""
    modulus, t, width = 1e6, 1e-3, 40e-3
    mean = 200e-3
    area = math.pi * mean * width
    force = pad_force(modulus, mean - width, mean + width, t, 1e-9)
    shape = width / (2 * t)
    # The half thickness beside each edge makes the pad wider by t/w = 2.5 %, its S² greater by 5 %.
    assert force / (area * 1e-6) == pytest.approx(modulus * (1 + 2 * shape**2), rel=0.06)
    # (1/λ² - λ)/3 exceeds the strain: by its second order, 1 + ε.
    assert pad_force(modulus, 0.1, 0.2, t, 0.1e-3) / pad_force(modulus, 0.1, 0.2, t, 1e-7) == pytest.approx(
        1000.0 * (1 / 0.81 - 0.9) / 0.3, rel=1e-3
    )
    assert pad_force(modulus, 0.1, 0.2, t, 0.0) == pad_force(modulus, 0.1, 0.2, t, -1e-4) == 0.0
    # Of one material: pressure depends on proportions only.
    assert pad_force(E, 0.026, 0.034, 6e-3, 0.8e-3) == pytest.approx(4 * pad_force(E, 0.013, 0.017, 3e-3, 0.4e-3))


@pytest.mark.parametrize(
    ("base_d", "slips", "sticks"),
    [(5.0, 29.0, 60.0), (8.0, 38.0, 84.0), (12.0, 51.0, 126.0), (25.0, 101.0, 203.0), (12.0, 58.0, 100.0)],
)  # the last one on a tool face of 40 mm, the others on a Nano17
def test_finite_elements_lie_within_the_stated_range_of_the_formula(base_d: float, slips: float, sticks: float) -> None:
    """`benchmarks/clamp.py` of commit 04ffc97: a lip of 3 mm compressed by 0.4 mm, small strain, E = 2.32 MPa."""
    bore_d, land_d = (base_d + 1.0) * 1e-3, (base_d + 5.0) * 1e-3
    linear = pad_force(E, bore_d, land_d, 3e-3, 1e-9) * 0.4e6
    low, high = MODEL_RANGE
    # The finite elements are rounded to 1 N of at least 29 N.
    assert low * linear * 0.98 <= slips < sticks <= high * linear * 1.02


@pytest.mark.parametrize("sensor", SENSORS)
def test_the_default_mount_of_every_sensor_closes(sensor: str) -> None:
    for base_d in (3.0, 5.0, 8.0, 12.0, 18.0, 25.0):
        clamp = clamp_of(design_of(sensor, base_d))
        assert 0.0 < clamp.range[0] < clamp.nominal < clamp.range[1] <= clamp.preload
        assert 0.0 < clamp.bending[0] < clamp.bending[1] < clamp.squeeze / 2
        assert clamp.bending_share <= MAX_BENDING_SHARE and clamp.as_record()["closes"]


@pytest.mark.parametrize("sensor", SENSORS)
def test_the_edge_of_the_land_leaves_no_blade_beside_the_heads(sensor: str) -> None:
    """Where the edge crosses the room of a head, the corner between both circles is blunt; otherwise a wall is left."""
    for base_d in np.arange(3.0, 26.0, 0.1):
        design = design_of(sensor, float(base_d))
        a = Mount.of(design).sensor_adapter
        R, r, apart = a.land_d / 2, a.tool.screw.counterbore_d / 2, a.tool.bolt_circle_d / 2
        assert (a.flange.diameter - a.land_d) / 2 >= MIN_RELIEF - 1e-9
        assert a.land_d - a.ring_bore_d >= 2 * MIN_LIP - 1e-9
        if apart + r <= R:
            assert R - apart - r >= WALL - 1e-9
        elif apart < R:
            assert math.degrees(math.acos((R * R + r * r - apart * apart) / (2 * R * r))) > 30.0


def test_the_bending_of_a_plate_is_that_of_textbooks() -> None:
    """A plate with a tiny hole and the load near its middle bends as a full plate under a point load: the hole leaves
    F a²/(16 π D) when clamped and (3 + ν)/(1 + ν) times as much when supported (Timoshenko, Theory of Plates and
    Shells, articles 16 and 19), but for moments at the hole's edge, which vanish with the load on a circle of 2 %."""
    E, t, a, force = 2.5e9, 2e-3, 0.05, 10.0
    D = E * t**3 / 12 / (1 - 0.35**2)
    point = force * a**2 / (16 * math.pi * D)
    clamped, supported = plate_bending(E, t, 1e-5 * a, 2 * a, 0.04 * a, force)
    assert clamped == pytest.approx(point, rel=0.02)
    assert supported == pytest.approx((3.35 / 1.35) * point, rel=0.02)
    twice = plate_bending(E, 2 * t, 0.4 * a, 2 * a, 0.5 * a, force)
    assert twice == pytest.approx([x / 8 for x in plate_bending(E, t, 0.4 * a, 2 * a, 0.5 * a, force)])


def test_a_ring_that_cannot_be_thick_enough_is_found_and_each_remedy_mends_it() -> None:
    def bends(mount: str = "", base_d: float = 12.0) -> str:
        stiff = design_of("gamma", base_d, mount, "[material]\nyoungs_modulus_mpa = 20.0")
        return next(f.severity for f in check_print(stiff).findings if f.rule == "ring_bending")

    assert bends() == "warning"
    assert bends('ring_screw = "M3"') == bends("flange_thickness_mm = 8.0") == bends(base_d=3.0) == "ok"


def test_the_preload_is_that_of_the_stated_torque() -> None:
    clamp = clamp_of(design_of())
    assert clamp.torque == hand_torque(mount_options(design_of()).ring_screw) == 0.05
    assert clamp.preload == pytest.approx(4 * 0.05 / (NUT_FACTOR * 2e-3))


def severity_of(design: Design) -> str:
    (finding,) = [f for f in check_print(design).findings if f.rule == "clamp_force"]
    return finding.severity


def test_a_lip_that_needs_more_than_the_screws_give_is_found_and_the_remedies_help() -> None:
    stiff = '[material]\nresin = "flexible-80a"'
    assert severity_of(design_of()) == "ok" and severity_of(design_of(resin=stiff)) == "warning"
    assert severity_of(design_of(mount="flange_thickness_mm = 5.0", resin=stiff)) == "ok"
    assert severity_of(design_of(base_d=30.0)) == "warning"
    assert severity_of(design_of(base_d=30.0, mount='ring_screw = "M3"')) == "ok"
    wide = design_of(mount="flange_lip_mm = 10.0")
    assert severity_of(wide) == "error" and clamp_of(wide).nominal > clamp_of(wide).preload
    assert severity_of(design_of(mount="flange_lip_mm = 4.0")) == "ok"
