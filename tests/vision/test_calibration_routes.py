"""Campaigns whose cameras are calibrated by a board or by files: from the folder to markers in space and to E."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from probedesign import pipeline
from probedesign.campaigns.manifest import read_manifest
from probedesign.campaigns.reading import read_cameras, read_campaign
from probedesign.cli.main import run
from probedesign.core.errors import InputError
from probedesign.simulation.campaign_folder import make_campaign
from probedesign.simulation.ground_truth import CampaignPlan, GroundTruth
from probedesign.simulation.simulated_calibration import SimulatedBoard, render_board
from probedesign.simulation.stereo_rig import SIZE_PX, RenderStyle, StereoRig
from probedesign.vision.markers import write_png

DESIGN = Path(__file__).parents[2] / "designs" / "large.toml"


@pytest.fixture(scope="module")
def model():
    return pipeline.load_probe(DESIGN).model


def plan(kind):
    return CampaignPlan(seed=1, calibration=kind)


@pytest.fixture(scope="module")
def made(model, tmp_path_factory):
    folder = tmp_path_factory.mktemp("routes")
    for kind in ("board", "files"):
        make_campaign(model, folder / kind, plan(kind))
    return folder


@pytest.fixture
def data(made, tmp_path):
    return lambda kind: Path(shutil.copytree(made / kind, tmp_path / kind))


@pytest.mark.parametrize("kind", ["board", "files"])
def test_markers_are_located_within_their_covariance(kind, data, model):
    campaign = read_campaign(data(kind))
    world = GroundTruth.draw(model, plan(kind), np.random.default_rng(1))
    rig, error, square = StereoRig(world), [], []
    for measured, test in zip(campaign.tests, world.tests(), strict=True):
        off = measured.markers.p_world - rig.markers(test)
        error.append(off)
        square.append(np.einsum("ni,nij,nj->n", off, np.linalg.inv(measured.markers.cov_world), off))
    assert np.sqrt(np.mean(np.sum(np.concatenate(error) ** 2, axis=1))) < 0.4e-3  # 0.2 mm by clicks of 0.7 px
    assert np.mean(np.concatenate(square)) < 6.0  # 3 is expected; one calibration is common to all
    assert any(note.startswith("camera left: ") for note in campaign.notes)


def test_e_is_identified_with_a_board(data, tmp_path, capsys):
    folder = data("board")
    assert run(["identify", str(DESIGN), str(folder), "--out", str(tmp_path / "found.toml"), "--json"]) == 0
    output = json.loads(capsys.readouterr().out)
    true = json.loads((folder / "truth.json").read_text())["youngs_modulus_mpa"]
    text = json.dumps(output)
    assert '"ok"' in text
    found = next(line for line in (tmp_path / "found.toml").read_text().splitlines() if "youngs_modulus_mpa =" in line)
    value = float(found.split("=")[1].split("#")[0])
    assert value == pytest.approx(true, rel=0.05)  # three times the stated 1.4 %


@pytest.fixture(scope="module")
def pictures(model, tmp_path_factory):
    """Four placements of the board, rendered."""
    world = GroundTruth.draw(model, plan("board"), np.random.default_rng(1))
    target = SimulatedBoard(StereoRig(world), 1, False)
    folder = tmp_path_factory.mktemp("board")
    for name in ("world", "01", "02", "03"):
        for camera in target.rig.cameras:
            look = RenderStyle(seed=len(name))
            picture = render_board(camera, target.board, target.placements[name], target.scale, SIZE_PX, look)
            write_png(folder / f"{name}-{camera.name}.png", picture)
    return folder


@pytest.fixture
def photographed(data, pictures):
    folder = data("board")
    (folder / "board_corners.csv").unlink()
    shutil.copytree(pictures, folder / "board")
    return folder


def test_pictures_of_the_board_calibrate_the_cameras(photographed, model, capsys):
    (photographed / "pixels.csv").rename(photographed / "kept.csv")
    assert run(["markers", str(photographed), "--json"]) == 0
    output = json.loads(capsys.readouterr().out)
    assert [one["used"] for one in output["boards"]] == [True] * 8 and output["tests"] == []
    assert {path.name for path in (photographed / "overlays").iterdir()} >= {"board-world-left.png"}
    cameras, _ = read_cameras(photographed, read_manifest(photographed))
    rig = StereoRig(GroundTruth.draw(model, plan("board"), np.random.default_rng(1)))
    for found, true in zip(cameras, rig.cameras, strict=True):
        std = np.sqrt(np.diag(found.cov))
        assert found.std_px < 0.1
        assert np.abs((found.K - true.K)[[0, 1, 0, 1], [0, 1, 2, 2]] / std[[0, 1, 3, 4]]).max() < 5.0
        assert np.abs((found.p_world - true.p_world) / std[8:11]).max() < 5.0
    assert run(["markers", str(photographed)]) == 2
    assert "--force" in capsys.readouterr().err


def remove(pattern):
    return lambda data: [path.unlink() for path in (data / "board").glob(pattern)]


def scale_down(data):
    path = data / "board" / "02-left.png"
    write_png(path, np.asarray(cv2.resize(cv2.imread(str(path), 0), None, fx=0.5, fy=0.5)))


def edit(old, new, file="campaign.toml"):
    def change(data):
        text = (data / file).read_text()
        assert old in text
        (data / file).write_text(text.replace(old, new))

    return change


def blank(data):
    for path in (data / "board").iterdir():
        write_png(path, np.full((1200, 1600), 90, dtype=np.uint8))


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda data: shutil.rmtree(data / "board"), "board: no such folder"),
        (remove("*"), "has no pictures of the board"),
        (remove("*-left.png"), "no picture by camera left shows the board"),
        (remove("world-*"), "no usable picture world-CAMERA"),
        (blank, "no picture shows the board of 9 x 7 squares"),
        (lambda data: (data / "board/01-left.png").rename(data / "board/01.png"), "is not named PLACEMENT-CAMERA"),
        (lambda data: shutil.copy(data / "board/01-left.png", data / "board/01-left.jpg"), "a second picture"),
        (lambda data: (data / "board/01-left.png").write_bytes(b"no"), "is not an image"),
        (edit("DICT_5X5_100", "DICT_6X6_50"), "no picture shows the board of 9 x 7 squares, DICT_6X6_50"),
        (edit("DICT_5X5_100", "DICT_5X5"), "cameras.board"),
        (edit("square_mm = 13", "square_mm = -13"), "square_mm"),
        (edit("square_mm = 13", "square_mm = nan"), "square_mm"),
        (edit("squares = [9, 7]", "squares = [9]"), "squares"),
        (edit("squares = [9, 7]", "squares = [9, 2]"), "cameras.board"),
    ],
)
def test_pictures_that_cannot_be_used_are_refused_in_one_line(photographed, spoil, words, capsys):
    (photographed / "pixels.csv").unlink()
    spoil(photographed)
    assert run(["markers", str(photographed), "--no-overlays"]) == 2
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1
    assert not (photographed / "board_corners.csv").exists()


@pytest.mark.parametrize(
    ("kind", "spoil", "words"),
    [
        ("board", lambda data: (data / "board_corners.csv").unlink(), "board_corners.csv: is missing"),
        ("board", edit("\n01,left,3,", "\n01,left,99,", "board_corners.csv"), "corner '99' is not one of the board"),
        ("board", edit("\n01,left,3,", "\n01,left,4,", "board_corners.csv"), "occurs twice"),
        ("board", edit("\n01,left,3,", "\n01,lft,3,", "board_corners.csv"), "camera 'lft' is not in cameras.names"),
        ("board", edit(",1600,1200\n01,left,4,", ",800,600\n01,left,4,", "board_corners.csv"), "no single size"),
        ("board", edit(",1600,1200", ",160,120", "board_corners.csv"), "lies outside the picture of 160 x 120"),
        ("board", edit("\nworld,", "\nother,", "board_corners.csv"), "no usable picture of the placement 'world'"),
        ("board", edit('names = ["left", "right"]', 'names = ["left", "right"]\ncalibration = ["left.yaml"]'),
         "left.yaml: no such calibration file"),
        ("board", lambda data: (data / "control_points.csv").write_text("x"), "keep one calibration"),
        ("files", edit("image_width: 1600", "image_width: 1000", "left.yaml"), "outside the pictures of 1000 x 1200"),
        ("files", edit('length_unit = "mm"', 'length_unit = "m"'), "length_unit"),
        ("files", edit('length_unit = "mm"', ""), "length_unit"),
        ("files", edit('length_unit = "mm"', 'length_unit = "inch"'), "length_unit"),
        ("files", edit('"left.yaml"', '"../left.yaml"'), "copy it there"),
        ("files", edit('length_unit = "mm"', "distortion = 2"), "cameras.distortion"),
        ("files", edit("R:", "Q:", "left.yaml"), "no rotation R"),
    ],
)  # fmt: skip
def test_a_folder_that_cannot_be_used_is_refused_in_one_line(data, kind, spoil, words):
    folder = data(kind)
    spoil(folder)
    with pytest.raises(InputError) as caught:
        read_campaign(folder)
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_files_without_poses_need_a_board(data):
    folder = data("files")
    for name in ("left", "right"):
        text = (folder / f"{name}.yaml").read_text()
        (folder / f"{name}.yaml").write_text(text.replace("\nR:", "\nQ:").replace("\nT:", "\nU:"))
    with pytest.raises(InputError, match=r"add \[cameras\.board\]"):
        read_campaign(folder)


def test_a_picture_of_another_size_than_the_file_is_refused(photographed, data):
    scale_down(photographed)
    assert run(["markers", str(photographed), "--no-overlays", "--force"]) == 0
    with pytest.raises(InputError, match="different sizes, 800 x 600 and 1600 x 1200"):
        read_campaign(photographed)


def test_a_board_is_written_in_both_formats_and_not_replaced(tmp_path, capsys):
    for suffix, start in ((".pdf", b"%PDF"), (".png", b"\x89PNG")):
        out = tmp_path / f"board{suffix}"
        assert run(["board", str(out), "--squares", "6", "5", "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["width_mm"] == 120.0
        assert out.read_bytes().startswith(start)
        assert run(["board", str(out)]) == 2 and "--force" in capsys.readouterr().err
    assert run(["board", str(tmp_path / "board.svg")]) == 2 and ".pdf or .png" in capsys.readouterr().err
