"""Coverage, NEES and error over bound of the estimators, by error source, friction and force.

`python -m benchmarks coverage [--draws N] [--only WORD] [--bounds]`

Probes, mounts, sensors, friction and touches are drawn from the priors, and their readings are simulated by the
reference rod of `tests/reference/cosserat.py`, which shares no code with the estimators. A draw is counted if the
Cramér–Rao bound of the touched point is below 6 mm, with all drawn error sources and the direction of the force
unknown; at a given place every draw counts.
"""

import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from benchmarks.error_statistics import CHI2_95, ErrorStatistics, nees
from benchmarks.reference_probes import PRESS_SOURCES, SOURCES, Perturbations, PriorStds, ProbeSamples
from benchmarks.reference_touches import (
    Presses,
    Readings,
    cramer_rao,
    evaluate_readings,
    fused_cramer_rao,
    position_rms,
    solve_presses,
)
from benchmarks.timing import print_table
from benchmarks.touches import paper_models
from probedesign.core.frames import Array, inverse, pose, wrench_map
from probedesign.core.units import MM
from probedesign.estimation.estimate import FusedEstimate
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import WALK_SECONDS, ProbeModel
from tests.reference.cosserat import solve

PLACES = (0.3, 0.95)  #: Range of the touched places over the length.
MAX_BOUND = 6.0 * MM  #: Largest bound of a draw that is counted.
MAX_BEND = 0.8  #: Largest F s²/(E I(0) r(s)/r(0)), which is about the angle by which the force bends the probe [rad].
TOUCHES = 5  #: Touches of a press.
#: Largest distance that a sliding touch moves along the probe from the first to the last touch. Assumed.
MAX_SLIDE = 1.0 * MM
SAMPLES = 36  #: Samples of each touch for the tracker; their mean is the reading for `fuse`.
MIN_STD = 1e-6  #: Smallest standard deviation of a point in any direction for its NEES [m].
FLATNESS = 0.6  #: Of the elliptic probes.
DRAWS, FUSED_DRAWS = 100, 30  #: Default numbers of single and of fused touches of each row.
JOB_DRAWS = 100  #: Fused touches that one process draws at a time.

#: Bend [deg] and turns of the curved axes: radii of 150, 100, 60 and 40 mm at a length of 150 mm.
CURVED = {"arc R 150": (57.3, 0.0), "arc R 100": (85.94, 0.0), "helix R 60, half a turn": (143.24, 0.5),
          "helix R 40, one turn": (214.86, 1.0)}  # fmt: skip

#: What `optimize` finds for 5 mN at 0.8 L within 60° of +x, the arc with distinction>=3 (docs/curved.md).
WHISKERS = {"arc of 49°": (49.0, 0.0, 90.0), "helix of 212°": (212.0, 0.965, 83.0)}

#: Ranges of the magnitude of the force [N].
DECADES = {"2-10 mN": (2e-3, 1e-2), "10-100 mN": (1e-2, 1e-1), "0.1-1 N": (1e-1, 1.0)}
ALL_SOURCES = tuple(SOURCES)
RIGID_SOURCES = tuple(source for source in ALL_SOURCES if source != "object")
#: Error sources of a single touch, whose point is in the base frame.
SINGLE_SOURCES = tuple(source for source in ALL_SOURCES if source not in PRESS_SOURCES)
#: Standard deviations stated for a probe after a short test of its stiffness.
BENCH = {"youngs_modulus": 0.03, "shear_modulus": 0.03}


@dataclass(frozen=True)
class Case:
    """One row of a table."""

    group: str  #: group, name: title of the table and label of the row.
    name: str
    sources: tuple[str, ...] = ()  #: error sources that are drawn.
    #: stated standard deviations that are not those of the design, by field of `Tolerances`.
    stated: Mapping[str, float] = field(default_factory=dict)
    #: range of the true sizes of error sources that are not drawn from their priors, log-uniform, in their units.
    sizes: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    friction: float | None = None  #: tangential over normal force, in a random direction; None draws it from the prior.
    forces: tuple[float, float] = (2e-3, 1.0)  #: smallest and largest force of a single touch [N].
    std_factor: float = 1.0  #: true over stated standard deviations.
    #: over the length; 0 draws the places of single touches. Where it is given, every draw counts.
    place: float = 0.0
    newtons: float = 0.0  #: largest normal force of fused touches [N]; 0 for single touches.
    sector: float = 180.0  #: half the range of a single touch's direction about +x [deg].
    kind: str = "estimate"  #: "estimate", "moments", "all six" or "tracker".
    sticks: bool = False  #: whether the touched material point stays the same during a press.
    anew: bool = False  #: whether the direction of the friction is drawn anew at each touch of a press.
    flatness: float = 1.0  #: of the probes' sections; only single touches.
    axis: tuple[float, ...] = (0.0, 0.0)  #: see `paper_models`; curved rows are of the large probe.
    # The following are conditions that the estimators do not know.
    stiffness_factor: float = 1.0  #: factor or divisor of E and G, alternately.
    pulls: bool = False  #: whether the force is directed away from the object.
    #: exponent of the yielding by the force; it is that of the linear object under the force of the last touch.
    exponent: float = 1.0
    #: object_step, tips, bias_steps: steps between the third and the fourth of five touches: of the object [m], in a
    #: random direction or, if it tips over, in that of the force on it; and of the bias [resolution].
    object_step: float = 0.0
    tips: bool = False
    bias_steps: float = 0.0


