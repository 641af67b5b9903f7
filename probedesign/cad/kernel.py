"""Interface to the CAD kernel: arguments in metres, CadQuery shapes in millimetres, mass properties in SI."""

from collections.abc import Sequence
from itertools import pairwise

import cadquery as cq
import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepBuilderAPI import (
    BRepBuilderAPI_MakeEdge,
    BRepBuilderAPI_MakeFace,
    BRepBuilderAPI_MakeVertex,
    BRepBuilderAPI_Sewing,
)
from OCP.BRepGProp import BRepGProp
from OCP.BRepMesh import BRepMesh_IncrementalMesh
from OCP.BRepTools import BRepTools
from OCP.Geom import Geom_BezierCurve, Geom_BSplineSurface
from OCP.gp import gp_Pnt
from OCP.GProp import GProp_GProps
from OCP.IMeshTools import IMeshTools_MeshAlgoType, IMeshTools_Parameters
from OCP.TColgp import TColgp_Array1OfPnt, TColgp_Array2OfPnt
from OCP.TColStd import TColStd_Array1OfInteger, TColStd_Array1OfReal, TColStd_Array2OfReal

from probedesign.core.errors import CheckFailedError
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.geometry import ProbeGeometry
from probedesign.geometry.mass import MassProperties
from probedesign.mount.engraving import CELL, DEPTH, ROWS, XY, Engraving, cut_outlines, glyph_width

PRODUCT = "product"  #: Key in the metadata of an assembly's piece: the name of its product.
#: Arcs of an ellipse. The kernel's quadrature is accurate to 1e-14 over an eighth, over a quarter only to 1e-8.
ARCS = 8
_HALF = np.pi / ARCS
#: Ends and middles of the arcs of a unit circle, with exact zeros on the axes, and their weights as rational curves.
_RING = np.round([(np.cos(a), np.sin(a)) for a in _HALF * np.arange(2 * ARCS + 1)], 15) + 0.0
_WEIGHTS = np.where(np.arange(2 * ARCS + 1) % 2, float(np.cos(_HALF)), 1.0)
#: Turn of a curved axis in one cubic piece [rad]; a ring between its ends is then too small by x⁴/384 = 2e-8.
PIECE_RAD = 0.05
FACE_PIECES = 8  #: Most pieces of a face: the kernel's quadrature over 80 is accurate to 8e-5 only.
#: Largest distance of the chord between two rings from the surface [mm], and their largest turn [rad], where a curved
#: body is replaced by one with ruled faces for its facets.
CHORD_MM, CHORD_RAD = 0.005, 0.05
FLAT_MM = 1e-6  #: Largest distance of a face from its plane [mm], which covers round-off of the kernel.


def revolved(outline: Sequence[XY]) -> cq.Solid:
    """Revolve a closed polygon of (radius, z) [m], two of its corners on the axis, about z."""
    corners = [(r / MM, z / MM) for r, z in outline]
    return single_solid(cq.Workplane("XZ").polyline(corners).close().revolve(360, (0, 0), (0, 1)).val())


def frusta(taper: Sequence[XY], flatness: float = 1.0) -> cq.Solid:
    """Loft ruled faces between ellipses of half-width r along x and `flatness` r along y, at (r, z) of a taper [m]."""
    rings = [_ellipse(r / MM, flatness * r / MM, z / MM) for r, z in taper]
    return single_solid(cq.Solid.makeLoft(rings, ruled=True))


def _ellipse(a: float, b: float, z: float) -> cq.Wire:
    """Return an ellipse about the z axis with semi-axes a and b, all in [mm].

    It is made of rational arcs, which are exact. The kernel's own ellipses become polynomials with an error of 1e-9
    when it lofts a face between two of them.
    """
    (x, y), weight = _RING.T, float(_WEIGHTS[1])
    # Two arcs share one vertex: of two that differ by round-off, the kernel keeps one by its address in memory.
    ends = [BRepBuilderAPI_MakeVertex(gp_Pnt(a * x[i], b * y[i], z)).Vertex() for i in range(0, 2 * ARCS, 2)]
    edges = []
    for k in range(ARCS):
        points, weights = TColgp_Array1OfPnt(1, 3), TColStd_Array1OfReal(1, 3)
        for i, w in enumerate((1.0, weight, 1.0)):
            points.SetValue(i + 1, gp_Pnt(a * x[2 * k + i] / w, b * y[2 * k + i] / w, z))
            weights.SetValue(i + 1, w)
        arc = Geom_BezierCurve(points, weights)
        edges.append(cq.Edge(BRepBuilderAPI_MakeEdge(arc, ends[k], ends[(k + 1) % ARCS]).Edge()))
    return cq.Wire.assembleEdges(edges)


