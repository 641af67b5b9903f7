"""Solve the rod by Exudyn: geometrically exact beams and static solver, with default tolerances and one load step.

Each element has the constant section of its middle. Exudyn runs without range checks and with sparse factorisation,
the fastest options it documents. Its beams lie along x: the rod's z, x, y are its x, y, z.
"""

import contextlib
import io
import sys
from typing import Any, NamedTuple

import numpy as np

from probedesign.core.frames import Array
from probedesign.rod.rod import Rod

vars(sys)["exudynFast"] = True  # selects the build without range checks
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


def stations(rod: Rod, s_contact: float, elements: int) -> Array:
    """Return the ends of the elements [m], (elements + 1,), with one at s_contact and equal lengths on either side.

    Args:
        rod: the cone.
        s_contact: arclength of the contact [m].
        elements: number of elements.
    """
    if s_contact == rod.length:
        before = elements
    else:
        before = min(max(1, round(elements * s_contact / rod.length)), elements - 1)
    return np.append(
        np.linspace(0.0, s_contact, before + 1), np.linspace(s_contact, rod.length, elements - before + 1)[1:]
    )


def nodal_weights(rod: Rod, s: Array, gravity: Array) -> Array:
    """Return the nodal weights of the frusta between the stations s [N], (k, 3), with their true centres of mass."""
    r0, r1 = rod.radius_at(s[:-1]), rod.radius_at(s[1:])
    squares = r0 * r0 + r0 * r1 + r1 * r1
    mass = rod.density * np.pi / 3.0 * np.diff(s) * squares
    far = (r0 * r0 + 2.0 * r0 * r1 + 3.0 * r1 * r1) / (4.0 * squares)  # centre of mass over the length
    return np.outer(np.append((1.0 - far) * mass, 0.0) + np.append(0.0, far * mass), gravity)
