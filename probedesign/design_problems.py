"""What is wrong with a design file, told in one line: key, value, remedy, line of the file."""

import difflib
import re
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from probedesign.errors import InputError


class Inconsistent(ValueError):
    """A value that is well-formed by itself and wrong beside the others; carries its key."""

    def __init__(self, key: str, text: str) -> None:
        super().__init__(f"{key} {text}" if not text.startswith("unknown") else f"{key}: {text}")
        self.key = key
        self.text = text


def first_problem(error: ValidationError, model: type[BaseModel], text: str) -> str:
    """The first error as ':LINE: KEY ...'; unknown keys first, since they explain missing ones."""
    details = sorted(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    detail = details[0]
    loc = [str(part) for part in detail["loc"] if not str(part).startswith(("function-", "constrained"))]
    cause = detail.get("ctx", {}).get("error")
    if isinstance(cause, Inconsistent):
        dotted = cause.key if "." in cause.key else ".".join([*loc, cause.key])
        message = f"{dotted}: {cause.text}" if cause.text.startswith("unknown") else f"{dotted} {cause.text}"
    elif isinstance(cause, InputError):
        dotted, message = ".".join(loc), str(cause)
    else:
        dotted = ".".join(loc)
        message = _explain(dotted, detail, model)
    line = _line_of(dotted, text)
    more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
    return f"{f':{line}' if line else ''}: {one_line(message)}{more}"


def _explain(key: str, detail: Any, model: type[BaseModel]) -> str:
    """Pydantic's finding in our words: key, value, what is allowed."""
    value, ctx = detail["input"], detail.get("ctx", {})
    shown = _short(value)
    match detail["type"]:
        case "extra_forbidden":
            return f"unknown key '{key}'{_did_you_mean(key, model)}"
        case "missing":
            return f"{key} is missing"
        case "greater_than_equal" | "less_than_equal":
            low, high = _range_of(key, model)
            return f"{key} = {shown} is out of range; allowed is {low} ... {high}"
        case "finite_number":
            return f"{key} = {shown} is not a finite number"
        case "literal_error":
            return f"{key} = {shown} is not one of {ctx.get('expected', '')}"
        case kind:
            wanted = {"float_type": "a number", "int_type": "a whole number", "string_type": "text in quotes",
                      "tuple_type": "a list", "model_type": "a table", "model_attributes_type": "a table"}  # fmt: skip
            return f"{key} = {shown}: expected {wanted.get(kind, detail['msg'].lower())}"


def _short(value: Any) -> str:
    text = f"'{value}'" if isinstance(value, str) else str(value)
    return text if len(text) <= 60 else text[:57] + "..."


def one_line(text: str) -> str:
    return " ".join(text.split())


def _fields(model: type[BaseModel], table: str) -> dict[str, Any]:
    """Fields of a dotted table by the name that stands in the file."""
    inner: Any = model
    for part in filter(None, table.split(".")):
        fields = {f.alias or n: f for n, f in inner.model_fields.items()}
        inner = fields[part].annotation if part in fields else None
        if not _is_table(inner):
            return {}
    return {f.alias or n: f for n, f in inner.model_fields.items()}


def _is_table(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def known_keys(model: type[BaseModel], table: str = "") -> list[str]:
    """Every key that a file checked by `model` may hold, as `table.key`."""
    keys = []
    for name, field in _fields(model, table).items():
        dotted = f"{table}.{name}" if table else name
        keys += [dotted, *(known_keys(model, dotted) if _is_table(field.annotation) else ())]
    return keys


def _did_you_mean(key: str, model: type[BaseModel]) -> str:
    """The nearest key of the same table, or of any."""
    keys = known_keys(model)
    table, _, last = key.rpartition(".")
    siblings = [k for k in keys if k.rpartition(".")[0] == table]
    near = difflib.get_close_matches(key, siblings, 1, 0.5) or difflib.get_close_matches(key, keys, 1, 0.5)
    near = near or [k for k in keys if k.rpartition(".")[2] == last][:1]
    return f"; did you mean '{near[0]}'?" if near else f"; known here: {', '.join(k.rpartition('.')[2] for k in siblings)}"


def _range_of(key: str, model: type[BaseModel]) -> tuple[str, str]:
    """Lowest and highest value of a bounded key, as text."""
    table, _, last = key.rpartition(".")
    field = _fields(model, table).get(last)
    metadata: list[Any] = [] if field is None else list(field.metadata)
    for argument in get_args(field.annotation) if field is not None else ():
        metadata += getattr(argument, "__metadata__", ())
    flat = [m for item in metadata for m in (*getattr(item, "metadata", ()), item)]
    low = next((m.ge for m in flat if hasattr(m, "ge")), None)
    high = next((m.le for m in flat if hasattr(m, "le")), None)
    return ("-inf" if low is None else f"{low:g}", "inf" if high is None else f"{high:g}")


def _line_of(key: str, text: str) -> int | None:
    """Line of a dotted key in a TOML text, or of its table, or None."""
    table, _, last = key.rpartition(".")
    current, table_line = "", None
    for number, line in enumerate(text.splitlines(), 1):
        header = re.match(r"\s*\[\s*([^\[\]]+?)\s*\]", line)
        if header:
            current = header.group(1)
            if current in (table, key):
                table_line = number
        elif current == table and re.match(rf"""\s*["']?{re.escape(last)}["']?\s*=""", line):
            return number
    return table_line
