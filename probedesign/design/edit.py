"""Changes of values in a design file that keep its comments and layout, and the former values as comments."""

import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass

from probedesign.core.errors import InputError
from probedesign.design import Design, check_design, parse_design
from probedesign.design.io import COMMENT_COLUMN

_HEADER = re.compile(r"\s*\[\s*([^\[\]]+?)\s*\]\s*(#.*)?$")


@dataclass(frozen=True)
class Change:
    """A new value of one key.

    Attributes:
        table: such as `material`.
        key: in the table.
        text: the value as TOML.
        note: comment beside the value.
    """

    table: str
    key: str
    text: str
    note: str = ""

    @property
    def line(self) -> str:
        """Return the line of the file."""
        line = f"{self.key} = {self.text}"
        return f"{line:<{COMMENT_COLUMN - 1}} # {self.note}" if self.note else line


def edit_text(text: str, changes: Sequence[Change], when: str, where: str) -> str:
    """Return the text of a design file with some values changed.

    A replaced value remains above the new one as a comment with the day; a missing table is added after its parent, or
    at the end.

    Args:
        text: of the file.
        changes: at most one for each key.
        when: the day, for the comment.
        where: names the file in errors.

    Raises:
        InputError: the file has inline tables or the like, which cannot be changed line by line.
    """
    ending = "\r\n" if "\r\n" in text else "\n"
    lines = text.splitlines()
    for change in changes:
        lines = _changed(lines, change, when)
    result = ending.join(lines) + ending
    if _parsed(result, where) != _expected(text, changes, where):
        keys = ", ".join(f"{one.table}.{one.key} = {one.text}" for one in changes)
        raise InputError(f"{where}: its tables are not written line by line; set by hand: {keys}")
    return result


def _changed(lines: list[str], change: Change, when: str) -> list[str]:
    start = next((i for i, line in enumerate(lines) if _table_of(line) == change.table), None)
    if start is None:
        return _with_table(lines, change)
    end = next((i for i in range(start + 1, len(lines)) if _table_of(lines[i])), len(lines))
    assignment = re.compile(rf"""\s*["']?{re.escape(change.key)}["']?\s*=""")
    for i in range(start + 1, end):
        if assignment.match(lines[i]):
            same = lines[i].split("#")[0].split() == change.line.split("#")[0].split()
            if lines[i] == change.line or (same and not change.note):
                return lines
            return [*lines[:i], f"# until {when}: {lines[i].strip()}", change.line, *lines[i + 1 :]]
    while end > start + 1 and not lines[end - 1].strip():
        end -= 1
    return [*lines[:end], change.line, *lines[end:]]


def _with_table(lines: list[str], change: Change) -> list[str]:
    """Return the lines with a new table, after its parent or at the end."""
    parent = change.table.rpartition(".")[0]
    at = next((i for i, line in enumerate(lines) if parent and _table_of(line) == parent), None)
    if at is None:
        end = len(lines)
    else:
        end = next((i for i in range(at + 1, len(lines)) if _table_of(lines[i])), len(lines))
    while end and not lines[end - 1].strip():
        end -= 1
    return [*lines[:end], "", f"[{change.table}]", change.line, *lines[end:]]


def _table_of(line: str) -> str:
    """Return the table whose header a line is; empty if it is none."""
    found = _HEADER.match(line)
    return "" if found is None else ".".join(part.strip().strip("\"'") for part in found.group(1).split("."))


def _parsed(text: str, where: str) -> Design | None:
    try:
        return parse_design(text, where)
    except InputError:
        return None


def _expected(text: str, changes: Sequence[Change], where: str) -> Design:
    """Return the design that the changed text must give."""
    data = tomllib.loads(text)
    for change in changes:
        table: dict[str, object] = data
        for part in change.table.split("."):
            inner = table.setdefault(part, {})
            assert isinstance(inner, dict)
            table = inner
        table[change.key] = tomllib.loads(f"v = {change.text}")["v"]
    return check_design(data, text, where)
