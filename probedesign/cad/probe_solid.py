"""The probe as a solid: the flexible part, exactly as the mechanics knows it, on its flange."""

import cadquery as cq

from probedesign.cad.kernel import cylinder, revolved, single
from probedesign.geometry import ProbeGeometry
from probedesign.mounting import SensorAdapter


def probe_solid(geometry: ProbeGeometry, adapter: SensorAdapter) -> cq.Solid:
    """Flexible part and flange in one piece.

    Args:
        geometry: of the probe.
        adapter: whose peg passes through the flange: the hole at +x is the clocking mark.

    Returns:
        The solid in millimetres in the base frame: flexible part above z = 0, flange below.
    """
    rim, underside = geometry.flange.diameter / 2, -geometry.flange.thickness
    taper = [(float(r), float(s)) for s, r in zip(geometry.s, geometry.radius, strict=True)]
    outline = [(0.0, underside), (rim, underside), (rim, 0.0), *taper, (0.0, geometry.length)]
    mark = cylinder(adapter.peg_hole_d, underside, 0.0, (adapter.peg_x, 0.0))
    return single(revolved(outline).cut(mark))
