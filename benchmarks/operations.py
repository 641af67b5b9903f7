"""How many floating-point operations a compiled function does: its Python, run on numbers that count."""

import math
from collections import Counter
from collections.abc import Callable
from functools import partial
from types import CellType, FunctionType, ModuleType, SimpleNamespace
from typing import Any, ClassVar

import numpy as np

FLOPS = ("add", "sub", "mul", "div", "sqrt")
"""What counts as one operation each. Signs, comparisons and whole numbers do not."""


class Counted(float):
    """A float that tells `done` of each operation it takes part in; `calls` is told of each function called."""

    done: ClassVar[Counter[str]] = Counter()
    calls: ClassVar[Counter[str]] = Counter()
    __array_ufunc__ = None  # numpy's numbers leave the operation to this class


def _counting(name: str, operator: str) -> Callable[[Counted, float], Any]:
    plain = getattr(float, operator)

    def operate(self: Counted, other: float) -> Any:
        if not isinstance(other, (int, float)):
            return NotImplemented
        if operator == "__pow__" and isinstance(other, int) and other > 0:
            self.done["mul"] += other.bit_length() + other.bit_count() - 2  # compiled to squares and products
        else:
            self.done[name] += 1
        return Counted(plain(self, float(other)))

    return operate


def _signing(operator: str) -> Callable[[Counted], Counted]:
    plain = getattr(float, operator)
    return lambda self: Counted(plain(self))


for _name in ("add", "sub", "mul", "truediv", "pow"):
    for _operator in (f"__{_name}__", f"__r{_name}__"):
        setattr(Counted, _operator, _counting("div" if _name == "truediv" else _name, _operator))
for _operator in ("__neg__", "__pos__", "__abs__"):
    setattr(Counted, _operator, _signing(_operator))


def count_operations(function: Callable[..., object], *args: object) -> dict[str, int]:
    """Operations of one call by their names, `add`, `sub`, `mul`, `div`, `sqrt` and other functions of `math`.

    Args:
        function: of Python or compiled by numba; what it calls may be compiled as well.
        args: floats, arrays of floats (left unchanged), tuples of them, and what is not a float as it is.

    What is kept in arrays that the function makes itself is no longer counted: the compiled code to be counted
    works on tuples and on arrays that it is given.
    """
    return count(function, *args)[0]


def count(function: Callable[..., object], *args: object) -> tuple[dict[str, int], dict[str, int]]:
    """Operations as from `count_operations`, and how often each function was called, by their names."""
    Counted.done, Counted.calls = Counter(), Counter()
    _uncompiled(function, {})(*(_counted(arg) for arg in args))
    return dict(Counted.done), dict(Counted.calls)


def flops(counts: dict[str, int]) -> int:
    """How many of them are those that the floating-point units are measured by."""
    return sum(counts.get(name, 0) for name in FLOPS)


def _counted(value: Any) -> Any:
    """The same value of counting numbers."""
    if isinstance(value, (float, np.floating)):
        return Counted(value)
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        found = np.empty(value.shape, dtype=object)
        for at in np.ndindex(value.shape):
            found[at] = Counted(value[at])
        return found
    if isinstance(value, np.ndarray) and value.dtype.names:
        return _Records(value)
    if isinstance(value, tuple):
        parts = [_counted(part) for part in value]
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    return value


class _Records(list[SimpleNamespace]):
    """Records of counting numbers, whose fields are attributes as in compiled code."""

    def __init__(self, array: Any) -> None:
        self.shape = array.shape
        super().__init__(
            SimpleNamespace(**{name: _counted(row[name]) for name in array.dtype.names}) for row in array
        )


def _uncompiled(value: Any, done: dict[Any, Any]) -> Any:
    """A compiled function's Python, with all that it calls uncompiled too and `math` counting; else the value.

    `done` holds those met already, so that functions may call each other.
    """
    if value is math:
        return _MATH
    if isinstance(value, ModuleType):  # its functions are called as module.function
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
        done[python] = _noting(plain)
        for name in code.co_names:
            if name in names:
                names[name] = _uncompiled(names[name], done)
        for cell, old in zip(cells, python.__closure__ or (), strict=True):
            cell.cell_contents = _uncompiled(old.cell_contents, done)
    return done[python]


def _noting(function: Callable[..., Any]) -> Callable[..., Any]:
    def call(*args: object) -> Any:
        Counted.calls[function.__name__] += 1
        return function(*args)

    return call


def _of_math(name: str, *args: float) -> Any:
    Counted.done[name] += 1
    return Counted(getattr(math, name)(*args))


_MATH = SimpleNamespace(**vars(math))
for _name in ("sqrt", "hypot", "sin", "cos", "tan", "atan2", "acos", "asin", "exp", "log"):
    setattr(_MATH, _name, partial(_of_math, _name))
