"""Base of all packages: frames, units, errors, files, statistics and tables; none knows a probe."""

import importlib
import sys
import warnings
from collections.abc import Mapping


def warn_renamed(former: str, current: str, modules: Mapping[str, str] | None = None) -> None:
    """Warn that a module was renamed, and make its submodules importable by their former names.

    Args:
        former: dotted name of the former module, which calls this while it is imported.
        current: dotted name of the module that replaces it.
        modules: names of the former submodules to those in `current`.
    """
    warnings.warn(
        f"{former} was renamed {current}; the former name is removed in the next release",
        DeprecationWarning,
        stacklevel=3,
    )
    for old, new in (modules or {}).items():
        sys.modules[f"{former}.{old}"] = importlib.import_module(f"{current}.{new}")
