"""The frozen probe: it reads back to the last bit, and an altered file is refused."""

import copy
import json
import subprocess
import sys
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from probedesign import frozen_probe
from probedesign.core.errors import InputError
from probedesign.design import check_design, load_design, parse_design
from probedesign.design.io import new
from probedesign.design.sensors import Noise
from probedesign.estimation.model import Tolerances
from probedesign.frozen_probe import check_manifest, deploy_model, freeze, load_estimator, load_model, write_frozen
from probedesign.probe import build_probe

DESIGNS = Path(__file__).parents[1] / "designs"


@pytest.fixture(scope="module")
def model():
    return build_probe(load_design(DESIGNS / "large.toml")).model


@pytest.fixture(scope="module")
def frozen(model):
    return json.loads(json.dumps(freeze(model)))


@pytest.fixture
def path(tmp_path):
    return tmp_path / "large.probe.json"


def leaves(data, at=()):
    if isinstance(data, dict) and data:
        return [leaf for key, value in data.items() for leaf in leaves(value, (*at, key))]
    if isinstance(data, list) and data:
        return [leaf for i, value in enumerate(data) for leaf in leaves(value, (*at, i))]
    return [at]


def with_changed(data, at, change):
    data = copy.deepcopy(data)
    parent = data
    for key in at[:-1]:
        parent = parent[key]
    change(parent, at[-1])
    return data


def alter(parent, key):
    value = parent[key]
    if isinstance(value, str):
        parent[key] = value + "x"
    elif isinstance(value, (int, float)):
        parent[key] = np.nextafter(value, np.inf) if value else 1e-300  # the last bit
    else:
        parent[key] = ["x"]


def remove(parent, key):
    del parent[key]


def refused(path, content, message=None):
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError, match=message) as error:
        load_model(path)
    line = str(error.value)
    assert line.isprintable() and str(path) in line
    return line


# Valid files


def assert_same(a, b):
    """Assert that two values are equal to the last bit, attribute by attribute; the file has no name of the resin."""
    if is_dataclass(a):
        for entry in fields(a):
            if entry.name != "resin":
                assert_same(getattr(a, entry.name), getattr(b, entry.name))
    elif isinstance(a, np.ndarray):
        np.testing.assert_array_equal(a, b)
    else:
        assert a == b


@st.composite
def probes(draw):
    """Draw valid probes: shape, size, section, tip, resin, friction, mount and tolerances."""
    base_d = draw(st.floats(4.0, 20.0))
    section = draw(st.sampled_from(["round", "hollow", "elliptic"]))
    tip = draw(st.sampled_from(["blunt", "rounded"] if section == "round" else ["blunt"]))
    design = new(
        "drawn",
        shape="cone",
        length_mm=draw(st.floats(40.0, 180.0)),
        base_d_mm=base_d,
        tip_d_mm=draw(st.floats(0.3, 0.9)) * base_d,
        tip=tip,
        section=section,
        bore_ratio=draw(st.floats(0.1, 0.6)) if section == "hollow" else None,
        flatness=draw(st.floats(0.3, 1.0)) if section == "elliptic" else None,
        resin=draw(st.sampled_from(["elastic-50a", "flexible-80a", "silicone-40a"])),
        friction=draw(st.none() | st.floats(0.0, 2.0) | st.just(float("inf"))),
    )
    data = design.model_dump(by_alias=True, exclude_none=True)
    data["mount"]["root_rigid_radii"] = draw(st.floats(-0.2, 0.5))
    data["material"]["stiffness_spread"] = draw(st.floats(0.0, 0.5))
    data["tolerances"] |= {"gain": draw(st.floats(0.0, 0.05)), "tared": draw(st.booleans())}
    return build_probe(check_design(data))


def assert_reads_back(probe, path):
    write_frozen(probe.model, path)
    wanted = replace(probe.model, tolerances=Tolerances.of(probe.model))
    assert_same(wanted, load_model(path))
    written = path.read_bytes()
    write_frozen(load_model(path), path)
    assert path.read_bytes() == written
    wrench = np.array([0.01, 0.002, -0.001, 1e-4, 8e-4, 1e-5])
    found, expected = (e.estimate(wrench) for e in (load_estimator(path), probe.estimator()))
    assert found.result == expected.result
    np.testing.assert_array_equal(found.p_surface_base, expected.p_surface_base)
    np.testing.assert_array_equal(found.cov_surface_base, expected.cov_surface_base)


