"""Pictures, drawings, the bill and the page of one export: read as text, as pixels, as a browser would."""

import csv
import io
import re
from dataclasses import replace
from html import unescape
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest

pytest.importorskip("cadquery", reason="the parts are drawn with CadQuery: pip install 'probedesign[cad]'")

import lib3mf
import trimesh

from probedesign.cad.documents import DOWN, assembly_page, assembly_steps, bill_of_materials, exploded_bodies
from probedesign.cad.inspection import inspection_sheets, probe_sheet
from probedesign.cad.model import CadModel, build_cad, overlaps
from probedesign.cad.render import BACKGROUND, RenderBody, camera_axes, fit_view, render_bodies, render_body
from probedesign.cad.sheet import EDGE, FRONT, HEIGHT, WIDTH, cut, seen
from probedesign.cad.solids import clamp_ring_solid
from probedesign.core.frames import pose
from probedesign.core.svg import Canvas
from probedesign.mount.engraving import Engraving
from probedesign.mount.sensor_adapter import RING_VENT_HEIGHT
from probedesign.mount.tolerance_stack import RESIN_PRESSURE, hand_torque, measurements
from probedesign.printing.check import RAFT_MARGIN
from tests.cad.conftest import LARGE, design_of, with_probe, without_engraving
from tests.reports.page_checks import browser, check_page

Exported = tuple[Path, dict[str, Any]]
PRINTED = ("probe", "sensor_adapter", "clamp_ring", "flange_adapter")
SVG = "{http://www.w3.org/2000/svg}"


# ---- bill of materials


def test_the_bill_lists_every_part(exported: Exported, large: CadModel) -> None:
    table = list(csv.DictReader(io.StringIO((exported[0] / "bill_of_materials.csv").read_text("utf-8"))))
    assert [row["number"] for row in table] == [str(i) for i in range(1, len(large.parts) + 1)]
    assert {row["name"]: int(row["quantity"]) for row in table} == {
        name: len(part.places) for name, part in large.parts.items()
    }
    rows = {row["name"]: row for row in table}
    for use in large.screws:
        assert rows[use.name]["what"] == f"ISO 4762 {use.screw.thread}x{1e3 * use.length:g}"
        assert float(rows[use.name]["length_mm"]) == pytest.approx(1e3 * use.length)
    for name in PRINTED:
        assert rows[name]["file"] in exported[1]["files"]
        # Three digits are written.
        assert float(rows[name]["mass_g"]) == pytest.approx(1e3 * exported[1]["parts"][name]["mass_kg"], rel=5e-3)
    assert rows["probe"]["material"] == "elastic-50a" and "rigid" in rows["clamp_ring"]["material"]
    assert len(exported[1]["bill_of_materials"]) == len(table)


def test_hand_torque_limits_the_pressure_on_the_resin(large: CadModel) -> None:
    """Torque over diameter and nut factor is the preload; it presses the ring under the head."""
    for use in large.screws:
        d, hole = (2e-3, 2.4e-3) if use.screw.thread == "M2" else (6e-3, 6.6e-3)
        preload = hand_torque(use.screw) / (0.2 * d)
        pressure = preload / (np.pi / 4 * (use.screw.head_d**2 - hole**2))
        assert 0.5 * RESIN_PRESSURE < pressure <= RESIN_PRESSURE  # one digit, rounded down
    # A tenth of what M2 in steel takes, 0.3 N·m: a table for steel does not apply.
    assert hand_torque(large.screws[0].screw) < 0.1


# ---- order of assembly


def test_every_part_is_mounted_onto_a_present_part(large: CadModel) -> None:
    present, moved = {"sensor", "sensor_adapter"}, set()  # the adapter is prepared on the bench
    for step in assembly_steps(large):
        for move in step.moves:
            assert move.onto in present | moved
            moved |= set(move.parts)
    assert moved == set(large.parts) - {"sensor"}


def test_the_bench_comes_first_and_the_robot_last_unless_the_adapter_covers_its_bolts(large: CadModel) -> None:
    """Pins into the sensor, nuts before the adapter is mounted; each measurement is asked for in one step."""
    steps = assembly_steps(large)
    order = [name for step in steps for name in step.parts]
    assert order.index("dowel_pins") < order.index("ring_nuts") < order.index("sensor_adapter")
    assert order[-1] == "robot_bolts" and all("N·m" in s.text for s in steps if any("screws" in n for n in s.parts))
    for row in measurements(large.adapter, large.plate):
        assert sum(row.what.startswith(step.measure or "-") for step in steps) == 1, row.what
    wide = replace(large, adapter=replace(large.adapter, body_d=45e-3))  # over the heads of bolts on 50 mm
    covered = [name for step in assembly_steps(wide) for name in step.parts]
    assert covered.index("robot_bolts") < covered.index("sensor_adapter")


