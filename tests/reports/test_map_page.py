"""Tests of the map as a page and as a picture."""

import re

import numpy as np
import pytest

from probedesign.mapping.contact_map import build_map, map_csv, map_lines, map_ply
from probedesign.reports.map_page import MapScene, map_page, map_svg
from probedesign.simulation.scenes import SOURCE, card_house, touch_targets, true_outlines
from tests.mapping.synthetic_touches import STD_E, touch

OUTLINE = b'fill-opacity="0.10"'  #: What only the outline of a touched object has.


def test_the_picture_contains_every_ellipsoid():
    """The ellipsoids of two vague points are longer than the distance between the points."""
    picture = map_svg(MapScene(build_map([touch(1, (0, 0, 0), 5e-3), touch(2, (20e-3, 0, 0), 5e-3)], STD_E))).decode()
    width, height = map(float, re.findall(r'<rect width="([\d.]+)" height="([\d.]+)"', picture)[0])
    found = re.findall(r'translate\(([\d.-]+) ([\d.-]+)\) rotate.*?rx="([\d.]+)" ry="([\d.]+)"', picture)
    assert len(found) == 2
    for x, y, rx, ry in (map(float, numbers) for numbers in found):
        extent = min(rx, ry)  # for any rotation it extends so far
        assert extent < x < width - extent and extent < y < height - extent


def test_zeros_have_no_sign():
    """A nanometre to the left of the origin, printed with two to four decimals of a millimetre."""
    contact_map = build_map([touch(1, (-1e-9, -1e-9, -0.0), 0.2e-3)], STD_E)
    for text in (*map_lines(contact_map), map_csv(contact_map).decode(), map_ply(contact_map, "").decode()):
        assert not re.search(r"-0(\.0*)?\b(?![.\d])", text)
    cells = re.findall(r"<td>(.*?)</td>", map_page(MapScene(contact_map), "Points", []).decode())
    assert cells[1:4] == ["0.00", "0.00", "0.00"]


@pytest.mark.parametrize(("std", "times"), [(5e-3, 1), (0.5e-3, 5), (0.1e-3, 10)])
def test_ellipsoids_are_magnified_until_they_are_visible(std, times):
    """Two points 200 mm apart; a half-axis of 2.8 deviations is to be 2 mm, a fiftieth of the scene's radius."""
    scene = MapScene(build_map([touch(i, ((-1) ** i * 0.1, 0, 0), std, lever=0.0) for i in (1, 2)], STD_E))
    assert scene.magnification == times
    stated = "in scale" if times == 1 else f"drawn {times} times as large"
    assert stated in map_svg(scene).decode()
    assert f'value="{times}" checked' in map_page(scene, "Points", []).decode()


def test_the_truth_is_drawn_only_where_it_is_known():
    """The recording of a simulated run states its source; the targets lie on the drawn edges."""
    contact_map = build_map([touch(1, (0, 0, 0), 0.2e-3)], STD_E)
    known, unknown = (
        MapScene(contact_map, true_outlines(SOURCE)),
        MapScene(contact_map, true_outlines("netft://192.168.1.1")),
    )
    for draw in (map_svg, lambda scene: map_page(scene, "Points", [])):
        assert draw(known).count(OUTLINE) == len(card_house()) and b"simulated truth" in draw(known)
        assert OUTLINE not in draw(unknown) and b"truth, not measured" not in draw(unknown)
    for target in touch_targets():
        offsets = [np.cross(target.p_world - card[0], _along(card)) for card in known.truth]
        assert min(np.linalg.norm(offset) for offset in offsets) < 1e-12  # rounding


def _along(card):
    return (card[1] - card[0]) / np.linalg.norm(card[1] - card[0])
