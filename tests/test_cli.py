"""Command line: exit statuses, error messages of one line, JSON documents and printed summaries."""

import importlib
import json
import os
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

from probedesign.cli import doctor, main
from probedesign.cli.main import NAMES, run
from probedesign.cli.options import frozen_probe, uncalibrated_probe
from probedesign.core.errors import CheckFailedError, InputError, MissingDependencyError
from probedesign.core.files import check_overwrite, exports_of
from probedesign.design import load_design
from probedesign.design.catalog import assumed_text
from probedesign.rod.kernels import cache

LARGE = Path(__file__).parents[1] / "designs/large.toml"
NEW = ("new", "--length", "150", "--base-d", "12")
REMEDY = "set PROBEDESIGN_DEBUG=1 for a traceback)"


def refused(capsys, *arguments: str) -> str:
    """Return the error line of a command that is refused: exit status 2 and nothing on stdout."""
    capsys.readouterr()
    status = run([*arguments])
    out, err = capsys.readouterr()
    assert (status, out) == (2, "") and err.startswith("probedesign: error: ") and err.count("\n") == 1
    return err


# In a process of its own


def test_help_lists_every_command_and_loads_nothing_heavy():
    code = (
        "import sys; from probedesign.cli.main import run; status = run(['--help']);"
        "heavy = {'numpy', 'numba', 'scipy', 'matplotlib', 'cadquery', 'pydantic'} & set(sys.modules);"
        "print(sorted(heavy), file=sys.stderr); sys.exit(status)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert result.returncode == 0
    assert result.stderr == "[]\n"
    listed = [line.split()[1] for line in result.stdout.splitlines() if line.startswith("│")]
    assert [name for name in listed if name in NAMES] == list(NAMES)


@pytest.mark.parametrize(
    "arguments",
    [("nwe",), ("new",), ("new", "--length", "abc", "--base-d", "12"), ("export", "none.toml", "--otu", "x")],
)
def test_invalid_command_line_is_one_line_and_status_2(tmp_path, monkeypatch, capsys, arguments):
    monkeypatch.chdir(tmp_path)
    refused(capsys, *arguments)
    assert list(tmp_path.iterdir()) == []


def test_debug_variable_adds_the_traceback(monkeypatch, capsys):
    monkeypatch.setenv(main.DEBUG, "1")
    assert run(["nwe"]) == 2
    err = capsys.readouterr().err
    assert "Traceback" in err and err.splitlines()[-1].startswith("probedesign: error: ")


def test_closed_output_pipe_is_status_1_without_a_message():
    read_end, write_end = os.pipe()
    os.close(read_end)
    with os.fdopen(write_end) as closed:
        result = subprocess.run(
            [sys.executable, "-m", "probedesign.cli.main", "doctor"],
            stdout=closed, stderr=subprocess.PIPE, text=True, timeout=120, check=False,
        )  # fmt: skip
    assert (result.returncode, result.stderr) == (1, "")


def test_a_closed_standard_output_is_no_failure():
    code = "import sys; from probedesign.cli.main import run; sys.exit(run(['doctor']))"
    closed = subprocess.run(["sh", "-c", '"$0" -c "$1" >&-', sys.executable, code], capture_output=True, timeout=120)
    assert (closed.returncode, closed.stderr) == (0, b"")


def test_sigint_ends_a_command_with_status_130():
    """`doctor` is replaced by a command that sends its own process what Ctrl-C sends."""
    code = (
        "import signal, sys; from probedesign.cli import doctor, main;"
        "signal.signal(signal.SIGINT, signal.default_int_handler);"  # ignored in a shell's background
        "doctor.doctor = lambda: signal.raise_signal(signal.SIGINT);"
        "sys.exit(main.run(['doctor']))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert (result.returncode, result.stdout) == (130, "")
    assert result.stderr == "probedesign: error: interrupted\n"


# In this process


def test_version_is_that_of_the_package(capsys):
    assert run(["--version"]) == 0
    assert capsys.readouterr().out.strip() == metadata.version("probedesign")


@pytest.mark.parametrize("name", NAMES)
def test_the_help_of_a_command_is_its_docstring(name, capsys):
    assert run([name, "--help"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    module, function = main.FUNCTIONS.get(name, f"{name}:{name}").split(":")
    command = getattr(importlib.import_module(f"probedesign.cli.{module}"), function)
    assert " ".join(command.__doc__.partition("Args:")[0].replace("`", "").split()) in shown


@pytest.mark.parametrize(
    ("error", "status", "message"),
    [
        (InputError("a.toml:3: wrong\nin two lines"), 2, "a.toml:3: wrong in two lines"),
        (MissingDependencyError("needs CadQuery"), 2, "needs CadQuery"),
        (CheckFailedError("the mesh is open"), 1, f"the mesh is open (CheckFailedError; {REMEDY}"),
        (ZeroDivisionError("division by zero"), 1, f"division by zero (ZeroDivisionError; {REMEDY}"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (KeyboardInterrupt("2 of 3 conditions are kept"), 130, "2 of 3 conditions are kept"),
    ],
)
def test_error_is_one_line_and_a_status(monkeypatch, capsys, error, status, message):
    def app(arguments):
        raise error

    monkeypatch.setattr(main, "build_app", lambda *_: app)
    monkeypatch.delenv(main.DEBUG, raising=False)
    assert run([]) == status
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", f"probedesign: error: {message}\n")


def test_existing_file_and_missing_package_have_one_message_each(tmp_path):
    file = tmp_path / "a.csv"
    check_overwrite(file, force=False)
    file.write_text("")
    check_overwrite(file, force=True)
    with pytest.raises(InputError) as error:
        check_overwrite(file, force=False)
    assert str(error.value) == f"{file}: exists already; --force replaces it, or choose another name"
    missing = MissingDependencyError.of_extra("export", "CadQuery", "cad")
    assert str(missing) == "export needs CadQuery: pip install 'probedesign[cad]'"


# new


@pytest.fixture
def workplace(tmp_path, monkeypatch):
    """Return an empty folder; the summary of `new` is replaced by fixed figures."""

    def summary(design):
        return {
            "mass_g": 6.822, "sag_mm": 12.3, "thinnest_mm": 2.0, "fits_upright": design.probe.length_mm < 185,
            "printer": design.print_.printer, "print_check": {"errors": 0, "warnings": 1, "findings": []},
            "expected_error_mm": float("inf"), "expected_error_condition": "one touch of 10 mN at 0.8 of the length",
            "assumptions": design.assumptions,
        }  # fmt: skip

    monkeypatch.setattr(importlib.import_module("probedesign.cli.new"), "summary", summary)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_new_writes_the_file_and_prints_its_figures(workplace, capsys):
    assert run([*NEW, "--tip-d", "2.5"]) == 0
    design = load_design("designs/cone-150x12x2.5.toml")
    assert design.probe.knots_mm == ((0.0, 12.0), (150.0, 2.5))
    rows = dict(re.findall(r"^  (\w[\w ]*?)  +(.*)$", capsys.readouterr().out, re.MULTILINE))
    assert [rows["mass"], *rows["sag"].split(" mm")[:1]] == ["6.82 g", "12.3"]
    assert rows["expected error"].split(",")[0] == "inf mm"
    assert rows["assumed until measured"] == assumed_text(design.assumptions)


@pytest.mark.parametrize(("base_d", "tip_d"), [("12", 2.0), ("24", 4.0), ("6", 2.0)])
def test_new_chooses_and_prints_the_default_tip(workplace, capsys, base_d, tip_d):
    assert run(["new", "a", "--length", "150", "--base-d", base_d]) == 0
    assert load_design("designs/a.toml").probe.knots_mm[1] == (150.0, tip_d)
    assert f"{tip_d:g} mm" in capsys.readouterr().out.splitlines()[1]


def test_new_prints_one_json_document(workplace, capsys):
    assert run([*NEW, "--json", "mine"]) == 0
    captured = capsys.readouterr()
    document = json.loads(captured.out, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert captured.err == ""
    assert document["file"] == "designs/mine.toml"
    assert (document["tip_d_mm"], document["mass_g"]) == (2.0, 6.822)
    assert document["expected_error_mm"] is None  # not finite: JSON has no number for it


def test_new_takes_every_option(workplace):
    options = ["--shape", "cylinder", "--resin", "flexible-80a", "--sensor", "si-25-0.25"]
    options += ["--friction", "inf", "--points", "down", "--printer", "form-4l"]
    assert run([*NEW, "tube", *options, "--robot-flange", "iso-9409-1-31.5-4-m5"]) == 0
    design = load_design("designs/tube.toml")
    assert design.probe.knots_mm == ((0.0, 12.0), (150.0, 12.0))
    assert (design.material.resin, design.sensor.calibration) == ("flexible-80a", "si-25-0.25")
    assert design.mount.robot_flange == "iso-9409-1-31.5-4-m5"
    assert design.contact.friction == float("inf")
    assert design.mount.gravity_base_m_s2 == (0.0, 0.0, 9.81)  # z of the base points to the tip, which hangs
    assert design.printer.product == "Form 4L"


@pytest.mark.parametrize(("section", "key", "ratio"), [("hollow", "bore_ratio", 0.4), ("elliptic", "flatness", 0.6)])
def test_new_takes_every_section(workplace, section, key, ratio):
    assert run([*NEW, "--section", section, f"--{key.replace('_', '-')}", str(ratio)]) == 0
    design = load_design(f"designs/cone-150x12x2-{section}-{ratio}.toml")
    assert (design.probe.section, getattr(design.probe, key)) == (section, ratio)


@pytest.mark.parametrize(
    ("options", "value"),
    [
        (["--length", "-5"], "--length = -5.0"),
        (["--length", "0"], "--length = 0.0"),
        (["--length", "1e300"], "--length = 1e+300"),
        (["--length", "inf"], "--length = inf"),
        (["--base-d", "nan"], "--base-d = nan"),
        (["--base-d", "0x10"], "--base-d"),
        (["--base-d", ""], "--base-d"),
        (["--tip-d", "nan"], "--tip-d = nan"),
        (["--tip-d", "14"], "--tip-d = 14.0"),
        (["--tip-d", "3", "--shape", "cylinder"], "--tip-d = 3.0"),
        (["--shape", "ball"], "--shape"),
        (["--section", "square"], "--section"),
        (["--section", "hollow"], "--bore-ratio"),
        (["--section", "hollow", "--bore-ratio", "1"], "--bore-ratio = 1.0"),
        (["--flatness", "0.5"], "--flatness"),
        (["--section", "elliptic", "--flatness", "nan"], "--flatness = nan"),
        (["--resin", "jelly"], "--resin: unknown 'jelly'"),
        (["--sensor", "nano43"], "--sensor: unknown 'nano43'"),
        (["--robot-flange", "x"], "--robot-flange: unknown 'x'"),
        (["--friction", "-0.1"], "--friction = -0.1"),
        (["--friction", "nan"], "--friction = nan"),
        (["--lenght", "3"], "--lenght"),
        (["a/b"], "'a/b'"),
        (["../../etc/passwd"], "../../etc/passwd"),
        ([""], "''"),
        (["one", "two"], "two"),
    ],
)
def test_new_refuses_bad_values_by_option_and_value_and_writes_nothing(workplace, capsys, options, value):
    given = dict(zip(options[::2], options[1::2], strict=False))
    rest = [o for pair in (("--length", "150"), ("--base-d", "12")) if pair[0] not in given for o in pair]
    assert value in refused(capsys, "new", *options, *rest)
    assert list(workplace.iterdir()) == []


def test_new_writes_no_design_whose_mount_does_not_fit(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    # the bolts of this robot flange are too close for the sensor
    error = refused(capsys, *NEW, "--sensor", "mini40", "--robot-flange", "iso-9409-1-50-4-m6")
    assert "bolt_circle_d_mm = 50" in error
    assert list(tmp_path.iterdir()) == []


def test_new_replaces_a_file_only_with_force(workplace, capsys):
    assert run([*NEW, "mine"]) == 0
    before = Path("designs/mine.toml").read_bytes()
    assert "designs/mine.toml" in refused(capsys, "new", "mine", "--length", "50", "--base-d", "5")
    assert Path("designs/mine.toml").read_bytes() == before
    assert run(["new", "mine", "--length", "50", "--base-d", "5", "--force"]) == 0
    assert load_design("designs/mine.toml").probe.length_mm == 50.0


def test_new_refuses_a_file_named_designs(workplace, capsys):
    Path("designs").write_text("a file")
    refused(capsys, *NEW)
    assert Path("designs").read_text() == "a file"


# doctor


def test_doctor_reports_what_is_installed(capsys):
    assert run(["doctor", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    versions = {package["name"]: package["version"] for package in report["packages"]}
    assert report["ok"] and versions["numpy"] == metadata.version("numpy")
    assert {"scipy", "numba", "cadquery", "lib3mf", "matplotlib"} <= versions.keys()


def test_doctor_looks_for_every_package_that_all_and_notebook_install():
    required = [line.partition(";") for line in metadata.requires("probedesign")]
    every = {
        requirement.strip() for requirement, _, marker in required if re.search("extra == .(all|notebook).", marker)
    }
    assert every == {package["requirement"] for package in doctor.examine()["packages"] if package["extra"]}


def without(monkeypatch, *names: str) -> None:
    installed = metadata.version

    def version(name):
        if name in names:
            raise metadata.PackageNotFoundError(name)
        return installed(name)

    monkeypatch.setattr(doctor.metadata, "version", version)


def test_doctor_names_disabled_features_and_fails_without_a_required_package(monkeypatch, capsys):
    without(monkeypatch, "cadquery", "matplotlib")
    assert run(["doctor"]) == 0  # the program runs without them
    out = capsys.readouterr().out
    assert 'pip install "cadquery' in out and 'pip install "matplotlib' in out
    monkeypatch.undo()
    without(monkeypatch, "numba")
    assert run(["doctor", "--json"]) == 1
    report = json.loads(capsys.readouterr().out)
    assert not report["ok"]
    assert [remedy["needed_for"] for remedy in report["missing"]] == ["everything"]


def test_doctor_reports_the_cache_of_the_rod_kernels_and_whether_it_is_writable(monkeypatch, capsys, tmp_path):
    """They are in the package, where a wheel has them."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    assert run(["doctor", "--json"]) == 0
    reported = json.loads(capsys.readouterr().out)["numba_cache"]
    assert Path(reported["folder"]) == cache.BUILT and reported["processor"] in cache.runs()
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file"))
    assert run(["doctor"]) == 0
    assert "NUMBA_CACHE_DIR" in capsys.readouterr().out


def test_options_come_from_the_settings_file_and_the_environment(tmp_path, monkeypatch, capsys):
    """The command line wins over the environment, and that over the file, which is found in a folder above."""
    (tmp_path / "probedesign.toml").write_text("[new]\nlength = 120.0\nbase-d = 11.0\ntip-d = 3.0\n")
    (tmp_path / "below").mkdir()
    monkeypatch.chdir(tmp_path / "below")
    monkeypatch.setenv("PROBEDESIGN_NEW_BASE_D", "10")
    assert run(["new", "--tip-d", "2"]) == 0
    assert "designs/cone-120x10x2.toml" in capsys.readouterr().out


@pytest.mark.parametrize(
    "text",
    ["[[[", 'exports = ""', "exports = 3", "[lvie]\na = 1", "[new]\nlenght = 1", "live = 3", '[new]\nlength = "long"'],
)
def test_a_wrong_settings_file_gives_one_line_that_names_it(text, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "probedesign.toml").write_text(text)
    assert run(["new", "--base-d", "12"]) == 2
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1 and "probedesign.toml" in error and not (tmp_path / "designs").exists()
    assert run(["new", "--help"]) == 0 == run(["--version"])


@pytest.mark.parametrize("by_file", [True, False])
def test_one_folder_for_the_files_of_all_designs_is_set_once(by_file, tmp_path, monkeypatch):
    (tmp_path / "work/below").mkdir(parents=True)
    monkeypatch.setenv("PROBEDESIGN_EXPORTS", "" if by_file else str(tmp_path / "work/prints"))
    if by_file:
        monkeypatch.delenv("PROBEDESIGN_EXPORTS")
        monkeypatch.setenv("HOME", str(tmp_path / "work"))
        (tmp_path / "work/probedesign.toml").write_text('exports = "~/prints"\n')
    monkeypatch.chdir(tmp_path / "work/below")
    assert run(NEW) == 0
    assert run(["deploy", "cone-150x12x2"]) == 0
    assert (tmp_path / "work/prints/cone-150x12x2/cone-150x12x2.probe.json").exists()
    assert run(["live", "cone-150x12x2", "--source", "sim:?speed=max&rate_hz=50&seconds=1", "--count", "1"]) == 0


def test_a_folder_that_cannot_be_written_is_named(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    for command in (["predict", str(LARGE), "--out", "file/x"], ["--install-completion"]):
        monkeypatch.setenv("HOME", str(tmp_path / "file"))
        monkeypatch.setenv("SHELL", "/bin/bash")
        assert "file/x/" not in refused(capsys, *command)


def test_completion_is_installed_for_a_shell(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("SHELL", "/bin/bash")
    assert run(["--install-completion"]) == 0
    assert any("--length" in file.read_text() for file in tmp_path.rglob("probedesign"))


def test_a_design_is_given_by_file_folder_or_name_and_a_frozen_probe_by_name(tmp_path, monkeypatch, capsys):
    """The name has a dot."""
    monkeypatch.chdir(tmp_path)
    assert run([*NEW, "--tip-d", "2.5"]) == 0
    name = "cone-150x12x2.5"
    for given in (f"designs/{name}.toml", "designs", name):
        capsys.readouterr()
        assert run(["check", given, "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["name"] == name
    assert run(["deploy", name]) == 0
    assert (tmp_path / "exports" / name / f"{name}.probe.json").exists()
    assert run(["live", name, "--source", "sim:?speed=max&rate_hz=50&seconds=1", "--count", "1"]) == 0
    (tmp_path / "notes").mkdir()
    monkeypatch.chdir(tmp_path / "notes")
    assert run(["check", name]) == 0
    assert exports_of().resolve() == tmp_path / "exports"  # of the project, also without a design
    monkeypatch.chdir(tmp_path / "exports")
    assert run(["check", name]) == 0  # although a folder has this name
    monkeypatch.chdir(tmp_path / "notes")
    for command in (["estimate", name, "none"], ["validate", name, "none"]):
        capsys.readouterr()
        assert run(command) == 2
        assert name not in capsys.readouterr().err  # the probe was found
    monkeypatch.chdir(tmp_path)
    (tmp_path / "designs/other.toml").write_text(Path(f"designs/{name}.toml").read_text())
    for given in ("designs", "unknown"):
        refused(capsys, "check", given)


def test_a_folder_means_the_calibration_of_its_frozen_probe_while_it_is_newer(tmp_path, capsys):
    deployed, calibration = (tmp_path / f"x.{kind}probe.json" for kind in ("", "calibrated."))
    deployed.write_text('{"fingerprint": "a"}')
    assert frozen_probe(tmp_path) == tmp_path
    calibration.write_text('{"fingerprint": "a"}')
    os.utime(deployed, (0.0, 0.0))
    assert frozen_probe(tmp_path) == calibration and "the calibration of x.probe.json" in capsys.readouterr().err
    assert uncalibrated_probe(tmp_path) == deployed and frozen_probe(deployed) == deployed
    os.utime(calibration, (-1.0, -1.0))
    assert frozen_probe(tmp_path) == deployed and "calibrate again" in capsys.readouterr().err
    calibration.write_text('{"fingerprint": "b"}')
    assert frozen_probe(tmp_path) == deployed
