"""Design, print and run soft conic probes that locate a touch from the wrench at their base."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from probedesign.design import load_design as load_design
    from probedesign.frozen_probe import load_estimator as load_estimator
    from probedesign.probe import build_probe as build_probe

_HOME = {
    "load_design": "probedesign.design",
    "build_probe": "probedesign.probe",
    "load_estimator": "probedesign.frozen_probe",
}
__all__ = ["build_probe", "load_design", "load_estimator"]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for, so that `import probedesign` stays light."""
    if name not in _HOME:
        raise AttributeError(f"module 'probedesign' has no attribute '{name}'")
    return getattr(import_module(_HOME[name]), name)
