"""`probedesign identify` as a user runs it, up to the frozen probe that carries its numbers."""

import json
import shutil
from pathlib import Path

import pytest

from probedesign import load_design, load_estimator
from probedesign.cli.main import run
from probedesign.identification import identify as module
from probedesign.identification.result import UNITS
from tests.identification.conftest import LARGE, TRUE_E
from tests.reports.test_pages import assert_whole


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a copy of the large probe's design."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(LARGE, tmp_path / "large.toml")
    return tmp_path


def test_a_dry_run_changes_nothing_and_prints_the_changes(here: Path, stage_folder: Path, capsys) -> None:
    before = (here / "large.toml").read_bytes()
    assert run(["identify", "large.toml", str(stage_folder), "--for", "E"]) == 0
    output = capsys.readouterr().out
    assert "--write would change large.toml" in output and "[material] youngs_modulus_mpa = 2." in output
    assert "large.toml was not changed" in output
    assert (here / "large.toml").read_bytes() == before
    assert run(["deploy", "large.toml"]) == 0  # with the old E, and not without a word
    assert ", where the design has 2.32. To write" in capsys.readouterr().out
    folder = here / "exports/large/identification"
    page = (folder / "identification.html").read_text()
    assert_whole(page)
    assert "Error budget" in page
    rows = (folder / "residuals.csv").read_text().splitlines()
    document = json.loads((folder / "identification.json").read_text())
    assert len(rows) == 1 + len(document["residuals"])
    assert document["found"][0]["result"] == "identified"
    assert {row["unit"] for row in document["residuals"]} <= set(UNITS.values())


def test_written_numbers_reach_the_frozen_probe(here: Path, stage_folder: Path, capsys) -> None:
    """The design's E was identified before, so it takes --force; its old value stays."""
    command = ["identify", "large.toml", str(stage_folder), "--for", "E", "--write", "--no-page", "--json"]
    before = (here / "large.toml").read_bytes()
    assert run(command) == 2
    error = capsys.readouterr().err
    assert (
        "identified already: material.youngs_modulus_mpa" in error
        and "--force replaces" in error
        and error.count("\n") == 1
    )
    assert (here / "large.toml").read_bytes() == before

    assert run([*command, "--force"]) == 0
    found = json.loads(capsys.readouterr().out)["found"][0]
    design = load_design("large.toml")
    assert design.youngs_modulus.value == pytest.approx(1e6 * found["value"], rel=2e-4)  # four digits are written
    assert design.youngs_modulus.value == pytest.approx(TRUE_E, rel=0.02)
    assert "youngs_modulus_mpa = 2.32" in (here / "large.toml").read_text()

    assert run(["deploy", "large.toml", "--out", "large.probe.json", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["identified_apart"] == ""
    model = load_estimator("large.probe.json").model
    spread = found["std"] / found["value"]
    assert model.rod.youngs_modulus == pytest.approx(design.youngs_modulus.value)
    assert model.material["youngs_modulus"].provenance == "identified"
    assert model.tolerances is not None
    assert model.tolerances.youngs_modulus == pytest.approx(spread, rel=0.06)  # two digits are written
    assert design.shear_modulus.provenance == "assumed"  # the tests do not determine it
    # Poisson's ratio 0.49 ± 0.01
    assert design.youngs_modulus.value / design.shear_modulus.value == pytest.approx(2.98, rel=0.01)
    assert model.tolerances.shear_modulus == pytest.approx((spread**2 + 0.0067**2) ** 0.5, rel=0.15)
    assert model.stiffness_spread == pytest.approx(spread, rel=0.06)  # for fused touches
    assert model.tolerances.youngs_modulus_by_diameter == pytest.approx(found["by_diameter"], abs=0.005)


def test_inconsistent_results_are_printed_and_end_as_an_error(
    here: Path, stage_folder: Path, capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was found is printed all the same; a script must not take it for a success."""
    whole = module.identify

    def contradicted(*arguments):
        return whole(*arguments).as_inconsistent("touches: 9 of 9 are outliers with little weight")

    monkeypatch.setattr(module, "identify", contradicted)
    for more in ((), ("--json",)):
        assert run(["identify", "large.toml", str(stage_folder), "--for", "E", "--no-page", *more]) == 2
        output = capsys.readouterr()
        assert (
            "inconsistent" in output.out and "outliers with little weight" in output.err and output.err.count("\n") == 1
        )


def test_out_writes_a_copy(here: Path, stage_folder: Path, capsys) -> None:
    before = (here / "large.toml").read_bytes()
    command = ["identify", "large.toml", str(stage_folder), "--for", "E", "--no-page", "--out", "mine.toml"]
    assert run(command) == 0
    assert load_design("mine.toml").youngs_modulus.provenance == "identified"
    assert (here / "large.toml").read_bytes() == before
    assert run(command) == 2 and "exists already" in capsys.readouterr().err
    old = (here / "mine.toml").read_bytes() + b"# mine\n"
    (here / "mine.toml").write_bytes(old)
    assert run([*command, "--force"]) == 0
    assert (here / "mine.toml.old").read_bytes() == old and b"# mine" not in (here / "mine.toml").read_bytes()
    assert "kept the former mine.toml as mine.toml.old" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "output"),
    [
        (["--for", "E,densty"], "did you mean 'density'?"),
        (["--for", ","], "no parameter is named"),
        (["--write", "--out", "x.toml"], "choose one"),
    ],
)
def test_wrong_options_are_one_line(arguments: list[str], output: str, here: Path, stage_folder: Path, capsys) -> None:
    assert run(["identify", "large.toml", str(stage_folder), *arguments]) == 2
    error = capsys.readouterr().err
    assert output in error and error.count("\n") == 1
