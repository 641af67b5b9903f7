"""Camera vision: calibration from control points, detection of markers, and their positions in space."""

from importlib.util import find_spec

from probedesign.core.errors import MissingDependencyError


def require() -> None:
    """Check that the package that reads photographs is installed; raise MissingDependencyError if it is not."""
    if find_spec("cv2") is None:
        raise MissingDependencyError.of_extra("reading photographs", "opencv", "vision")
