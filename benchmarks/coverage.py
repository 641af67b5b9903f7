"""Coverage, NEES and error over bound of the estimators, by error source, friction and force.

`python -m benchmarks coverage [--draws N] [--only WORD] [--bounds] [--json]`

Probes, mounts, sensors, friction and touches are drawn from the priors, and their readings are simulated by the
reference rod of `tests/reference/cosserat.py`, which shares no code with the estimators. A draw is counted if the
Cramér–Rao bound of the touched point is below 6 mm, with all drawn error sources and the direction of the force
unknown.
"""

import json
import math
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from benchmarks.error_statistics import ErrorStatistics
from benchmarks.reference_probes import SOURCES, Perturbations, PriorStds, ProbeSamples
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
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import WALK_SECONDS
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
#: Model errors: factor or divisor of E and G, step of the object [m], and step of the bias [resolution]; the steps
#: occur between the third and the fourth of five touches.
STIFFNESS_FACTOR, OBJECT_STEP, BIAS_STEPS = 1.2, 1.0 * MM, 5.0

#: Result code, touched point of the surface [m], (3,), and its covariance [m²], (3, 3).
Estimate = tuple[str, Array, Array]


# Estimators under test


#: Ranges of the magnitude of the force [N].
DECADES = {"2-10 mN": (2e-3, 1e-2), "10-100 mN": (1e-2, 1e-1), "0.1-1 N": (1e-1, 1.0)}
ALL_SOURCES = tuple(SOURCES)
#: Error sources of a single touch, whose point is in the base frame.
SINGLE_SOURCES = tuple(source for source in ALL_SOURCES if source != "robot")


@dataclass(frozen=True)
class Case:
    """One row of a table."""

    group: str  #: group, name: title of the table and label of the row.
    name: str
    sources: tuple[str, ...] = ()  #: error sources that are drawn.
    friction: float | None = None  #: tangential over normal force, in a random direction; None draws it from the prior.
    forces: tuple[float, float] = (2e-3, 1.0)  #: smallest and largest force of a single touch [N].
    std_factor: float = 1.0  #: true over stated standard deviations.
    #: place, newtons: of fused touches: place over the length and largest normal force [N]; 0 for single touches.
    place: float = 0.0
    newtons: float = 0.0
    kind: str = "estimate"  #: "estimate", "moments", "all six" or "tracker".
    sticks: bool = False  #: whether the touched material point stays the same during a press.
    anew: bool = False  #: whether the direction of the friction is drawn anew at each touch of a press.
    #: relative standard deviation stated for E and G of fused touches; None for the design's.
    youngs_modulus: float | None = None
    #: "" or a condition that no single contact within the priors explains: "stiffness" (E and G are off), "pull" (a
    #: force away from the object), "moved" (the object moves), "bias" (the bias jumps).
    model_error: str = ""
    flatness: float = 1.0  #: of the probes' sections; only single touches.


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
            cases += [Case(group, f"friction {name}, {decade}", sources, mu, forces)
                      for decade, forces in DECADES.items()]  # fmt: skip
    return cases


