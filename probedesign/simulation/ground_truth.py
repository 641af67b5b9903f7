"""The truth of a synthetic campaign: the probe as it was printed, where it stands, and how each test bends it."""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from probedesign.errors import InputError
from probedesign.estimation.error_sources import parameters_of, turns_of
from probedesign.estimation.force_moment import surface_point
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import Tolerances
from probedesign.frames import Array, pose
from probedesign.prediction.touches import DIRECTIONS
from probedesign.prediction.worlds import printed
from probedesign.rod.contact import solve_frictionless
from probedesign.rod.equilibrium import Equilibrium
from probedesign.rod.friction import draw_friction, line_of_action, solve_surface_force
from probedesign.rod.rod import Rod
from probedesign.simulation.plan import Plan, touches_of, weights_of
from probedesign.units import MM

PLACE = (0.0, 0.0, 0.25)
"""Where the base is said to stand in the world [m]: above a table."""
STD_BASE = {"cameras": (0.2 * MM, math.radians(0.2)), "stage": (0.05 * MM, math.radians(0.05))}
"""How well that is known, on each axis [m], [rad]: assumed, a bracket measured by the cameras; a stage's repeatability
over the length of a probe."""
FREE = 2
"""Tests of the free probe: at the beginning and at the end."""
LEAST_HALVINGS = 12


@dataclass(frozen=True, eq=False)
class State:
    """The truth of one test.

    Attributes:
        name: of the test.
        equilibrium: of the true probe in its true base.
        p_surface_base: the touched point [m], (3,); None where nothing touches or a weight hangs.
        direction: of a touch.
        weight: force in the world as it is known, straight down [N], (3,); zero for a free probe, None for a touch.
        wrench_sensor: what a perfect sensor reads [N, N·m], (6,).
        s_contact: where the force's line of action passes the axis [m].
        friction: of a touch: tangential over normal force.
    """

    name: str
    equilibrium: Equilibrium
    p_surface_base: Array | None
    direction: str
    weight: Array | None
    wrench_sensor: Array
    s_contact: float
    friction: float = 0.0


