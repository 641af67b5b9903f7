"""The folder that an export leaves: which files, what is in them, and what happens when it goes wrong."""

import hashlib
import json
import re
import sys
from collections import Counter
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("cadquery", reason="the parts are drawn with CadQuery: pip install 'probedesign[cad]'")

import cadquery as cq
import trimesh

from probedesign import cad
from probedesign.cad import export_parts
from probedesign.cad.exchange import reproducible, step_bytes
from probedesign.cad.kernel import location
from probedesign.cad.model import CadModel
from probedesign.core.errors import InputError, MissingDependencyError
from probedesign.design import Design
from probedesign.frozen_probe import freeze
from probedesign.geometry.mass import MassProperties, combined, flexible_part
from probedesign.mount import Mount, build_geometry, mount_mass_properties, sensor_adapter_for
from probedesign.probe import build_probe
from tests.cad.conftest import LARGE, OTHERS, design_of, files_of, with_probe

FILES = {
    "probe.stl", "sensor_adapter.stl", "clamp_ring.stl", "flange_adapter.stl",
    "probe.step", "sensor_adapter.step", "clamp_ring.step", "flange_adapter.step",
    "assembly.step", "assembly.glb", "probe.3mf", "adapters.3mf", "manifest.json",
    "probe.svg", "sensor_adapter.svg", "clamp_ring.svg", "flange_adapter.svg",
    "exploded.svg", "assembly.html", "bill_of_materials.csv",
}  # fmt: skip

Exported = tuple[Path, dict[str, Any]]


def test_files_and_their_digests(exported: Exported) -> None:
    folder, returned = exported
    assert {p.name for p in folder.iterdir()} == FILES
    assert [p.name for p in folder.parent.iterdir()] == [folder.name]  # no staging folder left
    manifest = json.loads((folder / "manifest.json").read_text("utf-8"))
    assert returned == {**manifest, "folder": str(folder)}
    assert set(manifest["files"]) == FILES - {"manifest.json"}
    for name, record in manifest["files"].items():
        content = (folder / name).read_bytes()
        assert hashlib.sha256(content).hexdigest() == record["sha256"] and len(content) == record["size_bytes"]


def test_manifest_describes_the_export(exported: Exported) -> None:
    _, manifest = exported
    design = design_of()
    assert manifest["schema"] == 1 and manifest["name"] == "large"
    assert manifest["fingerprint"] == build_geometry(design).fingerprint
    assert Design.model_validate_json(json.dumps(manifest["design"])) == design  # the echo is the design
    assert set(design.assumptions) <= set(manifest["assumptions"])
    assert all(finding["ok"] for finding in manifest["verification"].values())
    assert all(volume == 0.0 for volume in manifest["intersections_m3"].values())
    for screw in manifest["screws"]:
        low, high = screw["entry_allowed_mm"]
        assert low <= screw["entry_mm"] <= high
    prints = manifest["fingerprints"]
    assert prints == Mount.of(design_of()).fingerprints and prints["probe"] == manifest["fingerprint"]
    assert len(set(prints.values())) == 5  # four parts and the payload
    assert manifest["clamp"]["pressed_share"] == pytest.approx(0.8, abs=0.005)
    check = manifest["print_check"]
    assert check["ok"] and check["errors"] == 0 and check["warnings"] == len(check["findings"])
    assert manifest["print_scale"]["probe"] == [1.0, 1.0, 1.0]
    assert manifest["base"]["root_rigid_radii"] == -0.18  # that of hold = "clamped"
    assert manifest["base"]["root_rigid_radii_computed"] == pytest.approx(-0.18, abs=0.01)  # Ø12 mm


def test_manifest_masses_equal_those_of_the_mechanics(exported: Exported) -> None:
    _, manifest = exported
    design = design_of()
    geometry = build_geometry(design)
    adapter = sensor_adapter_for(geometry, design.sensor_model, design.name)
    rigid = mount_mass_properties(geometry, adapter, design.density.value)
    whole = combined([rigid, flexible_part(geometry, design.density.value).moved(adapter.T_sensor_base)])
    for name, formula in (("rigid", rigid), ("whole", whole)):
        record = manifest["mass"][name]
        drawn = MassProperties(*(np.array(record[k]) for k in ("volume_m3", "mass_kg", "p_com_m", "inertia_kg_m2")))
        # Solids and formulae agree to 1e-9; the centre is compared on the scale of the body, 10 mm.
        assert drawn.mass == pytest.approx(formula.mass, rel=1e-9)
        assert drawn.p_com == pytest.approx(formula.p_com, abs=1e-11)
        assert drawn.inertia == pytest.approx(formula.inertia, abs=1e-9 * formula.inertia.max())
    assert np.array(manifest["T_sensor_base"]) == pytest.approx(adapter.T_sensor_base, abs=1e-12)
    frozen = freeze(build_probe(design).model)  # what the estimator subtracts, engraving and all
    assert frozen["T_sensor_base"] == adapter.T_sensor_base.tolist()
    assert np.array(manifest["T_robotflange_base"]) == pytest.approx(np.array(frozen["T_robotflange_base"]), abs=1e-12)
    assert frozen["hanging"]["mass_kg"] == rigid.mass and frozen["hanging"]["p_com_m"] == rigid.p_com.tolist()
    assert frozen["hanging"]["inertia_kg_m2"] == rigid.inertia.tolist()


