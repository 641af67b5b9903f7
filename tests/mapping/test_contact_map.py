"""Touches to points: what is common to all is counted once, vague touches are left apart."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from probedesign.mapping.contact_map import cloud_of
from probedesign.mapping.located import Located
from probedesign.mapping.map_files import csv_of, lines_of
from probedesign.mapping.ply import ply_of
from probedesign.mapping.touch_point import NEVER_SETTLED, Touched
from probedesign.reports.map_page import page_of
from probedesign.reports.map_picture import svg_of
from probedesign.reports.map_scene import Scene
from probedesign.simulation.card_house import SOURCE, card_house, spots, true_outlines

STD_E, STD_BASE = 0.01, 0.05e-3
NAMES = ("E", "base place", "base place", "base place")
BY_STIFFNESS = np.array([0.0, 0.05, 0.0])
"""A place moves along the probe by half of its lever times a stiffness that is off."""


def located(p, std, lever=1.0):
    """A touch at p [m] with errors of its own of so much on each axis, that tells nothing of what is common."""
    B = np.column_stack([STD_E * lever * BY_STIFFNESS, -STD_BASE * np.eye(3)])
    return Located(np.asarray(p, dtype=float), B, std**2 * np.eye(3), np.zeros((4, 4)), np.zeros(4), NAMES)


def touch(number, p, std, lever=1.0):
    series = SimpleNamespace(number=number, start=float(number))
    return Touched(series, "ok", located(p, std, lever), 0.004, np.array([1.0, 0, 0]), np.array([0.1]), std)


def test_the_base_is_common_to_all_touches_and_never_averaged_away():
    """A hundred touches of one point: their own errors shrink by ten, the base's and the stiffness' not at all."""
    cloud = cloud_of([touch(i, (0, 0, 0), 0.2e-3) for i in range(100)], STD_E)
    (point,) = cloud.points
    common = np.diag([0.05e-3**2, 0.05e-3**2 + (0.01 * 0.05) ** 2, 0.05e-3**2])
    assert point.cov_world == pytest.approx(common + (0.02e-3) ** 2 * np.eye(3), rel=1e-9, abs=1e-20)
    assert len(point.touches) == 100


def test_one_point_from_two_levers_tells_the_stiffness():
    """Both touches are off by the lever times the stiffness, so their difference tells it: 0.5 mm here at 1 %."""
    off = 0.01
    first, second = touch(1, -off * BY_STIFFNESS, 1e-6), touch(2, -2.0 * off * BY_STIFFNESS, 1e-6, lever=2.0)
    cloud = cloud_of([first, second], STD_E)
    (point,) = cloud.points
    # (1e-6)²·2 over (0.05)² of the difference leaves 3e-5 of the stiffness; the base's offset stays as it is.
    assert np.log(cloud.stiffness) == pytest.approx(off, abs=1e-4)
    assert cloud.std_stiffness < 1e-4
    assert point.p_world == pytest.approx(np.zeros(3), abs=2e-5)


def test_common_errors_do_not_part_two_touches_of_one_point():
    """They differ by less than their own errors; the common ones, greater by far, are no reason to call them one."""
    same = [touch(1, (0, 0, 0), 0.1e-3), touch(2, (0.15e-3, 0, 0), 0.1e-3)]
    apart = [touch(1, (0, 0, 0), 0.01e-3), touch(2, (0.15e-3, 0, 0), 0.01e-3)]
    assert len(cloud_of(same, STD_E).points) == 1
    assert (
        len(cloud_of(apart, STD_E).points) == 2
    )  # 10 of their standard deviations apart, of the base's only two


def test_vague_touches_are_not_called_one_point():
    """Two touches that are known to 5 mm fit each other, and many another place: nothing is gained by fusing them."""
    vague = [touch(1, (0, 0, 0), 5e-3), touch(2, (1e-3, 0, 0), 5e-3)]
    assert len(cloud_of(vague, STD_E).points) == 2
    sure = [touch(1, (0, 0, 0), 0.5e-3), touch(2, (1e-3, 0, 0), 0.5e-3)]
    assert len(cloud_of(sure, STD_E).points) == 1 and len(cloud_of(sure, STD_E, apart=0.0).points) == 2


def test_the_order_of_touches_does_not_matter():
    rng = np.random.default_rng(3)
    p = rng.normal(0.0, 0.3e-3, (9, 3)) + np.outer(np.arange(9) % 3, (0.01, 0.0, 0.0))
    touches = [touch(i, p[i], 0.3e-3, 1 + i % 2) for i in range(9)]
    told = [cloud_of(order, STD_E) for order in (touches, touches[::-1])]
    places = [np.array(sorted(point.p_world.tolist() for point in cloud.points)) for cloud in told]
    assert places[0].shape == (3, 3)
    assert places[0] == pytest.approx(places[1], abs=1e-12)


def test_the_picture_holds_every_ellipsoid():
    """Two vague points that lie near to each other: their ellipsoids are longer than the way between them."""
    picture = svg_of(
        Scene(cloud_of([touch(1, (0, 0, 0), 5e-3), touch(2, (20e-3, 0, 0), 5e-3)], STD_E))
    ).decode()
    width, height = map(float, re.findall(r'<rect width="([\d.]+)" height="([\d.]+)"', picture)[0])
    found = re.findall(r'translate\(([\d.-]+) ([\d.-]+)\) rotate.*?rx="([\d.]+)" ry="([\d.]+)"', picture)
    assert len(found) == 2
    for x, y, rx, ry in (map(float, numbers) for numbers in found):
        least = min(rx, ry)  # however the ellipse is turned, it goes so far each way
        assert least < x < width - least and least < y < height - least


def test_what_is_nought_has_no_sign():
    """A nanometre to the left of the origin, told in hundredths or ten-thousandths of a millimetre."""
    cloud = cloud_of([touch(1, (-1e-9, -1e-9, -0.0), 0.2e-3)], STD_E)
    for text in (*lines_of(cloud), csv_of(cloud).decode(), ply_of(cloud, "").decode()):
        assert not re.search(r"-0(\.0*)?\b(?![.\d])", text)
    cells = re.findall(r"<td>(.*?)</td>", page_of(Scene(cloud), "Points", []).decode())
    assert cells[1:4] == ["0.00", "0.00", "0.00"]


def test_touches_without_a_place_are_told_by_number_and_reason():
    """A line for both, of a code and of what it means."""
    lost = [Touched(SimpleNamespace(number=n, start=float(n)), NEVER_SETTLED) for n in (2, 5)]
    (line,) = lines_of(cloud_of(lost, STD_E))
    assert "touch 2 at 2.00 s, 5 at 5.00 s: never_settled" in line and "stand" in line


@pytest.mark.parametrize(("located", "doubted"), [(2, True), (4, False)])
def test_more_touches_that_contradict_themselves_than_points_put_the_poses_in_doubt(located, doubted):
    lost = [Touched(SimpleNamespace(number=n, start=float(n)), "inconsistent") for n in (10, 11, 12)]
    found = [touch(n, (0.05 * n, 0.0, 0.0), 1e-3) for n in range(located)]
    lines = [line for line in lines_of(cloud_of([*found, *lost], STD_E)) if "are not to be trusted" in line]
    assert len(lines) == doubted and all(line.startswith("3 touches contradict") for line in lines)


@pytest.mark.parametrize(("std", "times"), [(5e-3, 1), (0.5e-3, 5), (0.1e-3, 10)])
def test_ellipsoids_are_drawn_as_large_as_is_needed_to_see_them_and_that_is_told(std, times):
    """Two points 200 mm apart; a half-axis of 2.8 deviations is to be 2 mm, a fiftieth of the scene's radius."""
    scene = Scene(cloud_of([touch(i, ((-1) ** i * 0.1, 0, 0), std, lever=0.0) for i in (1, 2)], STD_E))
    assert scene.times == times
    told = "in scale" if times == 1 else f"drawn {times} times as large"
    assert told in svg_of(scene).decode()
    assert f'value="{times}" checked' in page_of(scene, "Points", []).decode()


def test_the_truth_is_drawn_and_called_so_only_where_it_is_known():
    """A rehearsal's recording says what it was read from; the edges of its cards hold the points that were touched."""
    cloud = cloud_of([touch(1, (0, 0, 0), 0.2e-3)], STD_E)
    known, unknown = Scene(cloud, true_outlines(SOURCE)), Scene(cloud, true_outlines("netft://192.168.1.1"))
    for draw in (svg_of, lambda scene: page_of(scene, "Points", [])):
        assert draw(known).count(b"<polygon") == len(card_house()) and b"simulated truth" in draw(known)
        assert b"<polygon" not in draw(unknown) and b"truth, not measured" not in draw(unknown)
    for spot in spots():
        away = [np.cross(spot.p_world - card[0], _along(card)) for card in known.truth]
        assert min(np.linalg.norm(off) for off in away) < 1e-12  # rounding


def _along(card):
    return (card[1] - card[0]) / np.linalg.norm(card[1] - card[0])
