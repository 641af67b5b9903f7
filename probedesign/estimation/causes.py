"""What may differ between a probe and its model, one unit normal each: how readings and the touched point answer.

A cause moves the reading h of the touch and the touched point p while the touch itself stays: the same arclength (of
the length, where that differs), angle and magnitude. To first order it does not matter what of the touch is held.
"""

import math
from dataclasses import dataclass

import numpy as np

from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.frames import Array, inverse, skew, wrench_map
from probedesign.rod import kernels
from probedesign.rod.contacts import Contacts
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.rod import Rod
from probedesign.units import MM

CAUSES = ("noise", "drift", "E", "G", "density", "diameter", "diameter scatter", "length", "base place", "base tilt",
          "clocking", "gravity", "creep")  # fmt: skip
"""Of an error, in the order of the tables."""
LOG_E, LOG_G, LOG_DENSITY, LOG_DIAMETER = (
    kernels.PARAMETERS.index(f"log_{name}") for name in ("E", "G", "density", "diameter")
)
GRAVITY = slice(7, 10)


@dataclass(frozen=True)
class Answers:
    """How n touches answer to j parameters: gravity (3), log E, log G, log density, log length, log of each knot's
    diameter.

    Attributes:
        wrench: of the base wrench, (n, 6, j).
        point: of the touched point of the centreline [m], (n, 3, j).
        at: the base wrench itself, (n, 6).
        p: the point itself, (n, 3).
        force: of the contact's force [N], (n, 3, j).
    """

    wrench: Array
    point: Array
    at: Array
    p: Array
    force: Array


def parameters_of(rod: Rod, tolerances: Tolerances, hung: bool = False) -> dict[str, Array]:
    """Of each cause that is the rod's own, one standard deviation: the parameters from log E on, a row each.

    Where E was identified with the design's diameters, it goes with all of them together.

    Args:
        rod: of the model.
        tolerances: how well it is known.
        hung: whether only what a touch adds creeps: a rod that is lighter by as much as it is softer hangs the same.
    """
    K, diameters = len(rod.s), 2.0 * rod.radius / MM
    unit = np.eye(4 + K)
    t = tolerances
    common = np.maximum(t.diameter_mm, t.diameter_share * diameters) / diameters
    length = max(t.length_mm, t.length_share * rod.length / MM) * MM / rod.length
    return {
        "E": t.youngs_modulus * unit[0:1],
        "G": t.shear_modulus * unit[1:2],
        "density": t.density * unit[2:3],
        "diameter": (common @ unit[4:] + t.youngs_modulus_by_diameter * common[0] * unit[0])[None],
        "diameter scatter": (t.diameter_scatter_mm / diameters)[:, None] * unit[4:],
        "length": length * unit[3:4],
        "creep": t.creep * (unit[0:1] + unit[1:2] + hung * unit[2:3]),
    }


def turns_of(gravity: Array, tolerances: Tolerances) -> dict[str, Array]:
    """Of each cause that turns or shifts things, one standard deviation a row: shift and turn of the base [m, rad]
    and change of gravity [m/s²], (9,)."""
    g, unit = np.asarray(gravity, dtype=float), np.eye(9)
    size = float(np.linalg.norm(g))
    across = np.linalg.svd(g[None])[2][1:] if size > 0.0 else np.zeros((2, 3))
    return {
        "base place": tolerances.base_mm * MM * unit[0:3],
        "base tilt": math.radians(tolerances.tilt_deg) * unit[3:5],
        "clocking": math.radians(tolerances.clocking_deg) * unit[5:6],
        "gravity": math.radians(tolerances.gravity_deg) * size * across @ unit[6:9],
    }


def answers_of(contacts: Contacts, rod: Rod, gravity: Array) -> Answers:
    """Of touches by what their rod is made of and by gravity; `contacts` with all columns."""
    batch, n = contacts.batch, len(contacts.s)
    by_length = _by_length(batch.d_moment, batch.wrench_base[:, 3:6], contacts.force, 3.0)
    points = _by_length(batch.d_contact[:, 6:9], batch.p_contact_base, contacts.force, 1.0)
    frames = [_by_length(batch.d_contact[:, q], np.zeros((n, 3)), contacts.force, 0.0)
              for q in (slice(0, 3), slice(3, 6), slice(9, 12))]  # fmt: skip
    d_contact = _chosen(batch.d_contact, np.concatenate([frames[0], frames[1], points, frames[2]], axis=1))
    d_moment = _chosen(batch.d_moment, by_length)
    d_force = np.broadcast_to(_d_weight(rod, gravity), (n, 3, d_moment.shape[2]))
    dead = contacts.magnitude[:, None, None] * contacts.pushed(d_contact)
    turning = contacts.d_force(dead, d_slope(rod, contacts))
    wrench = np.concatenate([d_force + turning, d_moment + batch.d_moment[:, :, 0:3] @ turning], axis=1)
    point = d_contact[:, 6:9] + batch.d_contact[:, 6:9, 0:3] @ turning
    return Answers(wrench, point, batch.wrench_base, batch.p_contact_base, turning)


def free_answers(rod: Rod, gravity: Array) -> Answers:
    """The same of the free probe; its point is the tip."""
    return held_answers(rod, rod.solve(gravity, columns="all"), gravity)