@dataclass(frozen=True, eq=False)
class World:
    """The truth behind a campaign.

    Attributes:
        model: of the probe as designed.
        plan: of the campaign.
        rod: as printed.
        T_world_base: pose of the base as the campaign says it, (4, 4).
        T_world_mount: where that frame truly is, (4, 4).
        T_world_true: where the printed base truly is, (4, 4).
        gravity_said: as the campaign has it [m/s²], (3,).
        gravity_world: as it is.
        tolerances: all of it was drawn by.
    """

    model: ProbeModel
    plan: Plan
    rod: Rod
    T_world_base: Array
    T_world_mount: Array
    T_world_true: Array
    gravity_said: Array
    gravity_world: Array
    tolerances: Tolerances

    @classmethod
    def draw(cls, model: ProbeModel, plan: Plan, rng: np.random.Generator) -> "World":
        """Draw it.

        Raises:
            InputError: the design is mounted without gravity.
        """
        size = float(np.linalg.norm(model.gravity_base))
        if size == 0.0:
            raise InputError("mount.gravity_base_m_s2 is zero; a campaign needs gravity to tell up from down")
        tolerances = Tolerances.none() if plan.exact else Tolerances.of(model)
        said, T = np.array([0.0, 0.0, -size]), pose(_facing(model.gravity_base), PLACE)
        std_place, std_turn = (0.0, 0.0) if plan.exact else STD_BASE[plan.kind]
        mount = T @ _moved(rng.normal(size=3) * std_place, rng.normal(size=3) * std_turn)
        turns = np.zeros(9)
        for rows in turns_of(said, tolerances).values():
            turns += rng.normal(size=len(rows)) @ rows
        true = mount @ _moved(turns[0:3], turns[3:6])
        return cls(model, plan, _rod(model, plan, tolerances, rng), T, mount, true, said, said + turns[6:9],
                   tolerances)  # fmt: skip

    def states(self) -> list[State]:
        """Every test: free, weights, touches, free again.

        Raises:
            InputError: the probe cannot stand.
        """
        found = [self._free("hang-1")]
        if self.plan.kind == "cameras":
            for i, (fraction, newtons) in enumerate(weights_of(self.model), 1):
                found.append(self._loaded(f"weight-{i}", fraction, newtons))
        for i, touch in enumerate(touches_of(self.model), 1):
            found.append(self._touched(f"touch-{i:02d}", *touch))
        return [*found, self._free(f"hang-{FREE}")]

    @property
    def gravity_base(self) -> Array:
        """In the axes of the true base [m/s²], (3,)."""
        return np.asarray(self.T_world_true[:3, :3].T @ self.gravity_world)

    def to_world(self, points_base: Array) -> Array:
        """Points of the true base's frame in the world [m], (..., 3)."""
        return np.asarray(points_base @ self.T_world_true[:3, :3].T + self.T_world_true[:3, 3])

    def _free(self, name: str) -> State:
        return self._state(name, self.rod.solve(self.gravity_base), None, "", np.zeros(3))

    def _loaded(self, name: str, fraction: float, newtons: float) -> State:
        """A weight on a thread around the probe: a dead force on its axis, that of the greatest size that it bears."""
        down = self.gravity_world / np.linalg.norm(self.gravity_world)
        for _ in range(LEAST_HALVINGS):
            force_base = self.T_world_true[:3, :3].T @ (newtons * down)
            eq = self.rod.solve(self.gravity_base, force_base, fraction * self.rod.length)
            if eq.ok:
                break
            newtons /= 2.0
        return self._state(name, eq, None, "", np.array([0.0, 0.0, -newtons]))

    def _touched(self, name: str, fraction: float, newtons: float, direction: str) -> State:
        """A touch, as hard as planned or as the probe bears, with its own friction if the plan has any."""
        if self.plan.friction > 0.0:
            return self._rubbed(name, fraction, newtons, direction)
        s = fraction * self.rod.length
        for _ in range(LEAST_HALVINGS):
            found = solve_frictionless(self.rod, self.gravity_base, s, DIRECTIONS[direction], newtons)
            if found.result == "ok":
                break
            newtons /= 2.0
        eq = found.equilibrium
        return self._state(name, eq, surface_point(self.rod, eq) if eq.ok else None, direction, None)

    def _rubbed(self, name: str, fraction: float, newtons: float, direction: str) -> State:
        """A touch within Coulomb's cone: μ of its own, tangential force uniform in the circle of radius μ F_n."""
        rng = np.random.default_rng([self.plan.seed, 2, int(name.rsplit("-", 1)[1])])
        mu = draw_friction(self.plan.friction, self.plan.friction_spread, rng)
        size, turn = mu * math.sqrt(rng.random()), 2.0 * math.pi * rng.random()
        along = (size * math.cos(turn), size * math.sin(turn))
        s, angle = fraction * self.rod.length, DIRECTIONS[direction] + math.pi  # it lies against its push
        for _ in range(LEAST_HALVINGS):
            found = solve_surface_force(self.rod, self.gravity_base, s, angle, newtons, along)
            if found.result == "ok":
                break
            newtons /= 2.0
        eq, point = found.equilibrium, found.p_surface_base
        axis = line_of_action(self.rod, eq, point) if eq.ok else s
        return self._state(name, eq, point if eq.ok else None, direction, None, axis, size)

    def _state(
        self,
        name: str,
        eq: Equilibrium,
        surface: Array | None,
        direction: str,
        weight: Array | None,
        s_contact: float | None = None,
        friction: float = 0.0,
    ) -> State:
        if not eq.ok:
            raise InputError(
                f"test {name}: the probe cannot stand so ({eq.result}); a campaign needs one that can"
            )
        mount_true = np.linalg.inv(self.T_world_mount) @ self.T_world_true
        R, shift = mount_true[:3, :3], mount_true[:3, 3]
        force, moment = R @ eq.wrench_base[:3], R @ eq.wrench_base[3:]
        told = np.concatenate([force, moment + np.cross(shift, force)])
        pulled = self.T_world_mount[:3, :3].T @ self.gravity_world
        return State(name, eq, surface, direction, weight, self.model.to_sensor(told, pulled),
                     eq.s_contact if s_contact is None else s_contact, friction)  # fmt: skip


def _facing(gravity_base: Array) -> Array:
    """R_world_base with gravity down and the probe's axis along the world's x as far as it may be."""
    up = -gravity_base / np.linalg.norm(gravity_base)
    axis = np.array([0.0, 0.0, 1.0])
    across = axis - up * (up @ axis)
    if np.linalg.norm(across) < 0.1:  # it hangs or stands
        across = np.array([1.0, 0.0, 0.0]) - up * up[0]
    across /= np.linalg.norm(across)
    return np.array([across, np.cross(up, across), up])


def _moved(shift: Array, turn: Array) -> Array:
    return pose(Rotation.from_rotvec(turn).as_matrix(), shift)


def _rod(model: ProbeModel, plan: Plan, tolerances: Tolerances, rng: np.random.Generator) -> Rod:
    """Return the printed probe; the moduli that the plan names are its own, to the digit.

    What scatters from touch to touch is no property of the print.
    """
    K = len(model.rod.s)
    by = np.zeros(4 + K)
    for rows in parameters_of(model.rod, replace(tolerances, stiffness_scatter=0.0)).values():
        by += rng.normal(size=len(rows)) @ rows
    for i, (said, own) in enumerate(
        ((plan.youngs_modulus, model.rod.youngs_modulus), (plan.shear_modulus, model.rod.shear_modulus))
    ):
        if said is not None:
            by[i] = math.log(said / own)
    return printed(model.rod, by)