def test_exploded_parts_do_not_overlap(large: CadModel) -> None:
    """Each move takes its parts clear of all that is fixed before, along the axis."""
    moves = [move for step in assembly_steps(large) for move in step.moves]
    bodies = {name: render_body(part) for name, part in large.parts.items()}
    seat = 1e3 * large.adapter.T_sensor_base[2, 3]
    apart = exploded_bodies(bodies, moves, seat)
    for name, body in apart.items():
        along = body.corners - bodies[name].corners
        assert np.ptp(along.reshape(-1, 3), axis=0) == pytest.approx(0.0, abs=1e-9)  # rigidly
        assert along[..., :2] == pytest.approx(0.0)
    for move in moves:
        for name in move.parts[:1]:  # the nuts go with their adapter
            low, high = apart[name].span
            onto = apart[move.onto].span
            if move.side == DOWN:
                assert high < onto[0]
            elif move.onto != "probe":  # what slips over the probe is drawn around it
                assert low > onto[1]
    lifts = {name: pose(p=[0.0, 0.0, 1e-3 * (apart[name].span[0] - bodies[name].span[0])]) for name in large.parts}
    moved = {name: replace(part, T_sensor_part=lifts[name] @ part.T_sensor_part) for name, part in large.parts.items()}
    assert max(overlaps(moved).values(), default=0.0) == 0.0


# ---- pictures


def box(x: float, y: float, z: float, at: tuple[float, float, float], colour: float) -> RenderBody:
    mesh = trimesh.creation.box((x, y, z), pose(p=list(at)))
    corners = mesh.triangles
    return RenderBody(corners, np.repeat(mesh.face_normals[:, None], 3, axis=1), (colour, colour, colour))


