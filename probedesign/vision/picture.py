"""Photographs: read as grey levels, written as PNG."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from probedesign.errors import InputError
from probedesign.files import write_atomically
from probedesign.vision import require

MOST_BYTES = 300_000_000
"""No camera's photograph is larger (assumed)."""


def read_grey(path: Path) -> NDArray[np.uint8]:
    """Grey levels of a photograph (height, width), turned as its EXIF says, as any viewer does.

    Raises:
        InputError: there is none, or it is no picture.
        MissingDependencyError: OpenCV is not installed.
    """
    require()
    import cv2

    try:
        if path.stat().st_size > MOST_BYTES:
            raise InputError(
                f"{path}: is larger than {MOST_BYTES // 1_000_000} MB; save the photograph as PNG or JPEG"
            )
        content = np.fromfile(path, dtype=np.uint8)
    except FileNotFoundError:
        raise InputError(f"{path}: no such photograph") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    cv2.utils.logging.setLogLevel(
        cv2.utils.logging.LOG_LEVEL_ERROR
    )  # what it would warn of is told in our own line
    try:
        picture = cv2.imdecode(content, cv2.IMREAD_GRAYSCALE) if len(content) else None
    except cv2.error:
        picture = None
    if picture is None:
        raise InputError(f"{path}: is no picture that can be read; save it as PNG or JPEG")
    return np.asarray(picture, dtype=np.uint8)


def write_png(path: Path, picture: NDArray[np.uint8]) -> None:
    """Write a picture, grey (height, width) or blue, green, red (height, width, 3), whole or not at all.

    Raises:
        InputError: the folder cannot be written to.
        MissingDependencyError: OpenCV is not installed.
    """
    require()
    import cv2

    write_atomically(path, cv2.imencode(".png", picture)[1].tobytes())
