"""`probedesign markers`: from photographs to pixels, and what it refuses."""

import json
import shutil

import numpy as np
import pytest
from scene import BOX, SIZE, camera, probe

pytest.importorskip("cv2")

from probedesign.campaigns.reading import read_campaign
from probedesign.cli.main import run
from probedesign.vision.markers import read_grey, write_png
from tests.vision.rendering import render

PAIR = [camera(name, focal=2300.0, size=SIZE) for name in ("left", "right")]
TUBE, DOTS = probe()


@pytest.fixture(scope="module")
def taken(tmp_path_factory):
    """A campaign of one test with its photographs and a box."""
    data = tmp_path_factory.mktemp("campaign")
    data.joinpath("campaign.toml").write_text(
        'schema = 1\nprobe = "large"\n[base]\nrotation_world_deg = [0.0, 90.0, 0.0]\n'
        f"[gravity]\nworld_m_s2 = [0.0, 0.0, -9.81]\n[markers]\ns_mm = {[10.0 * i for i in range(1, 15)]}\n"
        'side_deg = -90.0\n[cameras]\nnames = ["left", "right"]\n'
    )
    data.joinpath("tests.csv").write_text("test\nbent\n")
    lines = ["point,x_world_mm,y_world_mm,z_world_mm,camera,u_px,v_px"]
    for one in PAIR:
        for number, (p, pixel) in enumerate(zip(BOX, one.project(BOX), strict=True), 1):
            x, y, z = 1e3 * p
            lines.append(f"{number},{x:.6f},{y:.6f},{z:.6f},{one.name},{pixel[0]:.6f},{pixel[1]:.6f}")
        (data / "images").mkdir(exist_ok=True)
        write_png(data / "images" / f"bent-{one.name}.png", render(one, TUBE, DOTS, SIZE))
    data.joinpath("control_points.csv").write_text("\n".join(lines) + "\n")
    return data


@pytest.fixture
def data(taken, tmp_path):
    return shutil.copytree(taken, tmp_path / "data")


def test_photographs_become_markers_in_space(data, capsys):
    assert run(["markers", str(data), "--dots", "dark", "--json"]) == 0
    output = json.loads(capsys.readouterr().out)
    assert output["tests"][0]["markers"] == 14 and output["tests"][0]["residual_px"] < 0.5
    assert {path.name for path in (data / "overlays").iterdir()} == {"bent-left.png", "bent-right.png"}
    markers = read_campaign(data).tests[0].markers
    error = markers.p_world - TUBE.dot_positions(DOTS)
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) < 0.1e-3  # 0.1 px at half a metre is 0.02 mm across
    square = np.einsum("ni,nij,nj->n", error, np.linalg.inv(markers.cov_world), error)
    assert np.mean(square) < 9.0  # 3 if the stated covariance is right; 14 markers share the light and the curvature

    assert run(["markers", str(data)]) == 2
    assert "--force" in capsys.readouterr().err


def swap_photographs(data):
    left, right, spare = (data / "images" / name for name in ("bent-left.png", "bent-right.png", "spare"))
    left.rename(spare), right.rename(left), spare.rename(right)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (swap_photographs, "cameras left and right are swapped"),
        (lambda data: (data / "images/bent-left.png").unlink(), "camera right only has a photograph of test bent"),
        (lambda data: shutil.rmtree(data / "images"), "no such folder"),
        (lambda data: (data / "images/bent-left.png").write_bytes(b"no"), "is not an image"),
        (lambda data: (data / "control_points.csv").unlink(), "control_points.csv: is missing"),
        (lambda data: (data / "images/bent-left.jpg").write_bytes(b""), "a second photograph"),
    ],
)
def test_bad_photographs_are_refused_in_one_line(data, spoil, words, capsys):
    spoil(data)
    assert run(["markers", str(data), "--dots", "dark", "--no-overlays"]) == 2
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1
    assert not (data / "pixels.csv").exists()


def test_photographs_of_one_camera_have_one_size(data, capsys):
    """Control points state no size: a photograph of another setting is compared with the camera's others."""
    data.joinpath("tests.csv").write_text("test\nbent\nother\n")
    images = data / "images"
    shutil.copy(images / "bent-left.png", images / "other-left.png")
    write_png(images / "other-right.png", read_grey(images / "bent-right.png")[:-40])
    assert run(["markers", str(data), "--dots", "dark"]) == 2
    error = capsys.readouterr().err
    assert "other-right.png" in error and f"{SIZE[1]}" in error and error.count("\n") == 1
