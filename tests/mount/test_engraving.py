"""Test the engraving: legible characters, distances between them and exact masses."""

from itertools import combinations

import numpy as np
import pytest

from probedesign.design import check_design
from probedesign.design.catalog import M2
from probedesign.design.sensor_catalog import SENSORS
from probedesign.geometry import ProbeGeometry
from probedesign.mount import SensorAdapter, build_geometry, sensor_adapter_for
from probedesign.mount.engraving import CELL, GLYPHS, ROWS, Engraving, cut_outlines, cut_runs, glyph_width
from probedesign.mount.sensor_adapter import WALL

BASES = [3.0, 10.0, 10.5, 12.0, 25.0]


def adapter_of(base_d: float, name: str = "large") -> SensorAdapter:
    return sensor_adapter_for(build_geometry_of(base_d), SENSORS["nano17"], name)


def build_geometry_of(base_d: float) -> ProbeGeometry:
    probe = {"length_mm": 150.0, "base_d_mm": base_d, "tip_d_mm": 2.0}
    return build_geometry(check_design({"schema": 1, "name": "x", "probe": probe}))


def test_no_two_characters_look_alike_and_all_are_five_high() -> None:
    drawn = {rows for character, rows in GLYPHS.items() if character in "bd" or not character.islower()}
    assert len(drawn) == len(set(GLYPHS.values())) == sum(c in "bd" or not c.islower() for c in GLYPHS)
    assert all(len(rows) == ROWS and len({len(row) for row in rows}) == 1 for rows in GLYPHS.values())
    assert set("0123456789abcdefghijklmnopqrstuvwxyz-_.") <= set(GLYPHS)  # all that names may hold


@pytest.mark.parametrize("character", GLYPHS)
def test_edges_enclose_the_cut_cells_and_never_meet_at_a_corner(character: str) -> None:
    cells = {(x, y) for start, end, y in cut_runs(character) for x in range(start, end)}
    drawn = {(x, ROWS - 1 - y) for y, row in enumerate(GLYPHS[character]) for x, c in enumerate(row) if c == "#"}
    assert cells == drawn
    loops = cut_outlines(character)
    twice = [sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(p, p[1:] + p[:1], strict=True)) for p in loops]
    assert sum(twice) == 2 * len(cells)
    assert sum(area > 0 for area in twice) == (character != " ")  # one piece, with islands or without
    corners = [p for loop in loops for p in loop]
    assert len(set(corners)) == len(corners)  # a solid that touches itself along an edge has no closed mesh


def corners_of(engraving: Engraving) -> list[np.ndarray]:
    def corners(character: str) -> np.ndarray:
        middle = [glyph_width(character) / 2, ROWS / 2]
        points = CELL * (np.array([p for loop in cut_outlines(character) for p in loop]) - middle)
        return np.column_stack([points, np.zeros(len(points)), np.ones(len(points))])

    return [(corners(c) @ T.T)[:, :2] for c, T in engraving.placed() if cut_outlines(c)]


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """Distance of two characters' corner points, an upper bound that is close where corners face each other."""
    return float(np.linalg.norm(a[:, None] - b[None], axis=2).min())


@pytest.mark.parametrize("base_d", BASES)
def test_characters_keep_to_their_place(base_d: float) -> None:
    a = adapter_of(base_d)
    digits = a.on_flange.text
    assert len(digits) >= 4 and build_geometry_of(base_d).fingerprint.startswith(digits)
    # the characters are behind the window, which keeps a wall to the nut slots, and within the flange's rim
    assert len(digits) * 2.0 * CELL <= a.window_half - 0.3e-3 and a.flange.thickness > ROWS * CELL + 0.2e-3
    slot_y = (a.ring_circle_d / 2 - a.nut_slot_reach) / np.sqrt(2.0) - a.nut_slot_width / 2
    assert a.window_half <= slot_y - WALL + 1e-9
    window = [((-a.recess_d / 2, y), 0.0) for y in (-a.window_half, a.window_half)]
    places = [
        (a.on_wall, a.recess_d / 2, a.mark_x, [*((p, M2.clearance_d / 2) for p in a.p_ring_screws), *window]),
        (a.on_ring, a.ring_bore_top_d / 2, a.body_d / 2, [(p, M2.head_d / 2) for p in a.p_ring_screws]),
    ]
    for engraving, inner, outer, holes in places:
        assert engraving.text.startswith(engraving.text[:12]) and len(engraving.text) >= 12
        characters = corners_of(engraving)
        for corners in characters:
            r = np.linalg.norm(corners, axis=1)
            assert r.min() > inner + 0.4e-3 and r.max() < outer - 0.4e-3  # the least wall of a supported feature
            for p, hole_r in holes:
                assert np.linalg.norm(corners - p, axis=1).min() > hole_r + 0.4e-3
        assert min(apart(a, b) for a, b in combinations(characters, 2)) > 0.9 * CELL


def test_a_long_name_is_shortened_and_the_fingerprint_never() -> None:
    short, long = adapter_of(3.0, "cone-60x3x1.2"), adapter_of(25.0, "cone-60x3x1.2")
    assert short.on_wall.text.startswith(short.fingerprints["sensor_adapter"])
    assert short.on_ring.text[12:].startswith(" cone-6") and long.on_ring.text.endswith(" cone-60x3x1.2")
