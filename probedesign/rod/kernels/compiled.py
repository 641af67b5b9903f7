"""How the kernels are compiled: once, cached beside their source, without Python inside."""

import sys
from functools import cache
from pathlib import Path
from typing import Any

from numba import njit

HERE = Path(__file__).parent


def drop_stale(folder: Path) -> None:
    """Remove a folder's compiled kernels that are older than any kernel's source, there or here.

    numba's cache looks at the file of the function it compiles alone; what that function calls stands in other
    files.
    """
    try:
        newest = max(source.stat().st_mtime for of in {folder, HERE} for source in of.glob("*.py"))
        for index in (folder / "__pycache__").glob("*.nbi"):
            if index.stat().st_mtime < newest:
                index.unlink()
    except OSError:
        pass  # installed where nothing may be written: nothing changes there either


drop_stale(HERE)

kernel = njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
"""Called from Python and by other kernels. Division by zero gives inf or NaN, which the step control refuses."""
inner = njit(
    cache=True,
    nogil=True,
    error_model="numpy",
    fastmath={"contract"},
    no_cpython_wrapper=True,
    no_cfunc_wrapper=True,
)
"""The same for what only kernels call."""
inlined = njit(
    error_model="numpy",
    fastmath={"contract"},
    forceinline=True,
    no_cpython_wrapper=True,
    no_cfunc_wrapper=True,
)
"""Arithmetic on three numbers: always part of its caller."""
merged = njit(
    error_model="numpy",
    fastmath={"contract"},
    inline="always",
    no_cpython_wrapper=True,
    no_cfunc_wrapper=True,
)
"""For what has one caller: compiled as part of it, not by itself and then again."""


@cache
def announce(dispatcher: Any) -> None:
    """Tell someone who waits at a terminal that the first run compiles; once, and only where nothing is cached."""
    name = f"{Path(dispatcher.py_func.__code__.co_filename).stem}.{dispatcher.py_func.__name__}-"
    if sys.stderr.isatty() and not any(Path(dispatcher.stats.cache_path).glob(name + "*.nbi")):
        print("compiling the rod's kernels, half a minute or so, once ...", file=sys.stderr, flush=True)