@pytest.mark.parametrize("name", sorted(file.stem for file in DESIGNS.glob("*.toml")))
def test_a_probe_reads_back_to_the_last_bit(name, path):
    assert_reads_back(build_probe(load_design(DESIGNS / f"{name}.toml")), path)


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(probe=probes())
def test_any_valid_probe_reads_back_to_the_last_bit(probe, path):
    assert_reads_back(probe, path)


def test_the_file_is_indented_and_states_provenance_and_stiffness(model, frozen, path):
    path.write_text("something else")
    write_frozen(model, path)
    assert [p.name for p in path.parent.iterdir()] == [path.name]
    assert path.read_text().count("\n") > 50 and path.read_text().endswith("}\n")
    assert frozen["flexible_mass_kg"] == pytest.approx(model.mass, rel=1e-15)
    assert {m["provenance"] for m in frozen["material"].values()} <= {"assumed", "datasheet", "identified"}
    r = model.rod.radius_at(frozen["sections"]["s_m"])
    for key in ("EI_xx_Nm2", "EI_yy_Nm2"):
        np.testing.assert_allclose(frozen["sections"][key], model.rod.youngs_modulus * np.pi / 4.0 * r**4, rtol=1e-14)


# Other sections


SECTIONS = {"hollow": 'section = "hollow"\nbore_ratio = 0.5\n', "elliptic": 'section = "elliptic"\nflatness = 0.6\n'}


def probe_with(section):
    """The large probe with another section."""
    text = (DESIGNS / "large.toml").read_text(encoding="utf-8")
    return build_probe(parse_design(text.replace("[material]", f"{SECTIONS[section]}\n[material]", 1)))


AXES = {
    "arc": 'axis = "arc"\naxis_bend_deg = 86.0\naxis_azimuth_deg = -90.0\nbow_mm = [1.0, -0.5]\n',
    "helix": 'axis = "helix"\naxis_bend_deg = 215.0\naxis_turns = 1.0\ntip = "rounded"\n',
    "knots": 'axis = "knots"\naxis_knots_mm_1_m = [[0.0, 0.0, 9.0], [60.0, 5.0, 0.0], [150.0, 0.0, -3.0]]\n',
}


@pytest.mark.parametrize("axis", AXES)
def test_a_curved_axis_reads_back_with_the_curvature_of_the_print(axis, path, monkeypatch):
    monkeypatch.setitem(SECTIONS, axis, AXES[axis])
    wanted = probe_with(axis)
    write_frozen(wanted.model, path)
    back = load_model(path)
    np.testing.assert_array_equal(back.rod.rest_curvature, wanted.rod.rest_curvature)
    np.testing.assert_array_equal(back.axis.curvature, wanted.geometry.axis.curvature)
    assert back.fingerprint == wanted.geometry.fingerprint


@pytest.mark.parametrize(
    ("axis", "message"),
    [({"s_m": [0.0, 0.15], "curvature_1_m": [[1.0, 0.0]]}, "axis: s must increase from 0"),
     ({"s_m": [0.0, 0.0], "curvature_1_m": [[1.0, 0.0], [1.0, 0.0]]}, "axis: s must increase from 0"),
     ({"s_m": [0.0, 0.15], "curvature_1_m": [[1.0, 0.0], [2.0, 0.0]]}, "is not that of the geometry")],
)  # fmt: skip
def test_a_forged_axis_is_refused(axis, message, frozen, path):
    refused(path, signed({**frozen, "axis": axis}), message)


