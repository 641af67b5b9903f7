"""Whether stated uncertainties come true: coverage, NEES and error over bound, by error source, friction and force.

`python -m benchmarks coverage [--draws N] [--only WORD] [--bounds] [--json]`

Probes, mounts, sensors, friction and touches are drawn from the priors and read by the reference rod of
`tests/reference/cosserat.py`, which shares no code with the estimator. A draw counts where the Cramér-Rao bound of the
touched point, with all drawn error sources and the force's direction unknown, is under 6 mm.
"""

import json
import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import chdtri, ndtr, ndtri

from benchmarks.reference_worlds import (
    FIELDS,
    Presses,
    Priors,
    Readings,
    Sources,
    Worlds,
    bound,
    fused_bound,
    presses,
    read,
    rms,
)
from benchmarks.timing import print_table
from probedesign.core.frames import Array, inverse, pose, wrench_map
from probedesign.core.units import MM
from probedesign.design import load_design
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import ProbeModel
from probedesign.estimation.tolerances import WALK_SECONDS
from probedesign.probe import build_probe
from tests.reference.cosserat import solve

PROBES = ("large", "medium", "small")
DECADES = {"2-10 mN": (2e-3, 1e-2), "10-100 mN": (1e-2, 1e-1), "0.1-1 N": (1e-1, 1.0)}
"""Of the whole force [N]."""
PLACES = (0.3, 0.95)
"""Of touches, over the length."""
LIMIT = 6.0 * MM
"""Largest bound that counts."""
STRENGTH = 0.8
"""Largest F s²/(E I(0) r(s)/r(0)): about the angle by which the force bends the probe [rad]."""
FRICTION = 0.6
"""Of the prior, where the design states none. Assumed, docs/design-file.md."""
WITHIN_95 = float(chdtri(3, 0.05))
TOUCHES = 5
SLIDE = 1.0 * MM
"""Way that a sliding touch goes along the probe from the first to the last of them, at most. Assumed."""
SAMPLES = 36
"""Samples that the tracker gets at each touch; together they are the reading that `fuse` gets."""
DRAWS, FUSED_DRAWS = 100, 30
"""By default: single touches and fused ones a row."""
WRONG = ("stiffness", "pull", "moved", "bias")
STIFFNESS_OFF, MOVED, BIAS_STEPS = 1.2, 1.0 * MM, 5.0
"""Of what is wrong: factor on E and G or its inverse, way of the object [m] and step of the bias in steps of the
resolution, both between the third and the fourth of five touches."""
ALL = tuple(FIELDS)
SINGLE = tuple(source for source in ALL if source != "robot")


# The package under test: everything that is called of it


@cache
def paper_models() -> dict[str, ProbeModel]:
    """Return the paper's probes."""
    folder = Path(__file__).parents[1] / "designs"
    return {name: build_probe(load_design(folder / f"{name}.toml")).model for name in PROBES}


def estimator_for(model: ProbeModel, priors: Priors) -> Estimator:
    """Return the estimator with these priors; none at all takes probe, mount and bench for exactly known."""
    return Estimator(model).with_tolerances(priors.tolerances())


def located(estimator: Estimator, wrench: Array) -> tuple[str, Array, Array]:
    """Return result, touched point of the surface [m] and its covariance [m²] of one reading."""
    c: Any = estimator.estimate(wrench, estimator.model.gravity_base)
    return c.result, c.p_surface_base, getattr(c, "cov_surface_base", c.cov_contact_base)


def fused(estimator: Estimator, wrenches: Array, Ts: Array, moments_only: bool) -> tuple[str, Array, Array]:
    """Return the same of several touches of one point, in the world."""
    f: Any = estimator.fuse(wrenches, Ts, estimator.model.gravity_base, moments_only=moments_only)
    return f.result, f.p_surface_world, _cov_world(f)


def tracked(estimator: Estimator, samples: Array, Ts: Array) -> tuple[str, Array, Array]:
    """Return the same after the last of single samples, (k, SAMPLES, 6)."""
    from probedesign.estimation.tracker import Tracker  # only these rows wait for it

    tracker = Tracker(estimator, gravity_world=estimator.model.gravity_base)
    clock, f = 0.0, None
    for readings, T in zip(samples, Ts, strict=True):
        for wrench in readings:
            clock += 1.0 / 7000.0
            f = tracker.update(wrench, T, clock, touching="contact")
        clock += WALK_SECONDS  # as `fuse` takes readings to be apart whose times are not given
    assert f is not None
    return f.result, f.p_surface_world, _cov_world(f)


