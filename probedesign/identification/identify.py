"""Identification of a probe: a campaign and a design in; numbers with intervals and design changes out."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eigh, null_space
from scipy.stats import norm
from scipy.stats import t as student_t

from probedesign.campaigns import Campaign, Test
from probedesign.campaigns.campaign import TESTS, WRENCHES
from probedesign.campaigns.checks import check_probe
from probedesign.campaigns.manifest import WRIST
from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.estimation.bias import RAMP_STEPS
from probedesign.estimation.model import WALK_SECONDS, ProbeModel, Tolerances
from probedesign.identification import result
from probedesign.identification.fit_checks import (
    LABELS,
    OF_PRINT,
    UnobservableDirection,
    bad_tests,
    contradictions,
    inconsistency,
    likely_causes,
    outlier_notes,
    reconciled,
    unobservable_direction,
    widened,
)
from probedesign.identification.parameters import (
    CHANNELS,
    DEFAULT,
    IMPLIED,
    LOG_E,
    CommonParameters,
    check_requested,
    columns_of,
)
from probedesign.identification.residuals import MassMeasurement, MeasuredTest
from probedesign.identification.result import Identification, Outlier
from probedesign.identification.solver import (
    Fit,
    LeastSquaresProblem,
    Linearization,
    fit,
    outliers,
    solvable_tests,
    start_point,
)

MIN_READINGS = 8  #: Readings of one test from which on their scatter replaces the sensor's noise where it is larger.
#: Factor on the design's E from which on units are questioned: published values of one resin, 1.6 to 3.2 MPa, differ by
#: two, and a factor on all forces cannot be distinguished from a factor on E.
SUSPICIOUS_FACTOR = 3.0
#: Factor on the limits of observability at the start of the search, where the parameters are rough.
START_TOLERANCE = 3.0
#: Fraction of the tests that may be left out because most of their readings are outliers; one always (assumed).
MAX_LEFT_OUT = 0.2
#: Largest drift of the bias over the assumed one, and that from which on it is noted. Of three ATI Nano17 one drifts by
#: 14 steps in 5 s, 125 times as much. Source: github.com/Cuberkk/Finger_manipulation_project, 5cf7320, free_S1_S2.csv.
MAX_DRIFT, NOTED_DRIFT = 125.0, 2.0
TEST_SECONDS = 60.0  #: Time from one test to the next where wrenches.csv has no time_s (assumed).


@dataclass(frozen=True)
class IdentificationData:
    """Tests of one probe as the fit uses them."""

    common: CommonParameters  #: parameters that the tests share.
    tests: tuple[MeasuredTest, ...]  #: usable tests.
    mass: MassMeasurement | None  #: the weighing; None if there was none.
    where: str  #: names the data in messages.
    notes: tuple[str, ...] = ()  #: lines for the user.


def data_of(campaign: Campaign, model: ProbeModel, flange_volume: float) -> IdentificationData:
    """Return a campaign's data for `identify`.

    Args:
        campaign: from `read_campaign`.
        model: of the probe as designed.
        flange_volume: of the printed flange below the base [m³].

    Raises:
        InputError: it is of another probe.
    """
    check_probe(campaign, model)
    notes = list(campaign.notes)
    order, seconds = _epochs(campaign, notes)
    common = CommonParameters(
        model,
        Tolerances.of(model),
        campaign.std_base,
        campaign.std_tilt,
        tuple(np.diff(seconds).tolist()),
        next((test.frame for test in campaign.tests if len(test.wrenches)), "base"),
    )
    held_out = sum(test.use == "validate" for test in campaign.tests)
    if held_out:
        notes.append(f"held out for validate by use in {TESTS}: {held_out} of {len(campaign.tests)} tests")
    tests, unplaced = [], list[str]()
    for test in campaign.tests:
        if test.use == "validate":
            continue
        measured = _measured(test, campaign, common)
        if test.name in order:
            epoch = order[test.name]
            ramp = (seconds[epoch] - seconds[0]) / max(seconds[-1] - seconds[0], 1.0) - 0.5
            measured = replace(measured, epoch=epoch, creep_ramp=float(ramp))
        why = _unusable(measured)
        if not why and test.p_contact_world is None and np.isfinite([test.std_contact, test.s_contact]).all():
            unplaced.append(test.name)
        if why:
            notes.append(f"{test.name}: not used: {why}")
        else:
            tests.append(measured)
    if unplaced:
        notes.append(f"{', '.join(unplaced)}: contact_x/y/z_world_mm is empty; only s_contact_mm ± std_s_mm is used, "
                     "to which friction adds μ r")  # fmt: skip
    weighing = campaign.weighing
    mass = None
    if weighing is not None:
        flange = flange_volume if weighing.of == "probe" else 0.0
        mass = MassMeasurement(weighing.mass, weighing.std, flange)
    return IdentificationData(common, tuple(tests), mass, str(campaign.folder), tuple(notes))


def _epochs(campaign: Campaign, notes: list[str]) -> tuple[dict[str, int], Array]:
    """Return the position of each test with readings in the order of time, and the times [s]; the order is that of the
    table where a test has no time, or where times begin anew in each test."""
    read = [test for test in campaign.tests if len(test.wrenches)]
    times = np.array([test.time for test in read])
    if not np.isfinite(times).all():
        times = TEST_SECONDS * np.arange(len(read))
        notes += [f"times of tests are not known: {TEST_SECONDS:g} s from one to the next are assumed, in the order of "
                  f"{TESTS}"] * (len(read) > 1)  # fmt: skip
    elif twins := [test.name for test in read if (times == test.time).sum() > 1]:
        notes.append(f"{', '.join(twins)}: the same time_s in {WRENCHES}; no drift between them is assumed")
    ranks = np.argsort(times, kind="stable")
    return {read[i].name: k for k, i in enumerate(ranks)}, times[ranks]


def _measured(test: Test, campaign: Campaign, common: CommonParameters) -> MeasuredTest:
    measured = MeasuredTest(
        test.name, test.T_world_base, test.gravity_world, test.force_world, test.s_contact,
        0.0 if np.isnan(test.std_s) else test.std_s, test.p_contact_world, test.std_contact,
        sag=test.tip_sag, std_sag=test.std_sag, std_place=common.tolerances.robot_mm * MM,
        std_turn=common.tolerances.robot_mm * MM / WRIST, digest=test.digest,
    )  # fmt: skip
    model, n = common.model, len(test.wrenches)
    if measured.touched and np.isfinite(test.s_contact):
        # The touched section, without friction r g tan α nearer to the tip than where the force's line passes the axis,
        # g how far the outline reaches in the direction of the push. Friction, whose direction is not known beforehand,
        # moves the line by up to μ r.
        s = min(test.s_contact, model.rod.length)
        radius, friction = float(model.rod.radius_at(s)), min(model.friction, 1.0)
        reach = model.rod.flatness if test.direction in ("+y", "-y") else 1.0
        section = min(s + radius * reach**2 * float(model.rod.taper_at(s)), model.rod.flank_end)
        measured = replace(measured, s_contact=section, std_s=math.hypot(measured.std_s, friction * radius))
    if n:
        noise = model.noise_base()
        if n >= MIN_READINGS:
            scatter = np.var(test.wrenches_base(model), axis=0, ddof=1)
            ratio = np.sqrt(np.maximum(scatter / np.diag(noise), 1.0))
            noise = noise * np.outer(ratio, ratio)
        measured = replace(measured, wrench_base=test.mean_wrench_base(model), cov_wrench=noise / n)
    if test.markers is None or not len(test.markers):
        return measured
    markers = test.markers
    return replace(
        measured, marker_s=campaign.marker_s[markers.numbers], p_markers_world=markers.p_world,
        cov_markers=markers.cov_world, marker_numbers=tuple(int(i) + 1 for i in markers.numbers),
        marker_side=campaign.marker_side,
    )  # fmt: skip


def drift_sizes(common: CommonParameters, tests: Sequence[MeasuredTest]) -> tuple[tuple[float, ...], float]:
    """Return how much each channel of the sensor drifts over what is assumed, by the free readings, at least 1, and the
    factor for its own uncertainty that a size above 1 includes.

    In steps of the resolution, readings of the free probe in one pose at times t_i have the covariance

        V_ij = σ²_i δ_ij + s² (q² min(t_i, t_j) + r² t_i t_j)

    about an unknown mean, with noise σ, walk q and rate r. The size s maximises the likelihood of their contrasts, with
    the scaled inverse χ² prior of one degree of freedom about 1: real sensors differ from it by a factor of a hundred.
    It is then multiplied by Student's quantile over the normal one, because so few contrasts determine it.
    """
    read = [test for test in tests if test.free and test.wrench_base is not None]
    sizes, student = np.ones(6), 1.0
    if common.tolerances.walk_steps > 0.0 and len(read) > 1:
        t = np.cumsum((0.0, *common.walk_seconds))[[test.epoch for test in read]]
        poses = np.unique(np.round([test.gravity_base for test in read], 1), axis=0, return_inverse=True)[1].ravel()
        contrasts = null_space(np.eye(len(read))[poses].T).T  # (n - poses, n)
        to_steps = np.linalg.inv(common.steps)
        bias = contrasts @ np.array([test.wrench_base for test in read]) @ to_steps.T
        noise = np.array([np.diag(to_steps @ np.asarray(test.cov_wrench) @ to_steps.T) for test in read])
        walk = common.tolerances.walk_steps**2 / WALK_SECONDS * np.minimum.outer(t, t) + RAMP_STEPS**2 * np.outer(t, t)
        student = float(student_t.ppf(0.975, len(contrasts) + 1) / norm.ppf(0.975))
        squares = np.geomspace(1.0, MAX_DRIFT, 200)[:, None] ** 2
        for channel in range(6 * (len(contrasts) > 0)):
            sigma = contrasts * noise[:, channel] @ contrasts.T
            w, U = eigh(contrasts @ walk @ contrasts.T, sigma)  # Uᵀ V U = 1 + s² w
            total = 1.0 + squares * np.maximum(w, 0.0)
            loss = np.sum(np.log(total) + (U.T @ bias[:, channel]) ** 2 / total, axis=1)
            loss += np.log(squares[:, 0]) + 1.0 / squares[:, 0]
            best = math.sqrt(squares[int(np.argmin(loss)), 0])
            sizes[channel] = best * student if best > 1.0 else 1.0
    return tuple(sizes.tolist()), student


def _unusable(test: MeasuredTest) -> str:
    """Return why a test cannot be used; empty if it can."""
    placed = np.isfinite(test.s_contact) or test.p_touch_world is not None
    if test.touched and test.wrench_base is None:
        return "it has neither a known force nor a wrench"
    if not test.free and not placed and not len(test.marker_s):
        return "it has neither the place of the load nor markers"
    if not test.touched and not placed and not test.free and test.wrench_base is None:
        return "the place of the known force is missing"
    measured = test.wrench_base is not None or len(test.marker_s) or np.isfinite(test.sag)
    if not measured and (test.free or test.p_touch_world is None):
        return "it has no measured value"
    return ""


def identify(data: IdentificationData, names: Sequence[str] = DEFAULT, accept: bool = False) -> Identification:
    """Identify parameters by robust least squares on the full rod.

    Args:
        data: from `data_of`.
        names: requested parameters, of `parameters.REQUESTABLE`; one that is not observable stays at the design value.
        accept: whether to report numbers, with widened intervals, where the tests contradict the design or each other.

    Raises:
        InputError: an unknown name, too few tests, or tests in which no requested parameter is observable.
    """
    begun = time.perf_counter()
    names = check_requested(names)
    sizes, student = drift_sizes(data.common, data.tests)
    data = replace(data, common=replace(data.common, drift=sizes))
    data, start = _solvable(data, names)
    values = sum(len(block.r) for block in start.blocks if block.kind != "poisson")
    unknowns = len(columns_of(names)) + sum(test.nuisance_size for test in data.tests)
    if values < unknowns:
        raise InputError(f"{data.where}: too few tests for {', '.join(names)}: {values} values are measured for "
                         f"{unknowns} unknowns")  # fmt: skip
    fitted, identified, unobservable = _search(data, names, start)
    outlying = outliers(fitted.point.blocks, fitted.scales)
    at_first = fitted
    left_out = bad_tests(fitted.point.blocks, outlying)
    if left_out and len(left_out) <= max(1, int(MAX_LEFT_OUT * len(data.tests))):
        counts = {name: sum(block.test == name for block, _ in outlying) for name in left_out}
        notes = [f"{name}: left out: {n} of its readings are outliers; check the known force and s_contact_mm, the "
                 "marker numbers, the wrench and the base pose" for name, n in counts.items()]  # fmt: skip
        kept = tuple(test for test in data.tests if test.name not in left_out)
        data, start = _solvable(replace(data, tests=kept, notes=(*data.notes, *notes)), names)
        fitted, identified, unobservable = _search(data, names, start)
    why = next(map(str, contradictions(fitted)), "")
    causes = likely_causes(fitted) if why or fitted.result != "ok" else ()
    why, warnings = why or ("the search did not converge" if causes else ""), tuple[str, ...]()
    explained = bool(causes) and causes[0].explains
    mistaken = any(cause.explains and cause.name not in OF_PRINT for cause in causes)
    if why and not mistaken and (agreeing := reconciled(fitted, identified)) is not None:
        (fitted, warnings), why = agreeing, ""
    if not causes and any(noise.kind == "stiffness" and noise.measured for noise in fitted.noise):
        causes = likely_causes(fitted, ("planes",))
        warnings += tuple(f"warning: likely cause of stiffnesses that scatter: {cause}" for cause in causes)
    exchanges = () if why or not outlying else likely_causes(at_first, ("exchange",))
    outlying = outliers(fitted.point.blocks, fitted.scales)
    problem, blocks = fitted.point.problem, fitted.point.blocks
    quantile = result.student_quantile(fitted)
    used = widened(fitted, causes[0].moves if causes else {}) if why and accept else fitted
    if used is not fitted:
        lost = result.beyond_limits(used, identified)
        identified = tuple(name for name in identified if name not in [other.name for other in lost])
        unobservable += [other for other in lost if "E" not in identified or other.name not in IMPLIED]
    numbers, correlation, correlated = result.identified_numbers(used, identified, unobservable, names, quantile)
    residuals = result.residuals_of(fitted)
    used_tests = {residual.test for residual in residuals}
    whole = Identification(
        fitted.result, data.common.model.name, data.common.model.fingerprint, data.where, len(data.tests),
        sum(len(block.r) for block in blocks), problem.size, numbers, correlation, correlated,
        fitted.noise, quantile,
        tuple(Outlier(*block.key, distance, len(block.r)) for block, distance in outlying),
        result.error_budget(used, identified),
        (*warnings, *data.notes, *(f"possible {cause}" for cause in exchanges),
         *(other.description for other in unobservable),
         *outlier_notes(blocks, outlying),
         *_remarks(fitted, student)),
        residuals, time.perf_counter() - begun, likely_causes=causes,
        served=tuple(test.digest for test in data.tests if test.digest and test.name in used_tests),
    )  # fmt: skip
    if not why:
        return replace(whole, notes=(*whole.notes, result.farthest_tests(whole.residuals))) if warnings else whole
    # a cause that explains the tests is the reason; what the contradiction was noticed by is a note
    reason = f"likely cause: {causes[0]}" if explained else why
    noticed = (*((f"noticed by: {why}",) if explained else ()), result.farthest_tests(whole.residuals))
    whole = replace(whole, why=reason, notes=(*noticed, *whole.notes))
    if not accept:
        return whole.as_inconsistent(reason)
    if not identified:
        return whole.as_inconsistent("; ".join([reason, *(other.description for other in unobservable)]))
    widening = result.widening(used, identified)
    note = (f"accepted although inconsistent: {reason}; standard deviations are up to {widening:.3g} times as large, "
            "by the residuals and by what the likely causes would change")  # fmt: skip
    unfinished = () if fitted.result == "ok" else ("the search ended before it converged: its numbers may be off",)
    return replace(whole, result="accepted", widening=widening, notes=(note, *unfinished, *whole.notes))


def _problem(data: IdentificationData, requested: Sequence[str]) -> LeastSquaresProblem:
    return LeastSquaresProblem(data.common, data.tests, data.mass, data.common.prior_without(requested))


def _search(
    data: IdentificationData, names: Sequence[str], start: Linearization
) -> tuple[Fit, tuple[str, ...], list[UnobservableDirection]]:
    """Fit the observable parameters of `names`; fix the others at the design, one after the other."""
    requested, unobservable = tuple(names), list[UnobservableDirection]()
    while requested:
        problem = _problem(data, requested)
        if unobservable:
            begin = start_point(problem, "E" in requested)
            assert begin is not None  # by `_solvable`, test by test
            start = begin
        # with full weight: what is far off at the start is not an outlier yet
        lost = unobservable_direction(start, np.ones(len(start.blocks)), requested, START_TOLERANCE)
        if lost is None:
            fitted = fit(replace(start, problem=problem))
            lost = unobservable_direction(fitted.point, fitted.weight, requested)
            # Contradictory tests have little weight left; at the start, with full weight, they determined everything.
            if lost is None or inconsistency(fitted):
                return fitted, requested, unobservable
        unobservable.append(lost)
        requested = tuple(name for name in requested if name != lost.name)
    reasons = "; ".join(direction.description for direction in unobservable)
    raise InputError(f"{data.where}: too few tests, or too weak ones: {reasons}")


def _solvable(data: IdentificationData, names: Sequence[str]) -> tuple[IdentificationData, Linearization]:
    """Return the data without the tests in which the rod has no stable equilibrium, with a note for each, and the start
    of the search."""
    if not data.tests:
        first = f": {data.notes[0]}" if data.notes else ""
        raise InputError(f"{data.where}: no test can be used{first}")
    problem, free_E = _problem(data, names), "E" in names
    start = start_point(problem, free_E)
    if start is not None:
        return data, start
    kept, lost = solvable_tests(problem, free_E)
    start = start_point(replace(problem, tests=tuple(kept)), free_E) if kept else None
    if start is None or len(lost) > max(1, int(MAX_LEFT_OUT * len(data.tests))):
        raise InputError(f"{data.where}: the probe buckles in {len(lost)} of {len(data.tests)} tests for any E; is it "
                         "the right design, and are forces in their column's unit?")  # fmt: skip
    notes = tuple(f"{test.name}: not used: the probe buckles under its load" for test in lost)
    return replace(data, tests=tuple(kept), notes=(*data.notes, *notes)), start


def _remarks(fitted: Fit, student: float) -> list[str]:
    """Return notes on the fit for the user; `student` is the factor on the sizes of the drift for their uncertainty,
    which is no drift: it exceeds two where two free readings are all."""
    notes = []
    factor = math.exp(fitted.point.values.x[LOG_E])
    if not 1.0 / SUSPICIOUS_FACTOR < factor < SUSPICIOUS_FACTOR:
        notes.append(f"E is {factor:.3g} times the design's: are forces and moments in their columns' units?")
    common = fitted.point.problem.common
    walk = common.tolerances.walk_steps
    rates = fitted.point.values.x[common.walk_columns(0)] * common.drift * RAMP_STEPS * 3600.0
    for name, size, rate in zip(CHANNELS, common.drift, rates, strict=True):
        if size > NOTED_DRIFT * student:
            notes.append(f"bias of {name}: by the free readings it drifts {size / student:.2g} times as much as "
                         f"assumed; the intervals include up to {size:.2g} times: a walk of {size * walk:.2g} steps of "
                         f"the resolution in {WALK_SECONDS:g} s, a rate of {rate:.2g} steps an hour")  # fmt: skip
    return notes + [
        f"{LABELS[noise.kind]} scatter {noise.scale:.2g} times as much as stated; the intervals include it"
        for noise in fitted.noise
        if noise.measured
    ]