def fused_cases() -> list[Case]:
    """Return the rows of fused touches of the large probe."""
    cases, some = [], ("E", "G", "drift", "robot")
    of = partial(Case, "Five touches of the large probe, 3 % on E and G, 0.01 mm poses, drift", sources=some,
                 youngs_modulus=0.03)  # fmt: skip
    for place in (0.5, 0.8):
        for newtons in (2e-3, 5e-3):
            for kind in ("all six", "moments"):
                name = f"{place:g} L, up to {1e3 * newtons:g} mN, {kind}, friction "
                cases += [of(name=f"{name}{mu:g}", friction=mu, place=place, newtons=newtons, kind=kind)
                          for mu in (0.0, 0.3, 0.6)]  # fmt: skip
    at = partial(replace, of(name="", place=0.8, newtons=5e-3, kind="all six"))
    cases += [at(name=f"0.8 L, up to 5 mN, all six, friction {mu:g}, anew at each touch", friction=mu, anew=True)
              for mu in (0.3, 0.6)]  # fmt: skip
    cases.append(at(name="0.8 L, up to 5 mN, all six, friction 0.6, E to 0.5 %", friction=0.6, youngs_modulus=0.005))
    cases.append(at(name="0.8 L, up to 5 mN, all six, friction 0.3, sticks", friction=0.3, sticks=True))
    cases.append(at(name="0.8 L, up to 5 mN, tracker, friction 0.3", friction=0.3, kind="tracker"))
    every = at(group="Five touches of the large probe, 0.8 L, up to 5 mN, all six; friction drawn from the prior",
               youngs_modulus=None)  # fmt: skip
    cases.append(replace(every, name="sensor noise alone", sources=()))
    cases += [replace(every, name=source, sources=(source,)) for source in ALL_SOURCES]
    cases.append(replace(every, name="all together", sources=ALL_SOURCES))
    cases.append(replace(every, name="all together, moments alone", sources=ALL_SOURCES, kind="moments"))
    cases.append(replace(every, name="all together, tracker", sources=ALL_SOURCES, kind="tracker"))
    cases.append(replace(every, name="all, true spread twice the stated", sources=ALL_SOURCES, std_factor=2.0))
    return cases


def model_error_cases() -> list[Case]:
    """Return the rows of readings that the estimators should refuse."""
    single = Case("Readings that no single contact explains, all error sources", "", SINGLE_SOURCES)
    press = replace(single, sources=ALL_SOURCES, place=0.8, newtons=5e-3, kind="all six")
    return [
        replace(single, name="one touch, E and G off by 20 %", model_error="stiffness"),
        replace(single, name="one touch that pulls", model_error="pull"),
        replace(press, name="five touches, E and G off by 20 %", model_error="stiffness"),
        replace(press, name="five touches, the object moves by 1 mm", model_error="moved"),
        replace(press, name="five touches, the bias jumps by 5 steps", model_error="bias"),
    ]


def estimator_for(model: ProbeModel, priors: PriorStds) -> Estimator:
    """Return the estimator with these priors."""
    return Estimator(model).with_tolerances(priors.tolerances())


def locate(estimator: Estimator, wrench: Array) -> Estimate:
    """Locate the touch of one reading in the base frame."""
    found = estimator.estimate(wrench, estimator.model.gravity_base)
    return found.result, found.p_surface_base, found.cov_surface_base


def fuse(estimator: Estimator, wrenches: Array, Ts: Array, moments_only: bool) -> Estimate:
    """Fuse several touches of one point of the world."""
    found = estimator.fuse(wrenches, Ts, estimator.model.gravity_base, moments_only=moments_only)
    return found.result, found.p_surface_world, found.cov_surface_world


def track(estimator: Estimator, samples: Array, Ts: Array) -> Estimate:
    """Return the estimate of the tracker after the last sample, given (k, SAMPLES, 6)."""
    from probedesign.estimation.tracker import Tracker  # its kernels load slowly and few rows need them

    tracker = Tracker(estimator, gravity_world=estimator.model.gravity_base)
    clock, found = 0.0, FusedEstimate("not_converged")
    for readings, T in zip(samples, Ts, strict=True):
        for wrench in readings:
            clock += 1.0 / 7000.0
            found = tracker.update(wrench, T, clock, touching="contact")
        clock += WALK_SECONDS  # the time between readings that `fuse` assumes if no times are given
    return found.result, found.p_surface_world, found.cov_surface_world


# Single touches