def test_the_manifest_states_what_the_robot_carries_and_where_the_base_is(exported: Exported) -> None:
    _, manifest = exported
    robot, whole, sensor = manifest["robot"], manifest["mass"]["whole"], manifest["sensor"]
    T = np.array(manifest["T_robotflange_base"])
    turn = Rotation.from_rotvec(robot["base_rotation_vector_rad"]).as_matrix()
    assert turn == pytest.approx(T[:3, :3], abs=1e-9) and robot["base_turn_about_z_deg"] == pytest.approx(-60.0)
    assert robot["base_mm"] == pytest.approx(1e3 * T[:3, 3], abs=1e-6) and robot["base_mm"][2] == pytest.approx(29.5)
    of_robot = {"flange_adapter", "mounting_screws", "robot_bolts", "centring_pins"}
    listed = [item for item in manifest["bill_of_materials"] if item["name"] in of_robot]
    assert len(listed) == len(of_robot)
    plate = 1e-3 * sum(item["quantity"] * item["mass_g"] for item in listed)  # to three digits
    assert robot["mass_kg"] == pytest.approx(whole["mass_kg"] + sensor["mass_kg"] + plate, rel=0.005)
    # All lies between the points of the robot's bolts and the tip.
    assert -0.01 < robot["p_com_m"][2] < T[2, 3] + 0.15
    assert np.linalg.eigvalsh(robot["inertia_kg_m2"])[0] > 0.0


def test_probe_stl_is_in_millimetres_in_the_base_frame(exported: Exported) -> None:
    mesh = trimesh.load(exported[0] / "probe.stl")
    assert mesh.is_watertight and mesh.is_winding_consistent
    # Single precision at 150 mm is 8e-6 mm.
    assert mesh.bounds == pytest.approx(np.array([[-9.5, -9.5, -3.0], [9.5, 9.5, 150.0]]), abs=0.02)
    assert mesh.bounds[:, 2] == pytest.approx([-3.0, 150.0], abs=1e-5)
    above = mesh.vertices[mesh.vertices[:, 2] > 1e-3]
    radius = np.hypot(above[:, 0], above[:, 1])
    cone = 6.0 - above[:, 2] * (5.0 / 150.0)
    assert (radius <= cone + 1e-5).all()  # facets lie inside the cone, corners on it


def test_step_has_one_product_per_part_and_its_instances_in_place(exported: Exported, large: CadModel) -> None:
    """Read by the kernel's own reader of assemblies."""
    path = exported[0] / "assembly.step"
    products = re.findall(r"= PRODUCT\(\s*'([^']*)'", path.read_text("ascii"))
    assert products[0] == "large"
    assert Counter(products[1:]) == Counter({part.standard or part.name for part in large.parts.values()})
    assert "ISO 4762 M2x6" in products  # of three groups of screws
    read = cq.Assembly.importStep(str(path))
    placed = {name: (part, T) for part in large.parts.values() for name, T in part.Ts_sensor_piece.items()}
    assert read.name == "large" and {child.name for child in read.children} == set(placed)
    assert len(read.children) == sum(len(part.places) for part in large.parts.values())
    for child in read.children:
        part, T = placed[child.name]
        # STEP writes some fifteen digits; kernel and file agree to about 1e-12.
        assert np.allclose(matrix_of(child.loc), matrix_of(location(T)), atol=1e-9)
        assert child.obj.Volume() == pytest.approx(part.shape.Volume(), rel=1e-9)
        assert child.obj.Center().toTuple() == pytest.approx(part.shape.Center().toTuple(), abs=1e-9)
        assert child.color.toTuple() == pytest.approx((*part.color, 1.0), abs=1e-6)  # single precision


