"""Solve the rod by Exudyn: geometrically exact beams and static solver, with default tolerances and one load step.

Each element has the constant section of its middle. Exudyn runs without range checks and with sparse factorisation,
the fastest options it documents. Its beams lie along x: the rod's z, x, y are its x, y, z.
"""

import contextlib
import io
import sys
from typing import Any, NamedTuple

import numpy as np

from benchmarks.peers.mesh import nodal_weights, stations
from probedesign.core.frames import Array
from probedesign.rod.rod import Rod

sys.exudynFast = True  # selects the build without range checks
with contextlib.redirect_stdout(io.StringIO()):  # suppresses the message about that build
    import exudyn
    from exudyn import itemInterface as item


class Model(NamedTuple):
    """Model of a cone."""

    s: Array  #: arclengths of the nodes [m], (k,).
    nodes: list[Any]  #: node numbers, k of them.
    container: Any  #: owner of the system; it must stay alive.
    system: Any  #: bodies and loads.
    settings: Any  #: settings of the solver.


def build(rod: Rod, gravity: Array, force: Array, s_contact: float, elements: int) -> Model:
    """Return the model of a cone under gravity [m/s²] and a dead force [N] on a node at s_contact [m]."""
    s = stations(rod, s_contact, elements)
    loads = nodal_weights(rod, s, gravity)
    loads[np.searchsorted(s, s_contact)] += force
    container = exudyn.SystemContainer()
    system = container.AddSystem()
    nodes = [system.AddNode(item.NodeRigidBodyEP(referenceCoordinates=[at, 0, 0, 1, 0, 0, 0])) for at in s]
    for i, middle in enumerate((s[:-1] + s[1:]) / 2.0):
        section = _section(rod, float(rod.radius_at(middle)))
        ends = [nodes[i], nodes[i + 1]]
        system.AddObject(
            item.ObjectBeamGeometricallyExact(nodeNumbers=ends, length=s[i + 1] - s[i], sectionData=section)
        )
    for node, load in zip(nodes, loads, strict=True):
        marker = system.AddMarker(item.MarkerNodePosition(nodeNumber=node))
        system.AddLoad(item.LoadForceVector(markerNumber=marker, loadVector=np.roll(load, 1)))
    ends = [system.AddNode(item.NodePointGround()), nodes[0]]
    clamp = [system.AddMarker(item.MarkerNodeRigid(nodeNumber=node)) for node in ends]
    system.AddObject(item.ObjectJointGeneric(markerNumbers=clamp))
    system.Assemble()
    settings = exudyn.SimulationSettings()
    settings.solution.file.write = False
    settings.staticSolver.verboseMode = 0
    settings.linearSolver.solverType = exudyn.LinearSolverType.EigenSparse
    return Model(s, nodes, container, system, settings)


def solve(model: Model) -> tuple[Array, Array]:
    """Solve from the straight cone; return stations [m], (k,), and points of the centreline [m], (k, 3).

    Raises:
        ArithmeticError: the solver does not converge.
    """
    if not model.system.SolveStatic(model.settings):
        raise ArithmeticError("Exudyn found no equilibrium")
    position = exudyn.OutputVariableType.Position
    found = np.array([model.system.GetNodeOutput(node, position) for node in model.nodes])
    return model.s, np.roll(found, -1, axis=1)


def _section(rod: Rod, radius: float) -> Any:
    """Return the stiffness of a solid round section in Exudyn's order: axial, shear (2), torsion, bending (2)."""
    E, kG = rod.youngs_modulus, rod.shear_coefficient * rod.shear_modulus
    A = np.pi * radius * radius
    EI, GJ = E * A * radius * radius / 4.0, rod.shear_modulus * A * radius * radius / 2.0
    section = exudyn.BeamSection()
    section.stiffnessMatrix = np.diag([E * A, kG * A, kG * A, GJ, EI, EI])
    section.massPerLength = rod.density * A  # required, but without effect in statics
    section.inertia = rod.density * A * radius * radius / 2.0 * np.eye(3)
    return section
