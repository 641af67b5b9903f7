"""However a design file is written, a change of its keys alters nothing else; text that cannot be kept is refused."""

import tomllib
from copy import deepcopy

from hypothesis import given, reject, settings
from hypothesis import strategies as st

from probedesign.core.errors import InputError
from probedesign.design import parse_design
from probedesign.design.edit import Change, edit_text

DAY = "2026-01-02"
TABLES = {
    "probe": {"length_mm": "100.0", "base_d_mm": "8.0", "tip_d_mm": "2.0"},
    "material": {"resin": '"elastic-50a"', "youngs_modulus_mpa": "2.0e0"},
    "material.provenance": {"youngs_modulus_mpa": '"assumed"'},
    "mount": {"gravity_base_m_s2": "[\n  0.0, # x\n  0.0,\n  9.81,\n]"},
    "tolerances": {"youngs_modulus": "0.03"},
}
CHANGES = [
    Change("probe", "tip_d_mm", "2.5", "measured"),
    Change("probe", "measured", '["tip_d_mm"]'),
    Change("material", "youngs_modulus_mpa", "2.41", "identified"),
    Change("material.provenance", "youngs_modulus_mpa", '"identified"'),
    Change("mount", "gravity_base_m_s2", "[9.81, 0.0, 0.0]"),
    Change("tolerances", "youngs_modulus", "0.02", "identified"),
    Change("tolerances", "diameter_mm", "0.03", "measured"),
    Change("print", "scale_xy", "1.01"),
]
COMMENTS = st.sampled_from(["", " # why", "\t# [probe] = \"x\" # '''", " # µm \N{LINE SEPARATOR}"])
KEYS = st.sampled_from(["{}", '"{}"', "'{}'"])


@st.composite
def design_files(draw):
    """Draw the text of a design file: each table under its head, inline or by dotted keys, in any order."""
    dotted, headed = ["schema = 1", f'name = "x"{draw(COMMENTS)}'], []
    names = ["probe", *draw(st.lists(st.sampled_from(list(TABLES)[1:]), unique=True))]
    for name in draw(st.permutations(names)):
        rows = [(draw(KEYS).format(key), value) for key, value in TABLES[name].items()]
        match draw(st.sampled_from(["head", "inline", "dotted"])):
            case "inline" if not any("\n" in value for _, value in rows):
                dotted.append(f"{name} = {{ {', '.join(f'{k} = {v}' for k, v in rows)} }}{draw(COMMENTS)}")
            case "dotted":
                dotted += [f"{name}.{key} = {value}{draw(COMMENTS)}" for key, value in rows]
            case _:
                indent = draw(st.sampled_from(["", "  "]))
                headed += [f"\n[ {name} ]{draw(COMMENTS)}", "# about it"]
                headed += [f"{indent}{key}{draw(st.sampled_from(['=', ' = ']))}{value}{draw(COMMENTS)}"
                           for key, value in rows]  # fmt: skip
    text = "\n".join(dotted + headed) + draw(st.sampled_from(["", "\n", "\n\n# end\n"]))
    try:
        parse_design(text)
    except InputError:  # such as a table that is written inline and under a head
        reject()
    return text.replace("\n", draw(st.sampled_from(["\n", "\r\n"])))


def plain_lines(text):
    """Return the lines, of one with an inline table what follows it, without the mark of a comment."""
    return [line.rpartition("}")[2].strip().removeprefix("# ").strip() for line in text.split("\n")]


@settings(deadline=None)
@given(design_files(), st.lists(st.sampled_from(CHANGES), min_size=1, unique=True))
def test_a_change_of_keys_keeps_everything_else(text, changes):
    try:
        result = edit_text(text, changes, DAY, "x.toml")
    except InputError as error:
        assert str(error).startswith("x.toml: its layout cannot be kept; set by hand: ") and "\n" not in str(error)
        return
    before = tomllib.loads(text)
    expected = deepcopy(before)
    for change in changes:
        table, former = expected, before
        for name in change.table.split("."):
            table, former = table.setdefault(name, {}), former.get(name, {})
        table[change.key] = tomllib.loads(f"v = {change.text}")["v"]
        if change.key in former:
            assert f"# until {DAY}: {change.key} = {TABLES[change.table][change.key].splitlines()[0]}" in result
    assert tomllib.loads(result) == expected
    lines = iter(plain_lines(result))
    assert all(line in lines for line in plain_lines(text) if not any(change.key in line for change in changes))
    assert result.count("\r\n") == ("\r\n" in text) * result.count("\n")
    assert edit_text(result, changes, DAY, "x.toml") == result