def test_pixels_cover_what_is_projected() -> None:
    """A ball of 10 mm, at any scale, is a disc of π·10² mm²; a level camera sees a box as a rectangle."""
    ball = trimesh.creation.icosphere(5, 10.0)
    body = RenderBody(ball.triangles, ball.vertex_normals[ball.faces], (0.8, 0.8, 0.8))
    view = fit_view([body], (400, 400))
    pixels, owners = render_bodies([body], view)
    height, width = owners.shape  # light comes from above left
    assert pixels[height // 4, width // 4].mean() > pixels[3 * height // 4, 3 * width // 4].mean() + 40
    covered = (owners != BACKGROUND).sum() / view.scale**2
    assert covered == pytest.approx(np.pi * 100.0, rel=5e-3)  # a pixel of a rim of 1200 is left to chance
    slab = box(20.0, 6.0, 30.0, (1.0, 2.0, 3.0), 0.5)
    view = fit_view([slab], (300, 300), axes=camera_axes(-90.0, 0.0))
    _, owners = render_bodies([slab], view)
    rows, columns = np.nonzero(owners != BACKGROUND)
    assert np.ptp(columns) + 1 == pytest.approx(20.0 * view.scale, abs=1.5)  # pixels
    assert np.ptp(rows) + 1 == pytest.approx(30.0 * view.scale, abs=1.5)


def test_the_nearer_body_hides_the_farther_one() -> None:
    near, far = box(4.0, 4.0, 4.0, (0.0, -20.0, 0.0), 0.2), box(8.0, 8.0, 8.0, (0.0, 20.0, 0.0), 0.9)
    for bodies in ([near, far], [far, near]):
        view = fit_view(bodies, (200, 200), axes=camera_axes(-90.0, 0.0))
        pixels, owners = render_bodies(bodies, view)
        middle = tuple(n // 2 for n in owners.shape)
        assert bodies[owners[middle]] is near
        assert (pixels[0, 0] == 0).all() and (pixels[middle][:3] < 120).all() and pixels[middle][3] == 255


# ---- drawings


def words_of(svg: bytes) -> list[str]:
    return [element.text or "" for element in ET.fromstring(svg).iter(f"{SVG}text")]


@pytest.fixture(scope="module")
def drawings(large: CadModel) -> dict[str, bytes]:
    return inspection_sheets(large)


def test_drawings_show_the_dimensions(large: CadModel, drawings: dict[str, bytes]) -> None:
    words = {name: words_of(drawings[f"{name}.svg"]) for name in PRINTED}
    assert {"150", "3", "⌀19", "⌀12 at s = 0", "⌀7 at s = 75", "⌀2 at s = 150"} <= set(words["probe"])
    a = large.adapter
    for d in (a.foot_d, a.recess_d, a.body_d):
        assert f"⌀{1e3 * d:g}" in words["sensor_adapter"]
    for height in (a.foot_height, a.body_top - a.floor, a.body_top):
        assert f"{round(1e3 * height, 2):g}" in words["sensor_adapter"]
    assert {f"⌀{1e3 * a.ring_bore_d:g}", f"⌀{1e3 * a.ring_bore_top_d:g}"} <= set(words["clamp_ring"])
    assert any(w.endswith("on ⌀12.5 at 60°, 180°, 300°") for w in words["sensor_adapter"])
    assert any("on ⌀50 at 45°, 135°, 225°, 315°" in w for w in words["flange_adapter"])
    for name in PRINTED:
        assert large.fingerprints[name] in "".join(words[name]) and f"{name}.stl" in "".join(words[name])
    for row in measurements(large.adapter, large.plate):
        part, _, what = row.what.partition(": ")
        if part.replace(" ", "_") in words:  # what calipers decide before the first screw
            text = " ".join(words[part.replace(" ", "_")])
            assert what in text and f"accept {1e3 * row.accept[0]:.2g}"[:-1] in text


def test_dimension_lines_have_their_length(drawings: dict[str, bytes]) -> None:
    """On the probe's sheet, scale 1 : 1: lines of 150, 19 and 3 mm of paper."""
    root = ET.fromstring(drawings["probe.svg"])
    assert any("scale 1 : 1" in words for words in words_of(drawings["probe.svg"]))
    lengths = []
    for path in root.iter(f"{SVG}path"):
        for line in path.get("d", "").split("M")[1:]:
            numbers = [float(n) for n in re.findall(r"-?[\d.]+", line)]
            if len(numbers) == 4:
                lengths.append(np.hypot(numbers[2] - numbers[0], numbers[3] - numbers[1]))
    for wanted in (150.0, 19.0, 3.0):
        # Both ends are written to a hundredth of a millimetre, so each is off by half of it at most.
        assert min(abs(length - wanted) for length in lengths) < 0.01 + 1e-9


def test_edges_are_those_of_the_solid(large: CadModel) -> None:
    probe = np.concatenate(seen(large.parts["probe"].shape, FRONT))
    assert probe.min(axis=0) == pytest.approx([-9.5, -3.0], abs=1e-6)
    assert probe.max(axis=0) == pytest.approx([9.5, 150.0], abs=1e-6)
    a = replace(large.adapter, on_ring=Engraving("", 0.0, (), 0.0))
    _, faces = cut(clamp_ring_solid(a))
    inner, outer, height = 1e3 * a.ring_bore_d / 2, 1e3 * a.body_d / 2, 1e3 * a.ring_thickness
    widening = 1e3 * (a.ring_bore_top_d - a.ring_bore_d) / 2
    area = (outer - inner) * height - widening * height / 2
    vent = 1e3 * RING_VENT_HEIGHT  # the notch below the section at +x, from the conical bore to the rim
    notch = (outer - inner) * vent - widening * vent**2 / (2.0 * height)
    drawn = sorted(abs(_area(loop)) for loops in faces for loop in loops)
    assert drawn == pytest.approx([area - notch, area], rel=1e-9)  # straight edges


def _area(loop: Any) -> float:
    x, y = loop[:, 0], loop[:, 1]
    return float(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1))) / 2


KNOTS = ", ".join(f"[{s:g}, {round(3 - 0.06 * s, 2):g}]" for s in np.arange(0.0, 30.1, 0.6).round(1))
ODD = {
    "thin, flat, many knots": "shape = 'profile'\nlength_mm = 30.0\nbase_d_mm = 3.0\nsection = 'elliptic'\n"
    f"flatness = 0.8\nprofile_mm = [{KNOTS}]",
    "long and wide": "length_mm = 400.0\nbase_d_mm = 25.0\ntip_d_mm = 3.0\nsection = 'hollow'\nbore_ratio = 0.5",
    "gamma": f'{LARGE}\n[sensor]\nmodel = "gamma"\n',
    "large": LARGE,
}


