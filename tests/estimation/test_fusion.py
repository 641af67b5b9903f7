"""Several touches of one point: located within the bound, honest about what is not known, silent where nothing is."""

import numpy as np
import pytest
from scipy import stats

from probedesign.errors import InputError
from probedesign.estimation.equations import channels_of
from probedesign.estimation.pressed import Push, press, settle
from probedesign.estimation.unknowns import Unknowns
from probedesign.frames import rotation_z
from tests.estimation.presses import presses

RARE = 1e-4


def noisy(model, wrenches, rng):
    return wrenches + rng.multivariate_normal(np.zeros(6), model.noise_base(), len(wrenches))


# Without noise


@pytest.mark.parametrize("fixed", ["surface", "contact"])
@pytest.mark.parametrize("moments_only", [False, True])
@pytest.mark.parametrize(
    ("fraction", "force", "angle"), [(0.5, 0.002, 1.57), (0.8, 0.01, 0.3), (0.4, 0.1, 3.0)]
)
def test_without_noise_the_point_is_found(fixed, moments_only, fraction, force, angle, large, gravity):
    forces = force * np.array([0.2, 0.5, 0.8, 1.0])
    wrenches, Ts, centre = presses(large, gravity, fraction * large.length, angle, forces, fixed)
    c = large.estimator().fuse(wrenches, Ts, gravity, moments_only=moments_only, unknowns=Unknowns.none())
    assert c.result == "ok"
    # Fast against reference rods: 1e-6 of the moment, where 1e-3 of it tells a millimetre; and where the two
    # hypotheses fit alike, the touched point is held for the one that stands still: hundredths of a radian of bending
    # times half a millimetre of radius.
    assert np.linalg.norm(c.p_contact_world - centre) <= (2e-5 if c.fixed == fixed else 3e-4)


def test_the_contact_may_slide_and_the_base_may_turn(large, gravity):
    turn = rotation_z(0.4)
    wrenches, Ts, centre = presses(
        large, gravity, 0.6 * large.length, 0.5, np.linspace(0.005, 0.02, 5), slide=0.003, turn=turn
    )
    c = large.estimator().fuse(wrenches, Ts, turn @ gravity, unknowns=Unknowns.none())
    assert c.result == "ok" and c.fixed == "surface"
    np.testing.assert_allclose(c.p_contact_world, centre, atol=2e-5)
    np.testing.assert_allclose(c.p_surface_world, np.zeros(3), atol=2e-5)
    np.testing.assert_allclose(np.diff(c.s_contact), 0.003, atol=2e-5)


# Statistics


@pytest.mark.parametrize("moments_only", [False, True])
def test_errors_scatter_as_the_covariance_says_with_everything_unknown(moments_only, large, gravity):
    """Truths drawn from the very priors: stiffness, base offset and scatter, bias walk, noise."""
    rng, runs = np.random.default_rng(8), 60
    unknowns = Unknowns(stiffness=0.03, base_offset=5e-5, base_repeat=1e-5, bias_walk_steps=0.2)
    wrenches, Ts, _ = presses(large, gravity, 0.7 * large.length, 1.57, np.linspace(1e-3, 5e-3, 5))
    estimator = large.estimator()
    squares, codes = [], []
    for _ in range(runs):
        stiff = np.exp(rng.normal(0.0, unknowns.stiffness))
        # A stiffer probe under equally greater loads bends alike: light touches, so weight may be left as it is.
        touched = disturbed(estimator, wrenches, Ts, gravity, stiff, unknowns, rng)
        c = estimator.fuse(
            touched, Ts, gravity, moments_only=moments_only, moments_about="sensor", unknowns=unknowns
        )
        codes.append(c.result)
        if c.ok and c.fixed == "surface":  # that point is at the world's origin
            squares.append(c.p_surface_world @ np.linalg.solve(c.cov_fixed_world, c.p_surface_world))
    assert codes.count("ok") >= runs - stats.binom(runs, 1e-3).ppf(1.0 - RARE)
    low, high = (stats.chi2(3 * len(squares)).ppf(q) for q in (RARE, 1.0 - RARE))
    assert low <= sum(squares) <= high


