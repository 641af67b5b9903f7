"""The colour of a point: blue where it is known well, to red where it is not."""

import numpy as np

SURE, VAGUE = 0.2, 5.0
"""Standard deviations at the ends of the scale [mm]; between them it goes by the logarithm."""
SCALE = ((31, 95, 168), (120, 120, 120), (217, 115, 13), (178, 24, 43))
"""Red, green and blue, evenly along the scale."""


def colour_of(rms_mm: float) -> tuple[int, int, int]:
    """Red, green and blue, 0 to 255, for the standard deviation of a place [mm]."""
    share = np.log(max(rms_mm, 1e-9) / SURE) / np.log(VAGUE / SURE)
    at = np.clip(share, 0.0, 1.0) * (len(SCALE) - 1)
    red, green, blue = (
        round(float(np.interp(at, range(len(SCALE)), part))) for part in zip(*SCALE, strict=True)
    )
    return red, green, blue


def hex_of(rms_mm: float) -> str:
    """The same as #rrggbb."""
    return "#{:02x}{:02x}{:02x}".format(*colour_of(rms_mm))