@pytest.mark.parametrize("probe", ODD.values(), ids=ODD)
def test_drawings_stay_in_their_frame_and_are_legible(probe: str) -> None:
    design = design_of(probe, "iso-9409-1-100-6-m8" if "gamma" in probe else "iso-9409-1-50-4-m6")
    model, longest = without_engraving(build_cad(design)), "name-of-" + 14 * "four"
    plate = replace(model.plate, on_plate=replace(model.plate.on_plate, text=f"{12 * '0'} {longest}"))
    model = replace(model, plate=plate, design=design.model_copy(update={"name": longest}))
    for name, sheet in inspection_sheets(model).items():
        root = ET.fromstring(sheet)
        texts = list(root.iter(f"{SVG}text"))
        low, high = np.swapaxes([_box(text) for text in texts], 0, 1)
        lines = [line for path in root.iter(f"{SVG}path") for line in _lines(path)]
        corners = np.concatenate([*lines, low, high])
        assert (corners >= EDGE).all() and (corners <= [WIDTH - EDGE, HEIGHT - EDGE]).all(), name
        apart = np.maximum(low[:, None] - high, low - high[:, None]).max(axis=2)
        close = [(texts[a].text, texts[b].text) for a, b in np.argwhere(apart <= 0.0) if a < b]
        assert close == [], name
        words = " ".join(text.text or "" for text in texts).replace("\u00a0", " ")
        if design.probe.profile_mm is not None and name == "probe.svg":
            assert all(f"{s:g}: {d:g}" in words for s, d in design.probe.profile_mm)  # every knot
        assert name != "sensor_adapter.svg" or "window" in words
        heights = sorted(float(text.get("y", "")) for text in texts if " at s = " in (text.text or ""))
        assert all(b - a > 3.0 for a, b in pairwise(heights))  # no note on another
        # an extension line through a value makes it illegible
        points = np.concatenate([np.linspace(*line, 400) for line in lines if len(line) == 2])
        for text, least, most in zip(texts, low, high, strict=True):
            assert not ((points > least) & (points < most)).all(axis=1).any(), (name, text.text)


def _lines(path: ET.Element) -> list[np.ndarray]:
    return [np.reshape([float(n) for n in re.findall(r"-?[\d.]+", line)], (-1, 2))
            for line in path.get("d", "").split("M")[1:]]  # fmt: skip


def _box(text: ET.Element) -> tuple[tuple[float, float], tuple[float, float]]:
    """Corners of a text of the usual width, capitals 0.7 high; a turned one reads upward."""
    x, y, size = (float(text.get(key, "")) for key in ("x", "y", "font-size"))
    wide, high = 0.5 * size * len(text.text or ""), 0.7 * size
    before = {"start": 0.0, "middle": wide / 2, "end": wide}[text.get("text-anchor", "start")]
    if text.get("transform"):
        return (x - high, y + before - wide), (x, y + before)
    return (x - before, y - high), (x - before + wide, y)


def test_the_title_block_is_complete(large: CadModel, exported: Exported, drawings: dict[str, bytes]) -> None:
    """Fingerprint, mass and date of the design, if it has one."""
    design = large.design.model_copy(update={"date": "2025-12-24", "owner": "A. & B. GmbH"})
    dated = {"probe.svg": bytes(probe_sheet(replace(large, design=design), large.parts["probe"]))}
    for drawn, date, owner in ((drawings, "", "not stated"), (dated, "2025-12-24", "A. & B. GmbH")):
        for number, (name, sheet) in enumerate(drawn.items(), 1):
            words = " ".join(words_of(sheet))
            part = name.removesuffix(".svg")
            grams, digits = 1e3 * exported[1]["parts"][part]["mass_kg"], large.fingerprints[part]
            assert all(text in words for text in (date, f"number {digits} · sheet {number} of 4",
                                                   f"owner: {owner}", f"{grams:.3g} g", "±0.15 mm"))  # fmt: skip


def test_sheets_of_odd_designs(large: CadModel) -> None:
    """A hollow probe is cut lengthwise; a rounded tip and a fillet have their radii, an elliptic one both widths."""

    def drawn(probe: str) -> str:
        model = with_probe(large, design_of(f"length_mm = 100.0\nbase_d_mm = 10.0\n{probe}"))
        return "\n".join(words_of(bytes(probe_sheet(model, model.parts["probe"]))))

    hollow = drawn("tip_d_mm = 4.0\nsection = 'hollow'\nbore_ratio = 0.5")
    assert "section in the plane y = 0" in hollow and "⌀7 / bore 3.5 at s = 50" in hollow
    # A cylinder rounded with its own radius, R = r; and a fillet.
    rounded = drawn("tip_d_mm = 10.0\ntip = 'rounded'\nbase_fillet_mm = 1.5")
    assert "R5," in rounded and "fillet R1.5" in rounded and "0.4 deep" in rounded
    elliptic = drawn("tip_d_mm = 4.0\nsection = 'elliptic'\nflatness = 0.6")
    assert "7 × 4.2 at s = 50" in elliptic and "plane y" not in elliptic


# ---- the page