def test_step_of_a_part_is_its_solid_in_its_frame(exported: Exported, large: CadModel) -> None:
    for part in large.printed:
        path = exported[0] / f"{part.name}.step"
        assert re.findall(r"= PRODUCT\(\s*'([^']*)'", path.read_text("ascii")) == [part.name]
        (solid,) = cq.importers.importStep(str(path)).solids().vals()
        assert solid.isValid()
        volume = 1e9 * exported[1]["parts"][part.name]["volume_m3"]
        assert solid.Volume() == pytest.approx(volume, rel=1e-9)  # some fifteen digits
        assert solid.Center().toTuple() == pytest.approx(part.shape.Center().toTuple(), abs=1e-9)


def test_step_header_names_file_design_program_and_date(exported: Exported, large: CadModel) -> None:
    def header_of(content: bytes) -> tuple[list[str], str, list[str]]:
        head = content.decode("ascii").partition("ENDSEC;")[0].replace("\n", "")
        fields = [re.search(rf"{name}\((.*?)\);", head) for name in ("FILE_DESCRIPTION", "FILE_NAME")]
        about, name = (re.findall(r"'([^']*)'", field[1]) for field in fields if field)
        return about, name[1], [name[0], *name[2:]]

    for file in ("assembly.step", "probe.step"):
        about, time, (name, author, organization, translator, program, _) = header_of((exported[0] / file).read_bytes())
        assert name == file and author and organization and "Open CASCADE" in translator
        assert program == f"probedesign {version('probedesign')}"
        assert about[0].startswith("large: ") and large.geometry.fingerprint in about[0]
        assert time == "1970-01-01T00:00:00"  # the design has no date
    ring = cq.Assembly(large.parts["clamp_ring"].shape, name="clamp_ring")
    dated = step_bytes(ring, "ring.step", "a ring", "2026-01-31")
    assert header_of(dated)[1] == "2026-01-31T00:00:00"


def test_glb_is_in_metres_with_y_up(exported: Exported, large: CadModel) -> None:
    """As the standard of glTF requires; nodes are named as the pieces and share the mesh of their product."""
    scene = trimesh.load(exported[0] / "assembly.glb")
    names = {name for part in large.parts.values() for name in part.Ts_sensor_piece}
    assert names <= set(scene.graph.nodes_geometry)
    boxes = np.array([part.box for part in large.parts.values()])
    low, high = 1e-3 * boxes[:, 0].min(axis=0), 1e-3 * boxes[:, 1].max(axis=0)
    # Facets lie inside by at most 0.02 mm, where their corners do not touch the box.
    assert scene.bounds == pytest.approx(np.array([[low[0], low[2], -high[1]], [high[0], high[2], -low[1]]]), abs=1e-4)
    T, geometry = scene.graph.get("clamp_ring")
    mesh = scene.geometry[geometry].copy().apply_transform(T)
    mesh.merge_vertices(merge_norm=True)
    volume = exported[1]["parts"]["clamp_ring"]["volume_m3"]
    assert mesh.is_watertight and mesh.volume == pytest.approx(volume, rel=0.01)  # coarse facets
    assert mesh.bounds[0][1] == pytest.approx(large.adapter.T_sensor_base[2, 3], abs=1e-6)  # z is y
    colour = np.array(scene.geometry[geometry].visual.material.baseColorFactor[:3]) / 255.0
    srgb = np.array(large.parts["clamp_ring"].color)
    assert colour == pytest.approx(((srgb + 0.055) / 1.055) ** 2.4, abs=0.01)  # linear, of 256 levels


def matrix_of(place: cq.Location) -> np.ndarray:
    """(3, 4), in millimetres."""
    transform = place.wrapped.Transformation()
    return np.array([[transform.Value(i, j) for j in range(1, 5)] for i in range(1, 4)])


@pytest.mark.usefixtures("large")  # whose solids the kernel has drawn already
def test_exports_are_reproducible(exported: Exported, tmp_path: Path) -> None:
    """Every file, manifest included, has the same bytes in another process."""
    export_parts(design_of(), tmp_path / "large")
    assert {path.name for path in (tmp_path / "large").iterdir()} == FILES
    for path in (tmp_path / "large").iterdir():
        assert path.read_bytes() == (exported[0] / path.name).read_bytes(), path.name


