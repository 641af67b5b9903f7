"""Two cameras, a box of twenty control points and a bent probe with dots, as the tests look at them."""

from pathlib import Path

import numpy as np

from probedesign.simulation.stereo_rig import SIZE_PX, StereoRig
from probedesign.vision.calibrate import calibrate
from probedesign.vision.camera import Camera
from probedesign.vision.camera_files import assumed_covariance
from tests.vision.rendering import PaintedDots, SurfaceTube

#: The paper's calibration box has 20 points; their places are assumed [m].
BOX = np.array([(x, y, z) for x in np.linspace(0, 0.2, 5) for y in (-0.06, 0.06) for z in (-0.06, 0.06)])
SIZE = (1300, 820)
MARKERS = np.column_stack([np.linspace(0.01, 0.15, 15), np.zeros(15), -1.5 * np.linspace(0.01, 0.15, 15) ** 2])


def camera(name="left", distortion=(), focal=3000.0, size=(1920, 1080)):
    """One of two at half a metre, 50° apart."""
    x = -0.15 if name == "left" else 0.35
    return Camera.looking(name, (x, -0.55, 0.25), (0.1, 0.0, 0.0), focal, size, distortion)


def calibrated(true, rng, std_px=0.5, **options):
    pixels = true.project(BOX) + rng.normal(0, std_px, (len(BOX), 2))
    return calibrate(true.name, BOX, pixels, len(true.distortion), **options)


def calibrate_by_files(folder: Path, rig: StereoRig, seed: int) -> None:
    """Replace the box of a simulated campaign by files of OpenCV, in mm, whose cameras err as assumed for 0.3 px."""
    import cv2

    rng = np.random.default_rng([seed, 3])
    for seen in rig.cameras:
        distance = float(np.linalg.norm(seen.p_world - rig.truth.T_world_base[:3, 3]))
        std = np.sqrt(np.diag(assumed_covariance(seen, 0.3, distance)))
        stated = seen.moved(std * rng.normal(size=len(std)))
        file = cv2.FileStorage(str(folder / f"{seen.name}.yaml"), cv2.FILE_STORAGE_WRITE)
        shift = -1e3 * stated.R_camera_world @ stated.p_world
        for key, value in (("image_width", SIZE_PX[0]), ("image_height", SIZE_PX[1]), ("camera_matrix", stated.K),
                           ("distortion_coefficients", np.zeros((5, 1))), ("R", stated.R_camera_world), ("T", shift),
                           ("avg_reprojection_error", 0.3)):  # fmt: skip
            file.write(key, value)
        file.release()
    (folder / "control_points.csv").unlink()
    names, path = 'names = ["left", "right"]', folder / "campaign.toml"
    files = 'calibration = ["left.yaml", "right.yaml"]\nlength_unit = "mm"'
    path.write_text(path.read_text().replace(names, f"{names}\n{files}"))


def probe(bend=1.0, side=(0.0, -1.0, 0.4), count=14):
    """A cone 12 to 2 mm of 150 mm, bent downwards, dots 10 mm apart."""
    s = np.linspace(0.0, 0.15, 400)
    angle = bend * (s / 0.15) ** 1.5
    steps = np.column_stack([np.cos(angle), 0.1 * np.sin(angle), -np.sin(angle)])
    steps /= np.linalg.norm(steps, axis=1)[:, None]
    line = np.vstack([np.zeros(3), np.cumsum((steps[1:] + steps[:-1]) / 2 * s[1], axis=0)])
    tube, places = SurfaceTube(line, np.linspace(0.012, 0.002, 400)), 0.01 * np.arange(1, count + 1)
    return tube, PaintedDots(
        places, np.tile(np.array(side), (count, 1)), np.minimum(0.5 * tube.at(places)[2] * 2, 0.003)
    )
