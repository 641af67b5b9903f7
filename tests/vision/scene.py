"""Two cameras, a box of twenty control points and a bent probe with dots, as the tests look at them."""

import numpy as np

from probedesign.vision.calibrate import calibrate
from probedesign.vision.camera import Camera
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
