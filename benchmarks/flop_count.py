"""Count the floating-point operations of a compiled function by running its Python source on counting numbers."""

import math
from collections import Counter
from collections.abc import Callable
from functools import partial
from types import CellType, FunctionType, ModuleType, SimpleNamespace
from typing import Any, ClassVar

import numpy as np

FLOPS = ("add", "sub", "mul", "div", "sqrt")
"""Operations that are counted. Changes of sign, comparisons and integer operations are not."""


class CountingFloat(float):
    """A float that counts its operations in `done`; `calls` counts the function calls."""

    done: ClassVar[Counter[str]] = Counter()
    calls: ClassVar[Counter[str]] = Counter()
    __array_ufunc__ = None  # numpy scalars then leave the operation to this class


def _counting(name: str, operator: str) -> Callable[[CountingFloat, float], Any]:
    plain = getattr(float, operator)

    def operate(self: CountingFloat, other: float) -> Any:
        if not isinstance(other, (int, float)):
            return NotImplemented
        if operator == "__pow__" and isinstance(other, int) and other > 0:
            self.done["mul"] += other.bit_length() + other.bit_count() - 2  # compiled to squares and products
        else:
            self.done[name] += 1
        return CountingFloat(plain(self, float(other)))

    return operate


def _signing(operator: str) -> Callable[[CountingFloat], CountingFloat]:
    plain = getattr(float, operator)
    return lambda self: CountingFloat(plain(self))


for _name in ("add", "sub", "mul", "truediv", "pow"):
    for _operator in (f"__{_name}__", f"__r{_name}__"):
        setattr(CountingFloat, _operator, _counting("div" if _name == "truediv" else _name, _operator))
for _operator in ("__neg__", "__pos__", "__abs__"):
    setattr(CountingFloat, _operator, _signing(_operator))


def count_operations(function: Callable[..., object], *args: object) -> dict[str, int]:
    """Return the operations of one call by name: `add`, `sub`, `mul`, `div`, `sqrt` and other functions of `math`.

    Args:
        function: a Python function or one compiled by numba; the functions it calls may be compiled as well.
        args: floats, arrays of floats, which stay unchanged, and tuples of them; other values are passed as they are.

    Operations on numbers from arrays that the function allocates are not counted. The compiled code measured here
    uses tuples and the arrays it is given.
    """
    return count(function, *args)[0]


def count(function: Callable[..., object], *args: object) -> tuple[dict[str, int], dict[str, int]]:
    """Return the operations as `count_operations` and the number of calls of each function by name."""
    CountingFloat.done, CountingFloat.calls = Counter(), Counter()
    _uncompiled(function, {})(*(_counting_value(arg) for arg in args))
    return dict(CountingFloat.done), dict(CountingFloat.calls)


def flops(counts: dict[str, int]) -> int:
    """Return the total number of the operations in `FLOPS`."""
    return sum(counts.get(name, 0) for name in FLOPS)


def _counting_value(value: Any) -> Any:
    """Return a value with its floats replaced by counting floats."""
    if isinstance(value, (float, np.floating)):
        return CountingFloat(value)
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        copy = np.empty(value.shape, dtype=object)
        for at in np.ndindex(value.shape):
            copy[at] = CountingFloat(value[at])
        return copy
    if isinstance(value, np.ndarray) and value.dtype.names:
        return _Records(value)
    if isinstance(value, tuple):
        parts = [_counting_value(part) for part in value]
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    return value


class _Records(list[SimpleNamespace]):
    """Records of counting floats whose fields are attributes, as in compiled code."""

    def __init__(self, array: Any) -> None:
        self.shape = array.shape
        super().__init__(
            SimpleNamespace(**{name: _counting_value(row[name]) for name in array.dtype.names}) for row in array
        )


def _uncompiled(value: Any, done: dict[Any, Any]) -> Any:
    """Return the Python function of a compiled one, with its callees uncompiled and `math` counting.

    Other values are returned as they are. `done` contains the functions converted so far, so that recursion ends.
    """
    if value is math:
        return _MATH
    if isinstance(value, ModuleType):  # functions that are called as module.function
        compiled = {name: part for name, part in vars(value).items() if hasattr(part, "py_func")}
        plain = {name: _uncompiled(part, done) for name, part in compiled.items()}
        return SimpleNamespace(**{**vars(value), **plain}) if plain else value
    python = getattr(value, "py_func", value)
    if not isinstance(python, FunctionType):
        return value
    if python not in done:
        names, code = dict(python.__globals__), python.__code__
        cells = tuple(CellType() for _ in code.co_freevars)
        plain = FunctionType(code, names, python.__name__, python.__defaults__, cells)
        done[python] = _recording_calls(plain)
        for name in code.co_names:
            if name in names:
                names[name] = _uncompiled(names[name], done)
        for cell, old in zip(cells, python.__closure__ or (), strict=True):
            cell.cell_contents = _uncompiled(old.cell_contents, done)
    return done[python]


def _recording_calls(function: Callable[..., Any]) -> Callable[..., Any]:
    def call(*args: object) -> Any:
        CountingFloat.calls[function.__name__] += 1
        return function(*args)

    return call


def _counted_math(name: str, *args: float) -> Any:
    CountingFloat.done[name] += 1
    return CountingFloat(getattr(math, name)(*args))


_MATH = SimpleNamespace(**vars(math))
for _name in ("sqrt", "hypot", "sin", "cos", "tan", "atan2", "acos", "asin", "exp", "log"):
    setattr(_MATH, _name, partial(_counted_math, _name))
