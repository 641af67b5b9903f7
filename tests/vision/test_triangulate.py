"""Markers in space: their error, its stated covariance, and refusals where the pictures contradict each other."""

from dataclasses import replace

import numpy as np
import pytest
from scene import MARKERS, calibrated, camera
from scipy import stats

from probedesign.core.errors import InputError
from probedesign.vision.triangulate import triangulate

PAIR = (camera("left"), camera("right"))


def pixels_of(cameras=PAIR, std_px=0.0, seed=0):
    rng = np.random.default_rng(seed)
    return np.array([c.project(MARKERS) + rng.normal(0, std_px, (15, 2)) for c in cameras])


def test_exact_pixels_give_the_markers_back():
    cameras = [camera(name, (-0.05, 0.02)) for name in ("left", "right")]
    found = triangulate(cameras, pixels_of(cameras), 0.2)
    assert found.p_world == pytest.approx(MARKERS, abs=1e-12)
    assert np.abs(found.residual_px).max() < 1e-8


def test_positions_agree_with_opencv():
    """Without noise the linear solution is exact; with noise it differs from the best by less than the best errs."""
    cv2 = pytest.importorskip("cv2")
    P = [c.K @ c.R_camera_world @ np.column_stack([np.eye(3), -c.p_world]) for c in PAIR]
    for std_px, allowed in ((0.0, 1e-9), (0.2, 0.02e-3)):
        pixels = pixels_of(std_px=std_px)
        theirs = cv2.triangulatePoints(*P, pixels[0].T, pixels[1].T)
        assert triangulate(PAIR, pixels, 0.2).p_world == pytest.approx((theirs[:3] / theirs[3]).T, abs=allowed)


def test_the_stated_covariance_is_that_of_the_errors():
    """Over many calibrations, pixel noise alone would be too small a standard deviation."""
    rng, square, alone, errors = np.random.default_rng(1), [], [], []
    for _ in range(30):
        cameras = [calibrated(c, rng) for c in PAIR]
        pixels = np.array([c.project(MARKERS) + rng.normal(0, 0.2, (15, 2)) for c in PAIR])
        found = triangulate(cameras, pixels, 0.2)
        exact = triangulate([replace(c, cov=0.0 * c.cov) for c in cameras], pixels, 0.2)
        error = found.p_world - MARKERS
        square.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.cov_world), error))
        alone.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(exact.cov_world), error))
        errors.append(error)
    inside = np.mean(np.array(square) < stats.chi2.isf(0.05, 3))
    # The markers of one calibration err together: 30 of these count, with a standard error of 4 %.
    assert 0.83 < inside <= 1.0
    assert np.mean(square) == pytest.approx(3.0, rel=0.3)
    assert np.mean(alone) > 1.3 * np.mean(square)
    assert np.sqrt(np.mean(np.sum(np.square(errors), axis=2))) < 0.15e-3  # 0.12 mm at half a metre with 0.2 px


def test_agreement_is_one_where_the_noise_is_as_stated():
    rng = np.random.default_rng(8)
    stated = [triangulate(PAIR, pixels_of(std_px=0.3, seed=int(rng.integers(1e6))), 0.3).agreement for _ in range(20)]
    assert np.mean(stated) == pytest.approx(1.0, abs=0.25)  # 300 times one degree of freedom: 0.082 a standard error


def test_a_third_camera_reduces_the_error_and_may_miss_markers():
    third = camera("left").looking("top", (0.1, -0.1, 0.6), (0.1, 0, 0), 3000.0, (1920, 1080), (), (0, 1, 0))
    three = (*PAIR, third)
    pixels = pixels_of(three)
    pixels[2, 3] = np.nan
    two, found = triangulate(PAIR, pixels[:2], 0.2), triangulate(three, pixels, 0.2)
    better = np.trace(found.cov_world, axis1=1, axis2=2) / np.trace(two.cov_world, axis1=1, axis2=2)
    assert better[3] == pytest.approx(1.0) and (np.delete(better, 3) < 0.9).all()
    assert np.isnan(found.residual_px[2, 3]).all()


def spoiled(change):
    pixels = pixels_of(std_px=0.2)
    change(pixels)
    return pixels


def lose(*where):
    return lambda pixels: pixels.__setitem__(where, np.nan)


@pytest.mark.parametrize(
    ("pixels", "words"),
    [
        (pixels_of()[::-1], "cameras left and right are swapped"),
        (np.array([pixels_of()[0], pixels_of()[1, ::-1]]), "left or right numbers the markers from the other end"),
        (spoiled(lambda p: p.__setitem__((1, [4, 7]), p[1, [7, 4]])), "marker .: its pixels are not of one point"),
        (spoiled(lose(1, 3)), "marker 4 is seen by camera left only"),
        (spoiled(lose(slice(None), 3)), "marker 4 is seen by no camera"),
        (spoiled(lambda p: p.__setitem__((0, 9), p[0, 9] + (0, 25))), "marker 10: its pixels are not of one point"),
    ],
)
def test_pictures_that_contradict_are_refused_in_one_line(pixels, words):
    with pytest.raises(InputError, match=words) as caught:
        triangulate(PAIR, pixels, 0.2)
    assert "\n" not in str(caught.value)


def test_cameras_must_see_from_two_sides():
    left = camera("left")
    centre = left.p_world + 0.1 * (np.array([0.1, 0, 0]) - left.p_world)
    rear = left.looking("rear", centre, (0.1, 0, 0), 3000.0, (1920, 1080))
    with pytest.raises(InputError, match="cameras left and rear look along one line"):
        triangulate([left, rear], pixels_of((left, rear)), 0.2)