def single_cases() -> list[Case]:
    """Return the rows of single touches."""
    by_source = partial(Case, "One touch, by error source; friction drawn from the prior")
    cases = [by_source("sensor noise alone")]
    cases += [by_source(source, (source,)) for source in SINGLE_SOURCES]
    cases += [
        by_source("all together", SINGLE_SOURCES),
        by_source("all, true spread twice the stated", SINGLE_SOURCES, std_factor=2.0),
    ]
    flat = partial(Case, "One touch of elliptic probes; friction drawn from the prior", flatness=FLATNESS)
    cases += [flat("flatness 0.6, sensor noise alone"), flat("flatness 0.6, all together", SINGLE_SOURCES)]
    for title, sources in (("sensor noise alone", ()), ("all error sources", SINGLE_SOURCES)):
        group = f"One touch, by friction and force; {title}"
        for mu in (0.0, 0.2, 0.5, 0.8, None):
            name = "drawn from the prior" if mu is None else f"{mu:g}"
            cases += [Case(group, f"friction {name}, {decade}", sources, friction=mu, forces=forces)
                      for decade, forces in DECADES.items()]  # fmt: skip
    return cases


def fused_cases() -> list[Case]:
    """Return the rows of fused touches of the large probe."""
    cases, some = [], ("E", "G", "drift", "robot")
    of = partial(Case, "Five touches of the large probe, 3 % on E and G, 0.01 mm poses, drift", sources=some,
                 stated=BENCH)  # fmt: skip
    for place in (0.5, 0.8):
        for newtons in (2e-3, 5e-3):
            for kind in ("all six", "moments"):
                name = f"{place:g} L, up to {1e3 * newtons:g} mN, {kind}, friction "
                cases += [of(name=f"{name}{mu:g}", friction=mu, place=place, newtons=newtons, kind=kind)
                          for mu in (0.0, 0.3, 0.6)]  # fmt: skip
    at = partial(replace, of(name="", place=0.8, newtons=5e-3, kind="all six"))
    cases += [at(name=f"0.8 L, up to 5 mN, all six, friction {mu:g}, anew at each touch", friction=mu, anew=True)
              for mu in (0.3, 0.6)]  # fmt: skip
    cases.append(at(name="0.8 L, up to 5 mN, all six, friction 0.3, sticks", friction=0.3, sticks=True))
    cases.append(at(name="0.8 L, up to 5 mN, tracker, friction 0.3", friction=0.3, kind="tracker"))
    every = at(group="Five touches of the large probe, 0.8 L, up to 5 mN, all six; friction drawn from the prior",
               stated={})  # fmt: skip
    cases.append(replace(every, name="sensor noise alone", sources=()))
    cases += [replace(every, name=source, sources=(source,)) for source in ALL_SOURCES]
    cases.append(replace(every, name="all together", sources=ALL_SOURCES))
    cases.append(replace(every, name="all together, moments alone", sources=ALL_SOURCES, kind="moments"))
    cases.append(replace(every, name="all together, tracker", sources=ALL_SOURCES, kind="tracker"))
    cases.append(replace(every, name="all, true spread twice the stated", sources=ALL_SOURCES, std_factor=2.0))
    return cases


