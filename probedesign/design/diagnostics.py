"""Checks of TOML files against a pydantic model, with errors of one line: key, value, remedy, line of the file."""

import difflib
import re
from collections.abc import Iterator
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError

from probedesign.core.errors import InputError, one_line, quoted
from probedesign.core.files import parse_bounded_toml

Model = TypeVar("Model", bound=BaseModel)


class Table(BaseModel):
    """Base of all tables: no unknown keys, no type conversion, no NaN."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


def as_tuple(value: Any) -> Any:
    """Convert a TOML array and the arrays in it to tuples; return anything else unchanged, for pydantic to refuse."""
    if not isinstance(value, list):
        return value
    return tuple(tuple(v) if isinstance(v, list) else v for v in value)


FromArray = BeforeValidator(as_tuple)


def parse_toml(text: str, model: type[Model], where: str) -> Model:
    """Parse the text of a TOML file and check it; `where` names it in errors.

    Raises:
        InputError: one line naming the key, the value, the remedy and the line.
    """
    return check_toml(read_toml(text, model, where), model, text, where)


def read_toml(text: str, model: type[BaseModel], where: str) -> dict[str, Any]:
    """Return the tables of the text of a TOML file, unchecked; `where` names it in errors.

    Raises:
        InputError: the text is not TOML, or empty; the message lists the keys that the model needs.
    """
    try:
        data = parse_bounded_toml(text)
    except ValueError as error:  # also an integer of thousands of digits
        raise InputError(f"{where}: not valid TOML: {one_line(str(error))}") from None
    if not data:
        needed = [f.alias or name for name, f in model.model_fields.items() if f.is_required()]
        raise InputError(f"{where}: is empty; it needs {', '.join(needed)}")
    return data


def check_toml(data: dict[str, Any], model: type[Model], text: str = "", where: str = "") -> Model:
    """Check the tables of a TOML file.

    Args:
        data: its tables, with the keys and units of the file.
        model: the schema.
        text: the file's text, to name the line of a wrong value; empty if there is no file.
        where: names the file in errors; empty if there is none.

    Raises:
        InputError: one line naming the key, the value and the remedy.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        line, problem = first_problem(error, model, text)
    at_line = f"{where}:{line}: " if line else f"{where}: "
    raise InputError(f"{at_line if where else ''}{problem}")


class Inconsistent(ValueError):
    """A value that contradicts another one; has the key of the value."""

    def __init__(self, key: str, text: str) -> None:
        super().__init__(f"{key} {text}" if not text.startswith("unknown") else f"{key}: {text}")
        self.key = key
        self.text = text


