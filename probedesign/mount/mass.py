"""Closed-form mass properties of everything rigid between the sensor's tool face and s = 0.

The frozen probe takes them from here, so it needs no CAD; `cad/verify` proves that the solids agree. All parts are sums
and differences of upright prisms and frusta.
"""

import math
from collections.abc import Iterable
from functools import lru_cache

import numpy as np

from probedesign.core.frames import Array, pose, rotation_z
from probedesign.design.catalog import RIGID_DENSITY, STEEL_DENSITY, SocketScrew
from probedesign.geometry import ProbeGeometry
from probedesign.geometry.mass import NOTHING, MassProperties, combined, flange_part, frustum
from probedesign.mount.engraving import CELL, DEPTH, ROWS, XY, Engraving, cut_runs, glyph_width
from probedesign.mount.sensor_adapter import PEG_D, RING_VENT_HEIGHT, VENT_WIDTH, SensorAdapter

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(48)


def mount_mass_properties(geometry: ProbeGeometry, adapter: SensorAdapter, probe_density: float) -> MassProperties:
    """Return the mass properties of all rigid parts between the tool face and s = 0, in the sensor frame.

    Flange, adapter, clamp ring, screws, nuts and dowel pins; not the flexible part.

    Args:
        geometry: of the probe.
        adapter: that clamps it.
        probe_density: of the flange's resin [kg/m³].
    """
    return combined(mount_part_masses(geometry, adapter, probe_density).values())


def mount_part_masses(
    geometry: ProbeGeometry, adapter: SensorAdapter, probe_density: float
) -> dict[str, MassProperties]:
    """Return the mass properties of each rigid part in the sensor frame; arguments as `mount_mass_properties`."""
    T = adapter.T_sensor_base
    flange = flange_part(geometry, probe_density).moved(T)
    peg_hole = cylinder(adapter.peg_hole_d, adapter.floor, T[2, 3], probe_density, (adapter.peg_x, 0.0))
    return {
        "flange": subtract(flange, [peg_hole, engraving_mass(adapter.on_flange, probe_density).moved(T)]),
        "sensor_adapter": _adapter_body(adapter, RIGID_DENSITY),
        "clamp_ring": _clamp_ring(adapter, RIGID_DENSITY).moved(T),
        "fasteners": combined(_fasteners(adapter, STEEL_DENSITY)),
    }


def _adapter_body(a: SensorAdapter, density: float) -> MassProperties:
    foot = cylinder(a.foot_d, 0.0, a.foot_height, density)
    cone = frustum(a.cone_d / 2, a.body_d / 2, a.cone_top - a.foot_height, a.foot_height, density)
    plate = cylinder(a.body_d, a.cone_top, a.body_top, density)
    p_peg, land_z = (a.peg_x, 0.0), (a.groove_floor, a.floor)
    peg = subtract(
        cylinder(PEG_D, a.groove_floor, a.peg_top, density, p_peg),
        [common_part(a.land_d, PEG_D, p_peg, land_z, density)],
    )
    screw, (slot_z0, slot_z1) = a.ring_screw, a.nut_slot_z
    half, room_d = VENT_WIDTH / 2, a.tool.screw.counterbore_d
    voids = [
        cylinder(a.recess_d, a.floor, a.body_top, density),
        subtract(cylinder(a.recess_d, *land_z, density), [cylinder(a.land_d, *land_z, density)]),
        segment(a.body_d / 2, a.mark_x, a.cone_top, a.body_top, density),
        subtract(  # the vent: from the recess's wall to the flat
            prism_of_box((0.0, a.mark_x), (-half, half), (a.groove_floor, a.body_top), density),
            [strip(a.recess_d / 2, 0.0, half, a.groove_floor, a.body_top, density)],
        ),
        subtract(  # the window: from the recess's wall to the rim, at -x
            strip(a.body_d / 2, 0.0, a.window_half, a.groove_floor, a.body_top, density),
            [strip(a.recess_d / 2, 0.0, a.window_half, a.groove_floor, a.body_top, density)],
        ).moved(pose(rotation_z(np.pi))),
        *(cylinder(a.tool.screw.clearance_d, 0.0, a.tool.grip, density, p) for p in a.p_tool_screws),
        *(cylinder(room_d, a.tool.grip, a.groove_floor, density, p) for p in a.p_tool_screws),
        *(common_part(a.land_d, room_d, p, land_z, density) for p in a.p_tool_screws),
        *(_dowel_hole(a, number, density) for number in range(len(a.p_dowels))),
        *(cylinder(a.roof_hole_d, slot_z1, a.body_top, density, p) for p in a.p_ring_screws),
        *(cylinder(screw.clearance_d, a.ring_hole_bottom, slot_z0, density, p) for p in a.p_ring_screws),
        *(_nut_slot(a, density, p) for p in a.p_ring_screws),
        engraving_mass(a.on_wall, density),
    ]
    return combined([subtract(combined([foot, cone, plate]), voids), peg])


