"""Test the print check: each rule detects its problem, its number is correct, and its remedy works."""

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from probedesign.cli.main import run
from probedesign.design import load_design, parse_design
from probedesign.design.catalog import PRINTERS
from probedesign.printing.check import RAFT_MARGIN, check_print, packed

DESIGNS = Path(__file__).parents[2] / "designs"


def design_of(length=150.0, base=12.0, tip=2.0, profile=None, print_="", **more):
    shape = "cone" if profile is None else "profile"
    rest = f"tip_d_mm = {tip}" if profile is None else f"profile_mm = {profile}"
    extra = "\n".join(f"{key} = {json.dumps(value)}" for key, value in more.items())
    return parse_design(
        f'schema = 1\nname = "x"\n[probe]\nshape = "{shape}"\nlength_mm = {float(length)}\nbase_d_mm = {float(base)}\n'
        f"{rest}\n{extra}\n[print]\n{print_}"
    )


def found(design, rule, what=""):
    rank = ("ok", "warning", "error").index
    every = check_print(design).findings
    findings = [f for f in every if (f.rule, f.part) == (rule, "probe") and what in f.what]
    return max(findings, key=lambda f: rank(f.severity))


@pytest.mark.parametrize("name", ["large", "medium", "small"])
def test_the_papers_probes_print(name):
    check = check_print(load_design(DESIGNS / f"{name}.toml"))
    assert check.errors == [] and check.fits
    parts = {"probe", "sensor_adapter", "clamp_ring", "flange_adapter", "mount"}
    assert {f.part for f in check.passed} == parts
    for finding in check.findings:
        assert finding.source and finding.unit in ("mm", "mm²", "mm³", "deg", "N", "1")
        assert bool(finding.remedy) == (finding.severity != "ok")


def test_a_rounded_tip_is_no_thinner_and_a_flange_without_pin_and_spigot_has_no_walls_there():
    text = 'schema = 1\nname = "x"\n[probe]\nshape = "cone"\nlength_mm = 150.0\nbase_d_mm = 12.0\ntip_d_mm = 2.0\n'
    assert check_print(parse_design(text + 'tip = "rounded"\n')).errors == []
    check = check_print(parse_design(
        f'{text}[mount]\nrobot_flange = "own"\n[mount.flange]\nbolt = "M6"\nbolt_circle_d_mm = 50.0\n'
        "bolt_azimuths_deg = [45.0, 135.0, 225.0, 315.0]\nmax_bolt_entry_mm = 6.0\nbolt_length_mm = 12.0\n"
        "face_d_mm = 63.0\n"))  # fmt: skip
    assert check.errors == []
    assert not any("pin slot" in f.what or "spigot" in f.what for f in check.findings)


# The printer's room


@pytest.mark.parametrize("printer", PRINTERS)
@pytest.mark.parametrize("scale_z", [1.0, 1.05])
def test_the_named_maximum_length_fits_and_a_millimetre_more_does_not(printer, scale_z):
    print_ = f'printer = "{printer}"\nscale_z = {scale_z}'
    finding = found(design_of(length=400, print_=print_), "build_volume", "height")
    assert finding.severity == "error"
    assert finding.measured == pytest.approx(scale_z * 403 + 7)  # with flange, raft and supports
    longest = int(finding.remedy.split(" is ")[1].split(" mm")[0])
    assert check_print(design_of(length=longest, print_=print_)).fits
    assert not check_print(design_of(length=longest + 1, print_=print_)).fits


def test_a_probe_too_long_names_the_smallest_printer_that_fits():
    for length, printer in ((200, "form-4"), (201, "form-3l"), (300, "form-4l")):  # 210 mm is a form-4's height
        assert f"it fits a {printer}" in found(design_of(length=length), "build_volume", "height").remedy
        assert check_print(design_of(length=length, print_=f'printer = "{printer}"')).fits
    assert "it fits no known printer" in found(design_of(length=400), "build_volume", "height").remedy


def test_the_width_is_that_of_the_widest_section():
    """A body of 60 mm across on a flange of 67 mm: 77 mm with the raft's margins."""
    assert found(design_of(base=60, tip=60), "build_volume", "width").measured == pytest.approx(77.0)


# The body


@pytest.mark.parametrize(("tip", "severity"), [(1.5, "ok"), (1.499, "error"), (1.2, "error")])
def test_a_tip_below_the_resins_limit_is_an_error_with_the_limit(tip, severity):
    finding = found(design_of(tip=tip), "smallest_feature")
    assert (finding.severity, finding.measured, finding.limit) == (severity, pytest.approx(tip), 1.5)
    assert finding.remedy == ("" if severity == "ok" else "make it 1.5 mm there")


def test_a_flattened_probe_is_as_thin_as_its_short_axis_and_a_neck_counts_like_a_tip():
    finding = found(design_of(tip=2.0, section="elliptic", flatness=0.5), "smallest_feature")
    assert finding.measured == pytest.approx(1.0)
    finding = found(design_of(profile=[[0.0, 12.0], [70.0, 1.0], [150.0, 3.0]]), "smallest_feature")
    assert finding.severity == "error" and "s = 70 mm" in finding.what