@pytest.mark.parametrize("section", SECTIONS)
def test_rod_and_geometry_have_the_same_mass_and_the_table_the_closed_forms_of_the_base(section):
    """12 mm wide: the tube of d = 6 mm, the ellipse of b = 3.6 mm; E is 2.32 MPa, G 0.761 MPa."""
    probe = probe_with(section)
    assert probe.model.mass == pytest.approx(probe.mass, rel=1e-12, abs=0)  # two closed forms
    a, b, d = 6e-3, 3.6e-3, 3e-3
    area, xx, yy, torsion = {
        "hollow": (a**2 - d**2, (a**4 - d**4) / 4, (a**4 - d**4) / 4, (a**4 - d**4) / 2),
        "elliptic": (a * b, a * b**3 / 4, a**3 * b / 4, a**3 * b**3 / (a**2 + b**2)),
    }[section]
    table = freeze(probe.model)["sections"]
    found = [table[key][0] for key in ("area_m2", "EI_xx_Nm2", "EI_yy_Nm2", "GJ_Nm2")]
    assert found == pytest.approx(np.pi * np.array([area, 2.32e6 * xx, 2.32e6 * yy, 0.761e6 * torsion]), rel=1e-12)


# Friction


def with_friction(friction):
    """The large probe with another friction."""
    text = (DESIGNS / "large.toml").read_text(encoding="utf-8")
    return build_probe(parse_design(text.replace("friction = 0.6", f"friction = {friction}", 1))).model


