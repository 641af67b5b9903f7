"""Resins and printers of a file: their numbers in the design, and one line for what is missing or too small."""

from pathlib import Path

import pytest

from probedesign.cli.main import run
from probedesign.design import load_design
from probedesign.design.io import render_design, write_design
from probedesign.printing.check import check_print
from probedesign.probe import build_probe

RESIN = """name = "lab-silicone"
product = "Silicone of our laboratory"
source = "tensile test of 12 July"
youngs_modulus_mpa = 0.8
density_kg_m3 = 1070.0
stiffness_spread = 0.07
provenance = "datasheet"
"""
PRINTER = 'name = "lab-printer"\nproduct = "A printer"\nsource = "its manual"\nbuild_volume_mm = [120.0, 68.0, 155.0]\n'
DESIGN = """schema = 1
name = "p"
[probe]
length_mm = 100.0
base_d_mm = 10.0
tip_d_mm = 2.0
[material]
file = "resin.toml"
[print]
file = "printer.toml"
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    for name, text in (("resin", RESIN), ("printer", PRINTER), ("p", DESIGN)):
        (tmp_path / f"{name}.toml").write_text(text, "utf-8")
    return tmp_path / "p.toml"


def test_a_design_has_the_numbers_of_the_files_and_is_complete_by_itself(path: Path, tmp_path: Path) -> None:
    design = load_design(path)
    assert design.youngs_modulus.value == 0.8e6 and design.youngs_modulus.provenance == "datasheet"
    assert design.shear_modulus.value == pytest.approx(0.8e6 / 3.0) and design.shear_modulus.provenance == "assumed"
    assert (design.density.value, design.resin.name) == (1070.0, "lab-silicone")
    assert build_probe(design).tolerances.youngs_modulus == 0.07
    assert design.printer.build_volume_mm == (120.0, 68.0, 155.0) and check_print(design).fits
    write_design(render_design(design), tmp_path / "elsewhere/p.toml")
    assert load_design(tmp_path / "elsewhere/p.toml") == design


@pytest.mark.parametrize(
    ("file", "old", "new", "named"),
    [
        ("resin", "youngs_modulus_mpa = 0.8\n", "", "youngs_modulus_mpa"),
        ("resin", "density_kg_m3 = 1070.0", "density_kg_m3 = 1.07", "density_kg_m3"),
        ("printer", "[120.0, 68.0, 155.0]", "[120.0, 68.0]", "build_volume_mm"),
        ("p", 'file = "resin.toml"', 'file = "resin.toml"\nresin = "elastic-50a"', "material.resin"),
        ("p", 'file = "printer.toml"', 'printer = "own"', "print.own"),
        ("p", 'file = "resin.toml"', "file = 3", "material.file"),
        ("p", "resin.toml", "missing.toml", "missing.toml"),
    ],
)
def test_a_wrong_file_is_refused_in_one_line(
    file: str, old: str, new: str, named: str, path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    changed = tmp_path / f"{file}.toml"
    assert old in changed.read_text("utf-8")
    changed.write_text(changed.read_text("utf-8").replace(old, new), "utf-8")
    assert run(["check", str(path)]) == 2
    error = capsys.readouterr().err.strip()
    assert named in error and "\n" not in error


def test_a_printer_smaller_than_the_part_is_one_finding(path: Path, tmp_path: Path) -> None:
    (tmp_path / "printer.toml").write_text(PRINTER.replace("155.0", "100.0"), "utf-8")
    errors = [f for f in check_print(load_design(path)).errors if f.part == "probe"]
    assert [f.rule for f in errors] == ["build_volume"] and errors[0].limit == 100.0 and "fits a" in errors[0].remedy