def run_single(case: Case, probe: str, n: int, seed: int) -> ErrorStatistics:
    """Draw and locate about n touches of one probe that are counted."""
    model, rng = paper_models(case.flatness)[probe], np.random.default_rng(seed)
    statistics = ErrorStatistics(MIN_STD)
    stated = PriorStds.of(model).only(case.sources)
    perturbations = Perturbations.of(model, stated.scaled(case.std_factor))
    estimator, noise = estimator_for(model, stated), model.noise_base()
    fraction, newtons = _draw_touches(model, case.forces, n, rng)
    n = len(fraction)
    if n == 0:
        return statistics
    # Draws that all rows have in common come first, so that rows differ only by their perturbations.
    ratios, phi = _draw_ratios(case, model, n, rng), rng.uniform(-np.pi, np.pi, n)
    scatter = rng.normal(size=(n, 6)) @ np.linalg.cholesky(noise).T
    z = perturbations.draw(n, rng)
    samples = perturbations.samples(z)
    force = newtons[:, None] * np.column_stack([np.ones(n), ratios])
    force /= np.sqrt(1.0 + (ratios**2).sum(axis=1))[:, None]

    def touched(samples: ProbeSamples, force: Array, columns: bool) -> Readings:
        s = fraction * samples.probes.length
        touches = solve(samples.at_touch(0), samples.gravity, s, phi, force, axes="surface")
        return evaluate_readings(samples, z, touches, samples.free_wrench(), columns=columns)

    readings = touched(samples, force, columns=True)
    bounds = position_rms(cramer_rao(readings, noise))
    if case.model_error:
        sign = -1.0 if case.model_error == "pull" else 1.0
        readings = touched(_with_wrong_stiffness(case, samples), sign * force, columns=False)
    wrenches = readings.wrench + scatter
    for i in np.flatnonzero(readings.touches.ok & (bounds < MAX_BOUND)):
        if model.in_range(model.to_sensor(wrenches[i], model.gravity_base)):
            result, point, cov = locate(estimator, wrenches[i])
            statistics.add(result, point - readings.point[i], cov, float(bounds[i]))
    return statistics


