"""The compiled rod: sweeps from the free tip to the base with exact sensitivities, and the solver on top of them.

Read `equations` first, then `steps`: one step of the state and of its sensitivities. `sweep` integrates one rod with
all outputs and evaluates the finished sweep; `lanes` and `lane_sweep` integrate as many rods side by side as a vector
register has lanes. `newton` finds the section of the tip, and `solve` runs many cases through it for callers in Python.
All of it works on flat arrays, records and tuples and allocates nothing: the caller provides the memory.

This module has the decorators that compile the kernels: once, cached beside their source, without Python objects.
"""

import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from numba import njit

HERE = Path(__file__).parent
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}}
"""Division by zero gives inf or NaN, which the step control refuses; products and sums may be fused, not reordered."""
_INTERNAL: dict[str, Any] = {**_OPTIONS, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


@cache
def drop_stale(folder: Path) -> None:
    """Remove a folder's compiled kernels that are older than any kernel source, there or here; once per process.

    numba's cache checks only the file of the function that it compiles; what that function calls is in other files.
    """
    try:
        newest = max(source.stat().st_mtime for of in {folder, HERE} for source in of.glob("*.py"))
        for index in (folder / "__pycache__").glob("*.nbi"):
            if index.stat().st_mtime < newest:
                index.unlink()
    except OSError:
        pass  # installed where nothing may be written: nothing changes there either


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function that Python and other kernels call, cached on disk."""
    drop_stale(Path(function.__code__.co_filename).parent)
    return njit(cache=True, nogil=True, **_OPTIONS)(function)


def inner(function: Callable[..., Any]) -> Any:
    """Compile a function that only kernels call, cached on disk."""
    drop_stale(Path(function.__code__.co_filename).parent)
    return njit(cache=True, nogil=True, **_INTERNAL)(function)


inlined = njit(forceinline=True, **_INTERNAL)
"""Compile a function that LLVM always inlines: arithmetic on a few numbers."""
inline_always = njit(inline="always", **_INTERNAL)
"""Compile a function with one caller as part of that caller, not by itself and then again."""


@cache
def announce(dispatcher: Any) -> None:
    """Print, once and only on a terminal, that the first run compiles; nothing where the kernel is cached."""
    name = f"{Path(dispatcher.py_func.__code__.co_filename).stem}.{dispatcher.py_func.__name__}-"
    if sys.stderr.isatty() and not any(Path(dispatcher.stats.cache_path).glob(name + "*.nbi")):
        print("Compiling the rod's kernels, once: about half a minute ...", file=sys.stderr, flush=True)