def test_the_page_is_self_contained_and_has_warning_parts_steps_and_tools(exported: Exported, large: CadModel) -> None:
    text, steps = (exported[0] / "assembly.html").read_text("utf-8"), assembly_steps(large)
    fetched = re.findall(r'(?:src|href|srcset)="([^"]*)"', text)
    assert all(url.startswith("data:image/png;base64,") for url in fetched)
    assert len(fetched) == len(steps) + 1  # a picture a step, and the exploded one
    assert "<script" not in text and "@import" not in text and "url(" not in text
    words = " ".join(unescape(re.sub(r"<style.*?</style>|<[^>]*>", " ", text, flags=re.DOTALL)).split())
    assert words.index("by more than 3.5 mm destroys it") < words.index("Parts")  # before anything else
    assert f"{1e3 * large.adapter.T_sensor_base[2, 3]:.2f} mm above the tool face" in words
    assert "29.50 mm , turned by -60.0° about z" in words
    for item in bill_of_materials(large, steps):
        assert item.title in words and (item.file or item.what) in words
    for part in (*(step.text[1:] for step in steps), "hexagon key 1.5 mm (M2)", "hexagon key 5 mm (M6)", "calipers",
                 large.geometry.fingerprint, "assumed"):  # fmt: skip
        assert part in words
    for row in measurements(large.adapter, large.plate):
        assert row.what in words and row.otherwise in words


def test_the_page_is_legible_and_prints_on_five_sheets(exported: Exported) -> None:
    """Nothing is cut at 360 px or on paper."""
    file = exported[0] / "assembly.html"
    with browser() as running:
        assert check_page(running, file) == (5, [])


def test_names_from_outside_are_escaped(large: CadModel) -> None:
    model = replace(large, design=design_of().model_copy(update={"name": "<b>&"}))
    page = assembly_page(model, [], [], Canvas(1.0, 1.0), [], {}).decode()
    assert "<b>&" not in page and page.count("&lt;b&gt;&amp;: assembly") == 2  # title and heading


# ---- 3MF


def test_packages_lie_as_the_check_says(exported: Exported, large: CadModel) -> None:
    """A strict reader finds each part in its orientation, apart from the others, on the platform within its margin."""
    folder, manifest = exported
    check = manifest["print_check"]
    x, y, _ = large.design.printer.build_volume_mm
    for file, platform in zip(("probe.3mf", "adapters.3mf"), check["platforms"], strict=True):
        model = lib3mf.get_wrapper().CreateModel()
        reader = model.QueryReader("3mf")
        reader.SetStrictModeActive(True)
        reader.ReadFromBuffer((folder / file).read_bytes())
        assert reader.GetWarningCount() == 0 and model.GetUnit() == lib3mf.ModelUnit.MilliMeter
        items, boxes, names = model.GetBuildItems(), [], []
        while items.MoveNext():
            item = items.GetCurrent()
            body = model.GetMeshObjectByID(item.GetObjectResource().GetResourceID())
            names.append(name := body.GetName())
            assert item.GetPartNumber() == f"large-{manifest['fingerprints'][name]}-{name}"
            turn = np.array([list(row) for row in item.GetObjectTransform().Fields])
            assert turn[2].tolist() == check["orientation"][name]["z_direction"]
            assert turn[3, :2] == pytest.approx(platform[name], abs=1e-3)
            corners = np.array([list(vertex.Coordinates) for vertex in body.GetVertices()])
            drawn = trimesh.load(folder / f"{name}.stl")
            volume = manifest["parts"][name]["volume_m3"]
            assert drawn.is_volume and 1e-9 * drawn.volume == pytest.approx(volume, rel=5e-4)
            assert len(body.GetTriangleIndices()) == len(drawn.faces)
            assert corners.min(axis=0) == pytest.approx(drawn.bounds[0], abs=1e-3)  # 3MF cuts digits
            placed = corners @ turn[:3] + turn[3]
            low, high = placed.min(axis=0), placed.max(axis=0)
            assert low[2] == pytest.approx(0.0, abs=1e-4)  # on the platform
            assert (low[:2] >= RAFT_MARGIN - 0.01).all() and (high[:2] <= np.array([x, y]) - RAFT_MARGIN + 0.01).all()
            boxes.append((low, high))
        assert names == list(platform)
        for a, b in combinations(boxes, 2):
            gap = np.maximum(a[0] - b[1], b[0] - a[1])[:2].max()
            assert gap >= 4.99  # millimetres
        middle = (np.min(boxes, axis=(0, 1)) + np.max(boxes, axis=(0, 1))) / 2
        assert middle[:2] == pytest.approx([x / 2, y / 2], abs=0.6)  # the flat on a rim is not counted
