"""What one sees of a solid from one side: its visible edges, and the cut faces of a section, as lines on paper."""

from dataclasses import dataclass

import cadquery as cq
import numpy as np
from OCP.BRepLib import BRepLib
from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt
from OCP.HLRAlgo import HLRAlgo_Projector
from OCP.HLRBRep import HLRBRep_Algo, HLRBRep_HLRToShape

from probedesign.frames import Array

CURVE_POINTS = 48
"""Of a bent edge: a full circle Ø60 mm is drawn within 0.07 mm, less than its line is wide."""
SAME_MM = 1e-4
"""Ends that near are one corner."""
Lines = list[Array]
"""Polylines, each (k, 2), in millimetres: u to the right, v up."""


@dataclass(frozen=True)
class Side:
    """Where one looks from.

    Attributes:
        eye: direction from the part to the eye.
        right: direction that is drawn to the right.
    """

    eye: tuple[float, float, float]
    right: tuple[float, float, float]


FRONT = Side((0.0, -1.0, 0.0), (1.0, 0.0, 0.0))
ABOVE = Side((0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
BELOW = Side((0.0, 0.0, -1.0), (1.0, 0.0, 0.0))
"""x stays to the right, so y points down."""


def seen(shape: cq.Shape, side: Side) -> Lines:
    """The visible edges and outlines of a solid."""
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
    """The half behind the plane y = 0, seen from the front, and the faces in that plane.

    Returns:
        Visible edges, and the closed outlines of each cut face.
    """
    box = shape.BoundingBox()
    reach = 2.0 * box.DiagonalLength
    behind = cq.Solid.makeBox(2 * reach, reach, 2 * reach, cq.Vector(-reach, 0.0, box.center.z - reach))
    plane = cq.Face.makePlane(
        2 * reach, 2 * reach, cq.Vector(0.0, 0.0, box.center.z), cq.Vector(0.0, -1.0, 0.0)
    )
    faces = shape.intersect(plane).Faces()
    loops = [[_loop(wire) for wire in face.Wires()] for face in faces]
    return seen(shape.intersect(behind), FRONT), loops


def _flat(wrapped: object) -> Lines:
    BRepLib.BuildCurves3d_s(wrapped)
    return [_points(edge)[:, :2] for edge in cq.Shape.cast(wrapped).Edges()]


def _loop(wire: cq.Wire) -> Array:
    """A closed outline in the plane y = 0 as (x, z); its edges come in turn, but each either way round."""
    edges = [_points(edge)[:, [0, 2]] for edge in wire]
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
