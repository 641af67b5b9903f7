"""Campaigns whose cameras are calibrated by files of other programs: from the folder to markers in space."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from probedesign import build_probe, load_design
from probedesign.campaigns import read_campaign
from probedesign.cli.main import run
from probedesign.core.errors import InputError
from probedesign.simulation.campaign_folder import make_campaign
from probedesign.simulation.ground_truth import CampaignPlan, GroundTruth
from probedesign.simulation.stereo_rig import StereoRig
from probedesign.vision.markers import write_png
from tests.vision.scene import calibrate_by_files

DESIGN = Path(__file__).parents[2] / "designs" / "large.toml"
PLAN = CampaignPlan(seed=1)


@pytest.fixture(scope="module")
def model():
    return build_probe(load_design(DESIGN)).model


@pytest.fixture(scope="module")
def rig(model):
    return StereoRig(GroundTruth.draw(model, PLAN, np.random.default_rng(1)))


@pytest.fixture(scope="module")
def made(model, rig, tmp_path_factory):
    folder = tmp_path_factory.mktemp("routes") / "files"
    make_campaign(model, folder, PLAN)
    calibrate_by_files(folder, rig, 1)
    return folder


@pytest.fixture
def data(made, tmp_path):
    return Path(shutil.copytree(made, tmp_path / "files"))


def without_poses(data, rig, points=20):
    """Remove the poses from the files, and add clicks of the box."""
    for name in ("left", "right"):
        text = (data / f"{name}.yaml").read_text()
        (data / f"{name}.yaml").write_text(text.replace("\nR:", "\nQ:").replace("\nT:", "\nU:"))
    rows, rng = ["point,x_world_mm,y_world_mm,z_world_mm,camera,u_px,v_px"], np.random.default_rng(2)
    for camera in rig.cameras:
        pixels = camera.project(rig.control_points) + 0.5 * rng.normal(size=(20, 2))
        for i, (p, (u, v)) in enumerate(zip(1e3 * rig.control_points[:points], pixels, strict=False), 1):
            rows.append(f"{i},{p[0]:.2f},{p[1]:.2f},{p[2]:.2f},{camera.name},{u:.2f},{v:.2f}")
    (data / "control_points.csv").write_text("\n".join(rows) + "\n")


@pytest.mark.parametrize("poses", [True, False])
def test_markers_are_located_within_their_covariance(poses, data, rig):
    if not poses:
        without_poses(data, rig)
    campaign = read_campaign(data)
    error, square = [], []
    for measured, test in zip(campaign.tests, rig.truth.tests(), strict=True):
        off = measured.markers.p_world - rig.markers(test)
        error.append(off)
        square.append(np.einsum("ni,nij,nj->n", off, np.linalg.inv(measured.markers.cov_world), off))
    assert np.sqrt(np.mean(np.sum(np.concatenate(error) ** 2, axis=1))) < 0.4e-3  # 0.2 mm by clicks of 0.7 px
    assert np.mean(np.concatenate(square)) < 6.0  # 3 is expected; one calibration is common to all
    assert any(note.startswith("camera left: ") for note in campaign.notes)


def edit(old, new, file="campaign.toml"):
    def change(data, rig):
        text = (data / file).read_text()
        assert old in text
        (data / file).write_text(text.replace(old, new))

    return change


def no_points(data, rig):
    without_poses(data, rig)
    (data / "control_points.csv").unlink()


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda data, rig: (data / "left.yaml").unlink(), "left.yaml: no such calibration file"),
        (lambda data, rig: (data / "control_points.csv").write_text("x"), "keep one"),
        (no_points, "add control_points.csv"),
        (lambda data, rig: without_poses(data, rig, 5), "too few"),
        (edit("image_width: 1600", "image_width: 1000", "left.yaml"), "outside the pictures of 1000 x 1200"),
        (edit('length_unit = "mm"', 'length_unit = "m"'), "length_unit"),
        (edit('length_unit = "mm"', ""), "length_unit"),
        (edit('length_unit = "mm"', 'length_unit = "inch"'), "length_unit"),
        (edit('"left.yaml"', '"../left.yaml"'), "copy it there"),
        (edit('length_unit = "mm"', "distortion = 2"), "cameras.distortion"),
        (edit("R:", "Q:", "left.yaml"), "no rotation R"),
    ],
)
def test_a_folder_that_cannot_be_used_is_refused_in_one_line(data, rig, spoil, words):
    spoil(data, rig)
    with pytest.raises(InputError) as caught:
        read_campaign(data)
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_a_photograph_of_another_size_than_the_file_is_refused(data, capsys):
    (data / "pixels.csv").unlink()
    (data / "images").mkdir()
    name = read_campaign(data).tests[0].name
    for camera in ("left", "right"):
        write_png(data / "images" / f"{name}-{camera}.png", np.full((600, 800), 90, dtype=np.uint8))
    assert run(["markers", str(data), "--no-overlays"]) == 2
    error = capsys.readouterr().err
    assert "800 x 600" in error and "calibrated for 1600 x 1200" in error and error.count("\n") == 1
    assert not (data / "pixels.csv").exists()