def _cov_world(f: Any) -> Array:
    return np.asarray(f.cov_surface_world if hasattr(f, "cov_surface_world") else f.cov_fixed_world)


def friction_of(model: ProbeModel) -> float:
    """Return the standard deviation of the friction prior."""
    return float(getattr(model, "friction", FRICTION))


# Cases and what is counted of them


@dataclass(frozen=True)
class Case:
    """One row of a table.

    Attributes:
        group, name: of the table and the row.
        sources: of error that are drawn.
        friction: tangential over normal force, in a random direction; None draws it from the prior.
        forces: least and largest [N] of a single touch.
        spread: true standard deviations over stated ones.
        place, newtons: of fused touches: over the length, and largest normal force [N]; 0 for single touches.
        kind: "estimate", "moments", "all six" or "tracker".
        sticks: whether the material point stays where it is through a press.
        anew: whether the direction of the friction is drawn anew at each touch of a press.
        youngs_modulus: stated for E and G of fused touches; None as the design has it.
        wrong: what no single contact of the stated priors explains: "" or one of `WRONG`.
    """

    group: str
    name: str
    sources: tuple[str, ...] = ()
    friction: float | None = None
    forces: tuple[float, float] = (2e-3, 1.0)
    spread: float = 1.0
    place: float = 0.0
    newtons: float = 0.0
    kind: str = "estimate"
    sticks: bool = False
    anew: bool = False
    youngs_modulus: float | None = None
    wrong: str = ""


def single_cases() -> list[Case]:
    """Return the rows of single touches."""
    by_source = partial(Case, "One touch, by error source; friction drawn from the prior")
    cases = [by_source("sensor noise alone")]
    cases += [by_source(source, (source,)) for source in SINGLE]
    cases += [
        by_source("all together", SINGLE),
        by_source("all, true spread twice the stated", SINGLE, spread=2.0),
    ]
    for title, sources in (("sensor noise alone", ()), ("all error sources", SINGLE)):
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
                cases += [of(name=name + ("prior" if mu is None else f"{mu:g}"), friction=mu, place=place,
                             newtons=newtons, kind=kind) for mu in (0.0, 0.3, 0.6)]  # fmt: skip
    at = partial(replace, of(name="", place=0.8, newtons=5e-3, kind="all six"))
    cases += [at(name=f"0.8 L, up to 5 mN, all six, friction {mu:g}, anew at each touch", friction=mu, anew=True)
              for mu in (0.3, 0.6)]  # fmt: skip
    cases.append(
        at(name="0.8 L, up to 5 mN, all six, friction 0.6, E to 0.5 %", friction=0.6, youngs_modulus=0.005)
    )
    cases.append(at(name="0.8 L, up to 5 mN, all six, friction 0.3, sticks", friction=0.3, sticks=True))
    cases.append(at(name="0.8 L, up to 5 mN, tracker, friction 0.3", friction=0.3, kind="tracker"))
    every = at(group="Five touches of the large probe, 0.8 L, up to 5 mN, all six; friction drawn from the prior",
               youngs_modulus=None)  # fmt: skip
    cases.append(replace(every, name="sensor noise alone", sources=()))
    cases += [replace(every, name=source, sources=(source,)) for source in ALL]
    cases.append(replace(every, name="all together", sources=ALL))
    cases.append(replace(every, name="all together, moments alone", sources=ALL, kind="moments"))
    cases.append(replace(every, name="all together, tracker", sources=ALL, kind="tracker"))
    cases.append(replace(every, name="all, true spread twice the stated", sources=ALL, spread=2.0))
    return cases


def negative_cases() -> list[Case]:
    """Return the rows of readings that should be refused."""
    single = Case("Readings that no single contact explains, all error sources", "", SINGLE)
    press = replace(single, sources=ALL, place=0.8, newtons=5e-3, kind="all six")
    return [
        replace(single, name="one touch, E and G off by 20 %", wrong="stiffness"),
        replace(single, name="one touch that pulls", wrong="pull"),
        replace(press, name="five touches, E and G off by 20 %", wrong="stiffness"),
        replace(press, name="five touches, the object moves by 1 mm", wrong="moved"),
        replace(press, name="five touches, the bias jumps by 5 steps", wrong="bias"),
    ]


