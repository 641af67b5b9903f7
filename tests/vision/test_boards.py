"""Cameras from pictures of a board: what is recovered, how well, compared with OpenCV, and what is refused."""

import re
import struct
import zlib
from dataclasses import replace

import numpy as np
import pytest
from scene import MARKERS, camera
from scipy import stats
from scipy.spatial.transform import Rotation

from probedesign.core.errors import InputError
from probedesign.core.frames import pose
from probedesign.simulation.simulated_calibration import render_board
from probedesign.simulation.stereo_rig import RenderStyle
from probedesign.vision.boards import MARGIN, POINT, Board, board_pdf, board_png, detect_board
from probedesign.vision.bundle import BoardView, BundleProblem, RelativePose, calibrate_with_board
from probedesign.vision.camera import Camera
from probedesign.vision.camera_files import assumed_covariance
from probedesign.vision.triangulate import triangulate

cv2 = pytest.importorskip("cv2")

SIZE = (1920, 1080)
BOARD = Board((9, 7), 0.018, 0.0135, "DICT_5X5_100")
FACING = Rotation.from_rotvec([-np.pi / 2, 0, 0])
NAMES = ["left", "right"]
LENS = (-0.1, 0.05)


def placement(turn=(0.0, 0.0, 0.0), shift=(0.0, 0.0, 0.0)):
    R = (FACING * Rotation.from_rotvec(turn)).as_matrix()
    return pose(R, np.array([0.1, 0.0, 0.0]) + shift - R @ [*np.array(BOARD.size) / 2, 0.0])


WORLD = placement()


def pair(distortion=LENS):
    return [camera(name, distortion) for name in NAMES]


def problem(cameras, rng, std_px=0.1, count=8, scale=1.0, stated=None, relative=(), tilt=0.5):
    """Return views of the board by exact cameras with noise, in the placement of the world frame and in others."""
    views = []
    for number in range(count + 1):
        T = placement(rng.uniform(-tilt, tilt, 3), rng.uniform(-0.04, 0.04, 3)) if number else WORLD
        for one in cameras:
            pixels = one.project(scale * BOARD.corners @ T[:3, :3].T + T[:3, 3])
            pixels = pixels + std_px * rng.normal(size=pixels.shape)
            views.append(BoardView(str(number), one.name, np.arange(len(pixels)), pixels, SIZE))
    return BundleProblem(BOARD, tuple(views), "0", WORLD, 1e-3, stated or {}, tuple(relative))


@pytest.mark.parametrize("distortion", [(), LENS, (-0.1, 0.05, 1e-3, -1e-3, 0.02)])
def test_exact_corners_give_the_cameras_back(distortion):
    true = pair(distortion)
    found = calibrate_with_board(NAMES, problem(true, np.random.default_rng(1), 0.0), len(distortion))
    for one, expected in zip(found, true, strict=True):
        # Levenberg-Marquardt ends at a relative gain of 1e-12 of the cost, 1e-6 of a step
        assert one.project(MARKERS) == pytest.approx(expected.project(MARKERS), abs=1e-4)
        assert one.p_world == pytest.approx(expected.p_world, abs=1e-7)


def test_the_fit_agrees_with_opencv():
    """OpenCV's minimum of the same pixels; the board's scale and the world do not change its intrinsic parameters."""
    task = problem(pair()[:1], np.random.default_rng(2))
    ours = calibrate_with_board(NAMES[:1], task, 2)[0]
    points = [BOARD.corners.astype(np.float32)] * len(task.views)
    pixels = [view.pixels.astype(np.float32) for view in task.views]
    flags = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-14)
    _, K, bends, turns, shifts = cv2.calibrateCamera(points, pixels, SIZE, None, None, flags=flags, criteria=criteria)
    std = np.sqrt(np.diag(ours.cov))
    # the same minimum, found in numbers of 32 bits: within a hundredth of its standard deviation
    assert np.abs(ours.K - K)[[0, 1, 0, 1], [0, 1, 2, 2]] == pytest.approx(0, abs=0.02 * std[[0, 1, 3, 4]].min())
    assert np.abs(ours.distortion - bends.ravel()[:2]) == pytest.approx(0, abs=0.02 * std[11:].max())
    T = pose(cv2.Rodrigues(turns[0])[0], shifts[0].ravel()) @ np.linalg.inv(WORLD)
    assert np.abs(ours.R_camera_world - T[:3, :3]).max() < 0.02 * std[5:8].max()
    assert ours.p_world == pytest.approx(-T[:3, :3].T @ T[:3, 3], abs=0.02 * std[8:11].max())


