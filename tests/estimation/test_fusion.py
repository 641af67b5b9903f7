"""Test the fusion of touches of one point: dense least squares, statistics and result codes."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy import stats

from probedesign.core.errors import InputError
from probedesign.core.frames import pose, rotation_z
from probedesign.core.statistics import MISFIT_CHANCE, max_chi2
from probedesign.core.units import MM
from probedesign.estimation.error_sources import ErrorSources
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.fusion import TAIL, Fusion, Reading, _moments
from probedesign.estimation.fusion_state import OBJECT_STEP, SINGLE_FRICTION, channels_of
from probedesign.estimation.model import Tolerances
from probedesign.rod.kernels.surface_contact import AROUND, BY_PARAMETER, POINT
from tests.estimation.true_touches import EXACT, presses, settle, sources_of, wrenches_of
from tests.reference import fusion as dense

RARE = 1e-3
FORCES = np.linspace(2e-3, 1e-2, 5)
PRIORS = {
    "all": Tolerances(),
    "no walk": replace(Tolerances(), walk_steps=0.0),
    "walk alone": replace(EXACT, walk_steps=0.2, drift_steps=0.5),
    "stiffness": replace(EXACT, youngs_modulus=0.03, stiffness_scatter=0.02, creep=0.02, robot_mm=0.01),
    "loose": replace(EXACT, object_walk_mm=0.3, robot_mm=0.01, drift_steps=0.5, walk_steps=0.2),
    "loose and soft": replace(Tolerances(), object_walk_mm=0.3, object_compliance=0.2),
}


@pytest.fixture(scope="module")
def pressed(exact_sources, large):
    """Five touches at 0.7 of the length with friction, and their poses."""
    return presses(exact_sources, 0.7 * large.length, -1.57, FORCES, (0.2, -0.3))


def noisy(model, wrenches, rng):
    return wrenches + rng.multivariate_normal(np.zeros(6), model.noise_base(), len(wrenches))


# The solver


def oracle_of(state, step=None, friction_parts=None, compliance=None):
    """Solve a linearised fusion by dense least squares."""
    poses = []
    for k, touched in enumerate(state.touched):
        lin, D = state.lin[k][:12, :BY_PARAMETER], state.D[k]
        if not touched:
            free, columns = state.free[k]
            lin, D = np.zeros((12, BY_PARAMETER)), np.zeros((12, columns.shape[1]))
            lin[:6, 0], D[:6] = free, columns
        poses.append(dense.LinearPose(
            lin, D, state.touches[k, AROUND : AROUND + 2], state.wrench[k], state.pose[k], state.whiten[k],
            state.model.mass * state.sources[k].gravity, float(state.ramp[k]) if touched else 1.0, bool(touched),
        ))  # fmt: skip
    scatter, creep = (state.sources[0].column(name) for name in ("stiffness scatter", "creep"))
    of = state.priors
    priors = dense.Priors(
        state.channels, state.bias, state.model.friction,
        friction_parts or state.friction_parts, of.robot_mm * MM,
        max(of.drift_steps, 1e-6), of.walk_steps, scatter, creep, compliance or tuple(state.compliance),
        of.object_walk_mm * MM,
    )  # fmt: skip
    return dense.solve(poses, priors, step)


def linearised(large, gravity, pressed, priors, moments, friction):
    """Return five noisy touches and two free readings of a rotated base, linearised away from the solution."""
    model, rng = replace(large.model, friction=friction), np.random.default_rng(1)
    touches, Ts = pressed
    free = large.rod.solve(gravity).wrench_base
    turn = pose(rotation_z(0.3), np.array([0.1, 0.0, -0.2]))
    wrenches = [free, *wrenches_of(touches[:3]), free, *wrenches_of(touches[3:])]
    poses = [Ts[0], *Ts[:3], Ts[2], *Ts[3:]]
    cov = model.noise_base()
    readings = tuple(
        Reading(w + rng.multivariate_normal(np.zeros(6), cov), cov, turn @ T, gravity, k not in (0, 4))
        for k, (w, T) in enumerate(zip(wrenches, poses, strict=True))
    )
    fusion = Fusion(model, readings, PRIORS[priors], channels_of(model, moments), rotation_z(0.3) @ gravity)
    start = np.zeros((7, touches[0].touch.size))
    start[fusion.touched] = [settle(fusion.sources[1], touch.touch[:5] * 1.02).touch for touch in touches]
    state = fusion.state(start)
    assert state.linearise()
    return state


CASES = [
    (moments, friction)
    for moments in (None, "base", "sensor")
    for friction in (0.0, 0.6, math.inf)
    if moments is None or friction < math.inf  # moments alone with a free direction locate nothing
]


@pytest.mark.parametrize(("moments", "friction"), CASES)
@pytest.mark.parametrize("priors", PRIORS)
def test_the_solver_is_dense_least_squares(priors, moments, friction, large, gravity, pressed):
    """Also the change of each touch, and the points of the last touch with their covariances."""
    state = linearised(large, gravity, pressed, priors, moments, friction)
    compliance = tuple(state.compliance)
    chi2, x, cov_x = state.solved()
    wanted = oracle_of(state, compliance=compliance)
    std = np.sqrt(np.diag(wanted.cov)[:3]).max()
    np.testing.assert_allclose(state.point, wanted.x[-9:-6], rtol=0, atol=1e-6 * std)
    np.testing.assert_allclose(x[:-9], wanted.x[:-9], rtol=0, atol=1e-5 * (1.0 + np.abs(wanted.x[:-9]).max()))
    np.testing.assert_allclose(x[-6:], wanted.x[-6:], rtol=0, atol=1e-5 * (1.0 + np.abs(wanted.x[-6:]).max()))
    np.testing.assert_allclose(cov_x, wanted.cov[:3, :3], rtol=0, atol=1e-6 * np.trace(cov_x))
    assert state.cov[3, 3] == pytest.approx(wanted.cov[3, 3], rel=1e-5)
    # A robot that is exact counts as one of 1e-8 m, whose squares cancel to ten digits.
    assert chi2 == pytest.approx(wanted.chi2, rel=1e-4)
    points, covs = state.points()
    size = np.trace(wanted.cov[:3, :3])
    np.testing.assert_allclose(points[1:], wanted.points, rtol=0, atol=1e-5 * math.sqrt(size))
    np.testing.assert_allclose(covs[1:], wanted.covs, rtol=0, atol=1e-6 * size)
    before = state.touches.copy()
    state.step(1.0)
    for k in np.flatnonzero(state.touched):
        own = wanted.own[k, :5]
        if np.abs(own[[1, 3, 4]]).max() < 0.5 and abs(own[0]) < 0.1 * large.length:  # a longer step is shortened
            np.testing.assert_allclose(state.touches[k, :5] - before[k, :5], own, rtol=1e-4, atol=1e-9)


@pytest.mark.parametrize("moments", [None, "sensor"])
@pytest.mark.parametrize("priors", PRIORS)
def test_the_misfit_with_a_step_of_the_object_is_dense_least_squares(priors, moments, large, gravity, pressed):
    state = linearised(large, gravity, pressed, priors, moments, 0.6)
    compliance = tuple(state.compliance)
    fixed, _x, _cov = state.solved(friction_parts=SINGLE_FRICTION)
    for first in (2, 3, 6):
        chi2, weights = state.with_step(first)
        wanted = oracle_of(state, (first, OBJECT_STEP), SINGLE_FRICTION, compliance)
        assert chi2 == pytest.approx(wanted.chi2, rel=1e-4)  # as for a point that does not move
        assert weights.min() > 0.0
        assert weights.max() < 1.0
        assert chi2 < fixed


# Without noise


@pytest.mark.parametrize("moments_only", [False, True])
@pytest.mark.parametrize(
    ("fraction", "force", "phi"), [(0.5, 2e-3, 1.57), (0.8, 1e-2, 0.3), (0.4, 0.1, 3.0), (0.9, 5e-3, -1.57)]
)
def test_without_noise_the_point_is_found(moments_only, fraction, force, phi, large, gravity, exact_sources, exact):
    """Without friction, the mean of its prior, the surface point is the origin, and the centreline a radius away."""
    touches, Ts = presses(exact_sources, fraction * large.length, phi, force * np.array([0.2, 0.5, 0.8, 1.0]))
    c = exact.fuse(wrenches_of(touches), Ts, gravity, moments_only=moments_only)
    assert c.result == "ok"
    # The steps end within a thousandth of a standard deviation, and pull along it in a valley that is bent.
    assert np.linalg.norm(c.p_surface_world) <= 1e-6 + 3e-3 * c.rms
    centre = touches[-1].p_contact - touches[-1].p_surface
    assert np.linalg.norm(c.p_contact_world - centre) <= 1e-5 + 1e-2 * c.rms
    normal = [touch.touch[2] for touch in touches]
    np.testing.assert_allclose(c.force_normal, normal, atol=0.1 * large.model.noise.force)


def test_friction_of_a_free_direction_is_found(large, gravity, exact_sources, exact):
    touches, Ts = presses(exact_sources, 0.7 * large.length, 0.4, 5.0 * FORCES, (0.4, -0.5))
    c = exact.with_friction(math.inf).fuse(wrenches_of(touches), Ts, gravity)
    assert c.result == "ok"
    assert np.linalg.norm(c.p_surface_world) <= 1e-6 + 3e-3 * c.rms
    np.testing.assert_allclose(c.friction_ratio, math.hypot(0.4, 0.5), atol=0.02)


@pytest.mark.parametrize("share", [0.0, 0.5, 0.9])
def test_an_ellipsoid_holds_points_that_bow_with_the_compliance(share):
    """Points on a parabola, of which a share of the variance is beside c, lie in the ellipsoid as often as stated."""
    c, bow, thin = np.linspace(-5.0, 5.0, 401), 1.0, 0.01
    along, beside = math.sqrt(1.0 - share) * c, math.sqrt(share)
    tangent = np.column_stack([np.ones_like(c), bow * along, np.zeros_like(c)])
    points = np.column_stack([along, bow * (along**2 + beside**2) / 2.0, np.zeros_like(c)])
    covs = beside**2 * tangent[:, :, None] * tangent[:, None, :] + thin**2 * np.eye(3)
    covs[:, 1, 1] += 3.0 * TAIL * (beside**2 * bow / 2.0) ** 2  # that of a given c, as `Fusion.curvature` adds it
    weight = np.exp(-0.5 * c**2)
    cov, mean, _ = _moments(weight / weight.sum(), c, points[:, None], covs[:, None])
    t, rng = np.random.default_rng(1).normal(size=20_000), np.random.default_rng(2)
    true = np.column_stack([t, bow * t**2 / 2.0, np.zeros_like(t)]) + thin * rng.normal(size=(len(t), 3))
    error = true - mean[0]
    inside = np.einsum("ni,ij,nj->n", error, np.linalg.inv(cov[0]), error) <= max_chi2(3, 0.05)
    assert 0.935 < inside.mean() < 0.97  # TAIL promises 95 % about the vertex; the mean square alone gives 92 %


def test_the_interval_of_a_rigid_object_contains_zero(large, gravity, exact_sources):
    """The true compliance is the bound of its prior: 19 of 20 one-sided intervals contain it."""
    touches, Ts = presses(exact_sources, 0.5 * large.length, 0.4, FORCES / 2.0)
    estimator = Estimator(large.model, replace(EXACT, object_compliance=0.05))
    rng = np.random.default_rng(1)
    found = [estimator.fuse(noisy(large.model, wrenches_of(touches), rng), Ts, gravity) for _ in range(40)]
    assert all(f.ok for f in found)
    held = sum(f.object_compliance_interval_95[0] == 0.0 for f in found)
    assert held >= stats.binom.ppf(RARE, len(found), 0.95)  # 33 of 40; the shortest interval: 69 of 100


def test_the_contact_may_slide_and_the_base_may_turn(large, gravity, exact_sources, exact):
    """The point of the object is fixed, and the touched material point may change."""
    touches, Ts = presses(exact_sources, 0.6 * large.length, 0.5, 2.0 * FORCES, slide=3e-3)
    turn = pose(rotation_z(0.4))
    c = exact.fuse(wrenches_of(touches), turn @ Ts, turn[:3, :3] @ gravity)
    assert c.result == "ok"
    assert np.linalg.norm(c.p_surface_world) <= 1e-5
    np.testing.assert_allclose(np.diff(c.s_contact), 3e-3, atol=2e-5)


# Both end within a hundredth of a standard deviation or so; weights at one place against columns there. Only the fusion
# moves the point by the bow that the reading suggests: up to four hundredths.
@pytest.mark.parametrize(
    ("tolerances", "apart"),
    [(EXACT, 0.03), (replace(Tolerances(), pose_deg=0.0, bow_mm=0.0), 0.03),
     (replace(Tolerances(), pose_deg=0.0), 0.05)],
    ids=["exact", "all", "bent"],
)  # fmt: skip
@pytest.mark.parametrize(("fraction", "force"), [(0.4, 0.05), (0.7, 0.02), (0.9, 0.02)])
def test_one_pose_is_one_estimate(tolerances, apart, fraction, force, large, gravity, touched):
    rng = np.random.default_rng(4)
    estimator = Estimator(large.model, tolerances)
    T = pose(rotation_z(0.7), np.array([0.2, 0.1, 0.0]))
    noise = rng.multivariate_normal(np.zeros(6), large.model.noise_base())
    wrench = touched(fraction * large.length, force, 0.8, 0.2, 0.1) + noise
    one = estimator.estimate(wrench, gravity)
    fused = estimator.fuse([wrench], [T], T[:3, :3] @ gravity)
    assert one.ok and fused.ok
    R, std = T[:3, :3], math.sqrt(np.trace(one.cov_surface_base))
    assert np.linalg.norm(R @ one.p_surface_base + T[:3, 3] - fused.p_surface_now_world) <= apart * std
    wanted = R @ one.cov_surface_base @ R.T
    np.testing.assert_allclose(fused.cov_surface_now_world, wanted, rtol=0, atol=0.03 * np.trace(wanted))
    assert fused.force_normal[0] == pytest.approx(one.force_normal, abs=0.1 * large.model.noise.force)


# Bounds and statistics

# Cramér–Rao bounds of five touches [mm], large probe, forces up to the one given, 3 % on E, poses to 0.01 mm, bias
# walking 0.2 steps, all six channels, by the prior on friction 0, 0.3, 0.6 (issue 19, second table of `friction.md`).
# The friction of each touch is independent there.
FIVE = [
    (0.5, 2.0, (2.98, 3.03, 3.16)),
    (0.5, 5.0, (1.41, 1.50, 1.65)),
    (0.8, 2.0, (1.61, 1.65, 1.72)),
    (0.8, 5.0, (1.06, 1.09, 1.18)),
]


@pytest.mark.parametrize(("fraction", "force_mN", "bounds"), FIVE)
def test_published_bounds_of_five_touches(fraction, force_mN, bounds, large, gravity, exact_sources):
    """The tolerance is a tenth, because the table lacks the lowest force, assumed as 0.3 of the highest."""
    priors = replace(EXACT, youngs_modulus=0.03, robot_mm=0.01, walk_steps=0.2)
    forces = 1e-3 * force_mN * np.linspace(0.3, 1.0, 5)
    touches, Ts = presses(exact_sources, fraction * large.length, -1.57, forces)
    for friction, bound_mm in zip((0.0, 0.3, 0.6), bounds, strict=True):
        model = replace(large.model, friction=friction)
        readings = tuple(
            Reading(w, model.noise_base(), T, gravity, True) for w, T in zip(wrenches_of(touches), Ts, strict=True)
        )
        fusion = Fusion(model, readings, priors, channels_of(model, None), gravity, friction_parts=SINGLE_FRICTION)
        state = fusion.state(np.array([touch.touch for touch in touches]))
        assert state.linearise()
        bound = math.sqrt(np.trace(state.solved()[2]))
        assert 1e3 * bound == pytest.approx(bound_mm, rel=0.1)
        stated = fusion.solve().rms
        assert bound <= stated <= 1.15 * bound  # the curve of the likely points adds to the linear bound


# Where an object that yields as much as the probe would need a contact off the probe, the integral over its compliance
# ends at one of a few places, half a step apart.
@pytest.mark.parametrize(
    ("name", "force_mN", "compliance", "jump"),
    [("large", 5.0, 0.0, 0.05), ("large", 5.0, 0.05, 0.15), ("small", 2.0, 0.05, 0.15)],
)
def test_the_stated_error_goes_smoothly_along_the_probe(name, force_mN, compliance, jump, probes, gravity):
    """The RMS error is a smooth function of the place: it changes by a few percent per hundredth of the length."""
    model = probes[name].model
    sources, estimator = sources_of(model, gravity), Estimator(model)
    rms = []
    for fraction in np.arange(0.75, 0.96, 0.01):
        touches, Ts = presses(sources, fraction * model.rod.length, -1.57, 1e-3 * force_mN * np.linspace(0.2, 1.0, 5))
        rms.append(estimator.fuse(wrenches_of(touches), Ts, gravity, object_compliance=compliance).rms)
    # Near the end of the probe the curve of the likely points is evaluated on one side alone, a step of 4 %.
    assert np.abs(np.diff(np.log(rms))).max() < jump


def disturbed(model, tolerances, touches, gravity, rng):
    """Return readings and poses of touches of the origin with all error sources drawn, to first order.

    The touches keep their places on the probe; the base moves so that the true touched point is the origin.
    """
    sources = ErrorSources.of(model, tolerances, gravity, model.rod.solve(gravity), posed=True)
    names = np.array(sources.names)
    m, step = rng.normal(size=len(names)), np.linalg.cholesky(model.noise_base() * model.averaging_samples)
    bias = tolerances.drift_steps * rng.normal(size=6)
    wrenches, Ts = [], []
    for k, of in enumerate(touches):
        touch = settle(sources, of.touch[:5])
        off = np.where(names == "stiffness scatter", rng.normal(size=len(names)), m)
        off = np.where(names == "creep", off * k / (len(touches) - 1), off)
        bias = bias + (tolerances.walk_steps * rng.normal(size=6) if k else 0.0)
        noise = rng.multivariate_normal(np.zeros(6), model.noise_base())
        wrenches.append(touch.wrench + touch.D[:6] @ off + step @ bias + noise)
        robot = tolerances.robot_mm * MM * rng.normal(size=3)
        Ts.append(pose(np.eye(3), -(touch.p_surface + touch.D[POINT : POINT + 3] @ off) + robot))
    return np.array(wrenches), np.array(Ts)


@pytest.mark.parametrize("moments_only", [False, True])
def test_five_touches_scatter_as_stated_with_every_source_drawn(moments_only, large, gravity, exact_sources):
    """The coverage is correct if friction, probe, mount, sensor, robot and stiffness are drawn from their priors."""
    rng, draws, squares, ratios, codes = np.random.default_rng(8), 25, [], [], []
    estimator, s = large.estimator(), 0.7 * large.length
    for _ in range(draws):
        forces = np.linspace(1e-3, 5e-3, 5)
        touches = []
        for force in forces:
            ratio = np.clip(0.6 * rng.normal(size=2), -1.5, 1.5)
            touches.append(settle(exact_sources, np.array([s, -1.57, force, *ratio])))
        wrenches, Ts = disturbed(large.model, estimator.priors, touches, gravity, rng)
        c = estimator.fuse(wrenches, Ts, gravity, moments_only=moments_only, moments_about="sensor")
        codes.append(c.result)
        if c.ok:
            squares.append(c.p_surface_world @ np.linalg.solve(c.cov_surface_world, c.p_surface_world))
            ratios.append(c.p_surface_world @ c.p_surface_world / np.trace(c.cov_surface_world))
    assert codes.count("ok") >= draws - 2
    low, high = (stats.chi2(3 * len(squares)).ppf(q) / len(squares) for q in (RARE, 1.0 - RARE))
    assert low <= np.mean(squares) <= high
    inside = np.sum(np.array(squares) < stats.chi2(3).ppf(0.95))
    assert inside >= stats.binom(len(squares), 0.95).ppf(RARE)
    # One of three axes carries most of it: the root of a mean of 25 values of χ² with one to two degrees of freedom.
    assert 0.6 <= math.sqrt(np.mean(ratios)) <= 1.4


def test_free_readings_tie_the_bias_down(large, gravity, pressed):
    rng, (touches, Ts) = np.random.default_rng(3), pressed
    free = large.rod.solve(gravity).wrench_base
    bias = 10.0 * np.sqrt(np.diag(large.model.noise_base()))
    readings = noisy(large.model, np.vstack([free, wrenches_of(touches), free]), rng) + bias
    poses, touched = np.concatenate([Ts[:1], Ts, Ts[-1:]]), [False, *[True] * 5, False]
    estimator = Estimator(large.model, replace(EXACT, drift_steps=3.0))
    c = estimator.fuse(readings, poses, gravity, touched=touched)
    alone = estimator.fuse(readings[1:6], Ts, gravity)
    assert c.result == "ok" and c.rms < alone.rms
    off = c.p_surface_world
    assert off @ np.linalg.solve(c.cov_surface_world, off) <= stats.chi2(3).ppf(1.0 - RARE)
    assert np.isnan(c.s_contact[[0, 6]]).all() and not c.force_base[[0, 6]].any()
    assert Estimator(large.model, EXACT).fuse(readings, poses, gravity, touched=touched).result == "inconsistent"


def test_what_is_uncertain_is_counted(large, gravity, pressed):
    touches, Ts = pressed
    wrenches = wrenches_of(touches)
    exact, vague = (e.fuse(wrenches, Ts, gravity) for e in (Estimator(large.model, EXACT), large.estimator()))
    assert vague.rms > exact.rms
    assert vague.rms == pytest.approx(math.sqrt(np.trace(vague.cov_surface_world)), rel=1e-6)
    for more in ({"creep": 0.05}, {"stiffness_scatter": 0.05}, {"tilt_deg": 1.0}, {"robot_mm": 0.5}):
        wider = large.estimator().with_tolerances(replace(large.estimator().priors, **more))
        assert wider.fuse(wrenches, Ts, gravity).rms > vague.rms, more


# Codes


def test_one_pose_with_moments_alone_is_unobservable(large, gravity, exact, pressed):
    touches, Ts = pressed
    wrenches = np.tile(wrenches_of(touches)[2], (3, 1))
    for count in (1, 3):
        c = exact.fuse(wrenches[:count], np.tile(Ts[2], (count, 1, 1)), gravity, moments_only=True)
        assert c.result == "unobservable"
        assert np.isnan(c.p_surface_world).all()


@pytest.mark.parametrize("rig", ["sensor", "robot"])
def test_an_offset_of_the_base_is_within_what_is_stated(rig, large, gravity, exact_sources):
    """The moment of a strong press depends on a base offset on the sensor, but not on an error of the reported pose."""
    rng, draws = np.random.default_rng(4), 20
    estimator = Estimator(large.model, replace(EXACT, base_mm=0.1))
    touches, Ts = presses(exact_sources, 0.4 * large.length, 1.57, np.linspace(0.05, 0.25, 5))
    squares = []
    for offset in 1e-4 * rng.normal(size=(draws, 3)):
        wrenches, poses = wrenches_of(touches), Ts.copy()
        if rig == "robot":
            poses[:, :3, 3] += offset
        else:  # the probe and all that it touches lie elsewhere on the sensor
            wrenches[:, 3:] += np.cross(offset, wrenches[:, :3] - large.rod.solve(gravity).wrench_base[:3])
            poses[:, :3, 3] -= offset
        c = estimator.fuse(noisy(large.model, wrenches, rng), poses, gravity)
        assert c.ok
        squares.append(c.p_surface_world @ np.linalg.solve(c.cov_surface_world, c.p_surface_world))
    # Each of both offsets is drawn alone, so that the mean is that of χ² with three degrees of freedom at most.
    assert np.mean(squares) < 3.0 + 3.0 * math.sqrt(6.0 / draws)


def test_touches_of_the_tip_are_located_though_noise_places_them_beyond_it(large, gravity, exact_sources):
    rng, draws, squares = np.random.default_rng(6), 20, []
    estimator = Estimator(large.model, replace(EXACT, youngs_modulus=0.03, base_mm=0.083, drift_steps=0.5))
    touches, Ts = presses(exact_sources, large.rod.flank_end, 1.57, np.linspace(1e-3, 4.5e-3, 5))
    for _ in range(draws):
        c = estimator.fuse(noisy(large.model, wrenches_of(touches), rng), Ts, gravity)
        assert c.ok
        squares.append(c.p_surface_world @ np.linalg.solve(c.cov_surface_world, c.p_surface_world))
    # Stiffness and base have no errors here, so that the mean is that of χ² with three degrees of freedom at most.
    assert np.mean(squares) < 3.0 + 3.0 * math.sqrt(6.0 / draws)


@pytest.mark.parametrize("friction", [0.6, math.inf])
def test_readings_of_one_pose_are_one_window(friction, large, gravity, exact, pressed):
    """The priors of friction and stiffness of a touch enter once for any number of readings."""
    exact = exact.with_friction(friction)
    rng, (touches, Ts) = np.random.default_rng(6), pressed
    window = noisy(large.model, np.tile(wrenches_of(touches)[4], (6, 1)), rng)
    one = exact.estimate(window, gravity)
    c = exact.fuse(window, np.tile(Ts[4], (6, 1, 1)), gravity)
    assert one.ok and c.ok
    # The estimate ends its iterations within a hundredth of a standard deviation.
    assert np.linalg.norm(one.p_surface_base + Ts[4, :3, 3] - c.p_surface_world) <= 0.02 * c.rms
    assert c.rms == pytest.approx(math.sqrt(np.trace(one.cov_surface_base)), rel=0.02)
    assert len(c.s_contact) == len(c.force_normal) == 6


@pytest.mark.parametrize(("touched", "result"), [(None, "no_contact"), ([False] * 3, "unobservable")])
def test_readings_of_a_free_probe_locate_nothing(touched, result, large, gravity, pressed):
    free = np.tile(large.rod.solve(gravity).wrench_base, (3, 1))
    wrenches = noisy(large.model, free, np.random.default_rng(2))
    assert large.estimator().fuse(wrenches, pressed[1][:3], gravity, touched=touched).result == result


def test_the_bias_walks_with_the_times_of_the_readings(large, gravity, pressed):
    """Readings without times are assumed 16 s apart, the interval of the stated random walk."""
    touches, Ts = pressed
    estimator = Estimator(large.model, replace(EXACT, drift_steps=0.1, walk_steps=1.0))
    wrenches, apart = wrenches_of(touches), 16.0 * np.arange(5)
    found = [estimator.fuse(wrenches, Ts, gravity, times=times) for times in (None, apart, 0.01 * apart)]
    assert all(c.ok for c in found)
    assert found[0].rms == pytest.approx(found[1].rms, rel=1e-12)
    assert found[2].rms < found[1].rms
    assert estimator.fuse(wrenches, Ts, gravity, times=-apart).result == "out_of_range"
    with pytest.raises(InputError):
        estimator.fuse(wrenches, Ts, gravity, times=apart[:3])


def test_what_is_stated_is_never_larger_than_the_probe(large, gravity, exact_sources):
    """The curvature correction of the covariance precedes the choice of the result code."""
    rng, codes = np.random.default_rng(7), []
    for fraction, force in product((0.1, 0.3, 0.6), (5e-4, 1e-3, 2e-3)):
        touches, Ts = presses(exact_sources, fraction * large.length, 1.57, [force, 2.0 * force])
        for count in (1, 2):
            c = large.estimator().fuse(noisy(large.model, wrenches_of(touches)[:count], rng), Ts[:count], gravity)
            codes.append(c.result)
            assert not c.ok or c.rms < large.length / math.sqrt(12.0)
    assert "too_light" in codes


@pytest.mark.parametrize("priors", [EXACT, Tolerances()], ids=["exact", "all"])
@pytest.mark.parametrize("step", [(0.0, 4e-3, 0.0), (1e-3, 0.0, 0.0)])
def test_an_object_that_moves_is_inconsistent(step, priors, large, gravity, exact_sources):
    touches, Ts = presses(exact_sources, 0.7 * large.length, -1.57, 4.0 * FORCES, (0.2, -0.3))
    Ts = Ts.copy()
    Ts[3:, :3, 3] += step
    c = Estimator(large.model, priors).fuse(wrenches_of(touches), Ts, gravity)
    assert c.result == "inconsistent"
    # With every source counted a step of a millimetre shows although the misfit is below its limit.
    assert (c.chi2 < max_chi2(c.dof, MISFIT_CHANCE)) == (priors is not EXACT and step[0] > 0.0)


def test_a_touch_that_slips_stays_ok(large, gravity, exact_sources):
    """The friction reverses while the point of the object is fixed."""
    touches, poses = [], []
    for k, force in enumerate(FORCES):
        ratios = (0.0, 0.5 if k < 3 else -0.5)
        (touch,), (T,) = presses(exact_sources, 0.7 * large.length + 1e-3 * k, -1.57, [force], ratios)
        touches.append(touch)
        poses.append(T)
    c = large.estimator().fuse(wrenches_of(touches), poses, gravity)
    assert c.result == "ok"
    assert np.linalg.norm(c.p_surface_world) <= 1.5 * c.rms
    assert np.diff(c.s_contact)[[0, 3]] == pytest.approx([1e-3, 1e-3], abs=3e-4)


def test_a_step_of_the_bias_is_inconsistent(large, gravity, exact_sources, exact):
    touches, Ts = presses(exact_sources, 0.7 * large.length, -1.57, 4.0 * FORCES)
    wrenches = wrenches_of(touches)
    wrenches[3:, 4] += 5e-4
    assert exact.fuse(wrenches, Ts, gravity).result == "inconsistent"


@pytest.mark.parametrize("bad", ["nan", "saturated", "not a rotation", "mirrored", "infinite pose"])
def test_readings_and_poses_that_cannot_be_give_no_number(bad, large, gravity, pressed):
    touches, Ts = pressed
    wrenches, Ts = wrenches_of(touches), Ts.copy()
    if bad == "nan":
        wrenches[0, 4] = np.nan
    elif bad == "saturated":
        wrenches[0, 3] = 10.0
    elif bad == "not a rotation":
        Ts[1, 0, 0] = 2.0
    elif bad == "mirrored":
        Ts[1, 0, 0] = -1.0
    else:
        Ts[1, 0, 3] = np.inf
    c = large.estimator().fuse(wrenches, Ts, gravity)
    assert c.result == "out_of_range"
    assert np.isnan(c.p_surface_world).all() and np.isnan(c.p_contact_world).all()


def test_moments_alone_about_the_base_need_no_forces(large, gravity, exact, pressed):
    touches, Ts = pressed
    wrenches = wrenches_of(touches)
    wrenches[:, :3] = np.nan
    c = exact.fuse(wrenches, Ts, gravity, moments_only=True)
    assert c.result == "ok"
    assert np.linalg.norm(c.p_surface_world) <= 2.0 * c.rms


# Input


@pytest.mark.parametrize(
    ("wrenches", "Ts"), [(np.zeros((2, 5)), np.zeros((2, 4, 4))), (np.zeros((2, 6)), np.zeros((1, 4, 4))),
                         (np.zeros((0, 6)), np.zeros((0, 4, 4))), (np.zeros(6), np.zeros((4, 4))), (0.0, np.eye(4))]
)  # fmt: skip
def test_wrong_shapes_are_refused(wrenches, Ts, large):
    with pytest.raises(InputError, match="shape"):
        large.estimator().fuse(wrenches, Ts)


def test_moments_about_nowhere_are_refused(large):
    with pytest.raises(InputError, match="moments_about"):
        large.estimator().fuse(np.zeros((2, 6)), np.tile(np.eye(4), (2, 1, 1)), moments_only=True, moments_about="tip")


@pytest.mark.parametrize("wrong", [{"youngs_modulus": -0.1}, {"creep": np.nan}, {"base_mm": np.inf}, {"gain": np.inf}])
def test_priors_that_are_none_are_refused(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        Tolerances(**wrong)


def test_the_sensors_own_moments_hold_no_noise_of_its_forces(large):
    model = large.model
    of = channels_of(model, "sensor")
    np.testing.assert_allclose(of @ model.noise_base() @ of.T, model.noise.moment**2 * np.eye(3), rtol=1e-9, atol=1e-22)


def test_a_reading_is_compared_with_the_free_probe_of_its_own_pose(large, gravity):
    """The base turns by 30° after a free reading: the second one is free as well, whatever the first one was."""
    Ts = np.array([pose(), pose(rotation_z(math.radians(30.0))[:3, :3])])
    free = [large.rod.solve(gravity @ T[:3, :3]).wrench_base for T in Ts]
    assert large.estimator().fuse(free, Ts, gravity, touched=[False, True]).result == "no_contact"
