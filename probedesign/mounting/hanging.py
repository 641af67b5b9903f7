"""Closed-form mass of all that is rigid between the sensor's tool face and s = 0.

The frozen probe weighs these, so it needs no CAD; `cad/verify` proves that the solids agree.
"""

from probedesign.geometry import ProbeGeometry
from probedesign.mass import MassProperties, combined, flange_part, frustum
from probedesign.materials import RIGID_DENSITY
from probedesign.mounting.adapter import DOWEL_PIN_LENGTH, PEG_D, SensorAdapter
from probedesign.mounting.fasteners import (
    M2,
    M2_CLEARANCE_D,
    M2_COUNTERBORE_D,
    M2_GRIP,
    M2_LENGTH,
    M2_NUT_AF,
    M2_NUT_HEIGHT,
    STEEL_DENSITY,
)
from probedesign.mounting.prism import Point, cylinder, hexagon, segment, without
from probedesign.units import MM


def hanging_mass(geometry: ProbeGeometry, adapter: SensorAdapter, probe_density: float) -> MassProperties:
    """All that is rigid between the tool face and s = 0, as one body in the sensor frame.

    Flange, adapter, clamp ring, screws, nuts and dowel pins; not the flexible part.

    Args:
        geometry: of the probe.
        adapter: that holds it.
        probe_density: of the flange's resin [kg/m³].
    """
    return combined(hanging_parts(geometry, adapter, probe_density).values())


def hanging_parts(
    geometry: ProbeGeometry, adapter: SensorAdapter, probe_density: float
) -> dict[str, MassProperties]:
    """The same, part by part, each in the sensor frame."""
    T = adapter.T_sensor_base
    flange = flange_part(geometry, probe_density).moved(T)
    peg_hole = cylinder(adapter.peg_hole_d, adapter.floor, T[2, 3], probe_density, (adapter.peg_x, 0.0))
    return {
        "flange": without(flange, [peg_hole, adapter.on_flange.mass(probe_density).moved(T)]),
        "sensor_adapter": _adapter_body(adapter, RIGID_DENSITY),
        "clamp_ring": _clamp_ring(adapter, RIGID_DENSITY).moved(T),
        "fasteners": combined(_fasteners(adapter, STEEL_DENSITY)),
    }


def _adapter_body(a: SensorAdapter, density: float) -> MassProperties:
    foot = cylinder(a.foot_d, 0.0, a.foot_height, density)
    plate = cylinder(a.body_d, a.foot_height, a.body_top, density)
    peg = cylinder(PEG_D, a.floor, a.peg_top, density, (a.peg_x, 0.0))
    voids = [
        cylinder(a.recess_d, a.floor, a.body_top, density),
        segment(a.body_d / 2, a.mark_x, a.foot_height, a.body_top, density),
        *(cylinder(M2_CLEARANCE_D, 0.0, M2_GRIP, density, p) for p in a.p_tool_screws),
        *(cylinder(M2_COUNTERBORE_D, M2_GRIP, a.floor, density, p) for p in a.p_tool_screws),
        *(cylinder(a.dowel_d, 0.0, a.dowel_depth, density, p) for p in a.p_dowels),
        *(cylinder(M2_CLEARANCE_D, a.nut_pocket_top, a.body_top, density, p) for p in a.p_ring_screws),
        *(hexagon(a.nut_pocket_af, a.foot_height, a.nut_pocket_top, density, p) for p in a.p_ring_screws),
        a.on_wall.mass(density),
    ]
    return combined([without(combined([foot, plate]), voids), peg])


def _clamp_ring(a: SensorAdapter, density: float) -> MassProperties:
    """In its own frame, which lies on the base frame while the lip is unpressed."""
    bore = frustum(a.ring_bore_d / 2, a.ring_bore_top_d / 2, a.ring_thickness, 0.0, density)
    holes = [cylinder(M2_CLEARANCE_D, 0.0, a.ring_thickness, density, p) for p in a.p_ring_screws]
    return without(
        cylinder(a.body_d, 0.0, a.ring_thickness, density), [bore, *holes, a.on_ring.mass(density)]
    )


def _fasteners(a: SensorAdapter, density: float) -> list[MassProperties]:
    sensor_screws = [_m2(M2_GRIP, M2_LENGTH, density, p) for p in a.p_tool_screws]
    ring_screws = [_m2(a.ring_top, a.ring_screw_length, density, p) for p in a.p_ring_screws]
    nut_z = a.nut_pocket_top - M2_NUT_HEIGHT
    nuts = [
        without(
            hexagon(M2_NUT_AF, nut_z, a.nut_pocket_top, density, p),
            [cylinder(M2.pitch_d, nut_z, a.nut_pocket_top, density, p)],
        )
        for p in a.p_ring_screws
    ]
    pin_top = a.dowel_depth - 0.2 * MM
    pins = [cylinder(2.0 * MM, pin_top - DOWEL_PIN_LENGTH, pin_top, density, p) for p in a.p_dowels]
    return [*sensor_screws, *ring_screws, *nuts, *pins]


def _m2(seat: float, length: float, density: float, p: Point) -> MassProperties:
    """An M2 screw, head above `seat` [m], point down."""
    top = seat + M2.head_height
    head = cylinder(M2.head_d, seat, top, density, p)
    socket = hexagon(M2.socket_af, top - M2.socket_depth, top, density, p)
    return combined([without(head, [socket]), cylinder(M2.pitch_d, seat - length, seat, density, p)])