@dataclass
class Tally:
    """Answers as they come in.

    Attributes:
        ratios: squared error over squared bound.
        nees: of the answers.
        errors: squared [m²].
        results: by code.
        bounds: squared, of all that counts [m²].
        beyond: answers further off than three stated standard deviations of the point.
        powers: of the best test of what is wrong, at one false flag in a hundred, see `_best_power`.
    """

    ratios: list[float] = field(default_factory=list)
    nees: list[float] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)
    results: Counter[str] = field(default_factory=Counter)
    bounds: list[float] = field(default_factory=list)
    beyond: int = 0
    powers: list[float] = field(default_factory=list)

    def add(self, answer: tuple[str, Array, Array], truth: Array, limit: float) -> None:
        """Count one answer against the true point and the bound's RMS [m]."""
        result, point, cov = answer
        self.results[result] += 1
        self.bounds.append(limit**2)
        if result != "ok":
            return
        off = np.asarray(point) - truth
        self.errors.append(float(off @ off))
        self.beyond += bool(off @ off > 9.0 * np.trace(cov))
        self.ratios.append(float(off @ off) / limit**2)
        # A covariance of a point on a surface may lack its third direction.
        values, vectors = np.linalg.eigh(np.asarray(cov, dtype=float))
        values = np.maximum(values, 1e-9 * values[-1] + (1e-6) ** 2)
        self.nees.append(float(((vectors.T @ off) ** 2 / values).sum()))

    def join(self, other: "Tally") -> None:
        """Add another's answers."""
        self.ratios += other.ratios
        self.nees += other.nees
        self.errors += other.errors
        self.bounds += other.bounds
        self.results += other.results
        self.beyond += other.beyond
        self.powers += other.powers

    def summary(self) -> dict[str, Any]:
        """Return what the tables and `--json` show; None where nothing was answered."""
        n, answered, nees = self.results.total(), len(self.nees), np.array(self.nees)
        inside = int((nees <= WITHIN_95).sum())
        none, wrong = not answered, n - answered + self.beyond
        return {
            "draws": n,
            "ok_share": None if not n else answered / n,
            "rms_mm": None if none else math.sqrt(np.mean(self.errors)) / MM,
            "bound_mm": None if not n else math.sqrt(np.mean(self.bounds)) / MM,
            "rms_over_bound": None if none else math.sqrt(np.mean(self.ratios)),
            "inside_95_share": None if none else inside / answered,
            "mean_nees": None if none else float(nees.mean()),
            "median_nees": None if none else float(np.median(nees)),
            "inside_or_refused_share": None if not n else (inside + n - answered) / n,
            "beyond_3_std": self.beyond,
            "flagged_of_wrong_share": (n - answered) / wrong if wrong else None,
            "flagged_at_best_share": float(np.mean(self.powers)) if self.powers else None,
            "results": dict(self.results),
        }  # fmt: skip


# Single touches


def run_single(case: Case, probe: str, n: int, seed: int) -> Tally:
    """Draw and locate about n touches of one probe that count."""
    model, rng, tally = paper_models()[probe], np.random.default_rng(seed), Tally()
    stated = Priors.of(model).only(case.sources)
    sources = Sources.of(model, stated.times(case.spread))
    estimator, noise = estimator_for(model, stated), model.noise_base()
    fraction, newtons = _touches(model, case.forces, n, rng)
    n = len(fraction)
    if n == 0:
        return tally
    # What every row shares is drawn first, so that rows differ by their worlds alone.
    ratios, phi = _ratios(case, model, n, rng), rng.uniform(-np.pi, np.pi, n)
    scatter = rng.normal(size=(n, 6)) @ np.linalg.cholesky(noise).T
    z = sources.draw(n, rng)
    worlds = sources.worlds(z)
    force = newtons[:, None] * np.column_stack([np.ones(n), ratios])
    force /= np.sqrt(1.0 + (ratios**2).sum(axis=1))[:, None]

    def touched(worlds: Worlds, force: Array, columns: bool) -> Readings:
        s = fraction * worlds.probes.length
        touches = solve(worlds.at_touch(0), worlds.gravity, s, phi, force, axes="surface")
        return read(worlds, z, touches, worlds.free(), columns=columns)

    readings = touched(worlds, force, columns=True)
    limits = rms(bound(readings, noise))
    if case.wrong:
        sign = -1.0 if case.wrong == "pull" else 1.0
        readings = touched(_wrong_worlds(case, worlds), sign * force, columns=False)
    touches = readings.touches
    wrenches = readings.wrench + scatter
    for i in np.flatnonzero(touches.ok & (limits < LIMIT)):
        if model.in_range(model.to_sensor(wrenches[i], model.gravity_base)):
            tally.add(located(estimator, wrenches[i]), readings.point[i], float(limits[i]))
    return tally


