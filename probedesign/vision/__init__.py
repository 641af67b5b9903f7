"""Camera vision: calibration from control points, detection of markers, and their positions in space."""

from probedesign.core.errors import require


def require_opencv() -> None:
    """Check that the package that reads photographs is installed; raise MissingDependencyError if it is not."""
    require("cv2", "reading photographs", "vision", "opencv")
