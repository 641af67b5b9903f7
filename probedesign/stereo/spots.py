"""Round spots in a photograph: where they may be, roughly."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from probedesign.frames import Array

LEAST_AREA_PX = 6.0
"""Fewer pixels tell neither shape nor centre."""
LARGEST_SHARE = 0.1
"""Of the picture's height; nothing larger is a dot."""
LEAST_CONTRAST = 24.0
"""Grey levels of 255 that a dot stands out by: four times the noise of a dim photograph (assumed)."""
MOST_SPOTS = 300
"""More are no clutter but a texture."""


@dataclass(frozen=True)
class Spots:
    """Spots, darker or lighter than what is around them.

    Attributes:
        pixels: centres, to about half a pixel [px], (n, 2).
        diameter_px: (n,).
        dark: whether they are darker.
    """

    pixels: Array
    diameter_px: Array
    dark: bool


def spots(grey: NDArray[np.uint8], dark: bool) -> Spots:
    """All round spots of a photograph, the dots of the probe and others."""
    settings = cv2.SimpleBlobDetector.Params()
    settings.filterByColor, settings.blobColor = True, 0 if dark else 255
    settings.filterByArea, settings.minArea = True, LEAST_AREA_PX
    settings.maxArea = float(np.pi / 4 * (LARGEST_SHARE * grey.shape[0]) ** 2)
    settings.filterByCircularity = False  # of a few pixels a perimeter is no number
    settings.filterByInertia, settings.minInertiaRatio = True, 0.15  # a dot seen at 67° from its normal
    settings.filterByConvexity, settings.minConvexity = True, 0.8
    settings.thresholdStep, settings.minRepeatability = LEAST_CONTRAST / 3, 3
    settings.minThreshold, settings.maxThreshold = 5, 250
    settings.minDistBetweenBlobs = 3
    found = cv2.SimpleBlobDetector.create(settings).detect(grey)
    found = sorted(found, key=lambda spot: -spot.size)[:MOST_SPOTS]
    pixels = np.array([spot.pt for spot in found], dtype=float).reshape(-1, 2)
    return Spots(pixels, np.array([spot.size for spot in found], dtype=float), dark)
