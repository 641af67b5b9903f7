"""Projections of a solid for its drawing: visible edges, and the outlines of the faces in a cutting plane."""

from dataclasses import dataclass

import cadquery as cq
import numpy as np
from OCP.BRepLib import BRepLib
from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt
from OCP.HLRAlgo import HLRAlgo_Projector
from OCP.HLRBRep import HLRBRep_Algo, HLRBRep_HLRToShape

from probedesign.core.frames import Array

CURVE_POINTS = 48
"""Points of a curved edge: a full circle Ø60 mm is drawn within 0.07 mm, less than its line width."""
SAME_MM = 1e-4
"""End points closer than this coincide."""
Lines = list[Array]
"""Polylines, each (k, 2), in millimetres: u to the right, v up."""


@dataclass(frozen=True)
class ViewDirection:
    """A direction of view."""

    eye: tuple[float, float, float]  #: direction from the part to the eye.
    right: tuple[float, float, float]  #: direction drawn to the right.


FRONT = ViewDirection((0.0, -1.0, 0.0), (1.0, 0.0, 0.0))
ABOVE = ViewDirection((0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
BELOW = ViewDirection((0.0, 0.0, -1.0), (1.0, 0.0, 0.0))
"""Keeps x to the right, so y points down."""


def seen(shape: cq.Shape, side: ViewDirection) -> Lines:
    """Return the visible edges and silhouettes of a solid."""
    algorithm = HLRBRep_Algo()
    algorithm.Add(shape.wrapped)
    axes = gp_Ax2(gp_Pnt(), gp_Dir(*side.eye), gp_Dir(*side.right))
    algorithm.Projector(HLRAlgo_Projector(axes))
    algorithm.Update()
    algorithm.Hide()
    found = HLRBRep_HLRToShape(algorithm)
    kinds = (found.VCompound(), found.OutLineVCompound())
    return [line for kind in kinds if kind is not None and not kind.IsNull() for line in _flat(kind)]


def cut(shape: cq.Shape) -> tuple[Lines, list[Lines]]:
    """Return the half at y > 0, seen from the front, and the faces in the plane y = 0.

    Returns:
        Visible edges, and the closed outlines of each section face.
    """
    box = shape.BoundingBox()
    reach = 2.0 * box.DiagonalLength
    half = shape.intersect(cq.Solid.makeBox(2 * reach, reach, 2 * reach, cq.Vector(-reach, 0.0, box.center.z - reach)))
    faces = [face for face in half.Faces() if face.Center().y < SAME_MM]  # of a half at y > 0: those in the plane
    return seen(half, FRONT), [[_loop(wire, [0, 2]) for wire in face.Wires()] for face in faces]


def cross_section(shape: cq.Shape, z: float) -> list[Lines]:
    """Return the closed outlines (x, y) of each face of a solid in the plane at height z [mm]."""
    reach = 4.0 * shape.BoundingBox().DiagonalLength
    plane = cq.Face.makePlane(reach, reach, cq.Vector(0.0, 0.0, z))
    return [[_loop(wire, [0, 1]) for wire in face.Wires()] for face in shape.intersect(plane).Faces()]


def _flat(wrapped: object) -> Lines:
    BRepLib.BuildCurves3d_s(wrapped)
    return [_points(edge)[:, :2] for edge in cq.Shape.cast(wrapped).Edges()]


def _loop(wire: cq.Wire, axes: list[int]) -> Array:
    """Return two coordinates of a closed outline; its edges are in order, but of either orientation."""
    edges = [_points(edge)[:, axes] for edge in wire]
    if len(edges) == 1:
        return edges[0]
    first, second = edges[0], edges[1]
    turn = min(_gap(first[-1], second[0]), _gap(first[-1], second[-1])) > SAME_MM
    line = [first[::-1] if turn else first]
    for edge in edges[1:]:
        line.append(edge if _gap(line[-1][-1], edge[0]) < _gap(line[-1][-1], edge[-1]) else edge[::-1])
    return np.concatenate(line)


def _gap(a: Array, b: Array) -> float:
    return float(np.hypot(*(a - b)))


def _points(edge: cq.Edge) -> Array:
    count = 2 if edge.geomType() == "LINE" else CURVE_POINTS
    ends = np.linspace(0.0, 1.0, count)
    return np.array([p.toTuple() for p in edge.positions(ends)])
