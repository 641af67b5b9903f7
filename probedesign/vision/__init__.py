"""Cameras as a reference: calibrated from control points, they place dots on a probe in space, with covariance."""

from importlib.util import find_spec

from probedesign.errors import MissingDependencyError


def require() -> None:
    """Refuse to go on without the package that reads photographs.

    Raises:
        MissingDependencyError: it is not installed.
    """
    if find_spec("cv2") is None:
        raise MissingDependencyError('photographs need: pip install "probedesign[vision]"')