def on_foot(geometry: ProbeGeometry, foot: cq.Solid, ruled: bool = False) -> cq.Solid:
    """Return the solid of a curved probe: the flexible part, with its bore, on a foot whose top is z = 0.

    The control points of a ring are fixed in its section, so they follow T(s) (r(s) ring). Between the knots of the
    radius, whose kinks stay sharp, they are cubic splines through values and derivatives of that; v is s [mm]. The
    faces are sewn: a union would take the kernel half a minute.

    Args:
        geometry: of the probe, with a curved axis.
        foot: its flange without bore, in millimetres.
        ruled: whether to draw it for its facets instead: ruled faces between so many rings that facets, which the
            kernel makes well on such faces only, are within `CHORD_MM` of the surface.
    """
    top, bore = geometry.length / MM, geometry.bore_radius / MM
    shells = [_tube_faces(geometry, geometry.radius, ruled)]
    inside = []
    if geometry.cross_section.hollow:
        shells.append(_tube_faces(geometry, geometry.cross_section.bore_ratio * geometry.radius, ruled))
        low = -geometry.flange.thickness / MM
        ring = np.column_stack([bore / _WEIGHTS[:, None] * _RING, np.zeros(2 * ARCS + 1)])
        poles = np.stack([ring + np.array([0.0, 0.0, z]) for z in (low, 0.0)], axis=1)
        inside = [_patch(poles[k : k + 3], _WEIGHTS[k : k + 3], np.array([low, 0.0]), 1) for k in range(0, 2 * ARCS, 2)]
    holes = {0.0: [_ring_at(shells[0], 0.0)], **({low: [_ellipse(bore, bore, low)]} if inside else {})}
    sewing = BRepBuilderAPI_Sewing(FLAT_MM)
    kept = foot.Faces()
    for height, wires in holes.items():
        flat = [face for face in kept if face.geomType() == "PLANE" and abs(face.Center().z - height) < FLAT_MM]
        whole = max(flat, key=lambda face: face.Area())  # beside it the islands of letters
        kept.remove(whole)
        kept.append(cq.Face.makeFromWires(whole.outerWire(), [*whole.innerWires(), *wires]))
    for face in (*kept, *(face for faces in shells for face in faces), *inside):
        sewing.Add(face.wrapped)
    tip, *hollow = (_ring_at(faces, top) for faces in shells)
    sewing.Add(cq.Face.makeFromWires(tip, hollow).wrapped)
    sewing.Perform()
    return single_solid(cq.Solid.makeSolid(cq.Shape.cast(sewing.SewedShape())).fix())


def _tube_faces(geometry: ProbeGeometry, radius: Array, ruled: bool) -> list[cq.Face]:
    """Return the faces around the axis at radii [m] of the knots; see `on_foot`."""
    axis, knots = geometry.axis, geometry.s
    ring = _RING / _WEIGHTS[:, None] * np.array([1.0, geometry.cross_section.flatness])
    faces = []
    for i in range(len(knots) - 1):
        inner = axis.s[(axis.s > knots[i]) & (axis.s < knots[i + 1])]
        ends, s = np.array([knots[i], *inner, knots[i + 1]]), knots[i : i + 1]
        for a, b in pairwise(ends):
            bend = max(float(np.linalg.norm(axis.curvature_at([a, b]), axis=1).max()), 1e-9)
            longest = min(CHORD_RAD / bend, np.sqrt(8.0 * CHORD_MM * MM / bend)) if ruled else PIECE_RAD / bend
            s = np.append(s, np.linspace(a, b, int(np.ceil((b - a) / longest)) + 1)[1:])
        slope = (radius[i + 1] - radius[i]) / (knots[i + 1] - knots[i])
        T, u = axis.frames(s), axis.rest_curvature(s)
        local = (radius[i] + slope * (s - knots[i]))[:, None, None] * np.column_stack([ring, np.zeros(len(ring))])
        p = (T[:, None, :3, 3] + np.einsum("kij,knj->kni", T[:, :3, :3], local)) / MM
        if ruled:
            faces += [
                _patch(np.swapaxes(p[j : j + 2], 0, 1), _WEIGHTS, s[j : j + 2] / MM, 1) for j in range(len(s) - 1)
            ]
            continue
        # (T local)' = R (u × local + e_z + local')
        along = np.cross(u[:, None], local) + np.array([0.0, 0.0, 1.0])
        along[..., :2] += slope * ring
        third = np.diff(s)[:, None, None] / 3.0
        d = np.einsum("kij,knj->kni", T[:, :3, :3], along) / MM
        between = np.stack([p[:-1] + third * d[:-1], p[1:] - third * d[1:]], axis=1).reshape(-1, *p.shape[1:])
        for first in range(0, len(s) - 1, FACE_PIECES):
            last = min(first + FACE_PIECES, len(s) - 1)
            poles = np.concatenate([p[first : first + 1], between[2 * first : 2 * last], p[last : last + 1]])
            poles, v = np.swapaxes(poles, 0, 1), s[first : last + 1] / MM
            faces += [_patch(poles[k : k + 3], _WEIGHTS[k : k + 3], v, 3) for k in range(0, 2 * ARCS, 2)]
    return faces