def disturbed(estimator, wrenches, Ts, gravity, stiff, unknowns, rng):
    """What is read of these touches if stiffness, base and bias are off by draws from their priors."""
    model, read = estimator.model, []
    offset = rng.normal(0.0, unknowns.base_offset, 3)
    step = model.noise_base() * model.averaging_samples
    bias = np.zeros(6)
    for wrench, T in zip(wrenches, Ts, strict=True):
        bias = bias + unknowns.bias_walk_steps * rng.multivariate_normal(np.zeros(6), step)
        point = T[:3, :3].T @ -T[:3, 3] - offset - rng.normal(0.0, unknowns.base_repeat, 3)
        c = estimator.estimate(wrench, gravity)
        eq = c.candidates[0].shape()
        found = settle(model.rod, gravity, Push.under(model.rod, eq), "surface", point, 1e-9, np.log(stiff))
        read.append(found.wrench + bias + rng.multivariate_normal(np.zeros(6), model.noise_base()))
    return np.array(read)


def test_what_is_not_known_is_counted_and_named(large, gravity):
    wrenches, Ts, _ = presses(large, gravity, 0.6 * large.length, 1.57, np.linspace(1e-3, 5e-3, 5))
    estimator = large.estimator()
    exact = estimator.fuse(wrenches, Ts, gravity, moments_only=True, unknowns=Unknowns.none())
    vague = estimator.fuse(wrenches, Ts, gravity, moments_only=True)
    assert vague.rms > exact.rms
    assert set(vague.rms_without) == {"stiffness", "bias", "robot"}
    assert all(exact.rms <= rms <= vague.rms for rms in vague.rms_without.values())
    assert set(vague.rms_with) == {"one more touch", "further press", "stiffness"}
    assert all(rms < vague.rms for rms in vague.rms_with.values())
    # rms is the root of the covariance's trace, but for which of the two points is meant: a µm here.
    assert vague.rms == pytest.approx(np.sqrt(np.trace(vague.cov_fixed_world)), rel=1e-6)


def test_free_readings_tie_the_bias_down(large, gravity):
    rng = np.random.default_rng(3)
    wrenches, Ts, centre = presses(large, gravity, 0.6 * large.length, 1.57, np.linspace(2e-3, 1e-2, 5))
    free = large.solve(gravity).wrench_base
    bias = 10.0 * np.sqrt(np.diag(large.model.noise_base()))
    readings = noisy(large.model, np.vstack([free, wrenches, free]), rng) + bias
    poses = np.concatenate([Ts[:1], Ts, Ts[-1:]])
    touched = [False, *[True] * 5, False]
    unknowns = Unknowns(0.0, 0.0, 0.0, bias_steps=3.0, bias_walk_steps=0.0)
    estimator = large.estimator()
    c = estimator.fuse(readings, poses, gravity, touched=touched, unknowns=unknowns)
    alone = estimator.fuse(readings[1:6], Ts, gravity, unknowns=unknowns)
    assert c.result == "ok" and c.rms < alone.rms
    off = c.p_contact_world - centre
    assert off @ np.linalg.solve(c.cov_contact_world, off) <= stats.chi2(3).ppf(1.0 - RARE)
    ignored = estimator.fuse(readings, poses, gravity, touched=touched, unknowns=Unknowns.none())
    assert ignored.result == "inconsistent"


def test_creep_is_counted_where_it_is_said(large, gravity):
    wrenches, Ts, _ = presses(large, gravity, 0.6 * large.length, 1.57, np.linspace(2e-3, 1e-2, 5))
    estimator = large.estimator()
    without = estimator.fuse(wrenches, Ts, gravity)
    creeping = estimator.fuse(wrenches, Ts, gravity, unknowns=Unknowns(creep=0.05))
    assert creeping.ok and creeping.rms > without.rms


def test_the_designs_material_says_how_well_its_stiffness_is_known(large):
    from dataclasses import replace

    model = large.model  # the paper identified its prints
    assert Unknowns.of(model) == Unknowns(stiffness=0.005)
    E = replace(model.material["youngs_modulus"], provenance="assumed")
    assert Unknowns.of(replace(model, material={**model.material, "youngs_modulus": E})) == Unknowns()
    said = Unknowns.of(replace(model, stiffness_spread=0.1, creep_spread=0.02))
    assert (said.stiffness, said.creep) == (0.1, 0.02)


