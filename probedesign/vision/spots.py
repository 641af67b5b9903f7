"""Round spots in a photograph: where they may be, roughly."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from probedesign.frames import Array

LEAST_AREA_PX = 3.0
"""Area within the outermost pixels' centres; a smaller spot has neither shape nor centre."""
LARGEST_SHARE = 0.1
"""Of the picture's height; nothing larger is a dot."""
LEAST_CONTRAST = 24.0
"""Grey levels of 255 that a dot stands out by: four times the noise of a dim photograph (assumed)."""
GRAIN_PX = 0.8
"""Standard deviation of the smoothing that spots are seen through, as wide as a usual lens' blur."""
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
    settings.thresholdStep, settings.minRepeatability = LEAST_CONTRAST / 4, 4
    settings.minThreshold, settings.maxThreshold = 5, 250
    settings.minDistBetweenBlobs = 3
    # Grain is smoothed away first: it has ten thousand outlines a threshold, and nine tenths of the time.
    found = cv2.SimpleBlobDetector.create(settings).detect(cv2.GaussianBlur(grey, (3, 3), GRAIN_PX))
    found = sorted(found, key=lambda spot: -spot.size)[:MOST_SPOTS]
    pixels = np.array([spot.pt for spot in found], dtype=float).reshape(-1, 2)
    return Spots(pixels, np.array([spot.size for spot in found], dtype=float), dark)