def _draw_touches(
    model: ProbeModel, forces: tuple[float, float], n: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Draw places over the length and forces [N] that bend the probe moderately and may have a small enough bound.

    The error of one touch is at least about s σ_F/F, so lighter touches need not be solved.
    """
    rod = model.rod
    low, high = np.log(forces)
    fraction, newtons = rng.uniform(*PLACES, 200 * n), np.exp(rng.uniform(low, high, 200 * n))
    s = fraction * rod.length
    stiffness = rod.factors[1] * rod.youngs_modulus * np.pi / 4.0 * rod.radius[0] ** 3 * rod.radius_at(s)
    moderate = newtons * s * s < MAX_BEND * stiffness
    strong = newtons > 0.9 * s * model.noise.force / MAX_BOUND
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


# Fused touches


def run_fused(case: Case, n: int, seed: int) -> ErrorStatistics:
    """Draw and fuse n presses of the large probe."""
    model, rng, statistics = paper_models()["large"], np.random.default_rng(seed), ErrorStatistics(MIN_STD)
    stated = _stated_priors(case, model)
    perturbations = Perturbations.of(model, stated.scaled(case.std_factor), TOUCHES)
    estimator, noise = estimator_for(model, stated), model.noise_base()
    ratios, phi = _draw_ratios(case, model, n, rng), rng.uniform(-np.pi, np.pi, n)
    z = perturbations.draw(n, rng)
    bound = _fused_bound(model, stated, case.place, case.newtons, case.kind == "moments")
    aside, slide = rng.uniform(-0.1, 0.1, n) if case.sticks else None, rng.uniform(0.0, MAX_SLIDE, n)
    samples = _with_wrong_stiffness(case, perturbations.samples(z))
    pressed = solve_presses(samples, z, case.place, phi, ratios, case.newtons, slide, aside=aside)
    wrenches, places = _with_wrong_readings(case, model, pressed.wrenches, pressed.places, rng)
    root = np.linalg.cholesky(noise).T
    for i in np.flatnonzero(pressed.ok):
        Ts = _poses(places[i])
        if case.kind == "tracker":
            scatter = math.sqrt(model.averaging_samples) * rng.normal(size=(TOUCHES, SAMPLES, 6)) @ root
            result, point, cov = track(estimator, wrenches[i][:, None] + scatter, Ts)
        else:
            noisy = wrenches[i] + rng.normal(size=(TOUCHES, 6)) @ root
            result, point, cov = fuse(estimator, noisy, Ts, case.kind == "moments")
        statistics.add(result, point, cov, bound)  # the touched point is the world's origin
    if case.model_error:
        statistics.powers = _best_powers(case, perturbations, phi, ratios, slide, seed)
    return statistics


def _poses(places: Array) -> Array:
    return np.array([pose(np.eye(3), p) for p in places])


def _best_powers(
    case: Case, perturbations: Perturbations, phi: Array, ratios: Array, slide: Array, seed: int
) -> list[float]:
    """Return the power of the best test for the model error at one false positive in a hundred, for each press.

    The best test knows the alternative exactly (Neyman and Pearson). Its statistic is normal with variance 1, and the
    model error shifts its mean by λ, where λ² is the increase of the least χ² that the error causes in the noise-free
    readings of the probe as designed.
    """
    model, z = perturbations.model, np.zeros((len(phi), perturbations.size))
    estimator, samples = estimator_for(model, _stated_priors(case, model)), perturbations.samples(z)
    right = solve_presses(samples, z, case.place, phi, ratios, case.newtons, slide)
    wrong = solve_presses(_with_wrong_stiffness(case, samples), z, case.place, phi, ratios, case.newtons, slide)
    wrenches, places = _with_wrong_readings(case, model, wrong.wrenches, wrong.places, np.random.default_rng(seed + 1))
    powers = []
    for i in np.flatnonzero(np.logical_and(right.ok, wrong.ok)):
        chi2_wrong, chi2_right = (
            estimator.fuse(w, _poses(p), model.gravity_base, moments_only=case.kind == "moments").chi2
            for w, p in ((wrenches[i], places[i]), (right.wrenches[i], right.places[i]))
        )
        if math.isfinite(chi2_wrong) and math.isfinite(chi2_right):
            shift = math.sqrt(max(chi2_wrong - chi2_right, 0.0))
            powers.append(float(ndtr(shift - ndtri(0.99))))
    return powers


def _stated_priors(case: Case, model: ProbeModel) -> PriorStds:
    priors = PriorStds.of(model).only(case.sources)
    E = case.youngs_modulus
    return priors if E is None else PriorStds(priors.by_name | {"youngs_modulus": E, "shear_modulus": E})


def _with_wrong_stiffness(case: Case, samples: ProbeSamples) -> ProbeSamples:
    """Return the samples, alternately stiffer and softer if the model error of the case is the stiffness."""
    if case.model_error != "stiffness":
        return samples
    factor = np.where(np.arange(len(samples.gravity)) % 2, STIFFNESS_FACTOR, 1.0 / STIFFNESS_FACTOR)
    probes = samples.probes
    return replace(samples, probes=replace(probes, E=factor * probes.E, G=factor * probes.G))


def _with_wrong_readings(case: Case, model: ProbeModel, wrenches: Array, places: Array, rng: np.random.Generator
                         ) -> tuple[Array, Array]:  # fmt: skip
    """Return readings and places, after the third touch with a moved object or a changed bias if the case has it."""
    direction = rng.normal(size=(len(places), 1, 3))
    signs = rng.choice([-1.0, 1.0], (len(places), 1, 6))
    after = (np.arange(TOUCHES) >= 3)[None, :, None]
    if case.model_error == "moved":
        # An error of the reported base position is equivalent to an opposite motion of the object.
        return wrenches, places + after * OBJECT_STEP * direction / np.linalg.norm(direction, axis=2, keepdims=True)
    if case.model_error == "bias":
        step = np.sqrt(np.diag(model.noise.cov) * model.averaging_samples)
        jump = BIAS_STEPS * signs * step
        return wrenches + after * (jump @ wrench_map(inverse(model.T_sensor_base)).T), places
    return wrenches, places


_NOMINAL_PRESSES: dict[Any, Presses] = {}


def _fused_bound(model: ProbeModel, stated: PriorStds, place: float, newtons: float, moments_only: bool) -> float:
    """Return the bound of the RMS error [m] for the probe as designed, over six directions of the touch.

    The friction has its prior, whose information is evaluated at the touch without friction, as in the table of bounds.
    """
    key = (model.name, tuple(stated.by_name.items()), place, newtons)
    if key not in _NOMINAL_PRESSES:
        perturbations = Perturbations.of(model, stated, TOUCHES)
        phi = np.linspace(-np.pi, np.pi, 6, endpoint=False)
        z = np.zeros((len(phi), perturbations.size))
        _NOMINAL_PRESSES[key] = solve_presses(perturbations.samples(z), z, place, phi, np.zeros((len(phi), 2)),
                                              newtons, np.zeros(len(phi)), columns=True)  # fmt: skip
    pressed = _NOMINAL_PRESSES[key]
    cov = fused_cramer_rao(pressed, model.noise_base(), model.friction, moments_only)
    return float(np.sqrt(np.nanmean(position_rms(cov)[pressed.ok] ** 2)))


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
        if case.newtons:
            jobs.append((i, (case, "large", fused_draws, 1)))
        else:
            jobs += [(i, (case, probe, -(-draws // 3), 10 + j)) for j, probe in enumerate(paper_models())]
    totals, began = [ErrorStatistics() for _ in cases], time.monotonic()
    with ProcessPoolExecutor(max_workers=workers) as pool:
        each = [job for _, job in jobs]
        statistics = map(_run, each) if workers == 1 else pool.map(_run, each)
        for done, ((i, job), found) in enumerate(zip(jobs, statistics, strict=True), 1):
            totals[i].join(found)
            progress(f"{done} of {len(jobs)}, {time.monotonic() - began:.0f} s: {job[0].name}, {job[1]}")
    return [(case, total.summary()) for case, total in zip(cases, totals, strict=True)]


#: `refused of wrong` counts estimates with an error above three standard deviations or that are refused as wrong.
HEAD = ("draws", "located", "RMS [mm]", "bound [mm]", "RMS / bound", "in 95 %", "NEES (expected 3)",
        "in 95 % or refused", "refused of wrong", "best test", "other results")  # fmt: skip


def _row(found: dict[str, Any]) -> list[str]:
    def cell(name: str, form: str) -> str:
        value = found[name]
        return "-" if value is None else format(value, form)

    others = ", ".join(f"{code} {n}" for code, n in found["results"].items() if code != "ok") or "none"
    nees = f"{cell('mean_nees', '.2f')}, median {cell('median_nees', '.2f')}"
    return [str(found["draws"]), cell("ok_share", ".1%"), cell("rms_mm", ".2f"), cell("bound_mm", ".2f"),
            cell("rms_over_bound", ".2f"), cell("inside_95_share", ".1%"), nees,
            cell("inside_or_refused_share", ".1%"), cell("flagged_of_wrong_share", ".1%"),
            cell("flagged_at_best_share", ".1%"), others]  # fmt: skip


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


def report(draws: int = DRAWS, only: str | None = None, bounds_only: bool = False, as_json: bool = False,
           workers: int = 2) -> None:  # fmt: skip
    """Print the tables, or one JSON document.

    Args:
        draws: single touches of each row; rows of fused touches have 0.3 of that.
        only: run only rows whose group or name contains this text, ignoring case; None runs all rows.
        bounds_only: print the bounds of one touch instead.
        as_json: print JSON.
        workers: number of processes.
    """
    if bounds_only:
        rows = bounds()
        if as_json:
            print(json.dumps(rows, indent=2))
        else:
            print_bounds(rows)
        return
    cases = [case for case in (*single_cases(), *fused_cases(), *model_error_cases())
             if only is None or only.lower() in f"{case.group}, {case.name}".lower()]  # fmt: skip
    fused_draws = max(1, round(draws * FUSED_DRAWS / DRAWS))
    found = run(cases, draws, fused_draws, workers, lambda line: print(line, file=sys.stderr, flush=True))
    if as_json:
        print(json.dumps([{"group": case.group, "case": case.name, **row} for case, row in found], indent=2))
        return
    for group in dict.fromkeys(case.group for case in cases):
        table = [[case.name, *_row(row)] for case, row in found if case.group == group]
        print_table(group, ["case", *HEAD], table)