# What it does not answer


def test_one_pose_with_moments_alone_is_unobservable(large, gravity):
    wrenches, Ts, _ = presses(large, gravity, 0.6 * large.length, 1.57, [0.01, 0.01, 0.01])
    estimator = large.estimator()
    for k in (1, 3):  # three times the same pose is one
        c = estimator.fuse(wrenches[:k], Ts[:k], gravity, moments_only=True)
        assert c.result == "unobservable"
        assert np.isnan(c.p_contact_world).all() and np.isnan(c.cov_contact_world).all()
    assert estimator.fuse(wrenches[:1], Ts[:1], gravity).ok  # with forces one touch is enough


def test_nothing_touched_is_unobservable(large, gravity):
    free = large.solve(gravity).wrench_base
    c = large.estimator().fuse([free], [np.eye(4)], gravity, touched=[False])
    assert c.result == "unobservable"


def test_an_object_that_moved_is_inconsistent(large, gravity):
    wrenches, Ts, _ = presses(large, gravity, 0.6 * large.length, 1.57, np.linspace(2e-3, 2e-2, 5))
    Ts[2:, 1, 3] += 0.001
    c = large.estimator().fuse(wrenches, Ts, gravity)
    assert c.result == "inconsistent"
    assert np.isnan(c.p_contact_world).all() and np.isnan(c.s_contact).all()


def test_two_places_that_explain_the_readings_are_both_told(large):
    """A base that turns about the probe's own axis: moments alone know the touch at another height as well."""
    world = np.array([0.0, 0.0, -9.81])
    wrenches, Ts = [], []
    for k in range(3):
        c, s = np.cos(0.12 * k), np.sin(0.12 * k)
        level = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
        R = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]) @ level
        wrench, T, _ = presses(large, R.T @ world, 0.1, 1.57, [0.01], turn=R)
        wrenches, Ts = [*wrenches, wrench[0]], [*Ts, T[0]]
    f = large.estimator().fuse(
        wrenches, Ts, world, moments_only=True, moments_about="sensor", unknowns=Unknowns.none()
    )
    if f.ok:  # then it must be the right one
        assert np.linalg.norm(f.p_surface_world) <= 5.0 * f.rms
    else:
        assert f.result == "ambiguous" and len(f.candidates_world) >= 2


def test_a_channel_at_full_scale_is_saturated(large, gravity):
    wrenches, Ts, _ = presses(large, gravity, 0.6 * large.length, 1.57, np.linspace(2e-3, 2e-2, 3))
    model = large.model
    full = model.to_sensor(wrenches, gravity)
    full[1, 3] = model.wrench_range[3] * (1.0 - 1e-13)
    c = large.estimator().fuse(model.to_base(full, gravity), Ts, gravity, moments_only=True)
    assert c.result == "out_of_range"
    assert large.estimator().estimate(model.to_base(full[1], gravity), gravity).result == "out_of_range"


def test_a_bias_step_is_inconsistent(large, gravity):
    wrenches, Ts, _ = presses(large, gravity, 0.6 * large.length, 1.57, np.linspace(2e-3, 2e-2, 5))
    wrenches[3:, 4] += 5e-4
    assert large.estimator().fuse(wrenches, Ts, gravity).result == "inconsistent"


@pytest.mark.parametrize("bad", ["nan", "saturated", "not a rotation", "infinite pose"])
def test_readings_and_poses_that_cannot_be_give_no_number(bad, large, gravity):
    wrenches, Ts, _ = presses(large, gravity, 0.6 * large.length, 1.57, [0.005, 0.01])
    if bad == "nan":
        wrenches[0, 4] = np.nan
    elif bad == "saturated":
        wrenches[0, 3] = 10.0
    elif bad == "not a rotation":
        Ts[1, 0, 0] = 2.0
    else:
        Ts[1, 0, 3] = np.inf
    c = large.estimator().fuse(wrenches, Ts, gravity)
    assert c.result == "out_of_range"
    assert np.isnan(c.p_contact_world).all()


