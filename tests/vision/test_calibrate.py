"""Cameras from control points: what is recovered, how well, and what is refused."""

import numpy as np
import pytest
from scene import BOX, calibrated, camera
from scipy import stats

from probedesign.core.errors import InputError
from probedesign.vision.calibrate import calibrate

BENDS = [(), (-0.05,), (-0.05, 0.02), (-0.05, 0.02, 1e-3, -2e-3), (-0.05, 0.02, 1e-3, -2e-3, 0.1)]


@pytest.mark.parametrize("distortion", BENDS)
def test_exact_control_points_give_the_camera_back(distortion):
    true = camera(distortion=distortion)
    found = calibrate("left", BOX, true.project(BOX), len(distortion))
    # Rounding of a pixel, 1e-13 of its size, over a condition of some 1e4.
    assert np.abs(found.project(BOX) - true.project(BOX)).max() < 1e-6
    assert found.p_world == pytest.approx(true.p_world, abs=1e-8)
    assert np.abs(found.K - true.K).max() < 1e-3
    assert found.std_px < 1e-6 and not found.outliers


@pytest.mark.parametrize("distortion", BENDS)
def test_rays_lead_back_to_the_points_and_projection_agrees_with_opencv(distortion):
    seen = camera(distortion=distortion)
    rays = seen.rays(seen.project(BOX))
    assert np.abs(np.cross(rays, BOX - seen.p_world)).max() < 1e-14 * 1e2  # rounding at half a metre
    cv2 = pytest.importorskip("cv2")
    turn, _ = cv2.Rodrigues(seen.R_camera_world)
    shift = -seen.R_camera_world @ seen.p_world
    theirs, _ = cv2.projectPoints(BOX, turn, shift, seen.K, np.array([*distortion, *(5 - len(distortion)) * [0.0]]))
    assert seen.project(BOX) == pytest.approx(theirs.reshape(-1, 2), abs=1e-9)


def test_calibration_agrees_with_opencv():
    """OpenCV has no skew: without noise there is none, and both find the same camera."""
    cv2 = pytest.importorskip("cv2")
    true = camera(distortion=(-0.05, 0.02))
    pixels = true.project(BOX)
    ours = calibrate("left", BOX, pixels, 2)
    start = np.array([[2900.0, 0, 950], [0, 2900, 530], [0, 0, 1]])
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3
    _, K, bends, _, _ = cv2.calibrateCamera(
        [BOX.astype(np.float32)], [pixels.astype(np.float32)], (1920, 1080), start, None, flags=flags
    )
    # They take 32-bit numbers: 1e-4 px of a pixel, and the focal length is known thirty times worse.
    assert np.abs(ours.K - K).max() < 0.05
    assert ours.distortion == pytest.approx(bends.ravel()[:2], abs=1e-3)


@pytest.mark.parametrize(
    ("distortion", "points"), [pytest.param((), 20, marks=pytest.mark.slow), ((), 9), ((-0.05,), 20)]
)
def test_the_stated_covariance_is_that_of_the_errors(distortion, points):
    """Projections of points of the box differ from the true ones by the camera's stated covariance."""
    rng, true, square = np.random.default_rng(2), camera(distortion=distortion), []
    for _ in range(40):
        chosen = rng.permutation(20)[:points]
        pixels = true.project(BOX[chosen]) + rng.normal(0, 0.5, (points, 2))
        try:
            found = calibrate("left", BOX[chosen], pixels, len(distortion))
        except InputError:  # some choices of nine lie nearly in one plane
            continue
        place = rng.uniform((0, -0.06, -0.06), (0.2, 0.06, 0.06), (1, 3))
        by, error = found.by_parameters(place)[0], (found.project(place) - true.project(place))[0]
        square.append(error @ np.linalg.solve(by @ found.cov @ by.T, error))
    inside = np.mean(np.array(square) < stats.chi2.isf(0.05, 2))
    assert len(square) > 30
    assert inside > 0.82  # 95 % are stated; of 40 at least 33 with probability 0.997


def test_residuals_estimate_the_noise():
    rng = np.random.default_rng(3)
    std = [calibrated(camera(), rng, 0.5).std_px for _ in range(20)]
    assert np.mean(std) == pytest.approx(0.5, rel=0.09)  # three standard errors of 20 times 29 spare equations


def test_wrong_points_are_found_and_named():
    rng, true, found = np.random.default_rng(4), camera(), 0
    labels = [f"p{i}" for i in range(20)]
    for _ in range(10):
        pixels = true.project(BOX) + rng.normal(0, 0.5, (20, 2))
        wrong = rng.choice(20, 3, replace=False)
        pixels[wrong] += rng.choice([-1, 1], (3, 2)) * rng.uniform(8, 200, (3, 2))  # 16 standard deviations and more
        outliers = calibrate("left", BOX, pixels, labels=labels).outliers
        found += set(outliers) == {labels[i] for i in wrong}
    assert found == 10


def test_good_points_are_left_in():
    rng = np.random.default_rng(5)
    refused = sum(bool(calibrated(camera(), rng).outliers) for _ in range(25))
    assert refused <= 1  # one in a thousand is allowed; two of 25 have probability 3e-4


def turned(points):
    return points * (1, -1, 1)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda w, p: (w[:5], p[:5]), "5 control points are too few"),
        (lambda w, p: (w[w[:, 1] > 0], p[w[:, 1] > 0]), "lie in one plane"),
        (lambda w, p: (w * (1, 1e-3, 1) + 0.1, p), "one plane"),
        (lambda w, p: (turned(w), p), "mirrored"),
        (lambda w, p: (w, p * (1, -1) + (0, 1079)), "mirrored"),
        (lambda w, p: (w, p[:, ::-1]), "mirrored"),
        (lambda w, p: (w, np.roll(p, 4, axis=0)), "4 of 20 control points do not fit"),
    ],
)
def test_bad_control_points_are_refused_in_one_line(spoil, words):
    pixels = camera().project(BOX) + np.random.default_rng(6).normal(0, 0.5, (20, 2))
    with pytest.raises(InputError, match=words) as caught:
        calibrate("left", *spoil(BOX, pixels))
    assert str(caught.value).startswith("camera left: ") and "\n" not in str(caught.value)


def test_distortion_needs_more_points():
    pixels = camera().project(BOX)
    with pytest.raises(InputError, match=r"6 control points are too few .* 1 of distortion; at least 7"):
        calibrate("left", BOX[:6], pixels[:6], 1)


def test_six_points_have_a_large_uncertainty():
    """One redundant equation does not determine the noise: a click's is assumed."""
    chosen = [0, 3, 6, 9, 13, 18]
    found = calibrate("left", BOX[chosen], camera().project(BOX[chosen]))
    place = np.array([[0.1, 0.0, 0.0]])
    by = found.by_parameters(place)[0]
    assert np.sqrt(np.diag(by @ found.cov @ by.T)).min() > 0.3  # six clicks of 1 px locate a point no better
