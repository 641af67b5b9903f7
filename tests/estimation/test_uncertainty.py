"""Test error columns against changed probes, the covariance against numpy, and known bounds."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from probedesign.core.frames import inverse as inverse_pose
from probedesign.core.frames import pose, wrench_map
from probedesign.estimation.error_sources import BEFORE_KNOTS, CAUSES, ErrorSources
from probedesign.estimation.estimator import Estimator
from probedesign.estimation.model import Tolerances
from probedesign.rod.kernels.surface_contact import BY_PARAMETER, BY_TOUCH, CENTRE, POINT
from tests.estimation.true_touches import EXACT, settle, sources_of
from tests.reference.surface_contact import SurfaceTouch, solve_touch
from tests.reference.uncertainty import information, inverse, point_covariance, reading_covariance

TOUCHES = {
    "near the base": (0.3, 0.5, 0.1, 0.2, -0.3),
    "mid": (0.6, -1.6, 0.02, 0.0, 0.0),
    "far": (0.8, 2.2, 0.01, -0.3, 0.5),
}
TOLERANCES = {
    "exact": EXACT,
    "all": Tolerances(),
    "drift": replace(EXACT, drift_steps=0.5),
    "not tared": replace(Tolerances(), tared=False),
}
PRIORS = (0.0, 0.3, 0.6, math.inf)


def unknowns(model, name):
    fraction, *rest = TOUCHES[name]
    return np.array([fraction * model.rod.length, *rest])


# Covariance


@pytest.mark.parametrize("friction", PRIORS)
@pytest.mark.parametrize("tolerances", TOLERANCES)
@pytest.mark.parametrize("touch", TOUCHES)
def test_the_linear_covariance_is_that_of_the_formula(touch, tolerances, friction, large, gravity):
    sources = sources_of(large.model, gravity, TOLERANCES[tolerances])
    true = settle(sources, unknowns(large.model, touch) * [1.0, 1.0, 1.0, friction > 0.0, friction > 0.0])
    estimator = Estimator(large.model, TOLERANCES[tolerances]).with_friction(friction)
    c = estimator.estimate(true.wrench, gravity).candidates[0]
    # Where the fit ended, as the kernel linearised it but for a thirtieth of a standard deviation.
    lin, D = sources.columns_at(c.touch.copy())
    H, noise = lin[:6, BY_TOUCH:BY_PARAMETER], large.model.noise_base() + sources.drift
    for rows, found in ((POINT, c.cov_linear_base), (CENTRE, c.cov_linear_contact_base)):
        at = slice(rows, rows + 3)
        wanted = point_covariance(H, lin[at, BY_TOUCH:BY_PARAMETER], D[:6], D[at], noise, friction)
        if friction == math.inf or touch == "mid":  # the truth without noise is then the estimate itself
            np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-4 * np.trace(wanted))
        else:
            np.testing.assert_allclose(found, wanted, rtol=0, atol=2e-2 * np.trace(wanted))
    size = c.touch[2] * math.sqrt(1.0 + c.touch[3] ** 2 + c.touch[4] ** 2)
    assert c.lever == pytest.approx(np.linalg.norm(H[3:, 0]) / size, rel=1e-2)
    sigma = reading_covariance(noise, D[:6])
    np.testing.assert_allclose(
        np.trace(c.fit["whiten"] @ sigma @ c.fit["whiten"].T), 6.0, rtol=2e-3 if tolerances != "exact" else 1e-9
    )
    C = inverse(information(H, sigma, friction))
    # A last step of a thirtieth of a standard deviation is taken after the covariance.
    np.testing.assert_allclose(np.diag(c.fit["cov_touch"]), np.diag(C), rtol=5e-2)


# Bounds of single touches, large probe, gravity across: Cramér–Rao bounds [mm] by finite differences of a rod of their
# own, issue 19 (`friction.md`, first table): fraction of the length, normal force [mN], then by the prior on friction.
BOUNDS = [
    (0.4, 5.0, (7.12, 7.15, 7.16, 7.16)),
    (0.4, 20.0, (1.78, 1.79, 1.79, 1.79)),
    (0.4, 50.0, (0.72, 0.72, 0.72, 0.72)),
    (0.6, 5.0, (10.28, 10.29, 10.29, 10.29)),
    (0.6, 20.0, (2.55, 2.58, 2.58, 2.58)),
    (0.6, 50.0, (0.94, 1.04, 1.04, 1.04)),
    (0.8, 5.0, (13.05, 13.41, 13.45, 13.46)),
    (0.8, 20.0, (2.21, 3.40, 3.41, 3.41)),
    (0.8, 50.0, (0.41, 1.44, 1.44, 1.44)),
    (0.95, 5.0, (8.14, 14.09, 15.41, 16.01)),
    (0.95, 20.0, (0.57, 4.01, 4.35, 4.48)),
]


@pytest.mark.parametrize(("fraction", "force_mN", "bounds"), BOUNDS)
def test_published_bounds_of_single_touches(fraction, force_mN, bounds, large, gravity, touched):
    for friction, bound_mm in zip(PRIORS, bounds, strict=True):
        wrench = touched(fraction * large.length, 1e-3 * force_mN)
        estimate = Estimator(large.model, EXACT).with_friction(friction).estimate(wrench, gravity)
        linear = estimate.candidates[0].cov_linear_base
        assert 1e3 * math.sqrt(np.trace(linear)) == pytest.approx(bound_mm, rel=0.03), friction


# Error columns


def true_reading(model, gravity, touch, own, turn, root, tared):
    """Return wrench, touched and centreline point of a perturbed probe in the base frame of the model, (12,).

    Args:
        touch: (s, φ, f_n, a_1, a_2) of the modelled probe; s keeps its place over the length.
        own: off in log E, log G, log density, log length, curvature at rest about x and y, and log diameters, (6 + K,).
        turn: shift and turn of the base [m, rad] and change of gravity [m/s²], (9,).
        root: more of `rigid_length` [m].
        tared: whether the free probe's reading is taken away.
    """
    e, g, density, length = np.exp(own[:4])
    knots, bent = np.exp(own[BEFORE_KNOTS:]), [*own[4:BEFORE_KNOTS], 0.0]
    rod = replace(
        model.rod,
        s=length * model.rod.s,
        radius=model.rod.radius * knots,
        rest_curvature=np.tile(bent, (len(knots), 1)),
        youngs_modulus=e * model.rod.youngs_modulus,
        shear_modulus=g * model.rod.shear_modulus,
        density=density * model.rod.density,
        rigid_length=model.rod.rigid_length + root,
    )
    R = Rotation.from_rotvec(turn[3:6]).as_matrix()
    at = pose(R, turn[:3])  # of the true base in the modelled one
    true_gravity = R.T @ (gravity + turn[6:])
    s, *rest = touch
    solved = solve_touch(rod, true_gravity, SurfaceTouch(length * s, *rest))
    to_model = wrench_map(at)
    # What hangs on the sensor is taken off as under the modelled gravity.
    hangs = wrench_map(inverse_pose(model.T_sensor_base)) @ model.payload_by_gravity @ turn[6:]
    wrench = to_model @ solved.wrench + hangs
    if tared:
        wrench = wrench - to_model @ rod.solve(true_gravity, mode="reference").wrench_base - hangs
    return np.concatenate([wrench, *(R @ p + turn[:3] for p in (solved.p_surface, solved.p_contact))])


def assert_columns(by_hand, column, allowed, name, moment=2e-9):
    """Compare columns: wrench and touched point to `allowed`, the centreline point to the error of its parabola."""
    for rows, share in ((slice(0, 3), allowed), (slice(3, 6), allowed), (slice(6, 9), allowed), (slice(9, 12), 0.05)):
        # And a thousandth of a noise (force, moment), a tenth of a micrometre.
        floor = {0: 5e-7, 3: moment, 6: 1e-7, 9: 1e-6}[rows.start]
        off = np.abs(by_hand[rows] - column[rows]).max()
        assert off <= share * np.abs(by_hand[rows]).max() + floor, (name, rows)


@pytest.mark.parametrize("tared", [True, False])
@pytest.mark.parametrize("touch", TOUCHES)
def test_error_columns_are_differences_of_other_probes(touch, tared, large):
    """All sources but root and gain. The probe has no bonded root, whose reach depends on the base radius."""
    model = replace(large.model, rod=replace(large.model.rod, rigid_length=0.0))
    gravity = np.array([9.0, 1.0, -3.0])
    sources = sources_of(model, gravity, replace(Tolerances(), tared=tared))
    y = unknowns(model, touch)
    D = settle(sources, y).D
    rows = [
        *((row, np.zeros(9)) for row in sources.rod),
        *((np.zeros(BEFORE_KNOTS + len(model.rod.s)), row) for row in sources.base),
    ]
    assert len(rows) + 7 == D.shape[1]
    h = 0.05  # of a standard deviation: third order is below a thousandth
    for c, (own, turn) in enumerate(rows):
        high, low = (true_reading(model, gravity, y, way * own, way * turn, 0.0, tared) for way in (h, -h))
        assert_columns((high - low) / (2.0 * h), D[:, c], 5e-3, sources.names[c])


@pytest.mark.parametrize("tared", [True, False])
@pytest.mark.parametrize("touch", TOUCHES)
def test_a_reported_rotation_that_is_off_turns_points_and_gravity(touch, tared, large):
    """The sensor turns with the base, so the wrench changes by gravity alone; a point counts in the world only."""
    model, gravity, std = large.model, np.array([9.0, 1.0, -3.0]), math.radians(0.3)
    tolerances = replace(EXACT, pose_deg=0.3, tared=tared)
    free, y = model.rod.solve(gravity), unknowns(large.model, touch)
    sources = ErrorSources.of(model, tolerances, gravity, free, posed=True)
    assert sources.names[:3] == ("pose",) * 3 and "pose" not in sources_of(model, gravity, tolerances).names

    def seen(turn):
        R = Rotation.from_rotvec(turn).as_matrix()
        change = np.concatenate([np.zeros(6), R.T @ gravity - gravity])
        wrench_points = true_reading(model, gravity, y, np.zeros(BEFORE_KNOTS + len(model.rod.s)), change, 0.0, tared)
        return np.concatenate([wrench_points[:6], R @ wrench_points[6:9], R @ wrench_points[9:]])

    D, h = settle(sources, y).D, 0.05 * std
    for c, axis in enumerate(np.eye(3)):
        assert_columns((seen(h * axis) - seen(-h * axis)) * std / (2.0 * h), D[:, c], 5e-3, f"pose {c}")


@pytest.mark.parametrize("rigid_radii", [0.0, 0.12, -0.18])
@pytest.mark.parametrize("touch", TOUCHES)
def test_the_column_of_the_root_is_a_difference(touch, rigid_radii, large, gravity):
    r0 = large.model.rod.radius[0]
    model = replace(large.model, rod=replace(large.model.rod, rigid_length=rigid_radii * r0))
    sources = sources_of(model, gravity, replace(EXACT, root_radii=0.15))
    y, none = unknowns(model, touch), np.zeros(BEFORE_KNOTS + len(model.rod.s))
    h = 0.01
    high, low = (true_reading(model, gravity, y, none, np.zeros(9), way * 0.15 * r0, tared=True) for way in (h, -h))
    column = settle(sources, y).D[:, sources.names.index("root")]
    # The compliance lies spread over two base radii and counts at their centre, under the base's own moment: two
    # hundredths of what touch and gravity show each, or of the moment's noise for their difference.
    assert_columns((high - low) / (2.0 * h), column, 0.03, "root", 0.02 * large.model.noise.moment)


@pytest.mark.parametrize("tared", [True, False])
def test_a_gain_scales_one_channel_of_what_the_sensor_reads_since_its_zero(tared, large, gravity):
    model, tolerances = large.model, replace(EXACT, gain=0.01, tared=tared)
    sources = sources_of(model, gravity, tolerances)
    true = settle(sources, unknowns(model, "mid"))
    free = model.to_sensor(model.rod.solve(gravity).wrench_base, gravity)
    read = model.to_sensor(true.wrench, gravity)
    first = sources.names.index("gain")
    for i in range(6):
        scaled = read.copy()
        scaled[i] += 0.01 * (read[i] - (free[i] if tared else 0.0))
        wanted = model.to_base(scaled, gravity) - true.wrench
        np.testing.assert_allclose(true.D[:6, first + i], wanted, rtol=1e-4, atol=1e-6 * np.abs(wanted).max() + 1e-15)
        assert not true.D[6:, first + i].any()


def test_a_tare_takes_away_what_the_free_probe_shows(large, gravity):
    """The error columns of the free probe are zero; after a tare in another pose they are the difference."""
    model = large.model
    sources = sources_of(model, gravity, Tolerances())
    free = model.rod.solve(gravity)
    np.testing.assert_allclose(sources.free_columns(free), 0.0, atol=1e-12)
    upright = np.array([0.0, 0.0, 9.81])
    there = model.rod.solve(upright)
    moved = ErrorSources.of(model, Tolerances(), upright, there, sources)
    bare = sources_of(model, upright, replace(Tolerances(), tared=False))
    before = sources_of(model, gravity, replace(Tolerances(), tared=False))
    ours = [i for i, name in enumerate(moved.names) if name != "gain"]
    wanted = bare.free_columns(there) - before.free_columns(free)
    np.testing.assert_allclose(moved.free_columns(there)[:, ours], wanted[:, ours], atol=1e-12)


def test_every_source_has_its_columns(large, gravity):
    sources = sources_of(large.model, gravity, Tolerances())
    assert set(sources.names) == set(CAUSES) - {"noise", "drift", "bore", "pose"}  # solid, and no world
    assert sources.drift == pytest.approx(0.2**2 * 36 * large.model.noise_base())
    # What has no standard deviation has no column, but root and gain, which are zero.
    none = sources_of(large.model, gravity)
    assert set(none.names) == {"root", "gain"}
    assert not settle(none, unknowns(large.model, "mid")).D.any()


def test_more_uncertain_sources_mean_a_wider_covariance(large, gravity, touched):
    wrench = touched(0.09, 0.05)
    variances = [
        np.trace(Estimator(large.model, of).estimate(wrench, gravity).cov_surface_base)
        for of in (EXACT, replace(EXACT, youngs_modulus=0.03), Tolerances(), replace(Tolerances(), tilt_deg=1.0))
    ]
    assert variances == sorted(variances)


@pytest.mark.parametrize("age", [10.0, 1000.0])
def test_an_old_tare_is_trusted_less(age, large, gravity, touched):
    estimator = large.estimator().with_tare_age(age)
    before, now = (e.estimate(touched(0.09, 0.1), gravity) for e in (large.estimator(), estimator))
    if age <= 16.0:
        assert estimator.priors == large.estimator().priors and now.std_s == before.std_s
    else:
        # After a thousand seconds the force is light against the drift: what is left is an interval.
        assert now.result == "interval_only" if age >= 1000.0 else now.std_s > before.std_s
        assert now.candidates[0].std_s > before.candidates[0].std_s


def test_the_covariance_of_a_light_touch_is_continuous_in_the_reading(large, gravity):
    """A node of the curvature correction may be at an end of the probe, on either side of it by rounding."""
    rng, estimator, compared = np.random.default_rng(11), large.estimator(), 0
    std = np.sqrt(np.diag(large.model.noise_base()))
    for _ in range(150):
        s, force = (rng.uniform(0.05, 1.0) * large.length, math.exp(rng.uniform(math.log(2e-4), math.log(2e-2))))
        true = settle(sources_of(large.model, gravity), np.array([s, 1.0, force, 0.1, 0.1]))
        if true is None:
            continue
        reading = true.wrench + std * rng.normal(size=6)
        one, other = (estimator.estimate(w, gravity) for w in (reading, reading * (1.0 + 1e-14)))
        if not (one.candidates and other.candidates):
            continue
        sizes = [np.sqrt(np.trace(c.candidates[0].cov_surface_base)) for c in (one, other)]
        assert sizes[1] == pytest.approx(sizes[0], rel=1e-3)
        compared += 1
    assert compared > 30
