"""Grid of designs: keys of the design file, each over a range or a list, in every combination."""

import itertools
import json
import math
from dataclasses import dataclass
from typing import Any

from probedesign.core.errors import InputError, unknown_name
from probedesign.design import Design
from probedesign.design.diagnostics import known_keys

MAX_POINTS = 1_000_000
_HOW = "write KEY=START:STOP:STEP or KEY=A,B,C"


@dataclass(frozen=True)
class GridAxis:
    """One key that varies.

    Attributes:
        key: of the design file, `table.key`.
        values: that it takes.
    """

    key: str
    values: tuple[Any, ...]


def parse_axis(text: str) -> GridAxis:
    """Parse `probe.tip_d_mm=1.5:4:0.25` or `sensor.calibration=si-12-0.12,si-25-0.25`; the end of a range is included.

    Raises:
        InputError: the key is unknown, or the range is invalid.
    """
    key, equals, values = (part.strip() for part in text.partition("="))
    if not equals or not values:
        raise InputError(f"--vary {text!r}: {_HOW}")
    keys = known_keys(Design)
    known = [name for name in keys if "." in name and not any(k.startswith(f"{name}.") for k in keys)]
    if key not in known:
        table = [name for name in known if name.partition(".")[0] == key.partition(".")[0]]
        raise unknown_name("--vary", key, table or known)
    if ":" in values:
        return GridAxis(key, numbers_of(f"--vary {key}", values))
    found = tuple(_value(part.strip()) for part in values.split(","))
    if any(value == "" for value in found):
        raise InputError(f"--vary {text!r}: an empty value; {_HOW}")
    return GridAxis(key, found)


def grid_points(axes: list[GridAxis]) -> list[dict[str, Any]]:
    """Return every combination of the axes' values, the last axis fastest.

    Raises:
        InputError: there is no axis, a key is given twice, or there are too many points.
    """
    keys = [axis.key for axis in axes]
    twice = next((key for key in keys if keys.count(key) > 1), None)
    if not axes:
        raise InputError(f"nothing to vary; {_HOW}: --vary probe.tip_d_mm=1.5:4:0.25")
    if twice:
        raise InputError(f"--vary {twice}: given twice; put all its values into one")
    size = math.prod(len(axis.values) for axis in axes)
    if size > MAX_POINTS:
        raise InputError(f"{size} designs are too many; the maximum is {MAX_POINTS}: use coarser steps")
    return [dict(zip(keys, values, strict=True)) for values in itertools.product(*(a.values for a in axes))]


def with_values(base: dict[str, Any], point: dict[str, Any]) -> dict[str, Any]:
    """Return the tables of a design file with some keys changed."""
    data: dict[str, Any] = json.loads(json.dumps(base))
    for key, value in point.items():
        *tables, last = key.split(".")
        inner = data
        for table in tables:
            inner = inner.setdefault(table, {})
        inner[last] = value
    return data


def design_dict(design: Design) -> dict[str, Any]:
    """Return the tables of a design's file as plain data."""
    tables: dict[str, Any] = design.model_dump(by_alias=True, exclude_none=True, mode="json")
    return tables


def numbers_of(what: str, text: str) -> tuple[float | int, ...]:
    """Return the numbers of START:STOP:STEP, the end included; integers stay integers.

    Raises:
        InputError: the text is not a range; `what` names the option.
    """
    parts = [_value(part.strip()) for part in text.split(":")]
    if len(parts) != 3 or not all(isinstance(part, int | float) for part in parts):
        raise InputError(f"{what}: {text!r} is not START:STOP:STEP in numbers")
    start, stop, step = parts
    if step == 0 or (stop - start) * step < 0:
        raise InputError(f"{what}: the step of {text!r} has the wrong sign, or is zero")
    steps = (stop - start) / step
    if steps > MAX_POINTS:
        raise InputError(f"{what}: {text!r} has more than {MAX_POINTS} values; use a coarser step")
    whole = all(isinstance(part, int) for part in parts)
    return tuple(start + i * step if whole else float(f"{start + i * step:.12g}")
                 for i in range(math.floor(steps + 1e-9) + 1))  # fmt: skip


def _value(text: str) -> Any:
    """Return the text as TOML would read it: a number, a boolean or a name."""
    for kind in (int, float):
        try:
            number = kind(text)
        except ValueError:
            continue
        return number if math.isfinite(number) else text
    return {"true": True, "false": False}.get(text, text)
