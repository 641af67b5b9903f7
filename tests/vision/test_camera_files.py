"""Calibration files of OpenCV, ROS and Kalibr: what is read from them, and what is refused in one line."""

import numpy as np
import pytest
from scene import camera
from scipy.spatial.transform import Rotation

from probedesign.core.errors import InputError
from probedesign.vision.calibrate import locate
from probedesign.vision.camera_files import ASSUMED_PX, read_camera_files

cv2 = pytest.importorskip("cv2")

NAMES = ("left", "right")
BENDS = (-0.1, 0.05, 1e-3, -1e-3, 0.02)
TRUE = [camera(name, BENDS) for name in NAMES]
TARGET = np.array([0.1, 0.0, 0.0])
R = TRUE[1].R_camera_world @ TRUE[0].R_camera_world.T
T = TRUE[1].R_camera_world @ (TRUE[0].p_world - TRUE[1].p_world)


def store(path, **values):
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in values.items():
        file.write(key, value)
    file.release()


def one_camera(folder, seen, suffix=".yaml", **changed):
    shift = -1e3 * seen.R_camera_world @ seen.p_world
    values = {"image_width": 1920, "image_height": 1080, "camera_matrix": seen.K, "R": seen.R_camera_world, "T": shift,
              "distortion_coefficients": np.array([BENDS]), "avg_reprojection_error": 0.21, **changed}  # fmt: skip
    path = folder / f"{seen.name}{suffix}"
    store(path, **{key: value for key, value in values.items() if value is not None})
    return path


def stereo(folder, suffix=".yml", **changed):
    bends = np.array([BENDS])
    store(folder / f"intrinsics{suffix}", M1=TRUE[0].K, D1=bends, M2=TRUE[1].K, D2=bends)
    store(folder / f"extrinsics{suffix}", **{"R": R, "T": T[:, None], **changed})
    return [folder / f"intrinsics{suffix}", folder / f"extrinsics{suffix}"]


ROS = """image_width: 1920
image_height: 1080
camera_name: left
camera_matrix:
  rows: 3
  cols: 3
  data: [3000.0, 0.0, 959.5, 0.0, 3000.0, 539.5, 0.0, 0.0, 1.0]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.1, 5e-2, 1e-03, -0.001, 0.02]
rectification_matrix: {rows: 3, cols: 3, data: [1., 0., 0., 0., 1., 0., 0., 0., 1.]}
"""

KALIBR = f"""cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.1, 0.05, 0.001, -0.001]
  distortion_model: radtan
  intrinsics: [3000.0, 3000.0, 959.5, 539.5]
  resolution: [1920, 1080]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1: {[[*row, shift] for row, shift in zip(R.tolist(), T.tolist(), strict=True)] + [[0.0, 0.0, 0.0, 1.0]]}
  cam_overlaps: [0]
  camera_model: pinhole
  distortion_coeffs: [-0.1, 0.05, 0.001, -0.001]
  distortion_model: radtan
  intrinsics: [3000.0, 3000.0, 959.5, 539.5]
  resolution: [1920, 1080]
"""


def read(paths, names=NAMES, px=None, unit=1e-3):
    return read_camera_files(paths, names, px, unit, TARGET)


@pytest.mark.parametrize("suffix", [".yaml", ".xml"])
def test_opencvs_files_give_the_cameras_back(tmp_path, suffix):
    found = read([one_camera(tmp_path, seen, suffix) for seen in TRUE])
    assert found.in_world
    for one, true in zip(found.cameras, TRUE, strict=True):
        assert one.project(TARGET[None]) == pytest.approx(true.project(TARGET[None]), abs=1e-9)
        assert one.distortion == pytest.approx(BENDS) and one.size_px == (1920, 1080) and one.std_px == 0.21


def test_a_rotation_vector_is_a_rotation_and_a_translation_without_its_unit_is_refused(tmp_path):
    turned = [one_camera(tmp_path, seen, R=None, T=None, rvec=cv2.Rodrigues(seen.R_camera_world)[0],
                         tvec=-1e3 * seen.R_camera_world @ seen.p_world) for seen in TRUE]  # fmt: skip
    assert read(turned).cameras[1].p_world == pytest.approx(TRUE[1].p_world)
    with pytest.raises(InputError, match="T is in the unit of the calibration board; name it"):
        read([one_camera(tmp_path, seen) for seen in TRUE], unit=None)


