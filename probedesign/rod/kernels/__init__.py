"""The compiled rod: sweeps from the free tip to the base with exact sensitivities, and the solver on top of them.

Read `equations` first, then `steps`: one step of the state and of its sensitivities. `sweep` integrates one rod and
evaluates the finished sweep, `newton` finds the section of the tip, and `solve` runs many cases for callers in Python.
All of it works on flat arrays, records and tuples and allocates nothing: the caller provides the memory.

This module has the decorators that compile the kernels: once, without Python objects. `cache` has their compiler, and
keeps what is compiled.
"""

from collections.abc import Callable
from typing import Any

from numba import njit, types

from probedesign.rod.kernels.cache import KernelCache, KernelCompiler

#: Division by zero gives inf or NaN, which the step control refuses; products and sums may be fused, not reordered.
#: Without numba's runtime (`_nrt`, no public option), memory cannot be allocated in a kernel, and less is compiled.
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}, "_nrt": False}
_INTERNAL: dict[str, Any] = {**_OPTIONS, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function that Python and other kernels call, cached on disk."""
    return _cached(function, {**_OPTIONS, "no_cfunc_wrapper": True})  # nothing calls them from C


def inner(function: Callable[..., Any]) -> Any:
    """Compile a function that only kernels call, cached on disk."""
    return _cached(function, _INTERNAL)


def inlined(function: Callable[..., Any]) -> Any:
    """Compile a function that LLVM always inlines, cached on disk: arithmetic on a few numbers."""
    return _cached(function, {**_INTERNAL, "forceinline": True})


def _cached(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    dispatcher = njit(nogil=True, pipeline_class=KernelCompiler, **options)(function)
    if dispatcher is not function:  # NUMBA_DISABLE_JIT returns the function
        dispatcher._cache = KernelCache(dispatcher)
        call_template = dispatcher.get_call_template

        def by_types(args: Any, kws: Any) -> Any:
            """Compile once for all integer constants, where numba would compile for each; flags select code."""
            integer = types.IntegerLiteral
            return call_template([types.unliteral(arg) if isinstance(arg, integer) else arg for arg in args], kws)

        dispatcher.get_call_template = by_types
    return dispatcher


#: Compile a function with one caller as part of that caller, not by itself and then again.
inline_always = njit(inline="always", **_INTERNAL)
