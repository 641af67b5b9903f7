"""Resins and printers of a file: their numbers in the design, and one line for what is missing or too small."""

from pathlib import Path

import pytest

from probedesign.cli.main import run
from probedesign.design import load_design
from probedesign.design.catalog import PrintLimits
from probedesign.design.io import render_design, write_design
from probedesign.printing.check import check_print
from probedesign.probe import build_probe

EXAMPLES = (Path(__file__).parents[2] / "docs/design-file.md").read_text("utf-8").split("```toml\n")
RESIN, PRINTER = (
    next(text.split("```")[0] for text in EXAMPLES if text.startswith(f"# my-{name}")) for name in ("resin", "printer")
)
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
    assert design.printer.build_volume_mm == (130.0, 80.0, 160.0) and not check_print(design).errors
    write_design(render_design(design), tmp_path / "elsewhere/p.toml")
    assert load_design(tmp_path / "elsewhere/p.toml") == design


@pytest.mark.parametrize(
    ("file", "old", "new", "named"),
    [
        ("resin", "youngs_modulus_mpa = 0.8\n", "", "youngs_modulus_mpa"),
        ("printer", "layer_mm = 0.05", "layer_mm = 0.0", "layer_mm"),
        ("printer", "hole_mm", "hole_m", "hole_mm"),
        ("resin", "density_kg_m3 = 1070.0", "density_kg_m3 = 1.07", "density_kg_m3"),
        ("printer", "[130.0, 80.0, 160.0]", "[130.0, 80.0]", "build_volume_mm"),
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


def test_a_printer_smaller_than_the_part_is_one_finding_and_no_export(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "printer.toml").write_text(PRINTER.replace("160.0", "100.0"), "utf-8")
    errors = [f for f in check_print(load_design(path)).errors if f.part == "probe"]
    assert [f.rule for f in errors] == ["build_volume"] and errors[0].limit == 100.0 and "fits a" in errors[0].remedy
    assert run(["export", str(path), "--out", str(tmp_path / "parts")]) == 2
    error = capsys.readouterr().err.strip()
    assert "'lab-printer' is too small: probe: height" in error and "\n" not in error
    assert not (tmp_path / "parts").exists()


@pytest.mark.parametrize(
    ("key", "rule", "severity"),
    [
        ("wall_mm = 0.5", "wall", "error"),
        ("hole_mm = 0.4", "hole", "error"),
        ("engraving_mm = 0.3", "engraving", "warning"),
        ("soft_feature_mm = 1.2", "smallest_feature", "error"),
        ("layer_mm = 0.05", "layer", "warning"),
    ],
)
def test_the_limits_of_a_printer_file_are_those_of_the_check(
    key: str, rule: str, severity: str, path: Path, tmp_path: Path
) -> None:
    """A limit of five millimetres fails its rule, and one that is left out is that of the design guide."""
    name = key.split(" = ")[0]
    (tmp_path / "printer.toml").write_text(PRINTER.replace(key, f"{name} = 5.0"), "utf-8")
    report = check_print(load_design(path))
    failed = [f for f in report.findings if f.rule == rule and f.severity != "ok"]
    assert severity in {f.severity for f in failed}
    assert rule == "layer" or all("its manual" in f.source for f in failed)
    assert report.layer_mm == (5.0 if rule == "layer" else 0.05)
    (tmp_path / "printer.toml").write_text(PRINTER.replace(key, ""), "utf-8")
    limits = load_design(path).printer.limits
    assert getattr(limits, name) == getattr(PrintLimits(), name) and "leaves out: Formlabs" in limits.source


def test_the_post_processing_is_that_of_the_resin_file(path: Path) -> None:
    steps = check_print(load_design(path)).post_processing
    assert list(steps) == ["wash", "dry", "cure", "supports", "calipers", "ageing", "storage"]
    assert steps["wash"] == "10 min in isopropanol, then 5 min in fresh one" and "180° from the" in steps["supports"]
    assert steps["cure"].startswith("30 min at 60 °C; hang it") and "before calipers" in steps["dry"]
