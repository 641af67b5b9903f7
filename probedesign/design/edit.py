"""Change keys of a design, in its tables as plain data or in the text of its file, which keeps comments and order."""

import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import InlineTable

from probedesign.core.errors import InputError
from probedesign.design.catalog import RESINS, find
from probedesign.design.io import COMMENT_COLUMN, check_design, material_keys, parse_design
from probedesign.design.schema import Design

#: Keys of `[tolerances]` that `measured` writes for one print.
_OF_A_PRINT = ("diameter_mm", "diameter_share", "diameter_scatter_mm", "bow_mm")
#: Keys that state what was measured of one resin and how well it is known, by table.
_OF_A_RESIN = {
    "material": ("own", "identified_tests", "stiffness_spread", "creep_spread"),
    "print": ("scale_xy", "scale_z", "offset_xy_mm"),
    "tolerances": ("youngs_modulus", "shear_modulus", "youngs_modulus_by_diameter", "density", "creep",
                   "stiffness_scatter"),
}  # fmt: skip


def tables_of(design: Design) -> dict[str, Any]:
    """Return the tables of a design's file as plain data."""
    return design.model_dump(by_alias=True, exclude_none=True, mode="json")


def with_values(tables: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return tables with the values of some keys, `table.key`, changed, and with what follows from them.

    Another resin brings its moduli, density and friction, which `values` can replace; what was measured of the former
    resin and on its print goes. A changed shape is a new print, see `as_new_print`; another hold has no stated root.

    Raises:
        InputError: a key lies in something that is not a table, or the resin is not known.
    """
    changed: dict[str, Any] = json.loads(json.dumps(tables))
    resin_key, name = "material.resin", values.get("material.resin")
    if isinstance(name, str) and name != _table(changed, ["material"], resin_key).get("resin"):
        resin = find(RESINS, name, resin_key)
        changed = as_new_print(changed)
        for table, keys in _OF_A_RESIN.items():
            changed[table] = {k: v for k, v in changed.get(table, {}).items() if k not in keys}
        changed["material"] |= material_keys(resin)
        changed["contact"] = {"friction": resin.friction.value}
    if "mount.hold" in values:  # the root is computed for it
        _table(changed, ["mount"], "mount.hold").pop("root_rigid_radii", None)
    for key, value in values.items():
        *parents, last = key.split(".")
        _table(changed, parents, key)[last] = value
    return as_new_print(changed, tables)


def _table(tables: Any, parents: Sequence[str], key: str) -> Any:
    for name in parents:
        tables = tables.setdefault(name, {})
        if not isinstance(tables, dict):
            raise InputError(f"{key}: {name} is a value, not a table; name a key such as probe.tip_d_mm")
    return tables


def as_new_print(tables: dict[str, Any], before: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return the tables of a changed design without what is known of the print of the former one alone.

    What was measured on that print goes. E and G that were identified on it keep their values and are assumed; the
    tests that served, and what they left unknown, go.

    Args:
        tables: of the changed design.
        before: of the former one. Tables with its `[probe]` are returned unchanged, and tolerances that differ from its
            own are kept. None: both are one design of which a new print is made.
    """
    probe, material, tolerances = tables["probe"], tables["material"], tables.get("tolerances", {})
    if not (isinstance(probe, dict) and isinstance(material, dict) and isinstance(tolerances, dict)):
        return tables  # the check of the design refuses it
    if before is not None and probe == before["probe"]:
        return tables
    former, gone = tolerances if before is None else before.get("tolerances", {}), tuple[str, ...]()
    if probe.get("measured"):
        gone = _OF_A_PRINT
        probe = {k: v for k, v in probe.items() if k not in ("measured", "bow_mm")}
    given = material.get("provenance")
    known = given if isinstance(given, dict) else {}
    assumed = {k: "assumed" for k in ("youngs_modulus_mpa", "shear_modulus_mpa") if known.get(k) == "identified"}
    if assumed:
        gone += ("youngs_modulus", "shear_modulus", "youngs_modulus_by_diameter")
        material = {k: v for k, v in material.items() if k != "identified_tests"} | {"provenance": known | assumed}
    if not gone:
        return tables
    kept = {k: v for k, v in tolerances.items() if k not in gone or v != former.get(k)}
    return {**tables, "probe": probe, "material": material, "tolerances": kept}


@dataclass(frozen=True)
class Change:
    """A new value of one key of a design file."""

    table: str  #: such as `material`.
    key: str  #: in the table.
    text: str  #: the value as TOML.
    note: str = ""  #: comment beside the value.


def edit_text(text: str, changes: Sequence[Change], when: str, where: str) -> str:
    """Return the text of a design file with some values changed, its comments and order kept.

    A replaced value remains above the new one, or above its inline table, as a comment with the day; a missing table is
    added to its parent, or at the end.

    Args:
        text: of the file.
        changes: at most one for each key.
        when: the day, for the comment.
        where: names the file in errors.

    Raises:
        InputError: a new value is not valid, or the file is written in a way that cannot be changed.
    """
    data = tomllib.loads(text)
    for change in changes:
        key = f"{change.table}.{change.key}"
        _table(data, change.table.split("."), key)[change.key] = tomllib.loads(f"v = {change.text}")["v"]
    expected = check_design(data, text, where)
    try:
        document = tomlkit.parse(text.replace("\r\n", "\n"))
        for change in changes:
            _edit(document, change, when)
        result = document.as_string()
        if parse_design(result, where) == expected:
            return result.replace("\n", "\r\n") if "\r\n" in text else result
    except (ValueError, TOMLKitError):
        pass
    keys = ", ".join(f"{change.table}.{change.key} = {change.text}" for change in changes)
    raise InputError(f"{where}: its layout cannot be kept; set by hand: {keys}")


def _edit(table: Any, change: Change, when: str) -> None:
    """Set the value of a key in a document, in a new table if necessary."""
    for name in change.table.split("."):
        if name not in table:
            table[name] = tomlkit.table()
        table = table[name]
    value, old = tomlkit.value(change.text), table.get(change.key)
    inline = isinstance(table, InlineTable)  # one line, without room for comments
    note = "" if inline else change.note
    same = old is not None and old.as_string() == change.text
    if same and (not note or old.trivia.comment == f"# {note}"):
        return
    former = "" if old is None else f"{change.key} = {old.as_string()}{old.trivia.comment_ws}{old.trivia.comment}"
    table[change.key] = value
    if note:
        value.comment(note)
        value.trivia.comment_ws = " " * max(COMMENT_COLUMN - len(f"{change.key} = {change.text}"), 1)
    elif old is not None and not inline:
        value.trivia.comment_ws = value.trivia.comment = ""
    if former:  # what stands before a key is its indent, the only place for lines above it
        trivia = table.trivia if inline else value.trivia
        trivia.indent += f"# until {when}: " + former.rstrip().replace("\n", "\n# ") + "\n" + trivia.indent
