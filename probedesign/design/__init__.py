"""The design file: its schema, its reading and writing, and the catalog of parts that it names.

The names of the package are imported when they are first used: the computer that runs `live` needs the catalog and
has no pydantic.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from probedesign.design.io import check_design as check_design
    from probedesign.design.io import load_design as load_design
    from probedesign.design.io import new as new
    from probedesign.design.io import parse_design as parse_design
    from probedesign.design.schema import Design as Design
    from probedesign.design.schema import check_name as check_name

_MODULES = {"Design": "schema", "check_name": "schema", "check_design": "io", "load_design": "io", "new": "io",
            "parse_design": "io"}  # fmt: skip
__all__ = ["Design", "check_design", "check_name", "load_design", "new", "parse_design"]


def __getattr__(name: str) -> Any:
    """Import a public name of the package when it is first used."""
    if name not in _MODULES:
        raise AttributeError(f"module 'probedesign.design' has no attribute '{name}'")
    return getattr(import_module(f"probedesign.design.{_MODULES[name]}"), name)
