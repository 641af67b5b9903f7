"""The rigid parts between the sensor's tool face and the probe: adapter and clamp ring."""

import cadquery as cq

from probedesign.cad.kernel import block, cylinder, engraved, hexagon, revolved, single
from probedesign.mount import SensorAdapter
from probedesign.mount.fasteners import M2_CLEARANCE_D, M2_COUNTERBORE_D, M2_GRIP
from probedesign.mount.sensor_adapter import PEG_D


def sensor_adapter_solid(a: SensorAdapter) -> cq.Solid:
    """The adapter, in millimetres in the sensor frame: its foot rests on the tool face, z = 0."""
    foot, rim, recess = a.foot_d / 2, a.body_d / 2, a.recess_d / 2
    outline = [
        (0.0, 0.0), (foot, 0.0), (foot, a.foot_height), (rim, a.foot_height),
        (rim, a.body_top), (recess, a.body_top), (recess, a.floor), (0.0, a.floor),
    ]  # fmt: skip
    holes = [
        block((a.mark_x, rim), (-rim, rim), (0.0, a.body_top)),
        *(cylinder(M2_CLEARANCE_D, 0.0, M2_GRIP, p) for p in a.p_tool_screws),
        *(cylinder(M2_COUNTERBORE_D, M2_GRIP, a.floor, p) for p in a.p_tool_screws),
        *(cylinder(a.dowel_d, 0.0, a.dowel_depth, p) for p in a.p_dowels),
        *(cylinder(M2_CLEARANCE_D, a.nut_pocket_top, a.body_top, p) for p in a.p_ring_screws),
        *(hexagon(a.nut_pocket_af, a.foot_height, a.nut_pocket_top, p) for p in a.p_ring_screws),
        *engraved(a.on_wall),
    ]
    peg = cylinder(PEG_D, a.floor, a.peg_top, (a.peg_x, 0.0))
    return single(revolved(outline).cut(*holes).fuse(peg))


def clamp_ring_solid(a: SensorAdapter) -> cq.Solid:
    """The ring, in millimetres in its own frame: underside at z = 0, which lies on the base plane."""
    bore, top = a.ring_bore_d / 2, a.ring_bore_top_d / 2
    height = a.ring_thickness
    body = cylinder(a.body_d, 0.0, height).cut(
        revolved([(0.0, 0.0), (bore, 0.0), (top, height), (0.0, height)]),
        *(cylinder(M2_CLEARANCE_D, 0.0, height, p) for p in a.p_ring_screws),
        *engraved(a.on_ring),
    )
    return single(body)
