"""Recordings in MCAP: standard ROS 2 messages in a file that survives its writer."""

from importlib.util import find_spec

from probedesign.errors import MissingDependencyError


def require() -> None:
    """Refuse to go on without the package that reads and writes MCAP.

    Raises:
        MissingDependencyError: it is not installed.
    """
    if find_spec("mcap") is None:
        raise MissingDependencyError('MCAP files need: pip install "probedesign[live]"')
