"""Values that a design may not have, or that someone set, are refused; what is kept is in tests/design/test_edit.py."""

from pathlib import Path

import pytest

from probedesign.core.errors import InputError
from probedesign.design import load_design, parse_design
from probedesign.design.edit import Change, edit_text
from probedesign.identification.design_update import check_overwritable, write_changes

DAY = "2026-01-02"
SMALL = 'schema = 1\nname = "x"\n[probe]\nlength_mm = 100.0\nbase_d_mm = 8.0\ntip_d_mm = 2.0\n'


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