def common_part(d: float, hole_d: float, p: XY, z: XY, density: float) -> MassProperties:
    """Return what an upright cylinder of diameter `hole_d` about p shares with one of diameter d about the axis.

    Where the circles cross, the chord divides the shared area into one segment of each.
    """
    R, r, apart = d / 2, hole_d / 2, float(np.hypot(*p))
    if apart <= R - r:
        return cylinder(hole_d, *z, density, p)
    if apart >= R + r:
        return NOTHING
    chord = (apart * apart + R * R - r * r) / (2 * apart)
    inner = segment(r, apart - chord, *z, density).moved(pose(rotation_z(np.pi), [apart, 0.0, 0.0]))
    both = combined([segment(R, chord, *z, density), inner])
    return both.moved(pose(rotation_z(np.arctan2(p[1], p[0]))))


def _nut_slot(a: SensorAdapter, density: float, p: XY) -> MassProperties:
    half, inner = a.nut_slot_width / 2, float(np.hypot(*p)) - a.nut_slot_reach
    end = segment(half, 0.0, *a.nut_slot_z, density).moved(pose(rotation_z(np.pi), [inner, 0.0, 0.0]))
    straight = strip(a.body_d / 2, inner, half, *a.nut_slot_z, density)
    return combined([end, straight]).moved(pose(rotation_z(np.arctan2(p[1], p[0]))))


def _dowel_hole(a: SensorAdapter, number: int, density: float) -> MassProperties:
    slot_deg, (x, y) = a.dowel_slot_deg(number), a.p_dowels[number]
    if slot_deg is None:
        return cylinder(a.dowel_d, 0.0, a.dowel_depth, density, (x, y))
    r, half = a.dowel_d / 2, a.dowel_slot / 2
    ends = [
        segment(r, 0.0, 0.0, a.dowel_depth, density).moved(pose(rotation_z(turn), [side, 0.0, 0.0]))
        for turn, side in ((0.0, half), (np.pi, -half))
    ]
    middle = prism_of_box((-half, half), (-r, r), (0.0, a.dowel_depth), density)
    return combined([*ends, middle]).moved(pose(rotation_z(np.radians(slot_deg)), [x, y, 0.0]))


def _clamp_ring(a: SensorAdapter, density: float) -> MassProperties:
    bore = frustum(a.ring_bore_d / 2, a.ring_bore_top_d / 2, a.ring_thickness, 0.0, density)
    holes = [cylinder(a.ring_screw.clearance_d, 0.0, a.ring_thickness, density, p) for p in a.p_ring_screws]
    disc = cylinder(a.body_d, 0.0, a.ring_thickness, density)
    return subtract(disc, [bore, _ring_vent(a, density), *holes, engraving_mass(a.on_ring, density)])


def _ring_vent(a: SensorAdapter, density: float) -> MassProperties:
    """Return the notch across the ring's underside at +x, from the conical bore to the rim.

    Its moments are integrals over y and z of polynomials of smooth limits in x, which Gauss points give to round-off.
    """
    half, height = a.ring_vent_width / 2, RING_VENT_HEIGHT
    y, z = np.meshgrid(half * _NODES, height / 2 * (1.0 + _NODES), indexing="ij")
    w = density * half * height / 2 * np.outer(_WEIGHTS, _WEIGHTS)
    bore = (a.ring_bore_d + (a.ring_bore_top_d - a.ring_bore_d) * z / a.ring_thickness) / 2
    x0, x1 = np.sqrt(bore**2 - y * y), np.sqrt(a.body_d**2 / 4 - y * y)
    length, first, second = ((x1**n - x0**n) / n for n in (1, 2, 3))
    mass = float((w * length).sum())
    p = np.array([(w * first).sum(), 0.0, (w * z * length).sum()]) / mass
    second_moments = np.diag([(w * second).sum(), (w * y * y * length).sum(), (w * z * z * length).sum()])
    second_moments[0, 2] = second_moments[2, 0] = (w * z * first).sum()
    return _of_moments(mass, p, second_moments, density)


