"""Curved probes: rod and touches without noise against an independent solver, and processor time of an estimate."""

import math
import time
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.cases import GRAVITY
from benchmarks.coverage import CURVED
from benchmarks.timing import format_seconds, print_table
from benchmarks.touches import paper_models
from probedesign.core.frames import Array
from probedesign.core.units import MILLINEWTON, MM
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel, Tolerances
from tests.reference.cosserat import Touches, solve
from tests.reference.round_rods import Probes

TOUCHES, TIMED, ROUNDS = 400, 60, 5
FORCES, PLACES, MAX_FRICTION = (5.0 * MILLINEWTON, 100.0 * MILLINEWTON), (0.4, 0.95), 0.8
#: Smallest angle of a force to the plane of an arc, within which an arc is blind [deg].
BLIND = 15.0
LOCATED = 0.02 * MM  #: Largest error of a touch without noise that counts as located.
#: A tenth of the sensor's noise: what a reading without noise leaves open is then the model's.
SHARP = {"force_N": 1e-4, "moment_Nm": 1e-6}


def touches_of(model: ProbeModel, rng: np.random.Generator) -> Touches:
    """Return touches in all directions with friction 0 to 0.8, solved by `tests/reference`."""
    size = np.exp(rng.uniform(*np.log(FORCES), TOUCHES))
    mu, way = MAX_FRICTION * rng.random(TOUCHES), 2.0 * math.pi * rng.random(TOUCHES)
    push = np.column_stack([np.ones(TOUCHES), mu * np.cos(way), mu * np.sin(way)])
    force = size[:, None] * push / np.linalg.norm(push, axis=1)[:, None]
    s = rng.uniform(*PLACES, TOUCHES) * model.rod.length
    # The solver has a fixed number of steps between knots: with eight pieces its error is below that of the rod.
    knots = np.unique(np.concatenate([model.rod.s, np.linspace(0.0, model.rod.length, 9)]))
    rest = model.rod.rest_curvature
    rod = replace(
        model.rod, s=knots, radius=model.rod.radius_at(knots),
        rest_curvature=None if rest is None else np.stack([np.interp(knots, model.rod.s, u) for u in rest.T], axis=1),
    )  # fmt: skip
    rods = Probes.of([rod] * TOUCHES)
    touches = solve(rods, np.array(GRAVITY), s, rng.uniform(-math.pi, math.pi, TOUCHES), force, axes="surface")
    return touches.take(np.flatnonzero(touches.ok))


def differences(model: ProbeModel, touches: Touches) -> tuple[float, float]:
    """Return the largest distance of the contact [m] and the largest relative difference of the base moment."""
    points, moments = [], []
    for i, wrench in enumerate(touches.wrench):
        couple = np.cross(touches.p_surface[i] - touches.p_centre[i], touches.force[i])
        R = Rotation.from_quat(touches.tip[i], scalar_first=True).as_matrix()  # of several equilibria the same one
        guess = np.concatenate([R[:, 2], R[:, 0]])
        eq = model.rod.solve(
            GRAVITY, touches.force[i], touches.s[i], couple=couple, guess=guess, guess_only=True, mode="reference"
        )
        if eq.ok:
            points.append(float(np.linalg.norm(eq.p_contact_base - touches.p_centre[i])))
            moments.append(float(np.linalg.norm(eq.wrench_base[3:] - wrench[3:]) / np.linalg.norm(wrench[3:])))
    return max(points), max(moments)


def shares(model: ProbeModel, touches: Touches, seen: Array) -> tuple[float, float]:
    """Return the share of `ok` answers among the touches that count, and the share of those within `LOCATED`."""
    estimator = Estimator(model, Tolerances.none()).with_friction(math.inf).with_noise(**SHARP)
    found = [estimator.estimate(touches.wrench[i], GRAVITY) for i in np.flatnonzero(seen)]
    off = [np.linalg.norm(c.p_surface_base - touches.p_surface[i])
           for c, i in zip(found, np.flatnonzero(seen), strict=True) if c.ok]  # fmt: skip
    return len(off) / len(found), float(np.mean(np.array(off) <= LOCATED))


def report() -> None:
    """Print the table."""
    rows, calls = [], {}
    for name, axis in {"straight": (0.0, 0.0), **CURVED}.items():
        model = paper_models(axis=axis)["large"]
        touches = touches_of(model, np.random.default_rng(3))
        lean = np.degrees(np.arcsin(np.abs(touches.force[:, 0]) / np.linalg.norm(touches.force, axis=1)))
        seen = lean > BLIND if name.startswith("arc") else np.ones(len(lean), dtype=bool)
        point, moment = differences(model, touches)
        ok, located = shares(model, touches, seen)
        rows.append([name, f"{1e6 * point:.2g} µm", f"{moment:.1g}", f"{ok:.1%} of {seen.sum()}", f"{located:.1%}"])
        noise = np.random.default_rng(4).multivariate_normal(np.zeros(6), model.noise_base(), TIMED)
        calls[name] = Estimator(model), touches.wrench[:TIMED] + noise[: len(touches.wrench[:TIMED])]
    seconds = {name: np.full((ROUNDS, len(readings)), np.inf) for name, (_, readings) in calls.items()}
    for k in range(1 + ROUNDS):  # the first round compiles and fills caches
        for name, (estimator, readings) in calls.items():
            for i, reading in enumerate(readings):
                start = time.process_time()
                estimator.estimate(reading, GRAVITY)
                if k:
                    seconds[name][k - 1, i] = time.process_time() - start
    for row in rows:
        each = seconds[row[0]].min(axis=0)
        row += [format_seconds(float(np.median(each))), format_seconds(float(np.quantile(each, 0.9)))]
    print_table(
        f"The large probe along an axis, {TOUCHES} touches of 5 to 100 mN, friction 0 to {MAX_FRICTION}: rod against "
        f"an independent solver; without noise, arcs outside ±{BLIND:g}° of their plane; processor time of an estimate",
        ["axis", "contact point", "base moment", "ok", f"within {LOCATED / MM:g} mm", "median", "90 %"],
        rows,
    )
