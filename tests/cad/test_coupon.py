"""The coupons: their solids against the sheet, and sheets that were filled in."""

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cadquery", reason="the parts are drawn with CadQuery: pip install 'probedesign[cad]'")

import cadquery as cq

from probedesign.cad import export_coupon
from probedesign.cad.mesh import printed_mesh, tessellate
from probedesign.cad.model import printed_solid
from probedesign.core.errors import InputError
from probedesign.design import Design, parse_design
from probedesign.identification.measured_print import read_calipers


def design_of(probe: str) -> Design:
    return parse_design(f'schema = 1\nname = "p"\n[probe]\n{probe}\n[print]\nscale_xy = 1.01\n')


CONE = design_of("length_mm = 150.0\nbase_d_mm = 12.0\ntip_d_mm = 2.0")
CYLINDER = design_of('shape = "cylinder"\nlength_mm = 80.0\nbase_d_mm = 6.0')


@pytest.mark.parametrize("design", [CONE, CYLINDER], ids=["cone", "cylinder"])
def test_solids_have_the_diameters_of_the_sheet(design: Design, tmp_path: Path) -> None:
    export_coupon(design, tmp_path / "coupon")
    text = (tmp_path / "coupon/coupon.csv").read_text("utf-8").splitlines()
    rows = list(csv.DictReader(line for line in text if not line.startswith("#")))
    assert next(row["drawn_mm"] for row in rows if row["part"] == "coupon_length") == "40"
    rows = [row for row in rows if row["part"] != "coupon_length"]  # heights, of the same solids
    solids = cq.importers.importStep(str(tmp_path / "coupon/coupon.step")).solids().vals()
    assert len(solids) == 2 and {row["part"] for row in rows} == {"coupon_steps", "coupon_rod"}
    steps, rod = sorted(solids, key=lambda solid: solid.BoundingBox().xmin)
    for row in rows:
        solid = steps if row["part"] == "coupon_steps" else rod
        x = solid.Center().x
        s, d = float(row["s_mm"]), float(row["drawn_mm"])
        slab = cq.Workplane(origin=(x, 0.0, s)).box(100.0, 100.0, 0.5).val()
        area = slab.intersect(solid).Volume() / 0.5
        assert area == pytest.approx(math.pi / 4 * d**2, rel=1e-6)  # drawn, not scaled


def test_sheet_of_the_probe_is_read_once_it_is_filled_in(tmp_path: Path) -> None:
    export_coupon(CONE, tmp_path / "coupon")
    sheet = tmp_path / "coupon/calipers.csv"
    with pytest.raises(InputError, match="empty"):
        read_calipers(sheet, CONE)
    sheet.write_text(sheet.read_text("utf-8").replace(",,,,drawn", ",7.0,7.0,,drawn"), "utf-8")
    assert len(read_calipers(sheet, CONE).s) == 14


def test_sheet_that_was_filled_in_is_not_replaced(tmp_path: Path) -> None:
    folder = tmp_path / "coupon"
    first = export_coupon(CONE, folder)
    assert export_coupon(CONE, folder) == first  # the same bytes twice
    sheet = folder / "calipers.csv"
    sheet.write_text(sheet.read_text("utf-8").replace("7.5,", "7.5,11.5", 1), "utf-8")
    filled = sheet.read_bytes()
    with pytest.raises(InputError, match="filled in"):
        export_coupon(CONE, folder)
    assert sheet.read_bytes() == filled and json.loads((folder / "manifest.json").read_bytes())["name"] == "p"


def test_files_of_another_kind_are_not_replaced(tmp_path: Path) -> None:
    """Each kind removes the files that the last of its kind left, which would be those of an export."""
    for kind in ({"kind": "export"}, {}):
        (tmp_path / "manifest.json").write_text(json.dumps({**kind, "files": {"probe.stl": {}}}), "utf-8")
        (tmp_path / "probe.stl").write_bytes(b"solid")
        with pytest.raises(InputError):
            export_coupon(CONE, tmp_path)
        assert sorted(path.name for path in tmp_path.iterdir()) == ["manifest.json", "probe.stl"]


@pytest.mark.parametrize("more", ["", 'section = "hollow"\nbore_ratio = 0.4\n', 'axis = "arc"\naxis_bend_deg = 60.0\n'])
def test_the_file_to_print_is_narrower_by_the_offset_and_then_scaled(more: str) -> None:
    text = f'schema = 1\nname = "p"\n[probe]\nlength_mm = 60.0\nbase_d_mm = 8.0\ntip_d_mm = 3.0\n{more}[print]\n'
    drawn, design = (parse_design(text + keys) for keys in ("", "offset_xy_mm = 0.1\nscale_z = 1.02\n"))
    mesh = tessellate(printed_solid(design, "probe"))
    moved = printed_mesh(design, "probe", mesh)
    assert moved.is_volume
    # The surface of the cone about s, a tube's area over its length, times half the offset; scaled along z.
    bore = 0.4 if "bore" in more else 0.0
    removed = math.pi * (8.0 + 3.0) / 2.0 * 60.0 * (1.0 + bore) * 0.05
    # second order: 0.05 mm of 1.5 to 4 mm of radius is 2 %; the rim at the base and the facets add less
    assert mesh.volume - moved.volume / 1.02 == pytest.approx(removed, rel=0.03)
    assert np.array_equal(printed_mesh(drawn, "probe", mesh).vertices, mesh.vertices)