def test_moments_alone_about_the_base_need_no_forces(large, gravity):
    wrenches, Ts, centre = presses(large, gravity, 0.6 * large.length, 1.57, [0.002, 0.005, 0.01])
    wrenches[:, :3] = np.nan
    c = large.estimator().fuse(wrenches, Ts, gravity, moments_only=True, unknowns=Unknowns.none())
    assert c.result == "ok"
    np.testing.assert_allclose(c.p_contact_world, centre, atol=3e-5)


@pytest.mark.parametrize(
    ("wrenches", "Ts"), [(np.zeros((2, 5)), np.zeros((2, 4, 4))), (np.zeros((2, 6)), np.zeros((1, 4, 4))),
                         (np.zeros((0, 6)), np.zeros((0, 4, 4))), (np.zeros(6), np.zeros((4, 4))), (0.0, np.eye(4))]
)  # fmt: skip
def test_wrong_shapes_are_refused(wrenches, Ts, large):
    with pytest.raises(InputError, match="shape"):
        large.estimator().fuse(wrenches, Ts)


def test_moments_about_nowhere_are_refused(large):
    with pytest.raises(InputError, match="moments_about"):
        large.estimator().fuse(
            np.zeros((2, 6)), np.tile(np.eye(4), (2, 1, 1)), moments_only=True, moments_about="tip"
        )


@pytest.mark.parametrize("wrong", [{"stiffness": -0.1}, {"creep": np.nan}, {"base_offset": np.inf}])
def test_priors_that_are_none_are_refused(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        Unknowns(**wrong)


# The pieces


@pytest.mark.parametrize("fixed", ["surface", "contact"])
@pytest.mark.parametrize("magnitude", [0.001, 0.004, 0.05])
def test_derivatives_of_a_press_are_those_of_settled_presses(fixed, magnitude, large, gravity):
    """Against central differences of the settled press itself, moving the fixed point by 10 µm each way."""
    rod, s, angle = large.rod, 0.6 * large.length, 0.7
    eq = large.solve(gravity, s)
    push = settle_angle(rod, gravity, Push(s, angle, magnitude, np.zeros(3), eq.tip), fixed)
    at = press(rod, gravity, push, fixed)
    h = 1e-5
    for axis in np.eye(3):
        ahead, behind = (
            settle(rod, gravity, push, fixed, at.p_fixed + side * h * axis, 1e-10) for side in (1.0, -1.0)
        )
        by_hand = (ahead.wrench - behind.wrench) / (2.0 * h)
        # Curvature over 20 µm, and the fast rod's jitter of 1e-6 of the moment over the difference.
        np.testing.assert_allclose(at.stiffness @ axis, by_hand, rtol=2e-3, atol=2e-3 * np.abs(by_hand).max())


def settle_angle(rod, gravity, push, fixed):
    """The push with its force made normal."""
    from dataclasses import replace

    for _ in range(4):
        at = press(rod, gravity, push, fixed)
        push = replace(push, force=push.force + at.towards_normal, tip=at.tip)
    return push


def test_the_sensors_own_moments_hold_no_noise_of_its_forces(large):
    model = large.model
    of = channels_of(model, "sensor")
    np.testing.assert_allclose(
        of @ model.noise_base() @ of.T, model.noise.moment**2 * np.eye(3), rtol=1e-9, atol=1e-22
    )


def test_one_pose_is_known_no_better_than_one_touch(large, gravity):
    """From one pose the place lies on a bowed line; the linear ellipsoid alone would hold the truth half the time."""
    wrenches, Ts, _ = presses(large, gravity, 0.09, 1.57, [0.02])
    estimator, rng, nees = large.estimator(), np.random.default_rng(4), []
    for _ in range(20):
        wrench = wrenches[0] + rng.multivariate_normal(np.zeros(6), large.model.noise_base())
        f = estimator.fuse([wrench], Ts, gravity, unknowns=Unknowns.none())
        one = estimator.estimate(wrench, gravity)
        assert f.ok and one.ok
        # Both curves are the contact's; the fusion's linear part is of another solver.
        assert f.cov_contact_world == pytest.approx(one.cov_contact_base, rel=0.2, abs=1e-8)
        off = f.p_surface_world
        nees.append(off @ np.linalg.solve(f.cov_fixed_world, off))
    # The mean of 20 is 3 within 0.5 if the ellipsoid were normal; it was 60 before.
    assert np.mean(nees) < 6.0
