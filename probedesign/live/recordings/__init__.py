"""Recordings: CSV with raw readings, and MCAP with standard ROS 2 messages in a file that survives a crash."""

from importlib.util import find_spec

from probedesign.core.errors import MissingDependencyError


def require() -> None:
    """Check that the package that reads and writes MCAP is installed.

    Raises:
        MissingDependencyError: it is not installed.
    """
    if find_spec("mcap") is None:
        raise MissingDependencyError.of_extra("an MCAP recording", "mcap", "live")
