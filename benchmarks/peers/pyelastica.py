"""Solve the rod by PyElastica: dynamic relaxation of a discrete Cosserat rod to its equilibrium.

Each element has the constant section of its middle. The time step is 0.9 of the stability limit, which the rotation of
the thinnest element determines. The damping is just below the critical damping of the slowest mode.
"""

import elastica
import numpy as np

from benchmarks.peers.mesh import stations
from probedesign.core.frames import Array
from probedesign.rod.rod import Rod

AT_REST = 1e-4
"""Largest speed of a node at rest [m/s]. A tenth of it changes the result by about 2 µm."""
CHECK_INTERVAL = 50
"""Steps between checks of the speed."""
MAX_STEPS = 100_000
SAFETY = 0.9
DAMPING = 12.5
"""Uniform damping over sqrt(E I/(ρ A))/L² of the base; the best of several values for this cone."""


class _Simulation(
    elastica.BaseSystemCollection, elastica.Constraints, elastica.Forcing, elastica.Damping
):  # PyElastica composes simulations of mixins
    pass


class _DeadForce(elastica.NoForces):
    """Constant force [N] on one node."""

    def __init__(self, node: int, force: Array) -> None:
        super().__init__()
        self.node, self.force = node, force

    def apply_forces(self, system: elastica.CosseratRod, time: float = 0.0) -> None:
        system.external_forces[:, self.node] += self.force


def relax(
    rod: Rod, gravity: Array, force: Array, s_contact: float, elements: int, behind: float
) -> tuple[Array, Array]:
    """Solve from the straight cone; return stations [m], (k,), and points of the centreline [m], (k, 3).

    Args:
        rod: the cone.
        gravity: in base axes [m/s²], (3,).
        force: on the rod in base axes [N], (3,).
        s_contact: arclength of the force [m], where a node is placed.
        elements: number of elements.
        behind: fraction of the first element behind the clamp. 0 is the documented clamp, which fixes the direction
            of the whole first element, so that the cone is half an element too short. With 0.5 it bends from s = 0.

    Raises:
        ArithmeticError: the rod is not at rest after `MAX_STEPS`.
    """
    s = stations(rod, s_contact, elements, behind)
    simulation, body = _Simulation(), _body(rod, s)
    step = _stable_step(rod, s, body.radius)
    scale = rod.radius[0] / 2.0 * np.sqrt(rod.youngs_modulus / rod.density) / rod.length**2
    simulation.append(body)
    simulation.constrain(body).using(
        elastica.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,)
    )
    simulation.add_forcing_to(body).using(elastica.GravityForces, acc_gravity=gravity)
    simulation.add_forcing_to(body).using(_DeadForce, int(np.searchsorted(s, s_contact)), force)
    simulation.dampen(body).using(
        elastica.AnalyticalLinearDamper, uniform_damping_constant=DAMPING * scale, time_step=step
    )
    simulation.finalize()
    stepper, time = elastica.PositionVerlet(), np.float64(0.0)
    for count in range(MAX_STEPS):
        time = stepper.step(simulation, time, step)
        if (count + 1) % CHECK_INTERVAL == 0 and np.abs(body.velocity_collection).max() < AT_REST:
            on = s >= 0.0
            return s[on], body.position_collection.T[on]
    raise ArithmeticError(f"PyElastica is not at rest after {MAX_STEPS} steps")


def _body(rod: Rod, s: Array) -> elastica.CosseratRod:
    """Return the straight rod with nodes at s [m]; the cone is extended behind the clamp."""
    slope = (rod.radius[-1] - rod.radius[0]) / rod.length
    radius = rod.radius[0] + slope * (s[:-1] + s[1:]) / 2.0
    position = np.zeros((3, len(s)))
    position[2] = s
    body = elastica.CosseratRod.straight_rod(
        n_elements=len(s) - 1,
        start=position[:, 0],
        direction=np.array([0.0, 0.0, 1.0]),
        normal=np.array([1.0, 0.0, 0.0]),
        base_length=s[-1] - s[0],
        base_radius=radius,
        density=rod.density,
        youngs_modulus=rod.youngs_modulus,
        shear_modulus=rod.shear_modulus,
        position=position,
    )
    kGA = (
        rod.shear_coefficient * rod.shear_modulus * np.pi * radius * radius
    )  # PyElastica assumes another shear coefficient
    body.shear_matrix[0, 0], body.shear_matrix[1, 1] = kGA, kGA
    return body


def _stable_step(rod: Rod, s: Array, radius: Array) -> float:
    """Return the time step [s] for the rotation of elements against the bending of their neighbours and their shear."""
    bending = rod.youngs_modulus / np.diff(s) ** 2
    shear = rod.shear_coefficient * rod.shear_modulus / radius**2
    return SAFETY * float(np.sqrt(rod.density / (bending + shear)).min())
