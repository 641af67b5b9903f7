"""Solids, meshes and files of a design: the only package that uses CadQuery, imported on demand.

Each name is imported when it is first used, which raises MissingDependencyError where CadQuery, trimesh or lib3mf is
not installed.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from probedesign.core.errors import MissingDependencyError
from probedesign.core.parallel import defer_sigint

if TYPE_CHECKING:
    from probedesign.cad.coupon import export_coupon
    from probedesign.cad.export import export_parts
    from probedesign.cad.mesh import export_part
    from probedesign.cad.workplanes import (
        assembly,
        clamp_ring,
        export_changed,
        flange_adapter,
        probe_solid,
        sensor_adapter,
    )

__all__ = [
    "assembly", "clamp_ring", "export_changed", "export_coupon", "export_part", "export_parts", "flange_adapter",
    "probe_solid", "sensor_adapter",
]  # fmt: skip
#: Modules of the names; all others are those of `workplanes`.
_MODULES = {"export_coupon": "coupon", "export_part": "mesh", "export_parts": "export"}


def __getattr__(name: str) -> Any:
    """Import the CAD kernel with a public name, and report what is missing."""
    if name not in __all__:
        raise AttributeError(f"module 'probedesign.cad' has no attribute '{name}'")
    try:
        with defer_sigint():  # Ctrl-C while the kernel loads would crash it
            module = import_module(f"probedesign.cad.{_MODULES.get(name, 'workplanes')}")
    except ImportError as error:
        if (error.name or "").startswith("probedesign"):
            raise
        if isinstance(error, ModuleNotFoundError):
            raise MissingDependencyError.of_extra("export", "CadQuery", "cad") from None
        # CadQuery is installed, a system library is missing
        raise MissingDependencyError(
            f"CadQuery does not load: {error}; on Debian and Ubuntu: apt-get install libgl1 libexpat1"
        ) from None
    return getattr(module, name)