def test_the_pair_agrees_with_opencv():
    """stereoCalibrate on the same corners, and its triangulatePoints of the same pixels."""
    true = pair()
    task = problem(true, np.random.default_rng(3))
    ours = calibrate_with_board(NAMES, task, 2)
    points = [BOARD.corners.astype(np.float32)] * (len(task.views) // 2)
    left, right = ([v.pixels.astype(np.float32) for v in task.views if v.camera == name] for name in NAMES)
    flags = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3
    each = [cv2.calibrateCamera(points, pixels, SIZE, None, None, flags=flags)[1:3] for pixels in (left, right)]
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-14)
    _, K1, D1, K2, D2, R, T, *_ = cv2.stereoCalibrate(
        points, left, right, *each[0], *each[1], SIZE, flags=flags | cv2.CALIB_USE_INTRINSIC_GUESS, criteria=criteria
    )
    mine = ours[1].R_camera_world @ ours[0].R_camera_world.T
    shift = ours[1].R_camera_world @ (ours[0].p_world - ours[1].p_world)
    # the same residuals, weighted by each camera's own noise here: a tenth of the standard deviations of some 1e-4
    assert np.abs(mine - R).max() < 3e-5
    assert shift == pytest.approx(T.ravel(), abs=3e-5)
    pixels = np.array([one.project(MARKERS) for one in true])
    plane = [cv2.undistortPoints(p, K, D).reshape(-1, 2).T for p, K, D in zip(pixels, (K1, K2), (D1, D2), strict=True)]
    homogeneous = cv2.triangulatePoints(np.eye(3, 4), np.hstack([R, T]), *plane)
    theirs = (homogeneous[:3] / homogeneous[3]).T
    mine = triangulate(ours, pixels, 0.1)
    in_left = (mine.p_world - ours[0].p_world) @ ours[0].R_camera_world.T
    # half the stated standard deviation, 0.04 mm in depth: one calibration is common to both
    assert np.abs(in_left - theirs).max() < 0.5 * np.sqrt(mine.cov_world.max())


def test_the_stated_covariance_is_that_of_the_errors():
    """Return errors of exactly observed markers, which are due to the calibration and its scale."""
    rng, true, square = np.random.default_rng(4), pair(), []
    marker = MARKERS[7:8]
    for _ in range(20):
        task = problem(true, rng, count=4, scale=1 + 1e-3 * rng.normal())
        found = calibrate_with_board(NAMES, task, 2)
        seen = triangulate(found, [one.project(marker) for one in true], 1e-3)
        error = (seen.p_world - marker)[0]
        square.append(error @ np.linalg.solve(seen.cov_world[0], error))
    inside = np.mean(np.array(square) < stats.chi2.isf(0.05, 3))
    assert inside >= 0.8  # 95 % are stated; of 20 at least 16 with probability 0.997
    assert 1.5 < np.mean(square) < 5.0  # 3 is expected, with a standard error of sqrt(6 / 20) = 0.55