@pytest.mark.parametrize("section", OTHERS)
def test_files_of_other_sections_are_reproducible(section: str, large: CadModel, exported: Exported) -> None:
    """The kernel keeps one of two coincident vertices by its address, which differs between processes."""
    made = exported[0].parents[1]
    for kind, content in files_of(large, OTHERS[section]).items():
        assert content == (made / f"{section}.{kind}").read_bytes(), kind
    thickness = 6.0 if section == "hollow" else 3.6
    mesh = trimesh.load(made / f"{section}.stl")
    assert mesh.is_watertight and mesh.is_winding_consistent
    above = mesh.vertices[mesh.vertices[:, 2] > -1e-3]
    near = above[np.hypot(above[:, 0], above[:, 1]) < 6.1]  # without the flange's rim
    # Facets have their corners on the body, and one at each end of both axes; single precision.
    assert abs(near[:, :2]).max(axis=0) == pytest.approx([6.0, thickness], abs=1e-5)
    # A hollow body has a handle: its surface is that of a torus. The clocking mark is another one.
    assert mesh.euler_number == (2 - 2 * 2 if section == "hollow" else 2 - 2 * 1)
    (solid,) = cq.importers.importStep(str(made / f"{section}.step")).solids().vals()
    # STEP writes some fifteen digits; kernel and file agree to about 1e-12.
    wanted = with_probe(large, design_of(OTHERS[section])).parts["probe"].shape.Volume()
    assert solid.Volume() == pytest.approx(wanted, rel=1e-9)


def test_scale_compensation_reaches_the_files_to_print_and_nothing_else(
    exported: Exported, large: CadModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scaled = design_of(f"{LARGE}\n[print]\nscale_xy = 1.02\nscale_z = 0.99\nrigid_scale_xy = 1.01\n")
    assert Mount.of(scaled).fingerprints == large.fingerprints  # the drawn parts are those of the design
    for name, value in {"build_cad": replace(large, design=scaled), "verify": {}, "cad_files": {},
                        "build_documents": ({}, [])}.items():  # fmt: skip
        monkeypatch.setattr(f"probedesign.cad.export.{name}", lambda *_, value=value: value)
    (folder, drawn), printed = exported, export_parts(scaled, tmp_path / "printed")
    for name, factor in (("probe", (1.02, 1.02, 0.99)), ("clamp_ring", (1.01, 1.01, 1.0))):
        a, b = (trimesh.load(parent / f"{name}.stl") for parent in (folder, tmp_path / "printed"))
        # Both are written in single precision, 150 mm to half of 1.5e-5 mm.
        assert b.bounds == pytest.approx(a.bounds * np.array(factor), abs=2e-5)
        assert printed["print_scale"][name] == list(factor)
        assert b.is_watertight and b.is_winding_consistent
    head = f"probedesign {drawn['fingerprint']} scaled 1.02 1.02 0.99 large"
    assert (tmp_path / "printed" / "probe.stl").read_bytes()[:80].startswith(head.encode())
    package = trimesh.load(tmp_path / "printed" / "probe.3mf", force="mesh")
    # On the plate, flange below; 3MF rounds to decimals.
    assert package.bounds[1][2] - package.bounds[0][2] == pytest.approx(0.99 * 153.0, abs=1e-4)
    for untouched in ("fingerprint", "parts", "mass", "T_sensor_base", "screws"):
        assert printed[untouched] == drawn[untouched]


def test_a_step_file_does_not_depend_on_the_order_in_which_the_kernel_writes_styles() -> None:
    blocks, swapped = (
        [
            f"#{n} = MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION('',(\n    #{n + 1}),#{shape});\n"
            f"#{n + 1} = STYLED_ITEM('color',(#{n + 2}),#{shape - 1});\n#{n + 2} = STYLE(#103);\n"
            for n, shape in zip((100, 104), shapes, strict=True)
        ]
        for shapes in ((20, 10), (10, 20))
    )
    files = [f"HEADER;\n#9 = SHAPE();\n{one}#103 = RGB(0.5);\n{two}ENDSEC;\nEND;\n" for one, two in (blocks, swapped)]
    assert reproducible(files[0]) == reproducible(files[1])
    assert reproducible(files[0]).count("#20") == 1 and "#9 = SHAPE" in reproducible(files[0])


def test_a_target_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("mine")
    for target in (file, file / "below"):
        with pytest.raises(InputError) as error:
            export_parts(design_of(), target)
        assert "\n" not in str(error.value) and str(target) in str(error.value)
    assert file.read_text() == "mine" and list(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize("package", ["cadquery", "lib3mf", "PIL"])
def test_a_missing_package_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: str) -> None:
    for name in [name for name in sys.modules if name.startswith("probedesign.cad.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingDependencyError, match=r"^export needs .*pip install 'probedesign\[cad\]'$"):
        cad.export_parts(design_of(), tmp_path / "large")
    assert list(tmp_path.iterdir()) == []