def yielding_cases() -> list[Case]:
    """Return the rows of fused touches of an object that yields, with all error sources drawn."""

    def case(prior: float, name: str, compliance: tuple[float, float] | None, **changes: Any) -> Case:
        """Return a row with a compliance of the object in a range [m/N]; None draws it from its prior."""
        return replace(
            Case(f"Five touches of the large probe, object with a prior of {prior:g} m/N", name,
                 ALL_SOURCES if prior else RIGID_SOURCES, BENCH | {"object_compliance": prior},
                 {} if compliance is None else {"object": compliance}, place=0.8, newtons=5e-3, kind="all six"),
            **changes,
        )  # fmt: skip

    where = [(place, newtons, f"{place:g} L, up to {1e3 * newtons:g} mN")
             for newtons in (5e-3, 20e-3) for place in (0.5, 0.6, 0.7, 0.8, 0.9)]  # fmt: skip
    objects = [(0.05, k) for k in (10.0, 20.0, 50.0, 100.0, 1000.0)] + [(0.2, k) for k in (5.0, 10.0)]
    cases = [case(prior, f"{k:g} N/m, {name}", (1.0 / k, 1.0 / k), place=place, newtons=newtons)
             for prior, k in objects for place, newtons, name in where]  # fmt: skip
    cases += [case(prior, f"drawn from the prior, {name}", None, place=place, newtons=newtons)
              for prior in (0.05, 0.2) for place, newtons, name in where]  # fmt: skip
    rigid = (0.0, 0.0)
    cases += [
        case(0.05, "rigid", rigid),
        replace(case(0.0, "rigid", None), group="Five touches of the large probe, rigid object"),
        case(0.05, "20 N/m, tracker", (0.05, 0.05), kind="tracker"),
        case(0.2, "card house of 5 to 50 N/m, friction 0.5", (0.02, 0.2), friction=0.5),
        case(0.05, "card house of 5 to 50 N/m, friction 0.5", (0.02, 0.2), friction=0.5),
    ]
    for prior, k in ((0.05, 20.0), (0.2, 5.0)):
        cases += [
            case(prior, f"Hertz, {k:g} N/m, up to {1e3 * newtons:g} mN", (1.0 / k, 1.0 / k), exponent=2.0 / 3.0,
                 newtons=newtons)
            for newtons in (5e-3, 20e-3)
        ]  # fmt: skip
    cases += [
        case(0.05, f"20 N/m, tips over by {step:g} mm", (0.05, 0.05), object_step=step * MM, tips=True)
        for step in (0.5, 2.0)
    ]
    loose = {"object_compliance": 0.05, "object_walk_mm": 0.3}
    walks = tuple(source for source in ALL_SOURCES if source != "object walk")
    cases += [
        case(0.05, "walks by 0.3 mm, as stated", None, stated=BENCH | loose),
        case(0.05, "moves once by 0.5 mm, walk of 0.3 mm stated", None, stated=BENCH | loose,
             sizes={"object walk": (0.0, 0.0)}, object_step=0.5 * MM),
        case(0.05, "moves once by 0.5 mm, no walk stated", None, sources=walks, object_step=0.5 * MM),
    ]  # fmt: skip
    return cases


def bent_cases() -> list[Case]:
    """Return the rows of prints that are bent by a given deviation of the tip, with all other error sources drawn."""
    one = Case("Bent prints with a prior of 1.5 mm", "", SINGLE_SOURCES, BENCH | {"bow_mm": 1.5}, forces=(5e-3, 50e-3))
    five = replace(one, sources=RIGID_SOURCES, place=0.8, newtons=5e-3, kind="all six")
    return [replace(case, name=f"{count}, bent by {bow:g} mm", sizes={"bow": (bow, bow)})
            for count, case in (("one touch, 5-50 mN", one), ("five touches, 0.8 L, up to 5 mN", five))
            for bow in (1.0, 2.0, 3.0)]  # fmt: skip


def curved_cases() -> list[Case]:
    """Return the rows of curved probes, E and G to 3 %: single touches, and fused ones of an object that yields."""
    cases = []
    for name, axis in CURVED.items():
        one = Case("One touch of the large probe along a curved axis", name, SINGLE_SOURCES, BENCH, axis=axis,
                   forces=(2e-3, 0.1))  # fmt: skip
        cases += [replace(one, name=f"{name}, sensor noise alone", sources=()), one]
        cases += [replace(one, name=f"{name}, {low:g}-{high:g} mN", forces=(1e-3 * low, 1e-3 * high))
                  for low, high in ((2, 5), (5, 10), (10, 100))]  # fmt: skip
    whisking = replace(one, stated=BENCH | {"bow_mm": 1.0}, forces=(5e-3, 5e-3), place=0.8, sector=60.0)
    cases += [
        replace(whisking, name=f"{name}, 5 mN at 0.8 L within 60° of +x", axis=axis) for name, axis in WHISKERS.items()
    ]
    fused = Case(
        "Five touches of the large probe along a curved axis, 0.5 L, up to 5 mN, object with a prior of 0.05 m/N",
        "",
        ALL_SOURCES,
        BENCH | {"object_compliance": 0.05},
        place=0.5,
        newtons=5e-3,
        kind="all six",
    )
    for name, axis in ({"straight": (0.0, 0.0)} | CURVED).items():
        cases += [replace(fused, name=f"{name}, {k:g} N/m", axis=axis, sizes={"object": (1.0 / k, 1.0 / k)})
                  for k in (20.0, 1000.0)]  # fmt: skip
    return cases