def _patch(poles: Array, weights: Array, v: Array, degree: int) -> cq.Face:
    """Return a face of rational arcs along u and splines of that degree with double inner knots v along v.

    Args:
        poles: control points [mm], (2 n + 1, degree + 1 + 2 (len(v) - 2), 3) of n arcs.
        weights: of the arcs' control points, (2 n + 1,).
        v: knots, increasing.
        degree: 1 (then of two knots) or 3.
    """
    rows, columns = poles.shape[:2]
    points, heavy = TColgp_Array2OfPnt(1, rows, 1, columns), TColStd_Array2OfReal(1, rows, 1, columns)
    for i in range(rows):
        for j in range(columns):
            points.SetValue(i + 1, j + 1, gp_Pnt(*map(float, poles[i, j])))
            heavy.SetValue(i + 1, j + 1, float(weights[i]))
    directions = []
    for knots, order in ((np.arange((rows + 1) // 2, dtype=float), 2), (v, degree)):
        values, multiplicities = TColStd_Array1OfReal(1, len(knots)), TColStd_Array1OfInteger(1, len(knots))
        for i, knot in enumerate(knots):
            values.SetValue(i + 1, float(knot))
            multiplicities.SetValue(i + 1, order + 1 if i in (0, len(knots) - 1) else 2)
        directions.append((values, multiplicities))
    (u, of_u), (w, of_w) = directions
    surface = Geom_BSplineSurface(points, heavy, u, w, of_u, of_w, 2, degree)
    return cq.Face(BRepBuilderAPI_MakeFace(surface, 1e-7).Face())


def _ring_at(faces: Sequence[cq.Face], v: float) -> cq.Wire:
    curves = []
    for face in faces:
        *_, v0, v1 = BRepTools.UVBounds_s(face.wrapped)
        if v0 - FLAT_MM <= v <= v1 + FLAT_MM:
            curves.append(BRep_Tool.Surface_s(face.wrapped).VIso(v))
    return cq.Wire.assembleEdges([cq.Edge(BRepBuilderAPI_MakeEdge(curve).Edge()) for curve in curves])


def cylinder(d: float, z0: float, z1: float, p: XY = (0.0, 0.0)) -> cq.Solid:
    """Return an upright cylinder of diameter d between z0 and z1 about p [m]."""
    return cq.Solid.makeCylinder(d / 2 / MM, (z1 - z0) / MM, _vector(p, z0))


def hexagon(af: float, z0: float, z1: float, p: XY, turn_deg: float = 0.0) -> cq.Solid:
    """Return an upright hexagonal prism across flats `af` between z0 and z1 about p [m], a flat facing the axis at a
    turn of 0."""
    outline = cq.Workplane().polygon(6, 2 * af / np.sqrt(3.0) / MM).extrude((z1 - z0) / MM)
    azimuth = np.degrees(np.arctan2(p[1], p[0]))
    return single_solid(
        outline.val().rotate((0, 0, 0), (0, 0, 1), azimuth + 30.0 + turn_deg).moved(cq.Location(_vector(p, z0)))
    )


def engraving_cuts(engraving: Engraving) -> list[cq.Solid]:
    """Return the solids that an engraving removes, one per character."""
    solids, up = [], cq.Vector(0, 0, DEPTH / MM)

    def turns(loop: list[XY]) -> float:
        return sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(loop, [*loop[1:], loop[0]], strict=True))

    for character, T in engraving.placed():
        middle = np.array([glyph_width(character), ROWS]) / 2
        loops = [[(float(x), float(y)) for x, y in CELL * (np.array(loop) - middle)]
                 for loop in cut_outlines(character)]  # fmt: skip
        if loops:  # Every character is connected; a loop of the other orientation is an island in it.
            corners = [[_vector(p, -DEPTH) for p in loop] for loop in sorted(loops, key=turns)]
            *islands, cut = [cq.Wire.makePolygon(points, close=True) for points in corners]
            solids.append(placed(cq.Solid.extrudeLinear(cq.Face.makeFromWires(cut, islands), up), T))
    return solids


def round_slot(width: float, x: XY, z: XY, p: XY, azimuth_deg: float, both_ends: bool = False) -> cq.Solid:
    """Return an upright slot along x in a frame at p [m], turned by the azimuth: the centres of its round ends at the
    values of x; without `both_ends` the one at x[1] is straight."""
    (x0, x1), half = x, width / 2
    body = block((x0, x1), (-half, half), z).fuse(cylinder(width, *z, (x0, 0.0)))
    if both_ends:
        body = body.fuse(cylinder(width, *z, (x1, 0.0)))
    turned = body.clean().rotate((0, 0, 0), (0, 0, 1), azimuth_deg)
    return single_solid(turned.moved(cq.Location(_vector(p, 0.0))))


def block(x: XY, y: XY, z: XY) -> cq.Solid:
    """Return a box between the two values of x, of y and of z [m]."""
    lengths = [(b - a) / MM for a, b in (x, y, z)]
    return cq.Solid.makeBox(*lengths, pnt=_vector((x[0], y[0]), z[0]))


def placed(shape: cq.Shape, T_a_b: Array) -> cq.Shape:
    """Return a shape of frame b in the coordinates of frame a; T (4, 4) in metres."""
    return shape.moved(location(T_a_b))


def location(T: Array) -> cq.Location:
    """Return a pose (4, 4) in metres as CadQuery's location."""
    origin = _vector((T[0, 3], T[1, 3]), T[2, 3])
    return cq.Location(cq.Plane(origin=origin, xDir=cq.Vector(*T[:3, 0]), normal=cq.Vector(*T[:3, 2])))


def meshed(shape: cq.Shape, linear_mm: float, angular_rad: float) -> cq.Shape:
    """Return a copy of a shape with facets, the same on every run.

    Args:
        shape: one or several solids, in millimetres.
        linear_mm: largest distance of a facet from its surface [mm].
        angular_rad: largest angle between adjacent facets [rad].
    """
    fresh = shape.copy()  # a copy has no coarser mesh from earlier use
    wanted = IMeshTools_Parameters()
    wanted.Deflection, wanted.Angle = linear_mm, angular_rad
    # Between rulings a facet is as accurate as its edge; checking its interior takes a minute on an elliptic probe.
    # A face that bends along the axis, which only a part that was changed in CadQuery has here, needs it.
    wanted.ControlSurfaceDeflection = any(_bends(face) for face in fresh.Faces())
    # The same points and as many triangles as by the default algorithm, in a quarter of its time.
    wanted.MeshAlgo = IMeshTools_MeshAlgoType.IMeshTools_MeshAlgoType_Delabella
    BRepMesh_IncrementalMesh(fresh.wrapped, wanted)
    return fresh


def single_solid(shape: cq.Shape) -> cq.Solid:
    """Return the single closed, valid solid of a shape.

    Raises:
        CheckFailedError: there is not exactly one, or it is not valid.
    """
    solids = shape.Solids()
    if len(solids) != 1 or not solids[0].isValid():
        raise CheckFailedError(f"the kernel returned {len(solids)} solids instead of one valid solid")
    return solids[0]


def mass_properties(shape: cq.Shape, density: float) -> MassProperties:
    """Return the mass properties of a solid, in SI, from its exact surfaces; density [kg/m³]."""
    gprops = GProp_GProps()
    BRepGProp.VolumeProperties_s(shape.wrapped, gprops)
    centre, matrix = gprops.CentreOfMass(), gprops.MatrixOfInertia()  # about the centre of mass
    inertia = np.array([[matrix.Value(i, j) for j in (1, 2, 3)] for i in (1, 2, 3)])
    volume = gprops.Mass() * MM**3
    p_com = np.array([centre.X(), centre.Y(), centre.Z()]) * MM
    return MassProperties(volume, density * volume, p_com, density * inertia * MM**5)


def _bends(face: cq.Face) -> bool:
    """Return whether a face is drawn along a curved axis."""
    surface = BRep_Tool.Surface_s(face.wrapped)
    return isinstance(surface, Geom_BSplineSurface) and surface.VDegree() == 3


def _vector(p: XY, z: float) -> cq.Vector:
    return cq.Vector(p[0] / MM, p[1] / MM, z / MM)