def _touches(
    model: ProbeModel, forces: tuple[float, float], n: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Places over the length and forces [N] that the probe holds and whose bound may count.

    One touch is located to about s σ_F/F at best, so lighter ones need not be solved.
    """
    rod = model.rod
    fraction, newtons = rng.uniform(*PLACES, 200 * n), np.exp(rng.uniform(*np.log(forces), 200 * n))
    s = fraction * rod.length
    stiffness = rod.youngs_modulus * np.pi / 4.0 * rod.radius[0] ** 3 * rod.radius_at(s)
    held = newtons * s * s < STRENGTH * stiffness
    counts = newtons > 0.9 * s * model.noise.force / LIMIT
    rows = np.flatnonzero(held & counts)[:n]
    return fraction[rows], newtons[rows]


def _ratios(case: Case, model: ProbeModel, n: int, rng: np.random.Generator) -> Array:
    """Tangential over normal force, around and along, (n, 2), or (TOUCHES, n, 2) if drawn anew at each touch."""
    if case.anew:
        once = replace(case, anew=False)
        return np.array([_ratios(once, model, n, rng) for _ in range(TOUCHES)])
    drawn, way = rng.normal(size=(n, 2)), rng.uniform(-np.pi, np.pi, n)
    if case.friction is None:
        return friction_of(model) * drawn
    return case.friction * np.column_stack([np.cos(way), np.sin(way)])


# Fused touches


def run_fused(case: Case, n: int, seed: int) -> Tally:
    """Draw and fuse n presses of the large probe."""
    model, rng, tally = paper_models()["large"], np.random.default_rng(seed), Tally()
    stated = _stated(case, model)
    sources = Sources.of(model, stated.times(case.spread), TOUCHES)
    estimator, noise = estimator_for(model, stated), model.noise_base()
    ratios, phi, z = _ratios(case, model, n, rng), rng.uniform(-np.pi, np.pi, n), sources.draw(n, rng)
    limit = _fused_limit(model, _stated(case, model), case.place, case.newtons, case.kind == "moments")
    aside, slide = rng.uniform(-0.1, 0.1, n) if case.sticks else None, rng.uniform(0.0, SLIDE, n)
    worlds = _wrong_worlds(case, sources.worlds(z))
    pressed = presses(worlds, z, case.place, phi, ratios, case.newtons, slide, aside)
    wrenches, places = _wrong_readings(case, model, pressed.wrenches, pressed.places, rng)
    root = np.linalg.cholesky(noise).T
    for i in np.flatnonzero(pressed.ok):
        Ts = np.array([pose(np.eye(3), p) for p in places[i]])
        if case.kind == "tracker":
            scatter = math.sqrt(model.averaging_samples) * rng.normal(size=(TOUCHES, SAMPLES, 6)) @ root
            answer = tracked(estimator, wrenches[i][:, None] + scatter, Ts)
        else:
            noisy = wrenches[i] + rng.normal(size=(TOUCHES, 6)) @ root
            answer = fused(estimator, noisy, Ts, case.kind == "moments")
        tally.add(answer, np.zeros(3), limit)
    if case.wrong:
        tally.powers = _best_powers(case, sources, phi, ratios, slide, seed)
    return tally


def _best_powers(
    case: Case, sources: Sources, phi: Array, ratios: Array, slide: Array, seed: int
) -> list[float]:
    """Chance that the best test flags what is wrong, at one false flag in a hundred, for each press.

    The best test knows what may be wrong and by how much (Neyman and Pearson). Its statistic is normal, of variance
    1, and moved by λ, where λ² is by how much the wrong readings without noise, of the probe as designed, raise the
    misfit over that of the right ones, with every unknown free to explain them.
    """
    model, z = sources.model, np.zeros((len(phi), sources.size))
    estimator, worlds = estimator_for(model, _stated(case, model)), sources.worlds(z)
    right = presses(worlds, z, case.place, phi, ratios, case.newtons, slide)
    wrong = presses(_wrong_worlds(case, worlds), z, case.place, phi, ratios, case.newtons, slide)
    wrenches, places = _wrong_readings(
        case, model, wrong.wrenches, wrong.places, np.random.default_rng(seed + 1)
    )
    powers = []
    for i in np.flatnonzero(right.ok & wrong.ok):
        misfits = [
            estimator.fuse(w, [pose(np.eye(3), p) for p in ps], model.gravity_base,
                           moments_only=case.kind == "moments").chi2
            for w, ps in ((wrenches[i], places[i]), (right.wrenches[i], right.places[i]))
        ]  # fmt: skip
        if np.isfinite(misfits).all():
            rise = math.sqrt(max(misfits[0] - misfits[1], 0.0))
            powers.append(float(ndtr(rise - ndtri(0.99))))
    return powers


def _stated(case: Case, model: ProbeModel) -> Priors:
    priors = Priors.of(model).only(case.sources)
    E = case.youngs_modulus
    return priors if E is None else Priors(priors.by_name | {"youngs_modulus": E, "shear_modulus": E})


def _wrong_worlds(case: Case, worlds: Worlds) -> Worlds:
    """Worlds with a stiffness far from what is stated, every other one stiffer and softer."""
    if case.wrong != "stiffness":
        return worlds
    factor = np.where(np.arange(len(worlds.gravity)) % 2, STIFFNESS_OFF, 1.0 / STIFFNESS_OFF)
    return replace(
        worlds, probes=replace(worlds.probes, E=factor * worlds.probes.E, G=factor * worlds.probes.G)
    )


def _wrong_readings(case: Case, model: ProbeModel, wrenches: Array, places: Array, rng: np.random.Generator
                    ) -> tuple[Array, Array]:  # fmt: skip
    """Readings and places with the object moved or the bias changed after the third touch."""
    way = rng.normal(size=(len(places), 1, 3))
    signs = rng.choice([-1.0, 1.0], (len(places), 1, 6))
    after = (np.arange(TOUCHES) >= 3)[None, :, None]
    if case.wrong == "moved":
        # A base that is reported elsewhere is an object that has moved the other way.
        return wrenches, places + after * MOVED * way / np.linalg.norm(way, axis=2, keepdims=True)
    if case.wrong == "bias":
        step = np.sqrt(np.diag(model.noise.cov) * model.averaging_samples)
        jump = BIAS_STEPS * signs * step
        return wrenches + after * (jump @ wrench_map(inverse(model.T_sensor_base)).T), places
    return wrenches, places


_PRESSED: dict[Any, Presses] = {}


def _fused_limit(
    model: ProbeModel, stated: Priors, place: float, newtons: float, moments_only: bool
) -> float:
    """RMS of the bound [m] with the friction prior, at the design's own probe, over directions of the touch."""
    # The prior's information is taken at the touch without friction, as the table of bounds is.
    key = (model.name, tuple(stated.by_name.items()), place, newtons)
    if key not in _PRESSED:
        sources = Sources.of(model, stated, TOUCHES)
        phi = np.linspace(-np.pi, np.pi, 6, endpoint=False)
        z = np.zeros((len(phi), sources.size))
        _PRESSED[key] = presses(sources.worlds(z), z, place, phi, np.zeros((len(phi), 2)), newtons,
                                np.zeros(len(phi)), columns=True)  # fmt: skip
    pressed = _PRESSED[key]
    cov = fused_bound(pressed, model.noise_base(), friction_of(model), moments_only)
    return float(np.sqrt(np.nanmean(rms(cov)[pressed.ok] ** 2)))


# Tables


def _run(job: tuple[Case, str, int, int]) -> Tally:
    case, probe, n, seed = job
    return run_fused(case, n, seed) if case.newtons else run_single(case, probe, n, seed)


def run(cases: Sequence[Case], draws: int, fused_draws: int, workers: int,
        progress: Callable[[str], None]) -> list[tuple[Case, dict[str, Any]]]:  # fmt: skip
    """Run the cases, each with its own fixed seed, in worker processes."""
    jobs: list[tuple[int, tuple[Case, str, int, int]]] = []
    for i, case in enumerate(cases):
        # The same seed for every row: rows differ by what they are about, not by their touches.
        if case.newtons:
            jobs.append((i, (case, "large", fused_draws, 1)))
        else:
            jobs += [(i, (case, probe, -(-draws // 3), 10 + j)) for j, probe in enumerate(PROBES)]
    tallies, began = [Tally() for _ in cases], time.monotonic()
    found = map(_run, [job for _, job in jobs]) if workers == 1 else None
    with ProcessPoolExecutor(max_workers=workers) as pool:
        answers = found if found is not None else pool.map(_run, [job for _, job in jobs])
        for done, ((i, job), tally) in enumerate(zip(jobs, answers, strict=True), 1):
            tallies[i].join(tally)
            progress(f"{done} of {len(jobs)}, {time.monotonic() - began:.0f} s: {job[0].name}, {job[1]}")
    return [(case, tally.summary()) for case, tally in zip(cases, tallies, strict=True)]


HEAD = ("draws", "ok", "RMS mm", "bound mm", "RMS ÷ bound", "in 95 %", "NEES, 3 is right", "in or refused",
        "flagged of wrong", "at best", "other answers")  # fmt: skip


def _row(found: dict[str, Any]) -> list[str]:
    def shown(name: str, form: str) -> str:
        value = found[name]
        return "-" if value is None else format(value, form)

    others = ", ".join(f"{code} {n}" for code, n in found["results"].items() if code != "ok") or "none"
    nees = f"{shown('mean_nees', '.2f')}, median {shown('median_nees', '.2f')}"
    return [str(found["draws"]), shown("ok_share", ".1%"), shown("rms_mm", ".2f"), shown("bound_mm", ".2f"),
            shown("rms_over_bound", ".2f"), shown("inside_95_share", ".1%"), nees,
            shown("inside_or_refused_share", ".1%"), shown("flagged_of_wrong_share", ".1%"),
            shown("flagged_at_best_share", ".1%"), others]  # fmt: skip


def bounds() -> list[dict[str, Any]]:
    """Return the bounds of one touch of the large probe across gravity, by place, force and friction [mm]."""
    model, rows = paper_models()["large"], []
    sources = Sources.of(model, Priors.of(model).only(()))
    for fraction, forces in ((0.4, (5, 20, 50)), (0.6, (5, 20, 50)), (0.8, (5, 20, 50)), (0.95, (5, 20))):
        z = np.zeros((len(forces), 0))
        worlds = sources.worlds(z)
        push = np.array([[1e-3 * force, 0.0, 0.0] for force in forces])
        touches = solve(worlds.probes, worlds.gravity, fraction * worlds.probes.length, np.pi / 2.0, push,
                        axes="surface")  # fmt: skip
        readings = read(worlds, z, touches, worlds.free())
        found = {mu: rms(bound(readings, model.noise_base(), mu)) / MM for mu in (0.0, 0.3, 0.6, math.inf)}
        rows += [{"contact_fraction": fraction, "force_mN": force,
                  "bound_mm": {f"{mu:g}": float(value[i]) for mu, value in found.items()}}
                 for i, force in enumerate(forces)]  # fmt: skip
    return rows


def print_bounds(rows: Sequence[dict[str, Any]]) -> None:
    """Print the table of bounds."""
    print_table("Cramér-Rao bound of the touched surface point [mm], one touch, large probe, across gravity",
                ["place, force", "friction 0", "0.3", "0.6", "direction free"],
                [[f"{row['contact_fraction']:g} L, {row['force_mN']} mN",
                  *(f"{value:.2f}" for value in row["bound_mm"].values())] for row in rows])  # fmt: skip


def report(draws: int = DRAWS, only: str | None = None, bounds_only: bool = False, as_json: bool = False,
           workers: int = 2) -> None:  # fmt: skip
    """Print the tables, or one JSON document.

    Args:
        draws: single touches a row; fused rows have 0.3 of them.
        only: rows whose group or name has this in it, in lower case; all if None.
        bounds_only: print the bounds of one touch instead.
        as_json: print JSON.
        workers: processes.
    """
    if bounds_only:
        rows = bounds()
        if as_json:
            print(json.dumps(rows, indent=2))
        else:
            print_bounds(rows)
        return
    cases = [case for case in (*single_cases(), *fused_cases(), *negative_cases())
             if only is None or only.lower() in f"{case.group}, {case.name}".lower()]  # fmt: skip
    fused_draws = max(1, round(draws * FUSED_DRAWS / DRAWS))
    found = run(cases, draws, fused_draws, workers, lambda line: print(line, file=sys.stderr, flush=True))
    if as_json:
        print(json.dumps([{"group": case.group, "case": case.name, **row} for case, row in found], indent=2))
        return
    for group in dict.fromkeys(case.group for case in cases):
        rows = [[case.name, *_row(row)] for case, row in found if case.group == group]
        print_table(group, ["case", *HEAD], rows)