def model_error_cases() -> list[Case]:
    """Return the rows of readings that the estimators should refuse."""
    single = Case("Readings that no single contact explains, all error sources", "", SINGLE_SOURCES)
    press = replace(single, sources=ALL_SOURCES, place=0.8, newtons=5e-3, kind="all six")
    return [
        replace(single, name="one touch, E and G off by 20 %", stiffness_factor=1.2),
        replace(single, name="one touch that pulls", pulls=True),
        replace(press, name="five touches, E and G off by 20 %", stiffness_factor=1.2),
        replace(press, name="five touches, the object moves by 1 mm", object_step=1.0 * MM),
        replace(press, name="five touches, the bias jumps by 5 steps", bias_steps=5.0),
    ]


def estimator_for(model: ProbeModel, priors: PriorStds) -> Estimator:
    """Return the estimator with these priors."""
    return Estimator(model).with_tolerances(priors.tolerances())


def track(estimator: Estimator, samples: Array, Ts: Array) -> FusedEstimate:
    """Return the estimate of the tracker after the last sample, given (k, SAMPLES, 6)."""
    from probedesign.estimation.tracker import Tracker  # its kernels load slowly and few rows need them

    tracker = Tracker(estimator, gravity_world=estimator.model.gravity_base)
    clock, found = 0.0, FusedEstimate("not_converged")
    for readings, T in zip(samples, Ts, strict=True):
        for wrench in readings:
            clock += 1.0 / 7000.0
            found = tracker.update(wrench, T, clock, touching="contact")
        clock += WALK_SECONDS  # the time between readings that `fuse` assumes if no times are given
    return found


# Single touches


def run_single(case: Case, probe: str, n: int, seed: int) -> ErrorStatistics:
    """Draw and locate about n touches of one probe that are counted."""
    model, rng = paper_models(case.flatness, case.axis)[probe], np.random.default_rng(seed)
    statistics, stated = ErrorStatistics(MIN_STD), _stated_priors(case, model)
    perturbations = Perturbations.of(model, stated.scaled(case.std_factor))
    estimator, noise = estimator_for(model, stated), model.noise_base()
    fraction, newtons = _draw_touches(model, case.forces, n, rng)
    if case.place:
        fraction[:] = case.place
    n = len(fraction)
    if n == 0:
        return statistics
    # Draws that all rows have in common come first, so that rows differ only by their perturbations.
    ratios, phi = _draw_ratios(case, model, n, rng), np.radians(case.sector) * rng.uniform(-1.0, 1.0, n)
    phi += np.pi * (case.sector < 180.0)  # an object that pushes towards +x touches the side at -x
    scatter = rng.normal(size=(n, 6)) @ np.linalg.cholesky(noise).T
    z = _with_sizes(case, perturbations, perturbations.draw(n, rng), rng)
    samples = perturbations.samples(z)
    force = newtons[:, None] * np.column_stack([np.ones(n), ratios])
    force /= np.sqrt(1.0 + (ratios**2).sum(axis=1))[:, None]

    def touched(samples: ProbeSamples, force: Array, columns: bool) -> Readings:
        s = fraction * samples.probes.length
        touches = solve(samples.at_touch(0), samples.gravity, s, phi, force, axes="surface")
        return evaluate_readings(samples, z, touches, samples.free_wrench(), columns=columns)

    readings = touched(samples, force, columns=True)
    bounds = position_rms(cramer_rao(readings, noise))
    if case.pulls or case.stiffness_factor != 1.0:
        readings = touched(_with_wrong_stiffness(case, samples), -force if case.pulls else force, columns=False)
    wrenches = readings.wrench + scatter
    for i in np.flatnonzero(readings.touches.ok & ((bounds < MAX_BOUND) | (case.place > 0.0))):
        if model.in_range(model.to_sensor(wrenches[i], model.gravity_base)):
            found = estimator.estimate(wrenches[i], model.gravity_base)
            statistics.add(found.result, found.p_surface_base - readings.point[i], found.cov_surface_base,
                           float(bounds[i]))  # fmt: skip
    return statistics


