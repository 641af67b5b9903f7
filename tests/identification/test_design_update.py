"""A design file keeps its comments and layout; replaced values stay as comments."""

from pathlib import Path

import pytest

from probedesign.core.errors import InputError
from probedesign.design import load_design, parse_design
from probedesign.design.edit import Change, edit_text
from probedesign.identification.design_update import check_overwritable, write_changes
from tests.identification.conftest import LARGE

DAY = "2026-01-02"
SMALL = 'schema = 1\nname = "x"\n[probe]\nlength_mm = 100.0\nbase_d_mm = 8.0\ntip_d_mm = 2.0\n'


def test_old_value_and_its_comment_stay_above_the_new() -> None:
    text = LARGE.read_text()
    change = Change("material", "youngs_modulus_mpa", "2.41", "identified")
    lines = edit_text(text, [change], DAY, "large.toml").splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("youngs_modulus_mpa = 2.41 "))
    before = next(line for line in text.splitlines() if line.startswith("youngs_modulus_mpa"))
    assert lines[at].endswith("# identified")
    assert lines[at - 1] == f"# until {DAY}: {before}"
    assert [line for line in lines if line not in (lines[at], lines[at - 1])] == [
        line for line in text.splitlines() if line != before
    ]


def test_tables_that_are_missing_are_added() -> None:
    changes = [
        Change("material", "youngs_modulus_mpa", "2.41"),
        Change("material.provenance", "youngs_modulus_mpa", '"identified"'),
        Change("tolerances", "youngs_modulus", "0.004"),
        Change("tolerances", "shear_modulus", "0.03"),
    ]
    design = parse_design(edit_text(SMALL, changes, DAY, "x.toml"))
    assert design.youngs_modulus.value == pytest.approx(2.41e6)
    assert design.material.provenance.youngs_modulus_mpa == "identified"
    assert (design.tolerances.youngs_modulus, design.tolerances.shear_modulus) == (0.004, 0.03)


def test_an_unchanged_value_is_left_alone() -> None:
    text = LARGE.read_text()
    change = Change("material.provenance", "youngs_modulus_mpa", '"identified"')
    assert edit_text(text, [change], DAY, "large.toml") == text
    once = edit_text(text, [Change("material", "youngs_modulus_mpa", "2.41", "identified")], DAY, "large.toml")
    again = edit_text(once, [Change("material", "youngs_modulus_mpa", "2.41", "identified")], DAY, "large.toml")
    assert again == once  # the same line is no old one


def test_a_layout_that_cannot_be_kept_is_refused() -> None:
    text = SMALL.replace("[probe]", 'material = { resin = "elastic-50a" }\n[probe]')
    with pytest.raises(InputError, match=r"layout cannot be kept; set by hand: material.provenance.youngs_modulus_mpa"):
        edit_text(text, [Change("material.provenance", "youngs_modulus_mpa", '"assumed"')], DAY, "x.toml")


def test_a_value_of_several_lines_stays_as_a_comment() -> None:
    profile = "profile_mm = [ # drawn\n  [0.0, 8.0],\n  [100.0, 2.0],\n]"
    text = SMALL.replace("tip_d_mm = 2.0", f'shape = "profile"\n{profile}')
    change = Change("probe", "profile_mm", "[[0.0, 8.0], [50.0, 4.0], [100.0, 2.0]]")
    former = profile.replace("\n", "\n# ")
    assert f"# until {DAY}: {former}\nprofile_mm = {change.text}\n" in edit_text(text, [change], DAY, "x.toml")


def test_a_value_that_no_design_may_have_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="out of range"):
        edit_text(SMALL, [Change("tolerances", "youngs_modulus", "0.7")], DAY, "x.toml")


@pytest.mark.parametrize(
    ("present", "change"),
    [
        ("[mount]\nroot_rigid_radii = 0.05\n", Change("mount", "root_rigid_radii", "0.2")),
        ('[tolerances]\nyoungs_modulus = 0.1\n[material]\nyoungs_modulus_mpa = 2.0\n'
         'provenance.youngs_modulus_mpa = "identified"\n', Change("tolerances", "youngs_modulus", "0.02")),
        ('[material]\nstiffness_spread = 0.1\nyoungs_modulus_mpa = 2.0\nprovenance.youngs_modulus_mpa = "identified"\n',
         Change("material", "stiffness_spread", "0.02")),
        ('[material]\nyoungs_modulus_mpa = 2.0\nprovenance.youngs_modulus_mpa = "identified"\n',
         Change("material", "youngs_modulus_mpa", "2.4")),
    ],
)  # fmt: skip
def test_present_values_are_replaced_only_by_force(present: str, change: Change) -> None:
    text = SMALL + present
    design = parse_design(text)
    with pytest.raises(InputError, match=f"already: {change.table}.{change.key}; --force replaces"):
        check_overwritable(design, text, (change,), "x.toml", False)
    check_overwritable(design, text, (change,), "x.toml", True)
    check_overwritable(parse_design(SMALL), SMALL, (change,), "x.toml", False)  # nothing is there


def test_assumed_values_are_replaced_without_force() -> None:
    """Their uncertainties are replaced with them."""
    text = SMALL + "[material]\nyoungs_modulus_mpa = 2.0\nstiffness_spread = 0.1\n[tolerances]\nyoungs_modulus = 0.1\n"
    changes = (
        Change("material", "youngs_modulus_mpa", "2.4"),
        Change("material", "stiffness_spread", "0.02"),
        Change("tolerances", "youngs_modulus", "0.02"),
    )
    check_overwritable(parse_design(text), text, changes, "x.toml", False)
    assert "# until 2026-01-02: stiffness_spread = 0.1" in edit_text(text, changes, DAY, "x.toml")


def test_a_probe_of_the_paper_loads_by_its_name_and_has_no_file_to_change(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # a folder without designs
    changes = (Change("material", "youngs_modulus_mpa", "2.41", "identified"),)
    with pytest.raises(InputError, match="without a file to change; give --out FILE"):
        write_changes(Path("small"), changes, DAY, None, False)
    assert list(tmp_path.iterdir()) == []
    path, _ = write_changes(Path("small"), changes, DAY, Path("mine.toml"), False)
    before, after = load_design("small"), load_design(path)
    assert after.material.youngs_modulus_mpa == 2.41 and after.probe == before.probe