@pytest.mark.parametrize(("friction", "written"), [("0", 0.0), ("0.35", 0.35), ("inf", "inf")])
def test_a_friction_reads_back_and_leaves_the_geometry_alone(friction, written, model, path):
    wanted = with_friction(friction)
    write_frozen(wanted, path)
    data = json.loads(path.read_text(), parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert data["contact"] == {"friction": written, "provenance": "assumed", "source": "design file, contact.friction"}
    back = load_model(path)
    assert back.friction == wanted.friction == float(friction)
    assert back.fingerprint == model.fingerprint
    write_frozen(back, path)
    assert json.loads(path.read_text()) == data


@pytest.mark.parametrize(
    "value", [-0.1, -1e300, float("nan"), float("inf"), float("-inf"), True, None, "0.6", "-inf", "nan", [], {}]
)
def test_a_friction_out_of_range_is_refused(value, frozen, path):
    data = copy.deepcopy(frozen)
    data["contact"]["friction"] = value
    line = refused(path, signed(data), r"contact\.friction = ")
    assert "must be a number of 0 or greater" in line


@pytest.mark.parametrize(
    "at",
    [("contact",), ("tolerances",), ("spread",), ("rod", "section"),
     *(("contact", key) for key in ("friction", "provenance", "source")),
     *(("tolerances", key) for key in ("root_radii", "gain", "stiffness_scatter", "walk_steps",
                                       "youngs_modulus_by_diameter", "tared"))],
)  # fmt: skip
def test_a_missing_part_is_refused_under_a_valid_checksum(at, frozen, path):
    refused(path, signed(with_changed(frozen, at, remove)), at[-1])
    if len(at) == 1:
        refused(path, signed({**frozen, at[0]: None}))


def signed(data):
    body = {key: value for key, value in data.items() if key != "checksum"}
    return json.dumps({**body, "checksum": frozen_probe._checksum(body)})


# Invalid files


def test_every_changed_value_is_refused(frozen, path):
    changed = leaves(frozen)
    assert len(changed) > 150
    for at in changed:
        refused(path, json.dumps(with_changed(frozen, at, alter)))


def test_every_removed_key_is_refused(frozen, path):
    for at in {leaf[:depth] for leaf in leaves(frozen) for depth in range(1, len(leaf) + 1)}:
        refused(path, json.dumps(with_changed(frozen, at, remove)))


def test_contradicting_values_are_refused_under_a_valid_checksum(frozen, path):
    contradictions = [
        (("rod", "radius_m", 0), alter_by_tenth, "fingerprint"),
        (("flange", "diameter_m"), alter_by_tenth, "fingerprint"),
        (("sections", "EI_yy_Nm2", 3), alter_by_tenth, "sections.EI_yy_Nm2"),
        (("rod", "section", "bore_ratio"), half, "full round"),
        (("rod", "section", "flatness"), negative, "section"),
        (("material", "youngs_modulus_Pa", "value"), alter_by_tenth, "sections"),
        (("T_sensor_base", 0, 0), alter_by_tenth, "T_sensor_base"),
        (("T_robotflange_base", 2, 2), alter_by_tenth, "T_robotflange_base"),
        (("sensor", "noise_force_N"), negative, "noise"),
        (("sensor", "force_range_N", 0), negative, "ranges"),
        (("rod", "s_m", 1), negative, "increase"),
        (("gravity_base_m_s2",), remove, "gravity_base_m_s2"),
        (("hanging", "p_com_m"), shorten, "shape"),
        (("contact", "provenance"), alter, "assumed, datasheet, identified"),
    ]
    for at, change, message in contradictions:
        refused(path, signed(with_changed(frozen, at, change)), message)


def test_noise_of_unequal_channels_and_the_sensor_read_back(model, path):
    cov = np.diag([1.0, 1.0, 4.0, 1e-4, 1e-4, 1e-4]) * 1e-6
    cov[0, 4] = cov[4, 0] = 2e-9
    write_frozen(replace(model, noise=Noise(cov), sensor="another"), path)
    data, read = json.loads(path.read_text()), load_model(path)
    assert read.noise == Noise(cov) and read.sensor == "another"
    assert data["sensor"]["noise_force_N"] == read.noise.force == 2e-3  # the largest of its channels
    assert "noise_cov" not in freeze(model)["sensor"]
    for wrong in (-cov, cov + np.eye(6, k=1), cov[:5]):
        data["sensor"]["noise_cov"] = wrong.tolist()
        refused(path, signed(data), "noise_cov|shape")


def alter_by_tenth(parent, key):
    parent[key] *= 1.1


def negative(parent, key):
    parent[key] = -abs(parent[key])


def half(parent, key):
    parent[key] = 0.5


def shorten(parent, key):
    parent[key] = parent[key][:-1]


@pytest.mark.parametrize("schema", [0, 1, 2, 3, 4, 5, "6", None, 1e9])
def test_another_schema_is_refused(schema, frozen, path):
    line = refused(path, signed({**frozen, "schema": schema}), f"schema {schema!r} is not known")
    assert "probedesign deploy" in line


def test_a_truncated_file_is_refused(model, path):
    write_frozen(model, path)
    whole = path.read_bytes()
    for share in (0.0, 0.001, 0.3, 0.5, 0.9, 0.999):
        refused(path, whole[: int(share * len(whole))])
    path.write_bytes(whole[:-1])  # only the last line end: nothing is lost
    assert load_model(path).name == "large"


@pytest.mark.parametrize(
    "content",
    [b"", b"null", b"[]", b"3", b'"probe"', b"{}", bytes(range(256)), b"\xff\xfe{\x00}\x00", b"solid probe\n",
     b"[" * 100_000, b'{"kind": "probedesign frozen probe", "schema": 1}'],
    ids=["empty", "null", "list", "number", "text", "object", "binary", "utf-16", "stl", "deep", "bare"],
)  # fmt: skip
def test_other_content_is_refused(content, path):
    refused(path, content)


def test_a_huge_file_is_refused(path):
    with path.open("wb") as file:
        file.truncate(11_000_000)
    with pytest.raises(InputError, match="too large"):
        load_model(path)


# Against the printed parts


def test_a_manifest_of_other_parts_is_refused(model, path):
    write_frozen(model, path)
    manifest = path.parent / "manifest.json"
    manifest.write_text(json.dumps({"fingerprint": model.fingerprint}))
    assert load_model(path).fingerprint == model.fingerprint
    manifest.write_text(json.dumps({"fingerprint": "another"}))
    with pytest.raises(InputError, match="another"):
        load_model(path)


@pytest.mark.parametrize(
    ("table", "changed", "parts"),
    [
        ("mount", {"ring_screw": "M3"}, {"sensor adapter", "clamp ring", "payload"}),
        ("mount", {"flange_thickness_mm": 4.0}, {"probe", "sensor adapter", "payload"}),
        ("mount", {"squeeze_mm": 0.45}, {"sensor adapter", "payload"}),
        ("mount", {"flange_lip_mm": 4.5}, {"probe", "sensor adapter", "clamp ring", "payload"}),
        ("mount", {"robot_flange": "iso-9409-1-31.5-4-m5"}, {"flange adapter"}),
        ("material", {"density_kg_m3": 1040.0}, {"payload"}),
        ("material", {"youngs_modulus_mpa": 9.0}, {"clamp ring"}),
        ("probe", {"base_d_mm": 14.0}, {"probe", "sensor adapter", "clamp ring", "payload"}),
        ("probe", {"tip_d_mm": 3.0}, {"probe"}),
        ("probe", {"length_mm": 149.0}, {"probe"}),
        ("sensor", {"model": "nano25", "calibration": None}, {"sensor adapter", "flange adapter", "payload"}),
        ("probe", {"section": "hollow", "bore_ratio": 0.5}, {"probe"}),
    ],
)
def test_parts_of_another_mount_and_another_payload_are_refused_by_name(table, changed, parts, tmp_path):
    """What was exported of one design is beside the frozen probe of another: each part that differs is named."""
    tables = {"schema": 1, "name": "a", "probe": {"length_mm": 150.0, "base_d_mm": 12.0, "tip_d_mm": 2.0}}
    other = {**tables, table: {**tables.get(table, {}), **changed}}
    other[table] = {key: value for key, value in other[table].items() if value is not None}
    exported, frozen = (build_probe(check_design(data)).model for data in (tables, other))
    (tmp_path / "manifest.json").write_text(json.dumps({"kind": "export", "fingerprints": exported.parts}))
    deploy_model(exported, tmp_path / "a.probe.json")
    assert load_model(tmp_path / "a.probe.json").parts == exported.parts
    with pytest.raises(InputError, match="export the design again") as caught:
        deploy_model(frozen, tmp_path / "a.probe.json")
    named = {name for name in ("probe", "sensor adapter", "clamp ring", "flange adapter", "payload")
             if f"the {name} there has" in str(caught.value)}  # fmt: skip
    assert parts <= named, str(caught.value)


def test_an_export_without_fingerprints_of_its_parts_is_stale(model, path):
    write_frozen(model, path)
    old = {"kind": "export", "fingerprint": model.fingerprint}
    (path.parent / "manifest.json").write_text(json.dumps(old))
    with pytest.raises(InputError, match="the clamp ring there has fingerprint None"):
        load_model(path)


def test_a_given_manifest_has_precedence_over_the_one_beside_the_file(model, path, tmp_path):
    write_frozen(model, path)
    (path.parent / "manifest.json").write_text(json.dumps({"fingerprint": "another"}))
    good = tmp_path / "good.json"
    good.write_text(json.dumps({"fingerprint": model.fingerprint}))
    assert load_estimator(path, manifest=good).model.fingerprint == model.fingerprint


@pytest.mark.parametrize("content", ["", "{}", "[]", '{"fingerprint": 3}', '{"fingerprint": null}'])
def test_a_manifest_without_a_fingerprint_is_refused(content, model, tmp_path):
    manifest = tmp_path / "manifest.json"
    manifest.write_text(content)
    with pytest.raises(InputError):
        check_manifest(model.parts, manifest)


# Imports


def test_running_imports_nothing_of_the_design_side():
    modules = "probedesign.frozen_probe, probedesign.live.run, probedesign.live.sources.source"
    code = f"import sys, {modules}; print(*{{name.split('.')[0] for name in sys.modules}})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    loaded = set(done.stdout.split())
    assert "probedesign" in loaded
    assert not loaded & {"pydantic", "cadquery", "OCP", "matplotlib", "tomlkit", "trimesh"}


def test_a_folder_with_one_frozen_probe_is_accepted(frozen, path):
    with pytest.raises(InputError, match="no such"):
        load_model(path)
    with pytest.raises(InputError, match="no frozen probe"):
        load_model(path.parent)
    path.write_text(json.dumps(frozen))
    assert load_model(path.parent).fingerprint == load_model(path).fingerprint
    path.with_name("other.probe.json").write_text(json.dumps(frozen))
    with pytest.raises(InputError, match=r"large\.probe\.json, other\.probe\.json"):
        load_model(path.parent)


def test_a_design_in_the_place_of_a_frozen_probe_is_refused_with_the_command():
    with pytest.raises(InputError, match="probedesign deploy"):
        load_model(DESIGNS / "large.toml")