def first_problem(error: ValidationError, model: type[BaseModel], text: str) -> tuple[int | None, str]:
    """Return the line and the message of the first error; unknown keys first, since they explain missing ones."""
    details = sorted(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    detail = details[0]
    key, table, item = _place_of(detail["loc"])
    cause = detail.get("ctx", {}).get("error")
    if isinstance(cause, Inconsistent):
        if "." in cause.key:
            key = cause.key
        elif key.rpartition(".")[2] != cause.key:  # else raised by the check of that key alone
            key = f"{key}.{cause.key}".lstrip(".")
        message = f"{key}{_of(table)}{':' if cause.text.startswith('unknown') else ''} {cause.text}"
    elif isinstance(cause, InputError):
        message = str(cause)
    else:
        message = _explain(key, f"{_of(table)}{item}", detail, model)
    others = one_line(", ".join(dict.fromkeys(".".join(map(str, detail["loc"])) for detail in details[1:])))
    return _line_of(key, text, table), one_line(message) + (f" (also wrong: {others})" if others else "")


def _place_of(loc: tuple[int | str, ...]) -> tuple[str, int | None, str]:
    last = max((i for i, part in enumerate(loc) if isinstance(part, str)), default=-1)
    table = next((part for part in loc[:last] if isinstance(part, int)), None)
    item = "".join(f", item {int(part) + 1}" for part in loc[last + 1 :])
    return ".".join(part for part in loc if isinstance(part, str)), table, item


def _of(table: int | None) -> str:
    return "" if table is None else f" of table {table + 1}"


def _explain(key: str, item: str, detail: Any, model: type[BaseModel]) -> str:
    ctx, wrong = detail.get("ctx", {}), f"{key}{item} = {quoted(detail['input'])}"
    match detail["type"]:
        case "extra_forbidden":
            return f"unknown key {quoted(key)}{_did_you_mean(key, model)}"
        case "missing":
            return f"{key}{item} is missing"
        case "greater_than_equal" | "less_than_equal" | "greater_than" | "less_than":
            return f"{wrong} is out of range; allowed is {_range_of(key, model)}"
        case "finite_number":
            return f"{wrong} is not a finite number"
        case "literal_error":
            return f"{wrong} is not one of {ctx.get('expected', '')}"
        case "too_long":
            return f"{wrong} has too many items; allowed are {ctx.get('max_length')}"
        case kind:
            return f"{wrong}: expected {_WANTED.get(kind, detail['msg'].lower())}"


_WANTED = {
    "float_type": "a number",
    "int_type": "a whole number",
    "string_type": "text in quotes",
    "tuple_type": "a list",
    "model_type": "a table",
    "model_attributes_type": "a table",
}


def _fields(model: type[BaseModel], table: str) -> dict[str, Any]:
    inner: Any = model
    for part in filter(None, table.split(".")):
        fields = {f.alias or n: f for n, f in inner.model_fields.items()}
        inner = _table_of(fields[part].annotation) if part in fields else None
        if not _is_table(inner):
            return {}
    return {f.alias or n: f for n, f in inner.model_fields.items()}


def _table_of(annotation: Any) -> Any:
    """Return the table in `Table | None`; anything else unchanged."""
    return next((a for a in get_args(annotation) if _is_table(a)), annotation)


def _is_table(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def known_keys(model: type[BaseModel], table: str = "") -> list[str]:
    """Return every key that a file of that model may have, as `table.key`."""
    keys = []
    for name, field in _fields(model, table).items():
        dotted = f"{table}.{name}" if table else name
        keys += [dotted, *(known_keys(model, dotted) if _is_table(_table_of(field.annotation)) else ())]
    return keys


def _did_you_mean(key: str, model: type[BaseModel]) -> str:
    keys = known_keys(model)
    table, _, last = key.rpartition(".")
    siblings = [k for k in keys if k.rpartition(".")[0] == table]
    near = difflib.get_close_matches(key, siblings, 1, 0.5) or difflib.get_close_matches(key, keys, 1, 0.5)
    near = near or [k for k in keys if k.rpartition(".")[2] == last][:1]
    if near:
        return f"; did you mean '{near[0]}'?"
    return f"; known here: {', '.join(k.rpartition('.')[2] for k in siblings)}"


def _range_of(key: str, model: type[BaseModel]) -> str:
    table, _, last = key.rpartition(".")
    field = _fields(model, table).get(last)
    metadata: list[Any] = [] if field is None else [*field.metadata, *_metadata(field.annotation)]
    flat = [m for item in metadata for m in (*getattr(item, "metadata", ()), item)]
    low = next((m.ge for m in flat if hasattr(m, "ge")), None)
    above = next((m.gt for m in flat if hasattr(m, "gt")), None)
    high = next((m.le for m in flat if hasattr(m, "le")), None)
    upper = "inf" if high is None else f"{high:g}"
    if above is not None:
        return f"above {above:g}, up to {upper}"
    return f"{'-inf' if low is None else f'{low:g}'} ... {upper}"


def _metadata(annotation: Any) -> Iterator[Any]:
    yield from getattr(annotation, "__metadata__", ())
    for argument in get_args(annotation):
        yield from _metadata(argument)


def _line_of(key: str, text: str, number: int | None = None) -> int | None:
    """Return the line of a dotted key in a TOML text, or of its table; None if there is neither.

    Args:
        key: dotted.
        text: of the file.
        number: of the table from 0 where the key is in a list of tables, [[...]].
    """
    table, _, last = key.rpartition(".")
    assignment = re.compile(rf"""\s*["']?{re.escape(last)}["']?\s*=""")
    current, table_line, seen = "", None, -1
    for count, line in enumerate(text.splitlines(), 1):
        header = re.match(r"\s*\[{1,2}\s*([^\[\]]+?)\s*\]", line)
        if header:
            current = header.group(1)
            seen += current == table
            if current in (table, key) and number in (None, seen):
                table_line = count
        elif current == table and number in (None, seen) and assignment.match(line):
            return count
    return table_line