@pytest.mark.parametrize(
    ("base", "tip", "severity"),
    [(12.0, 2.0, "ok"), (7.5, 7.5, "ok"), (7.0, 2.0, "warning"), (3.75, 2.0, "warning"), (3.7, 2.0, "error")],
)
def test_slenderness_is_diameter_over_the_height_above(base, tip, severity):
    finding = found(design_of(base=base, tip=tip), "slenderness")
    assert finding.severity == severity
    assert finding.measured == pytest.approx(base / 150.0)


def test_a_thin_end_is_slender_where_it_begins():
    """12 to 2 mm over 50 mm, then 2 mm for 100 mm: a wire of 2 mm, 100 mm tall, on top of the cone."""
    design = design_of(profile=[[0.0, 12.0], [50.0, 2.0], [150.0, 2.0]])
    finding = found(design, "slenderness")
    assert finding.measured == pytest.approx(0.02) and "s = 50 mm" in finding.what
    assert "5 mm there, or 40 mm" in finding.remedy
    mended = design_of(length=90, profile=[[0.0, 12.0], [50.0, 2.0], [90.0, 2.0]])
    assert found(mended, "slenderness").severity == "ok"


def test_no_place_between_the_knots_is_more_slender_than_the_knots():
    """d(s)/(L - s) of a body straight between knots has no least value inside: a thousand places agree."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        s = np.round(np.concatenate([[0.0], np.sort(rng.uniform(5, 95, 3)), [100.0]]), 2)
        d = np.round(rng.uniform(2, 6, 5), 2)
        knots = [[float(a), float(b)] for a, b in zip(s, d, strict=True)]
        stations = np.linspace(0.0, 99.9, 1000)
        least = (np.interp(stations, s, d) / (100.0 - stations)).min()
        finding = found(design_of(length=100, base=d[0], profile=knots), "slenderness")
        assert finding.measured <= least + 1e-12


@pytest.mark.parametrize(("out", "severity"), [(1.0, "ok"), (1.01, "warning"), (2.9, "warning"), (3.0, "error")])
def test_a_swelling_profile_overhangs_by_its_angle(out, severity):
    """It grows by `out` on the radius over 1 mm of height: tan 19° = 1/2.904, tan 45° = 1."""
    d = 8.0 + 2 * out
    design = design_of(length=80, profile=[[0.0, 12.0], [40.0, 8.0], [41.0, d], [80.0, d]])
    finding = found(design, "overhang")
    assert finding.severity == severity
    assert finding.measured == pytest.approx(math.degrees(math.atan(1.0 / out)))
    if severity != "ok":
        assert "at most 2 mm" in finding.remedy


def test_a_bore_overhangs_where_it_narrows():
    """A narrowing bore is an overhang, a narrowing outside is not. The bore narrows half as much as the body."""
    profile = [[0.0, 12.0], [40.0, 12.0], [41.0, 6.0], [80.0, 6.0]]
    assert found(design_of(length=80, profile=profile), "overhang").severity == "ok"
    hollow = design_of(length=80, profile=profile, section="hollow", bore_ratio=0.5)
    finding = found(hollow, "overhang")
    assert finding.measured == pytest.approx(math.degrees(math.atan(1.0 / 1.5)))
    assert finding.severity == "warning" and "at most 4 mm" in finding.remedy


def test_a_hollow_probe_is_measured_at_its_thinnest():
    design = design_of(length=100, base=12.0, tip=4.0, section="hollow", bore_ratio=0.5)
    wall, drain = found(design, "wall", "s = 100"), found(design, "trapped_volume")
    assert (wall.measured, wall.severity) == (pytest.approx(1.0), "ok")
    assert (drain.measured, drain.limit, drain.severity) == (pytest.approx(2.0), 3.5, "warning")
    thin = design_of(length=100, base=12.0, tip=1.5, section="hollow", bore_ratio=0.5)
    assert found(thin, "wall", "s = 100").severity == "error"  # 0.375 mm
    assert found(thin, "hole", "s = 100").severity == "warning"  # 0.75 mm
    assert not [f for f in check_print(design_of()).findings if f.rule == "trapped_volume"]  # a full one traps nothing


# The rigid parts


@pytest.mark.parametrize("base", [3.0, 4.5, 6.0, 8.0, 12.0, 18.5, 25.0])
@pytest.mark.parametrize("robot_flange", ["iso-9409-1-50-4-m6", "iso-9409-1-31.5-4-m5"])
def test_the_rigid_parts_of_every_base_keep_their_rules(base, robot_flange):
    text = (f'schema = 1\nname = "x"\n[probe]\nlength_mm = 60.0\nbase_d_mm = {base}\ntip_d_mm = 2.0\n[mount]\n'
            f'robot_flange = "{robot_flange}"\n')  # fmt: skip
    rigid = [f for f in check_print(parse_design(text)).findings if f.part != "probe"]
    assert {f.severity for f in rigid} == {"ok"}
    assert {"build_volume", "wall", "hole", "slenderness", "overhang", "cup"} <= {f.rule for f in rigid}


def test_a_probe_too_wide_for_the_ring_is_an_error():
    design = design_of(length=80, base=6, profile=[[0.0, 6.0], [40.0, 40.0], [80.0, 40.0]])
    (finding,) = [f for f in check_print(design).findings if f.rule == "mount"]
    assert finding.severity == "error" and finding.measured is None
    assert "the clamp ring cannot pass; at most" in finding.message
    assert finding.as_record()["measured"] is None


# The command


@pytest.fixture
def written(tmp_path):
    def write(probe):
        path = tmp_path / "x.toml"
        sizes = f"length_mm = {probe[0]}\nbase_d_mm = 12.0\ntip_d_mm = {probe[1]}\n"
        path.write_text(f'schema = 1\nname = "x"\n[probe]\n{sizes}')
        return str(path)

    return write


def test_the_command_prints_findings_and_passes_with_warnings(written, capsys):
    assert run(["check", written((150.0, 2.0))]) == 0
    out = capsys.readouterr().out
    assert "elastic-50a on a form-3" in out and "no errors" in out
    assert "hang it by its flange" in out and "180° from the clocking mark" in out


def test_the_command_fails_on_errors_and_its_json_holds_every_number(written, capsys):
    assert run(["check", written((240.0, 1.2))]) == 1
    captured = capsys.readouterr()
    assert captured.err == ""
    lines = [line for line in captured.out.splitlines() if line.startswith("  error")]
    assert len(lines) == 2
    assert "250 mm, required at most 185 mm; the longest probe for a form-3 is 175 mm; it fits a form-3l" in lines[0]
    assert "1.2 mm, required at least 1.5 mm" in lines[1]
    assert "low confidence: assumed" in captured.out
    assert run(["check", written((240.0, 1.2)), "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert (document["ok"], document["errors"], document["printer"]) == (False, 2, "form-3")
    finding = document["findings"][0]
    assert (finding["rule"], finding["severity"], finding["part"]) == ("build_volume", "error", "probe")
    assert (finding["measured"], finding["limit"], finding["unit"]) == (250.0, 185.0, "mm")
    assert finding["confidence"] == "high" and "PreForm" in finding["source"]
    assert all(f["severity"] == "ok" for f in document["passed"])


@pytest.mark.parametrize("printer", PRINTERS.values(), ids=PRINTERS)
@pytest.mark.parametrize("d", [(63.0, 31.2, 31.2), (125.0, 31.2, 31.2), (125.0, 86.0, 86.0), (25.0, 25.0, 25.0)])
def test_parts_are_packed_apart_on_as_many_platforms_as_they_need(printer, d):
    """Every part that fits lies inside of the margin, and no two rectangles around them come closer than 5 mm."""
    diameters = dict(zip("abc", d, strict=True))
    platforms = packed(diameters, printer)
    assert [part for platform in platforms for part in platform] == list("abc")
    sides = np.array(printer.build_volume_mm[:2])
    for platform in platforms:
        for part, axis in platform.items():
            r = diameters[part] / 2
            if (2 * r + 2 * RAFT_MARGIN <= sides).all():
                assert (np.array(axis) - r >= RAFT_MARGIN - 1e-2).all()
                assert (np.array(axis) + r <= sides - RAFT_MARGIN + 1e-2).all()
            for other in set(platform) - {part}:
                apart = np.abs(np.subtract(axis, platform[other])) - r - diameters[other] / 2
                assert apart.max() >= 5.0 - 1e-2
    if printer.name == "form-3":  # 145 mm: a plate of 125 mm leaves no room beside it
        assert len(platforms) == {63.0: 1, 25.0: 1, 125.0: 2 if d[1] < 60.0 else 3}[d[0]]


def test_the_check_needs_no_cad_and_no_mechanics():
    code = (
        "import sys; sys.modules['cadquery'] = sys.modules['trimesh'] = sys.modules['lib3mf'] = None;"
        "from probedesign.cli.main import run; status = run(['check', sys.argv[1]]); sys.exit(status)"
    )
    path = str(DESIGNS / "large.toml")
    result = subprocess.run([sys.executable, "-c", code, path], capture_output=True, text=True, timeout=120)
    assert (result.returncode, result.stderr) == (0, "")


@pytest.mark.parametrize("key", ["scale_xy", "scale_z", "rigid_scale_xy", "rigid_scale_z"])
@pytest.mark.parametrize("value", ["0.5", "101.0", "nan", '"1 %"'])
def test_implausible_scales_are_refused(key, value):
    from probedesign.core.errors import InputError

    with pytest.raises(InputError, match=rf"print\.{key} = .*(0\.9 \.\.\. 1\.1|finite|number)"):
        design_of(print_=f"{key} = {value}")
