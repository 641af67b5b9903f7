"""What follows a source's name: `sim:?force_mN=20&seed=1`. Nothing misspelt is passed over."""

import difflib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from urllib.parse import parse_qsl, urlencode

from probedesign.errors import InputError


@dataclass(frozen=True)
class Parameter:
    """One parameter of a source, in the unit that ends its name.

    Attributes:
        default: where it is not said.
        low: least value.
        high: largest value.
        whole: only whole numbers.
        words: words that stand for a value.
    """

    default: float
    low: float
    high: float
    whole: bool = False
    words: Mapping[str, float] = field(default_factory=dict)


SPEED = Parameter(1.0, 1e-3, 1e6, words={"max": math.inf})
"""How many times as fast as the source's own clock; shared by every source that does not run by itself."""
TICK, MOST = 0.002, 64
"""Readings of such sources come in blocks of so long at most, as they are paced [s], and of so many."""


def taken_text(source: str, query: str, name: str) -> tuple[str, str]:
    """The one parameter that is no number, empty where it is not said, and the query without it.

    Args:
        source: its name, for messages.
        query: `name=value&name=value`, or nothing.
        name: of the parameter.

    Raises:
        InputError: it is said twice, or the query is none.
    """
    pairs = _pairs(source, query)
    found = [text for said, text in pairs if said == name]
    if len(found) > 1:
        raise InputError(f"{source} {name} is said twice; keep one")
    return "".join(found), urlencode([pair for pair in pairs if pair[0] != name])


def parse_parameters(source: str, query: str, known: Mapping[str, Parameter]) -> dict[str, float]:
    """Values of a source's parameters.

    Args:
        source: its name, for messages.
        query: `name=value&name=value`, or nothing.
        known: what there is.

    Returns:
        A value for every known parameter.

    Raises:
        InputError: a parameter is unknown, doubled, no number or out of its range.
    """
    values: dict[str, float] = {}
    for name, text in _pairs(source, query):
        if name not in known:
            near = difflib.get_close_matches(name, known, 1)
            hint = f"did you mean {near[0]}? " if near else ""
            raise InputError(f"{source} has no parameter {name!r}; {hint}known: {', '.join(known)}")
        if name in values:
            raise InputError(f"{source} {name} is said twice; keep one")
        values[name] = _value(f"{source} {name}", text, known[name])
    return {name: values.get(name, parameter.default) for name, parameter in known.items()}


def _pairs(source: str, query: str) -> list[tuple[str, str]]:
    try:
        return parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
    except ValueError:
        raise InputError(f"{source}?{query}: write parameters as name=value&name=value") from None


def _value(what: str, text: str, parameter: Parameter) -> float:
    if text in parameter.words:
        return parameter.words[text]
    kind = "a whole number" if parameter.whole else "a number"
    allowed = " or ".join([f"{kind} in {parameter.low:g} ... {parameter.high:g}", *parameter.words])
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not parameter.low <= value <= parameter.high or (parameter.whole and value != int(value)):
        raise InputError(f"{what} = {text!r} must be {allowed}")
    return value
