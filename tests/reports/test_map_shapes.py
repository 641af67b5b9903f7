"""The page of a map with shapes and the suggested touch."""

import io
import json
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import trimesh

from benchmarks.shapes import draw_touches, object_of
from probedesign.core.units import MM
from probedesign.mapping.contact_map import build_map
from probedesign.mapping.shapes import KINDS, ShapeFit
from probedesign.mapping.touch_point import LocatedTouch
from probedesign.reports.map_page import MapScene, map_mesh, map_page, map_svg
from tests.mapping.synthetic_touches import STD_E, touch


def test_shapes_of_each_kind_and_the_next_touch_are_drawn_and_listed():
    rng, shapes = np.random.default_rng(1), []
    for kind in KINDS:
        touches, _ = draw_touches(object_of(kind, rng), 12, rng)
        shapes.append(ShapeFit(touches).best_of(kind, touches, rng))
    ghost = np.array([[0.0, 0.0, 0.0, 6e-3], [0.0, 0.0, 0.15, 1e-3]])
    lines = tuple(shape.text for shape in shapes)
    scene = MapScene(build_map([touch(1, (0, 0, 0), 5e-3)], STD_E), (), tuple(shapes), lines, ghost)
    page = map_page(scene, "Points", []).decode()
    data = json.loads(re.search(r'id="data">(.*?)</script>', page).group(1))
    assert len(data["shapes"]) == len(KINDS)
    assert data["ghost"][-1] == [0.0, 0.0, 150.0, 1.0]
    for shape in data["shapes"]:
        assert np.isfinite(np.concatenate([np.ravel(line) for line in shape["lines"]])).all()
        assert len(shape["ends"]) == len(shape["covs"])
    assert page.count("±") > len(KINDS)
    assert b"next touch" in map_svg(scene)
    solid = trimesh.load_mesh(io.BytesIO(map_mesh(scene)), file_type="ply")
    for shape in shapes:  # all of its touched part is beside its mesh, to the half width of its bar or ball
        assert (
            trimesh.proximity.closest_point_naive(solid, shape.ends / MM)[1].max() < max(1.0, shape.radius / MM) + 1e-3
        )
    assert len(np.unique(solid.visual.vertex_colors, axis=0)) == 2
    assert b"element vertex 0\n" in map_mesh(MapScene(build_map([], STD_E)))


def test_the_film_has_the_touches_of_all_probes_in_order_of_time():
    left, right = (replace(touch(number, (x, 0, 0), 0.02e-3), probe=probe)
                   for number, x, probe in ((1, 0.0, "left"), (2, 0.03, "right")))  # fmt: skip
    lost = LocatedTouch(SimpleNamespace(number=3, start=1.5), "too_light", probe="left")
    page = map_page(MapScene(build_map([right, left, lost], STD_E)), "Points", []).decode()
    data = json.loads(re.search(r'id="data">(.*?)</script>', page).group(1))
    assert [text for text, _ in data["film"]] == [
        "touch left 1 at 1.0 s: point 2", "touch left 3 at 1.5 s: too_light", "touch right 2 at 2.0 s: point 1",
    ]  # fmt: skip
    assert [point["step"] for point in data["points"]] == [2, 0]
    assert len({point["stroke"] for point in data["points"]}) == 2
    assert '<input type="range" min="1" max="3" value="3">' in page