@pytest.mark.parametrize("suffix", [".yml", ".xml"])
def test_a_stereo_pair_has_two_cameras_without_a_pose(tmp_path, suffix):
    found = read(stereo(tmp_path, suffix), unit=1.0)
    assert not found.in_world and found.cameras[0].std_px == ASSUMED_PX
    assert pytest.approx(TRUE[1].K) == found.cameras[1].K


def test_kalibrs_chain_and_ros_camera_info_are_read(tmp_path):
    path = tmp_path / "camchain.yaml"
    path.write_text(KALIBR)
    found = read([path], px=0.15, unit=None)
    assert found.cameras[1].distortion == pytest.approx(BENDS[:4]) and found.cameras[0].size_px == (1920, 1080)
    assert found.cameras[0].std_px == 0.15
    for name in NAMES:
        (tmp_path / f"{name}.yaml").write_text(ROS)
    found = read([tmp_path / f"{name}.yaml" for name in NAMES])
    assert not found.in_world and found.cameras[0].distortion == pytest.approx(BENDS)
    assert pytest.approx(TRUE[0].K) == found.cameras[0].K


@pytest.mark.parametrize(("bends", "count"), [((0, 0, 0, 0, 0), 0), ((0.1, 0, 0, 0, 0), 1), ((0.1, 0.1, 0.01, 0), 4)])
def test_zero_coefficients_are_not_parameters(tmp_path, bends, count):
    found = read([one_camera(tmp_path, seen, distortion_coefficients=np.array([bends], dtype=float)) for seen in TRUE])
    assert len(found.cameras[0].distortion) == count and len(found.cameras[0].cov) == 11 + count


def test_the_assumed_covariance_displaces_a_pixel_by_the_reprojection_error(tmp_path):
    one = read([one_camera(tmp_path, seen) for seen in TRUE]).cameras[0]
    side = one.rays(np.array([[1919.0, 539.5]]))
    by = one.by_parameters(one.p_world + 0.6 * side)[0]
    std = np.sqrt(np.diag(by @ one.cov @ by.T))
    assert (
        0.21 * 0.6 < std[0] < 0.21 * 1.3 and std[1] < 0.21 * 1.3
    )  # each parameter's share is rounded to its main axis


def turned(seen, angle):
    return Rotation.from_rotvec([0, 0, angle]).as_matrix() @ seen.R_camera_world


def spoiled(**changed):
    return lambda folder: [one_camera(folder, seen, **changed) for seen in TRUE]


def text(content):
    def write(folder):
        for name in NAMES:
            (folder / f"{name}.yaml").write_text(content)
        return [folder / f"{name}.yaml" for name in NAMES]

    return write


def chain(old="", new=""):
    def write(folder):
        assert old in KALIBR
        (folder / "camchain.yaml").write_text(KALIBR.replace(old, new))
        return [folder / "camchain.yaml"]

    return write


def cut(suffix, part):
    def write(folder):
        path = one_camera(folder, TRUE[0], suffix)
        content = path.read_text()
        path.write_text(content[: int(part * len(content))])
        return [path, one_camera(folder, TRUE[1], suffix)]

    return write


