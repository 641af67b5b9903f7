"""Parses the parameters of a source, `sim:?force_mN=20&seed=1`; an unknown or misspelt parameter is an error."""

import difflib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from urllib.parse import parse_qsl, urlencode

from probedesign.core.errors import InputError


@dataclass(frozen=True)
class SourceParameter:
    """One parameter of a source, in the unit that ends its name.

    Attributes:
        default: default value.
        minimum: minimum value.
        maximum: maximum value.
        integer: whether only integers are allowed.
        words: words that are accepted as values.
    """

    default: float
    minimum: float
    maximum: float
    integer: bool = False
    words: Mapping[str, float] = field(default_factory=dict)


SPEED = SourceParameter(1.0, 1e-3, 1e6, words={"max": math.inf})
"""Playback speed relative to the source's own clock, for all sources without hardware."""
BLOCK_DURATION, MAX_BLOCK_READINGS = 0.002, 64
"""Maximum duration [s] and size of a block of such sources."""


def pop_text_parameter(source: str, query: str, name: str) -> tuple[str, str]:
    """Return the value of a text parameter, empty if absent, and the query without it.

    Args:
        source: name of the source, for messages.
        query: `name=value&name=value`, or empty.
        name: name of the parameter.

    Raises:
        InputError: the parameter is duplicated, or the query is malformed.
    """
    pairs = _pairs(source, query)
    found = [text for given, text in pairs if given == name]
    if len(found) > 1:
        raise InputError(f"{source} {name} is given twice; keep one")
    return "".join(found), urlencode([pair for pair in pairs if pair[0] != name])


def parse_parameters(source: str, query: str, known: Mapping[str, SourceParameter]) -> dict[str, float]:
    """Return the values of a source's parameters.

    Args:
        source: name of the source, for messages.
        query: `name=value&name=value`, or empty.
        known: the parameters.

    Returns:
        A value for every parameter.

    Raises:
        InputError: a parameter is unknown, duplicated, not a number or out of range.
    """
    values: dict[str, float] = {}
    for name, text in _pairs(source, query):
        if name not in known:
            near = difflib.get_close_matches(name, known, 1)
            hint = f"did you mean {near[0]}? " if near else ""
            raise InputError(f"{source} has no parameter {name!r}; {hint}known: {', '.join(known)}")
        if name in values:
            raise InputError(f"{source} {name} is given twice; keep one")
        values[name] = _value(f"{source} {name}", text, known[name])
    return {name: values.get(name, parameter.default) for name, parameter in known.items()}


def _pairs(source: str, query: str) -> list[tuple[str, str]]:
    try:
        return parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
    except ValueError:
        raise InputError(f"{source}?{query}: write parameters as name=value&name=value") from None


def _value(what: str, text: str, parameter: SourceParameter) -> float:
    if text in parameter.words:
        return parameter.words[text]
    kind = "a whole number" if parameter.integer else "a number"
    allowed = " or ".join([f"{kind} in {parameter.minimum:g} ... {parameter.maximum:g}", *parameter.words])
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not parameter.minimum <= value <= parameter.maximum or (parameter.integer and value != int(value)):
        raise InputError(f"{what} = {text!r} must be {allowed}")
    return value
