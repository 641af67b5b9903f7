"""Maps of simulated touches: a printed probe with all its errors presses points of objects.

The reference rod of `tests/reference/cosserat.py` shares no code with the estimator. One probe, mount, sensor and
robot with errors drawn from the priors makes all touches of a map; bias, scatter of stiffness, robot error, friction
and the yielding of the object are drawn for each touch. The estimator locates each touch as `explore` does, from the
readings of the presses and of the free probe before and after them.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.reference_probes import Perturbations, PriorStds
from benchmarks.reference_touches import solve_presses
from benchmarks.touches import paper_models
from probedesign.core.frames import Array, inverse, pose, wrench_map
from probedesign.core.units import MILLINEWTON, MM
from probedesign.estimation.estimator import Estimator
from probedesign.mapping.contact_map import ContactMap, build_map
from probedesign.mapping.segmentation import StationaryInterval, TouchSegment
from probedesign.mapping.touch_point import LocatedTouch, locate_touch, with_base
from probedesign.rod.friction import ASSUMED_FRICTION, ASSUMED_SPREAD
from probedesign.simulation.simulated_run import base_rotation

PRESSES = 6  #: Presses of a touch, in even steps up to the firm force.
FORCE = 4.5 * MILLINEWTON  #: Firm force [N].
READINGS = 50  #: Readings of each press, a quarter of a second of a Net F/T box averaged by 36.
STIFFNESS = (10.0, 1000.0)  #: Range of the stiffness of objects [N/m], log-uniform.
SLIDE = 0.5 * MM  #: Largest distance that a touch slides along the probe from the first to the last press. Assumed.
GRAVITY = np.array([0.0, 0.0, -9.81])  #: In the world [m/s²].
_PER_TOUCH = ("drift", "stiffness scatter", "robot", "object", "object walk")


@dataclass(frozen=True)
class Place:
    """A touch to be made."""

    x: Array  #: point of the object at rest in the world [m], (3,).
    normal: Array  #: outward normal of the object there, (3,).
    R: Array  #: R_world_base, (3, 3).
    fraction: float  #: place on the probe, as a fraction of its length.
    compliance: float = 0.0  #: of the object there [m/N].


class SimulatedMap:
    """Touches of one simulated probe."""

    def __init__(self, seed: int, probe: str = "large") -> None:
        """Draw probe, mount, sensor and robot."""
        self.rng, self.estimator = np.random.default_rng(seed), Estimator(paper_models()[probe])
        model = self.estimator.model
        self.priors = with_base(self.estimator.priors)
        self.perturbations = Perturbations.of(model, PriorStds.of(model), PRESSES)
        self._common = self.perturbations.draw(1, self.rng)
        self.touches: list[LocatedTouch] = []
        self.places: list[Place] = []

    def compliance(self) -> float:
        """Draw the compliance of an object [m/N]."""
        return float(np.exp(-self.rng.uniform(*np.log(STIFFNESS))))

    def touch(self, places: list[Place]) -> None:
        """Make and locate touches."""
        n, model, rng, perturbations = len(places), self.estimator.model, self.rng, self.perturbations
        z = perturbations.draw(n, rng)
        for source, slot in perturbations.slots.items():
            if source not in _PER_TOUCH:
                z[:, slot] = self._common[:, slot]
        z[:, perturbations.slots["object"]] = 0.0
        samples = perturbations.samples(z)
        g = np.array([place.R.T @ GRAVITY for place in places])
        gravity = np.einsum("nji,nj->ni", samples.R, g)
        samples = replace(samples, gravity=gravity, compliance=np.array([place.compliance for place in places]))
        free = [self.estimator.free(each) for each in g]
        # Force in the axes of the free probe's section: its flank gives normal and, on a face that leans, axial parts.
        L = model.rod.length
        sections = [each.R_at(min(place.fraction * L, L)) for each, place in zip(free, places, strict=True)]
        local = np.array([F.T @ place.R.T @ place.normal for F, place in zip(sections, places, strict=True)])
        phi = np.arctan2(-local[:, 1], -local[:, 0])
        across = np.hypot(local[:, 0], local[:, 1])
        mu = ASSUMED_FRICTION * np.exp(ASSUMED_SPREAD * rng.normal(size=n)) * np.sqrt(rng.uniform(size=n))
        angle = rng.uniform(-np.pi, np.pi, n)
        ratios = np.column_stack([mu * np.cos(angle), local[:, 2] / across + mu * np.sin(angle)])
        fraction = np.array([place.fraction for place in places])
        pressed = solve_presses(samples, z, fraction, phi, ratios, FORCE, SLIDE * rng.uniform(size=n))  # type: ignore[arg-type]
        step = np.sqrt(np.diag(model.noise.cov) * model.averaging_samples)
        to_base = wrench_map(inverse(model.T_sensor_base))
        noise = np.linalg.cholesky(model.noise_base()).T / np.sqrt(READINGS)
        bare = samples.perturbations.model.rod.solve(model.gravity_base).wrench_base
        for i, place in enumerate(places):
            number, nominal = len(self.touches) + 1, free[i].wrench_base
            after = samples.drift[i, -1] + self.priors.walk_steps * step * rng.normal(size=6)
            unloaded = nominal + np.array([np.zeros(6), after]) @ to_base.T + rng.normal(size=(2, 6)) @ noise
            wrenches = pressed.wrenches[i] - bare + nominal + rng.normal(size=(PRESSES, 6)) @ noise
            Ts = [pose(place.R, place.x + place.R @ p) for p in pressed.places[i]]
            before, *on, behind = [
                StationaryInterval(T, g[i], float(k), k + 1.0, READINGS, READINGS * w)
                for k, (T, w) in enumerate(
                    zip([Ts[0], *Ts, Ts[-1]], [unloaded[0], *wrenches, unloaded[1]], strict=True)
                )
            ]
            segment = TouchSegment(number, float(number), before, tuple(on), behind)
            found = LocatedTouch(segment, "gives_way")
            if pressed.ok[i]:
                found = locate_touch(segment, self.estimator, self.priors, GRAVITY)
            self.touches.append(found)
            self.places.append(place)

    @property
    def map(self) -> ContactMap:
        """Return the map, in which no touches are fused to one point."""
        return build_map(self.touches, self.priors.youngs_modulus, 0.0)


def towards(normal: Array, along: Array, lean: float = 0.0) -> Array:
    """Return R_world_base of a probe about along a direction that touches a surface by its side, or leans on it.

    Args:
        normal: outward normal of the surface, (3,).
        along: direction of the probe from base to tip, (3,); made perpendicular to the normal.
        lean: angle between probe and surface [rad].
    """
    t = along - (along @ normal) * normal
    t = np.cos(lean) * t / np.linalg.norm(t) - np.sin(lean) * normal
    R = base_rotation()
    turn = Rotation.align_vectors(t[None], R[:, 2][None])[0].as_matrix()
    return np.asarray(turn @ R)