def test_errors_that_cameras_share_count_once():
    """A rotation of both cameras about the world axes moves a marker without changing a pixel."""
    true, marker = pair(()), MARKERS[7:8]
    common = np.zeros((11, 1))
    tilted = []
    for one in true:
        common = np.zeros((11, 1))
        turn = np.array([0.0, 0.0, 1e-3])
        common[5:8, 0] = -one.R_camera_world @ turn  # of the world in the camera's axes
        common[8:11, 0] = np.cross(turn, one.p_world)
        tilted.append(replace(one, cov=common @ common.T, common=common))
    found = triangulate(tilted, [one.project(marker) for one in true], 1e-6)
    moved = np.cross([0.0, 0.0, 1e-3], marker[0])
    assert found.cov_world[0] == pytest.approx(np.outer(moved, moved), abs=1e-12)  # 1e-6 m of 1e-4 m, squared
    alone = triangulate(
        [replace(one, common=np.zeros((11, 0))) for one in tilted], [o.project(marker) for o in true], 1e-6
    )
    assert np.abs(alone.cov_world[0] - np.outer(moved, moved)).max() > 1e-9  # as independent errors it is another


def stated_pair(true, px=0.3):
    """Cameras as a file of OpenCV states them, with a relative pose; their own poses are not known."""
    bare = [Camera(c.name, c.K, np.eye(3), np.zeros(3), c.distortion, assumed_covariance(c, px, 0.0), size_px=SIZE,
                   std_px=px) for c in true]  # fmt: skip
    R = true[1].R_camera_world @ true[0].R_camera_world.T
    T = pose(R, true[1].R_camera_world @ (true[0].p_world - true[1].p_world))
    return {c.name: c for c in bare}, [RelativePose("right", "left", T, 1e-4, 5e-5)]


def test_files_and_one_picture_of_the_board_give_the_world():
    """Only the left camera sees the board: the right one is placed by the stated relative pose."""
    true = pair()
    stated, relative = stated_pair(true)
    task = problem(true, np.random.default_rng(5), count=0, stated=stated, relative=relative)
    task = replace(task, views=tuple(view for view in task.views if view.camera == "left"))
    found = calibrate_with_board(NAMES, task, 2)
    seen = triangulate(found, [one.project(MARKERS) for one in true], 0.1)
    error = seen.p_world - MARKERS
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) < 0.5e-3
    square = np.einsum("ni,nij,nj->n", error, np.linalg.inv(seen.cov_world), error)
    assert np.mean(square) < 12.0  # 3 is expected; the markers share one calibration


def test_wrong_corners_are_left_out():
    true = pair()
    task = problem(true, np.random.default_rng(6))
    task.views[3].pixels[[5, 20]] += (4.0, -3.0)
    found = calibrate_with_board(NAMES, task, 2)
    assert found[1].outliers == ("1/5", "1/20") and not found[0].outliers
    assert found[1].std_px == pytest.approx(0.1, rel=0.1)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda task: replace(task, views=task.views[:5]), "camera right: sees the board in 2 usable pictures"),
        (lambda task: replace(task, views=tuple(v for v in task.views if v.placement != "0")),
         "connects it with the world"),
        (lambda task: replace(task, views=(replace(task.views[0], size_px=(960, 540)), *task.views[1:])),
         "different sizes, 960 x 540 and 1920 x 1080"),
        (lambda task: replace(task, views=tuple(replace(v, pixels=v.pixels[::-1] + 30 * np.sin(v.pixels))
                                                for v in task.views)),
         r"do not fit one camera|do not determine"),
    ],
)  # fmt: skip
def test_pictures_that_cannot_be_used_are_refused(spoil, words):
    task = spoil(problem(pair(), np.random.default_rng(7), count=3))
    with pytest.raises(InputError, match=words) as caught:
        calibrate_with_board(NAMES, task, 2)
    assert "\n" not in str(caught.value)


def test_a_board_that_is_never_tilted_determines_no_focal_length():
    straight = [camera("left"), camera("right")]
    straight[0] = Camera.looking("left", (0.1, -0.55, 0.0), (0.1, 0.0, 0.0), 3000.0, SIZE)
    task = problem(straight[:1], np.random.default_rng(8), tilt=0.0)
    with pytest.raises(InputError, match=r"focal length|do not determine"):
        calibrate_with_board(NAMES[:1], task, 0)