NOT_FINITE = TRUE[0].K * [[1, 1, 1], [1, np.nan, 1], [1, 1, 1]]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (spoiled(camera_matrix=None), "has no camera matrix of camera left"),
        (spoiled(distortion_coefficients=None), "has no coefficients of distortion"),
        (spoiled(camera_matrix=NOT_FINITE), r"camera_matrix .*(not finite|not a matrix)"),
        (spoiled(camera_matrix=TRUE[0].K[:2]), "camera_matrix has 6 numbers; 9"),
        (spoiled(camera_matrix=TRUE[0].K.T), "is not a camera matrix"),
        (spoiled(camera_matrix=np.diag([1e-6, 1e-6, 1.0]) @ TRUE[0].K), "are not those of"),
        (spoiled(camera_matrix=np.diag([3, 3, 1]) @ TRUE[0].K), "are not those of a picture of 1920 x 1080"),
        (spoiled(R=2 * np.eye(3)), "R is not a rotation"),
        (spoiled(R=np.diag([1.0, 1.0, -1.0])), "R is not a rotation"),
        (spoiled(R=None), "has T, but no rotation R"),
        (spoiled(T=None), "has R, but no translation T"),
        (lambda folder: [one_camera(folder, c, T=-c.R_camera_world @ c.p_world) for c in TRUE], "m apart.*length_unit"),
        (spoiled(T=np.array([0.0, 1e5, 5e5])), "m from the base.*length_unit"),
        (spoiled(distortion_coefficients=np.full((1, 8), 0.1)), "8 coefficients of distortion, of a model"),
        (spoiled(distortion_coefficients=np.zeros((1, 3))), "has 3 numbers"),
        (spoiled(image_width=0.5), "picture size 0.5 x 1080 is not one of whole pixels"),
        (spoiled(avg_reprojection_error=-1.0), "avg_reprojection_error = -1"),
        (cut(".yaml", 0.4), "is cut off|is not"),
        (cut(".yaml", 0.03), "is not a calibration file"),
        (cut(".xml", 0.5), "is cut off"),
        (text(""), "is not a calibration file"),
        (text("a: [1, 2"), r":1: is not valid YAML|:2: is not valid YAML"),
        (text("- 1\n- 2\n"), "is not a calibration file"),
        (text("[" * 1000), "is not valid YAML"),
        (text("%YAML:1.0\n---\na:\n  " + "- " * 100000 + "1\n"), "is not a calibration file of OpenCV"),
        (text(ROS.replace("image_width: 1920", "image_width: 1920.5")), "is not one of whole pixels"),
        (text("K: !!python/object/apply:os.system ['touch /tmp/never']\n"), "is not valid YAML"),
        (text("camera_matrix: 2001-99-99\n"), "is not valid YAML"),
        (text(ROS.replace("plumb_bob", "equidistant")), "'equidistant' is not supported"),
        (text(ROS.replace("3000.0, 0.0, 959.5", "x, 0.0, 959.5")), "is not a matrix of numbers"),
        (text('<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>'), "is not a calib"),
        (text("<a/>"), "is not a calibration file"),
        (text("<?xml version='1.0'?><opencv_storage>" + 300_000 * "<a>\n"), "is not a calibration file"),
        (text("%YAML:1.0\n---\na: " + 200_000 * "{a: "), "is not a calibration file"),
        (lambda folder: [folder / "left.yaml", folder / "right.yaml"], "no such calibration file"),
        (lambda folder: [one_camera(folder, TRUE[0])], "1 files for 2 cameras"),
        (lambda folder: [one_camera(folder, TRUE[0]), one_camera(folder, TRUE[1], R=None, T=None)], "all or none"),
        (chain("camera_model: pinhole", "camera_model: omni"), "camera_model 'omni' is not supported"),
        (chain("distortion_model: radtan", "distortion_model: equidistant"), "'equidistant' is not supported"),
        (chain("cam1:", "camera:"), "has 1 cameras, but cameras.names 2"),
        (chain("  intrinsics: [3000.0, 3000.0, 959.5, 539.5]\n", ""), "cam0: has no intrinsics"),
        (chain("intrinsics: [3000.0,", "intrinsics: [.nan,"), "intrinsics has a number that is not finite"),
    ],
)
def test_files_that_cannot_be_used_are_refused_in_one_line(tmp_path, make, words):
    with pytest.raises(InputError, match=words) as caught:
        read(make(tmp_path))
    assert "\n" not in str(caught.value) and str(caught.value).startswith(str(tmp_path))


def test_control_points_place_the_camera_of_a_file(tmp_path):
    """The pose is found within its covariance, by exact points as by clicked ones, and a wrong point is left out."""
    stated = read([one_camera(tmp_path, seen, R=None, T=None) for seen in TRUE])
    box = np.array([(x, y, z) for x in np.linspace(0, 0.2, 5) for y in (-0.06, 0.06) for z in (-0.06, 0.06)])
    labels, rng = [str(i) for i in range(20)], np.random.default_rng(4)
    for one, true in zip(stated.cameras, TRUE, strict=True):
        placed = locate(one, box, true.project(box), labels)
        assert placed.p_world == pytest.approx(true.p_world, abs=1e-6)
        square = []
        for _ in range(15):
            placed = locate(one, box, true.project(box) + 0.5 * rng.normal(size=(20, 2)), labels)
            off = placed.p_world - true.p_world
            square.append(off @ np.linalg.solve(placed.cov[8:11, 8:11], off))
        assert np.mean(square) < 5.0  # 3 is expected, ± 0.63
        pixels = true.project(box) + 0.5 * rng.normal(size=(20, 2))
        pixels[7] += (30.0, 0.0)
        assert locate(one, box, pixels, labels).outliers == ("7",)
        with pytest.raises(InputError, match="do not fit the calibration file"):
            locate(one, box, true.project(box)[::-1], labels)
        with pytest.raises(InputError, match="too few"):
            locate(one, box[:5], true.project(box)[:5], labels[:5])