def _of_moments(mass: float, p_com: Array, second: Array, density: float) -> MassProperties:
    """Return a body of which ∫ r rᵀ dm is known about the origin, (3, 3) [kg·m²]."""
    central = second - mass * np.outer(p_com, p_com)
    return MassProperties(mass / density, mass, p_com, np.trace(central) * np.eye(3) - central)


def _fasteners(a: SensorAdapter, density: float) -> list[MassProperties]:
    sensor_screws = [_screw(a.tool.screw, a.tool.grip, a.tool.length, density, p) for p in a.p_tool_screws]
    ring_screws = [_screw(a.ring_screw, a.ring_top, a.ring_screw_length, density, p) for p in a.p_ring_screws]
    nut, top = a.options.nut, a.nut_slot_z[1]
    bottom = top - nut.height
    nuts = [
        subtract(hexagon(nut.af, bottom, top, density, p), [cylinder(a.ring_screw.pitch_d, bottom, top, density, p)])
        for p in a.p_ring_screws
    ]
    pin_top = a.dowels.pin_length - a.dowels.depth
    pins = [cylinder(a.dowels.diameter, -a.dowels.depth, pin_top, density, p) for p in a.p_dowels]
    return [*sensor_screws, *ring_screws, *nuts, *pins]


def _screw(screw: SocketScrew, seat: float, length: float, density: float, p: XY) -> MassProperties:
    """Return the mass properties of a screw, head above `seat` [m], point down."""
    top = seat + screw.head_height
    head = cylinder(screw.head_d, seat, top, density, p)
    socket = hexagon(screw.socket_af, top - screw.socket_depth, top, density, p)
    return combined([subtract(head, [socket]), cylinder(screw.pitch_d, seat - length, seat, density, p)])


def engraving_mass(engraving: Engraving, density: float) -> MassProperties:
    """Return the mass properties of the material that an engraving removes; density [kg/m³]."""
    radius = engraving.radius if engraving.on_side else math.inf
    return combined(_glyph_mass(character, density, radius).moved(T) for character, T in engraving.placed())


@lru_cache(maxsize=256)
def _glyph_mass(character: str, density: float, radius: float) -> MassProperties:
    """Return the mass properties of what one character removes, in its own frame, from a face that is curved about y
    with that radius [m]."""
    bars, width = [], glyph_width(character)
    for start, end, row in cut_runs(character):
        a, b = (end - start) * CELL, CELL
        p = ((start + end - width) / 2 * CELL, (row + 0.5 - ROWS / 2) * CELL)
        if math.isinf(radius):
            bars.append(prism(a * b, a * b**3 / 12, a**3 * b / 12, (-DEPTH, 0.0), density, p))
        else:
            bars.append(_curved_bar(p, (a, b), radius, density))
    return combined(bars)


def _curved_bar(p: XY, size: XY, radius: float, density: float) -> MassProperties:
    """Return a bar about (x, y) from z = -DEPTH up to a cylinder about y whose side is at z = 0 in the middle x = 0.

    Its moments are integrals over x of polynomials of √(r² - x²), which Gauss points give to round-off.
    """
    x, w, (_, y), b = p[0] + size[0] / 2 * _NODES, density * size[0] / 2 * size[1] * _WEIGHTS, p, size[1]
    top = np.sqrt(radius**2 - x * x) - radius
    height, first, second = ((top**n - (-DEPTH) ** n) / n for n in (1, 2, 3))
    mass, x_first, z_first = float(w @ height), float(w @ (x * height)), float(w @ first)
    xx, yy, zz, xz = w @ (x * x * height), mass * (y * y + b * b / 12.0), w @ second, w @ (x * first)
    second_moments = np.array([[xx, y * x_first, xz], [y * x_first, yy, y * z_first], [xz, y * z_first, zz]])
    return _of_moments(mass, np.array([x_first / mass, y, z_first / mass]), second_moments, density)


