"""Interface to the CAD kernel: arguments in metres, CadQuery shapes in millimetres, mass properties in SI."""

from collections.abc import Sequence

import cadquery as cq
import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge, BRepBuilderAPI_MakeVertex
from OCP.BRepGProp import BRepGProp
from OCP.BRepMesh import BRepMesh_IncrementalMesh
from OCP.BRepTools import BRepTools
from OCP.Geom import Geom_BezierCurve
from OCP.gp import gp_Pnt
from OCP.GProp import GProp_GProps
from OCP.IMeshTools import IMeshTools_MeshAlgoType, IMeshTools_Parameters
from OCP.TColgp import TColgp_Array1OfPnt
from OCP.TColStd import TColStd_Array1OfReal

from probedesign.core.errors import CheckFailedError
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.geometry.mass import MassProperties
from probedesign.mount.engraving import DEPTH, XY, Engraving

PRODUCT = "product"  #: Key in the metadata of an assembly's piece: the name of its product.
#: Arcs of an ellipse. The kernel's quadrature is accurate to 1e-14 over an eighth, over a quarter only to 1e-8.
ARCS = 8


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
    half = np.pi / ARCS
    angles = half * np.arange(2 * ARCS + 1)  # of the ends of the arcs and of their middles
    x, y = (np.round(f, 15) + 0.0 for f in (np.cos(angles), np.sin(angles)))  # exact zeros on the axes
    weight = float(np.cos(half))
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

    for loops in filter(None, engraving.outlines()):
        # Every character is connected; a loop of the other orientation is an island in it.
        corners = [[_vector(p, engraving.top - DEPTH) for p in loop] for loop in sorted(loops, key=turns)]
        *islands, cut = [cq.Wire.makePolygon(points, close=True) for points in corners]
        solids.append(cq.Solid.extrudeLinear(cq.Face.makeFromWires(cut, islands), up))
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
    wanted.ControlSurfaceDeflection = False
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


def section_properties(solid: cq.Solid, z: float) -> tuple[float, float, float]:
    """Return area [m²] and second moments ∫y², ∫x² [m⁴] about the centroid of a solid's cut at height z [m].

    The faces are ruled about the axis and cut along their own coordinate lines. A cut by a plane is not exact: through
    a cone of less than about 0.02° and through an elliptic face the kernel fits a curve to 1e-5.
    """
    lines, height = [], z / MM
    for face in solid.Faces():
        box = face.BoundingBox()
        if not box.zmin < height < box.zmax:
            continue
        surface, (u, _, v0, v1) = BRep_Tool.Surface_s(face.wrapped), BRepTools.UVBounds_s(face.wrapped)
        z0, z1 = (surface.Value(u, v).Z() for v in (v0, v1))
        curve = surface.VIso(v0 + (height - z0) / (z1 - z0) * (v1 - v0))
        lines.append(cq.Edge(BRepBuilderAPI_MakeEdge(curve).Edge()))
        if max(abs(lines[-1].positionAt(t).z - height) for t in (0.0, 0.25, 0.5, 0.75)) > 1e-9:
            raise CheckFailedError(f"the face at z = {height:g} mm is not ruled about the axis")
    inside_out = sorted(cq.Wire.combine(lines), key=lambda wire: wire.BoundingBox().DiagonalLength)
    gprops = GProp_GProps()
    BRepGProp.SurfaceProperties_s(cq.Face.makeFromWires(inside_out[-1], inside_out[:-1]).wrapped, gprops)
    matrix = gprops.MatrixOfInertia()
    return gprops.Mass() * MM**2, matrix.Value(1, 1) * MM**4, matrix.Value(2, 2) * MM**4


def _vector(p: XY, z: float) -> cq.Vector:
    return cq.Vector(p[0] / MM, p[1] / MM, z / MM)