def _draw_touches(
    model: ProbeModel, forces: tuple[float, float], n: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Draw places over the length and forces [N] that bend the probe moderately and may have a small enough bound.

    The error of one touch of a straight probe is at least about s σ_F/F, so lighter touches need not be solved.
    """
    rod = model.rod
    low, high = np.log(forces)
    fraction, newtons = rng.uniform(*PLACES, 200 * n), np.exp(rng.uniform(low, high, 200 * n))
    s = fraction * rod.length
    stiffness = rod.factors[1] * rod.youngs_modulus * np.pi / 4.0 * rod.radius[0] ** 3 * rod.radius_at(s)
    moderate = newtons * s * s < MAX_BEND * stiffness
    strong = newtons > (0.9 * s * model.noise.force / MAX_BOUND if rod.rest_curvature is None else 0.0)
    rows = np.flatnonzero(moderate & strong)[:n]
    return fraction[rows], newtons[rows]


def _draw_ratios(case: Case, model: ProbeModel, n: int, rng: np.random.Generator) -> Array:
    """Draw tangential over normal force, around and along: (n, 2), or (TOUCHES, n, 2) if drawn at each touch."""
    if case.anew:
        once = replace(case, anew=False)
        return np.array([_draw_ratios(once, model, n, rng) for _ in range(TOUCHES)])
    from_prior, direction = rng.normal(size=(n, 2)), rng.uniform(-np.pi, np.pi, n)
    if case.friction is None:
        return model.friction * from_prior
    return case.friction * np.column_stack([np.cos(direction), np.sin(direction)])


# Light touches

LIGHT = "Light touches of the large probe, friction anywhere in a cone of 0.6"
LIGHT_FORCES = tuple(k / 2e3 for k in range(2, 25))  #: [N].
CONE = 0.6  #: Tangential over normal force, at most. Assumed.


def light_row(job: tuple[bool, float, int]) -> dict[str, Any]:
    """Draw and locate touches of one force, by the default or by the exact estimator; return the shares of the results.

    Unlike in the other rows every draw counts. The interval holds if it contains the arclength where the line of action
    of the force comes nearest to the tangent of the axis at the touched section.
    """
    exact, newtons, n = job
    model, rng = paper_models()["large"], np.random.default_rng(round(1e5 * newtons))
    stated = PriorStds.of(model).only(() if exact else SINGLE_SOURCES)
    perturbations, estimator = Perturbations.of(model, stated), estimator_for(model, stated)
    direction, phi = rng.uniform(-np.pi, np.pi, (2, n))
    ratios = CONE * np.sqrt(rng.uniform(size=(n, 1))) * np.column_stack([np.cos(direction), np.sin(direction)])
    force = newtons * np.column_stack([np.ones(n), ratios]) / np.sqrt(1.0 + (ratios**2).sum(axis=1))[:, None]
    scatter = rng.normal(size=(n, 6)) @ np.linalg.cholesky(model.noise_base()).T
    z = perturbations.draw(n, rng)
    samples, fraction = perturbations.samples(z), rng.uniform(*PLACES, n)
    touches = solve(samples.at_touch(0), samples.gravity, fraction * samples.probes.length, phi, force, axes="surface")
    readings = evaluate_readings(samples, z, touches, samples.free_wrench(), columns=False)
    f, t = touches.force / newtons, touches.R[:, :, 2]
    along = (f * t).sum(axis=1)
    arm = ((touches.p_surface - touches.p_centre) * (t - along[:, None] * f)).sum(axis=1)
    s_true, statistics, held = touches.s + arm / (1.0 - along**2), ErrorStatistics(MIN_STD), []
    for i in np.flatnonzero(touches.ok):
        found = estimator.estimate(readings.wrench[i] + scatter[i], model.gravity_base)
        statistics.add(found.result, found.p_surface_base - readings.point[i], found.cov_surface_base, 1.0)
        if found.result == "interval_only":
            held.append(bool(found.s_interval_95[0] <= s_true[i] <= found.s_interval_95[1]))
    n = statistics.results.total()
    return {"estimator": "exact" if exact else "default", "force_mN": 1e3 * newtons, "draws": n,
            "ok_share": len(statistics.nees) / n,
            "ok_outside_share": (len(statistics.nees) - statistics.n_inside_95) / n,
            "interval_only_share": len(held) / n,
            "interval_only_misses_share": (len(held) - sum(held)) / n}  # fmt: skip


# Fused touches


@dataclass(frozen=True)
class PressDraws:
    """Random values of n presses apart from their error sources."""

    phi: Array  #: angle of the first touch about the section [rad], (n,).
    ratios: Array  #: tangential over normal force, see `solve_presses`.
    aside: Array | None  #: aside, slide: see `solve_presses`.
    slide: Array
    direction: Array  #: of the object's step, (n, 3), unit vectors.
    signs: Array  #: of the bias's step, (n, 6).

    @classmethod
    def of(cls, case: Case, model: ProbeModel, n: int, rng: np.random.Generator) -> "PressDraws":
        """Draw the values of n presses."""
        ratios, phi = _draw_ratios(case, model, n, rng), rng.uniform(-np.pi, np.pi, n)
        aside, slide = rng.uniform(-0.1, 0.1, n) if case.sticks else None, rng.uniform(0.0, MAX_SLIDE, n)
        direction = rng.normal(size=(n, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        return cls(phi, ratios, aside, slide, direction, rng.choice([-1.0, 1.0], (n, 6)))


def simulate_presses(case: Case, perturbations: Perturbations, z: Array, drawn: PressDraws) -> tuple[Presses, Array]:
    """Return presses with the conditions of the case that the estimators do not know, and readings, (n, k, 6)."""
    model, samples = perturbations.model, _with_wrong_stiffness(case, perturbations.samples(z))
    pressed = solve_presses(samples, z, case.place, drawn.phi, drawn.ratios, case.newtons, drawn.slide,
                            aside=drawn.aside)  # fmt: skip
    size = np.linalg.norm(pressed.yielded, axis=2, keepdims=True)
    with np.errstate(invalid="ignore"):
        yielded = pressed.yielded * np.nan_to_num((size / size[:, -1:]) ** (case.exponent - 1.0))
        direction = pressed.yielded / size if case.tips else drawn.direction[:, None]
    after = (np.arange(TOUCHES) >= 3)[:, None]
    step = after * case.object_step * direction
    places = pressed.places + yielded - pressed.yielded + step
    unit = np.sqrt(np.diag(model.noise.cov) * model.averaging_samples)
    jump = case.bias_steps * unit * drawn.signs @ wrench_map(inverse(model.T_sensor_base)).T
    return replace(pressed, places=places, rest=pressed.rest + step, yielded=yielded), (
        pressed.wrenches + after * jump[:, None]
    )


def run_fused(case: Case, n: int, seed: int) -> ErrorStatistics:
    """Draw and fuse n presses of the large probe."""
    model, rng = paper_models(1.0, case.axis)["large"], np.random.default_rng(seed)
    statistics = ErrorStatistics(MIN_STD)
    stated = _stated_priors(case, model)
    perturbations = Perturbations.of(model, stated.scaled(case.std_factor), TOUCHES)
    estimator, noise = estimator_for(model, stated), model.noise_base()
    drawn = PressDraws.of(case, model, n, rng)
    z = _with_sizes(case, perturbations, perturbations.draw(n, rng), rng)
    pressed, wrenches = simulate_presses(case, perturbations, z, drawn)
    compliance = pressed.samples.compliance
    bound, std = _fused_bound(case, stated, float(compliance.mean()))
    width = _interval_width(compliance, std, stated["object_compliance"])
    root = np.linalg.cholesky(noise).T
    for i in np.flatnonzero(pressed.ok):
        Ts = _poses(pressed.places[i])
        if case.kind == "tracker":
            scatter = math.sqrt(model.averaging_samples) * rng.normal(size=(TOUCHES, SAMPLES, 6)) @ root
            found = track(estimator, wrenches[i][:, None] + scatter, Ts)
        else:
            noisy = wrenches[i] + rng.normal(size=(TOUCHES, 6)) @ root
            found = estimator.fuse(noisy, Ts, model.gravity_base, moments_only=case.kind == "moments")
        others, rest = dict[str, float](), pressed.rest[i, -1]
        if found.ok and std > 0.0:
            low, high = found.object_compliance_interval_95
            now = found.p_surface_now_world - rest - pressed.yielded[i, -1]
            others = {
                "now_inside_95_share": nees(now, found.cov_surface_now_world, MIN_STD) <= CHI2_95,
                "compliance_inside_95_share": low <= compliance[i] <= high,
                "compliance_width_m_N": high - low,
                "compliance_width_over_bound": (high - low) / width[i],
            }
        statistics.add(found.result, found.p_surface_world - rest, found.cov_surface_world, bound, **others)
    return statistics


def _poses(places: Array) -> Array:
    return np.array([pose(np.eye(3), p) for p in places])


def _stated_priors(case: Case, model: ProbeModel) -> PriorStds:
    priors = PriorStds.of(model)
    return PriorStds({**priors.by_name, **case.stated}).only(case.sources)


def _with_sizes(case: Case, perturbations: Perturbations, z: Array, rng: np.random.Generator) -> Array:
    """Return perturbations in which the error sources have the sizes that the case states."""
    for source, (low, high) in case.sizes.items():
        perturbations.fix(z, source, low * (high / max(low, 1e-12)) ** rng.uniform(size=len(z)), rng)
    return z


def _with_wrong_stiffness(case: Case, samples: ProbeSamples) -> ProbeSamples:
    """Return the samples, alternately stiffer and softer by the factor of the case."""
    factor = case.stiffness_factor ** np.where(np.arange(len(samples.gravity)) % 2, 1.0, -1.0)
    probes = samples.probes
    return replace(samples, probes=replace(probes, E=factor * probes.E, G=factor * probes.G))


def _interval_width(compliance: Array, std: float, prior: float) -> Array:
    """Return the width of the shortest 95 % interval of compliances of a given bound [m/N], (n,).

    The posterior is normal with the standard deviation of the bound and its expected mean, cut off at zero.
    """
    mean = compliance * (1.0 - (std / prior) ** 2) / std if std > 0.0 else np.zeros_like(compliance)
    positive = ndtr(mean)
    half = ndtri(0.5 + 0.475 * positive)
    return std * np.where(mean >= half, 2.0 * half, mean + ndtri(1.0 - 0.05 * positive))


_NOMINAL_PRESSES: dict[Any, Presses] = {}


def _fused_bound(case: Case, stated: PriorStds, compliance: float) -> tuple[float, float]:
    """Return the bounds of the RMS error [m] and of the object's compliance [m/N] for the probe as designed.

    They are root mean squares over six directions of the touch, for an object of a given compliance [m/N]. The friction
    has its prior, whose information is evaluated at the touch without friction, as in the table of bounds.
    """
    model = paper_models(1.0, case.axis)["large"]
    key = (tuple(stated.by_name.items()), case.place, case.newtons, case.axis)
    if key not in _NOMINAL_PRESSES:
        perturbations = Perturbations.of(model, stated, TOUCHES)
        phi = np.linspace(-np.pi, np.pi, 6, endpoint=False)
        z = np.zeros((len(phi), perturbations.size))
        _NOMINAL_PRESSES[key] = solve_presses(perturbations.samples(z), z, case.place, phi, np.zeros((len(phi), 2)),
                                              case.newtons, np.zeros(len(phi)), columns=True)  # fmt: skip
    pressed = _NOMINAL_PRESSES[key]
    pressed = replace(pressed, samples=replace(pressed.samples, compliance=np.full(len(pressed.ok), compliance)))
    cov = fused_cramer_rao(pressed, model.noise_base(), model.friction, case.kind == "moments")[pressed.ok]
    return (float(np.sqrt(np.nanmean(position_rms(cov[:, :3, :3]) ** 2))),
            float(np.sqrt(np.nanmean(cov[:, 3, 3]))))  # fmt: skip


# Tables


def _run(job: tuple[Case, str, int, int]) -> ErrorStatistics:
    case, probe, n, seed = job
    return run_fused(case, n, seed) if case.newtons else run_single(case, probe, n, seed)


def run(cases: Sequence[Case], draws: int, fused_draws: int, workers: int,
        progress: Callable[[str], None]) -> list[tuple[Case, dict[str, Any]]]:  # fmt: skip
    """Run the cases in worker processes and return their statistics."""
    jobs: list[tuple[int, tuple[Case, str, int, int]]] = []
    for i, case in enumerate(cases):
        # All rows have the same seeds, so that they do not differ by their touches.
        if case.newtons:  # long rows are divided among the workers
            parts = np.array_split(np.arange(fused_draws), -(-fused_draws // JOB_DRAWS))
            jobs += [(i, (case, "large", len(part), 1 + j)) for j, part in enumerate(parts)]
        else:
            probes = tuple(paper_models()) if case.axis == (0.0, 0.0) else ("large",)
            jobs += [(i, (case, probe, -(-draws // len(probes)), 10 + j)) for j, probe in enumerate(probes)]
    totals, began = [ErrorStatistics() for _ in cases], time.monotonic()
    with ProcessPoolExecutor(max_workers=workers) as pool:
        each = [job for _, job in jobs]
        statistics = map(_run, each) if workers == 1 else pool.map(_run, each)
        for done, ((i, job), found) in enumerate(zip(jobs, statistics, strict=True), 1):
            totals[i].join(found)
            progress(f"{done} of {len(jobs)}, {time.monotonic() - began:.0f} s: {job[0].name}, {job[1]}")
    return [(case, total.summary()) for case, total in zip(cases, totals, strict=True)]


#: Columns by the names of `ErrorStatistics.summary`, each with its format; a table leaves out those without values.
#: "refused of wrong" counts estimates with an error above three standard deviations or that are refused as wrong.
COLUMNS = {
    "draws": ("draws", "d"),
    "ok_share": ("ok", ".1%"),
    "inside_95_share": ("in 95 %", ".1%"),
    "inside_95_std": ("±", ".1%"),
    "ok_and_outside_share": ("ok and outside", ".1%"),
    "rms_mm": ("RMS [mm]", ".2f"),
    "rms_over_stated": ("RMS / stated", ".2f"),
    "rms_over_bound": ("RMS / bound", ".2f"),
    "bound_mm": ("bound [mm]", ".2f"),
    "mean_nees": ("NEES (expected 3)", ".2f"),
    "flagged_of_wrong_share": ("refused of wrong", ".1%"),
    "now_inside_95_share": ("now in 95 %", ".1%"),
    "compliance_inside_95_share": ("compliance in 95 %", ".1%"),
    "compliance_width_m_N": ("its width [m/N]", ".3f"),
    "compliance_width_over_bound": ("width / bound", ".2f"),
}


def _print_group(group: str, rows: Sequence[tuple[Case, dict[str, Any]]]) -> None:
    names = [name for name in COLUMNS if any(found.get(name) is not None for _, found in rows)]
    table = []
    for case, found in rows:
        cells = ["-" if found.get(name) is None else format(found[name], COLUMNS[name][1]) for name in names]
        others = ", ".join(f"{code} {n}" for code, n in found["results"].items() if code != "ok") or "none"
        table.append([case.name, *cells, others])
    print_table(group, ["case", *(COLUMNS[name][0] for name in names), "other results"], table)


def bounds() -> list[dict[str, Any]]:
    """Return the bounds of one touch of the large probe across gravity, by place, force and friction [mm]."""
    model, rows = paper_models()["large"], []
    perturbations = Perturbations.of(model, PriorStds.of(model).only(()))
    for fraction, forces in ((0.4, (5, 20, 50)), (0.6, (5, 20, 50)), (0.8, (5, 20, 50)), (0.95, (5, 20))):
        z = np.zeros((len(forces), 0))
        samples = perturbations.samples(z)
        push = np.array([[1e-3 * force, 0.0, 0.0] for force in forces])
        touches = solve(samples.probes, samples.gravity, fraction * samples.probes.length, np.pi / 2.0, push,
                        axes="surface")  # fmt: skip
        readings = evaluate_readings(samples, z, touches, samples.free_wrench())
        found = {mu: position_rms(cramer_rao(readings, model.noise_base(), mu)) / MM
                 for mu in (0.0, 0.3, 0.6, math.inf)}  # fmt: skip
        rows += [{"contact_fraction": fraction, "force_mN": force,
                  "bound_mm": {f"{mu:g}": float(value[i]) for mu, value in found.items()}}
                 for i, force in enumerate(forces)]  # fmt: skip
    return rows


def print_bounds(rows: Sequence[dict[str, Any]]) -> None:
    """Print the table of bounds."""
    print_table("Cramér–Rao bound of the touched surface point [mm], one touch, large probe, across gravity",
                ["place, force", "friction 0", "0.3", "0.6", "direction free"],
                [[f"{row['contact_fraction']:g} L, {row['force_mN']} mN",
                  *(f"{value:.2f}" for value in row["bound_mm"].values())] for row in rows])  # fmt: skip


def report(draws: int = DRAWS, only: str | None = None, bounds_only: bool = False, workers: int = 2) -> None:
    """Print the tables.

    Args:
        draws: single touches of each row; rows of fused touches have 0.3 of that.
        only: run only rows whose group or name contains this text, ignoring case; None runs all rows.
        bounds_only: print the bounds of one touch instead.
        workers: number of processes.
    """
    if bounds_only:
        print_bounds(bounds())
        return
    light = list[dict[str, Any]]()
    if only is None or only.lower() in LIGHT.lower():
        with ProcessPoolExecutor(max_workers=workers) as pool:
            light = list(pool.map(light_row, [(exact, newtons, draws) for exact in (False, True)
                                              for newtons in LIGHT_FORCES]))  # fmt: skip
    every = (*single_cases(), *fused_cases(), *yielding_cases(), *bent_cases(), *curved_cases(), *model_error_cases())
    cases = [case for case in every if only is None or only.lower() in f"{case.group}, {case.name}".lower()]
    fused_draws = max(1, round(draws * FUSED_DRAWS / DRAWS))
    found = run(cases, draws, fused_draws, workers, lambda line: print(line, file=sys.stderr, flush=True))
    if light:
        shares = ("ok_share", "ok_outside_share", "interval_only_share", "interval_only_misses_share")
        print_table(LIGHT, ["estimator", "force", "draws", "ok", "ok, but outside", "interval_only", "but outside"],
                    [[row["estimator"], f"{row['force_mN']:g} mN", str(row["draws"]),
                      *(f"{row[share]:.1%}" for share in shares)] for row in light])  # fmt: skip
    for group in dict.fromkeys(case.group for case in cases):
        _print_group(group, [(case, row) for case, row in found if case.group == group])