def subtract(body: MassProperties, voids: Iterable[MassProperties]) -> MassProperties:
    """Return a body less its voids, which lie wholly inside and do not overlap."""
    hole = combined(voids)
    mass = body.mass - hole.mass
    p_com = (body.mass * body.p_com - hole.mass * hole.p_com) / mass
    inertia = body.inertia_about(p_com) - hole.inertia_about(p_com)
    return MassProperties(body.volume - hole.volume, mass, p_com, inertia)


def prism(area: float, Ix: float, Iy: float, z: tuple[float, float], density: float, p: XY) -> MassProperties:
    """Return an upright prism between z[0] and z[1]: area [m²], ∫y² and ∫x² [m⁴] about its centroid p."""
    h = z[1] - z[0]
    mass = density * area * h
    slab = mass * h * h / 12.0
    inertia = np.diag([density * h * Ix + slab, density * h * Iy + slab, density * h * (Ix + Iy)])
    return MassProperties(area * h, mass, np.array([*p, (z[0] + z[1]) / 2]), inertia)


def prism_of_box(x: XY, y: XY, z: XY, density: float) -> MassProperties:
    """Return a box between the two values of x, of y and of z [m]."""
    a, b = x[1] - x[0], y[1] - y[0]
    return prism(a * b, a * b**3 / 12, a**3 * b / 12, z, density, ((x[0] + x[1]) / 2, (y[0] + y[1]) / 2))


def strip(r: float, x0: float, half: float, z0: float, z1: float, density: float) -> MassProperties:
    """Return the prism between the plane x = x0 and a cylinder of radius r about z, for |y| <= half < r.

    Its moments are integrals over y of polynomials of √(r² - y²), which Gauss points give to round-off.
    """
    y, w = half * _NODES, half * _WEIGHTS
    x1 = np.sqrt(r * r - y * y)
    area = float(w @ (x1 - x0))
    x = float(w @ (x1**2 - x0**2)) / 2 / area
    Iy = float(w @ (x1**3 - x0**3)) / 3 - area * x * x
    return prism(area, float(w @ (y * y * (x1 - x0))), Iy, (z0, z1), density, (x, 0.0))


def cylinder(d: float, z0: float, z1: float, density: float, p: XY = (0.0, 0.0)) -> MassProperties:
    """Return an upright cylinder of diameter d about p."""
    second = np.pi * d**4 / 64.0
    return prism(np.pi * d * d / 4.0, second, second, (z0, z1), density, p)


def hexagon(af: float, z0: float, z1: float, density: float, p: XY) -> MassProperties:
    """Return an upright hexagonal prism across flats `af`: A = √3/2 af², I = 5√3/144 af⁴ about any diameter."""
    second = 5.0 * np.sqrt(3.0) / 144.0 * af**4
    return prism(np.sqrt(3.0) / 2.0 * af * af, second, second, (z0, z1), density, p)


def segment(r: float, x: float, z0: float, z1: float, density: float) -> MassProperties:
    """Return what a plane at distance x cuts off a cylinder of radius r, on the +x side.

    With cos φ = x/r: A = r²(φ − sin φ cos φ), x̄ A = 2/3 r³ sin³ φ,
    ∫x² = r⁴/4 (φ − sin φ cos φ + 2 sin³ φ cos φ), ∫y² = r⁴/12 (3φ − 3 sin φ cos φ − 2 sin³ φ cos φ).

    Source: any table of plane areas (circular segment).
    """
    phi = float(np.arccos(x / r))
    s, c = np.sin(phi), np.cos(phi)
    area = r * r * (phi - s * c)
    x_mean = 2.0 / 3.0 * r**3 * s**3 / area
    Iy = r**4 / 4.0 * (phi - s * c + 2 * s**3 * c) - area * x_mean**2
    Ix = r**4 / 12.0 * (3 * phi - 3 * s * c - 2 * s**3 * c)
    return prism(area, Ix, Iy, (z0, z1), density, (x_mean, 0.0))
