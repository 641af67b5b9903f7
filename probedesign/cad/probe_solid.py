"""The probe as a solid: the flexible part, exactly as the mechanics knows it, on its flange."""

import cadquery as cq

from probedesign.cad.kernel import cylinder, engraved, frusta, revolved, single
from probedesign.geometry import ProbeGeometry
from probedesign.mount import SensorAdapter
from probedesign.mount.engraving import XY


def probe_solid(geometry: ProbeGeometry, adapter: SensorAdapter) -> cq.Solid:
    """Flexible part and flange in one piece.

    Args:
        geometry: of the probe.
        adapter: whose peg passes through the flange: the hole at +x is the clocking mark; and which knows what is
            engraved on the lip.

    Returns:
        The solid in millimetres in the base frame: flexible part above z = 0, flange below.
    """
    mark = cylinder(adapter.peg_hole_d, -geometry.flange.thickness, 0.0, (adapter.peg_x, 0.0))
    body = _turned(geometry) if geometry.cross_section.full_round else _ruled(geometry)
    return single(body.cut(mark, *engraved(adapter.on_flange)))


def _turned(geometry: ProbeGeometry) -> cq.Shape:
    rim, underside = geometry.flange.diameter / 2, -geometry.flange.thickness
    taper = _taper(geometry)
    return revolved([(0.0, underside), (rim, underside), (rim, 0.0), *taper, (0.0, geometry.length)])


def _ruled(geometry: ProbeGeometry) -> cq.Shape:
    """Of any section. A hollow one is not turned: the kernel takes a cone for a cylinder the sooner the thinner
    it is, and meshes the cone of a thin bore with hundreds of thousands of triangles.
    """
    section, taper = geometry.cross_section, _taper(geometry)
    disc = cylinder(geometry.flange.diameter, -geometry.flange.thickness, 0.0)
    body = disc.fuse(frusta(taper, section.flatness))
    if not section.hollow:
        return body
    # Open from tip to underside: resin runs out of it at both ends.
    bore = [(section.bore_ratio * r, s) for r, s in taper]
    return body.cut(frusta([(geometry.bore_radius, -geometry.flange.thickness), *bore]))


def _taper(geometry: ProbeGeometry) -> list[XY]:
    """(radius, s) at the knots [m]."""
    return [(float(r), float(s)) for s, r in zip(geometry.s, geometry.radius, strict=True)]