def held_answers(rod: Rod, eq: Equilibrium, gravity: Array) -> Answers:
    """The same of a force that keeps its place and direction, as a weight on a thread does; `eq` with all columns."""
    assert eq.sensitivity is not None, "asked of a probe that cannot stand"
    d, force = eq.sensitivity, eq.load[None, 0:3]
    moment, p, d_moment, d_p = (
        x[None] for x in (eq.wrench_base[3:6], eq.p_contact_base, d.d_moment, d.d_position)
    )
    moments = _chosen(d_moment, _by_length(d_moment, moment, force, 3.0))
    points = _chosen(d_p, _by_length(d_p, p, force, 1.0))
    wrench = np.concatenate([_d_weight(rod, gravity)[None], moments], axis=1)
    return Answers(wrench, points, eq.wrench_base[None], p, np.zeros_like(points))


def moved_by(
    answers: Answers, model: ProbeModel, gravity: Array, tolerances: Tolerances, hung: bool = False
) -> dict[str, tuple[Array, Array]]:
    """Of each cause, how one standard deviation of it moves reading and point as told in the model's base frame.
    `hung` is that of `parameters_of`.

    Returns:
        Of each cause, (n, 6, j) and (n, 3, j): one column for each of its unit normals.
    """
    found = {
        name: (answers.wrench[:, :, 3:] @ rows.T, answers.point[:, :, 3:] @ rows.T)
        for name, rows in parameters_of(model.rod, tolerances, hung).items()
    }
    by_pose = by_turns(answers, model, gravity)
    for name, rows in turns_of(gravity, tolerances).items():
        found[name] = (by_pose[0] @ rows.T, by_pose[1] @ rows.T)
    return found


def by_turns(answers: Answers, model: ProbeModel, gravity: Array) -> tuple[Array, Array]:
    """Of reading and point in the model's base frame by shift and turn of the base and by gravity, (n, 6, 9) and
    (n, 3, 9). A turn of the base turns what it reads, and gravity the other way as seen from it."""
    n, seen = len(answers.p), skew(gravity)
    wrench, point = np.zeros((n, 6, 9)), np.zeros((n, 3, 9))
    F, M, p = (_skews(v) for v in (answers.at[:, 0:3], answers.at[:, 3:6], answers.p))
    wrench[:, 3:6, 0:3] = -F
    wrench[:, 0:3, 3:6], wrench[:, 3:6, 3:6] = -F, -M
    wrench[:, :, 3:6] += answers.wrench[:, :, 0:3] @ seen
    point[:, :, 0:3], point[:, :, 3:6] = np.eye(3), -p + answers.point[:, :, 0:3] @ seen
    hanging = np.stack([model.gravity_wrench_sensor(e) for e in np.eye(3)], axis=1)
    wrench[:, :, 6:9] = answers.wrench[:, :, 0:3] + wrench_map(inverse(model.T_sensor_base)) @ hanging
    point[:, :, 6:9] = answers.point[:, :, 0:3]
    return wrench, point


def _by_length(columns: Array, value: Array, force: Array, power: float) -> Array:
    """By the logarithm of the length, diameters staying, (n, 3, 1).

    A rod of λ times the size under λ² times the force and 1/λ times the density is the same rod: so growing at rest
    of load is known from the columns, and the diameters' growth is taken back.
    """
    grown = (
        power * value - 2.0 * np.einsum("nij,nj->ni", columns[:, :, 0:3], force) + columns[:, :, LOG_DENSITY]
    )
    return np.asarray((grown - columns[:, :, LOG_DIAMETER])[:, :, None])


def _chosen(columns: Array, by_length: Array) -> Array:
    """The columns of `Answers` from the rod's."""
    return np.concatenate([columns[:, :, GRAVITY], columns[:, :, LOG_E : LOG_DENSITY + 1], by_length,
                           columns[:, :, kernels.ALL_COLUMNS :]], axis=2)  # fmt: skip


def _d_weight(rod: Rod, gravity: Array) -> Array:
    """Of the flexible part's weight [N], (3, j)."""
    g, K = np.asarray(gravity, dtype=float), len(rod.s)
    found = np.zeros((3, 7 + K))
    found[:, 0:3] = rod.mass * np.eye(3)
    found[:, 5] = found[:, 6] = rod.mass * g
    found[:, 7:] = np.outer(g, rod.density * rod.body.volume_by_knot[0])
    return found


def d_slope(rod: Rod, contacts: Contacts) -> Array:
    """Of the frustum's half-angle [rad], (n, j)."""
    K = len(rod.s)
    i = np.clip(np.searchsorted(rod.s, contacts.s) - 1, 0, K - 2)
    apart, n = np.diff(rod.s)[i], np.arange(len(i))
    tangent = np.zeros((len(i), 7 + K))
    tangent[n, 7 + i], tangent[n, 8 + i] = rod.radius[i] / apart, -rod.radius[i + 1] / apart
    tangent[:, 6] = -np.tan(contacts.slope)
    return np.asarray(np.cos(contacts.slope)[:, None] ** 2 * tangent)


def _skews(v: Array) -> Array:
    """skew of each row, (n, 3, 3)."""
    found = np.zeros((len(v), 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        found[:, i, j], found[:, j, i] = -v[:, k], v[:, k]
    return found