def test_a_board_of_another_size_contradicts_the_files():
    true = pair()
    stated, relative = stated_pair(true)
    task = problem(true, np.random.default_rng(9), scale=25.4 / 18, count=2, stated=stated, relative=relative)
    with pytest.raises(InputError, match="contradict the calibration files"):
        calibrate_with_board(NAMES, task, 2)


# the board itself


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"squares": (2, 7)}, "3 to 60"),
        ({"marker": 0.02}, "marker_mm = 20 must lie in"),
        ({"marker": np.nan}, "marker_mm = nan"),
        ({"dictionary": "DICT_4X4_50", "squares": (12, 9)}, "has 50 markers, but the board needs 54"),
        ({"dictionary": "5x5"}, "unknown '5x5'"),
    ],
)
def test_impossible_boards_are_refused(changed, words):
    with pytest.raises(InputError, match=words):
        replace(BOARD, **changed)


@pytest.mark.parametrize("squares", [(9, 7), (8, 5), (5, 8)])
def test_the_picture_is_opencvs_board(squares):
    board = Board(squares, 0.02, 0.014, "DICT_4X4_100")
    ours = board.picture(3500.0)  # 70 px a square, 49 a marker: 8.17 a module
    theirs = board.opencv().generateImage(ours.shape[::-1])
    assert np.mean(ours != theirs) < 0.02  # edges of modules are rounded by at most a pixel
    numbers, pixels = detect_board(np.pad(ours, 30, constant_values=255), board)
    assert sorted(numbers) == list(range(len(board.corners)))
    assert (pixels - 29.5) / 3500.0 == pytest.approx(board.corners[numbers, :2], abs=3e-5)  # a tenth of a pixel


def test_prints_have_their_exact_size():
    grey = cv2.imdecode(np.frombuffer(png := board_png(BOARD), np.uint8), cv2.IMREAD_GRAYSCALE)
    start = png.index(b"pHYs")
    per_m, _, unit = struct.unpack(">IIB", png[start + 4 : start + 13])
    assert zlib.crc32(png[start : start + 13]) == struct.unpack(">I", png[start + 13 : start + 17])[0]
    assert unit == 1 and grey.shape[1] / per_m == pytest.approx(BOARD.size[0] + 2 * MARGIN, abs=1e-4)

    pdf = board_pdf(BOARD)
    stream = zlib.decompress(re.search(rb"stream\n(.*)\nendstream", pdf, re.S)[1]).decode()
    areas = (
        np.array([[float(x) for x in line.split()[:4]] for line in stream.splitlines() if line.endswith("re")]) / POINT
    )
    assert areas[:, 0].min() == pytest.approx(MARGIN, abs=1e-6)
    assert (areas[:, 0] + areas[:, 2]).max() - areas[:, 0].min() == pytest.approx(BOARD.size[0], abs=1e-6)
    assert areas[0, 2:] == pytest.approx([BOARD.square] * 2, abs=1e-6)
    assert int(re.search(rb"startxref\n(\d+)", pdf)[1]) == pdf.index(b"xref\n0 ")


def test_corners_of_rendered_pictures_are_found_to_a_tenth_of_a_pixel():
    seen = camera("left", LENS, focal=1500.0, size=(960, 640))
    T = placement((0.3, -0.3, 0.4))
    picture = render_board(seen, BOARD, T, 1.0, (960, 640), RenderStyle(seed=1))
    numbers, pixels = detect_board(picture, BOARD)
    error = pixels - seen.project(BOARD.corners[numbers] @ T[:3, :3].T + T[:3, 3])
    assert len(numbers) == len(BOARD.corners)
    assert np.sqrt(np.mean(error**2)) < 0.1 and np.abs(error.mean(axis=0)).max() < 0.04  # 0.06 px / sqrt(48) is 0.01
    numbers, _ = detect_board(np.full((400, 400), 128, dtype=np.uint8), BOARD)
    assert len(numbers) == 0
