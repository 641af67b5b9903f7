"""Test sensor files: SI units in all uses, and error messages of one line."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from probedesign import cad
from probedesign.cli.main import run
from probedesign.core.errors import CheckFailedError, InputError
from probedesign.design import check_design, load_design, parse_design
from probedesign.design.catalog import CUSTOM
from probedesign.design.io import render_design, write_design
from probedesign.design.sensor_catalog import FILES, SENSORS, load_sensor
from probedesign.frozen_probe import load_model, write_frozen
from probedesign.printing.check import check_print
from probedesign.probe import build_probe
from probedesign.web.scene import rigid_parts

DESIGN = """\
schema = 1
name = "own-sensor"
[probe]
length_mm = 100.0
base_d_mm = 10.0
tip_d_mm = 2.0
[sensor]
file = "my/sensor.toml"
averaging_samples = 4
"""
COV = np.diag([1e-4, 1e-4, 4e-4, 1e-8, 1e-8, 1e-8])
COV[0, 4] = COV[4, 0] = 0.8e-6


def record(**noise):
    """Return the text of a sensor file: a Nano17 in another body, by default with correlated noise."""
    text = (FILES / "nano17.toml").read_text().replace('"nano17"', '"lab-1"')
    text = text.replace("body_d_mm = 17.0", "body_d_mm = 20.0").replace("height_mm = 14.5", "height_mm = 18.0")
    noise = noise or {"cov": COV.tolist()}
    lines = "".join(f"{key} = {value}\n" for key, value in noise.items())
    return text.replace("[[calibrations]]", f"[noise]\n{lines}\n[[calibrations]]", 1)


@pytest.fixture
def path(tmp_path):
    (tmp_path / "my").mkdir()
    (tmp_path / "my" / "sensor.toml").write_text(record())
    (tmp_path / "design.toml").write_text(DESIGN)
    return tmp_path / "design.toml"


def test_screws_that_may_enter_too_deep_are_found_and_nothing_is_written(path, tmp_path):
    """M2x6 has ±0.24 mm, the print ±0.15 mm, and 0.2 mm may be sanded: no entry of 2.5 to 3.0 mm is certain."""
    sensor = tmp_path / "my" / "sensor.toml"
    sensor.write_text(record().replace("max_entry_mm = 3.5", "max_entry_mm = 3.0"))
    findings = check_print(load_design(path)).errors
    assert {one.rule for one in findings} == {"tolerance_stack"} and len(findings) == 2  # both sides of the sensor
    assert all(one.measured == pytest.approx(0.48, abs=0.1) for one in findings)  # grips are in steps of 0.1 mm
    pytest.importorskip("cadquery")
    with pytest.raises(CheckFailedError):
        cad.export_part(load_design(path), "sensor_adapter", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_known_sensors_are_complete_files():
    """One file adds a sensor without any other change."""
    assert {path.stem for path in FILES.glob("*.toml")} == set(SENSORS)
    assert next(iter(SENSORS.values())) is SENSORS["nano17"]
    for name, sensor in SENSORS.items():
        assert load_sensor(FILES / f"{name}.toml").sensor == sensor
        for calibration in sensor.calibrations:
            assert (np.array(calibration.wrench_range) > 10 * np.array(calibration.resolution)).all()


def test_the_nano17_has_the_published_steps():
    """ATI: 1/320 N and 1/64 N·mm of SI-12-0.12, twice and four times as much of the others."""
    for k, calibration in enumerate(SENSORS["nano17"].calibrations):
        steps = [2**k / 320] * 3 + [2**k * 1e-3 / 64] * 3
        assert calibration.resolution == pytest.approx(steps, rel=1e-15)  # exact decimal numbers
        assert calibration.noise(4).std == pytest.approx(np.array(steps) / 2, rel=1e-15)


def test_a_sensor_file_is_followed_to_the_frozen_probe_and_the_view(path, tmp_path):
    design = load_design(path)
    assert design.sensor.model == CUSTOM and design.sensor_model.name == "lab-1"
    model = build_probe(design).model
    assert model.noise.cov == pytest.approx(COV / 4, rel=1e-15)  # the mean of four samples
    write_frozen(model, tmp_path / "a.probe.json")
    read = load_model(tmp_path / "a.probe.json")
    assert (read.sensor, read.noise) == ("lab-1", model.noise)
    vertices = rigid_parts(read, tmp_path)[0][0].vertices
    height = vertices[:, 2].max() - vertices[:, 2].min()
    assert height == pytest.approx(18e-3, abs=1e-9)  # float64 of a pose
    assert np.hypot(*vertices[:, :2].T).max() == pytest.approx(10e-3, abs=1e-9)


def test_a_written_design_contains_its_sensor(path, tmp_path):
    design = load_design(path)
    text = render_design(design)
    assert parse_design(text) == design
    other = tmp_path / "elsewhere" / "b.toml"
    write_design(text, other)
    assert load_design(other).sensor_model == design.sensor_model


def test_standard_deviations_are_a_diagonal_covariance(path):
    (path.parent / "my" / "sensor.toml").write_text(record(std=[0.01, 0.01, 0.02, 1e-4, 1e-4, 2e-4]))
    noise = load_design(path).calibration.noise()
    assert noise.std == pytest.approx([0.01, 0.01, 0.02, 1e-4, 1e-4, 2e-4], rel=1e-15)
    assert np.count_nonzero(noise.cov) == 6


INDEFINITE = COV.copy()
INDEFINITE[0, 4] = INDEFINITE[4, 0] = 2e-6  # a correlation of 2
ASYMMETRIC = COV.copy()
ASYMMETRIC[0, 4] = 0.0
NAN = "[[nan, 0.0, 0.0, 0.0, 0.0, 0.0]]"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[60.0, 180.0, 300.0]", "[60.0, 180.0]", "interface.tool.azimuths_deg has 2 holes"),
        ("[60.0, 180.0, 300.0]", "[60.0, 61.0, 300.0]", "which overlap"),
        (
            "bolt_circle_d_mm = 12.5",
            "bolt_circle_d_mm = 0.0",
            "interface.tool.azimuths_deg has 3 holes; bolt_circle_d_mm",
        ),
        (
            "bolt_circle_d_mm = 12.5",
            "bolt_circle_d_mm = -1.0",
            "interface.tool.bolt_circle_d_mm = -1.0 is out of range",
        ),
        ("[60.0, 180.0, 300.0]", "[5.0, 180.0, 300.0]", "interface.dowels.azimuths_deg has a hole"),
        ("[0.0, 120.0]", "[0.0, 50.0, 120.0]", "interface.dowels.azimuths_deg has 3 holes; it needs 1 to 2"),
        ("[0.0, 120.0]", "[]", "interface.dowels.azimuths_deg has 0 holes"),
        ("mass_g = 9.07", "mass_g = -9.07", "interface.mass_g = -9.07 is out of range"),
        ("mass_g = 9.07", "mass_g = nan", "mass_g = nan is not a finite number"),
        ("mass_g = 9.07", "mass_kg = 0.009", "did you mean 'interface.mass_g'"),
        ("bolt_circle_d_mm = 12.5", "bolt_circle_d_mm = 0.0125", "interface.tool.azimuths_deg has holes"),
        ("bolt_circle_d_mm = 12.5", "bolt_circle_d_mm = 125.0", "outside the face"),
        ("min_entry_mm = 2.5", "min_entry_mm = 4.0", "is above max_entry_mm"),
        (str(COV.tolist()), str(INDEFINITE.tolist()), "noise.cov is not positive definite"),
        (str(COV.tolist()), str((-COV).tolist()), "noise.cov is not positive definite"),
        (str(COV.tolist()), str(ASYMMETRIC.tolist()), "noise.cov is not symmetric"),
        (str(COV.tolist()), str(COV[:5].tolist()), "noise.cov needs six rows"),
        (str(COV.tolist()), NAN, "not a finite number"),
        ("cov =", "std = [1.0, 1.0, 1.0, 1.0, 1.0, 1.0]\ncov =", "one of the two"),
        ('name = "lab-1"', 'name = "../x"', "is not a plain name"),
        ('screw = "M2"', 'screw = "M7"', "interface.tool.screw = 'M7' is not one of"),
        ('name = "si-25-0.25"', 'name = "si-12-0.12"', "has two of one name"),
        ('name = "lab-1"', 'name = "lab-1"\nassumed = ["mass"]', "'mass' is not a key"),
        ("[interface.cable]", "[interface.cabel]", "unknown key"),
        ('name = "lab-1"', "name = ", "not valid TOML"),
    ],
)
def test_a_wrong_sensor_file_is_refused_in_one_line(path, old, new, message):
    file = path.parent / "my" / "sensor.toml"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    before = sorted(path.parent.rglob("*"))
    with pytest.raises(InputError) as error:
        load_design(path)
    assert message in str(error.value) and "sensor.toml" in str(error.value)
    assert "\n" not in str(error.value)
    assert sorted(path.parent.rglob("*")) == before


def centred(screw: str) -> str:
    """Return a sensor file with one thread on the axis of its tool face."""
    old = 'bolt_circle_d_mm = 12.5\nazimuths_deg = [60.0, 180.0, 300.0]\nscrew = "M2"'
    text = record().replace(old, f'bolt_circle_d_mm = 0.0\nazimuths_deg = [0.0]\nscrew = "{screw}"', 1)
    return re.sub(r"max_entry_mm = 3\.5.*", "max_entry_mm = 4.5", text, count=1)


def test_a_thread_on_the_axis_needs_a_dowel_or_a_measured_turn(path: Path) -> None:
    file = path.parent / "my" / "sensor.toml"
    file.write_text(centred("M3"))
    assert not check_print(load_design(path)).errors
    # One dowel: M3 in a hole of 3.4 + 0.15 mm, 6.25 mm from the pin, gives ±2.5°, evenly distributed.
    file.write_text(centred("M3").replace("[0.0, 120.0]", "[0.0]"))
    turn = np.degrees(np.arctan(0.275 / 6.25)) / np.sqrt(3.0)
    assert build_probe(load_design(path)).tolerances.clocking_deg == pytest.approx(np.hypot(0.5, turn), abs=0.001)
    head, _, rest = centred("M3").partition("[interface.dowels]")
    file.write_text(head + rest[rest.index("[interface.cable]") :])
    with pytest.raises(InputError, match=r"design\.toml: tolerances\.clocking_deg is missing: .*one screw") as error:
        load_design(path)
    assert "\n" not in str(error.value)
    path.write_text(DESIGN + "[tolerances]\nclocking_deg = 2.0\n")
    design = load_design(path)
    assert build_probe(design).tolerances.clocking_deg == 2.0


def test_a_centre_thread_is_refused_where_it_does_not_fit(path: Path) -> None:
    file = path.parent / "my" / "sensor.toml"
    file.write_text(centred("M6"))  # its head's room of 10.4 mm reaches into the dowel holes on a circle of 12.5 mm
    assert "dowel hole and a head's room" in " ".join(one.message for one in check_print(load_design(path)).errors)
    side = "bolt_circle_d_mm = 0.0\nazimuths_deg = [0.0]"
    file.write_text(record().replace("bolt_circle_d_mm = 12.5\nazimuths_deg = [95.0, 215.0, 335.0]", side))
    with pytest.raises(InputError, match=r"interface\.mounting\.bolt_circle_d_mm = 0: only the tool side"):
        load_design(path)
    narrow = centred("M6").replace("face_d_mm = 17.0", "face_d_mm = 10.9", 1)
    file.write_text(
        narrow.replace("circle_d_mm = 12.5\nazimuths_deg = [0.0, 1", "circle_d_mm = 8.5\nazimuths_deg = [0.0, 1")
    )
    path.write_text(DESIGN.replace("base_d_mm = 10.0", "base_d_mm = 4.0"))
    with pytest.raises(InputError, match=r"flange_lip_mm = .* leaves no land .* on the axis"):
        _ = build_probe(load_design(path)).tolerances


def line_named(path: Path) -> str:
    with pytest.raises(InputError) as error:
        load_sensor(path)
    found = re.match(r".*\.toml:(\d+): (.*)$", str(error.value))
    assert found, str(error.value)
    return path.read_text().splitlines()[int(found[1]) - 1]


@pytest.mark.parametrize("number", [0, 1, 2])
@pytest.mark.parametrize(
    ("key", "value"),
    [("range_N", "[12.0, 12.0]"), ("range_N", "[12.0, -1.0, 17.0]"), ("name", '"a b"'), ("resolution_Nm", "5.0")],
)
def test_an_error_in_a_list_of_tables_names_its_line(number: int, key: str, value: str, tmp_path: Path) -> None:
    head, *tables = (FILES / "nano17.toml").read_text().split("[[calibrations]]")
    tables[number] = re.sub(rf"(?m)^{key} = .*$", f"{key} = {value}", tables[number], count=1)
    path = tmp_path / "sensor.toml"
    path.write_text("[[calibrations]]".join([head, *tables]))
    assert line_named(path) == f"{key} = {value}"


def test_an_error_of_the_noise_names_its_line(tmp_path: Path) -> None:
    path = tmp_path / "sensor.toml"
    for noise in ({"std": [1e-3, 1e-3]}, {"cov": [[1.0, 2.0]]}, {"std": [1e-3] * 5 + [-1.0]}):
        path.write_text(record(**noise))
        assert line_named(path).startswith(next(iter(noise)))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("my/sensor.toml", "my/none.toml", "no such sensor file"),
        ("my/sensor.toml", "my", "cannot be read"),
        ('"my/sensor.toml"', "7", "sensor.file = 7"),
        ("averaging_samples", 'model = "nano17"\naveraging_samples', "sensor.model is not used beside sensor.file"),
        ("averaging_samples", 'calibration = "si-9"\naveraging_samples', "sensor.calibration"),
        ('file = "my/sensor.toml"', 'model = "own"', "sensor.own is missing"),
    ],
)
def test_a_wrong_reference_to_a_sensor_is_refused(path, old, new, message):
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(InputError) as error:
        load_design(path)
    assert message in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["nano25", "mini40", "gamma", "rokubi", "rft40"])
def test_parts_for_assumed_holes_are_refused(name, tmp_path):
    design = check_design({**tomllib.loads(DESIGN), "sensor": {"model": name}})
    assert "sensor.interface.tool" in design.assumptions
    for export in (
        lambda: cad.export_parts(design, tmp_path / "out"),
        lambda: cad.export_part(design, "probe", tmp_path / "out"),
    ):
        with pytest.raises(InputError, match="are assumed"):
            export()
    assert not (tmp_path / "out").exists()


def filled(text: str) -> str:
    """Return a design whose user has measured the interface: deeper dowel holes, and nothing of it assumed any more."""
    lines = []
    for line in text.splitlines():
        if line.startswith("assumed = "):
            values, _, _ = line.partition("#")
            kept = [key for key in tomllib.loads(values)["assumed"] if not key.startswith("interface.")]
            line = f"assumed = {kept}"
        if line.startswith("depth_mm = "):
            line = f"depth_mm = {float(line.split()[2]) + 0.5}"
        lines.append(line)
    return "\n".join(lines)


@pytest.mark.parametrize(
    "name", ["gamma", *(pytest.param(name, marks=pytest.mark.slow) for name in ("nano25", "mini40", "rokubi", "rft40"))]
)
def test_a_known_sensor_is_measured_in_the_new_design_and_exported(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(["new", "x", "--length", "100", "--base-d", "10", "--sensor", name]) == 0
    path = tmp_path / "designs" / "x.toml"
    design = load_design(path)
    assert design.sensor_model == SENSORS[name] and design.sensor.model == CUSTOM
    marked = [line for line in path.read_text().splitlines() if "assumed: measure it" in line]
    assert any(line.startswith("bolt_circle_d_mm") for line in marked)
    assert check_print(design).errors == []  # the robot flange that was taken has room, and the stacks hold
    with pytest.raises(InputError, match=r"tool, mounting, dowels, cable of its interface are assumed"):
        cad.export_part(design, "sensor_adapter", tmp_path / "out")

    path.write_text(filled(path.read_text()))
    measured = load_design(path)
    assert measured.sensor_model.assumed_shape == ()
    interface = SENSORS[name].interface
    assert measured.sensor_model.interface.dowels.depth == pytest.approx(interface.dowels.depth + 0.5e-3)
    assert check_print(measured).errors == []
    probe = build_probe(measured)
    write_frozen(probe.model, tmp_path / "a.probe.json")
    vertices = rigid_parts(load_model(tmp_path / "a.probe.json"), tmp_path)[0][0].vertices
    assert np.hypot(*vertices[:, :2].T).max() == pytest.approx(interface.body_d / 2, abs=1e-9)
    assert probe.predict(fractions=(0.5,), forces_N=(0.1,), directions=("+y",)).conditions[0].force_N == 0.1
    pytest.importorskip("cadquery")
    written = cad.export_part(measured, "flange_adapter", tmp_path / "out")
    assert written["volume_m3"] > 0.0 and (tmp_path / "out" / "flange_adapter.stl").exists()


def test_a_robot_flange_without_room_names_those_with_room(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    arguments = ["new", "x", "--length", "100", "--base-d", "10", "--sensor", "mini40"]
    assert run([*arguments, "--robot-flange", "iso-9409-1-50-4-m6"]) == 2
    message = capsys.readouterr().err
    assert "iso-9409-1-63-6-m6" in message and "51 mm" in message and message.count("\n") == 1
    assert not (tmp_path / "designs").exists()
    assert run([*arguments, "--robot-flange", "iso-9409-1-63-6-m6"]) == 0


def test_a_hole_that_is_still_assumed_is_refused(tmp_path):
    text = (FILES / "nano17.toml").read_text()
    text = text.replace("overload_N =", 'assumed = ["interface.dowels.depth_mm"]\noverload_N =', 1)
    (tmp_path / "s.toml").write_text(text)
    with pytest.raises(InputError, match=r"dowels\.depth_mm"):
        load_sensor(tmp_path / "s.toml").sensor.check_holes_known()
