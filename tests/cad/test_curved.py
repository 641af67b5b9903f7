"""Test the solid of a curved probe: closed forms, quadrature, points of its surface, meshes and the mount."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

pytest.importorskip("cadquery", reason="the parts are drawn with CadQuery: pip install 'probedesign[cad]'")

import cadquery as cq
import trimesh

from probedesign import new
from probedesign.cad import export_part, export_parts
from probedesign.cad.exchange import step_bytes
from probedesign.cad.kernel import mass_properties
from probedesign.cad.mesh import tessellate
from probedesign.cad.solids import probe_solid
from probedesign.core.errors import InputError
from probedesign.core.frames import Array
from probedesign.geometry import ProbeGeometry
from probedesign.geometry.mass import combined, flexible_part
from probedesign.mount import Mount
from probedesign.mount.mass import mount_part_masses
from probedesign.printing.check import bounds, check_print, support_scar
from tests.cad.conftest import design_of

ARC = 'axis = "arc"\naxis_bend_deg = 90.0\naxis_azimuth_deg = -90.0\n'
HELIX = 'axis = "helix"\naxis_bend_deg = 214.86\naxis_turns = 1.0\naxis_azimuth_deg = -90.0\n'
KNOTS = 'axis = "knots"\naxis_knots_mm_1_m = [[0, 0, 0], [60, 15, 5], [150, -10, 10]]\n'
CONE = "length_mm = 150.0\nbase_d_mm = 12.0\ntip_d_mm = 2.0\n"
PROFILE = (
    'shape = "profile"\nlength_mm = 150.0\nbase_d_mm = 12.0\ntip = "rounded"\nbase_fillet_mm = 2.0\n'
    "profile_mm = [[0, 12], [40, 12.5], [60, 7], [150, 4]]\n"
)
HOLLOW = 'section = "hollow"\nbore_ratio = 0.5\nlength_mm = 150.0\nbase_d_mm = 12.0\ntip_d_mm = 6.0\n'
ELLIPTIC = 'section = "elliptic"\nflatness = 0.6\nlength_mm = 150.0\nbase_d_mm = 12.0\ntip_d_mm = 4.0\n'
PROBES = {"arc": PROFILE + ARC, "elliptic helix": ELLIPTIC + HELIX, "hollow, knots": HOLLOW + KNOTS}


@pytest.fixture(scope="module", params=PROBES)
def drawn(request: Any) -> tuple[Mount, cq.Solid, cq.Solid]:
    """A curved probe: its mount, its solid, and the one with ruled faces that has the facets."""
    mount = Mount.of(design_of(PROBES[request.param]))
    return mount, *(probe_solid(mount.geometry, mount.sensor_adapter, ruled) for ruled in (False, True))


def test_volume_centre_and_inertia_agree_with_quadrature(drawn: tuple[Mount, cq.Solid, cq.Solid]) -> None:
    mount, solid, _ = drawn
    flange = mount_part_masses(mount.geometry, mount.sensor_adapter, 1010.0)["flange"]
    wanted = combined([flexible_part(mount.geometry, 1010.0), flange.moved(np.linalg.inv(
        mount.sensor_adapter.T_sensor_base))])  # fmt: skip
    body = mass_properties(solid, 1010.0)
    assert body.volume == pytest.approx(wanted.volume, rel=1e-5)  # the kernel's quadrature: 1e-6 on a helix
    np.testing.assert_allclose(body.p_com, wanted.p_com, atol=1e-5 * mount.geometry.length)
    np.testing.assert_allclose(body.inertia, wanted.inertia, atol=1e-5 * np.abs(wanted.inertia).max())


def test_a_bent_cylinder_is_a_sector_of_a_torus() -> None:
    """Pappus: the volume is π r² L; the centroid lies (R + r²/(4R)) sin(φ/2)/(φ/2) from the axis of the torus."""
    mount = Mount.of(design_of('shape = "cylinder"\nlength_mm = 100.0\nbase_d_mm = 8.0\naxis = "arc"\n'
                               "axis_bend_deg = 120.0\n"))  # fmt: skip
    solid, a = probe_solid(mount.geometry, mount.sensor_adapter), mount.sensor_adapter
    flexible = max(solid.split(cq.Face.makePlane(100.0, 100.0)).Solids(), key=lambda part: part.Center().z)
    r, phi, L = 4e-3, np.radians(120.0), 0.1
    R, body = L / phi, mass_properties(flexible, 1.0)
    assert body.volume == pytest.approx(np.pi * r**2 * L, rel=1e-6)
    reach = (R + r**2 / (4.0 * R)) * np.sin(phi / 2.0) / (phi / 2.0)
    np.testing.assert_allclose(body.p_com, [R - reach * np.cos(phi / 2.0), 0.0, reach * np.sin(phi / 2.0)], atol=1e-7)
    assert a.ring_bore_d == pytest.approx(9e-3)  # the mount is that of the straight probe


def surface(geometry: ProbeGeometry, s: Array, side: float) -> Array:
    """Points of the tube at an angle around the sections [m]."""
    T, r = geometry.axis.frames(s), geometry.radius_at(s)[:, None]
    around = np.cos(side) * T[:, :3, 0] + geometry.cross_section.flatness * np.sin(side) * T[:, :3, 1]
    return np.asarray(T[:, :3, 3] + r * around)


def test_the_surface_read_from_step_lies_on_the_tube_between_the_knots_and_at_kinks(
    drawn: tuple[Mount, cq.Solid, cq.Solid], tmp_path: Path
) -> None:
    mount, solid, _ = drawn
    file = tmp_path / "probe.step"
    file.write_bytes(step_bytes(cq.Assembly(solid, name="probe", color=cq.Color(1, 1, 1)), "probe.step", "", None))
    read = cq.importers.importStep(str(file)).val()
    assert read.isValid() and read.Volume() == pytest.approx(solid.Volume(), rel=1e-9)
    g, shell = mount.geometry, read.Shells()[0]
    s = np.unique([*np.linspace(0.013, 0.987, 5) * g.length, *g.s[g.s < 0.9 * g.flank_end][1:4]])
    for side in (0.3, 2.5, 4.4):
        away = [shell.distance(cq.Vertex.makeVertex(*p)) for p in 1e3 * surface(g, s, side)]
        assert max(away) < 1e-3  # a micrometre: the splines are within 0.1 µm


def test_the_mesh_is_closed_and_close_to_the_solid(drawn: tuple[Mount, cq.Solid, cq.Solid]) -> None:
    mount, solid, ruled = drawn
    mesh, g = tessellate(ruled), mount.geometry
    assert mesh.is_volume
    assert mesh.volume == pytest.approx(solid.Volume(), rel=5e-4)  # as for straight probes
    s = np.linspace(0.0, g.length, 4001)
    T = g.axis.frames(s)
    p = mesh.vertices[mesh.edges_unique].mean(axis=1)  # the middles of edges are deepest
    away, i = cKDTree(T[:, :3, 3]).query(p / 1e3)
    if g.cross_section.full_round:
        flank = (p[:, 2] > 2.5) & (s[i] < 0.98 * g.flank_end)
        depth = 1e3 * (g.radius_at(s[i]) - away)[flank]
        # A chord of 0.01 mm around and of 0.005 mm along; the taper's cosine makes the distance up to 0.01 mm less.
        assert np.abs(depth).max() < 0.03


def test_a_body_that_would_touch_the_clamp_ring_is_refused_with_the_largest_bend() -> None:
    """A half circle whose tip comes down onto the ring: a smaller bend keeps it above."""
    text = 'length_mm = 25.0\nbase_d_mm = 4.0\ntip_d_mm = 2.0\naxis = "arc"\naxis_azimuth_deg = 45.0\naxis_bend_deg = '
    with pytest.raises(InputError, match=r"axis_bend_deg = 179 bends the body .* touches .* at most ([\d.]+), a radius"
                       ) as refused:  # fmt: skip
        _ = Mount.of(design_of(f"{text}179.0\n")).sensor_adapter
    most = float(str(refused.value).split("at most ")[1].split(",")[0])
    _ = Mount.of(design_of(f"{text}{most}\n")).sensor_adapter
    with pytest.raises(InputError, match="touches"):
        _ = Mount.of(design_of(f"{text}{most + 1.0}\n")).sensor_adapter


@pytest.mark.parametrize("probe", [CONE + ARC, ELLIPTIC + HELIX, CONE])
def test_the_box_of_the_print_is_that_of_the_mesh_and_lies_in_the_middle_of_the_platform(probe: str) -> None:
    design = design_of(probe)
    mount, check = Mount.of(design), check_print(design)
    box = 1e3 * bounds(mount.geometry)
    mesh = tessellate(probe_solid(mount.geometry, mount.sensor_adapter, ruled=True), 0.05, 0.3)
    np.testing.assert_allclose(mesh.bounds, box, atol=0.06)  # facets are up to 0.05 mm inside
    width, height = (next(f.measured for f in check.findings if f.what == what and f.part == "probe")
                     for what in ("width with its raft", "height with its supports"))  # fmt: skip
    sides = box[1] - box[0]
    assert (width, height) == (pytest.approx(max(sides[:2]) + 10.0), pytest.approx(sides[2] + 7.0))
    x, y = np.array(check.platforms[0]["probe"]) + box.mean(axis=0)[:2]
    assert (x, y) == (pytest.approx(72.5, abs=1e-3), pytest.approx(72.5, abs=1e-3))  # of a Form 3's 145 mm


def test_scars_of_an_arc_lie_on_its_inner_side_and_leave_the_sides_across_its_plane() -> None:
    """An arc of 90° towards -y leans by 45° at half its length; from there on its inner side faces the platform."""
    scar = support_scar(Mount.of(design_of(CONE + ARC)).geometry, 2.32e6)
    assert scar is not None and scar.hangs
    assert scar.s_mm == (pytest.approx(75.0, abs=0.4), pytest.approx(150.0))
    assert scar.azimuth_deg == (-90.0, -90.0)
    assert scar.text.startswith("from s = 75 to 150 mm at -90° from the clocking mark")
    for axis in ("", ARC.replace("90.0\naxis_az", "40.0\naxis_az")):
        upright = support_scar(Mount.of(design_of(CONE + axis)).geometry, 2.32e6)
        assert upright is not None and not upright.hangs and upright.azimuth_deg == (180.0, 180.0)


def test_supports_lean_on_a_soft_probe_where_it_is_softer_than_the_longest_wire() -> None:
    """A cylinder deflects by F s³/(3 E I): 77 N/m of the wire Ø1.5 x 30 mm at s = (3 E I/77)^(1/3)."""
    cylinder = Mount.of(design_of('shape = "cylinder"\nlength_mm = 60.0\nbase_d_mm = 6.0\n')).geometry
    for modulus in (1e6, 3e6):
        scar = support_scar(cylinder, modulus)
        EI = modulus * np.pi / 64.0 * 6e-3**4
        assert scar is not None and scar.s_mm == (pytest.approx(1e3 * (3.0 * EI / 77.0) ** (1 / 3), rel=0.02), 60.0)
    assert support_scar(cylinder, 2.8e9) is None


@pytest.mark.slow
@pytest.mark.parametrize("probe", [PROFILE + ARC, CONE + HELIX])
def test_a_curved_probe_is_exported_with_all_its_checks(probe: str, tmp_path: Path) -> None:
    manifest = export_parts(design_of(probe), tmp_path / "curved")
    assert all(finding["ok"] for finding in manifest["verification"].values())
    assert {"probe.stl", "assembly.step", "assembly.glb", "probe.3mf", "probe.svg"} <= set(manifest["files"])
    design, sheet = design_of(probe), (tmp_path / "curved" / "probe.svg").read_text(encoding="utf-8")
    x, y, z = 1e3 * design.probe.designed_axis.frames([design.probe.designed_axis.length])[0, :3, 3]
    assert f"s = 150.0: {x:.2f}, {y:.2f}, {z:.2f};" in " ".join(sheet.split())


def test_one_part_of_a_curved_probe_is_written(tmp_path: Path) -> None:
    """Its facets are drawn on a solid that lacks 0.4 % of the volume; the mesh itself is that of the part."""
    design = new("arc", length_mm=60.0, base_d_mm=8.0, axis="arc", axis_bend_deg=60.0)
    assert export_part(design, "probe", tmp_path)["file"] == str(tmp_path / "probe.stl")
    assert trimesh.load_mesh(tmp_path / "probe.stl").is_watertight
