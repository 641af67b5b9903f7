"""Static equilibrium of an MJCF file under a force at a point of the centreline, by Newton's method in MuJoCo."""

import math

import mujoco
import numpy as np
from scipy.linalg import eigh

from probedesign.simulation.twin import chain_of

FREE = 6  #: Coordinates of velocity of the mount, which is held.


class Twin:
    """A chain read from MJCF."""

    def __init__(self, xml: bytes, rod):
        self.model = mujoco.MjModel.from_xml_string(xml.decode())
        self.data = mujoco.MjData(self.model)
        self.hinges = self.model.numeric("hinge_s_m").data
        self.rest = rod.solve(mode="reference")
        self.first = chain_of(rod, len(self.hinges))[0].material  #: The part of the rod that is fixed to the mount.

    def point(self, s: float) -> tuple[int, np.ndarray]:
        """Return the body that has the section at s, and the section's centre in its frame."""
        i = int(np.searchsorted(self.hinges, s, side="right"))
        start = float(self.hinges[i - 1]) if i else 0.0
        local = self.rest.R_at(start).T @ (self.rest.p_at(s) - self.rest.p_at(start))
        return self.model.body(f"link_{i}" if i else "mount").id, local

    def at(self, body: int, local: np.ndarray) -> np.ndarray:
        """Return a point of a body in the world."""
        return self.data.xpos[body] + self.data.xmat[body].reshape(3, 3) @ local

    def residual(self, q: np.ndarray, body: int, local: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Return the moments that the hinges lack for equilibrium, the mount at its place."""
        model, data = self.model, self.data
        data.qpos[FREE + 1 :], data.qvel[:] = q, 0.0
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, jacobian, None, self.at(body, local), body)
        return (data.qfrc_bias - data.qfrc_passive - jacobian.T @ force)[FREE:]

    def stiffness(self, q: np.ndarray, body: int, local: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Return the derivative of the residual by central differences."""
        columns = []
        for step in 1e-6 * np.eye(len(q)):
            ahead, back = (self.residual(q + x, body, local, force) for x in (step, -step))
            columns.append((ahead - back) / 2e-6)
        return np.array(columns).T

    def load(self, gravity, force=(0.0, 0.0, 0.0), s: float = 0.0, steps: int = 3) -> np.ndarray:
        """Find the equilibrium under gravity [m/s²] and a force [N] at s [m], increased in steps.

        Returns:
            The loaded point [m], (3,).
        """
        body, local = self.point(s)
        q = np.zeros(self.model.nv - FREE)
        for fraction in np.linspace(0.0, 1.0, steps + 1)[1:]:
            self.model.opt.gravity[:] = fraction * np.asarray(gravity)
            F = fraction * np.asarray(force, dtype=float)
            for _ in range(30):
                r = self.residual(q, body, local, F)
                if np.abs(r).max() < 1e-11:
                    break
                change = np.linalg.solve(self.stiffness(q, body, local, F), -r)
                q = q + change * min(1.0, 0.3 / np.abs(change).max())
            else:
                raise AssertionError("no equilibrium of the twin was found")
        return self.at(body, local)

    def moment(self, p: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Return the moment of a force at p and of the weight of the whole rod about the base [N·m], (3,)."""
        model, data = self.model, self.data
        links = slice(model.body("link_1").id, None)
        weights = np.outer(model.body_mass[links], model.opt.gravity)
        fixed = np.cross(self.first.p_com, self.first.mass * model.opt.gravity)
        return np.cross(p, force) + np.cross(data.xipos[links], weights).sum(axis=0) + fixed

    def frequency(self, gravity) -> float:
        """Return the lowest natural frequency about the unloaded shape [Hz]."""
        self.model.opt.gravity[:] = gravity
        M = np.zeros((self.model.nv, self.model.nv))
        K = self.stiffness(np.zeros(self.model.nv - FREE), 0, np.zeros(3), np.zeros(3))
        mujoco.mj_fullM(self.model, self.data, M)
        lowest = eigh((K + K.T) / 2.0, M[FREE:, FREE:], eigvals_only=True, subset_by_index=(0, 0))[0]
        return math.sqrt(lowest) / (2.0 * math.pi)
